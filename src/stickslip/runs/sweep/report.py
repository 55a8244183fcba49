"""A complete sweep, with its messages on the terminal."""

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from rich.text import Text

from ...core.progress import silent, within
from ...core.units import in_readable_units
from ...data.checkpoint import ANEW, MEMBERS, SWEEP
from ...data.law_schema import check_law_files
from ...data.manifest import find_foreign, read_manifest, write_manifest
from ...data.run_files import OPTIONS, SCENARIO, foreign_files_message
from ...ensemble import Workers, reach
from ...figures.saving import Look
from ...reports.terminal import console, new_table, progress, show_lines, show_table
from ..folder import check_writable, read_json
from .axes import short_names
from .dataset import DATASET, comparison_files, write_comparison
from .definition import Sweep, describe_differences, member
from .run import (
    MANY,
    SweepResult,
    estimate,
    gather_members,
    is_same_sweep,
    members_of,
    read_finished,
    run_sweep,
    validate_members,
)

LISTED = 10  # largest numbers of listed failures, and of listed measures that no member has
READY = "ready"  # file that marks a sweep that replaces another one as complete


def run_with_progress(
    chosen: Sweep, out: Path, *, workers: Workers, overwrite: bool, figures: bool, look: Look,
    confirm: Callable[[], bool], part: tuple[int, int] | None = None, gather: list[Path] = (),
) -> SweepResult | None:  # fmt: skip
    """Print the number of members, confirm it if there are many, validate them and run the unfinished ones.

    Parameters
    ----------
    confirm : called after the number and the estimated time have been printed, if there are more than MANY members;
        if it returns False, nothing is run
    part, gather : see `run_sweep` and `gather_members`
    """
    where = reach(workers)
    check_writable(out)
    _install_results(out)
    others = _check_folder(out, overwrite)
    target = out / ANEW if _holds_other_sweep(out, chosen, overwrite) or others else out
    if target != out:
        going = ", ".join(name for name in _ours() if (out / name).exists())
        console.print(f"--overwrite: {going} in {out} will be replaced when the new sweep is complete.", markup=False)
    check_law_files(member(chosen, 0).scenario.model_dump())
    console.print(_describe_size(chosen))
    if chosen.count > MANY:
        console.print(f"On {where.words}: {estimate(chosen, target, where.slots)}.")
        if not confirm():
            return None
    with progress() as report:
        names = validate_members(chosen, report if chosen.count > MANY else silent)
        if target != out and not is_same_sweep(target / SWEEP, chosen.text):
            shutil.rmtree(target, ignore_errors=True)
        if count := gather_members(target, chosen, names, gather):
            console.print(f"{count} members gathered from {len(gather)} folders.")
        done, members = _count_finished(target, names), [names[k] for k in sorted(members_of(part, names))]
        if part:
            console.print(f"Part {part[0]} of {part[1]}: {len(members)} members.")
        stage = f"{len(set(members)) - _count_finished(target, members)} members to run" + (
            f", {done} already done" if done else ""
        )
        report(stage, 0.0, f"on {where.words}")
        try:
            swept = run_sweep(
                chosen, target, names=names, workers=workers, figures=figures, look=look, part=part,
                report=within(report, stage=stage),
            )  # fmt: skip
        except KeyboardInterrupt:
            done = _count_finished(target, names)
            console.print(f"{done} of {len(names)} members are finished and saved: repeat the call to run the others.")
            raise
        swept = swept._replace(remarks=write_comparison(target, chosen, swept.names, swept.found, look))
    if target != out:
        if not any(swept.found):
            raise RuntimeError(f"every member failed ({swept.failures[0]}): {out} was left unchanged")
        (target / READY).touch()
        _install_results(out, overwrite=True)
    return swept


@cache
def _ours() -> tuple[str, ...]:
    """Names of the files and folders of a sweep."""
    return SWEEP, OPTIONS, DATASET, *comparison_files(), MEMBERS


def _count_finished(folder: Path, names: list[str]) -> int:
    return sum(read_finished(folder / MEMBERS / name) is not None for name in set(names))


def _describe_size(chosen: Sweep) -> str:
    short = short_names(axis.key for axis in chosen.axes)
    dims = " × ".join(
        f"{' with '.join(short[axis.key] for axis in group)} ({n})"
        for group, n in zip(chosen.groups, chosen.shape, strict=True)
    )
    size = f"Sweep: {chosen.count} member{'s' if chosen.count > 1 else ''}, {dims}."
    return f"{size} {chosen.refusals}".rstrip()


