"""Sheared spheres on the command line: a small run in three and two dimensions by one key, the quick reproduction."""

import json

import numpy as np
import pytest

from stickslip.data import archive
from stickslip.experiments.registry import ScenarioError, scenario
from tests.conftest import stickslip_here as stickslip

SMALL = """
experiment = "sphere-shear"
packings = {number}
seed = 2
[packing]
grains = 30
dim = {dim}
packing_fraction = {fraction}
[shear]
strain = [0.0, 0.01, 0.02]
step = [5e-4, 1e-3]
[release]
e_folds = 28.0
least = 100.0
duration = 3e4
snapshots = 8
"""
IDS = [
    "onset-strain", "im-lambda-at-birth-exponent", "pairs-at-zero-slip", "pairs-reappear", "growth-rate-ratio",
    "frequency-ratio", "growth-follows-prediction", "decades-of-growth", "spectrum-constant-until",
    "stress-drop-one-pair", "stress-drop-later", "contacts-lost", "im-lambda-one-pair", "many-pairs-at-larger-strain",
    "births-at-larger-strain", "symmetries-of-blocks", "trajectories-three-dimensional", "stress-around-zero",
    "stress-amplitude-exponent", "pairs-under-a-linear-law", "pairs-without-smoothing", "pairs-before-the-limit",
    "threshold-not-responsible", "generic-without-hamiltonian", "trajectories-spiral", "drag-time-over-sound-time",
    "dynamics-overdamped", "isotropic-contacts",
]  # fmt: skip


@pytest.mark.usefixtures("plain_figures")
@pytest.mark.parametrize(("dim", "fraction", "number"), [pytest.param(3, 0.7, 2, marks=pytest.mark.slow), (2, 0.88, 1)])
def test_a_small_scenario_runs_in_both_dimensions(tmp_path, dim, fraction, number):
    (tmp_path / "s.toml").write_text(SMALL.format(dim=dim, fraction=fraction, number=number))
    done = stickslip("run", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "Sheared packings" in done.stdout
    tree = archive.read(tmp_path / "out" / "results.h5")
    assert list(tree["paths"]) == ["002", "003"][:number]
    for seed in tree["paths"]:
        path = tree["paths"][seed]
        assert path["strain"][-1] == pytest.approx(0.02)
        assert path["pairs"][0] == 0
        assert path["pairs"][-1] > 0
        assert path["residual"].max() <= 5e-14
        assert path["zero_modes"] == dim + (6 if dim == 3 else 3) * path["packed"]["rattlers"]
        run = tree["later"][seed]
        assert run["growth"]["growth_rate"] == pytest.approx(run["growth_rate"], rel=0.02)
        assert run["msd"][-1] > 1e-9
    assert {f"fig{k}" for k in range(1, 6)} <= {p.name[:4] for p in (tmp_path / "out").glob("fig*.png")}
    last = tree["paths"]["002"]["last"]
    again = stickslip("stability", tmp_path / "out" / "results.h5", "--frame", "paths/002/last", "--json")
    assert again.returncode == 0, again.stderr
    assert len(json.loads(again.stdout)["pairs"]) == tree["paths"]["002"]["pairs"][-1]
    assert last.cell.vectors[1, 0] / last.cell.vectors[1, 1] == pytest.approx(0.02)


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_processes(tmp_path):
    text = SMALL.format(dim=3, fraction=0.7, number=2).replace("0.01, 0.02", "1e-3").replace("[5e-4, 1e-3]", "5e-4")
    (tmp_path / "s.toml").write_text(text)
    results = []
    for workers in (1, 2):
        out = tmp_path / str(workers)
        assert stickslip("run", tmp_path / "s.toml", "--out", out, "--workers", workers).returncode == 0
        results.append(archive.read(out / "results.h5")["paths"]["002"]["shear_stress"])
    np.testing.assert_allclose(*results, rtol=1e-9)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"packing": {"packing_fraction": 0.7, "pressure": 1e-3}}, "exclude each other"),
        ({"shear": {"strain": (0.1, 0.2)}}, "the first of them 0.0"),
        ({"shear": {"step": (1e-5, 1e-5, 1e-5)}}, "3 entries for 2 legs"),
        ({"shear": {"step": 1e-9}}, "at most 100000"),
    ],
)
def test_a_wrong_shear_scenario_gives_a_one_sentence_error(tables, message):
    with pytest.raises(ScenarioError, match=message) as problem:
        scenario(experiment="sphere-shear", **tables)
    assert "\n" not in str(problem.value)


def test_an_unknown_experiment_gives_a_one_sentence_error():
    with pytest.raises(ScenarioError, match="must be one of 'disk-array', 'sphere-shear', 'quasi-rigid'"):
        scenario(experiment="sphere")


@pytest.mark.slow
def test_the_quick_reproduction_has_every_claim(tmp_path):
    done = stickslip("reproduce", "sphere-shear", "--quick", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    claims = {c["id"]: c for c in json.loads((tmp_path / "out" / "claims.json").read_text())}
    assert sorted(claims) == sorted(IDS)
    assert claims["pairs-at-zero-slip"]["measured"] == 0
    assert 4e-5 < claims["onset-strain"]["measured"] < 5e-3
    decided = [c["id"] for c in claims.values() if c["verdict"] not in ("undecided", "no reference")]
    assert len(decided) >= 4, "a quick run that decides nothing is not worth its time"
    assert claims["im-lambda-at-birth-exponent"]["measured"] == pytest.approx(0.5, rel=0.05)
    assert claims["growth-rate-ratio"]["measured"] == pytest.approx(1, abs=1e-3)
    assert claims["frequency-ratio"]["measured"] == pytest.approx(1, abs=1e-4)
    assert claims["growth-follows-prediction"]["verdict"] == "reproduced"
    assert claims["decades-of-growth"]["measured"] > 11.5, "more than the window of the fit"
    assert claims["pairs-reappear"]["verdict"] in ("reproduced", "undecided")
    unprinted = {"onset-strain", "im-lambda-at-birth-exponent", "spectrum-constant-until", "stress-drop-later",
                 "contacts-lost", "births-at-larger-strain", "stress-amplitude-exponent"}  # fmt: skip
    assert {name for name, c in claims.items() if c["paper"] is None} == unprinted
    assert {name for name, c in claims.items() if c["verdict"] == "no reference"} == unprinted
    assert all(c["source"].partition(":")[2] for c in claims.values())
