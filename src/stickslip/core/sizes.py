"""Sizes of runs and protocols: stated, and refused beyond a limit, before anything is allocated."""

from collections.abc import Iterable
from typing import NamedTuple

MOST = 1_000_000
# largest number of each thing; the same on every machine, so that a scenario is valid everywhere or nowhere
LIMITS = {
    "grains": MOST, "bodies": 2 * MOST, "cells": MOST, "points": MOST, "times": MOST, "members": MOST, "runs": MOST,
    "types": 300, "branches": 100_000, "load steps": 100_000, "profiles": 100_000, "samples": 10 * MOST,
    "directions": 100_000, "walkers": 10_000, "wave vectors": 100_000,
    "time steps": 1000 * MOST, "bytes": 1 << 36,
}  # fmt: skip
STATE = 800  # bytes of a state for each grain; measured: 572 for packed disks, 766 for packed spheres


class Size(NamedTuple):
    """Number of things of one kind that a run has or a function makes."""

    what: str  # what determines it, as the start of a sentence: "line.width and line.cell make"
    number: float
    kind: str  # a key of LIMITS
    remedy: str  # what to do if there are too many


def require_sizes(sizes: Iterable[Size], error: type[ValueError] = ValueError) -> None:
    """Raise an error with one sentence at the first size beyond its limit.

    Sizes are computed one after another, so that an earlier one can bound the work of computing a later one.

    Examples
    --------
    >>> require_sizes([Size("it takes", 4e9, "load steps", "use larger steps")])
    Traceback (most recent call last):
    ValueError: it takes 4e+09 load steps: at most 100000 are allowed; use larger steps
    """
    for what, number, kind, remedy in sizes:
        if not number <= LIMITS[kind]:
            got, most = (f"{_format(n, kind)} {'GiB' if kind == 'bytes' else kind}" for n in (number, LIMITS[kind]))
            raise error(f"{what} {got}: at most {most.removesuffix(f' {kind}')} are allowed; {remedy}")


def _format(number: float, kind: str) -> str:
    if kind == "bytes":
        return f"{number / 2**30:.3g}"
    return f"{number:.0f}" if number < 10 * MOST else f"{number:.3g}"
