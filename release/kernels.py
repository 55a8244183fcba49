"""Build a wheel of compiled kernels for this operating system, Python and Numba, into dist/.

python release/kernels.py [--level x86-64-v3]...      # default: every level that this processor can run

The wheel `stickslip_kernels` is optional. With it the first computation of each kind starts at once; without it, or
wherever its stamp does not fit, kernels are compiled on first use. Each level is compiled by `stickslip warm --all`,
the README's snippet, `stickslip doctor` and `stickslip stability`, in a new cache folder.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from stickslip import __version__, prebuilt

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
PROJECT = f"""\
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "stickslip-kernels"
version = "{{version}}"
description = "Compiled kernels of stickslip, for one operating system, Python and Numba"
license = "BSD-3-Clause"
requires-python = "=={sys.version_info.major}.{sys.version_info.minor}.*"
dependencies = ["stickslip=={__version__}", "numba=={{numba}}", "llvmlite=={{llvmlite}}"]

[tool.hatch.build.targets.wheel]
packages = ["{prebuilt.PACKAGE}"]
artifacts = ["*.nbi", "*.nbc"]

[tool.hatch.build.targets.wheel.hooks.custom]
"""
HOOK = """\
from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Hook(BuildHookInterface):
    def initialize(self, version, build_data):
        build_data.update(pure_python=False, tag="{tag}")
"""


RUNS = """\
import sys
import stickslip as ss
name, dim = sys.argv[1], int(sys.argv[2])
for more in ({}, {"damping_n": 0.1, "damping_t": 0.05}):
    for coulomb in ("sharp", "smooth"):
        law = getattr(ss.laws, name)(mu=0.5, coulomb=coulomb, **more)
        state, _ = ss.packings.jammed(60, packing_fraction={2: 0.88, 3: 0.68}[dim], dim=dim, seed=1)
        ss.run(state, law, 20, 0.01, every=10)
"""


def everything() -> list[list[str]]:
    """Arguments of Python for runs that compile all kernels."""
    snippet = (ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    return [
        ["-m", "stickslip", "warm", "--all"], ["-c", snippet], ["-m", "stickslip", "doctor", "--quiet"],
        ["-m", "stickslip", "stability", str(ROOT / "examples" / "sheared_spheres.npz"), "--quiet"],
        *(["-c", RUNS, law, str(dim)] for law in ("hertz_mindlin", "hertz_mindlin_reff", "linear") for dim in (2, 3)),
    ]  # fmt: skip


def plain_environment() -> dict[str, str]:
    """Environment without settings of Numba or stickslip, which could change kernels."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "STICKSLIP_"))}


def compile_level(level: str, folder: Path, runs: list[list[str]]) -> None:
    """Fill a cache folder with kernels for a level of processors."""
    settings = {
        "NUMBA_CACHE_DIR": str(folder), "NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", prebuilt.OFF: "1",
        "PYTHONPATH": str(Path(prebuilt.__file__).parents[1]),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as empty:
        for words in runs:
            subprocess.run([sys.executable, *words], cwd=empty, env=plain_environment() | settings, check=True)
    for path in (folder / "syntax.json", *folder.rglob("*.lock")):
        path.unlink(missing_ok=True)


def missing(package: Path) -> int:
    """Number of files that all runs still add to an empty cache beside a package."""
    with tempfile.TemporaryDirectory() as cache:
        paths = os.pathsep.join([str(Path(prebuilt.__file__).parents[1]), str(package.parent)])
        for words in everything():
            env = plain_environment() | {"XDG_CACHE_HOME": cache, "PYTHONPATH": paths}
            subprocess.run([sys.executable, *words], cwd=cache, env=env, check=True, capture_output=True)
        return len(list(Path(cache).rglob("*.nbc")))


def build(levels: list[str]) -> Path:
    """Build the wheel."""
    environment = prebuilt.environment(__version__)
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / prebuilt.PACKAGE
        for level in levels:
            print(f"compiling for {level}", flush=True)
            compile_level(level, package / level, everything())
        (package / "__init__.py").write_text('"""Compiled kernels of stickslip; see `stickslip.prebuilt`."""\n')
        (package / prebuilt.STAMP).write_text(json.dumps(environment | {"levels": levels}, indent=1))
        if count := missing(package):
            raise SystemExit(f"{count} kernels are not in the package or cannot be loaded from it")
        local = "" if levels == list(prebuilt.LEVELS) else "+" + "-".join(levels).replace("-", ".")
        project = PROJECT.format(
            numba=environment["numba"], llvmlite=environment["llvmlite"], version=f"{__version__}{local}"
        )
        (Path(folder) / "pyproject.toml").write_text(project)
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        system = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        (Path(folder) / "hatch_build.py").write_text(HOOK.format(tag=f"{python}-{python}-{system}"))
        subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel"], cwd=folder, check=True)
        (wheel,) = (Path(folder) / "dist").glob("*.whl")
        DIST.mkdir(exist_ok=True)
        return Path(shutil.move(wheel, DIST / wheel.name))


def main() -> None:
    """Build the wheel and print its path and size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--level", action="append", choices=list(prebuilt.LEVELS), help="default: all that run here")
    asked, here = parser.parse_args().level, prebuilt.usable_levels()
    if not here or set(asked or []) - set(here):
        raise SystemExit(f"this processor runs {' and '.join(here) or 'none of the levels'}: kernels are run once each")
    path = build([level for level in here if level in (asked or here)])
    print(f"{path.relative_to(ROOT)}, {path.stat().st_size / 2**20:.0f} MiB")


if __name__ == "__main__":
    main()
