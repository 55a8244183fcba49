"""Faults: stress transfer, rates, energy balance, time stepper, restart and refusals."""

import re

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

from stickslip import friction
from stickslip.wings.faults.friction import laws
from stickslip.wings.faults.friction.fault_cycles import join_histories
from stickslip.wings.faults.friction.fault_record import YEAR, Moment, hermite, points
from stickslip.wings.faults.friction.fault_state import (
    NUMBER,
    Machine,
    initial_state,
    perturbed_state,
    steady_stress,
    with_rates,
)
from stickslip.wings.faults.friction.laws import (
    FORMS,
    RateState,
    Spring,
    critical_stiffness,
    rates,
    slider_of,
    steady_sliding,
)
from stickslip.wings.faults.friction.stress_transfer import stress_matrix, stress_transfer

G = 32.04e9
SECOND = {"b": 0.012, "b2": 0.004, "dc2": 5e-3}  # two states
SHORT = {"a": [(2000, 0.010), (3000, 0.025)], "b": 0.015, "dc": 1.5e-3, "normal": 10e6}


def small(cell=100.0, **more):
    """Fault of 5 km with events every few years."""
    return friction.line_fault(5e3, cell, **(SHORT | more))


# ---- stress transfer


@pytest.mark.parametrize("boundary", ["surface", "infinite"])
@pytest.mark.parametrize("number", [3, 64, 101])
def test_transforms_agree_with_the_dense_matrix(boundary, number):
    slip = np.random.default_rng(number).normal(size=number)
    dense = stress_matrix(number, 25.0, G, boundary)
    assert np.abs(stress_transfer(number, 25.0, G, boundary)(slip) - dense @ slip).max() < 1e-13 * np.abs(dense).max()
    assert np.array_equal(dense, dense.T)


def test_the_matrix_is_the_integral_of_the_stiffness_of_sinusoids():
    """Slip sin(πx/h)/(πx/h) is (h/π) ∫ cos(kx) dk from 0 to π/h, each sinusoid of which has the stiffness Gk/2."""
    h, depth = 3.0, (np.arange(5) + 0.5) * 3.0

    def stress(x):
        return -h / np.pi * G * quad(lambda k: 0.5 * k * np.cos(k * x), 0, np.pi / h, epsabs=1e-9)[0]

    matrix = stress_matrix(5, h, G, "surface")
    for i, z in enumerate(depth):
        for j, centre in enumerate(depth):
            assert matrix[i, j] == pytest.approx(stress(z - centre) + stress(z + centre), rel=1e-9, abs=1e-9 * G)
    assert np.array_equal(matrix, matrix.T)


