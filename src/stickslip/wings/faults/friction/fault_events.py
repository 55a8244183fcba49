"""Earthquakes of a simulated fault: moment, stress drops, speed of the rupture and energies of each event.

u is slip in excess of plate motion and K the stress transfer, so that the shear stress on the fault is τ = τ₀ + K u; it
exceeds friction by radiation damping, η V. D is the slip of an event, −K Δu its static stress drop. All sums are over
cells of length h, and all quantities are those of a unit of length along strike, as the fault is two-dimensional.
"""

from typing import NamedTuple

import numpy as np

from ....kit import Values, checked, pluralize, readable
from .fault import Fault


@readable(head=lambda events: pluralize(len(events.start), "event"))
class FaultEvents(NamedTuple):
    """Earthquakes (E,): intervals in which the maximum slip velocity exceeds the threshold."""

    start: np.ndarray  # [s]
    end: np.ndarray  # [s]
    depth: np.ndarray  # of the fastest cell when the threshold is reached [m]
    nucleation_length: np.ndarray  # around it, with at least a tenth of the largest slip velocity [m]
    top: np.ndarray  # shallowest and deepest points at which slip reached the threshold velocity [m]
    bottom: np.ndarray  # [m]
    max_velocity: np.ndarray  # [m/s]
    surface_velocity: np.ndarray  # largest of the first cell [m/s]
    max_slip: np.ndarray  # [m]
    surface_slip: np.ndarray  # of the first cell [m]
    moment: np.ndarray  # G × slip, integrated over depth: moment per length along strike [N]
    radiated: np.ndarray  # radiated energy, the work of radiation damping, per length along strike [J/m]
    rupture_length: np.ndarray  # length of the cells in which slip reached the threshold velocity [m]
    rupture_speed: np.ndarray  # mean, from where slip first reached the threshold velocity to the farther end [m/s]
    stress_drop: np.ndarray  # mean of the static stress drop over the rupture [Pa]
    slip_weighted_stress_drop: np.ndarray  # its mean weighted with slip, which is that of the energy [Pa]
    seismological_stress_drop: np.ndarray  # of a crack with the moment and the length of the rupture [Pa]
    released: np.ndarray  # elastic energy released, per length along strike [J/m]
    loading: np.ndarray  # work of the plates during the event, per length along strike [J/m]
    frictional: np.ndarray  # work of friction, per length along strike [J/m]
    fracture: np.ndarray  # part of the work of friction above slip × final shear stress [J/m]
    first: np.ndarray  # True for the first event after an artificial start, which depends on that start

    @property
    def recurrence(self) -> np.ndarray:
        """Times between the starts of events (E − 1,) [s]."""
        return np.diff(self.start)

    @property
    def energy_residual(self) -> np.ndarray:
        """Rest of the ledger, released + loading − frictional − radiated, over the released energy (E,)."""
        return (self.released + self.loading - self.frictional - self.radiated) / self.released


NAMES = FaultEvents._fields


@checked
def moment_magnitude(moment: Values):
    """Moment magnitude M_w = (2/3) (log10 M₀ − 9.1), with the seismic moment M₀ in N m.

    Source
    ------
    T. C. Hanks and H. Kanamori 1979, doi:10.1029/JB084iB05p02348, with the constant in SI units.

    Examples
    --------
    >>> print(round(float(moment_magnitude(1.1e20)), 2))
    7.29
    """
    moment = np.asarray(moment, float)
    if (moment <= 0).any():
        raise ValueError(f"a moment of {moment.min():g} N m was given: use positive moments")
    return 2 / 3 * (np.log10(moment) - 9.1)


def crack_stress_drop(fault: Fault, moment: float, length: float, *, surface: bool) -> float:
    """Uniform stress drop of a crack with a moment M per length along strike and a length L, C (G*/G) M/L² [Pa].

    A crack of length L in an infinite body, with the slip (2 Δτ/G*) √(L²/4 − x²), has the moment (G/G*) π Δτ L²/4, so
    that C = 4/π. One that breaks the free surface is half of a crack of length 2L: C = 2/π. This is exact for antiplane
    shear; a dipping fault that breaks the surface slips more, and the result is 17 % too large for a dip of 30 or 60
    degrees, and 26 % for one of 90 degrees.

    Source
    ------
    Antiplane: L. Knopoff, Geophys. J. 1, 44 (1958); in-plane: A. T. Starr, Proc. Camb. Phil. Soc. 24, 489 (1928).
    """
    return (2 if surface else 4) / np.pi * fault.modulus / fault.shear_modulus * moment / length**2


def measure_source(fault: Fault, prestress: np.ndarray, begin, end, arrival: np.ndarray) -> dict[str, float]:
    """Moment, stress drops, speed and energies of an event, by the names of `FaultEvents`.

    Parameters
    ----------
    prestress : (N,) shear stress at the start of the simulation [Pa]
    begin, end : Moment before and after the event
    arrival : (N,) times at which slip reached the threshold velocity, infinite where it did not [s]
    """
    h, change = fault.cell, end.excess_slip - begin.excess_slip
    slip = change + fault.plate_rate * (end.time - begin.time)
    drop, ruptured = -fault.transfer(change), np.isfinite(arrival)
    middle = prestress + fault.transfer(0.5 * (begin.excess_slip + end.excess_slip))  # elastic energy is quadratic in u
    loading, frictional, radiated = map(float, end.energy - begin.energy)
    length, moment = h * int(ruptured.sum()), fault.shear_modulus * h * float(slip.sum())
    endless = fault.boundary == "periodic" and bool(ruptured.all())
    surface = fault.boundary == "surface" and bool(ruptured[0])
    return {
        "moment": moment,
        "rupture_length": length,
        "rupture_speed": _rupture_speed(fault, arrival),
        "stress_drop": float(drop[ruptured].mean()),
        "slip_weighted_stress_drop": float(drop @ slip / slip.sum()),
        "seismological_stress_drop": np.nan if endless else crack_stress_drop(fault, moment, length, surface=surface),
        "released": h * float(change @ middle),
        "loading": loading,
        "frictional": frictional,
        "radiated": radiated,
        "fracture": frictional - h * float(slip @ (middle - 0.5 * drop)),
    }  # fmt: skip


def _rupture_speed(fault: Fault, arrival: np.ndarray) -> float:
    """Distance from the first cell that ruptured to the farthest one, over the time between; NaN for one cell."""
    first = int(np.argmin(arrival))
    distance = np.abs(fault.depth - fault.depth[first])
    if fault.boundary == "periodic":
        distance = np.minimum(distance, fault.width - distance)
    far = int(np.argmax(np.where(np.isfinite(arrival), distance, -1.0)))
    took = arrival[far] - arrival[first]
    return float(distance[far] / took) if took > 0 else np.nan
