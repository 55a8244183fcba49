"""Files that are replaced whole, or not at all: written beside their place, flushed to the disk, renamed."""

import errno
import os
from contextlib import contextmanager, suppress
from pathlib import Path


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


def replace(path: str | Path, content: bytes) -> None:
    """Put a file in place of another, all or nothing; errors as in `beside`."""
    with beside(path) as part:
        part.write_bytes(content)
