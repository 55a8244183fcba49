"""Sizes of runs, checked against limits before anything is allocated; cores; progress of a run; outcome of a solver.

Progress is reported through a callable. Short low-level tasks, such as the compilation of a law, have no such callable:
`announced` shows them on the terminal.
"""

import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from enum import Enum
from multiprocessing import parent_process
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from .arguments import Requirement
from .readable import pluralize, readable

MOST = 1_000_000
# largest number of items of each kind; the same on every machine, so a scenario is valid everywhere or nowhere
LIMITS = {
    "grains": MOST, "bodies": 2 * MOST, "cells": MOST, "points": MOST, "times": MOST, "members": MOST, "runs": MOST,
    "types": 300, "branches": 100_000, "load steps": 100_000, "profiles": 100_000, "samples": 10 * MOST,
    "directions": 100_000, "walkers": 10_000, "wave vectors": 100_000,
    "time steps": 1000 * MOST, "bytes": 1 << 36,
}  # fmt: skip
STATE = 800  # bytes of a state per grain; measured: 572 for packed disks, 766 for packed spheres


class Size(NamedTuple):
    """Number of items of one kind in a run, or in the result of a function."""

    what: str  # origin of the number, as the start of a sentence: "line.width and line.cell make"
    number: float
    kind: str  # a key of LIMITS
    remedy: str  # advice if there are too many


def require_sizes(sizes: Iterable[Size], error: type[ValueError] = ValueError) -> None:
    """Raise an error at the first size beyond its limit.

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


def available_cores() -> int:
    """Number of cores that this process may use, according to its affinity and the quotas of its control groups."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, int(min(cores, cpu_quota())))


