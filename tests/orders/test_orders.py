"""Convergence: slopes must lie on both sides of theory, and growth must be what the spectrum predicts."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.loading.protocols import fit_growth, free_run


def test_frictionless_energy_error_is_of_second_order_in_dt():
    """Three disks between walls and neighbours, always in contact: velocity Verlet's energy error falls as dt²."""
    state = ss.packings.disk_array(3, press=0.02, gap=-0.05)
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=0.0), 0, 1)
    state, _ = ss.relax(state, law)
    rng = np.random.default_rng(0)
    kick = np.zeros((3, 3))
    kick[:, :2] = rng.normal(0, 5e-3, (3, 2))
    state = state._replace(grains=state.grains._replace(velocity=kick))

    def error(dt):
        _, record, _ = ss.run(state, law, round(40 / dt), dt, every=1, probes=range(3))
        assert (record.touching == record.touching[0]).all()
        energy = record.kinetic_energy + potential(record.position) + 0.02 * record.position[:, :, 1].sum(axis=1)
        return np.abs(energy - energy[0]).max()

    def potential(position):
        gap = np.roll(position, -1, axis=1) - position
        gap[:, -1, 0] += state.cell.vectors[0, 0]
        pairs = np.clip(1.0 - np.linalg.norm(gap, axis=2), 0, None)
        floor = np.clip(0.5 - position[:, :, 1], 0, None)
        return 0.4 * (pairs**2.5 + floor**2.5).sum(axis=1)

    steps = np.array([0.4, 0.2, 0.1, 0.05])
    slope = np.polyfit(np.log(steps), np.log([error(dt) for dt in steps]), 1)[0]
    assert 1.9 < slope < 2.1


def test_dashpots_keep_second_order():
    """A disk in lasting contact with a wall is a damped oscillator, whose motion is known."""
    gamma, start = 0.4, 1e-3
    omega = np.sqrt(1 - gamma**2 / 4)
    law = ss.laws.linear(kn=1.0, mu=0.0, damping_n=gamma)
    control = ss.control.loads(1, 1, force=[0, -0.1, 0])
    grains = ss.disks([[0.0, 0.4 + start]], 0.5)
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), control)

    def error(dt):
        end, _, _ = ss.run(state, law, round(8 / dt), dt)
        exact = start * np.exp(-4 * gamma) * (np.cos(8 * omega) + gamma / (2 * omega) * np.sin(8 * omega))
        return abs(end.grains.position[0, 1] - 0.4 - exact)

    steps = np.array([0.1, 0.05, 0.025, 0.0125])
    slope = np.polyfit(np.log(steps), np.log([error(dt) for dt in steps]), 1)[0]
    assert 1.8 < slope < 2.2


def pressed():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10, coulomb="smooth"), 0, 1)
    state, outcome = ss.relax(ss.packings.disk_array(10, press=5e-5), law)
    assert outcome.ok
    # contacts between neighbours are closed from the start, so that the path holds no event
    state, outcome = ss.relax(ss.packings.with_push(state, 0.03 / 2000), law)
    assert outcome.ok
    return state, law


def test_newton_and_dynamics_part_with_the_square_of_the_load_step():
    state, law = pressed()

    def distance(step):
        load = (0.03 + step) / 2000
        slow, a = ss.relax(ss.packings.with_push(state, load), law, tolerance=1e-15)
        fast, b = ss.newton(ss.packings.with_push(state, load), law, tolerance=1e-15)
        assert a.ok
        assert b.ok
        return np.abs(slow.grains.position - fast.grains.position).max()

    steps = np.array([4e-3, 2e-3, 1e-3, 5e-4])
    distances = [distance(step) for step in steps]
    slope = np.polyfit(np.log(steps), np.log(distances), 1)[0]
    assert 1.8 < slope < 2.2, distances
    assert distances[-1] < 1e-6


def test_newton_reaches_the_same_state_with_a_dense_and_a_sparse_solver(monkeypatch):
    state, law = pressed()
    push = ss.packings.with_push(state, 0.031 / 2000)
    dense, _ = ss.newton(push, law)
    monkeypatch.setattr("stickslip.solve.newton.DENSE_BELOW", 0)
    sparse, outcome = ss.newton(push, law)
    assert outcome.ok
    # both end within the tolerance 1e-14 over the smallest stiffness, 1e-3
    np.testing.assert_allclose(dense.grains.position, sparse.grains.position, atol=1e-11)


@pytest.mark.parametrize("push", [0.03, 0.083])
def test_growth_is_what_the_spectrum_predicts(push):
    state, law = pressed()
    for load in np.arange(0.032, push + 1e-9, 0.003):
        state, outcome = ss.relax(ss.packings.with_push(state, load / 2000), law)
        assert outcome.ok
    modes = ss.spectrum(state, law)
    fastest = modes.pair_indices[0]
    start = ss.packings.perturbed(state, 3, 1e-13)
    _, record, _ = free_run(start, law, duration=20_000, dt=0.1, sample=2.0)
    rate, frequency = modes.growth_rate[fastest], modes.frequency[fastest]
    growth = fit_growth(record.time, record.msd, growth_rate=1.3 * rate, frequency=1.02 * frequency)
    assert growth.decades > 7
    assert growth.growth_rate == pytest.approx(rate, rel=0.02)  # the slower pair still counts at the window's start
    assert growth.frequency == pytest.approx(frequency, rel=1e-3)


