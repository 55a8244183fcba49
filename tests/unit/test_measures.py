"""Measures that runs leave , experiment by experiment: values and units, against tables of their own."""

from types import SimpleNamespace as Made

import numpy as np
import pytest

import stickslip as ss
from stickslip.core import arguments
from stickslip.core.dynamics.ledger import Ledger
from stickslip.experiments.registry import EXPERIMENTS, meaning_of
from stickslip.wings.faults.fault.simulate import FaultResult
from stickslip.wings.faults.friction.fault_cycles import Energy
from stickslip.wings.faults.friction.fault_record import FaultEvents
from stickslip.wings.faults.rate_state.simulate import simulate_slider
from stickslip.wings.papers.gouge import protocol as gouge_run
from stickslip.wings.soils.cyclic_shear.simulate import CyclicRun, Response
from stickslip.wings.soils.element_test.simulate import ElementRun, ElementSeries, SmallStrain
from tests.events.made import samples

LENGTH, TIME, VELOCITY, RATE, RATE_SQUARED, PER_LENGTH, FORCE, ENERGY, STRESS, LINE_ENERGY, NUMBER = range(11)
WRITTEN = {  # as dimensions, and in SI
    LENGTH: ("length", "m"), TIME: ("time", "s"), VELOCITY: ("length/time", "m/s"), FORCE: ("force", "N"),
    ENERGY: ("energy", "J"), STRESS: ("force/length^(dim-1)", "Pa"), RATE: ("1/time", "1/s"),
    RATE_SQUARED: ("1/time^2", "1/s^2"), LINE_ENERGY: ("energy/length", "J/m"), NUMBER: ("1", "1"),
}  # fmt: skip
SI = ("gouge", "rate-state", "fault")


def both(names: str) -> str:
    """Names of measures and of their errors."""
    return " ".join(f"{name} {name}_error" for name in names.split())


# what each measure is, without what stands behind an @; "load" is the scenario's `load.unit`
MEANT = {
    "disk-array": {
        NUMBER: "pairs", "load": "first_birth last_birth first_load_that_slides", RATE_SQUARED: "largest_im_lambda",
        RATE: "largest_growth_rate fitted_growth_rate", VELOCITY: "sliding_velocity",
    },
    "sphere-shear": {
        NUMBER: "packing_fraction coordination rattlers onset_strain onset_exponent pairs_at_last_strain "
        "onset_share_at_limit onset_mobilisation fitted_over_predicted_growth stress_drop_over_pressure "
        "contacts_lost unstable_steps steps_off_branch",
        STRESS: "packing_pressure shear_stress_at_last_strain", RATE: "largest_growth_rate",
    },
    "quasi-rigid": {
        NUMBER: "last_load stress_ratio strain events collapses sliding_share error_of_slowest_dynamics collapse_load",
    },
    "flow": {
        TIME: "end", ENERGY: "kinetic_energy", STRESS: "plane_pressure", RATE: "plane_shear_rate",
        LENGTH: "deposit_top deposit_length run_out plane_height",
        NUMBER: "coordination grains_in_deposit plane_friction plane_friction_deviation plane_inertial_number "
        "plane_packing_fraction",
    },
    "gouge": {
        LENGTH: "thickness",
        NUMBER: "inertial_number stiffness_over_b steady_friction steady_friction_half peak slips "
        "largest_friction_drop",
    },
    "catalogue": {
        NUMBER: "events packings events_per_strain share_saddle_node share_pair share_sliding share_opening "
        "share_breaking share_unstable share_unresolved saddle_node_exponent stress_drop_over_pressure "
        "jump_over_diameter auc_softest auc_nonaffine_rate auc_growth auc_tangent_modulus auc_switch auc_loss_ahead",
    },
    "failure": {
        NUMBER: "strain first_pair first_event first_break broken events pairs first_slide drop",
        STRESS: "stress", RATE: "growth_rate",
    },
    "rate-state": {
        NUMBER: "final_friction least_friction greatest_friction steady_friction stable", VELOCITY: "final_velocity",
        PER_LENGTH: "critical_stiffness", RATE: "growth_rate", TIME: "reached",
    },
    "fault": {
        NUMBER: "events radiated_fraction energy_residual event_energy_residual magnitude",
        TIME: "first_event recurrence duration", VELOCITY: "max_velocity rupture_speed", FORCE: "moment",
        LENGTH: "surface_slip max_slip nucleation_depth nucleation_length rupture_bottom rupture_length crept_length",
        STRESS: "stress_drop slip_weighted_stress_drop seismological_stress_drop",
        LINE_ENERGY: "released radiated fracture",
    },
    "element-test": {
        NUMBER: both("e0 coordination nu0 strain_at_peak e_critical K0 compression_index rowe_correlation skempton "
        "largest_unbalanced rearranged_share strain_at_cone stiffness_number critical_reached critical_from "
        "critical_ratio compression_misfit swelling_index swelling_misfit reloading_index reloading_misfit skempton_B "
        "end_ratio e_end nu nu_half bonds broken_before broken_tension_peak broken_shear_peak broken_tension "
        "broken_shear"),
        STRESS: both("G0 E0 E50 p_critical u_at_peak sigma1_peak sigma3_peak sigma1_critical sigma3_critical p_end "
                     "sigma1_end sigma3_end E E_half UCS tensile_strength strength crack_initiation"),
        "angle": both("phi_peak psi phi_residual phi_rowe cone_direction"),
    },
    "cyclic-shear": {
        NUMBER: both("gamma_half gamma_elastic gamma_returns residual in_band") + " G_ratio damping",
        STRESS: both("G0 G_smallest"),
    },
    "threshold": {
        NUMBER: "threshold threshold_low threshold_high largest_share lasting_threshold lasting_threshold_low "
        "lasting_threshold_high largest_lasting_share arrest_low arrest_high strength first_pair first_limit",
    },
}  # fmt: skip
WORDS = WRITTEN | {"load": ("load",) * 2, "angle": ("degrees",) * 2, PER_LENGTH: ("1/length", "1/m")}
UNITS = {
    experiment: {
        name: WORDS[kind][EXPERIMENTS[experiment].scenario.si]
        for kind, names in kinds.items()
        for name in names.split()
    }
    for experiment, kinds in MEANT.items()
}


