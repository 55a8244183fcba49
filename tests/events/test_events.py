"""Events of quasi-static shear: classes, brackets, independence of step and drag, and brute force."""

from itertools import pairwise

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.measure import touching
from stickslip.loading.event_class import fit_power, vanishes
from stickslip.loading.event_path import Judge, Point, commit, displacement
from stickslip.loading.events import Search
from stickslip.results import EventKind
from tests.events.packings import FRICTIONLESS, LINEAR, SMOOTH, STEP, found, packing, search


@pytest.fixture(scope="module")
def frictionless():
    return found(FRICTIONLESS, 3, 0.006, fraction=0.88)


@pytest.fixture(scope="module")
def sliding():
    return found(LINEAR, 3, 0.006, fraction=0.86)


def test_without_friction_only_saddle_nodes_happen(frictionless):
    assert frictionless.events
    for event in frictionless.events:
        assert event.kind is EventKind.SADDLE_NODE
        # the next term of the expansion changes a local exponent by some 1e-2 at the nearest distances
        assert abs(event.exponent - 0.5) < 0.03
        assert event.softest[-1] < 0.05 * event.softest[0]


@pytest.mark.slow
def test_without_friction_many_packings_have_only_saddle_nodes():
    events = [e for seed in range(8) for e in search(FRICTIONLESS, seed, 0.1, fraction=0.88).events]
    assert len(events) >= 10
    assert {e.kind for e in events} == {EventKind.SADDLE_NODE}
    assert abs(np.median([e.exponent for e in events]) - 0.5) < 0.01


@pytest.fixture(scope="module")
def varied():
    """Both searches in half the steps and with twice the drag, the second to a coarse resolution.

    The jump of its contact is about 0.75 % of the mean overlap, and it is asked for jumps above 0.5 %.
    """
    how = {"most": 1, "step": STEP / 2, "share": 0.2}
    coarse = {"resolution": 1e-5, "smallest": 0.005}
    return search(FRICTIONLESS, 3, 0.006, fraction=0.88, **how), search(LINEAR, 3, 0.006, **coarse, **how)


# 6 s: a search for events, on which several tests look
def test_brackets_are_as_narrow_as_the_resolution(frictionless, sliding, varied):
    assert varied[1].resolution == 1e-5 > sliding.resolution
    for record in (frictionless, sliding, *varied):
        assert record.events
        for event in record.events:
            assert 0 < event.strain - event.below <= record.resolution
            assert (np.diff(event.distances) < 0).all() and event.distances[0] <= record.step


# 6 s: two more searches for events, with another step and another drag
def test_events_do_not_depend_on_step_and_drag(frictionless, sliding, varied):
    """Newton's method adds the slip of a step at once, so that brackets move by the square of the step."""
    for record, known, most in zip(varied, (frictionless, sliding), (1e-6, 3e-5), strict=True):
        assert [e.kind for e in record.events] == [e.kind for e in known.events]
        assert [e.trigger for e in record.events] == [e.trigger for e in known.events]
        np.testing.assert_allclose(
            [e.strain for e in record.events], [e.strain for e in known.events], rtol=0, atol=most
        )


def test_a_contact_slides_while_the_spectrum_stays_flat(sliding):
    (event,) = sliding.events
    assert event.kind is EventKind.SLIDING
    assert np.isnan(event.exponent)
    assert np.ptp(event.softest[-3:]) < 1e-3 * event.softest[-1]  # constant to three digits until the event
    assert event.switched < 0 < event.softest[-1]
    assert event.mobilisation > 0.999


def test_smooth_friction_is_announced_on_the_same_packing(sliding):
    first = found(SMOOTH, 3, 0.006, fraction=0.86).events[0]
    assert first.kind in (EventKind.SADDLE_NODE, EventKind.PAIR)
    assert first.exponent > 0.4
    assert abs(first.strain - sliding.events[0].strain) < 2e-4


