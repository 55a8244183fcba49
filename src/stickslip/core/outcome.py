"""How a solve ended: data first, exception second."""

from enum import Enum
from typing import NamedTuple

from .readable import readable


class Status(Enum):
    """Each member is the sentence that a user should read, remedy included."""

    CONVERGED = "equilibrium was reached"
    DONE = "the run reached its last step"
    STEPS_SPENT = (
        "equilibrium was not reached in the allowed number of steps: perhaps nothing holds this load; "
        "else allow more, use stronger drag, or a tolerance above round-off"
    )
    NOT_A_NUMBER = "a grain's position became infinite or not a number: use a smaller time step or smaller load steps"
    BLOWN_UP = "a grain moved by more than its radius in one time step: use a smaller time step"
    STALLED = "Newton's method stopped getting closer: use smaller load steps, or damped dynamics"
    SINGULAR = (
        "the Jacobian is singular (a rattler, or sliding without resistance): remove rattlers, or use damped dynamics"
    )
    CONTACT_LOST = "grains flew apart and lost all their contacts: use stronger drag or a smaller load"


@readable
class Outcome(NamedTuple):
    """Result of a solve."""

    status: Status
    residual: float  # largest unbalanced force or torque/radius [force]
    iterations: int
    where: int = -1  # body with the largest residual, or the one that blew up
    how: str = ""  # what the solve did, in words
    fallback: bool = False  # whether Newton's method failed first and damped dynamics had to help
    warning: str = ""  # what the user should know although the solve succeeded

    @property
    def ok(self) -> bool:
        """True if equilibrium was reached, or the last step where no equilibrium was asked for."""
        return self.status in (Status.CONVERGED, Status.DONE)

    @property
    def broken(self) -> bool:
        """True if the run blew up and its last state means nothing."""
        return self.status in (Status.NOT_A_NUMBER, Status.BLOWN_UP)

    def __str__(self) -> str:
        if self.broken and self.how:
            return f"{self.status.value} (grain {self.where + 1}, {self.how})"
        at = f", grain {self.where + 1}" if self.where >= 0 and not self.ok else ""
        return f"{self.status.value} (residual {self.residual:.3g}{at}, {self.iterations} iterations)"


class NotInEquilibriumError(RuntimeError):
    """A run that needs an equilibrium did not find one; `outcome` holds how the solve ended."""

    def __init__(self, sentence: str, outcome: Outcome):
        super().__init__(f"{sentence}: {outcome}")
        self.outcome = outcome
