"""Processor time and size of output: archive frames, movies and reports.

For comparison, frames are also written with HDF5's gzip filter, alternating. Times do not include waiting for the disk.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np

import stickslip as ss
from stickslip.data import archive

from .engine import scene
from .engine_runner import WARM, load_scene, warm_up

PACKINGS = {"disks": (2, 0.86), "spheres": (3, 0.66)}
ROUNDS, FRAMES = 5, 20
BUDGET, LARGEST = 0.4, 120.0  # for a frame of 100,000 grains, and for a movie (200 frames) or report of 10,000 [s]


def packing(kind: str, n: int):
    """State after the first steps of a dense packing, its law and its time step."""
    dim, fraction = PACKINGS[kind]
    state, law, dt = load_scene(dict(np.load(scene(dim, fraction, n, 0.001))))
    return warm_up(state, law, dt, 1), law, dt


def _seconds(function, *arguments) -> float:
    start = time.process_time()
    function(*arguments)
    return time.process_time() - start


def frames(kind: str, n: int) -> list[dict]:
    """Seconds to write and to read a frame, and its size, compared with HDF5's filter."""
    state, law, _ = packing(kind, n)
    tree, found = {"state": state, "law": law}, {"ours": ([], []), "HDF5's gzip": ([], [])}
    size = {}
    archive.versions()  # looked up once per process
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.h5"
        for _ in range(ROUNDS):
            for side, (write, read) in found.items():
                with mock.patch.object(archive, "_LONG", archive._LONG if side == "ours" else np.inf):
                    write.append(_seconds(archive.write, path, tree))
                read.append(_seconds(archive.read, path))
                size[side] = path.stat().st_size / 1e6
    ours, peer = ([min(seconds) for seconds in found[side]] for side in found)
    name = f"frame of {kind}"
    return [
        row(f"write a {name}", n, ours[0], BUDGET, "budget"),
        row(f"write a {name}", n, ours[0], peer[0], "HDF5's gzip"),
        row(f"read a {name}", n, ours[1], peer[1], "HDF5's gzip"),
        row(f"size of a {name}", n, size["ours"], size["HDF5's gzip"], "HDF5's gzip", "MB"),
    ]  # fmt: skip


def pages(kind: str, n: int) -> list[dict]:
    """Seconds of the commands `movie` and `report`, and sizes of their output."""
    state, law, dt = packing(kind, n)
    out = []
    with tempfile.TemporaryDirectory() as folder:
        run, file = Path(folder) / "run", Path(folder) / "packing.npz"
        run.mkdir()
        ss.io.write_packing(file, state, law)
        states = {}
        for k in range(FRAMES):
            states[f"{k:04d}"] = state
            state = ss.run(state, law, WARM, dt, threads=1)[0]
        archive.write(run / "results.h5", {"law": law, "frames": states}, scenario='{"experiment": "flow"}')
        for words, place, name in (
            (("movie",), run, "run.gif"), (("movie",), run, "run.mp4"), (("report",), run, "run.html"),
            (("report", "--no-verdict"), file, "packing.html"),
        ):  # fmt: skip
            path = Path(folder) / name
            spent = _command_seconds(*words, str(place), "--out", str(path))
            case = f"{' '.join(words)} {name} of {kind}" + (f", {FRAMES} frames" if place == run else "")
            out.append(row(case, n, spent, LARGEST, "budget"))
            out.append(row(f"size of {case}", n, path.stat().st_size / 1e6, None, "", "MB"))
    return out


def _command_seconds(*words: str) -> float:
    before = os.times()
    subprocess.run([sys.executable, "-m", "stickslip", *words], capture_output=True, check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def row(case: str, n: int, ours: float, peer: float | None, peer_name: str, unit: str = "s") -> dict:
    """Row of the benchmark for one case."""
    return {
        "case": case, "n": n, "threads": 1, "ours": ours, "peer": peer, "peer_name": peer_name,
        "ratio": ours / peer if peer else None, "unit": unit,
    }  # fmt: skip


def rows(*, smallest: bool = False):
    """Yield the rows of all kinds and sizes."""
    for kind in PACKINGS:
        yield from frames(kind, 100 if smallest else 100_000)
    for kind in () if smallest else PACKINGS:
        yield from pages(kind, 10_000)
