"""The command line of fault gouge: a whole run, wrong input, and what is left in the folder."""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from stickslip.data import archive
from stickslip.experiments.registry import read_scenario, scenario
from stickslip.runs import folder as report
from stickslip.runs.folder import write_reproduction
from stickslip.wings.papers.gouge import EXPERIMENT, paper
from stickslip.wings.papers.gouge import claims as gouge_claims
from stickslip.wings.papers.gouge import report as gouge_report
from stickslip.wings.papers.gouge.simulate import simulate_gouge
from tests.conftest import save_noise
from tests.conftest import stickslip_here as stickslip
from tests.wings.papers.test_gouge import small

EXAMPLES = Path(__file__).parents[3] / "examples"


def reduced(chosen):
    """A small version of a scenario of the paper: two tiny samples, short holds and slips, higher velocities."""
    protocol = [part.model_dump() for part in chosen.protocol]
    for part in protocol:
        part["slip"] = 0.2
        if "holds" in part:
            part |= {"holds": (1e-4, 4e-4), "approach": 0.1, "branches": 2, "spacing": 0.1}
        for name in ("before", "after", "velocities"):
            if part.get(name):
                part[name] = tuple(10 * v for v in part[name])
        if part["kind"] == "slide":
            part["velocity"] *= 10
    tables = small().model_dump() | {
        "protocol": protocol,
        "realizations": 2,
        "ledger_steps": chosen.ledger_steps and 100,
    }
    return scenario(**tables | {"law": chosen.law.model_dump(), "load": chosen.load.model_dump()})


@pytest.fixture(scope="module")
def ran():
    """All that a full reproduction runs, small."""
    holds = {name: simulate_gouge(reduced(paper.paper_scenario(damping=name)), workers=2) for name in paper.DAMPINGS}
    more = {name: simulate_gouge(reduced(one), workers=2) for name, one in paper.full_scenarios().items()}
    return holds, more


