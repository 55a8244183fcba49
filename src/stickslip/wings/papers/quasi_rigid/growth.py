"""Motion of one disk through a mechanism, and through an instability, with growth that can be computed beforehand.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. III D and E.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigvals

from .... import SLIDE, Law, State, accept, assembly, box, disks, flat_walls, forces, run
from ....control import loads
from ....laws import linear
from ....modes import residual_vector
from ...status.matrices import linear_system, stiffness_matrix

RADIUS, OVERLAP = 0.5, 1e-4  # of the disk [length]; mass, kn and twice the radius are 1
KT, STEEP, FRICTION = 0.5, 20.0, 0.8  # kt; elevation of the normals of a groove in which det k(S) < 0 [degrees]; μ
PUSH = 1e-6  # change of the load, relative to the force of a contact
DT, EVERY = 0.02, 10
DECADES = 3.0  # of velocity over which a rate is fitted


class Growth(NamedTuple):
    """Speed of one disk against time, and the exponents of its growth."""

    time: np.ndarray  # (T,)
    speed: np.ndarray  # (T,) of all coordinates together [length/time]
    power: float  # d ln(speed)/d ln(time)
    rate: float  # d ln(speed)/d(time) over the last `DECADES` decades [1/time]
    predicted: float  # √−λ of the lowest eigenvalue λ of m⁻¹k, 0 without a negative one [1/time]


def disk_between_floors(mu: float = FRICTION) -> tuple[State, Law]:
    """Disk between two parallel floors with both contacts at the Coulomb limit, in balance."""
    return _disk_at_limit(np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([1.0, -1.0]), np.ones(2, bool), mu)


def disk_in_groove(mu: float = FRICTION, steep: float = STEEP, make: Callable = linear) -> tuple[State, Law]:
    """Disk in a groove, in balance; one contact is at the Coulomb limit, and det k(S) < 0 for the default angle."""
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
    """Change the load on a disk in balance and follow its motion without any damping.

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
    return Growth(
        t, v, _slope(np.log(t), np.log(v)), _slope(t[late], np.log(v[late])), float(np.sqrt(max(-lowest, 0.0)))
    )  # fmt: skip


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    return float(np.polyfit(x, y, 1)[0])


def through_mechanism() -> Growth:
    """Growth of a disk between two floors that is pushed along them."""
    return follow_motion(*disk_between_floors(), PUSH * OVERLAP * np.array([1.0, 0.0]), 100.0)


def through_instability() -> Growth:
    """Growth of a disk in a groove that is lifted a little: the contact at the limit must slide."""
    return follow_motion(*disk_in_groove(), PUSH * OVERLAP * np.array([0.0, 1.0]), 30.0)
