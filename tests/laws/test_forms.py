"""Built-in laws as a user would write them: the compiled core gives the same values and trajectories."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.builtin_laws import BUILTIN_LAWS
from stickslip.core.laws.builtin import STEP
from stickslip.core.laws.compiled import MEMBERS, block_function, evaluate
from stickslip.core.laws.kinds import evaluate_role, find_user_law
from tests.conftest import make_packing, stirred

FORMS, EXAMPLES = Path(__file__).parent / "forms", Path(__file__).parents[2] / "examples"
NAMES = [law.name for law in BUILTIN_LAWS if not (law.rescales or law.parameters)]
POINTS = 10_000


def pair_of(name, **options):
    """A built-in law of two materials, and its Python form."""
    given = {"kn": 1.7, "kt": 0.6, "mu": 0.4} | options
    laws = getattr(ss.laws, name)(**given), ss.laws.from_file(FORMS / f"{name}.py", **given)
    return tuple(ss.laws.for_pair(law, 0, 1, kn=0.9, kt=0.3, mu=0.2) for law in laws)


def points(law):
    """Overlaps, radii, materials and forces at random."""
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, len(law.table), (2, POINTS))
    overlap, r_eff = 10 ** rng.uniform(-8, 0, POINTS), rng.uniform(0.1, 2.0, POINTS)
    return {"a": a, "b": b, "overlap": overlap, "r_eff": r_eff, "normal_force": rng.normal(0, 1, POINTS)}


def in_python(law, role, at, step=""):
    """Values of a function of a law, or with a step their derivatives, by plain Python."""
    out, names = [], ("overlap", "r_eff", "normal_force")
    for k in range(POINTS):
        here = {name: float(at[name][k]) for name in names}
        if step:
            here[step] = complex(here[step], STEP)
        out.append(evaluate_role(law.kind, role, law.table[at["a"][k], at["b"][k]].tolist(), **here))
    return np.imag(out) / STEP if step else np.array(out)


@pytest.mark.parametrize("name", NAMES)
def test_the_core_evaluates_a_built_in_law_as_its_python_form(name):
    law, own = pair_of(name)
    at, soft = points(law), "tangential_stiffness" in find_user_law(own.kind).functions
    wanted = "force", "stiffness", "slopes", "energy", "cap", "cap_slopes"
    core, compiled = (dict(zip(wanted, evaluate(form, *wanted, **at), strict=True)) for form in (law, own))
    push = at["normal_force"] > 0  # what the slopes of a cap are for
    kt = law.table[at["a"], at["b"], 1]
    expected = {
        "force": in_python(own, "normal_force", at),
        "stiffness": in_python(own, "tangential_stiffness", at) if soft else kt,
        "slopes": np.stack([
            in_python(own, "normal_force", at, "overlap"),
            in_python(own, "tangential_stiffness", at, "overlap") if soft else 0 * kt,
        ], axis=1),
        "energy": core["energy"],
        "cap": in_python(own, "cap", at),
        "cap_slopes": np.stack([in_python(own, "cap", at, "normal_force"), 0 * kt], axis=1)[push],
    }  # fmt: skip
    for name, values in expected.items():
        for computed in (core[name], compiled[name]):
            np.testing.assert_allclose(computed[push] if name == "cap_slopes" else computed, values, rtol=1e-13)


@pytest.mark.parametrize("name", ["cohesive", "rolling"])
def test_every_c_function_of_a_law_is_its_python_function(name):
    law = ss.laws.from_file(EXAMPLES / f"{name}_law.py")
    own, at = find_user_law(law.kind), points(law)
    at["overlap"] = np.random.default_rng(1).uniform(-0.05, 0.1, POINTS)
    roles = {  # function and the variable of a derivative
        "force": [("normal_force", ""), ("tangential_stiffness", "")],
        "slopes": [("normal_force", "overlap"), ("tangential_stiffness", "overlap")],
        "cap": [("cap", "")], "cap_slopes": [("cap", "normal_force"), ("cap", "overlap")],
        "range": [("contact_range", "")], "rolling": [("rolling_stiffness", ""), ("rolling_stiffness", "overlap")],
        "rolling_cap": [("rolling_cap", "")],
        "rolling_slopes": [("rolling_cap", "normal_force"), ("rolling_cap", "overlap")],
    }  # fmt: skip
    for member, outputs in roles.items():
        if MEMBERS[member] not in own.functions:
            continue
        out, numbers = np.zeros((2, POINTS)), np.ascontiguousarray(law.table[0, 0])
        arrays = numbers, at["r_eff"], at["overlap"], at["normal_force"], np.zeros(0), out[0], out[1]
        q, *rest = (ctypes.c_void_p(array.ctypes.data) for array in arrays)
        ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, *6 * [ctypes.c_void_p])(
            block_function(law.kind, member).address
        )(q, POINTS, *rest)
        for values, (role, step) in zip(out, outputs, strict=False):
            if role in own.functions:
                expected = in_python(law, role, at, step)
                np.testing.assert_allclose(values, expected, rtol=1e-13, atol=1e-15 * np.abs(expected).max())


def test_caps_are_not_negative_and_zero_without_friction():
    given = {"normal_force": lambda overlap, kn: kn * overlap, "cap": lambda normal_force: normal_force - 1.0}
    for mu, cap in ((1.0, [0.0, 1.0]), (0.0, [0.0, 0.0])):
        law = ss.laws.custom(**given, parameters={"mu": mu})
        limit, slopes = evaluate(law, "cap", "cap_slopes", overlap=0.1, normal_force=[0.5, 2.0])
        np.testing.assert_array_equal(limit, cap)
        np.testing.assert_array_equal(slopes, [[0.0, 0.0], [np.sign(cap[1]), 0.0]])


def test_the_energy_by_quadrature_is_the_integral_of_the_force():
    law = ss.laws.from_file(EXAMPLES / "cohesive_law.py", tension=0.1)
    edges = np.linspace(-0.05, 0.1, 3001)
    force = evaluate(law, "force", overlap=edges, r_eff=0.25)
    steps = np.diff(edges) * (force[1:] + force[:-1]) / 2
    energy = evaluate(law, "energy", overlap=edges, r_eff=0.25)
    np.testing.assert_allclose(energy[1:], np.cumsum(steps), rtol=0, atol=1e-6 * np.abs(energy).max())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("options", [{}, {"coulomb": "smooth"}, {"damping_n": 0.3, "damping_t": 0.1}])
def test_a_run_with_the_python_form_is_a_run_with_the_built_in_law(name, options):
    options = dict(options)
    coulomb = options.pop("coulomb", "sharp")
    laws = [law._replace(coulomb={"sharp": 0, "smooth": 1}[coulomb]) for law in pair_of(name, **options)]
    laws[0] = laws[0]._replace(damping=laws[1].damping)
    ends = [ss.run(stirred(make_packing(3), law, np.random.default_rng(1)), law, 200, 0.02)[0] for law in laws]
    for field in ("position", "velocity", "spin"):
        values = [getattr(end.grains, field) for end in ends]
        np.testing.assert_allclose(values[1], values[0], atol=1e-12 * np.abs(values[0]).max())
    np.testing.assert_array_equal(ends[1].contacts.mode, ends[0].contacts.mode)


def test_a_power_that_loses_its_slope_when_compiled_is_refused_where_slopes_are_needed():
    """It is the power of a number that is negative at small overlaps; Python alone gives the right slope."""
    law = ss.laws.custom(
        normal_force=lambda overlap, kn: kn * (overlap + 100 * ((overlap - 0.02) ** 3 + 8e-6)), size=0.5
    )
    pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law, dim=2)
    with pytest.raises(ValueError, match=r"normal_force at overlap = .* when compiled: write x \* x \* x"):
        ss.jacobian(pair, law)
