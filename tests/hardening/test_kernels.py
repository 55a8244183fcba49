"""Compiled kernels on the disk: damaged ones are compiled again, temporary folders go, full disks do not matter."""

import os
import subprocess
import sys

import pytest
from numba.core.caching import IndexDataCacheFile

import stickslip.core  # noqa: F401  lets the cache heal

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


@pytest.mark.skipif(os.name != "posix", reason="needs a limit on the size of files")
def test_a_full_disk_leaves_no_index_that_names_an_older_kernel(tmp_path):
    """Where room ended between the index and the kernel, the next process computed with the kernel of before."""
    kernel = "from numba import njit\n\nFACTOR = {}\n\n\n@njit(cache=True)\ndef twice(x):\n    return FACTOR * x\n"
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    (tmp_path / "kernel.py").write_text(kernel.format(2))
    assert said(tmp_path, **cache).stdout == "42 0\n"
    (index,), (data,) = ((tmp_path / "cache").rglob(f"*{ending}") for ending in (".nbi", ".nbc"))
    between = (index.stat().st_size + data.stat().st_size) // 2
    (tmp_path / "kernel.py").write_text(kernel.format(3))
    limited = f"import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, ({between}, {between}))\n" + CODE
    env = os.environ | cache
    done = subprocess.run([sys.executable, "-c", limited, str(tmp_path)], capture_output=True, text=True, env=env)
    assert (done.stdout, done.stderr) == ("63 0\n", "")
    assert said(tmp_path, **cache).stdout == "63 0\n"
    assert said(tmp_path, **cache).stdout == "63 1\n"


def test_two_processes_that_compile_a_function_for_other_types_keep_their_own_kernels(tmp_path):
    """Each wrote its index, then its kernel: one index could name the other one's kernel, which nothing noticed."""
    mine, other = (IndexDataCacheFile(str(tmp_path), "f", "stamp") for _ in range(2))
    whole, opened = mine._open_for_write, []

    def late(path):
        if path.endswith(".nbc") and not opened:
            opened.append(path)
            other.save("floats", "kernel for floats")
        return whole(path)

    mine._open_for_write, other._load_index = late, dict  # which was looked at before there was one
    mine.save("integers", "kernel for integers")
    assert opened
    assert mine.load("integers") in (None, "kernel for integers")
    assert mine.load("floats") in (None, "kernel for floats")
    mine.save("integers", "kernel for integers")
    mine.save("integers", "a better kernel for integers")
    assert mine.load("integers") == "a better kernel for integers"
    assert len(list(tmp_path.glob("*.nbc"))) == 2


def test_a_folder_of_kernels_in_which_no_file_can_be_made_ends_no_run(tmp_path):
    """As where a disk has no inodes left, or a quota has been used up."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    full = """
import errno, tempfile, stickslip.core
from numba.core.caching import _CacheLocator
whole, made = _CacheLocator.ensure_cache_path, []
def once(self):
    if made:
        raise OSError(errno.ENOSPC, "No space left on device")
    made.append(self)
    whole(self)
_CacheLocator.ensure_cache_path = once
"""
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, "-c", full + CODE, str(tmp_path)], capture_output=True, text=True, env=env)
    assert (done.stdout, done.stderr) == ("42 0\n", "")


def test_a_law_of_ones_own_that_cannot_be_noted_as_compiled_is_used_all_the_same(tmp_path):
    code = "import stickslip as ss; ss.laws.custom(normal_force=lambda overlap, kn: kn * overlap); print('made')"
    (tmp_path / "laws").write_text("")  # where a folder cannot be made
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout == "made\n", done.stderr
