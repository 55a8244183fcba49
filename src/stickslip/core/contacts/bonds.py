"""Loads of bonds, their linearisation, and their failure.

A bond joins two grains i and j like a beam. n is the unit vector from j to i; γ is the rotation vector from the rest
direction, which rotates with j, to n. The rotation of i relative to j is exp(β) exp(ψ n): twist, then bending. The
shear force acts at a fraction α of r from j (`arm`), where i is displaced by u × n relative to j, u = |r| (γ − (1 − α)
β). The loads on j are

    F = k_n (|r| − r₀) n + k_s u × n,    M = k_b β + k_ψ ψ n + α r × (k_s u × n);

those on i are −F and −k_b β − k_ψ ψ n + (1 − α) r × (k_s u × n). With α = 1/2, they are the loads of `bpm/rotational`
in LAMMPS. Dashpots oppose the rates of the same deformations. The loads follow from the present configuration, so bonds
need no trial memory; committing them only updates their reference to the present rotations.

Source
------
Wang & Mora, doi:10.1007/978-3-540-85879-9_6.
"""

from typing import NamedTuple

import numpy as np

from ..fields import pack_keys
from ..library import core
from ..state import Bonds, Contacts, State


def add_bond_loads(bonds: Bonds, dim: int, here, vectors, force, torque, virial=None) -> np.ndarray:
    """Add the loads of all bonds in place; return the ratio of load to strength of each bond, (K,).

    Parameters
    ----------
    here : `Bodies`
    vectors : (3, 3) cell vectors [length]
    force, torque : (B, 3)
    virial : (3, 3) Σ f ⊗ r of the elastic forces, or None
    """
    share = np.zeros(len(bonds.i))
    core.evaluate_bonds(dim, here, bonds, vectors, False, share, force, torque, virial)
    return share


def follow_rotations(bonds: Bonds, dim: int, here, vectors) -> Bonds:
    """Bonds with their reference updated to the present rotations of the grains."""
    moved = {name: getattr(bonds, name).copy() for name in ("direction", "turn", "angle_i", "angle_j")}
    out, nothing = bonds._replace(**moved), np.zeros_like(here.position)
    core.evaluate_bonds(dim, here, out, vectors, True, None, nothing, nothing.copy(), None)
    return out


class BondLimits(NamedTuple):
    """Load/strength of K bonds, as if all were intact: tension, then the vectors of shear, bending and twist."""

    load: np.ndarray  # (K, 10)
    slope: np.ndarray  # (K, 10) derivatives along a motion
    energy: np.ndarray  # (K,) [energy]


def limits_of_bonds(bonds: Bonds, dim: int, here, vectors, way: np.ndarray | None = None) -> BondLimits:
    """Ratios of load to strength of bonds, and their energies.

    Parameters
    ----------
    way : (K, 9) changes of the pair vector [length] and of the angles of i and of j [rad]; zero by default
    """
    k = len(bonds.i)
    out, way = BondLimits(*np.zeros((2, k, 10)), np.zeros(k)), np.zeros((k, 9)) if way is None else way
    core.limit_bonds(dim, here, bonds, vectors, np.ascontiguousarray(way), *out)
    return out


