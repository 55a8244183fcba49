"""Cement between the grains of a sample: bonds, the unloading of the sample, and a catalogue of broken bonds.

Source
------
Potyondy & Cundall, doi:10.1016/j.ijrmms.2004.09.011.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from .... import Law, State
from ....control import loads
from ....kit import Scales, readable, settle
from ....laws import parallel_bond
from ....measure import bond_shares
from ....packings import bonded
from ....results import Factorisation
from .sample import Drive, controlled
from .scenario import Cement

STEPS = 5  # number of pressure steps from the sample to the test
CUT = 3.0  # standard deviations at which the distribution of strengths is cut off
ALONE = 1e300  # strength that no load reaches, for components that are ignored


@readable
class Breaks(NamedTuple):
    """Broken bonds in the order of breaking."""

    row: np.ndarray  # (K,) int, row of the series in whose step the bond broke; 0: before the test
    i: np.ndarray  # (K,) int, number of a grain
    j: np.ndarray  # (K,) int
    tension: np.ndarray  # (K,) bool: the tensile strength was reached, otherwise the shear strength
    energy: np.ndarray  # (K,) elastic energy of the bond at the break [energy]
    position: np.ndarray  # (K, 3) midpoint of the bond in the first periodic cell [length]


class Break(NamedTuple):
    """Broken bond; fields as in `Breaks`."""

    row: int
    i: int
    j: int
    tension: bool
    energy: float
    position: np.ndarray


class Cemented(NamedTuple):
    """Cemented sample under the pressure of its test."""

    state: State
    breaks: Breaks  # bonds that broke on the way to that pressure


def collect(breaks: list[Break]) -> Breaks:
    """Return a catalogue of breaks."""
    kinds = int, int, int, bool, float, float
    columns = zip(*breaks, strict=True) if breaks else ([] for _ in kinds)
    row, i, j, tension, energy, position = (np.array(c, kind) for c, kind in zip(columns, kinds, strict=True))
    return Breaks(row, i, j, tension, energy, position.reshape(-1, 3))


def join(parts: list[Breaks]) -> Breaks:
    """Join several catalogues."""
    return Breaks(*map(np.concatenate, zip(*parts, strict=True)))


def with_cement(state: State, cement: Cement, contact_modulus: float, seed: int) -> State:
    """State whose grains are bonded; stiffness per area E/(R_i + R_j) along the bond, with E of the cement.

    Parameters
    ----------
    contact_modulus : over which `cement.modulus` is given [force/length^(dim−1)]
    seed : of the scatter of the strengths
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
            stiffness=modulus[:, None] * bonds.stiffness, strength=np.minimum(factor * bonds.strength, ALONE)
        )
    )


def unloaded(
    state: State, law: Law, pressures: tuple[float, float], mass: float, scales: Scales, tolerance: float
) -> Cemented:
    """Cemented sample after small steps of the isotropic pressure from the first to the second one.

    Parameters
    ----------
    mass : of the cell, see `servo_mass`
    tolerance : largest unbalanced force [force]
    """
    every, broken = Drive(np.zeros((3, 3)), tuple(range(state.cell.dim))), []
    for pressure in np.linspace(*pressures, STEPS + 1)[1:]:
        state, _ = settle(
            controlled(state, every, np.full(3, pressure), mass), law, scales, tolerance=tolerance,
            keep=Factorisation(), broke=lambda before, after: broken.append(describe_break(before, after)),
        )  # fmt: skip
    return Cemented(state._replace(control=loads(len(state.grains.radius))), collect(broken))


def bond_loads(state: State) -> np.ndarray:
    """Tension (negative in compression), shear force, bending and twisting moment of parallel bonds, (K, 4)."""
    bonds, position = state.bonds, state.grains.position
    out = np.zeros(bonds.strength.shape)
    for part in range(4):  # at unit strength, the fraction of the strength is the load
        strength = np.full_like(bonds.strength, ALONE)
        strength[:, part] = 1.0
        out[:, part] = bond_shares(state._replace(bonds=bonds._replace(strength=strength)))
    way = position[bonds.i] - position[bonds.j] + bonds.image @ state.cell.vectors
    stretch = np.linalg.norm(way, axis=1) - bonds.length
    out[:, 0] = np.where(bonds.intact, bonds.stiffness[:, 0] * stretch, 0.0)
    return out


def describe_break(before: State, after: State, row: int = 0) -> Break:
    """Return the one bond that is intact in the equilibrium `before` and broken in `after`."""
    bonds, vectors = before.bonds, before.cell.vectors
    (k,) = np.flatnonzero(bonds.intact & ~after.bonds.intact)
    i, j, load, stiffness = bonds.i[k], bonds.j[k], bond_loads(before)[k], bonds.stiffness[k]
    share = load / bonds.strength[k]
    energy = 0.5 * np.divide(load**2, stiffness, out=np.zeros(4), where=stiffness > 0).sum()
    place, size = before.grains.position, np.where(before.cell.periodic, np.diag(vectors), np.inf)
    middle = np.mod(0.5 * (place[i] + place[j] + bonds.image[k] @ vectors), size)
    return Break(row, int(i), int(j), bool(share[0] + share[2] >= share[1] + share[3]), float(energy), middle)
