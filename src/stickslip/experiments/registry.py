"""Description of an experiment, registry of all experiments, and scenarios from TOML or JSON files or from Python.

A description contains everything that the commands, sweeps, restarts and documentation need.
"""

import json
import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from ..core.arguments import checked, require_options
from ..core.progress import Report, silent
from ..core.readable import pluralize, readable, words
from ..core.text import read_text, shortened
from ..core.units import in_units
from ..data.law_schema import check_law_files, renamed_keys, trust_law_files, with_laws
from ..data.run_files import FIGURES, MANIFEST, NAMES
from ..data.schema import ScenarioBase, ScenarioError, given_keys, validate_scenario
from ..ensemble.pool import Workers
from ..wing import ExperimentEntry, Wing, installed, missing_wing, wings


def _empty(result) -> tuple:
    return ()


def _failures(result) -> tuple[str, ...]:
    return tuple(getattr(result, "failures", ()))


class Reproduction(NamedTuple):
    """Result of a paper's scenario, which is stored in the run folder, and the evaluated claims."""

    main: Any
    claims: list


class Paper(NamedTuple):
    """Reproduction of a published experiment; `reproduce` returns a `Reproduction` or an object with its attributes."""

    title: str  # title of the claims table
    cuts: str  # parts that a quick run omits
    scenario: Callable  # (quick, seed) -> scenario of the main run
    reproduce: Callable  # (quick, seed, folder, workers, report) -> reproduction
    shows: Callable  # () -> figures of the paper, their content, and the claims to quote
    name: str | None = None  # name for `stickslip reproduce`; None: that of the experiment
    # functions of the reproduction; None: use the function of the experiment on the main run
    numbers: Callable | None = None
    figures: Callable | None = None
    files: Callable | None = None
    failures: Callable | None = None


class SweepMember(NamedTuple):
    """Member of a sweep, as passed to `compare` of its experiment."""

    values: dict[str, Any]  # values of the swept keys
    measures: dict[str, tuple[float, str]]  # measures with their units; empty if the member is not finished
    archive: Path  # path of its results.h5


class Comparison(NamedTuple):
    """Figures, texts and remarks on all members of a sweep, or on a run and a laboratory test."""

    files: Mapping[str, Any] = MappingProxyType({})  # Figure, or text of a table, by file name
    remarks: tuple[str, ...] = ()  # sentences


@readable(head=lambda value: value.words)
class Experiment(NamedTuple):
    """One experiment; `lazy_function` defers the import of its modules until they are needed."""

    scenario: type[ScenarioBase]
    words: str  # one line for help and completion
    simulate: Callable  # (scenario, folder=, workers=, report=) -> result, with the scenario in `result.scenario`
    numbers: Callable  # result -> contents of the archive
    measures: Callable  # result -> {name: (value, unit)}, the numbers of a sweep; preferably a table, see `Measures`
    show: Callable  # result -> None; prints a summary
    figures: Callable = _empty  # result -> iterator of (file name, Figure)
    files: Callable = _empty  # result -> iterator of (file name, function that writes it)
    writes: tuple[str, ...] = ()  # regular expressions of the names of these files, which are not figures
    failures: Callable = _failures  # result -> one sentence for each realisation that failed
    announce: Callable = _empty  # scenario -> None; prints the cost of a long run before it starts
    references: Callable = lambda scenario: {}  # scenario -> {purpose: keys of references.bib}
    # (scenario, path of a laboratory's table) -> function of the contents of the archive that returns a Comparison
    overlay: Callable | None = None
    compare: Callable | None = None  # (members of a sweep) -> Comparison
    compares: tuple[str, ...] = ()  # names of the files of a comparison
    paper: Paper | None = None
    more_papers: tuple[Paper, ...] = ()  # further papers that it reproduces
    smallest: tuple[dict, ...] = ()  # tables of runs that take seconds, for tests of all experiments
    export: Callable | None = None  # (scenario, folder) -> paths of the input that LAMMPS runs elsewhere
    parallel: bool = True  # whether realisations can be distributed over the workers of a cluster
    device: bool = False  # whether `simulate`, and `reproduce` of its paper, can use a graphics processor

    @property
    def name(self) -> str:
        """Value of `experiment` in a scenario file."""
        return self.scenario.model_fields["experiment"].default


