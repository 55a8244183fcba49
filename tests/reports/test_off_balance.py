"""Packings that are not at rest, at the command line, on pages and in movies: never a verdict, and what to do."""

import json
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.data import archive
from tests.conftest import stickslip_here as run
from tests.reports.test_reports import page, view_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "sheared_spheres.npz"
SENTENCE = "not in equilibrium (residual 5.3 % of the mean contact force): stability cannot be judged"
MEMORY = ("pair_i", "pair_j", "image", "slip")
LAW = ("law", "coulomb", "kn", "kt", "mu")


@pytest.fixture
def without(tmp_path):
    """Writes the example without some of its arrays."""

    def write(*names):
        arrays = {k: v for k, v in np.load(EXAMPLE).items() if k not in names}
        np.savez(tmp_path / "p.npz", **arrays)
        return tmp_path / "p.npz"

    return write


def words_of(text: str) -> str:
    return " ".join(text.split())


def test_a_report_starts_with_the_verdict(few_spheres, tmp_path):
    verdict = ss.stability(*ss.io.read_packing(few_spheres)[:2]).verdict
    assert verdict.startswith("oscillatory instability: 1 complex pair with period ")
    done = run("report", few_spheres, "--out", tmp_path / "r.html")
    assert words_of(done.stdout).startswith(verdict), done.stderr
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.index(f"O{verdict[1:]}.</p>") < text.index("<iframe")


def test_a_report_without_a_verdict_says_so_and_still_checks_the_balance(without, tmp_path):
    answer = json.loads(run("report", EXAMPLE, "--no-verdict", "--out", tmp_path / "r.html", "--json").stdout)
    assert (answer["verdict"], answer["notes"]) == (None, [])
    shown = page(tmp_path / "r.html")
    assert "the spectrum was not computed, so there is no verdict" in shown.words
    assert not view_of(shown)["modes"] and not any("Growing modes" in word for word in shown.words)
    done = run("report", without(*MEMORY), "--no-verdict", "--out", tmp_path / "r.html", "--json")
    assert SENTENCE in json.loads(done.stdout)["notes"]


def test_a_report_on_a_large_packing_says_how_to_get_a_verdict(few_spheres, tmp_path, monkeypatch):
    monkeypatch.setattr("stickslip.reports.page.SEARCHED", 100)
    answer = json.loads(run("report", few_spheres, "--out", tmp_path / "r.html", "--json").stdout)
    assert answer["verdict"] is None
    assert answer["notes"] == ["no verdict was computed, as it takes minutes for 18 grains: add --verdict."]
    assert "as it takes minutes for 18 grains" in " ".join(page(tmp_path / "r.html").words)
    answer = json.loads(run("report", few_spheres, "--verdict", "--out", tmp_path / "s.html", "--json").stdout)
    assert answer["verdict"].startswith("oscillatory")


def test_slips_left_out_end_with_a_code_of_their_own(without, tmp_path):
    done = run("stability", without(*MEMORY), cwd=tmp_path)
    text = words_of(done.stdout)
    assert done.returncode == 3 and SENTENCE in text
    assert "contacts were found from positions, without memory" in text
    assert "no slip: all 183 contacts are treated as never sheared" in text
    assert "--settle" in text and "no cell" not in text and "another law" not in text
    assert not list(tmp_path.glob("*modes*"))
    quiet = run("stability", tmp_path / "p.npz", "-q", cwd=tmp_path)
    assert (quiet.returncode, quiet.stdout.strip()) == (3, SENTENCE)


