"""Records with faults: a noisy load point, stated velocities, spikes."""

import numpy as np
import pytest

from stickslip.wings.faults.friction.fitting import fit
from stickslip.wings.faults.friction.laboratory import LabRecord, record_data, write_csv
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import LoadStep, find_steps, stated_steps, velocity_steps, with_normal
from stickslip.wings.faults.friction.model import Data
from tests.conftest import stickslip_here

SURFACE, SPRING = RateState(0.010, 0.006, 1e-5, 0.6, 1e-6), Spring(1e4)
LEGS = velocity_steps([1e-6, 1e-5, 1e-6], distance=1.5e-4)
TRUE = {"a": 0.010, "b": 0.006, "dc": 1e-5}
TIMES = np.arange(0.0, sum(leg.duration for leg in LEGS), 0.1)  # 10 Hz
CLEAN = spring_slider(SURFACE, SPRING, LEGS, times=TIMES)
AWAY = np.delete(np.arange(len(TIMES)), np.r_[1497:1506, 1647:1656])  # samples that cannot be the peak after a step


def noisy(seed, *, load_point=0.3e-6, friction=1e-3):
    """Record with noise of the load point [m] and of the friction."""
    rng, n = np.random.default_rng(seed), len(TIMES)
    place = CLEAN.load_point + load_point * rng.normal(size=n)
    return LabRecord(TIMES, CLEAN.friction + friction * rng.normal(size=n), place)


@pytest.mark.parametrize("noise", [0.0, 0.3e-6, 1e-6])
def test_steps_are_found_in_a_noisy_displacement(noise):
    rng = np.random.default_rng(3)
    ends, velocity = np.array([0.0, 60.013, 119.97, 180.02, 240.0]), [1e-6, 1e-5, 0.0, 3e-6]
    time = np.linspace(0, 240, 1200)
    place = np.interp(time, ends, np.r_[0.0, np.cumsum(np.diff(ends) * velocity)]) + noise * rng.normal(size=1200)
    steps = find_steps(time, place)
    assert [leg.velocity for leg in steps.legs] == pytest.approx(velocity, rel=0.01 if noise else 1e-6)
    errors = np.cumsum([leg.duration for leg in steps.legs])[:-1] - ends[1:-1]
    assert np.abs(errors[:2]).max() < 0.05  # seconds, a quarter of a sample
    assert steps.noise == pytest.approx(noise, rel=0.1, abs=1e-12)


def test_a_straight_line_has_no_steps():
    rng = np.random.default_rng(4)
    time = np.linspace(0, 100, 3000)
    assert all(len(find_steps(time, 1e-6 * time + 1e-6 * rng.normal(size=3000)).legs) == 1 for _ in range(20))


def test_noise_of_the_load_point_is_told_and_does_not_bias_a_fit():
    sentence = (
        r'noise of 3e-07; its velocity is assumed to be "1\.00.*e-06 until 149\.9.*, then 9\.99.*e-06 until 165\.'
    )
    with pytest.warns(UserWarning, match=sentence):
        data = record_data(noisy(1))
    assert len(data.legs) == 3
    best = fit(data, law="aging", fixed={"stiffness": 1e4})
    for name, true in TRUE.items():
        assert abs(best.values[name] - true) < 4 * best.errors[name] < 0.2 * true


def clean(law, state=1.0, times=TIMES):
    """Friction of a record that starts with a multiple of the steady state."""
    return spring_slider(SURFACE._replace(law=law), SPRING, LEGS, times=times, theta=state * 1e-5 / 1e-6).friction


def check_intervals(records, law, free=()):
    """95 % intervals of 400 records hold the truth in 93 to 97 %, within two statistical errors of 1 %."""
    z, inside = [], []
    for record in records:
        best = fit(record, law=law, fixed={"stiffness": 1e4}, free=free)
        z.append([(best.values[name] - true) / best.errors[name] for name, true in TRUE.items()])
        inside.append([low < TRUE[name] < high for name, (low, high) in best.intervals.items() if name in TRUE])
    share = np.mean(inside, axis=0)
    assert (np.abs(np.mean(z, axis=0)) < 0.3).all(), np.mean(z, axis=0)
    assert ((share > 0.93 - 0.02) & (share < 0.97 + 0.02)).all(), share


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("law", ["aging", "slip"])
@pytest.mark.filterwarnings("ignore:the load point has noise")
def test_intervals_hold_the_truth_with_a_noisy_load_point_and_spikes(law):
    def record(seed):
        rng, made = np.random.default_rng(1000 + seed), noisy(seed)
        friction = made.friction - CLEAN.friction + clean(law)
        friction[rng.choice(AWAY, 12, replace=False)] += 0.05 * rng.choice([-1, 1], 12)
        return record_data(made._replace(friction=friction))

    check_intervals((record(seed) for seed in range(400)), law)


