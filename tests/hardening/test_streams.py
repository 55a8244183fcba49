"""Standard output that cannot be written, or that nobody reads any more."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is always full")


@pytest.mark.parametrize(
    "arguments", [["--help"], ["cite", "--json", "examples/rate_state.toml"], ["doctor", "--nonsense"]]
)
def test_a_full_device_is_reported_in_one_sentence(arguments):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "stickslip", *arguments], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert ("standard output cannot be written (no space" in done.stderr) == (arguments[0] != "doctor")


def test_a_pipe_that_is_closed_is_no_traceback():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "stickslip", "--help"], stdout=write, stderr=subprocess.PIPE, text=True
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("closed", "words", "code"),
    [
        (">&-", ["cite", "s.toml"], 0),
        ("2>&-", ["cite", "none.toml"], 2),
        ("<&- >&- 2>&-", ["run", "s.toml", "--out", "out"], 0),
    ],
)
def test_closed_streams_change_nothing_but_what_is_reported(tmp_path, closed, words, code):
    (tmp_path / "s.toml").write_text('experiment = "rate-state"\nsamples.number = 10\n')
    arguments = ["sh", "-c", 'exec "$@" ' + closed, "sh", sys.executable, "-m", "stickslip", *words]
    done = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, "")
    assert (tmp_path / "out" / "results.h5").exists() == (words[0] == "run")
