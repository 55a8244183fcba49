"""Disks that are full, as a limit on the size of files: a sentence names the place, and the same call goes on."""

import functools
import json
import os
import resource
import shutil
from contextlib import contextmanager

import numpy as np
import pytest

from stickslip.wings.papers.quasi_rigid import claims as quasi_rigid
from tests.conftest import stickslip_here
from tests.hardening.test_sizes import FLOW

SLIDER = 'experiment = "rate-state"\nsamples.number = 10\n'


@contextmanager
def at_most(size):
    """No file of this process becomes larger, as on a disk with so little room."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [100, 1000, 3000, 50_000])
def test_a_disk_that_is_full_when_results_are_written_is_named(tmp_path, size):
    (tmp_path / "s.toml").write_text(SLIDER)
    with at_most(size):
        run = stickslip_here("run", "s.toml", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert run.stderr.startswith("stickslip: out")
    assert "free some space and repeat the command to continue" in run.stderr
    assert stickslip_here("run", "s.toml", "--out", "out", cwd=tmp_path).returncode == 0
    assert (tmp_path / "out" / "fig1_history.png").exists()


def test_a_fit_is_replaced_whole_and_the_same_call_goes_on(tmp_path):
    (tmp_path / "s.toml").write_text(SLIDER)
    assert stickslip_here("run", "s.toml", "--out", "out", cwd=tmp_path).returncode == 0
    arguments = ["fit", "out/series.csv", "--stiffness", "200", "--law", "slip", "--out", "fit"]
    for again in ([], ["--overwrite"]):
        before = (tmp_path / "fit" / "fit.png").read_bytes() if again else None
        with at_most(20_000):  # room for the numbers, none for the figure
            run = stickslip_here(*arguments, *again, cwd=tmp_path)
        assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
        assert run.stderr.startswith("stickslip: fit/fit.png: file too large")
        assert before is None or (tmp_path / "fit" / "fit.png").read_bytes() == before
        assert stickslip_here(*arguments, *again, cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("name", ["b.npz", "b.h5", "b.gsd", "b.vtu", "b.xyz", "b.data", "b.html", "b.gif", "b.mp4"])
def test_what_cannot_be_written_leaves_nothing(few_spheres, tmp_path, name):
    needed = {".gsd": "gsd", ".vtu": "pyevtk", ".mp4": "imageio_ffmpeg"}
    pytest.importorskip(needed.get(name[1:], "numpy"))
    shutil.copy(few_spheres, tmp_path / "a.npz")
    modes = np.ones((1, 18, 3)) * 1j
    np.savez(tmp_path / "m.npz", eigenvalue=[1j], exponent=[1j], translation=modes, rotation=modes, rattlers=[])
    (tmp_path / name).write_text("mine")
    before = {path: os.stat(path).st_size for path in tmp_path.iterdir()}
    how = {"b.html": ["report"], "b.gif": ["movie", "--frames", "2"], "b.mp4": ["movie", "--frames", "2"]}
    arguments = [*how[name], "--modes", "m.npz", "--out"] if name in how else ["convert", "--coulomb", "sharp", "--to"]
    with at_most(2000):
        run = stickslip_here(*arguments[:1], "a.npz", *arguments[1:], name, "--overwrite", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (1 if name == "b.mp4" else 2, 1), run.stderr
    assert run.stderr.startswith("stickslip: ffmpeg ended" if name == "b.mp4" else f"stickslip: {name}: file too large")
    assert "free some" in run.stderr
    assert {path: os.stat(path).st_size for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("size", [0, 10, 300, 600, 800, 1200])
@pytest.mark.parametrize("kind", ["sweep", "flow", "paper"])
def test_the_same_call_goes_on_wherever_a_disk_was_full_at_the_start(tmp_path, size, kind, monkeypatch):
    """Folders that were made before the first file could not be written are no strangers to the next call."""
    (tmp_path / "sweep.toml").write_text(SLIDER + "[sweep]\nseed = [0, 1]\n")
    (tmp_path / "flow.json").write_text(json.dumps(FLOW))
    arguments = (
        ["reproduce", "quasi-rigid", "--quick"] if kind == "paper" else ["run", str(min(tmp_path.glob(f"{kind}.*")))]
    )
    arguments += ["--workers", "1", "--out", "out"]
    with monkeypatch.context() as now:
        now.setattr(quasi_rigid, "reproduce", functools.wraps(quasi_rigid.reproduce)(stopped))
        now.setattr("stickslip.runs.sweep.run.run_members", stopped)
        now.setattr("stickslip.wings.studies.flow.simulate._run_stage", stopped)
        with at_most(size):
            run = stickslip_here(*arguments, cwd=tmp_path)
        assert run.returncode in (2, 130), run.stderr
        again = stickslip_here(*arguments, cwd=tmp_path)
        assert again.returncode == 130, again.stderr


def stopped(*_, **__):
    raise KeyboardInterrupt
