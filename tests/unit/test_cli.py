"""The command line: wrong input is one sentence and exit code 2, nothing written; runs of one's own work."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from stickslip.cli import running
from stickslip.data import archive
from stickslip.data.checkpoint import checkpoint_in
from stickslip.experiments.registry import EXPERIMENTS
from tests.conftest import stickslip_here as stickslip

SHORT = """
[array]
disks = {disks}
{array}
[law]
{law}
[load]
push = [0.0, 0.02, 0.01]
step = 5e-3
{load}
[relaxation]
{relaxation}
[dynamics]
loads = [0.02]
duration = 2000.0
[sliding]
loads = [0.02]
realizations = 3
duration = 600.0
"""


def short(path, disks=4, array="", law="mu = 10.0", load="", relaxation=""):
    path.write_text(SHORT.format(disks=disks, array=array, law=law, load=load, relaxation=relaxation))
    return path


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["reproduce", "disk-aray"], "unknown experiment 'disk-aray': use disk-array"),
        (["reproduce", "disk-array", "--workers", "0"], "greater than or equal to 1"),
        (["reproduce", "disk-array", "--seed", "x"], "valid integer"),
        (["reproduce", "disk-array", "--fast"], "unknown option --fast: "),
        (
            ["stability", "p.npz", "--step", "3"],
            "unknown option --step: did you mean --frame? `stickslip stability --h",
        ),
        (["run", "absent.toml", "--out", "out"], "absent.toml cannot be read"),
        (["jump"], "unknown command 'jump': use reproduce, run"),
    ],
)
def test_unknown_commands_and_options_are_refused(arguments, sentence, tmp_path):
    run = stickslip(*arguments, cwd=tmp_path)
    assert run.returncode == 2
    assert sentence in run.stderr
    assert run.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"disks": 0}, "array.disks must be greater than or equal to 1, got 0"),
        ({"law": "mu = nan"}, "law.mu must be a finite number, got nan"),
        ({"load": "press = 0.0"}, "without contact"),
    ],
)
def test_wrong_scenarios(change, sentence, tmp_path):
    scenario = short(tmp_path / "s.toml", **change)
    run = stickslip("run", scenario, "--out", tmp_path / "out")
    assert run.returncode == 2
    assert sentence in run.stderr
    assert run.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.name != "posix", reason="permissions are those of POSIX")
def test_unwritable_folders(tmp_path):
    scenario = short(tmp_path / "s.toml")
    (tmp_path / "file").write_text("")
    run = stickslip("run", scenario, "--out", tmp_path / "file")
    assert run.returncode == 2
    assert "is a file, not a folder" in run.stderr
    run = stickslip("run", scenario, "--out", "/proc/stickslip")
    assert run.returncode == 2
    assert "cannot write to the folder" in run.stderr


@pytest.mark.parametrize(
    "change",
    [
        {},
        pytest.param(
            {"array": "radius = [0.5, 0.49, 0.51, 0.5]", "law": 'kind = "linear"\nmu = 2.0\ncoulomb = "sharp"'},
            marks=pytest.mark.slow,
        ),
        {"disks": 2, "relaxation": 'method = "newton"', "array": "gap = -0.001"},
    ],
    ids=["paper", "unlike-radii-linear", "two-newton"],
)
def test_a_scenario_of_the_user_runs(change, tmp_path):
    scenario = short(tmp_path / "s.toml", **change)
    run = stickslip("run", scenario, "--out", tmp_path / "out", "--workers", "1")
    assert run.returncode == 0, run.stderr
    assert "Free runs" in run.stdout
    numbers = archive.read(tmp_path / "out" / "results.h5")["main"]
    assert numbers["ramp"]["load"].tolist() == pytest.approx([0, 0.005, 0.01, 0.015, 0.02, 0.015, 0.01])
    assert numbers["ramp"]["residual"].max() <= 1e-14


@pytest.mark.parametrize("change", [{"law": "mu = 0.0"}, {"disks": 1}], ids=["frictionless", "rolls"])
def test_a_push_that_nothing_holds_ends_with_the_load_and_a_remedy(change, tmp_path):
    scenario = short(tmp_path / "s.toml", **change)
    run = stickslip("run", scenario, "--out", tmp_path / "out")
    assert run.returncode == 1
    assert "no equilibrium at push = 0.005" in run.stderr
    assert "stronger drag" in run.stderr
    assert not (tmp_path / "out" / "results.h5").exists()


def test_a_time_step_that_cannot_work_is_named(tmp_path):
    (tmp_path / "s.toml").write_text("[load]\npush = [0.0, 0.01]\nstep = 5e-3\n[dynamics]\ndt = 20.0\nloads = [0.01]\n")
    run = stickslip("run", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert run.returncode == 1
    assert "dynamics.dt = 20 is too long at push = 0.01" in run.stderr
    assert not (tmp_path / "out" / "results.h5").exists()


@pytest.mark.slow
def test_a_disk_whose_own_contact_is_first_at_the_limit_can_be_drawn(tmp_path):
    text = "\n".join([
        "[array]", "disks = 2", "[law.wall]", "mu = 1.0", "[load]", "push = [0.0, 0.06]", "step = 5e-3", "disk = 2",
        "[dynamics]", "loads = [0.06]", "duration = 20000.0",
    ])  # fmt: skip
    (tmp_path / "two.toml").write_text(text)
    run = stickslip("run", tmp_path / "two.toml", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_control_c_ends_with_a_sentence_and_130(tmp_path):
    code = "from stickslip.cli import main; main()"
    arguments = ["reproduce", "disk-array", "--out", str(tmp_path / "out")]
    run = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # shells ignore it in the background
    )  # fmt: skip
    assert any("ramps and free runs" in line for line in run.stdout)
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=60)
    assert run.returncode == 130
    assert "stickslip: stopped by the user" in said and said.endswith(
        ("run the command again\n", f"{tmp_path / 'out'}\n")
    )
    assert "Traceback" not in said
    assert not (tmp_path / "out" / "results.h5").exists()


@pytest.mark.parametrize(("saved", "by"), [(True, "SIGTERM"), (False, "the user")], ids=["saved", "nothing saved"])
def test_after_control_c_the_message_names_the_folder_if_something_was_saved(saved, by, tmp_path, monkeypatch):
    """`SIGTERM`, with which a job ends, is told by its name."""

    def stopped(scenario, *, folder, **more):
        if saved:
            checkpoint_in(folder, scenario).save("piece", {"value": 1.0})
        if by == "SIGTERM":
            signal.raise_signal(signal.SIGTERM)
            pytest.fail("the signal stops nothing")
        raise KeyboardInterrupt

    stopping = EXPERIMENTS["rate-state"]._replace(simulate=stopped)
    monkeypatch.setattr("stickslip.wings.faults.rate_state.EXPERIMENT", stopping)
    (tmp_path / "s.toml").write_text('experiment = "rate-state"\nsamples.number = 10\n')
    run = stickslip("run", "s.toml", "--out", "out", cwd=tmp_path)
    ending = "continue with stickslip resume out" if saved else "run the command again"
    assert run.returncode == 130
    assert run.stderr.startswith(f"stickslip: stopped by {by}") and run.stderr.endswith(f"{ending}\n")
    monkeypatch.undo()
    again = ("resume", "out") if saved else ("run", "s.toml", "--out", "out")
    assert stickslip(*again, cwd=tmp_path).returncode == 0


@pytest.mark.slow
def test_the_number_of_workers_does_not_change_the_numbers(tmp_path):
    scenario = short(tmp_path / "s.toml")
    results = []
    for workers in (1, 2):
        out = tmp_path / str(workers)
        assert stickslip("run", scenario, "--out", out, "--workers", workers).returncode == 0
        results.append(archive.read(out / "results.h5")["main"]["sliding"]["0.020000"])
    for name in ("breach", "slide", "velocity", "center"):
        assert np.array_equal(results[0][name], results[1][name], equal_nan=True), name


@pytest.mark.parametrize(
    ("words", "folder"),
    [
        (["gouge", "--quick"], "gouge-quick"), (["gouge"], "gouge"), (["gouge", "--paper-size"], "gouge-paper-size"),
        (["gouge", "--quick", "--out", "here"], "../here"),
    ],
)  # fmt: skip
def test_reproductions_of_other_sizes_have_folders_of_their_own(words, folder, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(running, "_reproduce_in", lambda command, folder, *given, **more: seen.append(folder))
    done = stickslip("reproduce", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / folder).resolve() == (tmp_path / seen[0]).resolve()
