"""Progress of what takes a while, reported to one kind of callable, and outcome of a solve."""

import inspect
from collections.abc import Callable
from enum import Enum
from typing import Annotated, NamedTuple

import numpy as np

from .arguments import Requirement
from .readable import pluralize, readable


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


class Status(Enum):
    """Status of a solve. The value of each member is a message for users, including a remedy."""

    CONVERGED = "equilibrium was reached"
    DONE = "the run reached its last step"
    STEPS_SPENT = (
        "equilibrium was not reached in the allowed number of steps: perhaps nothing balances this load; "
        "otherwise allow more steps, or use stronger drag or a tolerance above round-off"
    )
    NOT_A_NUMBER = "a grain's position became infinite or NaN: use a smaller time step or smaller load steps"
    BLOWN_UP = "a grain moved by more than its radius in one time step: use a smaller time step"
    STALLED = "Newton's method stopped converging: use smaller load steps, or damped dynamics"
    SINGULAR = (
        "the Jacobian is singular (a rattler, or sliding without resistance): remove rattlers, or use damped dynamics"
    )
    CONTACT_LOST = "grains flew apart and lost all their contacts: use stronger drag or a smaller load"


@readable(rows=lambda outcome: _rows(outcome))
class Outcome(NamedTuple):
    """Result of a solve."""

    status: Status
    residual: float  # largest unbalanced force or torque/radius [force]
    iterations: int
    where: int = -1  # body with the largest residual, or the one that blew up
    how: str = ""  # description of the solve
    fallback: bool = False  # True if Newton's method failed and damped dynamics was used
    warning: str = ""  # message to the user about a solve that succeeded
    unstable: bool = False  # True if a check found that the equilibrium is unstable
    left: bool = False  # True if a check found that a step of a path left its branch

    @property
    def ok(self) -> bool:
        """True if equilibrium was reached, or the last step of a run without a tolerance."""
        return self.status in (Status.CONVERGED, Status.DONE)

    @property
    def broken(self) -> bool:
        """True if the run blew up, so that its last state is meaningless."""
        return self.status in (Status.NOT_A_NUMBER, Status.BLOWN_UP)

    def __str__(self) -> str:
        if self.broken and self.how:
            return f"{self.status.value} (grain {self.where + 1}, {self.how})"
        at = f", grain {self.where + 1}" if self.where >= 0 and not self.ok else ""
        size = "" if np.isinf(self.residual) else f"residual {self.residual:.3g}{at}, "  # inf: it was not computed
        return f"{self.status.value} ({size}{pluralize(self.iterations, 'iteration')})"


def _rows(outcome: Outcome):
    yield "end", outcome.status.value
    yield "residual", outcome.residual if np.isfinite(outcome.residual) else None, "force", "largest unbalanced force"
    yield "where", f"grain {outcome.where + 1}" if outcome.where >= 0 and not outcome.ok else None
    yield "iterations", outcome.iterations
    yield "how", outcome.how
    yield "fallback", "damped dynamics, because Newton's method failed" if outcome.fallback else None
    yield "warning", outcome.warning


class NotInEquilibriumError(RuntimeError):
    """Error for a run that did not reach a required equilibrium; `outcome` is the outcome of the solve."""

    def __init__(self, sentence: str, outcome: Outcome):
        super().__init__(f"{sentence}: {outcome}")
        self.outcome = outcome
