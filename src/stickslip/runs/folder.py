"""Run folders: checks before a run, writing all run files as a unit, and finding runs for `stickslip resume`."""

import inspect
import json
import shlex
import shutil
import tempfile
from collections.abc import Callable
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from .. import __version__
from ..core.units import units_in_use
from ..data import archive
from ..data.checkpoint import checkpoint_in, remove_checkpoint
from ..data.run_files import (
    LOOK,
    NUMBERS,
    OPTIONS,
    REPRODUCTION,
    SCENARIO,
    SWEEP,
    UNFINISHED,
    WRITING,
    allow_overwriting,
    check_hidden,
    digest,
    find_foreign,
    foreign_files_message,
    join_names,
    name_file_in_errors,
    read_manifest,
    resume_command,
    unfinished_scenario,
    write_atomically,
    write_file,
    write_manifest,
)
from ..data.schema import ScenarioBase
from ..experiments.registry import Comparison, Experiment, is_run_file, list_files, named_measures, papers, read_tables
from ..experiments.registry import read_scenario as read_scenario
from ..figures.style import FORMATS, PLAIN, WIDTHS, Look, render_all
from ..reports.claims import write_claims
from ..reports.terminal import console


def prepare_folder(folder: Path, scenario, *, overwrite: bool = False) -> None:
    """Check before any computation that results can be written to a folder.

    With `overwrite`, the checkpoint of an unfinished run is removed immediately, and existing results are removed once
    those of the new run are complete.

    Raises
    ------
    ValueError
        If the folder is a file, is not writable, or contains results of another scenario or foreign files.
    """
    check_writable(folder)
    if not folder.is_dir():
        return
    if (folder / SWEEP).exists():
        raise ValueError(f"{folder} contains the results of a sweep: choose another --out")
    install_results(folder)
    others, known = find_foreign(folder, is_run_file), unfinished_scenario(folder) or folder / SCENARIO
    if overwrite:
        _discard_previous(folder, scenario, others)
    elif others:
        raise ValueError(foreign_files_message(folder, others))
    elif known.exists() and known.read_bytes() != scenario.text.encode():
        what = "an unfinished run" if unfinished_scenario(folder) else "the results"
        raise ValueError(f"{folder} contains {what} of another scenario: choose another --out, or add --overwrite")


def check_writable(folder: Path) -> None:
    """Raise ValueError if a folder is not writable."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if folder.is_dir():
        check_hidden(folder, is_run_file)
    try:
        _probe(folder)
    except OSError as problem:
        raise ValueError(f"cannot write to the folder {folder} ({problem.strerror}): choose another --out") from None


def _discard_previous(folder: Path, scenario, others: list[str]) -> None:
    """Print and record the files that will be replaced, and remove the checkpoint of another run."""
    going = sorted({path.name for path in list_files(folder)} | {name for name in others if is_run_file(name)})
    if name := next((name for name in going if (folder / name).is_dir()), None):
        raise ValueError(
            f"{folder / name} is a folder, but runs write a file of this name: move it away, or choose another --out"
        )
    if going:
        console.print(
            f"--overwrite: {join_names(going)} in {folder} will be replaced or removed when the new results are "
            f"complete.",
            soft_wrap=True,
        )  # fmt: skip
    if others or going or unfinished_scenario(folder):
        remove_checkpoint(folder)
        allow_overwriting(folder, going)
        checkpoint_in(folder, scenario).announce()


def _probe(folder: Path) -> None:
    """Write a temporary file in a folder, then remove it and any folders created for it."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for path in missing:
            if path.exists():
                path.rmdir()


