"""Where pages and movies go: into the folder of a run, to which they belong then, or where a user says."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...data.atomic import beside, check_free
from ...data.manifest import digest, note, note_too, proven, strange
from ...figures.page import MARK
from ..run_folder import FILM, PAGE

MARK_RANGE = 4096  # bytes, in which a mark stands


def default_path(place: Path, name: str) -> Path:
    """Where a page or movie goes: into the folder of a run, or beside nothing else here."""
    return place / name if place.is_dir() else Path(f"{place.stem}-{name}")


def ready(path: Path, endings: tuple[str, ...], *, overwrite: bool = False, made_from=()) -> None:
    """Raise ValueError if a file cannot be meant, or would replace somebody else's, before anything is computed.

    Parameters
    ----------
    overwrite : whether it may replace what is there; pages replace pages of this package anyway, and movies movies
    made_from : files that it never replaces
    """
    if path.suffix.lower() not in endings:
        raise ValueError(f"--out {path} ends with {path.suffix or 'nothing'!r}: {' or '.join(endings)} is written")
    if not path.parent.is_dir():
        raise ValueError(f"{path.parent} is no folder: make it first, or give another --out")
    belongs = _belongs_to_run(path)
    if belongs and not overwrite and strange(path.parent, lambda name: name == path.name):
        raise ValueError(
            f"{path} was not written by stickslip, or was changed since: give another --out, or add --overwrite"
        )
    check_free([path], overwrite=overwrite or belongs or _is_own_file(path), made_from=made_from)


@contextmanager
def staged_file(path: Path) -> Iterator[Path]:
    """What takes the place of a page or movie; one in the folder of a run is replaced or removed by the next run."""
    with beside(path) as part:
        yield part
        if _belongs_to_run(path):  # known before it is there: who is killed in between leaves nothing that is not
            known = proven(path.parent)
            note(path.parent, known | {path.name: [*known.get(path.name, []), digest(part)]})
    if _belongs_to_run(path):
        note_too(path.parent, path.name)


def _is_own_file(path: Path) -> bool:
    """Whether a file is a page or movie that this package wrote: its mark stands near the beginning, or the end."""
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(MARK_RANGE)
        file.seek(max(0, path.stat().st_size - MARK_RANGE))
        return MARK.encode() in head + file.read(MARK_RANGE)


def _belongs_to_run(path: Path) -> bool:
    return path.name in (PAGE, FILM) and bool(proven(path.parent))
