"""Built-in laws with parameters of their own, against the same laws as a user writes them, and closed forms."""

import runpy
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.builtin_laws import BUILTIN_LAWS, BY_NAME, NAMES
from stickslip.core.laws.builtin import LEVER, laws_equal
from stickslip.core.laws.compiled import evaluate, law_struct
from stickslip.core.laws.kinds import find_user_law
from stickslip.core.library import core
from stickslip.data.exchange.frame import law_from_dict, law_to_dict
from stickslip.data.sample import PackingError, law_by_name
from stickslip.data.schema import ScenarioError
from stickslip.wings.studies.flow.pouring import flow_law
from tests.conftest import make_packing, stickslip_here, stirred

EXAMPLES = Path(__file__).parents[2] / "examples"
PACKING = EXAMPLES / "sheared_spheres.npz"
FORMS, POINTS = Path(__file__).parent / "forms", 3000
FORM = {law.name: FORMS / f"{law.name}.py" for law in BUILTIN_LAWS if law.parameters}
FORM |= {"walton_braun": EXAMPLES / "walton_braun_law.py"}  # stands in the guide to laws
DEFAULTS = {name: runpy.run_path(str(path))["parameters"] for name, path in FORM.items()}
OWN = {name: {p.name: DEFAULTS[name][p.name] for p in BY_NAME[name].parameters} for name in FORM}
EVERY = pytest.mark.parametrize("name", OWN)
pytestmark = pytest.mark.filterwarnings("ignore:the normal force of dmt jumps")  # as it does by definition


def pair_of(name, **options):
    """A built-in law of two materials, and its Python form."""
    given = {"kn": 1.7, "kt": 0.6, "mu": 0.4} | OWN[name] | options
    laws = getattr(ss.laws, name)(**given), ss.laws.from_file(FORM[name], **given)
    return tuple(ss.laws.for_pair(law, 0, 1, kn=0.9, kt=0.3, mu=0.2) for law in laws)


def test_every_law_has_a_line_in_the_guide():
    guide = (Path(__file__).parents[2] / "docs" / "contact_laws.md").read_text()
    for law in BUILTIN_LAWS:
        assert law.rescales or f"\n| `{law.name}` |" in guide
        assert all(f"`{p.name}`" in guide for p in law.parameters)


@EVERY
def test_a_law_has_the_values_of_its_python_form(name):
    rng, laws = np.random.default_rng(0), pair_of(name)
    a, b = rng.integers(0, 2, (2, POINTS))
    r_eff, deep = rng.uniform(0.1, 2.0, POINTS), 10 ** rng.uniform(-6, 0, POINTS)
    at = {"a": a, "b": b, "r_eff": r_eff, "m_eff": np.ones(POINTS), "fn": rng.normal(0, 1, POINTS)}
    reach = np.zeros(POINTS)
    if BY_NAME[name].bonds:
        reach = evaluate(laws[1], "range", **{k: at[k] for k in ("a", "b", "r_eff")}, overlap=0.0)
    at["overlap"] = np.where(rng.uniform(size=POINTS) < 0.5, deep, -rng.uniform(0, 0.99, POINTS) * reach)
    at["overlap"] = np.where(at["overlap"] == 0, deep, at["overlap"])
    at["memory"] = deep[rng.permutation(POINTS)][:, None].copy() if BY_NAME[name].memory else None
    values = []
    for law in laws:
        out = {key: np.zeros(POINTS) for key in ("force", "stiffness", "energy", "cap", "range")}
        out |= {key: np.zeros((POINTS, 2)) for key in ("slopes", "cap_slopes")} | {"damping": np.zeros(POINTS)}
        core.law_values(law_struct(law), {key: at[key] for key in at} | out)
        values.append(out)
    for key, computed in values[0].items():
        if key == "energy" and "normal_energy" not in find_user_law(laws[1].kind).functions:
            continue  # by quadrature
        expected = values[1][key]
        # differences of terms as large as the largest
        np.testing.assert_allclose(computed, expected, rtol=1e-9, atol=1e-13 * np.abs(expected).max(), err_msg=key)


