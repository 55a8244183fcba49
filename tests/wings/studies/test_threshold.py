"""Kinetic threshold: the fit to outcomes, a block whose sliding distance has a closed form, and a grain on bumps."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from scipy.special import expit

import stickslip as ss
from stickslip.core.contacts.forces import forces
from stickslip.core.state import SLIDE
from stickslip.loading import threshold as kinetic
from stickslip.loading.packing import wrapped
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


def first_velocity(seed, load, kick, number):
    """Velocity along x with which a run of one grain starts."""
    return np.random.default_rng(kinetic._seed(seed, load, kick, number)).normal(0.0, kick, (1, 6))[0, 0]


def test_a_block_slides_where_its_kinetic_energy_suffices():
    loads, kick, runs = [0.0, 0.001, 0.002, 0.003, 0.0035], 0.03, 5
    path, protocol = path_and_protocol(loads)
    threshold = ss.protocols.kinetic_threshold(
        path, protocol, kicks=kick, realizations=runs, duration=2000.0, dt=0.1, workers=1, seed=5
    )
    for load, slid in zip(loads, threshold.slid[:, 0], strict=True):
        velocity = np.array([first_velocity(5, load, kick, k) for k in range(runs)])
        # the disk drifts to a distance of v²/(2 a), a = (μ N ∓ F)/m, plus the deflection of its spring
        decelerated = (MU * PRESS - np.sign(velocity) * load) / MASS
        distance = velocity**2 / (2 * decelerated)
        sure, possible = (distance > 0.1 + margin for margin in (0.02, -0.02))
        assert sure.sum() <= slid <= possible.sum()
    assert np.isnan(threshold.first_pair) and 0 < threshold.slid.sum() < threshold.runs.sum()
    # friction is the same at rest and in motion: below the static limit, a block slides by some distance, and stops
    assert not threshold.lasting.any() and threshold.arrest.shape == (0, 2)
    assert "keep sliding" not in "; ".join(threshold.sentences).replace("never keep sliding for another 2000", "")
    assert "no run keeps sliding, so the load cannot be lowered" in "; ".join(threshold.sentences)


def test_the_lifetime_is_the_end_of_the_leg_in_which_the_block_had_slid():
    kick, duration = 0.05, 400.0
    path, protocol = path_and_protocol([0.0, 0.001])
    threshold = ss.protocols.kinetic_threshold(
        path, protocol, kicks=kick, realizations=1, duration=duration, dt=0.1, workers=1, seed=25, ramps=0
    )
    for load, lifetime in zip(threshold.loads, threshold.lifetime[:, 0], strict=True):
        velocity = first_velocity(25, load, kick, 0)
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


def profile(loads, slid, runs, at):
    """Largest log-likelihood of a logistic curve with a given threshold."""

    def negative(log_width):
        x = (loads - at) / np.exp(log_width)
        return (slid * np.logaddexp(0, -x) + (runs - slid) * np.logaddexp(0, x)).sum()

    return -minimize_scalar(negative, bounds=(-8, 3), method="bounded", options={"xatol": 1e-10}).fun


def test_ends_of_the_interval_are_those_of_the_likelihood_ratio():
    loads, slid, runs = np.linspace(0, 1, 9), np.array([0, 0, 1, 1, 5, 7, 10, 9, 10]), np.full(9, 10)
    at, (low, high), _ = fit_threshold(loads, slid, runs)
    best = minimize_scalar(lambda x: -profile(loads, slid, runs, x), bounds=(0.2, 0.8), method="bounded")
    assert at == pytest.approx(best.x, abs=2e-3)

    def excess(x):
        return profile(loads, slid, runs, x) + best.fun + 3.841459 / 2  # 95 % quantile of χ² with one degree of freedom

    assert low == pytest.approx(brentq(excess, 0.2, best.x), abs=3e-3)
    assert high == pytest.approx(brentq(excess, best.x, 0.8), abs=3e-3)


@pytest.mark.slow
def test_intervals_of_kicked_blocks_contain_what_many_runs_give():
    """Outcomes in closed form, of blocks that are pushed the way they move, with the velocities of the package."""
    loads, kick, runs, inside = np.linspace(0, 0.0038, 20), 0.02, 10, 0

    def slides(velocity, load):
        return velocity**2 / (2 * (MU * PRESS - load)) > 0.1

    many = np.random.default_rng(0).normal(0.0, kick, 400_000)
    expected = np.array([slides(many, load).mean() for load in loads])
    true = fit_threshold(loads, 1e4 * expected, np.full(20, 1e4))[0]
    for seed in range(200):
        velocity = [[first_velocity(seed, load, kick, k) for k in range(runs)] for load in loads]
        slid = [slides(np.array(v), load).sum() for v, load in zip(velocity, loads, strict=True)]
        _, (low, high), _ = fit_threshold(loads, slid, np.full(20, runs))
        inside += low <= true <= high
    assert inside >= 181  # 95 % of 200 are 190; fewer than 181 are expected in 1 of 200 repetitions


@pytest.mark.parametrize(
    "slid",
    [[0, 1, 0, 0, 0], [10, 9, 9, 8, 8], [10, 10, 5, 0, 0], [0, 0, 0, 0, 1], [9, 10, 10, 10, 10], [3, 3, 3, 3, 3]],
)
def test_a_threshold_that_the_loads_do_not_bracket_is_not_stated(slid):
    at, interval, width = fit_threshold([0, 0.25, 0.5, 0.75, 1], slid, [10] * 5)
    assert np.isnan(at) and interval == (-np.inf, np.inf) and np.isnan(width)
    said = kinetic._describe_rise("slide", at, interval, np.array(slid) / 10)
    assert said == "slide from a load that is not bracketed by these loads"


def test_runs_that_always_or_never_slide_are_called_so():
    assert kinetic._describe_rise("slide", np.nan, (-np.inf, np.inf), np.zeros(3)) == "never slide"
    assert kinetic._describe_rise("slide", np.nan, (-np.inf, np.inf), np.ones(3)) == "always slide"


def test_what_bounds_nothing_has_an_infinite_interval():
    loads, runs = np.linspace(0, 1, 5), np.full(5, 10)
    assert np.isnan(fit_threshold(loads, [0, 0, 0, 0, 0], runs)[0])
    assert np.isnan(fit_threshold(loads, runs, runs)[0])
    at, (low, high), _ = fit_threshold(loads, [0, 0, 0, 10, 10], runs)
    assert 0.48 <= low <= at <= high <= 0.77 and high - low > 0.2
    assert fit_threshold(loads, [4, 5, 5, 5, 6], runs)[1] == (-np.inf, np.inf)


def test_loads_off_the_path_are_refused():
    path, protocol = path_and_protocol([0.0, 0.001])
    with pytest.raises(ValueError, match=r"the path does not contain loads = \[0.5\]: it has"):
        ss.protocols.kinetic_threshold(path, protocol, loads=[0.5], duration=10.0, dt=0.1)
    for wrong in ([], [np.nan], -0.1, np.inf, "fast", [[0.1]]):
        with pytest.raises(ValueError, match="one or more velocities"):
            ss.protocols.kinetic_threshold(path, protocol, kicks=wrong, duration=10.0, dt=0.1)
    with pytest.raises(ValueError, match="the path does not contain loads"):
        ss.protocols.kinetic_threshold(path, protocol, loads=[np.nan], duration=10.0, dt=0.1)
    with pytest.raises(ValueError, match="at least 40 steps"):
        ss.protocols.kinetic_threshold(path, protocol, duration=1.0, dt=0.1)
    with pytest.raises(ValueError, match="dt = 50 is unstable: with contacts this stiff"):
        ss.protocols.kinetic_threshold(path, protocol, duration=1e4, dt=50.0)
    with pytest.raises(ValueError, match="the loads of a path must increase"):
        ss.protocols.kinetic_threshold(path[::-1], protocol, duration=10.0, dt=0.1)
    for wrong in (-1, 2**70):
        with pytest.raises(
            ValueError, match=rf"seed must be (a whole number from 0 to 1e18|at most 18446744073709551615), got {wrong}"
        ):
            ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, seed=wrong)
    with pytest.raises(ValueError, match="realizations must be a whole number from 1 to"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, realizations=True)
    with pytest.raises(ValueError, match="ramps must be a whole number from 0 to 1e18, got -1"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, ramps=-1)
    with pytest.raises(ValueError, match="loads must be numbers, or None for all loads of the path, got 'all'"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, loads="all")
    with pytest.raises(ValueError, match="must be distinct"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, kicks=[0.1, 0.2, 0.1])
    with pytest.raises(ValueError, match="move by more than a radius in a step: use smaller velocities"):
        ss.protocols.kinetic_threshold(path, protocol, duration=10.0, dt=0.1, kicks=1e3)
    with pytest.raises(ValueError, match="duration"):
        ss.protocols.kinetic_threshold(path, protocol, duration=-1.0, dt=0.1)


NUMBER, DRAG, BUMP_PRESS = 20, 0.02, 0.01
SMOOTH = ss.laws.linear(kn=1.0, kt=0.5, mu=0.0)
BUMPS = {"kicks": 0.3, "realizations": 3, "duration": 400.0, "dt": 0.2, "drag": DRAG, "distance": 2.0, "workers": 1}


def grain_on_bumps(number):
    """A pressed grain without friction on a periodic row of fixed ones."""
    places = [*([k, 0, 0] for k in range(number)), [0.5, np.sqrt(0.75) - 0.005, 0]]
    control = ss.control.rigid(ss.control.fixed(ss.control.loads(number + 1), list(range(number))), [number])
    control = ss.control.force_controlled(control, [number], [0, -BUMP_PRESS])
    control.free[number, 3:] = False
    cell = ss.box([number, 4.0, 4.0], [True, False, False], dim=2)
    return ss.assembly(ss.spheres(places, 0.5, mass=1.0), cell=cell, control=control)


@pytest.fixture(scope="module")
def bumps():
    """Path and protocol of the grain. It is held up to a load of tan 30° = 0.58; with little drag it slides on."""
    protocol = ss.protocols.plate_shear(SMOOTH, [NUMBER])
    return ss.protocols.ramp(grain_on_bumps(NUMBER), [0.0, 0.05, 0.15, 0.3], protocol), protocol


def hold(state, load):
    """State after a duration under a load, and ways in each quarter, none if one is below half a diameter; by hand."""
    force = state.control.force.copy()
    force[NUMBER, :2] = [load * BUMP_PRESS, -BUMP_PRESS]
    state, ways = state._replace(control=state.control._replace(force=force)), []
    for _ in range(4):
        before = state.grains.position[NUMBER]
        state, _, _ = ss.run(state, SMOOTH, 500, 0.2, drag=DRAG, threads=1)
        ways.append(np.linalg.norm(state.grains.position[NUMBER] - before))
        if ways[-1] < 0.5:
            return state, []
    return state, ways


def start_sliding(point, seed, number):
    """State in which a kicked grain has moved by two diameters; None if it does not within the duration."""
    state = ss.packings.perturbed(point.state, kinetic._seed(seed, point.load, 0.3, number), 0.3)
    for _ in range(40):
        state, _, _ = ss.run(state, SMOOTH, 50, 0.2, drag=DRAG, threads=1)
        if np.linalg.norm((state.grains.position - point.state.grains.position)[NUMBER]) > 2:
            return state
    return None


def test_runs_that_last_and_ramps_down_are_those_of_dynamics_by_hand(bumps):
    """Forces are set and runs are judged without the protocol and the threshold of the package."""
    path, protocol = bumps
    threshold = ss.protocols.kinetic_threshold(path, protocol, loads=[0.05, 0.15, 0.3], seed=3, **BUMPS)
    for point, slid, lasting in zip(path[1:], threshold.slid[:, 0], threshold.lasting[:, 0], strict=True):
        begun = [state for k in range(3) if (state := start_sliding(point, 3, k)) is not None]
        assert len(begun) == slid and sum(bool(hold(state, point.load)[1]) for state in begun) == lasting
    assert threshold.lasting[0, 0] == 0 < threshold.slid[0, 0] and threshold.lasting[2, 0] == 3
    for k, (low, high) in enumerate(threshold.arrest):
        state = start_sliding(path[3], 3, k)
        stops, above = -np.inf, 0.3
        for load in (0.15, 0.05):
            state, ways = hold(state, load)
            while ways and ways[3] < 0.95 * ways[0]:  # it still slows down
                state, ways = hold(state, load)
            if not ways:
                stops = load
                break
            above = load
        assert (low, high) == (stops, above)
    assert len(threshold.arrest) == 3 and len(np.unique(threshold.arrest[:, 0])) > 1  # one ramp down does not tell
    assert threshold.arrest_range == (threshold.arrest[:, 0].min(), threshold.arrest[:, 1].max())
    assert (
        f"3 of 3 sliding samples stop between {threshold.arrest_range[0]:g} and {threshold.arrest_range[1]:g}"
        in "; ".join(threshold.sentences)
    )
    assert "slide by 2" in "; ".join(threshold.sentences) and "keep sliding for another 400 from 0" in "; ".join(
        threshold.sentences
    )


def test_a_sample_that_slides_at_every_load_has_not_stopped(bumps):
    path, protocol = bumps
    threshold = ss.protocols.kinetic_threshold(path, protocol, loads=[0.3], ramps=2, **BUMPS)
    assert threshold.arrest.tolist() == [[-np.inf, 0.3]] * 2
    assert "2 of 2 still slide at 0.3, the lowest of these loads" in "; ".join(
        threshold.sentences
    ) and "stop between" not in "; ".join(threshold.sentences)
    threshold = ss.protocols.kinetic_threshold(path, protocol, loads=[0.3], ramps=0, **BUMPS | {"realizations": 1})
    assert threshold.arrest.shape == (0, 2) and np.isnan(threshold.arrest_range).all()
    assert "still slide" not in "; ".join(threshold.sentences) and "cannot be lowered" not in "; ".join(
        threshold.sentences
    )


def test_runs_are_independent_and_do_not_depend_on_what_else_is_run(bumps, monkeypatch):
    path, protocol = bumps
    seeds, perturbed = [], kinetic.perturbed
    monkeypatch.setattr(
        kinetic, "perturbed", lambda state, seed, kick: seeds.append(seed) or perturbed(state, seed, kick)
    )
    how = BUMPS | {"realizations": 2, "duration": 40.0, "ramps": 0, "kicks": [0.1, 0.3]}
    both = ss.protocols.kinetic_threshold(path, protocol, loads=[0.15, 0.3], **how)
    assert len(set(seeds)) == len(seeds) == 2 * 2 * 2
    threshold = ss.protocols.kinetic_threshold(path, protocol, loads=[0.3], **how | {"kicks": 0.3})
    assert seeds[8:] == seeds[6:8] and threshold.lifetime[0, 0] == pytest.approx(both.lifetime[1, 1], nan_ok=True)
    ss.protocols.kinetic_threshold(path, protocol, loads=[0.3], seed=1, **how)
    assert not set(seeds[10:]) & set(seeds[:10])


def test_lifetimes_are_medians_over_all_runs_and_static_loads_are_the_smallest(monkeypatch):
    """Outcomes that are given: times until a run has slid, NaN if it did not, and whether it lasted."""
    path, protocol = path_and_protocol([0.0, 0.001, 0.002, 0.003])
    limit = path[2].state
    limit.contacts.reached[0], limit.contacts.mode[0] = True, SLIDE
    path[2] = path[2]._replace(state=limit)
    path[3] = path[3]._replace(state=path[3].state._replace(contacts=limit.contacts))
    values = np.append(1 + 1j, path[0].spectrum.eigenvalues[1:])
    path[1:] = [point._replace(spectrum=point.spectrum._replace(eigenvalues=values)) for point in path[1:]]
    told = iter([
        *[(np.nan, 0)] * 3,
        *[(30.0, 0), (np.nan, 0), (np.nan, 0)],
        *[(10.0, 0), (np.nan, 0), (20.0, 1)],
        *[(4.0, 1), (30.0, 1), (6.0, 0)],
    ])  # fmt: skip
    monkeypatch.setattr(kinetic, "_kick", lambda *task: np.array(next(told)))
    threshold = ss.protocols.kinetic_threshold(
        path, protocol, kicks=0.1, realizations=3, duration=40.0, dt=0.1, workers=1, ramps=0
    )
    assert threshold.lifetime[:, 0].tolist() == pytest.approx([np.nan, np.nan, 20.0, 6.0], nan_ok=True)
    assert threshold.slid[:, 0].tolist() == [0, 1, 2, 3] and threshold.lasting[:, 0].tolist() == [0, 0, 1, 2]
    assert threshold.first_pair == 0.001 and threshold.first_limit == 0.002
    fits = [
        fit_threshold(threshold.loads, counts[:, 0], threshold.runs[:, 0])
        for counts in (threshold.slid, threshold.lasting)
    ]
    assert [threshold.threshold[0], threshold.lasting_threshold[0]] == [at for at, _, _ in fits]
    assert threshold.threshold[0] < threshold.lasting_threshold[0] and threshold.lasting_width[0] == fits[1][2]
    assert [tuple(threshold.interval[0]), tuple(threshold.lasting_interval[0])] == [ends for _, ends, _ in fits]


def test_states_that_are_not_at_rest_at_their_loads_are_refused():
    law = ss.laws.hertz_mindlin(mu=0.5, coulomb="sharp")
    state, _ = ss.packings.jammed(20, pressure=1e-3, dim=2, seed=3)
    protocol = ss.protocols.cell_shear(law, 1e-3)
    path = ss.protocols.ramp(state, [0.0, 0.05, 0.1], protocol)
    how = {"kicks": 1e-6, "realizations": 1, "duration": 4.0, "dt": 0.1, "workers": 1}
    moving = path[1]._replace(state=ss.packings.perturbed(path[1].state, 1, 1e-3))
    for wrong in (moving, path[1]._replace(load=0.06)):
        with pytest.raises(
            ValueError, match=r"the state of the path at a load of 0.0[56] is not at rest there .*: use equilibria"
        ):
            ss.protocols.kinetic_threshold([path[0], wrong, path[2]], protocol, **how)
        ss.protocols.kinetic_threshold([path[0], wrong, path[2]], protocol, loads=[0.0, 0.1], **how)  # it is not used


def test_travel_is_the_strain_of_a_cell_the_path_of_a_plate_or_else_the_median_displacement():
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


def test_wrapped_grains_have_the_same_forces_and_go_on_alike():
    law = ss.laws.hertz_mindlin(mu=0.5, coulomb="sharp", damping_n=0.1)
    state, _ = ss.packings.jammed(20, pressure=1e-3, dim=2, seed=3)
    state, _, _ = ss.run(ss.packings.perturbed(ss.packings.sheared(state, 5.3), 1, 0.3), law, 2000, 0.1, threads=1)
    inside = wrapped(ss.packings.reduced_cell(state))
    share = inside.grains.position[:, :2] @ np.linalg.inv(inside.cell.vectors[:2, :2])
    assert (share >= 0).all() and (share < 1).all() and np.abs(state.contacts.image).max() > 2
    assert np.abs(inside.contacts.image[: inside.contacts.count[0]]).max() <= 1
    for mine, other in zip(forces(state, law)[0][:2], forces(inside, law)[0][:2], strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-12)
    later, then = (ss.run(start, law, 200, 0.1, threads=1)[0] for start in (state, inside))
    np.testing.assert_allclose(later.grains.velocity, then.grains.velocity, atol=1e-9)


def test_wrapped_grains_on_a_wall_have_the_same_forces_and_go_on_alike():
    state, _ = ss.relax(ss.packings.with_push(ss.packings.disk_array(3, press=1e-3), 1e-4), LAW)
    state.grains.velocity[:, 0] = 0.5
    state, _, _ = ss.run(state, LAW, 200, 0.1, threads=1)
    inside = wrapped(state)
    shift = (state.grains.position - inside.grains.position)[:, 0]
    assert (inside.grains.position[:, 0] < 3).all() and (shift > 3).all() and np.allclose(shift % 3, 0)
    for mine, other in zip(forces(state, LAW)[0][:2], forces(inside, LAW)[0][:2], strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-14)
    later, then = (ss.run(start, LAW, 200, 0.1, threads=1)[0] for start in (state, inside))
    np.testing.assert_allclose(later.grains.velocity, then.grains.velocity, atol=1e-12)


def test_a_plate_that_slides_by_more_than_64_boxes_goes_on():
    start = ss.protocols.plate_shear(SMOOTH, [4]).apply(grain_on_bumps(4), 1.0)
    with pytest.raises(ValueError, match="64 or more periodic boxes apart"):
        ss.run(start, SMOOTH, 8000, 0.2, drag=DRAG, threads=1)
    how = kinetic._Dynamics(SMOOTH, 8000, 0.2, 2.0, DRAG)
    (begun,), end = kinetic._run_leg((start,), start, how, 8000)
    assert travel(begun, end) > 64 * 4 and np.ptp(end.grains.position[:, 0]) < 4 * kinetic.FAR


def test_a_flow_by_more_than_a_hundred_boxes_goes_on():
    """The leg is too long for the list of neighbours, which holds images up to 64 boxes away."""
    law = ss.laws.hertz_mindlin(mu=0.5, coulomb="sharp", damping_n=0.1, damping_t=0.1)
    state, _ = ss.packings.jammed(20, pressure=1e-3, dim=2, seed=3)
    start = ss.protocols.cell_shear(law, 1e-3).apply(state, 1.0)
    with pytest.raises(ValueError, match="64 or more periodic boxes apart"):
        ss.run(start, law, 9000, 0.3, threads=1)
    how = kinetic._Dynamics(law, 9000, 0.3, 0.1, 0.0)
    (begun,), end = kinetic._run_leg((start,), start, how, 9000)
    assert travel(begun, end) > 100
    assert np.abs(ss.measure.shear_strain(end)) < 64  # put back, or the list could not hold it
    assert travel(start, end) < 100  # the cell of the start is reduced as that of the end


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
    with pytest.raises(ValueError, match="the plate must be pressed along −y"):
        ss.protocols.plate_shear(law, [2]).step(path[0].state, 0.0)


@pytest.mark.slow
def test_a_plate_has_no_equilibrium_beyond_friction():
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.4, coulomb="sharp"), 0, 1)
    protocol = ss.protocols.plate_shear(law, [0, 1])
    with pytest.raises(ss.NotInEquilibriumError, match=r"no equilibrium at a load of 0\.45"):
        protocol.step(plate(0.01), 0.45)
