"""Collapse at the end of a load path: damped dynamics under the final load until the next equilibrium.

Where no stable equilibrium continues the path, the load is raised slightly and then held while the packing moves under
a given drag. A dead load is constant. A body pulled by a spring moves relative to a fixed load point, so a stiff
spring fixes the displacement and a soft one the force. The energy released, the work of the load less the change in
stored energy, is dissipated by friction, dashpots and drag.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eig

from ... import SLIDE, Control, Law, State, Status, accept, forces, freedom, newton, run
from ...control import between, spring_forces
from ...kit import (
    body_positions,
    builtin,
    natural_scales,
    near_zero,
    readable,
    reset_reached,
    resting,
    volume,
    with_neighbor_list,
)
from ...measure import contact_forces, elastic_energy, stable_time_step, touching
from ...results import Factorisation
from .events import APEX, gaps
from .increment import force_scale
from .matrices import linear_system, loose_grains, stiffness_matrix
from .system import external_force, pinned_coordinates, roll_springs

TIME_STEP = 0.1  # time step of dynamics, in units of the longest stable one, as in `slow_dynamics`
RAMP, GENTLY = 25, 200  # number of stages in which the load is raised, and steps per stage
BLOCK, SAMPLE = 5000, 25  # steps between checks of the packing, and between samples of its energy
DURATION, TRAVEL = 1e5, 5.0  # default limits of time, in natural units, and of displacement, in mean diameters
RESTING = (1e-6, 1e-8)  # residuals, over the mean normal force, at which Newton's method is tried
BALANCED = 5e-11  # tolerance of Newton's method, over the mean normal force
ROUND_OFF = 1e-15  # round-off of a stiff spring's force, over its force at an elongation as long as the packing
FAR = 1e3  # largest motion allowed in Newton's method, over the motion that changes a contact force by the residual
NULL = 1e-9  # fraction of the largest stiffness below which an eigenvalue belongs to an unresisted motion
RANK = 1e-8  # singular value below which modes are parallel
DENSE_BELOW, NEAREST = 1200, 12  # number of coordinates below which all modes are computed; number of modes otherwise


@readable(
    head=lambda event: f"collapse at load {event.load:.6g}: {event.largest:.3g} along, {event.released:.3g} released"
)
class Collapse(NamedTuple):
    """Motion from the end of a load path to the next equilibrium, under a constant load.

    Vectors have the coordinates of `freedom(state)`: displacements, R·angle, and ℓ times the strain of a free cell.
    """

    load: float  # load at which the path ended, in legs
    reason: str  # reason for the end of the path
    held: float  # load during the motion, slightly higher, in legs
    quiet: bool  # True if there was no collapse: such a change of load caused as large a motion before
    rests: bool  # True if an equilibrium was found; otherwise numbers describe the state where dynamics ended
    duration: float  # [time]
    steps: int  # number of steps of dynamics
    largest: float  # largest displacement of a grain, relative to the deformation of the cell [length]
    total: float  # root of the sum of squared displacements of the grains [length]
    motion: float  # motion along the load, for example of the loaded wall, or ℓ times the strain [length]
    strain: np.ndarray  # (3, 3) change of the displacement gradient of the cell
    work: float  # work of the loads and springs during the motion [energy]
    released: float  # work less the change in stored energy, which is dissipated [energy]
    kinetic_energy: float  # largest kinetic energy [energy]
    direction: np.ndarray  # (n,) displacement, normalised to unit length, zero for rattlers
    participation: float  # participation of the displacement, (Σ u²)²/(N Σ u⁴) over grains, from 1/N to 1
    eigenvalue: float  # smallest real part of the eigenvalues of k where the path ended [force/length]
    modes: int  # number of unresisted modes where the path ended, or 1 for the softest mode
    overlap: float  # overlap of `direction` with the modes: length of its projection on their span
    lost: int  # number of contacts lost between grains that were not rattlers
    gained: int  # number of contacts gained between such grains
    sliding: tuple[int, int]  # number of contacts at the Coulomb limit before and after


class Motion(NamedTuple):
    """Damped dynamics from a state."""

    state: State  # state at the end, without velocities
    rests: bool
    steps: int
    time: float  # [time]
    kinetic_energy: float  # largest kinetic energy [energy]
    work: float  # work of loads, springs and the stress on a free cell [energy]


class _Dynamics:
    """State that moves under drag, and the quantities measured so far."""

    def __init__(self, state: State, law: Law, drag: float):
        self.start, self.law, self.drag, self.held = state, law, drag, _held_bodies(state)
        limit = stable_time_step(state, law)
        limit = limit if np.isfinite(limit) else natural_scales(state, law).time  # without contacts
        self.state, self.dt = _still(state), TIME_STEP * limit
        self.steps, self.energy, self.work = 0, 0.0, 0.0

    def run(self, steps: int, tolerance: float = 0.0) -> Status:
        """Run the dynamics; return the outcome."""
        before, (self.state, record, outcome) = self.state, run(
            self.state, self.law, steps, self.dt, drag=self.drag, every=SAMPLE, tolerance=tolerance
        )  # fmt: skip
        self.steps += outcome.iterations
        self.energy = max(self.energy, float(record.kinetic_energy.max(initial=0.0)))
        self.work += _work_of_loads(before, self.state) + _work_on_cell(record.cell, before)
        return outcome.status

    @property
    def farthest(self) -> float:
        """Largest displacement of a body that was not a rattler [length]."""
        return float(np.linalg.norm(displacements(self.start, self.state)[self.held, :3], axis=1).max(initial=0.0))

    def motion(self, state: State, rests: bool) -> Motion:
        """Return the result of the run."""
        return Motion(state, rests, self.steps, self.steps * self.dt, self.energy, self.work)


def run_to_rest(
    state: State, law: Law, control: Control, drag: float, duration: float | None = None, travel: float | None = None
) -> Motion:
    """Run damped dynamics under a control until the packing is at rest or exceeds a limit of time or displacement.

    Loads change to those of the control so slowly that a stiff spring causes no jolt. Newton's method only removes the
    remaining unbalanced forces.

    Parameters
    ----------
    drag : drag on translations and rotations [1/time]
    duration : longest time; default: 1e5 natural units [time]
    travel : largest displacement of a body other than a rattler; default: 5 mean diameters [length]
    """
    duration = DURATION * natural_scales(state, law).time if duration is None else duration
    travel = TRAVEL * 2 * float(state.grains.radius.mean()) if travel is None else travel
    here, force = _Dynamics(state, law, drag), force_scale(state, law, external_force(state, freedom(state)))
    for share in np.arange(1, RAMP + 1) / RAMP:
        here.state = here.state._replace(control=between(state.control, control, float(share)))
        if here.run(GENTLY) is not Status.DONE:
            return here.motion(_still(here.state), False)
    noise = ROUND_OFF * float(np.abs(control.spring * control.anchor).max()) / force
    for share in np.maximum(RESTING, 4 * noise):
        while (status := here.run(BLOCK, float(share) * force)) is not Status.CONVERGED:
            late = here.steps * here.dt >= duration or not here.farthest < travel
            if late or status is not Status.STEPS_SPENT:
                return here.motion(_still(here.state), False)
        now = here.state.contacts
        rest = _still(here.state)._replace(contacts=reset_reached(now), time=state.time)
        end, outcome = newton(rest, law, tolerance=max(BALANCED, noise) * force, keep=Factorisation())
        near = FAR * share * force / float(law.table[..., builtin.KT].min())
        if outcome.ok and np.abs(displacements(rest, end)[_held_bodies(rest)]).max(initial=0.0) < near:
            rest = end
            break
    rest = with_neighbor_list(rest, law)
    return here.motion(accept(rest, forces(rest, law)[1]), True)


def describe_collapse(before: State, motion: Motion, law: Law, pull: np.ndarray, predicted: float, **known) -> Collapse:
    """Describe the collapse between two states.

    Parameters
    ----------
    before : state at the end of the path
    pull : (n,) rate of the load on the coordinates of `freedom(before)`, up to a factor
    predicted : displacement below which the motion does not count as a collapse [length]
    known : the fields `load`, `reason` and `held` of the result
    """
    after, free, loose = motion.state, freedom(before), loose_grains(before, loaded=False)
    strain = _strain(before, after)
    moved = without_drift(before, displacements(before, after))
    full = np.append(moved.ravel(), free.length * strain.ravel())
    field = full[free.component]
    square = (moved[: len(loose), :3][~loose] ** 2).sum(axis=1)
    size, total = float(np.linalg.norm(field)), float(np.sqrt(square.sum()))
    value, modes, sliding = soft_modes_where_it_ends(before, law)
    direction = field / size if size else field
    held = [_loaded_contacts(state) for state in (before, after)]
    gain = stored_energy(after, law) - stored_energy(before, law)
    return Collapse(
        **known, quiet=bool(total <= predicted), rests=motion.rests, duration=motion.time, steps=motion.steps,
        largest=float(np.sqrt(square.max(initial=0.0))), total=total,
        motion=float(field @ pull / np.linalg.norm(pull)) if pull.any() else 0.0, strain=strain, work=motion.work,
        released=motion.work - gain, kinetic_energy=motion.kinetic_energy, direction=direction,
        participation=float(total**4 / (len(square) * (square**2).sum())) if total else 1.0, eigenvalue=value,
        modes=modes.shape[1], overlap=float(np.linalg.norm(direction @ modes)),
        lost=len(held[0].keys() - held[1].keys()), gained=len(held[1].keys() - held[0].keys()),
        sliding=(sliding, sum(held[1].values())),
    )  # fmt: skip


def soft_modes_where_it_ends(state: State, law: Law) -> tuple[float, np.ndarray, int]:
    """Return the smallest real part of the eigenvalues of k(S), and the unresisted modes or, if none, the softest mode.

    In S, all contacts at the limit slide, and those without force are open.

    Returns
    -------
    float, (n, K) orthonormal basis on the coordinates of `freedom(state)`, number of sliding contacts
    """
    m, whole = linear_system(state, law, bonds="elastic"), freedom(state)
    mean = float(m.force[:, 0].mean()) if m.count else 0.0
    faint = m.force[:, 0] <= APEX * mean
    slides = ~faint & (m.limit | (m.margin <= APEX * mean))
    m = m._replace(springs=np.where(faint[:, None, None], 0.0, m.springs))
    kept = np.setdiff1d(np.arange(len(m.free)), pinned_coordinates(m))
    if not len(kept):
        return np.nan, np.zeros((len(whole), 0)), 0
    part = sparse.csr_array(stiffness_matrix(m, slides) + roll_springs(m))[kept][:, kept]
    try:
        values, modes = eig(part.toarray()) if len(kept) < DENSE_BELOW else near_zero(part, NEAREST, 1e-6)[:2]
    except (LinAlgError, RuntimeError):
        return np.nan, np.zeros((len(whole), 0)), int(slides.sum())
    unresisted = values.real <= NULL * np.abs(part.data).max()
    unresisted[np.argmin(values.real)] = True
    parts = np.concatenate([modes[:, unresisted].real, modes[:, unresisted].imag], axis=1)
    base, sizes, _ = np.linalg.svd(parts, full_matrices=False)
    out = np.zeros((len(whole), int((sizes > RANK).sum())))
    out[np.searchsorted(whole.component, m.free.component[kept])] = base[:, sizes > RANK]
    return float(values.real.min()), out, int(slides.sum())


def stored_energy(state: State, law: Law) -> float:
    """Return the energy of bonds and of the contact springs of a law that is linear in the overlap [energy]."""
    rows = touching(state)
    push, normal = contact_forces(state._replace(bonds=None), law)[rows], gaps(state, rows)[0]
    along = push - np.einsum("ck,ck->c", push, normal)[:, None] * normal
    material = np.concatenate([state.grains.material, state.walls.material])
    k_t = law.table[material[state.contacts.i[rows]], material[state.contacts.j[rows]], builtin.KT]
    return elastic_energy(state, law) + float(((along**2).sum(axis=1) / (2 * k_t)).sum())


def _work_of_loads(before: State, after: State) -> float:
    """Work of forces, torques, gravity and springs between two states [energy]."""
    control, n = before.control, len(before.grains.radius)
    start, end = body_positions(before), body_positions(after)
    mass = np.append(before.grains.mass, before.walls.mass)
    pull = 0.5 * (spring_forces(control, start, before.time) + spring_forces(control, end, before.time))
    turned = (control.torque[:n] * (after.grains.angle - before.grains.angle)).sum()
    return float(((control.force + pull + mass[:, None] * control.gravity) * (end - start)).sum() + turned)


def _work_on_cell(cells: np.ndarray, state: State) -> float:
    """Work of the stress on a free cell whose vectors (T, 3, 3) were sampled [energy]."""
    if not state.control.cell_free.any() or len(cells) < 2:
        return 0.0
    size = np.array([volume(state._replace(cell=state.cell._replace(vectors=v))) for v in cells])
    steps = 2 * np.linalg.solve(cells[1:] + cells[:-1], np.diff(cells, axis=0)).transpose(0, 2, 1)
    return -float(0.5 * (size[1:] + size[:-1]) @ (steps * state.control.stress).sum(axis=(1, 2)))


def displacements(before: State, after: State) -> np.ndarray:
    """Displacements and R·angle of all bodies (B, 6), relative to the deformation of the cell [length]."""
    a, b = before.grains, after.grains
    moved = b.position - a.position - a.position @ _strain(before, after).T
    grains = np.concatenate([moved, (b.angle - a.angle) * a.radius[:, None]], axis=1)
    walls = after.walls.point - before.walls.point
    return np.concatenate([grains, np.concatenate([walls, np.zeros_like(walls)], axis=1)])


def without_drift(state: State, moved: np.ndarray) -> np.ndarray:
    """Return displacements (B, 6): zero for rattlers; along unsupported axes, relative to the mean of other bodies."""
    held = _held_bodies(state)
    moved = moved * held[:, None]
    if not len(state.walls.mass) and held.any():
        unheld = np.append(state.control.free[:, :3].all(axis=0), [False] * 3)
        moved -= np.outer(held, np.where(unheld, moved[held].mean(axis=0), 0.0))
    return moved


def _strain(before: State, after: State) -> np.ndarray:
    """Return the displacement gradient (3, 3) of the cell between two states."""
    return np.linalg.solve(before.cell.vectors, after.cell.vectors).T - np.eye(3)


def _held_bodies(state: State) -> np.ndarray:
    """Return the mask (B,) of walls and of grains that are not rattlers."""
    return np.append(~loose_grains(state, loaded=False), np.ones(len(state.walls.mass), bool))


def _loaded_contacts(state: State) -> dict[int, bool]:
    """Return, for the key of each contact between bodies that are not rattlers, whether it slides."""
    rows, held, contacts = touching(state), _held_bodies(state), state.contacts
    rows = rows[held[contacts.i[rows]] & held[contacts.j[rows]]]
    return dict(zip(contacts.key[rows].tolist(), (contacts.mode[rows] == SLIDE).tolist(), strict=True))


def _still(state: State) -> State:
    """Return the state at rest, without velocities."""
    return resting(state)._replace(instant=None)
