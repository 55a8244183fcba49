"""A graphics processor on which batches run: kernels from the headers of the core, compiled by NVRTC through CuPy."""

import ctypes
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from ..._core import build
from ...extras import require
from ..library import core
from .batch import Sizes

STEPS = 32  # between looks at what the systems wait for
LONGEST = 1000  # launches between two looks from here
THREADS, TILE, CREW = 256, 32, 128  # the last two as in `batch.cu`
OPTIONS = "--std=c++17", "--device-as-default-execution-space", "--fmad=false", "--diag-suppress=1097"


class Cuda:
    """The current device of CUDA."""

    def __init__(self):
        self.cupy, self.module = _module()
        self.stream = self.cupy.cuda.Stream(non_blocking=True)

    def allocate(self, arrays, law, sizes) -> None:
        """Make arrays of zeros, and take the law."""
        with self.stream:
            self.arrays = {}  # frees the memory of the former
            self.arrays = {name: self.cupy.zeros(shape, kind) for name, (shape, kind) in arrays.items()}
            pointers = {name: array.data.ptr for name, array in self.arrays.items()}
            self._store("systems", core.fill("Batch", sizes._asdict() | pointers))
            self._store("law", core.fill("Law", law))
            self.stream.synchronize()
            self._launch(sizes, 1)  # loads the kernels, which a capture cannot
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
        """Run steps."""
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
    """Name, blocks and threads of each kernel of a number of steps, and of what systems wait for after them."""
    bodies, dim = sizes.slots * sizes.room, sizes.dim
    each = -(-bodies // THREADS), THREADS
    yield from [(f"step_{dim}", bodies // TILE, CREW)] * steps
    yield f"sample_{dim}", sizes.slots, core.TEAM
    yield f"begin_{dim}", *each
    yield "sort", sizes.slots, core.TEAM
    yield f"list_{dim}", *each
    yield "resume", -(-sizes.slots // THREADS), THREADS


def open_device(name: str) -> Cuda:
    """Return a device by its name, "cuda".

    Raises
    ------
    ValueError
        with a one-sentence message, if there is no device of this name.
    MissingExtraError
        if CuPy is missing.
    RuntimeError
        if no graphics processor of NVIDIA answers.
    """
    if name != "cuda":
        raise ValueError(f"device = {name!r} was given: 'cuda' is allowed, or none for ordinary processors")
    return Cuda()


@cache
def _module():
    """CuPy, and the compiled kernels."""
    cupy = require("cupy", "gpu")
    try:
        cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as problem:
        raise RuntimeError(f"CUDA finds no graphics processor ({problem}): run without device") from None
    folder = Path(build.__file__).parent
    code = (folder / "batch.cu").read_text(encoding="utf-8")
    return cupy, cupy.RawModule(code=code, options=(*OPTIONS, f"-I{folder}"), backend="nvrtc")
