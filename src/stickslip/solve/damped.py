"""Stability of a packing with dashpots, from the first-order form of M q̈ = J q + C q̇."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eig
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, splu

from ..core.arguments import checked
from ..core.contacts.jacobian import contact_blocks
from ..core.laws.builtin import Law
from ..core.readable import pluralize, readable
from ..core.state import State
from .balance import no_equilibrium_message, with_modes_under
from .freedom import ZERO_BELOW, Freedom, assembled, dynamical_matrix
from .linear import suitable_threads
from .stability import (
    MIXED,
    PAIR_ABOVE,
    Stability,
    combine_motions,
    combine_stability,
    contacts_at_limit,
    stability,
    unloading_scope,
    with_sticking,
)

DENSE_UP_TO = 1_250  # coordinates, solved within seconds; the first-order form has twice as many
DENSE_AT_MOST = 4_000  # coordinates, solved within minutes
NEAR = 4  # exponents computed near each one of the undamped motion
NEAR_ZERO = 18  # exponents computed near zero, where translations take six
TOLERANCE = 1e-10  # relative, of the inverse distance from the shift
STARTS = 8  # undamped pairs near which exponents are sought, the fastest first


@readable
class DampedStability(NamedTuple):
    """Stability of the linearised motion around a state with dashpots: exponents s of exp(st)."""

    undamped: Stability  # without dashpots; also holds the numbers of grains, contacts, rattlers and zero modes
    exponents: np.ndarray  # (K,) Re s > 0, Im s ≥ 0, one of each conjugate pair, fastest growing first [1/time]
    modes: np.ndarray  # (n, K) complex: generalised displacements of unit mass-weighted norm
    slowest: complex | None  # exponent of the slowest decay; None if not all were computed
    scope: str  # limits of the analysis, in words
    if_stuck: "DampedStability | None" = None  # the same with contacts at the Coulomb limit sticking, see `Stability`

    @property
    def free(self) -> Freedom:
        """Coordinates of the modes, without rattlers."""
        return self.undamped.free

    @property
    def residual(self) -> float:
        """Largest unbalanced force or torque/R over the mean normal contact force."""
        return self.undamped.residual

    @property
    def causes(self) -> tuple[str, ...]:
        """Possible reasons why the forces do not balance; empty if they do."""
        return self.undamped.causes

    @property
    def balanced(self) -> bool:
        """True if neither residual nor motion exceeds `BALANCED_BELOW`."""
        return self.undamped.balanced

    @property
    def grows(self) -> bool:
        """True if any mode grows exponentially in the linearised motion around this state, at rest or not."""
        return bool(len(self.exponents))

    @property
    def stable(self) -> bool | None:
        """True if no exponentially growing mode was found; None under the conditions of `Stability.stable`."""
        return combine_stability(self.grows, self.if_stuck) if self.balanced else None

    @property
    def growth_rate(self) -> np.ndarray:
        """(K,) Re s: displacements grow as exp(Re s t) [1/time]."""
        return self.exponents.real

    @property
    def frequency(self) -> np.ndarray:
        """(K,) Im s [1/time]."""
        return self.exponents.imag

    @property
    def verdict(self) -> str:
        """Verdict in words, with dashpots included, or a statement that the state is not in equilibrium."""
        if not self.balanced:
            return no_equilibrium_message(self.residual, self.undamped.swing)
        return combine_motions(self.undamped.at_limit, self, self.if_stuck)

    @property
    def motion(self) -> str:
        """Spectrum in words: the verdict if the forces balance, otherwise the initial motion."""
        found, swings = [], self.exponents.imag > 0
        if swings.any():
            s, count = self.exponents[swings][0], int(swings.sum())
            several = ", the fastest" if count > 1 else ""
            found.append(
                f"oscillatory instability: {pluralize(count, 'growing pair')} of exponents{several} with period "
                f"{2 * np.pi / s.imag:.4g} and e-folding time {1 / s.real:.4g}"
            )
        if not swings.all():
            e_folding = 1 / self.exponents[~swings].real.max()
            found.append(
                f"buckling: {pluralize(int((~swings).sum()), 'growing exponent')}, e-folding time {e_folding:.4g}"
            )
        if self.undamped.zero_modes > self.undamped.rigid:
            floppy = self.undamped.zero_modes - self.undamped.rigid
            found.append(f"floppy modes: {floppy} in addition to {self.undamped.rigid} translations")
        if not self.grows:
            found.insert(0, "stable" if self.balanced else "nothing grows")
        return "; ".join(found)


@checked
def damped_stability(
    state: State, law: Law, *, method: str = "auto", report: Callable | None = None
) -> DampedStability:
    """Analyse the stability of a state whose law has dashpots, from the exponents s of M q̈ = J q + C q̇.

    Parameters
    ----------
    state : State, accepted and at rest
    method : "dense" (all exponents, up to 4000 coordinates), "pairs", "all" or "fastest" (exponents near those of the
        undamped motion, which `stability` finds with this method; growth caused by dashpots alone is not sought);
        "auto" takes the first that is feasible
    report : called as report(stage, share done, words)

    Raises
    ------
    ValueError
        if the state is too large for the method; the message names one that can be used.

    Source
    ------
    Tisseur & Meerbergen, doi:10.1137/S0036144500381988, Sec. 3.4, for the first-order form of the quadratic
    eigenvalue problem.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp", damping_n=0.1, damping_t=0.1)
    >>> flat = ss.packings.from_arrays([[0, 0], [0.99, 0], [0.5, 0.85]], [0.5, 0.5, 0.5], law, dim=2)
    >>> damped_stability(flat, law).undamped.contacts
    3
    """
    size = _max_coordinates(state)
    if method == "certify":
        raise ValueError("method 'certify' was given for a law with dashpots: use 'all', or a law without dashpots")
    if method == "dense" and size > DENSE_AT_MOST:
        raise ValueError(
            f"{size} coordinates were given: the method 'dense' with dashpots takes at most {DENSE_AT_MOST}; use "
            f"'pairs' or 'fastest'"
        )
    state = with_modes_under(state, law)
    undamped = stability(state, law, method=method, report=report)
    found = _analyse(state, law, undamped, method, report)
    if undamped.if_stuck is None:
        return found
    stuck = with_sticking(state, contacts_at_limit(state, law))
    scope = found.scope if MIXED in found.scope else f"{found.scope}; {MIXED}" if found.scope else MIXED
    return found._replace(if_stuck=_analyse(stuck, law, undamped.if_stuck, method, report), scope=scope)


def _analyse(state: State, law: Law, undamped: Stability, method: str, report) -> DampedStability:
    """Stability with every contact held in its mode."""
    free, size = undamped.free, _max_coordinates(state)
    pull, root = dynamical_matrix(state, law, free), 1 / np.sqrt(free.mass)
    _, blocks = contact_blocks(state, law)
    drag = sparse.csr_array(sparse.diags_array(-root) @ assembled(state, blocks, free) @ sparse.diags_array(root))
    unit = np.sqrt(np.abs(pull.data).max())  # [1/time]: in this unit both blocks are of order one
    pull, drag = pull / unit**2, drag / unit
    if method == "dense" or (method in ("auto", "all", "fastest") and size <= DENSE_UP_TO):
        values, vectors, slowest, scope = *_solve_dense(pull, drag), unloading_scope(law)
    else:
        starts = np.concatenate([-1j * np.sqrt(undamped.pairs), np.sqrt(-undamped.negative.astype(complex))]) / unit
        values, vectors = _search_near_shifts(pull, drag, starts, report)
        slowest, scope = None, _describe_scope(undamped, starts)
    order = np.lexsort((values.imag, -values.real))
    modes = vectors[:, order] * root[:, None]
    return DampedStability(undamped, unit * values[order], modes, None if slowest is None else unit * slowest, scope)


def _max_coordinates(state: State) -> int:
    """Number of coordinates of all grains, an upper bound that does not require finding the rattlers."""
    per_grain = 3 if state.cell.dim == 2 else 6
    return per_grain * len(state.grains.radius)


def _describe_scope(undamped: Stability, starts: np.ndarray) -> str:
    near = f"exponents were sought near the {min(len(starts), STARTS)} fastest of the undamped motion and near zero"
    return "; ".join(
        words for words in (near, "growth caused by dashpots alone was not sought", undamped.scope) if words
    )


def _is_growing(values: np.ndarray) -> np.ndarray:
    """Mask of growing nonzero exponents, one of each pair. Translations give s = 0 twice, split by round-off."""
    return (values.real > PAIR_ABOVE) & (values.imag >= 0) & (np.abs(values) ** 2 > ZERO_BELOW)


def _solve_dense(pull, drag) -> tuple[np.ndarray, np.ndarray, complex]:
    """Growing exponents, their mass-weighted modes, and the slowest decay, in units of the largest λ."""
    n = pull.shape[0]
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull.toarray(), -drag.toarray()]])
    with suitable_threads(n):
        values, vectors = eig(form, overwrite_a=True)
    chosen = np.flatnonzero(_is_growing(values))
    decaying = values[(np.abs(values) ** 2 > ZERO_BELOW) & (values.real <= PAIR_ABOVE)]
    slowest = complex(decaying[np.argmax(decaying.real)]) if len(decaying) else None
    return values[chosen], _normalise_columns(vectors[:n, chosen]), slowest


def _normalise_columns(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=0, keepdims=True)


def _search_near_shifts(pull, drag, starts: np.ndarray, report) -> tuple[np.ndarray, np.ndarray]:
    """Growing exponents near those of the undamped motion and near zero, by shift and invert, without duplicates."""
    n = pull.shape[0]
    chosen = starts[np.argsort(-starts.real)][:STARTS]
    shifts = [1e-3, *(complex(s.real, abs(s.imag)) for s in chosen)]
    values, vectors = np.zeros(0, complex), np.zeros((n, 0), complex)
    for k, shift in enumerate(shifts):
        if report:
            report("exponents with dashpots", k / len(shifts), f"{len(values)} growing so far")
        found, modes = _exponents_near(pull, drag, complex(shift), NEAR if k else NEAR_ZERO)
        found, modes = found[_is_growing(found)], modes[:, _is_growing(found)]
        new = [not np.any(np.abs(values - s) < 1e-8) for s in found]
        values, vectors = np.append(values, found[new]), np.hstack([vectors, modes[:, new]])
    return values, _normalise_columns(vectors)


def _exponents_near(pull, drag, shift: complex, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Exponents nearest to a shift σ, and their modes; (A − σ)⁻¹ takes one factorisation of σ² + σ C + K."""
    n = pull.shape[0]
    quadratic = sparse.csc_array(shift**2 * sparse.eye_array(n) + shift * drag + pull)
    # the pattern is symmetric: an ordering that uses this has a tenth of the fill of the default
    solve = splu(quadratic, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-2, options={"SymmetricMode": True})

    def inverse(x):
        u, v = x[:n].astype(complex), x[n:].astype(complex)
        top = -solve.solve(v + drag @ u + shift * u)
        return np.concatenate([top, u + shift * top])

    operator = LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=complex)
    start = np.random.default_rng(0).normal(size=2 * n).astype(complex)
    try:
        theta, vectors = eigs(operator, k=min(count, n - 2), which="LM", v0=start, tol=TOLERANCE)
    except ArpackNoConvergence as problem:
        theta, vectors = problem.eigenvalues, problem.eigenvectors
    return shift + 1 / theta, vectors[:n]
