"""The architecture, executed: who may import whom, no cycles, and a light front door."""

import subprocess
import sys
from pathlib import Path

import grimp

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


def test_import_stays_light():
    heavy = ("matplotlib", "h5py", "dask", "scipy", "numba")
    code = f"import sys, stickslip; print([m for m in {heavy!r} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
