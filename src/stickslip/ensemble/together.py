"""Legs of several callers, each in a thread of its own, run side by side in one batch."""

from collections.abc import Iterator
from dataclasses import dataclass
from threading import Condition, Lock

from ..core.dynamics.batch import Device, System, prepare, run_systems
from ..core.dynamics.engine import Engine, Leg
from ..core.dynamics.record import Record
from ..core.state import State


@dataclass
class _Waiting:
    system: System
    outcome: tuple[State, Record] | Exception | None = None


class Together:
    """Engine for several callers, each in a thread of its own: waits until all have a leg, and runs these side by side.

    Parameters
    ----------
    members : number of callers; each holds `turn` while it works, and calls `leave` when it has no more legs
    """

    SAMPLES = 500  # of a leg, so that packing takes a small share of the time

    def __init__(self, device: Device, members: int):
        self.device, self.members = device, members
        self.waiting: list[_Waiting] = []
        self.stopped = False  # set it to run no more legs
        self.change = Condition()
        self.turn = Lock()  # callers that do not wait take turns, as not all that they do may run at once

    @property
    def engine(self) -> Engine:
        """The engine."""
        return Engine(self._pieces, samples=self.SAMPLES)

    def leave(self) -> None:
        """Wait for one caller less."""
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
