"""Deforming cells in dynamics: against Lees–Edwards in the laboratory's frame, the ledger, threads, and courses."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.dynamics import moving
from tests.conftest import make_law
from tests.derivatives.test_free_cell import packed
from tests.properties.test_determinism import flowing, same_bits

pytestmark = pytest.mark.slow  # 15 s

RATE = 2e-3


def sheared(dim=3, n=60, rate=RATE, seed=0):
    state = flowing(n=n, dim=dim, seed=seed)
    return state._replace(
        control=ss.control.strained_at(state.control, rate * np.eye(3, k=1) * [1, 1, 0] * [[1], [0], [0]])
    )


def laboratory(state, law, steps, dt, rate):
    """A slow obvious twin: velocity Verlet for laboratory velocities V = v + L x; the box leans as time goes on."""
    x, angle = state.grains.position.copy(), state.grains.angle.copy()
    gradient = np.zeros((3, 3))
    gradient[0, 1] = rate
    velocity, spin = state.grains.velocity + x @ gradient.T, state.grains.spin.copy()
    mass, inertia = state.grains.mass[:, None], state.grains.inertia[:, None]
    vectors, contacts = state.cell.vectors, state.contacts

    def evaluated(contacts):
        now = state._replace(
            grains=state.grains._replace(position=x, angle=angle),
            cell=state.cell._replace(vectors=vectors),
            contacts=contacts._replace(stale=True),
        )
        return ss.forces(now, law)

    loads, contacts = evaluated(contacts)
    for _ in range(steps):
        velocity, spin = velocity + 0.5 * dt * loads.force / mass, spin + 0.5 * dt * loads.torque / inertia
        x, angle = x + dt * velocity, angle + dt * spin
        vectors = vectors + dt * vectors @ gradient.T
        loads, contacts = evaluated(contacts)
        velocity, spin = velocity + 0.5 * dt * loads.force / mass, spin + 0.5 * dt * loads.torque / inertia
    return x, velocity - x @ gradient.T, spin


def test_simple_shear_is_newton_in_lees_edwards_conditions():
    """The two are the same algebra when L² = 0: what differs is round-off."""
    law, state = make_law("hertz_mindlin", "sharp", mu=0.0), sheared(n=60)
    x, velocity, _ = laboratory(state, law, 100, 0.05, RATE)
    end, _, _ = ss.run(state, law, 100, 0.05)
    still, _, _ = ss.run(
        state._replace(control=ss.control.strained_at(state.control, np.zeros((3, 3)))), law, 100, 0.05
    )
    np.testing.assert_allclose(end.grains.velocity, velocity, atol=1e-12)
    np.testing.assert_allclose(end.grains.position, x, atol=1e-12)
    assert np.abs(still.grains.position - end.grains.position).max() > 1e-3


def test_friction_sees_the_flow_as_the_laboratory_does():
    """The twin starts a contact at the end of the step in which it closes: its steps are a sixteenth of ours."""
    law, state = make_law("hertz_mindlin", "sharp"), sheared(n=60)
    x, velocity, spin = laboratory(state, law, 6400, 0.005 / 16, RATE)
    end, _, _ = ss.run(state, law, 400, 0.005)
    for mine, its in ((end.grains.position, x), (end.grains.velocity, velocity), (end.grains.spin, spin)):
        np.testing.assert_allclose(mine, its, atol=3e-6)


@pytest.mark.slow
@pytest.mark.parametrize("n", [60, 400])
def test_a_deforming_cell_gives_the_same_bits_on_any_number_of_threads_and_in_any_order(n, monkeypatch):
    law = make_law("hertz_mindlin_reff", "sharp", damping_n=0.3, damping_t=0.15)
    state = sheared(n=n)
    state = state._replace(control=ss.control.stress_controlled(state.control, {"yy": 0.02}))
    single, record, _ = ss.run(state, law, 200, 0.05, threads=1, every=20)
    assert np.abs(record.cell[-1] - record.cell[0])[:2].max() > 1e-3
    two, _, _ = ss.run(state, law, 200, 0.05, threads=2)
    monkeypatch.setattr(moving, "TILE_SIZE", 32)
    wide = state._replace(contacts=state.contacts._replace(skin=state.contacts.skin * 2.1))
    three, _, _ = ss.run(wide, law, 200, 0.05)
    for other in (two, three):
        assert same_bits(single, other)
        assert np.array_equal(single.cell.vectors, other.cell.vectors)
        assert np.array_equal(single.cell.rate, other.cell.rate)


def test_a_continued_run_in_a_deforming_cell_gives_the_same_bits():
    law, state = make_law("hertz_mindlin", "sharp"), sheared()
    state = state._replace(control=ss.control.stress_controlled(state.control, {"yy": 0.02, "zz": 0.02}))
    state = state._replace(control=ss.control.time_dependent(state.control, "cell", [0.0, 3.0, 9.0], [0.0, 1.0, -1.0]))
    whole, _, _ = ss.run(state, law, 160, 0.05)
    half, _, _ = ss.run(state, law, 70, 0.05)
    rest, _, _ = ss.run(half, law, 90, 0.05)
    assert same_bits(whole, rest)
    assert np.array_equal(whole.cell.vectors, rest.cell.vectors)


def test_the_ledger_closes_in_a_deforming_cell_to_second_order():
    """In a packing whose contacts stick and stay: one that begins to slide within a step would make it first order."""
    law = make_law("hertz_mindlin_reff", "smooth", mu=5.0, damping="viscoelastic", damping_n=0.4, damping_t=0.3)
    (state, _), defects = ss.equilibrate(packed(3, n=40), law), []
    control = ss.control.strained_at(state.control, [[0, 1e-5, 0], [0, 0, 0], [0, 0, 0]])
    control = ss.control.stress_controlled(control, {"yy": 0.01001, "zz": 0.01})
    state = state._replace(control=ss.control.time_dependent(control, "cell", [0, 5, 10], [0.0, 1.0, 0.5]))
    for steps in (100, 200, 400):
        _, record, _ = ss.run(state, law, steps, 10.0 / steps, every=steps // 8, ledger=True)
        defects.append(np.abs(record.ledger.defect).max())
    assert defects[1] < 1e-3 * np.abs(record.ledger.external).max()
    np.testing.assert_allclose(np.log2(np.divide(defects[:-1], defects[1:])), 2.0, atol=0.3)


def test_shear_at_constant_pressure():
    """The mean normal stress is the wanted one, the shear stress is borne by friction, and the strain is as imposed."""
    law = make_law("hertz_mindlin_reff", "sharp", damping_n=0.3, damping_t=0.15)
    state, _ = ss.packings.jammed(80, packing_fraction=0.68, dim=3, seed=1)
    control = ss.control.strained_at(state.control, [[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]])
    control = ss.control.stress_controlled(control, {"yy": 0.01})
    end, record, outcome = ss.run(state._replace(control=control), law, 10_000, 0.1, every=100)
    assert outcome.ok
    cell = record.cell
    stress = (record.virial + record.momentum_flux) / np.linalg.det(cell)[:, None, None]
    late = record.time > 200
    assert stress[late, 1, 1].mean() == pytest.approx(0.01, rel=0.05)
    assert 0.1 < -stress[late, 0, 1].mean() / 0.01 < 0.6
    assert ss.measure.shear_strain(end) == pytest.approx(1.0, rel=0.05)  # the height changes on the way
    assert record.shear_strain[-1] == pytest.approx(cell[-1, 1, 0] / cell[0, 1, 1], rel=1e-12)
    assert record.volumetric_strain[-1] == pytest.approx(1 - cell[-1, 1, 1] / cell[0, 1, 1], rel=1e-9)
    assert np.ptp(cell[late, 1, 1]) > 0
    assert (cell[:, 0, 0] == cell[0, 0, 0]).all()


@pytest.mark.parametrize("n", [3, 60])
def test_a_floor_follows_its_course(n):
    """Its position is the integral of the given function of time, whatever the time step; disks roll on it.

    A disk that rolls without sliding follows a floor that it rests on with a third of its velocity: F = m a and
    F R = m R² α/2, where the floor's acceleration is a + α R. Its contact's spring lets it swing about that.
    """
    law = make_law("linear", "sharp", mu=5.0, damping="velocity", damping_n=0.1, damping_t=0.1)
    grains = ss.disks(np.stack([1.1 * np.arange(n), np.full(n, 0.5 - 1e-2 / 1.3)], axis=1), 0.5)
    control = ss.control.driven(ss.control.loads(n, 1, force=[0, -1e-2, 0]), [n], [0.02, 0, 0, 0, 0, 0])
    times = np.array([0.0, 5.0, 8.0, 20.0])
    factors = np.array([0.0, 1.0, -0.5, 0.25])
    control = ss.control.time_dependent(control, [n], times, factors)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0], material=1), ss.box(dim=2), control)
    end, _, _ = ss.run(state, law, 230, 0.1)
    path = 0.02 * (np.sum(0.5 * (factors[1:] + factors[:-1]) * np.diff(times)) + 3.0 * factors[-1])
    assert end.walls.point[0, 0] == pytest.approx(path, rel=1e-12)
    assert end.walls.velocity[0, 0] == 0.02 * 0.25
    halves, _, _ = ss.run(ss.run(state, law, 100, 0.1)[0], law, 130, 0.1)
    assert halves.walls.point[0, 0] == pytest.approx(path, rel=1e-12)
    np.testing.assert_allclose(end.grains.position[:, 0] - grains.position[:, 0], path / 3, rtol=0.1)
    np.testing.assert_allclose(end.grains.velocity[:, 0], end.walls.velocity[0, 0] / 3, rtol=0.1)


def test_a_plate_follows_its_course_on_two_threads_as_on_one():
    law = make_law("hertz_mindlin_reff", "sharp", damping_n=0.3, damping_t=0.15)
    state = flowing(n=300, walls=True)
    top = np.flatnonzero(state.grains.position[:, 2] > np.quantile(state.grains.position[:, 2], 0.9))
    control = ss.control.rigid(state.control, top)
    control.free[top, 0], control.rate[top, 0] = False, 1e-2
    times = np.linspace(0, 10, 101)
    state = state._replace(control=ss.control.time_dependent(control, top, times, np.sin(times)))
    single, _, _ = ss.run(state, law, 200, 0.05, threads=1)
    double, _, _ = ss.run(state, law, 200, 0.05, threads=2)
    assert same_bits(single, double)
    assert single.grains.velocity[top[0], 0] == pytest.approx(1e-2 * np.sin(10.0), rel=1e-9)
    moved = (single.grains.position - state.grains.position)[top, 0]
    np.testing.assert_allclose(moved, 1e-2 * (1 - np.cos(10.0)), rtol=2e-3)  # linear between knots


WRONG = {
    "only along periodic axes": lambda s: s._replace(cell=s.cell._replace(periodic=np.array([True, False, True]))),
    "walls or rigid groups": lambda s: s._replace(control=ss.control.rigid(s.control, [0, 1])),
    "cell_mass is -1: it must be zero or positive": lambda s: s._replace(control=s.control._replace(cell_mass=-1.0)),
    "knots must increase": lambda s: s._replace(
        control=s.control._replace(knots=np.array([1.0, 1.0]), course=np.ones((2, 1)))
    ),
    r"cell_follows\[0, 0\] is 3": lambda s: s._replace(control=s.control._replace(cell_follows=np.full((3, 3), 3))),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_contradictory_cells_are_refused(name):
    with pytest.raises(ValueError, match=name):
        ss.packings.check(WRONG[name](sheared(n=20)))


def test_wrong_arguments_of_control_are_refused():
    control = ss.control.loads(2)
    with pytest.raises(ValueError, match=r"a stress component has two letters, .* got 'yq'"):
        ss.control.stress_controlled(control, {"yq": 1.0})
    with pytest.raises(ValueError, match=r"got \(3,\)"):
        ss.control.strained_at(control, [1, 2, 3])
    with pytest.raises(ValueError, match="3 times and 2 values"):
        ss.control.time_dependent(control, [0], [0, 1, 2], [1, 1])
    with pytest.raises(ValueError, match="got 'box'"):
        ss.control.time_dependent(control, "box", [0, 1], [1, 1])
