"""Processes of runs: those that nobody needs end quietly."""

import subprocess
import sys

IDLES = "from stickslip.ensemble import helper; helper.IDLE = 0.2; helper.serve()"


def test_a_process_that_nobody_asks_ends_quietly():
    """It aborted at the interpreter's shutdown, with words of Python's on the terminal of who had started it."""
    process = subprocess.Popen(
        [sys.executable, "-c", IDLES], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    with process:  # its stdin stays open, as while another one works
        code = process.wait(50)
        assert (code, process.stderr.read()) == (0, b"")
