"""Recipes of `docs/about/extending.md`, step by step in a copy of the sources: a law, an observable, a file format, a
claim."""

import json
import os
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from stickslip.cli import main
from stickslip.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[2]
ENTRY = """\
    BuiltinLaw(
        "stiffening", "k √R δ^(3/2) (1 + c δ)", 1.5, ("Hertz1882",), uses_radius=True,
        parameters=(Parameter("stiffening_c", "1/length", "relative growth of the stiffness"),),
    ),
"""
FORMULA = """\
struct Stiffening : Plain {
  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    Elastic<T> out = hertz(at);
    return {out.force * (at.q[OWN] * at.overlap + 1.0), out.stiffness};
  }

  static double energy(const At<double> &at) {
    return hertz(at).force * at.overlap * (0.4 + 2.0 / 7.0 * at.q[OWN] * at.overlap);
  }
};

"""
CONSTRUCTOR = '''\
@checked
def stiffening(
    kn=1.0, kt=2 / 7, mu=0.5, *, stiffening_c, coulomb="sharp", damping="viscoelastic", damping_n=0.0, damping_t=0.0,
    tension: bool = True,
) -> Law:  # fmt: skip
    """F_n = k_n √R_eff δ^{3/2} (1 + c δ)."""
    own = {"stiffening_c": stiffening_c}
    return make_law("stiffening", coulomb, damping, tension, kn, kt, mu, damping_n, damping_t, **own)


'''
FORM = """\
from math import sqrt

parameters = {"kn": 1.0, "kt": 0.8, "mu": 0.5, "stiffening_c": 0.7}
damping = "viscoelastic"


def normal_force(overlap, r_eff, kn, stiffening_c):
    return kn * overlap * sqrt(overlap * r_eff) * (1 + stiffening_c * overlap)


def normal_energy(overlap, r_eff, kn, stiffening_c):
    return kn * overlap**2 * sqrt(overlap * r_eff) * (0.4 + 2 / 7 * stiffening_c * overlap)


def tangential_stiffness(overlap, r_eff, kt):
    return kt * sqrt(overlap * r_eff)
"""
STEPS = {  # file: text, and the text that comes before it
    "src/stickslip/builtin_laws.py": (")  # fmt: skip\nBY_NAME", ENTRY),
    "src/stickslip/_core/normal_laws.cpp": ("enum Member", FORMULA),
    "src/stickslip/core/laws/builtin.py": ("CONSTRUCTORS: dict", CONSTRUCTOR),
    "src/stickslip/laws.pyi": (
        "from .core.laws.builtin import walton_braun", "from .core.laws.builtin import stiffening as stiffening\n",
    ),
    "docs/contact_laws.md": ("| `walton_braun` |", "| `stiffening` | Hertz (1 + c δ) | `stiffening_c` |\n"),
}  # fmt: skip


