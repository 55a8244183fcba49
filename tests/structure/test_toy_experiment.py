"""A wing of somebody else: `ss.simulate`, the command line, sweeps and `resume` know its experiment.

Without a wing, or with a broken one, everything else works.
"""

import ast
import gzip
import importlib
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import warnings
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Literal, NamedTuple

import numpy as np
import pytest
from matplotlib.figure import Figure

import stickslip as ss
from stickslip import wing
from stickslip.cli import main
from stickslip.cli.running import _papers
from stickslip.core.laws.builtin import MU
from stickslip.data.checkpoint import checkpoint_in, load_or_compute
from stickslip.data.schema import NotNegative, ScenarioBase, Seed
from stickslip.doctor import PROBLEM, SelfcheckResult, measure
from stickslip.experiments import EXPERIMENTS, Experiment
from stickslip.experiments.registry import papers, table_of
from stickslip.kit import Measures, Quantities, Quantity, result_of
from stickslip.runs import bundled
from stickslip.runs.folder import write_result
from stickslip.wing import GROUP, FileFormat, Wing
from tests import hidden, rooms

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
WING = Wing("coins_wing", "tosses of a coin", experiments={"coins": "coins"}, formats=(
    FileFormat("stacks of coins", rb"# coins\r?\n", "stacks.read", suffix=".coins", write="stacks.write"),
))  # fmt: skip
COINS = EntryPoint("coins", f"{__name__}:WING", GROUP)


@pytest.fixture
def install(monkeypatch):
    """Function that installs wings, and uninstalls others."""

    found = wing.entry_points

    def change(*more, without=()):
        kept = [entry for entry in found(group=GROUP) if entry.name not in without]
        monkeypatch.setattr(wing, "entry_points", lambda group: [*kept, *more])
        wing.installed.cache_clear()

    yield change
    monkeypatch.undo()
    wing.installed.cache_clear()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder in which packages of wings are found."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "coins_wing").mkdir()
    (folder / "coins_wing" / "__init__.py").write_text("")
    (folder / "coins_wing" / "stacks.py").write_text("raise RuntimeError('imported before it is needed')")
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))


@pytest.fixture(autouse=True)
def coins(site, install, monkeypatch):
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
    with pytest.raises(RuntimeError, match=r"tosses\.csv are not run files: list them in `writes`"):
        write_result(tmp_path / "out", EXPERIMENT, ss.simulate(ss.scenario(experiment="coins")))


@pytest.mark.parametrize("part", ["files", "figures"])
def test_no_file_is_written_outside_the_folder(part, tmp_path):
    made = {"files": lambda path: path.write_text("x"), "figures": Figure()}[part]
    experiment = EXPERIMENT._replace(**{part: lambda result: [("../../evil.png", made)]})
    with pytest.raises(RuntimeError, match=r"'\.\./\.\./evil\.png' is not a file name"):
        write_result(tmp_path / "out", experiment, ss.simulate(ss.scenario(experiment="coins")))
    assert not (tmp_path / "evil.png").exists()


def read_stacks(path) -> dict[str, dict]:
    stacks = path.read_text().split("# coins\n")[1:]
    arrays = [np.array([line.split() for line in stack.splitlines()], float) for stack in stacks]
    return {str(k): {"position": a[:, :3], "radius": a[:, 3], "density": 8.9} for k, a in enumerate(arrays)}


def write_stacks(path, frames) -> list[str]:
    grains = [frame.state.grains for frame in frames]
    rows = [np.column_stack([one.position, one.radius]).tolist() for one in grains]
    path.write_text("".join("# coins\n" + "".join(f"{x} {y} {z} {r}\n" for x, y, z, r in each) for each in rows))
    return ["stacks of coins do not store laws"]


@pytest.fixture
def stacks(monkeypatch, install):
    """Function that makes the module that reads and writes stacks of coins importable."""
    module = SimpleNamespace(read=read_stacks, write=write_stacks, __spec__=ModuleSpec("coins_wing.stacks", None))
    return lambda: monkeypatch.setitem(sys.modules, "coins_wing.stacks", module)


