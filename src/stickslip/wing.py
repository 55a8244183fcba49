"""Wings: packages of experiments and commands built on the laboratory.

Each has a head, a `Wing`, registered as an entry point of the group `stickslip.wings`. Heads are small: they list the
content of a wing, which is imported on first use. This module needs only the standard library.
"""

import warnings
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

GROUP = "stickslip.wings"


class Selfcheck(NamedTuple):
    """A number that `stickslip doctor` measures and compares."""

    measured: float
    stored: float
    tolerance: float  # relative
    why: str  # reason for the tolerance


class FileFormat(NamedTuple):
    """A file format of packings; its functions are imported on demand. "" stands for a missing function."""

    name: str
    start: bytes = b""  # regular expression for the beginning of readable files
    read: str = ""  # "module.function": path -> {name of a frame: arguments of `packings.from_arrays`}
    suffix: str = ""  # extension of written files, such as ".pdb"
    write: str = ""  # "module.function": (path, frames) -> notes on data that are not stored


class Wing(NamedTuple):
    """Head of a wing: the names of all that it adds. Modules are named relative to its package."""

    package: str  # `__package__` of the module of the head
    words: str  # description in one line
    experiments: Mapping[str, str] = {}  # value of `experiment` in a scenario -> package with its `EXPERIMENT`
    commands: str = ""  # module that adds commands to `stickslip` when it is imported
    selfchecks: str = ""  # "module.function": () -> {name: Selfcheck}
    fault: str = ""  # "module.function": () -> reason why a required external program does not work, or ""
    needs: tuple[str, ...] = ()  # names of the wings that it imports, directly or indirectly
    formats: tuple[FileFormat, ...] = ()
    pages: tuple[str, ...] = ()  # NAME.md in the wing's documentation, or a page of the laboratory

    def module(self, name: str = ""):
        """Import a module of the wing, or its package."""
        return import_module(f"{self.package}.{name}".rstrip("."))

    def function(self, path: str) -> Callable[..., Any]:
        """Import a function, given as "module.function"."""
        module, _, name = path.rpartition(".")
        return getattr(self.module(module), name)


class MissingWingError(ImportError, ValueError):
    """Raised if a required wing is not installed; the message is one sentence (exit code 2)."""


def wings() -> dict[str, Wing]:
    """Heads of the installed wings whose required wings are also installed, by name."""
    found = installed()
    return {name: wing for name, wing in found.items() if set(wing.needs) <= set(found)}


@cache
def installed() -> dict[str, Wing]:
    """Heads of all installed wings, by name; broken ones are skipped with a warning."""
    order = {"papers": 0, "studies": 1, "soils": 2, "faults": 3}  # the order of experiments in lists
    found = sorted(entry_points(group=GROUP), key=lambda entry: (order.get(entry.name, len(order)), entry.name))
    return {entry.name: wing for entry in found if (wing := _load(entry)) is not None}


def experiment_packages() -> dict[str, str]:
    """Packages of the experiments of all wings, by package name: `gouge` is `ss.experiments.gouge`."""
    return {name: f"{wing.package}.{name}" for wing in wings().values() for name in wing.experiments.values()}


def figure_modules() -> dict[str, str]:
    """Modules `figures` of all experiments, by the names of their packages: `ss.figures.gouge`."""
    found = {}
    for wing in wings().values():
        spec = find_spec(wing.package)
        places = [Path(location) for location in spec.submodule_search_locations or ()] if spec else []
        for name in wing.experiments.values():
            if any((location / name / "figures.py").exists() for location in places):
                found[name] = f"{wing.package}.{name}.figures"
    return found


def add_commands() -> None:
    """Import the command modules of the wings."""
    for name, wing in wings().items():
        if wing.commands:
            try:
                wing.module(wing.commands)
            except Exception as problem:  # third-party code
                _warn(name, problem)


def missing_wing(user: str, name: str) -> MissingWingError:
    """Error for a feature that needs a missing wing."""
    remedy = "install stickslip again, or the package that contains this wing"
    return MissingWingError(f"{user} needs the wing {name}, which is not installed: {remedy}")


def without_wing(user: str, problem: ModuleNotFoundError) -> ImportError:
    """Error for a failed import: a sentence if a wing of this package is missing, otherwise the original error."""
    package, _, name = (problem.name or "").rpartition(".")
    return missing_wing(user, name) if package == f"{__package__}.wings" else problem


def _load(entry: EntryPoint) -> Wing | None:
    try:
        wing = entry.load()
        if not isinstance(wing, Wing):
            raise TypeError(f"{entry.value} is a {type(wing).__name__}, not a Wing")
    except Exception as problem:  # third-party code
        _warn(entry.name, problem)
        return None
    return wing


def _warn(name: str, problem: Exception) -> None:
    said = " ".join(str(problem).split()) or type(problem).__name__
    warnings.warn(f"the wing {name} cannot be loaded ({said}): repair or uninstall its package", stacklevel=3)
