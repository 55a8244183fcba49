"""Sensitivity of stability to single contacts: their stiffness, sliding and opening."""

from typing import Annotated, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eig, eigvals

from ..core.arguments import NOT_NEGATIVE, checked, knows_bonds
from ..core.contacts.bonds import bond_rows
from ..core.contacts.forces import FREE
from ..core.contacts.jacobian import Linearisation, blocks_of, bond_blocks, contact_blocks, linearise
from ..core.laws.builtin import Law, damping_model
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.state import OPEN, SLIDE, STICK, State
from .balance import BALANCED_BELOW, LinearisedState, force_imbalance, linearised, no_equilibrium_message, with_mode
from .freedom import (
    PAIR_ABOVE,
    ZERO_BELOW,
    Freedom,
    backbone,
    cell_geometric_terms,
    incidence,
    mass_weighted,
    stiffness_of,
)
from .linear import suitable_threads
from .stability import LEFT_OUT, join_scopes

AT_MOST = 2_500  # number of coordinates for which all modes are computed within minutes
WORK = 5e9  # default limit on the number of spectra times (number of coordinates)³, for about ten seconds
LEAST = 3  # smallest default number of spectra, however large the packing


@readable
class ContactSensitivity(NamedTuple):
    """Sensitivity of one pair to contact stiffness, and of the verdict to the sliding or opening of each contact.

    Changes that reverse the verdict come first. The others are sorted by the change in the growth rate, and then by the
    derivative.
    """

    eigenvalue: complex | None  # λ of the pair, Im λ > 0; None if there is no pair [1/time²]
    condition: float  # ‖w‖‖v‖/|wᴴv| of λ, with left mode w, right mode v; diverges at birth; NaN without a pair
    contacts: np.ndarray  # (C,) rows in the contact list of the touching contacts that support the packing
    derivative: np.ndarray  # (C,) complex ∂λ/∂ln s for a factor s on each contact's stiffness; empty without a pair
    growth_rate: float  # growth rate of the fastest-growing mode, 0 if none grows [1/time]
    verdict: str  # stable, oscillates, buckles, or oscillates and buckles
    contact: np.ndarray  # (K,) row of the contact list for each change
    i: np.ndarray  # (K,) first body of the contact
    j: np.ndarray  # (K,) second body of the contact
    what: np.ndarray  # (K,) "slides", "opens", or "breaks" for a bond
    mobilised: np.ndarray  # (K,) |F_t|/(μ F_n) of the unchanged contact, 1 at the Coulomb limit; NaN without friction
    predicted: np.ndarray  # (K,) growth rate after the change, from pairs of neighbouring modes; for small changes only
    after: np.ndarray  # (K,) growth rate after the change, from the full spectrum; NaN if not computed
    verdict_after: np.ndarray  # (K,) new verdict; "falls apart" if only rattlers remain; empty if not computed
    scope: str  # limits of the analysis, in words

    @property
    def verified(self) -> np.ndarray:
        """(K,) True where the full spectrum was computed."""
        return np.isfinite(self.after)

    @property
    def turns(self) -> np.ndarray:
        """(K,) True where the change is verified to make an unstable packing stable, or a stable one unstable."""
        return self.verified & ((self.verdict_after == "stable") != (self.verdict == "stable"))

    @property
    def growth_derivative(self) -> np.ndarray:
        """(C,) ∂ω_i/∂ln s = Im(∂λ/∂ln s/(2√λ)) of the pair [1/time]."""
        return (self.derivative / (2 * np.sqrt(self.eigenvalue or 1))).imag


class _ModeData(NamedTuple):
    """Modes Λ = W A V, and the contributions of contacts to A = −Q B Qᵀ + other terms."""

    matrix: np.ndarray  # (n, n) A
    values: np.ndarray  # (n,) sorted
    right: np.ndarray  # (n, n) V
    left: np.ndarray  # (n, n) W = V⁻¹
    incidence: sparse.csc_array  # (n, 6C) Q, divided by √mass; 9C columns if contacts resist rolling
    blocks: np.ndarray  # (C, 6, 6) B
    force: np.ndarray  # (C, 3) contact forces

    def columns_of(self, row: int) -> sparse.csc_array:
        """(n, 6) columns of Q for one contact."""
        width = self.blocks.shape[1]
        return self.incidence[:, width * row : width * (row + 1)]


