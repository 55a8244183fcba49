"""A run that was killed goes on from what it had kept, and leaves the files of one that was not."""

import os
import random
import re
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.data.archive import ArchiveError, make_node, restore, to_bytes
from stickslip.data.checkpoint import Checkpoint, read_pieces
from stickslip.experiments import EXPERIMENTS
from tests.conftest import stickslip_here as stickslip

FLOW = """
experiment = "flow"
samples = 24
frames = 12
gravity = [0.0, -1.0]
[grains]
number = 50
low = [0.0, 0.0]
high = [6.0, 16.0]
mass = 1.0
polydispersity = 0.1
[law]
kn = 1e4
restitution = 0.3
[[walls]]
name = "floor"
point = [0.0, 0.0]
normal = [0.0, 1.0]
[[walls]]
name = "left"
point = [0.0, 0.0]
normal = [1.0, 0.0]
[[walls]]
name = "gate"
point = [6.0, 0.0]
normal = [-1.0, 0.0]
velocity = {{ y = 0.1 }}
[[stages]]
name = "settle"
duration = {settle}
[[stages]]
name = "open"
duration = {open}
remove = ["gate"]
drag = 0.01
"""
ARRAY = """
[array]
disks = 4
[load]
push = [0.0, 0.02]
step = 2e-3
[dynamics]
loads = [0.01, 0.02]
duration = 2000.0
[sliding]
loads = [0.02]
realizations = 4
duration = 600.0
"""
SPHERES = """
experiment = "sphere-shear"
packings = 2
[packing]
grains = 40
[shear]
strain = [0.0, 2e-3]
step = 2e-4
[release]
duration = 300.0
"""


def begun(path, words):
    """A process of the command line, in a group of its own with all of its workers."""
    code = "from stickslip.reports import terminal; terminal.LINES = 0.0; from stickslip.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, words)], cwd=path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


def killed_when(process, true, patience=120.0):
    """Kill a process and its workers as soon as something is true; False if it ended before."""
    end = time.monotonic() + patience
    while process.poll() is None and not true():
        assert time.monotonic() < end
        time.sleep(0.05)
    alive = process.poll() is None
    if alive:
        os.killpg(process.pid, signal.SIGKILL)
    process.said = "".join(process.communicate())
    return alive


def pieces(folder):
    return read_pieces(folder)[0]


def run_killed_once(path, scenario, after):
    """The folder of a run that is killed once so many pieces are kept, then resumed."""
    (path / "scenario.toml").write_text(scenario)
    out = path / "out"
    process = begun(path, ["run", "scenario.toml", "--out", "out", "--workers", "2"])
    assert killed_when(process, lambda: len(pieces(out)) >= after), process.said
    kept = pieces(out)
    assert not (out / "results.h5").exists()
    done = stickslip("resume", out)
    assert done.returncode == 0, done.stderr
    return out, kept, done


def whole(path, scenario):
    path.mkdir()
    (path / "scenario.toml").write_text(scenario)
    done = stickslip("run", "scenario.toml", "--out", "whole", cwd=path)
    assert done.returncode == 0, done.stderr
    return path / "whole"


@pytest.mark.timeout(300)
# 4 s: a process of its own is killed with its workers, and a second run is compared with what the first one leaves
def test_a_flow_that_was_killed_leaves_the_file_of_one_that_was_not(tmp_path):
    scenario = FLOW.format(settle=6.0, open=6.0)
    out, kept, _ = run_killed_once(tmp_path, scenario, after=4)
    assert len(kept) >= 4
    other = whole(tmp_path / "other", scenario)
    assert {path.name for path in out.iterdir()} == {path.name for path in other.iterdir()}
    for name in ("results.h5", "series.csv", "scenario.json"):
        assert (out / name).read_bytes() == (other / name).read_bytes()
    again = stickslip("resume", out)
    assert again.returncode == 0
    assert "is finished: there is nothing to resume" in " ".join(again.stdout.split())


def leaves(path):
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "after"), [(ARRAY, 14), (SPHERES, 6)], ids=["disk-array", "sphere-shear"])
def test_quasi_static_runs_go_on_to_the_tolerance_of_their_solver(tmp_path, scenario, after):
    """On this machine and with as many threads it is to the last bit, but that is promised for dynamics only."""
    out, _, _ = run_killed_once(tmp_path, scenario, after)
    mine, other = leaves(out / "results.h5"), leaves(whole(tmp_path / "other", scenario) / "results.h5")
    assert list(mine) == list(other)
    for name, value in mine.items():
        if name.endswith(("ramp/load", "paths/0000/strain")):
            np.testing.assert_array_equal(value, other[name])
        if name.endswith(("position", "slip")):
            np.testing.assert_allclose(value, other[name], atol=1e-9, err_msg=name)


