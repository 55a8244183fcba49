"""Runs replace and remove their own files only, and old results go when new ones are complete."""

import hashlib
import json
import os
import shutil
import sys
from types import SimpleNamespace

import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.data import run_files
from stickslip.data.checkpoint import checkpoint_in
from stickslip.data.run_files import unfinished_scenario
from stickslip.ensemble import pool
from stickslip.experiments.registry import is_run_file, list_files
from stickslip.runs import folder as report
from stickslip.runs.folder import find_unfinished
from stickslip.runs.sweep import run as sweep_run
from stickslip.runs.sweep.run import SweepResult
from stickslip.wings.faults.rate_state import simulate as slider
from tests.conftest import stickslip_here, without_drawing

SLIDER = """
experiment = "rate-state"
seed = {seed}
[surface]
a = 0.0247
b = 0.0178
dc = 5.3e-3
mu0 = 0.4
v0 = 0.02
[spring]
stiffness = 200.0
[[legs]]
velocity = 0.02
distance = 0.02
[samples]
number = 50
"""
SWEEP = SLIDER.format(seed=0) + '[sweep]\n"surface.a" = [0.02, 0.03]\n'
NAMES = ("series.csv", "claims.json", "report.html", "movie.gif", "fig1_mine.png", "steps_1_2.csv", "results.h5")


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """The command line in a folder with two scenarios: called with words, it returns exit code and what was said."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pool, "default_workers", lambda: 1)  # members of sweeps run in this process
    for seed in (0, 1):
        (tmp_path / f"{seed}.toml").write_text(SLIDER.format(seed=seed))
    (tmp_path / "many.toml").write_text(SWEEP)

    def called(*arguments):
        monkeypatch.setattr(sys, "argv", ["stickslip", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
        said = capsys.readouterr()
        return SimpleNamespace(code=caught.value.code, out=" ".join(said.out.split()), err=said.err)

    return called


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folder with a run and a sweep that have ended, for copies."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "0.toml").write_text(SLIDER.format(seed=0))
    (folder / "many.toml").write_text(SWEEP)
    with without_drawing():
        for scenario, out in (("0.toml", "out"), ("many.toml", "many")):
            assert stickslip_here("run", scenario, "--out", out, "--workers", "1", cwd=folder).returncode == 0
    return folder


@pytest.fixture
def ran(runs, tmp_path):
    """Function that puts a copy of the run `out` or of the sweep `many` into the folder of the test."""
    return lambda name: shutil.copytree(runs / name, tmp_path / name)


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "arguments", [["run", "0.toml"], ["reproduce", "quasi-rigid", "--quick"]], ids=["run", "paper"]
)
def test_foreign_files_stay(call, tmp_path, name, arguments):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    done = call(*arguments, "--out", "out")
    assert done.code == 2
    assert done.err.count("\n") == 1
    assert f"have changed since ({name}): choose another --out, or add --overwrite" in done.err
    assert contents(tmp_path / "out") == {name: b"mine"}


def test_a_folder_without_any_trace_of_a_run_is_left_alone_and_hidden_files_do_not_count(call, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("mine")
    assert "(thesis.tex)" in call("run", "0.toml", "--out", "out").err
    assert "(thesis.tex)" in call("run", "many.toml", "--out", "out").err
    (tmp_path / "out" / "thesis.tex").rename(tmp_path / "out" / ".thesis")
    assert call("run", "0.toml", "--out", "out").code == 0
    (tmp_path / "out" / "notes.txt").write_text("mine")  # beside results that are proven, names of runs count only
    assert call("run", "0.toml", "--out", "out").code == 0
    assert {".thesis", "notes.txt"} < set(contents(tmp_path / "out"))


def test_overwrite_names_what_goes_and_leaves_the_rest(call, tmp_path):
    (tmp_path / "out").mkdir()
    for name in ("series.csv", "claims.json", "thesis.tex"):
        (tmp_path / "out" / name).write_text("mine")
    done = call("run", "0.toml", "--out", "out", "--overwrite")
    assert done.code == 0
    assert "--overwrite: claims.json, series.csv in out will be replaced or removed" in done.out
    now = contents(tmp_path / "out")
    assert "claims.json" not in now
    assert now["series.csv"] != b"mine"
    assert now["thesis.tex"] == b"mine"


def test_results_that_were_changed_are_somebodys(call, ran, tmp_path):
    ran("out")
    told = json.loads((tmp_path / "out" / "manifest.json").read_text())["files"]
    assert set(told) == set(contents(tmp_path / "out")) - {"manifest.json"}
    with open(tmp_path / "out" / "series.csv", "a") as file:
        file.write("1,2,3\n")
    before = contents(tmp_path / "out")
    done = call("run", "0.toml", "--out", "out")
    assert (done.code, "(series.csv)" in done.err) == (2, True)
    assert contents(tmp_path / "out") == before
    (tmp_path / "out" / "manifest.json").write_text("[]")  # and without a manifest nothing is proven
    assert "(fig1" in call("run", "0.toml", "--out", "out").err


def test_what_appears_while_a_run_goes_on_is_not_replaced(call, tmp_path, monkeypatch):
    simulate = slider.simulate_slider

    def slowly(chosen, *, folder, **more):
        (folder / "series.csv").write_text("mine")
        return simulate(chosen, folder=folder, **more)

    monkeypatch.setattr(slider, "simulate_slider", slowly)
    done = call("run", "0.toml", "--out", "out")
    assert done.code == 1
    assert "files that another program wrote during the run (series.csv): move them away" in done.err
    assert (tmp_path / "out" / "series.csv").read_text() == "mine"
    assert not (tmp_path / "out" / "results.h5").exists()


@pytest.mark.parametrize("step", ["simulate_slider", "save"])
def test_overwriting_keeps_the_old_results_until_the_new_ones_are_complete(call, ran, tmp_path, monkeypatch, step):
    """The run stops while it computes, or while the new files are written: the old ones stand as they were."""
    ran("out")
    before = contents(tmp_path / "out")

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as now:
        now.setattr(slider if step == "simulate_slider" else report, step, stopped)
        assert call("run", "1.toml", "--out", "out", "--overwrite").code == 130
    after = contents(tmp_path / "out")
    assert {name: after[name] for name in before} == before
    assert call("run", "0.toml", "--out", "out").code == 2  # an unfinished run of another scenario is there
    assert call("resume", "out").code == 0
    assert json.loads((tmp_path / "out" / "scenario.json").read_text())["seed"] == 1
    assert not (tmp_path / "out" / "unfinished").exists()


def test_an_unfinished_run_is_overwritten_by_another_scenario(call, tmp_path, monkeypatch):
    """What the stopped run had left beside its checkpoint is no file of another program when the new run ends."""

    def stopped(scenario, *, folder, **_):
        checkpoint_in(folder, scenario).save("piece", {"a": 1.0})
        raise KeyboardInterrupt

    with monkeypatch.context() as now:
        now.setattr(slider, "simulate_slider", stopped)
        assert call("run", "0.toml", "--out", "out").code == 130
    assert "scenario.json" in contents(tmp_path / "out")
    done = call("run", "1.toml", "--out", "out", "--overwrite")
    assert done.code == 0, done.err
    assert json.loads((tmp_path / "out" / "scenario.json").read_text())["seed"] == 1


def test_who_is_killed_while_results_are_moved_in_is_followed_by_the_next_call(call, ran, tmp_path, monkeypatch):
    ran("out")
    settle = report.install_results

    def killed(folder):
        """Some files are in their places, others are not."""
        room = folder / report.WRITING
        if run_files.read_manifest(room):
            run_files.write_manifest(
                folder, {n: d + run_files.read_manifest(room)[n] for n, d in run_files.read_manifest(folder).items()}
            )
            (room / "series.csv").replace(folder / "series.csv")
            raise KeyboardInterrupt

    with monkeypatch.context() as now:
        now.setattr(report, "install_results", killed)
        assert call("run", "1.toml", "--out", "out", "--overwrite").code == 130
    assert report.install_results is settle
    assert call("resume", "out").code == 0
    now, told = contents(tmp_path / "out"), run_files.read_manifest(tmp_path / "out")
    assert set(now) == {*told, "manifest.json"}
    assert all(told[name] == [run_files.digest(tmp_path / "out" / name)] for name in told)
    assert json.loads(now["scenario.json"])["seed"] == 1


@pytest.mark.parametrize("missing", ["scenario.json", "results.h5"])
def test_incomplete_results_replace_nothing(ran, tmp_path, missing):
    ran("out")
    before, staging = contents(tmp_path / "out"), tmp_path / "out" / report.WRITING
    staging.mkdir()
    there = run_files.read_manifest(tmp_path / "out")
    kept = [name for name in ("scenario.json", "results.h5") if name != missing]
    for name in kept:
        shutil.copy(tmp_path / "out" / name, staging / name)
    run_files.write_manifest(staging, {name: there[name] for name in kept})
    report.install_results(tmp_path / "out")
    assert (staging / kept[0]).exists()
    shutil.rmtree(staging)
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize("seeds", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)])
@pytest.mark.parametrize("older", [False, True])
def test_the_scenario_of_a_run_of_several_is_its_first(tmp_path, seeds, older):
    """Papers run several scenarios in one folder, whose digests are in any order; `resume` goes on with the first."""
    ones = [ss.scenario(experiment="rate-state", seed=seed) for seed in seeds]
    for chosen in ones:
        kept = checkpoint_in(tmp_path, chosen)
        kept.of("some").save("piece", 1.0)
        assert kept.if_visible() is not None
    if older:  # version 0.1
        for path in (tmp_path / "unfinished").glob("part-*.json"):
            path.rename(path.with_name(path.name.replace("part-", "scenario-")))
    assert unfinished_scenario(tmp_path).read_text() == ones[0].text
    assert run_files.find_foreign(tmp_path, is_run_file) == []
    report.prepare_folder(tmp_path, ones[0])
    with report.staged_results(tmp_path) as room:
        report.save(room, ones[0], {})
    assert find_unfinished(tmp_path) is None


def test_a_file_under_a_name_that_runs_do_not_have_is_an_error(tmp_path):
    unknown = pytest.raises(RuntimeError, match=r"files named odd\.csv are not run files")
    with unknown, report.staged_results(tmp_path) as room:
        report.save(room, ss.scenario(experiment="rate-state"), {})
        (room / "odd.csv").write_text("1")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_sweeps_prove_their_files_too(call, tmp_path):
    (tmp_path / "out" / "members").mkdir(parents=True)
    (tmp_path / "out" / "members" / "mine").write_text("mine")
    assert "(members)" in call("run", "many.toml", "--out", "out").err
    assert contents(tmp_path / "out") == {"members/mine": b"mine"}
    assert call("run", "many.toml", "--out", "many").code == 0
    assert call("run", "many.toml", "--out", "many").code == 0
    (tmp_path / "many" / "sweep.nc").write_text("mine")
    assert "(sweep.nc)" in call("run", "many.toml", "--out", "many").err
    assert "contains the results of a sweep" in call("run", "0.toml", "--out", "many", "--overwrite").err
    assert call("run", "0.toml", "--out", "one").code == 0
    assert "contains the results of a run" in call("run", "many.toml", "--out", "one", "--overwrite").err


SLOW_MOMENTS = [pytest.param(when, marks=pytest.mark.slow) for when in ("settling", "failing")]


@pytest.mark.parametrize("when", ["members", *SLOW_MOMENTS])
def test_a_sweep_stands_until_the_one_that_overwrites_it_has_ended(call, ran, tmp_path, monkeypatch, when):
    """A kill while members run, or while the new sweep takes the old one's place, or members that all fail."""
    other = (tmp_path / "many.toml").read_text().replace("stiffness = 200.0", "stiffness = 210.0")
    (tmp_path / "other.toml").write_text(other)
    ran("many")
    before, arguments = contents(tmp_path / "many"), ("run", "other.toml", "--out", "many", "--overwrite")

    def stopped(*_, **__):
        raise KeyboardInterrupt

    def failed(chosen, folder, **_):
        return SweepResult(chosen, ["a", "b"], [None, None], ["no", "no"], 0)

    place, stop = {
        "members": ("run_sweep", stopped), "settling": ("write_manifest", stopped), "failing": ("run_sweep", failed)
    }[when]  # fmt: skip
    with monkeypatch.context() as now:
        now.setattr(sweep_run, place, stop)
        done = call(*arguments)
        assert done.code == (1 if when == "failing" else 130)
    after = contents(tmp_path / "many")
    assert {name: after[name] for name in before} == before
    assert (when == "failing") == ("every member failed (no)" in done.err)
    assert call(*arguments).code == 0
    final = contents(tmp_path / "many")
    assert not set(final) & (set(before) - {"sweep.json", "sweep.nc", "sweep-options.json", "manifest.json"})
    assert not (tmp_path / "many" / ".anew").exists()
    assert call("run", "other.toml", "--out", "many").code == 0
    assert contents(tmp_path / "many").keys() == final.keys()


