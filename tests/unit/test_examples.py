"""Examples that come with the package: all are described, loaded by name, and copied whole or not at all."""

import importlib.metadata as metadata
import json
import os
import re
import tomllib
from operator import attrgetter
from pathlib import Path

import pytest
from matplotlib import pyplot as plt
from packaging.requirements import Requirement

import stickslip as ss
from stickslip.runs.bundled import page
from tests.conftest import stickslip_here
from tests.unit.test_page_outputs import require_output, run, sessions

ROOT = Path(__file__).parents[2]


def test_every_example_has_a_description_and_every_scenario_is_valid():
    known = ss.examples.names()
    files = {path.name for path in (ROOT / "examples").iterdir() if not path.name.startswith("_")}
    assert set(known) == files
    assert all(10 < len(description) <= 140 and "examples/" not in description for description in known.values()), known
    for name in known:
        if name.endswith(".toml"):
            text = ss.examples.path(name).read_text()
            read = ss.io.read_sweep if "sweep" in tomllib.loads(text) else ss.examples.scenario
            assert read(ss.examples.path(name) if read is ss.io.read_sweep else name)
    assert ss.laws.from_file(ss.examples.path("cohesive_law")).kind


LECTURE = json.loads((ROOT / "examples" / "lecture.ipynb").read_text(encoding="utf-8"))["cells"]
CELLS = ["".join(cell["source"]) for cell in LECTURE if cell["cell_type"] == "code"]


def test_the_lecture_has_no_outputs_and_its_names_exist():
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in LECTURE if "outputs" in cell)
    for cell in CELLS:
        assert re.match(r"# \d+ s\n", cell), f"the cell does not say how long it takes: {cell[:60]}"
        for name in re.findall(r"\bss\.([\w.]+)", cell):
            assert attrgetter(name.rstrip("."))(ss), name
    for page_name in re.findall(r"`stickslip docs (\w+)`", str(LECTURE)):
        assert page(page_name)


@pytest.mark.slow
def test_the_lecture_runs_and_a_pair_is_born_that_grows_as_predicted(capsys):
    space = {"__name__": "lecture"}
    for cell in CELLS:
        exec(compile(cell, cell.splitlines()[1], "exec"), space)
    plt.close("all")
    assert space["pairs"][0] == 0 and space["pairs"][-1] == 1
    assert space["path"][10].load < space["birth"] < space["path"][11].load
    assert space["run"].growth.growth_rate == pytest.approx(space["run"].corrected_rate, rel=1e-3)
    lines = capsys.readouterr().out.splitlines()
    works = [float(line.split()[-1]) for line in lines if "work" in line]
    assert works[0] > 1e-8 and works[1] < -1e-8 and abs(works[2]) < 1e-12
    assert [line for line in lines if line.startswith("without friction ") and "at most 0 complex pairs" in line]


def test_the_packing_is_that_of_the_quick_start():
    state, law = ss.examples.packing()
    result = ss.stability(state, law)
    assert len(result.pairs) == 1 and 1 / result.growth_rate.max() == pytest.approx(4446, rel=1e-3)


def test_examples_are_copied_whole_or_not_at_all(tmp_path):
    made = ss.examples.copy("sheared", "rate_state", to=tmp_path / "a")
    assert [str(path.relative_to(tmp_path)) for path in made] == [
        "a/sheared/contacts.dump", "a/sheared/grains.dump", "a/rate_state.toml",
    ]  # fmt: skip
    with pytest.raises(ValueError, match=r"rate_state\.toml exists: give another name, or add --overwrite"):
        ss.examples.copy("gouge", "rate_state", to=tmp_path / "a")
    assert not (tmp_path / "a" / "gouge.toml").exists()
    assert len(ss.examples.copy(to=tmp_path / "a", overwrite=True)) >= 20
    with pytest.raises(ValueError, match=r"no example 'sheared_spheres': use sheared_spheres.npz, sheared_spheres.py"):
        ss.examples.path("sheared_spheres")


def test_the_command_lists_and_copies(tmp_path):
    done = stickslip_here("example", cwd=tmp_path)
    assert "column_collapse.toml" in done.stdout and not any(tmp_path.iterdir())
    answer = json.loads(stickslip_here("example", "--all", "--json", cwd=tmp_path).stdout)
    assert len(answer["files"]) > len(answer["examples"]) >= 20
    assert all((tmp_path / path).is_file() for path in answer["files"])
    for arguments in (["nonsense"], ["gouge", "--all"], ["gouge"]):
        done = stickslip_here("example", *arguments, cwd=tmp_path)
        assert done.returncode == 2 and done.stderr.count("\n") == 1


def installed_with_core_dependencies() -> set[str]:
    """Top-level modules of every distribution that `pip install .` installs here, without extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    waiting, installed = [Requirement(line) for line in project["dependencies"]], {"stickslip"}
    while waiting:
        need = waiting.pop()
        key = re.sub(r"[-_.]+", "-", need.name).lower()
        if key in installed or not (need.marker is None or need.marker.evaluate({"extra": ""})):
            continue
        installed.add(key)
        waiting += [Requirement(line) for line in metadata.requires(need.name) or ()]
    tops = metadata.packages_distributions()
    return {top for top, names in tops.items() if {re.sub(r"[-_.]+", "-", name).lower() for name in names} & installed}


BLOCK = """
import sys
from importlib.machinery import PathFinder
class Installed(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {blocked!r} else super().find_spec(name, path, target)
sys.meta_path[:] = [Installed if finder is PathFinder else finder for finder in sys.meta_path]
"""


@pytest.mark.slow
def test_commands_of_the_readme_print_what_it_shows_with_what_they_install(tmp_path):
    """`pip install .` and nothing else: modules of all other distributions here cannot be imported."""
    steps = [step for session in sessions(ROOT / "README.md") for step in session]
    commands = [step for step in steps if step[0].startswith("stickslip ")]
    assert len(commands) >= 2
    core = installed_with_core_dependencies()
    blocked = set(metadata.packages_distributions()) - core
    assert {"numpy", "k3d"} <= core and {"gsd", "dask", "pytest", "imageio_ffmpeg", "numba"} <= blocked
    (tmp_path / "sitecustomize.py").write_text(BLOCK.format(blocked=blocked))
    paths = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    ss.examples.copy(to=tmp_path / "examples")
    for command, shown in commands:
        done = run(command, tmp_path, PYTHONPATH=paths)
        require_output(shown, done.stdout)
        assert done.returncode == 0 and not done.stderr and "not installed" not in done.stdout, done.stderr
    view = (tmp_path / "sheared_spheres-report.html").read_text()
    assert "K3D" in view or "k3d" in view
