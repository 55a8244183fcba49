"""Cases for McNamara & Herrmann 2006: constructed statuses, growing motion of one disk, and sliding contacts.

Constructed cases are based on states of real packings, with randomly drawn critical contacts or with contacts at the
apex of the Coulomb cone. In two further cases, one disk moves through a mechanism or an instability, and the growth of
its velocity is predicted. Sliding contacts of packings are examined for status, stability, contribution to Q, and
vibrations.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Secs. III D, III E and V A.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigvals, eigvalsh

from .... import SLIDE, Law, State, accept, assembly, box, disks, flat_walls, forces, run
from ....control import loads
from ....laws import linear
from ....modes import residual_vector
from ....packings import TOP, biaxial_box
from ....quasirigid import with_load
from ...status.apex_status import contact_status, reduce_to_contacts
from ...status.complementarity import MAPPED, complementarity, status_map
from ...status.cone_apex import STATUS_NAMES, Apex, consistent_statuses
from ...status.matrices import LinearSystem, linear_system, statuses, stiffness_matrix
from ...status.path import load_path
from ...status.system import pinned_coordinates
from ...status.uniqueness import certificate
from .simulate import QuasiResult


class StatusCases(NamedTuple):
    """Counts of cases with randomly drawn critical contacts, slip signs and loads."""

    total: int
    p_matrices: int
    agree: int  # number of cases in which A is a P-matrix if and only if the status map is bijective
    none: int  # number of cases without a consistent status
    several: int  # number of cases with two or more consistent statuses


def status_cases(main: QuasiResult, cases: int) -> StatusCases:
    """Draw critical contacts, slip signs and loads for states on the paths; count the cases with a unique status."""
    rng, count, drawn = np.random.default_rng(main.scenario.seed), np.zeros(4, int), 0
    while drawn < cases:
        m = _random_system(main, rng, drawn)
        critical = rng.choice(m.count, int(rng.integers(2, 9)), replace=False)
        m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
        try:
            problem = complementarity(m, rng.normal(size=len(m.free)), critical=critical)
        except LinAlgError:
            continue  # a contact has just opened and released a disk
        whole, mapped = bool(certificate(problem).unique), status_map(problem)
        count += [whole, whole == mapped.bijective, len(mapped.consistent) == 0, len(mapped.consistent) > 1]
        drawn += 1
    return StatusCases(cases, *(int(c) for c in count))


def _random_system(main: QuasiResult, rng, number: int) -> LinearSystem:
    """Linear system for a random state on one sample's path; successive numbers cycle through the samples."""
    sample = main.tested[number % len(main.tested)]
    return linear_system(sample.path.states[int(rng.integers(len(sample.path.points)))], sample.law)


class ApexCases(NamedTuple):
    """Counts of cases in which contacts of real packings are placed at the apex of the Coulomb cone."""

    total: int
    coherent: int  # number of cases in which det k has the same sign for all choices of statuses
    wrong: int  # number of coherent cases without exactly one consistent choice
    several: int  # number of other cases with two or more consistent choices
    none: int  # number of other cases without a consistent choice
    example: tuple[str, ...]  # statuses that are all consistent with one load, without stability


def counterexample(directions: int = 720) -> tuple[str, ...]:
    """Return the largest set of statuses that are simultaneously consistent for one contact in unstable surroundings.

    The stiffness of these surroundings is K_ext = ((1, 0.3), (0.3, 0.1)) in (n, t), with K_n = 1, K_t = 0.5 and μ =
    0.9; the load is rotated through all directions.
    """
    springs = np.diag([1.0, 0.5])
    compliance = np.linalg.inv(np.array([[1.0, 0.3], [0.3, 0.1]]) + springs)
    most = np.zeros((0, 1), int)
    for angle in np.linspace(0, 2 * np.pi, directions, endpoint=False):
        velocity = compliance @ np.array([np.cos(angle), np.sin(angle)])
        apex = Apex(compliance, velocity[None], springs[None], np.array([1.8]), np.zeros(1), np.zeros(1, bool))
        statuses, _ = consistent_statuses(apex)
        most = statuses if len(statuses) > len(most) else most
    return tuple(STATUS_NAMES[status] for status in most[:, 0])


