"""Many independent runs, in local processes or on a Dask cluster."""

from .pool import Member, Spread, Workers, default_workers, reach, run_members, trial

__all__ = ["Member", "Spread", "Workers", "default_workers", "reach", "run_members", "trial"]