def test_pages_belong_to_the_run_in_whose_folder_they_are(call, ran, tmp_path):
    ran("out")
    assert call("report", "out").code == 0
    assert call("report", "out").code == 0
    assert call("run", "0.toml", "--out", "out").code == 0  # the page was proven, and is out of date now
    assert not (tmp_path / "out" / "report.html").exists()
    (tmp_path / "out" / "report.html").write_text("mine")
    assert "was not written by stickslip" in call("report", "out").err
    assert (tmp_path / "out" / "report.html").read_text() == "mine"


def test_fits_prove_their_files_too(call, ran, tmp_path):
    ran("out")
    (tmp_path / "fit").mkdir()
    (tmp_path / "fit" / "fit.json").write_text("mine")
    arguments = ("fit", "out/series.csv", "--stiffness", "200", "--out", "fit")
    assert "(fit.json)" in call(*arguments).err
    assert (tmp_path / "fit" / "fit.json").read_text() == "mine"


def test_names_with_brackets_are_shown_as_they_are(call, tmp_path):
    done = call("run", "0.toml", "--out", "o[red]")
    assert "o[red]/results.h5" in done.out
    (tmp_path / "p[bold]").mkdir()
    (tmp_path / "p[bold]" / "claims.json").write_text("mine")
    assert "p[bold] contains" in call("run", "0.toml", "--out", "p[bold]").err
    assert "claims.json in p[bold] will be" in call("run", "0.toml", "--out", "p[bold]", "--overwrite").out


