"""Events of quasi-static paths: their kinds, their properties, and the path on which they were found."""

from enum import Enum
from typing import NamedTuple

import numpy as np

from ..core.readable import pluralize, readable
from ..core.state import State


class EventKind(Enum):
    """What announces and starts an event. The value of each member is a description."""

    SADDLE_NODE = "a real eigenvalue reaches zero"
    PAIR = "a complex pair with growing oscillations"
    SLIDING = "a contact starts to slide"
    OPENING = "a contact opens"
    UNSTABLE = "the state before was already unstable"
    UNRESOLVED = "unresolved"


@readable(head=lambda event: f"{event.kind.value} at strain {event.strain:.6g}, drop {event.stress_drop:.3g} of p")
class Event(NamedTuple):
    """Discontinuity of a quasi-static path; see `find_events`. Strains count from the first state."""

    strain: float  # upper end of the bracket [1]
    below: float  # its lower end, the last strain that the path reaches without a jump or loss of stability
    kind: EventKind
    exponent: float  # p of (γ_c − γ)^p for λ_min, for pairs Re λ − (Im λ/drag)²; see `fit_power`; NaN if flat
    exponent_error: float  # its standard error
    distances: np.ndarray  # (K,) strains before the event, step · 8^(−k)
    softest: np.ndarray  # (K,) smallest real eigenvalue λ_min there [1/time²]
    re_pair: np.ndarray  # (K,) Re λ of the fastest growing pair, NaN without a pair [1/time²]
    growth: np.ndarray  # (K,) growth rate |Im √λ| of that pair without drag, 0 without a pair [1/time]
    trigger: tuple[int, int]  # grains of the contact whose sliding or opening starts the event; (−1, −1) without
    mobilisation: float  # |F_t|/(μ F_n) of that contact in the last stable state, or NaN
    # smallest λ, for pairs Re λ − (Im λ/drag)², of the last stable state with that contact sliding or open; negative
    # if this makes it unstable, NaN without such a contact [1/time²]
    switched: float  # [1/time²]
    growth_rate: float  # initial growth rate of the instability under the drag [1/time]
    stress_drop: float  # change of σ_xy over the pressure before the event; positive if −σ_xy falls
    jump: float  # root mean square non-affine displacement, in mean diameters
    participation: float  # of the jump, (Σ u²)²/(N Σ u⁴), from 1/N to 1
    opened: int  # contacts that opened
    closed: int  # contacts that closed
    # root mean square distance, in mean diameters, between the state at the end of the strain step and that of Newton's
    # method alone in one step; NaN if Newton's method fails
    newton_distance: float


@readable(head=lambda steps: pluralize(len(steps.strain), "strain step"))
class StrainStep(NamedTuple):
    """Predictors at the beginning of each strain step of a path; arrays (S,) over steps."""

    strain: np.ndarray  # counted from the first state [1]
    softest: np.ndarray  # smallest real eigenvalue λ_min [1/time²]
    nonaffine_rate: np.ndarray  # root mean square of dq/dγ over the supported grains, from J alone [length]
    growth: np.ndarray  # growth rate |Im √λ| of the fastest pair without drag, 0 without a pair [1/time]
    tangent_modulus: np.ndarray  # d(−σ_xy)/dγ, from J alone [force/length^(dim−1)]
    switch: np.ndarray  # smallest λ_min if one of the most mobilised sticking contacts slides [1/time²]
    shear_stress: np.ndarray  # −σ_xy [force/length^(dim−1)]
    pressure: np.ndarray  # [force/length^(dim−1)]
    loss_ahead: np.ndarray  # strain after which, on the linear motion, a contact is lost and leaves an unstable state


@readable(head=lambda record: f"{pluralize(len(record.events), 'event')}; {record.end}")
class Events(NamedTuple):
    """Events of a quasi-static path, and predictors along it."""

    events: tuple[Event, ...]
    steps: StrainStep
    state: State  # at the end of the path
    drag: float  # of the dynamics that decide where an event ends [1/time]
    step: float  # largest strain step
    resolution: float  # largest width of a bracket
    end: str  # reason why the search ended
