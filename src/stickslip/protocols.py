"""Load paths, free runs and release from unstable states.

Protocol        how loads are applied and equilibria are found
load_path       values of the load between turning points
ramp            equilibria along a path of loads
aqs             protocol of athermal quasi-static shear
cell_shear      protocol of shear of a periodic cell under stress
plate_shear     protocol of shear by a plate under a force
stable_window   range of loads without complex pairs nearest to a given load
free_run        Newtonian dynamics from a state, with M(t) and events
fit_growth      growth rate and frequency fitted to M(t)
kinetic_threshold   load from which on kicked samples slide, and at which sliding ones stop
find_events     discontinuities of quasi-static shear, bracketed and classified
release         undamped run from an unstable state, with snapshots of its spectrum
run_in_lammps   run in LAMMPS, with MPI; contact memory goes there and comes back
"""

from .experiments.lammps.run import run_in_lammps
from .lazy import unknown
from .loading.events import find_events
from .loading.protocols import Protocol, fit_growth, free_run, load_path, ramp, stable_window
from .loading.quasistatic import aqs
from .loading.release import release
from .loading.stress import cell_shear, plate_shear
from .loading.threshold import kinetic_threshold

__all__ = [
    "Protocol",
    "aqs",
    "cell_shear",
    "find_events",
    "fit_growth",
    "free_run",
    "kinetic_threshold",
    "load_path",
    "plate_shear",
    "ramp",
    "release",
    "run_in_lammps",
    "stable_window",
]

__getattr__ = unknown(__name__)
