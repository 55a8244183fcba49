"""Cement between the grains of a sample: bonds, unloading of the sample, and a catalogue of broken bonds.

Source
------
Potyondy & Cundall, doi:10.1016/j.ijrmms.2004.09.011.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from .... import Law, State
from ....control import loads
from ....kit import FAILURES, UNBREAKABLE, Scales, bond_limits, readable, settle
from ....laws import parallel_bond
from ....packings import bonded
from ....results import Factorisation
from .sample import Drive, controlled
from .scenario import Cement

STEPS = 5  # number of pressure steps from the sample to the test
CUT = 3.0  # standard deviations at which the distribution of strengths is cut off


@readable
class Breaks(NamedTuple):
    """Broken bonds in the order of breakage."""

    row: np.ndarray  # (K,) int, row of the series in whose step the bond broke; 0: before the test
    i: np.ndarray  # (K,) int, indices of the two grains
    j: np.ndarray  # (K,) int
    tension: np.ndarray  # (K,) bool, True if the tensile strength was reached, False for the shear strength
    energy: np.ndarray  # (K,) elastic energy of the bond when it broke [energy]
    position: np.ndarray  # (K, 3) midpoint of the bond in the first periodic cell [length]


class Cemented(NamedTuple):
    """Cemented sample under the pressure of its test."""

    state: State
    breaks: Breaks  # bonds that broke on the way to that pressure


NO_BREAKS = Breaks(*np.zeros((3, 0), int), np.zeros(0, bool), np.zeros(0), np.zeros((0, 3)))


def join(parts: list[Breaks]) -> Breaks:
    """Join several catalogues."""
    return Breaks(*map(np.concatenate, zip(NO_BREAKS, *parts, strict=True)))


def with_cement(state: State, cement: Cement, contact_modulus: float, seed: int) -> State:
    """State with bonded grains; the stiffness per area along a bond is E/(R_i + R_j), with E of the cement.

    Parameters
    ----------
    contact_modulus : modulus relative to which `cement.modulus` is stated [force/length^(dim−1)]
    seed : seed of the scatter of the strengths
    """
    radius = state.grains.radius
    bond = parallel_bond(
        1.0, 1 / cement.stiffness_ratio, cement.tensile_strength, cement.shear_strength, radius=cement.radius
    )
    state = bonded(state, bond, within=2 * cement.gap * radius.mean())
    bonds = state.bonds
    modulus = cement.modulus * contact_modulus / (radius[bonds.i] + radius[bonds.j])
    share = np.random.default_rng(seed).uniform(ndtr(-CUT), ndtr(CUT), (len(bonds.i), 2))
    factor = 1 + cement.scatter * ndtri(share)[:, [0, 1, 0, 1]]  # for tension and bending, and for shear and twisting
    return state._replace(
        bonds=bonds._replace(
            stiffness=modulus[:, None] * bonds.stiffness, strength=np.minimum(factor * bonds.strength, UNBREAKABLE)
        )
    )


def unloaded(
    state: State, law: Law, pressures: tuple[float, float], mass: float, scales: Scales, tolerance: float
) -> Cemented:
    """Cemented sample after small steps of isotropic pressure from the first to the second value.

    Parameters
    ----------
    mass : mass of the cell, see `servo_mass`
    tolerance : largest unbalanced force [force]
    """
    every, broken = Drive(np.zeros((3, 3)), tuple(range(state.cell.dim))), []
    for pressure in np.linspace(*pressures, STEPS + 1)[1:]:
        state, _ = settle(
            controlled(state, every, np.full(3, pressure), mass), law, scales, tolerance=tolerance,
            keep=Factorisation(), broke=lambda before, after: broken.append(describe_break(before, after)),
        )  # fmt: skip
    return Cemented(state._replace(control=loads(len(state.grains.radius))), join(broken))


def describe_break(before: State, after: State, row: int = 0) -> Breaks:
    """Return the single bond that is intact in the equilibrium `before` and broken in `after`."""
    bonds, vectors = before.bonds, before.cell.vectors
    k = np.flatnonzero(bonds.intact & ~after.bonds.intact)
    i, j, position = bonds.i[k], bonds.j[k], before.grains.position
    middle = 0.5 * (position[i] + position[j] + bonds.image[k] @ vectors)
    tension = np.isin(after.bonds.failed[k], [FAILURES.index(load) for load in ("tension", "bending")])
    middle = np.mod(middle, np.where(before.cell.periodic, np.diag(vectors), np.inf))
    return Breaks(np.full(1, row), i, j, tension, bond_limits(before).energy[k], middle)


def has_failed(stress: np.ndarray, cement: Cement, dim: int) -> bool:
    """Return True if the axial stress (T, 3, 3), less the confining stress, has fallen to `until` of its maximum."""
    lead = np.abs(stress[:, dim - 1, dim - 1] - cement.confining)
    return bool(len(lead) and lead[-1] < cement.until * lead.max())
