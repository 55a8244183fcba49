"""Many independent runs, in local processes or on a Dask cluster."""

from .members import Member, Workers, default_workers, reach, run_members

__all__ = ["Member", "Workers", "default_workers", "reach", "run_members"]
