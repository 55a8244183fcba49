"""A sweep from beginning to end, with what it tells on the terminal."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from ..data.kept import MEMBERS, SCENARIO, SWEEP
from ..data.manifest import strange
from ..data.sweep import Sweep, differences, member
from ..data.sweep_data import DATASET
from ..ensemble import Workers, reach
from .report import OPTIONS, STYLE, checked, console, foreign, noted, progress
from .sweep import MANY, Swept, estimate, finished, judged, run_sweep

OURS = (SWEEP, OPTIONS, DATASET, MEMBERS)
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
    _claim(out, overwrite)
    another = _another(out, chosen, overwrite)
    member(chosen, 0)
    console.print(_count(chosen))
    if chosen.count > MANY:
        console.print(f"On {where.words}: {estimate(chosen, out, where.slots)}.")
        if not confirm():
            return None
    with progress() as tell:
        told = (lambda share, words: tell("checking scenarios", share, words)) if chosen.count > MANY else None
        names = judged(chosen, told)
        done = sum(finished(out / MEMBERS / name) is not None for name in set(names)) if out.exists() else 0
        stage = f"{len(set(names)) - done} members to run" + (f", {done} done before" if done else "")
        if another:
            _begin_anew(out)

        def line(share: float, words: str, left: float | None) -> None:
            tell(stage, share, words, left)

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


def _claim(out: Path, overwrite: bool) -> None:
    """Raise ValueError if a sweep cannot go to a folder: it cannot be written, or holds what no sweep wrote."""
    checked(out)
    if (out / SCENARIO).exists() and not (out / SWEEP).exists():
        raise ValueError(f"{out} holds the results of a run: choose another --out")
    others = strange(out, lambda name: name in OURS)
    if others and not overwrite:
        raise ValueError(foreign(out, others))
    going = [name for name in OURS if (out / name).exists()]
    if overwrite and going:
        console.print(f"--overwrite: {', '.join(going)} in {out} will be replaced.")


def _another(out: Path, chosen: Sweep, overwrite: bool) -> bool:
    """Whether a folder holds another sweep, which then is to be replaced; longer lists of values make none of it."""
    if not (out / SWEEP).is_file():
        return False
    try:
        differ = differences(noted(out / SWEEP), json.loads(chosen.text))
    except ValueError:
        if overwrite:
            return True
        raise
    if differ and not overwrite:
        raise ValueError(f"{out} holds another sweep ({differ}): choose another --out, or add --overwrite")
    return bool(differ)


def _begin_anew(out: Path) -> None:
    """Remove what another sweep left; its name last, so that a kill leaves a sweep that can be gone on with."""
    shutil.rmtree(out / MEMBERS, ignore_errors=True)
    for name in (DATASET, OPTIONS, SWEEP):
        (out / name).unlink(missing_ok=True)


def show(swept: Swept) -> None:
    """Ranges of what was measured, and failures."""
    rows = [one for one in swept.found if one]
    table = Table(title=f"Measures of {len(rows)} of {len(swept.names)} members", **STYLE)
    for name in ("measure", "unit", "members", "least", "median", "greatest"):
        table.add_column(name, justify="left" if name in ("measure", "unit") else "right", no_wrap=True)
    for name, known in ranges(swept).items():
        cells = [known[which] for which in ("least", "median", "greatest")] if known["members"] else []
        table.add_row(name, known["unit"], str(known["members"]), *(f"{v:.5g}" for v in cells))
    if rows:
        console.print(table)
    failed = [(name, words) for name, words in zip(swept.names, swept.failures, strict=True) if words]
    for name, words in failed[:LISTED]:
        console.print(Text.assemble((name, "yellow"), f": {words}"), soft_wrap=True)
    if len(failed) > LISTED:
        console.print(f"… and {len(failed) - LISTED} more, see the variable `failure` of the dataset")
    if swept.reused:
        rest = " The sweep is finished: nothing was left to run." if swept.reused == len(set(swept.names)) else ""
        console.print(f"{swept.reused} members were finished before and not run again.{rest}")


def ranges(swept: Swept) -> dict[str, dict]:
    """{measure: unit, how many members have it, least, median and greatest value}."""
    rows, out = [one for one in swept.found if one], {}
    for name, unit in {name: unit for one in rows for name, (_, unit) in one["measures"].items()}.items():
        values = np.array([one["measures"].get(name, (np.nan,))[0] for one in rows])
        values = values[np.isfinite(values)]
        found = (values.min(), np.median(values), values.max()) if len(values) else (None, None, None)
        out[name] = {"unit": unit, "members": len(values)} | dict(
            zip(("least", "median", "greatest"), found, strict=True)
        )
    return out


def verdict(swept: Swept) -> str | None:
    """One sentence if members failed."""
    failed = sum(map(bool, swept.failures))
    if not failed:
        return None
    return f"{failed} of {len(swept.names)} members failed: the others are kept, the same call tries these again"
