"""Energy ledger, updated after every step. It does not affect the trajectory.

Over a step from 0 to 1, velocity Verlet changes the kinetic energy by ½(F₀ + F₁)·Δx up to the change of a function of
state, so that trapezoidal sums balance to second order in the time step. With the energy U(|s|, k_t, L) of a tangential
spring and the Coulomb limit L,

    −F_t·v_t dt = dU − ∂U/∂k_t dk_t − ∂U/∂L dL + |F_t| d(slid distance):

F_t has no potential, and the terms in ∂U are the energy that a contact creates or destroys when it is sheared at one
overlap and released at another. These terms have a separate column. That column also contains the energy destroyed by
laws that shorten the slip as the overlap decreases, −|F_t| |s| d ln f with f the factor applied to the slip.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..contacts.forces import Bodies
from ..contacts.geometry import (
    at_contact,
    mid_normal,
    normal_and_overlap,
    onto_plane,
    pair_vector,
    shifts,
    slip_increment,
    surface_rotation,
)
from ..contacts.mechanics import (
    contact_radius_ratio,
    effective_values,
    normal_force_and_limit,
    tangential_force,
    with_tangential_dashpot,
)
from ..contacts.rolling import add_rolling_energy
from ..contacts.rows import add_gradient, relative_motion
from ..control import spring_forces
from ..laws.builtin import DAMPING_T, SMOOTH, damping_model
from ..laws.oracle import normal_energy, reach, rescaling_flag, row, tangential_stiffness
from ..options import INNER
from ..readable import readable
from ..state import OPEN
from .coefficients import Plan

COLUMNS = ("kinetic", "normal", "tangential", "external", "coulomb", "viscous", "drag", "nonpotential")
_KINETIC, _NORMAL, _TANGENTIAL, _EXTERNAL, _COULOMB, _VISCOUS, _DRAG, _NONPOTENTIAL = range(8)


@readable
class Ledger(NamedTuple):
    """Energies at T samples, and work and dissipation since the start of the run [energy]."""

    kinetic: np.ndarray  # (T,) of grains and walls, translations and rotations
    normal: np.ndarray  # (T,) stored in normal springs
    tangential: np.ndarray  # (T,) stored in tangential springs
    external: np.ndarray  # (T,) work of forces, springs, torques, gravity, driven bodies, and the cell
    coulomb: np.ndarray  # (T,) dissipated by sliding
    viscous: np.ndarray  # (T,) dissipated by dashpots
    drag: np.ndarray  # (T,) dissipated by drag
    # (T,) created (negative: destroyed) by tangential springs whose stiffness changed or whose slip was rescaled
    nonpotential: np.ndarray

    @property
    def defect(self) -> np.ndarray:
        """Energy stored + dissipated − supplied, less its initial value, (T,): zero up to the integration error."""
        stored = self.kinetic + self.normal + self.tangential
        total = stored + self.coulomb + self.viscous + self.drag - self.external - self.nonpotential
        return total - total[0]


@njit(cache=True, fastmath=False, error_model="numpy", **INNER)
def _evaluate_contact(kind, coulomb, dim, viscous, rate, p, b, i, j, shift, c, slip, known):
    """Evaluate a contact at one end of a step.

    Returns overlap plus reach, (n, 1/|r|), stored energies of both springs, (k_t, L, ∂U/∂k_t, ∂U/∂L), |F_t|, power of
    the dashpots, force and torque/R.
    """
    n_grains = len(b.radius) - len(b.normal)
    rx, ry, rz = pair_vector(dim, b.position, shift, c, i, j)
    nx, ny, nz, overlap, inverse = normal_and_overlap(i, j, j >= n_grains, j - n_grains, b.radius, b.normal, rx, ry, rz)
    q = row(kind, p, b.material[i], b.material[j])
    r_eff, m_eff = effective_values(kind, viscous, b.radius, b.inverse_mass, i, j, j >= n_grains)
    edge = reach(kind, q, r_eff)
    if overlap <= -edge:
        stiffness, none = tangential_stiffness(kind, q, r_eff, 0.0 - edge), (0.0, 0.0, 0.0)
        return overlap + edge, (nx, ny, nz, inverse), 0.0, 0.0, (stiffness, 0.0, 0.0, 0.0), 0.0, 0.0, none, none
    stiffness = tangential_stiffness(kind, q, r_eff, overlap)
    sx, sy, sz = (slip[0], slip[1], slip[2]) if known else (0.0, 0.0, 0.0)
    square = sx * sx + sy * sy + sz * sz
    vn = vx = vy = vz = 0.0
    if viscous:
        ux, uy, uz = surface_rotation(dim, b.spin, b.radius, i, j)
        vx, vy, vz = add_gradient(b.rate, rx, ry, rz, *relative_motion(dim, b.velocity, i, j))
        vx, vy, vz = at_contact(nx, ny, nz, vx, vy, vz, ux, uy, uz)
        vn = vx * nx + vy * ny + vz * nz
        vx, vy, vz = vx - vn * nx, vy - vn * ny, vz - vn * nz
    elastic, fn, factor, limit = normal_force_and_limit(kind, viscous, rate, True, q, r_eff, m_eff, overlap, vn)
    power = (elastic - fn) * vn
    tx, ty, tz = tangential_force(coulomb, stiffness, limit, sx, sy, sz)
    spring = np.sqrt(tx * tx + ty * ty + tz * tz)
    energy, by_stiffness, by_limit = 0.5 * stiffness * square, 0.5 * square, 0.0
    if coulomb == SMOOTH and limit > 0.0:  # ∫ k s (1 + x − x²) ds, x = k s/limit
        x = stiffness * np.sqrt(square) / limit
        energy = stiffness * square * (0.5 + x / 3 - x * x / 4)
        by_stiffness = square * (0.5 + x / 3 - x * x / 4 + x * (1 / 3 - x / 2))
        by_limit = -stiffness * square * x * (1 / 3 - x / 2) / limit
    spends = (stiffness, limit, by_stiffness, by_limit)
    if viscous:
        ux, uy, uz = with_tangential_dashpot(tx, ty, tz, factor * q[DAMPING_T], limit, vx, vy, vz)
        power -= (ux - tx) * vx + (uy - ty) * vy + (uz - tz) * vz
        tx, ty, tz = ux, uy, uz
    force = (fn * nx + tx, fn * ny + ty, fn * nz + tz)
    turn = (nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty)
    stored = normal_energy(kind, q, r_eff, overlap)
    return overlap + edge, (nx, ny, nz, inverse), stored, energy, spends, spring, power, force, turn


@njit(cache=True, **INNER)
def _length(s):
    return np.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])


@njit(cache=True, fastmath=False, error_model="numpy")
def _add_contacts(
    kind, coulomb, dim, viscous, p, old, new, before, after, shift0, shift, way, strain, free, dt, first, rate,
    rescaled, row,
):  # fmt: skip
    """Add one step of all contacts to the row, or, with `first`, only their stored energies; `rate`: see `run`."""
    m, nothing = 0, np.zeros(3)
    for c in range(after.count[0]):
        while m < before.count[0] and before.key[m] < after.key[c]:
            m += 1
        same = m < before.count[0] and before.key[m] == after.key[c]
        known = same and before.mode[m] != OPEN
        i, j = after.i[c], after.j[c]
        mine = before.slip[m] if same else nothing
        closed = after.mode[c] != OPEN
        depth, (nx, ny, nz, inverse), stored, energy, spends, spring, power, force, turn = _evaluate_contact(
            kind, coulomb, dim, viscous, rate, p, new, i, j, shift, c, after.slip[c], closed
        )
        row[_NORMAL] += stored
        row[_TANGENTIAL] += energy
        depth0, _, _, energy0, spends0, spring0, power0, force0, turn0 = _evaluate_contact(
            kind, coulomb, dim, viscous, rate, p, old, i, j, shift0, c, mine, known
        )
        # fraction of the step during which a closing or opening contact has touched; LAMMPS counts the whole step
        whole = rate or known == closed or depth == depth0
        fraction = 1.0 if whole else max(depth, depth0) / abs(depth - depth0)
        a0, a1 = pair_vector(dim, old.position, shift0, c, i, j), pair_vector(dim, new.position, shift, c, i, j)
        dx, dy, dz = a1[0] - a0[0], a1[1] - a0[1], a1[2] - a0[2]
        mx, my, mz = mid_normal(nx, ny, nz, 0.0 if rate else inverse, dx, dy, dz)
        normals = (nx, ny, nz, mx, my, mz)
        add_rolling_energy(
            kind, dim, p, old, new, shift0, shift, normals, fraction, before, m, after, c, i, j, known, closed, free,
            first, (_TANGENTIAL, _COULOMB, _NONPOTENTIAL, _EXTERNAL), row,
        )  # fmt: skip
        if first:
            continue
        if rescaled is not None:
            fade = contact_radius_ratio(depth, depth - depth0) if known and closed else 1.0
            row[_NONPOTENTIAL] += 0.5 * (spring * _length(after.slip[c]) + spring0 * _length(mine)) * np.log(fade)
            if known and not closed:  # the slip has vanished: replaces the terms that follow
                row[_NONPOTENTIAL] += 0.5 * (spends0[0] * spends0[2] + spends0[1] * spends0[3]) - energy0
        for k in range(2):
            row[_NONPOTENTIAL] += 0.5 * (spends[2 + k] + spends0[2 + k]) * (spends[k] - spends0[k])
        row[_VISCOUS] += 0.5 * dt * (power + power0)
        for k in range(3):
            for q in range(3):
                row[_EXTERNAL] -= 0.5 * (force[k] * a1[q] + force0[k] * a0[q]) * strain[k, q]
        if known or closed:
            w0, w1 = (
                surface_rotation(dim, old.angle, old.radius, i, j),
                surface_rotation(dim, new.angle, new.radius, i, j),
            )
            sx, sy, sz = onto_plane(*normals, mine[0], mine[1], mine[2])
            dx, dy, dz = slip_increment(*normals, dx, dy, dz, w1[0] - w0[0], w1[1] - w0[1], w1[2] - w0[2])
            s = after.slip[c]
            if rescaled is not None:
                half = 1.0 if rate else 0.5 * (1.0 + fade)
                sx, sy, sz, dx, dy, dz = fade * sx, fade * sy, fade * sz, half * dx, half * dy, half * dz
            sx, sy, sz = sx + fraction * dx - s[0], sy + fraction * dy - s[1], sz + fraction * dz - s[2]
            slid = np.sqrt(sx * sx + sy * sy + sz * sz)
            if rescaled is not None:
                slid = slid / half if closed else 0.0  # the slid distance was shortened like the slip
            row[_COULOMB] += 0.5 * (spring + spring0) * slid
        for end in range(2):
            a, sign = (i, 1.0) if end == 0 else (j, -1.0)
            for k in range(3):
                if not free[a, k]:
                    row[_EXTERNAL] -= 0.5 * sign * (force[k] + force0[k]) * way[a, k]
                if not free[a, 3 + k]:
                    turned = new.radius[a] * (new.angle[a, k] - old.angle[a, k])
                    row[_EXTERNAL] -= 0.5 * (turn[k] + turn0[k]) * turned


@njit(cache=True, fastmath=False)
def _add_bodies(old, new, mass, inertia, external, way, strain, free, drag, spin_drag, dt, first, row):
    """Add kinetic energy, and one step of external work and drag, to the row."""
    for a in range(len(mass)):
        for k in range(3):
            v, w = new.velocity[a, k], new.spin[a, k]
            row[_KINETIC] += 0.5 * mass[a] * v * v + 0.5 * inertia[a] * w * w
            if first:
                continue
            v0, w0 = old.velocity[a, k], old.spin[a, k]
            for q in range(3):
                flux = v * new.velocity[a, q] + v0 * old.velocity[a, q]
                row[_EXTERNAL] -= 0.5 * mass[a] * flux * strain[k, q]
            if free[a, k]:
                row[_EXTERNAL] += external[0, a, k] * way[a, k]
                row[_DRAG] += 0.5 * dt * drag * mass[a] * (v * v + v0 * v0)
            if free[a, 3 + k]:
                row[_EXTERNAL] += external[1, a, k] * (new.angle[a, k] - old.angle[a, k])
                row[_DRAG] += 0.5 * dt * spin_drag * inertia[a] * (w * w + w0 * w0)


class Books(NamedTuple):
    """Data for posting one step: the state before it, and the running row."""

    bodies: Bodies
    contacts: tuple
    vectors: np.ndarray  # (3, 3) of the cell
    pull: np.ndarray  # (B, 3) forces of springs
    row: np.ndarray  # (len(COLUMNS),)
    rows: np.ndarray  # (T, len(COLUMNS))
    rate: bool  # True with `slip_update="rate"`


def open_books(samples: int, bodies: Bodies, state, rate: bool) -> Books:
    """Open the books before the first entry."""
    row, rows = np.zeros(len(COLUMNS)), np.zeros((samples, len(COLUMNS)))
    pull = spring_forces(state.control, bodies.position, state.time)
    return Books(_copy(bodies), _copy(state.contacts), state.cell.vectors, pull, row, rows, rate)


def post_step(books: Books, law, state, plan: Plan, here: Bodies, contacts, step: int, every: int) -> Books:
    """Post one step, from the state in the books to `here` and `contacts`, which are not modified."""
    row, first, viscous, old, vectors = books.row, step == 0, damping_model(law), books.bodies, state.cell.vectors
    strain = np.zeros((3, 3))
    if (vectors != books.vectors).any():  # dt L of the step that moved the cell
        strain = 2 * np.linalg.solve((vectors + books.vectors), vectors - books.vectors).T
    way = here.position - old.position - 0.5 * (here.position + old.position) @ strain.T
    row[[_KINETIC, _NORMAL, _TANGENTIAL]] = 0.0
    free, b, n = state.control.free, state.n_bodies, len(plan.mass)
    mass = np.append(plan.mass, state.walls.mass)
    inertia = np.append(plan.inertia, np.zeros(b - n))
    pull = spring_forces(state.control, here.position, state.time + step * plan.dt)
    loads = np.stack([plan.external[0] + 0.5 * (pull + books.pull), plan.external[1]])
    _add_bodies(old, here, mass, inertia, loads, way, strain, free, *plan.drags, plan.dt, first, row)
    _add_contacts(
        law.kind, law.coulomb, state.cell.dim, viscous, law.table, old, here, books.contacts, contacts,
        shifts(contacts, books.vectors), shifts(contacts, vectors), way, strain, free, plan.dt, first,
        books.rate, rescaling_flag(law.kind), row,
    )  # fmt: skip
    if step % every == 0:
        books.rows[step // every] = row
    return books._replace(bodies=_copy(here), contacts=_copy(contacts), vectors=vectors, pull=pull)


def _copy(record):
    return type(record)(*(value.copy() if isinstance(value, np.ndarray) else value for value in record))


def make_ledger(books: Books, kept: int) -> Ledger:
    """Make the ledger from the first `kept` samples."""
    return Ledger(*books.rows[:kept].T)
