"""Fault gouge: scenarios, one small sample from nothing to slides after holds, its files, its measures."""

import sys
from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.dynamics import device
from stickslip.core.dynamics.batch import Processor
from stickslip.core.dynamics.run import own_engine
from stickslip.core.laws.builtin import KEEPS_FORCE, LEVER, ROLLING, TWISTING
from stickslip.core.progress import silent
from stickslip.data import archive
from stickslip.data.archive import ArchiveError
from stickslip.data.checkpoint import Checkpoint
from stickslip.extras import MissingExtraError
from stickslip.wings.papers.gouge import measures, statistics
from stickslip.wings.papers.gouge.protocol import Realization, Series, Test, _LegRunner, _log_binned, _mean_overlap
from stickslip.wings.papers.gouge.report import numbers
from stickslip.wings.papers.gouge.sample import (
    BOTTOM,
    TOP,
    Gouge,
    Range,
    _shrink_apart,
    attach_spring,
    gouge_law,
    inertial_numbers,
    make_range,
    normalised_hold,
    normalised_stiffness,
    prepare_sample,
    stiffness,
)
from stickslip.wings.papers.gouge.scenario import GougeScenario
from stickslip.wings.papers.gouge.simulate import MEMBERS, GougeResult, simulate_gouge

LAW = {"damping_n": 1e4}
SLIDE = [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]
STEPS = {"kind": "velocity-steps", "velocities": [0.3, 0.1], "slip": 1.0}
HOLDS = {"kind": "slide-hold-slide", "before": [0.3], "holds": [1e-2]}
BRIEF = {"slip": 0.05, "steady": False, "approach": 10.0, "unbalanced": 0.03}  # the shortest preparation
INTERVAL = 50 * 4e-7  # of samples [s]
pytestmark = pytest.mark.timeout(600)  # 2 s of processor time have taken 42 s on a machine with other work
Test.__test__ = False  # not a test of pytest's


def small(**more) -> GougeScenario:
    """A sample as small as its cell allows; steadiness is not asked for."""
    tables = {
        "experiment": "gouge", "grains": {"number": 70}, "cell": {"length": 0.016, "width": 0.016}, "dt": 4e-7,
        "preparation": {"slip": 0.4, "window": 0.2, "change": 1.0, "approach": 10.0, "unbalanced": 0.03},
        "sample_every": 50, "ledger_steps": 300, "law": LAW,
        "protocol": [
            {"kind": "velocity-steps", "velocities": (0.3, 0.6), "slip": 0.1, "twin": 0.05},
            {
                "kind": "slide-hold-slide", "before": (0.3,), "holds": (2e-4, 1e-4), "after": (0.3, 0.6),
                "approach": 0.1, "slip": 0.1, "twin": 0.1,
            },
        ],
    }  # fmt: skip
    return ss.scenario(**(tables | more))