def disks():
    """Two pairs are born, and one of three runs slides, whose growth could not be fitted."""

    def family(load, *values):
        return Made(eigenvalues=5 + 1j * np.array(values), birth=Made(load=load) if load else None)

    def free(slid, rate):
        return Made(slid=slid, growth=Made(growth_rate=rate) if rate else None)

    path = [Made(spectrum=Made(growth_rate=np.array(rates))) for rates in ([], [0.0, 0.03], [0.02])]
    runs = {0.02: free(False, 0.011), 0.04: free(False, 0.012), 0.08: free(True, None)}
    families = [family(0.06, 2e-3, 4e-3), family(0.05, 3e-3), family(None, 1e-3)]
    sliding = {0.08: Made(velocity=np.array([0.1, np.nan, 0.3]))}
    return Made(families=families, path=path, free_runs=runs, sliding=sliding), {
        "pairs": 3, "first_birth": 0.05, "last_birth": 0.06, "largest_im_lambda": 4e-3, "largest_growth_rate": 0.03,
        "first_load_that_slides": 0.08, "fitted_growth_rate": 0.012, "sliding_velocity@0.08": 0.2,
    }  # fmt: skip


def spheres():
    """Three packings: medians are those of the middle one, or half-way between the two that have the measure."""

    def path(k):
        packed = Made(packing_fraction=0.6 + k / 100, pressure=1e-3 * k, coordination=5.0 + k, rattlers=10 * k)
        onset = Made(strain=1e-4 * k, exponent=0.5 + k, at_limit=0.1 * k, mobilisation=0.4 * k) if k < 3 else None
        return Made(packed=packed, onset=onset, pairs=np.array([9, k]), growth_rate=np.array([0.01, 0.1]) * k,
                    shear_stress=np.array([9.0, 2e-3 * k]), unstable=5 * k, left=k - 1)  # fmt: skip

    single = [Made(growth=Made(growth_rate=0.3), corrected_rate=0.2), Made(growth=None, corrected_rate=1.0), None]
    later = [Made(drop=0.1, pressure=np.array([0.5, 9.0]), contacts_lost=7), None, None]
    return Made(paths=[path(k) for k in (1, 2, 3)], single=single, later=later), {
        "packing_fraction": 0.62, "packing_pressure": 2e-3, "coordination": 7.0, "rattlers": 20, "onset_strain": 1.5e-4,
        "onset_share_at_limit": 0.15, "onset_mobilisation": 0.6,
        "onset_exponent": 2.0, "pairs_at_last_strain": 2, "largest_growth_rate": 0.2,
        "shear_stress_at_last_strain": 4e-3, "fitted_over_predicted_growth": 1.5, "stress_drop_over_pressure": 0.2,
        "contacts_lost": 7, "unstable_steps": 10, "steps_off_branch": 1,
    }  # fmt: skip


