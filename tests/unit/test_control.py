"""Rigid groups: in dynamics, in J, in Newton's method, and what contradicts itself is refused."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import body_positions
from stickslip.core.control import spring_forces
from stickslip.loading import quasistatic
from tests.conftest import make_law
from tests.derivatives.test_jacobian import differences, overlaps, sample
from tests.properties.test_determinism import flowing


def plated(n, dim=3, seed=0, direction=None):
    """A flowing packing on a frozen layer, below a rigid plate of grains that is pulled along x and pressed down."""
    state = flowing(n=n, dim=dim, seed=seed, walls=True)
    up = dim - 1
    height = state.grains.position[:, up]
    high, low = np.flatnonzero(height > np.quantile(height, 0.85)), np.flatnonzero(height < np.quantile(height, 0.15))
    control = ss.control.rigid(ss.control.fixed(state.control, low), high)
    control.force[high[0], up] = -1e-2
    if direction is not None:
        control.free[high, direction], control.rate[high, direction] = False, 3e-3
    grains = state.grains._replace(velocity=0 * state.grains.velocity, spin=0 * state.grains.spin)
    return ss.assembly(grains, state.walls, state.cell, control, skin=0.1), high, low


@pytest.mark.parametrize("n", [40, 200])
@pytest.mark.parametrize("direction", [None, 0])
def test_a_plate_moves_as_one(n, direction):
    law = make_law("hertz_mindlin", "sharp")
    state, high, low = plated(n, direction=direction)
    end, _, _ = ss.run(state, law, 300, 0.05)
    moved = end.grains.position - state.grains.position
    assert np.abs(moved[high]).max() > 1e-4
    assert np.ptp(end.grains.velocity[high], axis=0).max() == 0
    assert np.ptp(moved[high], axis=0).max() < 1e-12  # positions are rounded each at its own size
    assert not moved[low].any()
    assert not end.grains.spin[high].any()
    if direction == 0:
        assert end.grains.velocity[high[0], 0] == 3e-3
    loads, _ = ss.forces(end, law)
    mass = state.grains.mass[high].sum()
    force = (loads.force + end.control.force)[high].sum(axis=0)
    before, _, _ = ss.run(end, law, 1, 1e-4)
    gained = (before.grains.velocity[high[0]] - end.grains.velocity[high[0]]) / 1e-4
    free = [0, 1, 2] if direction is None else [1, 2]
    np.testing.assert_allclose(gained[free], (force / mass)[free], rtol=2e-2, atol=1e-6)


def test_a_group_whose_members_joined_another_changes_nothing():
    law, (state, high, _) = make_law("hertz_mindlin", "sharp"), plated(40)
    empty = state._replace(control=ss.control.rigid(state.control, high))
    assert np.unique(empty.control.group).tolist() == [-1, 1]
    ends = [ss.run(one, law, 20, 0.05, every=10) for one in (state, empty)]
    assert np.array_equal(ends[0][0].grains.position, ends[1][0].grains.position)
    assert np.array_equal(ends[0][1].group_position[:, 0], ends[1][1].group_position[:, 1])
    still = [ss.equilibrate(one, law)[0] for one in (state, empty)]
    assert np.array_equal(still[0].grains.position, still[1].grains.position)


def test_a_plate_does_not_depend_on_threads_or_on_the_way_through_the_list(monkeypatch):
    law, (state, *_) = make_law("hertz_mindlin", "sharp"), plated(300)
    single, double = (ss.run(state, law, 200, 0.05, threads=threads)[0] for threads in (1, 2))
    assert np.array_equal(single.grains.position, double.grains.position)
    law = make_law("hertz_mindlin_reff", "sharp", damping_n=0.3, damping_t=0.15)
    single, record, _ = ss.run(state, law, 200, 0.05, every=10, ledger=True)
    monkeypatch.setattr("stickslip.core.dynamics.driver.MIN_BODIES", 10**9)
    plain, _, _ = ss.run(state, law, 200, 0.05)
    np.testing.assert_allclose(plain.grains.position, single.grains.position, atol=1e-11)
    # walls that cut into grains throw them apart at the start: a step of a fifth of a radius closes to half a per cent
    assert np.abs(record.ledger.defect).max() < 5e-3 * record.ledger.viscous[-1]


@pytest.mark.parametrize("dim", [2, 3])
def test_jacobian_of_a_rigid_group_against_differences(dim):
    state, law = sample("hertz_mindlin", "smooth", dim, seed=1)
    control = ss.control.rigid(state.control, [1, 3, 4])
    state = state._replace(control=control)
    free = ss.freedom(state)
    assert len(free) == (4 + 1) * dim + 4 * (1 if dim == 2 else 3)
    exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[0], free).toarray()
    numeric = differences(
        state,
        law,
        free,
        ss.HELD,
        h=1e-4 * overlaps(state)[state.contacts.mode[: state.contacts.count[0]] > 0].min() ** 0.5,
    )
    np.testing.assert_allclose(exact, numeric, atol=1e-8 * np.abs(exact).max(), rtol=0)
    assert free.mass[free.body == 1][0] == pytest.approx(state.grains.mass[[1, 3, 4]].sum())


def test_a_pressed_plate_comes_to_equilibrium_by_newton_and_by_dynamics_alike():
    """Three disks on a floor under a plate of two: the floor carries the load on the plate."""
    grains = ss.disks([[0, 0.495], [1.0, 0.495], [2.0, 0.495], [0.5, 1.35], [1.5, 1.35]], 0.5)
    control = ss.control.rigid(ss.control.loads(5, 1), [3, 4])
    control.force[3, 1] = -0.01
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), control)
    law = ss.laws.linear(1.0, 0.5, 1.0)
    calm, outcome = ss.relax(state, law, drag=0.3)
    assert outcome.ok
    solved, outcome = ss.newton(calm, law, tolerance=1e-14)
    assert outcome.ok
    loads, _ = ss.forces(solved, law)
    assert loads.force[5, 1] == pytest.approx(-0.01, rel=1e-9)
    np.testing.assert_allclose(solved.grains.position, calm.grains.position, atol=1e-8)


def test_contradictory_control_is_refused():
    control = ss.control.rigid(ss.control.loads(3), [0, 1])
    control.free[0, 0] = False
    with pytest.raises(ValueError, match="contradictory control"):
        ss.assembly(ss.spheres([[0, 0, 0], [2, 0, 0], [4, 0, 0]], 0.5), control=control)


@pytest.mark.parametrize("skin", [0.0, -0.1, 1e-6, np.nan])
def test_a_skin_too_small_is_refused(skin):
    with pytest.raises(ValueError, match="at least 5e-05" if skin > 0 else "skin is .* must be positive|skin is NaN"):
        ss.assembly(ss.spheres([[0, 0, 0]], 0.5), skin=skin)


def test_a_servo_controlled_lid_brings_the_floor_under_its_load():
    grains = ss.disks([[0, 0.497], [1.2, 0.497], [2.4, 0.497]], 0.5)
    walls = ss.flat_walls([[0, 0, 0], [0, 1.0, 0]], [[0, 1, 0], [0, -1, 0]], mass=2.0)
    state = ss.assembly(
        grains, walls, ss.box(dim=2), ss.control.force_controlled(ss.control.loads(3, 2), [4], [0, -0.03])
    )
    law = ss.laws.linear(1.0, 0.5, 1.0)
    calm, outcome = ss.relax(state, law, drag=0.3)
    assert outcome.ok
    solved, outcome = ss.newton(calm, law)
    assert outcome.ok
    assert ss.forces(solved, law)[0].force[3, 1] == pytest.approx(-0.03, rel=1e-9)
    assert (ss.freedom(solved).body == 4).sum() == 1


def test_the_examples_of_control_work():
    import doctest

    from stickslip.core import control

    assert doctest.testmod(control).failed == 0


def test_a_rigid_group_keeps_the_velocity_that_drives_it():
    driven = ss.control.driven(ss.control.loads(3), [0, 1], [0.1, 0.2, 0, 0, 0, 0.3])
    assert ss.control.rigid(driven, [0, 1]).rate[:2].tolist() == [[0.1, 0.2, 0, 0, 0, 0]] * 2


def test_a_machine_exerts_the_force_that_it_replaces():
    state, _ = ss.packings.biaxial_box(12, pressure=1e-3, seed=1)
    lid = 12 + ss.packings.TOP
    held = ss.quasirigid.with_machine(state, lid, 100.0)
    pull = spring_forces(held.control, body_positions(held), held.time)
    np.testing.assert_allclose(pull[lid], state.control.force[lid], rtol=1e-9)
    assert state.control.force[lid].any() and not held.control.force[lid].any()


@pytest.mark.parametrize("dim", [2, 3])
def test_tolerances_of_shear_are_forces_on_a_diameter(dim, monkeypatch):
    law, tolerances = make_law("hertz_mindlin", "sharp"), []
    monkeypatch.setattr(quasistatic, "_settle", lambda state, load, law, tolerance: tolerances.append(tolerance))
    state, _ = ss.packings.jammed(10, dim=dim, packing_fraction=0.86 if dim == 2 else 0.66, seed=1)
    ss.protocols.cell_shear(law, 1e-3, tolerance=1e-7).settle(state, 0.0)
    diameter = 2 * state.grains.radius.mean()
    assert tolerances == [pytest.approx(1e-10 * diameter ** (dim - 1))] and abs(diameter - 1) > 0.01


def test_free_runs_are_sampled_in_units_of_time():
    state, law = ss.packings.biaxial_box(12, pressure=1e-3, seed=1)
    _, record, _ = ss.protocols.free_run(state, law, duration=2.0, dt=0.05, sample=0.4)
    np.testing.assert_allclose(np.diff(record.time), 0.4)
