"""A wing of somebody else: `ss.simulate`, the command line, sweeps and `resume` know its experiment.

Without a wing, or with a broken one, everything else works.
"""

import json
import os
import runpy
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pytest

import stickslip as ss
from stickslip import wing
from stickslip.cli import main
from stickslip.data.checkpoint import checkpoint_in, load_or_compute
from stickslip.data.schema import NotNegative, ScenarioBase, Seed
from stickslip.experiments import EXPERIMENTS, Experiment
from stickslip.experiments.registry import _written_names
from stickslip.kit import Measures, Quantities, Quantity, result_of
from stickslip.runs.writer import write_result
from stickslip.wing import GROUP, Wing

ROOT = Path(__file__).parents[2]


class Coins(ScenarioBase):
    """So many tosses of a coin."""

    experiment: Literal["coins"] = "coins"
    seed: Seed = 0
    bias: NotNegative = 0.5


class Tosses(NamedTuple):
    scenario: Coins
    heads: np.ndarray


CALLS = []


def simulate(scenario, *, folder=None, workers=None, report=lambda *now: None):
    kept = checkpoint_in(folder, scenario)
    heads = load_or_compute(kept, "tosses", lambda: np.random.default_rng(scenario.seed).random(100) < scenario.bias)
    CALLS.append(scenario.seed)
    if len(CALLS) == 1 and folder:
        raise KeyboardInterrupt
    return Tosses(scenario, np.asarray(heads))


TOSS = Quantities([Quantity("heads", "1", "1 for heads", lambda result: result.heads)])
EXPERIMENT = Experiment(
    Coins, "tosses of a coin", simulate,
    numbers=lambda result: {"heads": result.heads.astype(float)},
    measures=Measures([Quantity("share", "1", "share of heads", lambda result: result.heads.mean())]),
    show=lambda result: print(f"{result.heads.sum()} heads"),
    files=lambda result: [("tosses.csv", lambda path: TOSS.write(path, [result]))],
    writes=(r"tosses\.csv",),
)  # fmt: skip
result_of(EXPERIMENT)(Tosses)
# the head of a wing is all that names the experiment
WING = Wing("coins_wing", "tosses of a coin", experiments={"coins": "coins"})
COINS = EntryPoint("coins", f"{__name__}:WING", GROUP)


@pytest.fixture
def install(monkeypatch):
    """Function that installs wings, and uninstalls others."""

    def change(*more, without=()):
        kept = [entry for entry in entry_points(group=GROUP) if entry.name not in without]
        monkeypatch.setattr(wing, "entry_points", lambda group: [*kept, *more])
        wing.wings.cache_clear()

    yield change
    monkeypatch.undo()
    wing.wings.cache_clear()


@pytest.fixture(autouse=True)
def coins(install, monkeypatch):
    monkeypatch.setitem(sys.modules, "coins_wing.coins", sys.modules[__name__])
    install(COINS)
    CALLS[:] = [None]


def call(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["stickslip", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


def test_from_python():
    result = ss.simulate(ss.scenario(experiment="coins", bias=0.7))
    assert 0.5 < result.heads.mean() < 0.9


def test_from_the_command_line_and_after_it_was_stopped(tmp_path, monkeypatch, capsys):
    (tmp_path / "coins.toml").write_text('experiment = "coins"\nbias = 1.0\n')
    CALLS.clear()  # the first call is stopped by ctrl-C after its piece is saved
    assert call(monkeypatch, "run", tmp_path / "coins.toml", "--out", tmp_path / "out") == 130
    assert call(monkeypatch, "resume", tmp_path / "out") == 0
    assert "100 heads" in capsys.readouterr().out
    assert ss.io.open_dataset(tmp_path / "out")["numbers"].heads.sum() == 100
    assert call(monkeypatch, "cite", tmp_path / "coins.toml") == 0


def test_in_a_sweep(tmp_path):
    swept = ss.run_sweep(ss.sweep(experiment="coins", sweep={"bias": [0.0, 1.0]}), tmp_path, workers=1)
    assert swept.failures == ["", ""]
    assert list(ss.io.open_sweep(tmp_path).share.values) == [0.0, 1.0]
    assert json.loads((tmp_path / "sweep.json").read_text())["experiment"] == "coins"


def test_its_folder_and_the_head_of_its_wing_are_all_that_it_needs(tmp_path, monkeypatch):
    """Namespaces, files of runs, tables of notebooks and the page of reference follow from its value EXPERIMENT."""
    assert ss.experiments.coins is sys.modules[__name__] and "coins" in dir(ss.experiments)
    assert {"coins", "gouge"} <= {*ss.experiments.__all__} and "gouge" in ss.figures.__all__
    run = ss.simulate(ss.scenario(experiment="coins", bias=1.0))
    assert run.to_dataframe().loc["share"].tolist() == [1.0, "1", "share of heads"]
    assert "share of heads" in run._repr_html_()
    (tmp_path / "coins.toml").write_text('experiment = "coins"\n')
    assert call(monkeypatch, "run", tmp_path / "coins.toml", "--out", tmp_path / "out") == 0
    assert len((tmp_path / "out" / "tosses.csv").read_text().splitlines()) == 101
    assert "tosses.csv" in json.loads((tmp_path / "out" / "manifest.json").read_text())["files"]
    page = runpy.run_path(str(ROOT / "docs" / "scenario_reference.py"))["page"]("coins", Coins)
    assert "| `bias` |" in page and "| `share` | – | share of heads |" in page


def test_a_file_that_it_does_not_name_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "EXPERIMENT", EXPERIMENT._replace(writes=()))
    _written_names.cache_clear()
    with pytest.raises(RuntimeError, match=r"tosses\.csv are no files of runs: name them in `writes`"):
        write_result(tmp_path / "out", EXPERIMENT, ss.simulate(ss.scenario(experiment="coins")))
    _written_names.cache_clear()


def test_bad_keys_are_named():
    with pytest.raises(ss.experiments.ScenarioError, match="bias"):
        ss.scenario(experiment="coins", bias=-1)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_what_is_imported_late_is_there(name):
    first = EXPERIMENTS[name]
    for value in (*first, *(first.paper or ())):
        if hasattr(value, "resolve"):
            assert callable(value.resolve())


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("absent_package.wing:WING", "No module named 'absent_package'"),
        (f"{__name__}:CALLS", "CALLS is a list, not a Wing"),
    ],
)
def test_a_broken_wing_is_named_and_nothing_else_is_lost(value, said, install):
    install(EntryPoint("broken", value, GROUP), COINS)
    with pytest.warns(UserWarning, match=f"the wing broken cannot be loaded .*{said}.*repair or uninstall"):
        assert "coins" in EXPERIMENTS
    assert EXPERIMENTS["coins"] is EXPERIMENT
    assert "gouge" in EXPERIMENTS


