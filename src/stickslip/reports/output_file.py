"""Output paths of pages and movies: in the folder of a run, where they count as run files, or in another folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..data.atomic import check_free, replace_atomically
from ..data.manifest import add_to_manifest, digest, find_foreign, read_manifest, write_manifest
from ..data.run_files import FILM, PAGE
from ..figures.page import MARK

MARK_RANGE = 4096  # bytes at the beginning and end of a file that may contain the mark


def default_path(place: Path, name: str) -> Path:
    """Default output path: inside the run folder if there is one, otherwise in the current directory."""
    return place / name if place.is_dir() else Path(f"{place.stem}-{name}")


def check_output(path: Path, endings: tuple[str, ...], *, overwrite: bool = False, made_from=()) -> None:
    """Raise ValueError before any computation if a path is unsuitable or would replace a file from another program.

    Parameters
    ----------
    overwrite : whether any existing file may be replaced; pages and movies of this package may always be replaced
    made_from : files that are never replaced
    """
    if path.suffix.lower() not in endings:
        raise ValueError(f"--out {path} ends with {path.suffix or 'nothing'!r}: use {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise ValueError(f"{path.parent} is not a folder: create it first, or give another --out")
    belongs = _belongs_to_run(path)
    if belongs and not overwrite and find_foreign(path.parent, lambda name: name == path.name):
        raise ValueError(
            f"{path} was not written by stickslip or has changed since: give another --out, or add --overwrite"
        )
    check_free([path], overwrite=overwrite or belongs or _is_own_file(path), made_from=made_from)


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """Context manager for a temporary file that replaces a page or movie.

    A page or movie in the folder of a run is replaced or removed by the next run.
    """
    with replace_atomically(path) as part:
        yield part
        if _belongs_to_run(path):  # recorded before it exists, so that a killed process leaves no unknown file
            known = read_manifest(path.parent)
            write_manifest(path.parent, known | {path.name: [*known.get(path.name, []), digest(part)]})
    if _belongs_to_run(path):
        add_to_manifest(path.parent, path.name)


def _is_own_file(path: Path) -> bool:
    """Return True for a page or movie written by this package, recognised by a mark near its beginning or end."""
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(MARK_RANGE)
        file.seek(max(0, path.stat().st_size - MARK_RANGE))
        return MARK.encode() in head + file.read(MARK_RANGE)


def _belongs_to_run(path: Path) -> bool:
    return path.name in (PAGE, FILM) and bool(read_manifest(path.parent))
