"""`experiment = "threshold"`: outcomes counted by hand, a run that is stopped and resumed, and bad scenarios."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.core.progress import Outcome, Status
from stickslip.experiments import ScenarioError
from stickslip.loading import threshold as kinetic
from stickslip.wings.studies.threshold import simulate as threshold

EXAMPLES = Path(__file__).parents[3] / "examples"
PACKING = {
    "experiment": "threshold",
    "seed": 1,
    "sample": {"kind": "packing", "grains": 20, "dim": 2, "pressure": 1e-3,
               "law": {"mu": 0.5, "coulomb": "sharp", "damping_n": 0.1, "damping_t": 0.1}},
    "load": {"loads": [0.2, 0.3], "step": 0.1},
    "kicks": {"velocities": [1e-9, 0.02], "realizations": 3, "duration": 300.0, "dt": 0.5, "distance": 0.05},
}  # fmt: skip
TOML = """
experiment = "threshold"
seed = 1
[sample]
kind = "packing"
grains = 20
dim = 2
pressure = 1e-3
law = {mu = 0.5, coulomb = "sharp", damping_n = 0.1, damping_t = 0.1}
[load]
loads = [0.2, 0.3]
step = 0.1
[kicks]
velocities = [1e-9, 0.02]
realizations = 3
duration = 300.0
dt = 0.5
distance = 0.05
"""


@pytest.fixture(scope="module")
def result():
    return ss.simulate(ss.scenario(**PACKING), workers=1)


def test_outcomes_are_those_of_dynamics_run_by_hand(result):
    """The packing, its stress, the kicks and the count, without the protocol and the threshold of the package."""
    assert 0 < result.found.slid.sum() < result.found.runs.sum()
    for point in result.path:
        stress = ss.measure.stress(point.state, result.law)
        np.testing.assert_allclose(stress[:2, 1], [-point.load * 1e-3, 1e-3], atol=1e-7)
    for load, slid in zip(result.found.loads, result.found.slid, strict=True):
        (start,) = (point.state for point in result.path if point.load == load)
        for velocity, expected in zip((1e-9, 0.02), slid, strict=True):
            count = 0
            for number in range(3):
                seed = kinetic._seed(1, load, velocity, number)
                kick = np.random.default_rng(seed).normal(0.0, velocity, (20, 6))
                grains = start.grains._replace(
                    velocity=kick[:, :3] * [1, 1, 0], spin=kick[:, 3:] * [0, 0, 1] / start.grains.radius[:, None]
                )
                state, far = start._replace(grains=grains), 0.0
                for _ in range(40):
                    state, _, _ = ss.run(state, result.law, 15, 0.5, threads=1)
                    lean, high = state.cell.vectors[1, 0], start.cell.vectors[1, 1]
                    far = max(far, abs(lean - start.cell.vectors[1, 0]) / high)
                count += far > 0.05
            assert count == expected


def test_the_path_ends_where_the_sample_slides(result):
    """If a sample has slid after the way of its third step, the path has two, and the third load is the strength."""
    lean = [ss.measure.shear_strain(point.state) for point in result.path]
    steps = np.diff(lean)
    assert len(steps) == 3 and steps[2] > 1.2 * steps[:2].max()
    tables = PACKING | {"load": {"loads": [0.1, 0.3], "step": 0.1}}
    tables["kicks"] = PACKING["kicks"] | {"distance": 0.9 * steps[2], "velocities": [0.0], "realizations": 1}
    rerun = ss.simulate(ss.scenario(**tables), workers=1)
    assert rerun.strength == 0.3 and rerun.path[-1].load == 0.2
    assert rerun.found.loads.tolist() == [0.1] and np.isnan(result.strength)
    assert rerun.sentences[0] == "the sample held a load of 0.2 and slid spontaneously at 0.3"
    assert result.sentences[0].endswith(" and did not slide")
    tables["kicks"] |= {"distance": 0.5 * steps.min()}
    with pytest.raises(ScenarioError, match=r"slides spontaneously at a load of 0.1, below all of load.loads: add"):
        ss.simulate(ss.scenario(**tables | {"load": {"loads": [0.2], "step": 0.1}}), workers=1)


def test_a_load_without_equilibrium_is_the_strength(result):
    """A protocol that finds the known equilibria up to a load of 0.2, and none beyond it."""
    known = {point.load: point.state for point in result.path}

    def settle(state, load):
        if load > 0.2:
            raise ss.NotInEquilibriumError("none", Outcome(Status.STEPS_SPENT, 1.0, 1))
        return known[load], Outcome(Status.CONVERGED, 0.0, 1)

    protocol = ss.protocols.Protocol(result.law, lambda state, load: state, settle, False)
    start, said = result.path[0].state, []
    path, strength = threshold.raise_load(start, [0.0, 0.1, 0.2, 0.3], protocol, 1.0, None, lambda *w: said.append(w))
    assert strength == 0.3 and [point.load for point in path] == [0.0, 0.1, 0.2] and "no equilibrium" in said[-1][2]
    with pytest.raises(ss.NotInEquilibriumError):
        threshold.raise_load(start, [0.3], protocol, 1.0, None, lambda *now: None)


def call(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["stickslip", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


def test_a_run_that_is_stopped_continues_with_what_is_saved(result, tmp_path, monkeypatch):
    (tmp_path / "one.toml").write_text(TOML)
    out, kick, calls = tmp_path / "out", kinetic._kick, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return kick(*arguments)

    monkeypatch.setattr("stickslip.loading.threshold._kick", interrupted)
    assert call(monkeypatch, "run", tmp_path / "one.toml", "--out", out, "--workers", 1) == 130
    assert call(monkeypatch, "resume", out, "--workers", 1) == 0
    assert len(calls) == result.found.runs.sum() + 1  # the interrupted one is repeated, and no other
    with (out / "threshold.csv").open() as file:
        rows = list(csv.DictReader(file))
    outcome = result.found
    assert [int(row["slid"]) for row in rows] == outcome.slid.ravel().tolist()
    assert [int(row["lasting"]) for row in rows] == outcome.lasting.ravel().tolist()
    assert [float(row["lasting share"]) * 3 for row in rows] == pytest.approx(outcome.lasting.ravel().tolist())
    assert [float(row["load"]) for row in rows] == np.repeat(outcome.loads, 2).tolist()
    assert (out / "fig1_static_and_kinetic.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("dt = 0.5", "dt = 50.0\nduration = 3000.0"), "kicks.dt = 50 exceeds the largest stable time step of the"),
        (("[1e-9, 0.02]", "[1e3]"), "kicks.velocities = 1000 moves grains by more than a radius in a time"),
        pytest.param(
            ("[0.2, 0.3]\nstep = 0.1", "[2.0, 3.0]\nstep = 0.5"),
            "below all of load.loads: add smaller loads",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_input_that_proves_wrong_leaves_nothing(change, message, tmp_path, monkeypatch, capsys):
    text = TOML.replace("duration = 300.0\n", "") if "duration" in change[1] else TOML
    (tmp_path / "one.toml").write_text(text.replace(*change))
    assert call(monkeypatch, "run", tmp_path / "one.toml", "--out", tmp_path / "out", "--workers", 1) == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_in_a_sweep(tmp_path):
    swept = ss.sweep(**PACKING, sweep={"seed": [1, 2]})
    assert ss.run_sweep(swept, tmp_path, workers=1).failures == ["", ""]
    share = ss.io.open_sweep(tmp_path)["largest_share@0.02"].values
    assert share.shape == (2,) and share[0] > 0 and (share * 3 == np.round(share * 3)).all()


def test_the_load_of_an_array_is_its_push_over_the_normal_force():
    chosen = ss.scenario(
        experiment="threshold", sample={"kind": "disk-array", "disks": 4, "press": 1e-4}, load={"loads": [0.02]}
    )
    state, protocol = threshold.make_sample(chosen, None, lambda *now: None)
    pushed = protocol.apply(state, 0.02)
    assert pushed.control.force[:, 0].tolist() == pytest.approx([0.02 * 4e-4, 0, 0, 0, 0])
    assert pushed.control.force[:4, 1] == pytest.approx(-1e-4)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"sample": {"kind": "sand"}}, "sample has kind = 'sand': use 'disk-array', 'packing', 'gouge'"),
        ({"sample": {"disks": 3}}, "sample has no kind"),
        ({"sample": {"kind": "packing", "grain": 30}}, "did you mean 'grains'"),
        ({"sample": {"kind": "gouge"}}, "law is missing"),
        ({"sample": {"kind": "gouge", "law": {"damping_n": 1e4}, "dt": 1e-3}}, "is unstable"),
        ({"sample": {"kind": "disk-array", "press": 1.0}}, "more than a fifth of a radius"),
        ({"sample": {"kind": "disk-array", "disks": 3, "disk": 4}}, "load.disk must be at most 3"),
        ({"load": {"loads": [0.2, 0.1]}}, "load.loads must increase, got .*: sort them"),
        (
            {"load": {"loads": []}},
            r"load.loads must be a list of one or more numbers, such as \[0.03, 0.04\], got \[\]",
        ),
        ({"kicks": {"velocities": 1e-4}}, "kicks.velocities must be a list"),
        ({"kicks": {"velocities": [1e-4, 1e-6, 1e-4]}}, "must be distinct"),
        ({"load": {"loads": [1.0], "step": 1e-9}}, "use a larger load.step"),
        ({"kicks": {"dt": 1.0, "duration": 10.0}}, "which need at least 40 steps"),
    ],
)
def test_bad_scenarios(tables, message):
    with pytest.raises(ScenarioError, match=message):
        ss.scenario(experiment="threshold", **tables)


def test_the_law_of_a_sample_may_come_from_a_file(tmp_path):
    law = tmp_path / "law.py"
    law.write_text((EXAMPLES / "cohesive_law.py").read_text())
    file = tmp_path / "one.toml"
    file.write_text('experiment = "threshold"\n[sample]\nkind = "packing"\n[sample.law]\nfile = "law.py"\n')
    chosen = ss.read_scenario(file)
    assert chosen.sample.law.file == str(law) and chosen.sample.law.checksum
    copy = tmp_path / "scenario.json"
    copy.write_text(chosen.text.replace(chosen.sample.law.checksum, "x" * 16))
    law.write_text(law.read_text() + "\n")
    assert ss.read_scenario(copy).sample.law.checksum == "x" * 16  # reading a run's scenario executes nothing
