"""A laboratory for frictional grains: build them, load them, know when and how they will slip.

Every public name is here, and is loaded when first used: `import stickslip` itself imports nothing heavy.
"""

from importlib import import_module

__version__ = "0.1.0"

_WHERE = {
    "core.state": (
        "State Grains Walls Cell Contacts Control assembly box check disks flat_walls heights loads spheres "
        "OPEN STICK SLIDE"
    ),
    "core.contact": "FREE FROZEN HELD",
    "core.control": (
        "between_controls deformed driven following frozen pressed pulled rigid spring_forces stress_controlled"
    ),
    "core.laws": "Law between hertz_mindlin hertz_mindlin_reff linear stiffnesses",
    "core.judge": "LawWarning",
    "core.own": "contact_law law_from_file",
    "core.neighbors": "without_walls",
    "core.outcome": "Outcome Status NotInEquilibriumError",
    "core.frame": "strained",
    "core.forces": "Loads accept forces unbalanced",
    "core.integrate": "run",
    "core.ledger": "Ledger",
    "core.timestep": "stable_time_step",
    "core.jacobian": "contact_blocks",
    "core.measure": (
        "branches contact_forces contact_numbers coordination fabric inertial_number packing_fraction pressure "
        "rattlers stress touching wrapped"
    ),
    "friction.evidence": "Comparison compare",
    "friction.fit": "Fit fit",
    "friction.laboratory": "Record read_csv write_csv",
    "friction.loads": "Leg measured_legs slide_hold_slide velocity_steps",
    "friction.measure": "healing held steady steady_from",
    "friction.model": "Data",
    "friction.ratestate": "History RateState Spring prescribed slide",
    "friction.stability": "critical_stiffness steady_sliding",
    "quasirigid.apex": "Apex consistent_statuses statuses_at_apex",
    "quasirigid.complementarity": "Complementarity complementarity",
    "quasirigid.enumeration": "status_map",
    "quasirigid.matrices": "Matrices damping_matrix matrices quadratic_form stiffness_matrix",
    "quasirigid.mechanisms": "Mechanism mechanisms",
    "quasirigid.path": "Path quasirigid_path",
    "quasirigid.status": "Choice Verdict status",
    "quasirigid.uniqueness": "Uniqueness certificate",
    "solve.balance": "BALANCED_BELOW imbalance likely_causes",
    "solve.collision": "Collision collision eq8_damping with_restitution",
    "solve.damped": "Damped damped_stability",
    "solve.density": "Density density_of_states participation_ratio",
    "solve.equilibrate": "UnstableEquilibriumWarning equilibrate",
    "solve.fastest": "FastestPair fastest_pair",
    "solve.freedom": "Freedom backbone displaced freedom residual_vector restricted stiffness",
    "solve.moduli": "Moduli elastic_moduli",
    "solve.newton": "Kept newton",
    "solve.pairs": "Pairs complex_pairs",
    "solve.relax": "relax residual",
    "solve.sensitivity": "Sensitivity contact_sensitivity",
    "solve.spectrum": "Spectrum damped_growth follow spectrum",
    "solve.stability": "Stability stability",
    "solve.transient": "Transient transient_growth",
    "data.dataset": "contact_table open",
    "data.exchange.files": "read_sample read_samples write_sample",
    "data.exchange.frame": "frame_of",
    "data.exchange.motion": "mode_frames read_mode",
    "data.sample": "SampleError SampleWarning sample",
    "data.flow_scenario": "FlowScenario",
    "data.gouge_scenario": "GougeScenario",
    "data.quasi_scenario": "QuasiScenario",
    "data.ratestate_scenario": "RateStateScenario",
    "data.scenario": "Scenario ScenarioError ShearScenario scenario",
    "data.sweep": "Sweep read_sweep sweep",
    "data.sweep_data": "open_sweep",
    "ensemble": "run_members",
    "experiments.sweep": "run_sweep",
    "loading.flow": "FlowResult Series simulate_flow",
    "loading.flow_numbers": "Deposit PlaneShear deposit plane_shear velocity_profile",
    "loading.biaxial": "biaxial_box sheared_box",
    "loading.packing": "Packed disk_array frictionless jammed pushed",
    "loading.gouge_ensemble": "GougeResult simulate_gouge",
    "loading.pouring": "Poured poured",
    "loading.protocols": "Equilibrium Protocol families fitted_growth free_run path_of ramp shaken stable_window",
    "loading.release": "Released release",
    "loading.run": "Result push simulate",
    "loading.slow": "SlowRun slowly",
    "loading.shear": "aqs reduced_cell shear_strain sheared",
    "loading.shear_run": "ShearPath ShearResult simulate_shear",
}
_ROOM = {name: room for room, names in _WHERE.items() for name in names.split()}
__all__ = ["__version__", "figures", *sorted(_ROOM)]


def __getattr__(name: str):
    if name == "figures":  # a room of many functions, under its own name
        return import_module(".figures", __name__)
    if name in _ROOM:
        return getattr(import_module(f".{_ROOM[name]}", __name__), name)
    raise AttributeError(f"stickslip has no name {name!r}: see dir(stickslip)")


def __dir__():
    return __all__
