"""Many runs in processes: the same results however they are spread, and a death that costs one member only."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import pytest

from stickslip.ensemble import reach, run_members, trial, worker
from stickslip.ensemble.worker import WorkerDiedError, WorkerProcess, borrowed, waiting_processes
from tests.ensemble import tasks

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")


def ended(process: int) -> bool:
    """Whether a process is no more, or a zombie that nobody has buried."""
    found = subprocess.run(["ps", "-o", "stat=", "-p", str(process)], capture_output=True, text=True)
    return found.stdout.strip() in ("", *["Z", "Z+", "Zs"])


def until(condition, seconds=20.0) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return bool(condition())


@pytest.mark.parametrize("workers", [1, 3])
def test_results_do_not_depend_on_processes(workers):
    told = []
    found = run_members(tasks.square, [(k,) for k in range(5)], workers=workers, report=lambda *now: told.append(now))
    assert [m.result for m in found] == [0, 1, 4, 9, 16]
    assert {stage for stage, *_ in told} == {"members"}
    said = [(share, text.partition("; ")[2]) for _, share, text in told if text.endswith("half")]
    assert sorted(text for _, text in said) == [f"square of {k}: half" for k in range(5)]
    assert all(0 < share < 1 for share, _ in said)
    done = [(share, text) for _, share, text in told if not text.endswith("half")]
    assert [text for _, text in done] == [f"{k} of 5; done" for k in (1, 2, 3, 4, 5)]
    assert done[-1][0] == pytest.approx(1.0)


def test_who_waits_for_members_in_threads_can_be_interrupted():
    never = threading.Event()

    def wait(first, report):
        never.wait(0.1 if first else 60)

    def interrupt(stage, share, text):
        raise KeyboardInterrupt

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_members(wait, [(True,), (False,)], together=True, report=interrupt)
    assert time.monotonic() - start < 30
    never.set()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_member_that_fails_is_a_sentence(workers):
    found = run_members(tasks.fail_at, [(k, 2) for k in range(4)], workers=workers)
    assert [m.result for m in found] == [0, 1, None, 3]
    assert found[2].failure == "2 is bad"


def test_what_cannot_travel_is_a_failure():
    found = run_members(tasks.unpicklable, [(), ()], workers=2)
    assert all("pickle" in m.failure for m in found)


def test_processes_have_one_core_each():
    found = [m.result for m in run_members(tasks.environment, [(), ()], workers=2)]
    assert [threads for threads, _ in found] == ["1", "1"]
    assert os.getpid() not in [process for _, process in found]


def test_a_member_whose_process_dies_once_is_tried_again(tmp_path):
    found = run_members(tasks.die, [(k, str(tmp_path), 1) for k in range(6)], workers=2)
    assert [m.result for m in found] == [k * k for k in range(6)]
    assert (tmp_path / "deaths").read_text() == ".."


def test_a_member_that_always_dies_costs_only_itself(tmp_path):
    found = run_members(tasks.die, [(k, str(tmp_path), 99) for k in range(6)], workers=2)
    assert [m.result for m in found] == [0, 1, 4, None, 16, 25]
    assert found[3].failure == "worker died (killed, or out of memory), 2 times"
    assert (tmp_path / "deaths").read_text() == ".."


def test_a_process_killed_from_outside_does_not_stop_the_others(tmp_path):
    def kill():
        until(lambda: (tmp_path / "pid0").exists() and (tmp_path / "pid0").read_text())
        os.kill(int((tmp_path / "pid0").read_text().split()[0]), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    found = run_members(tasks.wait, [(str(tmp_path), k, 0.5) for k in range(4)], workers=2)
    killer.join()
    assert [m.result for m in found] == [0, 1, 2, 3]


def test_finished_members_are_loaded_and_others_saved():
    kept, saved, told = {1: "one", 3: "three"}, {}, []
    found = run_members(
        tasks.fail_at, [(k, 2) for k in range(5)], workers=2, load=kept.get, save=saved.__setitem__,
        report=lambda *now: told.append(now[2]),
    )  # fmt: skip
    assert [m.result for m in found] == [0, "one", None, "three", 4]
    assert saved == {0: 0, 4: 4}
    assert [text[:6] for text in told] == ["3 of 5", "4 of 5", "5 of 5"]
    assert any(text.endswith("1 failed; 2 is bad") for text in told)


def test_what_cannot_be_saved_stops_everything(tmp_path):
    def save(k, result):
        raise OSError("the disk is full")

    before = set(threading.enumerate())
    with pytest.raises(OSError, match="disk is full"):
        run_members(tasks.wait, [(str(tmp_path), k, 0.1 + k) for k in range(3)], workers=2, save=save)
    assert set(threading.enumerate()) == before


def test_processes_end_with_whoever_started_them(tmp_path):
    code = f"from stickslip.ensemble import run_members as r; from tests.ensemble.tasks import wait; \
        r(wait, [({str(tmp_path)!r}, k, 60) for k in range(2)], workers=2)"
    mother = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    assert until(lambda: all((tmp_path / f"pid{k}").exists() for k in range(2)))
    children = [int((tmp_path / f"pid{k}").read_text().split()[0]) for k in range(2)]
    assert not any(map(ended, children))
    mother.kill()
    mother.wait()
    assert until(lambda: all(map(ended, children)), 5)


def test_a_trial_ends_in_time():
    assert trial(tasks.square, (3,), 20.0).result == 9
    assert "bad" in trial(tasks.fail_at, (1, 1), 20.0).failure
    begin = time.monotonic()
    assert trial(tasks.hold, (60,), 0.5) is None
    assert time.monotonic() - begin < 5


def test_a_worker_of_another_version_says_so(monkeypatch):
    helper = WorkerProcess()
    monkeypatch.setattr("stickslip.ensemble.worker.__version__", "0.0.1")
    answer, failure = helper.call(b"", None, None)
    helper.end()
    assert answer is None
    assert "the client 0.0.1: install the same version" in failure


def test_a_helper_that_is_gone_is_a_death():
    helper = WorkerProcess()
    helper.process.kill()
    with pytest.raises(WorkerDiedError, match="killed, or out of memory"):
        helper.call(b"", None, None)
    helper.end()


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (0, "workers must be at least 1, got 0"),
        ("nonsense", "no Dask scheduler answers at 'nonsense'"),
        ("a/b.json", "no such file"),
    ],
)
def test_where_nothing_can_run_is_one_sentence(where, words):
    with pytest.raises(ValueError, match=words) as caught:
        reach(where)
    assert "\n" not in str(caught.value)
    assert reach(3) == (3, "3 processes")


def test_without_dask_one_sentence_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r'pip install .*"stickslip\[cluster\]"'):
        run_members(tasks.square, [(1,)], workers="tcp://127.0.0.1:8786")


SCRIPT = """
from stickslip.ensemble import run_members