def result_of(experiment: Experiment, head: Callable | None = None):
    """Decorate the class of an experiment's results with a repr, a table, and `to_dataframe`."""

    def describe(result) -> str:
        failed = _failures(result)
        return result.scenario._summary() + (f"; {pluralize(len(failed), 'failure')}" if failed else "")

    def rows(result):
        yield "experiment", experiment.name, "", experiment.words
        for name, (value, unit) in experiment.measures(result).items():
            if math.isfinite(value):
                yield words(name), value, unit, meaning_of(experiment, name)
        for failure in _failures(result):
            yield "failed", failure
        yield from given_keys(result.scenario)

    def to_dataframe(result):
        """Measures with their units and meanings, one row each, as a pandas DataFrame."""
        import pandas

        named = {k: (*pair, meaning_of(experiment, k)) for k, pair in named_measures(experiment, result).items()}
        return pandas.DataFrame.from_dict(named, orient="index", columns=["value", "unit", "meaning"])

    def decorate(kind):
        kind.to_dataframe = to_dataframe
        return readable(kind, head=head or describe, rows=rows)

    return decorate


def table_of(experiment: Experiment):
    """Table of the quantities that an experiment measures; None if its `measures` is a plain function."""
    table = getattr(experiment.measures, "resolve", lambda: experiment.measures)()
    return table if hasattr(table, "row") else None


def meaning_of(experiment: Experiment, name: str) -> str:
    """Meaning of a measure in a few words; empty if the experiment does not state it."""
    table = table_of(experiment)
    return "" if table is None else table.row(name).meaning


def named_measures(experiment: Experiment, result) -> dict[str, tuple[float, str]]:
    """Return the measures of a result by name, each with its value and its unit, named as in the scenario."""
    units = result.scenario.named_units
    return {name: (float(value), in_units(unit, units)) for name, (value, unit) in experiment.measures(result).items()}


class Experiments(Mapping[str, Experiment]):
    """Experiments of all wings, by the value of `experiment` in a scenario; each is imported when it is used."""

    def entries(self) -> dict[str, tuple[Wing, ExperimentEntry]]:
        """Entry of each experiment in the head of its wing, with this head."""
        return {name: (wing, entry) for wing in wings().values() for name, entry in wing.experiments.items()}

    def __getitem__(self, name: str) -> Experiment:
        wing, entry = self.entries()[name]
        return wing.function(f"{entry.package}.EXPERIMENT")

    def __iter__(self) -> Iterator[str]:
        return iter(self.entries())

    def __len__(self) -> int:
        return len(self.entries())


