"""Sweeps: members from lists and distributions, each an ordinary scenario; the same dataset however they are run."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from stickslip.data import archive
from stickslip.data.run_files import OPTIONS as REMEMBERED
from stickslip.data.run_files import SWEEP
from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, read_scenario, scenario
from stickslip.runs.folder import find_unfinished
from stickslip.runs.page import folder_content
from stickslip.runs.sweep import run
from stickslip.runs.sweep.axes import OPTIONS, quantiles, short_names
from stickslip.runs.sweep.dataset import DATASET, is_sweep, open_sweep, write_sweep
from stickslip.runs.sweep.definition import members, read_sweep, sweep
from stickslip.runs.sweep.run import MEASURES, MEMBERS, SweepResult, gather_members, run_sweep
from tests.conftest import stickslip_here

EXAMPLE = Path(__file__).parents[2] / "examples" / "rate_state_sweep.toml"
SLIDER = {"experiment": "rate-state", "samples": {"number": 12}, "legs": [{"velocity": 0.02, "distance": 1e-3}]}
LATIN = {"mode": "sample", "number": 4}


def small(**table):
    """A sweep of sliders, which take milliseconds."""
    return sweep(**SLIDER, sweep=table or {"surface.mu0": [0.3, 0.5, 0.7], "seed": {"count": 2}})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"law.my": [0.2]}, r"sweep.law.my: the table \[law\] has no key 'my': did you mean 'mu'"),
        ({"law": [0.2]}, "sweep.law is a table: name one of its keys, file, parameters, checksum, kind, coulomb"),
        ({"law.mu.x": [0.2]}, "sweep.law.mu.x: law.mu is not a table"),
        ({"law.mu": 0.4}, "sweep.law.mu = 0.4 is not allowed: use a list"),
        ({"law.mu": []}, "sweep.law.mu is an empty list"),
        ({"law.mu": [0.2, 0.2]}, "sweep.law.mu contains 0.2 more than once"),
        ({"law.mu": {}}, "sweep.law.mu = {} is not allowed: it has 0 kinds of values"),
        ({"law.mu": {"unifrom": [0, 1], "number": 2}}, r"law.mu\] has no key 'unifrom': did you mean 'uniform'"),
        ({"law.mu": {"logspace": [0, 1], "number": 2}}, "use geomspace with the end values"),
        ({"law.mu": {"uniform": [0, 1]}}, "sweep.law.mu needs a number of values"),
        ({"law.mu": {"uniform": [1, 0], "number": 2}}, "the first end must be below the second"),
        ({"law.mu": {"uniform": [0, 1, 2], "number": 2}}, r"use two numbers of at most 1e\+100 in magnitude as ends"),
        ({"law.mu": {"loguniform": [0, 1], "number": 2}}, "both ends must be positive"),
        ({"law.mu": {"normal": {"mean": 1}, "number": 2}}, "sweep.law.mu.normal.sd is missing"),
        ({"array.disks": {"integers": [1.5, 3], "number": 2}}, "use two whole numbers"),
        ({"law.mu": {"count": 3}}, "sweep.law.mu.count is not allowed, except for seed"),
        ({"seed": {"count": 0}}, "sweep.seed.count must be greater than or equal to 1, got 0"),
        ({"mode": "gird", "seed": [1]}, "sweep.mode must be 'grid', 'zip' or 'sample', got 'gird'"),
        ({"mode": "sample", "seed": [1]}, "needs the number of points"),
        ({"number": 3, "seed": [1]}, "sweep.number applies to zip and sample only"),
        (LATIN | {"law.mu": {"uniform": [0, 1], "number": 2}}, "a sample has one number for all keys"),
        ({"mode": "zip", "law.mu": [1, 2], "law.kn": [1, 2, 3]}, "sweep.law.mu has 2 values, but sweep.law.kn has 3"),
        ({}, "contains no key"),
        ({"law.mu": {"uniform": [0, 1], "number": 10_000}, "seed": {"count": 101}}, "defines 1010000 members: at most"),
        ({"law.mu": [0.4, -1.0]}, "member law.mu = -1.0: law.mu must be greater than or equal to 0, got -1.0"),
        ({"array.disks": [3, 2.5]}, "member array.disks = 2.5: array.disks must be a valid integer, got 2.5"),
    ],
)  # fmt: skip
def test_a_bad_sweep_is_one_sentence(table, words):
    with pytest.raises(ScenarioError, match=words) as caught:
        list(members(sweep(sweep=table)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("legs.velocity", "give the number of the entry"),
        ("legs.2.velocity", "entry 2, but the scenario gives 1 entries"),
    ],
)
def test_entries_of_lists_are_counted_from_one(key, words):
    with pytest.raises(ScenarioError, match=words):
        list(members(small(**{key: [0.01]})))
    assert next(members(small(**{"legs.1.velocity": [0.01]}))).scenario.legs[0].velocity == 0.01


def test_every_member_is_the_scenario_with_its_values():
    found = list(members(small(**{"surface.a": [0.01, 0.02], "seed": {"count": 3}})))
    assert [one.values for one in found[:4]] == [
        {"surface.a": 0.01, "seed": 0}, {"surface.a": 0.01, "seed": 1}, {"surface.a": 0.01, "seed": 2},
        {"surface.a": 0.02, "seed": 0},
    ]  # fmt: skip
    assert found[3].scenario == scenario(**SLIDER, surface={"a": 0.02}, seed=0)
    assert len({one.name for one in found}) == 6


def test_dotted_keys_and_tables_are_the_same():
    assert small(**{"surface.a": [0.01]}).axes == small(surface={"a": [0.01]}).axes


def test_spaced_values_hold_their_ends_and_stay_whole():
    axes = sweep(sweep={
        "array.disks": {"linspace": [4, 8], "number": 3}, "law.kn": {"geomspace": [1.0, 100.0], "number": 3},
    }).axes  # fmt: skip
    assert axes[0].values == (4, 6, 8)
    assert all(isinstance(value, int) for value in axes[0].values)
    assert axes[1].values == pytest.approx((1, 10, 100))


def test_draws_depend_on_their_seed_and_key_alone():
    table = {"law.mu": {"uniform": [0, 1], "number": 5}}
    alone = sweep(sweep=table).axes[0].values
    assert sweep(sweep=table).axes[0].values == alone == tuple(sorted(alone))
    assert sweep(sweep={"law.kn": {"uniform": [0, 1], "number": 2}} | table).axes[1].values == alone
    assert not set(alone) & set(sweep(sweep=table | {"draw_seed": 1}).axes[0].values)


def test_whole_numbers_are_drawn_up_to_both_ends():
    assert quantiles("integers", (3, 5), np.array([0.0, 0.33, 0.34, 0.66, 0.67, 1.0])) == (3, 3, 4, 4, 5, 5)


@pytest.mark.parametrize(
    ("told", "median", "quarter"),
    [
        ({"uniform": [1.0, 3.0]}, 2.0, 1.5), ({"loguniform": [1.0, 100.0]}, 10.0, 10**0.5),
        ({"normal": {"mean": 2.0, "sd": 0.5}}, 2.0, 2 - 0.5 * 0.67449), ({"linspace": [1.0, 3.0]}, 2.0, 1.5),
    ],
)  # fmt: skip
def test_a_latin_hypercube_has_one_value_in_every_part(told, median, quarter):
    chosen = sweep(sweep={"mode": "sample", "number": 1000, "law.kn": told, "law.kt": {"uniform": [0.0, 1.0]}})
    assert chosen.shape == (1000,)
    values, other = (np.array(axis.values) for axis in chosen.axes)
    assert np.median(values) == pytest.approx(median, rel=5e-3)  # one of 1000 strata is 1e-3 of the probability
    assert np.quantile(values, 0.25) == pytest.approx(quarter, rel=5e-3)
    np.testing.assert_array_equal(np.sort((other * 1000).astype(int)), np.arange(1000))
    assert abs(np.corrcoef(values, other)[0, 1]) < 0.15  # 1/sqrt(1000) = 0.03 for independent ones


def test_points_that_go_side_by_side_are_repeated_with_every_seed():
    both = sweep(sweep={"mode": "zip", "law.mu": [1.0, 2.0], "array.disks": [3, 4], "seed": {"count": 2}})
    found = [tuple(one.values.values()) for one in members(both)]
    assert found == [(1.0, 3, 0), (1.0, 3, 1), (2.0, 4, 0), (2.0, 4, 1)]


def test_no_key_of_a_scenario_is_an_option_of_a_sweep():
    for one in EXPERIMENTS.values():
        assert not set(OPTIONS) & set(one.scenario.model_fields)


def test_a_scenario_with_a_sweep_is_not_one_scenario():
    with pytest.raises(ScenarioError, match=r"has a table \[sweep\] for many scenarios"):
        read_scenario(EXAMPLE)
    assert read_sweep(EXAMPLE).shape == (2, 5, 4)


def test_the_dataset_is_labelled_and_members_are_where_it_says(tmp_path):
    swept = run_sweep(small(), tmp_path, workers=1)
    assert not any(swept.failures)
    found = open_sweep(tmp_path)
    assert is_sweep(tmp_path)
    assert found.sizes == {"surface.mu0": 3, "seed": 2}
    assert found.critical_stiffness.attrs["units"] == "1/m"
    assert found.sel({"surface.mu0": 0.5}).final_friction.values == pytest.approx(0.5, abs=1e-3)  # a slide at V0
    assert "[m" not in str(found["surface.mu0"].attrs)
    for mu0 in (0.3, 0.5, 0.7):
        one = found.sel({"surface.mu0": mu0, "seed": 1})
        folder = tmp_path / MEMBERS / str(one.member.values)
        left = read_scenario(folder / "scenario.json")
        assert (left.surface.mu0, left.seed) == (mu0, 1)
        assert archive.read(folder / "results.h5")["history"]["friction"][-1] == one.final_friction
    with xr.open_dataset(tmp_path / DATASET) as again:
        assert again.identical(found)


def test_parts_gathered_are_the_whole(tmp_path):
    chosen, parts = small(), [tmp_path / f"part {k}" for k in (1, 2, 3, 4)]
    ran = [run_sweep(chosen, folder, workers=1, part=(k + 1, 4)) for k, folder in enumerate(parts)]
    assert [sum(one is not None for one in swept.found) for swept in ran] == [2, 2, 1, 1]
    assert find_unfinished(parts[1]).part == (2, 4)
    names = ran[0].names
    (tmp_path / "whole" / MEMBERS / names[0]).mkdir(parents=True)
    assert gather_members(tmp_path / "whole", chosen, names, parts) == 6
    assert run_sweep(chosen, tmp_path / "whole", workers=1).reused == 6
    run_sweep(chosen, tmp_path / "once", workers=1)
    whole, once = (open_sweep(tmp_path / name).drop_vars("seconds") for name in ("whole", "once"))
    assert whole.identical(once)
    with pytest.raises(ValueError, match="part 1 does not contain this sweep"):
        gather_members(tmp_path / "whole", small(seed={"count": 3}), names, parts)


def test_files_of_a_member_travel_when_its_worker_does_not_see_the_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("stickslip.runs.sweep.run.is_same_sweep", lambda path, text: False)
    swept = run_sweep(small(), tmp_path, workers=1)
    for name in swept.names:
        here = {path.name for path in (tmp_path / MEMBERS / name).iterdir()}
        assert here == {"manifest.json", "scenario.json", "results.h5", MEASURES}


def test_a_second_call_runs_what_is_missing_only(tmp_path):
    first = run_sweep(small(), tmp_path, workers=1)
    times = {name: (tmp_path / MEMBERS / name / "results.h5").stat().st_mtime_ns for name in first.names}
    (tmp_path / MEMBERS / first.names[2] / MEASURES).write_text("{broken")
    (tmp_path / MEMBERS / first.names[4] / "results.h5").unlink()
    again = run_sweep(small(), tmp_path, workers=1)
    assert again.reused == 4
    assert [one["measures"] for one in again.found] == [one["measures"] for one in first.found]
    new = {name for name in first.names if (tmp_path / MEMBERS / name / "results.h5").stat().st_mtime_ns != times[name]}
    assert new == {first.names[2], first.names[4]}
    more = run_sweep(small(**{"surface.mu0": [0.1, 0.3, 0.5, 0.7], "seed": {"count": 2}}), tmp_path, workers=1)
    assert more.reused == 6
    assert open_sweep(tmp_path).finished.values.all()


@pytest.mark.parametrize("figures", [False, True])
def test_resume_draws_figures_if_the_first_call_did(figures, tmp_path):
    chosen = small(**{"surface.mu0": [0.3, 0.5]})
    swept = run_sweep(chosen, tmp_path, workers=1, figures=figures)
    assert find_unfinished(tmp_path).figures is figures
    assert find_unfinished(tmp_path).sweep == json.loads(chosen.text)
    shutil.rmtree(tmp_path / MEMBERS / swept.names[1])
    run = stickslip_here("resume", tmp_path, "--workers", "1")
    assert run.returncode == 0, run.stderr
    for name in swept.names:
        assert any((tmp_path / MEMBERS / name).glob("*.png")) == figures
    assert find_unfinished(tmp_path).figures is figures
    (tmp_path / REMEMBERED).unlink()
    assert find_unfinished(tmp_path).figures is False


def test_members_of_another_version_are_run_again(tmp_path):
    first = run_sweep(small(), tmp_path, workers=1)
    path = tmp_path / MEMBERS / first.names[0] / MEASURES
    path.write_text(path.read_text().replace(json.loads(path.read_text())["stickslip"], "0.0.1"))
    assert run_sweep(small(), tmp_path, workers=1).reused == 5


def test_a_scenario_that_is_drawn_twice_is_run_once(tmp_path):
    swept = run_sweep(
        small(mode="zip", **{"surface.mu0": [0.3, 0.3, 0.5], "surface.law": ["aging"] * 3}), tmp_path, workers=1
    )
    assert len(list((tmp_path / MEMBERS).iterdir())) == 2
    assert swept.found[0] == swept.found[1]
    assert open_sweep(tmp_path).sizes == {"point": 3}


def test_members_that_fail_are_named_and_tried_again(tmp_path):
    disks = {"array": {"disks": 2}, "load": {"push": [0.0, 0.01], "step": 5e-3}, "dynamics": {"loads": ()}}
    chosen = sweep(**disks, sweep={"law.mu": [0.0, 10.0]})
    swept = run_sweep(chosen, tmp_path, workers=1)
    assert "no equilibrium at push = 0.005" in swept.failures[0]
    assert not swept.failures[1]
    found = open_sweep(tmp_path)
    assert found.finished.values.tolist() == [0, 1]
    assert "no equilibrium" in str(found.failure.values[0])
    assert np.isnan(found.pairs.values[0])
    assert found.pairs.values[1] == 0
    again = run_sweep(chosen, tmp_path, workers=1)
    assert again.reused == 1
    assert again.failures[0]


def test_pieces_that_cannot_be_used_do_not_stop_a_member(tmp_path, monkeypatch):
    from stickslip.data.archive import ArchiveError
    from stickslip.data.run_files import UNFINISHED
    from stickslip.wings.faults.rate_state import simulate as room

    simulate = room.simulate_slider

    def picky(one, *, folder, **more):
        if (folder / UNFINISHED).exists():
            raise ArchiveError("pieces of another version")
        return simulate(one, folder=folder, **more)

    monkeypatch.setattr(room, "simulate_slider", picky)
    chosen = small(**{"surface.mu0": [0.3]})
    (tmp_path / MEMBERS / next(members(chosen)).name / UNFINISHED).mkdir(parents=True)
    assert run_sweep(chosen, tmp_path, workers=1).failures == [""]


def test_figures_are_drawn_if_asked_for(tmp_path):
    swept = run_sweep(small(**{"surface.mu0": [0.3]}), tmp_path, workers=1, figures=True)
    here = {path.name for path in (tmp_path / MEMBERS / swept.names[0]).iterdir()}
    assert here >= {"fig1_history.png", "series.csv", "results.h5"}


def test_what_is_no_sweep_cannot_be_opened(tmp_path):
    assert not is_sweep(tmp_path)
    with pytest.raises(ValueError, match="does not contain a sweep"):
        open_sweep(tmp_path)
    (tmp_path / DATASET).write_text("broken")
    with pytest.raises(ValueError, match="does not contain a sweep"):
        open_sweep(tmp_path)


def test_the_sweep_that_was_run_is_kept(tmp_path):
    chosen = small()
    run_sweep(chosen, tmp_path, workers=1)
    assert read_sweep(tmp_path / SWEEP) == chosen
    assert json.loads(open_sweep(tmp_path).attrs["sweep"]) == json.loads(chosen.text)


def test_measures_that_no_member_has_fill_no_rows(tmp_path, capsys):
    """Neither on the terminal nor on the page; the dataset has them."""
    none = dict.fromkeys(("nowhere", "nowhere_error", "known_error"), (float("nan"), "m"))
    made = [{"seconds": 1.0, "measures": {"known": (k, "1")} | none} for k in (1.0, 2.0)]
    chosen = small(**{"surface.mu0": [0.3, 0.5], "seed": [0]})
    names = ["a", "b"]
    run.show(SweepResult(chosen, names, made, ["", ""], 0))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["known", "1", "2", "1", "1.5", "2"] in lines
    assert ["Measures", "without", "a", "value", "in", "any", "member:", "nowhere."] in lines
    assert not [line for line in lines if line[:1] == ["nowhere"]]
    write_sweep(tmp_path, chosen, names, made, ["", ""])
    (tmp_path / "sweep.json").write_text(chosen.text)
    text = dict(folder_content(tmp_path).sections)["Members"]
    assert "known" in text and "Measures without a value in any member: nowhere." in text and "nan" not in text


@pytest.mark.parametrize("keys, others, short", [
    (["law.mu"], [], ["mu"]),
    (["law.mu", "packing.friction.mu"], [], ["law.mu", "friction.mu"]),
    (["law.mu", "law.kn", "seed"], ["kn", "friction"], ["mu", "law.kn", "seed"]),  # a measure has that name
    (["legs.1.velocity", "legs.2.velocity"], [], ["legs.1.velocity", "legs.2.velocity"]),
    (["friction.a.1.2", "friction.b"], [], ["a.1.2", "b"]),  # no name begins with a number
    (["mu", "law.mu"], [], ["mu", "law.mu"]),
])  # fmt: skip
def test_swept_keys_have_short_names_that_tell_them_apart(keys, others, short):
    assert short_names(keys, others) == dict(zip(keys, short, strict=True))


def test_a_sweep_is_read_with_short_names_and_its_file_keeps_the_keys(tmp_path):
    chosen = small(**{"surface.mu0": [0.3, 0.5], "legs.1.velocity": [0.01, 0.02]})
    run_sweep(chosen, tmp_path, workers=1)
    assert set(open_sweep(tmp_path).coords) == {"surface.mu0", "legs.1.velocity"}
    found = open_sweep(tmp_path, short=True)
    assert set(found.coords) == set(found.final_friction.dims) == {"mu0", "velocity"}
    assert float(found.final_friction.sel(mu0=0.3, velocity=0.01)) == float(open_sweep(tmp_path).final_friction[0, 0])
