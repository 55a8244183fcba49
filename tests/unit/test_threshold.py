"""Kinetic threshold: the fit to outcomes, and a block whose sliding distance has a closed form."""

import numpy as np
import pytest
from scipy.special import expit

import stickslip as ss
from stickslip.loading.threshold import fit_threshold

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


@pytest.mark.parametrize("width", [0.02, 0.2])
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
