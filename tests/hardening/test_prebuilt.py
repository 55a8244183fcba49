"""Kernels compiled beforehand are loaded where their stamp fits, and nowhere else."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import llvmlite.binding
import pytest

import stickslip as ss
from stickslip import prebuilt

LEVELS = prebuilt.usable_levels()
pytestmark = pytest.mark.skipif(not LEVELS, reason="needs an x86-64 processor of level 3")


def process(code: list[str], cache: Path, packages: Path | None = None, **more: str) -> subprocess.CompletedProcess:
    env = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", prebuilt.OFF)}
    paths = [str(packages)] if packages else []
    env["PYTHONPATH"] = os.pathsep.join([*paths, *filter(None, [env.get("PYTHONPATH")])])
    env |= {"XDG_CACHE_HOME": str(cache)} | more
    return subprocess.run([sys.executable, *code], capture_output=True, text=True, env=env)


def warm(cache: Path, packages: Path, **more: str) -> int:
    """Number of kernel files that compiling everything for rate and state adds."""
    return json.loads(process(["-m", "stickslip", "warm", "rate-state", "--json"], cache, packages, **more).stdout)[
        "new_files"
    ]


def reason(packages: Path, **more: str) -> str:
    code = "from stickslip import prebuilt; print(prebuilt.find().reason)"
    return process(["-c", code], packages, packages, **more).stdout.strip()


def install(packages: Path) -> None:
    """Leave what pip leaves of an installed distribution."""
    about = packages / f"{prebuilt.PACKAGE}-{ss.__version__}.dist-info"
    about.mkdir(exist_ok=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {prebuilt.PACKAGE}\nVersion: {ss.__version__}\n")


def stamp(packages: Path, **changes) -> None:
    path = packages / prebuilt.PACKAGE / prebuilt.STAMP
    whole = json.loads(path.read_text()) if path.exists() else prebuilt.environment(ss.__version__)
    install(packages)
    path.write_text(json.dumps(whole | changes))


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A package with the kernels of rate and state, as the builder of the wheel makes it."""
    packages = tmp_path_factory.mktemp("packages")
    folder = packages / prebuilt.PACKAGE / LEVELS[-1]
    folder.mkdir(parents=True)
    source = Path(__file__).parents[2] / "release" / "kernels.py"
    spec = importlib.util.spec_from_file_location("kernels", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.compile_level(LEVELS[-1], folder, [["-m", "stickslip", "warm", "rate-state"]])
    (folder.parent / "__init__.py").touch()
    stamp(packages, levels=LEVELS[-1:])
    return packages


@pytest.mark.slow
def test_kernels_are_loaded_from_the_package(built, tmp_path):
    assert warm(tmp_path, built) == 0
    assert warm(tmp_path, built, **{prebuilt.OFF: "1"}) > 0


@pytest.mark.slow
def test_kernels_for_other_settings_are_compiled(built, tmp_path):
    assert warm(tmp_path, built, NUMBA_OPT="2") > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [{"NUMBA_OPT": "2"}, {"NUMBA_BOUNDSCHECK": "1"}, {"NUMBA_ENABLE_AVX": "0"}, {"NUMBA_LOOP_VECTORIZE": "0"}],
)
def test_other_settings_of_numba_have_other_kernels(built, settings):
    code = "from stickslip.kernel_cache import prebuilt_state; print(prebuilt_state())"
    assert process(["-c", code], built, built).stdout.startswith(f"for {LEVELS[-1]}: ")
    assert process(["-c", code], built, built, **settings).stdout.startswith("not used: built from other sources or")


@pytest.fixture
def copied(built, tmp_path):
    """A copy of the package that a test may damage."""
    shutil.copytree(built, tmp_path / "packages")
    return tmp_path / "packages"


def damage_halves(paths):
    for path in paths:
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])


