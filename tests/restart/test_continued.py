"""A run that is stopped, written, read and continued is the run, to the last bit: laws, memories, controls, threads."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.state import PER_PAIR
from stickslip.data import archive
from stickslip.loading.packing import jammed
from tests.conftest import make_law

DASHPOTS = {"damping_n": 0.3, "damping_t": 0.15}
LAWS = {
    "hertz_mindlin sharp": make_law("hertz_mindlin", "sharp"),
    "hertz_mindlin smooth": make_law("hertz_mindlin", "smooth"),
    "linear sharp": make_law("linear", "sharp"),
    "linear smooth mass": make_law("linear", "smooth", damping="mass_velocity", damping_n=0.02, damping_t=0.01),
    "reff sharp": make_law("hertz_mindlin_reff", "sharp"),
    "reff sharp viscoelastic": make_law("hertz_mindlin_reff", "sharp", **DASHPOTS),
    "reff sharp no tension": make_law("hertz_mindlin_reff", "sharp", **DASHPOTS, tension=False),
}


@cache
def flowing(n, dim, seed=0):
    """A packing with random velocities and spins, in which contacts open, close and slide within 100 steps."""
    state, _ = jammed(n, packing_fraction=0.66 if dim == 3 else 0.86, dim=dim, seed=seed)
    velocity, spin = np.random.default_rng(seed).normal(0, 0.01, (2, n, 3))
    if dim == 2:
        velocity[:, 2] = spin[:, :2] = 0
    return ss.assembly(state.grains._replace(velocity=velocity, spin=spin), cell=state.cell, skin=0.1)


def bounded(state):
    """The same between two walls across y, the upper one pressed, both with friction of their own."""
    n, size, dim = len(state.grains.radius), state.cell.vectors[1, 1], state.cell.dim
    inside = np.mod(state.grains.position, size)
    walls = ss.flat_walls([[0, 0, 0], [0, size, 0]], [[0, 1, 0], [0, -1, 0]], mass=[1.0, 3.0], material=1)
    control = ss.control.force_controlled(ss.control.loads(n, 2, gravity=(0, -1e-4, 0)), [n + 1], [0, -1e-3])
    cell = state.cell._replace(periodic=np.array([True, False, dim == 3]))
    return ss.assembly(state.grains._replace(position=inside), walls, cell, control, skin=0.1)


def free(state):
    return state


def shaken(state):
    state = bounded(state)
    n = len(state.grains.radius)
    control = ss.control.driven(state.control, [n], [0.02, 0, 0, 0, 0, 0])
    times = np.linspace(0, 6, 25)
    return state._replace(control=ss.control.time_dependent(control, [n], times, np.cos(times), axes=[0]))


def plate(state):
    """A rigid plate of grains that is pressed along y and pulled along x by a spring to a moving load point."""
    state = bounded(state)
    n, position = len(state.grains.radius), state.grains.position
    members = np.argsort(position[:, 1])[-n // 8 :]
    control = ss.control.force_controlled(ss.control.rigid(state.control, members), members, [0, -1e-4])
    if state.cell.dim == 3:
        control.free[members, 2] = False
    course = {"times": [0.0, 3.0, 5.0], "displacement": [0.0, 0.3, 0.3]}
    return state._replace(control=ss.control.spring_loaded(control, members, position[members], 0.3, **course))


def sheared(state):
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 0.01
    control = ss.control.strained_at(state.control, gradient)
    return state._replace(control=ss.control.time_dependent(control, "cell", [0.0, 2.0, 4.0], [0.5, 1.0, 0.8]))


def breathing(state):
    return state._replace(control=ss.control.stress_controlled(sheared(state).control, {"yy": 2e-3}))


CONTROLS = (
    (bounded, 30, 0.01), (bounded, 150, 0.0), (shaken, 150, 0.01), (plate, 150, 0.0), (plate, 30, 0.01),
    (sheared, 150, 0.0), (breathing, 150, 0.01), (breathing, 30, 0.0),
)  # fmt: skip
SHARP, VISCOUS = "hertz_mindlin sharp", "reff sharp viscoelastic"
# law, dimension, grains (30: the plain loop, 150: blocks), control, memory, drag
FAST = [
    *((VISCOUS, 3, n, c, "difference", drag) for c, n, drag in CONTROLS if (c, n) in ((bounded, 30), (bounded, 150))),
    (SHARP, 3, 150, free, "rate", 0.0),
    *((law, dim, 150, free, "difference", 0.0) for law in LAWS for dim in (2, 3)),
    *((law, 3, n, control, "difference", drag) for law, (control, n, drag) in zip(LAWS, CONTROLS, strict=False)),
]
SLOW = [
    *((law, dim, n, free, "difference", 0.0) for law in LAWS for dim, n in ((3, 150), (2, 150), (3, 30), (2, 30))),
    *((law, dim, 150, free, "rate", 0.0) for law in LAWS if "smooth" not in law for dim in (2, 3)),
    *((law, dim, n, control, "difference", drag) for law in LAWS for dim in (2, 3) for control, n, drag in CONTROLS),
]
MATRIX = [*FAST, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW if case not in FAST)]


def differences(one, two):
    """Names of arrays in which two states differ; of contacts only what touches is compared."""
    found = []
    touching = [state.contacts.mode[: state.contacts.count[0]] != ss.OPEN for state in (one, two)]
    for noun in ("grains", "walls", "cell", "contacts", "control"):
        for name in getattr(one, noun)._fields:
            mine, other = (getattr(getattr(state, noun), name) for state in (one, two))
            if noun == "contacts":
                if name not in PER_PAIR:
                    continue
                # laws without rolling resistance have no rows of its memory
                mine, other = (
                    a[: len(t)][t] if a is not None else a for a, t in zip((mine, other), touching, strict=True)
                )
            if not np.array_equal(mine, other):
                found.append(f"{noun}.{name}")
    return found


def there_and_back(state, folder):
    archive.write(folder / "state.h5", {"state": state})
    return archive.read(folder / "state.h5")["state"]


@pytest.mark.parametrize(("law", "dim", "n", "control", "memory", "drag"), MATRIX)
def test_a_run_continued_from_a_file_is_the_run(law, dim, n, control, memory, drag, tmp_path):
    start, how = control(flowing(n, dim)), {"slip_update": memory, "drag": drag}
    whole, _, _ = ss.run(start, LAWS[law], 80, 0.05, **how)
    half, _, _ = ss.run(start, LAWS[law], 40, 0.05, **how)
    rest, _, _ = ss.run(there_and_back(half, tmp_path), LAWS[law], 40, 0.05, **how)
    assert (whole.contacts.mode != ss.OPEN).sum() > n / 3
    assert (whole.grains.position != half.grains.position).any(axis=1).sum() > 0.8 * n
    assert differences(whole, rest) == []
    assert rest.time == pytest.approx(whole.time, rel=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("control", [free, plate, breathing])
def test_on_another_number_of_threads_too(control, tmp_path):
    law, start = LAWS["reff sharp viscoelastic"], control(flowing(600, 3))
    whole, _, _ = ss.run(start, law, 80, 0.05, threads=1)
    half, _, _ = ss.run(start, law, 40, 0.05, threads=2)
    rest, _, _ = ss.run(there_and_back(half, tmp_path), law, 40, 0.05, threads=2)
    assert differences(whole, rest) == []


@pytest.mark.parametrize("n", [30, pytest.param(150, marks=pytest.mark.slow)])
def test_what_is_changed_in_between_counts(n):
    """Forces that a run leaves behind are used for the state that it left, and for no other."""
    law, start = LAWS["reff sharp viscoelastic"], bounded(flowing(n, 3))
    half, _, _ = ss.run(start, law, 40, 0.05)
    assert half.instant is not None
    changed = {
        "gravity": half._replace(control=half.control._replace(gravity=np.array([0, -1e-2, 0.0]))),
        "velocity": half._replace(grains=half.grains._replace(velocity=0 * half.grains.velocity)),
        "slip": half._replace(contacts=half.contacts._replace(slip=0 * half.contacts.slip)),
    }
    for state in changed.values():
        one, _, _ = ss.run(state, law, 3, 0.05)
        two, _, _ = ss.run(state._replace(instant=None), law, 3, 0.05)
        assert differences(one, two) == []
    other = LAWS["reff sharp no tension"]
    one, _, _ = ss.run(half, other, 3, 0.05)
    two, _, _ = ss.run(half._replace(instant=None), other, 3, 0.05)
    assert differences(one, two) == []


def test_what_is_changed_in_place_counts_too():
    law, start = LAWS["reff sharp viscoelastic"], bounded(flowing(150, 3))
    half, _, _ = ss.run(start, law, 40, 0.05)
    half.grains.velocity[:] *= 0.5
    one, _, _ = ss.run(half, law, 3, 0.05)
    two, _, _ = ss.run(half._replace(instant=None), law, 3, 0.05)
    assert differences(one, two) == []


def test_samples_of_a_continued_run_are_those_of_the_run():
    law, start = LAWS["reff sharp viscoelastic"], plate(flowing(150, 3))
    _, whole, _ = ss.run(start, law, 80, 0.05, every=10)
    half, _, _ = ss.run(start, law, 40, 0.05, every=10)
    _, rest, _ = ss.run(half, law, 40, 0.05, every=10)
    for name in ("kinetic_energy", "touching", "sliding", "group_position"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[4:], err_msg=name)
    # of forces on a group, springs and loads are taken off, at times that differ by round-off
    np.testing.assert_allclose(rest.group_force, whole.group_force[4:], rtol=1e-12)