STRUCTS = """\
struct Momentum : Sums<3> {
  static constexpr const char *NAME = "momentum";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    const Vec<double> v = view.velocity(a);
    const double entry[3] = {v.x, v.y, v.z};
    for (int k = 0; k < 3; ++k) sum[k] += view.mass(a) * entry[k];
  }
};

struct WallContacts : Sums<1> {
  static constexpr const char *NAME = "wall_contacts";
  static void add_contact(const Seen &seen, double *sum) { *sum += seen.wall ? seen.part : 0.0; }
};

struct ContactForce : Sums<1> {
  static constexpr const char *NAME = "contact_force";
  static void add_contact(const Seen &seen, double *sum) { *sum += seen.part * root(dot(seen.force, seen.force)); }
};

"""
FIELDS = """\
    momentum: np.ndarray  # (T, 3) Σ m v over grains [mass length/time]
    wall_contacts: np.ndarray  # (T,) number of closed contacts with walls
    contact_force: np.ndarray  # (T,) Σ|f| over contacts, elastic part [force]
"""
OBSERVABLE = {
    "src/stickslip/_core/observables.h": ("template <class... Ones>", STRUCTS),
    "src/stickslip/core/dynamics/record.py": ("    group_position: np.ndarray", FIELDS),
}
TABLE = "src/stickslip/_core/observables.h", "CellVectors>;", "CellVectors, Momentum, WallContacts, ContactForce>;"
USED = """
import numpy as np
import stickslip as ss
state, law = ss.packings.biaxial_box(12, seed=1)
n = len(state.grains.radius)
velocity = 1e-9 * np.random.default_rng(0).normal(size=(n, 3)) * [1, 1, 0]
state = state._replace(grains=state.grains._replace(velocity=velocity))
end, record, _ = ss.run(state, law, 20, 0.05, every=20)
assert record.momentum.shape == (2, 3) and abs(record.momentum[0, 0]) > 0
np.testing.assert_allclose(record.momentum[-1], end.grains.mass @ end.grains.velocity, rtol=1e-9, atol=1e-24)
walls = int((end.contacts.j[ss.measure.touching(end)] >= n).sum())
assert record.wall_contacts[-1] == walls > 0
force = np.linalg.norm(ss.measure.contact_forces(end, law), axis=1).sum()
np.testing.assert_allclose(record.contact_force[-1], force, rtol=1e-9)
assert force > 0
"""
FORMAT = '''\
"""Packings as lines of coins."""

import numpy as np

from ..run_files import replace_atomically
from .columns import Packing, extent_note, mass_note, only_state, read_lines


def recognize(head):
    return head.startswith(b"coins\\n")


def read(path, frame=None):
    only_state(path, frame)
    x, y, radius = np.array([line.split() for line in read_lines(path).splitlines()[1:]], float).T
    arrays = {"position": np.stack([x, y, 0 * x], axis=1), "radius": radius, "dim": 2}
    return [Packing("0", arrays, [mass_note(path.name), extent_note(path.name)])]


def write(path, frames):
    grains = frames[0].state.grains
    with replace_atomically(path) as part:
        rows = np.column_stack([grains.position[:, :2], grains.radius]).tolist()
        part.write_text("coins\\n" + "".join(" ".join(map(repr, row)) + "\\n" for row in rows))
    return ["coins have neither masses nor contacts"]
'''
DOOR = {  # lines of files.py, and the texts before which they stand
    '    Format("VTK"': '    Format("coins", _here("coins.recognize"), _here("coins.read")),\n',
    "LAW_OPTIONS =": 'SERIES[".coins"] = _here("coins.write")\n',
}
TRADE = """
import numpy as np, stickslip as ss
state = ss.assembly(ss.disks([[0, 0, 0], [0.9, 0, 0]], [0.5, 0.4]))
law = ss.laws.linear()
state = ss.accept(state, ss.forces(state, law)[1])
notes = ss.io.write_packing("two.coins", state, law)
assert notes == ["coins have neither masses nor contacts"]
back = ss.io.read_packing("two.coins", law=law)
assert np.array_equal(back.state.grains.radius, [0.5, 0.4]) and len(back.assumed) == 2
"""
CLAIM = {  # text of the claims of sheared spheres, and the text that comes before it
    '    "pairs": 0.0,': '    "rattlers": 0.5,  # a number of a few per cent, from a few packings\n',
    '    "Sec. II": (': '    "Sec. I": ("rattlers", "share-of-rattlers"),\n',
    '        claim(\n            "pairs-at-zero-slip"': """\
        median_claim(
            "share-of-rattlers", "Sec. I: some spheres are rattlers", 0.02,
            [p.packed.rattlers / main.scenario.packing.grains for p in paths], "1", "rattlers", "before shear",
        ),
""",
}