@checked
@knows_bonds
def contact_sensitivity(
    state: State, law: Law, *, pair: int = 0, most: Annotated[int, NOT_NEGATIVE] | None = None, report: Report = silent
) -> ContactSensitivity:
    """Sensitivity of a complex pair, and of the stability verdict, to single contacts.

    A = −M^(−1/2) J M^(−1/2) is a sum over contacts. For a small change of one contact, dλ = wᴴ dA v/(wᴴv). At the birth
    of a pair, wᴴv → 0 and the derivative diverges, because λ depends there on the square root of the change. For large
    changes, the block of a contact is replaced: by zero if it opens; if it slides, by the block of a contact at
    the Coulomb limit in the direction of its slip (without slip, the tangential stiffness vanishes). A bond persists if
    its contact opens or slides; its block vanishes if it breaks. Everything else is unchanged: the spectrum is that at
    the moment of the change, before the forces find a new balance. Grains that become rattlers through the change are
    excluded together with their contacts.

    Derivatives agree with finite differences to 1e-4, and `after` with the growth rate of the changed packing to 1e-7.
    In 30 spheres, `predicted`, from first-order shifts, had a correlation of 0.70 with `after`
    (`tests/modes/test_sensitivity.py`).

    Parameters
    ----------
    pair : index of the complex pair whose derivative is computed; 0 is the fastest growing
    most : number of changes for which the full spectrum is computed, the most promising first (if the packing is
        unstable, those with the smallest predicted growth); default: as many as take about ten seconds, which in small
        packings are all of them. The prediction rests on first-order shifts of all modes and on the coupling of
        neighbouring modes, and may miss some changes
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If there are more than 2500 coordinates, or no such pair; if the packing has only rattlers, or is not in
        equilibrium.

    Source
    ------
    Kato, Perturbation Theory for Linear Operators (Springer 1995), § II.2, for simple eigenvalues; Seyranian &
    Mailybaev, doi:10.1142/5305, Ch. 2, for coalescing ones.

    Examples
    --------
    Three disks that are pressed together by loads. If any one of their contacts opens, the remaining chain buckles:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(1.0, 0.5, 0.5)
    >>> place = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5]])
    >>> press = -2e-6 * 3 * (place - place.mean(axis=0))
    >>> three = ss.packings.from_arrays(
    ...     place, [0.5 + 1e-6] * 3, law, dim=2, external_force=press
    ... )
    >>> found = contact_sensitivity(three, law)
    >>> [str(word) for word in found.verdict_after[found.what == "opens"]]
    ['buckles', 'buckles', 'buckles']
    """
    here = linearised(state, law)
    free = here.backbone
    if not len(free):
        raise ValueError("the packing has only rattlers: sensitivities need grains that support each other")
    if len(free) > AT_MOST:
        raise ValueError(f"sensitivities need all modes: use at most {AT_MOST} coordinates, got {len(free)}")
    if (residual := force_imbalance(here)) > BALANCED_BELOW:
        raise ValueError(f"{no_equilibrium_message(residual)}; equilibrate the packing first")
    with suitable_threads(len(free)):
        modes = _compute_modes(here, free)
        growth, verdict = assess(modes.values)
        rows = here.rows
        bodies = np.stack([state.contacts.i[rows], state.contacts.j[rows]])
        rows = rows[np.isin(bodies, free.body).any(axis=0)]
        value, condition, derivative = _pair_sensitivity(modes, rows, pair)
        changes = _list_changes(here, modes, rows)
        predicted = np.array([_predict_growth(modes, row, block) for row, _, block, _ in changes])
        order = np.argsort(predicted if growth else -predicted, kind="stable")
        chosen = order[: max(LEAST, int(WORK / len(free) ** 3)) if most is None else most]
        after, verdicts = np.full(len(changes), np.nan), np.full(len(changes), "", dtype="<U24")
        for k, row in enumerate(chosen):
            report("sensitivity to contacts", k / len(chosen), f"{k} of {len(chosen)} spectra")
            after[row], verdicts[row] = assess(_eigenvalues_after(here, modes, free, *changes[row]))
    missing = len(changes) - len(chosen)
    scope = f"{missing} of {len(changes)} changes were evaluated by first-order shifts only" if missing else ""
    sliding = "contacts at the Coulomb limit are assumed to keep sliding" if len(here.at_limit) else ""
    scope = join_scopes(scope, LEFT_OUT if damping_model(law) else "", sliding)
    contact = np.array([row for row, *_ in changes], int)
    slope = np.abs(derivative)[np.searchsorted(rows, contact)] if len(derivative) else np.zeros(len(contact))
    finite = np.isfinite(after)
    turns = finite & ((verdicts == "stable") != (verdict == "stable"))
    last = np.lexsort((-slope, -np.abs(np.where(finite, after - growth, 0.0)), ~finite, ~turns))
    contact = contact[last]
    return ContactSensitivity(
        value, condition, rows, derivative, growth, verdict, contact, state.contacts.i[contact],
        state.contacts.j[contact], np.array([what for _, what, *_ in changes], "<U6")[last],
        here.line.mobilisation[contact], predicted[last], after[last], verdicts[last], scope,
    )  # fmt: skip