@cache
def settled():
    """Made once for all tests, none of which writes to it."""
    return prepare_sample(small(), 0)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Two realizations of the small scenario, and the folder that keeps them."""
    folder = tmp_path_factory.mktemp("gouge")
    return simulate_gouge(small(realizations=2), folder=folder, workers=1), folder


def test_a_batch_gives_the_realizations_of_single_runs(monkeypatch, tmp_path):
    monkeypatch.setattr(device, "open_device", lambda name: Processor())
    hold = {"kind": "slide-hold-slide", "before": (0.3,), "holds": (2e-4,), "approach": 0.05, "slip": 0.05}
    scenario = small(realizations=2, preparation=BRIEF, protocol=[hold], ledger_steps=0)
    told = []
    result = simulate_gouge(scenario, folder=tmp_path, device="cuda", report=lambda *said: told.append(said))
    assert not result.failures, result.failures
    assert len(result.realizations) == 2 and told
    assert simulate_gouge(scenario, folder=tmp_path, workers=1).reused == 2
    known = simulate_gouge(scenario, workers=1)
    for mine, own in zip(result.realizations, known.realizations, strict=True):
        assert [test[:4] for test in mine.tests] == [test[:4] for test in own.tests]
        # the first leg only, where round-off is still below 1e-9: it grows by 1e4 or more until the last one
        for name in Series._fields:
            a, b = (getattr(r.tests[0].series, name) for r in (mine, own))
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-6 * np.abs(b).max(), err_msg=name)


def test_a_device_that_cannot_run_is_refused_in_one_sentence(monkeypatch):
    with pytest.raises(ValueError, match=r"device must be 'cuda', .*, got 'metal'"):
        simulate_gouge(small(), device="metal")
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(MissingExtraError, match=r"cupy is .*\[gpu\]"):
        simulate_gouge(small(), device="cuda")
    with pytest.raises(ValueError, match='device = "cuda" does not apply to engine = "lammps"'):
        simulate_gouge(small(engine="lammps"), device="cuda")
    with pytest.raises(ValueError, match="no rolling resistance"):
        simulate_gouge(small(law=LAW | {"rolling": "spring", "k_roll": 1e6, "mu_roll": 0.2}), device="cuda")


def test_a_leg_continues_from_pieces_of_another_length(tmp_path):
    """Pieces are longer on a device, on which an interrupted run may be resumed."""
    scenario = small(preparation=BRIEF)
    gouge, seconds = settled(), 11 * scenario.sample_every * scenario.dt
    kept = Checkpoint(tmp_path, scenario.text, (Gouge, Series))

    def stop(stage, share, text):
        raise KeyboardInterrupt

    def run(samples, report=silent, kept=kept):
        engine = own_engine(threads=1)._replace(samples=samples)
        return _LegRunner(scenario, engine, report, kept, seconds, "leg").run(gouge, 0.3, seconds, "slide")[1]

    whole = run(100, kept=None)
    for first, second in ((3, 5), (5, 3)):
        with pytest.raises(KeyboardInterrupt):
            run(first, stop)
        np.testing.assert_allclose(run(second).time, whole.time, rtol=1e-9)
        kept.clear()


# --- scenarios -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"protocol": [{"kind": "slide", "velocity": 1e-6, "slip": 1.0}]}, "more than most_steps = 5e\\+07"),
        ({"protocol": [{"kind": "slide", "velocity": 0.3, "time": 1e6}]}, "raise velocities, shorten holds"),
        ({"protocol": [{"kind": "slide", "velocity": 0.3}]}, "ends after a given slip or a given time"),
        ({"protocol": [{"kind": "slide", "velocity": 0.0, "slip": 1.0}]}, "never reaches a given slip"),
        ({"protocol": [{"kind": "slide", "velocity": 0.1, "time": 1.0, "steady": True}]}, "needs a maximum slip"),
        ({"protocol": [{"kind": "slip"}]}, "protocol \\(entry 1\\) has kind = 'slip': use 'slide', 'velocity-steps'"),
        (
            {"protocol": [*SLIDE, {"kind": "velocity-steps", "slip": 1.0}]},
            "protocol.velocities \\(entry 2\\) is missing",
        ),
        ({"protocol": [{**STEPS, "twinn": 1.0}]}, "has no key 'twinn': did you mean 'twin'"),
        ({"protocol": [{"kind": "slide", "velocity": 0.3, "slip": 1e-3}]}, "fewer than 8 samples of 5e-05 s"),
        ({"protocol": [{**HOLDS, "holds": [1e-3, 1.01e-3]}]}, "differ by at least one"),
        (
            {"protocol": [{"kind": "slide", "velocity": 0.1, "slip": 1.0, "steady": True}]},
            "must be at least two windows",
        ),
        ({"protocol": SLIDE, "preparation": {"longest": 3.0}}, "slip plus two windows, 8"),
        ({"protocol": SLIDE, "cell": {"length": 0.01}}, "stay clear of their periodic images"),
        ({"protocol": SLIDE, "grains": {"diameter": [4e-3, 2e-3]}}, "the smallest and the largest diameter"),
        ({"protocol": SLIDE, "load": {"definition": "newton"}}, "per_area"),
    ],
)
def test_bad_scenarios_are_refused_in_one_sentence(tables, words):
    with pytest.raises(ss.experiments.ScenarioError, match=words):
        ss.scenario(**{"experiment": "gouge", "law": LAW} | tables)


def test_the_estimate_counts_every_leg():
    """Preparation and a protocol by hand: slips of D over velocities, the longest hold, slides from each of them."""
    chosen = small()
    size = 3e-3
    steps = 0.1 * size / 0.3 + 0.1 * size / 0.6 + 0.05 * size / 0.3
    holds = (0.1 + 0.1) * size / 0.3 + 2e-4 + 2 * (0.1 * size / 0.3 + 0.1 * size / 0.6)
    assert chosen.steps == pytest.approx((0.4 * size / 0.3 + steps + holds) / 4e-7)


def test_a_time_step_that_is_too_long_is_refused_with_the_number():
    with pytest.raises(ss.experiments.ScenarioError, match=r"limit is about 9\.9e-07: use about 2e-07"):
        small(dt=3e-6)
    ran = settled()
    assert 0.5 < small().longest_step / ss.measure.stable_time_step(ran.state, ran.law) < 2


# --- numbers ---------------------------------------------------------------------------------------------------------


def test_every_definition_of_stiffness_is_its_formula():
    chosen = ss.scenario(
        experiment="gouge", law=LAW, protocol=SLIDE, load={"stiffness": 425.0, "definition": "rate_state"}
    )
    k = 425 * 0.0178 * 5e6 / 5.3e-3
    told = {"per_area": k, "per_stress": k / 5e6, "grain": k * 3e-3 / 5e6, "rate_state": 425.0}
    assert normalised_stiffness(chosen) == pytest.approx(told)
    for name, value in told.items():
        again = ss.scenario(experiment="gouge", law=LAW, protocol=SLIDE, load={"stiffness": value, "definition": name})
        assert stiffness(again) == pytest.approx(k)


def test_every_definition_of_hold_time_is_its_formula():
    chosen = ss.scenario(experiment="gouge", law=LAW, protocol=SLIDE, load={"stiffness": 7e9, "definition": "per_area"})
    found = normalised_hold(chosen, 0.1, 0.02)
    assert found["load_point"] == pytest.approx(0.1 * 0.02 / 5.3e-3)
    assert found["frozen"] == pytest.approx(7e9 / 5e6 * 0.02 * 0.1 / 0.0247)
    assert found["inertial"] == pytest.approx(0.1 / (3e-3 * np.sqrt(2500 / 5e6)))


def test_every_definition_of_the_inertial_number_is_its_formula():
    chosen = ss.scenario(experiment="gouge", law=LAW, protocol=SLIDE)
    found, root = inertial_numbers(chosen, 0.1, 0.03), np.sqrt(2500 / 5e6)
    told = {"mean_grain": 0.1 / 0.03 * 3e-3 * root, "largest_grain": 0.1 / 0.03 * 4e-3 * root, "slip": 0.1 * root}
    assert found == pytest.approx(told)


def test_what_leaves_the_quasi_static_range_is_said():
    chosen = ss.scenario(experiment="gouge", law=LAW, protocol=SLIDE)
    good = make_range(chosen, 0.1, 0.03, 0.004, 1e-6)
    assert good.warnings == []
    assert good.inertial_number == pytest.approx(0.1 / 0.03 * 3e-3 * np.sqrt(2500 / 5e6))
    assert good.stiffness == pytest.approx((50e9 / (0.91 * 5e6)) ** (2 / 3))
    bad = Range(2e-3, 50.0, 0.03, 5.0, 5.0, 0.8).warnings
    assert len(bad) == 5
    assert "inertial number reaches 2.0e-03" in bad[0]


# --- a sample --------------------------------------------------------------------------------------------------------


def test_a_settled_sample_bears_its_load(ran):
    """The plates are rigid and glued without contacts of their own; the contacts carry the normal stress."""
    result, _ = ran
    state = result.realizations[0].states["settled"]
    law = ss.laws.hertz_mindlin_reff(*ss.laws.elastic_constants(50e9, 0.3), 0.5)
    group = state.control.group
    assert [(group == g).sum() for g in (-1, BOTTOM, TOP)] == [70, *[result.scenario.plate_grains] * 2]
    found, _ = ss.forces(state, law, memory=ss.FROZEN)
    whole = 5e6 * 0.016**2
    assert found.force[group == TOP, 1].sum() == pytest.approx(whole, rel=0.05)  # at rest to `unbalanced`
    assert found.force[group == BOTTOM, 1].sum() == pytest.approx(-whole, rel=0.05)
    rows = ss.measure.touching(state)
    own = group[state.contacts.i[rows]] == group[state.contacts.j[rows]]
    assert not (own & (group[state.contacts.i[rows]] >= 0)).any()


def test_the_load_point_does_what_the_protocol_says(ran):
    result, _ = ran
    for test in result.realizations[0].tests:
        series = test.series
        assert np.diff(series.load_point) == pytest.approx(test.velocity * np.diff(series.time), abs=1e-12)
    kinds = [test.kind for test in result.realizations[0].tests]
    assert kinds == [
        "steady", "slide", "slide", "twin", "step", "twin", *["reslide"] * 4, "hold"
    ]  # fmt: skip
    assert [t.hold for t in result.realizations[0].of("reslide")] == [1e-4, 1e-4, 2e-4, 2e-4]


def test_spring_and_contacts_tell_the_same_friction(ran):
    """They differ by the plate's inertia, whose mean is its change of velocity over the time."""
    result, _ = ran
    series = result.realizations[0].tests[0].series
    assert series.friction.mean() == pytest.approx(series.contact_friction.mean(), abs=5e-3)
    assert series.normal.mean() == pytest.approx(1.0, abs=0.02)
    k = stiffness(result.scenario) / result.scenario.load.normal_stress
    assert series.friction == pytest.approx(k * (series.load_point - series.slip), abs=1e-9)
    assert 0.2 < series.friction[len(series.friction) // 2 :].mean() < 1.0


def test_branches_start_where_they_were_told_to(ran):
    """A step and its twin start from the end of their slide; slides after a hold start at its friction."""
    one = ran[0].realizations[0]
    for test in (*one.of("step"), *one.of("twin"), *one.of("hold")):
        before = one.slide_to(test)
        assert (before.part, before.branch, before.velocity) == (test.part, test.branch, test.before)
        assert test.series.time[0] == pytest.approx(before.series.time[-1] + INTERVAL)
    twin = one.of("twin")[0]
    ahead = twin.series.load_point[0] - one.slide_to(twin).series.load_point[-1]
    assert ahead == pytest.approx(0.3 * INTERVAL)
    hold = one.of("hold")[0].series
    for reslide in one.of("reslide"):
        at = int(np.argmin(np.abs(hold.time - (reslide.series.time[0] - INTERVAL))))
        assert hold.time[at] - hold.time[0] + INTERVAL == pytest.approx(reslide.hold)
        assert reslide.series.slip[0] - hold.slip[at] < 2 * reslide.velocity * INTERVAL


# 4 s: a sample that is tested from several states
def test_several_branches_start_along_one_slide(tmp_path):
    """Spaced as asked, in whichever process, with the same results; what is finished is not run again."""
    hold = {"kind": "slide-hold-slide", "before": (0.3,), "holds": (4e-4,), "after": (), "approach": 0.1}
    steps = {"kind": "velocity-steps", "velocities": (0.3, 0.6), "slip": 0.1, "branches": 2, "spacing": 0.1}
    chosen = small(protocol=[hold | {"branches": 3, "spacing": 0.2}, steps], ledger_steps=0, preparation=BRIEF)
    assert chosen.duration == pytest.approx(
        (0.05 + 0.1 + 2 * 0.2 + 0.1 + 0.1) * 3e-3 / 0.3 + 3 * 4e-4 + 2 * 0.1 * 3e-3 / 0.6
    )
    here, there = (simulate_gouge(chosen, workers=n, folder=tmp_path / str(n)) for n in (1, 2))
    one = here.realizations[0]
    holds = one.of("hold")
    assert [(t.part, t.branch) for t in holds] == [(0, 0), (0, 1), (0, 2)]
    assert [(t.part, t.branch) for t in one.of("step")] == [(1, 0), (1, 1)]
    ends = [one.slide_to(t).series.load_point[-1] for t in holds]
    assert np.diff(ends) == pytest.approx([0.2 * 3e-3] * 2)
    for a, b in zip(one.tests, there.realizations[0].tests, strict=True):
        assert (a.series.friction == b.series.friction).all()
    (file,), (other,) = ((tmp_path / str(n) / MEMBERS).iterdir() for n in (1, 2))
    assert file.read_bytes() == other.read_bytes()
    assert one.of("hold")[0].elastic > 0


MOMENTS = {
    "lever": "overlap", "memory": "force", "rolling": "spring", "k_roll": 1e6, "mu_roll": 0.2,
    "twisting": "spring", "k_twist": 0.1, "mu_twist": 1e-4,
}  # fmt: skip


def test_moments_and_memory_are_properties_of_the_law():
    assert gouge_law(small(), 0.5).properties == 0
    assert gouge_law(small(law=LAW | MOMENTS), 0.5).properties == KEEPS_FORCE | LEVER | ROLLING | TWISTING


@pytest.mark.parametrize("moments", [{}, pytest.param(MOMENTS, marks=pytest.mark.slow)], ids=["plain", "moments"])
def test_a_killed_realization_goes_on_from_its_branches(moments, tmp_path, monkeypatch):
    """What a branch has finished is not run again, and the result is that of a run that was not stopped."""
    hold = {"kind": "slide-hold-slide", "before": (0.3,), "holds": (4e-4,), "after": (), "approach": 0.1}
    chosen = small(
        protocol=[hold | {"branches": 2, "spacing": 0.2}], ledger_steps=0, law=LAW | moments, preparation=BRIEF
    )
    from stickslip.wings.papers.gouge import simulate as gouge_ensemble

    whole, calls = gouge_ensemble.run_branch, []

    def once(scenario, start, *rest):
        calls.append(start.number)
        if start.number == 1:
            raise KeyboardInterrupt
        return whole(scenario, start, *rest)

    monkeypatch.setattr(gouge_ensemble, "run_branch", once)
    with pytest.raises(KeyboardInterrupt):
        simulate_gouge(chosen, workers=1, folder=tmp_path / "stopped")
    monkeypatch.setattr(
        gouge_ensemble, "run_branch", lambda s, start, *rest: (calls.append(start.number), whole(s, start, *rest))[1]
    )
    monkeypatch.setattr(gouge_ensemble, "run_trunk", refuse)
    again = simulate_gouge(chosen, workers=1, folder=tmp_path / "stopped")
    assert calls == [0, 1, 1]
    monkeypatch.undo()
    straight = simulate_gouge(chosen, workers=1)
    for a, b in zip(again.realizations[0].tests, straight.realizations[0].tests, strict=True):
        assert (a.series.friction == b.series.friction).all()


def test_a_branch_that_fails_is_told_with_its_sample(monkeypatch):
    def fails(scenario, start, *_):
        raise RuntimeError("it blew up")

    monkeypatch.setattr("stickslip.wings.papers.gouge.simulate.run_branch", fails)
    with pytest.raises(RuntimeError, match="every realisation failed; first message: realisation 0 failed: it blew up"):
        simulate_gouge(small(ledger_steps=0, preparation=BRIEF), workers=1)


def test_samples_of_a_hold_are_means_over_growing_intervals():
    """Each sample counts once; 20 intervals in a decade, single samples at first."""
    columns = {name: np.arange(1.0, 5001) for name in Series._fields}
    columns["fabric"] = np.arange(1.0, 5001)[:, None, None] * np.ones((1, 3, 3))
    thin = _log_binned(Series(**columns))
    assert 60 < len(thin.time) < 20 * np.log10(5001) + 1
    assert thin.time[:5] == pytest.approx([1, 2, 3, 4, 5])
    assert thin.time[-1] == pytest.approx(5000 * (1 + 10**-0.05) / 2, rel=1e-3)
    assert thin.fabric[:, 1, 2] == pytest.approx(thin.time)
    end = 0.5
    for middle in thin.time:  # the mean of an interval is half the sum of its ends
        end = 2 * middle - end
    assert end == pytest.approx(5000.5)


def test_the_energies_of_sliding_balance(ran):
    """The defect is second order in dt; friction takes nearly all."""
    books = ran[0].realizations[0].ledger
    spent = books["coulomb"][-1] + books["viscous"][-1]
    assert spent > 0
    assert np.abs(books["defect"]).max() < 1e-3 * spent
    assert books["viscous"][-1] < 0.2 * spent


def test_a_finished_realization_is_not_run_again(ran, monkeypatch, tmp_path):
    """Neither by the same scenario nor by one that asks for more of them; what cannot be used stops the run."""
    result, folder = ran
    monkeypatch.setattr("stickslip.wings.papers.gouge.simulate.run_trunk", refuse)
    again = simulate_gouge(small(realizations=2), folder=folder, workers=1)
    assert again.reused == 2
    for name, found in (("ran", result), ("read", again)):
        archive.write(tmp_path / f"{name}.h5", numbers(found))
    assert (tmp_path / "ran.h5").read_bytes() == (tmp_path / "read.h5").read_bytes()
    for one, other in zip(result.realizations, again.realizations, strict=True):
        assert (one.tests[-1].series.friction == other.tests[-1].series.friction).all()
        assert one.states["end"].control.leads.dtype == other.states["end"].control.leads.dtype
    more = simulate_gouge(small(realizations=3), folder=folder, workers=1)
    assert more.reused == 2
    assert more.failures == ("realisation 2 failed: not again",)
    file = next((folder / MEMBERS).iterdir())
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArchiveError, match="damaged"):
        simulate_gouge(small(realizations=2), folder=folder, workers=1)
    file.write_bytes(whole)
    monkeypatch.setattr("stickslip.wings.papers.gouge.simulate.__version__", "99.0")
    with pytest.raises(ArchiveError, match=r"computed by stickslip .*, but this is version 99.0.*: move the file away"):
        simulate_gouge(small(realizations=2), folder=folder, workers=1)


