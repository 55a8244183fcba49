"""Kernels compiled beforehand, from the optional package `stickslip_kernels`.

`release/kernels.py` builds this package for one operating system, one version each of Python, Numba and llvmlite, and
one or two processor levels. Its stamp records all of these. If anything differs, the prebuilt kernels are ignored,
and kernels are compiled as usual. The package holds only data: `stamp.json` and, for each level, a cache folder as
`kernel_cache` writes it.
"""

import functools
import importlib.metadata
import json
import os
import platform
import sys
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding
import numba

_CONFIG: Any = numba.config
PACKAGE, STAMP = "stickslip_kernels", "stamp.json"
OFF = "STICKSLIP_NO_PREBUILT"  # environment variable that makes this process compile its kernels itself
_V3 = "sse3 ssse3 sse4.1 sse4.2 popcnt cx16 sahf avx avx2 bmi bmi2 f16c fma lzcnt movbe xsave"
# LLVM's names of processor levels, best first, and the features that each may use; other architectures have one level
LEVELS = {"x86-64-v4": f"{_V3} avx512f avx512bw avx512cd avx512dq avx512vl".split(), "x86-64-v3": _V3.split()}


class Prebuilt(NamedTuple):
    """What is installed: a level and its folder if its kernels can be used, otherwise the reason why they cannot."""

    level: str | None
    folder: Path | None
    reason: str


def environment(release: str) -> dict[str, str]:
    """Return what prebuilt kernels depend on besides the sources and the processor.

    Parameters
    ----------
    release : version of stickslip
    """
    return {
        "stickslip": release,
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "python": f"{sys.implementation.name} {sys.version_info.major}.{sys.version_info.minor}{sys.abiflags}",
        "system": f"{platform.system()} {platform.machine()}",
    }


def usable_levels() -> list[str]:
    """Entries of LEVELS whose features this processor has, best first."""
    try:
        present = {name for name, on in llvmlite.binding.get_host_cpu_features().items() if on}
    except RuntimeError:  # LLVM does not know the processor
        return []
    return [level for level, features in LEVELS.items() if present.issuperset(features)]


@functools.cache
def find() -> Prebuilt:
    """Find prebuilt kernels for this process."""
    here = os.getcwd()  # kernels are unpickled: a folder that merely lies in the working directory is not used
    paths = [path for path in sys.path if path and os.path.abspath(path) != here]
    installed = next(iter(importlib.metadata.distributions(name=PACKAGE, path=paths)), None)
    if installed is None:
        return Prebuilt(None, None, "not installed")
    if os.environ.get(OFF, "0") not in ("", "0"):
        return Prebuilt(None, None, f"not used: {OFF} is set")
    if _CONFIG.CPU_NAME is not None or _CONFIG.CPU_FEATURES is not None:
        return Prebuilt(None, None, "not used: NUMBA_CPU_NAME or NUMBA_CPU_FEATURES is set")
    from . import __version__

    base = Path(str(installed.locate_file(PACKAGE)))
    try:
        stamp = json.loads((base / STAMP).read_bytes())
        levels = [str(level) for level in stamp.pop("levels")]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return Prebuilt(None, None, f"not used: {PACKAGE} has no readable {STAMP}")
    for name, value in environment(__version__).items():
        if stamp.get(name) != value:
            return Prebuilt(None, None, f"not used: built for {name} {stamp.get(name)}, here it is {value}")
    level = next((one for one in usable_levels() if one in levels and (base / one).is_dir()), None)
    if level is None:
        return Prebuilt(None, None, f"not used: built for {' and '.join(levels)}, which this processor is not")
    return Prebuilt(level, base / level, f"for {level}")


def key_of(key: tuple) -> tuple:
    """Key of a kernel in the prebuilt index: Numba's key, with the level in place of this processor."""
    signature, (triple, *_), code = key
    return signature, (triple, find().level, ""), code
