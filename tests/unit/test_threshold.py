"""Kinetic threshold: the fit to outcomes, and a block whose sliding distance has a closed form."""

import numpy as np
import pytest
from scipy.special import expit

import stickslip as ss
from stickslip.loading.threshold import fit_threshold, travel

PRESS, MU, MASS = 0.01, 0.4, 1.0
LAW = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=1.0, mu=MU, coulomb="sharp"), 0, 1)


def block():
    """A disk that can only move along the substrate, at rest: it slides as a block under friction μ PRESS."""
    state = ss.packings.disk_array(1, press=PRESS, mass=MASS, gap=0.5)
    free = state.control.free.copy()
    free[0, 3:] = False
    state, outcome = ss.relax(state._replace(control=state.control._replace(free=free)), LAW, tolerance=1e-14)
    assert outcome.ok
    free[0, 1] = False
    return state._replace(control=state.control._replace(free=free))


def path_and_protocol(loads):
    protocol = ss.protocols.Protocol(
        LAW, ss.packings.with_push, lambda state, load: ss.relax(state, LAW, tolerance=1e-13)
    )
    return ss.protocols.ramp(block(), loads, protocol), protocol


def test_a_block_slides_where_its_kinetic_energy_suffices():
    loads, kick, runs = [0.0, 0.001, 0.002, 0.003, 0.0035], 0.03, 8
    path, protocol = path_and_protocol(loads)
    found = ss.protocols.kinetic_threshold(
        path, protocol, kicks=kick, realizations=runs, duration=2000.0, dt=0.1, workers=1, seed=5
    )
    velocity = np.array([np.random.default_rng(5 + k).normal(0.0, kick, (1, 6))[0, 0] for k in range(runs)])
    for load, slid in zip(loads, found.slid[:, 0], strict=True):
        # the disk drifts to a distance of v²/(2 a), a = (μ N ∓ F)/m, plus the deflection of its spring
        decelerated = (MU * PRESS - np.sign(velocity) * load) / MASS
        distance = velocity**2 / (2 * decelerated)
        sure, possible = (distance > 0.1 + margin for margin in (0.02, -0.02))
        assert sure.sum() <= slid <= possible.sum()
    assert np.isnan(found.first_pair) and 0 < found.slid.sum() < found.runs.sum()
    assert np.isfinite(found.lifetime[found.slid > 0]).all() and np.isnan(found.lifetime[found.slid == 0]).all()


def test_a_sliding_block_stops_below_the_static_limit():
    loads = [0.0, 0.001, 0.002, 0.003, 0.0039]
    path, protocol = path_and_protocol(loads)
    found = ss.protocols.kinetic_threshold(
        path, protocol, loads=[0.0039], kicks=0.05, realizations=3, duration=4000.0, dt=0.1, workers=1
    )
    assert found.slid.sum() > 0 and found.arrest is None  # there is no lower load to go to
    found = ss.protocols.kinetic_threshold(
        path, protocol, kicks=0.05, realizations=3, duration=4000.0, dt=0.1, workers=1
    )
    assert found.arrest[1] <= MU * PRESS  # friction is the same at rest and in motion


def test_the_lifetime_is_the_end_of_the_leg_in_which_the_block_had_slid():
    kick, duration = 0.05, 400.0
    path, protocol = path_and_protocol([0.0, 0.001])
    found = ss.protocols.kinetic_threshold(
        path, protocol, kicks=kick, realizations=1, duration=duration, dt=0.1, workers=1, seed=5, ramp_down=False
    )
    velocity = np.random.default_rng(5).normal(0.0, kick, (1, 6))[0, 0]
    for load, lifetime in zip(found.loads, found.lifetime[:, 0], strict=True):
        slower = (MU * PRESS - np.sign(velocity) * load) / MASS
        time = (abs(velocity) - np.sqrt(velocity**2 - 2 * slower * 0.1)) / slower
        leg = duration / 40
        assert lifetime == pytest.approx(leg * np.ceil(time / leg)) and time % leg > 0.2 * leg


@pytest.mark.parametrize("width", [0.02, pytest.param(0.2, marks=pytest.mark.slow)])
def test_thresholds_of_known_curves_lie_within_their_intervals(width):
    loads, runs, true, inside = np.linspace(0.0, 1.0, 11), 20, 0.43, 0
    rng = np.random.default_rng(1)
    for _ in range(60):
        slid = rng.binomial(runs, expit((loads - true) / width))
        at, (low, high), _ = fit_threshold(loads, slid, np.full(11, runs))
        assert low <= at <= high
        inside += low <= true <= high
    assert inside >= 52  # 95 % of 60 are 57; fewer than 52 are expected in 1 of 200 repetitions


def test_what_bounds_nothing_has_an_infinite_interval():
    loads, runs = np.linspace(0, 1, 5), np.full(5, 10)
    assert np.isnan(fit_threshold(loads, [0, 0, 0, 0, 0], runs)[0])
    assert np.isnan(fit_threshold(loads, runs, runs)[0])
    at, (low, high), _ = fit_threshold(loads, [0, 0, 0, 10, 10], runs)
    assert 0.48 <= low <= at <= high <= 0.77 and high - low > 0.2
    assert fit_threshold(loads, [4, 5, 5, 5, 6], runs)[1] == (-np.inf, np.inf)