class Papers(Mapping[str, Experiment]):
    """Experiments that reproduce a paper, each with its paper, by the name for `stickslip reproduce`."""

    def _experiments(self) -> dict[str, str]:
        return {paper: name for name, (_, entry) in EXPERIMENTS.entries().items() for paper in entry.papers}

    def __getitem__(self, name: str) -> Experiment:
        one = EXPERIMENTS[self._experiments()[name]]
        return one._replace(paper={p.name or one.name: p for p in (one.paper, *one.more_papers) if p}[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self._experiments())

    def __len__(self) -> int:
        return len(self._experiments())


EXPERIMENTS, PAPERS = Experiments(), Papers()
DEFAULT = "disk-array"  # experiment of a scenario that names none
LARGEST_INTEGER = 2**63 - 1
INTEGER_RANGE = "integers are limited to 64 bits; use a smaller one or write it as a float such as 1e30"
NAMED_FILES = (("sweep", "draws"), ("packing", "file"), ("packing", "contacts"), ("normal_stress", "file"))
_JSON_TYPES = {list: "an array", str: "a string", bool: "a boolean", type(None): "null"}


def papers() -> Papers:
    """Return the experiments that reproduce a paper, each with its paper, by the name for `stickslip reproduce`."""
    return PAPERS


def with_feature(has: Callable[[Experiment], Any]) -> str:
    """Quoted names of the experiments for which a function is true, for messages; broken ones are left out."""
    names = []
    for name in EXPERIMENTS:
        with suppress(Exception):  # third-party code
            names += [repr(name)] if has(EXPERIMENTS[name]) else []
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


_EVERY_RUN = re.compile("|".join([FIGURES, *map(re.escape, NAMES)]))


def is_run_file(name: str) -> bool:
    """Return True if runs write files with this name."""
    if _EVERY_RUN.fullmatch(name):
        return True
    if name.startswith(".") or name == MANIFEST:
        return False
    entries = EXPERIMENTS.entries()
    loaded = {key: f"{wing.package}.{entry.package}" in sys.modules for key, (wing, entry) in entries.items()}
    for experiment in sorted(entries, key=lambda key: not loaded[key]):  # few names need those not yet imported
        try:
            if any(re.fullmatch(pattern, name) for pattern in EXPERIMENTS[experiment].writes):
                return True
        except Exception:  # third-party code, needed only by its own runs
            continue
    return False


def list_files(folder: Path) -> list[Path]:
    """Return the sorted paths of the run files in a folder."""
    return sorted(path for path in folder.iterdir() if path.is_file() and is_run_file(path.name))


def experiment_of(scenario: ScenarioBase) -> Experiment:
    """Return the experiment of a scenario."""
    return EXPERIMENTS[scenario.experiment]


@checked
def simulate(
    scenario: ScenarioBase,
    *,
    folder: str | Path | None = None,
    workers: Workers = None,
    report: Report = silent,
    **more,
):
    """Run a scenario of any kind and return the result of its experiment.

    Parameters
    ----------
    scenario : from `scenario(...)` or `read_scenario`
    folder : where finished parts are saved during the run; with the same folder, an interrupted run continues
    workers : processes, or the address of a Dask scheduler, for independent realisations (threads for a flow)
    report : called as report(stage, share done, text with the main quantities)
    more : other options of the experiment

    Returns
    -------
    result of the experiment, such as FlowResult, with the scenario as `result.scenario`

    Examples
    --------
    >>> short = scenario(
    ...     load={"push": (0.0, 0.02), "step": 0.01}, dynamics={"loads": ()}
    ... )
    >>> [len(point.spectrum.pairs) for point in simulate(short).path]
    [0, 1, 1]
    """
    check_law_files(scenario.model_dump())
    run = experiment_of(scenario).simulate
    require_options(run.resolve() if hasattr(run, "resolve") else run, more)
    return run(scenario, folder=None if folder is None else Path(folder), workers=workers, report=report, **more)


def scenario_class(tables: dict) -> type[ScenarioBase]:
    """Return the scenario class named by `experiment`, by default that of the disk array."""
    name = tables.get("experiment", DEFAULT)
    for wing in installed().values():
        entry = wing.experiments.get(str(name))
        if entry and (lacking := [need for need in (*wing.needs, *entry.needs) if need not in installed()]):
            raise ScenarioError(str(missing_wing(f"experiment = {name!r}", lacking[0])))
    if not EXPERIMENTS:
        raise ScenarioError(
            f"experiment = {str(name)[:100]!r} is not available, as no wing is installed: install stickslip again"
        )
    if not isinstance(name, str) or name not in EXPERIMENTS:
        near = get_close_matches(str(name).lower().replace("_", "-"), EXPERIMENTS, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ScenarioError(
            f"experiment must be one of {', '.join(map(repr, EXPERIMENTS))}, got {str(name)[:100]!r}{hint}"
        )
    return EXPERIMENTS[name].scenario


@checked
def scenario(*, trust: bool = False, **tables) -> ScenarioBase:
    """Create a scenario from nested dictionaries, as in the TOML file; `experiment` names the experiment.

    Parameters
    ----------
    trust : True if runs may execute the present text of the Python file `law.file`

    Raises
    ------
    ScenarioError
        If the scenario is invalid; the message names the key, the value given and the values allowed.

    Examples
    --------
    >>> tables = {"load": {"push": (0.0, 0.05)}, "dynamics": {"loads": (0.03,)}}
    >>> scenario(array={"disks": 5}, **tables).array.disks
    5
    """
    if trust:
        trust_law_files(tables)
    return validate_scenario(scenario_class(tables), **tables)


@checked
def read_scenario(path: str | Path, *, trust: bool = False) -> ScenarioBase:
    """Read a scenario from a TOML file, or from the canonical text in a run folder; `trust` as in `scenario`."""
    tables = read_tables(path)
    if "sweep" in tables:
        raise ScenarioError(f"{path} has a table [sweep] for many scenarios: use read_sweep, or remove the table")
    return scenario(trust=trust, **tables)


def read_tables(path: str | Path) -> dict:
    """Read the tables of a TOML or JSON file, with absolute paths of the files that they name.

    Raises
    ------
    ScenarioError
        If the file cannot be read.
    """
    path = Path(path)
    try:
        text = read_text(path, remedy="give the path of a TOML file")
    except OSError as problem:
        raise ScenarioError(
            f"the scenario {path} cannot be read ({problem.strerror}): give the path of a TOML file"
        ) from None
    except ValueError as problem:
        raise ScenarioError(str(problem)) from None
    tables = _parse(text, path)
    if not isinstance(tables, dict):
        kind = _JSON_TYPES.get(type(tables), "a number")
        raise ScenarioError(f"the scenario {path} contains {kind}, not an object: give the scenario.json of a run")
    _check_whole_numbers(tables, path)
    tables = with_laws(tables, renamed_keys) if path.suffix == ".json" else tables

    def resolve(table: dict, key: str) -> dict:  # paths are relative to the folder of the scenario
        return table | {key: str(path.parent.absolute() / table[key])} if isinstance(table.get(key), str) else table

    for table, key in NAMED_FILES:
        if isinstance(tables.get(table), dict):
            tables[table] = resolve(tables[table], key)
    return with_laws(tables, lambda law: resolve(law, "file"))


def _parse(text: str, path: Path):
    try:
        return json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise ScenarioError(f"the scenario {path} is not valid TOML: {problem}") from None
    except json.JSONDecodeError as problem:
        raise ScenarioError(f"the scenario {path} is not valid JSON: {problem}") from None
    except RecursionError:
        raise ScenarioError(
            f"the scenario {path} is nested too deeply: at most five levels of tables are allowed"
        ) from None
    except ValueError:  # Python limits the number of digits of integers
        number = max(re.finditer(r"\d[\d_]*", text), key=lambda digits: len(digits[0].replace("_", "")))
        line, digits = text.count("\n", 0, number.start()) + 1, len(number[0].replace("_", ""))
        raise ScenarioError(
            f"the scenario {path}, line {line}, contains an integer of {digits} digits: {INTEGER_RANGE}"
        ) from None


def _check_whole_numbers(tree, path: Path, above: tuple = ()) -> None:
    """Reject integers that other TOML and JSON readers and the result files cannot represent."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree, start=1) if isinstance(tree, list) else ()
    for key, value in items:
        if isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
            where = shortened(".".join(map(str, (*above, key))))
            raise ScenarioError(f"the scenario {path} has an integer beyond 64 bits at {where}: {INTEGER_RANGE}")
        _check_whole_numbers(value, path, (*above, key))
