"""Decisive bonds: those on which the softest or fastest-growing mode depends, and the first to break under a load."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigvals

from ..core.arguments import NotNegative, Numbers, checked, knows_bonds, require_shape
from ..core.contacts.bonding import bond_limits, bond_shares
from ..core.contacts.bonds import bond_rows, bond_vectors, judge_loads
from ..core.contacts.jacobian import bond_blocks
from ..core.laws.builtin import Law
from ..core.readable import readable
from ..core.state import FAILURES, Bonds, State
from .balance import LinearisedState, balanced
from .freedom import incidence, unsupported_grains
from .gradient import AT_MOST, deciding_vectors
from .linear import suitable_threads
from .moduli import VOIGT, ElasticModuli, elastic_moduli
from .sensitivity import assess

HALVINGS = 80  # number of bisections in the search for the amount of load that breaks a bond
NEVER = 1e100  # larger amounts occur only for bonds of unlimited strength, which never break


@readable(head=lambda found: _describe(found))
class FirstBreak(NamedTuple):
    """Amounts of a load at which K bonds reach their strengths, in the linear response of a packing.

    The displacement gradient is `amount` times `strain`, and the stress changes by `amount` times `stress`.
    """

    amount: np.ndarray  # (K,) amount at which each bond breaks; infinite if it never does or is already broken
    failure: np.ndarray  # (K,) index in `FAILURES` of the load that breaks each bond
    i: np.ndarray  # (K,) first grain of each bond
    j: np.ndarray  # (K,) second grain of each bond
    strain: np.ndarray  # (dim, dim) displacement gradient, extension positive [1]
    stress: np.ndarray  # (dim, dim) compression positive [force/length^(dim−1)]

    @property
    def bond(self) -> int:
        """Index of the first bond to break; −1 if none ever does."""
        return int(self.amount.argmin()) if np.isfinite(self.amount).any() else -1

    @property
    def at(self) -> float:
        """Amount at which the first bond breaks; infinite if none does."""
        return float(self.amount.min(initial=np.inf))

    @property
    def pair(self) -> tuple[int, int]:
        """Grains of the first bond to break; (−1, −1) if none does."""
        return (int(self.i[self.bond]), int(self.j[self.bond])) if self.bond >= 0 else (-1, -1)

    @property
    def mode(self) -> str:
        """Load that breaks the first bond: "tension", "shear", "bending", "twisting" or "compression"; or empty."""
        return FAILURES[self.failure[self.bond]] if self.bond >= 0 else ""


def _describe(found: FirstBreak) -> str:
    if found.bond < 0:
        return "no bond breaks under this load"
    return "the bond of grains {} and {} breaks first, at {:.5g}, by {}".format(*found.pair, found.at, found.mode)


@checked
@knows_bonds
def first_break(state: State, law: Law, *, strain: Numbers | None = None, stress: Numbers | None = None) -> FirstBreak:
    """First bond to break under a proportionally increasing strain or stress, in the linear response of the packing.

    Bond loads change linearly with the amount, according to the Jacobian with each contact held in its mode.
    Load over strength is a convex function of the amount, so a bond reaches its strength at most once. The amount is
    accurate if it is so small that few contacts open, close or slide before it is reached: it agreed with steps of
    `equilibrate` to 0.1 % at strains of 3e-4, and to 1 % at 3e-3 (30 disks, `tests/modes/test_bond_failure.py`). Fading
    bonds soften before they break, at amounts that are smaller by a quarter or more, and other bonds may break first.

    Parameters
    ----------
    state : State, accepted and in equilibrium, in a fully periodic cell, without walls or rigid groups
    strain : (dim, dim) displacement gradient for a unit amount, extension positive
    stress : (dim, dim), symmetric: change of the stress for a unit amount, compression positive, instead of `strain`
        [force/length^(dim−1)]

    Raises
    ------
    ValueError
        If there are no intact bonds, if the forces do not balance, if neither or both of `strain` and `stress` are
        given, or as in `elastic_moduli`.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, packing_fraction=0.66, seed=1)
    >>> cement = ss.laws.parallel_bond(3.0, 1.0, 0.002, 0.004)
    >>> cemented = ss.packings.bonded(state, cement, within=0.05)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> shear = [[0, 1, 0], [0, 0, 0], [0, 0, 0]]
    >>> ss.modes.first_break(cemented, law, strain=shear).mode
    'tension'
    """
    here, dim = _cemented(state, law), state.cell.dim
    if (strain is None) == (stress is None):
        raise ValueError("first_break needs either strain or stress: give the one that grows")
    moduli = elastic_moduli(here.state, law)
    wanted = np.asarray(strain if stress is None else stress, float)
    require_shape((dim, dim), **{"strain" if stress is None else "stress": wanted})
    return break_along(here, moduli, wanted if stress is None else strain_for(moduli, wanted))


def _cemented(state: State, law: Law) -> LinearisedState:
    if not state.bonds or not state.bonds.intact.any():
        raise ValueError("the packing has no intact bonds: create them with packings.bonded")
    return balanced(state, law)


def strain_for(moduli: ElasticModuli, stress: np.ndarray) -> np.ndarray:
    """(dim, dim) symmetric strain, extension positive, for a given change of the stress, compression positive."""
    if not np.allclose(stress, stress.T):
        raise ValueError("the stress must be symmetric, because torques must balance")
    pairs, stiffness = VOIGT[moduli.dim], moduli.voigt
    if not np.linalg.cond(stiffness) < 1e12:
        raise ValueError(
            "the stress does not determine the strain, because some strains cause no stress: give the strain instead"
        )
    solved = np.linalg.solve(stiffness, -np.array([stress[pair] for pair in pairs]))
    out = np.zeros((moduli.dim,) * 2)
    for (a, b), value in zip(pairs, solved, strict=True):
        out[a, b] = out[b, a] = value if a == b else value / 2
    return out


def break_along(here: LinearisedState, moduli: ElasticModuli, strain: np.ndarray) -> FirstBreak:
    """Amounts of a displacement gradient (dim, dim) at which bonds break; see `first_break`."""
    state, bonds, wide = here.state, here.state.bonds, np.zeros((3, 3))
    wide[: moduli.dim, : moduli.dim] = strain
    moved = moduli.free.spread(np.einsum("nab,ab->n", moduli.motion, strain))
    limits = bond_limits(state, bond_motions(state, moved, wide))
    loose = unsupported_grains(state, here.law)  # their bonds carry no load
    amount, failure = bond_crossings(bonds, limits.load, limits.slope, bonds.intact & ~loose[bonds.i] & ~loose[bonds.j])
    return FirstBreak(amount, failure, bonds.i, bonds.j, strain, -np.einsum("abcd,cd->ab", moduli.tensor, strain))


def bond_motions(state: State, moved: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(K, 9) changes of pair vectors and angles of bonds, for motions of the bodies (B, 6) and of the cell (3, 3)."""
    bonds, grains = state.bonds, state.grains
    turned = moved[: len(grains.radius), 3:] / grains.radius[:, None]
    apart = (
        bond_vectors(bonds, grains.position, state.cell.vectors) @ gradient.T + moved[bonds.i, :3] - moved[bonds.j, :3]
    )
    return np.hstack([apart, turned[bonds.i], turned[bonds.j]])


