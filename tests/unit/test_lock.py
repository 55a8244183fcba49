"""One process at a time works in a folder; one that is killed leaves it free."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from stickslip.data.run_files import HOLDER, LOCK, lock_folder
from tests.conftest import stickslip_here

SLIDER = 'experiment = "rate-state"\n[samples]\nnumber = 12\n'
HOLD = """
import sys
from pathlib import Path
from stickslip.data.run_files import lock_folder
with lock_folder(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that works in tmp_path/out."""
    arguments = [sys.executable, "-c", HOLD, str(tmp_path / "out")]
    process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_process_is_told_who_holds_the_lock_and_a_killed_holder_releases_it(holder, tmp_path):
    out = tmp_path / "out"
    (tmp_path / "s.toml").write_text(SLIDER)
    (tmp_path / "many.toml").write_text(SLIDER + '[sweep]\n"surface.mu0" = [0.3, 0.4]\n')
    before = sorted(path.name for path in out.iterdir())
    calls = [["run", "s.toml"], ["run", "many.toml"], ["reproduce", "disk-array"], ["run", "s.toml", "--overwrite"]]
    for arguments in calls:
        run = stickslip_here(*arguments, "--out", "out", cwd=tmp_path)
        assert run.returncode == 2
        assert f"out is in use: process {holder.pid} on " in run.stderr
        assert "has been using it since 2" in run.stderr
        assert "choose another --out" in run.stderr
        assert run.stderr.count("\n") == 1
        assert sorted(path.name for path in out.iterdir()) == before
    (out / "scenario.json").write_text("{}")
    assert "in use" in stickslip_here("resume", out).stderr
    (out / "scenario.json").unlink()
    holder.send_signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
    holder.communicate()
    assert (out / LOCK).exists()  # it had no time to tidy up, and that does not matter
    run = stickslip_here("run", "s.toml", "--out", "out", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert not [path.name for path in out.iterdir() if path.name.startswith(".")]


def test_the_note_of_who_works_there_may_be_gone_or_damaged(holder, tmp_path):
    for content in (None, "", "{", "{}", '{"pid": 3}'):
        (tmp_path / "out" / HOLDER).unlink(missing_ok=True)
        if content is not None:
            (tmp_path / "out" / HOLDER).write_text(content)
        with (
            pytest.raises(ValueError, match="out is in use: another process is using it; wait"),
            lock_folder(tmp_path / "out"),
        ):
            pass


def test_a_member_is_held_with_its_sweep(tmp_path):
    member = tmp_path / "members" / "one"
    member.mkdir(parents=True)
    (tmp_path / "sweep.json").write_text("{}")
    with lock_folder(tmp_path), pytest.raises(ValueError, match="one is in use"), lock_folder(member):
        pass
    with lock_folder(member), pytest.raises(ValueError, match="is in use"), lock_folder(tmp_path):
        pass


def test_what_goes_wrong_inside_leaves_neither_lock_nor_folder(tmp_path):
    with pytest.raises(KeyError), lock_folder(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / LOCK).exists()
        raise KeyError
    assert not list(tmp_path.iterdir())


def test_only_one_of_many_holds_the_lock_at_a_time(tmp_path):
    """Threads hold locks of their own, as processes do; none may pass by a lock file that is just being removed."""
    inside, most, wrong = [], [], []

    def work():
        entered = 0
        while entered < 20 and not wrong:
            try:
                with lock_folder(tmp_path / "out"):
                    inside.append(1)
                    time.sleep(1e-3)
                    most.append(len(inside))
                    entered += 1
                    inside.pop()
            except Exception as problem:
                if "in use" not in str(problem):
                    wrong.append(problem)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert most == [1] * 80
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.parametrize(("make", "sentence"), [("file", "is a file, not a folder"), ("shut", "cannot write to")])
def test_folders_that_cannot_be_held(make, sentence, tmp_path):
    place = tmp_path / "out"
    if make == "file":
        place.write_text("")
    elif os.name == "posix" and os.path.isdir("/proc"):
        from pathlib import Path

        place = Path("/proc/stickslip")
    else:
        pytest.skip("needs a folder in which nobody can write")
    with pytest.raises(ValueError, match=sentence), lock_folder(place):
        pass