def refuse(*_):
    raise RuntimeError("not again")


def test_if_all_fail_the_first_reason_is_told(monkeypatch):
    monkeypatch.setattr("stickslip.wings.papers.gouge.simulate.run_trunk", refuse)
    with pytest.raises(RuntimeError, match="every realisation failed; first message: realisation 0 failed: not again"):
        simulate_gouge(small(), workers=1)


def test_a_spring_pulls_the_plate_from_where_it_is():
    gouge = settled()
    pulled = attach_spring(gouge, 1e6, [gouge.state.time], [1e-6])
    forces = ss.control.spring_forces(pulled.state.control, pulled.state.grains.position, pulled.state.time)
    assert forces[pulled.top, 0].sum() == pytest.approx(1.0)


# --- measures --------------------------------------------------------------------------------------------------------


def made(kind, before, velocity, hold, friction, *, begin=0.0, thickness=0.03) -> Test:
    """A test with a given friction against slip and constants for all else; 2e-5 s between samples."""
    count = len(friction)
    time = 2e-5 * np.arange(1, count + 1)
    columns = {name: np.zeros(count) for name in Series._fields}
    columns |= {
        "time": time, "load_point": begin + velocity * time, "friction": np.asarray(friction, float),
        "thickness": np.broadcast_to(thickness, count), "fabric": np.zeros((count, 3, 3)),
    }  # fmt: skip
    return Test(kind, before, velocity, hold, Series(**columns))


