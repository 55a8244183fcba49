"""`stickslip run` of a slider, `stickslip fit` of what it wrote, and wrong words."""

import json
from pathlib import Path
from types import SimpleNamespace as Made

import numpy as np
import pytest

from stickslip.cli import app
from stickslip.data import archive
from stickslip.experiments.registry import ScenarioError, read_scenario, scenario
from stickslip.wings.faults.rate_state import simulate as room
from tests.conftest import stickslip_here as stickslip

EXAMPLE = Path(__file__).parents[3] / "examples" / "rate_state.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("rate-state") / "out"
    run = stickslip("run", EXAMPLE, "--out", out)
    assert run.returncode == 0, run.stderr
    assert "stable with any spring" in " ".join(run.stdout.split())
    return out


def test_the_example_writes_what_it_says(folder):
    names = {path.name for path in folder.iterdir()}
    assert names == {"fig1_history.png", "manifest.json", "results.h5", "scenario.json", "series.csv"}
    numbers = archive.read(folder / "results.h5")
    assert numbers["history"]["friction"].shape == numbers["recorded"].shape
    assert read_scenario(folder / "scenario.json") == read_scenario(EXAMPLE)


def test_noise_has_its_size_and_correlation_and_depends_on_the_seed():
    one, other = (room._noise(Made(seed=seed, samples=Made(noise=2e-3, correlation=0.9)), 20_000) for seed in (3, 4))
    assert one.std() == pytest.approx(2e-3, rel=0.1)  # as many as 1000 independent values
    assert np.corrcoef(one[1:], one[:-1])[0, 1] == pytest.approx(0.9, abs=0.02)
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.2


def test_the_series_fitted_again_gives_the_parameters(folder, tmp_path):
    arguments = ("fit", folder / "series.csv", "--stiffness", "200", "--out", tmp_path / "fit", "--json")
    run = stickslip(*arguments)
    assert run.returncode == 0, run.stderr
    answer = json.loads(run.stdout)
    written = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert {key: answer[key] for key in written} == written
    assert {path.name for path in (tmp_path / "fit").iterdir()} == {"fit.json", "fit.png", "manifest.json"}
    slip = answer["fits"]["slip"]
    for name, true in (("a", 0.0247), ("b", 0.0178), ("dc", 5.3e-3), ("mu0", 0.4)):  # of the example
        assert abs(slip["values"][name] - true) < 4 * slip["errors"][name], name
    assert answer["comparison"]["preferred"] == "slip"
    assert answer["fits"]["aging"]["intervals"]["a"] == [None, None]
    again = stickslip(*arguments)
    assert again.returncode == 2
    assert "contains the results of a fit" in again.stderr


def test_a_wrong_unit_of_length_is_suspected(folder, tmp_path, capsys):
    lines = (folder / "series.csv").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("time"))
    lines[head] = lines[head].replace("load_point [m]", "load_point [um]")
    (tmp_path / "um.csv").write_text("\n".join(lines))
    app(["fit", str(tmp_path / "um.csv"), "--stiffness", "2e8", "--law", "slip"], standalone_mode=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "slip law: D_c = 5.29e-09 m is outside the range of 1e-08 to 0.1 m found in experiments" in said
    assert "is the unit of the displacement right? In a unit 1000 times larger, D_c would be 5.29e-06 m" in said


def test_tables_for_people(folder, capsys):
    app(["fit", str(folder / "series.csv"), "--free-stiffness", "--law", "slip", "--detrend"], standalone_mode=False)
    said = capsys.readouterr().out
    for word in ("Slip law", "dc", "stiffness", "trend", "a − b", "1/m"):
        assert word in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "give --stiffness K [1/m], or --free-stiffness"),
        (["--stiffness", "-1"], "stiffness = -1.0 was fixed"),
        (["--stiffness", "1", "--free-stiffness"], "exclude each other"),
        (["--law", "slow"], "unknown law 'slow': use aging, slip, both"),
        (["--free-stiffness", "--normal"], "no normal_stress"),
    ],
)
def test_unknown_commands_and_options_are_refused(folder, arguments, sentence):
    with pytest.raises(ValueError) as caught:
        app(["fit", str(folder / "series.csv"), *arguments], standalone_mode=False)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_absent_files(tmp_path):
    run = stickslip("fit", tmp_path / "absent.csv", "--free-stiffness")
    assert run.returncode == 2
    assert "no such file" in run.stderr


@pytest.mark.parametrize(
    ("tables", "sentence"),
    [
        ({"legs": [{"velocity": 0.0, "duration": 1.0}]}, "the first leg is a hold"),
        ({"legs": [{"velocity": 1.0}]}, "either duration or distance"),
        ({"legs": [{"velocity": 1.0, "distance": 1.0}, {"velocity": 0.0, "distance": 1.0}]}, "give its duration"),
        ({"legs": [{"duration": 1.0}]}, "legs.velocity (entry 1) is missing"),
    ],
)
def test_wrong_scenarios(tables, sentence):
    with pytest.raises(ScenarioError) as caught:
        scenario(experiment="rate-state", **tables)
    assert sentence in str(caught.value)


def test_a_slider_that_runs_away_is_shown_as_far_as_it_got(tmp_path, capsys):
    text = """
experiment = "rate-state"
legs = [{velocity = 1e-6, distance = 1e-4}, {velocity = 1e-5, distance = 1e-2}]
[surface]
a = 0.010
b = 0.015
dc = 1e-5
[spring]
stiffness = 100.0
"""
    (tmp_path / "s.toml").write_text(text)
    app(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "out")], standalone_mode=False)
    said = " ".join(capsys.readouterr().out.split())
    assert "ran away" in said
    assert "unstable: stiffness 100 is 0.2 times the critical 500" in said
    assert (tmp_path / "out" / "fig1_history.png").exists()
