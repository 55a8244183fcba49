"""What an engine is: a program that runs a state under constant conditions; a value, so that LAMMPS can be one."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..laws.builtin import Law
from ..state import State
from .record import Record


class Wave(NamedTuple):
    """A velocity A sin(2π f (t − t₀) + φ), which LAMMPS evaluates as a formula."""

    amplitude: float  # A [length/time]
    frequency: float  # f [1/time]
    phase: float  # φ
    start: float  # t₀ [time]

    def __call__(self, time):
        """Velocity at a time."""
        return self.amplitude * np.sin(2 * np.pi * self.frequency * (time - self.start) + self.phase)


class Leg(NamedTuple):
    """Part of a run: everything that an engine is told.

    With `every` = 0 a state comes back at each of `samples` times, without a record. Otherwise only the last state
    does, with a record of the leg.
    """

    state: State
    law: Law
    dt: float  # [time]
    steps: int  # from the state
    samples: int = 1  # states that come back, evenly spaced, the last one at the end
    drag: float = 0.0  # [1/time]
    spin_drag: float | None = None  # [1/time], if it differs; LAMMPS has none
    every: int = 0  # steps between samples of the record; 0: none
    detailed: bool = False  # whether the record has contact events, and every grain at each sample; not from LAMMPS
    before: tuple[int, int] = 0, 0  # samples and steps that preceded the state, if samples are spaced with them
    walls: tuple[int, ...] | None = None  # number of each wall, if earlier legs had more walls
    waves: Mapping[int, Wave] = MappingProxyType({})  # courses, by column, that are waves
    number: int = 0  # in a sequence of legs
    name: str = ""  # of the leg, and of the one from whose end it starts, for engines that keep legs in files
    after: str = ""
    skin_diameters: float = 0.1  # skin of neighbour lists in mean diameters, for engines that do not choose it
    ranks: int = 1  # processes, for engines that have several

    @property
    def skin(self) -> float:
        """Skin of neighbour lists [length]."""
        return self.skin_diameters * 2 * float(self.state.grains.radius.mean())

    @property
    def wall_numbers(self) -> tuple[int, ...]:
        """Number of each wall of the state among those of all legs."""
        return tuple(range(len(self.state.walls.mass))) if self.walls is None else self.walls

    @property
    def sample_steps(self) -> list[int]:
        """Steps from the state, after which a state comes back or a sample of the record is taken, and the last one."""
        if self.every:
            return [*range(self.every, self.steps, self.every), self.steps]
        past, done = self.before
        spacing = (done + self.steps) / (past + self.samples)
        return [int(k * spacing + 0.5) - done for k in range(past + 1, past + self.samples + 1)]


class Engine(NamedTuple):
    """Program that runs legs: `run` is one, LAMMPS another.

    `pieces` yields the states that a leg asks for, each with a record, which is empty if none is asked for. Such a
    state may start another leg, even in another process. Closing the iterator ends the leg.
    """

    MADE_BY = "protocols.lammps_engine"
    pieces: Callable[[Leg], Iterator[tuple[State, Record]]]
    stops: bool = True  # whether a leg can be ended before its last step
    samples: int = 100  # of a record, in legs into which a long one may be divided