def of_tests(*lists) -> GougeResult:
    """A result with one realization for each list of tests."""
    good = Range(1e-4, 500.0, 1e-3, 10.0, 10.0, 0.1)
    ones = tuple(Realization(k, good, tuple(tests), {}, {}) for k, tests in enumerate(lists))
    return GougeResult(small(), ones, (), 0)


def test_a_direct_effect_is_read_off_the_difference_of_twins():
    """Fluctuations that both share drop out; a ln(V2/V1) is found to round-off, in steps up and down."""
    rng, a = np.random.default_rng(1), 0.02
    for old, new in ((0.1, 0.3), (0.3, 0.1)):
        tests = []
        for _ in range(3):
            at = np.arange(1, 400)
            # one landscape of friction along the slip, which both copies see
            place = np.cumsum(rng.normal(size=4000)) * 1e-3
            see = lambda v, place=place, at=at: np.interp(v * 2e-5 * at / 3e-3, np.arange(4000) / 1000, place)  # noqa: E731
            tests.append([
                made("slide", old, old, 0.0, np.full(99, 0.4)), made("twin", old, old, 0.0, 0.4 + see(old)),
                made("step", old, new, 0.0, 0.4 + a * np.log(new / old) + see(new)),
            ])  # fmt: skip
        result = of_tests(*tests)
        curve = measures.step_curve(result, old, new, twin=True)
        found = measures.direct_effect(curve, old, new)
        assert found.value == pytest.approx(a, abs=1e-4)  # the landscape is sampled at other places
        assert found.error < 1e-4


