"""Folder of a run: checks before the run, and installation of its complete results."""

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

from .. import __version__
from ..data import archive
from ..data.atomic import name_file_in_errors
from ..data.checkpoint import SCENARIO, SWEEP, WRITING, checkpoint_in, remove_checkpoint, unfinished_scenario
from ..data.manifest import allow_overwriting, check_hidden, digest, find_foreign, read_manifest, write_manifest
from ..data.run_files import NUMBERS, foreign_files_message, join_names, resume_command
from ..experiments.registry import is_run_file, list_files
from ..reports.terminal import console


def prepare_folder(folder: Path, scenario, *, overwrite: bool = False) -> None:
    """Check before any computation that results can be written to a folder.

    With `overwrite`, the checkpoint of an unfinished run is removed immediately, and existing results are removed once
    those of the new run are complete.

    Raises
    ------
    ValueError
        If the folder is a file, is not writable, or contains results of another scenario or files that no run wrote.
    """
    check_writable(folder)
    if not folder.is_dir():
        return
    if (folder / SWEEP).exists():
        raise ValueError(f"{folder} contains the results of a sweep: choose another --out")
    install_results(folder)
    others, known = find_foreign(folder, is_run_file), unfinished_scenario(folder) or folder / SCENARIO
    if overwrite:
        _discard_previous(folder, scenario, others)
    elif others:
        raise ValueError(foreign_files_message(folder, others))
    elif known.exists() and known.read_bytes() != scenario.text.encode():
        what = "an unfinished run" if unfinished_scenario(folder) else "the results"
        raise ValueError(f"{folder} contains {what} of another scenario: choose another --out, or add --overwrite")


def check_writable(folder: Path) -> None:
    """Raise ValueError with a one-sentence message if a folder is not writable."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file, not a folder: choose another --out")
    if folder.is_dir():
        check_hidden(folder, is_run_file)
    try:
        _probe(folder)
    except OSError as problem:
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another --out") from None


def _discard_previous(folder: Path, scenario, others: list[str]) -> None:
    """Print what will be replaced, remove the checkpoint of another run, and record which files may be replaced."""
    going = sorted({path.name for path in list_files(folder)} | {name for name in others if is_run_file(name)})
    if name := next((name for name in going if (folder / name).is_dir()), None):
        raise ValueError(
            f"{folder / name} is a folder, but runs write a file of this name: move it away, or choose another --out"
        )
    if going:
        console.print(
            f"--overwrite: {join_names(going)} in {folder} will be replaced or removed when the new results are "
            f"complete.",
            soft_wrap=True,
        )  # fmt: skip
    if others or going or unfinished_scenario(folder):
        remove_checkpoint(folder)
        allow_overwriting(folder, going)
        checkpoint_in(folder, scenario).announce()


def _probe(folder: Path) -> None:
    """Write a temporary file in a folder, then remove it and any folders created for it."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for path in missing:
            if path.exists():
                path.rmdir()


@contextmanager
def staged_results(folder: Path, *, failures=()):
    """Context manager for a staging folder whose files replace those of an earlier run when all are complete.

    The run is then finished, unless members failed, in which case `stickslip resume` runs them again.

    Raises
    ------
    RuntimeError
        If a file from another program is in the way; the message is one sentence, and nothing is replaced or removed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    staging = folder / WRITING
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir()
    try:
        with name_file_in_errors(folder):
            yield staging
        files = {path.name: [digest(path)] for path in staging.iterdir()}
        if unknown := [name for name in files if not is_run_file(name)]:
            raise RuntimeError(
                f"files named {join_names(unknown)} are no files of runs: name them in `writes` of the experiment"
            )
        if others := find_foreign(folder, lambda name: is_run_file(name) or name in files):
            raise RuntimeError(
                f"{folder} contains files that another program wrote during the run ({join_names(others)}): move them "
                f"away, then continue from the saved results with {resume_command(folder)}"
            )
        write_manifest(staging, files)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    install_results(folder)
    if not failures:
        remove_checkpoint(folder)


def install_results(folder: Path) -> None:
    """Move complete results into their folder; if the process is killed midway, the next call finishes the move."""
    staging = folder / WRITING
    new = read_manifest(staging)
    if not all(is_run_file(name) and _is_complete(folder, name, digests) for name, digests in new.items()):
        new = {}
    if NUMBERS not in new or SCENARIO not in new:  # not complete, or not written by a run: it replaces nothing
        return
    if find_foreign(folder, is_run_file):
        return
    old = read_manifest(folder)
    write_manifest(folder, {name: old.get(name, []) + new.get(name, []) for name in old | new})
    for path in list_files(folder):
        if path.name not in new:
            path.unlink()
    for name in new:
        if (staging / name).exists():
            (staging / name).replace(folder / name)
    write_manifest(folder, new)
    shutil.rmtree(staging, ignore_errors=True)


def _is_complete(folder: Path, name: str, digests: list[str]) -> bool:
    """Return True if a new file is in the staging folder, or has been moved from there."""
    return any((place / name).is_file() and digest(place / name) in digests for place in (folder / WRITING, folder))


def save(staging: Path, scenario, numbers: dict) -> None:
    """Write the scenario and the raw numbers."""
    units = scenario.named_units
    if scenario.units is not None:
        numbers["units"] = str(units)
    archive.write(staging / NUMBERS, numbers, scenario=scenario.text, version=__version__, units=units)
    (staging / SCENARIO).write_text(scenario.text, encoding="utf-8")