def _compute_modes(here: LinearisedState, free: Freedom) -> _ModeData:
    state, law, line, *_ = here
    blocks = blocks_of(state, law, line)[0]
    matrix = mass_weighted(stiffness_of(state, line, blocks, free), free).toarray()
    values, right = eig(matrix)
    order = np.lexsort((values.imag, values.real))
    values, right = values[order], right[:, order]
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        raise ValueError("modes coincide to round-off: this packing is at the birth of a complex pair") from None
    columns = incidence(state, len(blocks), free, blocks.shape[1]) / np.sqrt(free.mass)[:, None]
    return _ModeData(matrix, values, right, left, sparse.csc_array(columns), blocks, line.force)


def assess(values: np.ndarray) -> tuple[float, str]:
    """Fastest growth rate and verdict, with the thresholds of `stability`."""
    if not len(values):
        return 0.0, "falls apart"
    scale = np.abs(values).max(initial=0.0)
    swings = np.abs(values.imag) > PAIR_ABOVE * scale
    falls = ~swings & (values.real < -ZERO_BELOW * scale)
    motions = [name for name, there in (("oscillates", swings.any()), ("buckles", falls.any())) if there]
    rates = np.abs(np.sqrt(values[swings | falls].astype(complex)).imag)
    return float(rates.max(initial=0.0)), " and ".join(motions) or "stable"


def _pair_sensitivity(modes: _ModeData, rows: np.ndarray, pair: int):
    """λ of a pair, its condition number, and ∂λ/∂ln s (C,) of each contact."""
    scale = np.abs(modes.values).max()
    pairs = np.flatnonzero(modes.values.imag > PAIR_ABOVE * scale)
    pairs = pairs[np.argsort(-np.abs(np.sqrt(modes.values[pairs]).imag))]
    if not len(pairs) and pair == 0:
        return None, np.nan, np.zeros(0, complex)
    if not 0 <= pair < len(pairs):
        raise ValueError(f"pair {pair} does not exist: this packing has {len(pairs)} pairs, numbered from 0")
    p = pairs[pair]
    left, right = modes.left[p] @ modes.incidence, modes.right[:, p] @ modes.incidence
    left, right = (x.reshape(len(modes.blocks), -1)[rows] for x in (left, right))
    condition = float(np.linalg.norm(modes.left[p]) * np.linalg.norm(modes.right[:, p]))
    return complex(modes.values[p]), condition, -np.einsum("ca,cab,cb->c", left, modes.blocks[rows], right)


def _list_changes(here: LinearisedState, modes: _ModeData, rows: np.ndarray) -> list:
    """(row, kind of change, change of block, change of force) for every contact that can slide or open."""
    (state, law, line, *_), blocks, force = here, modes.blocks, modes.force
    slid = _with_all_sliding(state, line)
    slid_line = linearise(slid, law)
    slid_blocks, slid_force = blocks_of(slid, law, slid_line)[0], slid_line.force
    still = np.flatnonzero(~slid.contacts.slip[: len(blocks)].any(axis=1))  # no slip, so no direction of sliding
    slid_blocks[still] = contact_blocks(with_mode(slid, still, OPEN), law, memory=FREE)[0][still]
    sticks = (state.contacts.mode[rows] == STICK) & (line.limit[rows] > 0)
    sliding = [(c, "slides", slid_blocks[c] - blocks[c], slid_force[c] - force[c]) for c in rows[sticks]]
    if not state.bonds:
        return [*sliding, *((c, "opens", -blocks[c], -force[c]) for c in rows)]
    held, cement = bond_blocks(state), np.broadcast_to(line.bond, force.shape)
    bonded = np.intersect1d(rows, bond_rows(state.bonds, state.contacts)[state.bonds.intact])
    opening = [(c, "opens", held[c] - blocks[c], cement[c] - force[c]) for c in rows[line.closed[rows] > 0]]
    return [*sliding, *opening, *((c, "breaks", -held[c], -cement[c]) for c in bonded)]