@EVERY
@pytest.mark.parametrize("options", [{}, {"coulomb": "smooth"}, {"damping_n": 0.3, "damping_t": 0.1}])
def test_a_run_with_the_python_form_is_a_run_with_the_built_in_law(name, options):
    options = dict(options)
    coulomb = {"sharp": 0, "smooth": 1}[options.pop("coulomb", "sharp")]
    laws = [law._replace(coulomb=coulomb) for law in pair_of(name, **options)]
    assert laws[0].damping == laws[1].damping
    ends = [ss.run(stirred(make_packing(3), law, np.random.default_rng(1)), law, 200, 0.02)[0] for law in laws]
    for field in ("position", "velocity", "spin"):
        values = [getattr(end.grains, field) for end in ends]
        np.testing.assert_allclose(values[1], values[0], atol=1e-11 * np.abs(values[0]).max())
    np.testing.assert_array_equal(ends[1].contacts.mode, ends[0].contacts.mode)


@pytest.mark.parametrize("name", ["jkr", "dmt", "liquid_bridge"])  # the other stores less than it is given
def test_the_force_is_the_slope_of_the_energy(name):
    law, _ = pair_of(name)
    edge = float(evaluate(law, "range", overlap=0.0, r_eff=0.25)) if BY_NAME[name].bonds else 0.0
    x = np.concatenate([np.linspace(-0.95 * edge, -0.05 * edge, 20) if edge else [], np.geomspace(1e-3, 0.2, 20)])
    sides = [evaluate(law, "energy", overlap=x + h, r_eff=0.25) for h in (1e-6, -1e-6)]
    force, slope = evaluate(law, "force", "slopes", overlap=x, r_eff=0.25)
    np.testing.assert_allclose((sides[0] - sides[1]) / 2e-6, force, atol=1e-7 * np.abs(force).max())
    ends = [evaluate(law, "force", overlap=x + h, r_eff=0.25) for h in (1e-6, -1e-6)]
    np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, slope[:, 0], atol=1e-5 * np.abs(slope[:, 0]).max())
    if edge:  # nothing is stored where the range ends
        assert abs(evaluate(law, "energy", overlap=-edge * (1 - 1e-12), r_eff=0.25)) < 1e-9


def test_without_adhesion_or_liquid_laws_are_those_of_dry_spheres():
    x, dry = np.geomspace(1e-4, 0.3, 30), ss.laws.hertz_mindlin_reff(2.0, 0.7)
    expected = evaluate(dry, "force", "stiffness", "slopes", overlap=x, r_eff=0.3)
    for law in (
        ss.laws.jkr(2.0, 0.7, work=0.0), ss.laws.dmt(2.0, 0.7, work=0.0),
        ss.laws.liquid_bridge(2.0, 0.7, surface_tension=0.0, volume=1e-3),
        ss.laws.liquid_bridge(2.0, 0.7, surface_tension=1.0, volume=0.0),
    ):  # fmt: skip
        for mine, theirs in zip(
            evaluate(law, "force", "stiffness", "slopes", overlap=x, r_eff=0.3), expected, strict=True
        ):
            np.testing.assert_allclose(mine, theirs, rtol=1e-12)


def test_pull_off_forces():
    x = np.linspace(-0.05, 0.05, 200_001)
    for law, pull in ((ss.laws.jkr(work=1e-3), 1.5), (ss.laws.dmt(work=1e-3), 2.0)):
        edge = 0.0 if pull == 2.0 else float(evaluate(law, "range", overlap=0.0, r_eff=0.25))
        force = evaluate(law, "force", overlap=x[x > -edge], r_eff=0.25)
        assert force.min() == pytest.approx(-pull * np.pi * 1e-3 * 0.25, rel=1e-6)


@EVERY
def test_laws_have_names_units_and_survive_text(name):
    law, _ = pair_of(name)
    back = law_from_dict(law_to_dict(law))
    assert back.kind == law.kind and np.array_equal(back.table, law.table)
    assert all(parameter in repr(law) for parameter in OWN[name])
    known = law_by_name(name, "sharp", 1.7, 0.6, 0.4, **OWN[name])
    assert known.kind == law.kind
    with pytest.raises(PackingError, match=next(iter(OWN[name]))):
        law_by_name(name)


def test_wrong_values_are_refused_in_one_sentence():
    with pytest.raises(ValueError, match=r"k_unload must be at least kn, .* got 0.5 kn"):
        ss.laws.walton_braun(kn=2.0, k_unload=1.0)
    with pytest.raises(ValueError, match=r"work must be finite and not negative, got -1"):
        ss.laws.jkr(work=-1)
    with pytest.raises(ValueError, match=r"k_unload must be at least kn, .* got 0.25 kn"):
        ss.laws.for_pair(ss.laws.walton_braun(k_unload=1.0), 0, 1, kn=4.0)
    with pytest.raises(ValueError, match="`collision` supports the normal forces"):
        ss.laws.collision(ss.laws.jkr(work=1e-3), radius=1.0, mass=1.0, speed=1.0)


