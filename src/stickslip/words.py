"""Words that users and other programs use, and the corresponding names of this package.

A word that is neither a public name nor in this table is looked up by its spelling among all public names, then by its
parts in the overviews of namespaces.
"""

import difflib
import inspect
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module

from .wing import wings

# public names, or commands in backticks, and words for them; those for experiments are in the heads of wings
MEANT = {
    "packings.jammed": "cloud make_cloud jam random random_packing generate pack packing create_packing make_packing "
    "jamming rcp rlp",
    "packings.compressed": "compress frictional isotropic_compression consolidate confine",
    "packings.strained": "compress strain deform affine",
    "packings.sheared": "simple_shear pure_shear",
    "packings.perturbed": "kick perturb thermalize",
    "packings.bonded": "bond bonds cement cemented glue glued bpm attach",
    "packings.poured": "pour rain sediment deposit",
    "packings.biaxial_box": "biax biaxial_test biaxial",
    "packings.from_arrays": "hcp fcc bcc crystal lattice hexagonal triangular moment_of_inertia neighbor_list "
    "neighbours from_numpy arrays custom_packing sphere disk polydisperse bidisperse size_distribution grading psd",
    "packings.from_forces": "measured photoelastic pegs experiment_forces",
    "packings.disk_array": "array chain row_of_disks",
    "protocols.shear_to_failure": "shear failure fail when_will_it_fail forecast predict next_event loading",
    "protocols.aqs": "shear athermal quasistatic quasi_static lees_edwards simple_shear pure_shear shear_strength "
    "stress_strain stress_strain_curve",
    "protocols.load_path": "cyclic isotropic_compression unload reload unloading preload",
    "protocols.find_events": "events avalanche rearrangement plastic_event avalanche_size waiting_time",
    "modes.track_pairs": "birth exceptional_point hopf bifurcation track_modes",
    "protocols.free_run": "nve newtonian",
    "protocols.response_envelope": "second_order_work hill gudehus",
    "protocols.localisation": "shear_band localization acoustic_tensor",
    "modes.complex_pairs": "pairs flutter exceptional_point complex_eigenvalues",
    "modes.birth_form": "hopf bifurcation normal_form saddle_node weakly_nonlinear",
    "modes.elastic_moduli": "moduli elastic_constants shear_modulus bulk_modulus poisson nonaffine non_affine born "
    "stiffness_tensor elasticity",
    "modes.equations_of_motion": "mass_matrix damping_matrix mck state_space linearise linearize dae",
    "Grains": "ball balls particle particles grain mass masses radius radii diameter diameters",
    "io.write_matrices": "sparse mtx matrix_market export_matrix save_matrix savemat",
    "modes.density_of_states": "dos vdos density_of_modes phonons boson_peak",
    "modes.participation_ratio": "ipr localisation_of_modes soft_spots softness soft_modes",
    "modes.dynamical_matrix": "stiffness dynamical",
    "quasirigid.stiffness_matrix": "stiffness",
    "modes.frequency_response": "gain shake transfer_function forced_response",
    "modes.trigger_amplitude": "shake trigger seismic_wave dynamic_triggering vibration tapping tap",
    "modes.stationary_fluctuations": "lyapunov noise thermal covariance brownian langevin",
    "modes.dispersion": "sound waves phonon_dispersion",
    "modes.wave_spectrum": "structure_factor dynamic_structure_factor sqw",
    "modes.elastic_speeds": "sound wave_speed p_wave s_wave vp vs",
    "modes.moduli_bounds": "reuss voigt",
    "modes.eigenvalue_gradient": "perturbation_theory",
    "modes.verdict_probability": "uncertainty robustness how_sure",
    "modes.transient_growth": "pseudospectrum non_normal numerical_abscissa",
    "measure.packing_fraction": "volume_fraction phi porosity void_ratio density solid_fraction solids_fraction",
    "measure.elastic_energy": "energy potential_energy",
    "measure.dissipation": "dissipated_energy energy_loss frictional_work",
    "results.Ledger": "energy_balance dissipated_energy energy_budget kinetic_energy",
    "measure.fabric": "fabric_tensor anisotropy",
    "measure.stress": "stress_tensor virial cauchy_stress",
    "measure.force_chains": "force_chain chain_length",
    "measure.strong_network": "backbone strong_contacts percolation",
    "measure.force_anisotropy": "rose anisotropy stress_force_fabric a_c a_n a_t",
    "figures.forces": "force_distribution force_chains rose backbone photoelastic",
    "measure.contact_forces": "normal_force tangential_force forces_between force_distribution fn ft",
    "io.contact_table": "contact_list contacts_dataframe sliding_contacts mobilized_friction mobilised_friction "
    "friction_mobilization contact_status_table",
    "io.contact_graph": "contact_network force_network networkx graph force_chain",
    "measure.coordination": "contact_number coordination_number z isostatic mean_contacts",
    "measure.rattlers": "rattler",
    "measure.stable_time_step": "timestep dt critical_time_step time_step rayleigh",
    "measure.inertial_number": "inertial mu_i rheology",
    "measure.coarse_grained": "continuum coarse_grain coarse_graining goldhirsch field granular_temperature "
    "temperature_field strain_field displacement_field",
    "measure.touching": "sliding_contacts active_contacts",
    "io.read_packing": "load read read_lammps read_dump read_data read_restart from_lammps from_yade from_file dump "
    "lammps yade liggghts import_packing pfc edem",
    "io.write_packing": "save write to_vtk vtk ovito export to_ovito gsd to_lammps to_gsd write_data paraview xyz ase",
    "io.open_dataset": "load to_xarray load_dataset to_pandas open results_of trajectory archive hdf5 h5 netcdf "
    "time_series history",
    "laws.hertz_mindlin": "hertz mindlin hertzian contact_law contact_model",
    "laws.linear": "hooke hookean cundall linear_spring",
    "laws.for_pair": "pair per_pair by_material materials mixture",
    "laws.parallel_bond": "bond bond_law bonded_particle parallel pbond linearpbond cohfrict",
    "laws.custom": "rolling user_law own_law custom_law",
    "laws.with_rolling": "rolling_resistance rolling_friction",
    "laws.jkr": "cohesion adhesion van_der_waals cohesive tensile_strength pull_off",
    "laws.liquid_bridge": "cohesion capillary wet",
    "laws.with_restitution": "restitution coefficient_of_restitution damping dashpot viscous cor",
    "laws.elastic_constants": "young poisson material material_properties",
    "control.force_controlled": "servo",
    "control.stress_controlled": "servo pressure_control triaxial barostat constant_pressure npt",
    "measure.overlaps": "gap gaps overlap penetration indentation",
    "control.driven": "belt driver bumpy wall_velocity intruder",
    "control.loads": "gravity loads external_force body_force",
    "results.ContactLoads": "loads",
    "control.spring_loaded": "spring",
    "control.strained_at": "shear_rate strain_rate lees_edwards",
    "control.fixed": "fix freeze clamp",
    "control": "boundary boundary_conditions wall",
    "box": "periodic pbc cell unit_cell",
    "quasirigid.mechanisms": "floppy zero_modes floppy_modes",
    "quasirigid.rigid_clusters": "pebble_game rigidity rigidity_percolation rigid",
    "quasirigid.complementarity": "lcp linear_complementarity complementarity_problem constraint_matrix",
    "quasirigid.contact_status": "status stick slip_status minimum_sliding",
    "jacobian": "hessian tangent tangent_stiffness",
    "spectrum": "eigen eigvals eigvalsh eigh linalg eigenvalues eigenmodes eigenvectors normal_modes softest_mode "
    "lowest_mode eig diagonalize diagonalise",
    "stability": "buckling is_stable growth_rate oscillatory analyze analyse verdict unstable",
    "relax": "minimize minimise energy_minimize fire settle",
    "newton": "solve solver minimize minimise newton_raphson",
    "equilibrate": "minimize minimise equilibrium",
    "run": "engine engines integrator msd integrate verlet step run_packing simulate_grains md dem dynamics evolve",
    "simulate": "run_scenario experiment",
    "State": "scene o omega model system world snapshot configuration",
    "figures": "plotting plots viz visualization visualisation graphics matplotlib",
    "measure": "analysis observable observables stats statistics postprocessing post_processing",
    "figures.packing": "plot plot_packing show draw force_chains picture",
    "figures.view": "visualize visualise view_3d interactive notebook k3d",
    "figures.movie": "animate animation video gif mp4 film",
    "figures.save": "save_figure savefig pdf svg",
    "friction.fit": "calibrate calibration fit_rate_and_state fit_rate_state fit_rsf inversion invert bootstrap "
    "least_squares",
    "friction.posterior": "mcmc emcee bayesian sampling corner_plot credible_interval",
    "friction.RateState": "rate_and_state dieterich ruina aging_law slip_law a_minus_b ageing_law state_variable dc "
    "direct_effect evolution_effect velocity_weakening velocity_strengthening friction_parameters",
    "friction.spring_slider": "block_on_spring slider velocity_step block stick_slip_cycle",
    "friction.simulate_fault": "recurrence_time earthquake faults seismic_cycle earthquake_cycle seas rupture "
    "dynamic_rupture foreshock aftershock afterslip slow_slip creep tremor process_zone",
    "results.FaultEvents": "quakeml obspy magnitude moment stress_drop event_catalog seismic_moment b_value "
    "gutenberg_richter slip rupture_speed fracture_energy",
    "friction.nucleation": "nucleation_length nucleation_size h_star",
    "friction.critical_stiffness": "kc stiffness_criterion",
    "friction.healing": "frictional_healing ageing aging contact_age",
    "friction": "friction_coefficient rsf",
    "laws": "friction_coefficient coulomb coulomb_friction potential interaction pair_style force_law",
    "protocols.run_batch": "gpu cuda device parallel batch ensemble_run",
    "run_sweep": "sweep parameter_study parameter_sweep grid_search scan parallel",
    "ensemble.run_members": "parallel multiprocessing dask ensemble cluster slurm",
    "io.units_in_use": "units si_units si unit",
    "`stickslip report`": "visualize visualise report html page summary plot view show display open figure figures "
    "gui dashboard browser notebook color colour colormap",
    "`stickslip movie`": "render animate video film picture png snapshot",
    "`stickslip resume`": "restart checkpoint resume continue restore pause cancel kill stop",
    "`stickslip fit`": "calibrate calibration fit_rsf rsf inversion invert rate_and_state",
    "`stickslip convert`": "dump read_data write_data export import save to translate write read",
    "`stickslip stability FILE`": "dos eigen analyze analyse check verdict modes spectrum eigenvalues jacobian "
    "unstable status inspect pairs growth eig info",
    "`stickslip run SCENARIO`": "simulate start execute launch dem sweep batch array ensemble",
    "`stickslip example`": "list ls examples new init create template scenario scenarios start tutorial triaxial",
    "`stickslip docs`": "help manual man documentation keys settings config options guide howto schema units tutorial "
    "how why explain",
    "`stickslip --help`": "help commands usage",
    "`stickslip doctor`": "test selfcheck self_test verify install version check openmp threads set_threads "
    "num_threads info verbose debug",
    "`stickslip --version`": "version",
    "`stickslip reproduce`": "demo papers paper claims reproduction benchmark validate validation",
    "`stickslip docs installation`": "upgrade update self_update completion install_completion conda pip container "
    "docker",
    "`stickslip docs performance`": "speed benchmark benchmarks timing profile",
    "`stickslip cite SCENARIO`": "cite citation reference bibtex doi license",
    "`stickslip shear PACKING`": "compress direct_shear aqs isotropic uniaxial fail predict forecast load unload "
    "strain perturb events",
    "`stickslip watch DIR`": "monitor tail log logs progress follow",
    "`stickslip docs files`": "clean cleanup delete remove purge rm",
    "`stickslip docs faults`": "quakeml obspy",
    "`stickslip docs many_runs`": "merge gather compare submit queue job slurm sweep seed seeds random_seed set_seed "
    "statistics average",
    "`stickslip convert FILE --to packing.gsd` for OVITO or freud": "d_min segregation mixing rdf g_of_r gr g_r "
    "pair_correlation voronoi d2min steinhardt hyperuniformity radial_distribution bond_order static_structure_factor",
    "`to_dataframe()` of a result": "dataframe pandas table csv as_dataframe",
}  # fmt: skip
# subjects that the package leaves to others, and words for them
ABSENT = {
    "grains are disks and spheres": "clump clumps multisphere ellipsoid superquadric polygon polyhedron non_spherical "
    "rod fiber fibre shape triangle",
    "grains do not break": "breakage breakage_model crushing crush fragmentation fragment wear comminution",
    "no fluid flows between grains": "fluid cfd permeability seepage diffusion lubrication porous_flow immersed "
    "hydrodynamics suspension",
    "there is no heat": "heat temperature thermal_conduction heat_transfer",
    "walls are planes": "mesh stl facet facets triangulated_wall cad",
}  # fmt: skip
# options of commands, and words for them
OPTIONS = {
    "frame": "step timestep time index snapshot", "workers": "threads jobs nproc np n_jobs cores procs parallel",
    "out": "output outdir out_dir folder dir directory save file", "modes": "out output save",
    "until": "strain stop to", "step": "increment dt", "overwrite": "force", "quiet": "silent",
    "figures": "plot plots plots_only", "fps": "speed rate", "to": "out output format",
    "settle": "relax equilibrate minimize", "young": "modulus e",
    "poisson": "nu", "mu": "friction mu_s", "columns": "names headers header",
}  # fmt: skip
COMMON = {"get", "set", "compute", "calc", "calculate", "make", "create", "find", "start", "stop", "end", "work"}
COMMON |= {"the", "and", "from", "for", "with", "about", "size"}
ROW = re.compile(r"^ *(\w+(?:, \w+)*)  +(\S.*)$", re.M)
SHORT = 7  # number of letters of a part of a word that are compared