def apex_cases(main: QuasiResult, cases: int) -> ApexCases:
    """Draw one or two contacts at the apex, up to two at the Coulomb limit, and loads; count consistent statuses.

    The counts show whether the four statuses at the apex are mutually exclusive.
    """
    rng, count, drawn = np.random.default_rng(main.scenario.seed + 1), np.zeros(4, int), 0
    while drawn < cases:
        m = _random_system(main, rng, drawn)
        open_ones, critical = int(rng.integers(1, 3)), int(rng.integers(0, 3))
        contacts = rng.choice(m.count, open_ones + critical, replace=False)
        sign = np.append(np.zeros(open_ones), rng.choice([-1.0, 1.0], critical))
        try:
            apex = reduce_to_contacts(m, rng.normal(size=len(m.free)), contacts, sign).apex
        except LinAlgError:
            continue
        statuses, coherent = consistent_statuses(apex)
        number = len(statuses)
        count += [coherent, coherent and number != 1, not coherent and number > 1, not (coherent or number)]
        drawn += 1
    return ApexCases(cases, *(int(c) for c in count), counterexample())


RADIUS, OVERLAP = 0.5, 1e-4  # radius and overlap of the disk [length]; mass, kn and twice the radius are 1
KT, STEEP, FRICTION = 0.5, 20.0, 0.8  # kt; elevation of the normals of a groove with det k(S) < 0 [degrees]; μ
PUSH = 1e-6  # change of the load, relative to the force of a contact
DT, EVERY = 0.02, 10
DECADES = 3.0  # decades of velocity over which a rate is fitted


class Growth(NamedTuple):
    """Speed of one disk against time, and the exponents of its growth."""

    time: np.ndarray  # (T,)
    speed: np.ndarray  # (T,) norm over all coordinates [length/time]
    power: float  # d ln(speed)/d ln(time)
    rate: float  # d ln(speed)/d(time) over the last `DECADES` decades [1/time]
    predicted: float  # √−λ of the lowest eigenvalue λ of m⁻¹k, 0 if none is negative [1/time]


def disk_between_floors(mu: float = FRICTION) -> tuple[State, Law]:
    """Balanced disk between two parallel floors, with both contacts at the Coulomb limit."""
    return _disk_at_limit(np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([1.0, -1.0]), np.ones(2, bool), mu)


def disk_in_groove(mu: float = FRICTION, steep: float = STEEP, make: Callable = linear) -> tuple[State, Law]:
    """Balanced disk in a groove; one contact is at the Coulomb limit, and det k(S) < 0 for the default angle."""
    x, y = np.cos(np.radians(steep)), np.sin(np.radians(steep))
    normals = np.array([[x, y], [-x, y]])
    return _disk_at_limit(normals, np.array([0.0, 1.0]), np.array([False, True]), mu, make)


def _disk_at_limit(
    normals: np.ndarray, sign: np.ndarray, slides: np.ndarray, mu: float, make: Callable = linear
) -> tuple[State, Law]:
    """Disk that touches walls with the given normals (2, 2); contact slips are `sign` times the limit."""
    law = make(1.0, KT, mu, coulomb="sharp")
    walls = flat_walls(-(RADIUS - OVERLAP) * normals, normals)
    state = assembly(disks([[0.0, 0.0]], RADIUS, mass=1.0), walls, box(dim=2), loads(1, 2))
    state = accept(state, forces(state, law)[1])
    contacts = state.contacts
    along = np.stack([normals[:, 1], -normals[:, 0], np.zeros(2)], axis=1)[contacts.j[:2] - 1]
    slip, mode = contacts.slip.copy(), contacts.mode.copy()
    slip[:2] = (sign * mu * OVERLAP / KT)[contacts.j[:2] - 1, None] * along
    mode[:2][slides[contacts.j[:2] - 1]] = SLIDE
    state = state._replace(contacts=contacts._replace(slip=slip, mode=mode), instant=None)
    force, torque = state.control.force.copy(), state.control.torque.copy()
    x, y, turn = residual_vector(state, forces(state, law)[0], linear_system(state, law, rattlers=True).free)
    force[0, :2], torque[0, 2] = (-x, -y), -turn * RADIUS
    return state._replace(control=state.control._replace(force=force, torque=torque)), law


