"""A sweep from beginning to end, with what it tells on the terminal."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.table import Table

from ..data.sweep import Sweep, member
from ..data.sweep_data import DATASET
from ..ensemble import Workers, reach
from .report import STYLE, claim_folder, console, duration, progress, show_paths
from .sweep import MANY, MEMBERS, Swept, estimate, finished, judged, run_sweep

LINES = 30.0  # between two lines where there is no terminal [s]
LISTED = 10  # failures that are listed


def simulate(
    chosen: Sweep, out: Path, *, workers: Workers, overwrite: bool, figures: bool, confirm: Callable[[], bool]
) -> Swept | None:
    """Say how many members there are, ask if they are many, judge all, run those that are not finished.

    Parameters
    ----------
    confirm : called after count and estimate were shown, if there are more than MANY members; False runs nothing
    """
    where = reach(workers)
    claim_folder(out, chosen, overwrite=overwrite)
    member(chosen, 0)
    console.print(_count(chosen), highlight=False)
    if chosen.count > MANY:
        console.print(f"On {where.words}: {estimate(chosen, out, where.slots)}.", highlight=False)
        if not confirm():
            return None
    with progress() as tell:
        told = (lambda share, words: tell("checking scenarios", share, words)) if chosen.count > MANY else None
        names = judged(chosen, told)
        done = sum(finished(out / MEMBERS / name) is not None for name in set(names)) if out.exists() else 0
        stage = f"{len(set(names)) - done} members to run" + (f", {done} done before" if done else "")
        line = _lines(lambda share, words, left: tell(stage, share, words, left))
        line(0.0, f"on {where.words}", None)
        try:
            return run_sweep(chosen, out, names=names, workers=workers, figures=figures, report=line)
        except KeyboardInterrupt:
            done = sum(finished(out / MEMBERS / name) is not None for name in set(names))
            console.print(
                f"{done} of {len(names)} members are finished and kept: the same call goes on with the others."
            )
            raise


def _count(chosen: Sweep) -> str:
    dims = " × ".join(
        f"{' with '.join(axis.key for axis in group)} ({n})"
        for group, n in zip(chosen.groups, chosen.shape, strict=True)
    )
    return f"Sweep: {chosen.count} member{'s' if chosen.count > 1 else ''}, {dims}."


def _lines(tell):
    """The same report, and where there is no terminal a line now and then."""
    last = time.monotonic()

    def line(share: float, words: str, left: float | None) -> None:
        nonlocal last
        tell(share, words, left)
        if not console.is_terminal and time.monotonic() - last >= LINES:
            last = time.monotonic()
            console.print(f"  {words}" + (f"; {duration(left)} left" if left else ""), highlight=False)

    return line


def show(swept: Swept, out: Path) -> None:
    """Ranges of what was measured, failures, and where everything is."""
    rows = [one for one in swept.found if one]
    table = Table(title=f"Measures of {len(rows)} of {len(swept.names)} members", **STYLE)
    for name in ("measure", "unit", "members", "least", "median", "greatest"):
        table.add_column(name, justify="left" if name in ("measure", "unit") else "right", no_wrap=True)
    for name, unit in {name: unit for one in rows for name, (_, unit) in one["measures"].items()}.items():
        values = np.array([one["measures"].get(name, (np.nan,))[0] for one in rows])
        values = values[np.isfinite(values)]
        cells = (values.min(), np.median(values), values.max()) if len(values) else ()
        table.add_row(name, unit, str(len(values)), *(f"{v:.5g}" for v in cells))
    if rows:
        console.print(table)
    failed = [(name, words) for name, words in zip(swept.names, swept.failures, strict=True) if words]
    for name, words in failed[:LISTED]:
        console.print(f"[yellow]{name}[/]: {words}", highlight=False, soft_wrap=True)
    if len(failed) > LISTED:
        console.print(f"… and {len(failed) - LISTED} more, see the variable `failure` of the dataset")
    if swept.reused:
        console.print(f"{swept.reused} members were finished before and not run again.", highlight=False)
    show_paths([out / DATASET, out / MEMBERS])


def verdict(swept: Swept) -> str | None:
    """One sentence if members failed."""
    failed = sum(map(bool, swept.failures))
    if not failed:
        return None
    return f"{failed} of {len(swept.names)} members failed: the others are kept, the same call tries these again"