def test_growth_from_the_unstable_mode_itself():
    """Seeded with the mode, the fit meets the spectrum to a few 1e-5: Verlet's own shift is ω_r² dt²/24 of ω_r."""
    state, law = pressed()
    for load in np.arange(0.033, 0.0831, 0.0025):
        state, _ = ss.relax(ss.packings.with_push(state, load / 2000), law)
    state, _ = ss.relax(ss.packings.with_push(state, 0.083 / 2000), law)
    modes = ss.spectrum(state, law)
    p = modes.pair_indices[0]
    growing = np.conj(np.sqrt(modes.eigenvalues[p]))  # exp(i ω t) grows with Im ω < 0
    mode = np.conj(modes.modes[:, p])
    mode *= 1e-10 / np.abs(mode).max()
    start = ss.modes.displaced(state, modes.free, mode.real)
    rate = np.zeros(6 * state.n_bodies)
    rate[modes.free.component] = (1j * growing * mode).real
    rate = rate.reshape(-1, 6)[:10]
    start = start._replace(grains=start.grains._replace(velocity=rate[:, :3].copy(), spin=rate[:, 3:] / 0.5))
    _, record, _ = ss.run(start, law, 40_000, 0.1, every=20, reference=state.grains.position)
    w, f = modes.growth_rate[p], modes.frequency[p]
    growth = fit_growth(record.time, record.msd, growth_rate=1.3 * w, frequency=0.98 * f, window=(2e-20, 1e-12))
    assert growth.growth_rate == pytest.approx(w, rel=5e-4)
    assert growth.frequency == pytest.approx(f, rel=5e-5)


def test_damped_growth_without_damping_is_the_spectrum():
    state, law = pressed()
    modes = ss.spectrum(state, law)
    exponents = ss.modes.damped_growth(state, law)
    assert exponents.real.max() == pytest.approx(modes.growth_rate.max(), rel=1e-6)
    calmed = ss.modes.damped_growth(state, law, drag=0.05)
    # drag on all components alike: s(s + ν) = −λ, so a fast mode loses ν/2
    s = -0.025 + np.sqrt(0.025**2 - modes.pairs[0] + 0j)
    assert np.abs(calmed - s).min() < 1e-9
    assert calmed.real.max() < 0


def test_growth_with_dashpots_and_drag_is_what_the_damped_spectrum_predicts():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10, coulomb="smooth", damping_n=1e-3, damping_t=1e-3), 0, 1)
    state, _ = ss.relax(ss.packings.disk_array(10, press=5e-5), law)
    for load in (0.015, 0.03):
        state, outcome = ss.relax(ss.packings.with_push(state, load / 2000), law)
        assert outcome.ok
    fastest = ss.modes.damped_growth(state, law, drag=1e-4)[0]
    assert fastest.real < 0.7 * ss.spectrum(state, law).growth_rate.max()  # damping matters here
    start = ss.packings.perturbed(state, 3, 1e-13)
    _, record, _ = free_run(start, law, duration=20_000, dt=0.1, sample=2.0, drag=1e-4)
    growth = fit_growth(record.time, record.msd, growth_rate=fastest.real, frequency=abs(fastest.imag))
    assert growth.growth_rate == pytest.approx(fastest.real, rel=5e-3)


def test_wall_mode_of_a_lone_disk():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10), 0, 1)
    state, _ = ss.relax(ss.packings.disk_array(1, press=5e-5, gap=0.5), law)
    modes = ss.spectrum(with_neighbor_list(state), law)
    share = modes.shares()
    k = int(np.argmax(share[:, 1]))
    assert share[k, 1] == pytest.approx(1.0, abs=1e-12)
    assert modes.frequency[k] == pytest.approx(np.sqrt(1.5 * (5e-5) ** (1 / 3)), rel=1e-9)
    assert modes.stable


def test_modes_solve_the_eigenvalue_problem_and_shares_add_up():
    state, law = pressed()
    modes = ss.spectrum(state, law)
    jacobian = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[0], modes.free).toarray()
    left = -jacobian @ modes.modes
    right = modes.free.mass[:, None] * modes.modes * modes.eigenvalues
    # backward error of a dense eigensolver: a few hundred roundings of the largest entry
    np.testing.assert_allclose(left, right, atol=1e-13 * np.abs(jacobian).max())
    np.testing.assert_allclose(modes.shares().sum(axis=1), 1.0, atol=1e-12)
    assert not modes.stable
