"""Element tests: gradings, paths, both integrators, and the numbers that are read off them."""

import csv
import json
import re
import sys
import warnings

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.core.laws.builtin import with_values
from stickslip.data import laboratory_table
from stickslip.experiments.realizations import make_law
from stickslip.experiments.registry import SweepMember, named_measures
from stickslip.figures.style import render as png
from stickslip.solve.moduli import elastic_moduli
from stickslip.solve.newton import Factorisation
from stickslip.wings.soils.element_test import figures as element_figures
from stickslip.wings.soils.element_test import simulate as element
from stickslip.wings.soils.element_test.grading import Grading, diameters, from_d10_d50_d60, passing_of
from stickslip.wings.soils.element_test.laboratory import read_test
from stickslip.wings.soils.element_test.measures import (
    SAMPLE,
    LoadedSample,
    dilatancy_angle,
    face_stress,
    friction_angle,
    invariants,
    legs_of,
    log_slope,
    work,
)
from stickslip.wings.soils.element_test.report import (
    columns,
    compare,
    figures,
    fit_critical_line,
    fit_envelope,
    sentences,
)
from stickslip.wings.soils.element_test.sample import check_pressures, drive_of, make_sample
from tests.wings.soils import element_test_lammps

DISKS = {"dim": 2, "grains": 40, "pressure": 100.0, "friction": 0.1}
SPHERES = {"grains": 60, "friction": 0.1}


def scenario(sample=DISKS, **more):
    return ss.scenario(experiment="element-test", sample=sample, **more)


def loaded(sample, **path):
    return ss.simulate(scenario(sample, path=path), workers=1).runs[0]


@pytest.fixture(scope="module")
def spheres():
    """An isotropic sample of spheres, its scenario and its law."""
    chosen = scenario(SPHERES)
    law = make_law(chosen.law)
    state, _ = make_sample(chosen.sample, law, 0, lambda *_: None)
    return chosen, law, state


def rig(spheres, **path):
    chosen, law, state = spheres
    chosen = scenario(SPHERES, path=path)
    return element.Rig(chosen, law, state, drive_of(chosen.path, 3), 1e-9 * 1e5 * 1e-6, Factorisation(), None)


def steps(spheres, loads, **path):
    """States along a path of spheres."""
    here = rig(spheres, **path)
    return [state for state, _, _ in element.quasi_static(here, here.start, np.array(loads), 0)]


# gradings


def test_a_table_of_passing_by_mass_is_reproduced_between_its_points():
    curve = Grading(np.array([0.1, 0.2, 0.5, 1.0]), np.array([0.0, 0.3, 0.8, 1.0]))
    for dim in (2, 3):
        sample = diameters(curve, 20_000, dim)
        grain = sample[-1] ** dim / (sample**dim).sum()  # share of the mass in the largest one
        for size in (0.15, 0.2, 0.3, 0.5, 0.8):
            assert passing_of(sample, size, dim) == pytest.approx(curve.passing_at(size), abs=2 * grain)


def test_d10_d50_d60_are_those_of_the_grains():
    sample = diameters(from_d10_d50_d60(0.2, 0.35, 0.4), 20_000)
    for size, passing in ((0.2, 0.1), (0.35, 0.5), (0.4, 0.6)):
        assert passing_of(sample, size) == pytest.approx(passing, abs=1e-3)


def test_a_lognormal_grading_has_its_median_and_width():
    chosen = scenario({"grains": 5000, "grading": {"kind": "lognormal", "d50": 2e-3, "sigma": 0.3}})
    sample = chosen.sample.diameters
    assert passing_of(sample, 2e-3) == pytest.approx(0.5, abs=2e-3)
    # P(z < 1) between cuts at two standard deviations
    assert passing_of(sample, 2e-3 * np.exp(0.3)) == pytest.approx((0.84134 - 0.02275) / 0.9545, abs=3e-3)


# paths


def test_the_first_step_has_the_stiffness_of_the_elastic_moduli(spheres):
    _, law, state = spheres
    c = elastic_moduli(state, law).tensor
    step = 1e-9
    end = steps(spheres, [0.0, step], kind="triaxial")[1]
    slope = (ss.measure.stress(end, law) - ss.measure.stress(state, law))[2, 2] / step
    normal = np.einsum("aacc->ac", c)  # −∂σ_aa/∂G_cc
    lateral = np.linalg.solve(normal[:2, :2], normal[:2, 2])
    assert slope == pytest.approx(normal[2, 2] - normal[2, :2] @ lateral, rel=1e-3)


def test_no_volume_changes_in_an_undrained_test(spheres):
    start, *_, end = steps(spheres, [0, 1e-4, 1e-3], kind="undrained")
    volumes = [np.linalg.det(state.cell.vectors) for state in (start, end)]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-14)
    assert end.cell.vectors[2, 2] / start.cell.vectors[2, 2] == pytest.approx(np.exp(-1e-3), rel=1e-13)


def test_lateral_stresses_stay_constant_in_a_triaxial_test(spheres):
    law = spheres[1]
    for sign in (1, -1):
        end = steps(spheres, [0, 1e-4 * sign, 1e-3 * sign], kind="triaxial")[-1]
        normal = np.diag(ss.measure.stress(end, law))
        assert normal[:2] == pytest.approx(1e5, rel=1e-8)
        assert sign * (normal[2] - 1e5) > 1e3


def test_the_mean_stress_stays_constant_at_constant_p(spheres):
    for state in steps(spheres, [0, 1e-4, 3e-4], kind="constant-p"):
        assert ss.measure.pressure(state, spheres[1]) == pytest.approx(1e5, rel=2e-6)


def test_the_intermediate_stress_has_its_b_value(spheres):
    end = steps(spheres, [0, 1e-4, 3e-4], kind="true-triaxial", b=0.4)[-1]
    normal = np.diag(ss.measure.stress(end, spheres[1]))
    assert normal[0] == pytest.approx(1e5, rel=1e-8)
    assert (normal[1] - normal[0]) / (normal[2] - normal[0]) == pytest.approx(0.4, abs=1e-4)


def test_strains_that_a_path_excludes_stay_zero(spheres):
    start = spheres[2].cell.vectors
    for kind, held in (("oedometric", [0, 1]), ("plane-strain", [1]), ("simple-shear", [0, 2])):
        end = steps(spheres, [0, 1e-4, 3e-4], kind=kind)[-1]
        assert np.diag(end.cell.vectors)[held] == pytest.approx(np.diag(start)[held], rel=1e-15), kind
    assert end.cell.vectors[1, 0] / end.cell.vectors[1, 1] == pytest.approx(3e-4, rel=1e-4)  # its height changes
    assert ss.measure.stress(end, spheres[1])[1, 1] == pytest.approx(1e5, rel=1e-8)


def test_an_isotropic_path_leads_to_its_pressures(spheres):
    loads = np.log([1e5, 1.5e5, 2e5, 1e5])
    *_, top, end = steps(spheres, loads, kind="isotropic", pressures=[2e5, 1e5])
    assert np.diag(ss.measure.stress(top, spheres[1])) == pytest.approx(2e5, rel=1e-8)
    assert np.diag(ss.measure.stress(end, spheres[1])) == pytest.approx(1e5, rel=1e-8)
    assert np.linalg.det(top.cell.vectors) < np.linalg.det(end.cell.vectors)