def test_a_sinusoid_has_its_exact_stiffness_up_to_waves_of_two_cells():
    """G |k|/2, within a long window in which the sinusoid fades out smoothly."""
    n, h = 4096, 25.0
    x, middle = (np.arange(n) - n / 2) * h, slice(n // 2 - 4, n // 2 + 4)
    for cells in (2, 3, 5, 40):
        k = 2 * np.pi / (cells * h)
        stress = stress_transfer(n, h, G, "infinite")(np.cos(k * x) * np.exp(-((x / (n * h / 8)) ** 2)))
        assert np.allclose(stress[middle], -0.5 * G * k * np.cos(k * x[middle]), atol=2e-3 * G * k)


def test_an_elliptic_crack_converges_to_its_uniform_stress_drop():
    """δ(x) = (2 Δτ/G) √(L² − x²) lowers the stress by Δτ everywhere on an antiplane crack of half-length L."""
    half, errors = 1000.0, []
    for number in (100, 200, 400):
        x = (np.arange(number) + 0.5) * (2 * half / number) - half
        stress = stress_transfer(number, 2 * half / number, G, "infinite")(2e6 / G * np.sqrt(half**2 - x**2))
        errors.append(np.abs(stress[np.abs(x) < 0.5 * half] + 1e6).max() / 1e6)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 5e-3
    assert ((slopes > 0.9) & (slopes < 1.6)).all()  # limited by the square root at the tips


def test_a_crack_at_the_surface_is_half_of_one_in_an_infinite_body():
    n, h = 60, 10.0
    x = (np.arange(n) + 0.5) * h
    slip = np.sqrt((n * h) ** 2 - x**2)
    whole = stress_transfer(2 * n, h, G, "infinite")(np.r_[slip[::-1], slip])
    assert np.allclose(stress_transfer(n, h, G, "surface")(slip), whole[n:], rtol=1e-11, atol=1e-3)


def test_a_sinusoid_of_a_periodic_fault_has_the_stiffness_of_a_plate():
    n, h, thickness = 64, 50.0, 900.0
    x = np.arange(n) * h
    transfer = stress_transfer(n, h, G, "periodic", thickness)
    for waves in (0, 1, 5, 31):
        k = 2 * np.pi * waves / (n * h)
        stiffness = 0.5 * G * (k / np.tanh(k * thickness) if k else 1 / thickness)
        assert np.allclose(transfer(np.cos(k * x)), -stiffness * np.cos(k * x), rtol=1e-11, atol=1e-9 * stiffness)


def test_stress_of_a_smooth_bump_is_its_hilbert_transform():
    """τ(x) = (G/2π) ∫ δ'(ξ)/(ξ − x) dξ, a principal value integrated by quadrature."""
    n, h, x0 = 800, 5.0, 2000.0
    x = (np.arange(n) + 0.5) * h

    def bump(at):
        return np.exp(-(((at - x0) / 200) ** 2))

    def slope(at):
        return -2 * (at - x0) / 200**2 * bump(at)

    stress = stress_transfer(n, h, G, "infinite")(bump(x))
    for i in (380, 399, 430, 500):
        even = quad(lambda s, z=x[i]: (slope(z + s) - slope(z - s)) / s, 0, 3000, limit=400)[0]
        assert stress[i] == pytest.approx(G / (2 * np.pi) * even, rel=1e-6, abs=1e-6 * np.abs(stress).max())


# ---- rates


@pytest.mark.parametrize("form", ["regularized", "logarithmic"])
def test_velocities_balance_stress_and_friction(form):
    fault = small(form=form, wave_speed=3000.0)
    rng = np.random.default_rng(0)
    n = len(fault.depth)
    state = initial_state(fault)._replace(
        excess_slip=rng.normal(0, 1e-3, n), log_state=initial_state(fault).log_state + rng.normal(0, 5, n)
    )
    state = with_rates(fault, state)
    v, s = state.velocity(fault), state.log_state
    x = (fault.mu0 + fault.a * np.log(v / fault.v0) + fault.b * s) / fault.a
    f = fault.a * (np.arcsinh(np.exp(x) / 2) if form == "regularized" else x)
    total = state.prestress + stress_matrix(n, fault.cell, fault.modulus, "surface") @ state.excess_slip
    assert np.allclose(fault.normal * f + fault.damping * v, total, rtol=1e-9)
    assert np.allclose(state.stress(fault), fault.normal * f, rtol=1e-9)
    assert np.allclose(state.rates[0], v - fault.plate_rate, rtol=1e-12)
    assert np.allclose(state.rates[1] * state.theta(fault), 1 - v * state.theta(fault) / fault.dc, rtol=1e-9)


def test_the_slip_law():
    fault = small(law="slip")
    state = perturbed_state(fault, initial_state(fault), 0.7)
    omega = state.velocity(fault) * state.theta(fault) / fault.dc
    assert np.allclose(state.rates[1], -(state.velocity(fault) / fault.dc) * np.log(omega), rtol=1e-9)


def test_cut_off_velocities():
    """High cut-offs change nothing; a low one of the evolution effect makes fast slip strengthen."""
    usual = small(form="logarithmic")
    state = perturbed_state(usual, initial_state(usual), 0.7)
    high = usual._replace(v1=1e9, v2=1e9)
    other = perturbed_state(high, initial_state(high), 0.7)
    assert np.allclose(other.rates, state.rates, rtol=1e-6, atol=1e-6 * np.abs(state.rates).max())
    low = usual._replace(v2=1e-6)
    change = (steady_stress(low, 1e-1) - steady_stress(low, 1e-2) - low.damping * 0.09) / low.normal
    assert np.allclose(change, low.a * np.log(10), rtol=1e-2)
    with pytest.raises(ValueError, match="cut-off velocities require the logarithmic form"):
        usual._replace(form="regularized", v1=1.0).check_entries()
    with pytest.raises(ValueError, match="v2 must be"):
        usual._replace(v2=0.0).check_entries()


@pytest.mark.parametrize("form", ["regularized", "logarithmic"])
def test_the_derivative_of_friction(form):
    surface = 0.02, 0.01, 0.02, 0.6, 0.0, 0.0
    for w, s in ((-20.0, 10.0), (3.0, -2.0), (-100.0, -1.0)):
        before, after = laws.friction(FORMS[form], [(w + d, s, 0.5 * s) for d in (-1e-5, 1e-5)], surface)
        exact = laws.slopes(FORMS[form], (w, s, 0.5 * s), surface)[0, 0]
        assert (after - before) / 2e-5 == pytest.approx(exact, rel=1e-5, abs=1e-12)


def test_the_initial_state_of_the_benchmark():
    """Prestress and θ at the surface as printed in files of other codes on the SEAS platform."""
    fault = friction.line_fault(
        40e3, 100.0, a=[(15e3, 0.010), (18e3, 0.025)], b=0.015, dc=8e-3, normal=50e6, shear_modulus=2670 * 3464.0**2
    )
    state = initial_state(fault)
    assert state.prestress[0] / 1e6 == pytest.approx(26.546122, abs=1e-6)
    assert np.log10(state.theta(fault)[0]) == pytest.approx(3.903090, abs=1e-6)
    assert np.allclose(state.velocity(fault), 1e-9, rtol=1e-12)


def test_steady_sliding_stays_steady():
    fault = small(a=0.02)
    state = initial_state(fault, stress=steady_stress(fault, 1e-9))
    h = friction.simulate_fault(fault, 5.0, start=state, tolerance=1e-9)
    assert np.abs(np.log(h.state.velocity(fault) / 1e-9)).max() < 1e-8
    assert h.slip.shape == (len(h.time), 0)


@pytest.mark.parametrize(("form", "cuts"), [("regularized", {}), ("logarithmic", {"v1": 1e-3, "v2": 1e-5})])
def test_the_initial_state_slips_as_asked(form, cuts):
    fault = small(form=form, **SECOND, **cuts)
    for velocity in (1e-9, 1e-4):
        assert np.allclose(initial_state(fault, velocity=velocity).velocity(fault), velocity, rtol=1e-9)


def test_a_stress_below_the_cut_off_is_refused():
    with pytest.raises(ValueError, match=r"no state balances .* use a larger stress, or v2 far above"):
        initial_state(small(form="logarithmic", v2=1e-8), stress=5.3e6)


@pytest.mark.parametrize("law", ["aging", "slip"])
def test_records_of_a_second_state_are_those_of_the_state(law):
    fault = small(law=law, **SECOND)
    history = friction.simulate_fault(fault, 12.0, recording=friction.Recording(stations=(550.0, 1450.0)))
    state, cells = history.state, [5, 14]
    assert len(history.events.start) > 0
    history = friction.simulate_fault(fault, 12.5, start=state, recording=friction.Recording(stations=(550.0, 1450.0)))
    state = friction.simulate_fault(fault, history.time[-1] / YEAR - 1e-6, start=state).state
    for name, values in (
        ("stress", state.stress(fault)),
        ("theta", state.theta(fault)),
        ("theta2", state.theta2(fault)),
    ):
        assert np.allclose(getattr(history, name)[-1], values[cells], rtol=1e-4), name


def test_steady_states_of_two_states():
    """V θ = D_c and V θ2 = D_c2."""
    fault = small(a=0.02, **SECOND)
    state = initial_state(fault, stress=steady_stress(fault, 1e-9))
    assert np.allclose(state.theta(fault) * 1e-9, fault.dc, rtol=1e-9)
    assert np.allclose(state.theta2(fault) * 1e-9, fault.dc2, rtol=1e-9)


def test_nucleation_with_two_states():
    """Zones of both states, from 1.3774 L_b or the fracture energy, or of one alone, the shortest of them."""

    def half(**more):
        return friction.nucleation(small(50.0, a=0.010, **more)).half_length

    alone = friction.nucleation_half_length(G, 0.010, 0.015, 1.5e-3, 10e6)
    assert half(b=0.015, b2=0.002, dc2=1e3) == pytest.approx(alone)  # the second never evolves
    both = G / 10e6 * (0.012 * 1.5e-3 + 0.004 * 5e-3) / (np.pi * (0.016 - 0.010) ** 2)
    assert half(**SECOND) == pytest.approx(both)
    short = 1.3774 * G / 10e6 / (0.02 / 1.5e-3 + 0.01 / 1.6e-3)
    assert half(b=0.020, b2=0.010, dc2=1.6e-3) == pytest.approx(short)


@pytest.mark.parametrize("v1", [1e-8, 1e-6])
def test_slip_far_above_the_cut_off_of_the_direct_effect(v1):
    """Friction hardly depends on velocity there: Newton's method ends at the round-off of the stress."""
    history = friction.simulate_fault(small(form="logarithmic", v1=v1, **SECOND), 10.0)
    assert history.state.time >= 10 * YEAR
    assert abs(history.energy.residual) < 1e-4


def test_a_state_of_another_fault_is_refused():
    first, second = small(), small(b2=0.0, dc2=1.0)._replace(b2=np.full(50, 0.001), dc2=np.full(50, 5e-3))
    for fault, other in ((first, second), (second, first)):
        with pytest.raises(ValueError, match=r"state variable.*, but the fault has [12]: use a state of this fault"):
            friction.simulate_fault(fault, 1.0, start=initial_state(other))
        with pytest.raises(ValueError, match=r"state variable.*, but the fault has [12]: use a state of this fault"):
            perturbed_state(fault, initial_state(other), 0.1)
    broken = initial_state(second)._replace(log_state2=np.full(50, np.nan))
    with pytest.raises(ValueError, match="log_state2 of the state is not an array of 50 finite numbers"):
        friction.simulate_fault(second, 1.0, start=broken)


@pytest.mark.parametrize("change", [{"v1": 1e-8}, {"v2": 1e-7}, {"form": "regularized"}])
def test_a_perturbation_changes_velocities_as_asked(change):
    fault = small(
        **{"form": "logarithmic", "b": [(0, 0.012), (2000, 0.012), (2000, 0.0)], **change, "b2": 0.004, "dc2": 5e-3}
    )
    state = initial_state(fault, stress=steady_stress(fault, 1e-9))
    moved = perturbed_state(fault, state, 0.3)
    assert np.allclose(moved.log_velocity - state.log_velocity, 0.3, atol=1e-9)


@pytest.mark.parametrize("law", ["aging", "slip"])
def test_two_equal_states_are_one(law):
    """With D_c2 = D_c, the second state equals the first, so that b + b2 acts as one evolution effect."""
    recording = friction.Recording(stations=(500.0,))
    result = friction.simulate_fault(small(law=law), 10.0, recording=recording, tolerance=1e-6)
    other = small(law=law, b=0.010, b2=0.005, dc2=1.5e-3)
    two = friction.simulate_fault(other, 10.0, recording=recording, tolerance=1e-6)
    assert len(result.events.start) > 0
    assert np.allclose(two.events.start, result.events.start, rtol=1e-5)
    assert np.allclose(two.events.max_slip, result.events.max_slip, atol=1e-3)
    assert np.array_equal(two.theta2, two.theta)
    assert result.theta2 is None
    nucleations = [friction.nucleation(h.fault) for h in (result, two)]
    assert np.allclose(nucleations[1][1:4], nucleations[0][1:4], rtol=1e-12)


def test_a_second_state_that_hardly_evolves_strengthens():
    """With a very long D_c2, θ2 stays as it is, and only b counts: the fault slips as one with b alone."""
    b_alone = friction.simulate_fault(small(), 10.0, tolerance=1e-6)
    long = small(b2=0.01, dc2=1e6)
    start = initial_state(small())
    start = with_rates(long, start._replace(log_state2=np.zeros(50), rates=np.zeros((3, 50))))
    frozen = friction.simulate_fault(long, 10.0, start=start, tolerance=1e-6)
    assert len(b_alone.events.start) > 0
    assert np.allclose(frozen.events.start, b_alone.events.start, rtol=1e-3)
    assert np.allclose(frozen.events.moment, b_alone.events.moment, rtol=1e-2)


def integrated(fault, start, time):
    """Slip and logarithms of both states, by SciPy from the equations of the theory page; no code of the package."""
    n, place = len(fault.depth), fault.depth
    away = [
        np.rint(np.abs(place[:, None] - end) / fault.cell) for end in (place, -place)
    ]  # from cells and their images
    odd = [np.divide(1.0, lag**2, out=np.zeros((n, n)), where=lag % 2 == 1) for lag in away]
    stiffness = G / (np.pi * fault.cell) * (sum(odd) - np.pi**2 / 4 * np.eye(n))
    cut, cut2, w = fault.v0 / fault.v1, fault.v0 / fault.v2, [start.log_velocity]

    def friction_of(w, s, s2):
        if fault.form == "regularized":
            y = 0.5 * np.exp(w + (fault.mu0 + fault.b * s + fault.b2 * s2) / fault.a)
            return fault.a * np.arcsinh(y), fault.a * y / np.sqrt(1 + y * y)
        evolved = fault.b * np.log(np.exp(s) + cut2) + fault.b2 * np.log(np.exp(s2) + cut2)
        return fault.mu0 - fault.a * np.log(np.exp(-w) + cut) + evolved, fault.a / (1 + cut * np.exp(w))

    def rates(_, y):
        u, s, s2 = y.reshape(3, n)
        eta, stress = fault.shear_modulus / (2 * fault.wave_speed), start.prestress + stiffness @ u
        for _ in range(60):
            f, slope = friction_of(w[0], s, s2)
            push = eta * fault.v0 * np.exp(w[0])
            step = (fault.normal * f + push - stress) / (fault.normal * slope + push)
            w[0] = w[0] - np.clip(step, -2, 2)
            if np.abs(step).max() < 1e-12:
                break
        v = fault.v0 * np.exp(w[0])
        evolution = [
            fault.v0 / dc * np.exp(-state) - v / dc if fault.law == "aging" else -v / dc * (w[0] + state)
            for state, dc in ((s, fault.dc), (s2, fault.dc2))
        ]
        return np.concatenate([v - fault.plate_rate, *evolution])

    solution = solve_ivp(rates, (0, time), start.unknowns.ravel(), "DOP853", rtol=1e-9, atol=1e-10)
    return solution.y[:, -1].reshape(3, n)


@pytest.mark.parametrize(
    ("law", "form", "cuts"),
    [
        ("aging", "regularized", {}),
        pytest.param("slip", "regularized", {}, marks=pytest.mark.slow),
        pytest.param("aging", "logarithmic", {"v1": 1.0, "v2": 1e-2}, marks=pytest.mark.slow),
        ("slip", "logarithmic", {"v1": 1.0, "v2": 1e-2}),
    ],
)
def test_another_integration_of_two_states(law, form, cuts):
    """Through an earthquake, with a second state in the upper half only."""
    fault = small(law=law, form=form, **SECOND | {"b2": [(0, 0.004), (2400, 0.004), (2600, 0.0)]}, **cuts)
    state = friction.simulate_fault(fault, 12.0, tolerance=1e-8)
    assert len(state.events.start) > 0
    state = state.state
    slip, *logs = integrated(fault, initial_state(fault), state.time) - state.unknowns
    assert np.abs(slip).max() < 1e-8  # errors of both integrations; it slips by more than 0.1 m
    assert np.abs(logs).max() < 1e-6


# ---- stability


@pytest.mark.parametrize("second", [{}, {"b2": 0.006, "dc2": 4e-3}])
@pytest.mark.parametrize("law", ["aging", "slip"])
def test_a_sinusoid_grows_as_the_slider_with_its_stiffness(law, second):
    """Linear theory: a mode of a uniform fault is a slider on the spring G k/2, also with radiation damping."""
    surface = RateState(0.010, 0.015, 1e-3, 0.6, 1e-6, law, **second)
    fault = friction.line_fault(
        6400.0, 50.0, a=0.010, b=0.015, dc=1e-3, normal=10e6, law=law, form="logarithmic", boundary="periodic",
        thickness=1e3, plate_rate=1e-6, **second,
    )  # fmt: skip
    for waves, grows in ((2, True), (12, False)):
        k = 2 * np.pi * waves / 6400.0
        spring = Spring(0.5 * fault.modulus * k / np.tanh(k * 1e3) / 10e6, fault.damping / 10e6)
        assert steady_sliding(surface, spring, 1e-6).stable == (not grows)
        matrix = rates(slider_of(surface, spring), np.zeros(3), 1e-6, 1.0)[1]
        size = 1 + fault.states
        mode = np.cos(k * fault.depth)
        state = perturbed_state(fault, initial_state(fault, stress=steady_stress(fault, 1e-6)), 1e-6 * mode)

        def amplitudes(state, mode=mode):
            return np.array([state.log_velocity, *state.unknowns[1:]]) @ mode

        first = amplitudes(state)
        for time in (500.0, 2000.0, 4000.0):
            state = friction.simulate_fault(fault, time / YEAR, start=state, tolerance=1e-13).state
            expected = expm(matrix[:size, :size] * state.time) @ first
            assert np.abs(amplitudes(state) - expected).max() < 1e-4 * np.abs(expected).max()


def test_critical_wavelength_is_that_of_the_critical_stiffness():
    surface, normal = RateState(0.010, 0.015, 1e-3), 10e6
    wave = friction.critical_wavelength(G, 0.010, 0.015, 1e-3, normal)
    stiffness = stress_transfer(64, wave / 64, G, "periodic", 1e9)(np.ones(64) * np.cos(2 * np.pi * np.arange(64) / 64))
    assert -stiffness[0] / normal == pytest.approx(critical_stiffness(surface), rel=1e-9)
    assert friction.critical_wavelength(G, 0.015, 0.015, 1e-3, normal) == np.inf


# ---- time stepping


def march(fault, state, steps, duration):
    """Fixed steps of the formula of order 8; also the largest estimated error of a step."""
    machine, h = Machine(fault, state.prestress), duration / steps
    y, w = np.array([state.excess_slip, state.log_state]), state.log_velocity.copy()
    stages, powers, out = np.zeros((NUMBER + 1, *y.shape)), np.zeros((NUMBER + 1, 3)), np.zeros_like(y)
    machine.rates(y, w, stages[0], powers[0])
    errors = []
    for _ in range(steps):
        errors.append(machine.step(y, w, stages, powers, h, out))
        y, out = out.copy(), y
        stages[0] = stages[-1]
    return y, max(errors)


def test_order_of_the_time_stepper():
    fault = friction.line_fault(2e3, 100.0, a=0.010, b=0.015, dc=2e-3, normal=10e6, plate_rate=1e-6)
    state = perturbed_state(fault, initial_state(fault), np.cos(fault.depth / 300))
    exact, _ = march(fault, state, 1024, 5000.0)
    for steps in (20, 24):
        (coarse, large), (fine, small_error) = (march(fault, state, n, 5000.0) for n in (steps, 2 * steps))
        slopes = np.log2(np.abs(coarse - exact).max(axis=1) / np.abs(fine - exact).max(axis=1))
        assert (slopes > 7.6).all(), slopes
        assert (slopes < 8.4).all(), slopes
        assert np.log2(large / small_error) == pytest.approx(8.0, abs=0.5)  # the step is chosen by its power 1/8


@pytest.fixture(scope="module")
def cycles():
    return friction.simulate_fault(small(), 20.0, recording=friction.Recording(stations=(0.0, 1500.0)))


def test_events_and_energy_balance(cycles):
    e = cycles.events
    assert len(e.start) >= 3
    assert (e.end > e.start).all()
    assert (e.max_velocity > 1e-3).all()
    assert (np.diff(cycles.time) > 0).all()
    assert abs(cycles.energy.residual) < 1e-5
    assert cycles.energy.radiated > 0
    assert sum(e.radiated) == pytest.approx(cycles.energy.radiated, rel=1e-3)
    assert (np.diff(cycles.profile_time) >= 0).all()


def test_a_tighter_tolerance_moves_events_little(cycles):
    tight = friction.simulate_fault(small(), 20.0, tolerance=1e-6)
    assert np.allclose(tight.events.start, cycles.events.start, rtol=1e-4)
    assert abs(tight.energy.residual) < 0.1 * abs(cycles.energy.residual) + 1e-9


def test_slip_of_samples_profiles_and_events_agree(cycles):
    fault, event = cycles.fault, cycles.events
    final = points(fault, [0.0, 1500.0])(cycles.state.slip(fault))
    assert np.allclose(cycles.slip[-1], final, rtol=1e-3)
    before, after = (np.interp(t, cycles.time, cycles.slip[:, 0]) for t in (event.start[0], event.end[0]))
    assert after - before == pytest.approx(event.surface_slip[0], rel=0.02)
    assert np.allclose(
        np.interp(cycles.profile_time, cycles.time, cycles.slip[:, 1]),
        cycles.profile_slip[:, np.argmin(np.abs(cycles.profile_depth - 1500))], atol=2e-3,
    )  # fmt: skip


def test_a_continued_run_is_the_same_run():
    rare = friction.Recording(stations=(0.0, 1500.0), quiet_sampling=2 * YEAR)  # most steps are not sampled
    fault = small(**SECOND)
    single = friction.simulate_fault(fault, 16.0, recording=rare)
    parts, state = [], None
    for years in (6.0, 10.0, 16.0):
        parts.append(friction.simulate_fault(fault, years, start=state, recording=rare))
        state = parts[-1].state
    whole = join_histories(parts)
    assert len(whole.events.start) > 0
    for name in ("time", "max_velocity", "slip", "stress", "theta", "theta2", "profile_time", "profile_slip"):
        assert np.array_equal(getattr(whole, name), getattr(single, name)), name
    for value, other in zip((*whole.events, *whole.state), (*single.events, *single.state), strict=True):
        assert np.array_equal(value, other)
    assert whole.energy.loading == pytest.approx(single.energy.loading, rel=1e-12)


def test_profiles_within_a_step_are_those_of_a_cubic():
    def moment(time):
        none = np.zeros(1)
        return Moment(time, np.array([time**3 - 2 * time]), np.array([3 * time**2 - 2]), none, none, 1.0, np.zeros(3))

    for time in (1.0, 1.2, 2.9, 3.0):
        assert hermite(moment(1.0), moment(3.0), (time - 1) / 2)[0] == pytest.approx(time**3 - 2 * time, rel=1e-12)


# ---- refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"a": -0.01}, "a must be positive and finite, got -0.01"),
        ({"dc": float("nan")}, "dc contains nan"),
        ({"normal": 0.0}, "normal must be positive and finite, got 0"),
        ({"b": [(3000, 0.01), (1000, 0.02)]}, "not in order at 1000"),
        ({"b": [(-5, 0.01)]}, "depth of -5"),
        ({"a": [1, 2, 3]}, "pairs of depth and value"),
        ({"law": "ageing"}, "'aging' or 'slip'"),
        ({"boundary": "periodic"}, "finite, got inf"),
        ({"shear": "in-plane", "boundary": "periodic"}, "boundary must be 'surface' or 'infinite' for in-plane shear"),
        ({"dip": 30.0}, "dip = 30 and slip = 'thrust' require in-plane shear"),
        ({"slip": "normal"}, "require in-plane shear and boundary = 'surface'"),
        ({"shear": "in-plane", "dip": 120.0}, "dip must be above 0 and at most 90 degrees"),
        ({"shear": "in-plane", "slip": "left"}, "slip must be 'thrust' or 'normal', got 'left'"),
        ({"dc": 1e-3}, "a third of it, 71.2 m"),
        ({"b2": 0.02, "dc2": 1e-3}, "b2/D_c2) σ] = 106.8 m"),
        ({"b2": -0.01}, "b2 must be finite and not negative, got -0.01"),
        ({"b2": 0.001, "dc2": 0.0}, "dc2 must be positive and finite, got 0"),
        ({"b2": 0.001}, "b2 requires dc2"),
        ({"b2": [(0, "x")]}, "b2 must be a number, or pairs"),
        ({"v2": "1"}, "v2 must be a number, got a value of type str"),
        ({"v3": 1.0}, "'v3' is not a field of a fault; the other fields are mu0"),
        ({"poisson": None}, "poisson must be a number, got None"),
        ({"plate_rate": -1.0}, "plate_rate must be zero or positive, got -1.0"),
        ({"poisson": 0.5}, "poisson must be between −1 and 0.5, got 0.5"),
    ],
)
def test_bad_faults_are_refused_with_one_sentence(change, message):
    with pytest.raises((ValueError, TypeError), match=re.escape(message)):
        small(**change)


