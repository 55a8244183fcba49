"""Names of the files that runs write into their folders."""

import re
import shlex
from pathlib import Path

from .checkpoint import SCENARIO

NUMBERS, MOVIE = "results.h5", "transition.gif"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # arguments of a call, for `stickslip resume`
LOOK = "look.json"  # how its figures are written
PAGE, FILM = "report.html", "movie.gif"  # written by stickslip report and movie
SERIES, CURVES, THRESHOLD = "series.csv", "curves.csv", "threshold.csv"
EVENTS, STEPS, SLIPS, CYCLES = "events.csv", "steps.csv", "slips.csv", "cycles.csv"
COLLAPSES, PROBES, ENVELOPES = "collapses.csv", "probes.csv", "envelopes.csv"
TABLES = (SERIES, CURVES, THRESHOLD, EVENTS, STEPS, SLIPS, CYCLES, COLLAPSES, PROBES, ENVELOPES)
RUN_FILES = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, MOVIE, *TABLES, PAGE, FILM)
_RUN_FILE = re.compile(
    r"(fig\d_\w+|claims)\.(png|pdf|svg)|steps_\d+_\d+\.csv|(fltst_dp|srfst_fn[+-])\d+(\.\d+)?\.txt|"
    r"(devol|slip|shear_stress|normal_stress)\.dat|" + "|".join(map(re.escape, RUN_FILES))
)
SHOWN = 8  # file names listed in a message


def foreign_files_message(folder: Path, names: list[str]) -> str:
    """Return the message about files that no run wrote."""
    return (
        f"{folder} contains files that stickslip did not write or that have changed since ({join_names(names)}): "
        f"choose another --out, or add --overwrite"
    )


def join_names(names: list[str]) -> str:
    """Join names for a message; if there are many, only the first few are listed."""
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def resume_command(folder: Path) -> str:
    """Return the command that continues a run, as it is typed."""
    return shlex.join(["stickslip", "resume", str(folder)])


def is_run_file(name: str) -> bool:
    """Return True if runs write files with this name."""
    return _RUN_FILE.fullmatch(name) is not None


def list_files(folder: Path) -> list[Path]:
    """Return the sorted paths of the run files in a folder."""
    return sorted(path for path in folder.iterdir() if is_run_file(path.name) and path.is_file())
