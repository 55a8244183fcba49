"""Interrupted runs, for `stickslip resume`."""

import inspect
import json
import shlex
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from ..data.atomic import write_atomically
from ..data.checkpoint import SCENARIO, SWEEP, UNFINISHED, checkpoint_in, unfinished_scenario
from ..data.manifest import check_hidden, find_foreign
from ..data.run_files import LOOK, NUMBERS, OPTIONS, REPRODUCTION, join_names
from ..data.schema import ScenarioBase
from ..experiments.registry import is_run_file, papers, read_tables
from ..experiments.registry import read_scenario as read_scenario
from ..figures.saving import FORMATS, PLAIN, WIDTHS, Look
from .folder import install_results

WHERE = {"folder", "workers", "device", "report"}  # arguments of `reproduce` that do not change what is computed


class UnfinishedRun(NamedTuple):
    """A run that was started in a folder and is not finished."""

    scenario: ScenarioBase | None
    reproduction: dict | None = None  # arguments of `reproduce`, if the run reproduces a paper
    sweep: dict | None = None  # tables, if it is a sweep
    figures: bool = False  # whether the members of the sweep draw figures
    look: Look = PLAIN  # of figures


@cache
def reproduction_arguments(experiment: str) -> type[BaseModel]:
    """Return the arguments of a paper's `reproduce` that define what is computed, as a model with their defaults."""
    function = papers()[experiment].paper.reproduce.resolve()
    kinds, parameters = get_type_hints(function), inspect.signature(function).parameters
    fields: dict[str, Any] = {name: (kinds[name], one.default) for name, one in parameters.items() if name not in WHERE}
    return create_model("Arguments", __config__=ConfigDict(extra="forbid", strict=True), **fields)


def mark_reproduction(folder: Path, scenario, experiment: str, **arguments) -> None:
    """Save the arguments of a reproduction in its folder when it starts, for `find_unfinished`."""
    checkpoint_in(folder, scenario).announce()
    saved = reproduction_arguments(experiment)(**arguments).model_dump(mode="json") | {"experiment": experiment}
    write_atomically(folder / UNFINISHED / REPRODUCTION, json.dumps(saved).encode())


def mark_look(folder: Path, scenario, look: Look) -> None:
    """Save how figures are written in the folder of a run when it starts, for `find_unfinished`."""
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
        If there is no run; the message is one sentence.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder: give the folder of an interrupted run")
    check_hidden(folder, is_run_file)
    if (folder / SWEEP).is_file():
        options = folder / OPTIONS
        known = read_json(options) if options.is_file() else {}
        look = _look_in(known["look"], options) if "look" in known else PLAIN
        return UnfinishedRun(None, None, read_tables(folder / SWEEP), known.get("figures", False), look)
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
    """Read the arguments of `reproduce` that `mark_reproduction` saved; ValueError if they are others."""
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
        if set(look.formats) <= set(FORMATS) and look.width in WIDTHS and isinstance(look.letters, bool):
            return look._replace(formats=tuple(look.formats))
    except TypeError:
        pass
    raise ValueError(_damage_message(path))


def _damage_message(path: Path) -> str:
    return f"{path} is damaged: start again with --overwrite"


def read_json(path: Path) -> dict:
    """Read an object from a JSON file; raise ValueError with a one-sentence message if the file is damaged."""
    try:
        if isinstance(content := json.loads(path.read_text(encoding="utf-8")), dict):
            return content
    except (ValueError, RecursionError):
        pass
    raise ValueError(_damage_message(path))
