"""Progress of what takes a while: every function tells it to one kind of callable."""

import inspect
from collections.abc import Callable
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
