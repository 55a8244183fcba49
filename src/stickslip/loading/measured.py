"""The state in balance that is nearest to measured positions and contact forces, whose overlaps are not known."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..core.arguments import checked
from ..core.contacts.jacobian import Linearisation, linearise
from ..core.contacts.neighbors import with_neighbor_list
from ..core.control import fixed
from ..core.laws.builtin import MU, Law
from ..core.laws.kinds import bridges_gaps
from ..core.laws.properties import angular_columns, needs_rows
from ..core.measure import branch_vectors
from ..core.readable import readable
from ..core.state import SLIDE, STICK, State, assembly, box, disks
from ..data.exchange.arrays import law_from_options
from ..data.exchange.files import LAMMPS_OPTIONS, Reading, law_from_file, with_inertia
from ..data.exchange.force_network import MeasuredForces, read_forces
from ..data.sample import PackingError, from_arrays, law_note
from ..solve.projection import Projection, nearest_point

STEPS, SETTLED = 100, 1e-8  # linearisations, and largest last change over the errors
FALLS, SHORTEST = 0.7, 1 / 4  # a step that is longer than this share of the last one halves all later ones, down to
LEAST_ERROR = 1e-5  # smallest error of a measurement, over the mean radius or force
FAR = 5.0  # errors beyond which a measurement contradicts the law
NEAR = 8.0  # errors of a position within which grains may come to touch
OPENS, APART = 1e-6, 1e-9  # force of an open contact over the mean force, and its gap over the mean radius
WEAK = 1e-2  # force over the mean force below which dδ/dF_n is that of this force, so that steps do not cycle
AT_LIMIT = 1e-5  # relative distance to the Coulomb limit at which a contact slides
INVERSIONS, BISECTIONS = 30, 60
ROUND_OFF = 1e-15  # of a force, and of the sum of two radii


@readable
class Adjustment(NamedTuple):
    """What was changed so that measured forces balance; changes are in errors of measurement."""

    chi_square: float  # Σ (change/error)² over all coordinates and forces
    degrees: int  # of freedom: equations and limits that bind
    position_error: float  # mean error of a coordinate, given or estimated [length]
    force_error: float  # mean error of a normal force, given or estimated [force]
    largest_move: float  # of a grain, over its error
    rms_move: float  # of all coordinates
    largest_force: float  # change of a normal or tangential force, over its error
    rms_force: float  # of all forces
    at_limit: int  # contacts at the Coulomb limit
    moved_to_limit: int  # of these, contacts measured beyond it
    opened: tuple[tuple[int, int], ...]  # grains of contacts that bear no force in balance

    def __str__(self) -> str:
        return (
            f"balanced by moving grains by at most {self.largest_move:.2g} errors of position (rms {self.rms_move:.2g}; "
            f"error {self.position_error:.3g}) and forces by at most {self.largest_force:.2g} errors (rms "
            f"{self.rms_force:.2g}; error {self.force_error:.3g}); chi² is {self.chi_square:.4g} for {self.degrees} "
            f"degrees of freedom; {self.at_limit} contacts at the Coulomb limit, {self.moved_to_limit} of them measured "
            f"beyond it; {len(self.opened)} opened"
        )


@checked
def from_forces(measured: MeasuredForces, law: Law, *, mass=None, density=None) -> tuple[State, Adjustment]:
    """State in exact balance that is nearest to measured positions and contact forces of disks.

    Minimises Σ Δx²/σ_x² + Σ ΔF²/σ_F² over positions, normal and tangential forces. Every free grain is in balance,
    each contact has the overlap and the slip that the law gives for its forces, none exceeds the Coulomb limit or
    pulls, and no other grains overlap. The equations are linearised until nothing changes; each linear problem is
    solved by an interior-point method. Contacts whose force vanishes open. Grains that are held need not balance, but
    their positions were measured like all others. Errors that were not measured are estimated: of positions from the
    gaps at contacts, of forces from the imbalance of free grains; chi² then says little.

    Parameters
    ----------
    measured : from `read_forces`
    law : Law with friction, of one material, whose forces follow from overlap and slip
    mass, density : as in `from_arrays`

    Returns
    -------
    State, Adjustment
        the balanced state, and what was changed

    Raises
    ------
    PackingError
        if the forces cannot be balanced; the message is one sentence.

    Source
    ------
    Sequential quadratic programming: Nocedal & Wright, doi:10.1007/978-0-387-40065-5, Ch. 18.

    Examples
    --------
    >>> import numpy as np
    >>> import stickslip as ss
    >>> law, row = ss.laws.linear(kn=100.0), [[0.0, 0.0], [1.01, 0.0], [2.0, 0.0]]
    >>> forces = ss.io.measured_forces(row, 0.5, [0, 1], [1, 2], [1.0, 1.1], held=[0, 2])
    >>> state, change = from_forces(forces, law)
    >>> ss.measure.overlaps(state).round(6).tolist()
    [0.0105, 0.0105]
    """
    _check_law(law)
    network = _Network.of(measured, law)
    while True:
        solution = network.solve()
        bears = solution.force_n > 2 * network.least
        if bears.all():
            return network.state(solution, mass, density), network.adjustment(solution)
        network = network.without(~bears, solution)


def read_measured(path: Path, *, contacts: Path | None = None, i0: float | None = None, **options) -> Reading:
    """State in balance nearest to measured forces in files, see `read_forces`; options of the law as in `read_packing`."""
    options = {name: value for name, value in options.items() if value not in (None, {})}
    given, law = law_from_file(options)
    for name in ("frame", *LAMMPS_OPTIONS):
        if name in given:
            raise PackingError(f"{name} was given with measured forces, which have none: leave it out")
    law = law or law_from_options(given)
    measured = read_forces(path, contacts)
    state, change = from_forces(measured, law)
    as_given, reversed_ = (np.linalg.norm(_imbalance(measured, sign)[measured.free]) for sign in (1.0, -1.0))
    notes = [*measured.notes, str(change)] + ([] if options else [law_note(law)])
    if reversed_ < as_given / 2:
        notes.append(
            "forces balance better with opposite tangential forces: ft is positive if it turns grains from x to y"
        )
    return Reading(with_inertia(state, i0), law, notes)


def _check_law(law: Law) -> None:
    if len(law.table) > 1 or needs_rows(law) or angular_columns(law) or bridges_gaps(law.kind):
        raise PackingError(
            "a law of several materials, with moments, a memory of its own or lever arms R − δ/2 was given: measured "
            "forces need one whose forces follow from overlap and slip"
        )
    if not law.table[0, 0, MU] > 0:
        raise PackingError("a law without friction was given: measured tangential forces need mu above zero")


class _Solution(NamedTuple):
    """Positions and forces, with the changes in units of their errors."""

    position: np.ndarray  # (N, 2)
    force_n: np.ndarray  # (C,)
    force_t: np.ndarray  # (C,)
    change: np.ndarray  # (2N + 2C,)
    binding: int  # equations and inequalities that bind


class _Network(NamedTuple):
    """A measured network with all errors, and the pairs that must not overlap."""

    measured: MeasuredForces
    law: Law
    least: float  # smallest normal force of a contact
    near: np.ndarray  # (P, 2) grains without contact that might overlap
    start: np.ndarray  # (2N + 2C,) first guess of the changes
    opened: tuple[tuple[int, int], ...] = ()
    spent: float = 0.0  # chi² of the forces of opened contacts

    @classmethod
    def of(cls, measured: MeasuredForces, law: Law) -> "_Network":
        measured = _with_errors(measured, law)
        _check_contacts(measured, law)
        tree = cKDTree(measured.position)
        reach = 2 * measured.radius.max() + NEAR * np.sqrt(2) * measured.position_error.max()
        pairs = tree.query_pairs(reach, output_type="ndarray").reshape(-1, 2)
        contact = {frozenset(pair) for pair in measured.ends.T.tolist()}
        near = np.array([pair for pair in pairs.tolist() if frozenset(pair) not in contact], int).reshape(-1, 2)
        gap = np.linalg.norm(measured.position[near[:, 0]] - measured.position[near[:, 1]], axis=1)
        wide = NEAR * np.linalg.norm(measured.position_error[near], axis=1) + measured.radius[near].sum(axis=1)
        size = measured.position.size + 2 * len(measured.force_n)
        network = cls(measured, law, OPENS * measured.force_n.mean(), near[gap < wide], np.zeros(size))
        return network._without_loose_ends()

    def _without_loose_ends(self) -> "_Network":
        """Network without the contacts of free grains that have only one, if their force may be an error."""
        measured, network = self.measured, self
        ends = measured.ends
        count = np.bincount(ends.ravel(), minlength=len(measured.radius))
        loose = measured.free & (count == 1) & ~measured.load.any(axis=1)
        ends_loose = loose[ends].any(axis=0)
        strong = ends_loose & (measured.force_n > FAR * measured.force_n_error)
        if strong.any():
            c = int(np.flatnonzero(strong)[0])
            k = int(ends[:, c][loose[ends[:, c]]][0])
            raise PackingError(
                f"grain {measured.ids[k]} has one contact, with the force {measured.force_n[c]:.4g}, which nothing "
                f"balances: mark the grain as fixed if it touches a wall, or give its other contacts"
            )
        if not ends_loose.any():
            return network
        zero = np.zeros(len(measured.force_n))
        return self.without(ends_loose, _Solution(measured.position, zero, zero, self.start, 0))._without_loose_ends()

    def without(self, rows: np.ndarray, solution: _Solution) -> "_Network":
        """Network in which these contacts are open."""
        measured, kept = self.measured, ~rows
        ends = measured.ends
        lost = ((measured.force_n / measured.force_n_error)[rows] ** 2).sum()
        lost += ((measured.force_t / measured.force_t_error)[rows] ** 2).sum()
        names = tuple((int(i), int(j)) for i, j in measured.ids[ends[:, rows]].T)
        if not kept.any():
            raise PackingError("no contact bears a force in balance: mark the grains at the edge as fixed")
        whole = np.concatenate([np.ones(measured.position.size, bool), kept, kept])
        return self._replace(
            measured=measured.select(kept), near=np.concatenate([self.near, ends[:, rows].T]),
            start=solution.change[whole], opened=self.opened + names, spent=self.spent + float(lost),
        )  # fmt: skip

    @property
    def error(self) -> np.ndarray:
        """(2N + 2C,) errors of the coordinates and forces."""
        m = self.measured
        return np.concatenate([np.repeat(m.position_error, 2), m.force_n_error, m.force_t_error])

    def at(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, normal and tangential forces after a change."""
        m, n = self.measured, self.measured.position.size
        place, force_n, force_t = np.split(change * self.error, [n, n + len(m.force_n)])
        return m.position + place.reshape(-1, 2), m.force_n + force_n, m.force_t + force_t

    def solve(self) -> _Solution:
        """Nearest balanced positions and forces."""
        change, share, size = self.start, 1.0, np.inf
        for _ in range(STEPS):
            a, b, g, h = self.linearised(change)
            nearest = nearest_point(a, b, g, h)
            if nearest is None:
                raise PackingError(self._reason())
            step, last = nearest.point - change, size
            size = float(np.abs(step).max())
            if size < SETTLED:
                return self._solution(nearest)
            share = max(share / 2, SHORTEST) if size > FALLS * last else share
            change = change + share * step
        raise PackingError(
            f"positions and forces still change by {size:.2g} errors after {STEPS} steps: their "
            f"errors are too large for the equations of balance to be linearised"
        )

    def _solution(self, nearest: Projection) -> _Solution:
        binding = len(nearest.of_equations) + int((nearest.of_inequalities > nearest.slack).sum())
        return _Solution(*self.at(nearest.point), nearest.point, binding)

    def linearised(self, change: np.ndarray):
        """A, b, G, h of the equations A z = b and inequalities G z ≥ h around a change."""
        m, (place, force_n, force_t) = self.measured, self.at(change)
        force_n = np.maximum(force_n, self.least)
        n, count, error = len(m.radius), len(m.force_n), self.error
        normal, distance, along = _geometry(place, m.ends)
        _, _, across = _geometry(place, m.ends, turned=True)
        overlap, line = _invert(self.law, m.radius[m.ends], force_n)
        weak = np.maximum(force_n, WEAK * m.force_n.mean())
        slope = _invert(self.law, m.radius[m.ends], weak)[1].slope_n
        both = sparse.csr_array((np.ones(2 * count), (m.ends.ravel(), np.tile(np.arange(count), 2))), shape=(n, count))
        turning = across.T @ sparse.diags_array(force_n / distance) - along.T @ sparse.diags_array(force_t / distance)
        zero = sparse.csr_array((n, 2 * n))
        balance = sparse.block_array([[turning @ across, along.T, across.T], [zero, None, both]], format="csr")
        kept = np.concatenate([np.repeat(m.free, 2), m.free])
        force = along.T @ force_n + across.T @ force_t + m.load.ravel()
        closure = sparse.block_array([[along, sparse.diags_array(1 / slope), sparse.csr_array((count, count))]])
        equations = sparse.vstack([balance[kept] / m.force_n_error.mean(), closure / m.position_error.mean()], "csr")
        unbalanced = np.concatenate([force, both @ force_t])[kept] / m.force_n_error.mean()
        open_by = (distance + overlap - m.radius[m.ends].sum(axis=0)) / m.position_error.mean()
        a = sparse.csr_array(equations @ sparse.diags_array(error))
        b = a @ change - np.concatenate([unbalanced, open_by])
        g, above = self._inequalities(place, force_n, force_t, line)
        g = sparse.csr_array(g @ sparse.diags_array(error))
        return a, b, g, g @ change - above

    def _inequalities(self, place, force_n, force_t, line: Linearisation):
        """Derivatives and values of what must not be negative: forces, distances to the limits, and gaps."""
        m, count = self.measured, len(force_n)
        eye, none = sparse.eye_array(count), sparse.csr_array((count, place.size))
        limit = sparse.diags_array(line.mu)
        _, distance, along = _geometry(place, self.near.T)
        empty = sparse.csr_array((len(self.near), count))
        forces = sparse.block_array([[none, eye, None], [none, limit, -eye], [none, limit, eye]])
        gaps = sparse.hstack([along, empty, empty]) / m.position_error.mean()
        gap = distance - m.radius[self.near].sum(axis=1) - APART * m.radius.mean()
        values = np.concatenate([force_n - self.least, line.limit - force_t, line.limit + force_t])
        scale = m.force_n_error.mean()
        return sparse.vstack([forces / scale, gaps]), np.concatenate([values / scale, gap / m.position_error.mean()])

    def _reason(self) -> str:
        """Sentence for forces that cannot be balanced, with the grain that is farthest from balance."""
        m = self.measured
        size = np.linalg.norm(_imbalance(m), axis=1) * m.free
        k = int(np.argmax(size))
        return (
            f"no forces within the Coulomb limit balance all free grains, farthest from balance is grain {m.ids[k]} "
            f"with {size[k]:.3g}: check its contacts and mu, or mark grains that touch a wall as fixed"
        )

    def state(self, solution: _Solution, mass, density) -> State:
        """Balanced state."""
        m, law = self.measured, self.law
        overlap, line = _invert(law, m.radius[m.ends], solution.force_n)
        slip = _slip_of_force(law, m.radius[m.ends], overlap, np.abs(solution.force_t), line)
        slides = self.slides(solution.force_t, line)
        normal, *_ = _geometry(solution.position, m.ends)
        way = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        state = from_arrays(
            solution.position, m.radius, law, mass=mass, density=density, pair_i=m.pair_i, pair_j=m.pair_j,
            slip=-(slip * np.sign(solution.force_t))[:, None] * way, mode=np.where(slides, SLIDE, STICK),
            external_force=m.load if m.load.any() else None, dim=2,
        )  # fmt: skip
        held = np.flatnonzero(~m.free)
        return state._replace(control=fixed(state.control, held)) if len(held) else state

    @staticmethod
    def slides(force_t: np.ndarray, line: Linearisation) -> np.ndarray:
        """(C,) mask of contacts at the Coulomb limit."""
        return np.abs(force_t) >= (1 - AT_LIMIT) * line.limit

    def adjustment(self, solution: _Solution) -> Adjustment:
        """What was changed."""
        m, n = self.measured, self.measured.position.size
        _, line = _invert(self.law, m.radius[m.ends], solution.force_n)
        _, before = _invert(self.law, m.radius[m.ends], np.maximum(m.force_n, self.least))
        slides, beyond = self.slides(solution.force_t, line), np.abs(m.force_t) > before.limit
        move, force = solution.change[:n], solution.change[n:]
        total = len(force) + 2 * len(self.opened)
        return Adjustment(
            float(solution.change @ solution.change + self.spent), solution.binding + 2 * len(self.opened),
            float(m.position_error.mean()), float(m.force_n_error.mean()),
            float(np.linalg.norm(move.reshape(-1, 2), axis=1).max()), float(np.sqrt((move**2).mean())),
            float(np.abs(force).max()), float(np.sqrt((force @ force + self.spent) / total)),
            int(slides.sum()), int((slides & beyond).sum()), self.opened,
        )  # fmt: skip


