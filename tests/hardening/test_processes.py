"""Processes of runs: those that nobody needs end quietly."""

import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stickslip.ensemble.worker import WorkerDiedError, WorkerProcess

IDLES = "from stickslip.ensemble import worker; worker.IDLE = 0.2; worker.serve()"


def test_a_process_that_nobody_asks_ends_quietly():
    """It aborted at the interpreter's shutdown, with words of Python's on the terminal of who had started it."""
    process = subprocess.Popen(
        [sys.executable, "-c", IDLES], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    with process:  # its stdin stays open, as while another one works
        code = process.wait(50)
        assert (code, process.stderr.read()) == (0, b"")


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_an_interrupted_process_ends_by_the_signal(capfd):
    """It aborted in the interpreter's shutdown, with a core dump and words of Python's on the terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored, where tests run in the background
    try:
        helper = WorkerProcess()
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        with pytest.raises(WorkerDiedError, match="interrupt"):
            packed = pickle.dumps((_tells_and_sleeps, (50.0,)))
            helper.call(packed, 0.0, lambda *_: helper.process.send_signal(signal.SIGINT))
    finally:
        helper.end()
    assert helper.process.returncode == -signal.SIGINT
    assert capfd.readouterr().err == ""


def test_a_process_that_cannot_answer_ends_with_one_reason(capfd):
    """So did one whose main thread met with an error of its own."""
    helper = WorkerProcess()
    with pytest.raises(WorkerDiedError, match="exit code 1"):
        helper.call(pickle.dumps((sys.exit, (3,))), None, None)
    helper.end()
    said = capfd.readouterr().err
    assert said.count("SystemExit: 3") == 1
    assert "Fatal Python error" not in said


def test_a_process_that_nobody_listens_to_ends_quietly(capfd):
    helper = WorkerProcess()
    helper.process.stdout.close()
    pickle.dump(("0", None, pickle.dumps((time.sleep, (0.0,)))), helper.process.stdin)
    helper.process.stdin.flush()
    assert helper.process.wait(50) == 0
    helper.process.stdin.close()
    assert capfd.readouterr().err == ""


ASKS = """
import pickle, sys
from stickslip.ensemble.worker import WorkerProcess
from tests.hardening.test_processes import tells_on

def heard(stage, share, text):
    if share == 0.0:
        print("heard", flush=True)

WorkerProcess().call(pickle.dumps((tells_on, (1_000_000,))), 0.0, heard)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_whoever_asked_is_killed_and_the_process_ends_quietly():
    """While it told how far it was it mostly aborted, with a core dump."""
    root = Path(__file__).parents[2]
    asks = subprocess.Popen(
        [sys.executable, "-c", ASKS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=root
    )
    assert asks.stdout.readline() == "heard\n"
    asks.kill()
    assert asks.communicate(timeout=50)[1] == ""  # to the end of the other process, which has the same stderr


def tells_on(times, report):
    for k in range(times):
        report("on", k / times, "on " * 100)


def _tells_and_sleeps(seconds, report):
    report("sleep", 0.0, "asleep")
    time.sleep(seconds)