def rigid():
    """Three samples; two have dynamics, and in one of them stability was lost."""

    def sample(k):
        points = [Made(sliding=0, contacts=1), Made(sliding=k, contacts=10)]
        collapses = [Made(quiet=True), *[Made(quiet=False)] * (k - 1)]
        path = Made(load=np.array([0.0, 0.1 * k]), events=[None] * k, points=points, collapses=collapses)
        slow = [Made(time=1.0, error=9.0), Made(time=1e4, error=0.01 * k), Made(time=1e3, error=9.0)] if k < 3 else []
        curve = Made(ratio=np.array([0.0, 0.2 * k]), strain=np.array([0.0, 1e-3 * k]))
        return Made(path=path, curve=curve, slow=slow, collapse=0.9 if k == 1 else None)

    return Made(tested=[sample(k) for k in (1, 2, 3)]), {
        "last_load": 0.2, "stress_ratio": 0.4, "strain": 2e-3, "events": 2, "sliding_share": 0.2, "collapses": 1,
        "error_of_slowest_dynamics": 0.015, "collapse_load": 0.9,
    }  # fmt: skip


def poured():
    """Three disks in a row and one that flies, between two plates of one grain each, the upper one moving."""
    place = np.array([[1.0, 2.0], [2.0, 2.0], [3.0, 2.0], [3.0, 9.0], [4.0, 0.0], [4.0, 12.0]])
    state = ss.assembly(ss.disks(place, 0.5, mass=1.5, velocity=np.array([[0.0, 0, 0]] * 5 + [[3.0, 0, 0]])))
    time = np.arange(1.0, 5.0)
    height, force = np.zeros((4, 2, 3)), np.zeros((4, 2, 3))
    height[:, 1, 1] = 12.0
    force[:, 1, :2] = [[0, 9], [0, 9], [-2.0, 8.0], [-4.0, 12.0]]
    series = Made(time=time, kinetic_energy=time**2, coordination=time / 2, plate_position=height, plate_force=force)
    scenario = Made(cell=Made(periodic=(), size=(5.0, 12.0)), grains=Made(dim=2))
    plates = {"bottom": np.array([4]), "top": np.array([5])}
    result = Made(series=series, frames=[state], scenario=scenario, poured=Made(loose=np.arange(4), plates=plates),
                 stages=[Made(start=0.0, end=4.0)])  # fmt: skip
    gap, pressure = 11.0, 10.0 / 5.0
    return result, {
        "end": 4.0, "kinetic_energy": 16.0, "coordination": 2.0, "deposit_top": 2.5, "grains_in_deposit": 3,
        "deposit_length": 3.0, "run_out": 3.5, "plane_friction": 0.3, "plane_friction_deviation": 0.1,
        "plane_pressure": pressure, "plane_shear_rate": 3 / gap, "plane_height": gap,
        "plane_inertial_number": 3 / gap * np.sqrt(1.5 / (np.pi / 4) / pressure),
        "plane_packing_fraction": np.pi / (5.0 * gap),
    }  # fmt: skip


def crushed():
    """Two samples at two levels of friction, and slides after a hold whose peak is 0.05 above either level."""
    parts = [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]
    load = {"stiffness": 200.0, "definition": "per_stress"}
    scenario = ss.scenario(experiment="gouge", law={"damping_n": 1e4}, protocol=parts, load=load)
    place = np.arange(1, 401) / 200

    def sample(seed, level):
        calm = Made(load_point=place * scenario.grains.mean, friction=np.full(400, level), time=place / 100,
                    velocity=np.full(400, 0.3), slip=place * scenario.grains.mean)  # fmt: skip
        calm.velocity[100:103] = 4.0
        peak = Made(load_point=calm.load_point, friction=level + 0.05 * (np.abs(place - 1) < 0.1))
        rows = ("slide", 0.3, 0.3, 0.0, calm), ("reslide", 0.3, 0.3, 1e-3, peak)
        tests = tuple(gouge_run.Test(*row) for row in rows)
        return gouge_run.Realization(seed, Made(thickness=21.0, inertial_number=2e-4), tests, {}, {})

    return Made(scenario=scenario, realizations=[sample(0, 0.4), sample(1, 0.5)]), {
        "slips": 2, "largest_friction_drop": 0.0,
        "thickness": 0.063, "inertial_number": 2e-4, "steady_friction@0.3": 0.45, "peak@0.3,0.001s,0.3": 0.05,
        "stiffness_over_b": 200.0 * scenario.scales.dc / scenario.scales.b,
    }  # fmt: skip


