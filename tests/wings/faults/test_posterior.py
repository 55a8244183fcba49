"""The posterior of a fit: closed forms, a grid, coverage against the interval method, and what is refused."""

import json

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import t as student

from stickslip.runs.sweep.definition import members, sweep
from stickslip.wings.faults.friction.inference import PERCENTS, posterior
from stickslip.wings.faults.friction.laws import RateState, prescribed
from stickslip.wings.faults.friction.model import DEFAULTS, Data, model_friction, prepare
from stickslip.wings.faults.rate_state.figures import corner
from tests.conftest import stickslip_here

pytest.importorskip("emcee")
TRUE = RateState(0.010, 0.014, 2e-5, 0.6, 1e-6, "slip")


def noise(seed, number, rho, size=5e-4):
    draws = np.random.default_rng(seed).normal(0, size, number)
    for k in range(1, number):
        draws[k] += rho * draws[k - 1]
    return draws


def record(seed, rho=0.0, number=160):
    """Velocity steps of a surface whose slip velocity was measured: no spring, hence fast."""
    time = np.linspace(0.0, 320.0, number)
    velocity = np.where((time // 80) % 2 == 0, 1e-6, 4e-6)
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    states = prescribed(TRUE, time, mean, theta=TRUE.dc / velocity[0]).theta
    friction = TRUE.mu0 + TRUE.a * np.log(velocity / TRUE.v0)
    friction += TRUE.b * np.log(TRUE.v0 / TRUE.dc * np.r_[TRUE.dc / velocity[0], states])
    return Data(time, friction + noise(seed, number, rho), velocity=velocity)


def ends(sampled, name):
    return np.array(sampled.percentiles[name])[[0, -1]]


def test_the_level_alone_has_students_distribution():
    """One parameter of which friction is a linear function, and white noise: a mean with an unknown variance."""
    data = record(1)
    known = {"a": TRUE.a, "b": TRUE.b, "dc": TRUE.dc}
    sampled = posterior(data, law="slip", fixed=known, noise="white", walkers=64, seed=3)
    rest = sampled.fit.residuals[0] + sampled.fit.values["mu0"]
    exact = rest.mean() + rest.std(ddof=1) / np.sqrt(len(rest)) * student.ppf(np.array(PERCENTS) / 100, len(rest) - 1)
    spread = rest.std(ddof=1) / np.sqrt(len(rest))
    assert np.allclose(sampled.percentiles["mu0"], exact, rtol=0, atol=0.08 * spread)
    assert sampled.acceptance > 0.5


def test_percentiles_are_those_of_a_grid():
    """Two parameters, few samples: the density is evaluated on a grid with the model and nothing else."""
    data = record(5, number=60)
    known = {"a": TRUE.a, "mu0": TRUE.mu0}
    sampled = posterior(data, law="slip", fixed=known, noise="white", walkers=64)
    case, n, m = prepare(data), 60, 2
    least = np.sum(sampled.fit.residuals[0] ** 2)
    axes = [np.linspace(*(np.log(sampled.fit.values[name]) + s * sampled.fit.errors[name] / sampled.fit.values[name]
                          for s in (-6, 6)), 44) for name in ("b", "dc")]  # fmt: skip
    density = np.zeros((44, 44))
    for i, b in enumerate(np.exp(axes[0])):
        for j, dc in enumerate(np.exp(axes[1])):
            values = {"v0": 1e-6, "stiffness": 1.0, "damping": 0.0, "alpha": 0.0, "theta": 1.0, "trend": 0.0, **known}
            rest = data.friction - model_friction(case, values | {"b": b, "dc": dc}, "slip")
            density[i, j] = (1 + (rest @ rest - least) / least) ** (-n / 2)  # ν s² = S₀ for white noise, ν + m = n
    assert m == len(sampled.names)
    for name, axis, marginal in zip(sampled.names, axes, (density.sum(1), density.sum(0)), strict=True):
        share = (np.cumsum(marginal) - marginal / 2) / marginal.sum()
        exact = np.exp(np.interp(np.array(PERCENTS) / 100, share, axis))
        width = exact[-1] - exact[0]
        assert np.allclose(sampled.percentiles[name], exact, rtol=0, atol=0.04 * width), name


def test_percentiles_agree_with_the_interval_method():
    sampled = posterior(record(2, 0.6), law="slip")
    for name, interval in sampled.fit.intervals.items():
        width = interval[1] - interval[0]
        assert np.allclose(ends(sampled, name), interval, rtol=0, atol=0.08 * width), name
    assert all(sampled.steps >= 50 * tau for tau in sampled.times.values())


def _coverage(count, rho):
    hits = {"posterior": 0, "interval": 0}
    total = 0
    for seed in range(count):
        sampled = posterior(record(100 + seed, rho), law="slip", seed=seed)
        for name, (low, high) in sampled.fit.intervals.items():
            truth, (first, last) = getattr(TRUE, name), ends(sampled, name)
            hits["interval"] += low <= truth <= high
            hits["posterior"] += first <= truth <= last
            total += 1
    return hits, total


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_percentiles_hold_the_truth_as_often_as_intervals(rho):
    """150 records, four parameters: both methods within the resolution of 95 %, and nearly the same records."""
    hits, total = _coverage(150, rho)
    records = total / 4
    for method, count in hits.items():
        assert binom.ppf(1e-3, records, 0.92) <= count / 4 <= binom.ppf(1 - 1e-3, records, 0.97), (method, count)
    assert abs(hits["posterior"] - hits["interval"]) < 0.02 * total


@pytest.mark.slow
def test_percentiles_hold_the_truth_in_a_few_records():
    """5 records with four parameters each: a right method fails this bound in one of 1e4 runs."""
    hits, total = _coverage(5, 0.6)
    assert hits["posterior"] >= binom.ppf(1e-4, total / 2, 0.90) * 2


def test_draws_are_reproducible_and_weighted_as_their_percentiles_say():
    data, known = record(7, number=60), {"a": TRUE.a, "mu0": TRUE.mu0}
    sampled, same = (posterior(data, law="slip", fixed=known) for _ in range(2))
    assert np.array_equal(sampled.draws, same.draws)
    other = posterior(data, law="slip", fixed=known, seed=1)
    assert other.draws.shape != sampled.draws.shape or not np.array_equal(other.draws, sampled.draws)
    for k, name in enumerate(sampled.names):
        share = np.mean(sampled.draws[:, k] < sampled.percentiles[name][1])
        assert share == pytest.approx(0.16, abs=0.03)
    tables = {"experiment": "rate-state", "legs": [{"velocity": 1e-6, "distance": 1e-4}]}
    chosen = sweep(**tables, sweep={"draws": sampled.columns, "surface.dc": {"column": "dc"}})
    assert next(members(chosen)).values["surface.dc"] == sampled.columns["dc"][0]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"steps": 100}, RuntimeError, "the posterior did not converge: the chain of"),
        ({"free": ("trend", "theta"), "steps": 150}, RuntimeError, "autocorrelation times long (τ = "),
        ({"walkers": 7}, ValueError, "walkers must be an even number, at least 8 for 4 parameters"),
        ({"steps": 10}, ValueError, "steps must be at least 100, got 10"),
        ({"law": "ageing"}, ValueError, "law must be 'aging' or 'slip', got 'ageing'"),
        ({"free": ("b2", "dc2")}, RuntimeError, "there is no posterior to sample: these data do not determine"),
    ],
)
def test_what_is_not_a_posterior_gives_a_one_sentence_error(options, error, message):
    with pytest.raises(error) as caught:
        posterior(record(3), **{"law": "slip", **options})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("posterior")
    data = record(9, 0.4, number=80)
    rows = zip(data.time, data.friction, data.velocity, strict=True)
    lines = ["time [s],friction [-],velocity [m/s]", *(f"{t:.6g},{mu:.8g},{v:.6g}" for t, mu, v in rows)]
    (place / "record.csv").write_text("\n".join(lines) + "\n")
    return place


