"""Is this packing stable? The verdict on any accepted state, with the modes that decide it."""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import eig

from ..core.forces import forces, unbalanced
from ..core.laws import Law
from ..core.measure import mean_normal_force, touching
from ..core.state import State
from .fastest import fastest_pair
from .freedom import ZERO_BELOW, Freedom, backbone, freedom, loose_grains, stiffness, translations
from .pairs import complex_pairs
from .spectrum import SOFTEST, softest

PAIR_ABOVE = 1e-9  # of the largest |λ|
DENSE_UP_TO, PAIRS_UP_TO = 2_500, 12_000  # coordinates


class Stability(NamedTuple):
    """What the linearised motion around a state does; rattlers are left out."""

    n: int  # grains
    contacts: int  # that touch
    rattlers: np.ndarray  # their numbers, from 0
    residual: float  # largest unbalanced force or torque/R over the mean normal contact force
    pairs: np.ndarray  # (P,) complex λ with Im > 0, fastest growing first [1/time²]
    negative: np.ndarray  # (K,) real λ < 0 [1/time²]
    zero_modes: int
    rigid: int  # zero modes that are translations of everything
    modes: np.ndarray  # (n, P + K) of the pairs, then of the negative ones: generalised displacements
    free: Freedom
    method: str  # "dense", "pairs" or "fastest"
    scope: str  # what was not looked at, in words

    @property
    def stable(self) -> bool:
        """True if nothing was found that grows exponentially; floppy modes are counted, not judged."""
        return not len(self.pairs) and not len(self.negative)

    @property
    def growth_rate(self) -> np.ndarray:
        """(P,) ω_i of the pairs: displacements grow as exp(ω_i t) [1/time]."""
        return np.abs(np.sqrt(self.pairs).imag)

    @property
    def frequency(self) -> np.ndarray:
        """(P,) ω_r of the pairs [1/time]."""
        return np.abs(np.sqrt(self.pairs).real)

    @property
    def verdict(self) -> str:
        """In words: stable, oscillatory instability, buckling, floppy modes."""
        found = []
        if len(self.pairs):
            rate, frequency = self.growth_rate[0], self.frequency[0]
            period = f"period {2 * np.pi / frequency:.4g}" if frequency > 0 else "no period"
            found.append(
                f"oscillatory instability: {len(self.pairs)} complex pair(s), the fastest with {period} and e-folding "
                f"time {1 / rate:.4g}"
            )
        if len(self.negative):
            e_folding = 1 / np.sqrt(-self.negative.min())
            found.append(f"buckling: {len(self.negative)} negative λ, e-folding time {e_folding:.4g}")
        if self.zero_modes > self.rigid:
            found.append(f"floppy modes: {self.zero_modes - self.rigid} beside {self.rigid} translations")
        if self.stable:
            found.insert(0, "stable")
        return "; ".join(found)


def stability(state: State, law: Law, *, method: str = "auto", report=None) -> Stability:
    """The verdict on an accepted state: complex pairs, negative λ, floppy modes, rattlers.

    Parameters
    ----------
    method : "dense" (everything, up to 2500 coordinates within seconds, at most 10,000), "pairs" (all complex pairs, up
        to 12,000), "fastest" (the fastest pair that can be excited); "auto" takes the first that fits
    report : called as report(stage, share done, words)

    Raises
    ------
    ValueError
        if the state is too large for the method; names the one to take.

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Sec. II C and III A.
    """
    if method not in ("auto", "dense", "pairs", "fastest"):
        raise ValueError(f"method {method!r} was given: use auto, dense, pairs or fastest")
    loose = loose_grains(state, law)
    free = backbone(state, law)
    size = len(free)
    if not size:
        raise ValueError("nothing but rattlers was given: stability needs grains that hold each other")
    if method == "auto":
        method = "dense" if size <= DENSE_UP_TO else "pairs" if size <= PAIRS_UP_TO else "fastest"
    if method == "dense" and size > 10_000:
        raise ValueError(f"{size} coordinates are too many for the method 'dense' (10000): take 'pairs' or 'fastest'")
    if method == "pairs" and size > PAIRS_UP_TO:
        raise ValueError(f"{size} coordinates are too many for the method 'pairs' ({PAIRS_UP_TO}): take 'fastest'")
    matrix = stiffness(state, law, free)
    if method == "dense":
        pairs, negative, zero_modes, vectors = _dense(matrix)
        modes, scope = vectors / np.sqrt(free.mass)[:, None], ""
    else:
        pairs, modes, scope = _large(state, law, free, method, report)
        negative, zero_modes, soft = softest(matrix)
        modes = np.hstack([modes, soft / np.sqrt(free.mass)[:, None]])
        scope += f"; negative and zero λ were looked for among the {SOFTEST} smallest"
    contact_force = mean_normal_force(state, law)
    worst = float(np.abs(unbalanced(state, forces(state, law)[0])).max())
    rigid = int(state.control.free[: len(loose), : state.cell.dim].all()) * translations(matrix, free).shape[1]
    return Stability(
        len(loose), len(touching(state)), np.flatnonzero(loose), worst / contact_force if contact_force else np.inf,
        pairs, negative, zero_modes, rigid, modes, free, method, scope,
    )  # fmt: skip


def _dense(matrix):
    values, vectors = eig(matrix.toarray(), overwrite_a=True)
    scale = np.abs(values).max(initial=0.0)
    pair = np.flatnonzero(values.imag > PAIR_ABOVE * scale)
    pair = pair[np.argsort(-np.abs(np.sqrt(values[pair]).imag))]
    real = np.abs(values.imag) <= PAIR_ABOVE * scale
    zero = np.abs(values) < ZERO_BELOW * scale
    negative = np.flatnonzero(real & ~zero & (values.real < 0))
    negative = negative[np.argsort(values.real[negative])]
    return values[pair], values.real[negative], int(zero.sum()), vectors[:, [*pair, *negative]]


def _large(state: State, law: Law, free: Freedom, method: str, report):
    """Pairs, their modes in the coordinates `free`, and what was not looked at."""
    if method == "pairs":
        found = complex_pairs(state, law, report=report and partial(report, "complex pairs"))
        values, modes, scope = found.eigenvalues, found.modes, "all complex pairs that floating point can tell"
    else:
        one = fastest_pair(state, law, report=report)
        there = one.eigenvalue is not None and one.eigenvalue.imag != 0
        values = np.array([one.eigenvalue] if there else [], complex)
        modes = one.mode[:, None] if there else np.zeros((len(one.free), 0), complex)
        scope = str(one)
    place = np.searchsorted(freedom(state).component, free.component)
    return values, modes[place], scope