def test_files_of_its_format_are_read_and_written(stacks, tmp_path):
    law, place = ss.laws.linear(mu=0.3), np.array([[0.0, 0.0, 0.0], [0.99, 0.0, 0.0]])
    pair = ss.packings.from_arrays(place, [0.5, 0.5], law)
    ss.io.write_packing(tmp_path / "a.npz", pair, law)
    assert ss.io.read_packing(tmp_path / "a.npz").law  # its module was not needed
    stacks()
    notes = ss.io.write_packing(tmp_path / "b.coins", [ss.io.frame_of(pair, law)] * 2)
    assert notes == ["stacks of coins do not store laws"]
    (_, state, chosen, said), _ = ss.io.read_packings(tmp_path / "b.coins", law="linear", mu=0.2)
    assert (state.grains.position == place).all() and chosen.table[0, 0, MU] == 0.2
    assert state.grains.mass[0] == pytest.approx(8.9 * np.pi / 6)
    assert any("has no box" in note for note in said) and not any("has no masses" in note for note in said)
    assert ss.io.read_packing(tmp_path / "b.coins", frame="1").state.contacts.count == [1]
    with pytest.raises(ss.packings.PackingError, match="has no frame '7': it has 0, 1"):
        ss.io.read_packing(tmp_path / "b.coins", frame="7")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"# coins\n0 0 zero 1\n", "cannot be read as stacks of coins .*zero.*: the file is damaged, or its wing is"),
        (gzip.compress(b"# coins\n0 0 0 1\n", mtime=0), "is compressed: decompress it first"),
        (b"# coins\n0 0 0 -1\n", "radius"),
    ],
)
def test_damaged_files_of_its_format_end_in_one_sentence(stacks, tmp_path, content, said):
    stacks()
    (tmp_path / "a.coins").write_bytes(content)
    with pytest.raises(ss.packings.PackingError, match=said) as caught:
        ss.io.read_packing(tmp_path / "a.coins")
    assert "\n" not in str(caught.value)


def test_a_file_extension_of_a_wing_that_is_missing_is_refused(install, tmp_path):
    install()
    pair = ss.packings.from_arrays([[0, 0, 0]], [0.5], ss.laws.linear())
    with pytest.raises(ss.packings.PackingError, match=r"ends with '\.coins', an unsupported output format"):
        ss.io.write_packing(tmp_path / "b.coins", pair, ss.laws.linear())


def test_bad_keys_are_named():
    with pytest.raises(ss.experiments.ScenarioError, match="bias"):
        ss.scenario(experiment="coins", bias=-1)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_what_is_imported_late_is_there(name):
    first = EXPERIMENTS[name]
    for value in (*first, *(first.paper or ())):
        if hasattr(value, "resolve"):
            assert callable(value.resolve()) or isinstance(value(), dict)


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


HEADS = {  # heads that are wrong in part or altogether, and what the warning says
    "raise SystemExit(3)": "cannot be loaded (3)",
    "WING = Wing('absent', 'x')": "`package` must be the name of its package",
    "WING = Wing(7, 'x')": "`package` must be the name of its package",
    "experiments=['odd']": "experiments must be a dict, got list",
    "experiments={'odd': 'absent'}": "experiments: odd_wing has no module absent",
    "experiments={'odd': 3}": "experiments: 3 must have the form ExperimentEntry(",
    "experiments={3: 'lost'}": "experiments: ExperimentEntry(package='lost', needs=(), papers=(), meant_by='') must",
    "experiments={'odd': ExperimentEntry('lost', papers=(3,))}": "papers=(3,), meant_by='') must have the form",
    "experiments={'gouge': 'lost'}": "experiments: experiment gouge exists already",
    "commands='commands'": "commands must be a tuple, got str",
    "commands={'odd': 'lost'}": "commands must be a tuple, got dict",
    "commands=(Command(3, 'x', 'lost.run'),)": "Command(name=3, words='x', function='lost.run', needs=()) must",
    "commands=(Command('fit', 'x', 'lost.run'),)": "commands: command fit exists already",
    "commands=(Command('run', 'x', 'lost.run'),)": "the command run of the wing odd_wing exists already",
    "selfchecks='absent.checks'": "selfchecks: odd_wing has no module absent",
    "selfchecks=3": "selfchecks must be a str, got int",
    "needs='papers', pages='odd'": "needs must be a tuple, got str; pages must be a tuple, got str",
    "pages=('odd', 3)": "pages: 3 must be a str",
    "formats={'odd': 'lost.read'}": "formats must be a tuple, got dict",
    "formats=(FileFormat('odd', b'(', 'lost.read'),)": "expression b'(' of odd is invalid (",
    "formats=(FileFormat('odd', suffix='.coins', write='lost.write'),)": "file extension .coins exists already",
    "formats=(FileFormat('odd', 'odd', 'lost.read'),)": "formats: FileFormat(name='odd', start=",
}
OK = "from stickslip.wing import Command, ExperimentEntry, FileFormat, Wing\n"