def suggestions(word: str, limit: int = 3) -> list[str]:
    """Public names, and commands in backticks, that a user may mean by a word, best match first.

    Examples
    --------
    >>> suggestions("hessian")
    ['jacobian']
    >>> suggestions("plane_strain_test")
    ['experiments.element_test']
    """
    word = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", word).replace("-", "_").replace(" ", "_").lower().strip("_")
    names = public_names_by_space()
    for forms in ((word,), (word.rstrip("s"), f"{word}s", word.replace("_", "")), _without_an_end(word)):
        found = [f"{space}.{name}".lstrip(".") for space, own in names.items() for name in own if name.lower() in forms]
        found += [target for target, words in meant().items() if not {*forms}.isdisjoint(words.split())]
        if found:
            return list(dict.fromkeys(found))[:limit]
    return (_spelled_like(word, names) or with_rarest_parts(word, _overview()))[:limit]


def meant() -> dict[str, str]:
    """Words for public names, for the experiments of all wings, and for commands."""
    entries = [one for wing in wings().values() for one in wing.experiments.values()]
    names, commands = ({k: v for k, v in MEANT.items() if k.startswith("`") == kind} for kind in (False, True))
    return names | {f"experiments.{one.package}": one.meant_by for one in entries if one.meant_by} | commands


