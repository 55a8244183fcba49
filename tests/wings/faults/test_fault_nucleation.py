"""Nucleation zones against Rubin and Ampuero 2005, and the benchmark problems at several cell sizes."""

import numpy as np
import pytest

from stickslip import friction
from stickslip.wings.faults.friction.fault import _Lengths
from stickslip.wings.faults.friction.fault_record import YEAR
from stickslip.wings.faults.friction.fault_state import (
    EXPONENT,
    NUMBER,
    Machine,
    initial_state,
    perturbed_state,
    steady_stress,
)

G, B, DC, NORMAL = 32e9, 0.015, 1e-3, 50e6
LENGTH = G * DC / (B * NORMAL)  # L_b


def nucleate(ratio: float, law: str, levels, spread: float, shear: str = "antiplane", v1: float = np.inf):
    """Accelerate a patch of a uniform, quasi-static fault; half-lengths of the zone, over L_b, at slip velocities.

    Parameters
    ----------
    levels : maximum slip velocities, ascending
    spread : slip velocity at the edge of the zone, over the largest
    """
    fault = friction.line_fault(
        24 * LENGTH, LENGTH / 20, a=ratio * B, b=B, dc=DC, normal=NORMAL, law=law, form="logarithmic", shear=shear,
        boundary="infinite", shear_modulus=G * (0.75 if shear == "in-plane" else 1.0), wave_speed=np.inf, v1=v1,
    )  # fmt: skip
    bump = 2 * np.exp(-(((fault.depth - 12 * LENGTH) / LENGTH) ** 2))
    state = perturbed_state(fault, initial_state(fault, stress=steady_stress(fault, 1e-9)), bump)
    machine = Machine(fault, state.prestress)
    y, w = np.array([state.excess_slip, state.log_state]), state.log_velocity.copy()
    stages, powers, out = np.zeros((NUMBER + 1, *y.shape)), np.zeros((NUMBER + 1, 3)), np.zeros_like(y)
    stages[0], h, zones = state.rates, state.step, []
    while len(zones) < len(levels):
        trial = w.copy()
        error = machine.step(y, trial, stages, powers, h, out) / 1e-5
        if error <= 1:
            y, out, w = out, y, trial
            stages[0] = stages[-1]
            if w.max() > np.log(levels[len(zones)] / fault.v0):
                zones.append((w > w.max() + np.log(spread)).sum() * fault.cell / (2 * LENGTH))
        h *= min(5.0, max(0.2, 0.9 * max(error, 1e-4) ** -EXPONENT)) if np.isfinite(error) else 0.2
    return np.array(zones)


@pytest.mark.parametrize("ratio", [0.2, 0.3])
def test_zones_of_the_aging_law_keep_a_fixed_length_for_small_a_over_b(ratio):
    """1.3774 L_b for a/b < 0.3781, where slip velocity vanishes at the edge: 1 % of the maximum is close to it."""
    theory = friction.nucleation_half_length(G, ratio * B, B, DC, NORMAL) / LENGTH
    assert theory == pytest.approx(1.3774)
    early, late = nucleate(ratio, "aging", (1.0, 100.0), 0.01)
    assert late == pytest.approx(theory, rel=0.05)
    assert early == pytest.approx(late, rel=0.05)


@pytest.mark.parametrize("shear", ["antiplane", "in-plane"])
def test_zones_of_the_aging_law_approach_a_length_that_grows_with_a_over_b(shear):
    """L_b/[π (1 − a/b)²]; in-plane shear has G/(1 − ν) for G."""
    theory = friction.nucleation_half_length(G, 0.7 * B, B, DC, NORMAL) / LENGTH
    assert theory == pytest.approx(1 / (np.pi * 0.09))
    assert nucleate(0.7, "aging", (100.0,), 0.1, shear)[0] == pytest.approx(theory, rel=0.05)


def test_zones_far_above_the_cut_off_of_the_direct_effect_approach_those_of_slip_weakening():
    """A = a/(1 + V/V1) vanishes: 0.579 L_b (Uenishi and Rice 2003), below the 1.3774 L_b of a constant, small A/B.

    With a = 0.7 b at all velocities it were 3.54 L_b. Slip velocity is a tenth of the largest near the edge: 10 %.
    """
    assert nucleate(0.7, "aging", (1e-4,), 0.1, v1=2e-9)[0] == pytest.approx(0.579, rel=0.15)


@pytest.mark.parametrize("ratio", [0.3, 0.7])
def test_zones_of_the_slip_law_become_shorter_as_they_accelerate(ratio):
    """Ampuero and Rubin 2008: no fixed length; zones are shorter than those of the aging law, and shrink."""
    lengths = nucleate(ratio, "slip", (1e-6, 1e-4, 1e-2), 0.1)
    assert (np.diff(lengths) < 0).all()
    assert lengths[-1] < 0.3 * friction.nucleation_half_length(G, ratio * B, B, DC, NORMAL) / LENGTH


def benchmark(cell: float, dc: float):
    """BP1-QD (dc = 8 mm) or BP2-QD (4 mm)."""
    return friction.line_fault(
        40e3, cell, a=[(15e3, 0.010), (18e3, 0.025)], b=0.015, dc=dc, normal=50e6, shear_modulus=2670 * 3464.0**2
    )


@pytest.mark.slow
def test_bp1_converges_to_the_recurrence_of_other_codes():
    """78.34 years in the series of HBI on the SEAS platform (boundary elements of 10 m).

    With band-limited slip, cells of 100 m suffice: what is left is the tolerance of the time steps.
    """
    runs = [friction.simulate_fault(benchmark(cell, 8e-3), 720.0).events for cell in (100.0, 50.0, 25.0)]
    recurrence = np.array([np.diff(e.start[4:]).mean() for e in runs]) / YEAR
    assert np.allclose(recurrence, 78.34, rtol=5e-3)
    assert np.ptp(recurrence) < 1e-4 * recurrence[-1]
    for name in ("surface_slip", "moment"):
        values = np.array([getattr(e, name)[4:].mean() for e in runs])
        assert np.allclose(values, values[-1], rtol=5e-3), name
    zones = np.array([e.nucleation_length[4:].mean() for e in runs])
    assert np.ptp(zones) <= 100.0  # one cell of the coarsest
    half = friction.nucleation_half_length(2670 * 3464.0**2, 0.010, 0.015, 8e-3, 50e6)
    assert zones[-1] == pytest.approx(2 * half, rel=0.1)


@pytest.mark.slow
def test_bp2_alternates_between_large_and_moderate_events():
    """Erickson et al. 2020: "bimodal sizes (BP2)"; the pair of events converges with the cell."""
    periods = []
    for cell in (50.0, 25.0):
        events = friction.simulate_fault(benchmark(cell, 4e-3), 660.0).events
        large = events.top < 1.0
        assert (large[2:] != large[1:-1]).all()  # one after the other
        assert events.moment[large].min() > 5 * events.moment[~large][1:].max()
        periods.append(np.diff(events.start[large][-3:]).mean() / YEAR)
    assert periods[0] == pytest.approx(periods[1], rel=5e-3)


@pytest.mark.parametrize(("longest", "possible"), [(1.9, False), (2.1, True), (0.9, False)])
def test_a_part_must_be_as_long_as_two_half_lengths(longest, possible):
    assert _Lengths(longest, 0.1, 1.0).possible is possible