SPARSE = np.r_[0:1500:5, 1500:1650, 1650:3150:5]  # samples of a record at 2 Hz, and at 10 Hz while it slides fast
PLACE = (CLEAN.load_point - CLEAN.load_point[0])[SPARSE]
FAULTS = {  # added friction, state at the start over the steady one, degrees of freedom of the noise, what is fitted
    "linear trend": (100.0 * PLACE, 1.0, np.inf, ("trend",)),
    "drift in time": (1e-4 * TIMES[SPARSE], 1.0, np.inf, ("drift",)),
    "exponential trend": (-0.03 * (1 - np.exp(-PLACE / 1e-4)), 1.0, np.inf, ("trend", "trend_length")),
    "long tails": (0.0, 1.0, 3.0, ()),
    "start away from steady state": (0.0, 0.2, np.inf, ("theta",)),
}


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("law", ["aging", "slip"])
@pytest.mark.parametrize("fault", FAULTS)
def test_intervals_hold_the_truth_with(fault, law):
    added, state, degrees, free = FAULTS[fault]
    friction = clean(law, state, TIMES[SPARSE]) + added

    def record(seed):
        rng = np.random.default_rng(5000 + seed)
        noise = rng.normal(size=len(SPARSE)) if degrees == np.inf else rng.standard_t(degrees, len(SPARSE))
        return Data(TIMES[SPARSE], friction + 1e-3 * noise, LEGS)

    check_intervals((record(seed) for seed in range(400)), law, free)


def test_velocities_can_be_stated():
    legs = stated_steps("1 um/s until 150 s, then 1e-5 until 2.75 min, then 60 um/min", TIMES)
    assert [leg.duration for leg in legs] == pytest.approx([150, 15, TIMES[-1] - 165])
    assert [leg.velocity for leg in legs] == pytest.approx([1e-6, 1e-5, 1e-6])
    data = record_data(noisy(2)._replace(load_point=None), velocity="1e-6 until 150 s, then 1e-5 until 165, then 1e-6")
    assert [leg.velocity for leg in data.legs] == [1e-6, 1e-5, 1e-6]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("fast", "then 10 um/s', got 'fast'"),
        ("1e-6 until 150 s, then", "got 'then'"),
        ("1e-6 until 900 s, then 1e-5", "a leg ends at 900 s: it must end after 0 s and within the 314.9 s recorded"),
        ("1e-6 until 150 s, then 1e-5 until 120 s, then 1", "a leg ends at 120 s: it must end after 150 s"),
        ("1e-6 until 150 s", "ends at 150 s, but the record ends at 314.9 s: add the rest"),
        ("1e-6 until 150 furlongs, then 1", "expected velocities and times"),
        ("", "got ''"),
    ],
)
def test_velocities_that_make_no_sense_are_refused_in_a_sentence(text, sentence):
    with pytest.raises(ValueError) as caught:
        stated_steps(text, TIMES)
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_legs_are_cut_where_the_normal_stress_changes():
    legs = (LoadStep(2.5, 1.0), LoadStep(2.5, 2.0))
    cut = with_normal(legs, np.arange(6.0), np.array([1.0, 1.0, 1.0, 1.0, 1.2, 1.2]))
    assert [tuple(leg) for leg in cut] == [(2.5, 1.0, 1.0), (1.5, 2.0, 1.0), (1.0, 2.0, 1.2)]


def spiked(seed, size=0.05, count=12):
    rng, record = np.random.default_rng(seed), noisy(seed, load_point=0.0)
    places = rng.choice(len(TIMES), count, replace=False)
    friction = record.friction.copy()
    friction[places] += size * rng.choice([-1, 1], count)
    return Data(TIMES, friction, LEGS), Data(TIMES, record.friction, LEGS), places


@pytest.mark.parametrize("law", ["aging", "slip"])
def test_spikes_are_left_out_and_counted(law):
    data, clean, places = spiked(3)
    with_spikes, without = (fit(record, law=law, fixed={"stiffness": 1e4}) for record in (data, clean))
    assert set(with_spikes.spikes[0]) == set(places) and not len(without.spikes[0])
    assert with_spikes.samples == len(TIMES) - 12
    if law == "aging":
        for name in TRUE:
            assert with_spikes.errors[name] == pytest.approx(without.errors[name], rel=0.05)
            assert abs(with_spikes.values[name] - without.values[name]) < without.errors[name]


