"""Transient growth: a closed form of two modes, the matrix exponential, and nothing where nothing drives it."""

import numpy as np
import pytest
from scipy.linalg import expm

import stickslip as ss
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.core.progress import silent
from stickslip.solve import transient as module
from stickslip.solve.freedom import assembled, displaced
from tests.modes.conftest import LAW, sheared


def propagator(state, law, free, t):
    """exp(Bt) of (√M q, √M q̇), and the metric of its energy."""
    root, n = np.sqrt(free.mass), len(free)
    pull = ss.modes.dynamical_matrix(state, law, free).toarray()
    drag = assembled(state, contact_blocks(state, law)[1], free).toarray() / root / root[:, None]
    metric = np.zeros((2 * n, 2 * n))
    metric[:n, :n], metric[n:, n:] = (pull + pull.T) / 2, np.eye(n)
    return expm(t * np.block([[np.zeros((n, n)), np.eye(n)], [-pull, drag]])), metric


def energies(growth, state, law):
    """Energy at the start, and what the matrix exponential makes of it; and both ends in masses' units."""
    root = np.sqrt(growth.free.mass)
    begin, end = (np.concatenate(part * root) for part in (growth.start, growth.end))
    motion, metric = propagator(state, law, growth.free, growth.time)
    np.testing.assert_allclose(motion @ begin, end, atol=1e-9 * np.abs(end).max())
    return begin @ metric @ begin, end @ metric @ end


@pytest.mark.parametrize("near", [0.3, 0.1, 0.03])
def test_two_modes_in_closed_form(near):
    """A = [[1 + d, k], [−k, 1 − d]], λ = 1 ± √(d² − k²), modes of cosine c = k/d: sup |y|/|y0| = √((1 + c)/(1 − c))."""
    d, c = 0.02, 1 - near
    pull = np.array([[1 + d, c * d], [-c * d, 1 - d]])
    motion, _ = module._modal_motion(pull, None, "displacement")
    truth = np.sqrt((1 + c) / (1 - c))
    (of_pair, time, first, second), *rest = module._find_beats(motion, undamped=True)
    split = d * np.sqrt(1 - c**2)
    assert not rest
    assert of_pair == pytest.approx(truth, rel=1e-9)
    np.testing.assert_allclose(sorted([first, second]), np.sqrt([1 - split, 1 + split]), rtol=1e-12)
    assert time == pytest.approx(np.pi / abs(first - second))
    assert module._amplitude_bound(motion) == pytest.approx(truth, rel=1e-9)
    times, amplitudes = module._search_times(motion, [(of_pair, time, first, second)], None, 60, silent)
    # opposite phase and the carrier's crest are up to π/2ω apart, which costs (truth Δω/ω)² π²/32 of the supremum
    assert truth * (1 - 0.4 * (truth * split) ** 2) < amplitudes.max() <= truth * (1 + 1e-12)
    assert abs(times[np.argmax(amplitudes)] - time) < 0.05 * time  # the envelope is flat at its top


def test_it_is_the_matrix_exponential_and_nothing_exceeds_it(calm):
    growth = ss.modes.transient_growth(calm, LAW)
    before, after = energies(growth, calm, LAW)
    assert before == pytest.approx(1, rel=1e-9)
    assert np.sqrt(after) == pytest.approx(growth.amplitude, rel=1e-9)
    assert 1.01 < growth.of_pair <= growth.amplitude <= growth.bound
    # brute force: every 0.7 up to the end of the window, in the energy's metric without translations
    step, metric = propagator(calm, LAW, growth.free, 0.7)
    values, vectors = np.linalg.eigh(metric)
    held = values > 1e-9
    root = np.sqrt(values[held])[:, None] * vectors[:, held].T
    back = vectors[:, held] / np.sqrt(values[held])
    motion, most = np.eye(len(step)), 0.0
    for _ in range(int(growth.times[-1] / 0.7)):
        motion = step @ motion
        most = max(most, np.linalg.norm(root @ motion @ back, 2))
    assert 0.995 * growth.amplitude < most <= growth.amplitude * (1 + 1e-3)


def test_a_run_grows_as_predicted(calm):
    growth, small = ss.modes.transient_growth(calm, LAW, duration=100.0, samples=4), 1e-8
    start, speed = displaced(calm, growth.free, small * growth.start[0]), growth.free.spread(small * growth.start[1])
    speed = speed.reshape(-1, 6)
    grains = start.grains._replace(velocity=speed[:, :3], spin=speed[:, 3:] / calm.grains.radius[:, None])
    expected = growth.free.spread(growth.end[0]).reshape(-1, 6)[:, :3]
    off = []
    for dt in (0.1, 0.05):  # a fifteenth and a thirtieth of the stable one
        steps = int(growth.time / dt)
        end, _, outcome = ss.run(start._replace(grains=grains), LAW, steps, growth.time / steps)
        assert outcome.ok
        off.append(np.abs((end.grains.position - calm.grains.position) / small - expected).max())
    assert off[1] < 0.012 * np.abs(expected).max() and off[1] < 0.3 * off[0]  # of velocity Verlet: (ω dt)² ω t/24


def test_displacements_grow_likewise_and_lanczos_agrees(calm, monkeypatch):
    growth = ss.modes.transient_growth(calm, LAW, norm="displacement", samples=20)
    root, n = np.sqrt(growth.free.mass), len(growth.free)
    assert np.linalg.norm(growth.start[0] * root) == pytest.approx(1)
    assert not growth.start[1].any()
    motion, _ = propagator(calm, LAW, growth.free, growth.time)
    assert np.linalg.norm(motion[:n, :n], 2) == pytest.approx(growth.amplitude, rel=1e-9)
    assert np.linalg.norm(growth.end[0] * root) == pytest.approx(growth.amplitude, rel=1e-9)
    assert 1 < growth.amplitude <= growth.bound
    monkeypatch.setattr(module, "SMALL", 0)
    other = ss.modes.transient_growth(calm, LAW, norm="displacement", samples=20)
    assert other.amplitude == pytest.approx(growth.amplitude, rel=1e-6)


def test_without_curl_nothing_grows():
    law = ss.laws.hertz_mindlin(1.0, 0.0, 0.0)
    state = sheared(16, 2, 0.9, 0.0, seed=1, law=law, steps=1)
    growth = ss.modes.transient_growth(state, law, samples=10)
    np.testing.assert_allclose(growth.amplitudes, 1, rtol=1e-9)
    assert growth.bound == pytest.approx(1, rel=1e-9)


def test_dashpots_take_from_it(calm):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth", damping_n=1e-3, damping_t=1e-3)
    free, growth = ss.modes.transient_growth(calm, LAW, samples=40), ss.modes.transient_growth(calm, law, samples=40)
    before, after = energies(growth, calm, law)
    assert np.sqrt(after / before) == pytest.approx(growth.amplitude, rel=1e-8)
    assert 1 <= growth.amplitude < free.amplitude


def test_what_has_no_transient_is_reported(swinging, calm):
    with pytest.raises(ValueError, match="the packing is unstable"):
        ss.modes.transient_growth(swinging, LAW)
    with pytest.raises(ValueError, match="norm must be 'energy' or 'displacement', got 'power'"):
        ss.modes.transient_growth(calm, LAW, norm="power")
    with pytest.raises(ValueError, match="duration must be positive"):
        ss.modes.transient_growth(calm, LAW, duration=-1.0)
