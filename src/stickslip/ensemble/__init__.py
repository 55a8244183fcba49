"""Many independent runs, in local processes or on a Dask cluster.

run_members      call a function for many tasks; one that fails is reported and the others continue
trial            one call in a separate process, with a time limit
reach            check that runs can be distributed as requested
default_workers  number of cores that this process may use

Member           result of one run, or the reason why it failed
Spread           number of simultaneous runs, and where they run
Workers          type of `workers`: a number of processes, or the address of a Dask scheduler
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