def test_the_wing_among_the_examples_runs(install, tmp_path, monkeypatch):
    folder = ROOT / "examples" / "wing"
    monkeypatch.syspath_prepend(folder)
    entries = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["entry-points"][GROUP]
    install(*(EntryPoint(name, value, GROUP) for name, value in entries.items()))
    (tmp_path / "bouncing.toml").write_text('experiment = "bouncing"\nheight = 2.0\n')
    assert call(monkeypatch, "run", tmp_path / "bouncing.toml", "--out", tmp_path / "out") == 0
    assert (tmp_path / "out" / "fig1_height.png").exists()
    data = ss.io.open_dataset(tmp_path / "out")["numbers"]
    restitution = np.exp(-np.pi * 0.05 / np.sqrt(1 - 0.05**2))  # of a linear spring with 5 % of the critical damping
    assert np.sqrt(data.height[np.argmin(data.height.values) :].max() / 2.0) == pytest.approx(restitution, rel=5e-3)


@pytest.mark.slow
def test_the_wing_among_the_examples_is_installed_by_pip(tmp_path):
    options = "--quiet", "--no-deps", "--no-build-isolation", "--target", tmp_path / "site"
    subprocess.run([sys.executable, "-m", "pip", "install", *options, ROOT / "examples" / "wing"], check=True)
    (tmp_path / "bouncing.toml").write_text('experiment = "bouncing"\n')
    code = (
        "import sys; from stickslip.cli import main; sys.argv[1:1] = ['run', 'bouncing.toml', '--out', 'out']; main()"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (tmp_path / "site", ROOT / "src")))}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert "rebound: 0.7" in done.stdout, done.stderr


ALONE = """
import importlib.abc, importlib.metadata, sys
class Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.startswith("stickslip.wings"):
            raise ImportError(f"{name} is hidden")
sys.meta_path.insert(0, Hidden())
found = importlib.metadata.entry_points
importlib.metadata.entry_points = lambda **which: [] if which == {"group": "stickslip.wings"} else found(**which)
from stickslip.cli import main
for words in (["stability", "few.npz"], ["convert", "few.npz", "--to", "few.csv"], ["report", "few.npz"], ["doctor"]):
    sys.argv = ["stickslip", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
"""


def test_the_laboratory_works_without_its_wings(few_spheres, tmp_path):
    shutil.copy(few_spheres, tmp_path / "few.npz")  # a process of its own, 4 s: nothing may have been imported before
    done = subprocess.run([sys.executable, "-c", ALONE], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "oscillatory instability" in done.stdout and "all is well" in done.stdout
    assert (tmp_path / "few.csv").exists() and (tmp_path / "few-report.html").exists()


def test_without_any_wing_scenarios_name_no_experiment(install):
    install(without=[*wing.wings()])
    assert not EXPERIMENTS
    with pytest.raises(ss.experiments.ScenarioError, match="experiment = 'gouge' was given, but no wing is installed"):
        ss.scenario(experiment="gouge")