def walk(state, law, start, steps, width, nu):
    """Equilibria of damped dynamics after each of many small strain steps: the obvious and slow way."""
    judge = Judge(commit(state, law), law, nu)
    points = [Point(start, state, judge)]
    for k in range(1, steps + 1):
        moved = ss.packings.sheared(points[-1].state, width)
        end, outcome = ss.relax(moved, law, tolerance=1e-9 * judge.force, drag=nu, dt=0.1)
        assert outcome.ok
        points.append(Point(start + k * width, end, judge))
    return points


def jumps(points):
    return [
        float(np.sqrt((displacement(a.state, b.state, b.strain - a.strain)[:, :2] ** 2).mean()))
        for a, b in pairwise(points)
    ]


@pytest.mark.parametrize(
    ("law", "seed", "fraction"),
    [
        (FRICTIONLESS, 3, 0.88),
        (LINEAR, 3, 0.86),
        pytest.param(LINEAR, 5, 0.86, marks=pytest.mark.slow),
        (SMOOTH, 3, 0.86),
    ],
)
def test_brute_force_dynamics_agrees(law, seed, fraction):
    """Tiny strain steps with damped dynamics jump in the bracket, and as the class says: by the same contact, or by
    oscillations with the frequency of the pair."""
    event = found(law, seed, 0.006, fraction=fraction).events[0]
    before = search(law, seed, event.below - 2e-5, fraction=fraction, step=event.below / 8)
    assert not before.events
    points = walk(before.state, law, event.below - 2e-5, 36, 1e-6, before.drag)
    moved = jumps(points)
    where = int(np.argmax(moved))
    assert moved[where] > 20 * np.median(moved)
    # the last strain step before the event is shorter, which shifts the slip by the square of its length
    shift = 0.0 if law is FRICTIONLESS else 1e-5
    assert points[where].strain - 1e-6 - shift <= event.strain <= points[where + 1].strain + 1e-6 + shift
    if event.kind is EventKind.SLIDING:
        slides = sliding_contacts(points[where].state, law) | sliding_contacts(
            ss.relax(ss.packings.sheared(points[where].state, 1e-6), law, drag=before.drag, steps=20, dt=0.01)[0], law
        )
        assert event.trigger in slides
    last = points[where].eigenvalues
    pairs = last[last.imag > 0]
    assert (event.kind is EventKind.PAIR) == (len(pairs) > 0)
    if len(pairs):
        critical = pairs[np.argmin(pairs.real - (pairs.imag / before.drag) ** 2)]
        # ω differs from Re √λ by drag and nonlinearity, both below 1 %, and by the end of the sampled interval
        assert oscillation(points[where], law, before.drag) == pytest.approx(np.sqrt(critical).real, rel=0.01)


def oscillation(point, law, nu):
    """Angular frequency of the dynamics that follow a small strain step, from zeros of the largest velocity."""
    state = ss.packings.sheared(point.state, 1e-6)
    record = ss.run(state, law, 6000, 0.1, drag=nu, spin_drag=nu, every=10, probes=range(16))[1]
    # velocities when the fastest decaying modes are gone
    late = np.diff(record.position[300:, :, :2].reshape(301, -1), axis=0)
    zeros = np.flatnonzero(np.diff(np.sign(late[:, np.argmax((late**2).sum(axis=0))])))
    return np.pi / np.diff(zeros).mean()


def sliding_contacts(state, law):
    contacts, rows = state.contacts, touching(state)
    return {(int(contacts.i[r]), int(contacts.j[r])) for r in rows if contacts.mode[r] == ss.SLIDE}


def test_dynamics_confirms_the_switch_test(sliding):
    """With the trigger made unable to slide, the packing passes the event."""
    record = sliding
    event = record.events[0]
    free = packing(LINEAR, 3)
    stuck = ss.laws.linear(mu=1e3)  # no contact slides
    passed = ss.protocols.find_events(free, stuck, to=0.006, drag=record.drag, step=STEP)
    assert all(abs(other.strain - event.strain) > 1e-5 for other in passed.events)