def damage_bits(paths):
    for path in paths:
        whole = bytearray(path.read_bytes())
        whole[len(whole) // 2] ^= 1
        path.write_bytes(bytes(whole))


def damage_order(paths):
    contents = [path.read_bytes() for path in paths]
    for path, content in zip(paths, contents[1:] + contents[:1], strict=True):
        path.write_bytes(content)


def damage_access(paths):
    for path in {one.parent for one in paths}:
        for index in path.glob("*.nbi"):
            index.unlink()
            index.mkdir()  # reading it is an OSError, whoever does it


@pytest.mark.slow
@pytest.mark.parametrize("damage", [damage_halves, damage_bits, damage_order, damage_access])
def test_a_damaged_kernel_is_compiled_again(copied, tmp_path, damage):
    damage(sorted((copied / prebuilt.PACKAGE).rglob("*.nbc")))
    assert warm(tmp_path / "cache", copied) > 0


@pytest.fixture
def stamped(tmp_path):
    """A package without kernels, whose stamp fits."""
    (tmp_path / prebuilt.PACKAGE / LEVELS[-1]).mkdir(parents=True)
    (tmp_path / prebuilt.PACKAGE / "__init__.py").touch()
    stamp(tmp_path, levels=LEVELS[-1:])
    return tmp_path


def test_a_stamp_fits_this_processor_only(stamped):
    assert reason(stamped) == f"for {LEVELS[-1]}"
    assert reason(stamped, NUMBA_CPU_NAME="generic").startswith("not used: NUMBA_CPU_NAME")


def test_kernels_that_lie_in_the_working_directory_are_not_loaded(stamped, monkeypatch):
    """Neither a bare folder on the path, nor anything where the process happens to be."""
    assert reason(stamped) == f"for {LEVELS[-1]}"
    monkeypatch.chdir(stamped)
    code = "from stickslip import prebuilt; print(prebuilt.find().reason)"
    for words in (["-c", code], ["-m", "code", "-q"]):
        done = subprocess.run([sys.executable, *words], input=code, capture_output=True, text=True)
        assert "not installed" in done.stdout, done.stderr
    monkeypatch.undo()
    shutil.rmtree(next(stamped.glob("*.dist-info")))
    assert reason(stamped) == "not installed"


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"numba": "0.1"}, "not used: built for numba 0.1, here it is "),
        ({"stickslip": "9.0"}, f"not used: built for stickslip 9.0, here it is {ss.__version__}"),
        ({"llvmlite": None}, "not used: built for llvmlite None, here it is "),
        ({"python": "cpython 2.7"}, "not used: built for python cpython 2.7, here it is cpython 3."),
        ({"system": "Plan9 mips"}, "not used: built for system Plan9 mips, here it is "),
        ({"levels": ["x86-64-v9"]}, "not used: built for x86-64-v9, which this processor is not"),
    ],
)
def test_a_stamp_that_does_not_fit_is_named(stamped, changes, words):
    stamp(stamped, **changes)
    assert reason(stamped).startswith(words)


@pytest.mark.parametrize("text", [None, "", "[]", "{}", '{"levels": null}', "\0"])
def test_a_stamp_that_cannot_be_read_is_named(tmp_path, text):
    (tmp_path / prebuilt.PACKAGE).mkdir()
    (tmp_path / prebuilt.PACKAGE / "__init__.py").touch()
    install(tmp_path)
    if text is not None:
        (tmp_path / prebuilt.PACKAGE / prebuilt.STAMP).write_text(text)
    assert reason(tmp_path) == "not used: stickslip_kernels has no readable stamp.json"


def test_a_processor_without_a_feature_is_of_a_lower_level(monkeypatch):
    # the x86-64 psABI, section "x86-64 Architecture Levels"
    third = "avx avx2 bmi bmi2 f16c fma lzcnt movbe cx16 sahf popcnt sse3 sse4.1 sse4.2 ssse3 xsave"
    names = {*third.split(), *["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]}
    assert {level: set(features) for level, features in prebuilt.LEVELS.items()} == {
        "x86-64-v4": names, "x86-64-v3": set(third.split()),
    }  # fmt: skip
    for lacking, levels in (
        (set(), ["x86-64-v4", "x86-64-v3"]), ({"avx512vl"}, ["x86-64-v3"]), ({"fma"}, []), (names, []),
    ):  # fmt: skip
        features = dict.fromkeys(names, True) | dict.fromkeys(lacking, False)
        monkeypatch.setattr(llvmlite.binding, "get_host_cpu_features", lambda features=features: features)
        assert prebuilt.usable_levels() == levels
