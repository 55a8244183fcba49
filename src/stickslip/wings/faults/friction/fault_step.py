"""Rates of a fault, and steps of order 8 with error estimates of order 5 and 3.

Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I, section II.5, with the coefficients of SciPy.
"""

import numpy as np
from scipy.integrate import DOP853

from ....core.library import core
from .fault import Fault
from .laws import EVOLUTIONS

NUMBER = DOP853.n_stages
STAGES = np.vstack([DOP853.A[1:], DOP853.B])  # weights of the earlier stages in each later one, and in the step
TIMES = np.append(DOP853.C, 1.0)  # of the stages, over the length of the step
EXPONENT = 1 / 8  # of the error in the choice of the step


class Machine:
    """Evaluates rates and steps of a fault under its initial stress.

    The unknowns (1 + S, N) are u = δ − V_p t of each cell, and s = ln(V0 θ/D_c) of each of its S = 1 or 2 states.
    """

    def __init__(self, fault: Fault, prestress: np.ndarray):
        self.transfer, self.fault = fault.transfer, fault
        cut, cut2 = fault.cuts
        rows = fault.a, fault.b, fault.dc, fault.normal, prestress, fault.b2, fault.dc2, 0.0
        self._cells = np.array(np.broadcast_arrays(*rows), float)
        values = {
            "form": fault.form_code, "evolution": EVOLUTIONS[fault.law], "mu0": fault.mu0, "cut": cut, "cut2": cut2,
            "v0": fault.v0, "damping": fault.damping, "plate_rate": fault.plate_rate, "cell": fault.cell,
            "cells": self._cells, "number": len(fault.depth), "states": fault.states,
            "weights": STAGES, "five": DOP853.E5, "three": DOP853.E3,
        }  # fmt: skip
        self._fault = core.fill("Fault", values)

    def _shear(self, slip, time: float) -> np.ndarray | None:
        """Shear stress due to excess slip, after an update of the normal stress; None where it is not compressive."""
        shear, clamped = self.transfer.tractions(slip)
        if self.fault.changes or self.fault.dips:
            normal = self.fault.normal_at(time) + clamped
            if not normal.min() > 0:
                return None
            self._cells[3], self._cells[7] = normal, self.fault.state_shift(normal)
        return shear

    def rates(self, y, w, out, power, time: float = 0.0) -> bool:
        """Rates of the unknowns, and powers per unit length; return False if a velocity cannot be found.

        Parameters
        ----------
        y : (1 + S, N) unknowns
        w : (N,) ln(V/V0), a guess that is replaced by the solution
        out : (1 + S, N) rates of the unknowns, overwritten
        power : (3,) of loading τ V_p, friction σ μ V and radiation η V², overwritten
        time : [s], for changes of the normal stress
        """
        shear = self._shear(y[0], time)
        return shear is not None and core.fault_rates(self._fault, shear, y, w, out, power)

    def step(self, y, w, stages, powers, length: float, trial, time: float = 0.0) -> float:
        """Take a step from y at a time to `trial`; return its estimated error, infinite if a stage fails.

        Parameters
        ----------
        stages, powers : (NUMBER + 1, 1 + S, N) and (NUMBER + 1, 3), rates and powers at the start and in each stage;
            the last ones are those at the end
        """
        values = {"y": y, "trial": trial, "w": w, "stages": stages, "powers": powers, "length": length}
        step = core.fill("FaultStep", values)
        core.fault_trial(self._fault, step, 1)
        for stage in range(1, NUMBER + 1):
            shear = self._shear(trial[0], time + TIMES[stage] * length)
            if shear is None or not core.fault_stage(self._fault, step, stage, shear):
                return np.inf
        return core.fault_error(self._fault, step)
