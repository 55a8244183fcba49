"""Announcements of kernel compilation, to progress displays, to the logger `stickslip`, and to people at a keyboard."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

ONCE = "compiling kernels, once per installation"
ALWAYS = "compiling kernels, again in every process, as no folder for them is writable: set NUMBA_CACHE_DIR"

_LOG = logging.getLogger("stickslip")
_LOG.addHandler(logging.NullHandler())
_listeners: list[Callable[[str | None], None]] = []
_compiled: list[str] = []  # by this process
_kept = True


def headline() -> str:
    """Sentence that announces compilation and says how often it happens."""
    return ONCE if _kept else ALWAYS


def forget_afterwards() -> None:
    """Declare that compiled kernels will not last beyond this process."""
    global _kept
    _kept = False


@contextmanager
def announced_to(listener: Callable[[str | None], None]) -> Iterator[None]:
    """Call listener(name of a kernel) when its compilation starts, and listener(None) when it ends."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def start(name: str) -> None:
    """Announce that a kernel is being compiled."""
    if not _compiled:
        words = f"{headline()}: each kind of computation takes a few seconds the first time"
        _LOG.info(words)
        if not _listeners and _somebody_waits():
            print(f"stickslip: {words}", file=sys.stderr)
    _LOG.debug("compiling %s", name)
    _compiled.append(name)
    for listener in _listeners:
        listener(name)


def _somebody_waits() -> bool:
    """Return True in a notebook, or if errors go to a terminal."""
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


def end() -> None:
    """Announce that a kernel has been compiled."""
    for listener in _listeners:
        listener(None)
