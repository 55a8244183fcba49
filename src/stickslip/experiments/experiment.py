"""Description of one experiment: everything that the commands, sweeps, restarts and documentation need."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from ..core.readable import pluralize, readable, words
from ..core.units import in_units
from ..data.schema import ScenarioBase, given_keys


def _empty(result) -> tuple:
    return ()


def _failures(result) -> tuple[str, ...]:
    return tuple(getattr(result, "failures", ()))


class Reproduction(NamedTuple):
    """Result of a paper's scenario, which is stored in the run folder, and the evaluated claims."""

    main: Any
    claims: list


class Paper(NamedTuple):
    """Reproduction of a published experiment; `reproduce` returns a `Reproduction`, or more with its attributes."""

    title: str  # title of the claims table
    cuts: str  # parts that a quick run omits
    scenario: Callable  # (quick, seed) -> scenario of the main run
    reproduce: Callable  # (quick, seed, folder, workers, report) -> reproduction
    shows: Callable  # () -> figures of the paper, their content, and the claims to quote
    name: str | None = None  # for `stickslip reproduce`; None: the name of the experiment
    # functions of the reproduction; None: use the function of the experiment on the main run
    numbers: Callable | None = None
    figures: Callable | None = None
    files: Callable | None = None
    failures: Callable | None = None


class SweepMember(NamedTuple):
    """Member of a sweep, for `compare` of its experiment."""

    values: dict[str, Any]  # of the swept keys
    measures: dict[str, tuple[float, str]]  # with their units; empty if the member is not finished
    archive: Path  # its results.h5


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
    compares: tuple[str, ...] = ()  # names of its files
    paper: Paper | None = None
    more_papers: tuple[Paper, ...] = ()  # others that it reproduces
    smallest: tuple[dict, ...] = ()  # tables of runs that take seconds, for tests of all experiments
    export: Callable | None = None  # (scenario, folder) -> paths of the input that LAMMPS runs elsewhere
    parallel: bool = True  # whether realisations can be distributed over the workers of a cluster
    device: bool = False  # whether `simulate`, and `reproduce` of its paper, can run them on a graphics processor

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
    """Meaning of a measure in a few words, if the experiment gives it."""
    table = table_of(experiment)
    return "" if table is None else table.row(name).meaning


def named_measures(experiment: Experiment, result) -> dict[str, tuple[float, str]]:
    """Return the measures of a result with their units, which are named as in its scenario."""
    units = result.scenario.named_units
    return {name: (float(value), in_units(unit, units)) for name, (value, unit) in experiment.measures(result).items()}
