"""Functions that other processes find by their names."""

import os
import signal
import time
from pathlib import Path

from stickslip.core.progress import silent


def square(x, report=silent):
    report(f"square of {x}", 0.5, "half")
    return x * x


def linger(x, report=silent):
    report(f"wait of {x}", 0.5, "half")
    time.sleep(0.4)
    return x


def fail_at(x, bad, report=silent):
    if x == bad:
        raise ValueError(f"{x} is bad")
    return x


def die(x, notes, times):
    """x squared, by processes of which the first `times` that take x = 3 are killed from outside."""
    if x == 3:
        with (Path(notes) / "deaths").open("a") as file:
            file.write(".")
        if len((Path(notes) / "deaths").read_text()) <= times:
            os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return x * x


def wait(notes, k, seconds, report=silent):
    """Sleep, in a process that leaves its number and its parent's."""
    (Path(notes) / f"pid{k}").write_text(f"{os.getpid()} {os.getppid()}")
    report(f"task {k}", 0.0, "started")
    time.sleep(seconds)
    return k


def environment():
    return os.environ["OMP_NUM_THREADS"], os.getpid()


def unpicklable():
    return lambda: 0


def hold(seconds):
    """Keep the interpreter's lock, as a compiled kernel does."""
    import ctypes

    ctypes.PyDLL(None).sleep(int(seconds))
    return seconds
