"""The architecture, executed: who may import whom, no cycles, and a light front door."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

from tests import rooms
from tests.structure.size import internal_names

ROOT = Path(__file__).parents[2]


def test_layer_contracts_hold():
    run = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout


def test_no_import_cycles_between_modules():
    graph = grimp.build_graph("stickslip", cache_dir=None)
    for module in graph.modules:
        for imported in graph.find_modules_directly_imported_by(module):
            if not module.startswith(f"{imported}."):
                back = graph.find_shortest_chain(importer=imported, imported=module)
                assert back is None, f"import cycle: {back}"


@pytest.mark.parametrize(
    "code, heavy",
    [
        ("import stickslip", ("matplotlib", "h5py", "dask", "scipy", "numba")),
        ("from stickslip.cli import app", ("matplotlib", "h5py", "scipy", "numba", "numpy")),
        # what `stickslip stability` imports
        ("import stickslip.reports.packing, stickslip.data.exchange.files, stickslip.reports.terminal",
         ("matplotlib", "h5py", "xarray", "pandas", "scipy.stats", "scipy.optimize", "scipy.spatial")),
        # pyplot belongs to the user: with it, a backend is chosen
        ("import stickslip.figures.animation, stickslip.figures.style", ("matplotlib.pyplot",)),
    ],
    ids=["package", "help", "stability", "figures"],
)  # fmt: skip
def test_import_stays_light(code, heavy):
    code = f"import sys; {code}; print([m for m in {heavy!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


LOADED = """
import re, sys
from stickslip.cli import main
sys.argv[0] = "stickslip"
try:
    main()
except SystemExit:
    pass
print(*sorted(name for name in sys.modules if re.fullmatch(r"stickslip\\.wings\\.\\w+\\.(?!wing$)\\w+", name)))
"""


@pytest.mark.parametrize(
    ("words", "loaded"),
    [
        ("--help", []),
        ("stability few.npz -q", []),
        ("shear --help", ["studies.commands"]),
        ("run examples/rate_state.toml --out out -q", ["faults.friction", "faults.rate_state"]),
        ("reproduce sphere-shear --full", ["papers.sphere_shear"]),  # has no such option
    ],
)
def test_commands_import_only_what_they_use(words, loaded, few_spheres, tmp_path):
    shutil.copy(few_spheres, tmp_path / "few.npz")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    call = [sys.executable, "-c", LOADED, *words.split()]
    said = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert said.splitlines()[-1].split() == [f"stickslip.wings.{name}" for name in loaded], said


def test_no_public_name_is_that_of_a_module_beside_it():
    """Once such a module is imported, from wherever, the attribute of the package is the module."""
    for stub in (ROOT / "src/stickslip").rglob("__init__.pyi"):
        for line in re.findall(r"^from \.\w[\w.]* import (\w+) as \w+$", stub.read_text(), re.MULTILINE):
            assert not stub.with_name(f"{line}.py").exists(), f"{stub.parent.name}.{line}"


def test_the_diagram_of_rooms_is_that_of_the_code():
    drawn = (ROOT / "docs" / "figures" / "rooms.svg").read_text()
    stale = "docs/figures/rooms.svg is stale: python docs/rooms.py draws it again"
    assert runpy.run_path(str(ROOT / "docs" / "rooms.py"))["svg"]() == drawn, stale


@pytest.mark.parametrize("folder", ["soils", "studies", "faults/fault"])
def test_wings_import_public_names_and_the_kit(folder):
    assert not internal_names(folder), "use public names, or `stickslip.kit`"


def test_every_room_has_tests():
    assert [room for room in rooms.rooms() if not rooms.files(room)] == []


def test_tests_of_a_room_are_those_that_use_it():
    values = {
        room: [str(path.relative_to(ROOT / "tests")) for path in rooms.files(room)] for room in ("faults", "core")
    }
    assert "wings/faults/test_fit.py" in values["faults"]  # the folder's name
    assert "derivatives/test_jacobian.py" in values["core"]  # an import
    assert "properties/test_determinism.py" in values["core"]  # names of the public package
    assert "wings/faults/test_fit.py" not in values["core"]
