"""Numbers of faults for `stickslip doctor`."""

import numpy as np

from ...kit import Selfcheck
from .friction.loads import slide_hold_slide
from .friction.ratestate import RateState, Spring, spring_slider


def selfchecks() -> dict[str, Selfcheck]:
    """Friction right after a hold, from the slip law with the parameters of Ferdowsi & Rubin 2021."""
    surface = RateState(a=0.0247, b=0.0178, dc=5.3e-3, mu0=0.4, v0=0.02, law="slip")
    legs = slide_hold_slide([1.0], velocity=0.02, distance=0.05)
    history = spring_slider(surface, Spring(200.0), legs, times=np.linspace(0, 5, 51))
    measured = float(history.friction.min())
    return {
        "rate and state, after a hold": Selfcheck(measured, 0.27764026555526716, 1e-6, "tolerance of the integrator")
    }
