"""Compiled kernels on the disk: damaged ones are compiled again, temporary folders go, full disks do not matter."""

import os
import subprocess
import sys

import pytest

# a kernel of a few lines, known to the process as one of the package's would be
CODE = """
import sys, numba, stickslip.core
sys.path.insert(0, sys.argv[1])
from kernel import twice
print(twice(21), sum(twice.stats.cache_hits.values()))
"""
KERNEL = "from numba import njit\n\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n"


def said(folder, **more):
    env = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "STICKSLIP_KERNELS")} | more
    return subprocess.run([sys.executable, "-c", CODE, str(folder)], capture_output=True, text=True, env=env)


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize("how", ["cut", "garbage", "empty", "one byte"])
def test_a_damaged_kernel_is_compiled_again_with_one_warning(tmp_path, ending, how):
    (tmp_path / "kernel.py").write_text(KERNEL)
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert said(tmp_path, **cache).stdout == "42 0\n"
    assert said(tmp_path, **cache).stdout == "42 1\n"
    (path,) = (tmp_path / "cache").rglob(f"*{ending}")
    whole = path.read_bytes()
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 0xFF
    damaged = {"cut": whole[: len(whole) // 2], "garbage": b"garbage" * 100, "empty": b"", "one byte": bytes(changed)}
    path.write_bytes(damaged[how])
    done = said(tmp_path, **cache)
    if ending == ".nbc" or how != "one byte":  # an index with another name in it is an index
        assert done.stderr.count("Warning: ") == 1, done.stderr
        assert done.stdout == "42 0\n", done.stderr
    assert said(tmp_path, **cache).stdout == "42 1\n"
    assert not said(tmp_path, **cache).stderr


@pytest.mark.skipif(os.name != "posix", reason="needs a folder that cannot be made")
def test_a_temporary_folder_of_kernels_goes_away(tmp_path):
    (tmp_path / "kernel.py").write_text(KERNEL)
    (tmp_path / "file").write_text("")
    (tmp_path / "tmp").mkdir()
    done = said(tmp_path, XDG_CACHE_HOME=str(tmp_path / "file"), TMPDIR=str(tmp_path / "tmp"))
    assert done.stdout == "42 0\n", done.stderr
    assert not list((tmp_path / "tmp").glob("stickslip-kernels-*"))


@pytest.mark.skipif(os.name != "posix", reason="needs a limit on the size of files")
def test_a_kernel_that_cannot_be_kept_is_used_all_the_same(tmp_path):
    """A disk that is full ends no run that could do without its cache."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    limited = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))\n" + CODE
    env = {k: v for k, v in os.environ.items() if k != "STICKSLIP_KERNELS"}
    env["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    done = subprocess.run([sys.executable, "-c", limited, str(tmp_path)], capture_output=True, text=True, env=env)
    assert (done.stdout, done.stderr) == ("42 0\n", "")
    assert said(tmp_path, NUMBA_CACHE_DIR=env["NUMBA_CACHE_DIR"]).stdout == "42 0\n"
