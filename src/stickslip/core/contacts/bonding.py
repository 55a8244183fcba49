"""Bonds of a state: creating them between chosen grains, comparing loads with strengths, and breaking them."""

from typing import Annotated

import numpy as np

from ..arguments import Array, NotNegative, checked, knows_bonds
from ..fields import IMAGE_BITS, pack_keys
from ..laws.bonds import UNBREAKABLE, Bond, coefficients
from ..state import Bonds, State, empty_contacts
from .bonds import BondLimits, add_bond_loads, bond_gap, bond_vectors, judge_loads, limits_of_bonds
from .forces import bodies
from .neighbors import TOO_FAR, TooFarApartError, body_positions, body_radii, grid_of, needs_rebuild, rebuild_list

AMBIGUOUS = 1e-9  # tolerance for distances of half a box, in box lengths


@checked
@knows_bonds
def bonded(
    state: State,
    bond: Bond,
    *,
    within: NotNegative = 0.0,
    pairs: Annotated[np.ndarray, Array((2,), "iu")] | None = None,
) -> State:
    """State with bonded grains; each bond is at rest at its present length and orientation.

    Bonds act in addition to the contact law, even across a gap. After a bond breaks, only the contact law acts.

    Parameters
    ----------
    bond : law of the bonds, from `laws.spring_bond`, `laws.beam_bond` or `laws.parallel_bond`
    within : two grains are bonded if their surfaces are at most this far apart; not more than half the smallest height
        of a periodic cell [length]
    pairs : (K, 2) numbers of the grains to bond instead, between their nearest periodic images

    Raises
    ------
    ValueError
        If a pair is already bonded, or contains a grain twice, a wall, or a grain that does not exist; if two of its
        images are equally near; if `within` is too large; or if both `within` and `pairs` are given.

    Examples
    --------
    >>> import stickslip as ss
    >>> state = ss.assembly(ss.spheres([[0, 0, 0], [1, 0, 0]], 0.5))
    >>> ss.packings.bonded(state, ss.laws.spring_bond(10.0)).bonds
    Bonds: 1 bond
    """
    if pairs is not None and within:
        raise ValueError("within and pairs exclude each other: give one of them")
    ends = _pairs_within(state, within) if pairs is None else _given_pairs(state, np.asarray(pairs))
    return with_bonds(state, _make(state, bond, *ends))


def bonded_at_rest(state: State, bond: Bond, pairs, length=None, direction=None, turn=None) -> State:
    """State with grains bonded as in `bonded`, with a given rest configuration.

    Parameters
    ----------
    pairs : (K, 2) numbers of the grains, the smaller one first
    length : (K,) rest lengths [length]; by default, and where zero, the present lengths
    direction, turn : (K, 3) and (K, 4) as in `Bonds`; by default, and where zero, unrotated
    """
    new = _make(state, bond, *_given_pairs(state, pairs), length)
    if turn is not None:
        given = turn.any(axis=1)[:, None]
        new = new._replace(direction=np.where(given, direction, new.direction), turn=np.where(given, turn, new.turn))
    return with_bonds(state, new)


def with_bonds(state: State, new: Bonds) -> State:
    """State with additional bonds, at most one for each pair, and a contact list that includes them."""
    bonds = _join(state.bonds, new)
    keys = pack_keys(bonds.i, bonds.j, bonds.image)
    if len(np.unique(keys)) < len(keys):
        raise ValueError("a pair of grains is already bonded: bond each pair only once")
    return _add_bond_rows(state._replace(bonds=bonds, instant=None))


@checked
@knows_bonds
def without_bonds(state: State) -> State:
    """State without its bonds, whether intact or broken."""
    return state._replace(bonds=None, instant=None)


def _add_bond_rows(state: State) -> State:
    """State with a row for each bond in its contact list, if the list is valid."""
    contacts, x, radius = state.contacts, body_positions(state), body_radii(state)
    gap = bond_gap(state.bonds, state.grains.position, radius, state.cell.vectors, contacts.skin)
    if gap <= contacts.gap or needs_rebuild(x, contacts):
        return state
    wider = rebuild_list(x, radius, state.walls.normal, grid_of(state.cell), contacts._replace(gap=gap))
    return state._replace(contacts=wider)


def _make(state: State, bond: Bond, i, j, image, rest=None) -> Bonds:
    radius, angle, k = state.grains.radius, state.grains.angle, len(i)
    nothing = np.zeros((k, 3))
    bonds = Bonds(
        i.astype(np.int32), j.astype(np.int32), image.astype(np.int16), np.ones(k, bool), np.ones(k), np.full(k, 0.5),
        nothing, np.tile([1.0, 0, 0, 0], (k, 1)), angle[i].copy(), angle[j].copy(), np.zeros((k, 4)), np.zeros((k, 4)),
        np.ones((k, 4)), np.full(k, bond.form, np.int8), np.full(k, bond.fading, np.int8), np.zeros(k, np.int8),
    )  # fmt: skip
    way = bond_vectors(bonds, state.grains.position, state.cell.vectors)
    length = np.linalg.norm(way, axis=1)
    if k and not length.min() > 0:
        a = length.argmin()
        raise ValueError(f"grains {i[a]} and {j[a]} have the same position: a bond needs a length")
    rest = length if rest is None else np.where(rest > 0, rest, length)
    stiffness, damping, strength, arm = coefficients(bond, state.cell.dim, radius[i], radius[j], rest)
    return bonds._replace(
        length=rest, direction=way / length[:, None], arm=arm, stiffness=stiffness, damping=damping, strength=strength
    )


