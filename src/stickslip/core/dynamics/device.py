"""A graphics processor on which batches run: kernels from the headers of the core, compiled by NVRTC through CuPy."""

import ctypes
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from ..._core import build
from ...extras import require
from ..arguments import NotNegative, checked
from ..laws.builtin import Law
from ..library import core
from ..state import State
from .batch import Device, Sizes, run_legs
from .record import Record
from .run import Leg, check_steps

STEPS = 32  # steps between checks of the state of the systems
LONGEST = 1000  # launches between two checks by the host
THREADS, TILE, CREW = 256, 32, 128  # the last two as in `batch.cu`
OPTIONS = "--std=c++17", "--device-as-default-execution-space", "--fmad=false", "--diag-suppress=1097"


class Cuda:
    """The current CUDA device."""

    def __init__(self):
        self.cupy, self.module = _module()
        self.stream = self.cupy.cuda.Stream(non_blocking=True)

    def allocate(self, arrays, law, sizes) -> None:
        """Allocate arrays of zeros, and set the law."""
        with self.stream:
            self.arrays = {}  # frees the memory of the previous batch
            self.arrays = {name: self.cupy.zeros(shape, kind) for name, (shape, kind) in arrays.items()}
            pointers = {name: array.data.ptr for name, array in self.arrays.items()}
            self._store("systems", core.fill("Batch", sizes._asdict() | pointers))
            self._store("law", core.fill("Law", law))
            self.stream.synchronize()
            self._launch(sizes, 1)  # loads the kernels, which is impossible during a capture
            self.stream.begin_capture()
            self._launch(sizes, STEPS)
            self.graph = self.stream.end_capture()

    def write(self, name, place, values) -> None:
        """Write to a part of an array."""
        with self.stream:
            array = self.arrays[name]
            array[place] = self.cupy.asarray(np.ascontiguousarray(values, array.dtype))

    def read(self, name, place) -> np.ndarray:
        """Read a part of an array."""
        with self.stream:
            return self.cupy.asnumpy(self.arrays[name][place])

    def run(self, steps: int) -> np.ndarray:
        """Run each system for at most this number of steps; return the array `number`."""
        for _ in range(min(LONGEST, -(-steps // STEPS))):
            self.graph.launch(self.stream)
        return self.read("number", slice(None))

    def _store(self, name: str, struct) -> None:
        """Write a struct to constant memory."""
        target = self.module.get_global(name)
        target.copy_from_host(ctypes.c_void_p(ctypes.addressof(struct)), ctypes.sizeof(struct))

    def _launch(self, sizes: Sizes, steps: int) -> None:
        for name, blocks, threads in launches(sizes, steps):
            self.module.get_function(name)((blocks,), (threads,), ())


def launches(sizes: Sizes, steps: int) -> Iterator[tuple[str, int, int]]:
    """Name and numbers of blocks and threads of each kernel launch, for some steps and the tasks after them."""
    bodies, dim = sizes.slots * sizes.room, sizes.dim
    each = -(-bodies // THREADS), THREADS
    yield from [(f"step_{dim}", bodies // TILE, CREW)] * steps
    yield f"sample_{dim}", sizes.slots, core.TEAM
    yield f"begin_{dim}", *each
    yield "sort", sizes.slots, core.TEAM
    yield f"list_{dim}", *each
    yield "resume", -(-sizes.slots // THREADS), THREADS


def open_device(name: str) -> Device:
    """Return a device by its name, "cuda".

    Raises
    ------
    ValueError
        If there is no device of this name.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If no graphics processor responds.
    """
    if name != "cuda":
        raise ValueError(f"device must be 'cuda', or omitted for ordinary processors, got {name!r}")
    return Cuda()


@checked
def run_batch(
    states: list[State] | tuple[State, ...],
    law: Law,
    steps: int,
    dt: float,
    *,
    drag: NotNegative = 0.0,
    every: int = 0,
    device: str = "cuda",
) -> list[tuple[State, Record]]:
    """Run many systems side by side on a graphics processor, each of them as `run` does.

    Sums have a fixed order, so results are bitwise reproducible. They agree with those of `run` to round-off.
    Returned states can be continued here or by `run`.

    Parameters
    ----------
    states : systems of the same dimension, in fixed cells, with walls that do not follow loads, at most 21 rigid groups
        each, and at most 256 neighbours per grain
    law : Law; linear or Hertzian springs with friction and dashpots
    steps : int; dt : float [time]
    drag : float [1/time]
    every : int, number of steps between samples (0: no samples)
    device : "cuda", which requires the extra gpu

    Returns
    -------
    list of (State, Record)
        one for each system, in the order given

    Raises
    ------
    ValueError
        If the device cannot run a system, or if dt is longer than `stable_time_step`.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If no graphics processor responds, or if a system becomes unstable.

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Eqs 6–7 and the computational protocol in its supplement.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> kicked = [ss.packings.perturbed(state, velocity=1e-3, seed=k) for k in range(4)]
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> ends = ss.protocols.run_batch(kicked, law, 1000, 0.02)  # doctest: +SKIP
    """
    if not states:
        raise ValueError("a batch needs at least one state")
    check_steps(steps, dt, every)
    every = min(every, steps + 1)
    outcomes = run_legs([Leg(state, law, dt, steps, drag=drag, every=every) for state in states], open_device(device))
    for outcome in outcomes:
        if isinstance(outcome, Exception):
            raise outcome
    return outcomes


@cache
def _module():
    """CuPy and the compiled kernels."""
    cupy = require("cupy", "gpu")
    try:
        cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as problem:
        raise RuntimeError(f"CUDA finds no graphics processor ({problem}): run without device") from None
    folder = Path(build.__file__).parent
    code = (folder / "batch.cu").read_text(encoding="utf-8")
    return cupy, cupy.RawModule(code=code, options=(*OPTIONS, f"-I{folder}"), backend="nvrtc")