def announced():
    """Four packings with five events each, and a switch test that announces all of them."""
    shear = Made(window=4e-4, step=4e-4)
    packings = samples(4, 5)
    strain = 4 * 56 * 4e-4
    return Made(samples=packings, number=20, scenario=Made(shear=shear)), {
        "events": 20, "packings": 4, "events_per_strain": 20 / strain, "saddle_node_exponent": 0.5,
        "share_pair": 2 / 20, "share_breaking": 4 / 20, "auc_switch": 1.0,
    }  # fmt: skip


def slid():
    """The spring-slider's own example."""
    chosen = ss.scenario(experiment="rate-state")
    return simulate_slider(chosen), {}


def cycled():
    """Five events, of which the last two are settled; without an event there is no average."""
    start = 10.0 * np.arange(5)
    steady = {name: np.ones(5) for name in FaultEvents._fields} | {
        "start": start,
        "end": start + np.array([0, 0, 0, 1, 3]),
    }
    fault, state = Made(cell=50.0, dc=0.1, changes=("injection",)), Made(excess_slip=np.array([0.05, 0.1, 0.3]))
    history = Made(events=FaultEvents(**steady), energy=Energy(10.0, 7.0, 1.0, 1.0), fault=fault, state=state)
    return FaultResult(Made(line=Made(strike_length=10**19.6)), history, None), {
        "events": 5, "magnitude": 7.0, "event_energy_residual": 0.0, "first_event": 0.0, "recurrence": 10.0,
        "duration": 2.0, "radiated_fraction": 0.1, "energy_residual": 0.1, "moment": 1.0, "crept_length": 100.0,
    }  # fmt: skip


def kicked():
    """Two velocities, of which the smaller never makes the sample slide."""
    threshold = Made(
        kicks=np.array([1e-13, 1e-4]), threshold=np.array([np.nan, 0.04]), arrest_range=(0.02, 0.03), first_pair=0.01,
        interval=np.array([[-np.inf, np.inf], [0.035, 0.05]]), probability=np.array([[0.0, 0.2], [0.0, 0.9]]),
        first_limit=0.015, lasting_threshold=np.array([np.nan, 0.045]),
        lasting_interval=np.array([[-np.inf, np.inf], [0.042, 0.048]]),
        lasting_probability=np.array([[0.0, 0.1], [0.0, 0.8]]),
    )  # fmt: skip
    return Made(found=threshold, strength=0.06), {
        "threshold_low@1e-13": -np.inf, "threshold_high@1e-13": np.inf,
        "largest_share@1e-13": 0.0, "threshold@0.0001": 0.04, "threshold_low@0.0001": 0.035,
        "threshold_high@0.0001": 0.05, "largest_share@0.0001": 0.9, "arrest_low": 0.02, "arrest_high": 0.03,
        "lasting_threshold@0.0001": 0.045, "lasting_threshold_low@0.0001": 0.042,
        "lasting_threshold_high@0.0001": 0.048, "largest_lasting_share@0.0001": 0.8,
        "strength": 0.06, "first_pair": 0.01, "first_limit": 0.015,
    }  # fmt: skip