def test_what_others_have_is_left_where_only_other_names_are_there(call, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert "(notes.txt)" in call("run", "0.toml", "--out", "out").err
    assert call("run", "0.toml", "--out", "out", "--overwrite").code == 0
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "out" / "results.h5").exists()


def test_a_folder_by_the_name_of_a_result_is_reported_before_anything_is_computed(call, tmp_path):
    (tmp_path / "out" / "series.csv").mkdir(parents=True)
    (tmp_path / "out" / "series.csv" / "mine").write_text("mine")
    done = call("run", "0.toml", "--out", "out", "--overwrite")
    assert done.code == 2
    assert "series.csv is a folder, but runs write a file of this name: move it away" in done.err
    assert list(contents(tmp_path / "out")) == ["series.csv/mine"]


@pytest.mark.parametrize("name", [".lock", ".lock.json"])
@pytest.mark.parametrize("kind", ["file", "link", "pipe"])
def test_what_bears_the_names_of_the_lock_stays(call, tmp_path, name, kind):
    (tmp_path / "out").mkdir()
    path, target = tmp_path / "out" / name, tmp_path / "precious"
    target.write_text("mine")
    {"file": lambda: path.write_text("mine"), "link": lambda: path.symlink_to(target), "pipe": lambda: os.mkfifo(path)}[
        kind
    ]()
    done = call("run", "0.toml", "--out", "out")
    assert done.code == 2
    assert f"contains {name}, which stickslip did not write: move it away" in done.err
    assert target.read_text() == "mine"
    assert list((tmp_path / "out").iterdir()) == [path]


