"""Progress of what takes a while: every function tells it to one kind of callable.

Short work deep below, such as the compilation of a law, has no such callable: `announced` shows it on the terminal.
"""

import inspect
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing import parent_process
from typing import Annotated

from .arguments import Requirement


def _require_signature(name: str, value: Callable) -> None:
    try:
        inspect.signature(value).bind("stage", 0.0, "text")
    except TypeError:
        raise ValueError(
            f"{name} was given a function of other arguments: it is called as {name}(stage, share done, text)"
        ) from None
    except ValueError:  # a compiled function does not say what it takes
        return


# called as report(name of the stage, its share that is done, text with the relevant quantities)
Report = Annotated[Callable[[str, float, str], None], Requirement(_require_signature)]


def silent(stage: str, share: float, text: str) -> None:
    """Report nothing."""


def within(
    report: Report, begin: float = 0.0, end: float = 1.0, *, stage: str | None = None, prefix: str = ""
) -> Report:
    """Return what reports a part of a longer work.

    Parameters
    ----------
    begin, end : shares of the whole at which the part begins and ends
    stage, prefix : name of the stage, instead of that of the part; and what is put before it

    Examples
    --------
    >>> within(print, 0.5, 1.0, prefix="sample 3: ")("shear", 0.5, "2 pairs")
    sample 3: shear 0.75 2 pairs
    """
    return lambda name, share, text: report(f"{prefix}{stage or name}", begin + (end - begin) * share, text)


@contextmanager
def _line_on_terminal(text: str) -> Iterator[None]:
    """Show a line on standard error while the work lasts, if that is a terminal and this is no worker process."""
    stream = sys.stderr
    if stream is None or not stream.isatty() or os.environ.get("TERM") == "dumb" or parent_process():
        yield
        return
    stream.write(f"{text} …")
    stream.flush()
    try:
        yield
    finally:
        stream.write("\r\x1b[K")
        stream.flush()


_displays: list[Callable[[str], AbstractContextManager]] = [_line_on_terminal]  # the last one is in use


def announced(text: str) -> AbstractContextManager:
    """Context manager that shows what is being done while it lasts."""
    return _displays[-1](text)


def hidden(text: str) -> AbstractContextManager:
    """Display that shows nothing."""
    return nullcontext()


@contextmanager
def displayed_by(display: Callable[[str], AbstractContextManager]) -> Iterator[None]:
    """Let `announced` use another display: a function of the text that returns a context manager."""
    _displays.append(display)
    try:
        yield
    finally:
        _displays.remove(display)