def test_steps_grow_from_the_start_of_each_leg():
    loads = element.loads_of(scenario(path={"strain": [0.01, 0.005], "step": 1e-3}))
    turn = int(loads.argmax())
    assert loads[0] == 0 and loads[turn] == pytest.approx(0.01) and loads[-1] == pytest.approx(0.005)
    size = np.abs(np.diff(loads))
    assert size[1] == pytest.approx(1.5e-6) and size[turn + 1] == pytest.approx(1.5e-6)
    assert size[0] == pytest.approx(1e-6) and size[turn] == pytest.approx(1e-6) and size.max() <= 1e-3 * (1 + 1e-9)
    assert (np.diff(loads[: turn + 1]) > 0).all() and (np.diff(loads[turn:]) < 0).all()


def test_both_integrators_agree_before_grains_rearrange():
    """A slow test at I = 1e-5, whose inertia changes stresses by far less than 1 %."""
    sample = DISKS | {"grains": 100}
    slow = loaded(sample, strain=2e-4, integrator="dynamic", inertial_number=1e-5).series
    still = loaded(sample, strain=2e-4).series
    assert not still.rearranged.any()
    q, p = (invariants(face_stress(series.stress, "triaxial"), 2)[1] for series in (slow, still))
    assert q[-1] == pytest.approx(p[-1], rel=0.01)
    assert slow.void_ratio[-1] == pytest.approx(still.void_ratio[-1], rel=1e-5)
    assert slow.unbalanced.max() < 1e-2


def test_a_dynamic_undrained_test_keeps_its_volume():
    path = {"kind": "undrained", "strain": 1e-4, "integrator": "dynamic", "inertial_number": 1e-3}
    result = ss.simulate(scenario(path=path), workers=1)
    series, (table,) = result.runs[0].series, [columns(run, result.scenario) for run in result.runs]
    assert 0 < np.abs(series.strain[:, :3].sum(axis=1)).max() < 1e-12
    # round-off is zero in tables, numbers and figures; the quantity is the pressure that the water takes over
    assert not table["volumetric_strain"].any() and not np.signbit(table["volumetric_strain"]).any()
    water = 100.0 - series.stress[:, 0, 0]
    np.testing.assert_allclose(table["pore_pressure"], water, atol=1e-3)
    found = numbers(result.runs[0], result.scenario)
    peak = int(table["phi"].argmax())
    assert found["u_at_peak"] == pytest.approx(water[peak], abs=1e-3)
    assert found["skempton"] == pytest.approx(
        water[peak] / (series.stress[peak, 1, 1] - series.stress[peak, 0, 0]), rel=1e-3
    )
    drawn = dict(figures(result))
    effective, total = drawn["fig2_stress_path.png"].axes[0].lines
    np.testing.assert_allclose(total.get_xdata() - effective.get_xdata(), table["pore_pressure"], atol=1e-9)
    assert "excess pore" in drawn["fig1_stress_strain.png"].axes[1].get_ylabel()
    low, high = drawn["fig3_void_ratio.png"].axes[0].get_ylim()
    assert high - low > 0.01 * table["void_ratio"][0] > 1e6 * np.ptp(table["void_ratio"])


@pytest.mark.parametrize("dim", [2, 3])
def test_strains_that_cancel_are_no_dilatancy_and_real_ones_are_kept(dim):
    rate = np.array([-1.0, 0.0, 1.0 + 3e-10, 0.0]) if dim == 3 else np.array([-1.0, 1.0 + 3e-10, 0.0, 0.0])
    assert dilatancy_angle(rate, dim) == 0
    assert dilatancy_angle(rate * [1, 1 + 1e-6, 1 + 1e-6, 0], dim) != 0


def test_lammps_follows_the_same_path():
    """Stresses from `python -m tests.wings.soils.element_test_lammps`; slip in LAMMPS is first order in time."""
    state, _, _ = ss.io.read_packing(element_test_lammps.SAMPLE)
    here = np.array(element_test_lammps.stresses(element_test_lammps.rig(state, "stickslip")))
    there = np.array(json.loads(element_test_lammps.STORE.read_text(encoding="utf-8")))
    assert there[-1, 2] - there[0, 2] > 5e3
    np.testing.assert_allclose(here, there, rtol=2e-4)


def test_friction_during_the_compression_controls_the_density():
    loose, dense = (
        make_sample(chosen.sample, make_law(chosen.law), 0, lambda *_: None)[1].packing_fraction
        for chosen in (scenario(DISKS | {"friction": mu, "grains": 60}) for mu in (1.0, 0.0))
    )
    assert dense > loose + 0.01


# numbers


def made(strain, stress, load=None, void_ratio=None, dim=3):
    """A run with a given series."""
    n = len(strain)
    full, tensor = np.zeros((n, 4)), np.zeros((n, 3, 3))
    full[:, : np.shape(strain)[1]] = strain
    for k in range(3):
        tensor[:, k, k] = np.asarray(stress)[:, k]
    nothing = np.zeros(n)
    load = full[:, dim - 1] if load is None else load
    series = element.ElementSeries(
        np.asarray(load), full, tensor, nothing if void_ratio is None else void_ratio, nothing, nothing, nothing,
        nothing, nothing.astype(bool),
    )  # fmt: skip
    return element.ElementRun(0, None, element.SmallStrain(*[np.nan] * 4), series, None, "")


def numbers(run, chosen) -> dict:
    """Quantities of one sample."""
    return SAMPLE.of(LoadedSample(run, chosen))


def test_angles_and_invariants_by_hand():
    stress = np.array([np.diag([100.0, 100.0, 300.0]), np.diag([200.0, 200.0, 100.0]), np.diag([1.0, 1.0, 1.0])])
    p, q = invariants(stress, 3)
    assert p == pytest.approx([500 / 3, 500 / 3, 1]) and q == pytest.approx([200, -100, 0])
    assert friction_angle(stress, 3) == pytest.approx([30.0, np.degrees(np.arcsin(1 / 3)), 0.0])
    sheared = np.array([[[1.0, -0.5, 0], [-0.5, 1.0, 0], [0, 0, 1.0]]])
    assert friction_angle(sheared, 3) == pytest.approx([30.0])
    assert invariants(sheared, 3)[1] == pytest.approx([0.5 * 3**0.5])
    assert invariants(-sheared + 2 * np.eye(3), 3)[1] == pytest.approx([-0.5 * 3**0.5])
    assert dilatancy_angle(np.array([-0.6, -0.6, 1.0, 0.0]), 3) == pytest.approx(np.degrees(np.arcsin(0.2 / 2.2)))
    assert dilatancy_angle(np.array([0.0, -0.5, 0.0, 1.0]), 2) == pytest.approx(np.degrees(np.arctan(0.5)))


def test_numbers_of_a_hyperbolic_test_with_known_dilatancy():
    """q = 4e5 ε/(0.01 + ε), dε_v = −0.2 dε_a: E50 from half of the largest q, ψ, and no critical state."""
    axial = np.linspace(0, 0.1, 401)
    q = 4e5 * axial / (0.01 + axial)
    side = -0.6 * axial
    run = made(np.column_stack([side, side, axial]), np.column_stack([0 * q + 1e5, 0 * q + 1e5, 1e5 + q]))
    found = numbers(run, scenario({}))
    half = 0.5 * q[-1]
    assert found["E50"] == pytest.approx(half / (0.01 * half / (4e5 - half)), rel=1e-3)
    assert found["phi_peak"] == pytest.approx(np.degrees(np.arcsin(q[-1] / (2e5 + q[-1]))))
    assert found["psi"] == pytest.approx(np.degrees(np.arcsin(0.2 / 2.2)), rel=1e-6)
    assert np.isnan(found["phi_residual"]) and np.isnan(found["K0"])


