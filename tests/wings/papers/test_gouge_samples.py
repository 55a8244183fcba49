"""Samples of gouge as files: they are evaluated as the runs that wrote them, and others are refused."""

import numpy as np
import pytest

from stickslip.data import archive
from stickslip.data.archive import ArchiveError
from stickslip.wings.papers.gouge import paper
from stickslip.wings.papers.gouge import simulate as samples
from stickslip.wings.papers.gouge import simulate as simulation
from stickslip.wings.papers.gouge.simulate import read_sample, read_samples, sample_path, simulate_gouge
from tests.conftest import stickslip_here as stickslip
from tests.wings.papers.test_gouge import BRIEF, small


def short(**more):
    """A small sample with a short preparation and one step of the velocity."""
    steps = {"kind": "velocity-steps", "velocities": (0.3, 0.6), "slip": 0.05, "twin": 0.05}
    return small(**{"preparation": BRIEF, "protocol": [steps], "ledger_steps": 100} | more)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A folder with two samples, and the result of the runs that wrote them; their run folder is next to it."""
    folder = tmp_path_factory.mktemp("samples")
    return folder, simulate_gouge(short(realizations=2), folder=folder / "run", samples=folder, workers=1)


def test_a_sample_has_the_series_of_its_run(stored):
    folder, result = stored
    found = read_samples(folder, {"this": short()})["this"]
    assert list(found) == [0, 1]
    for sample, run in zip(found.values(), result.realizations, strict=True):
        assert [t[:4] for t in sample.realization.tests] == [t[:4] for t in run.tests]
        assert sample.realization.range == run.range
        assert sample.realization.ledger["defect"].tolist() == run.ledger["defect"].tolist()
        for a, b in zip(sample.realization.tests, run.tests, strict=True):
            for name in a.series._fields:
                rounded = 0 if name in ("time", "load_point") else 6e-8
                np.testing.assert_allclose(getattr(a.series, name), getattr(b.series, name), rtol=rounded, atol=1e-30)
        end = archive.read(folder / samples.STATES / sample.path.name)["end"]
        assert (end.grains.position == run.states["end"].grains.position).all()
        assert (end.contacts.slip == run.states["end"].contacts.slip).all()


def test_only_what_is_missing_runs(stored, tmp_path, monkeypatch):
    """And samples that finished in the run folder before they were asked for are written as well."""
    folder, _ = stored
    monkeypatch.setattr(simulation, "run_realizations", None)
    assert simulate_gouge(short(realizations=2), samples=folder).reused == 2
    with pytest.raises(TypeError):
        simulate_gouge(short(realizations=3), samples=folder, workers=1)
    simulate_gouge(short(seed=1), folder=folder / "run", samples=tmp_path)
    a, b = (read_sample(sample_path(place, short(seed=1)), short()).realization for place in (folder, tmp_path))
    assert a.tests[0].series.friction.tolist() == b.tests[0].series.friction.tolist()
    assert [path.name for path in tmp_path.glob("*.h5")] == [sample_path(folder, short(seed=1)).name]


def test_other_samples_are_refused(stored, tmp_path, monkeypatch):
    folder, _ = stored
    other = short(grains={"number": 75}, law={"damping_n": 1e4, "mu": 0.4})
    with pytest.raises(ArchiveError, match=r"another scenario \(grains.number = 70 instead of 75; law.mu = default"):
        read_samples(folder, {"other": other})
    archive.write(tmp_path / "results.h5", {"numbers": 1.0}, scenario=short().text)
    with pytest.raises(ArchiveError, match=r"results.h5 is not a sample of gouge"):
        read_samples(tmp_path, {"this": short()})
    (tmp_path / "results.h5").write_bytes(sample_path(folder, short()).read_bytes())
    (tmp_path / "twin.h5").write_bytes(sample_path(folder, short()).read_bytes())
    with pytest.raises(ArchiveError, match="are the same sample: remove one of them"):
        read_samples(tmp_path, {"this": short()})
    monkeypatch.setattr(samples, "PHYSICS", 0)
    with pytest.raises(ArchiveError, match="version 1 of the physics of gouge, and this is version 0"):
        read_samples(folder, {"this": short()})


def test_stored_samples_are_evaluated_and_added_to(tmp_path, monkeypatch, capsys):
    """The paper's size, reduced: first two samples of each damping run, then they are evaluated without a run."""
    whole = paper.paper_size_scenario
    protocol = [{"kind": "slide-hold-slide", "before": (0.3,), "holds": (2e-4,), "approach": 0.05, "slip": 0.05}]

    def scenario(*arguments, **more):
        chosen = whole(*arguments, **more)
        update = {"realizations": chosen.realizations, "seed": chosen.seed}
        tables = {"law": chosen.law.model_dump(), "protocol": protocol, "ledger_steps": 0}
        return short(**tables).model_copy(update=update)

    monkeypatch.setattr(paper, "paper_size_scenario", scenario)
    monkeypatch.setattr(paper, "evaluate_claims", lambda holds, rest: [holds[paper.MAIN].realizations, rest])
    kept = tmp_path / "kept"
    first = paper.reproduce(paper_size=True, samples=kept, realizations=1, workers=1)
    assert "1 sample (seeds 0), 1 computed now and added to" in " ".join(capsys.readouterr().out.split())
    assert len(list(kept.glob("*.h5"))) == 2
    monkeypatch.setattr(simulation, "run_realizations", None)
    second = paper.reproduce(paper_size=True, samples=kept)
    assert f"1 sample (seeds 0), 1 from {kept} (stickslip " in " ".join(capsys.readouterr().out.split())
    assert second.claims[1]["steps"] is second.main
    a, b = (np.concatenate([t.series.friction for t in r.claims[0][0].tests]) for r in (first, second))
    assert (a == b).all()


def test_an_empty_folder_is_refused(tmp_path):
    done = stickslip("reproduce", "gouge", "--paper-size", "--samples", tmp_path / "kept", "--out", tmp_path / "none")
    assert done.returncode == 2
    assert "has no samples with ε = 0.98, Eq 8: add --realizations N to compute N of them" in done.stderr
    assert not (tmp_path / "none").exists()


def test_a_folder_that_cannot_be_written_is_refused_before_the_run(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(simulation, "run_realizations", None)
    with pytest.raises(ValueError, match=r"cannot write to the folder .*file \(File exists\): choose another one"):
        simulate_gouge(short(), samples=tmp_path / "file")