@pytest.fixture
def odd(site, install, monkeypatch):
    """Function that installs a wing with this head, and a module `lost` that cannot be imported."""

    def create(head, **files):
        folder = site / "odd_wing"
        folder.mkdir(exist_ok=True)
        head = head if head.startswith(("raise", "WING")) else f"WING = Wing(__name__, 'x', {head})"
        for name, text in {"__init__": OK + head, "lost": "import absent_library", **files}.items():
            (folder / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)
        install(COINS, EntryPoint("odd", "odd_wing:WING", GROUP))

    yield create
    for name in [name for name in sys.modules if name.partition(".")[0] == "odd_wing"]:
        del sys.modules[name]


TYPED = "stability few.npz -q", "--help", "docs -q", "run coins.toml --out out -q"


@pytest.mark.parametrize("head", HEADS)
def test_a_broken_head_gives_one_line_and_takes_nothing_with_it(head, odd, few_spheres, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    shutil.copy(few_spheres, "few.npz")
    Path("coins.toml").write_text('experiment = "coins"\n')
    for words in TYPED:
        odd(head)
        with warnings.catch_warnings():
            warnings.simplefilter("default")  # as in a process of its own
            assert call(monkeypatch, *words.split()) == 0, words
        (line,) = capfd.readouterr().err.splitlines()
        assert line.startswith("stickslip: the ") and HEADS[head] in line, line
    assert EXPERIMENTS["gouge"].scenario.__module__ == "stickslip.wings.papers.gouge.scenario"


def test_what_cannot_be_imported_names_its_wing_and_is_missed_by_nothing_else(odd, tmp_path, monkeypatch, capfd):
    """An experiment with a paper, and a command."""
    odd(
        "experiments={'odd': ExperimentEntry('lost', papers=('odd-paper',))}, "
        "commands=(Command('odd', 'x', 'lost.run'),)"
    )
    (tmp_path / "odd.toml").write_text('experiment = "odd"\n')
    said = "lost.EXPERIMENT of the wing odd_wing cannot be imported (No module named 'absent_library'): repair or unin"
    for words in (["reproduce", "odd-paper"], ["run", tmp_path / "odd.toml"], ["odd"]):
        assert call(monkeypatch, *words) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert said in line.replace("lost.run", "lost.EXPERIMENT")
    assert call(monkeypatch, "reproduce", "absent") == 2
    assert "use disk-array, sphere-shear, quasi-rigid, gouge, seas-bp1" in capfd.readouterr().err
    assert "disk-array" in _papers() and "odd-paper" not in _papers()
    (tmp_path / "coins.toml").write_text('experiment = "coins"\n')
    assert call(monkeypatch, "run", tmp_path / "coins.toml", "--out", tmp_path / "out", "--device", "cuda") == 2
    assert "--device is available for single runs of 'disk-array' and 'gouge' only" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("module", "code", "said"),
    [
        ("@command()\ndef run():\n    {}['a']", 1, "the wing odd failed in tool.py, line 4 (KeyError: 'a'): report it"),
        ("@command()\ndef run():\n    command(3)", 1, "the wing odd failed in tool.py, line 4 (TypeError: "),
        ("def run(): pass", 2, "tool.run, is not a function decorated with `stickslip.kit.command`"),
        ("run = 3", 2, "tool.run, is not a function decorated with `stickslip.kit.command`"),
    ],
)
def test_what_fails_in_a_wing_is_one_sentence_without_a_traceback(module, code, said, odd, monkeypatch, capfd):
    odd("commands=(Command('odd', 'x', 'tool.run'),)", tool=f"from stickslip.kit import command\n{module}")
    assert call(monkeypatch, "odd") == code
    (line,) = capfd.readouterr().err.splitlines()
    assert said in line


