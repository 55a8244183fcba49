"""Contacts with memory keep the second order of velocity Verlet: rolling over, sliding, closing and opening."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip as ss

LAWS = {"hertz": ss.laws.hertz_mindlin, "linear": ss.laws.linear}
SLOW = [("linear", "smooth", 3)]  # whose kernels no other test compiles
CASES = [
    pytest.param(*case, marks=pytest.mark.slow if case in SLOW else ())
    for case in product(LAWS, ("sharp", "smooth"), (2, 3))
]
LOADS = {"hertz": 2e-3, "linear": 2e-2}
REST = {"hertz": 2e-3 ** (2 / 3), "linear": 2e-2}  # overlaps under these loads


def law_of(name, coulomb, mu):
    return LAWS[name](kn=1.0, kt=0.8, mu=mu, coulomb=coulomb)


def grains(dim, *rest, **more):
    return (ss.disks if dim == 2 else ss.spheres)(*rest, **more)


def on_a_grain(dim, law_name):
    """A grain that rolls over a frozen one; in three dimensions it is also pushed and spun out of the plane."""
    up, tilt, speed = dim - 1, -0.5, {"hertz": 0.03, "linear": 0.1}[law_name]
    position, velocity, spin = np.zeros((3, 2, 3))
    position[1, [0, up]] = (1.0 - REST[law_name] * np.cos(tilt)) * np.array([np.sin(tilt), np.cos(tilt)])
    velocity[1, [0, up]] = speed * np.array([np.cos(tilt), -np.sin(tilt)])
    spin[1, 2 if dim == 2 else 1] = -2 * speed if dim == 2 else 2 * speed
    if dim == 3:
        velocity[1, 1], spin[1, [0, 2]] = 0.2 * speed, [0.3 * speed, 0.5 * speed]
    force = np.zeros((2, 3))
    force[1, up] = -LOADS[law_name]
    both = grains(dim, position, 0.5, velocity=velocity, spin=spin)
    return ss.assembly(both, None, ss.box(dim=dim), ss.control.fixed(ss.control.loads(2, force=force), [0]), skin=0.6)


def on_a_floor(dim, law_name, heights, speed=0.0):
    """Grains far apart above a floor that a load presses them on, in motion along it and spinning."""
    up, load = dim - 1, LOADS[law_name]
    position, velocity, spin, force = np.zeros((4, len(heights), 3))
    position[:, 0], position[:, up], velocity[:, up] = 20.0 * np.arange(len(heights)), 0.5 + heights, -speed
    velocity[:, 0], force[:, 0], force[:, up] = 0.02, 0.1 * load, -load
    if dim == 3:
        velocity[:, 1], spin[:], force[:, 1] = 0.008, [0.06, 0.02, 0.04], 0.2 * load
    every = grains(dim, position, 0.5, velocity=velocity, spin=spin)
    floor = ss.flat_walls(np.zeros(3), np.eye(3)[up])
    return ss.assembly(every, floor, ss.box(dim=dim), ss.control.loads(len(heights), 1, force=force), skin=0.6)


def dragged(dim, law_name):
    """A grain that bobs on a floor, does not turn, and is dragged across the way it goes by more than friction."""
    state, load, speed = (
        on_a_floor(dim, law_name, np.array([-0.7 * REST[law_name]])),
        LOADS[law_name],
        {"hertz": 0.01, "linear": 0.05},
    )
    control, velocity = state.control, np.array([[speed[law_name], 0.0, 0.0]])
    control.free[:, 3:], control.force[0, :2] = False, 0.5 * load * np.eye(3)[dim - 2, :2]
    control.force[0, dim - 1] = -load
    return state._replace(grains=state.grains._replace(velocity=velocity, spin=0 * velocity))


def ended(state, law, dt, duration, grain=slice(None)):
    end, _, outcome = ss.run(state, law, round(duration / dt), dt, threads=1)
    assert outcome.ok
    g = end.grains
    return np.concatenate([g.position[grain], g.velocity[grain], g.radius[grain, None] * g.spin[grain]]), end


def order(state, law, duration, steps, grain=slice(None), halvings=4):
    """Slope of the root mean square difference of ends with dt and dt/2 against dt, and the last end."""
    values = [ended(state, law, duration / (steps * 2**k), duration, grain) for k in range(halvings + 1)]
    apart = [np.sqrt(((a[0] - b[0]) ** 2).sum()) for a, b in pairwise(values)]
    return np.polyfit(np.arange(halvings), -np.log2(apart), 1)[0], values[-1][1]


@pytest.mark.parametrize(("law_name", "coulomb", "dim"), CASES)
def test_a_sticking_grain_that_rolls_over_another(law_name, coulomb, dim):
    """Projecting the slip on the plane at the end of the step, as before, gives slopes of 1.2 to 1.7."""
    state, law = on_a_grain(dim, law_name), law_of(law_name, coulomb, 10.0)
    slope, end = order(state, law, {"hertz": 40.0, "linear": 12.8}[law_name], 240, grain=slice(1, 2))
    assert end.contacts.mode[0] == ss.STICK
    assert np.arccos(normal(state) @ normal(end)) > 1.0
    assert slope == pytest.approx(2.0, abs=0.15)


def normal(state):
    r = state.grains.position[1] - state.grains.position[0]
    return r / np.linalg.norm(r)


@pytest.mark.parametrize(
    ("law_name", "coulomb", "dim"), [pytest.param("linear", "sharp", 3, marks=pytest.mark.slow), ("hertz", "smooth", 2)]
)
@pytest.mark.parametrize("mu", [0.05, 10.0])
def test_blocks_of_many_contacts_carry_slip_as_single_ones_do(law_name, coulomb, dim, mu):
    """Sixty pairs far apart go through vectorised blocks, one pair by rows."""
    single, law = on_a_grain(dim, law_name), law_of(law_name, coulomb, mu)
    position = np.concatenate([single.grains.position + np.array([20.0 * k, 0, 0]) for k in range(60)])
    more = {name: np.tile(getattr(single.grains, name), (60, 1)) for name in ("velocity", "spin")}
    force = np.tile(single.control.force, (60, 1))
    control = ss.control.fixed(ss.control.loads(120, force=force), np.arange(0, 120, 2))
    many = ss.assembly(grains(dim, position, 0.5, **more), None, ss.box(dim=dim), control, skin=0.6)
    duration = {"hertz": 60.0, "linear": 19.2}[law_name]  # long enough for the contact to open
    alone, _ = ended(single, law, duration / 600, duration, slice(1, 2))
    crowd, _ = ended(many, law, duration / 600, duration, slice(1, 2))
    np.testing.assert_allclose(crowd, alone, atol=1e-11)  # six hundred steps of round-off


def turned(vector, axis, angle):
    return (
        vector * np.cos(angle) + np.cross(axis, vector) * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_slip_turns_with_a_pair_that_turns_as_one_body(dim):
    """Two grains that turn as one about their centre keep their slip in the frame of the contact, to second order."""
    law = ss.laws.linear(kn=1.0, kt=0.8, mu=100.0)
    axis = np.array([0.0, 0.0, 1.0]) if dim == 2 else np.array([0.4, -0.5, 0.7681145747868608])
    branch = np.array([1.0, 0.0, 0.0])
    branch -= (axis @ branch) * axis
    branch *= 0.98 / np.linalg.norm(branch)  # it turns in the plane across the axis
    slip = 0.01 * np.cross(axis, branch) + (0.0 if dim == 2 else 0.004) * axis

    def missed(steps):
        state = ss.packings.from_arrays(
            [0.5 * branch, -0.5 * branch],
            [0.5, 0.5],
            law,
            pair_i=[0],
            pair_j=[1],
            slip=[slip],
            mode=[ss.STICK],
            dim=dim,
        )
        for k in range(1, steps + 1):
            r = turned(branch, axis, k / steps)
            g = state.grains
            angle = np.tile(0.98 * axis * k / steps, (2, 1))  # R·angle sums to |r|·angle: no rolling on the way
            moved = state._replace(grains=g._replace(position=np.array([0.5 * r, -0.5 * r]), angle=angle))
            state = ss.accept(moved, ss.forces(moved, law)[1])
        return np.linalg.norm(state.contacts.slip[0] - turned(slip, axis, 1.0))

    values = [missed(steps) for steps in (10, 20, 40)]
    np.testing.assert_allclose(np.diff(np.log2(values)), -2.0, atol=0.15)


def test_the_direction_of_sliding_turns_as_the_exact_solution_does():
    """tan(ψ/2) falls as exp(−distance/reach) where ψ is the angle between the slip and the direction of motion."""
    law, depth, distance = ss.laws.linear(kn=1.0, kt=0.8, mu=0.4), 0.01, 0.006
    reach = 0.4 * depth / 0.8

    def missed(steps):
        state = ss.assembly(ss.spheres([[0.0, 0.0, 0.5 - depth]], 0.5), ss.flat_walls([0, 0, 0], [0, 0, 1]), skin=0.2)
        state = ss.accept(state, ss.forces(state, law)[1])
        contacts = state.contacts
        slip, mode = contacts.slip.copy(), contacts.mode.copy()
        slip[0], mode[0] = [0.6 * reach, 0.8 * reach, 0.0], ss.SLIDE
        state = state._replace(contacts=contacts._replace(slip=slip, mode=mode))
        for k in range(1, steps + 1):
            position = np.array([[distance * k / steps, 0.0, 0.5 - depth]])
            moved = state._replace(grains=state.grains._replace(position=position))
            state = ss.accept(moved, ss.forces(moved, law)[1])
        slip = state.contacts.slip[0]
        assert np.linalg.norm(slip) == pytest.approx(reach, rel=1e-12)
        return abs(np.arctan2(slip[1], slip[0]) - 2 * np.arctan(0.5 * np.exp(-distance / reach)))

    values = [missed(steps) for steps in (8, 16, 32)]
    np.testing.assert_allclose(np.diff(np.log2(values)), -2.0, atol=0.15)


@pytest.mark.parametrize(("law_name", "coulomb", "dim"), CASES)
def test_a_sliding_grain(law_name, coulomb, dim):
    """the Coulomb limit changes as it bobs, and in three dimensions the direction of sliding turns."""
    state, law = dragged(dim, law_name), law_of(law_name, coulomb, 0.3)
    state = ss.run(state, law, 4000, 5e-4)[0]  # where it begins to slide
    assert state.contacts.mode[0] == ss.SLIDE
    direction = state.contacts.slip[0] / np.linalg.norm(state.contacts.slip[0])
    slope, end = order(state, law, 9.6, 192)
    assert end.contacts.mode[0] == ss.SLIDE
    if dim == 3:
        assert direction @ end.contacts.slip[0] < 0.95 * np.linalg.norm(end.contacts.slip[0])
    assert slope == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize(
    ("law_name", "dim", "speed", "duration", "count"),
    [
        ("linear", 3, 0.02, 6.4, 40),
        pytest.param("linear", 3, 0.02, 6.4, 60, marks=pytest.mark.slow),
        ("hertz", 2, 0.01, 25.6, 40),
        ("hertz", 2, 0.01, 25.6, 60),
    ],
)
def test_grains_that_hit_a_floor_and_leave_it(law_name, dim, speed, duration, count):
    """Collisions at any moment of a step: counting no slip in the step that closes a contact gives 1.

    Forty grains go by rows, sixty through vectorised blocks.
    """
    state, law = on_a_floor(dim, law_name, np.linspace(0.02, 0.03, count), speed), law_of(law_name, "sharp", 10.0)
    slope, end = order(state, law, duration, 128)
    assert (np.abs(end.grains.spin).max(axis=1) > 0).all()
    assert slope == pytest.approx(2.0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("damping", ["velocity", "mass_velocity"])
def test_dashpots_that_act_from_the_first_touch_leave_first_order(damping):
    law = ss.laws.linear(kn=1.0, kt=0.8, mu=0.5, damping=damping, damping_n=0.1)
    state = on_a_floor(2, "linear", np.linspace(0.02, 0.03, 60), 0.02)
    slope, _ = order(state, law, 6.4, 128)
    assert slope == pytest.approx(1.0, abs=0.15)


def test_viscoelastic_dashpots_leave_order_three_halves():
    """Their force starts as √δ v: the step in which a contact closes or opens has an error of dt^{3/2} in the impulse.

    Four hundred disks hit a floor at random moments of a step and rebound with one speed, that of the exact equation.
    """
    gamma, speed, duration, steps = 2.0, 0.02, 8.0, 0.05 * 0.5 ** np.arange(6)
    law = ss.laws.linear(kn=1.0, mu=0.0, damping="viscoelastic", damping_n=gamma)
    height = 0.5 + speed * np.random.default_rng(1).uniform(0.5, 1.5, 400)
    disks = ss.disks(np.stack([2.0 * np.arange(400), height], axis=1), 0.5, velocity=[0, -speed, 0])
    state = ss.assembly(disks, ss.flat_walls([0, 0], [0, 1]), ss.box(dim=2))

    def motion(_, y):
        return [y[1], -y[0] - gamma * np.sqrt(0.5 * max(y[0], 0.0)) * y[1]]

    def leaves(_, y):
        return y[0] if y[1] < 0 else 1.0

    leaves.terminal = True
    solution = solve_ivp(motion, (0, duration), [0, speed], method="DOP853", rtol=1e-12, atol=1e-16, events=leaves)
    error = []
    for dt in steps:
        after = ss.run(state, law, round(duration / dt), dt)[0].grains.velocity[:, 1]
        error.append(np.sqrt(((after + solution.y[1, -1]) ** 2).mean()))
    slope = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert slope == pytest.approx(1.5, abs=0.12)  # scatter of a mean over random phases


def test_dashpots_and_drag_together_are_second_order():
    """Dashpots use velocities predicted at the end of the step, which drag has slowed, too."""
    law = ss.laws.hertz_mindlin_reff(1.0, 0.5, 5.0, damping="viscoelastic", damping_n=0.6, damping_t=0.4)
    velocity, spin = [[0.01, 0.02, 0], [-0.01, -0.015, 0.01]], [[0, 0, 0.02], [0.01, 0, 0]]
    state = ss.assembly(ss.spheres([[0, 0, 0], [0.95, 0, 0]], 0.5, velocity=velocity, spin=spin))

    def end(dt):
        grains = ss.run(state, law, round(1.6 / dt), dt, drag=1.0)[0].grains
        return np.concatenate([grains.position, grains.velocity, grains.spin])

    exact = end(0.1 / 128)
    errors = [np.abs(end(dt) - exact).max() for dt in (0.1 / 4, 0.1 / 8)]
    # 2.00; it was 0.98 while the prediction left drag out
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)
