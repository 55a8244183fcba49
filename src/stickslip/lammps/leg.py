"""What LAMMPS runs: a state under constant conditions, for a number of steps."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..core.laws.builtin import Law
from ..core.state import State


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
    """Part of a run: everything that LAMMPS is told."""

    state: State
    law: Law
    dt: float  # [time]
    steps: int
    samples: int  # number of states written, evenly spaced, the last one at the end
    drag: float = 0.0  # [1/time]
    walls: tuple[int, ...] | None = None  # number of each wall in its fix, if earlier legs had more walls
    waves: Mapping[int, Wave] = MappingProxyType({})  # courses, by column, that are waves
    ranks: int = 1
    more: str = ""  # commands before `run`
    number: int = 0  # in a sequence of legs
    skin_diameters: float = 0.1  # skin of neighbour lists in mean diameters

    @property
    def skin(self) -> float:
        """Skin of neighbour lists [length]."""
        return self.skin_diameters * 2 * float(self.state.grains.radius.mean())

    @property
    def wall_numbers(self) -> tuple[int, ...]:
        """Number of each wall of the state in the names of fixes."""
        return tuple(range(len(self.state.walls.mass))) if self.walls is None else self.walls

    @property
    def warm_up(self) -> int:
        """Number of steps of duration zero before the first one."""
        return 2 if self.state.control.cell_rate.any() or self.state.control.cell_free.any() else 0

    @property
    def sample_steps(self) -> list[int]:
        """Steps at which a state is written."""
        return [int(k * self.steps / self.samples + 0.5) for k in range(1, self.samples + 1)]


LOOSE = 1  # atom type of grains that belong to no rigid group; group g has type g + 2


def digits(*numbers: float) -> str:
    """Numbers with seventeen digits, from which they are read back exactly."""
    return " ".join(f"{number:.17g}" for number in numbers)


def atom_types(state: State) -> np.ndarray:
    """Atom type of each grain, (N,)."""
    group = state.control.group[: len(state.grains.radius)]
    return np.where(group < 0, LOOSE, group + 2)


def members_of(state: State) -> dict[int, np.ndarray]:
    """Indices of the grains of each rigid group, by its number."""
    group = state.control.group[: len(state.grains.radius)]
    return {int(g): np.flatnonzero(group == g) for g in np.unique(group[group >= 0])}


def is_held(state: State, members: np.ndarray) -> bool:
    """Return True if no component of a rigid group is free."""
    return not state.control.free[members[0], : state.cell.dim].any()


def inertia_factor(state: State) -> float:
    """I0 of the grains that turn, NaN if they differ."""
    grains, loose = state.grains, state.control.group[: len(state.grains.radius)] < 0
    i0 = (grains.inertia / (grains.mass * grains.radius**2))[loose]
    if not len(i0):
        return 0.4
    return float(i0[0]) if np.allclose(i0, i0[0], rtol=1e-9) else np.nan