def test_nothing_is_read_off_noise():
    """Without a direct effect the fixed window gives none within three errors; a largest value would be positive."""
    rng, tests = np.random.default_rng(2), []
    for _ in range(16):
        noise = rng.normal(0, 0.01, (2, 400))
        tests.append([
            made("slide", 0.3, 0.3, 0.0, np.full(99, 0.4)), made("twin", 0.3, 0.3, 0.0, noise[0]),
            made("step", 0.3, 0.6, 0.0, noise[1]),
        ])  # fmt: skip
    curve = measures.step_curve(of_tests(*tests), 0.3, 0.6, twin=True)
    found = measures.direct_effect(curve, 0.3, 0.6)
    assert abs(found.value) < 3 * found.error
    assert measures.peak(curve).value > 0.003


def test_healing_and_compaction_of_a_made_up_sample():
    """Excess b ln t over the copy without a hold; thickness that falls by c ln t in a hold."""
    b, c, tests = 0.015, 1e-5, []
    for offset in (0.0, 0.03, -0.02):
        held = np.arange(1, 1001) * 2e-5
        one = [
            made("slide", 0.3, 0.3, 0.0, np.full(400, 0.4 + offset)),
            made("twin", 0.3, 0.3, 0.0, np.full(400, 0.4 + offset)),
        ]
        for hold in (1e-3, 1e-2):
            one.append(made("reslide", 0.3, 0.3, hold, np.full(400, 0.4 + offset + b * np.log(hold / 1e-4))))
        one.append(made("hold", 0.3, 0.0, 0.0, np.full(1000, 0.4), thickness=0.03 - c * np.log(held / 2e-5)))
        tests.append(one)
    result = of_tests(*tests)
    excess = [measures.just_after(measures.reslide_curve(result, 0.3, hold, 0.3, twin=True)) for hold in (1e-3, 1e-2)]
    found = statistics.slope(np.log([1e-3, 1e-2]), excess)
    assert found.value == pytest.approx(b)
    assert found.error == pytest.approx(0, abs=1e-9)
    thinner = measures.per_efold(measures.hold_curve(result, 0.3, "thickness"))
    assert thinner.value == pytest.approx(-c, rel=1e-3)
    assert measures.mean_friction(result, 0.3).value == pytest.approx(0.4 + 0.01 / 3)
    plain = measures.reslide_curve(result, 0.3, 1e-2, 0.3)
    assert plain.mean == pytest.approx(b * np.log(100), abs=1e-9)
    assert plain.band == pytest.approx(0, abs=1e-9)