def test_a_fault_of_this_package_keeps_its_traceback(odd, monkeypatch):
    odd("commands=(Command('odd', 'x', 'tool.run'),)", tool="")
    monkeypatch.setattr(wing.Wing, "function", lambda *_: {}["a"])
    with pytest.raises(KeyError):
        monkeypatch.setattr(sys, "argv", ["stickslip", "odd"])
        main()


def test_prints_of_a_wing_and_its_unreadable_pages_spoil_nothing(odd, few_spheres, monkeypatch, capfd):
    odd("WING = Wing(__name__, 'x', pages=('odd',))\nprint('hello')")
    assert call(monkeypatch, "stability", few_spheres, "--json") == 0
    said = capfd.readouterr()
    assert json.loads(said.out)["command"] == "stability" and said.err == "hello\n"
    (wing.installed()["odd"].folders()[0] / "odd.md").write_bytes(b"# Odd \xff\n")
    assert bundled.pages()["odd"] == "Odd \ufffd"


@pytest.mark.parametrize(
    ("checks", "said"),
    [
        ("odd = lambda: {'odd': Selfcheck('a', 0.0, 1, 'x')}", "odd: ValueError: could not convert string to float"),
        ("odd = lambda: None", "odd: AttributeError: "),
        ("odd = lambda: exit(3)", "odd: SystemExit: 3"),
        ("", "odd: MissingWingError: checks.odd of the wing odd_wing cannot be imported (module"),
        ("raise SystemExit(3)", "odd: MissingWingError: checks.odd of the wing odd_wing cannot be imported (3)"),
    ],
)
def test_self_checks_that_fail_are_reported_and_the_others_are_done(checks, said, odd):
    odd("selfchecks='checks.odd'", checks=f"from stickslip.wing import Selfcheck\n{checks}")
    numbers = measure()
    assert said in numbers[PROBLEM]
    assert "contact force, normal" in numbers and any(isinstance(one, wing.Selfcheck) for one in numbers.values())
    assert not SelfcheckResult([], numbers[PROBLEM], 0.0).ok


FRAME = "{'position': [[0, 0, 0], [0.99, 0, 0]], 'radius': [0.5, 0.5], 'mass': [1, 1]"


@pytest.mark.parametrize(
    "start, frames, said",
    [
        ("b'# odd'", f"{{'a': {FRAME}, 'law': 'hertz'}}}}", "its law must be a Law or a dict of options, got 'hertz'"),
        ("b'# odd'", "{}", "it has no frames"),
        ("b'# odd'", "{'a': 5}", "'int' object is not iterable"),
        ("b'(?s).*'", "{'a': 5}", ""),  # every file
    ],
)
def test_formats_of_wings_replace_none_and_wrong_frames_are_refused(start, frames, said, odd, few_spheres, tmp_path):
    odd(f"formats=(FileFormat('odd', {start}, 'io.read'),)", io=f"def read(path):\n    return {frames}")
    assert len(ss.io.read_packing(few_spheres).state.grains.radius) > 2
    (tmp_path / "a.odd").write_text("# odd\n")
    with pytest.raises(ss.packings.PackingError, match=f"a.odd cannot be read as odd .*{re.escape(said)}"):
        ss.io.read_packing(tmp_path / "a.odd")