def test_every_kind_of_result_is_complete(frictionless):
    steps = frictionless.steps
    assert len(steps.strain) == 5  # with the one in which the event happens
    for values in steps:
        assert values.shape == steps.strain.shape
    assert np.isfinite(steps.softest).all() and (steps.pressure > 0).all()
    assert np.isnan(steps.switch).all()  # nothing sticks
    event = frictionless.events[0]
    assert event.jump > 0 and 1 / 16 <= event.participation <= 1
    assert "a real eigenvalue reaches zero at strain 0.0049" in repr(event)
    assert "1 event" in repr(frictionless)


def test_drag_decides_which_pairs_are_events():
    """Without much drag, a pair starts an event that a strong drag suppresses."""
    (weak,) = found(SMOOTH, 3, 0.006, fraction=0.86).events
    assert weak.kind is EventKind.PAIR
    assert not search(SMOOTH, 3, weak.strain + 1e-6, share=2.0).events


def test_exponents_are_fitted_to_power_laws():
    distances = 1e-3 * 8.0 ** -np.arange(5)
    for power in (0.5, 1.0, 1.5):
        assert fit_power(distances, 3 * distances**power, 0.0) == pytest.approx((power, 0), abs=1e-6)
        # the first correction of a saddle node, a third of the value at the largest distance
        values = distances**power
        assert fit_power(distances, values * (1 + 0.3 * values / values[0]), 0.0)[0] == pytest.approx(power, abs=0.005)
    for values in (-distances, np.ones(5), distances[::-1]):
        assert np.isnan(fit_power(distances, values, 0.0)).all()
    assert np.isnan(fit_power(distances[:2], distances[:2], 0.0)[0])


LEAD = np.geomspace(1e-3, 1e6, 4001)  # coordinate along a branch that ends at 0
CORRECTIONS = {  # distance d and value λ along it, for corrections of size s; λ ∝ d^p near the end
    "of the branch": (0.5, lambda s: (LEAD**2 * (1 + s * LEAD), LEAD)),
    "of the value": (0.5, lambda s: (LEAD**2, LEAD * (1 + s * LEAD) / (1 + 2 * s * LEAD))),
    "by another mode": (0.5, lambda s: (LEAD**2, LEAD / (1 + 10 * s * LEAD))),
    "of a real part": (1.0, lambda s: (LEAD, LEAD * (1 + s * LEAD**2) / (1 + s * LEAD + s * LEAD**2))),
}


@pytest.mark.parametrize("kind", CORRECTIONS)
@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2])
def test_errors_of_exponents_cover_what_is_not_known(kind, size):
    """The event lies anywhere in its bracket, the nearest distance is 16 brackets: p within two errors in 95 %."""
    power, series = CORRECTIONS[kind]
    distances = 16 * 8.0 ** np.arange(3, -1, -1)
    inside = []
    for offset in np.linspace(-0.5, 0.5, 41):
        values = np.exp(np.interp(np.log(distances + offset), *np.log(series(size))))
        exponent, error = fit_power(distances, values, 1.0)
        inside.append(abs(exponent - power) <= 2 * error)
        assert abs(exponent - power) <= 3 * error
        assert vanishes(exponent, error)
    assert np.mean(inside) >= 0.95


def test_exponents_of_a_contact_that_is_about_to_open_are_between_a_third_and_a_half():
    """d = A λ² + B λ³: the exponent lies between, and is that of the term that dominates at the distances used."""
    distances = 8.0 ** np.arange(3, -1, -1)
    results = []
    for lead in (1e-3, 1.0, 10.0, 1e3):
        values = np.exp(np.interp(np.log(distances), np.log(lead * LEAD**2 + LEAD**3), np.log(LEAD)))
        results.append(fit_power(distances, values, 1 / 16))
        assert 1 / 3 - 2 * results[-1][1] < results[-1][0] < 1 / 2 + 2 * results[-1][1]
    powers, errors = np.transpose(results)
    assert (np.diff(powers) > 0).all()
    assert abs(powers[0] - 1 / 3) < 2 * errors[0]
    assert (np.abs(powers[2:] - 1 / 2) < 2 * errors[2:]).all()


def test_no_class_from_values_that_fall_by_a_jump():
    """Another mode is the softest at all but the nearest distance: nothing is known about a limit of zero."""
    exponent, error = fit_power(8.0 ** np.arange(3, -1, -1), np.array([1.1, 1.05, 1.0, 0.01]), 1 / 16)
    assert not vanishes(exponent, error)


