"""Benchmarks, run by `python -m benchmarks NAME`: speed relative to other codes, and numbers in the documentation."""

from typing import NamedTuple


class Benchmark(NamedTuple):
    """Command that measures numbers, its duration, and the code on which the numbers depend."""

    about: str
    seconds: float  # approximate duration on one core
    rooms: tuple[str, ...]  # rooms of `src/stickslip` on which its numbers depend
    place: str = ""  # module and function that yield the rows; default: `NAME:rows`
    ratios: bool = False  # True if it is part of `make bench`


STEPS = ("_core", "builtin_laws", "core")  # code that computes single time steps
LOOP = (  # code that computes time steps of grains
    "_core", "builtin_laws", "core/dynamics", "core/contacts/forces.py", "core/contacts/neighbors.py",
    "core/laws/builtin.py", "core/laws/compiled.py", "core/laws/kinds.py", "core/laws/properties.py", "core/state.py",
)  # fmt: skip
STATICS = (*STEPS, "loading", "solve")
PATHS = (*STATICS, "wings/status")
FRICTION = (
    "_core/fault.cpp", "_core/rate_state.h", "_core/slider.cpp", "_core/stress_transfer.cpp", "wings/faults/friction",
)  # fmt: skip
DISKS = (*STATICS, "wings/papers/disk_array", "wings/papers/sphere_shear")
GOUGE = (*STEPS, "loading", "wings/papers/gouge")

BENCHMARKS = {
    "after_instability": Benchmark("predictions of `birth_form` compared with free runs", 1800, STATICS),
    "ten_disks": Benchmark("time steps of ten disks, compared with LAMMPS", 60, LOOP, ratios=True),
    "backward_front": Benchmark("speed of the backward front of a pushed array of disks", 600, DISKS),
    "budgets": Benchmark("time of `stickslip reproduce --quick`", 300, (*PATHS, "experiments"), ratios=True),
    "catalogue": Benchmark("catalogue of events: tables and figures", 20_000, (*STATICS, "wings/studies/catalogue")),
    "collapses": Benchmark("paths through collapses, compared with slow dynamics", 1800, PATHS),
    "collisions": Benchmark("restitution for both readings of a damping, compared with LAMMPS", 20, STEPS),
    "contact_laws": Benchmark("a user's law compared with the built-in one", 60, STEPS),
    "contact_number": Benchmark("contact number of frictional packings", 240, STATICS),
    "contact_status": Benchmark("status of critical contacts, compared with slower methods", 120, PATHS, ratios=True),
    "device": Benchmark("time steps on a graphics processor, compared with all cores", 600, STEPS),
    "directions_of_failure": Benchmark("which sign of failure comes first", 300, STATICS),
    "element_test_budget": Benchmark(
        "a drained triaxial test of 1000 spheres in five minutes",
        120,
        (*STATICS, "wings/soils/element_test"),
        "element_tests:budget_rows",
    ),
    "element_tests": Benchmark("triaxial tests and response envelopes", 1000, (*STATICS, "wings/soils/element_test")),
    "engine": Benchmark("time steps of many spheres, compared with LAMMPS and YADE", 600, LOOP, ratios=True),
    "engine_sizes": Benchmark(
        "time steps of dilute and dense grains, and of up to a million", 2400, LOOP, "engine:size_rows", ratios=True
    ),
    "engine_widths": Benchmark(
        "time steps of spheres of narrow and wide size distributions", 120, LOOP, "engine:width_rows", ratios=True
    ),
    "equilibrium": Benchmark("reliability of verdicts off equilibrium", 600, STATICS),
    "fastest_pair": Benchmark(
        "the fastest pair of up to 100,000 spheres, compared with exact spectra and runs", 1200, STATICS
    ),
    "fault": Benchmark("time steppers for earthquake cycles, compared with SciPy", 300, FRICTION),
    "first_result": Benchmark("seconds to the first result of each command", 200, (*STATICS, "cli", "experiments")),
    "forecast": Benchmark("forecasts of events and pairs, compared with naive ones", 300, STATICS),
    "frictionless_shear": Benchmark("angle of friction of spheres without friction", 900, STATICS),
    "gouge": Benchmark("time steps of fault gouge, compared with LAMMPS", 900, GOUGE, ratios=True),
    "gouge_samples": Benchmark(
        "verdicts on gouge from the stored samples of the paper's size", 10, ("wings/papers/gouge",)
    ),
    "gouge_steps": Benchmark(
        "what velocity steps of gouge determine", 10, ("wings/faults/friction", "wings/papers/gouge")
    ),
    "gouge_thickness": Benchmark("gouge with a thickness of 14 D and of 20 D", 3600, GOUGE),
    "hold_energy": Benchmark("energy of vibrations in holds of gouge", 900, GOUGE),
    "hold_energy_lammps": Benchmark(
        "relaxation in holds of gouge, compared with LAMMPS", 9000, GOUGE, "hold_energy:rows_of_engines"
    ),
    "hold_energy_steps": Benchmark("holds of gouge with several time steps", 900, GOUGE, "hold_energy:rows_of_steps"),
    "inclusions": Benchmark("inflated grains compared with elasticity", 300, STATICS),
    "lammps_ranks": Benchmark("LAMMPS on several MPI ranks", 60, ("wings/lammps",)),
    "load_path_dynamics": Benchmark(
        "ends of load paths, compared with slow dynamics", 1800, PATHS, "load_paths:rows_of_dynamics"
    ),
    "load_paths": Benchmark("ends of load paths with several increments", 1800, PATHS),
    "measured_forces": Benchmark("verdicts from measured forces", 60, (*STATICS, "data/exchange")),
    "memory": Benchmark("memory of states and runs, up to a million grains", 900, LOOP),
    "packings": Benchmark("time to generate packings", 120, STATICS),
    "pairs_by_law": Benchmark("which laws lead to complex pairs: table of a sweep", 20, DISKS),
    "qdyn": Benchmark("earthquake cycles, compared with QDYN", 600, FRICTION, ratios=True),
    "quasi_static": Benchmark("strain steps of frictional spheres", 3000, STATICS),
    "rate_state": Benchmark("spring-sliders, compared with LSODA", 30, FRICTION, ratios=True),
    "rigid_clusters": Benchmark("rigid clusters by linear algebra and by the pebble game", 60, PATHS),
    "spectra": Benchmark(
        "spectra of large packings, compared with LAPACK", 1500, STATICS, "spheres:spectra", ratios=True
    ),
    "spheres": Benchmark("strain steps of spheres, compared with damped dynamics", 900, STATICS, ratios=True),
    "unresolved_events": Benchmark("unresolved events of packings without friction", 900, STATICS),
    "wedged_paths": Benchmark("load paths on which rattlers are wedged", 600, PATHS, "load_paths:rows_of_wedged"),
    "writing": Benchmark("time and size of archives, movies and reports", 600, ("data", "figures", "reports")),
}