EXPERIMENT = {  # files of the folder of an experiment
    "scenario.py": '''\
"""Scenario of tosses of a coin."""

from typing import Literal

from pydantic import Field

from ....kit import NotNegative, ScenarioBase, Seed


class CoinScenario(ScenarioBase):
    """A hundred tosses of a coin."""

    experiment: Literal["coins"] = "coins"
    seed: Seed = 0
    bias: NotNegative = Field(0.5, description="probability of heads")
''',
    "simulate.py": '''\
"""Tosses of a coin."""

from typing import NamedTuple

import numpy as np

from .scenario import CoinScenario


class Tosses(NamedTuple):
    """Heads and tails."""

    scenario: CoinScenario
    heads: np.ndarray  # (T,) 1 for heads


def simulate(scenario, *, folder=None, workers=None, report=None) -> Tosses:
    """Toss the coin."""
    return Tosses(scenario, (np.random.default_rng(scenario.seed).random(100) < scenario.bias).astype(float))
''',
    "report.py": '''\
"""Measures, archive and summary of tosses of a coin."""

from ....kit import Measures, Quantity, console

MEASURES = Measures([Quantity("share", "1", "share of heads", lambda result: result.heads.mean())])


def numbers(result) -> dict:
    """Contents of the archive."""
    return {"heads": result.heads}


def show(result) -> None:
    """Print the number of heads."""
    console.print(f"{result.heads.sum():.0f} heads")


def figures(result):
    """Figures of a run."""
    from .figures import draw

    yield "fig1_heads.png", draw(result)
''',
    "figures.py": '''\
"""Figure of tosses of a coin."""

from ....kit import column_axes, label_axes, styled


@styled
def draw(result):
    """Number of heads against the number of tosses."""
    figure, axes = column_axes()
    axes.plot(result.heads.cumsum())
    label_axes(axes, x=("tosses", "1"), y=("heads", "1"))
    return figure
''',
    "__init__.py": '''\
"""Tosses of a coin."""

from functools import partial

from ....kit import Experiment, lazy_function, lazy_functions
from .scenario import CoinScenario

_here = partial(lazy_function, __name__)

EXPERIMENT = Experiment(
    scenario=CoinScenario,
    words="tosses of a coin",
    simulate=_here("simulate.simulate"),
    **lazy_functions(__name__, "report", "numbers", "show", "figures"),
    measures=_here("report.MEASURES"),
    references=lambda scenario: {},
    smallest=({},),
    parallel=False,
)
''',
}
CHANGED = {  # existing files, each with the text before which a line is inserted
    "src/stickslip/wings/studies/wing.py": (
        '        "failure": ExperimentEntry("failure"),', '        "coins": ExperimentEntry("coins"),\n',
    ),
}  # fmt: skip
THERE = """
import runpy
import sys
import stickslip as ss
import stickslip.experiments.coins.simulate
from stickslip.cli import main
assert "coins" in ss.experiments.__all__ and ss.figures.coins.draw.__doc__
swept = ss.run_sweep(ss.sweep(experiment="coins", sweep={"bias": [0.0, 1.0]}), "sweep", workers=1)
assert list(ss.io.open_sweep("sweep").share.values) == [0.0, 1.0] and swept.failures == ["", ""]
page = runpy.run_path(sys.argv[1])["page"]("coins", ss.experiments.coins.CoinScenario)
assert "| `share` | – | share of heads |" in page and "| `bias` |" in page
sys.argv = ["stickslip", "run", "coins.toml", "--out", "out"]
main()
"""
GONE = """
import stickslip as ss
from stickslip.words import suggestions
for name in ("coins", "threshold"):
    for space in (ss.experiments, ss.figures):
        assert name not in dir(space) and name not in space.__all__
        try:
            getattr(space, name)
        except AttributeError as said:
            assert f"has no attribute '{name}'" in str(said), said
        else:
            raise AssertionError(name)
    try:
        ss.scenario(experiment=name)
    except ss.experiments.ScenarioError as said:
        assert f"'flow', 'catalogue', 'failure', 'element-test', " in str(said) and f"got '{name}'" in str(said)
    else:
        raise AssertionError(name)
assert "experiments.threshold" not in suggestions("yield_stress")
assert ss.experiments.gouge.EXPERIMENT.name == "gouge" and ss.simulate(ss.scenario(experiment="rate-state"))
"""


def copy_sources(to: Path) -> None:
    for folder in ("src", "tests", "docs", "examples"):
        shutil.copytree(ROOT / folder, to / folder, ignore=shutil.ignore_patterns("__pycache__", "_build"))
    shutil.copy(ROOT / "pyproject.toml", to)


def insert(path: Path, after: str, text: str) -> None:
    """Insert a text before another that occurs once."""
    before = path.read_text()
    assert before.count(after) == 1, (path, after)
    path.write_text(before.replace(after, text + after))


def run_python(folder: Path, *arguments: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(folder / "src")}
    run = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_law_needs_one_entry_one_formula_one_constructor_one_form_and_one_line(tmp_path):
    copy_sources(tmp_path)
    for name, (after, text) in STEPS.items():
        insert(tmp_path / name, after, text)
    formulas, last = tmp_path / "src/stickslip/_core/normal_laws.cpp", "function<LiquidBridge>}"
    formulas.write_text(formulas.read_text().replace(last, last.replace("}", ", function<Stiffening>}")))
    (tmp_path / "tests/laws/forms/stiffening.py").write_text(FORM)
    run_python(tmp_path, "src/stickslip/_core/build.py")
    tests = ("-m", "pytest", "-x", "-p", "no:cacheprovider", "tests/laws/test_normal_laws.py")
    said = run_python(tmp_path, *tests, "-k", "stiffening or guide")
    assert " passed" in said and "skipped" not in said


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_observable_needs_a_struct_a_name_in_the_table_and_a_field(tmp_path):
    """Runs record it, of grains and of contacts; batches do so as runs do."""
    copy_sources(tmp_path)
    for name, (after, text) in OBSERVABLE.items():
        insert(tmp_path / name, after, text)
    name, end, more = TABLE
    (tmp_path / name).write_text((tmp_path / name).read_text().replace(end, more))
    run_python(tmp_path, "src/stickslip/_core/build.py")
    run_python(tmp_path, "-c", USED)
    tests = ("-m", "pytest", "-x", "-p", "no:cacheprovider", "tests/unit/test_record.py", "tests/device/test_batch.py")
    assert " passed" in run_python(tmp_path, *tests, "-m", "not slow")