def options_like(word: str, options: list[str]) -> list[str]:
    """Options of a command, without dashes, that a user may mean by an unknown one, best match first."""
    plain = word.lower().strip("-").replace("-", "_")
    found = [one for one in options if plain in OPTIONS.get(one, "").split()]
    return found or [one for one in difflib.get_close_matches(plain, options, n=2, cutoff=0.75) if one[0] == plain[0]]


def absent(word: str) -> str:
    """Reason why the package does not cover the subject of a word; empty for other words."""
    return next((why for why, words in ABSENT.items() if word.lower() in words.split()), "")


def public_names_by_space() -> dict[str, list[str]]:
    """Public names of the package, under "", of its namespaces, and of the modules that these contain, by path."""
    package = import_module(__package__)
    spaces = _modules(package)
    within = {f"{name}.{inner}": module for name, space in spaces.items() for inner, module in _modules(space).items()}
    return {name: public_names(module) for name, module in ({"": package} | spaces | within).items()}


def _modules(space) -> dict:
    """Modules among the public names of a module, by name, without those of wings that are not installed."""
    public = {}
    for name in getattr(space, "__all__", ()):
        with suppress(ImportError):
            public[name] = getattr(space, name)
    return {name: value for name, value in public.items() if inspect.ismodule(value)}


