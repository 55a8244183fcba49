"""`stickslip run` of a sweep, as a user sees it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stickslip.runs.sweep.dataset import open_sweep
from tests.conftest import stickslip_process
from tests.ensemble.test_ensemble import until

pytestmark = pytest.mark.slow  # processes of their own, each a second or two to begin
ROOT = Path(__file__).parents[2]
SLIDERS = """
experiment = "rate-state"
[samples]
number = 12
[sweep]
"surface.mu0" = {values}
seed = {{count = {seeds}}}
"""
DISKS = """
[array]
disks = 10
[load]
push = [0.0, 0.02]
step = 1e-3
[dynamics]
loads = [0.02]
duration = 60000.0
[sweep]
"law.mu" = [{mu}5.0, 6.0, 7.0, 8.0]
"""


def sliders(path, values="[0.3, 0.5]", seeds=2):
    path.write_text(SLIDERS.format(values=values, seeds=seeds))
    return path


@pytest.mark.slow
def test_a_sweep_says_what_it_is_and_where_everything_is(tmp_path):
    run = stickslip_process("run", sliders(tmp_path / "s.toml"), "--out", tmp_path / "out", "--workers", "2")
    assert run.returncode == 0, run.stderr
    assert "Sweep: 4 members, mu0 (2) × seed (2)." in run.stdout
    assert "Measures of 4 of 4 members" in run.stdout
    assert "sweep.nc" in run.stdout
    again = stickslip_process("run", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert "4 members were already finished and not run again." in again.stdout


def test_a_million_members_are_counted_and_estimated_first_and_not_run_unasked(tmp_path):
    scenario = sliders(tmp_path / "s.toml", "{uniform = [0.3, 0.7], number = 1000}", 1000)
    run = stickslip_process("run", scenario, "--out", tmp_path / "out")
    assert run.returncode == 2
    assert "Sweep: 1000000 members" in run.stdout
    assert ": about " in run.stdout
    assert "a trial run of the first member took" in run.stdout
    assert run.stderr == "stickslip: the sweep has 1000000 members and there is no terminal to confirm: add --yes\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.name != "posix", reason="terminals are those of POSIX")
@pytest.mark.parametrize(("answer", "code"), [("n", 0), ("y", 2)])
def test_many_members_are_confirmed_at_a_terminal(answer, code, tmp_path):
    """The last of the members is no scenario, so that nothing runs even after a yes."""
    scenario = sliders(tmp_path / "s.toml", "[" + ", ".join(f"0.{k}1" for k in range(1000, 2000)) + ', "rough"]', 1)
    mine, theirs = os.openpty()
    words = [sys.executable, "-c", "from stickslip.cli import main; main()", "run", scenario, "--out", tmp_path / "out"]
    run = subprocess.Popen(words, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    os.write(mine, f"{answer}\n".encode())
    out, err = run.communicate(timeout=60)
    assert run.returncode == code
    assert "Run 1001 members?" in out + err
    assert ("nothing was run" in out) == (answer == "n")
    assert ("member surface.mu0 = rough, seed = 0: surface.mu0 must be a valid number, got 'rough'" in err) == (
        answer == "y"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "--workers and --scheduler exclude each other"),
        (["--scheduler", "nonsense"], "no Dask scheduler answers at 'nonsense'"),
        (["--scheduler", "absent.json"], "(there is no such file)"),
    ],
)
def test_where_nothing_can_run(words, sentence, tmp_path):
    run = stickslip_process("run", sliders(tmp_path / "s.toml"), "--out", tmp_path / "out", *words)
    assert run.returncode == 2
    assert sentence in run.stderr
    assert run.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_single_run_has_nothing_for_a_cluster(tmp_path):
    scenario = ROOT / "examples" / "rate_state.toml"
    run = stickslip_process("run", scenario, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1")
    assert run.returncode == 2
    assert "experiment = 'rate-state' is a single one" in run.stderr


@pytest.mark.slow
def test_a_folder_of_another_run_is_not_taken(tmp_path):
    out = tmp_path / "out"
    assert stickslip_process("run", ROOT / "examples" / "rate_state.toml", "--out", out).returncode == 0
    run = stickslip_process("run", sliders(tmp_path / "s.toml"), "--out", out)
    assert run.returncode == 2
    assert "contains the results of a run: choose another --out" in run.stderr
    assert stickslip_process("run", tmp_path / "s.toml", "--out", tmp_path / "sweep").returncode == 0
    run = stickslip_process("run", ROOT / "examples" / "rate_state.toml", "--out", tmp_path / "sweep")
    assert run.returncode == 2
    assert "contains the results of a sweep" in run.stderr


def test_a_member_that_is_no_scenario_stops_the_sweep_before_it_starts(tmp_path):
    run = stickslip_process("run", sliders(tmp_path / "s.toml", '[0.3, "rough"]'), "--out", tmp_path / "out")
    assert run.returncode == 2
    assert "member surface.mu0 = rough, seed = 0: surface.mu0 must be a valid number, got 'rough'" in run.stderr
    assert not (tmp_path / "out").exists()


def test_members_that_fail_end_with_1_and_the_others_are_kept(tmp_path):
    (tmp_path / "s.toml").write_text(DISKS.format(mu="0.0, ").replace("60000", "200"))
    run = stickslip_process("run", tmp_path / "s.toml", "--out", tmp_path / "out", "--workers", "2")
    assert run.returncode == 1
    assert run.stderr == (
        "stickslip: 1 of 5 members failed: the others are saved; repeat the call to rerun the failed ones\n"
    )
    assert "no equilibrium at push = 0.001" in run.stdout
    assert open_sweep(tmp_path / "out").finished.values.tolist() == [0, 1, 1, 1, 1]


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize("end", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGKILL])
def test_a_sweep_that_is_stopped_goes_on_with_the_next_call(end, tmp_path):
    (tmp_path / "s.toml").write_text(DISKS.format(mu=""))
    words = [sys.executable, "-c", "from stickslip.cli import main; main()", "run", tmp_path / "s.toml"]
    words += ["--out", tmp_path / "out", "--workers", "2"]
    run = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # shells ignore it in the background
    )  # fmt: skip
    done = tmp_path / "out" / "members"
    assert until(lambda: list(done.glob("*/measures.json")), 60)
    time.sleep(0.2)
    run.send_signal(end)
    out, err = run.communicate(timeout=20)
    kept = len(list(done.glob("*/measures.json")))
    if end == signal.SIGINT:
        assert run.returncode == 130
        assert f"{kept} of 4 members are finished and saved" in out
        assert err.count("\n") == 1
        assert open_sweep(tmp_path / "out").finished.values.sum() == kept
    again = stickslip_process("run", tmp_path / "s.toml", "--out", tmp_path / "out", "--workers", "2")
    assert again.returncode == 0, again.stderr
    assert f"{kept} members were already finished and not run again." in again.stdout
    assert open_sweep(tmp_path / "out").finished.values.all()
    assert not [path.name for path in done.iterdir() if path.name.startswith(".")]
