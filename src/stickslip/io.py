"""Input and output of packings and results.

Packings
    read_packing, read_packings     one state, or all states, from .npz, archive, GSD, LAMMPS data or dump
    packing_units, units_in_use     units that a file names, and a `with` statement that prints them
    follow_packings     states of a running LAMMPS simulation, as its dumps become complete
    write_packing       .npz, GSD, VTK, extended XYZ, LAMMPS data
    frame_of            columns of a state as these formats store them
    read_mode, mode_frames  a mode from `stickslip stability`, and its motion as frames

Results
    open_dataset        results of a run as an xarray dataset
    open_sweep          results of a sweep as an xarray dataset
    read_sweep          definition of a sweep
    contact_table       contacts of one frame, one row each
    contact_graph       contacts of a state as a graph of networkx
"""

from .core.units import units_in_use
from .data.exchange.files import packing_units, read_packing, read_packings, write_packing
from .data.exchange.follow import follow_packings
from .data.exchange.frame import frame_of
from .data.exchange.graph import contact_graph
from .data.exchange.motion import mode_frames, read_mode
from .experiments.dataset import contact_table, open_dataset
from .experiments.sweep.dataset import open_sweep
from .experiments.sweep.definition import read_sweep
from .lazy import unknown

__all__ = [
    "contact_graph",
    "contact_table",
    "follow_packings",
    "frame_of",
    "mode_frames",
    "open_dataset",
    "open_sweep",
    "packing_units",
    "read_mode",
    "read_packing",
    "read_packings",
    "read_sweep",
    "units_in_use",
    "write_packing",
]

__getattr__ = unknown(__name__)