@contextmanager
def staged_results(folder: Path, *, failures=()):
    """Context manager for a staging folder whose files replace those of an earlier run when all are complete.

    The run is then finished, unless members failed, in which case `stickslip resume` runs them again.

    Raises
    ------
    RuntimeError
        If a file from another program is in the way; the message is one sentence, and nothing is replaced or removed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    staging = folder / WRITING
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir()
    try:
        with name_file_in_errors(folder):
            yield staging
        files = {path.name: [digest(path)] for path in staging.iterdir()}
        if unknown := [name for name in files if not is_run_file(name)]:
            raise RuntimeError(
                f"files named {join_names(unknown)} are not run files: list them in `writes` of the experiment"
            )
        if others := find_foreign(folder, lambda name: is_run_file(name) or name in files):
            raise RuntimeError(
                f"{folder} contains files that another program wrote during the run ({join_names(others)}): move them "
                f"away, then continue from the saved results with {resume_command(folder)}"
            )
        write_manifest(staging, files)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    install_results(folder)
    if not failures:
        remove_checkpoint(folder)


def install_results(folder: Path) -> None:
    """Move complete results into their folder; if the process is killed midway, the next call finishes the move."""
    staging = folder / WRITING
    new = read_manifest(staging)
    for name, digests in new.items():  # each is in the staging folder, or has been moved from there
        there = any((parent / name).is_file() and digest(parent / name) in digests for parent in (staging, folder))
        if not (there and is_run_file(name)):
            return
    if NUMBERS not in new or SCENARIO not in new:  # incomplete, or not written by a run: leave the existing files
        return
    if find_foreign(folder, is_run_file):
        return
    old = read_manifest(folder)
    write_manifest(folder, {name: old.get(name, []) + new.get(name, []) for name in old | new})
    for path in list_files(folder):
        if path.name not in new:
            path.unlink()
    for name in new:
        if (staging / name).exists():
            (staging / name).replace(folder / name)
    write_manifest(folder, new)
    shutil.rmtree(staging, ignore_errors=True)


def save(staging: Path, scenario, numbers: dict) -> None:
    """Write the scenario and the raw numbers into a staging folder."""
    units = scenario.named_units
    if scenario.units is not None:
        numbers["units"] = str(units)
    archive.write(staging / NUMBERS, numbers, scenario=scenario.text, version=__version__, units=units)
    (staging / SCENARIO).write_text(scenario.text, encoding="utf-8")


def write_result(folder: Path, experiment: Experiment, result, look: Look = PLAIN) -> list[Path]:
    """Write all run files as a unit and return their paths."""
    with (
        units_in_use(result.scenario.named_units),
        staged_results(folder, failures=experiment.failures(result)) as staging,
    ):
        _save_result(staging, experiment, result, experiment.numbers(result))
        _write_files(staging, experiment.files(result), experiment.figures(result), look)
    return list_files(folder)


def write_comparison(folder: Path, scenario: ScenarioBase, draw: Callable, look: Look = PLAIN) -> tuple[str, ...]:
    """Write figures that compare a laboratory test with a finished run, and return sentences about them."""
    with units_in_use(scenario.named_units):
        return write_comparison_files(folder, draw(archive.read(folder / NUMBERS)), look)


def write_comparison_files(folder: Path, found: Comparison, look: Look) -> tuple[str, ...]:
    """Write the figures and texts of a comparison into a folder with results, and return its sentences."""
    for name, content in found.files.items():
        files = {name: content.encode()} if isinstance(content, str) else render_all(name, content, look)
        for each, data in files.items():
            write_file(folder, each, data)
    return found.remarks


def is_finished(folder: Path, scenario: ScenarioBase) -> bool:
    """Return True if a folder has the results of a scenario."""
    path = folder / SCENARIO
    finished = (folder / NUMBERS).is_file() and path.is_file() and not (folder / UNFINISHED).is_dir()
    return finished and path.read_bytes() == scenario.text.encode()


def write_numbers(folder: Path, experiment: Experiment, result) -> None:
    """Write only the scenario and raw numbers, as for members of a sweep."""
    with staged_results(folder) as staging:
        _save_result(staging, experiment, result, experiment.numbers(result))


def _save_result(staging: Path, experiment: Experiment, result, numbers: dict) -> None:
    """Write the scenario of a result, and its numbers together with its measures and their units."""
    pairs = named_measures(experiment, result)
    if measures := {name: {"value": value, "unit": unit} for name, (value, unit) in pairs.items()}:
        numbers["measures"] = measures
    save(staging, result.scenario, numbers)


def write_reproduction(folder: Path, experiment: Experiment, reproduction, look: Look = PLAIN) -> list[Path]:
    """Write all files of the reproduction of a paper, with its claims, and return their paths."""
    paper = experiment.paper
    if paper is None:
        raise ValueError(f"{experiment.name} does not reproduce a paper")

    def of(name: str):
        function = getattr(paper, name)
        return function(reproduction) if function else getattr(experiment, name)(reproduction.main)

    failures = of("failures")
    with units_in_use(reproduction.main.scenario.named_units), staged_results(folder, failures=failures) as staging:
        _save_result(staging, experiment, reproduction.main, of("numbers"))
        _write_files(staging, of("files"), of("figures"), look)
        write_claims(staging, reproduction.claims, paper.shows(), paper.title, failures, look)
    return list_files(folder)


def _write_files(staging: Path, files, figures, look: Look) -> None:
    def inside(name: str) -> str:
        if Path(name).name != name:
            raise RuntimeError(f"{name!r} is not a file name: every file is written into the run folder")
        return name

    for name, write in files:
        write(staging / inside(name))
    for name, figure in figures:
        for each, content in render_all(inside(name), figure, look).items():
            (staging / each).write_bytes(content)


WHERE = {"folder", "workers", "device", "report"}  # arguments of `reproduce` that do not change the results


class UnfinishedRun(NamedTuple):
    """An unfinished run in a folder."""

    scenario: ScenarioBase | None
    reproduction: dict | None = None  # arguments of `reproduce`, if the run reproduces a paper
    sweep: dict | None = None  # tables of the sweep, if it is one
    figures: bool = False  # whether the members of the sweep draw figures
    look: Look = PLAIN  # look of figures
    part: tuple[int, int] | None = None  # (k, n) if only the k-th of n parts of a sweep is run here


@cache
def reproduction_arguments(experiment: str) -> type[BaseModel]:
    """Return the arguments of a paper's `reproduce` that determine its results, as a model with their defaults."""
    function = papers()[experiment].paper.reproduce.resolve()  # type: ignore[union-attr]
    kinds, parameters = get_type_hints(function), inspect.signature(function).parameters
    fields: dict[str, Any] = {name: (kinds[name], one.default) for name, one in parameters.items() if name not in WHERE}
    return create_model("Arguments", __config__=ConfigDict(extra="forbid", strict=True), **fields)


