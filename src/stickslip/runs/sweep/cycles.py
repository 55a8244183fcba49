"""Figure of stick–slip cycles of all members of a sweep: slip since an event, and recurrence."""

from pathlib import Path

import numpy as np

from ...data import archive
from ...data.checkpoint import MEMBERS
from ...data.manifest import write_file
from ...data.run_files import NUMBERS
from ...experiments.registry import EXPERIMENTS, scenario_class
from ...figures.analyses import cycles
from ...figures.saving import PLAIN, Look, render_all
from .definition import Sweep

FIGURE = "cycles.png"
MOST = 500  # members that are drawn
BEFORE, SPAN, POINTS = 0.1, 2.3, 1200  # times of the figure, in median recurrence times, and their number


def write_cycles(
    folder: Path, chosen: Sweep, names: list[str], outputs: list[dict | None], look: Look = PLAIN
) -> Path | None:  # fmt: skip
    """Write the figure into the folder of a sweep, if at least three members of its experiment have cycles."""
    experiment = EXPERIMENTS[scenario_class(chosen.base).model_fields["experiment"].default]
    if experiment.cycles is None:
        return None
    known = {name: _recurrence(output) for name, output in zip(names, outputs, strict=True)}
    known = {name: time for name, time in known.items() if np.isfinite(time)}
    if len(known) < 3:
        return None
    recurrence = np.array(list(known.values()))
    since = np.linspace(-BEFORE, SPAN, POINTS) * np.median(recurrence)
    trees = (archive.read(folder / MEMBERS / name / NUMBERS) for name in list(known)[:MOST])
    curves = [curve for tree in trees if (curve := experiment.cycles(tree, since)) is not None]
    if len(curves) < 3:
        return None
    figure = cycles(since, np.array(curves), recurrence, without=len(names) - len(known))
    for name, content in render_all(FIGURE, figure, look).items():
        write_file(folder, name, content)
    return folder / FIGURE


def _recurrence(output: dict | None) -> float:
    return output["measures"].get("recurrence", (np.nan,))[0] if output else np.nan