def _geometry(place: np.ndarray, ends: np.ndarray, *, turned=False):
    """Unit vectors n from j to i, or n × z, (C, 2); distances (C,); and ∂(n·r)/∂x, (C, 2N) sparse."""
    branch = place[ends[0]] - place[ends[1]]
    distance = np.linalg.norm(branch, axis=1)
    unit = branch / distance[:, None]
    if turned:
        unit = np.stack([unit[:, 1], -unit[:, 0]], axis=1)
    rows = np.repeat(np.arange(len(unit)), 2)
    columns = [(2 * end[:, None] + [0, 1]).ravel() for end in ends]
    values = np.concatenate([unit.ravel(), -unit.ravel()])
    where = np.tile(rows, 2), np.concatenate(columns)
    return unit, distance, sparse.csr_array((values, where), shape=(len(unit), place.size))


def _imbalance(m: MeasuredForces, sign: float = 1.0) -> np.ndarray:
    """(N, 3) sums of forces and torque/R on every grain, as measured; or with the opposite tangential forces."""
    _, _, along = _geometry(m.position, m.ends)
    _, _, across = _geometry(m.position, m.ends, turned=True)
    force = (along.T @ m.force_n + sign * (across.T @ m.force_t)).reshape(-1, 2) + m.load
    turn = np.bincount(m.ends.ravel(), np.tile(m.force_t, 2), len(m.radius))
    return np.column_stack([force, turn])