def test_loads_off_the_path_are_refused():
    path, protocol = path_and_protocol([0.0, 0.001])
    with pytest.raises(ValueError, match=r"loads = \[0.5\] were given: the path has"):
        ss.protocols.kinetic_threshold(path, protocol, loads=[0.5], duration=10.0, dt=0.1)
    for wrong in ([], [np.nan], -0.1, np.inf, "fast", [[0.1]]):
        with pytest.raises(ValueError, match="one or more velocities"):
            ss.protocols.kinetic_threshold(path, protocol, kicks=wrong, duration=10.0, dt=0.1)
    with pytest.raises(ValueError, match="were given: the path has"):
        ss.protocols.kinetic_threshold(path, protocol, loads=[np.nan], duration=10.0, dt=0.1)
    with pytest.raises(ValueError, match="at least 40 steps"):
        ss.protocols.kinetic_threshold(path, protocol, duration=1.0, dt=0.1)
    with pytest.raises(ValueError, match="stable only up to"):
        ss.protocols.kinetic_threshold(path, protocol, duration=1e4, dt=50.0)
    with pytest.raises(ValueError, match="loads that rise"):
        ss.protocols.kinetic_threshold(path[::-1], protocol, duration=10.0, dt=0.1)
    with pytest.raises(ValueError, match="seed"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, seed=-1)
    with pytest.raises(ValueError, match="duration"):
        ss.protocols.kinetic_threshold(path, protocol, duration=-1.0, dt=0.1)


def test_a_sliding_block_stops_at_the_first_lower_load_however_fast_it_is():
    """Below the limit, friction is the same at any velocity: a block that slides for many distances still stops."""
    loads = [0.0005, 0.001, 0.0015, 0.002]
    path, protocol = path_and_protocol(loads)
    found = ss.protocols.kinetic_threshold(
        path, protocol, kicks=0.1, realizations=4, duration=400.0, dt=0.1, workers=1, seed=5
    )
    assert found.slid[-1].sum() and found.arrest == (0.0015, 0.002)


def test_travel_is_the_strain_of_a_cell_the_way_of_a_plate_and_else_the_median_way():
    state = ss.assembly(ss.spheres([[0, 0, 0], [0, 1, 0], [3, 0, 0]], 0.25), cell=ss.box([4.0, 4.0, 4.0], [True] * 3))
    ways = np.array([[0.1, 0, 0], [0.3, 0.4, 0], [1.0, 0, 0]])
    moved = state._replace(grains=state.grains._replace(position=state.grains.position + ways))
    assert travel(state, moved) == pytest.approx(0.5 / 0.5)
    plated = state._replace(control=ss.control.rigid(state.control, [2]))
    assert travel(plated, moved) == pytest.approx(1.0 / 0.5)
    held = plated._replace(control=ss.control.fixed(plated.control, [2]))  # a plate that cannot move does not count
    assert travel(held, moved) == pytest.approx(0.5 / 0.5)
    stressed = state._replace(control=ss.control.stress_controlled(state.control, {"yy": 1.0, "xy": 0.1}))
    once = ss.packings.sheared(stressed, 0.2)
    assert travel(stressed, once) == pytest.approx(0.2)
    assert travel(once, ss.packings.sheared(once, -0.05)) == pytest.approx(0.05)


def test_a_cell_under_stress_has_that_stress_and_no_other_strain():
    law = ss.laws.hertz_mindlin(mu=0.5, coulomb="sharp")
    state, _ = ss.packings.jammed(20, pressure=1e-3, dim=2, seed=3)
    path = ss.protocols.ramp(state, [0.0, 0.05, 0.1], ss.protocols.cell_shear(law, 2e-3))
    for point in path:
        stress = ss.measure.stress(point.state, law)
        assert stress[1, 1] == pytest.approx(2e-3, rel=1e-6)
        assert -stress[0, 1] / stress[1, 1] == pytest.approx(point.load, abs=1e-6)
        assert point.state.cell.vectors[0] == pytest.approx(state.cell.vectors[0])  # neither width nor lean along y
    assert np.all(np.diff([ss.measure.shear_strain(p.state) for p in path]) > 0)


def plate(press):
    """Two spheres that form a plate, pressed on a wall."""
    control = ss.control.rigid(ss.control.loads(2, 1), [0, 1])
    control = ss.control.force_controlled(control, [0, 1], [0, -press])
    wall = ss.flat_walls([0, 0, 0], [0, 1, 0], material=1)
    grains = ss.spheres([[0, 0.5 - press, 0], [2, 0.5 - press, 0]], 0.5)
    return ss.assembly(grains, wall, ss.box([4.0, 4.0, 4.0], [True, False, True]), control)


def test_a_plate_moves_by_force_over_stiffness():
    press, kt = 0.01, 0.5
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=kt, mu=0.4, coulomb="sharp"), 0, 1)
    path = ss.protocols.ramp(plate(press), [0.0, 0.1, 0.35], ss.protocols.plate_shear(law, [0, 1]))
    for point in path:
        way = point.state.grains.position - path[0].state.grains.position
        np.testing.assert_allclose(way[:, 0], point.load * press / kt, rtol=1e-6, atol=1e-12)
    with pytest.raises(ValueError, match="a plate is pressed along −y"):
        ss.protocols.plate_shear(law, [2]).step(path[0].state, 0.0)


@pytest.mark.slow
def test_a_plate_has_no_equilibrium_beyond_friction():
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.4, coulomb="sharp"), 0, 1)
    protocol = ss.protocols.plate_shear(law, [0, 1])
    with pytest.raises(ss.NotInEquilibriumError, match=r"no equilibrium at a load of 0\.45"):
        protocol.step(plate(0.01), 0.45)
