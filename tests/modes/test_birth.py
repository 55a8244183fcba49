"""Normal form at the birth of a pair: identities, a model with known coefficients, and free runs of the disk array."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from typer.testing import CliRunner

import stickslip as ss
from stickslip.cli.app import app
from stickslip.core.laws.builtin import damping_model
from stickslip.reports.page import packing_content
from stickslip.solve import birth
from stickslip.solve.balance import linearised
from stickslip.solve.freedom import backbone
from tests.modes.conftest import LAW as SPHERES

UNIT = 1 / 2000
LAW = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth"), 0, 1)


@cache
def pushed(load: float):
    """The array of Charan et al. 2020 pushed with a force, in the paper's units, in equilibrium under drag.

    The force grows in steps, and each step is made once.
    """
    step = 5e-4 if load < 0.01 else 4e-3
    done = np.ceil(load / step - 1e-6) - 1
    state = pushed(round(done * step, 10)) if done >= 0 else ss.packings.disk_array(10, press=0.1 * UNIT)
    force = state.control.force.copy()
    force[0, 0] = load * UNIT
    state, outcome = ss.relax(state._replace(control=state.control._replace(force=force)), LAW, tolerance=1e-13)
    assert outcome.ok
    return state


@cache
def form(load: float):
    return ss.modes.birth_form(pushed(load), LAW)


def plane_of(state):
    motion = birth._motion(state, LAW, backbone(state, LAW))
    return motion, birth.invariant_plane(motion.matrix, ss.stability(state, LAW).pairs[0])


def model(real=2.0, imaginary=0.02, stiff=3.0, cubic=0.7, given=0.4, taken=-1.3):
    """a₀'' = −λ a₀ − a₁, a₁'' = −λ a₁ + λ_i² a₀ + κ a₀³ + g a₀ b, b'' = −Λ b + h a₀²."""
    matrix = sparse.csr_array([[real, 1, 0], [-(imaginary**2), real, 0], [0, 0, stiff]])

    def force(y):
        return -matrix @ y + np.array([0.0, cubic * y[0] ** 3 + given * y[0] * y[2], taken * y[0] ** 2])

    def tangent(y):
        by_y = [[0, 0, 0], [3 * cubic * y[0] ** 2 + given * y[2], 0, given * y[0]], [2 * taken * y[0], 0, 0]]
        return matrix - sparse.csr_array(np.array(by_y, float))

    return birth.Motion(matrix, force, tangent, np.zeros((3, 0)))


def test_vectors_and_duals_of_a_pair_obey_their_definitions():
    motion, plane = plane_of(pushed(0.0062))
    u, w = np.stack([plane.u0, plane.u1], axis=1), np.stack([plane.w0, plane.w1], axis=1)
    real, imaginary = plane.value.real, plane.value.imag
    scale = np.linalg.norm(plane.u0)
    assert abs(scale - 1) < 1e-12
    assert np.abs(w.T @ u - np.eye(2)).max() < 1e-9
    assert np.linalg.norm(motion.matrix @ plane.u1 - real * plane.u1 - plane.u0) < 1e-9
    assert np.linalg.norm(motion.matrix @ plane.u0 - real * plane.u0 + imaginary**2 * plane.u1) < 1e-9
    assert abs(plane.u0 @ plane.u1) < 1e-6 * np.linalg.norm(plane.u1)
    for dual in (plane.w0, plane.w1):  # the left plane is invariant
        left = motion.matrix.T @ dual
        assert np.linalg.norm(left - w @ (u.T @ left)) < 1e-8 * np.linalg.norm(dual)


def test_beta_of_a_model_with_known_coefficients():
    real, stiff, cubic, given, taken = 2.0, 3.0, 0.7, 0.4, -1.3
    motion = model(real, 0.02, stiff, cubic, given, taken)
    plane = birth.invariant_plane(motion.matrix, real + 0.02j)
    size = abs(plane.u0[0])  # u₀ has unit length, and its amplitude is that of a₀ but for a part of order λ_i
    beta, bare, _ = birth.cubic_coefficient(motion, plane, 1e-3)
    slaved = given * taken * (2 / stiff + 1 / (stiff - 4 * real))
    assert beta == pytest.approx((3 * cubic + slaved) / (4 * real) * size**2, rel=1e-5)
    assert bare == pytest.approx(3 * cubic / (4 * real) * size**2, rel=1e-5)


@pytest.mark.slow  # the closed form that it derives is compared above
def test_the_amplitude_equation_follows_by_symbolic_algebra():
    """Multiple scales of the model: d/dt = ∂_t + ε ∂_T, λ_i = ε l, a₀ of order ε; first harmonic at order ε³."""
    sympy = pytest.importorskip("sympy")
    t, late, eps, omega = sympy.symbols("t T epsilon omega", positive=True)
    stiff, cubic, given, taken, small = sympy.symbols("Lambda kappa g h l", real=True)
    a, conjugate = sympy.Function("A")(late), sympy.Function("B")(late)

    def wave(n, amplitude, other):
        return amplitude * sympy.exp(n * sympy.I * omega * t) + other * sympy.exp(-n * sympy.I * omega * t)

    def rate(x):
        return sympy.diff(x, t) + eps * sympy.diff(x, late)

    a0 = eps * wave(1, a, conjugate)
    mean, double = 2 * taken / stiff, taken / (stiff - 4 * omega**2)
    b = eps**2 * (mean * a * conjugate + wave(2, double * a**2, double * conjugate**2))
    order = sympy.expand(rate(rate(b)) + stiff * b - taken * a0**2).coeff(eps, 2)
    assert sympy.simplify(order) == 0  # slaved
    a1 = -(rate(rate(a0)) + omega**2 * a0)
    left = rate(rate(a1)) + omega**2 * a1
    right = eps**2 * small**2 * a0 + cubic * a0**3 + given * a0 * b
    third = sympy.expand(left - right).coeff(eps, 3)
    first = sympy.expand(third * sympy.exp(-sympy.I * omega * t)).subs(t, 0) - sum(
        sympy.expand(third).coeff(sympy.exp(n * sympy.I * omega * t)) for n in (-3, -1, 3)
    )
    (equation,) = sympy.solve(first, sympy.diff(a, late, 2))
    beta = sympy.simplify(sympy.expand(equation).coeff(a, 2).coeff(conjugate, 1))
    values = {omega: np.sqrt(2.0), stiff: 3.0, cubic: 0.7, given: 0.4, taken: -1.3}
    motion = model()
    plane = birth.invariant_plane(motion.matrix, 2.0 + 0.02j)
    ours, _, _ = birth.cubic_coefficient(motion, plane, 1e-3)
    assert ours / plane.u0[0] ** 2 == pytest.approx(float(beta.subs(values)), rel=1e-5)
    assert sympy.simplify(sympy.expand(equation).coeff(a, 1).coeff(conjugate, 0) - small**2 / (4 * omega**2)) == 0


def test_growth_at_finite_amplitude_of_a_model_against_its_motion():
    """β < 0: the amplitude of the exact motion along a₀ is compared with the harmonic balance."""
    from scipy.integrate import solve_ivp

    motion = model(cubic=-1.1)
    plane = birth.invariant_plane(motion.matrix, 2.0 + 0.02j)
    beta, _, detuned = birth.cubic_coefficient(motion, plane, 1e-3)
    assert beta < 0 and abs(detuned / beta - 1) < 0.01
    sigma = 0.02 / (2 * np.sqrt(2.0))
    cubic_peak = sigma * np.sqrt(-2 / beta)
    _, rates, peak, _ = birth.growth_by_amplitude(motion, plane, np.linspace(0, 2 * cubic_peak, 25)[1:])
    assert peak == pytest.approx(cubic_peak, rel=0.01)
    assert rates[0] == pytest.approx(sigma, rel=0.01) and np.isnan(rates[-1])
    exponent = np.sqrt(-plane.value + 0j)
    exponent *= np.sign(exponent.real)
    u = plane.u0 + 1j * plane.value.imag * plane.u1
    start = 0.2 * peak
    first = np.concatenate([2 * start * u.real, 2 * start * (exponent * u).real])
    times = np.linspace(0, 3 / sigma, 6001)
    solution = solve_ivp(
        lambda t, z: np.concatenate([z[3:], motion.force(z[:3])]), (0, times[-1]), first, "DOP853", times, rtol=1e-8,
        atol=1e-12,
    )  # fmt: skip
    assert np.abs(plane.u0 @ solution.y[:3]).max() / 2 == pytest.approx(peak, rel=0.02)


def test_squared_peaks_extrapolate_to_the_birth(monkeypatch):
    """peak² is linear in the distance from the birth: it vanishes where λ_i² does."""
    loads, known = np.array([0.006, 0.0062]), form(0.0062)
    monkeypatch.setattr(birth, "SAMPLES", 2)  # amplitudes of the balance, on which the cubic peak does not depend
    forms = birth.birth_form(pushed(0.006), LAW), known
    square = [one.cubic_peak**2 for one in forms]
    lines = [np.polyfit(loads, values, 1) for values in (square, [one.eigenvalue.imag**2 for one in forms])]
    births = [-b / a for a, b in lines]
    assert births[0] == pytest.approx(births[1], abs=1e-5)
    assert not len(ss.stability(pushed(0.00595), LAW).pairs) and births[1] == pytest.approx(0.00598, abs=4e-5)


def grown(state, known, plane, share):
    """State on the growing mode at a share of an amplitude, and coordinates."""
    free, exponent = known.free, np.sqrt(-plane.value + 0j)
    exponent *= np.sign(exponent.real)
    u = (plane.u0 + 1j * plane.value.imag * plane.u1) / np.sqrt(free.mass)
    grains = state.grains
    moved = ss.modes.displaced(state, free, 2 * share * u.real)
    speed = free.spread(2 * share * (exponent * u).real)[: len(grains.radius)]
    turning = speed[:, 3:] / grains.radius[:, None]
    return moved._replace(grains=moved.grains._replace(velocity=speed[:, :3], spin=turning))


def amplitude(state, record, known, plane):
    """Amplitude along u₀ at the samples of a run, from displacements in the mass-weighted scalar product."""
    grains = state.grains
    way = np.concatenate(
        [record.position - grains.position, (record.angle - grains.angle) * grains.radius[:, None]], axis=2
    )
    y = way.reshape(len(way), -1)[:, known.free.component] * np.sqrt(known.free.mass)
    return y @ plane.u0 / 2


def test_a_burst_of_the_disk_array_ends_where_predicted():
    state, predicted = pushed(0.0062), form(0.0062)
    assert predicted.fate == "bounded bursts" and predicted.beta < 0
    _, plane = plane_of(state)
    start = grown(state, predicted, plane, 0.02 * predicted.peak)
    steps = round(9 / predicted.growth_rate / 0.2)
    _, record, outcome = ss.run(start, LAW, steps, 0.2, every=4, probes=range(10), events=True)
    assert outcome.ok and not (record.events["kind"] == "limit").any()
    assert np.abs(amplitude(state, record, predicted, plane)).max() == pytest.approx(predicted.peak, rel=0.02)


@pytest.mark.parametrize(("load", "fate"), [(0.007, "limit first"), (0.046, "runaway")])
@pytest.mark.slow
def test_the_contact_that_is_lost_first_is_the_predicted_one(load, fate):
    state, known = pushed(load), form(load)
    assert known.fate == fate
    motion, plane = plane_of(state)
    start = grown(state, known, plane, 0.02 * known.first)
    _, record, _ = ss.run(start, LAW, round(12 / known.growth_rate / 0.2), 0.2, every=4, probes=range(10), events=True)
    limit = record.events[record.events["kind"] == "limit"][0]
    assert (limit["i"], limit["j"]) == known.limit_contact
    before = record.time < limit["time"]
    swing = np.abs(amplitude(state, record, known, plane)[before]).max()
    balance = birth.growth_by_amplitude(motion, plane, known.first * (np.arange(1, 31) / 30) ** 2)
    predicted = birth.balanced_motion(plane, balance, known.growth_rate)(known.limit) @ plane.u0 / 2
    # both contain the slaved motion along u₀, by which swings in the two directions differ
    assert swing == pytest.approx(np.abs(predicted).max(), rel=0.08)


def test_a_verdict_without_a_lost_contact_says_so():
    none = {"limit": np.inf, "opening": np.inf, "limit_contact": (-1, -1), "opening_contact": (-1, -1)}
    said = form(0.046)._replace(peak=np.inf, closing=np.inf, rates=np.array([1.0]), **none).verdict
    assert said == "runaway: growth becomes faster, and no contact is lost up to the largest amplitude examined"


def test_rates_are_those_of_the_spectrum_also_far_from_a_birth():
    computed, spectrum = form(0.046), ss.stability(pushed(0.046), LAW)
    assert computed.fate == "runaway"
    assert computed.growth_rate == pytest.approx(spectrum.growth_rate[0], rel=1e-6)
    assert computed.frequency == pytest.approx(spectrum.frequency[0], rel=1e-6)
    assert computed._replace(detuned=2.0).fate == "resonance"


def test_a_balance_that_diverges_ends_before():
    motion = model(cubic=40.0, given=30.0)
    plane = birth.invariant_plane(motion.matrix, 2.0 + 0.02j)
    growth = birth.growth_by_amplitude(motion, plane, np.geomspace(1e-3, 1e6, 40))
    assert 4 < len(growth.amplitudes) < 39 and np.isfinite(growth.harmonics).all()


def test_motions_have_the_amplitude_and_the_slaved_parts_that_theory_gives():
    real, stiff, taken = 2.0, 3.0, -1.3
    motion = model(real=real, stiff=stiff, taken=taken)
    plane = birth.invariant_plane(motion.matrix, real + 0.02j)
    line, a = birth.ellipse(plane)(0.3), 2e-4
    assert (plane.w0 @ line[0], plane.w0 @ line[birth.PHASES // 2]) == pytest.approx((0.6, -0.6))
    assert np.abs(line @ plane.w1).max() == pytest.approx(0.6 * plane.value.imag)
    growth = birth.growth_by_amplitude(motion, plane, np.linspace(0, 4e-4, 9)[1:])
    ways = birth.balanced_motion(plane, growth, 0.02 / np.sqrt(8.0))(a)
    phase, size = 2 * np.pi * np.arange(len(ways)) / len(ways), (a * plane.u0[0]) ** 2
    assert 2 * (ways @ plane.w0 * np.cos(phase)).mean() == pytest.approx(2 * a, rel=1e-3)
    assert ways[:, 2].mean() == pytest.approx(2 * taken / stiff * size, rel=1e-2)
    assert 2 * (ways[:, 2] * np.cos(2 * phase)).mean() == pytest.approx(2 * taken / (stiff - 4 * real) * size, rel=1e-2)


def test_the_first_change_of_a_contact_along_a_line_has_a_closed_form():
    """A disk that is pushed sideways by x slips at x = μ F_n/k_t, reverses its slip, and opens if it is lifted."""
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.4, coulomb="sharp"), 0, 1)
    state = ss.packings.disk_array(1, press=0.01, push=0.001, gap=0.5)
    held = state.control.free.copy()
    held[0, 3:] = False
    state, outcome = ss.relax(state._replace(control=state.control._replace(free=held)), law, tolerance=1e-13)
    assert outcome.ok
    free, slip = ss.freedom(state), state.contacts.slip[0, 0]
    unit = np.zeros(len(free))
    unit[free.axis == 0] = 1.0
    right, _, _, none = birth.first_changes(linearised(state, law), free, lambda a: a * unit[None], 1e-6)
    assert right[0] == pytest.approx(0.4 * 0.01 / 0.5 - slip, rel=1e-4) and not np.isfinite(none[0])
    left, _, _, back = birth.first_changes(linearised(state, law), free, lambda a: -a * unit[None], 1e-6)
    assert left[0] == pytest.approx(0.4 * 0.01 / 0.5 + slip, rel=1e-4) and back[0] == pytest.approx(slip, rel=1e-4)
    unit = np.zeros(len(free))
    unit[free.axis == 1] = 1.0
    _, up, _, _ = birth.first_changes(linearised(state, law), free, lambda a: a * unit[None], 1e-6)
    assert up[0] == pytest.approx(0.01, rel=1e-4) and up[1] == (0, 1)


@cache
def mixed_row():
    """A row of unequal disks with small gaps, pressed on a floor, in equilibrium: one disk touches only the floor.

    Returns the state, its law, that disk, and its birth form, in which a contact of that disk is the first to close.
    Which rows have one differs among processors.
    """
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=5.0, coulomb="smooth"), 0, 1)
    for seed in (81, *range(20, 120)):  # the first one has on many processors
        rng = np.random.default_rng(seed)
        n = int(rng.integers(5, 12))
        radius = rng.uniform(0.4, 0.6, n)
        state = ss.packings.disk_array(n, radius, press=5e-5, mass=(radius / 0.5) ** 2, gap=-1e-6)
        place = state.grains.position.copy()
        place[:, 0] += rng.uniform(-3e-6, 3e-6, n)
        state, outcome = ss.relax(state._replace(grains=state.grains._replace(position=place)), law, tolerance=1e-13)
        alone = np.flatnonzero(ss.measure.contact_numbers(state) == 1) if outcome.ok else ()
        if len(alone) and len(ss.stability(state, law).pairs):
            known = ss.modes.birth_form(state, law)
            if set(known.closing_contact) & {*alone.tolist()} and known.closing < 0.2 * known.first:
                return state, law, next(iter(set(known.closing_contact) & {*alone.tolist()})), known
    raise AssertionError("no row has such a disk")


def test_collisions_with_a_grain_that_touches_only_the_floor_are_foreseen():
    """An undamped run on the growing mode closes the same contact at the same displacement."""
    state, law, _, known = mixed_row()
    assert not ss.measure.rattlers(state).any()
    i, j = known.closing_contact
    assert f"before that, {i} and {j} come into contact" in known.verdict
    plane = birth.invariant_plane(ss.modes.dynamical_matrix(state, law, known.free), known.eigenvalue)
    start = grown(state, known, plane, 0.3 * known.closing)
    dt = 0.2 * ss.measure.stable_time_step(state, law)
    _, record, _ = ss.run(
        start, law, round(3 / known.growth_rate / dt), dt, every=4, probes=range(len(state.grains.radius)), events=True
    )
    first = record.events[0]
    assert (first["kind"], first["i"], first["j"]) == ("closed", i, j)
    moved = np.abs(record.position - state.grains.position)[record.time <= first["time"]].max()
    # the ellipse touches the other disk at one phase, which the run meets once per period
    period_growth = np.exp(2 * np.pi * known.growth_rate / known.frequency)
    assert known.displacement(known.closing) <= 1.02 * moved <= 1.05 * period_growth * known.displacement(known.closing)


def test_the_contact_of_spheres_that_is_lost_first_is_the_predicted_one(swinging):
    """An undamped run on the growing mode."""
    known = ss.modes.birth_form(swinging, SPHERES)
    assert known.growth_rate == pytest.approx(ss.stability(swinging, SPHERES).growth_rate[0], rel=1e-6)
    plane = birth.invariant_plane(ss.modes.dynamical_matrix(swinging, SPHERES, known.free), known.eigenvalue)
    start = grown(swinging, known, plane, 0.3 * known.first)
    dt = 0.2 * ss.measure.stable_time_step(swinging, SPHERES)
    _, record, _ = ss.run(start, SPHERES, round(1 / known.growth_rate / dt), dt, every=4, probes=range(16), events=True)
    first = record.events[0]
    assert (first["kind"], (first["i"], first["j"])) == ("limit", known.limit_contact) and known.limit == known.first
    before = record.time <= first["time"]
    # far from a birth and with 300 periods of growth: see the spread for spheres in docs/theory/stability.md
    assert np.abs(amplitude(swinging, record, known, plane)[before]).max() == pytest.approx(known.first, rel=0.6)


def test_a_disk_that_rolls_without_resistance_is_held_in_the_normal_form():
    """A disk rolls on the floor: its motion is a zero mode, in the coordinates, and no part of the slaved motion."""
    state, law, disk, _ = mixed_row()
    motion = birth._motion(state, law, backbone(state, law))
    zero = motion.zero
    assert zero.shape[1] == ss.stability(state, law).zero_modes > 0
    assert np.abs(motion.matrix @ zero).max() < 1e-10 * np.abs(motion.matrix.data).max()
    assert (np.abs(zero[backbone(state, law).body == disk]) > 0.1).any()


def test_what_has_no_normal_form_is_refused():
    with pytest.raises(ValueError, match="pair -1 does not exist"):
        ss.modes.birth_form(pushed(0.0062), LAW, pair=-1)
    with pytest.raises(ValueError, match="whole number"):
        ss.modes.birth_form(pushed(0.0062), LAW, pair=0.5)
    with pytest.raises(ValueError, match="pair 0 does not exist: the state has 0 complex pairs"):
        ss.modes.birth_form(pushed(0.0055), LAW)
    with pytest.raises(ValueError, match="pair 3 does not exist"):
        ss.modes.birth_form(pushed(0.0062), LAW, pair=3)
    state = pushed(0.0062)
    moved = state._replace(grains=state.grains._replace(position=state.grains.position * [1, 1.00001, 1]))
    _, trial = ss.forces(moved, LAW)
    with pytest.raises(ValueError, match="not in equilibrium"):
        ss.modes.birth_form(ss.accept(moved, trial), LAW)
    sliding = state.contacts._replace(mode=np.where(state.contacts.mode == ss.STICK, ss.SLIDE, state.contacts.mode))
    weak = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=0.5, coulomb="smooth"), 0, 1)
    assert birth._at_limit(linearised(state._replace(contacts=sliding), weak)).any()
    with pytest.raises(ValueError, match="dashpots"):
        ss.modes.birth_form(state, ss.laws.for_pair(LAW, 0, 1, damping_n=0.1))


def test_the_command_says_what_follows(tmp_path, monkeypatch):
    """Of the command, of the page, and without dashpots."""

    search, once = birth.birth_form, form(0.0062)

    def known(state, law):
        same = np.array_equal(state.grains.position, pushed(0.0062).grains.position)
        return once if same and not damping_model(law) else search(state, law)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(birth, "birth_form", known)
    ss.io.write_packing("array.h5", pushed(0.0062), LAW)
    done = CliRunner().invoke(app, ["stability", "array.h5", "--after", "--json"])
    assert done.exit_code == 0, done.output
    after = json.loads(done.stdout)["after"]
    assert after["fate"] == "bounded bursts" and after["limit_contact"] == [2, 3]
    page = packing_content(Path("array.h5"), options={})
    assert "all eigenvalues by LAPACK" in str(page.sections)
    assert "bounded bursts, in which grains move" in str(page.sections)
    ss.io.write_packing("damped.h5", pushed(0.0062), ss.laws.for_pair(LAW, 0, 1, damping_n=0.1))
    arguments = ["stability", "damped.h5", "--after", "--json"]
    reason, bare = (
        json.loads(CliRunner().invoke(app, [*arguments, *option]).stdout)["after"] for option in ([], ["--no-dashpots"])
    )
    assert "dashpots" in reason["reason"] and bare["beta"] == after["beta"]
    ss.io.write_packing("calm.h5", pushed(0.0055), LAW)
    done = CliRunner().invoke(app, ["stability", "calm.h5", "--after"])
    assert done.exit_code == 0 and "0 complex pairs" in " ".join(done.output.split())
