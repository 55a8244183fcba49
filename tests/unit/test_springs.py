"""Springs to moving load points: dynamics, energy, Jacobian, time step, what a record tells of rigid groups."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.solve.freedom import jacobian

LAW = ss.laws.hertz_mindlin_reff(1.0, 0.5, 0.3, damping_n=0.3, damping_t=0.15)  # as other tests: one kernel


def slider(stiffness=2.0, velocity=0.1, until=20.0):
    """A free grain on a spring whose load point moves, then stands."""
    state = ss.assembly(ss.spheres([[0, 0, 0]], 0.5))
    course = {"times": [0, until], "displacement": [0, velocity * until]}
    return state._replace(control=ss.control.spring_loaded(state.control, [0], [[0, 0, 0]], stiffness, **course))


def plate(normal=1.0, stiffness=0.4):
    """Three spheres on three others that are frozen, pressed as one plate and pulled by a spring."""
    low = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]])
    high = low + np.array([0.3, 0.92, 0.1])
    grains = ss.spheres(np.concatenate([low, high]), 0.5)
    state = ss.assembly(grains, cell=ss.box([3.0, 5.0, 5.0], [True, False, False]))
    control = ss.control.fixed(ss.control.rigid(state.control, [3, 4, 5]), [0, 1, 2])
    control.free[3:, 2] = False
    control = ss.control.force_controlled(control, [3, 4, 5], [0, -normal / 3])
    course = {"times": [0.0, 50.0], "displacement": [0.0, 5.0]}
    return state._replace(
        control=ss.control.spring_loaded(control, [3, 4, 5], grains.position[3:], stiffness, **course)
    )


def test_a_mass_on_a_spring_follows_its_load_point():
    """x = V t − V/ω sin ωt, second order in dt, and the same energy book."""
    errors = []
    for dt in (2e-2, 1e-2):
        _, record, _ = ss.run(slider(), LAW, round(20 / dt), dt, every=100, ledger=True)
        w = np.sqrt(2.0 / 1.0)
        errors.append(np.abs(record.center[:, 0] - (0.1 * record.time - 0.1 / w * np.sin(w * record.time))).max())
        # defect: (ω dt)² of the energy that swings, m V²
        assert np.abs(record.ledger.defect).max() < 2 * dt**2 * 0.01
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_a_load_point_that_stands_holds():
    end, _, _ = ss.run(slider(until=5.0), LAW, 4000, 1e-2, every=1, drag=1.0)
    assert end.grains.position[0, 0] == pytest.approx(0.5, abs=1e-8)  # exp(−35/2)


def test_a_continued_run_is_the_same_to_the_last_bit():
    whole, _, _ = ss.run(slider(), LAW, 1000, 1e-2)
    half, _, _ = ss.run(slider(), LAW, 377, 1e-2)
    rest, _, _ = ss.run(half, LAW, 1000 - 377, 1e-2)
    assert rest.time == whole.time
    assert (rest.grains.position == whole.grains.position).all()


def test_a_new_course_replaces_the_old_one():
    state = slider()
    control = ss.control.spring_loaded(state.control, [0], [[0, 0, 0]], 2.0, times=[0, 10], displacement=[1, 2])
    assert control.course.shape[1] == 1
    assert ss.control.spring_forces(control, np.zeros((1, 3)), 5.0)[0, 0] == pytest.approx(2 * 1.5)


def test_a_course_that_others_follow_stays_theirs():
    state = ss.assembly(ss.spheres([[0, 0, 0], [5, 0, 0]], 0.5))
    both = ss.control.spring_loaded(
        state.control, [0, 1], state.grains.position, 2.0, times=[0, 10], displacement=[0, 1]
    )
    control = ss.control.spring_loaded(both, [0], state.grains.position[:1], 1.0, times=[0, 10], displacement=[0, 4])
    assert ss.control.spring_forces(control, state.grains.position, 5.0)[:, 0] == pytest.approx([2.0, 0.5])


def test_the_record_tells_what_pulls_a_group():
    """Force of contacts, of the spring and of the load give the group's acceleration."""
    state = plate()
    dt = 1e-3
    _, record, _ = ss.run(state, LAW, 4000, dt, every=1)
    top, load = 0, np.array([0, -1.0, 0])
    acceleration = np.gradient(record.group_velocity[:, top], dt, axis=0)[1:-1]
    total = (record.group_force[:, top] + record.group_pull[:, top] + load)[1:-1]
    # differences of the velocity over two steps: (ω dt)² of forces of size 1, and the dashpots' prediction
    assert np.abs(3.0 * acceleration[:, :2] - total[:, :2]).max() < 2e-3
    assert np.abs(record.group_pull[:, top, 0]).max() > 0.05
    pull = 0.4 * (state.grains.position[3:, 0].mean() + 0.1 * record.time - record.group_position[:, top, 0])
    assert np.allclose(record.group_pull[:, top, 0], pull, atol=1e-12)


def test_the_spring_is_in_the_jacobian():
    """∂f/∂q by differences of the unbalanced force."""
    state, law = plate(), ss.laws.hertz_mindlin_reff(1.0, 0.5, 0.3)
    state, _, _ = ss.run(state, law, 200, 1e-3)
    state = ss.accept(state, ss.forces(state, law)[1])
    free = ss.freedom(state)
    matrix, h = jacobian(state, law, free).toarray(), 1e-7
    sides = []
    for sign in (1, -1):
        moved = ss.modes.displaced(state, free, sign * h * np.eye(len(free))[0])
        loads, _ = ss.forces(moved, law, memory=ss.HELD)
        sides.append(ss.modes.residual_vector(moved, loads, free))
    assert matrix[:, 0] == pytest.approx((sides[0] - sides[1]) / (2 * h), abs=1e-6)
    control = state.control._replace(spring=0 * state.control.spring)
    without = jacobian(state._replace(control=control), law, free).toarray()
    assert (matrix - without)[0, 0] == pytest.approx(-0.4)


def test_a_stiff_spring_shortens_the_time_step():
    assert ss.measure.stable_time_step(slider(8.0), LAW) == pytest.approx(2 / np.sqrt(8.0))
    with pytest.raises(ValueError, match=r"use at most 0.7071"):
        ss.run(slider(8.0), LAW, 10, 0.8)


def test_bad_springs_are_refused():
    state = slider()
    with pytest.raises(ValueError, match=r"stiffness must be positive, got -1\.0"):
        ss.control.spring_loaded(state.control, [0], [[0, 0, 0]], -1.0)
    with pytest.raises(ValueError, match="2 times and 3 values"):
        ss.control.spring_loaded(state.control, [0], [[0, 0, 0]], 1.0, times=[0, 1], displacement=[0, 1, 2])
    held = ss.control.fixed(state.control, [0])
    with pytest.raises(ValueError, match="a spring pulls body 0 along x, where it is frozen"):
        ss.assembly(state.grains, control=held)
