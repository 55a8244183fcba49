"""The command line of fault gouge: a whole run, wrong input, and what is left in the folder."""

import json
from pathlib import Path

import numpy as np
import pytest

from stickslip.data import archive
from stickslip.data.scenario import read, scenario
from stickslip.experiments import gouge as paper
from stickslip.experiments import gouge_claims, gouge_report, report
from stickslip.loading.gouge_ensemble import simulate_gouge
from tests.gouge.test_gouge import small
from tests.published.test_disk_array import stickslip

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def ran():
    """Two small samples taken through a small version of the paper's protocol, with both restitutions."""
    chosen = paper.paper_scenario(quick=True)
    tiny = small().model_dump()
    protocol = [part.model_dump() for part in chosen.protocol]
    for part in protocol:
        part |= {"slip": 0.2, "twin": 0.1}
        if "holds" in part:
            part |= {"holds": tuple(t / 10 for t in part["holds"]), "approach": 0.1}
    reduced = scenario(**tiny | {"protocol": protocol, "realizations": 2})
    return simulate_gouge(reduced, workers=2), simulate_gouge(paper.damped_scenario(reduced), workers=2)


@pytest.mark.timeout(300)  # another process compiles
def test_a_run_leaves_figures_series_and_numbers(tmp_path):
    """And says how long it will take, and what is out of range; a second run takes what is there."""
    file, out = tmp_path / "gouge.json", tmp_path / "out"
    file.write_text(small().text)
    done = stickslip("run", file, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "1 realizations, each of about" in done.stdout
    assert "warning: the thickness of the layer" in " ".join(done.stdout.split())
    names = {path.name for path in out.iterdir()}
    assert names >= {"fig1_steady_sliding.png", "fig2_velocity_steps.png", "fig3_holds.png", "series.csv", "results.h5"}
    header, *rows = (out / "series.csv").read_text().splitlines()
    assert header.startswith("realization [-],test [-],kind,before [m/s]")
    assert all(len(row.split(",")) == len(header.split(",")) for row in rows)
    found = archive.read(out / "results.h5")
    assert found["stiffness"]["grain"] == pytest.approx(4.3)
    tests = found["realizations"]["0000"]["tests"]
    assert [test["kind"] for test in tests][:3] == ["steady", "slide", "twin"]
    assert np.isfinite(found["realizations"]["0000"]["ledger"]["defect"]).all()
    fitted = stickslip("fit", out / "steps_0000_0.csv", "--law", "slip", "--stiffness", "1433")
    assert fitted.returncode == 0, fitted.stderr
    again = stickslip("run", file, "--out", out)
    assert "1 realizations were finished before and not run again" in " ".join(again.stdout.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", EXAMPLES / "disk_array.toml", "--engine", "lammps"], 'only "gouge" has a choice'),
        (["run", EXAMPLES / "gouge.toml", "--engine", "yade"], "use stickslip, lammps"),
    ],
)
def test_a_wrong_engine_is_refused(words, sentence, tmp_path):
    done = stickslip(*words, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_examples_are_scenarios_of_their_own_scale():
    assert read(EXAMPLES / "gouge.toml").steps < 2e6
    whole = read(EXAMPLES / "gouge_paper.toml")
    assert whole.dt == 2e-8
    assert whole.realizations == 8
    assert set(whole.protocol[1].before) == {2e-4, 2e-3, 2e-2, 0.1}  # Fig S1
    assert set(whole.protocol[2].after) == {0.05, 0.1, 0.3}  # Fig S2
    assert "days" in whole.words


@pytest.mark.slow
def test_the_papers_claims_are_all_judged(tmp_path, ran):
    """On samples far too small: nothing may be told to be reproduced that two of them cannot tell."""
    main, damped = ran
    claims = {c.id: c for c in gouge_claims.evaluated(main, damped)}
    assert set(claims) >= {
        "steady-friction", "direct-effect-sign", "velocity-step-symmetry", "hold-relaxation-law", "compaction-in-holds",
        "healing-rate", "peak-vs-velocity-ratio", "restitution-insensitivity", "inertial-number",
    }  # fmt: skip
    printed = {name for name, c in claims.items() if c.paper is not None}
    assert printed == {"direct-effect", "direct-effect-sign", "a-minus-b", "peak-vs-velocity-ratio",
                       "restitution-insensitivity"}  # fmt: skip
    assert {name for name, c in claims.items() if c.verdict != "no reference"} == printed
    assert all(c.source.partition(":")[0] in gouge_claims.SHOWS for c in claims.values())
    assert all("2 × 70 grains" in c.note for c in claims.values() if c.id not in ("inertial-number", "energy-balance"))
    folder = tmp_path / "out"
    report.claim_folder(folder, main.scenario)
    gouge_report.write_reproduction(folder, paper.Reproduction(main, damped, list(claims.values())))
    told = json.loads((folder / "claims.json").read_text())
    assert [c["id"] for c in told] == list(claims)
    assert "fault gouge" in (folder / "claims.md").read_text()
    assert (folder / "claims.png").stat().st_size > 10_000
