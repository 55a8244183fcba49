"""Figures: a result in, a matplotlib Figure out (`view`: a widget, `movie`: a file); nothing is simulated here.

Every function is here, and is loaded when first used: `ss.figures.packing(state, law)`.
"""

from importlib import import_module

_WHERE = {
    "grains": "packing",
    "scene": "view",
    "film": "movie",
    "disk_array": "center_of_mass complex_pairs mean_square_displacement mode_shape trajectory traveling_fronts",
    "sphere_shear": "growth pairs_along_strain spectrum_in_time stress_through_failure trajectories",
    "quasi_rigid": "cone curves errors stiffness",
    "flow": "snapshots time_series velocity_profile",
    "gouge": "healing holds reslides sample steady_sliding velocity_steps",
    "rate_state": "fitted slid",
    "claims": "claims_chart",
}
_ROOM = {name: room for room, names in _WHERE.items() for name in names.split()}
__all__ = sorted(_ROOM)


def __getattr__(name: str):
    if name in _ROOM:
        return getattr(import_module(f".{_ROOM[name]}", __name__), name)
    raise AttributeError(f"stickslip.figures has no name {name!r}: see dir(stickslip.figures)")


def __dir__():
    return __all__