def mark_reproduction(folder: Path, scenario, experiment: str, **arguments) -> None:
    """Save the arguments of a reproduction in its folder when it starts, for `find_unfinished`."""
    checkpoint_in(folder, scenario).announce()
    saved = reproduction_arguments(experiment)(**arguments).model_dump(mode="json") | {"experiment": experiment}
    write_atomically(folder / UNFINISHED / REPRODUCTION, json.dumps(saved).encode())


def mark_look(folder: Path, scenario, look: Look) -> None:
    """Save the look of figures in a run folder at the start, for `find_unfinished`."""
    if look != PLAIN:
        checkpoint_in(folder, scenario).announce()
        write_atomically(folder / UNFINISHED / LOOK, json.dumps(look._asdict()).encode())
    else:
        (folder / UNFINISHED / LOOK).unlink(missing_ok=True)


def find_unfinished(folder: Path) -> UnfinishedRun | None:
    """Return the unfinished run in a folder, or None if the run is finished.

    Raises
    ------
    ValueError
        If the folder contains no run to resume.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: give the folder of an interrupted run")
    check_hidden(folder, is_run_file)
    if (folder / SWEEP).is_file():
        options = folder / OPTIONS
        given = read_json(options) if options.is_file() else {}
        look = _look_in(given["look"], options) if "look" in given else PLAIN
        part = given.get("part")
        return UnfinishedRun(
            None, None, read_tables(folder / SWEEP), given.get("figures", False), look, part and tuple(part)
        )
    install_results(folder)
    known, arguments = unfinished_scenario(folder), folder / UNFINISHED / REPRODUCTION
    if known is None and not (folder / SCENARIO).is_file():
        raise ValueError(
            f"{folder} contains nothing to resume: start with stickslip run SCENARIO --out {shlex.quote(str(folder))}"
        )
    if known is None and (folder / NUMBERS).is_file():
        return None
    if known and (others := find_foreign(folder, is_run_file)):
        raise ValueError(
            f"{folder} contains files that stickslip did not write or that have changed since ({join_names(others)}): "
            f"move them away, then resume again"
        )
    reproduction = _read_arguments(arguments) if arguments.is_file() else None
    look = _look_in(read_json(path), path) if (path := folder / UNFINISHED / LOOK).is_file() else PLAIN
    return UnfinishedRun(read_scenario(known or folder / SCENARIO), reproduction, look=look)


def _read_arguments(path: Path) -> dict:
    """Read the arguments of `reproduce` saved by `mark_reproduction`; raise ValueError if they are invalid."""
    saved = read_json(path)
    experiment = saved.pop("experiment", None)
    if not isinstance(experiment, str) or experiment not in papers():
        raise ValueError(_damage_message(path))
    try:
        arguments = reproduction_arguments(experiment).model_validate_json(json.dumps(saved))
    except ValidationError as problem:
        wrong = ", ".join(".".join(map(str, one["loc"])) for one in problem.errors())
        raise ValueError(f"{_damage_message(path)} (wrong: {wrong})") from None
    return {"experiment": experiment} | dict(arguments)


def _look_in(options, path: Path) -> Look:
    try:
        look = Look(**options)
        plain = isinstance(look.letters, bool) and isinstance(look.slides, bool)
        if set(look.formats) <= set(FORMATS) and look.width in WIDTHS and plain:
            return look._replace(formats=tuple(look.formats))
    except TypeError:
        pass
    raise ValueError(_damage_message(path))


def _damage_message(path: Path) -> str:
    return f"{path} is damaged: start again with --overwrite"


def read_json(path: Path) -> dict:
    """Read an object from a JSON file; raise ValueError if the file is damaged."""
    try:
        if isinstance(content := json.loads(path.read_text(encoding="utf-8")), dict):
            return content
    except (ValueError, RecursionError):
        pass
    raise ValueError(_damage_message(path))
