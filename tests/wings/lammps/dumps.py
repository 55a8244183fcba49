"""Dumps of a real LAMMPS run, three frames of 27 grains at rest, and ways to write them anew."""

import threading
import time
from pathlib import Path

SHEARED = Path(__file__).parents[3] / "examples" / "sheared"
LAW = {"law": "hertz_mindlin_reff", "kn": 1.0, "kt": 0.8, "mu": 0.2, "damping_n": 0.0, "damping_t": 0.0}
WORDS = [word for name, value in LAW.items() for word in (f"--{name.replace('_', '-')}", str(value))]
STEPS = [0, 40000, 80000]


def frames(name: str) -> list[bytes]:
    """Frames of grains.dump or contacts.dump."""
    return [b"ITEM: TIMESTEP" + part for part in (SHEARED / name).read_bytes().split(b"ITEM: TIMESTEP")[1:]]


def copy(folder: Path, *, each: bool = False, contacts: bool = True) -> Path:
    """Write the dumps into a folder: in one file, or one for each frame."""
    folder.mkdir(exist_ok=True)
    for name in ("grains", "contacts") if contacts else ("grains",):
        for step, frame in zip(STEPS, frames(f"{name}.dump"), strict=True):
            path = folder / (f"{name}.{step}.dump" if each else f"{name}.dump")
            with path.open("ab") as file:
                file.write(frame)
    return folder


def simulate(folder: Path, *, each: bool = False, piece: int = 1777, pause: float = 0.004) -> threading.Thread:
    """Write the dumps as a running simulation does, in pieces that end anywhere."""

    def run():
        for k, step in enumerate(STEPS):
            for name in ("grains", "contacts"):
                content = frames(f"{name}.dump")[k]
                for at in range(0, len(content), piece):
                    with (folder / (f"{name}.{step}.dump" if each else f"{name}.dump")).open("ab") as file:
                        file.write(content[at : at + piece])
                    time.sleep(pause)

    folder.mkdir(exist_ok=True)
    for name in ("grains", "contacts"):
        if not each:
            (folder / f"{name}.dump").touch()
    writer = threading.Thread(target=run)
    writer.start()
    return writer
