"""Run all members of a sweep: each writes the folder of an ordinary run, and together they form one dataset.

On the terminal, a complete sweep shows its size, its progress, the ranges of the measures and the failures.
"""

import json
import math
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.text import Text

from ... import __version__
from ...core.arguments import checked
from ...core.progress import Report, silent, within
from ...core.readable import readable
from ...core.units import in_readable_units
from ...data.archive import ArchiveError
from ...data.checkpoint import remove_checkpoint as drop_pieces
from ...data.law_schema import check_law_files
from ...data.run_files import (
    ANEW,
    MEMBERS,
    NUMBERS,
    OPTIONS,
    SCENARIO,
    SWEEP,
    add_to_manifest,
    check_hidden,
    find_foreign,
    foreign_files_message,
    read_manifest,
    write_atomically,
    write_file,
    write_manifest,
)
from ...data.schema import ScenarioBase
from ...ensemble import Workers, reach, run_members, trial
from ...experiments.registry import experiment_of, is_run_file, list_files, named_measures
from ...figures.style import PLAIN, Look
from ...reports.terminal import console, format_duration, new_table, progress, show_lines, show_table
from ..folder import check_writable, read_json, staged_results, write_numbers, write_result
from .axes import short_names
from .dataset import DATASET, comparison_files, write_comparison, write_sweep
from .definition import Sweep, describe_differences, member, sweep

MEASURES = "measures.json"
MANY = 1000  # number of members above which the user must confirm
FIRST = "first"  # folder of a timed first member
SOME = 50  # number of members whose run times are used for the estimate
PROBE = 20.0  # longest trial run of the first member [s]


class MemberOutput(NamedTuple):
    """Output of a member: its measures, and its files unless they were written in place."""

    seconds: float
    measures: dict  # {name: [value, unit]}
    files: dict[str, bytes]


@readable
class SweepResult(NamedTuple):
    """Outcomes of all members of a sweep, in order."""

    sweep: Sweep
    names: list[str]
    found: list[dict | None]  # measures and seconds
    failures: list[str]  # error messages, or empty strings
    reused: int  # number of members that were already finished
    remarks: tuple[str, ...] = ()  # remarks on comparisons of the members


def validate_members(chosen: Sweep, report: Report = silent) -> list[str]:
    """Validate the scenarios of all members and return their names.

    Raises
    ------
    ScenarioError
        If a member is invalid; the message names the first such member and the key.
    """
    names = []
    for k in range(chosen.count):
        names.append(member(chosen, k).name)
        if (k + 1) % 500 == 0:
            report("checking scenarios", (k + 1) / chosen.count, f"{k + 1} of {chosen.count}")
    return names


def estimate(chosen: Sweep, folder: Path, slots: int) -> str:
    """Return the estimated time for all members and its basis, as a phrase.

    The estimate uses the median time of finished members, or else a trial run of the first member, limited to
    PROBE seconds in a local process.
    """
    some = (read_finished(folder / MEMBERS / member(chosen, k).name) for k in range(min(chosen.count, SOME)))
    known = [output["seconds"] for output in some if output]
    if known:
        seconds, basis = statistics.median(known), "finished members took {:.2g} s"
    else:
        tried = trial(_time_first_member, (chosen.text,), PROBE)
        if tried is None:
            least = PROBE * chosen.count / max(1, slots)
            return f"more than {format_duration(least)}, since the first member takes longer than {PROBE:g} s"
        if tried.failure:
            return f"unknown time, since the first member fails ({tried.failure})"
        seconds, basis = tried.result, "a trial run of the first member took {:.2g} s"
    return f"about {format_duration(seconds * chosen.count / max(1, slots))}: {basis.format(seconds)}"


def _time_first_member(text: str) -> float:
    """Return the run time of the first member in seconds, without one-time costs such as loading kernels."""
    seconds = PROBE
    for _ in range(2):
        with tempfile.TemporaryDirectory() as scratch:  # outside the sweep's folder, which may be inaccessible
            seconds = min(seconds, _run_member(text, 0, str(Path(scratch) / MEMBERS / FIRST), None, silent).seconds)
        if seconds > 0.3 * PROBE:  # a second run might exceed the limit
            break
    return seconds


