"""Input and output of packings and results.

Packings
    read_packing, read_packings     one state, or all states, from .npz, archive, GSD, LAMMPS data or dump files
    packing_units, units_in_use     units named in a file, and a context manager that prints numbers in such units
    read_forces, measured_forces    measured disks and their contact forces, from files or arrays
    follow_packings     states of a running LAMMPS simulation, as its dumps become complete
    write_packing       .npz, GSD, VTK, extended XYZ, LAMMPS data
    write_matrices      matrices of a packing for other programs: NumPy or Matrix Market
    frame_of            columns of a state as these formats store them
    read_mode, mode_frames  a mode from `stickslip stability`, and its motion as frames

Results
    open_dataset        results of a run as an xarray dataset
    open_sweep          results of a sweep as an xarray dataset
    read_sweep          definition of a sweep
    contact_table       contacts of one frame, one row each
    contact_graph       contacts of a state as a networkx graph
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