def public_names(module) -> list[str]:
    """Public names of a module: those that it lists, or else those that it defines."""
    local_names = [name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__]
    return list(getattr(module, "__all__", [name for name in local_names if not name.startswith("_")]))


def _without_an_end(word: str) -> list[str]:
    """The word without its first or last part, as in `get_stress` and `triaxial_test`."""
    parts = word.split("_")
    ends = ["_".join(parts[1:]), "_".join(parts[:-1])] if len(parts) > 1 else []
    return [end for end in ends if len(end) > 2]


def _spelled_like(word: str, names: dict[str, list[str]]) -> list[str]:
    """Public names that are spelled like the word, or contain it."""
    full = {f"{space}.{name}".lstrip("."): name.lower() for space, own in names.items() for name in own}
    near = [name for name in difflib.get_close_matches(word, set(full.values()), n=2, cutoff=0.8) if name[0] == word[0]]
    inside = sorted((name for name in set(full.values()) if len(word) > 3 and f"_{word}" in f"_{name}"), key=len)[:2]
    return [place for name in near or inside for place, own in full.items() if own == name]


@cache
def _overview() -> dict[str, str]:
    """Public names with their rows in the overviews of the namespaces."""
    rows = {}
    for space in public_names_by_space():
        text = inspect.getdoc(import_module(f"{__package__}.{space}".rstrip("."))) or "" if "." not in space else ""
        for names, about in ROW.findall(text):
            rows |= {f"{space}.{name}".lstrip("."): f"{name} {about}" for name in names.split(", ")}
    return rows


def with_rarest_parts(word: str, texts: Mapping[str, str]) -> list[str]:
    """Names whose texts contain the rarest parts of a word."""
    rows, wanted = {name: _parts(text) for name, text in texts.items()}, _parts(word)
    weight = {part: 1 / max(sum(part in parts for parts in rows.values()), 1) for part in wanted}
    score = {name: sum(weight[part] for part in wanted & parts) for name, parts in rows.items()}
    best = max(score.values(), default=0.0)
    return [name for name, value in sorted(score.items(), key=lambda item: -item[1]) if value > 0.5 * best > 0]


def _parts(text: str) -> set[str]:
    return {part[:SHORT] for part in re.findall(r"[a-z]{3,}", text.lower().replace("_", " ")) if part not in COMMON}
