"""Every public function with invalid states and arguments: results, or errors of this package in one sentence."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHARE = 40  # of all invalid arguments, one in so many is tried in the fast suite; of invalid states, all are


def faults(part: int, share: int = SHARE) -> dict[str, str]:
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


@pytest.mark.timeout(600)
def test_no_function_crashes_hangs_or_lets_an_error_of_others_through():
    assert faults(0) == {}


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1, SHARE))
def test_the_other_arguments(part):
    assert faults(part) == {}