def test_json_has_the_likely_causes_off_equilibrium(without, tmp_path):
    done = run("stability", without(*MEMORY, "cell"), "--mu", "0.3", "--json", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    answer = json.loads(done.stdout)
    assert answer["balanced"] is False and answer["stable"] is None and answer["settled"] is None
    assert answer["residual"] > answer["tolerance"] == ss.measure.BALANCED_BELOW
    assert [cause.partition(" ")[0] + " " + cause.split()[1].rstrip(":") for cause in answer["causes"]] == [
        "no slip", "no cell", "another law",
    ]  # fmt: skip
    assert "--mu came from the command line" in answer["causes"][2]
    done = run("stability", without(*MEMORY, *LAW), "--json", cwd=tmp_path)
    assert "the defaults were used" in json.loads(done.stdout)["causes"][1]


def test_the_answer_after_settling_is_about_the_settled_packing(without, tmp_path):
    file = without(*MEMORY)
    done = run("stability", file, "--settle", cwd=tmp_path)
    text = words_of(done.stdout)
    assert done.returncode == 0 and "not in equilibrium" not in text
    assert "the verdict is for the SETTLED packing, not for the one in the file" in text
    assert "grains moved by up to 0.0018 of their radius (rms 0.00068), 0 contacts lost and 0 gained" in text
    assert "SETTLED" in run("stability", file, "--settle", "-q", cwd=tmp_path).stdout
    answer = json.loads(run("stability", file, "--settle", "--json", cwd=tmp_path).stdout)
    assert answer["balanced"] is True and "SETTLED" in answer["verdict"]
    calm = answer["settled"]
    assert set(calm) == {"moved", "moved_rms", "lost", "gained", "before", "how"}
    assert calm["moved"] == pytest.approx(0.0018, abs=5e-5) and calm["before"] == pytest.approx(0.053, abs=5e-4)
    # the slips do not come back: with them the same packing is unstable
    assert answer["stable"] is True
    assert json.loads(run("stability", EXAMPLE, "--json").stdout)["stable"] is False


def test_what_falls_apart_when_it_settles_has_no_answer(without, tmp_path):
    done = run("stability", without(*MEMORY, "cell"), "--settle", cwd=tmp_path)
    assert done.returncode == 1
    assert "fell apart" in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_modes_off_equilibrium_are_written_on_demand_only(few_spheres, tmp_path):
    arrays = dict(np.load(few_spheres))
    np.savez(tmp_path / "p.npz", **arrays | {"slip": 0.9 * arrays["slip"]})
    done = run("stability", "p.npz", "--modes", "m.npz", "--mu", "0.1", cwd=tmp_path)
    assert done.returncode == 3
    assert (tmp_path / "m.npz").exists()
    assert "another law than that of the packing: --mu came from the command line" in words_of(done.stdout)


def test_a_page_says_it_and_shows_no_mode(without, tmp_path):
    done = run("report", without(*MEMORY), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert SENTENCE in words_of(done.stdout)
    shown = page(tmp_path / "p-report.html")
    text = "".join(shown.words)
    assert SENTENCE in text and "N" + SENTENCE[1:] in text and "no slip: all 183 contacts" in text
    assert "stable" not in text.replace("stability", "") and "Growing modes" not in text
    assert view_of(shown)["modes"] == []
    assert 'class="warning"' in (tmp_path / "p-report.html").read_text()
    done = run("report", tmp_path / "p.npz", "--settle", cwd=tmp_path)
    assert done.returncode == 0 and "SETTLED" in done.stdout
    assert "SETTLED" in "".join(page(tmp_path / "p-report.html").words)


def test_a_mode_off_equilibrium_is_filmed_only_if_given_and_says_so(without, tmp_path, monkeypatch):
    file = without(*MEMORY)
    for arguments, said in (
        ([], SENTENCE),
        (["--settle"], "is stable or has no growing mode (the verdict is for the SETTLED"),
    ):
        done = run("movie", file, *arguments, cwd=tmp_path)
        assert done.returncode == 2 and said in done.stderr and not list(tmp_path.glob("*.gif"))
    assert run("stability", EXAMPLE, "--modes", tmp_path / "m.npz").returncode == 0
    labels = []

    def film(frames, path, **more):
        labels.extend(more["labels"])
        path.write_bytes(b"GIF89a")

    monkeypatch.setattr("stickslip.figures.animation.movie", film)
    done = run("movie", file, "--modes", tmp_path / "m.npz", "--frames", "2", cwd=tmp_path)
    assert SENTENCE in words_of(done.stdout)
    assert len(labels) == 2 and all(label.endswith("NOT IN EQUILIBRIUM") for label in labels)


def test_a_frame_of_a_run_that_is_not_at_rest_has_no_modes(few_spheres, tmp_path):
    (tmp_path / "run").mkdir()
    arrays = dict(np.load(few_spheres))
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
    names = ("position", "radius", "cell", *MEMORY)
    rest = ss.packings.from_arrays(**{name: arrays[name] for name in names}, law=law)
    moved = rest._replace(contacts=rest.contacts._replace(slip=0.5 * rest.contacts.slip))
    tree = {"law": law, "frames": {"0000": rest, "0001": moved._replace(time=1.0)}}
    archive.write(tmp_path / "run" / "results.h5", tree, scenario='{"experiment": "flow"}', version="9")
    for arguments, modes, warned in ((["--frame", "0001"], 0, True), (["--frame", "0000"], 1, False), ([], 1, False)):
        done = run("report", tmp_path / "run", *arguments)
        assert done.returncode == 0, done.stderr
        shown = page(tmp_path / "run" / "report.html")
        assert len(view_of(shown)["modes"]) == modes
        assert ("not in equilibrium" in "".join(shown.words)) is warned
    done = run("movie", tmp_path / "run", "--frame", "0001", "--mode", "0")
    assert done.returncode == 2 and "0001: not in equilibrium" in words_of(done.stderr)
    done = run("report", tmp_path / "run", "--settle")
    assert done.returncode == 2 and "applies to packing files only" in done.stderr
