"""Compiled kernels on the disk: damaged ones are compiled again, temporary folders go, full disks do not matter."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import IndexDataCacheFile

import stickslip.core  # repairs damaged files

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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A folder with a module and the cache of its compiled kernel, which a second process loads."""
    folder = tmp_path_factory.mktemp("compiled")
    (folder / "kernel.py").write_text(KERNEL)
    for hits in (0, 1):
        assert said(folder, NUMBA_CACHE_DIR=str(folder / "cache")).stdout == f"42 {hits}\n"
    return folder


@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
@pytest.mark.parametrize(
    "how", ["one byte", *(pytest.param(how, marks=pytest.mark.slow) for how in ("cut", "garbage", "empty"))]
)
def test_a_damaged_kernel_is_compiled_again_with_one_warning(compiled, tmp_path, ending, how):
    shutil.copytree(compiled / "cache", tmp_path / "cache")
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    (path,) = (tmp_path / "cache").rglob(f"*{ending}")
    whole = path.read_bytes()
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 0xFF
    damaged = {"cut": whole[: len(whole) // 2], "garbage": b"garbage" * 100, "empty": b"", "one byte": bytes(changed)}
    path.write_bytes(damaged[how])
    done = said(compiled, **cache)
    if ending == ".nbc" or how != "one byte":  # an index with another name in it is an index
        assert done.stderr.count("Warning: ") == 1, done.stderr
        assert done.stdout == "42 0\n", done.stderr
    again = said(compiled, **cache)
    assert (again.stdout, again.stderr) == ("42 1\n", "")


@pytest.mark.skipif(os.name != "posix", reason="needs a folder that cannot be made")
def test_a_temporary_folder_of_kernels_is_removed(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "tmp").mkdir()
    places = {"XDG_CACHE_HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path / "tmp")}
    code = "from stickslip.core.contacts import geometry; print(geometry.shifts.stats.cache_path)"
    env = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "STICKSLIP_KERNELS")} | places
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.startswith(str(tmp_path / "tmp" / "stickslip-kernels-")), done.stderr
    assert not list((tmp_path / "tmp").iterdir())


@pytest.fixture
def copied(tmp_path):
    """A copy of the package whose sources a test may change."""
    source = Path(stickslip.__file__).parent
    shutil.copytree(source, tmp_path / "src" / "stickslip", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "src" / "stickslip"


def printed(code: str, copied: Path) -> list[str]:
    env = os.environ | {"PYTHONPATH": str(copied.parent), "NUMBA_CACHE_DIR": str(copied.parent.parent / "cache")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert not done.returncode, done.stderr
    return done.stdout.split()


def changed(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_a_changed_docstring_recompiles_nothing_and_a_changed_constant_does(copied):
    code = """
from stickslip.core.contacts import geometry
value = geometry.total(1.0)
print(value, sum(geometry.total.stats.cache_hits.values()))
"""
    with open(copied / "core" / "contacts" / "geometry.py", "a") as file:
        file.write('\n\n@njit(cache=True)\ndef total(x):\n    """Add a half."""\n    return x + 0.5\n')
    assert printed(code, copied) == ["1.5", "0"]
    assert printed(code, copied) == ["1.5", "1"]
    changed(copied / "core" / "contacts" / "geometry.py", '"""Geometry', '"""Some lines\n\nmore.\n\nGeometry')
    changed(copied / "core" / "contacts" / "geometry.py", '"""Add a half."""', '"""Add one half."""  # a comment')
    assert printed(code, copied) == ["1.5", "1"]
    changed(copied / "core" / "contacts" / "geometry.py", "x + 0.5", "x + 0.25")
    assert printed(code, copied) == ["1.25", "0"]


def test_kernels_are_keyed_by_the_modules_that_they_import(copied):
    names = ("core.contacts.forces", "core.contacts.jacobian", "core.dynamics.ledger", "core.contacts.geometry")
    code = f"from stickslip.kernel_cache import digest\nfor name in {names}: print(digest('stickslip.' + name))"
    before = printed(code, copied)
    for file in ("contacts/forces.py", "laws/builtin.py", "dynamics/ledger.py"):
        path = copied / "core" / file
        path.write_text("# a comment above everything\n" + path.read_text())
    assert printed(code, copied) == before
    changes = {  # file -> which of the four kernels are compiled again
        "dynamics/ledger.py": [False, False, True, False],
        "laws/builtin.py": [True, True, True, False],
        "laws/user.py": [True, True, True, False],  # whose functions kernels find while types are inferred
    }
    for file, expected in changes.items():
        path = copied / "core" / file
        path.write_text(path.read_text() + "\nADDED = 1\n")
        after = printed(code, copied)
        assert [a != b for a, b in zip(after, before, strict=True)] == expected, file
        before = after


def test_functions_of_one_name_have_kernels_of_their_own(copied):
    """Numba tells them apart by their line, which a comment shifts; here it is their code."""
    with open(copied / "core" / "contacts" / "geometry.py", "a") as file:
        for factor in (2, 3):
            file.write(f"\n\n@njit(cache=True)\ndef times(x):\n    return {factor} * x\n\n\ntimes_{factor} = times\n")
    code = "from stickslip.core.contacts import geometry; print(geometry.times_2(7), geometry.times_3(7))"
    assert printed(code, copied) == ["14", "21"]
    assert printed(code, copied) == ["14", "21"]


def test_a_damaged_table_of_digests_is_written_again(copied):
    code = "from stickslip.kernel_cache import digest; print(digest('stickslip.core.contacts.forces'))"
    first = printed(code, copied)
    table = copied.parent.parent / "cache" / "syntax.json"
    whole = table.read_bytes()
    for damaged in (b"", b"[1, 2]", b'{"a": 3}', b"\xff\xfe", whole[: len(whole) // 2]):
        table.write_bytes(damaged)
        assert printed(code, copied) == first
    assert json.loads(table.read_bytes()).keys() == json.loads(whole).keys()


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
