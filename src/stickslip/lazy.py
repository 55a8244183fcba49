"""Lazy imports: the names in a stub (`.pyi`) of a package or a namespace are imported on first use.

Type checkers and editors read the same stub, so that each name is listed once.
"""

import ast
import difflib
import inspect
from collections.abc import Iterable
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

# words of users and of other programs, and what they are called here
WORDS = {
    "random": "packings.jammed", "random_packing": "packings.jammed", "generate": "packings.jammed",
    "compress": "packings.compressed, packings.strained", "frictional": "packings.compressed",
    "shear": "protocols.aqs, packings.sheared", "cyclic": "protocols.load_path", "pairs": "modes.complex_pairs",
    "moduli": "modes.elastic_moduli", "elastic_constants": "modes.elastic_moduli",
    "volume_fraction": "measure.packing_fraction", "energy": "measure.elastic_energy",
    "phi": "measure.packing_fraction", "load": "io.read_packing, io.open_dataset", "read": "io.read_packing",
    "read_lammps": "io.read_packing", "read_dump": "io.read_packing", "save": "io.write_packing",
    "write": "io.write_packing", "to_vtk": "io.write_packing", "hertz": "laws.hertz_mindlin",
    "mindlin": "laws.hertz_mindlin", "hooke": "laws.linear", "hookean": "laws.linear", "pair": "laws.for_pair",
    "per_pair": "laws.for_pair", "by_material": "laws.for_pair", "rolling": "laws.custom", "user_law": "laws.custom",
    "servo": "control.force_controlled, control.stress_controlled", "pressure_control": "control.stress_controlled",
    "gravity": "control.loads", "spring": "control.spring_loaded", "shear_rate": "control.strained_at",
    "fix": "control.fixed", "freeze": "control.fixed", "floppy": "quasirigid.mechanisms", "hessian": "jacobian",
    "eigenvalues": "spectrum", "timestep": "measure.stable_time_step", "dt": "measure.stable_time_step",
    "plot": "figures.packing", "plot_packing": "figures.packing", "show": "figures.packing",
    "run_scenario": "simulate", "loads": "control.loads, results.ContactLoads", "fit_rate_and_state": "friction.fit",
    "fit_rate_state": "friction.fit", "rate_and_state": "friction.RateState", "slider": "friction.spring_slider",
    "report": "`stickslip report`", "fabric_tensor": "measure.fabric", "minimize": "relax, newton, equilibrate",
    "minimise": "relax, newton, equilibrate", "energy_minimize": "relax",
    "isotropic_compression": "packings.compressed, protocols.load_path", "triaxial": "control.stress_controlled",
    "recurrence_time": "friction.simulate_fault", "to_xarray": "io.open_dataset", "load_dataset": "io.open_dataset",
    "to_pandas": "io.open_dataset", "plotting": "figures", "stress_tensor": "measure.stress",
    "contact_number": "measure.coordination", "coordination_number": "measure.coordination",
    "rattler": "measure.rattlers", "shear_modulus": "modes.elastic_moduli", "bulk_modulus": "modes.elastic_moduli",
    "dos": "modes.density_of_states", "vdos": "modes.density_of_states", "eigenmodes": "spectrum",
    "stiffness": "modes.dynamical_matrix, quasirigid.stiffness_matrix", "open": "io.open_dataset",
    "restart": "`stickslip resume`", "checkpoint": "`stickslip resume`", "resume": "`stickslip resume`",
    "integrate": "run", "verlet": "run", "step": "run", "cundall": "laws.linear", "hertzian": "laws.hertz_mindlin",
    "cohesion": "laws.jkr, laws.liquid_bridge", "rolling_resistance": "laws.with_rolling",
    "boundary": "control", "periodic": "box",
    "neighbor_list": "packings.from_arrays", "neighbours": "packings.from_arrays", "force_chains": "figures.packing",
    "friction_coefficient": "friction, laws", "porosity": "measure.packing_fraction",
    "void_ratio": "measure.packing_fraction", "density": "measure.packing_fraction", "msd": "run",
    "velocity_step": "experiments.gouge, friction.spring_slider", "rsf": "friction",
    "dieterich": "friction.RateState", "ruina": "friction.RateState", "aging_law": "friction.RateState",
    "slip_law": "friction.RateState", "earthquake": "friction.simulate_fault", "biaxial": "packings.biaxial_box",
    "potential_energy": "measure.elastic_energy", "draw": "figures.packing", "visualize": "figures.view",
    "animate": "figures.movie", "vtk": "io.write_packing", "ovito": "io.write_packing", "export": "io.write_packing",
    "is_stable": "stability", "growth_rate": "stability", "oscillatory": "stability",
    "events": "protocols.find_events", "avalanche": "protocols.find_events", "fire": "relax", "run_packing": "run",
    "moment_of_inertia": "packings.from_arrays", "inertial": "measure.inertial_number",
    "cell_strain": "packings.strained", "poisson": "modes.elastic_moduli, laws.elastic_constants",
    "young": "laws.elastic_constants", "gain": "modes.frequency_response", "lyapunov": "modes.stationary_fluctuations",
    "shake": "modes.frequency_response, modes.trigger_amplitude", "noise": "modes.stationary_fluctuations",
    "sound": "modes.dispersion, modes.elastic_speeds", "waves": "modes.dispersion", "reuss": "modes.moduli_bounds",
}  # fmt: skip


