"""The build of the compiled core, tried on a folder with two sources."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import pytest

from stickslip._core import build

API = 'extern "C" __attribute__((visibility("default")))'
SOURCES = {
    "version.h": "#define VERSION 3\n",
    "level.h": "#if defined(__AVX512F__)\n#define LEVEL 2\n#elif defined(__AVX2__)\n#define LEVEL 1\n"
    "#else\n#define LEVEL 0\n#endif\n",
    "version.cpp": f'#include "version.h"\n{API} int version(void) {{ return VERSION; }}\n',
    "fused.cpp": '// build: -DSCALE=7 -ffp-contract=fast\n#include <math.h>\n#include "level.h"\n'
    f"{API} double scaled(double x) {{ return SCALE * exp(x); }}\n"
    f"{API} int level(void) {{ return LEVEL; }}\n",
    build.PROBE_SOURCE: (build.HERE / build.PROBE_SOURCE).read_text(),
}
ALL = {"levels": build.LEVELS}


FIND = cache(lambda *environment, find=build.find_compiler: find())


@pytest.fixture
def trial(tmp_path, monkeypatch):
    """A folder of sources. A compiler is tried once, whichever test asks."""
    for name in ("CXX", "STICKSLIP_CORE", "STICKSLIP_LEVEL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(build, "find_compiler", lambda: FIND(*map(os.environ.get, ("CXX", "PATH"))))
    for name, text in SOURCES.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.fixture
def no_zig(trial):
    """Skip where only the compiler of the package `ziglang` works: it takes no flags in CXX, and links without libc."""
    if build.find_compiler().is_zig:
        pytest.skip("needs GCC or Clang")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder in which `build` was called."""
    folder = tmp_path_factory.mktemp("made")
    for name, text in SOURCES.items():
        (folder / name).write_text(text)
    with pytest.MonkeyPatch.context() as now:
        for name in ("CXX", "STICKSLIP_CORE", "STICKSLIP_LEVEL"):
            now.delenv(name, raising=False)
        build.build(folder)
    return folder


@pytest.fixture
def built(trial, made):
    """A copy of it."""
    shutil.copytree(made, trial, dirs_exist_ok=True)
    return trial


def loaded(folder, level="base"):
    library = ctypes.CDLL(str(build.library_path(level, folder)))
    library.scaled.argtypes, library.scaled.restype = [ctypes.c_double], ctypes.c_double
    return library


def check_levels(folder):
    for number, level in enumerate(build.usable_levels(folder)):
        library = loaded(folder, level)
        assert (library.version(), library.level()) == (3, number)
        assert library.scaled(0.0) == 7.0  # the flag in the first line of its source


