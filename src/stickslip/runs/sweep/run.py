"""Run all members of a sweep: each writes the folder of an ordinary run, and together they form one dataset."""

import json
import math
import shutil
import statistics
import tempfile
import time
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

from ... import __version__
from ...core.arguments import checked
from ...core.progress import Report, silent, within
from ...core.readable import readable
from ...data.archive import ArchiveError
from ...data.checkpoint import MEMBERS, SWEEP
from ...data.checkpoint import remove_checkpoint as drop_pieces
from ...data.manifest import add_to_manifest, check_hidden, write_file
from ...data.run_files import NUMBERS, OPTIONS, write_atomically
from ...data.schema import ScenarioBase
from ...ensemble import Workers, run_members, trial
from ...experiments.experiment import named_measures
from ...experiments.registry import experiment_of, is_run_file, list_files
from ...figures.saving import PLAIN, Look
from ...reports.terminal import format_duration
from ..folder import staged_results, write_numbers, write_result
from .axes import short_names
from .dataset import write_sweep
from .definition import Sweep, member, sweep

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
    """Outcome of all members, in order."""

    sweep: Sweep
    names: list[str]
    found: list[dict | None]  # measures and seconds
    failures: list[str]  # error messages, or empty strings
    reused: int  # number of members that were already finished
    remarks: tuple[str, ...] = ()  # on comparisons of the members


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
        with tempfile.TemporaryDirectory() as scratch:  # outside of the sweep's folder, which may be inaccessible
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
        outputs[missing[place]] = _store_output(folder / MEMBERS / names[missing[place]], output)

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
    """Numbers of the members of a part: every n-th one."""
    first, every = part or (1, 1)
    return set(range(first - 1, len(names), every))


def gather_members(folder: Path, chosen: Sweep, names: list[str], parts: list[Path]) -> int:
    """Copy finished members that a folder lacks from folders of parts of the same sweep; return their number.

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


def _store_output(folder: Path, output: MemberOutput) -> dict:
    """Write the files of a member to its folder, and finally its measures, which mark it as finished."""
    if output.files:
        with staged_results(folder) as staging:
            for name, data in output.files.items():
                (staging / name).write_bytes(data)
    known = {"stickslip": __version__, "seconds": output.seconds, "measures": output.measures}
    write_atomically(folder / MEASURES, json.dumps(known, indent=1).encode())
    return known


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
    except ArchiveError:  # damaged checkpoint, or one of another version, without a user to decide
        drop_pieces(folder)
        result = simulate()
    if look:
        write_result(folder, experiment, result, look)
    else:
        write_numbers(folder, experiment, result)
    measures = {name: [value, unit] for name, (value, unit) in named_measures(experiment, result).items()}
    return time.perf_counter() - start, measures