@pytest.mark.parametrize("sine", [0.2, -0.1])
def test_the_flow_rule_of_mohr_and_coulomb_has_its_dilatancy_on_every_path(sine):
    """Flow from g = σ₁ − σ₃ − (σ₁ + σ₃) sin ψ: λ (1 − sin ψ) along σ₁ and −λ (1 + sin ψ) along σ₃."""
    along, across = 1 - sine, -(1 + sine)
    for rates in ([across / 2, across / 2, along], [along / 2, along / 2, across], [across, 0.0, along]):
        assert dilatancy_angle(np.array([*rates, 0.0]), 3) == pytest.approx(np.degrees(np.arcsin(sine)))


def test_dilatancy_at_an_early_peak_is_not_that_of_the_start():
    """dε_v/dε_a = −0.4 (x/0.02) exp(1 − x/0.02) with its extremum at the peak of σ₁, a tenth of the way."""
    axial = np.linspace(0, 0.2, 2001)
    shape = axial / 0.02 * np.exp(1 - axial / 0.02)
    volumetric = -0.4 * np.append(0, np.cumsum(0.5 * (shape[1:] + shape[:-1]) * np.diff(axial)))
    side = 0.5 * (volumetric - axial)
    stress = 1e5 * np.column_stack([0 * shape + 1, 0 * shape + 1, 1 + 2 * shape])
    found = numbers(made(np.column_stack([side, side, axial]), stress), scenario({}))
    assert found["E50"] == pytest.approx(1e5 / np.interp(0.5, shape[:201], axial[:201]), rel=1e-6)  # q softens
    assert found["strain_at_peak"] == pytest.approx(0.02)
    assert found["psi"] == pytest.approx(np.degrees(np.arcsin(0.4 / 2.4)), rel=0.06)


@pytest.mark.parametrize(("sign", "a"), [(1, 1 / 3), (-1, 2 / 3)])
def test_skempton_s_a_of_an_elastic_sample(sign, a):
    """Without a change of volume p of an isotropic elastic sample is constant."""
    axial = sign * np.linspace(0, 0.01, 21)
    q = 3e6 * axial
    stress = np.column_stack([1e5 - q / 3, 1e5 - q / 3, 1e5 + 2 * q / 3])
    run = made(np.column_stack([-axial / 2, -axial / 2, axial]), stress, void_ratio=0.6 + 0 * axial)
    found = numbers(run, scenario({}, path={"kind": "undrained", "strain": sign * 0.01}))
    assert found["skempton"] == pytest.approx(a) and found["skempton_B"] == 1


@pytest.mark.parametrize("path", [{"kind": "undrained", "strain": 4e-4}, {"kind": "isotropic", "pressures": [120.0]}])
def test_a_dynamic_test_holds_the_total_stress_of_its_cell(path):
    """Within 1 % of the pressure while grains move; the quasi-static test has the same pore pressure."""
    fluid = {"fluid_modulus": 1e5}
    moving, still = (
        (run.series, columns(run, chosen)["pore_pressure"])
        for how in ({"integrator": "dynamic", "inertial_number": 1e-3}, {})
        for chosen in [scenario(path=path | fluid | how)]
        for run in ss.simulate(chosen, workers=1).runs
    )
    (series, water), (_, expected) = moving, still
    lateral = np.exp(series.load) if path["kind"] == "isotropic" else 100.0
    assert series.stress[:, 0, 0] + water == pytest.approx(lateral, abs=1.0)
    assert water[-1] == pytest.approx(expected[-1], abs=1.0) and expected[-1] > 5


def bulk_modulus(spheres, pressure):
    """Tangent bulk modulus of a drained sample, from its start."""
    _, law, state = spheres
    end = steps(spheres, np.log([1e5, pressure]), kind="isotropic", pressures=[2e5])[1]
    strain = -np.log(np.linalg.det(end.cell.vectors) / np.linalg.det(state.cell.vectors))
    return (ss.measure.pressure(end, law) - ss.measure.pressure(state, law)) / strain


@pytest.mark.parametrize("fluid", [1e6, 3e7, 2.2e9])
def test_skempton_s_b_is_that_of_a_closed_sample_with_a_compressible_fluid(spheres, fluid):
    """B = 1/(1 + n K/K_f) with the measured K of the drained sample and rigid grains."""
    _, law, state = spheres
    n = 1 - ss.measure.packing_fraction(state)
    b = 1 / (1 + n * bulk_modulus(spheres, 1e5 * (1 + 1e-4)) / fluid)
    rise = 1e5 * 1e-4 / (1 - b)  # of the cell, so that the skeleton carries the same
    path = {"kind": "isotropic", "pressures": [1e5 + rise], "fluid_modulus": fluid}
    end = steps(spheres, np.log([1e5, 1e5 + rise]), **path)[1]
    closed = np.diag(ss.measure.stress(end, law))
    assert np.ptp(closed) < 5e-3 * (closed - 1e5).mean()
    assert 1 - (closed.mean() - 1e5) / rise == pytest.approx(b, rel=1e-3)
    series = made(*2 * [np.zeros((2, 3))], void_ratio=np.array([n / (1 - n), 1 / ss.measure.packing_fraction(end) - 1]))
    series = series.series._replace(stress=np.array([ss.measure.stress(each, law) for each in (state, end)]))
    run = made(np.zeros((2, 3)), np.zeros((2, 3)))._replace(series=series, elastic=element._small_strain(state, law))
    found = numbers(run, scenario(SPHERES, path=path))
    assert found["skempton_B"] == pytest.approx(b, rel=1e-3)
    told = " ".join(sentences(element.ElementTestResult(scenario(SPHERES, path=path), law, (run,), None, ())))
    assert f"As measured over the first change of the cell pressure, B is {found['skempton_B']:.3g};" in told
    sheared = scenario(SPHERES, path={"kind": "undrained", "fluid_modulus": fluid})
    # so few spheres are anisotropic: K under an isotropic strain is larger than under an isotropic stress
    assert numbers(run, sheared)["skempton_B"] == pytest.approx(b, rel=0.01)


@pytest.mark.parametrize("fluid", [1e6, 2.2e9])
def test_a_fluid_and_the_grains_bear_the_pressure_of_the_cell(spheres, fluid):
    law, loads = spheres[1], [0, 1e-5, 1e-4, 1e-3]
    start, *_, end = steps(spheres, loads, kind="undrained", fluid_modulus=fluid)
    e0, e = (1 / ss.measure.packing_fraction(state) - 1 for state in (start, end))
    normal, water = np.diag(ss.measure.stress(end, law)), fluid * np.log(e0 / e)
    assert normal[:2].mean() + water == pytest.approx(1e5, rel=2e-6) and normal[2] + water > 1.05e5
    sides = np.diag(end.cell.vectors)[:2] / np.diag(start.cell.vectors)[:2]
    assert sides[0] == pytest.approx(sides[1], rel=1e-14)
    limits = [steps(spheres, loads, kind=kind)[-1] for kind in ("triaxial", "undrained")]  # drained and incompressible
    lateral = [np.diag(ss.measure.stress(each, law))[:2].mean() for each in limits]
    assert normal[:2].mean() == pytest.approx(lateral[int(fluid > 1e9)], rel=0.02)


def test_rowe_s_relation_is_recovered_with_its_angle():
    """σ₁/σ₃ = K D with D = 1 − dε_v/dε₁ rising from 1 to 1.3 and K of an angle of 20 degrees."""
    axial = np.linspace(0, 0.1, 2001)
    d = 1 + 3 * axial
    ratio = np.tan(np.radians(45 + 10)) ** 2 * d
    volumetric = -np.cumsum(np.append(0, (0.5 * (d[1:] + d[:-1]) - 1) * np.diff(axial)))
    side = 0.5 * (volumetric - axial)
    run = made(np.column_stack([side, side, axial]), 1e5 * np.column_stack([0 * ratio + 1, 0 * ratio + 1, ratio]))
    found = numbers(run, scenario({}))
    assert found["phi_rowe"] == pytest.approx(20.0, abs=0.01)
    assert found["rowe_correlation"] == pytest.approx(1.0, abs=1e-4)