def test_bands_are_two_standard_deviations():
    curve = statistics.Curve(np.zeros(2), np.array([[0.0, 1], [0.03, 1], [-0.02, 1]]), np.arange(3), "")
    assert curve.band == pytest.approx([2 * np.std([0, 0.03, -0.02], ddof=1), 0])
    assert curve.error == pytest.approx(curve.band / 2 / np.sqrt(3))


@pytest.mark.parametrize("levels", [(0.3, 0.5), (0.3, 0.4, 0.35, 0.5)])
def test_the_error_of_few_realizations_is_that_of_their_mean(levels):
    """s/√n with n − 1 in s: drawn again with replacement, n values scatter less by √((n − 1)/n), a third for two."""
    result = of_tests(*[[made("slide", 0.3, 0.3, 0.0, np.full(50, level))] for level in levels])
    found = measures.mean_friction(result, 0.3)
    assert found.value == pytest.approx(np.mean(levels))
    # 400 draws tell a standard deviation to 1/√800 = 3.5 %
    assert found.error == pytest.approx(np.std(levels, ddof=1) / np.sqrt(len(levels)), rel=0.1)
    average = statistics.combine([found, found], np.mean)
    assert (average.value, average.error) == (pytest.approx(found.value), pytest.approx(found.error))


def test_plates_and_overlaps_see_the_nearest_images():
    """Grains at either end of a cell that is periodic along x and z are neighbours there, and not along y."""
    place = np.array([[0.1, 0.05, 0.2], [3.8, 0.05, 3.8], [2.0, 0.1, 2.0], [2.0, 3.9, 2.0]])
    cell = ss.box([4.0, 4.0, 4.0], [True, False, True])
    state = with_neighbor_list(ss.assembly(ss.spheres(place, [0.5, 0.5, 0.4, 0.4]), cell=cell))
    distance = np.hypot(0.3, 0.4)
    shrunk = _shrink_apart(state, np.arange(4)).radius
    np.testing.assert_allclose(shrunk, np.array([0.5, 0.5, 0.4, 0.4]) * distance / 1.0, rtol=1e-8)  # less 1e-9, told
    law = ss.laws.linear(kn=1.0, kt=0.5)
    touched = ss.accept(state, ss.forces(state, law)[1])
    assert _mean_overlap(touched) == pytest.approx(1.0 - distance, rel=1e-12)


