"""Samples before loading."""

import numpy as np

from ..core.laws import Law, between, hertz_mindlin, linear
from ..core.state import State, assembly, box, disks, flat_walls, loads
from ..data.scenario import LawChoice, Scenario

SUBSTRATE = 1  # material of the wall; disks are material 0


def disk_array(
    n: int = 10,
    radius=0.5,
    *,
    press: float,
    push: float = 0.0,
    disk: int = 0,
    mass=1.0,
    i0: float = 0.5,
    gap: float = 0.0,
) -> State:
    """A row of disks on a substrate at y = 0, periodic along x, not yet in equilibrium.

    Parameters
    ----------
    n : int, number of disks
    radius : float or (n,) [length]
    press : float, force on every disk towards the substrate [force]
    push : float, force along x on disk number `disk`, counted from 0 [force]
    mass : float or (n,) [mass]; i0 : float, moment of inertia i0 m R²
    gap : float, distance between neighbours at the start, negative if they overlap [length]

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Fig 1.

    Examples
    --------
    >>> disk_array(3, press=5e-5).grains.position[:, 0]
    array([0.5, 1.5, 2.5])
    """
    radius = np.broadcast_to(np.asarray(radius, float), (n,))
    after = np.roll(radius, -1)
    spacing = np.sqrt((radius + after + gap) ** 2 - (radius - after) ** 2)  # centers of unlike disks differ in height
    centers = radius[0] + np.concatenate([[0.0], np.cumsum(spacing[:-1])])
    length = float(spacing.sum())
    grains = disks(np.stack([centers, radius], axis=1), radius, mass=mass, i0=i0)
    force = np.zeros((n, 3))
    force[:, 1] = -press
    force[disk, 0] += push
    wall = flat_walls([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], material=SUBSTRATE)
    cell = box([length, 1.0, 1.0], [True, False, False], dim=2)
    return assembly(grains, wall, cell, loads(n, 1, force=force))


def law_of(choice: LawChoice) -> Law:
    """The contact law that a scenario chose, with the disk–wall parameters where they differ."""
    make = {"hertz_mindlin": hertz_mindlin, "linear": linear}[choice.kind]
    law = make(
        choice.kn, choice.kt, choice.mu, coulomb=choice.coulomb, damping_n=choice.damping_n, damping_t=choice.damping_t
    )
    return between(law, 0, SUBSTRATE, **{k: v for k, v in choice.wall.model_dump().items() if v is not None})


def array_of(scenario: Scenario) -> tuple[State, Law]:
    """The unloaded array of a scenario, pressed but not pushed, and its law."""
    array, load = scenario.array, scenario.load
    state = disk_array(
        array.disks, array.radius, press=load.press * load.unit, mass=array.mass, i0=array.i0, gap=array.gap
    )
    return state, law_of(scenario.law)


def pushed(state: State, push: float, disk: int = 0) -> State:
    """The same state with another force along x on one disk [force]."""
    force = state.control.force.copy()
    force[disk, 0] = push
    return state._replace(control=state.control._replace(force=force))
