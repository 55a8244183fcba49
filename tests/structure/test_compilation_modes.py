"""The tests of forces, tangents and runs again, with bounds checked in compiled code, and without compiled code."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCALAR = ("unit/test_closed_forms.py", "derivatives/test_jacobian.py", "properties/test_evaluation.py")
CHECKED = (*SCALAR, "unit/test_core.py", "unit/test_dynamics.py", "unit/test_record.py", "unit/test_partition.py",
           "properties/test_determinism.py", "orders/test_ledger.py", "laws/test_mechanics.py")  # fmt: skip


def passes(files, tmp_path, **settings: str) -> None:
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--timeout", "900"]
    words += [str(ROOT / "tests" / file) for file in files]
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)} | settings
    done = subprocess.run(words, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-5000:]
    assert " passed" in done.stdout


@pytest.mark.slow
def test_no_kernel_looks_beyond_an_array(tmp_path):
    passes(CHECKED, tmp_path, NUMBA_BOUNDSCHECK="1")


@pytest.mark.slow
def test_scalar_code_gives_the_same_without_being_compiled(tmp_path):
    passes(SCALAR, tmp_path, NUMBA_DISABLE_JIT="1")