def test_what_cannot_be_resumed_is_told_in_a_sentence(tmp_path, monkeypatch, capsys):
    out, _ = tmp_path / "out", (tmp_path / "scenario.toml").write_text(FLOW.format(settle=6.0, open=6.0))
    save, kept = Checkpoint.save, []

    def save_two(*given, **how):
        if len(kept) == 2:
            raise KeyboardInterrupt
        kept.append(save(*given, **how))

    with monkeypatch.context() as now:
        now.setattr(Checkpoint, "save", save_two)
        assert stickslip("run", "scenario.toml", "--out", "out", cwd=tmp_path).returncode == 130
    assert len(pieces(out)) == 2

    def refused(place, sentence):
        monkeypatch.setattr(sys, "argv", ["stickslip", "resume", str(place)])
        with pytest.raises(SystemExit) as caught:
            main()
        said = capsys.readouterr().err
        assert (caught.value.code, said.count("\n")) == (2, 1), said
        assert sentence in said

    text = (out / "scenario.json").read_text()
    (note,) = (out / "unfinished").glob("scenario-*.json")
    harder = text.replace('"kn": 10000.0', '"kn": 20000.0')
    (out / "scenario.json").write_text(harder)
    refused(out, "have changed since (scenario.json)")
    note.write_text(harder)
    refused(out, "contains parts of a run of a different scenario, perhaps with another law")
    note.write_text(text[:100])
    (out / "scenario.json").unlink()
    refused(out, "is not valid JSON")
    note.write_text(text)
    (out / "unfinished" / "000000.h5").write_bytes(b"")
    refused(out, "contains checkpoints in the format of an earlier version")
    refused(tmp_path / "absent", "is not a folder")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "contains nothing to resume")


def test_pieces_of_another_version_are_refused(tmp_path, monkeypatch):
    from stickslip.data import checkpoint as room

    one = room.Checkpoint(tmp_path, "scenario")
    one.save("piece", {"x": 1.0})
    assert one.load("piece") == {"x": 1.0}
    monkeypatch.setattr(room, "__version__", "99.0")
    with pytest.raises(ArchiveError, match=r"was computed by stickslip .* those of this version, 99\.0"):
        one.load("piece")


def test_checkpoints_of_another_level_of_the_core_are_named(tmp_path, monkeypatch):
    from stickslip.data import checkpoint as room

    monkeypatch.setattr(room.build, "usable_levels", lambda: ("base", "avx2"))
    for level in ("avx2", "avx512", "base"):
        monkeypatch.setattr(room.build, "best_level", lambda level=level: level)
        one = room.Checkpoint(tmp_path / level, "scenario")
        one.save("piece", {"x": 1.0})
        assert room.note_on_levels(one.run) == ""
    assert one.load("piece") == {"x": 1.0}
    note = room.note_on_levels(tmp_path / "avx2")
    assert "by the core for avx2, but this is the core for base: " in note
    assert note.endswith("; STICKSLIP_LEVEL=avx2 continues with that core")
    assert room.note_on_levels(tmp_path / "avx512").endswith("to round-off, not bit for bit")


@pytest.mark.skipif(os.name != "posix", reason="needs limits on the size of files")
def test_a_full_disk_ends_with_a_sentence_and_what_was_kept_is_whole(tmp_path):
    """A limit on the size of files stands for the disk: writing beyond it is an error, as it is there."""
    (tmp_path / "scenario.toml").write_text(FLOW.format(settle=1.0, open=1.0))
    import resource

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (52_000, limits[1]))
    try:
        done = stickslip("run", "scenario.toml", "--out", "out", cwd=tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert done.stderr.count("\n") == 1, done.stderr
    assert "file too large" in done.stderr
    assert pieces(tmp_path / "out")
    assert not (tmp_path / "out" / "results.h5").exists()
    assert stickslip("resume", tmp_path / "out").returncode == 0


@pytest.mark.slow
def test_a_hundred_kills_lose_no_frame_that_was_said_to_be_kept(tmp_path):
    scenario, rng, kills, most = FLOW.format(settle=60.0, open=60.0), random.Random(0), 0, 0
    other = whole(tmp_path / "other", scenario)
    while kills < 100:
        out = tmp_path / f"out-{kills}"
        (tmp_path / "scenario.toml").write_text(scenario)
        words, said, longest = ["run", "scenario.toml", "--out", out], 0, 4.0
        while not (out / "results.h5").exists():
            process = begun(tmp_path, words)
            alive = killed_after(process, rng.uniform(0.8, longest))
            longest *= 1.1  # however slow the machine is, in the end there is time to write results
            kills += alive
            said = max(said, *(int(n) for n in re.findall(r"(\d+) frames saved", process.said)), 0)
            most = max(most, said)
            frames = sum(restore(node, {})["frame"] for node in pieces(out).values())
            assert frames >= said or (out / "results.h5").exists()
            words = ["resume", out] if (out / "scenario.json").exists() else words
        stickslip("resume", out)
        assert (out / "results.h5").read_bytes() == (other / "results.h5").read_bytes()
    assert most > 0  # what is said was heard


def killed_after(process, seconds):
    """Kill a process after a time; what it had said is kept beside it."""
    try:
        process.said = "".join(process.communicate(timeout=seconds))
        return False
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.said = "".join(process.communicate())
        return True


FEWER = {  # cycles and load steps, all of which are saved in the same way
    "cyclic-shear": {"cycles": {"amplitudes": [1e-5], "number": 1, "steps": 12}},
    "element-test": {"path": {"strain": 1e-3, "step": 1e-3}},
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_run_whose_parts_are_all_saved_gives_the_same_numbers(name, tmp_path):
    """Results are restored from what a killed run leaves, with the classes of all their fields."""
    scenario = ss.scenario(experiment=name, **EXPERIMENTS[name].smallest[0] | FEWER.get(name, {}))
    first, second = (
        to_bytes(make_node(EXPERIMENTS[name].numbers(ss.simulate(scenario, folder=tmp_path)))) for _ in range(2)
    )
    assert first == second
