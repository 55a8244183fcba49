"""Parts common to all simulations: the law and the packing of a scenario, and the loop over its realisations.

Realisations run in parallel and are saved; saved ones are skipped, and failures are reported. On a device, time is
integrated in legs: those of several realisations, each in a separate thread, run as one batch (`Together`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from threading import Condition, Lock
from typing import Any, NamedTuple

import numpy as np

from ..builtin_laws import BUILTIN_LAWS, BY_NAME
from ..core.dynamics.batch import Device, System, check_law, prepare, run_systems
from ..core.dynamics.record import Record
from ..core.dynamics.run import Engine, Leg
from ..core.laws.builtin import KN, MOMENTS, ROLLING, TWISTING, Law, for_pair, with_values
from ..core.laws.properties import with_lever, with_memory, with_rolling, with_twisting
from ..core.progress import Report, silent, within
from ..core.state import State
from ..data.checkpoint import Checkpoint, kind_of_result
from ..data.law_schema import SUBSTRATE, LawTable, Packing, load_law
from ..data.sample import law_by_name
from ..ensemble import Workers, run_members
from ..loading.packing import PackingInfo, jammed
from ..solve.collision import eq8_damping, with_restitution

RESTITUTION = ("tsuji", "coeff_restitution")
DEFAULT_FRACTION = {2: 0.86, 3: 0.68}
SOURCES = {law.name: law.sources for law in BUILTIN_LAWS}


def make_law(chosen: LawTable, *, radius: float = np.nan, mass: float = np.nan) -> Law:
    """Contact law that a scenario selects, with separate parameters for walls if its table has them.

    `radius` and `mass` are those of the two grains whose collision has the given restitution.
    """
    if chosen.file is not None:
        law = load_law(chosen)
    else:
        kt = 2 / 7 * chosen.kn if chosen.kt is None and chosen.kn is not None else chosen.kt
        damping_n, damping_t = chosen.damping_n or 0.0, chosen.damping_t
        if damping_t is None:  # with a coefficient of restitution, damping_t is a ratio
            damping_t = (chosen.damping_ratio or 0.0) * (1.0 if chosen.damping in RESTITUTION else damping_n)
        law = law_by_name(
            chosen.kind, chosen.coulomb, chosen.kn, kt, chosen.mu, young=chosen.young, poisson=chosen.poisson,
            damping=chosen.dashpots, damping_n=damping_n, damping_t=damping_t, tension=chosen.tension,
            **{p.name: getattr(chosen, p.name) for p in BY_NAME[chosen.kind].parameters},
        )  # fmt: skip
    if chosen.restitution is not None:
        ratio = 0.5 if chosen.damping_ratio is None else chosen.damping_ratio
        # the restitution of a linear law does not depend on the speed: any value of a suitable magnitude works
        speed = chosen.speed or 0.01 * radius * float(np.sqrt(law.table[0, 0, KN] / mass))
        meeting = {"radius": radius, "mass": mass, "speed": speed, "ratio": ratio}
        if chosen.reading == "eq8":
            gamma = eq8_damping(chosen.restitution, young=chosen.young, poisson=chosen.poisson, **meeting)
            law = with_values(law, damping_n=gamma, damping_t=ratio * gamma)
        else:
            law = with_restitution(law, chosen.restitution, **meeting)
    law = law if chosen.lever is None else with_lever(law, chosen.lever)
    law = law if chosen.memory is None else with_memory(law, chosen.memory)
    given = {name: getattr(chosen, name) or 0.0 for part in MOMENTS.values() for name in part}
    rolls, twists = ({name: given[name] for name in MOMENTS[part]} for part in (ROLLING, TWISTING))
    law = law if chosen.rolling is None else with_rolling(law, chosen.rolling, **rolls)
    law = law if chosen.twisting is None else with_twisting(law, chosen.twisting, **twists)
    if chosen.wall is None:
        return law
    return for_pair(law, 0, SUBSTRATE, **{k: v for k, v in chosen.wall.model_dump().items() if v is not None})


def law_references(law: LawTable | str) -> tuple[str, ...]:
    """Return the references of a built-in law, given by a table or a name; a law from a file has none."""
    return SOURCES[law] if isinstance(law, str) else SOURCES[law.kind] if law.file is None else ()


def make_packing(chosen: Packing, law: Law, seed: int, tolerance: float | None = None) -> tuple[State, PackingInfo]:
    """Make the packing of a scenario; return State and PackingInfo (see `jammed`)."""
    fraction = chosen.packing_fraction
    if fraction is None and chosen.pressure is None:
        fraction = DEFAULT_FRACTION[chosen.dim]
    return jammed(
        chosen.grains,
        packing_fraction=fraction,
        pressure=chosen.pressure,
        dim=chosen.dim,
        radius=chosen.radius,
        mass=chosen.mass,
        i0=chosen.i0,
        law=law,
        seed=seed,
        tolerance=tolerance,
    )


MOST = 256  # largest number of realisations side by side on a device


class Task(NamedTuple):
    """One realisation, or one independent part of it."""

    label: str  # name in messages, such as "sample 3"
    arguments: tuple
    name: str  # name of its saved result
    checkpoint: Checkpoint | None  # where the result is saved


class Realizations(NamedTuple):
    """Results in the order of the tasks."""

    results: list[Any]  # None where a realisation failed
    labels: list[str]  # labels of the tasks
    reasons: list[str | None]  # reason for each failure, None elsewhere

    @property
    def sentences(self) -> list[str | None]:
        """Sentence with label and reason for each failure, None elsewhere."""
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
            raise RuntimeError(f"every {what} failed; first message: {self.failures[0]}")
        return results


def open_device(name: str, law: Law) -> Device:
    """Return the device with this name.

    Raises
    ------
    ValueError
        If it cannot evaluate the law, or if the name is unknown.
    MissingExtraError
        If CuPy is missing.
    RuntimeError
        If this machine has no such device.
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
    function : called as function(*arguments, report), and importable by name; calls `report` to show its progress
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
    """Engine for several callers, each in a separate thread: waits for a leg from each, and runs these side by side.

    Parameters
    ----------
    members : number of callers; each holds `turn` while it works, and calls `leave` when it has no more legs
    """

    SAMPLES = 500  # number of samples of a leg, so that assembling batches takes a small share of the time

    def __init__(self, device: Device, members: int):
        self.device, self.members = device, members
        self.waiting: list[_Waiting] = []
        self.stopped = False  # set to True to run no more legs
        self.change = Condition()
        self.turn = Lock()  # callers that do not wait take turns, as some of their work must not run concurrently

    @property
    def engine(self) -> Engine:
        """Engine whose legs run in common batches."""
        return Engine(self._pieces, samples=self.SAMPLES)

    def leave(self) -> None:
        """Remove one caller, so that the others no longer wait for it."""
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
        except Exception as problem:  # raised in each caller
            outcomes = [problem] * len(waiting)
        for one, outcome in zip(waiting, outcomes, strict=True):
            one.outcome = outcome
        self.change.notify_all()