def test_a_critical_state_is_found_only_where_volume_and_stresses_are_steady():
    axial = np.linspace(0, 0.2, 401)
    rise = 1 - np.exp(-axial / 0.01)
    for drift, there in ((0.0, True), (0.2, False)):  # dε_v/dε_a = −0.2 in the second
        side = -0.5 * axial * (1 + drift)
        stress = 1e5 * np.column_stack([0 * rise + 1, 0 * rise + 1, 1 + rise])
        run = made(np.column_stack([side, side, axial]), stress, void_ratio=0.6 + 0 * axial)
        found = numbers(run, scenario({}))
        assert found["critical_reached"] == there == np.isfinite(found["phi_residual"])
        if there:  # q/p = 1e5/(4e5/3), from two thirds of the path on
            assert [found[name] for name in ("critical_ratio", "critical_from", "e_critical")] == pytest.approx(
                [0.75, 2 / 15, 0.6], rel=5e-3
            )
    assert numbers(made(np.zeros((9, 3)), np.ones((9, 3))), scenario({}))["e0"] == 0


def test_rows_at_the_same_load_do_not_end_a_leg():
    load = np.array([0.0, 1.0, 1.0, 2.0, 1.5, 1.5, 3.0])
    run = made(np.zeros((7, 3)), np.ones((7, 3)), load=load)
    assert [leg.load.tolist() for leg in legs_of(run.series, 3, "triaxial")] == [[0, 1, 1, 2], [2, 1.5, 1.5], [1.5, 3]]


@pytest.mark.parametrize("kind", ["oedometric", "isotropic"])
def test_compression_swelling_and_reloading_are_told_apart(kind):
    """Lines e = 0.7 − C log σ with C_c = 0.1, C_s = 0.02 and C_r = 0.03, and K0 = 0.4 (loading), 0.8 (unloading)."""
    ways = [
        (0, 0.7, 0.1, 0.4),
        (0.7, 0.5, 0.02, 0.8),
        (0.5, 0.7, 0.03, 0.8),
        (0.7, 1.2, 0.1, 0.4),
        (1.2, 0.3, 0.02, 0.8),
    ]
    decades, e, k0 = [0.0], [0.7], [0.4]
    for start, end, index, k in ways:
        part = np.linspace(start, end, 41)[1:]
        e += list(e[-1] - index * (part - start))
        decades += list(part)
        k0 += [k] * 40
    vertical, axial = 1e5 * 10 ** np.array(decades), np.log(1.7) - np.log(1 + np.array(e))
    lateral = np.array(k0) * vertical if kind == "oedometric" else vertical
    run = made(np.column_stack([0 * axial, 0 * axial, axial]), np.column_stack([lateral, lateral, vertical]),
               load=np.array(decades), void_ratio=np.array(e))  # fmt: skip
    path = {"kind": kind} | ({"pressures": [2e5]} if kind == "isotropic" else {})
    found = numbers(run, scenario({}, path=path))
    if kind == "oedometric":
        assert found["K0"] == pytest.approx(0.4)
    for name, index in (("compression", 0.1), ("swelling", 0.02), ("reloading", 0.03)):
        assert found[f"{name}_index"] == pytest.approx(index, rel=1e-6), name
        assert found[f"{name}_misfit"] < 1e-6


def test_the_error_of_a_compression_index_covers_its_scatter():
    """95 % intervals of the slope of e + noise hold the true one in about 95 % of 200 cases (2σ of a binomial: 3 %)."""
    rng, x = np.random.default_rng(1), np.linspace(5, 6, 200)
    found = [log_slope(10**x, 0.7 - 0.1 * x + 1e-3 * rng.normal(size=200)) for _ in range(200)]
    assert 0.9 < np.mean([abs(each.index - 0.1) < each.error for each in found]) < 0.99


def test_work_at_a_constant_pressure_is_the_pressure_times_the_change_of_volume():
    """By finite strains: W/V₀ = p (1 − V/V₀), where ε_v = −ln(V/V₀)."""
    strain = np.linspace(0.0, 0.1, 400)[:, None] * [1.0, 1.0, 1.0, 0.0]
    absent = [np.zeros(400)] * 6
    series = element.ElementSeries(strain[:, 0], strain, np.tile(2.0 * np.eye(3), (400, 1, 1)), *absent)
    np.testing.assert_allclose(work(series), 2.0 * (1 - np.exp(-3 * strain[:, 0])), atol=1e-6)


def test_work_of_an_elastic_cycle_is_zero_and_of_plastic_strain_is_not():
    axial = np.concatenate([np.linspace(0, 1e-4, 51), np.linspace(1e-4, 0, 51)[1:]])
    stress = 1e5 + 1e8 * axial
    run = made(np.column_stack([0 * axial, 0 * axial, axial]), np.column_stack([stress] * 3))
    done = work(run.series)
    assert done[50] == pytest.approx(1e5 * 1e-4 + 0.5 * 1e8 * 1e-8, rel=2e-4)  # volume changes by 1e-4
    assert abs(done[-1]) < 1e-12 * done[50]


# Mohr circles


def circles_of(phi, cohesion, sigma3):
    n = np.tan(np.radians(45 + phi / 2)) ** 2
    return n * sigma3 + 2 * cohesion * np.sqrt(n), sigma3


def test_the_envelope_of_exact_circles_touches_them():
    """Circles of radius c cos φ + middle × sin φ have the tangent c + σ tan φ."""
    sigma1, sigma3 = circles_of(28.0, 12e3, np.array([50e3, 100e3, 400e3]))
    found = fit_envelope(sigma1, sigma3)
    assert [found.phi, found.cohesion] == pytest.approx([28.0, 12e3])
    assert found.phi_error < 1e-6 and found.cohesion_error < 1e-3
    phi = np.radians(found.phi)
    distance = (found.cohesion + 0.5 * (sigma1 + sigma3) * np.tan(phi)) * np.cos(phi)  # from the middles
    assert distance == pytest.approx(0.5 * (sigma1 - sigma3))
    assert np.isnan(fit_envelope(sigma1[:2], sigma3[:2]).phi_error)
    with pytest.raises(ValueError, match="two or more values of σ₃"):
        fit_envelope(sigma1[[0, 0]], sigma3[[0, 0]])


def test_errors_of_the_envelope_cover_the_scatter_of_samples():
    """In 300 sets of samples whose σ₁ scatters by 3 %, 95 % intervals hold φ and c (4σ of a binomial: 5 %)."""
    rng, hits = np.random.default_rng(2), []
    sigma1, sigma3 = circles_of(25.0, 5e3, np.array([50e3, 100e3, 200e3, 300e3, 400e3]))
    for _ in range(300):
        found = fit_envelope(sigma1 + 0.03 * (sigma1 + sigma3) * rng.normal(size=5), sigma3)
        hits.append([abs(found.phi - 25) < found.phi_error, abs(found.cohesion - 5e3) < found.cohesion_error])
    assert (np.mean(hits, axis=0) > 0.9).all() and (np.mean(hits, axis=0) < 1).all()