def bond_crossings(
    bonds: Bonds, load: np.ndarray, slope: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Amounts a (K,) at which bonds break under `load` + a · `slope`, and the kinds of load that break them.

    Load over strength, g, is convex, and g(a · slope) − g(−load) ≤ g(load + a · slope) bounds the amount.
    """
    begin, growth, against = (judge_loads(bonds, loads)[0] for loads in (load, slope, -load))
    breaks = held & (growth > 0)
    high = np.divide(1 + against, growth, out=np.full_like(growth, np.inf), where=breaks)
    breaks &= high < NEVER
    high[~breaks] = 0.0
    low = np.zeros_like(high)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        beyond = judge_loads(bonds, load + middle[:, None] * slope)[0] >= 1
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    high = np.where(begin >= 1, 0.0, high)
    failure = judge_loads(bonds, load + high[:, None] * slope)[1]
    return np.where(breaks | (held & (begin >= 1)), high, np.inf), np.where(held, failure, 0)


@readable(head=lambda found: f"λ = {found.eigenvalue:.4g}, {found.verdict}")
class DecisiveBonds(NamedTuple):
    """Bonds on which the decisive mode depends most, in descending order."""

    eigenvalue: complex  # λ that grows fastest or, if none grows, the softest [1/time²]
    verdict: str  # stable, oscillates, buckles, or oscillates and buckles
    bond: np.ndarray  # (K,) number of the bond
    i: np.ndarray  # (K,) first grain of the bond
    j: np.ndarray  # (K,) second grain of the bond
    derivative: np.ndarray  # (K,) ∂λ/∂ln s for a factor s on the stiffness of the bond, complex [1/time²]
    share: np.ndarray  # (K,) load of the bond over its strength
    verdict_after: np.ndarray  # (K,) verdict after the break, before forces find a new balance; empty if not computed
    growth_after: np.ndarray  # (K,) growth rate of the fastest mode after the break [1/time]; NaN if not computed


@checked
@knows_bonds
def decisive_bonds(state: State, law: Law, *, most: NotNegative = 3) -> DecisiveBonds:
    """Bonds on which the decisive mode depends: the fastest-growing mode or, if none grows, the softest.

    For a factor s on the stiffness of bond b, dλ = −wᴴ dJ_b v/(wᴴ M v). The spectrum after a break is computed for the
    first `most` bonds, as `contact_sensitivity` does for contacts. Dashpots are ignored.

    Raises
    ------
    ValueError
        If there are no intact bonds or more than 2500 coordinates, or if the forces do not balance.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.66, seed=1)
    >>> cemented = ss.packings.bonded(state, ss.laws.spring_bond(0.01), within=0.05)
    >>> found = ss.modes.decisive_bonds(cemented, ss.laws.hertz_mindlin(mu=0.5), most=0)
    >>> bool(found.eigenvalue.real > 0), len(found.bond) == len(cemented.bonds.i)
    (True, True)
    """
    here = _cemented(state, law)
    state, bonds, free = here.state, here.state.bonds, here.backbone
    if len(free) > AT_MOST:
        raise ValueError(f"modes are computed for at most {AT_MOST} coordinates, got {len(free)}")
    if not len(free):
        raise ValueError("the packing has only rattlers: decisive bonds need grains that support each other")
    value, left, right = deciding_vectors(here)
    count = len(here.line.closed)
    columns = incidence(state, count, free, 9).multiply(1 / np.sqrt(free.mass)[:, None]).tocsr()
    blocks = bond_blocks(state)
    sides = [(columns.T @ mode).reshape(count, 9) for mode in (left, right)]
    held = np.flatnonzero(bonds.intact)
    rows = bond_rows(bonds, state.contacts)[held]
    slope = np.einsum("ca,cab,cb->c", sides[0][rows], blocks[rows], sides[1][rows])
    order = np.argsort(-np.abs(slope), kind="stable")
    matrix = here.dynamical_matrix(free).toarray()
    after, growth = np.full(len(order), "", dtype="<U24"), np.full(len(order), np.nan)
    with suitable_threads(len(free)):
        verdict = assess(eigvals(matrix))[1]
        for k, row in enumerate(rows[order[: int(most)]]):
            q = columns[:, 9 * row : 9 * row + 9].toarray()
            growth[k], after[k] = assess(eigvals(matrix + q @ blocks[row] @ q.T, overwrite_a=True))
    bond = held[order]
    return DecisiveBonds(
        value, verdict, bond, bonds.i[bond], bonds.j[bond], slope[order], bond_shares(state)[bond], after, growth
    )
