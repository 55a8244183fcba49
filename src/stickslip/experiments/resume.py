"""What is left of a run that was stopped, for `stickslip resume`."""

import json
from pathlib import Path
from typing import NamedTuple

from ..data.atomic import replace
from ..data.checkpoint import SCENARIO, SWEEP, UNFINISHED, kept_in, under_way
from ..data.law_file import check_sealed
from ..data.manifest import check_hidden, strange
from ..data.schema import Whole
from .registry import read_scenario as read_scenario
from .run_folder import NUMBERS, OPTIONS, REPRODUCTION, install_results, is_run_file, join_names


class UnfinishedRun(NamedTuple):
    """A run that was begun in a folder and is not finished."""

    scenario: Whole | None
    reproduction: dict | None = None  # arguments of `reproduce`, if the run is that of a paper
    sweep: dict | None = None  # tables, if it is one
    figures: bool = False  # whether its members draw theirs


def begin_reproduction(folder: Path, scenario, **arguments) -> None:
    """Note in the folder which paper's run begins there, for `begun`."""
    kept_in(folder, scenario).announce()
    replace(folder / UNFINISHED / REPRODUCTION, json.dumps(arguments).encode())


def begun(folder: Path) -> UnfinishedRun | None:
    """What is unfinished in a folder; None if it is finished.

    Raises
    ------
    ValueError
        with one sentence, if there is no run.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give the one of a run that was stopped")
    check_hidden(folder, is_run_file)
    if (folder / SWEEP).is_file():
        options = folder / OPTIONS
        figures = read_json(options).get("figures", False) if options.is_file() else False
        tables = read_json(folder / SWEEP)
        check_sealed(tables, folder / SWEEP)
        return UnfinishedRun(None, sweep=tables, figures=figures)
    install_results(folder)
    known, arguments = under_way(folder), folder / UNFINISHED / REPRODUCTION
    if known is None and not (folder / SCENARIO).is_file():
        raise ValueError(f"{folder} holds nothing to go on from: begin with stickslip run SCENARIO --out {folder}")
    if known is None and (folder / NUMBERS).is_file():
        return None
    if known and (others := strange(folder, is_run_file)):
        raise ValueError(
            f"{folder} holds what no run of stickslip wrote, or what was changed since ({join_names(others)}): move it "
            f"away, then resume goes on"
        )
    return UnfinishedRun(
        read_scenario(known or folder / SCENARIO), read_json(arguments) if arguments.is_file() else None
    )


def read_json(path: Path) -> dict:
    """What a file of JSON holds; ValueError with one sentence, if it is damaged."""
    try:
        if isinstance(found := json.loads(path.read_text(encoding="utf-8")), dict):
            return found
    except (ValueError, RecursionError):
        pass
    raise ValueError(f"{path} is damaged: begin again, with --overwrite")