def _join(old: Bonds | None, new: Bonds) -> Bonds:
    if old is None:
        return new
    return Bonds(*(np.concatenate([a, b]) for a, b in zip(old, new, strict=True)))


def _pairs_within(state: State, within: float):
    """Pairs of grains whose surfaces are at most `within` apart."""
    grid = grid_of(state.cell)
    most = 0.5 * grid.height[state.cell.periodic].min(initial=np.inf)
    if within > most:
        raise ValueError(
            f"within must be at most half the smallest height of the periodic cell, {most:.4g}, got {within:g}"
        )
    contacts = empty_contacts(state.n_bodies, 0, state.contacts.skin)._replace(gap=within)
    x = body_positions(state)
    near = rebuild_list(x, body_radii(state), state.walls.normal, grid, contacts)
    count = int(near.count[0])
    if count < 0:
        raise TooFarApartError(TOO_FAR)
    i, j, image = near.i[:count], near.j[:count], near.image[:count]
    radius = state.grains.radius
    free = np.flatnonzero(j < len(radius))
    i, j, image = i[free], j[free], image[free]
    gap = np.linalg.norm(x[i] - x[j] + image @ state.cell.vectors, axis=1) - radius[i] - radius[j]
    kept = (gap <= within + 1e-12 * (radius[i] + radius[j])) & (i != j)
    return i[kept], j[kept], image[kept]


def _given_pairs(state: State, pairs: np.ndarray):
    """Pairs with i < j, and their nearest images."""
    n, cell = len(state.grains.radius), state.cell
    if pairs.shape[1:] != (2,):
        raise ValueError(f"pairs must have shape (K, 2), two grain numbers per row, got {pairs.shape}")
    for a, b in pairs:
        if a == b:
            raise ValueError(f"grain {a} cannot be bonded to itself: give two grains")
        if not (min(a, b) >= 0 and max(a, b) < n):
            raise ValueError(
                f"a bond joins two grains, numbered 0 to {n - 1}, got {a} and {b}; to bond a grain to a wall, bond it "
                "to a fixed grain instead"
            )
    i, j = np.sort(pairs, axis=1).T
    apart = (state.grains.position[i] - state.grains.position[j]) @ grid_of(cell).inverse
    image = np.where(cell.periodic, -np.round(apart), 0.0)
    if abs(image).max(initial=0.0) >= 1 << IMAGE_BITS - 1:
        raise TooFarApartError(TOO_FAR)
    tie = np.where(cell.periodic, abs(abs(apart + image) - 0.5) < AMBIGUOUS, False).any(axis=1)
    if tie.any():
        a = tie.argmax()
        raise ValueError(f"grains {i[a]} and {j[a]} are half a periodic box apart, so two images of the bond are "
                         "equally long: use a larger box")  # fmt: skip
    return i, j, image.astype(np.int16)


@checked
@knows_bonds
def bond_shares(state: State) -> np.ndarray:
    """Ratio of load to strength of each bond, (K,): the bond breaks at 1. Zero for broken and unbreakable bonds."""
    if state.bonds is None:
        return np.zeros(0)
    nothing = np.zeros((state.n_bodies, 3))
    return add_bond_loads(state.bonds, state.cell.dim, bodies(state), state.cell.vectors, nothing, nothing.copy())


def broken_since(state: State, before: State) -> np.ndarray:
    """(B, 3) bonds that broke since an earlier state: i, j, and the index in `FAILURES` of the load that broke them."""
    if not state.bonds:
        return np.zeros((0, 3), int)
    lost, bonds = before.bonds.intact & ~state.bonds.intact, state.bonds
    return np.stack([bonds.i, bonds.j, bonds.failed], axis=1).astype(int)[lost]


def bond_limits(state: State, way: np.ndarray | None = None) -> BondLimits:
    """Ratios of load to strength of the bonds of a state; see `limits_of_bonds`."""
    return limits_of_bonds(state.bonds, state.cell.dim, bodies(state), state.cell.vectors, way)


def without_failure(state: State) -> State:
    """State whose bonds do not break in a run, except those with fading loads; `with_strength_of` undoes this."""
    if not state.bonds:
        return state
    strength = np.where(state.bonds.fading[:, None] > 0, state.bonds.strength, UNBREAKABLE)
    return state._replace(bonds=state.bonds._replace(strength=strength), instant=None)


def with_strength_of(state: State, before: State, *, mended: bool = False) -> State:
    """State whose bonds have the strength of `before`; if `mended`, those that were intact then are intact again."""
    if not state.bonds:
        return state
    kept = before.bonds if mended else state.bonds
    bonds = state.bonds._replace(strength=before.bonds.strength, intact=kept.intact, failed=kept.failed)
    return state._replace(bonds=bonds, instant=None)


def with_weakest_broken(state: State) -> State:
    """State in which the bond with the largest ratio of load to strength is broken, if this ratio is at least 1."""
    share = bond_shares(state) if state.bonds else np.zeros(0)
    if not share.max(initial=0.0) >= 1.0:
        return state
    intact, failed, weakest = state.bonds.intact.copy(), state.bonds.failed.copy(), share.argmax()
    intact[weakest] = False
    failed[weakest] = judge_loads(state.bonds, bond_limits(state).load)[1][weakest]
    return state._replace(bonds=state.bonds._replace(intact=intact, failed=failed), instant=None)