def _with_errors(m: MeasuredForces, law: Law) -> MeasuredForces:
    """Network with errors of positions estimated from gaps, and of forces from imbalance, where none were measured."""
    _, distance, _ = _geometry(m.position, m.ends)
    overlap, _ = _invert(law, m.radius[m.ends], np.maximum(m.force_n, OPENS * m.force_n.mean()))
    miss = np.sqrt(((distance + overlap - m.radius[m.ends].sum(axis=0)) ** 2).mean() / 2)
    contacts = np.bincount(m.ends.ravel(), minlength=len(m.radius))[m.free].sum()
    off = np.sqrt((_imbalance(m)[m.free] ** 2).sum() / max(3 * contacts, 1))
    position = max(miss, LEAST_ERROR * m.radius.mean())
    force = max(off, LEAST_ERROR * m.force_n.mean())
    return m._replace(
        position_error=np.where(np.isnan(m.position_error), position, m.position_error),
        force_n_error=np.where(np.isnan(m.force_n_error), force, m.force_n_error),
        force_t_error=np.where(np.isnan(m.force_t_error), force, m.force_t_error),
    )


def _check_contacts(m: MeasuredForces, law: Law) -> None:
    """Raise PackingError if a tangential force is far beyond the Coulomb limit."""
    mu = law.table[0, 0, MU]
    beyond = (np.abs(m.force_t) - mu * m.force_n) / np.hypot(m.force_t_error, mu * m.force_n_error)
    c = int(np.argmax(beyond))
    if beyond[c] > FAR:
        i, j = m.ids[m.ends[:, c]]
        raise PackingError(
            f"grains {i} and {j} touch with a tangential force of {abs(m.force_t[c]):.4g} at a normal force of "
            f"{m.force_n[c]:.4g}, {beyond[c]:.2g} errors beyond the Coulomb limit for mu = {mu:g}: check mu and the errors"
        )


