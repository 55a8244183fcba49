"""A laboratory for frictional grains: build packings, load them, and know when and how they slip.

Packings and states
    State, Grains, Walls, Cell, Contacts, Control   parts of a state
    assembly, box, disks, spheres, flat_walls       build a state by hand
    OPEN, STICK, SLIDE      modes of a contact
    packings    make packings, build them from arrays, and prepare them for a test
    laws        contact laws: built-in, combined or user-defined
    control     boundary conditions: fixed, driven, force-controlled bodies; springs; cells

Forces, equilibrium, dynamics
    Law         a contact law with its parameters
    forces, accept      evaluate contact forces; commit the memory of the contacts
    FREE, HELD, FROZEN      treatment of contact memory in an evaluation of forces
    equilibrate, newton, relax      find an equilibrium
    Outcome, Status, NotInEquilibriumError      outcome of a solver
    run         integrate the equations of motion
    protocols   load paths, free runs, release from unstable states
    measure     stress, fabric, coordination, contact forces

Stability
    stability   stability of a packing: complex pairs, growth rates, floppy modes
    spectrum    all eigenvalues and modes of -M^-1 J
    jacobian, freedom       the matrix J and its coordinates
    modes       pairs of large packings, moduli, transient growth, sensitivity
    quasirigid  contact status, load paths, mechanisms

Experiments and files
    examples    packings and scenarios that come with the package
    scenario, read_scenario, simulate       define an experiment, run it
    sweep, run_sweep    many scenarios in one run
    experiments     scenario classes and measures of each experiment
    friction    rate-and-state friction: slider, fits, laboratory records
    io          packings from this and other programs, results as datasets
    figures     figures of all results
    results     types of results, for annotations
    ensemble    independent tasks in processes or on a cluster

Names are imported on first use, so `import stickslip` loads no heavy library.
"""

from .lazy import attach

__version__ = "0.3.0"
__getattr__, _names, _all = attach(__name__, __file__)
__all__ = ["__version__", *_all]


def __dir__():
    return __all__
