"""Every public function with invalid states and arguments: results, or errors of this package in one sentence."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FEW, SHARE = 2000, 40  # one in so many calls is tried in the fast suite, and in each part of the slow one


def faults(part: int, share: int) -> dict[str, str]:
    """Calls that end in a raw error, a signal or 20 s of processor time, or that accept an invalid state."""
    values, start = {}, 0
    while start >= 0:
        arguments = [sys.executable, "-m", "tests.hardening.every_function", *map(str, (share, part, start))]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=ROOT, env=environment) as child:
            name, before = "the first call", start
            for line in child.stdout:
                start, name, fault = json.loads(line)
                if fault:
                    values[name] = fault
        if start >= 0:
            values[name] = f"the process ended with {child.returncode}"
            start += 1
            assert start > before or before == 0, "the calls cannot be repeated"
    return values


# 3 s: every public function is called
def test_a_few_calls_end_in_results_or_in_errors_of_this_package():
    assert faults(FEW // 2, FEW) == {}


@pytest.mark.slow
@pytest.mark.parametrize("part", range(SHARE))
def test_no_function_crashes_hangs_or_lets_an_error_of_others_through(part):
    assert faults(part, SHARE) == {}