def square(x):
    return x * x

if __name__ == "__main__":
    print([member.result for member in run_members(square, [(3,), (4,)], workers=2)])
"""


def test_processes_that_wait_take_tasks_only_of_the_same_folder_and_environment(tmp_path, monkeypatch):
    def started() -> int:
        with borrowed(waiting) as process:
            return process.process.pid

    waiting: list[WorkerProcess] = []
    try:
        first = started()
        assert started() == first
        monkeypatch.chdir(tmp_path)
        second = started()
        assert second != first
        monkeypatch.setenv("STICKSLIP_TEST", "1")
        assert started() not in (first, second)
    finally:
        while waiting:
            waiting.pop().end()


@pytest.mark.parametrize("as_module", [True, False])
def test_functions_of_a_script_run_as_a_module_or_are_refused_with_the_remedy(tmp_path, as_module):
    (tmp_path / "squares.py").write_text(SCRIPT, encoding="utf-8")
    how = ["-m", "squares"] if as_module else ["squares.py"]
    said = subprocess.run([sys.executable, *how], cwd=tmp_path, capture_output=True, text=True, timeout=50)
    if as_module:
        assert said.stdout.strip() == "[9, 16]", said.stderr
    else:
        assert "square is defined in a script or notebook" in said.stderr and "python -m" in said.stderr


def test_a_process_that_ended_while_it_waited_costs_no_try():
    waiting = [WorkerProcess()]
    waiting[0].kill()
    waiting[0].process.wait()
    with borrowed(waiting) as process:
        assert pickle.loads(process.call(pickle.dumps((divmod, (7, 2))), None, None)[0]) == (3, 1)
    assert waiting == [process]
    process.end()


@pytest.mark.parametrize("own", [False, True])
def test_processes_wait_for_later_tasks_if_only_this_package_runs(own):
    while waiting_processes:
        waiting_processes.pop().end()
    worker.run_tasks(enumerate([pickle.dumps((os.getpid, ()))] * 3), 2, lambda *_: None, None, own=own)
    assert len(waiting_processes) in ((1, 2) if own else (0,))


@pytest.mark.parametrize(
    ("problem", "text"),
    [
        (ValueError("a sentence"), "a sentence"), (RuntimeError("another"), "another"), (ValueError(), "ValueError: "),
        (KeyError("x"), "KeyError: 'x'"), (TypeError("not for users"), "TypeError: not for users"),
    ],
)  # fmt: skip
def test_errors_that_are_no_sentence_are_named(problem, text):
    assert worker.describe_error(problem) == text
