"""Jammed packings of scenarios, for experiments that shear them."""

from ..core.laws.builtin import Law
from ..core.state import State
from ..data.law_schema import Packing
from ..loading.packing import PackingInfo, jammed

DEFAULT_FRACTION = {2: 0.86, 3: 0.68}


def make_packing(chosen: Packing, law: Law, seed: int, tolerance: float | None = None) -> tuple[State, PackingInfo]:
    """Make the packing of a scenario; return State and PackingInfo, see `jammed`."""
    fraction = chosen.packing_fraction
    if fraction is None and chosen.pressure is None:
        fraction = DEFAULT_FRACTION[chosen.dim]
    return jammed(
        chosen.grains,
        packing_fraction=fraction,
        pressure=chosen.pressure,
        dim=chosen.dim,
        radius=chosen.radius,
        mass=chosen.mass,
        i0=chosen.i0,
        law=law,
        seed=seed,
        tolerance=tolerance,
    )
