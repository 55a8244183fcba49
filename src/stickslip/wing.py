"""Wings: packages of experiments and commands that stand on the laboratory.

Each has a head, a `Wing`, that an entry point of the group `stickslip.wings` names. Heads are small: they list what
there is, and nothing else of a wing is imported before it is used. This module needs the standard library alone.
"""

import warnings
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

GROUP = "stickslip.wings"


class Selfcheck(NamedTuple):
    """A number that `stickslip doctor` measures and compares."""

    measured: float
    stored: float
    tolerance: float  # relative
    why: str  # reason of the tolerance


class FileFormat(NamedTuple):
    """A format of packings; its functions are imported when such a file is met. "" stands for what it lacks."""

    name: str
    start: bytes = b""  # regular expression: how files that are read begin
    read: str = ""  # "module.function": path -> {name of a frame: arguments of `packings.from_arrays`}
    suffix: str = ""  # of files that are written, as in ".pdb"
    write: str = ""  # "module.function": (path, frames) -> notes on what is not stored


class Wing(NamedTuple):
    """Head of a wing: names of what it adds. Modules are named relative to its package."""

    package: str  # `__package__` of the module of the head
    words: str  # one line
    experiments: Mapping[str, str] = {}  # value of `experiment` in a scenario -> package with its `EXPERIMENT`
    commands: str = ""  # module that adds commands to `stickslip` when it is imported
    selfchecks: str = ""  # "module.function": () -> {name: Selfcheck}
    fault: str = ""  # "module.function": () -> why an external program that the wing needs does not work, or ""
    needs: tuple[str, ...] = ()  # names of the wings that it imports, itself or through others
    formats: tuple[FileFormat, ...] = ()
    pages: tuple[str, ...] = ()  # of documentation: NAME.md in its folder, or a page of the laboratory's documentation

    def module(self, name: str = ""):
        """Import a module of the wing, or its package."""
        return import_module(f"{self.package}.{name}".rstrip("."))

    def function(self, path: str) -> Callable[..., Any]:
        """Import a function, given as "module.function"."""
        module, _, name = path.rpartition(".")
        return getattr(self.module(module), name)


class MissingWingError(ImportError, ValueError):
    """Raised if a wing that is needed is not installed; the message is one sentence (exit code 2)."""


def wings() -> dict[str, Wing]:
    """Heads of the wings that are installed together with those that they need, by name."""
    found = installed()
    return {name: wing for name, wing in found.items() if set(wing.needs) <= set(found)}


@cache
def installed() -> dict[str, Wing]:
    """Heads of all wings that are installed, by name; a broken one is left out with a warning."""
    own = {"papers": 0, "studies": 1, "soils": 2, "faults": 3}  # the order of experiments in lists
    found = sorted(entry_points(group=GROUP), key=lambda entry: (own.get(entry.name, len(own)), entry.name))
    return {entry.name: wing for entry in found if (wing := _load(entry)) is not None}


def add_commands() -> None:
    """Import the modules with the commands of wings."""
    for name, wing in wings().items():
        if wing.commands:
            try:
                wing.module(wing.commands)
            except Exception as problem:  # code of other people
                _warn(name, problem)


def missing_wing(user: str, name: str) -> MissingWingError:
    """Error for something that needs a wing that is not installed."""
    remedy = "install stickslip again, or the package that has this wing"
    return MissingWingError(f"{user} needs the wing {name}, which is not installed: {remedy}")


def without_wing(user: str, problem: ModuleNotFoundError) -> ImportError:
    """Error for an import that failed: a sentence if a wing of this package is missing, otherwise the error itself."""
    package, _, name = (problem.name or "").rpartition(".")
    return missing_wing(user, name) if package == f"{__package__}.wings" else problem


def _load(entry: EntryPoint) -> Wing | None:
    try:
        wing = entry.load()
        if not isinstance(wing, Wing):
            raise TypeError(f"{entry.value} is a {type(wing).__name__}, not a Wing")
    except Exception as problem:  # code of other people
        _warn(entry.name, problem)
        return None
    return wing


def _warn(name: str, problem: Exception) -> None:
    said = " ".join(str(problem).split()) or type(problem).__name__
    warnings.warn(f"the wing {name} cannot be loaded ({said}): repair or uninstall its package", stacklevel=3)