def swept(phi, cohesion, pressures, steady=None, **others):
    """Members of a sweep with given angles, on a line e = 0.8 − 0.02 ln p; the last one not in a critical state."""
    members = []
    for k, pressure in enumerate(pressures):
        major, minor = circles_of(phi, cohesion, pressure)
        there = k < (len(pressures) - 1 if steady is None else steady)
        end, p = np.where(there, 0.9, np.nan), 0.9 * (major + 2 * minor) / 3
        values = {
            "sigma1_peak": major, "sigma3_peak": minor, "sigma1_critical": end * major, "sigma3_critical": end * minor,
            "sigma1_end": 0.9 * major, "sigma3_end": 0.9 * minor, "phi_peak": phi, "phi_residual": end / 0.9 * phi,
            "critical_reached": there, "p_end": p, "end_ratio": 0.9 * (major - minor) / p,
            "e_end": 0.8 - 0.02 * np.log(p / 1e3),
        }  # fmt: skip
        units = dict.fromkeys([name for name in values if name[:2] in ("si", "p_")], "Pa")
        measures = {
            f"{name}{end}": (float(value), units.get(name, "1"))
            for name, mean in values.items() for end, value in (("", mean), ("_error", 0.0))
        }  # fmt: skip
        members.append(
            SweepMember({"sample.pressure": pressure} | {n: v[k] for n, v in others.items()}, measures, None)
        )
    return members


def test_a_sweep_over_the_pressure_gives_mohr_circles_and_an_envelope():
    members = swept(25.0, 3e3, [5e4, 1e5, 2e5], **{"law.young": [5e8, 1e9, 2e9]})  # which varies with the pressure
    found = compare(members)
    assert re.search(
        r"at the peak: φ = \(25.000\d* ± \S+\)°, c = \(3.000\d* ± \S+\) kPa, from 3 of 3 members", found.remarks[0]
    )
    assert "critical state: φ = 25°, c = 2.7 kPa, from 2 of 3 members" in found.remarks[1]
    panels = found.files["mohr.png"].axes
    assert [len(axes.lines) for axes in panels] == [4, 3] and len(png(found.files["mohr.png"])) > 5000
    first = panels[0].lines[0]
    assert first.get_xdata().min() == pytest.approx(50) and first.get_ydata().max() == pytest.approx(
        0.5 * (members[0].measures["sigma1_peak"][0] / 1e3 - 50)
    )
    heading, *rows = csv.reader(line for line in found.files["mohr.csv"].splitlines() if line[0] != "#")
    assert heading[:4] == ["sample.pressure [Pa]", "law.young", "sigma3_peak [Pa]", "sigma3_peak_error [Pa]"]
    assert [float(row[0]) for row in rows] == [5e4, 1e5, 2e5]
    assert [float(row[heading.index("critical_reached [-]")]) for row in rows] == [1, 1, 0]
    for name in [name for name in members[0].measures if "_end" in name or "end_" in name]:
        del members[0].measures[name]  # as in sweeps of earlier versions
    assert compare(members).remarks[:2] == found.remarks[:2]


def test_critical_states_of_a_sweep_lie_on_a_line_and_others_on_none():
    """Spheres without cohesion at φ have M = 6 sin φ/(3 − sin φ)."""
    pressures, sine = [5e4, 1e5, 2e5, 4e5], np.sin(np.radians(25))
    found = compare(swept(25.0, 0.0, pressures))
    ratio = f"{6 * sine / (3 - sine):.6f}"
    line = next(text for text in found.remarks if "Critical-state line" in text)
    assert f"M = {ratio[:5]}" in line and re.search(r"Γ = 0.80+ ± \S+, λ = 0.020+ ± ", line)
    assert re.search(r"φ_cs = \(?25\S*.* without cohesion, from 3 of 4 members", line) and "ln(p / kPa)" in line
    left, right = found.files["critical_state.png"].axes
    steady, other, fitted = right.lines
    assert [len(each.get_xdata()) for each in (steady, other)] == [3, 1] and len(png(right.figure)) > 5000
    np.testing.assert_allclose(fitted.get_ydata(), 0.8 - 0.02 * np.log(fitted.get_xdata()))
    assert left.lines[-1].get_ydata()[-1] == pytest.approx(float(ratio) * left.lines[-1].get_xdata()[-1], rel=1e-6)
    without = compare(swept(25.0, 0.0, pressures, steady=1))
    assert "path, not steady: φ = (25" in without.remarks[1] and "from 4 of 4" in without.remarks[1]
    assert without.remarks[2].startswith("1 of 4 members reached a critical state; ")
    assert [len(each.lines) for each in without.files["critical_state.png"].axes] == [2, 2]
    for p in ([1.0, 1.0], [1.0], [-1.0, 1.0]):
        with pytest.raises(ValueError, match=r"critical-state line|critical states"):
            fit_critical_line(np.array(p), np.ones(len(p)), np.ones(len(p)))


def test_envelopes_are_those_of_members_that_differ_in_the_pressure_alone():
    pressures = [5e4, 1e5, 2e5] * 2
    members = swept(25.0, 0.0, pressures[:3], **{"law.mu": [0.5] * 3}) + swept(
        20.0, 0.0, pressures[3:], **{"law.mu": [0.3] * 3}
    )
    found = compare(members)
    assert [re.search(r"law\.mu = \S+\): φ = \(?\d+", text)[0] for text in found.remarks if "peak" in text] == [
        "law.mu = 0.5): φ = (25", "law.mu = 0.3): φ = (20"
    ]  # fmt: skip
    assert compare(members[:1]).files == {}


def test_stresses_of_less_than_two_decades_are_numbers_on_a_logarithmic_axis():
    table = {"p": np.array([50.0, 100.0, 600.0]), "q": np.zeros(3), "void_ratio": np.array([0.7, 0.68, 0.6])}
    figure = element_figures.void_ratio([table], "kPa")
    figure.draw_without_rendering()
    assert {"50", "100", "200", "500"} <= {text.get_text() for text in figure.axes[0].get_xticklabels()}


# tests of laboratories


LOADED = np.linspace(0, 0.1, 6)  # nominal axial strain
DEVIATOR = 3e5 * LOADED / (0.02 + LOADED)  # [Pa]
DILATION = -0.2 * LOADED


def table_of(path, headings, *columns, mark=";", comma=True):
    rows = [mark.join(f"{value:.10g}" for value in row) for row in zip(*columns, strict=True)]
    text = "\n".join(rows)
    path.write_text(f"{mark.join(headings)}\n{text.replace('.', ',') if comma else text}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("headings", "factors", "options"),
    [
        (["Axial strain (%)", "σ₁ − σ₃ [kPa]", "εv [%]"], (100, 1e-3, 100), {}),
        (["eps_a [-]", "Deviator stress (psi)", "Volumetric strain [-]"], (1, 1 / 6894.757293168, 1), {}),
        (["Axial Strain, %", "Deviatoric stress q, MPa", "ε_v [-]"], (100, 1e-6, 1), {"mark": "\t"}),
        (["ε1 / %", "(σ1-σ3) (kN/m²)", "vol_strain_%"], (100, 1e-3, 100), {"mark": ",", "comma": False}),
        (["Axialdehnung [%]", "Deviatorspannung [kPa]", "Volumenänderung [%]"], (100, 1e-3, 100), {}),
        (["Déformation axiale (%)", "Déviateur (kPa)", "Déformation volumique (%)"], (100, 1e-3, 100), {}),
    ],
)
def test_tables_of_laboratories_are_read_by_their_headings_and_units(tmp_path, headings, factors, options):
    columns = [f * values for f, values in zip(factors, (LOADED, DEVIATOR, DILATION), strict=True)]
    test = read_test(table_of(tmp_path / "test.csv", headings, *columns, **options))
    assert test["axial_strain"] == pytest.approx(-np.log(1 - LOADED), rel=1e-6)
    assert test["volumetric_strain"] == pytest.approx(-np.log(1 - DILATION), rel=1e-6)
    assert test["q"] == pytest.approx(DEVIATOR, rel=1e-6)