def read_finished(folder: Path) -> dict | None:
    """Return the measures and the run time in seconds of a member finished by this version, or None.

    The name of the folder identifies the run.
    """
    try:
        if not ((folder / MEASURES).is_file() and (folder / NUMBERS).is_file()):
            return None
        saved = json.loads((folder / MEASURES).read_text(encoding="utf-8"))
        whole = saved["stickslip"] == __version__ and 0 <= saved["seconds"] < math.inf
        plain = all(
            isinstance(value, (int, float)) and isinstance(unit, str) for value, unit in saved["measures"].values()
        )
        return saved if whole and plain else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


@checked
def run_sweep(
    chosen: Sweep,
    folder: str | Path,
    *,
    names: list[str] | None = None,
    workers: Workers = None,
    figures: bool = False,
    look: Look = PLAIN,
    part: tuple[int, int] | None = None,
    report: Report = silent,
) -> SweepResult:
    """Run all members that are not in the folder yet, and write the dataset of all finished ones.

    Parameters
    ----------
    names : names of all members, if already validated
    workers : number of processes, each of which runs one member at a time, or the address of a Dask scheduler
    figures : whether each member also draws its figures
    look : formats and width of figures
    part : (k, n), to run only the k-th of n parts, in a separate folder; `gather_members` joins the folders
    report : called as report(stage, share of the pending work done, text)
    """
    folder, names = Path(folder).resolve(), names or validate_members(chosen)
    (folder / MEMBERS).mkdir(parents=True, exist_ok=True)
    options = {"figures": figures, "look": look._asdict()} | ({"part": part} if part else {})
    write_file(folder, OPTIONS, json.dumps(options).encode())
    write_file(folder, SWEEP, chosen.text.encode())
    add_to_manifest(folder, MEMBERS)
    outputs = [read_finished(folder / MEMBERS / name) for name in names]
    first = {name: k for k, name in reversed(list(enumerate(names)))}  # a sample may contain a scenario twice
    wanted = members_of(part, names)
    failures, missing = [""] * len(names), [k for k in first.values() if k in wanted and outputs[k] is None][::-1]

    def save(place: int, output: MemberOutput) -> None:
        """Write the files of a member to its folder, and finally its measures, which mark it as finished."""
        mine = folder / MEMBERS / names[missing[place]]
        if output.files:
            with staged_results(mine) as staging:
                for name, data in output.files.items():
                    (staging / name).write_bytes(data)
        known = {"stickslip": __version__, "seconds": output.seconds, "measures": output.measures}
        write_atomically(mine / MEASURES, json.dumps(known, indent=1).encode())
        outputs[missing[place]] = known

    tasks = [(chosen.text, k, str(folder / MEMBERS / names[k]), look if figures else None) for k in missing]
    try:
        done = run_members(_run_member, tasks, workers=workers, report=report, save=save)
        for k, result in zip(missing, done, strict=True):
            failures[k] = result.failure or ""
    finally:
        outputs = [outputs[first[name]] for name in names]
        write_sweep(folder, chosen, names, outputs, failures)
    return SweepResult(chosen, names, outputs, failures, len(wanted & {*first.values()}) - len(missing))


def members_of(part: tuple[int, int] | None, names: list[str]) -> set[int]:
    """Numbers of the members that belong to a part: every n-th member."""
    first, every = part or (1, 1)
    return set(range(first - 1, len(names), every))


def gather_members(folder: Path, chosen: Sweep, names: list[str], parts: list[Path]) -> int:
    """Copy the finished members that a folder lacks from folders with parts of its sweep; return their number.

    Raises
    ------
    ValueError
        If a folder does not contain this sweep.
    """
    count = 0
    for part in parts:
        if not is_same_sweep(part / SWEEP, chosen.text):
            raise ValueError(
                f"{part} does not contain this sweep: give folders written with --part for the same scenario"
            )
        check_hidden(part, is_run_file)
        for name in dict.fromkeys(names):
            target, source = folder / MEMBERS / name, part / MEMBERS / name
            if read_finished(source) and not read_finished(target):
                copy = target.with_name(f".{name}")
                for old in (copy, target):
                    shutil.rmtree(old, ignore_errors=True)
                shutil.copytree(source, copy)
                copy.replace(target)
                count += 1
    return count