def follow_motion(state: State, law: Law, push: np.ndarray, time: float) -> Growth:
    """Change the load on a balanced disk and follow its motion without any damping.

    Parameters
    ----------
    push : (2,) change of the force on the disk [force]
    """
    m = linear_system(state, law, rattlers=True)
    lowest = float(eigvals(stiffness_matrix(m).toarray() / m.free.mass[:, None]).real.min())
    force = state.control.force.copy()
    force[0, :2] += push
    here, elapsed, speed = state._replace(control=state.control._replace(force=force)), [], []
    for count in range(1, round(time / DT / EVERY) + 1):
        here, _, _ = run(here, law, EVERY, DT)
        elapsed.append(count * EVERY * DT)
        speed.append(float(np.hypot(np.linalg.norm(here.grains.velocity[0]), RADIUS * here.grains.spin[0, 2])))
    t, v = np.array(elapsed), np.array(speed)
    late = v > v[-1] / 10**DECADES
    power, rate = (float(np.polyfit(x, y, 1)[0]) for x, y in ((np.log(t), np.log(v)), (t[late], np.log(v[late]))))
    return Growth(t, v, power, rate, float(np.sqrt(max(-lowest, 0.0))))


def through_mechanism() -> Growth:
    """Growing motion of a disk pushed along two floors."""
    return follow_motion(*disk_between_floors(), PUSH * OVERLAP * np.array([1.0, 0.0]), 100.0)


def through_instability() -> Growth:
    """Growing motion of a disk lifted slightly in a groove, whose contact at the limit must slide."""
    return follow_motion(*disk_in_groove(), PUSH * OVERLAP * np.array([0.0, 1.0]), 30.0)


SOLVED = 6  # largest number of critical contacts for which eigenvalues of all statuses are computed
SLACK = 1e-9  # largest relative difference between two equally stable statuses
KICK = 1e-2  # random velocities, in overlaps per contact time
TIME, LOOKS, DRAG = 200.0, 200, 0.02  # duration of vibrations, number of checks of the statuses, drag of slow dynamics
BURST = 10.0  # kinetic energy, over that of the kick, above which a motion counts as a collapse
PRESSURES = (1e-5, 1e-4, 1e-3)
SMALL = 30  # number of disks in packings that are prepared at several pressures


class SlidingState(NamedTuple):
    """Critical contacts of one state under a load and under its reverse."""

    critical: int
    slide: int  # number of critical contacts that slide under the load
    reverse: int  # number of critical contacts that slide under the reverse load
    least_eigenvalue: bool | None  # True if no status has a smaller eigenvalue of sym k than the one in which all slide
    least_determinant: bool | None  # True if no status has a smaller det k than the one in which all slide
    shares: np.ndarray  # contribution of each sliding contact to Q(v), over Q, for the velocity v under the load


def sliding_state(state: State, law: Law, load: np.ndarray) -> SlidingState | None:
    """Compare the statuses of a state; None if there are no critical contacts, or no consistent status.

    Parameters
    ----------
    load : (n,) rate of the external load [force/time]
    """
    m = linear_system(state, law)
    if not m.limit.any():
        return None
    forth, back = (contact_status(m, sign * load) for sign in (1, -1))
    if not (forth.ok and back.ok):
        return None
    critical = int(m.limit.sum())
    return SlidingState(
        critical, int(forth.sliding.sum()), int(back.sliding.sum()), least_eigenvalue(m),
        least_determinant(m, load), sliding_shares(m, forth.velocity, forth.sliding),
    )  # fmt: skip


def sliding_shares(m: LinearSystem, velocity: np.ndarray, sliding: np.ndarray) -> np.ndarray:
    """Contributions Vᵀ K S V of the sliding contacts to Q(v), over Q (Eq 43)."""
    relative = (m.c.T @ velocity).reshape(-1, 2)
    parts = np.einsum("ma,mab,mb->m", relative, m.springs @ statuses(m, sliding), relative)
    return parts[sliding] / parts.sum()


def least_eigenvalue(m: LinearSystem) -> bool | None:
    """Return True if the status in which all critical contacts slide has the smallest eigenvalue of k's symmetric part.

    None for more than `SOLVED` contacts.
    """
    critical = np.flatnonzero(m.limit)
    if len(critical) > SOLVED:
        return None
    kept = np.setdiff1d(np.arange(len(m.free)), pinned_coordinates(m))

    def lowest(bits: int) -> float:
        sliding = np.zeros(m.count, bool)
        sliding[critical] = (bits >> np.arange(len(critical))) & 1
        k = stiffness_matrix(m, sliding, geometric=False)[kept][:, kept].toarray()
        return float(eigvalsh(0.5 * (k + k.T), subset_by_index=[0, 0])[0])

    values = [lowest(bits) for bits in range(1 << len(critical))]
    return bool(values[-1] <= min(values) + SLACK * abs(min(values)))