def test_the_wing_among_the_examples_runs(install, tmp_path, monkeypatch, capfd):
    """It has help, shell completion and pages; its measure is a quantity with a meaning."""
    folder = ROOT / "examples" / "wing"
    monkeypatch.syspath_prepend(folder)
    entries = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["entry-points"][GROUP]
    install(*(EntryPoint(name, value, GROUP) for name, value in entries.items()))
    assert sum(len(path.read_text().splitlines()) for path in folder.rglob("*.py")) <= 60
    assert bundled.pages()["bouncing"] == "A bouncing disk" and "rebound" in bundled.page("bouncing")
    assert call(monkeypatch, "run", "--help") == 0
    assert "rate-state, fault, bouncing." in " ".join(capfd.readouterr().out.split())
    assert call(monkeypatch, "docs", "scenario/bouncing") == 2
    assert "there is no page 'scenario/bouncing': use bouncing\n" in capfd.readouterr().err
    monkeypatch.setenv("COMP_WORDS", "stickslip docs boun")
    monkeypatch.setenv("COMP_CWORD", "2")
    with monkeypatch.context() as shell:
        shell.setenv("_STICKSLIP_COMPLETE", "complete_bash")
        assert call(shell) == 0
    assert capfd.readouterr().out.split() == ["bouncing"]
    (tmp_path / "bouncing.toml").write_text('experiment = "bouncing"\nheight = 2.0\n')
    assert call(monkeypatch, "run", tmp_path / "bouncing.toml", "--out", tmp_path / "out") == 0
    assert (tmp_path / "out" / "fig1_height.png").exists()
    assert table_of(EXPERIMENTS["bouncing"]).row("rebound").meaning == "height of the rebound over the initial height"
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


COMMANDS = """
import sys
from tests import hidden
hidden.hide(hidden.NAMES)
from stickslip.cli import main
for words in (["stability", "few.npz"], ["convert", "few.npz", "--to", "few.csv"], ["report", "few.npz"], ["doctor"]):
    sys.argv = ["stickslip", *words]
    try:
        main()
    except SystemExit as end:
        assert not end.code, words
"""


def run_here(*arguments, cwd=ROOT):
    """Run Python in a process of its own: nothing may have been imported before a wing is hidden."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([sys.executable, *arguments], cwd=cwd, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-2000:]
    return done.stdout


# 4 s: a process of its own, into which nothing may have been imported before
def test_the_laboratory_works_without_its_wings(few_spheres, tmp_path):
    shutil.copy(few_spheres, tmp_path / "few.npz")
    said = run_here("-c", COMMANDS, cwd=tmp_path)
    assert "oscillatory instability" in said and "all is well" in said
    assert (tmp_path / "few.csv").exists() and (tmp_path / "few-report.html").exists()


# a wing of somebody else, its sweep and its format; verdicts and files of packings are in COMMANDS
TELLING = (
    "tests/structure/test_toy_experiment.py::test_from_python",
    "tests/structure/test_toy_experiment.py::test_in_a_sweep",
    "tests/structure/test_toy_experiment.py::test_files_of_its_format_are_read_and_written",
)  # fmt: skip


ONE = "faults"  # the wing with most commands, in every run of the tests; the others in slow ones


# 5 s: a process of its own, in which the wing is hidden from the start
@pytest.mark.parametrize(
    "name", [ONE, *(pytest.param(name, marks=pytest.mark.slow) for name in hidden.NAMES if name != ONE)]
)
def test_the_laboratory_passes_its_tests_without_a_wing(name):
    assert "cannot be loaded" not in run_here("-m", "tests.hidden", name, *TELLING)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["all", *hidden.NAMES])
def test_the_laboratory_passes_all_its_tests_without_a_wing(name):
    own = [str(path.relative_to(ROOT)) for path in rooms.of_laboratory()]
    assert len(own) > 60
    run_here("-m", "tests.hidden", name, "-m", "not slow", *own)


def test_heads_name_the_wings_that_their_experiments_and_commands_import():
    """Directly or indirectly: from the folder of an experiment, or the module of a command."""
    above, inner = "stickslip.wings", {}
    for path in (rooms.PACKAGE / "wings").rglob("*.py"):
        parts = path.relative_to(rooms.PACKAGE / "wings").with_suffix("").parts
        package = [*above.split("."), *parts[:-1]]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                module = ".".join([*package[: len(package) + 1 - node.level], *filter(None, [node.module])])
                found = [f"{module}.{alias.name}".removeprefix(f"{above}.").split(".")[:2] for alias in node.names]
                inner.setdefault(parts[:2], set()).update(tuple(one) for one in found if one[0] in hidden.NAMES)

    def needed(part, seen=frozenset()):
        more = inner.get(part, set()) - seen
        return {one[0] for one in more}.union(*(needed(one, seen | more) for one in more))

    assert needed(("studies", "threshold")) > {"papers"}
    for name, head in wing.wings().items():
        for one in (*head.experiments.values(), *head.commands):
            if name in hidden.NAMES:
                part = one.function.partition(".")[0] if isinstance(one, wing.Command) else one.package
                assert {*head.needs, *one.needs} == needed((name, part)) - {name}, (name, part)


def test_heads_name_the_papers_of_their_experiments():
    for name, (_, entry) in EXPERIMENTS.entries().items():
        one = EXPERIMENTS[name]
        assert entry.papers == tuple(paper.name or name for paper in (one.paper, *one.more_papers) if paper)
        assert one.name == name
    assert papers()["seas-bp6"].paper.name == "seas-bp6" and papers()["gouge"].paper.title.endswith("fault gouge")


ALONE = """
import sys
from tests import hidden
hidden.hide([name for name in hidden.NAMES if name != "studies"])
import stickslip as ss
from stickslip.experiments import EXPERIMENTS
from stickslip.cli import main
assert {*EXPERIMENTS} == {"catalogue", "failure"}, [*EXPERIMENTS]
assert EXPERIMENTS["failure"] is ss.experiments.failure.EXPERIMENT and EXPERIMENTS["catalogue"]
assert "threshold" not in ss.experiments.__all__
sys.argv = ["stickslip", "shear", "few.npz", "--until", "1e-6", "--out", "out", "-q"]
try:
    main()