def _with_all_sliding(state: State, line: Linearisation) -> State:
    """State with every contact at the Coulomb limit, in the direction of its slip."""
    contacts, count = state.contacts, len(line.limit)
    slip, mode = contacts.slip.copy(), contacts.mode.copy()
    size = np.linalg.norm(slip[:count], axis=1)
    stretched = (size > 0) & (line.stiffness_t > 0)
    reach = line.limit[stretched] / line.stiffness_t[stretched]
    slip[:count][stretched] *= (reach / size[stretched])[:, None]
    mode[:count][mode[:count] != OPEN] = SLIDE
    return state._replace(contacts=contacts._replace(slip=slip, mode=mode))


def _predict_growth(modes: _ModeData, row: int, block: np.ndarray) -> float:
    """Predicted growth rate after a change: first-order shifts of all λ, then pairwise coupling of neighbours."""
    columns = modes.columns_of(row)
    where = np.unique(columns.indices)
    q = columns[where].toarray()
    left, right = -(modes.left[:, where] @ q) @ block, modes.right[where].T @ q
    shifted = modes.values + (left * right).sum(axis=1)
    order = np.lexsort((shifted.imag, shifted.real))
    a, b = order[:-1], order[1:]
    coupling = (left[a] * right[b]).sum(axis=1) * (left[b] * right[a]).sum(axis=1)
    middle, half = (shifted[a] + shifted[b]) / 2, (shifted[a] - shifted[b]) / 2
    root = np.sqrt(half**2 + coupling)
    return assess(np.concatenate([middle + root, middle - root]))[0]


def _eigenvalues_after(
    here: LinearisedState, modes: _ModeData, free: Freedom, row: int, what: str, block, force
) -> np.ndarray:
    """All eigenvalues with one contact changed; grains that become rattlers are excluded with their contacts."""
    state, rows = here.state, here.rows
    if what == "slides":
        return eigvals(_changed_matrix(state, modes, free, [(row, block, force)]), overwrite_a=True)
    if what == "breaks":
        intact = bond_rows(state.bonds, state.contacts) != row
        after = state._replace(bonds=state.bonds._replace(intact=state.bonds.intact & intact))
    else:
        after = with_mode(state, row, OPEN)
    left = backbone(after, here.law)
    loose = np.setdiff1d(free.body, left.body)
    gone = rows[np.isin(state.contacts.i[rows], loose) | np.isin(state.contacts.j[rows], loose) | (rows == row)]
    lost = [(c, -modes.blocks[c], -modes.force[c]) for c in gone if c != row]
    alone = not np.isin([state.contacts.i[row], state.contacts.j[row]], loose).any()
    changed = (row, block, force) if alone else (row, -modes.blocks[row], -modes.force[row])
    matrix = _changed_matrix(state, modes, free, [*lost, changed])
    kept = np.searchsorted(free.component, left.component)
    return eigvals(matrix[np.ix_(kept, kept)], overwrite_a=True)


def _changed_matrix(state: State, modes: _ModeData, free: Freedom, changes) -> np.ndarray:
    """(n, n) A after changes (row, block, force) of contacts."""
    matrix = modes.matrix.copy()
    for row, block, force in changes:
        q = modes.columns_of(row).toarray()
        matrix -= q @ block @ q.T
        if free.length:
            root, every = 1 / np.sqrt(free.mass), np.zeros((int(state.contacts.count[0]), 3))
            nothing = cell_geometric_terms(state, every, free)
            every[row] = force
            matrix -= root[:, None] * (cell_geometric_terms(state, every, free) - nothing).toarray() * root
    return matrix