@pytest.mark.timeout(300)  # another process compiles
# 6 s: a sample with all kinds of tests, and figures that are drawn
def test_a_run_leaves_figures_series_and_numbers(tmp_path, monkeypatch):
    """And says how long it will take, and what is out of range; a second run takes what is there."""
    file, out = tmp_path / "gouge.json", tmp_path / "out"
    file.write_text(small().text)
    done = stickslip("run", file, "--out", out, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert "1 realisations, each of about" in done.stdout
    assert "warning: the thickness of the layer" in " ".join(done.stdout.split())
    names = {path.name for path in out.iterdir()}
    assert names >= {"fig1_steady_sliding.png", "fig2_velocity_steps.png", "fig3_holds.png", "series.csv", "results.h5"}
    header, *rows = (out / "series.csv").read_text().splitlines()
    assert header.startswith("realization [-],test [-],part [-],branch [-],kind,before [m/s]")
    assert all(len(row.split(",")) == len(header.split(",")) for row in rows)
    found = archive.read(out / "results.h5")
    assert found["stiffness"]["grain"] == pytest.approx(4.3)
    tests = found["realizations"]["0000"]["tests"]
    assert [test["kind"] for test in tests][:3] == ["steady", "slide", "slide"]
    assert np.isfinite(found["realizations"]["0000"]["ledger"]["defect"]).all()
    fitted = stickslip("fit", out / "steps_0000_0.csv", "--law", "slip", "--stiffness", "1433")
    assert fitted.returncode == 0, fitted.stderr
    monkeypatch.setattr(Figure, "savefig", save_noise)
    again = stickslip("run", file, "--out", out)
    assert "1 realisations had finished earlier and were not run again" in " ".join(again.stdout.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["run", EXAMPLES / "disk_array.toml", "--engine", "lammps"],
            "applies to the experiments 'gouge', 'flow' and 'element-test' only",
        ),
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
    assert read_scenario(EXAMPLES / "gouge.toml").steps < 2e6
    whole = read_scenario(EXAMPLES / "gouge_paper.toml")
    assert whole.dt == 2e-8
    assert whole.realizations == 8
    assert set(whole.protocol[1].before) == {2e-4, 2e-3, 2e-2, 0.1}  # Fig S1
    assert set(whole.protocol[2].after) == {0.05, 0.1, 0.3}  # Fig S2
    assert "days" in whole.expected_cost
    assert (whole.law.reading, whole.law.restitution) == ("eq8", 0.98)


STEPS = {"a", "b", "a-minus-b", "dc"}
PEAKS = {"peak-vs-velocity-ratio", "peak-at-equal-velocities", "collapse-of-peaks", "slope-below-b"}
UNMEASURED = {"time-step", "damping-ratio"}  # from a closed form, or not run
PRINTED = STEPS | PEAKS | UNMEASURED | {"restitution-insensitivity", "restitution-of-collisions"}


@pytest.mark.slow
@pytest.mark.parametrize("full", [False, True])
def test_the_papers_claims_are_all_judged(tmp_path, ran, full):
    """On samples far too small: nothing may be told to be reproduced that two of them cannot tell."""
    holds, more = ran[0], ran[1] if full else {}
    claims = {c.id: c for c in gouge_claims.evaluate_claims(holds, more)}
    assert set(claims) == PRINTED | {
        "hold-relaxation-per-e-fold", "hold-relaxation-at-end", "compaction-in-holds", "healing-rate",
        "velocity-step-symmetry", "calibrated-damping", "steady-friction", "granular-temperature", "quasi-static",
        "energy-balance", "definition-of-hold-time", "slip-law-in-holds", "bands-of-holds",
        *(["peak-at-equal-velocities@frozen"] if full else []),
    }  # fmt: skip
    printed = PRINTED | {"peak-at-equal-velocities@frozen"} & set(claims)
    assert {name for name, c in claims.items() if c.paper is not None} == printed
    assert {name for name, c in claims.items() if c.verdict != "no reference"} == printed
    assert all(c.source.partition(":")[0] in gouge_claims.SHOWS for c in claims.values())
    missing = {name for name, c in claims.items() if "--full" in c.note}
    assert missing == (set() if full else STEPS | PEAKS | {"velocity-step-symmetry"})
    assert all(claims[name].verdict == "undecided" for name in missing & PRINTED)
    folder, main = tmp_path / "out", holds[paper.MAIN]
    report.prepare_folder(folder, main.scenario)
    write_reproduction(folder, EXPERIMENT, paper.Reproduction(holds, more, list(claims.values())))
    told = json.loads((folder / "claims.json").read_text())
    assert [c["id"] for c in told] == list(claims)
    assert "fault gouge" in (folder / "claims.md").read_text()
    assert (folder / "claims.png").stat().st_size > 10_000
    names = {path.name for path in folder.iterdir()}
    assert names >= {"fig3_holds.png", "fig4_rest.png", "fig5_reslides.png", "fig6_healing.png", "curves.csv"}
    assert ("fig2_velocity_steps.png" in names) == full
    header, *rows = (folder / "curves.csv").read_text().splitlines()
    assert all(row.count(",") == header.count(",") for row in rows)
    assert {row.split(",")[0] for row in rows} == {n.replace(",", ";") for n in (*holds, *more)} - {"velocities"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["reproduce", "gouge", "--quick", "--full"], "--full and --quick exclude each other: give only one"),
        (["reproduce", "disk-array", "--full"], "disk-array has no --full: leave it out"),
        (["reproduce", "disk-array", "--paper-size"], "disk-array has no --paper-size: leave it out"),
        (["reproduce", "gouge", "--full", "--paper-size"], "--paper-size and --full exclude each other: give only one"),
        (
            ["reproduce", "gouge", "--realizations", "2"],
            "--realizations requires --paper-size, the only run with samples",
        ),
        (["reproduce", "sphere-shear", "--device", "cuda"], "single runs of 'disk-array' and 'gouge' only"),
        (["reproduce", "gouge", "--device", "rocm"], "rocm"),
        pytest.param(
            ["reproduce", "disk-array", "--device", "cuda"],
            "cupy is not installed",
            marks=pytest.mark.skipif(find_spec("cupy") is not None, reason="CuPy is installed"),
        ),
    ],
)
def test_options_of_what_has_none_are_refused(words, sentence, tmp_path):
    done = stickslip(*words, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_long_hold_is_told_before_it_starts(capsys):
    """Its steps, and how long they take, where it is more than a tenth of a realization."""
    gouge_report.announce(paper.paper_scenario())
    words = " ".join(capsys.readouterr().out.split())
    assert "Each hold of 1 s takes 2.5e+06 of these steps, about 2.6 minutes on one core" in words
