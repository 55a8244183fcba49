"""Names of the files that runs of any experiment write into their folders; an experiment names its own in `writes`."""

import shlex
from pathlib import Path

SCENARIO, NUMBERS = "scenario.json", "results.h5"
CLAIMS, NOTES, CHART = "claims.json", "claims.md", "claims.png"
REPRODUCTION, OPTIONS = "reproduce.json", "sweep-options.json"  # arguments of a call, for `stickslip resume`
LOOK = "look.json"  # how its figures are written
PAGE, FILM = "report.html", "movie.gif"  # written by stickslip report and movie
NAMES = (SCENARIO, NUMBERS, CLAIMS, NOTES, CHART, PAGE, FILM)
FIGURES = r"(fig\d_\w+|claims)\.(png|pdf|svg)"
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