@lru_cache(1)
def _parse_sweep(text: str) -> Sweep:
    return sweep(**json.loads(text))


def _run_member(text: str, k: int, folder: str, look: Look | None, report) -> MemberOutput:
    """Run one member in any process, in its folder if the process can access it; otherwise return its files."""
    chosen, target = member(_parse_sweep(text), k), Path(folder)
    assert target.name in (chosen.name, FIRST), f"{target.name} is not {chosen.name}"
    short = short_names(chosen.values)
    label = ", ".join(
        f"{short[key]} = {v:.6g}" if isinstance(v, float) else f"{short[key]} = {v}" for key, v in chosen.values.items()
    )
    report(label, 0.0, "started")
    report = within(report, prefix=f"{label}: ")
    if is_same_sweep(target.parent.parent / SWEEP, text):
        return MemberOutput(*_run_in_folder(chosen.scenario, target, look, report), {})
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / target.name
        seconds, measures = _run_in_folder(chosen.scenario, folder, look, report)
        return MemberOutput(seconds, measures, {path.name: path.read_bytes() for path in list_files(folder)})


def is_same_sweep(path: Path, text: str) -> bool:
    """Return True if a file contains the text of a sweep."""
    try:
        return path.read_text(encoding="utf-8") == text
    except (OSError, ValueError):
        return False


def _run_in_folder(scenario: ScenarioBase, folder: Path, look: Look | None, report: Report) -> tuple[float, dict]:
    """Run a scenario, write its files, and return the seconds taken and the measures."""
    start, experiment = time.perf_counter(), experiment_of(scenario)
    simulate = partial(experiment.simulate, scenario, folder=folder, workers=1, report=report)
    try:
        result = simulate()
    except ArchiveError:  # the checkpoint is damaged or of another version, and no user can decide
        drop_pieces(folder)
        result = simulate()
    if look:
        write_result(folder, experiment, result, look)
    else:
        write_numbers(folder, experiment, result)
    measures = {name: [value, unit] for name, (value, unit) in named_measures(experiment, result).items()}
    return time.perf_counter() - start, measures


LISTED = 10  # largest number of listed failures, and of listed measures that no member has
READY = "ready"  # file that marks a complete sweep, which is to replace another one


def run_with_progress(
    chosen: Sweep, out: Path, *, workers: Workers, figures: bool, look: Look, confirm: Callable[[], bool],
    overwrite: bool = False, part: tuple[int, int] | None = None, gather: list[Path] = (),
) -> SweepResult | None:  # fmt: skip
    """Print the number of members, let the user confirm a large number, validate all members, and run unfinished ones.

    Parameters
    ----------
    confirm : called after the number and the estimated time have been printed, if there are more than MANY members;
        if it returns False, nothing is run
    part, gather : see `run_sweep` and `gather_members`
    """
    where = reach(workers)
    check_writable(out)
    _install_results(out)
    target = out / ANEW if _must_replace(out, chosen, overwrite) else out
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


def _must_replace(out: Path, chosen: Sweep, overwrite: bool) -> bool:
    """Return True if a folder contains another sweep (not just other values of the same keys), or foreign files.

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
    if not (out / SWEEP).is_file():
        return bool(others)
    try:
        differ = describe_differences(read_json(out / SWEEP), json.loads(chosen.text))
    except ValueError:
        if overwrite:
            return True
        raise
    if differ and not overwrite:
        raise ValueError(f"{out} contains another sweep ({differ}): choose another --out, or add --overwrite")
    return bool(differ or others)


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
    """Sentence listing measures that no member has, except errors of measures; empty if there are none.

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
