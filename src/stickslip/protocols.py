"""Load paths, free runs and release from unstable states.

Protocol        rule that applies a load and finds the equilibrium
load_path       load values between turning points
ramp            equilibria along a load path
aqs             protocol for athermal quasi-static shear
cell_shear      protocol that shears a periodic cell under stress
plate_shear     protocol that shears by a plate under a force
stable_window   range of loads without complex pairs that is nearest to a given load
free_run        Newtonian dynamics from a state, with M(t) and events
fit_growth      growth rate and frequency fitted to M(t)
kinetic_threshold   load above which kicked samples slide, and load at which sliding ones stop
response_envelope   response to small strains or stresses in all directions, and its second-order work
Envelope        the result of `response_envelope`
localisation    plane across which a shear band forms most easily
inflate         quasi-static inflation of a grain, with the displacements around it
find_events     discontinuities of quasi-static shear, bracketed and classified
shear_to_failure  load path up to the first complex pair or event, with forecasts
release         undamped run from an unstable state, with snapshots of its spectrum
run_batch       many systems side by side on a graphics processor
lammps_engine   LAMMPS as the engine of `run`
run_in_lammps   run in LAMMPS, with MPI; contact memory is passed both ways
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
