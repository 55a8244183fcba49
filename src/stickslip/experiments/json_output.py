"""What programs read: one JSON object for each command, described in docs/command_line.md."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from .. import __version__
from ..data.checkpoint import MEMBERS, UNFINISHED
from .registry import experiment_of
from .run_folder import files_of
from .sweep.dataset import DATASET
from .sweep.run import SweepResult

LIBRARIES = ("numpy", "scipy", "numba", "h5py")


def text(answer: dict) -> str:
    """An object as JSON, in letters that every terminal and code page has; what is no number is null."""
    return json.dumps(finite(answer), allow_nan=False)


def finite(thing):
    """The same with None for numbers that are not finite, and without NumPy's types."""
    if isinstance(thing, dict):
        return {str(k): finite(v) for k, v in thing.items()}
    if isinstance(thing, list | tuple):
        return [finite(v) for v in thing]
    if isinstance(thing, np.ndarray | np.generic):
        return finite(thing.tolist())
    if isinstance(thing, float):
        return thing if np.isfinite(thing) else None
    return str(thing) if isinstance(thing, Path) else thing


def common(command: str, *, files: Sequence[Path] = (), folder: Path | None = None, status: str = "finished") -> dict:
    """What every command tells."""
    versions = {"stickslip": __version__} | {name: version(name) for name in LIBRARIES}
    return {"command": command, "status": status, "folder": folder, "files": list(files), "versions": versions}


def of_run(command: str, folder: Path, result, paths: list[Path], claims=None) -> dict:
    """A run, with its measures, and its claims if it is that of a paper."""
    scenario = result.scenario
    found = experiment_of(scenario).measures(result)
    measures = {name: {"value": float(value), "unit": unit} for name, (value, unit) in found.items()}
    # who writes results while some realizations failed keeps the others' pieces
    status = "incomplete" if (folder / UNFINISHED).is_dir() else "finished"
    out = common(command, files=paths, folder=folder, status=status)
    out |= {"scenario": _scenario_entry(scenario), "measures": measures}
    if failures := getattr(result, "failures", ()):
        out["failures"] = list(failures)
    if claims is not None:
        out["claims"] = [claim._asdict() for claim in claims]
    return out


def of_finished(command: str, folder: Path, scenario) -> dict:
    """A run that was finished before; nothing was done now."""
    return common(command, files=files_of(folder), folder=folder) | {"scenario": _scenario_entry(scenario)}


def of_sweep(command: str, folder: Path, swept: SweepResult, ranges: dict) -> dict:
    """A sweep: its members by number, the ranges of their measures, and who failed with which sentence."""
    failures = {name: words for name, words in zip(swept.names, swept.failures, strict=True) if words}
    total = len(swept.names)
    members = {"total": total, "finished": total - sum(map(bool, swept.failures)), "reused": swept.reused}
    status = "failed" if failures else "finished"
    out = common(command, files=[folder / DATASET, folder / MEMBERS], folder=folder, status=status)
    experiment = swept.sweep.base.get("experiment", "disk-array")
    about = {"experiment": experiment, "digest": swept.sweep.digest}
    more = {"members": members | {"failed": len(failures)}, "ranges": ranges}
    return out | {"scenario": about} | more | {"failures": failures}


def _scenario_entry(scenario) -> dict:
    return {"experiment": scenario.experiment, "digest": scenario.digest}