def test_small_jumps_are_events_only_if_asked_for(sliding, varied):
    (event,) = sliding.events
    assert [other.trigger for other in varied[1].events] == [event.trigger]
    assert not search(LINEAR, 3, event.strain + 1e-4, smallest=0.01).events


def test_the_search_ends_with_the_number_of_events(frictionless):
    assert frictionless.events and "number" in frictionless.end and len(frictionless.steps.strain) == 5


@pytest.fixture
def begun():
    """A search at its first point."""
    state = commit(packing(LINEAR, 3), LINEAR)
    return Search(Point(0.0, state, Judge(state, LINEAR, 0.1)), STEP, 1e-6, 0.02)


def test_points_are_apart_by_a_share_of_the_mean_diameter(begun):
    point = begun.point
    grains, held = point.state.grains, np.flatnonzero(point.response.support.grains)
    position = grains.position.copy()
    position[held[:2], 0] += 1e-4, -1e-4
    other = Point(0.0, point.state._replace(grains=grains._replace(position=position)), point.judge)
    known = 1e-4 * np.sqrt(2 / len(held)) / (2 * grains.radius.mean())
    assert begun._distance_from(other) == pytest.approx(known, rel=1e-9)


@pytest.mark.parametrize("lean", [0.7, -0.7])
def test_a_cell_that_leans_to_either_side_is_reduced(begun, lean):
    point = begun.point
    side = point.state.cell.vectors[0, 0]
    begun.point = Point(0.1, ss.packings.sheared(point.state, lean), point.judge)
    begun._choose_cell()
    assert begun.point.state.cell.vectors[1, 0] == pytest.approx(lean * side - np.sign(lean) * side)
    assert begun.point.strain == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step": -1e-3}, r"step must be positive, got -0\.001"),
        ({"to": 0.0}, "to must be positive, got 0.0"),
        ({"drag": 0.0}, "drag must be positive, got 0.0"),
        ({"drag": np.inf}, "drag must be positive, got inf"),
        ({"resolution": 1e-2}, "resolution must not exceed step"),
        ({"resolution": 0.0}, "resolution must be positive, got 0.0"),
        ({"most": 0}, "most must be positive, got 0"),
        ({"prune": -1.0}, "prune must be positive, got -1"),
        ({"smallest": 0.0}, "smallest must be positive, got 0.0"),
    ],
)
def test_bad_options_are_refused_in_one_sentence(options, message):
    with pytest.raises(ValueError, match=message) as error:
        ss.protocols.find_events(packing(LINEAR, 3), LINEAR, **{"to": 0.01, "drag": 0.1, "step": STEP, **options})
    assert "\n" not in str(error.value)


def test_drag_has_no_default():
    with pytest.raises(TypeError, match="drag"):
        ss.protocols.find_events(packing(LINEAR, 3), LINEAR, to=0.01)


def test_unsuitable_packings_and_laws_are_refused():
    state, options = packing(LINEAR, 3), {"to": 0.01, "drag": 0.1}
    wrong = [
        (ss.packings.disk_array(3, press=5e-5), LINEAR, "walls"),
        (
            state._replace(cell=state.cell._replace(periodic=np.zeros(3, bool))),
            LINEAR,
            "must be periodic in all dimensions",
        ),
        (state, ss.laws.linear(damping_n=0.1), "dashpots"),
        (state, ss.laws.hertz_mindlin(rescaled=True), "rescaled"),
        (
            ss.packings.from_arrays([[0, 0], [2, 2]], [0.5, 0.5], LINEAR, cell=[4, 4], dim=2),
            LINEAR,
            "has no contacts and carries no load",
        ),
        (state._replace(control=state.control._replace(gravity=np.array([0.0, -1.0, 0.0]))), LINEAR, "loads"),
    ]
    for bad, law, message in wrong:
        with pytest.raises(ValueError, match=message) as error:
            ss.protocols.find_events(bad, law, **options)
        assert "\n" not in str(error.value)
