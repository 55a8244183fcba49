"""The compiled core neither reads nor writes beyond arrays, nor has undefined behaviour, in tests of its parts."""

import os
import subprocess
import sys

import pytest

from stickslip._core import build

KINDS = "address,undefined"
TESTS = (
    "tests/unit/test_core.py", "tests/unit/test_dynamics.py", "tests/unit/test_blocks.py", "tests/unit/test_record.py",
    "tests/unit/test_springs.py", "tests/derivatives/test_jacobian.py", "tests/properties/test_determinism.py",
    "tests/wings/faults/test_laws.py",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="sanitizers are preloaded as on Linux")
def test_sanitizers_find_nothing(tmp_path):
    script = [sys.executable, build.__file__, "--sanitize", KINDS, "--out", str(tmp_path)]
    subprocess.run(script, check=True, capture_output=True)
    env = os.environ | {
        "STICKSLIP_CORE": str(tmp_path), "LD_PRELOAD": build.preload(KINDS), "ASAN_OPTIONS": "detect_leaks=0",
    }  # fmt: skip
    arguments = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--timeout", "1800", *TESTS]
    run = subprocess.run(arguments, capture_output=True, text=True, env=env)
    assert run.returncode == 0, (run.stdout + run.stderr)[-3000:]
