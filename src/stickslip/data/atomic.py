"""Files that are replaced whole, or not at all: written beside their place, flushed to the disk, renamed."""

import errno
import os
from collections.abc import Iterable
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def named(path: str | Path):
    """Errors of the system within, as of a full disk, name a path: some libraries do not say which file it was."""
    try:
        yield
    except OSError as problem:
        if problem.strerror and not problem.filename:
            problem.filename = str(path)
        raise


@contextmanager
def beside(path: str | Path):
    """A path in the same folder, with the same ending, that takes the place of `path` if all went well.

    Raises
    ------
    OSError
        that names `path`, where it cannot be written; what was there is left alone.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "its folder does not exist: make it first", str(path))
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as problem:
        problem.filename = str(path)
        raise
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def check_free(paths: Iterable[Path], *, overwrite: bool = False, made_from: Iterable[str | Path | None] = ()) -> None:
    """Make sure that files may be written where a user wants them, before anything is computed.

    Parameters
    ----------
    overwrite : whether they may replace what is there
    made_from : files that they never replace

    Raises
    ------
    ValueError
        with one sentence that names the first file that may not be written.
    """
    sources = [Path(path) for path in made_from if path is not None]
    for path in paths:
        if any(path.exists() and source.exists() and path.samefile(source) for source in sources):
            raise ValueError(f"{path} would replace the file that it is made from: give another name")
        if path.is_dir():
            raise ValueError(f"{path} is a folder: give the name of a file")
        if os.path.lexists(path) and not overwrite:
            raise ValueError(f"{path} exists: give another name, or add --overwrite")


def replace(path: str | Path, content: bytes) -> None:
    """Put a file in place of another, all or nothing; errors as in `beside`."""
    with beside(path) as part:
        part.write_bytes(content)