@pytest.mark.parametrize("named", [{"../victim": None}, {"thesis.tex": None}, {"fig1_mine.png": None}, {}, None])
@pytest.mark.parametrize("arguments", [["resume", "out"], ["run", "0.toml", "--out", "out"]], ids=["resume", "run"])
def test_a_foreign_manifest_moves_and_removes_nothing(call, ran, tmp_path, named, arguments):
    """Names that no run writes, results that are not there, and digests of nothing."""
    ran("out")
    (tmp_path / "victim").write_text("precious")
    staging = tmp_path / "out" / ".writing"
    staging.mkdir()
    for name in named or ():
        (staging.parent / name).write_text("evil") if name.startswith("..") else (staging / name).write_text("evil")
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "out" / "victim").write_text("evil")
    whole = {"results.h5": "neither", "scenario.json": "neither"} if named is None else named
    files = {name: [made or "0", hashlib.sha256(b"evil").hexdigest()] for name, made in whole.items()}
    (staging / "manifest.json").write_text(json.dumps({"files": files}))
    before = contents(tmp_path)
    call(*arguments)
    after = contents(tmp_path)
    assert after["victim"] == b"precious"
    kept = {name for name in before if ".writing" not in name and name != "out/manifest.json"}
    assert kept <= set(after) and all(after[name] == before[name] for name in kept if arguments[0] == "resume")


@pytest.mark.parametrize("name", ["members", "lammps", "members/one", "lammps/leg-01"])
def test_no_run_writes_through_a_link(call, tmp_path, name):
    (tmp_path / "outside").mkdir()
    (tmp_path / "out" / name).parent.mkdir(parents=True)
    (tmp_path / "out" / name).symlink_to(tmp_path / "outside")
    for scenario in ("0.toml", "many.toml"):
        done = call("run", scenario, "--out", "out", "--overwrite", "--yes")
        assert done.code == 2 and "is a link that leads outside the run folder" in done.err
    assert not any((tmp_path / "outside").iterdir())