# 4 s: as many draws as percentiles need
def test_the_command_writes_draws_a_figure_and_percentiles(folder):
    done = stickslip_here("fit", "record.csv", "--law", "slip", "--posterior", "--out", "fit", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Posterior, slip law" in done.stdout
    assert "acceptance" in done.stdout
    answer = json.loads((folder / "fit" / "fit.json").read_text())["posterior"]
    head = next(line for line in (folder / "fit" / "posterior.csv").read_text().splitlines() if line[0] != "#")
    assert head == "a [-],b [-],dc [m],mu0 [-]"
    table = np.loadtxt(folder / "fit" / "posterior.csv", delimiter=",", comments=["#", "a"])
    assert table.shape == (answer["draws"], 4)
    assert np.median(table[:, 2]) == pytest.approx(answer["percentiles"]["dc"]["50.0"], rel=0.01)
    assert (folder / "fit" / "posterior.png").stat().st_size > 10_000
    again = stickslip_here("fit", "record.csv", "--law", "slip", "--out", "fit", "--overwrite", cwd=folder)
    assert again.returncode == 0, again.stderr
    assert not list((folder / "fit").glob("posterior*"))


def test_draws_too_narrow_for_their_numbers_are_drawn_around_their_median():
    draws = np.random.default_rng(0).normal(size=(2, 500))
    columns = {"a": 0.01 + 1e-12 * draws[0], "mu0": 0.6 + 1e-3 * draws[1]}
    figure = corner(columns, {name: np.quantile(values, [0.025, 0.975]) for name, values in columns.items()}, {})
    figure.canvas.draw()
    left, right = figure.axes[2], figure.axes[3]
    assert np.ptp(left.get_xlim()) < 1e-11 and left.get_xlabel().startswith(r"$\Delta$")
    assert min(right.get_xlim()) > 0.59 and "Delta" not in right.get_xlabel()


def test_a_posterior_that_did_not_converge_is_not_written(folder):
    arguments = ("fit", "record.csv", "--law", "slip", "--posterior", "--steps", "100", "--out", "short")
    done = stickslip_here(*arguments, cwd=folder)
    assert done.returncode == 1
    assert "the posterior did not converge" in done.stderr
    assert not (folder / "short").exists() or not list((folder / "short").iterdir())


def test_a_posterior_has_two_states_in_the_order_of_their_slip():
    two = {"a": 0.010, "b": 0.006, "dc": 4e-6, "b2": 0.005, "dc2": 6e-5}
    data = record(0, number=400)
    values = DEFAULTS | two | {"mu0": 0.6, "v0": 1e-6, "stiffness": 1.0}
    friction = model_friction(prepare(data), values, "slip") + noise(5, 400, 0.0, size=1e-4)
    drawn = posterior(data._replace(friction=friction), law="slip", free=("b2", "dc2"), seed=1)
    for name, true in two.items():
        low, high = drawn.fit.intervals[name]
        assert drawn.percentiles[name][0] == pytest.approx(low, rel=0.1)
        assert drawn.percentiles[name][-1] == pytest.approx(high, rel=0.1)
        assert low < true < high
    assert (drawn.columns["dc"] < drawn.columns["dc2"]).all()
