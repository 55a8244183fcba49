"""History of a fault as an xarray dataset."""

import numpy as np
import xarray as xr

from ....kit import checked, units_of
from .fault_cycles import FaultHistory
from .fault_record import FaultEvents


@checked
def fault_dataset(history: FaultHistory) -> xr.Dataset:
    """Convert a history to a dataset with units.

    Variables are max_velocity and moment_rate (time); slip, velocity, stress and theta (time, station), theta2 with two
    states; normal (time, station) if the normal stress changes; horizontal, down and their velocities (time, surface)
    beside a dipping fault; profile_slip (profile_time, profile_depth); columns of the events, with the prefix `event_`
    (event).

    Examples
    --------
    >>> from stickslip import friction
    >>> fault = friction.line_fault(10e3, 100.0, a=0.02, b=0.015, dc=8e-3, normal=50e6)
    >>> found = friction.simulate_fault(
    ...     fault, 10.0, recording=friction.Recording(stations=(0.0, 5e3))
    ... )
    >>> dict(fault_dataset(found).sizes)["station"]
    2
    """

    known = units_of(FaultEvents) | units_of(FaultHistory)

    def units(name: str) -> dict[str, str]:
        return {"units": known[name]} if name in known else {}

    series, tables = ("max_velocity", "moment_rate"), ["slip", "velocity", "stress", "theta"]
    tables += ["theta2"] if history.theta2 is not None else []
    tables += ["normal"] if history.fault.changes or history.fault.dips else []
    variables = {name: ("time", getattr(history, name), units(name)) for name in series}
    variables |= {name: (("time", "station"), getattr(history, name), units(name)) for name in tables}
    if len(history.surface):
        moved = ("horizontal", "down", "horizontal_velocity", "down_velocity")
        variables |= {name: (("time", "surface"), getattr(history, name), units(name)) for name in moved}
    variables["profile_slip"] = (("profile_time", "profile_depth"), history.profile_slip, units("profile_slip"))
    for name in ("profile_seismic", "profile_max_velocity"):
        variables[name] = ("profile_time", getattr(history, name), units(name))
    for name, values in history.events._asdict().items():
        variables[f"event_{name}"] = ("event", values, units(name))
    axes = ["time", "station", "profile_time", "profile_depth", *(["surface"] if len(history.surface) else [])]
    coordinates = {name: (name, getattr(history, name), units(name)) for name in axes}
    coordinates["event"] = ("event", np.arange(len(history.events.start)), {})
    return xr.Dataset(variables, coordinates, attrs={"law": history.fault.law, "cell": history.fault.cell})
