"""Wings: packages of experiments and commands built on the laboratory.

Each has a head, a `Wing`, registered as an entry point of the group `stickslip.wings`. Heads are small: they list the
content of a wing, which is imported on first use. This module needs only the standard library.
"""

import re
import sys
import warnings
from collections.abc import Mapping
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from traceback import walk_tb
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


class Command(NamedTuple):
    """A command of `stickslip`; its module is imported when it is used."""

    name: str
    words: str  # its line in `stickslip --help`
    function: str  # "module.function", decorated with `command`
    needs: tuple[str, ...] = ()  # names of the wings that it imports, directly or indirectly


class ExperimentEntry(NamedTuple):
    """An experiment in the head of a wing."""

    package: str  # with its `EXPERIMENT`
    needs: tuple[str, ...] = ()  # names of the wings that it imports, directly or indirectly
    papers: tuple[str, ...] = ()  # names for `stickslip reproduce`
    meant_by: str = ""  # words with which users look for it, separated by spaces


class Wing(NamedTuple):
    """Head of a wing: the names of all that it adds. Modules are named relative to its package."""

    package: str  # `__package__` of the module of the head
    words: str  # description in one line
    experiments: Mapping[str, Any] = {}  # value of `experiment` in a scenario -> `ExperimentEntry`, or package alone
    commands: tuple[Command, ...] = ()
    selfchecks: str = ""  # "module.function": () -> {name: Selfcheck}
    fault: str = ""  # "module.function": () -> reason why a required external program does not work, or ""
    needs: tuple[str, ...] = ()  # names of the wings without which nothing of it works
    formats: tuple[FileFormat, ...] = ()
    pages: tuple[str, ...] = ()  # NAME.md in the wing's documentation, or a page of the laboratory

    def function(self, path: str) -> Any:
        """Import a function or a value, given as "module.name"; a failure of third-party code names its package."""
        module, _, name = path.rpartition(".")
        try:
            with redirect_stdout(sys.stderr):  # standard output is the answer of a command
                return getattr(import_module(f"{self.package}.{module}".rstrip(".")), name)
        except (Exception, SystemExit) as problem:
            if self.package.startswith(f"{__package__}."):
                raise
            raise MissingWingError(
                f"{path} of the wing {self.package} cannot be imported ({_said(problem)}): repair or uninstall it"
            ) from problem

    def folders(self) -> list[Path]:
        """Folders of its package."""
        spec = find_spec(self.package)
        return [Path(location) for location in (spec and spec.submodule_search_locations) or ()]


class MissingWingError(ImportError, ValueError):
    """Raised if a required wing is not installed or is broken; the message is one sentence (exit code 2)."""


def wings() -> dict[str, Wing]:
    """Heads of the installed wings, by name, without all that needs a wing that is not installed."""
    found = installed()

    def usable(one) -> bool:
        return found.keys() >= {*one.needs}

    return {
        name: wing._replace(
            experiments={key: one for key, one in wing.experiments.items() if usable(one)},
            commands=tuple(filter(usable, wing.commands)),
        )
        for name, wing in found.items()
        if usable(wing)
    }


@cache
def installed() -> dict[str, Wing]:
    """Heads of all installed wings, by name, without broken or repeated parts, which a warning names."""
    order = {"papers": 0, "studies": 1, "soils": 2, "faults": 3}  # the order of experiments in lists
    found: dict[str, Wing] = {}
    taken: set[tuple[str, str]] = set()
    for entry in sorted(
        entry_points(group=GROUP),
        key=lambda entry: (
            not entry.value.startswith(f"{__package__}."), order.get(entry.name, len(order)), entry.name
        ),
    ):  # fmt: skip
        try:
            if entry.name in found:
                raise ValueError("a wing of this name is loaded already")
            with redirect_stdout(sys.stderr):
                wing = entry.load()
            if not isinstance(wing, Wing):
                raise TypeError(f"{entry.value} is a {type(wing).__name__}, not a Wing")
            if not isinstance(wing.words, str) or not _has_module(wing.package):
                raise ValueError("`package` must be the name of its package, and `words` a text")
        except (Exception, SystemExit) as problem:  # third-party code
            _warn(entry, "cannot be loaded", _said(problem))
            continue
        found[entry.name], wrong = _sound(wing, taken)
        if wrong:
            _warn(entry, "is loaded only in part", "; ".join(wrong))
    return found


def failure_of_foreign_wing(problem: BaseException) -> str | None:
    """One sentence if an exception passed through a wing of another package, with its place there; otherwise None."""
    own = f"{__package__}."
    foreign = [(name, wing.package) for name, wing in installed().items() if not wing.package.startswith(own)]
    for frame, line in reversed([*walk_tb(problem.__traceback__)]):
        module = f"{frame.f_globals.get('__name__')}."
        for name in (name for name, package in foreign if module.startswith(f"{package}.")):
            where = f"{Path(frame.f_code.co_filename).name}, line {line}"
            return (
                f"the wing {name} failed in {where} ({type(problem).__name__}: {_said(problem)}): report it to its "
                f"authors, with the traceback of `python -X dev -m {__package__}`"
            )
    return None