def least_determinant(m: LinearSystem, load: np.ndarray) -> bool | None:
    """Return True if the status with all critical contacts sliding has the smallest det k(S); None above `MAPPED`."""
    if m.limit.sum() > MAPPED:
        return None
    a = complementarity(m, load).matrix
    bits = (np.arange(1 << len(a))[:, None] >> np.arange(len(a))) & 1 > 0
    minors = np.array([np.linalg.det(a[np.ix_(s, s)]) for s in bits])  # det k(S)/det k(nothing slides)
    return bool(minors[-1] <= minors.min() + SLACK * abs(minors.min()))


class Vibration(NamedTuple):
    """Statuses of the critical contacts of a vibrating state."""

    critical: int
    kicked: float  # switches per contact between sliding and sticking
    still: float  # switches per contact without a kick
    energy: float  # largest kinetic energy after the kick, over that of the kick


def vibrate(state: State, law: Law, seed: int = 0) -> Vibration:
    """Give all disks random velocities under a constant load, and observe the contacts that were critical."""
    m, grains = linear_system(state, law), state.grains
    stiff = m.springs[:, 0, 0] > 0
    overlap, stiffness = (m.force[stiff, 0] / m.springs[stiff, 0, 0]).mean(), m.springs[stiff, 0, 0].mean()
    size = KICK * float(overlap * np.sqrt(stiffness / grains.mass.mean()))
    velocity = np.zeros_like(grains.velocity)
    velocity[:, :2] = size * np.random.default_rng(seed).normal(size=(len(velocity), 2))
    kicked, keys = state._replace(grains=grains._replace(velocity=velocity)), state.contacts.key[m.rows[m.limit]]
    (switches, energy), (still, _) = _watch(kicked, law, keys), _watch(state, law, keys)
    return Vibration(len(keys), switches, still, energy)


def _watch(state: State, law: Law, keys: np.ndarray) -> tuple[float, float]:
    """Number of switches per contact, and largest kinetic energy over that at the start."""
    start, dt, last, switches = _kinetic_energy(state), 0.1, None, 0
    most = start
    for _ in range(LOOKS):
        state, _, _ = run(state, law, round(TIME / LOOKS / dt), dt, drag=DRAG)
        alive = state.contacts.key[: int(state.contacts.count[0])]
        rows = np.minimum(np.searchsorted(alive, keys), len(alive) - 1)
        slides = (state.contacts.mode[rows] == SLIDE) & (alive[rows] == keys)
        switches += 0 if last is None else int((slides != last).sum())
        last, most = slides, max(most, _kinetic_energy(state))
    return switches / len(keys), most / start if start > 0 else 0.0


def _kinetic_energy(state: State) -> float:
    grains = state.grains
    return float(0.5 * (grains.mass * (grains.velocity**2).sum(axis=1)).sum())


def geometric_slope(seed: int, disks: int = SMALL) -> float:
    """Slope of ln(|geometric stiffness|/|k|) against ln(largest overlap), from one packing at three pressures.

    The norms are the largest singular values.
    """
    rows = []
    for pressure in PRESSURES:
        m = linear_system(*biaxial_box(disks, pressure=pressure, seed=seed))
        k, g = (x.toarray() for x in (stiffness_matrix(m, geometric=False), m.geometric))
        rows.append([(m.force[:, 0] / m.springs[:, 0, 0]).max(), np.linalg.norm(g, 2) / np.linalg.norm(k, 2)])
    overlap, ratio = np.log(rows).T
    return float(np.polyfit(overlap, ratio, 1)[0])


def most_critical(disks: int, seed: int, increment: float = 5e-3) -> tuple[int, float]:
    """Largest number of critical contacts along a path under a growing force on the lid, and the final load."""
    state, law = biaxial_box(disks, seed=seed)
    path = load_path(state, law, with_load(state.control, disks + TOP, 4.0), increment=increment)
    return max(point.sliding for point in path.points), float(path.points[-1].load)