def judge_loads(bonds: Bonds, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Loads as fractions of the strengths (see `BondLimits`), and the load that breaks each bond (index in `FAILURES`).

    Both are (K,). The load that breaks a bond is the largest of those that together reach its strength.
    """
    share, failure = np.zeros(len(load)), np.zeros(len(load), np.int8)
    core.judge_loads(bonds, np.ascontiguousarray(load), share, failure)
    return share, failure


def bond_vectors(bonds: Bonds, position: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors from j to i, (K, 3) [length]."""
    return position[bonds.i] - position[bonds.j] + bonds.image @ vectors


def bond_gap(bonds: Bonds, position: np.ndarray, radius: np.ndarray, vectors: np.ndarray, skin: float) -> float:
    """Gap that a contact list must cover to include all intact bonds, rounded up to a multiple of its skin [length]."""
    held = bonds._replace(i=bonds.i[bonds.intact], j=bonds.j[bonds.intact], image=bonds.image[bonds.intact])
    gap = np.linalg.norm(bond_vectors(held, position, vectors), axis=1) - radius[held.i] - radius[held.j]
    return float(np.ceil(max(gap.max(initial=0.0), 0.0) / skin) * skin)


def bond_rows(bonds: Bonds, contacts: Contacts) -> np.ndarray:
    """Row of each bond in the contact list, (K,); −1 for broken ones."""
    count = int(contacts.count[0])
    rows = np.searchsorted(contacts.key[:count], pack_keys(bonds.i, bonds.j, bonds.image))
    return np.where(bonds.intact, rows, -1)


def is_beam(bonds: Bonds, dim: int) -> np.ndarray:
    """Mask of intact bonds that resist all relative motions, so that a single one holds a grain, (K,)."""
    return bonds.intact & (bonds.stiffness[:, 1 : dim + 1] > 0).all(axis=1)


def bond_forces(bonds: Bonds, dim: int, here, vectors, contacts: Contacts) -> np.ndarray:
    """Elastic force that the bond of each contact exerts on body i, (C, 3) [force]."""
    force, out, rows = np.zeros((len(bonds.i), 3)), np.zeros((int(contacts.count[0]), 3)), bond_rows(bonds, contacts)
    core.linearise_bonds(dim, here, bonds, vectors, force, None, None)
    np.add.at(out, rows[bonds.intact], force[bonds.intact])
    return out


def with_bonds(bonds: Bonds, dim: int, here, vectors, contacts: Contacts, *blocks: np.ndarray):
    """Contact blocks of springs and dashpots, including those of bonds, (C, 9, 9) as in `contact_blocks`."""
    k = len(bonds.i)
    a, b = here.radius[bonds.i], here.radius[bonds.j]
    turn = np.array([[np.ones(k), b], [np.ones(k), -a]]) / (a + b)  # a_i and a_j from ρ and a_i − a_j
    maps = np.zeros((k, 9, 9))
    maps[:, :3, :3] = np.eye(3)
    maps[:, 3:, 3:] = np.einsum("rck,xy->krxcy", turn, np.eye(3)).reshape(k, 6, 6)
    rows, held = bond_rows(bonds, contacts), bonds.intact
    own = np.zeros((2, k, 9, 9))  # derivatives with respect to pair vector and angles, and to their rates
    core.linearise_bonds(dim, here, bonds, vectors, np.zeros((k, 3)), *own)
    for whole, more in zip(blocks, own, strict=True):
        wide = np.zeros((len(whole), 9, 9))
        wide[:, : whole.shape[1], : whole.shape[2]] = whole
        np.add.at(wide, rows[held], (maps.transpose(0, 2, 1) @ more @ maps)[held])
        yield wide


def has_damped_bonds(state: State) -> bool:
    """Return True if an intact bond has a dashpot."""
    return state.bonds is not None and bool(state.bonds.damping[state.bonds.intact].any())


def frequency_bound_of_bonds(bonds: Bonds, here, vectors: np.ndarray, inverse_inertia: np.ndarray) -> float:
    """Upper bound on the ω² due to bonds, from the sum of the stiffnesses at each body."""
    held = np.flatnonzero(bonds.intact)
    tension, shear, bending, twisting = bonds.stiffness[held].T
    total = np.zeros((2, len(inverse_inertia)))
    lengths = np.maximum(bonds.length, np.linalg.norm(bond_vectors(bonds, here.position, vectors), axis=1))[held]
    for ends, arm in ((bonds.i[held], 1 - bonds.arm[held]), (bonds.j[held], bonds.arm[held])):
        np.add.at(total[0], ends, 2 * np.maximum(tension, 2 * shear))
        np.add.at(total[1], ends, 4 * shear * (arm * lengths) ** 2 + 2 * np.maximum(bending, twisting))
    return float(max((total[0] * here.inverse_mass).max(initial=0.0), (total[1] * inverse_inertia).max(initial=0.0)))