def flow(law):
    """A flow of four disks with a law table."""
    grains = {"number": 4, "mass": 1.0, "low": [0.0, 0.0], "high": [6.0, 16.0]}
    tables = {"experiment": "flow", "stages": [{"name": "settle", "duration": 1.0}], "gravity": [0.0, -1.0]}
    return ss.scenario(grains=grains, law={"kn": 1e4} | law, **tables)


SPRING = {"rolling": "spring", "k_roll": 100.0, "mu_roll": 0.1}
TWIST = {"twisting": "spring", "k_twist": 5.0, "mu_twist": 0.02}


def test_flows_take_lever_arms_and_moments():
    law = flow_law(flow({"lever": "overlap"} | SPRING | TWIST), [0.5], [1.0])
    wanted = ss.laws.with_twisting(
        ss.laws.with_rolling(
            ss.laws.with_lever(
                ss.laws.linear(1e4, 2 / 7 * 1e4, 0.5, damping="mass_velocity", tension=False), "overlap"
            ),
            k_roll=100.0, mu_roll=0.1,
        ),
        k_twist=5.0, mu_twist=0.02,
    )  # fmt: skip
    assert laws_equal(law, wanted)
    viscous = flow_law(flow({"rolling": "viscous", "gamma_roll": 0.3}), [0.5], [1.0])
    assert viscous.table[0, 0, 5:].tolist() == [0.0, 0.0, 0.3] and not viscous.properties & LEVER


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (SPRING | {"mu_roll": 0.0}, "law.mu_roll is missing or zero: law.rolling = 'spring' needs it"),
        ({"rolling": "constant", "mu_roll": 0.1}, "law.gamma_roll is missing or zero: law.rolling = 'constant'"),
        ({"k_roll": 1.0}, "law.k_roll requires law.rolling"),
        (SPRING | {"rolling": "viscous", "gamma_roll": 0.1}, "law.rolling = 'viscous' does not use law.k_roll"),
        ({"twisting": "spring", "k_twist": 1.0}, "law.mu_twist is missing or zero"),
        ({"lever": "arm"}, "law.lever must be 'radius' or 'overlap', got 'arm'"),
    ],
)
def test_moments_that_do_not_fit_are_refused_in_one_sentence(law, message):
    with pytest.raises(ScenarioError, match=message) as problem:
        flow(law)
    assert "\n" not in str(problem.value)


def test_the_damping_ratio_of_a_restitution_is_that_of_the_dashpots():
    table = {"damping": "coeff_restitution", "damping_n": 0.6, "damping_ratio": 0.5}
    assert flow_law(flow(table), [0.5], [1.0]).table[0, 0, 3:].tolist() == [0.6, 0.5]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--law", "jkr"], 2, "jkr needs work, work of adhesion [energy/length^2]: give it (--parameter work=…)"),
        (["--law", "jkr", "--parameter", "work=0", "--coulomb", "sharp"], 3, "not in equilibrium"),
        (["--law", "linear", "--parameter", "work=1"], 2, "linear has no parameter work: it has kn, kt, mu,"),
        (["--law", "jkr", "--parameter", "volume=1", "--parameter", "work=1"], 2, "kt, mu, damping_n, damping_t, work"),
        (["--law", "jkr", "--parameter", "work"], 2, "expected a name and a number as in work=1e-3, got 'work'"),
        (["--law", "jkr", "--parameter", "work=one"], 2, "'one' is not a number"),
    ],
)
def test_parameters_of_a_law_on_the_command_line(tmp_path, arguments, code, said):
    done = stickslip_here("stability", PACKING, "-q", *arguments, cwd=tmp_path)
    assert done.returncode == code
    assert said in " ".join((done.stdout + done.stderr).split())
    assert code == 3 or done.stderr.count("\n") == 1


@EVERY
def test_flows_take_a_law_with_its_own_parameters(name):
    own = OWN[name] | ({"k_unload": 3e4} if name == "walton_braun" else {})
    law = flow_law(flow({"kind": name} | own), [0.5], [1.0])
    assert NAMES[law.kind] == name
    assert law.table[0, 0, 5:].tolist() == list(own.values())
    with pytest.raises(ScenarioError, match=f"law.{sorted(own)[0]} is missing: give it"):
        flow({"kind": name})
    with pytest.raises(ScenarioError, match=f"is not a parameter of {name}: leave it out"):
        flow({"kind": name, "work": 1.0, "k_unload": 1.0, "volume": 1.0} | own)