def test_pore_pressure_is_in_excess_of_that_at_the_start_and_gives_p(tmp_path):
    u = 200e3 + 0.3 * DEVIATOR
    columns = [1e2 * LOADED, 1e-3 * DEVIATOR, 1e-3 * u, np.full(6, 300.0)]
    heads = ["axial strain [%]", "q [kPa]", "u [kPa]", "Cell pressure [kPa]"]
    test = read_test(table_of(tmp_path / "test.csv", heads, *columns))
    assert test["pore_pressure"] == pytest.approx(0.3 * DEVIATOR)
    assert test["p"] == pytest.approx(100e3 + DEVIATOR / 3 - 0.3 * DEVIATOR)


def test_a_given_excess_pore_pressure_is_left_as_it_is(tmp_path):
    columns = [1e2 * LOADED, 1e-3 * DEVIATOR, 8.0 + 0.3e-3 * DEVIATOR]
    heads = ["axial strain [%]", "q [kPa]", "Excess pore pressure [kPa]"]
    assert read_test(table_of(tmp_path / "test.csv", heads, *columns))["pore_pressure"] == pytest.approx(
        8e3 + 0.3 * DEVIATOR
    )


@pytest.mark.parametrize("heading", ["Total axial stress [kPa]", "Axial stress [kPa]", "σ'1 [kPa]"])
def test_q_follows_from_total_and_from_effective_axial_stresses(tmp_path, heading):
    u = 200e3 + 0.3 * DEVIATOR
    axial = 300e3 + DEVIATOR - ("'" in heading) * u
    columns = [1e2 * LOADED, 1e-3 * axial, 1e-3 * u, np.full(6, 300.0)]
    heads = ["axial strain [%]", heading, "u [kPa]", "Cell pressure [kPa]"]
    test = read_test(table_of(tmp_path / "test.csv", heads, *columns))
    assert test["q"] == pytest.approx(DEVIATOR, abs=1.0)
    assert test["p"] == pytest.approx(100e3 + DEVIATOR / 3 - 0.3 * DEVIATOR, rel=1e-5)


def test_ratios_of_columns_are_not_units_of_them(tmp_path):
    heads = ["axial strain [%]", "q [kPa]", "q/p'", "σ'1/σ'3", "u/σ3"]
    columns = [1e2 * LOADED, 1e-3 * DEVIATOR, *np.ones((3, 6))]
    with pytest.warns(UserWarning, match="unknown columns, not drawn: \"q/p'\", \"σ'1/σ'3\", 'u/σ3'"):
        test = read_test(table_of(tmp_path / "test.csv", heads, *columns))
    assert set(test) == {"axial_strain", "q"}


def test_units_in_a_row_below_the_headings_may_begin_with_per_cent(tmp_path):
    rows = "".join(f"{e},{q}\n" for e, q in zip(1e2 * LOADED, 1e-6 * DEVIATOR, strict=True))
    (tmp_path / "a.csv").write_text(f"Axial strain,q\n%,MPa\n{rows}")
    assert read_test(tmp_path / "a.csv")["q"] == pytest.approx(DEVIATOR)
    (tmp_path / "b.csv").write_text(f"Axial strain [%],q [kPa]\n%,MPa\n{rows}")
    with pytest.raises(ValueError, match="q has the unit 'kPa' in its heading and 'MPa' below it: keep only one"):
        read_test(tmp_path / "b.csv")


def test_strains_without_a_unit_are_fractions_with_a_warning(tmp_path):
    heads = ["Axial strain", "q [kPa]", "e"]
    path = table_of(tmp_path / "test.csv", heads, 8 * LOADED, 1e-3 * DEVIATOR, 0.6 + 0 * LOADED)
    with pytest.warns(UserWarning, match=r"are read as fractions, 'Axial strain' up to 0\.\d+: add \[%\]"):
        assert read_test(path)["axial_strain"] == pytest.approx(-np.log(1 - 8 * LOADED))


def test_a_table_that_begins_with_its_end_is_turned_round(tmp_path):
    heads = ["Axial strain [%]", "q [kPa]", "u [kPa]", "e"]
    columns = 1e2 * LOADED, 1e-3 * DEVIATOR, 0.3e-3 * DEVIATOR, 1.6 * (1 - DILATION) - 1
    with pytest.warns(UserWarning, match="rows begin with the largest axial strain: their order was reversed"):
        turned = read_test(table_of(tmp_path / "a.csv", heads, *(column[::-1] for column in columns)))
    for name, values in read_test(table_of(tmp_path / "b.csv", heads, *columns)).items():
        np.testing.assert_allclose(turned[name], values, err_msg=name)


def test_signs_and_names_that_are_not_understood_are_in_warnings(tmp_path):
    e = 1.6 * (1 - DILATION) - 1
    heads = ["Axial strain [%]", "q [kPa]", "Volumetric strain [%]", "e", "Suction [kPa]", "Time [s]"]
    columns = [-1e2 * LOADED, 1e-3 * DEVIATOR, -1e2 * DILATION, e, 0 * e, 0 * e]
    path = table_of(tmp_path / "test.csv", heads, *columns)
    with pytest.warns(UserWarning) as told:
        test = read_test(path)
    said = " ".join(str(each.message) for each in told)
    assert "unknown columns, not drawn: 'Suction [kPa]'" in said and "opposite signs" in said and "Time" not in said
    assert test["axial_strain"][-1] > 0 and test["volumetric_strain"][-1] < 0
    heads[2], columns[2] = "Volumetric strain [%]", 1e2 * DILATION  # now dilation is positive beside compression
    with pytest.warns(UserWarning, match="dilation is positive"):
        columns[0] = 1e2 * LOADED
        columns[2] = -1e2 * DILATION
        assert read_test(table_of(path, heads, *columns))["volumetric_strain"][-1] < 0


@pytest.mark.parametrize(
    ("heads", "factors", "words"),
    [
        (["axial strain", "q [kPa]", "p' [kPa]"], (100, 1e-3, 1e-3), r"'axial strain' reaches 10 times .* per cent"),
        (["axial strain [%]", "q [furlong]", "p' [kPa]"], (100, 1e-3, 1e-3), r"'furlong': use Pa, kPa, MPa, GPa"),
        (["axial strain [%]", "q", "p' [kPa]"], (100, 1e-3, 1e-3), r"has no unit: write it as 'q \[Pa\]'"),
        (
            ["axial strain [%]", "q [MPa]", "p' [kPa]"],
            (100, 1e-3, 1e-3),
            r"more than three times .* correct the wrong unit",
        ),
        (["axial strain [%]", "q [kPa]", "p' [kPa]"], (-100, -2e-3, 1e-3), r"q is -500 kPa .* more than 1\.5 times"),
        (["axial strain [%]", "q [kPa]", "p' [kPa]"], (0, 1e-3, 1e-3), r"axial strain is constant in all rows"),
        (["load cell [V]", "clock [s]", "x [mm]"], (1, 1, 1), r"no row of headings|no soil-test columns"),
    ],
)
def test_tables_with_contradictory_units_are_refused_in_one_sentence(tmp_path, heads, factors, words):
    mean = 1e5 + DEVIATOR / 3
    columns = [f * values for f, values in zip(factors, (LOADED, DEVIATOR, mean), strict=True)]
    with pytest.raises(ValueError, match=words) as caught:
        read_test(table_of(tmp_path / "test.csv", heads, *columns))
    assert "\n" not in str(caught.value)