def test_bad_lengths_and_recordings():
    with pytest.raises(ValueError, match="a whole number of cells, at least three"):
        friction.line_fault(1e3, 300.0, **SHORT)
    with pytest.raises(ValueError, match="too many cells: use at most 1,000,000"):
        friction.line_fault(1e3, 1e-100, **SHORT)
    with pytest.raises(ValueError, match=r"years must be at most .*, got 1e[+]09"):
        friction.simulate_fault(small(), 1e9)
    with pytest.raises(ValueError, match="depths from 0 to 5000 m, got 6000 m"):
        friction.simulate_fault(small(), 1.0, recording=friction.Recording(stations=(6e3,)))
    with pytest.raises(ValueError, match="use a larger one"):
        friction.simulate_fault(small(), 1.0, recording=friction.Recording(threshold=1e-9))
    with pytest.raises(ValueError, match="the state has 50 cells, but the fault has 100"):
        friction.simulate_fault(small(50.0), 1.0, start=initial_state(small()))
    with pytest.raises(ValueError, match="stress must be positive and finite, got -1 Pa"):
        initial_state(small(), stress=-1.0)
    with pytest.raises(ValueError, match="one for each of the 50 cells"):
        initial_state(small(), stress=[1e6, 2e6])
    with pytest.raises(ValueError, match="use a smaller stress"):
        initial_state(small(), stress=1e9)