def loaded_sample():
    """Two triaxial tests of a sample that is elastic and incompressible, one of which is softer."""
    axial = np.linspace(0, 0.1, 101)

    def run(young):
        strain, stress = np.zeros((101, 4)), np.zeros((101, 3, 3))
        strain[:, :3] = axial[:, None] * [-0.5, -0.5, 1]
        stress[:, range(3), range(3)] = 1e5 + young * axial[:, None] * [0, 0, 1]
        columns = {name: np.zeros(101) for name in ElementSeries._fields}
        series = ElementSeries(**columns | {"load": axial, "strain": strain, "stress": stress})
        return ElementRun(0, None, SmallStrain(1.0, 2.0, 3.0, 0.3), series, None, "")

    result = Made(scenario=ss.scenario(experiment="element-test"), runs=(run(1e6), run(1.2e6)))
    return result, {
        "G0": 1.0, "G0_error": 0.0, "nu0": 0.3, "E50": 1.1e6, "E50_error": 12.7062 * 0.1e6, "psi": 0.0,
        "strain_at_peak": 0.1, "phi_peak": 0.5 * np.degrees(np.arcsin(1 / 3) + np.arcsin(0.12 / 0.32)), "e0": 0.0,
    }  # fmt: skip


def failed():
    """A contact slides in the second of three steps, and the third has an event that breaks two bonds."""
    slid, none = np.array([[2, 0, 1]]), np.zeros((0, 3), int)
    event = Made(strain=2.5e-4, stress_drop=0.1, broken=np.array([[0, 1], [2, 3]]))
    steps = [
        Made(strain=k * 1e-4, stress=k, pairs=k, growth=0.1 * k, changes=slid if k == 1 else none) for k in range(1, 4)
    ]
    return Made(scenario=ss.scenario(experiment="failure", packing={"file": "a.npz"}), found=Made(
        steps=steps, events=[event], onset=Made(load=2e-4))
    ), {
        "strain": 3e-4, "stress": 3, "pairs": 3, "growth_rate": 0.3, "first_pair": 2e-4, "first_event": 2.5e-4,
        "first_break": 2.5e-4, "broken": 2, "events": 1, "drop": 0.1, "first_slide": 1e-4,
    }  # fmt: skip


def cycled_sample():
    """Two elastic samples, which yield at a larger amplitude: loops with a straight axis, and an area of their own."""
    theta = np.linspace(0, 2 * np.pi, 401)

    def response(amplitude, g, width, distance):
        gamma, tau = amplitude * np.sin(theta), g * amplitude * np.sin(theta) + width * np.cos(theta)
        energies = np.zeros((2, 401, len(Ledger._fields)))
        energies[:, -1, Ledger._fields.index("external")] = np.pi * amplitude * width
        rows = [np.tile(values, (2, 1)) for values in (gamma, tau, *4 * [0 * theta])]
        return Response(amplitude, *rows, energies, np.zeros(2), np.zeros(2), distance * (1 - np.eye(3)))

    chosen = ss.scenario(experiment="cyclic-shear", cycles={"amplitudes": [1e-6, 1e-4]})
    run = CyclicRun(0, None, 1e8, (response(1e-6, 1e8, 0.0, 0.0), response(1e-4, 4e7, 1e3, 1.0)), None, "")
    return Made(scenario=chosen, runs=(run, run)), {
        "G0": 1e8, "G0_error": 0.0, "G_smallest": 1e8, "gamma_half": 10 ** (-6 + 2 * 0.5 / 0.6), "G_ratio@0.0001": 0.4,
        "damping@0.0001": 1e3 / (2 * 4e7 * 1e-4), "gamma_elastic": 1e-6, "gamma_returns": 1e-6, "residual": 1.0,
        "in_band": 0.0,
    }  # fmt: skip


MADE = {"disk-array": disks, "sphere-shear": spheres, "quasi-rigid": rigid, "flow": poured, "gouge": crushed,
        "rate-state": slid, "fault": cycled, "threshold": kicked, "catalogue": announced, "failure": failed,
        "element-test": loaded_sample, "cyclic-shear": cycled_sample}  # fmt: skip


def test_every_experiment_has_a_table():
    assert set(UNITS) == set(MADE) == set(EXPERIMENTS)


@pytest.mark.parametrize("experiment", MADE)
def test_measures_have_their_values_and_units(experiment, monkeypatch):
    """Every branch is taken, so that the tables have all that a run can leave, and nothing else."""
    result, values = MADE[experiment]()
    monkeypatch.setattr(arguments._door, "passed", True, raising=False)  # results that only look like them
    measured = EXPERIMENTS[experiment].measures(result)
    assert {name.partition("@")[0]: unit for name, (_, unit) in measured.items()} == UNITS[experiment]
    assert {name: measured[name][0] for name in values} == {name: pytest.approx(v) for name, v in values.items()}
    assert all(meaning_of(EXPERIMENTS[experiment], name) for name in measured)