def attach(package: str, file: str):
    """Return `__getattr__`, `__dir__` and `__all__` of a package or a module, from the imports in its stub.

    Parameters
    ----------
    package, file : its `__name__` and `__file__`
    """
    above = package if Path(file).stem == "__init__" else package.rpartition(".")[0]
    where: dict[str, tuple[str, str]] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            where |= {name.asname or name.name: (module, name.name) for name in node.names}

    def get(name: str):
        if name in where:
            module, inner = where[name]
            if module == ".":
                return import_module(f".{inner}", above)
            try:
                source = import_module(module, above)
                return getattr(source, inner) if hasattr(source, inner) else import_module(f".{inner}", source.__name__)
            except ModuleNotFoundError as problem:
                from .wing import without_wing

                raise without_wing(f"{package}.{name}", problem) from None
        raise AttributeError(missing_attribute(package, name, where))

    return get, lambda: sorted(where), sorted(where)


def missing_attribute(package: str, name: str, known: Iterable[str]) -> str:
    """Error message for a missing attribute, with the places where it exists, or the closest name."""
    if name.startswith("_"):
        return f"module {package!r} has no attribute {name!r}"
    root = package.partition(".")[0]
    if hasattr(import_module(package), "__path__") and find_spec(
        f"{package}.{name}"
    ):  # `from package import module` asks first, then imports the module
        return f"{package}.{name} is a module that was not imported: import {package}.{name}"
    near = [f"{root}.{space}.{name}" for space, names in _namespaces(root).items() if name in names]
    others = filter(None, WORDS.get(name.lower(), "").split(", "))
    near = near or [other if other.startswith("`") else f"{root}.{other}" for other in others]
    near = near or [f"{package}.{other}" for other in _closest(name, known)]
    hint = f"did you mean {' or '.join(near)}?" if near else f"see help({package})"
    return f"{package} has no attribute {name!r}: {hint}"


def _namespaces(root: str) -> dict[str, list[str]]:
    """Public names of each namespace, and of those within experiments and figures."""
    spaces = _modules(import_module(root))
    within = {f"{name}.{inner}": module for name, space in spaces.items() for inner, module in _modules(space).items()}
    return {name: public_names(module) for name, module in (spaces | within).items()}


def _modules(space) -> dict:
    """Modules among the public names of a module, by name, without those of wings that are not installed."""
    public = {}
    for name in getattr(space, "__all__", ()):
        with suppress(ImportError):
            public[name] = getattr(space, name)
    return {name: value for name, value in public.items() if inspect.ismodule(value)}


def public_names(module) -> list[str]:
    """Public names of a module: those that it lists, or else those that it defines."""
    own = [name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
    return list(getattr(module, "__all__", [name for name in own if not name.startswith("_")]))


def _closest(name: str, known: Iterable[str]) -> list[str]:
    """Name that contains the given one, or is contained in it, or else is spelled most like it; at most one."""
    inside = [candidate for candidate in known if len(name) > 3 and name.lower() in candidate.lower()]
    return sorted(inside, key=len)[:1] or difflib.get_close_matches(name, known, n=1, cutoff=0.75)