def test_stresses_and_strains_that_contradict_each_other_are_refused(tmp_path):
    heads = ["axial strain [%]", "q [kPa]", "axial stress [kPa]", "cell pressure [kPa]"]
    columns = [1e2 * LOADED, DEVIATOR, 100 + 1e-3 * DEVIATOR, np.full(6, 100.0)]  # q is in Pa
    with pytest.raises(ValueError, match=r"q reaches .* axial stress minus the cell pressure"):
        read_test(table_of(tmp_path / "a.csv", heads, *columns))
    heads, columns = ["axial strain [%]", "q [kPa]", "volumetric strain [%]", "e"], [
        1e2 * LOADED, 1e-3 * DEVIATOR, DILATION, 1.6 * (1 - DILATION) - 1,
    ]  # fmt: skip
    with pytest.raises(ValueError, match=r"0\.0101 times that implied by the void ratio"):
        read_test(table_of(tmp_path / "b.csv", heads, *columns))


@pytest.mark.parametrize(
    ("headings", "factors"),
    [
        (["Ax. strain (%)", "Dev. stress [kPa]", "Vol. strain (%)"], (100, 1e-3, 100)),
        (["AxStrain(%)", "DevStress(kPa)", "VolStrain(%)"], (100, 1e-3, 100)),
        (["Axial strain εa [%]", "Deviator stress (q) [kPa]", "Volumetric strain, εv, %"], (100, 1e-3, 100)),
        (["ε1, %", "q = σ1 − σ3 [kPa]", "eps. vol. [%]"], (100, 1e-3, 100)),
        (["Axial strain (local) [%]", "Corrected deviator stress [kN m^-2]", "ε_v (%)"], (100, 1e-3, 100)),
        (["Axialdehnung in %", "Deviatorspannung in kPa", "Volumendehnung in %"], (100, 1e-3, 100)),
        (["Déf. axiale (%)", "Déviateur (kPa)", "Déf. vol. (%)"], (100, 1e-3, 100)),
        (["Deformación axial (%)", "Esfuerzo desviador (kN·m⁻²)", "Deformación volumétrica (%)"], (100, 1e-3, 100)),
        (["Deformazione assiale (%)", "Tensione deviatorica (kPa)", "Deformazione volumetrica (%)"], (100, 1e-3, 100)),
    ],
)
def test_headings_are_read_with_abbreviations_and_symbols_after_names(tmp_path, headings, factors):
    columns = [f * values for f, values in zip(factors, (LOADED, DEVIATOR, DILATION), strict=True)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        test = read_test(table_of(tmp_path / "test.csv", headings, *columns))
    assert test["axial_strain"] == pytest.approx(-np.log(1 - LOADED), rel=1e-6)
    assert test["volumetric_strain"] == pytest.approx(-np.log(1 - DILATION), rel=1e-6)
    assert test["q"] == pytest.approx(DEVIATOR, rel=1e-6)


@pytest.mark.parametrize(
    "heads", ["σ'1 σ'3", "σ1' σ3'", "sigma_1' sigma_3'", "Sig'1 Sig'3", "Eff.AxialStress Eff.RadialStress"]
)
@pytest.mark.parametrize("wet", [False, True])
def test_q_and_p_follow_from_two_effective_stresses(tmp_path, heads, wet):
    columns = [1e2 * LOADED, 1e-3 * DEVIATOR + 100, np.full(6, 100.0), np.full(6, 300.0)]
    names = [f"{head} [kPa]" for head in heads.split()]
    heads = ["axial strain [%]", *names, "u [kPa]"][: 3 + wet]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        test = read_test(table_of(tmp_path / "test.csv", heads, *columns[: 3 + wet]))
    assert test["q"] == pytest.approx(DEVIATOR, abs=1.0)
    assert test["p"] == pytest.approx(100e3 + DEVIATOR / 3)
    assert test["axial_stress"] == pytest.approx(100e3 + DEVIATOR)


def test_the_name_of_another_column_is_not_a_name_with_a_symbol(tmp_path):
    """p_p is a pore pressure, and not p followed by its symbol."""
    heads = ["axial strain [%]", "q [kPa]", "p_p [kPa]"]
    columns = [1e2 * LOADED, 1e-3 * DEVIATOR, 200.0 + 0.1e-3 * DEVIATOR]
    assert set(read_test(table_of(tmp_path / "test.csv", heads, *columns))) == {"axial_strain", "q", "pore_pressure"}


def test_half_the_difference_of_stresses_is_not_q(tmp_path):
    heads = ["axial strain [%]", "(σ1-σ3)/2 [kPa]"]
    with pytest.warns(UserWarning, match=r"unknown columns, not drawn: '\(σ1-σ3\)/2 \[kPa\]'"):
        assert set(read_test(table_of(tmp_path / "test.csv", heads, 1e2 * LOADED, 1e-3 * DEVIATOR))) == {"axial_strain"}


@pytest.mark.parametrize("form", ["{:,.2f}", "x", "{:_.2f}", "y"])
def test_thousands_are_grouped_in_any_way_that_is_not_a_decimal_mark(tmp_path, form):
    def spelt(value):
        if form == "x":
            return f"{value:,.2f}".translate(str.maketrans(",.", ".,"))
        return f"{value:,.2f}".replace(",", "'") if form == "y" else form.format(value).replace("_", "\u202f")

    rows = "".join(f"{spelt(100 * e)};{spelt(q)}\n" for e, q in zip(LOADED, DEVIATOR, strict=True))
    (tmp_path / "a.csv").write_text(f"Axial strain [%];q [Pa]\n{rows}", encoding="utf-8")
    assert read_test(tmp_path / "a.csv")["q"] == pytest.approx(DEVIATOR, abs=0.01)


def test_short_names_name_one_column_each():
    names = {}
    for column, (_, aliases) in laboratory_table.COLUMNS.items():
        for alias in aliases:
            assert names.setdefault(laboratory_table.same_word(alias), column) == column, alias


@pytest.mark.usefixtures("plain_figures")
def test_a_laboratory_s_test_is_laid_over_a_run_which_is_not_repeated(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "test.toml").write_text(
        'experiment = "element-test"\nsample = {grains = 20}\npath = {strain = 1e-3, step = 5e-4}\n'
    )
    table_of(tmp_path / "mine.csv", ["axial strain [%]", "q [kPa]", "εv [%]"], LOADED, 1e-3 * DEVIATOR, DILATION)

    def run(*more):
        monkeypatch.setattr(sys, "argv", ["stickslip", "run", "test.toml", "--out", "out", *more])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr()

    code, said = run("--compare", "none.csv")
    assert code == 2 and "none.csv cannot be read" in said.err and not (tmp_path / "out").exists()
    table_of(tmp_path / "other.csv", ["axial strain [%]", "q [kPa]"], -LOADED, -1e-3 * DEVIATOR)
    code, said = run("--compare", "other.csv")
    assert code == 2 and "other.csv is a test in extension, but path.strain is in compression" in said.err
    code, said = run("--compare", "mine.csv")
    assert code == 0 and "Largest deviatoric stress: 250 kPa at an axial strain of 0.001" in said.out
    assert (tmp_path / "out" / "fig8_laboratory.png").is_file()
    monkeypatch.setattr(element, "load_sample", None)
    (tmp_path / "out" / "fig8_laboratory.png").unlink()
    code, said = run("--compare", "mine.csv")
    assert code == 0 and "its results are used" in said.out and (tmp_path / "out" / "fig8_laboratory.png").is_file()


# runs


@pytest.fixture(scope="module")
def result():
    return ss.simulate(scenario(realizations=2, check=True, path={"strain": 2e-3, "step": 1e-3}), workers=1)


def test_what_was_not_reached_is_said(result):
    text = " ".join(sentences(result))
    for words in ("0 of 2 samples reached a critical state", "scatters by", "With half the step", "rearranged in"):
        assert words in text
    assert "The angle is largest where the path ends, or first turns, in 2 of 2 samples" in text
    named = named_measures(ss.experiments.EXPERIMENTS["element-test"], result)
    assert np.isnan(named["phi_residual"][0]) and named["phi_peak"][0] > 0 and named["G0"][1] == "N/m"


@pytest.mark.parametrize(
    ("end", "words"),
    [(1.0, "the compression index of the first sample is 0.1000"), (-1.0, "the swelling index of the first sample is"),
     (0.0, "The path gives no number for a comparison with half the step")],
)  # fmt: skip
def test_half_the_step_is_compared_in_a_number_that_a_compression_has(end, words):
    decades = np.linspace(0, end, 50)
    stress = 1e5 * 10 ** np.column_stack([decades] * 3)
    run = made(np.zeros((50, 3)), stress, load=decades, void_ratio=0.7 - 0.1 * decades)
    chosen = scenario({}, path={"kind": "isotropic", "pressures": [2e5]})
    text = " ".join(sentences(element.ElementTestResult(chosen, None, (run,), run, ())))
    assert words in text and "nan" not in text


def test_every_figure_can_be_drawn(result):
    drawn = {name: png(figure) for name, figure in figures(result)}
    assert len(drawn) == 5 and min(map(len, drawn.values())) > 5000


def test_tension_may_be_positive(result):
    run, flipped = result.runs[0], result.scenario.model_copy(update={"signs": "tension"})
    plain, turned = columns(run, result.scenario), columns(run, flipped)
    assert (plain["p"] == -turned["p"]).all() and (plain["phi"] == turned["phi"]).all()


def test_a_run_that_is_stopped_continues_with_what_is_saved(tmp_path, monkeypatch):
    chosen = scenario(path={"strain": 1e-3, "step": 1e-3})
    whole = ss.simulate(chosen, workers=1).runs[0].series
    monkeypatch.setattr(element, "SAVE_EVERY", 0.0)

    def stop(stage, share, words):
        if "load 0.0001" in words:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ss.simulate(chosen, folder=tmp_path, workers=1, report=stop)
    seen = []
    again = ss.simulate(chosen, folder=tmp_path, workers=1, report=lambda *words: seen.append(words[2]))
    assert not any("load 1e-06" in words or "compression" in words for words in seen)
    # equilibria agree within the tolerance of forces
    np.testing.assert_allclose(again.runs[0].series.stress, whole.stress, atol=1e-4)
    np.testing.assert_array_equal(again.runs[0].series.load, whole.load)


@pytest.mark.usefixtures("plain_figures")
def test_the_command_line_writes_series_with_units(tmp_path, monkeypatch, capsys):
    (tmp_path / "test.toml").write_text(
        'experiment = "element-test"\nsample = {dim = 2, grains = 40, pressure = 100.0}\npath = {strain = 1e-5}\n'
    )
    monkeypatch.setattr(sys, "argv", ["stickslip", "run", str(tmp_path / "test.toml"), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0 and "void ratio of the sample" in capsys.readouterr().out
    with (tmp_path / "out" / "series.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert {"sample", "axial_strain", "p [N/m]", "q [N/m]", "void_ratio"} <= set(rows[0])
    assert float(rows[0]["p [N/m]"]) == pytest.approx(100, rel=1e-6)


# bad input


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"sample": {"grading": {"kind": "table", "sizes": [1e-3, 1e-2], "passing": [0, 100]}, "grains": 30}},
         r"sample\.grains = 30 .* use at least \d+ grains"),
        ({"sample": {"grains": 100}, "path": {"strain": 0.9}}, r"path\.strain = 0\.9, .* use at most 0\.\d+"),
        ({"path": {"integrator": "dynamic", "inertial_number": 0.1}},
         r"path\.inertial_number = 0\.1 .* use at most 0\.001"),
        ({"path": {"integrator": "dynamic", "rate": 1e3}}, r"path\.rate = 1000 .* use at most \d"),
        ({"path": {"kind": "true-triaxial"}}, r"path\.b is missing"),
        ({"path": {"b": 0.5}}, r"path\.b applies to true-triaxial paths only"),
        ({"path": {"kind": "isotropic"}}, r"path\.pressures is missing"),
        ({"path": {"rate": 1.0}}, "quasi-static"),
        ({"path": {"fluid_modulus": 2e9}}, "does not apply to triaxial paths, which are drained"),
        ({"path": {"kind": "undrained", "fluid_modulus": 1e30}}, "at most 1e.07 sample.pressure .* leave it out"),
        ({"sample": {"grading": {"kind": "table", "sizes": [1e-6, 1e-3], "passing": [0, 100]}}}, "a factor of 100"),
        ({"sample": {"grading": {"kind": "sieve"}}}, r"sample\.grading has kind = 'sieve': use 'uniform', 'lognormal'"),
        ({"engine": "lammps"}, "has no quasi-static steps"),
        ({"sample": {"dim": 2, "pressure": 100.0}, "path": {"kind": "plane-strain"}}, "biaxial"),
        ({"sample": {"grading": {"kind": "d10-d50-d60", "d10": 2e-3, "d50": 1e-3, "d60": 3e-3}}}, "must increase"),
    ],
)  # fmt: skip
def test_bad_scenarios_are_refused_in_one_sentence(tables, words):
    with pytest.raises(ss.experiments.ScenarioError) as caught:
        ss.scenario(experiment="element-test", **tables)
    assert re.search(words, str(caught.value))
    assert "\n" not in str(caught.value)


