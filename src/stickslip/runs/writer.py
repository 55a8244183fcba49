"""Output files of a run: raw numbers, scenario, tables, figures and, for a paper, claims."""

from pathlib import Path

from ..core.units import units_in_use
from ..experiments.experiment import Experiment, named_measures
from ..experiments.registry import list_files
from ..figures.saving import PLAIN, Look, render_all
from ..reports.claims_report import write_claims
from .folder import save, staged_results


def write_result(folder: Path, experiment: Experiment, result, look: Look = PLAIN) -> list[Path]:
    """Write all files of a run as a unit and return the paths."""
    with (
        units_in_use(result.scenario.named_units),
        staged_results(folder, failures=experiment.failures(result)) as staging,
    ):
        save(staging, result.scenario, _contents(experiment, result, experiment.numbers(result)))
        _write_files(staging, experiment.files(result), experiment.figures(result), look)
    return list_files(folder)


def write_numbers(folder: Path, experiment: Experiment, result) -> None:
    """Write only the scenario and raw numbers, as for members of a sweep."""
    with staged_results(folder) as staging:
        save(staging, result.scenario, _contents(experiment, result, experiment.numbers(result)))


def _contents(experiment: Experiment, result, numbers: dict) -> dict:
    """Contents of the archive: the numbers of a result, and its measures with their units."""
    pairs = named_measures(experiment, result)
    if measures := {name: {"value": value, "unit": unit} for name, (value, unit) in pairs.items()}:
        numbers["measures"] = measures
    return numbers


def write_reproduction(folder: Path, experiment: Experiment, reproduction, look: Look = PLAIN) -> list[Path]:
    """Write all files of the reproduction of a paper, with its claims, and return the paths."""
    paper = experiment.paper
    if paper is None:
        raise ValueError(f"{experiment.name} does not reproduce a paper")

    def of(name: str):
        own = getattr(paper, name)
        return own(reproduction) if own else getattr(experiment, name)(reproduction.main)

    failures = of("failures")
    with units_in_use(reproduction.main.scenario.named_units), staged_results(folder, failures=failures) as staging:
        save(staging, reproduction.main.scenario, _contents(experiment, reproduction.main, of("numbers")))
        _write_files(staging, of("files"), of("figures"), look)
        write_claims(staging, reproduction.claims, paper.shows(), paper.title, failures, look)
    return list_files(folder)


def _write_files(staging: Path, files, figures, look: Look) -> None:
    for name, write in files:
        write(staging / name)
    for name, figure in figures:
        for each, content in render_all(name, figure, look).items():
            (staging / each).write_bytes(content)