def test_a_fault_that_cannot_nucleate_says_so():
    assert "velocity-strengthening" in friction.nucleation(small(a=0.02)).sentence
    assert not friction.nucleation(small(dc=1e-2)).possible
    assert "no earthquake is expected" in friction.nucleation(small(dc=1e-2)).sentence
    assert friction.nucleation(small()).possible


def fastest_growth(fault, velocity):
    """Largest real part of the eigenvalues of uniform steady sliding, linearised by hand with a dense matrix [1/s]."""
    n, v, a = len(fault.depth), velocity, fault.a / (1 + velocity / fault.v1)
    states = [(fault.b, fault.dc), (fault.b2, fault.dc2)][: fault.states]
    change = np.hstack([
        stress_matrix(n, fault.cell, fault.modulus, fault.boundary),
        *(-np.diag(np.broadcast_to(fault.normal * b / (1 + v / fault.v2), n)) for b, _ in states),
    ])  # fmt: skip
    change /= (fault.normal * a + fault.damping * v)[:, None]  # of ln V with slip and ln θ
    rows = [v * change]
    for k, (_, dc) in enumerate(states, 1):
        own = np.hstack([np.eye(n) if j == k else np.zeros((n, n)) for j in range(1 + len(states))])
        rows.append(-v / np.broadcast_to(dc, n)[:, None] * (change + own))
    return np.linalg.eigvals(np.vstack(rows)).real.max()