def test_the_grains_that_a_grading_needs_do():
    table = {"kind": "table", "sizes": [1e-3, 1e-2], "passing": [0, 100]}
    with pytest.raises(ss.experiments.ScenarioError) as caught:
        scenario({"grading": table, "grains": 30})
    need = int(re.search(r"at least (\d+) grains", str(caught.value))[1])
    scenario({"grading": table, "grains": need}, path={"strain": 1e-3})


def test_a_pressure_that_grains_cannot_bear_is_refused_with_one_that_they_can(tmp_path):
    with pytest.raises(ss.experiments.ScenarioError, match=r"sample\.pressure must be at most .* got 1e\+09") as caught:
        ss.simulate(scenario({"pressure": 1e9}), folder=tmp_path)
    assert not list(tmp_path.iterdir())
    most = float(re.search(r"at most ([\d.e+]+)", str(caught.value))[1])
    chosen = scenario({"pressure": 0.99 * most})
    check_pressures(chosen.sample, make_law(chosen.law), None)


def test_a_law_with_more_friction_at_first_settles_under_its_own():
    sample = DISKS | {"friction": 1.0, "grains": 50}
    run = ss.simulate(scenario(sample, law={"young": 1e9, "poisson": 0.2, "mu": 0.3}, path={"strain": 1e-6}), workers=1)
    end = run.runs[0].end
    law = with_values(run.law, mu=0.3)
    force = ss.measure.contact_forces(end, law)
    normal = ss.measure.branch_vectors(end)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    push = np.einsum("ck,ck->c", force, normal)
    assert (np.linalg.norm(force - push[:, None] * normal, axis=1) <= 0.3 * push * (1 + 1e-9)).all()