@pytest.mark.parametrize(
    "arguments",
    [{"experiment": "../x"}, {"experiment": "gouge", "quick": 1, "seed": 0}, {"folder": "/"}, [], {"seed": [0]}],
)
def test_arguments_that_no_run_saved_are_refused(call, tmp_path, arguments):
    (tmp_path / "out" / "unfinished").mkdir(parents=True)
    (tmp_path / "out" / "unfinished" / "scenario-0123.json").write_text(ss.scenario().text)
    (tmp_path / "out" / "unfinished" / "reproduce.json").write_text(json.dumps(arguments))
    done = call("resume", "out")
    assert done.code == 2 and done.err.count("\n") == 1 and "reproduce.json is damaged" in done.err


def test_a_sweep_that_seems_to_wait_for_its_place_moves_nothing_of_others(call, tmp_path):
    """Before anything is installed: whose files are there, and is the new sweep in this folder at all?"""
    away = tmp_path / "away"
    (away / "members").mkdir(parents=True)
    (away / "members" / "mine").write_text("mine")
    (away / "ready").touch()
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / ".anew").symlink_to(away)
    (tmp_path / "both" / ".anew" / "members").mkdir(parents=True)
    (tmp_path / "both" / ".anew" / "ready").touch()
    (tmp_path / "both" / "members").mkdir()
    (tmp_path / "both" / "members" / "mine").write_text("mine")
    for name in ("linked", "both"):
        assert call("run", "many.toml", "--out", name).code == 2
    assert (away / "members" / "mine").read_text() == "mine"
    assert contents(tmp_path / "both") == {"members/mine": b"mine", ".anew/ready": b""}


def test_results_that_wait_for_their_place_replace_nothing_of_others(call, ran, tmp_path):
    ran("out")
    waiting = tmp_path / "out" / ".writing"
    waiting.mkdir()
    for path in list_files(tmp_path / "out"):
        (waiting / path.name).write_bytes(path.read_bytes())
    (waiting / "manifest.json").write_bytes((tmp_path / "out" / "manifest.json").read_bytes())
    (tmp_path / "out" / "series.csv").write_text("mine")
    (tmp_path / "out" / "events.csv").write_text("mine")
    for arguments in (("run", "1.toml", "--out", "out"), ("resume", "out")):
        call(*arguments)
        assert (tmp_path / "out" / "series.csv").read_text() == (tmp_path / "out" / "events.csv").read_text() == "mine"


@pytest.mark.parametrize("inner", ["members/{}/.writing/mine.txt", "members/{}/unfinished/mine.txt"])
def test_files_of_others_in_the_temporary_folders_of_members_are_kept(call, ran, tmp_path, inner):
    ran("many")
    member = next((tmp_path / "many" / "members").iterdir())
    (member / "measures.json").unlink()
    mine = tmp_path / "many" / inner.format(member.name)
    mine.parent.mkdir()
    mine.write_text("mine")
    done = call("run", "many.toml", "--out", "many")
    assert done.code == 2
    assert "mine.txt" in done.err
    assert mine.read_text() == "mine"


def test_folders_named_like_results_are_kept(call, tmp_path):
    inner = tmp_path / "out" / ".writing" / "series.csv"
    inner.mkdir(parents=True)
    (inner / "mine").write_text("mine")
    assert call("run", "0.toml", "--out", "out").code == 2
    assert (inner / "mine").read_text() == "mine"


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes")
def test_pipes_in_the_place_of_results_are_not_read(call, tmp_path):
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / "scenario.json")
    (tmp_path / "out" / "manifest.json").write_text('{"files": {"scenario.json": ["neither"]}}')
    assert call("run", "0.toml", "--out", "out").code == 2
    with pytest.raises(ValueError, match="does not contain a sweep"):
        ss.io.open_sweep(tmp_path / "out" / "scenario.json")


@pytest.mark.parametrize("measures", ["[1]", '{"a": 5}', '{"a": ["x", "y"]}'])
def test_members_with_damaged_measures_are_run_again(call, ran, tmp_path, measures):
    ran("many")
    path = next((tmp_path / "many" / "members").iterdir()) / "measures.json"
    before = json.loads(path.read_text())
    path.write_text(f'{{"stickslip": "{ss.__version__}", "seconds": 1, "measures": {measures}}}')
    assert call("run", "many.toml", "--out", "many").code == 0
    assert json.loads(path.read_text())["measures"] == before["measures"]