def test_one_realization_has_no_error():
    curve = statistics.Curve(np.linspace(0, 1, 50), np.full((1, 50), 0.1), np.zeros(1), "")
    assert np.isnan(measures.just_after(curve).error)
    assert np.isnan(curve.error).all()
    assert repr(measures.just_after(curve)) == "Number(0.1 ± nan, 95 %, 1 samples, 1 branches)"
    assert statistics.slope([0.0, 1.0], [measures.just_after(curve)] * 2).value == 0
    with pytest.raises(ValueError, match="two different values of x"):
        statistics.slope([1.0], [measures.just_after(curve)])


def test_a_twin_that_goes_further_than_its_step_is_cut():
    tests = [
        made("slide", 0.3, 0.3, 0.0, np.full(50, 0.4)), made("twin", 0.3, 0.3, 0.0, np.linspace(0.4, 0.5, 200)),
        made("step", 0.3, 0.3, 0.0, np.linspace(0.4, 0.5, 200)[:50]),
    ]  # fmt: skip
    curve = measures.step_curve(of_tests(tests), 0.3, 0.3, twin=True)
    assert np.abs(curve.mean).max() < 1e-12


def test_the_first_samples_are_seen_however_long_the_slip_is():
    """20 diameters: the window after the step still holds many points."""
    count = 10_000
    tests = [
        made("slide", 0.3, 0.3, 0.0, np.full(50, 0.4)), made("twin", 0.3, 0.3, 0.0, np.zeros(count)),
        made("step", 0.3, 0.6, 0.0, np.arange(count) % 2),
    ]  # fmt: skip
    found = measures.just_after(measures.step_curve(of_tests(tests), 0.3, 0.6, twin=True))
    assert found.value == pytest.approx(0.5, abs=0.15)


