"""Balanced state nearest to measured positions and contact forces, whose overlaps are unknown."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..core.arguments import checked
from ..core.control import fixed
from ..core.laws.builtin import MU, Law
from ..core.laws.kinds import bridges_gaps
from ..core.laws.properties import angular_columns, remembers_more
from ..core.readable import readable
from ..core.state import SLIDE, STICK, State
from ..data.exchange.arrays import law_from_options
from ..data.exchange.columns import mass_note
from ..data.exchange.files import LAMMPS_OPTIONS, Reading, separate_law, with_inertia
from ..data.exchange.force_network import MeasuredForces, read_forces, unit_branches
from ..data.sample import PackingError, from_arrays, law_note, naming, with_one_account
from ..solve.inversion import nearest_point, overlap_of_force, slip_of_force

STEPS, SETTLED = 100, 1e-8  # largest number of linearisations, and largest change in the last one, in errors
# after a step longer than this fraction of the previous one, steps are halved (down to a quarter) if its direction was
# reversed, and doubled (up to four times) if it was kept
FALLS, SHORTEST, LONGEST = 0.7, 1 / 4, 4.0
LEAST_ERROR = 1e-5  # smallest estimated error, in units of the mean radius or force
FAR, NEAR = 5.0, 8.0  # number of errors beyond which a measurement is impossible, and within which grains may touch
OPENS, APART = 1e-6, 1e-9  # force of an open contact in mean forces, and its gap in mean radii
WEAK = 1e-2  # force, in mean forces, below which dδ/dF_n is that at this force, so that steps do not cycle
AT_LIMIT = 1e-5  # relative distance to the Coulomb limit at which a contact slides
FACETS = 8  # number of facets of the Coulomb cone between spheres
BLUNT = 1e-3  # tangential force, in errors, below which the curvature of the cone is that at this force


@readable
class Adjustment(NamedTuple):
    """Changes of measured positions and forces that make the forces balance, in units of the errors."""

    chi_square: float  # Σ (change/error)² over all coordinates and forces
    degrees: int  # degrees of freedom: equations and active limits
    position_error: float  # mean error of a coordinate, given or estimated [length]
    force_error: float  # mean error of a normal force, given or estimated [force]
    largest_move: float  # largest displacement of a coordinate
    rms_move: float  # root mean square displacement over all coordinates
    largest_force: float  # largest change of a normal or tangential force
    rms_force: float  # root mean square change over all forces
    at_limit: int  # contacts at the Coulomb limit
    moved_to_limit: int  # contacts at the limit that were measured beyond it
    opened: tuple[tuple[int, int], ...]  # grains of contacts that carry no force in the balanced state

    def __str__(self) -> str:
        return (
            f"balanced by moving coordinates by at most {self.largest_move:.2g} errors (rms {self.rms_move:.2g}; one "
            f"error is {self.position_error:.3g}) and forces by at most {self.largest_force:.2g} (rms "
            f"{self.rms_force:.2g}; one error is {self.force_error:.3g}); chi² is {self.chi_square:.4g} for "
            f"{self.degrees} degrees of freedom; "
            f"contacts at the Coulomb limit: {self.at_limit}, {self.moved_to_limit} of them measured beyond it; "
            f"opened: {len(self.opened)}"
        )


@checked
def from_forces(measured: MeasuredForces, law: Law, *, density=1.0) -> tuple[State, Adjustment]:
    """State in exact balance nearest to measured positions and contact forces of disks or spheres.

    Minimises Σ Δx²/σ_x² + Σ ΔF²/σ_F² over positions, normal and tangential forces. Constraints: every free grain is in
    balance, overlap and slip of each contact follow from its forces by the law, no contact exceeds the Coulomb limit or
    pulls, and no other grains overlap. The equations are linearised repeatedly until convergence; each linear problem
    is solved by an interior-point method. Contacts whose force vanishes open. Held grains need not balance, but their
    positions are measured quantities like all others. Unknown errors are estimated, those of positions from the gaps at
    contacts, and those of forces from the imbalance of free grains; chi² is then of little significance. Tangential
    forces of spheres turn with the branch vector of their contact, and each component has the given error.

    Parameters
    ----------
    measured : positions and contact forces, from `read_forces`
    law : Law with friction, of one material, whose forces follow from overlap and slip
    density : float or (N,), mass per area of a disk or volume of a sphere [mass/length²] or [mass/length³]

    Returns
    -------
    State, Adjustment
        the balanced state, and the changes made

    Raises
    ------
    PackingError
        If the forces cannot be balanced.

    Source
    ------
    Sequential quadratic programming: Nocedal & Wright, doi:10.1007/978-0-387-40065-5, Ch. 18.

    Examples
    --------
    >>> import stickslip as ss
    >>> law, row = ss.laws.linear(kn=100.0), [[0.0, 0.0], [1.01, 0.0], [2.0, 0.0]]
    >>> chain = ss.io.measured_forces(row, 0.5, [0, 1], [1, 2], [1, 1.1], held=[0, 2])
    >>> state, change = from_forces(chain, law)
    >>> ss.measure.overlaps(state).round(4).tolist()
    [0.0105, 0.0105]
    """
    _check_law(law)
    network = _network(measured, law)
    while True:
        change, binding = network.solve()
        opens = network.at(change)[1] <= 2 * network.least
        if not opens.any():
            return network.result(change, binding, density)
        network = network.without(opens, change)


def read_measured(path: Path, *, contacts: Path | None = None, i0: float | None = None, **options) -> Reading:
    """Balanced state nearest to measured forces (see `read_forces`); options of the law as in `read_packing`."""
    options = {name: value for name, value in options.items() if value not in (None, {})}
    frame = options.pop("frame", None)
    for name in LAMMPS_OPTIONS:
        if name in options:
            raise PackingError(f"{name} does not apply to the measured forces in {path.name}: leave it out")
    given, file_law = separate_law(options)
    measured = read_forces(path, contacts, frame=frame)
    with naming(path):
        law = file_law or law_from_options(given)
        state, change = from_forces(measured, law)
    notes = [*measured.notes, str(change), mass_note(path.name)] + ([] if options else [law_note(law)])
    return Reading(with_inertia(state, i0), law, with_one_account(notes))


def _check_law(law: Law) -> None:
    if len(law.table) > 1 or remembers_more(law) or angular_columns(law) or bridges_gaps(law.kind):
        raise PackingError(
            "measured forces need a law of one material whose forces depend only on overlap and slip: use one without "
            "moments, additional memory or lever arms R − δ/2"
        )
    if not law.table[0, 0, MU] > 0:
        raise PackingError("measured tangential forces need a law with friction: use mu > 0")


class _Network(NamedTuple):
    """A measured network with all errors, and the pairs that must not overlap."""

    measured: MeasuredForces
    law: Law
    least: float  # smallest normal force of a contact
    near: np.ndarray  # (2, P) pairs of grains without contact that might overlap
    start: np.ndarray  # (D (N + C),) first guess of the changes, in errors
    opened: tuple[tuple[int, int], ...] = ()
    spent: float = 0.0  # chi² of the forces of opened contacts

    def without(self, rows: np.ndarray, change: np.ndarray) -> "_Network":
        """Network with these contacts open."""
        m, ends = self.measured, self.measured.ends[:, rows]
        if rows.all():
            raise PackingError("no contact carries a force in the balanced state: mark the grains at the edge as fixed")
        sizes = m.force_n / m.force_n_error, _sizes(m.force_t) / m.force_t_error
        lost = np.concatenate(sizes)[np.tile(rows, 2)]
        kept = np.concatenate([np.ones(m.position.size, bool), ~rows, np.repeat(~rows, m.dim - 1)])
        return self._replace(
            measured=m.select(~rows), near=np.hstack([self.near, ends]), start=change[kept],
            opened=self.opened + tuple(map(tuple, m.ids[ends].T.tolist())), spent=self.spent + float(lost @ lost),
        )  # fmt: skip

    @property
    def error(self) -> np.ndarray:
        """(D (N + C),) errors of the coordinates and forces."""
        m = self.measured
        return np.concatenate(
            [np.repeat(m.position_error, m.dim), m.force_n_error, np.repeat(m.force_t_error, m.dim - 1)]
        )

    def at(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, normal forces and (C, D − 1) components of tangential forces after a change."""
        m, n = self.measured, self.measured.position.size
        position, force_n, force_t = np.split(change * self.error, [n, n + len(m.force_n)])
        before = _components(m, _Directions.of(m, m.position))
        return m.position + position.reshape(-1, m.dim), m.force_n + force_n, before + force_t.reshape(-1, m.dim - 1)

    def solve(self) -> tuple[np.ndarray, int]:
        """(D (N + C),) smallest change that balances forces, and the number of equations and active inequalities."""
        change, share, size, bent, step = self.start, 1.0, np.inf, None, np.zeros(len(self.start))
        for _ in range(STEPS):
            nearest = nearest_point(*self.linearise(change), bent, change)
            if nearest is None:
                raise PackingError(self._reason())
            former, step, last = step, nearest.point - change, size
            moves = np.where(self.bearing(nearest.point), np.abs(step), 0.0)
            size = float(moves.max())
            if size < SETTLED:
                return nearest.point, nearest.binding
            if size > FALLS * last:
                share = min(2 * share, LONGEST) if former @ step > 0 else max(share / 2, SHORTEST)
            change = change + share * step
            bent = self.curvature(change, nearest.pushes) if self.measured.dim == 3 else None
        raise PackingError(
            f"positions and forces still change by {size:.2g} errors after {STEPS} steps: the errors are too large for "
            f"the equations of balance to be linearised"
        )

    def linearise(self, change: np.ndarray):
        """Matrices A, G and vectors b, h of the linearised equations A z = b and inequalities G z ≥ h at a change."""
        m, (position, force_n, force_t) = self.measured, self.at(change)
        force_n, radii, count = np.maximum(force_n, self.least), m.radius[m.ends], len(force_n)
        to = _Directions.of(m, position)
        overlap, line = overlap_of_force(self.law, radii, force_n)
        slope = overlap_of_force(self.law, radii, np.maximum(force_n, WEAK * m.force_n.mean()))[1].slope_n
        steps, spins = _differences(m.ends, m.dim, len(position)), _sums(m)
        near, far = _separations(position, self.near)
        kept, turning = np.repeat(m.free, m.dim), np.repeat(m.free, spins.shape[0] // len(m.free))
        along, across = _blocks(to.normal[:, None]) @ steps, _blocks(to.across) @ steps
        force, torque = to.force_slopes(force_n, force_t)
        eye, mu, (length, unit) = sparse.eye_array(count), sparse.diags_array(line.mu), self._scales
        equations = [
            [(steps.T @ _blocks(force) @ steps)[kept] / unit, along.T[kept] / unit, across.T[kept] / unit],
            [(spins @ _blocks(torque) @ steps)[turning] / unit, None, (spins @ _blocks(to.levers))[turning] / unit],
            [along / length, sparse.diags_array(1 / (length * slope)), None],
        ]
        facets = _facets(force_t)
        limits = [[None, eye / unit, None], *([None, mu / unit, -_blocks(f[:, None]) / unit] for f in facets)]
        total = to.total(force_n, force_t)
        values = [
            (steps.T @ total.ravel() + m.load.ravel())[kept] / unit,
            (spins @ to.torque(force_t).ravel())[turning] / unit,
            (to.distance + overlap - radii.sum(axis=0)) / length, (force_n - self.least) / unit,
            *((line.limit - (f * force_t).sum(axis=1)) / unit for f in facets),
            (far - m.radius[self.near].sum(axis=0) - APART * m.radius.mean()) / length,
        ]  # fmt: skip
        a, g = (
            sparse.csr_array(sparse.block_array(rows) @ sparse.diags_array(self.error))
            for rows in (equations, [*limits, [near / length, None, None]])
        )
        return a, a @ change - np.concatenate(values[:3]), g, g @ change - np.concatenate(values[3:])

    def bearing(self, change: np.ndarray) -> np.ndarray:
        """(D (N + C),) mask; False for tangential forces of contacts about to open, whose directions do not converge"""
        m = self.measured
        bears = self.at(change)[1] > 2 * self.least
        return np.concatenate([np.ones(m.position.size + len(bears), bool), np.repeat(bears, m.dim - 1)])

    def curvature(self, change: np.ndarray, pushes: np.ndarray):
        """Second derivative of the limits of tangential forces, times their multipliers; needed for convergence.

        The second derivative of |t| is (1 − t̂ ⊗ t̂)/|t|.
        """
        m, force_t = self.measured, self.at(change)[2]
        count, size = len(force_t), np.maximum(np.linalg.norm(force_t, axis=1), BLUNT * m.force_t_error)
        way = force_t / size[:, None]
        weight = pushes[count : 2 * count] * m.force_t_error**2 / (self._scales[1] * size)
        block = _blocks(weight[:, None, None] * (np.eye(2) - way[:, :, None] * way[:, None]))
        free = m.position.size + count
        return sparse.block_diag([sparse.csr_array((free, free)), block], format="csr")

    @property
    def _scales(self) -> tuple[float, float]:
        """Mean errors of a coordinate and of a normal force."""
        return float(self.measured.position_error.mean()), float(self.measured.force_n_error.mean())

    def _reason(self) -> str:
        """Sentence for forces that cannot be balanced, with the grain that is farthest from balance."""
        size = np.linalg.norm(_imbalance(self.measured), axis=1) * self.measured.free
        k = int(np.argmax(size))
        return (
            f"no forces within the Coulomb limit balance all free grains; the largest imbalance is {size[k]:.3g} "
            f"at grain {self.measured.ids[k]}: check its contacts and mu, or mark grains at walls as fixed"
        )

    def result(self, change: np.ndarray, binding: int, density) -> tuple[State, Adjustment]:
        """Balanced state, and the changes made."""
        m, law, (position, force_n, force_t) = self.measured, self.law, self.at(change)
        radii, size = m.radius[m.ends], np.linalg.norm(force_t, axis=1)
        overlap, line = overlap_of_force(law, radii, force_n)
        tangential = _Directions.of(m, position).total(0 * force_n, force_t)
        slip = slip_of_force(law, radii, overlap, size, line) / np.where(size > 0, size, 1.0)
        slides = size >= (1 - AT_LIMIT) * line.limit
        state = from_arrays(
            position, m.radius, law, pair_i=m.pair_i, pair_j=m.pair_j, slip=-slip[:, None] * tangential, dim=m.dim,
            mode=np.where(slides, SLIDE, STICK), external_force=m.load, density=density,
        )  # fmt: skip
        held = np.flatnonzero(~m.free)
        state = state._replace(control=fixed(state.control, held)) if len(held) else state
        return state, self._adjustment(change, binding, slides)

    def _adjustment(self, change: np.ndarray, binding: int, slides: np.ndarray) -> Adjustment:
        m, count = self.measured, self.measured.dim * len(self.opened)
        limit = overlap_of_force(self.law, m.radius[m.ends], np.maximum(m.force_n, self.least))[1].limit
        move, force = np.split(change, [m.position.size])
        return Adjustment(
            float(change @ change + self.spent), binding + count, *self._scales,
            float(np.abs(move).max()), float(np.sqrt((move**2).mean())),
            float(np.abs(force).max()), float(np.sqrt((force @ force + self.spent) / (len(force) + count))),
            int(slides.sum()), int((slides & (_sizes(m.force_t) > limit)).sum()), self.opened,
        )  # fmt: skip


def _network(measured: MeasuredForces, law: Law) -> _Network:
    """Network with its errors and the pairs that might touch, without contacts that cannot be balanced."""
    if measured.free.all() and not measured.load.any():
        raise PackingError(
            "no grain is held and there are no loads, so forces under pressure cannot balance: mark the grains at the "
            "edge as fixed"
        )
    m = _with_errors(measured, law)
    _check_limit(m, law)
    reach = 2 * m.radius.max() + NEAR * np.sqrt(2) * m.position_error.max()
    pairs = cKDTree(m.position).query_pairs(reach, output_type="ndarray").T
    wide = m.radius[pairs].sum(axis=0) + NEAR * np.linalg.norm(m.position_error[pairs], axis=0)
    near, n = np.linalg.norm(m.position[pairs[0]] - m.position[pairs[1]], axis=1) < wide, len(m.radius)
    near &= ~np.isin(pairs[0] * n + pairs[1], m.ends.min(axis=0) * n + m.ends.max(axis=0))
    start = np.zeros(m.dim * (len(m.radius) + len(m.force_n)))
    network = _Network(m, law, OPENS * m.force_n.mean(), pairs[:, near], start)
    while (loose := _loose_contacts(network.measured)).any():
        network = network.without(loose, network.start)
    return network


def _loose_contacts(m: MeasuredForces) -> np.ndarray:
    """(C,) mask of the single contacts of free grains; raise PackingError if the force of one exceeds its error."""
    loose = m.free & (np.bincount(m.ends.ravel(), minlength=len(m.radius)) == 1) & ~m.load.any(axis=1)
    rows = loose[m.ends].any(axis=0)
    for c in np.flatnonzero(rows & (m.force_n > FAR * m.force_n_error)):
        grain = m.ids[next(k for k in m.ends[:, c] if loose[k])]
        raise PackingError(
            f"grain {grain} has a single contact, with an unbalanced force of {m.force_n[c]:.4g}: mark the grain as "
            "fixed if it touches a wall, or give its other contacts"
        )
    return rows


class _Directions(NamedTuple):
    """Directions at C contacts for given positions; tangential forces have D − 1 components."""

    normal: np.ndarray  # (C, D) from j to i
    across: np.ndarray  # (C, D − 1, D) unit vectors of the components; in a plane n × z
    twist: np.ndarray  # (C, D) when n changes by dn, the vectors `across` turn about n by twist · dn
    distance: np.ndarray  # (C,)

    @classmethod
    def of(cls, m: MeasuredForces, place: np.ndarray) -> "_Directions":
        """Directions after grains moved: the vectors `across` turn with the normals, by the smallest angle."""
        branch = place[m.pair_i] - place[m.pair_j]
        distance = np.linalg.norm(branch, axis=1)
        normal = branch / distance[:, None]
        if m.dim == 2:
            return cls(normal, np.stack([normal[:, 1], -normal[:, 0]], axis=1)[:, None], 0 * normal, distance)
        first = unit_branches(m)
        one = np.cross(first, np.eye(3)[np.argmin(np.abs(first), axis=1)])
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        axis, share = np.cross(first, normal), 1 + np.einsum("ck,ck->c", first, normal)[:, None]
        across = [
            v + np.cross(axis, v) + np.cross(axis, np.cross(axis, v)) / share for v in (one, np.cross(first, one))
        ]
        return cls(normal, np.stack(across, axis=1), -axis / share, distance)

    def total(self, force_n: np.ndarray, force_t: np.ndarray) -> np.ndarray:
        """(C, D) forces on i."""
        return force_n[:, None] * self.normal + np.einsum("ca,cak->ck", force_t, self.across)

    @property
    def levers(self) -> np.ndarray:
        """(C, 1 or 3, D − 1) torques of unit tangential forces on both grains, divided by their radii: −n × t."""
        if self.normal.shape[1] == 2:
            return np.ones((len(self.normal), 1, 1))
        return -np.cross(self.normal[:, None], self.across).transpose(0, 2, 1)

    def torque(self, force_t: np.ndarray) -> np.ndarray:
        """(C, 1 or 3) torques on both grains, divided by their radii."""
        return np.einsum("cra,ca->cr", self.levers, force_t)

    def force_slopes(self, force_n: np.ndarray, force_t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(C, D, D) and (C, 1 or 3, D): change of forces and torques with the branch vector, at fixed components.

        With dn = (1 − n ⊗ n) dr/r: dt = −n (t · dn) + (n × t) (twist · dn), d(−n × t) = t × dn + t (twist · dn).
        """
        n, t, dim = self.normal, self.total(0 * force_n, force_t), self.normal.shape[1]
        turn = (np.eye(dim) - n[:, :, None] * n[:, None]) / self.distance[:, None, None]
        force = force_n[:, None, None] * turn - n[:, :, None] * np.einsum("ck,ckl->cl", t, turn)[:, None]
        if dim == 2:
            return force, np.zeros((len(n), 1, 2))
        spin = np.einsum("ck,ckl->cl", self.twist, turn)[:, None]
        force = force + np.cross(n, t)[:, :, None] * spin
        return force, np.cross(t[:, :, None], turn, axis=1) + t[:, :, None] * spin


def _components(m: MeasuredForces, to: _Directions) -> np.ndarray:
    """(C, D − 1) components of measured tangential forces."""
    return m.force_t[:, None] if m.dim == 2 else np.einsum("cak,ck->ca", to.across, m.force_t)


def _sizes(force_t: np.ndarray) -> np.ndarray:
    """(C,) sizes of tangential forces."""
    return np.abs(force_t) if force_t.ndim == 1 else np.linalg.norm(force_t, axis=1)


def _facets(force_t: np.ndarray) -> list[np.ndarray]:
    """Directions (C, D − 1) in which tangential forces are limited: ±, or around the cone, the first along the force.

    At convergence, the first facet touches the cone at the force, and the others are inactive.
    """
    if force_t.shape[1] == 1:
        return [np.ones_like(force_t), -np.ones_like(force_t)]
    angle = np.arctan2(force_t[:, 1], force_t[:, 0])
    return [np.stack([np.cos(angle + at), np.sin(angle + at)], axis=1) for at in 2 * np.pi * np.arange(FACETS) / FACETS]


def _blocks(matrices: np.ndarray):
    """(C p, C q) sparse, with the (p, q) matrices of each contact on its diagonal."""
    count, p, q = matrices.shape
    of = sparse.bsr_array((matrices, np.arange(count), np.arange(count + 1)), shape=(count * p, count * q))
    return sparse.csr_array(of)


def _differences(ends: np.ndarray, dim: int, n: int):
    """(D C, D N) sparse, from positions of grains to branch vectors."""
    count = ends.shape[1]
    where = np.tile(np.arange(count), 2), ends.ravel()
    of = sparse.csr_array((np.repeat([1.0, -1.0], count), where), shape=(count, n))
    return sparse.csr_array(sparse.kron(of, sparse.eye_array(dim)))


def _separations(place: np.ndarray, ends: np.ndarray):
    """∂(distance)/∂x of pairs, (P, D N) sparse, and their distances (P,)."""
    branch = place[ends[0]] - place[ends[1]]
    distance = np.linalg.norm(branch, axis=1)
    return _blocks((branch / distance[:, None])[:, None]) @ _differences(ends, place.shape[1], len(place)), distance


def _sums(m: MeasuredForces):
    """(N, C) or (3 N, 3 C) sparse, from torques at contacts to those on grains."""
    count = len(m.pair_i)
    where = m.ends.ravel(), np.tile(np.arange(count), 2)
    both = sparse.csr_array((np.ones(2 * count), where), shape=(len(m.radius), count))
    return sparse.csr_array(sparse.kron(both, sparse.eye_array(1 if m.dim == 2 else 3)))


def _imbalance(m: MeasuredForces) -> np.ndarray:
    """(N, 3 or 6) sums of measured forces and torque/R on every grain."""
    to, n = _Directions.of(m, m.position), len(m.radius)
    force_t = _components(m, to)
    force = _differences(m.ends, m.dim, n).T @ to.total(m.force_n, force_t).ravel()
    return np.column_stack([force.reshape(-1, m.dim) + m.load, (_sums(m) @ to.torque(force_t).ravel()).reshape(n, -1)])


def _with_errors(m: MeasuredForces, law: Law) -> MeasuredForces:
    """Network with missing errors estimated: of positions from gaps, and of forces from imbalance."""
    mean = m.force_n.mean()
    overlap, _ = overlap_of_force(law, m.radius[m.ends], np.maximum(m.force_n, OPENS * mean))
    miss = _separations(m.position, m.ends)[1] + overlap - m.radius[m.ends].sum(axis=0)
    sides = np.bincount(m.ends.ravel(), minlength=len(m.radius))[m.free].sum()
    length = max(np.sqrt((miss**2).mean() / 2), LEAST_ERROR * m.radius.mean())
    rest = _imbalance(m)[m.free]
    force = max(np.sqrt((rest**2).sum() / max(rest.shape[1] * sides, 1)), LEAST_ERROR * mean)
    estimates = {"position_error": length, "force_n_error": force, "force_t_error": force}
    known = {name: getattr(m, name) for name in estimates}
    return m._replace(**{name: np.where(np.isnan(e), estimates[name], e) for name, e in known.items()})


def _check_limit(m: MeasuredForces, law: Law) -> None:
    """Raise PackingError if a tangential force is far beyond the Coulomb limit."""
    mu = law.table[0, 0, MU]
    size = _sizes(m.force_t)
    beyond = (size - mu * m.force_n) / np.hypot(m.force_t_error, mu * m.force_n_error)
    c = int(np.argmax(beyond))
    if beyond[c] > FAR:
        i, j = m.ids[m.ends[:, c]]
        raise PackingError(
            f"grains {i} and {j} touch with a tangential force of {size[c]:.4g} at a normal force of "
            f"{m.force_n[c]:.4g}, {beyond[c]:.2g} errors beyond the Coulomb limit for mu = {mu:g}: check mu and errors"
        )
