"""The loop over realisations, shared by all experiments: run in parallel, save, skip saved ones, report failures.

On a device, legs of several realisations, each in a separate thread, run side by side in one batch (`Together`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from threading import Condition, Lock
from typing import Any, NamedTuple

from ..core.dynamics.batch import Device, System, check_law, prepare, run_systems
from ..core.dynamics.record import Record
from ..core.dynamics.run import Engine, Leg
from ..core.laws.builtin import Law
from ..core.progress import Report, silent, within
from ..core.state import State
from ..data.checkpoint import Checkpoint, kind_of_result
from ..ensemble import Workers, run_members

MOST = 256  # realisations side by side on a device


class Task(NamedTuple):
    """One realisation, or one independent part of it."""

    label: str  # in messages, such as "sample 3"
    arguments: tuple
    name: str  # name of its saved result
    checkpoint: Checkpoint | None  # where the result is saved


class Realizations(NamedTuple):
    """Results in the order of the tasks."""

    results: list[Any]  # None where a realisation failed
    labels: list[str]  # labels of the tasks
    reasons: list[str | None]  # reason of each failure, None elsewhere

    @property
    def sentences(self) -> list[str | None]:
        """Label and reason of each failure, None elsewhere."""
        return [reason and f"{label}: {reason}" for label, reason in zip(self.labels, self.reasons, strict=True)]

    @property
    def failures(self) -> tuple[str, ...]:
        """One sentence for each realisation that failed."""
        return tuple(sentence for sentence in self.sentences if sentence)

    def groups(self, size: int) -> "list[Realizations]":
        """Split into groups of consecutive tasks."""
        starts = range(0, len(self.results), size)
        return [Realizations(*(part[k : k + size] for part in self)) for k in starts]

    @property
    def complete(self) -> list[Any]:
        """Results of all tasks; raise RuntimeError with the first failure if there is one."""
        if self.failures:
            raise RuntimeError(self.failures[0])
        return self.results

    def successful(self, what: str) -> list[Any]:
        """Return the results of the tasks that did not fail.

        Raises
        ------
        RuntimeError
            If there are none.
        """
        results = [result for result in self.results if result is not None]
        if not results and self.failures:
            raise RuntimeError(f"every {what} failed, the first with {self.failures[0]}")
        return results


def open_device(name: str, law: Law) -> Device:
    """Return the device of this name.

    Raises
    ------
    ValueError
        If it cannot evaluate the law, or if no device has this name.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If there is no such device.
    """
    from ..core.dynamics.device import open_device

    check_law(law)
    return open_device(name)


def run_realizations(
    function: Callable,
    tasks: Sequence[Task],
    *,
    stage: str,
    workers: Workers = None,
    device: Device | None = None,
    report: Report = silent,
    **options,
) -> Realizations:
    """Run a function for every task that has no saved result, and save each result as soon as it is available.

    Parameters
    ----------
    function : called as function(*arguments, report), by which it reports its progress; importable by name
    device : runs the legs of up to `MOST` tasks side by side; the function is called with an Engine as `engine`
    stage, workers, report, options : as for `run_members`

    Raises
    ------
    ArchiveError
        If a saved result is damaged, or belongs to another scenario or version.
    """
    if device:
        return _run_on_device(device, function, tasks, report, stage=stage, **options)
    places = {task.checkpoint.folder: task.checkpoint for task in tasks if task.checkpoint}
    for checkpoint in places.values():
        checkpoint.check()
        checkpoint.announce()

    def load(k: int) -> Any:
        _, _, name, checkpoint = tasks[k]
        return checkpoint.load(name, kind_of_result(function)) if checkpoint and checkpoint.has(name) else None

    def save(k: int, result: Any) -> None:
        _, _, name, checkpoint = tasks[k]
        if checkpoint:
            checkpoint.save(name, result)
            checkpoint.of(name).clear()  # pieces of the unfinished task

    arguments = [task.arguments for task in tasks]
    members = run_members(
        function, arguments, workers=workers, stage=stage, report=report, load=load, save=save, **options
    )
    return Realizations([m.result for m in members], [task.label for task in tasks], [m.failure for m in members])


def _run_on_device(device: Device, function: Callable, tasks: Sequence[Task], report: Report, **options):
    """Run tasks side by side in groups; see `run_realizations`."""
    parts = []
    for first in range(0, len(tasks), MOST):
        group = tasks[first : first + MOST]
        batches = Together(device, sum(not (task.checkpoint and task.checkpoint.has(task.name)) for task in group))

        def run(*arguments, batches=batches):
            try:
                with batches.turn:
                    return function(*arguments, engine=batches.engine)
            finally:
                batches.leave()

        tell = within(report, first / len(tasks), (first + len(group)) / len(tasks))
        try:
            parts.append(run_realizations(run, group, report=tell, together=True, **options))
        finally:
            batches.stopped = True
    return Realizations(*(list(chain(*part)) for part in zip(*parts, strict=True)))


@dataclass
class _Waiting:
    system: System
    outcome: tuple[State, Record] | Exception | None = None


class Together:
    """Engine for several callers, each in a separate thread: waits until all have a leg, and runs these side by side.

    Parameters
    ----------
    members : number of callers; each holds `turn` while it works, and calls `leave` when it has no more legs
    """

    SAMPLES = 500  # number of samples of a leg, so that packing takes a small share of the time

    def __init__(self, device: Device, members: int):
        self.device, self.members = device, members
        self.waiting: list[_Waiting] = []
        self.stopped = False  # set it to run no more legs
        self.change = Condition()
        self.turn = Lock()  # callers that do not wait take turns, as some of their work must not run concurrently

    @property
    def engine(self) -> Engine:
        """The engine."""
        return Engine(self._pieces, samples=self.SAMPLES)

    def leave(self) -> None:
        """Wait for one caller fewer."""
        with self.change:
            self.members -= 1
            self._run_when_complete()

    def _pieces(self, leg: Leg) -> Iterator[tuple[State, Record]]:
        mine = _Waiting(prepare(leg))
        with self.change:
            self.waiting.append(mine)
            self._run_when_complete()
            self.turn.release()
            self.change.wait_for(lambda: mine.outcome is not None)
        self.turn.acquire()
        if isinstance(mine.outcome, Exception):
            raise mine.outcome
        yield mine.outcome

    def _run_when_complete(self) -> None:
        if len(self.waiting) < max(1, self.members):
            return
        waiting, self.waiting = self.waiting, []
        try:
            if self.stopped:
                raise RuntimeError("the run was stopped")
            outcomes = run_systems([one.system for one in waiting], self.device)
        except Exception as problem:  # each caller raises it
            outcomes = [problem] * len(waiting)
        for one, outcome in zip(waiting, outcomes, strict=True):
            one.outcome = outcome
        self.change.notify_all()