def test_of_several_holds_the_longest_count():
    tests = [
        made("slide", 0.3, 0.3, 0.0, np.full(50, 0.4)), made("hold", 0.3, 0.0, 0.0, np.full(1000, 0.3)),
        made("slide", 0.0, 0.3, 0.0, np.full(50, 0.4)), made("hold", 0.3, 0.0, 0.0, np.full(100, 0.0)),
    ]  # fmt: skip
    curve = measures.hold_curve(of_tests(tests), 0.3)
    assert curve.x[-1] == pytest.approx(1000 * 2e-5)
    assert curve.mean == pytest.approx(-0.1)


def test_records_of_steps_know_what_was_before():
    """Each branch with steps is a record; where its slide comes from another velocity, the first half is left out."""
    ones = [
        made("steady", 0.0, 0.3, 0.0, np.full(50, 0.4)), made("slide", 0.3, 0.1, 0.0, np.full(80, 0.4)),
        made("slide", 0.1, 0.1, 0.0, np.full(30, 0.4))._replace(branch=1),
        made("step", 0.1, 0.3, 0.0, np.full(40, 0.4)), made("step", 0.3, 0.1, 0.0, np.full(40, 0.5)),
        *(made("step", *v, 0.0, np.full(40, 0.6))._replace(branch=1) for v in ((0.1, 0.3), (0.3, 0.1))),
    ]  # fmt: skip
    first, second = measures.step_records(of_tests(ones))
    assert [(one.part, one.branch) for one in (first, second)] == [(0, 0), (0, 1)]
    assert (first.data.before, second.data.before) == (0.3, 0.1)
    assert [leg.velocity for leg in first.data.legs] == [0.1, 0.3, 0.1]
    assert [round(leg.duration / 2e-5) for leg in first.data.legs] == [40, 40, 40]
    assert [round(leg.duration / 2e-5) for leg in second.data.legs] == [30, 40, 40]
    few = measures.step_records(of_tests(ones), samples=30)[0].data
    assert len(few.time) == 5 + 13 + 5  # means over 7, 3 and 7 samples, of nearly the same slip
    assert few.time[-1] < sum(leg.duration for leg in few.legs)


def test_steps_are_averaged_over_branches_of_all_samples():
    """The first branch, whose slide has another length, is left out where there are others."""

    def one(level):
        return [
            made("slide", 0.3, 0.1, 0.0, np.full(80, 0.0)),
            made("slide", 0.1, 0.1, 0.0, np.full(30, level))._replace(branch=1),
            made("step", 0.1, 0.3, 0.0, np.zeros(40)),
            made("step", 0.1, 0.3, 0.0, np.full(40, 2 * level))._replace(branch=1),
        ]  # fmt: skip

    (record,) = measures.mean_records(of_tests(one(0.3), one(0.5)))
    assert record.data.friction == pytest.approx([0.4] * 30 + [0.8] * 40)


def test_a_level_that_samples_keep_is_no_error_of_what_follows_a_hold():
    """Each sample's friction after a hold is measured from its own steady friction."""
    tests = []
    for level in (0.30, 0.35, 0.40, 0.45):
        tests.append([
            made("slide", 0.3, 0.3, 0.0, np.full(50, level)), made("reslide", 0.3, 0.3, 1e-3, np.full(50, level + 0.01))
        ])  # fmt: skip
    found = measures.peak(measures.reslide_curve(of_tests(*tests), 0.3, 1e-3, 0.3))
    assert found.value == pytest.approx(0.01)
    assert found.half < 1e-9