def experiment_packages() -> dict[str, str]:
    """Packages of the experiments of all wings, by package name: `gouge` is `ss.experiments.gouge`."""
    return {
        one.package: f"{wing.package}.{one.package}" for wing in wings().values() for one in wing.experiments.values()
    }


def figure_modules() -> dict[str, str]:
    """Modules `figures` of all experiments, by the names of their packages: `ss.figures.gouge`."""
    found = {}
    for wing in wings().values():
        for name in (one.package for one in wing.experiments.values()):
            if any((folder / name / "figures.py").exists() for folder in wing.folders()):
                found[name] = f"{wing.package}.{name}.figures"
    return found


def missing_wing(user: str, name: str) -> MissingWingError:
    """Error for a feature that needs a missing wing."""
    remedy = "install stickslip again, or the package that contains this wing"
    return MissingWingError(f"{user} needs the wing {name}, which is not installed: {remedy}")


def without_wing(user: str, problem: ModuleNotFoundError) -> ImportError:
    """Error for a failed import: a sentence if a wing of this package is missing, otherwise the original error."""
    package, _, name = (problem.name or "").rpartition(".")
    return missing_wing(user, name) if package == f"{__package__}.wings" else problem


SAMPLES: dict[str, Any] = {  # parts of a head, each with a sample of its entries
    "experiments": ExperimentEntry(""), "commands": Command("", "", ""), "formats": FileFormat(""), "needs": "",
    "pages": "", "selfchecks": "", "fault": "",
}  # fmt: skip


def _sound(wing: Wing, taken: set[tuple[str, str]]) -> tuple[Wing, list[str]]:
    """The head without broken parts and taken names, to which its own are added, and the faults found in it."""
    parts: dict[str, Any] = {}
    wrong = []
    for field in SAMPLES:
        value, default = getattr(wing, field), Wing._field_defaults[field]
        kinds = list if isinstance(default, tuple) else Mapping if isinstance(default, dict) else str
        if not isinstance(value, (kinds, type(default))):
            wrong.append(f"{field} must be a {type(default).__name__}, got {type(value).__name__}")
            value = default
        kept = {}
        for name, one in value.items() if kinds is Mapping else enumerate([value] if kinds is str else value):
            one = ExperimentEntry(one) if field == "experiments" and isinstance(one, str) else one
            try:
                _check(wing.package, field, name, one, taken)
                kept[name] = one
            except ValueError as problem:
                wrong.append(f"{field}: {problem}"[:200])
        parts[field] = kept if kinds is Mapping else kept.get(0, "") if kinds is str else tuple(kept.values())
    return wing._replace(**parts), wrong


def _check(package: str, field: str, name: Any, one: Any, taken: set[tuple[str, str]]) -> None:
    """Check one part of a head, and add its names to those taken; raise ValueError if it cannot be used."""
    sample = SAMPLES[field]
    inner = [*map(type, one)] if isinstance(one, tuple) else []
    texts = [name] if field == "experiments" else []
    texts += [text for value in one if isinstance(value, tuple) for text in value] if inner else []
    if type(one) is not type(sample) or (inner and inner != [*map(type, sample)]) or {*map(type, texts)} - {str}:
        form = f"have the form {sample!r}" if isinstance(sample, tuple) else "be a str"
        raise ValueError(f"{one!r} must {form}")
    names: list[tuple[str, str]] = []
    paths = [one] if field in ("selfchecks", "fault") else []
    if field == "experiments":
        names = [("experiment", str(name)), ("package", one.package), *(("paper", paper) for paper in one.papers)]
        paths = [f"{one.package}.EXPERIMENT"]
    elif field == "commands":
        names, paths = [("command", one.name)], [one.function]
    elif field == "formats":
        names, paths = [("file extension", one.suffix)] if one.suffix else [], [one.read, one.write]
        try:
            re.compile(one.start)
        except re.error as problem:
            raise ValueError(f"the regular expression {one.start!r} of {one.name} is invalid ({problem})") from None
    for module in (path.partition(".")[0] for path in paths if "." in path):
        if not _has_module(package, module):
            raise ValueError(f"{package} has no module {module}")
    if clash := sorted(taken.intersection(names)):
        raise ValueError(f"{' '.join(clash[0])} exists already")
    taken.update(names)


def _has_module(*parts: str) -> bool:
    try:
        return find_spec(".".join(parts)) is not None
    except (Exception, SystemExit):  # third-party code
        return False


def _warn(entry: EntryPoint, what: str, said: str) -> None:
    owner = f" of {entry.dist.name} {entry.dist.version}" if entry.dist else ""
    message = f"the wing {entry.name}{owner} {what} ({said}): repair or uninstall its package"
    warnings.warn(" ".join(message.split()), stacklevel=3)


def _said(problem: BaseException) -> str:
    return " ".join(str(problem).split()) or type(problem).__name__