except SystemExit as end:
    assert not end.code
"""


# 5 s: a process of its own, in which wings are hidden from the start
def test_what_a_wing_can_do_without_the_others_remains(few_spheres, tmp_path):
    shutil.copy(few_spheres, tmp_path / "few.npz")
    run_here("-c", ALONE, cwd=tmp_path)
    assert (tmp_path / "out" / "results.h5").exists()


@pytest.mark.parametrize(
    ("experiment", "missing"),
    [("gouge", "faults"), ("threshold", "papers"), ("flow", "lammps"), ("quasi-rigid", "status")],
)
def test_an_experiment_without_a_wing_that_it_needs_names_it(experiment, missing, install):
    install(without=[missing])
    said = f"experiment = '{experiment}' needs the wing {missing}, which is not installed: install stickslip again, or"
    with pytest.raises(ss.experiments.ScenarioError, match=said):
        ss.scenario(experiment=experiment)
    assert experiment not in EXPERIMENTS and "fault" in {*EXPERIMENTS, missing.removesuffix("s")}


def test_a_public_name_of_a_missing_wing_names_it(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("stickslip.wings.status")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(sys, "meta_path", [hidden.Hidden({"stickslip.wings.status"}), *sys.meta_path])
    with pytest.raises(wing.MissingWingError, match=r"stickslip.quasirigid.load_path needs the wing status, which is"):
        ss.quasirigid.load_path  # noqa: B018


@pytest.mark.parametrize("pages", ["pages=()", "pages=('guide',)"])
def test_without_a_page_of_its_keys_the_pages_of_its_wing_are_named(pages, odd, monkeypatch, capfd):
    odd(f"experiments={{'odd': 'lost'}}, {pages}")
    Path(sys.path[0], "odd_wing", "guide.md").write_text("# Guide\n")
    assert call(monkeypatch, "docs", "scenario/odd") == 2
    said = "use guide" if "guide" in pages else "the package of this experiment, odd_wing, has no pages"
    assert capfd.readouterr().err == f"stickslip: there is no page 'scenario/odd': {said}\n"


def test_without_any_wing_scenarios_and_papers_have_no_name(install, monkeypatch, capfd):
    install(without=[*wing.wings()])
    assert call(monkeypatch, "reproduce", "gouge") == 2
    said = "stickslip: 'gouge' is not available, as no installed wing has papers: install stickslip again\n"
    assert capfd.readouterr().err == said
    assert not EXPERIMENTS
    with pytest.raises(
        ss.experiments.ScenarioError, match="experiment = 'gouge' is not available, as no wing is installed"
    ):
        ss.scenario(experiment="gouge")