def _check_folder(out: Path, overwrite: bool) -> bool:
    """Return True if a folder contains replaceable files that were not written by a sweep.

    Raises
    ------
    ValueError
        If they may not be replaced.
    """
    if (out / SCENARIO).exists() and not (out / SWEEP).exists():
        raise ValueError(f"{out} contains the results of a run: choose another --out")
    others = find_foreign(out, lambda name: name in _ours())
    if others and not overwrite:
        raise ValueError(foreign_files_message(out, others))
    return bool(others)


def _holds_other_sweep(out: Path, chosen: Sweep, overwrite: bool) -> bool:
    """Return True if a folder contains another sweep (not just other values of the same keys) that may be replaced."""
    if not (out / SWEEP).is_file():
        return False
    try:
        differ = describe_differences(read_json(out / SWEEP), json.loads(chosen.text))
    except ValueError:
        if overwrite:
            return True
        raise
    if differ and not overwrite:
        raise ValueError(f"{out} contains another sweep ({differ}): choose another --out, or add --overwrite")
    return bool(differ)


def _install_results(out: Path, overwrite: bool = False) -> None:
    """Move a complete sweep into place; if the process is killed during the move, the next call finishes it.

    If foreign files must not be overwritten, they and the new sweep stay in their places.
    """
    target = out / ANEW
    if not (target / READY).exists():
        return
    old, new = read_manifest(out), read_manifest(target)
    if SWEEP not in new or (not overwrite and find_foreign(out, lambda name: name in _ours())):
        return
    write_manifest(out, {name: old.get(name, []) + new.get(name, []) for name in old | new})
    for name in _ours():
        if (target / name).exists():
            if (out / name).is_dir():
                shutil.rmtree(out / name)
            (target / name).replace(out / name)
    write_manifest(out, new)
    shutil.rmtree(target)


def describe_empty(names: list[str], written: Callable[[str], str] = str) -> str:
    """Sentence on measures that no member has, without their errors; empty if there are none.

    Parameters
    ----------
    written : function that formats a name
    """
    plain = [name for name in names if not name.endswith("_error")]
    more = f" and {len(plain) - LISTED} more" if len(plain) > LISTED else ""
    return f"Measures without a value in any member: {', '.join(map(written, plain[:LISTED]))}{more}." if plain else ""


def show(swept: SweepResult) -> None:
    """Print the ranges of the measures, and the failures."""
    rows = [output for output in swept.found if output]
    names = ("measure", "unit", "members", "least", "median", "greatest")
    title = f"Measures of {len(rows)} of {len(swept.names)} members"
    table = new_table(*names, title=title, left=("measure", "unit"))
    found = ranges(swept)
    for name, known in found.items():
        if known["members"]:
            cells, unit = in_readable_units([known[which] for which in ("least", "median", "greatest")], known["unit"])
            table.add_row(name, unit, str(known["members"]), *(f"{v:.5g}" for v in cells))
    if rows:
        show_table(table)
    show_lines(swept.remarks)
    if told := describe_empty([name for name, known in found.items() if not known["members"]]):
        console.print(told, soft_wrap=True)
    failed = [(name, failure) for name, failure in zip(swept.names, swept.failures, strict=True) if failure]
    for name, failure in failed[:LISTED]:
        console.print(Text.assemble((name, "yellow"), f": {failure}"), soft_wrap=True)
    if len(failed) > LISTED:
        console.print(f"… and {len(failed) - LISTED} more: see the variable `failure` of the dataset")
    if swept.reused:
        rest = " The sweep is finished: there was nothing to run." if swept.reused == len(set(swept.names)) else ""
        console.print(f"{swept.reused} members were already finished and not run again.{rest}")


def ranges(swept: SweepResult) -> dict[str, dict]:
    """Return {measure: unit, number of members that have it, minimum, median and maximum}."""
    rows, out = [output for output in swept.found if output], {}
    for name, unit in {name: unit for row in rows for name, (_, unit) in row["measures"].items()}.items():
        values = np.array([row["measures"].get(name, (np.nan,))[0] for row in rows])
        values = values[np.isfinite(values)]
        least, median, greatest = (f(values) if len(values) else None for f in (np.min, np.median, np.max))
        out[name] = {"unit": unit, "members": len(values), "least": least, "median": median, "greatest": greatest}
    return out


def failure_summary(swept: SweepResult) -> str | None:
    """Return one sentence if any members failed, otherwise None."""
    failed = sum(map(bool, swept.failures))
    if not failed:
        return None
    return (
        f"{failed} of {len(swept.names)} members failed: the others are saved; repeat the call to rerun the failed ones"
    )
