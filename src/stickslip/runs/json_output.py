"""JSON output of the commands: one object per command, described in docs/command_line.md."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..data.run_files import MEMBERS, UNFINISHED
from ..experiments.registry import DEFAULT, experiment_of, list_files, named_measures

if TYPE_CHECKING:  # these need xarray, SciPy's statistics and Matplotlib
    from .sweep.run import SweepResult

LIBRARIES = ("numpy", "scipy", "h5py")


def show(command: str, fields: dict, **common) -> None:
    """Print the object of a command: the fields common to all commands (see `common_fields`), and its own `fields`."""
    print(to_json(common_fields(command, **common) | fields))


def to_json(answer: dict) -> str:
    """Return an object as ASCII JSON; non-finite numbers are null."""
    return json.dumps(to_jsonable(answer), allow_nan=False)


def to_jsonable(thing):
    """Replace non-finite numbers with None, and NumPy types with built-in types."""
    if isinstance(thing, dict):
        return {str(k): to_jsonable(v) for k, v in thing.items()}
    if isinstance(thing, list | tuple):
        return [to_jsonable(v) for v in thing]
    if isinstance(thing, np.ndarray | np.generic):
        return to_jsonable(thing.tolist())
    if isinstance(thing, float):
        return thing if np.isfinite(thing) else None
    return str(thing) if isinstance(thing, Path) else thing


def common_fields(
    command: str, *, files: Sequence[Path] = (), folder: Path | None = None, status: str = "finished"
) -> dict:
    """Return the fields common to all commands."""
    versions = {"stickslip": __version__} | {name: version(name) for name in LIBRARIES}
    return {"command": command, "status": status, "folder": folder, "files": list(files), "versions": versions}


def describe_run(command: str, folder: Path, result, paths: list[Path], claims=None) -> dict:
    """Describe a run with its measures, and the claims if it reproduces a paper."""
    scenario = result.scenario
    pairs = named_measures(experiment_of(scenario), result)
    measures = {name: {"value": value, "unit": unit} for name, (value, unit) in pairs.items()}
    # the checkpoint remains if results were written although some realisations failed
    status = "incomplete" if (folder / UNFINISHED).is_dir() else "finished"
    out = common_fields(command, files=paths, folder=folder, status=status)
    out |= {"scenario": _scenario_entry(scenario), "measures": measures}
    if failures := getattr(result, "failures", ()):
        out["failures"] = list(failures)
    if claims is not None:
        out["claims"] = [claim._asdict() for claim in claims]
    return out


def describe_finished_run(command: str, folder: Path, scenario) -> dict:
    """Describe a run that was already finished."""
    return common_fields(command, files=list_files(folder), folder=folder) | {"scenario": _scenario_entry(scenario)}


def describe_sweep(command: str, folder: Path, swept: "SweepResult", ranges: dict) -> dict:
    """Describe a sweep: numbers of members, ranges of their measures, and failures with their messages."""
    from .sweep.dataset import DATASET, comparison_files

    failures = {name: message for name, message in zip(swept.names, swept.failures, strict=True) if message}
    total = len(swept.names)
    members = {"total": total, "finished": sum(one is not None for one in swept.found), "reused": swept.reused}
    status = "failed" if failures else "finished"
    more = [folder / name for name in comparison_files() if (folder / name).is_file()]
    files = [folder / DATASET, *more, folder / MEMBERS]
    out = common_fields(command, files=files, folder=folder, status=status)
    experiment = swept.sweep.base.get("experiment", DEFAULT)
    about = {"experiment": experiment, "digest": swept.sweep.digest}
    more = {"members": members | {"failed": len(failures)}, "refused": dict(swept.sweep.refused), "ranges": ranges}
    return out | {"scenario": about} | more | {"remarks": list(swept.remarks), "failures": failures}


def _scenario_entry(scenario) -> dict:
    return {"experiment": scenario.experiment, "digest": scenario.digest}