def changed(folder, work):
    """Names of objects and libraries that a piece of work wrote."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    work()
    now = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.suffix in (".o", build.SUFFIX)}
    return sorted(path.name.partition("-")[0] for path, time in now.items() if before.get(path) != time)


def test_the_library_of_every_level_holds_every_source(trial):
    assert f"({' and '.join(build.LEVELS)}) was built in" in build.build(trial, **ALL)
    check_levels(trial)
    stamps = [build.stamp(build.library_path(level, trial)) for level in build.LEVELS]
    assert {stamp["digest"] for stamp in stamps} == {build.digest(trial)}
    assert stamps[0]["compiler"] == build.find_compiler().version
    assert not list(trial.rglob(".[0-9]*"))  # nothing half written


def test_only_what_changed_is_compiled(trial):
    levels, two = 2, {"levels": build.LEVELS[:2]}
    probe = ["core", "stamp"]
    build.build(trial, **two)
    assert changed(trial, lambda: build.build(trial, **two)) == []
    (trial / "version.cpp").write_text(SOURCES["version.cpp"].replace("VERSION;", "VERSION + 1;"))
    expected = sorted([*["core", "stamp", "version"] * levels, *probe])
    assert changed(trial, lambda: build.build(trial, **two)) == expected
    (trial / "version.h").write_text("#define VERSION 4\n")
    expected = sorted([*["core", "fused", "level", "stamp", "version"] * levels, *probe, "level"])
    assert changed(trial, lambda: build.build(trial, **two)) == expected
    assert loaded(trial).version() == 5
    assert len(list(trial.rglob("*.o"))) == 4 * levels + 2  # none of older sources
    assert changed(trial, lambda: build.build(trial, **two, force=True)) == expected


def test_only_the_level_of_this_machine_is_built_unless_others_are_asked_for(built, monkeypatch):
    best = build.usable_levels(built)[-1]
    libraries = sorted(path.name for path in built.glob("core-*"))
    assert libraries == sorted(build.library_path(name, built).name for name in (best, build.PROBE))
    monkeypatch.setenv("STICKSLIP_CORE", str(built))
    monkeypatch.setattr(build, "digest", lambda: build.stamp(build.library_path(best))["digest"])
    assert build.best_level() == best
    if best == "base":
        return
    monkeypatch.setenv("STICKSLIP_LEVEL", "base")
    with pytest.raises(
        build.BuildError, match=r"core-base\.\w+ does not exist: .*build.py --level base --out \S+ builds it$"
    ):
        build.library(build.best_level())
    monkeypatch.delenv("STICKSLIP_LEVEL")
    build.library_path(best).unlink()  # of another machine, say, with a lower level
    monkeypatch.undo()
    build.build(built, levels=("base",))
    monkeypatch.setenv("STICKSLIP_CORE", str(built))
    monkeypatch.setattr(build, "digest", lambda: build.stamp(build.library_path("base"))["digest"])
    assert build.best_level() == "base"


def test_an_error_in_a_source_gives_a_one_sentence_error_with_its_line(trial):
    (trial / "wrong.cpp").write_text("int first;\nint second = third;\n")
    with pytest.raises(build.BuildError) as error:
        build.build(trial)
    assert str(error.value).startswith(f"the core was not built: {trial / 'wrong.cpp'}, line 2: ")
    assert "third" in str(error.value) and "\n" not in str(error.value)
    assert [path.name for path in trial.glob("core-*")] == [build.library_path(build.PROBE, trial).name]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere linkers say it in other words")
def test_a_function_that_no_source_has_is_noticed_when_linking(trial, no_zig):
    (trial / "open.cpp").write_text(
        f'extern "C" int elsewhere(void);\n{API} int open(void) {{ return elsewhere(); }}\n'
    )
    with pytest.raises(build.BuildError, match=r"^the core was not built: .*elsewhere"):
        build.build(trial)


def test_without_a_compiler_one_sentence_says_what_to_install(trial, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(trial))
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(
        build.BuildError, match=r"^no C\+\+ compiler works here: install .* or run .* 'ziglang>=[\d.]+'$"
    ) as error:
        build.build(trial)
    assert "\n" not in str(error.value)
    monkeypatch.setattr(sys, "argv", ["build.py", "--find"])  # what the Makefile asks
    with pytest.raises(SystemExit, match=r"^no C\+\+ compiler works here"):
        build.main()


def test_a_compiler_that_does_not_work_is_passed_over(trial, monkeypatch, capsys):
    """One that ends with an error, and one that is not there."""
    (trial / "c++").write_text("#!/bin/sh\nexit 1\n")
    (trial / "c++").chmod(0o755)
    monkeypatch.setenv("PATH", str(trial), prepend=os.pathsep)
    assert build.find_compiler().command != ["c++"]
    monkeypatch.setenv("CXX", "no-such-compiler -O2")
    assert build.find_compiler().command not in (["c++"], ["no-such-compiler", "-O2"])
    assert "CXX=no-such-compiler -O2 does not compile: other compilers are tried\n" in capsys.readouterr().err


def test_another_compiler_in_cxx_builds_again(built, monkeypatch, no_zig):
    monkeypatch.setenv("CXX", f"{build.find_compiler().command[0]} -DVERSION_OF_CXX")
    assert "was built" in build.build(built)
    assert "-DVERSION_OF_CXX" in build.stamp(build.library_path(build.PROBE, built))["command"]
    assert "up to date" in build.build(built)


def test_the_level_is_that_of_the_processor_or_a_lower_one(monkeypatch):
    monkeypatch.delenv("STICKSLIP_LEVEL", raising=False)
    best = build.best_level()
    if sys.platform == "linux" and build.MACHINE == "x86_64":
        flags = set(Path("/proc/cpuinfo").read_text().partition("\nflags")[2].partition("\n")[0].split())
        v3 = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"} <= flags
        v4 = v3 and {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= flags
        assert best == build.LEVELS[v3 + v4]
    for level in build.LEVELS[: build.LEVELS.index(best) + 1]:
        monkeypatch.setenv("STICKSLIP_LEVEL", level)
        assert build.best_level() == level
    monkeypatch.setenv("STICKSLIP_LEVEL", "avx1024")
    with pytest.raises(build.BuildError, match=f"^STICKSLIP_LEVEL is avx1024: this processor runs base.*{best}$"):
        build.best_level()


def test_a_core_of_other_sources_is_refused_with_the_command_that_builds_it(trial, monkeypatch):
    monkeypatch.setenv("STICKSLIP_CORE", str(trial))
    remedy = rf": .*python\S* {build.HERE / 'build.py'} --level base --out {trial} builds it$"
    with pytest.raises(build.BuildError, match=f"does not exist{remedy}"):
        build.library("base")
    build.build(trial, levels=("base",))
    with pytest.raises(
        build.BuildError, match=f"is damaged, or was built from sources other than those in {build.HERE}{remedy}"
    ):
        build.library("base")


FAILS = {  # compilers that fail for one source, and what is said
    "writes nothing": ("exit 0", "exited with 0 and wrote no version-"),
    "is killed": ("kill -9 $$", "exited with -9 and wrote no version-"),
    "writes half": ('c++ "$@" || exit; for a; do [ "$last" = -o ] && truncate -s 100 "$a"; last=$a; done', "version-"),
}


@pytest.mark.skipif(sys.platform != "linux", reason="shell and linker of Linux")
@pytest.mark.parametrize("how", FAILS)
def test_a_compiler_that_fails_leaves_the_library_and_the_next_call_builds(built, monkeypatch, no_zig, how):
    does, message = FAILS[how]
    path = build.library_path(build.usable_levels(built)[-1], built)
    before = path.read_bytes()
    bad = built / "bad"
    good = f'[ -e {built}/good ] && exec c++ "$@"'  # the same compiler, mended
    bad.write_text(f'#!/bin/sh\n{good}\ncase "$*" in *-c*version.cpp*) {does};;\n*) exec c++ "$@";; esac\n')
    bad.chmod(0o755)
    monkeypatch.setenv("CXX", str(bad))
    with pytest.raises(build.BuildError, match=f"^the core was not built: .*{message}") as error:
        build.build(built)
    assert "\n" not in str(error.value) and path.read_bytes() == before
    assert not list(built.rglob(".[0-9]*"))
    (built / "good").touch()
    assert "was built" in build.build(built)


@pytest.mark.parametrize("asked", ["'", "text"])
def test_what_cannot_be_started_is_passed_over(trial, monkeypatch, capsys, asked):
    (trial / "text").write_text("no program")
    (trial / "text").chmod(0o755)
    monkeypatch.setenv("CXX", asked if asked == "'" else str(trial / asked))
    assert build.find_compiler().command[0] != asked
    assert "does not compile: other compilers are tried" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_named_in_one_sentence(trial):
    (trial / build.OBJECTS).touch()
    with pytest.raises(
        build.BuildError, match=rf"^the core was not built: {trial}/\{build.OBJECTS}: file exists; make"
    ):
        build.build(trial)


@pytest.mark.skipif(sys.platform != "linux", reason="files in the format of Linux")
def test_truncated_libraries_are_built_again_and_never_loaded(built):
    """The system ended the process that loaded one."""
    for path in built.glob("core-*"):
        whole = path.read_bytes()
        for size in (0, 100, len(whole) // 2, len(whole) - 1):
            path.unlink()  # it may be loaded
            path.write_bytes(whole[:size])
            assert build.stamp(path) == {}
    assert "was built" in build.build(built)
    assert loaded(built, build.usable_levels(built)[-1]).version() == 3


@pytest.mark.skipif(build.fcntl is None, reason="needs locks of files")
def test_builds_at_the_same_time_wait_for_each_other(trial):
    (trial / build.OBJECTS).mkdir()
    (trial / build.OBJECTS / ".12-killed.o").touch()
    with ThreadPoolExecutor(3) as pool:
        said = [*pool.map(lambda force: build.build(trial, force=force), [True, False, True])]
    assert sum("was built in" in text for text in said) >= 2, said
    assert loaded(trial, build.usable_levels(trial)[-1]).version() == 3
    assert not list(trial.rglob(".[0-9]*"))


@pytest.mark.slow
def test_the_compiler_of_the_package_index_builds_for_each_level(trial, monkeypatch):
    """Left alone it compiles for the processor at hand."""
    pytest.importorskip("ziglang")
    monkeypatch.setenv("CXX", "ziglang")
    build.build(trial, **ALL)
    assert build.stamp(build.library_path("base", trial))["compiler"].startswith("ziglang: clang")
    monkeypatch.delenv("CXX")
    check_levels(trial)


OUTSIDE = f"""
#include <stdlib.h>
{API} int outside(int n) {{ int *a = (int *)malloc(4 * sizeof(int)); a[n] = 1; int got = a[n]; free(a); return got; }}
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD")
def test_a_sanitizer_stops_at_an_index_beyond_the_end(trial):
    (trial / "outside.cpp").write_text(OUTSIDE)
    compiler = build.find_compiler()
    if compiler.is_zig:
        pytest.skip("sanitizers need GCC or Clang")
    build.build(trial, trial / "out", levels=("base",), sanitize="address,undefined")
    call = f"import ctypes; ctypes.CDLL({str(build.library_path('base', trial / 'out'))!r}).outside(%d)"
    env = os.environ | {"LD_PRELOAD": build.preload("address,undefined"), "ASAN_OPTIONS": "detect_leaks=0"}
    inside, beyond = (
        subprocess.run([sys.executable, "-c", call % n], env=env, capture_output=True, text=True) for n in (3, 4)
    )
    assert inside.returncode == 0, inside.stderr
    assert beyond.returncode != 0 and re.search(r"outside.cpp:3.* runtime error|heap-buffer-overflow", beyond.stderr)