def test_a_law_that_does_not_fit_makes_no_spikes():
    assert not len(fit(Data(TIMES, CLEAN.friction, LEGS), law="slip", fixed={"stiffness": 1e4}).spikes[0])


def test_long_tails_are_noise_and_no_spikes():
    heavy = CLEAN.friction + 1e-3 * np.random.default_rng(1).standard_t(1.2, len(TIMES))
    assert not len(fit(Data(TIMES, heavy, LEGS), law="aging", fixed={"stiffness": 1e4}).spikes[0])


@pytest.mark.parametrize("length", [5e-5, 1e-4])
def test_an_exponential_trend_is_fitted(length):
    place = np.interp(TIMES, np.cumsum([0, *(leg.duration for leg in LEGS)]), [0, 1.5e-4, 3e-4, 4.5e-4])
    noise = 1e-4 * np.random.default_rng(5).normal(size=len(TIMES))
    data = Data(TIMES, CLEAN.friction + noise - 300.0 * length * (1 - np.exp(-place / length)), LEGS)
    free = ("trend", "trend_length")
    best = fit(data, law="aging", fixed={"stiffness": 1e4}, free=free)
    for name, true in (TRUE | {"trend": -300.0, "trend_length": length}).items():
        low, high = best.intervals[name]
        assert low - 0.5 * (high - low) < true < high + 0.5 * (high - low) and high - low < 0.2 * abs(true)
    with pytest.raises(ValueError, match="trend_length requires a trend"):
        fit(data, law="aging", fixed={"stiffness": 1e4}, free=("trend_length",))


def test_a_drift_in_time_is_fitted_and_is_no_trend():
    rng, added = np.random.default_rng(5), 1e-4 * TIMES
    data = Data(TIMES, CLEAN.friction + added + 1e-4 * rng.normal(size=len(TIMES)), LEGS)
    best = fit(data, law="aging", fixed={"stiffness": 1e4}, free=("drift", "trend"))
    for name, true in (TRUE | {"drift": 1e-4, "trend": 0.0}).items():
        assert abs(best.values[name] - true) < 4 * best.errors[name], name
    assert best.errors["drift"] < 1e-6


def test_the_command_line_states_velocities_and_counts_spikes(tmp_path):
    record = noisy(4)._replace(load_point=None, velocity=None)
    friction = record.friction.copy()
    friction[[100, 900, 2000]] += 0.1
    write_csv(tmp_path / "a.csv", record._replace(friction=friction))
    arguments = ("fit", "a.csv", "--stiffness", "1e4", "--law", "aging")
    velocity = "1 um/s until 150 s, then 10 um/s until 165 s, then 1 um/s"
    done = stickslip_here(*arguments, "--velocity", velocity, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    free = stickslip_here("fit", "a.csv", "--free-stiffness", "--law", "aging", "--velocity", velocity, cwd=tmp_path)
    assert "correlation of the stiffness with a " in free.stdout and "correlation" not in done.stdout
    assert "3 of 3150 samples are spikes" in " ".join(done.stdout.split())
    done = stickslip_here(*arguments, "--velocity", "brisk", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    done = stickslip_here(*arguments, "--velocity", "0 until 150 s, then 10 um/s", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "stickslip: --velocity starts with 0 m/s, but a fit starts from sliding: "
        "give the slip velocity before the record (--before), or remove its start\n",
    )


@pytest.mark.parametrize("state", [0.2, 1.0])
def test_a_start_away_from_steady_state_is_told_with_the_bias_it_makes(tmp_path, state):
    friction = clean("aging", state, TIMES[SPARSE]) + 1e-4 * np.random.default_rng(6).normal(size=len(SPARSE))
    write_csv(tmp_path / "a.csv", LabRecord(TIMES[SPARSE], friction, CLEAN.load_point[SPARSE]))
    arguments = ("fit", "a.csv", "--stiffness", "1e4", "--law", "aging")
    done = stickslip_here(*arguments, cwd=tmp_path)
    said = " ".join(done.stdout.split())
    assert ("does not start in steady state, but with 0.20" in said) == (state != 1.0), said
    assert ("use --free theta" in said) == (state != 1.0)
    if state != 1.0:
        assert "does not start" not in stickslip_here(*arguments, "--free", "theta", cwd=tmp_path).stdout
