"""Time stepping of a fault, and its state between steps, from which a simulation continues bit for bit.

Steps are of order 8 with error estimates of orders 5 and 3: Hairer, Nørsett and Wanner, Solving Ordinary Differential
Equations I, section II.5, with the coefficients of SciPy.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853

from ....kit import Values, checked, core, in_readable_units, readable, require_shape
from .fault import Fault
from .laws import EVOLUTIONS, friction
from .ranges import Positive
from .stress_transfer import KERNEL

NUMBER = DOP853.n_stages
STAGES = np.vstack([DOP853.A[1:], DOP853.B])  # weights of earlier stages in each stage, and in the step
TIMES = np.append(DOP853.C, 1.0)  # times of the stages, as fractions of the step
EXPONENT = 1 / 8  # exponent of the error in step size control


class Machine:
    """Computation of rates and time steps for a fault with a given initial stress.

    The unknowns (1 + S, N) are u = δ − V_p t of each cell, and s = ln(V0 θ/D_c) of each of its S = 1 or 2 states.
    """

    def __init__(self, fault: Fault, prestress: np.ndarray):
        self.transfer, self.fault = fault.transfer, fault
        cut, cut2 = fault.cuts
        rows = fault.a, fault.b, fault.dc, fault.normal, prestress, fault.b2, fault.dc2, 0.0
        self._cells = np.array(np.broadcast_arrays(*rows), float)
        self._varies = bool(fault.changes or fault.dips)  # True if the normal stress changes
        values = {
            "transfer": self.transfer.struct(),
            "form": fault.form_code, "evolution": EVOLUTIONS[fault.law], "mu0": fault.mu0, "cut": cut, "cut2": cut2,
            "v0": fault.v0, "damping": fault.damping, "plate_rate": fault.plate_rate, "cell": fault.cell,
            "cells": self._cells, "number": len(fault.depth), "states": fault.states,
            "weights": STAGES, "five": DOP853.E5, "three": DOP853.E3,
        }  # fmt: skip
        self._fault = core.fill("Fault", values)

    def _image(self, slip, time: float) -> tuple[np.ndarray | None, bool]:
        """Update the normal stress; return the shear stress due to the surface, and False if slip opens the fault."""
        shear, clamped = self.transfer.of_image(slip)
        normal = self.fault.normal_at(time) + clamped
        self._cells[3], self._cells[7] = normal, self.fault.state_shift(normal)
        return shear, bool(normal.min() > 0)

    def rates(self, y, w, out, power, time: float = 0.0) -> bool:
        """Compute rates of the unknowns and powers per unit length; return False if no velocity is found.

        Parameters
        ----------
        y : (1 + S, N) unknowns
        w : (N,) ln(V/V0); the initial guess is overwritten by the solution
        out : (1 + S, N) rates of the unknowns, overwritten
        power : (3,) powers of loading τ V_p, friction σ μ V and radiation η V², overwritten
        time : time at which imposed changes of the normal stress are evaluated [s]
        """
        image, closed = self._image(y[0], time) if self._varies else (None, True)
        return closed and core.fault_rates(self._fault, image, y, w, out, power)

    def step(self, y, w, stages, powers, length: float, trial, time: float = 0.0) -> float:
        """Take a step from y to `trial`; return its estimated error, infinite if a stage fails.

        Parameters
        ----------
        stages, powers : (NUMBER + 1, 1 + S, N) and (NUMBER + 1, 3), rates and powers at the start, in each stage and at
            the end
        """
        values = {"y": y, "trial": trial, "w": w, "stages": stages, "powers": powers, "length": length, "image": None}
        step = core.fill("FaultStep", values)
        core.fault_trial(self._fault, step, 1)
        if not self._varies:
            found = core.fault_stages(self._fault, step, 1, NUMBER)
            return core.fault_error(self._fault, step) if found else np.inf
        for stage in range(1, NUMBER + 1):
            image, closed = self._image(trial[0], time + TIMES[stage] * length)
            step = core.fill("FaultStep", values | {"image": image})
            if not closed or not core.fault_stages(self._fault, step, stage, stage):
                return np.inf
        return core.fault_error(self._fault, step)


LARGEST = 300.0  # largest logarithm of a state


def _head(state) -> str:
    (time,), unit = in_readable_units([state.time], "s")
    return f"{len(state.excess_slip)} cells at {time:.6g} {unit}"


@readable(head=_head)
class FaultState(NamedTuple):
    """A fault at one time, from which `simulate_fault` continues as if it had not stopped."""

    time: float  # [s]
    excess_slip: np.ndarray  # (N,) slip minus plate motion since the start, δ − V_p t [m]
    log_state: np.ndarray  # (N,) ln(V0 θ/D_c), plus `Fault.state_shift` if normal stress acts on the state
    log_velocity: np.ndarray  # (N,) ln(V/V0), with the reference velocity V0 = `fault.v0`
    prestress: np.ndarray  # (N,) shear stress at the start [Pa]
    rates: np.ndarray  # (V, N) time derivatives of excess_slip, and of log_state for S = 1 or 2 states
    power: np.ndarray  # (3,) powers of loading, friction and radiation, per length along strike [W/m]
    energy: np.ndarray  # (3,) time integrals of `power` since the start [J/m]
    step: float  # proposed length of the next step [s]
    error: float  # error of the last step, relative to the tolerance
    sampled: np.ndarray  # (2,) time and log10 of the maximum slip velocity of the last sample
    log_state2: np.ndarray | None = None  # (N,) ln(V0 θ2/D_c2) of a second state, if the fault has one
    events: int = 0  # number of events since an artificial start; 0 in a state that was not simulated
    kernel: str = (
        "uniform"  # slip between cell centres: now "band-limited"; in states of earlier versions uniform within cells
    )

    @property
    def unknowns(self) -> np.ndarray:
        """Integrated variables: excess slip, and the logarithm of each state (1 + S, N)."""
        second = [] if self.log_state2 is None else [self.log_state2]
        return np.array([self.excess_slip, self.log_state, *second])

    def slip(self, fault: Fault) -> np.ndarray:
        """Slip since the start (N,) [m]."""
        return self.excess_slip + fault.plate_rate * self.time

    def velocity(self, fault: Fault) -> np.ndarray:
        """Slip velocity (N,) [m/s]."""
        return fault.v0 * np.exp(self.log_velocity)

    def normal(self, fault: Fault) -> np.ndarray:
        """Effective normal stress (N,) [Pa]."""
        return fault.normal_at(self.time, self.excess_slip)

    def theta(self, fault: Fault) -> np.ndarray:
        """State variable θ (N,) [s]."""
        return fault.dc / fault.v0 * np.exp(self.log_state - fault.state_shift(self.normal(fault)))

    def theta2(self, fault: Fault) -> np.ndarray | None:
        """Second state variable (N,) [s]; None if there is none."""
        if self.log_state2 is None:
            return None
        return fault.dc2 / fault.v0 * np.exp(self.log_state2 - fault.state_shift(self.normal(fault)))

    def stress(self, fault: Fault) -> np.ndarray:
        """Shear stress that friction balances, τ₀ + τ(δ − V_p t) − η V (N,) [Pa]."""
        return self.prestress + fault.transfer(self.excess_slip) - fault.damping * self.velocity(fault)

    def elastic_energy(self, fault: Fault) -> float:
        """Elastic energy per length along strike, relative to the start [J/m]."""
        u = self.excess_slip
        return float(-fault.cell * (u @ self.prestress + 0.5 * u @ fault.transfer(u)))


def steady_stress(fault: Fault, velocity: float) -> np.ndarray:
    """Shear stress (N,) in steady sliding at one velocity, including radiation damping [Pa]."""
    w = np.full(len(fault.depth), np.log(velocity / fault.v0))
    return fault.normal * friction_of(fault, w, np.array([-w, -w])) + fault.damping * velocity


def friction_of(fault: Fault, log_velocity: np.ndarray, log_states: np.ndarray, cells=None) -> np.ndarray:
    """Friction coefficient (..., K) from ln(V/V0) (..., K) and the logarithms of the states (S, ..., K).

    Parameters
    ----------
    cells : numbers of the K cells; default: all
    """
    logs = np.stack([log_velocity, log_states[0], log_states[-1]], axis=-1)
    surface = np.stack(np.broadcast_arrays(fault.a, fault.b, fault.b2, fault.mu0, *fault.cuts), axis=-1)
    surface = np.broadcast_to(surface if cells is None else surface[cells], (*logs.shape[:-1], 6))
    rows = friction(fault.form_code, logs.reshape(-1, 3), np.ascontiguousarray(surface.reshape(-1, 6)))
    return rows.reshape(log_velocity.shape)


@checked
def initial_state(fault: Fault, *, velocity: Positive | None = None, stress: Values | str | None = None) -> FaultState:
    """State in which all cells slip at one velocity under a given shear stress; θ follows from stress balance.

    A second state has the same ratio to its steady value as the first.

    Parameters
    ----------
    velocity : default: the plate rate [m/s]
    stress : a number or (N,), or "steady" for steady sliding of each cell; default: the steady stress of the deepest
        cell at that velocity, as in the SEAS benchmark problems [Pa]

    Raises
    ------
    ValueError
        If the stress is not positive, or if no θ balances it.

    Examples
    --------
    >>> from stickslip import friction
    >>> a = [(15e3, 0.010), (18e3, 0.025)]
    >>> fault = friction.line_fault(40e3, 100.0, a=a, b=0.015, dc=8e-3, normal=50e6)
    >>> print(round(initial_state(fault).prestress[0] / 1e6, 6))
    26.546122
    """
    if velocity is None and not fault.plate_rate:
        raise ValueError("plate_rate = 0 requires an initial velocity, such as 1e-12 m/s")
    velocity = fault.plate_rate if velocity is None else velocity
    normal = fault.normal_at(0.0)
    steady = steady_stress(fault._replace(normal=normal), velocity)
    if isinstance(stress, str) and stress != "steady":
        raise ValueError(f"stress must be values in Pa, or 'steady', got {stress!r}")
    tau = np.asarray(steady[-1] if stress is None else steady if isinstance(stress, str) else stress, float)
    if tau.shape not in ((), fault.depth.shape):
        raise ValueError(f"stress has shape {tau.shape}: use a number, or one for each of the {len(fault.depth)} cells")
    tau = np.array(np.broadcast_to(tau, fault.depth.shape))
    strength = tau - fault.damping * velocity
    if not (np.isfinite(strength).all() and (strength > 0).all()):
        raise ValueError(f"stress must be positive and finite, got {tau.min():g} Pa")
    w, n = np.log(velocity / fault.v0), len(fault.depth)
    s = _log_state(fault, _state_terms(fault, w, strength / normal), fault.evolution, -w)
    _check_balance(fault, s, tau, velocity, default=stress is None)
    s = s + fault.state_shift(normal)
    state = FaultState(
        0.0, np.zeros(n), s, np.full(n, w), tau, np.zeros((1 + fault.states, n)), np.zeros(3), np.zeros(3),
        1e-3 * float(fault.dc.min()) / velocity, 1.0, np.array([-np.inf, -np.inf]),
        s.copy() if fault.states > 1 else None, kernel=KERNEL,
    )  # fmt: skip
    return with_rates(fault, state)


def _state_terms(fault: Fault, w, friction: np.ndarray) -> np.ndarray:
    """Sum (N,) of the state terms for which friction has a given value at a slip velocity."""
    x, cut = friction / fault.a, fault.cuts[0]
    if fault.form == "regularized":
        x = x + np.log(-np.expm1(-2 * x))  # ln(2 sinh x)
    return fault.a * (x - (-np.log(np.exp(-w) + cut) if cut else w)) - fault.mu0


def _log_state(fault: Fault, term: np.ndarray, effect: np.ndarray, otherwise) -> np.ndarray:
    """Logarithm (N,) of the state that adds `term` to friction: NaN if none does, `otherwise` where effects are 0."""
    cut2, acts = fault.cuts[1], effect > 0
    s = term / np.where(acts, effect, 1.0)
    if cut2:
        with np.errstate(invalid="ignore", divide="ignore"):
            s = s + np.log1p(-cut2 * np.exp(-np.maximum(s, -LARGEST)))
    return np.where(acts, s, otherwise)


def _check_balance(fault: Fault, s: np.ndarray, stress: np.ndarray, velocity: float, *, default: bool = False) -> None:
    wrong = ~(np.abs(s) < LARGEST)
    if wrong.any():
        k = int(np.argmax(wrong))
        more = f", or v2 far above this velocity instead of {fault.v2:g} m/s" if fault.cuts[1] else ""
        if default:
            raise ValueError(
                f"the default initial stress, {stress[k]:.4g} Pa of steady sliding at the deepest cell, cannot be "
                f"balanced at {fault.depth[k]:g} m, where the normal stress is {fault.normal[k]:.4g} Pa: use stress = "
                f"'steady' for the steady stress of each cell, or values that vary with depth{more}"
            )
        change = "smaller" if s[k] > 0 else "larger"
        raise ValueError(
            f"no state balances the initial stress of {stress[k]:.4g} Pa at {fault.depth[k]:g} m with a slip velocity "
            f"of {velocity:g} m/s: use a {change} stress{more}"
        )


@checked
def perturbed_state(fault: Fault, state: FaultState, log_velocity: Values) -> FaultState:
    """Change slip velocities at constant stress by changing θ, as in studies of nucleation.

    The first state changes, or the second where the first has no effect (b = 0).

    Parameters
    ----------
    log_velocity : change of ln V, a number or (N,)

    Raises
    ------
    ValueError
        If the state does not belong to this fault, or if no θ balances the stress.
    """
    check_state(fault, state)
    if np.ndim(log_velocity):
        require_shape(fault.depth.shape, log_velocity=log_velocity)
    w = state.log_velocity + np.broadcast_to(np.asarray(log_velocity, float), fault.depth.shape)
    stress = state.prestress + fault.transfer(state.excess_slip)
    strength = stress - fault.damping * fault.v0 * np.exp(w)
    normal = state.normal(fault)
    terms, shift = _state_terms(fault, w, strength / normal), fault.state_shift(normal)
    effects = [fault.b, np.broadcast_to(fault.b2, fault.b.shape)][: fault.states]
    cut2, states = fault.cuts[1], state.unknowns[1:] - shift
    added = [effect * (np.log(np.exp(s) + cut2) if cut2 else s) for effect, s in zip(effects, states, strict=True)]
    first = _log_state(fault, terms - sum(added[1:]), fault.b, states[0])
    _check_balance(fault, first, stress, fault.v0 * float(np.exp(w.max())))
    second = state.log_state2
    if second is not None:
        second = np.where(fault.b > 0, second, _log_state(fault, terms, effects[1], states[1]) + shift)
    state = state._replace(log_state=first + shift, log_state2=second, log_velocity=w, events=0)
    return with_rates(fault, state)


def check_state(fault: Fault, state: FaultState) -> None:
    """Raise ValueError if a state does not belong to this fault."""
    cells, states = len(fault.depth), 1 if state.log_state2 is None else 2
    if len(state.excess_slip) != cells:
        raise ValueError(
            f"the state has {len(state.excess_slip)} cells, but the fault has {cells}: use a state of this fault"
        )
    if states != fault.states:
        raise ValueError(
            f"the state has {states} state variable{'s' * (states > 1)}, but the fault has {fault.states}: use a state "
            "of this fault"
        )
    if state.kernel != KERNEL:
        raise ValueError(
            f"the state has {state.kernel} slip in each cell, but faults now have {KERNEL} slip, which changes their "
            "stress: start from initial_state, or use the version of stickslip that saved the state"
        )
    for name in ("excess_slip", "log_state", "log_state2", "log_velocity", "prestress"):
        values = getattr(state, name)
        if values is not None and not (np.shape(values) == (cells,) and np.isfinite(values).all()):
            raise ValueError(f"{name} of the state is not an array of {cells} finite numbers: use an unchanged state")


def with_rates(fault: Fault, state: FaultState) -> FaultState:
    """Return the state with velocities and rates computed from slip, θ and stress."""
    check_state(fault, state)
    machine, w = Machine(fault, state.prestress), state.log_velocity.copy()
    y, power = state.unknowns, np.zeros(3)
    out = np.zeros_like(y)
    if not machine.rates(y, w, out, power, state.time):
        raise ValueError("no slip velocity balances the stress: check the initial stress and the parameters")
    return state._replace(log_velocity=w, rates=out, power=power)