@pytest.mark.parametrize(
    ("change", "unstable", "text"),
    [
        ({"v1": 1e-10}, True, "earthquakes can nucleate"),
        ({"v1": 1e-10, "b": 0.010, "b2": 0.005, "dc2": 3e-3}, True, "earthquakes can nucleate"),
        ({"v1": 1e-7}, False, "the fault is velocity-strengthening (a ≥ b with the cut-offs) everywhere at"),
        ({"v1": 1e-7, "v2": 1e-9}, False, "no earthquake can nucleate: the fault is velocity-strengthening everywhere"),
        ({"a": 0.010, "v2": 5e-9}, True, "slip above 2.5e-09 m/s strengthens and may stay slow"),
        ({"a": 0.010, "v2": 1e-9}, False, "no earthquake can nucleate: the fault is velocity-strengthening everywhere"),
        ({"a": 0.010, "b": 0.006, "b2": 0.009, "dc2": 3e-3, "v2": 1e-9}, False, "no earthquake can nucleate"),
    ],
)
def test_nucleation_counts_cut_offs_at_the_plate_rate(change, unstable, text):
    fault = small(**({"a": 0.020, "form": "logarithmic"} | change))
    nucleation = friction.nucleation(fault)
    assert text in nucleation.sentence
    assert nucleation.possible == unstable == (fastest_growth(fault, fault.plate_rate) > 0)
    fixed = fault.sliding_at(fault.plate_rate)
    assert fastest_growth(fixed, fault.plate_rate) == pytest.approx(fastest_growth(fault, fault.plate_rate), rel=1e-6)
    assert np.array_equal(friction.nucleation(fixed)[:4], nucleation[:4])