def _evaluate(law: Law, radius: np.ndarray, overlap: np.ndarray, slip=0.0) -> Linearisation:
    """Law at contacts of given radii (2, C), overlaps and slips (C,)."""
    count = len(overlap)
    place = np.zeros((2, count, 2))
    place[1, :, 0], place[:, :, 1] = radius.sum(axis=0) - overlap, 4 * radius.max() * np.arange(count)
    state = assembly(disks(place.reshape(-1, 2), radius.ravel()), cell=box(dim=2))
    state = with_neighbor_list(state, law)
    contacts = state.contacts._replace(slip=state.contacts.slip.copy(), mode=state.contacts.mode.copy())
    contacts.pair[:count], contacts.mode[:count], contacts.slip[:count, 1] = branch_vectors(state), STICK, slip
    return linearise(state._replace(contacts=contacts), law)


def _invert(law: Law, radius: np.ndarray, force_n: np.ndarray) -> tuple[np.ndarray, Linearisation]:
    """(C,) overlaps with given normal forces, and the law there, by Newton's method for ln F_n of ln δ."""
    most = radius.min(axis=0)
    overlap = 1e-3 * most
    for _ in range(INVERSIONS):
        line = _evaluate(law, radius, overlap)
        if not (line.force_n > 0).all():
            break
        if (np.abs(line.force_n / force_n - 1) < ROUND_OFF * (1 + radius.sum(axis=0) / overlap)).all():
            return overlap, line
        overlap = overlap * (force_n / line.force_n) ** (line.force_n / (overlap * line.slope_n))
        if not (overlap < most).all():
            c = int(np.argmax(overlap / most))
            raise PackingError(
                f"the normal force {force_n[c]:.4g} would need an overlap of more than a radius ({most[c]:.4g}): check kn, "
                f"which must be in the units of the forces and lengths"
            )
    raise PackingError("a law whose normal force does not grow from zero with the overlap was given: give another")


def _slip_of_force(law: Law, radius, overlap, force_t, line: Linearisation) -> np.ndarray:
    """(C,) sizes of the slips with given tangential forces, by bisection up to the Coulomb limit."""
    low, high = np.zeros(len(overlap)), line.limit / line.stiffness_t
    for _ in range(BISECTIONS):
        slip = (low + high) / 2
        short = _evaluate(law, radius, overlap, slip).secant * slip < force_t
        low, high = np.where(short, slip, low), np.where(short, high, slip)
    return (low + high) / 2
