"""Bonds written plainly (`bonds`) against LAMMPS (`bonds_lammps`) and against closed forms of chains."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.laws import bonds, bonds_lammps

THEIRS = np.load(bonds_lammps.STORE)
CASES = bonds_lammps.CASES


def of(name, key):
    return THEIRS[f"{name}/{key}"]


def loads_at(case, state, pairs, reference):
    """Loads of bonds between spheres in a state, by the plain law."""
    i, j = pairs.T
    place, velocity, spin = state[:, :3], state[:, 3:6], state[:, 6:9]
    pair = bonds_lammps.shortest(place[i] - place[j], case)
    if case.law == "spring":
        rest = np.linalg.norm(reference, axis=1)
        return bonds.spring(pair, velocity[i] - velocity[j], rest, **case.options)
    turned = [Rotation.from_quat(state[k, 9:], scalar_first=True) for k in (i, j)]
    return bonds.rotational(pair, velocity[[i, j]], spin[[i, j]], turned, reference, **case.options)


def summed(n, pairs, on_i, on_j):
    """Loads of spheres from loads of bonds."""
    total = np.zeros((n, 3))
    np.add.at(total, pairs[:, 0], on_i)
    np.add.at(total, pairs[:, 1], on_j)
    return total


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if not case.motion])
def test_loads_are_those_of_lammps(name):
    pairs, state = of(name, "bonds"), of(name, "start")
    ours = loads_at(CASES[name], state, pairs, of(name, "reference"))
    for key, *both in (("force", ours.force_i, ours.force_j), ("torque", ours.torque_i, ours.torque_j)):
        theirs = of(name, key)
        size = max(np.abs(of(name, "force")).max(), np.abs(theirs).max())
        np.testing.assert_allclose(summed(len(state), pairs, *both), theirs, rtol=0, atol=1e-12 * size)
    np.testing.assert_array_equal(ours.share < 1, of(name, "kept"))


def turned_by(quaternion, spin, dt):
    """Quaternions after a step of LAMMPS: two half steps, extrapolated with one whole step."""

    def half_turned(start, by, time):
        w, v = start[:, :1], start[:, 1:]
        rate = np.hstack([-np.sum(by * v, axis=1, keepdims=True), w * by + np.cross(by, v)]) / 2
        return rate * time

    def unit(q):
        return q / np.linalg.norm(q, axis=1, keepdims=True)

    whole = unit(quaternion + half_turned(quaternion, spin, dt))
    middle = unit(quaternion + half_turned(quaternion, spin, dt / 2))
    return unit(2 * unit(middle + half_turned(middle, spin, dt / 2)) - whole)


def moved(name, steps):
    """States at some steps, and steps at which bonds broke, of velocity Verlet with the plain law."""
    case, pairs, reference, dt = CASES[name], of(name, "bonds"), of(name, "reference"), bonds_lammps.STEP
    state, mass, radius = of(name, "start").copy(), of(name, "mass")[:, None], of(name, "radius")[:, None]
    inertia = (0.5 if case.dim == 2 else 0.4) * mass * radius**2
    broken, found = np.full(len(pairs), -1), []

    def accelerations(step):
        kept = broken < 0
        loads = loads_at(case, state, pairs[kept], reference[kept])
        if step > 0:
            broken[np.flatnonzero(kept)[loads.share >= 1]] = step
        force = summed(len(state), pairs[kept], loads.force_i, loads.force_j)
        torque = summed(len(state), pairs[kept], loads.torque_i, loads.torque_j)
        return np.hstack([force / mass, torque / inertia])

    rates = accelerations(0)
    for step in range(max(steps) + 1):
        if step > 0:
            state[:, 3:9] += dt / 2 * rates
            state[:, :3] += dt * state[:, 3:6]
            if case.law == "rotational":
                state[:, 9:] = turned_by(state[:, 9:], state[:, 6:9], dt)
            rates = accelerations(step)
            state[:, 3:9] += dt / 2 * rates
        if step in steps:
            found.append(state.copy())
    return np.array(found), broken