def test_earthquakes_are_simulated_where_cut_offs_allow_them():
    """Weakening at the plate rate: events without help. Weakening above 3e-8 m/s: only a disturbance starts them."""

    def events(change, disturbance, years=8.0):
        fault = small(**({"a": 0.020, "form": "logarithmic"} | change))
        state = initial_state(fault)
        start = perturbed_state(fault, state, disturbance * np.cos(np.pi * fault.depth / 5e3))
        return len(friction.simulate_fault(fault, years, start=start).events.start)

    assert events({"v1": 1e-10}, 0.2) > 0
    assert events({"v1": 1e-7}, 0.2, 25.0) == 0
    assert (
        "a disturbance can turn it into an earthquake"
        in friction.nucleation(small(a=0.020, form="logarithmic", v1=1e-7)).sentence
    )
    assert events({"v1": 1e-7}, 8.0) > 0


def test_cells_resolve_ruptures_that_only_cut_offs_allow():
    with pytest.raises(ValueError, match="does not resolve the cohesive length"):
        small(500.0, a=0.020, form="logarithmic", v1=1e-10)
    small(500.0, a=0.020, form="logarithmic")  # strengthens at all velocities


def test_lengths_at_a_velocity():
    """With cut-offs, the critical wavelength is where the eigenvalues of the slider at that velocity cross zero."""
    fault = small(a=0.020, form="logarithmic", v1=3e-8)
    surface = RateState(0.020, 0.015, 1.5e-3, form="logarithmic", v1=3e-8)
    at = fault.sliding_at(1e-7)
    wave = friction.critical_wavelength(G, at.a[0], at.b[0], 1.5e-3, 10e6)
    for share, grows in ((1.01, True), (0.99, False)):
        sliding = steady_sliding(surface, Spring(np.pi * G / (wave * share) / 10e6), 1e-7)
        assert sliding.stable == (not grows) == (sliding.growth_rate < 0)
    half = friction.nucleation_half_length(G, at.a[0], at.b[0], 1.5e-3, 10e6)
    assert friction.nucleation(fault, 1e-7).half_length == pytest.approx(half, rel=1e-12)