def cpu_quota(groups: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")) -> float:
    """Processor time per unit of time that the control groups of this process allow; infinite without a limit.

    Source: Linux kernel, Documentation/admin-guide/cgroup-v2.rst, cpu.max; scheduler/sched-bwc.rst for version 1.
    """
    try:
        match = re.search(r"^\d+:(|(?:[^:]+,)?cpu(?:,[^:]+)?):/(.*)", groups.read_text(), re.MULTILINE)
    except OSError:  # not Linux
        match = None
    if not match:
        return np.inf
    root, least = root / match[1], np.inf
    for folder in (root / match[2], *(root / match[2]).parents):
        for names in (["cpu.max"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"]):
            try:
                quota, period = " ".join((folder / name).read_text() for name in names).split()
                least = min(least, float(quota) / float(period) if quota not in ("max", "-1") else np.inf)
            except (OSError, ValueError):
                continue
        if folder == root:
            break
    return least


def _require_signature(name: str, value: Callable) -> None:
    try:
        inspect.signature(value).bind("stage", 0.0, "text")
    except TypeError:
        raise ValueError(f"{name} has the wrong arguments: it is called as {name}(stage, share done, text)") from None
    except ValueError:  # a compiled function has no signature
        return


# called as report(name of the stage, share of it that is done, text with the relevant quantities)
Report = Annotated[Callable[[str, float, str], None], Requirement(_require_signature)]


def silent(stage: str, share: float, text: str) -> None:
    """Report nothing."""


def within(
    report: Report, begin: float = 0.0, end: float = 1.0, *, stage: str | None = None, prefix: str = ""
) -> Report:
    """Return a function that reports the progress of a part as progress of a longer task.

    Parameters
    ----------
    begin, end : fractions of the whole at which the part begins and ends
    stage, prefix : stage name that replaces that of the part, and prefix of the stage name

    Examples
    --------
    >>> within(print, 0.5, 1.0, prefix="sample 3: ")("shear", 0.5, "2 pairs")
    sample 3: shear 0.75 2 pairs
    """
    return lambda name, share, text: report(f"{prefix}{stage or name}", begin + (end - begin) * share, text)


@contextmanager
def _line_on_terminal(text: str) -> Iterator[None]:
    """Show a line on standard error during a task, if this is a terminal and the process is not a worker."""
    stream = sys.stderr
    if stream is None or not stream.isatty() or os.environ.get("TERM") == "dumb" or parent_process():
        yield
        return
    stream.write(f"{text} …")
    stream.flush()
    try:
        yield
    finally:
        stream.write("\r\x1b[K")
        stream.flush()


_displays: list[Callable[[str], AbstractContextManager]] = [_line_on_terminal]  # the last one is in use


def announced(text: str) -> AbstractContextManager:
    """Context manager that shows the present task."""
    return _displays[-1](text)


def hidden(text: str) -> AbstractContextManager:
    """Display that shows nothing."""
    return nullcontext()


@contextmanager
def displayed_by(display: Callable[[str], AbstractContextManager]) -> Iterator[None]:
    """Let `announced` use another display: a function of the text that returns a context manager."""
    _displays.append(display)
    try:
        yield
    finally:
        _displays.remove(display)


class Status(Enum):
    """Status of a solve. The value of each member is a message for users, including a remedy."""

    CONVERGED = "equilibrium was reached"
    DONE = "the run reached its last step"
    STEPS_SPENT = (
        "equilibrium was not reached in the allowed number of steps: perhaps there is no equilibrium under "
        "this load; otherwise allow more steps, or use stronger drag or a tolerance above round-off"
    )
    NOT_A_NUMBER = "a grain's position became infinite or NaN: use a smaller time step or smaller load steps"
    BLOWN_UP = "a grain moved by more than its radius in one time step: use a smaller time step"
    STALLED = "Newton's method stopped converging: use smaller load steps, or damped dynamics"
    SINGULAR = (
        "the Jacobian is singular (a rattler, or sliding without resistance): remove rattlers, or use damped dynamics"
    )
    CONTACT_LOST = "grains flew apart and lost all their contacts: use stronger drag or a smaller load"


@readable(rows=lambda outcome: _rows(outcome))
class Outcome(NamedTuple):
    """Result of a solve."""

    status: Status
    residual: float  # largest unbalanced force or torque/radius [force]
    iterations: int
    where: int = -1  # body with the largest residual, or the one that became unstable
    how: str = ""  # description of the solve
    fallback: bool = False  # True if Newton's method failed and damped dynamics was used
    warning: str = ""  # message to the user about a solve that succeeded
    unstable: bool = False  # True if a check found that the equilibrium is unstable
    left: bool = False  # True if a check found that a step of a path left its branch

    @property
    def ok(self) -> bool:
        """True if equilibrium was reached, or the last step of a run without a tolerance."""
        return self.status in (Status.CONVERGED, Status.DONE)

    @property
    def broken(self) -> bool:
        """True if the run became numerically unstable, so that its last state is meaningless."""
        return self.status in (Status.NOT_A_NUMBER, Status.BLOWN_UP)

    def __str__(self) -> str:
        if self.broken and self.how:
            return f"{self.status.value} (grain {self.where + 1}, {self.how})"
        at = f", grain {self.where + 1}" if self.where >= 0 and not self.ok else ""
        size = "" if np.isinf(self.residual) else f"residual {self.residual:.3g}{at}, "  # inf: it was not computed
        return f"{self.status.value} ({size}{pluralize(self.iterations, 'iteration')})"


def _rows(outcome: Outcome):
    yield "end", outcome.status.value
    yield "residual", outcome.residual if np.isfinite(outcome.residual) else None, "force", "largest unbalanced force"
    yield "where", f"grain {outcome.where + 1}" if outcome.where >= 0 and not outcome.ok else None
    yield "iterations", outcome.iterations
    yield "how", outcome.how
    yield "fallback", "damped dynamics, because Newton's method failed" if outcome.fallback else None
    yield "warning", outcome.warning


class NotInEquilibriumError(RuntimeError):
    """Raised if a run does not reach a required equilibrium; `outcome` is that of the solve."""

    def __init__(self, sentence: str, outcome: Outcome):
        super().__init__(f"{sentence}: {outcome}")
        self.outcome = outcome