def test_a_file_format_needs_a_module_and_a_line_to_read_and_to_write_it(tmp_path):
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", ".objects"))
    door = tmp_path / "src/stickslip/data/exchange/files.py"
    (door.parent / "coins.py").write_text(FORMAT)
    for after, text in DOOR.items():
        insert(door, after, text)
    run_python(tmp_path, "-c", TRADE)


def test_an_experiment_needs_a_folder_and_a_line_and_is_deleted_with_them(tmp_path):
    """As `docs/about/extending.md` says; it can be run, drawn, and read about. The same for one that exists."""
    recipe = (ROOT / "docs/about/extending.md").read_text().partition("**An experiment.**")[2].partition("**A file")[0]
    assert all(f"`{name}`" in recipe for name in ("wing.py", *EXPERIMENT))
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", ".objects"))
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    wing = tmp_path / "src/stickslip/wings/studies"
    head, folder = wing / "wing.py", wing / "coins"
    before = head.read_text()
    folder.mkdir()
    for name, text in EXPERIMENT.items():
        (folder / name).write_text(text)
    for name, (after, text) in CHANGED.items():
        insert(tmp_path / name, after, text)
    (tmp_path / "coins.toml").write_text('experiment = "coins"\nbias = 1.0\n')
    assert "100 heads" in run_python(tmp_path, "-c", THERE, str(ROOT / "docs" / "scenario_reference.py"))
    assert {"fig1_heads.png", "results.h5"} <= {path.name for path in (tmp_path / "out").iterdir()}
    shutil.rmtree(folder)
    shutil.rmtree(wing / "threshold")
    entry = before.index('        "threshold": ')
    head.write_text(before[:entry] + before[before.index('        "catalogue": ') :])
    run_python(tmp_path, "-c", GONE)


@pytest.mark.usefixtures("plain_figures")
def test_a_claim_needs_a_row_a_tolerance_and_its_place_in_the_paper(tmp_path, monkeypatch, capsys):
    """The terminal, `claims.md` and `claims.json` have it; the scenario is the smallest one."""
    name, path = "stickslip.wings.papers.sphere_shear.claims", tmp_path / "copy" / "claims.py"
    shutil.copytree(ROOT / "src/stickslip/wings/papers/sphere_shear", path.parent)
    for after, text in CLAIM.items():
        insert(path, after, text)
    spec = spec_from_file_location(name, path)
    copy = module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, copy)
    spec.loader.exec_module(copy)
    small = copy.validate_scenario(copy.ShearScenario, **EXPERIMENTS["sphere-shear"].smallest[0])
    monkeypatch.setattr(copy, "paper_scenario", lambda **_: small)
    monkeypatch.setattr(
        sys, "argv", ["stickslip", "reproduce", "sphere-shear", "--quick", "--out", str(tmp_path / "out")]
    )
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 0
    assert "Sec. I " in capsys.readouterr().out
    (row,) = (one for one in json.loads((tmp_path / "out/claims.json").read_text()) if one["id"] == "share-of-rattlers")
    assert (row["paper"], row["tolerance"], row["measured"]) == (0.02, 0.5, 0.0)
    assert row["verdict"] == "undecided" and "share-of-rattlers" in (tmp_path / "out/claims.md").read_text()


@pytest.mark.parametrize(
    ("name", "inner"),
    [("experiments.element_test", "soils.element_test"), ("experiments.gouge.measures", "papers.gouge.measures"),
     ("figures.gouge", "papers.gouge.figures")],
)  # fmt: skip
def test_public_names_of_modules_in_wings_can_be_imported(name, inner):
    module, own = import_module(f"stickslip.{name}"), import_module(f"stickslip.wings.{inner}")
    assert module is own and own.__spec__.name == own.__name__
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'stickslip\.experiments\.none'"):
        import_module("stickslip.experiments.none")
