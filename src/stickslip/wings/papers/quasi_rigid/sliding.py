"""What critical contacts do in packings of disks: statuses, their stability, their share of Q, and vibrations.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V A.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigvalsh

from .... import SLIDE, Law, State, run
from ....packings import TOP, biaxial_box
from ....quasirigid import with_load
from ...status.apex_status import contact_status
from ...status.complementarity import MAPPED, complementarity
from ...status.matrices import LinearSystem, linear_system, statuses, stiffness_matrix
from ...status.path import load_path
from ...status.system import pinned_coordinates

SOLVED = 6  # critical contacts up to which the eigenvalues of all statuses are computed
SLACK = 1e-9  # relative difference up to which two statuses are equally stable
KICK = 1e-2  # random velocities, in overlaps per time of a contact
TIME, LOOKS, DRAG = 200.0, 200, 0.02  # duration of vibrations, looks at the statuses, drag as in slow dynamics
BURST = 10.0  # kinetic energy over that of the kick that counts as a collapse
PRESSURES = (1e-5, 1e-4, 1e-3)
SMALL = 30  # disks of the packings at several pressures


class SlidingState(NamedTuple):
    """Critical contacts of one state under a load and under its reverse."""

    critical: int
    slide: int  # critical contacts that slide under the load
    reverse: int  # those that slide under the reverse load
    least_eigenvalue: bool | None  # no status has a smaller eigenvalue of sym k than the one in which all slide
    least_determinant: bool | None  # nor a smaller det k
    shares: np.ndarray  # contribution of every sliding contact to Q(v), over Q, for v under the load


def sliding_state(state: State, law: Law, load: np.ndarray) -> SlidingState | None:
    """Compare the statuses of a state; None without critical contacts, or without a consistent status.

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
    """Whether the status in which all critical contacts slide has the smallest eigenvalue of the symmetric part of k.

    None beyond `SOLVED` contacts.
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
    """Whether the status in which all critical contacts slide has the smallest det k(S); None beyond `MAPPED`."""
    if m.limit.sum() > MAPPED:
        return None
    a = complementarity(m, load).matrix
    bits = (np.arange(1 << len(a))[:, None] >> np.arange(len(a))) & 1 > 0
    minors = np.array([np.linalg.det(a[np.ix_(s, s)]) for s in bits])  # det k(S)/det k(nothing slides)
    return bool(minors[-1] <= minors.min() + SLACK * abs(minors.min()))


class Vibration(NamedTuple):
    """Statuses of the critical contacts of a state that is set vibrating."""

    critical: int
    kicked: float  # switches of each of these contacts between sliding and sticking
    still: float  # the same without a kick
    energy: float  # largest kinetic energy after the kick, over that of the kick


def vibrate(state: State, law: Law, seed: int = 0) -> Vibration:
    """Give all disks random velocities under a constant load, and watch the contacts that were critical."""
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
    """Switches of each contact, and the largest kinetic energy over that at the start."""
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
    """Slope of ln(|geometric stiffness|/|k|) against ln(largest overlap), from packings of one seed at three pressures.

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
    """Largest number of critical contacts along a path under a growing force on the lid, and the load at its end."""
    state, law = biaxial_box(disks, seed=seed)
    path = load_path(state, law, with_load(state.control, disks + TOP, 4.0), increment=increment)
    return max(point.sliding for point in path.points), float(path.points[-1].load)
