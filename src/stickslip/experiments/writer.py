"""Results of a run as files: raw numbers, scenario, tables, figures and, of a paper, claims."""

from pathlib import Path

from ..figures.style import save as save_figure
from .claims_report import write_claims
from .experiment import Experiment
from .run_folder import files_of, save, staged_results


def write_result(folder: Path, experiment: Experiment, result) -> list[Path]:
    """Write everything that a run leaves, all at once; returns the paths."""
    with staged_results(folder, failures=experiment.failures(result)) as room:
        save(room, result.scenario, experiment.numbers(result))
        _write_files(room, experiment.files(result), experiment.figures(result))
    return files_of(folder)


def write_numbers(folder: Path, experiment: Experiment, result) -> None:
    """Write scenario and raw numbers only, as members of a sweep leave them."""
    with staged_results(folder) as room:
        save(room, result.scenario, experiment.numbers(result))


def write_reproduction(folder: Path, experiment: Experiment, found) -> list[Path]:
    """Write what the reproduction of a paper leaves, with its claims; returns the paths."""
    paper = experiment.paper
    if paper is None:
        raise ValueError(f"{experiment.name} reproduces no paper")

    def of(name: str):
        own = getattr(paper, name)
        return own(found) if own else getattr(experiment, name)(found.main)

    failures = of("failures")
    with staged_results(folder, failures=failures) as room:
        save(room, found.main.scenario, of("numbers"))
        _write_files(room, of("files"), of("figures"))
        write_claims(room, found.claims, paper.shows(), paper.title, failures)
    return files_of(folder)


def _write_files(room: Path, files, figures) -> None:
    for name, write in files:
        write(room / name)
    for name, figure in figures:
        save_figure(figure, room / name)
