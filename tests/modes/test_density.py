"""Participation and density of states: closed forms of a chain, and the estimate against the count."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.solve import spectrum as room
from tests.modes.conftest import LAW

CHAIN = ss.laws.linear(1.0, 0.0, 0.5)


def chain(n):
    """Equal disks in a periodic row that move along it only: ω = 2√(k/m) |sin(π k/n)|."""
    place = np.stack([0.99 * np.arange(n), np.zeros(n)], axis=1)
    state = ss.packings.from_arrays(place, np.full(n, 0.5), CHAIN, cell=[0.99 * n, 3.0], dim=2)
    free = state.control.free.copy()
    free[:, 1:] = False
    return state._replace(control=state.control._replace(free=free))


def test_a_chain_has_the_frequencies_of_its_closed_form():
    n = 11
    density = ss.modes.density_of_states(chain(n), CHAIN, bins=4)
    truth = np.sort(2 * np.abs(np.sin(np.pi * np.arange(n) / n)))[1:]
    np.testing.assert_allclose(density.frequency, truth, rtol=1e-12)
    assert (density.n, density.zero, density.negative) == (n, 1, 0)
    assert (density.density * np.diff(density.edges)).sum() == pytest.approx((n - 1) / n)
    assert not density.of_pairs.any()


def test_modes_of_a_pair_are_counted_where_they_oscillate():
    found = room._count_modes(np.array([4.0, (1 + 2j) ** 2, (1 - 2j) ** 2, -1.0]), 2)
    assert found.frequency.tolist() == pytest.approx([1.0, 1.0, 2.0])
    assert (found.negative, found.zero) == (1, 0)


def test_estimates_differ_with_their_seed():
    one, other = (
        ss.modes.density_of_states(chain(60), CHAIN, bins=4, method="polynomials", probes=2, seed=seed).density
        for seed in (1, 2)
    )
    assert not np.allclose(one, other, rtol=1e-6)


def test_the_estimate_of_a_long_chain_is_the_closed_form():
    """D = (2/π)/√(ω_max² − ω²), integrated over bins."""
    density = ss.modes.density_of_states(chain(1500), CHAIN, bins=10, method="polynomials")
    truth = np.diff(2 / np.pi * np.arcsin(np.minimum(density.edges / 2, 1))) / np.diff(density.edges)
    # the two highest bins hold the singularity, which the resolution smears; in the others D'' Δω²/2 is below 1 %
    deviation = np.abs(density.density - truth)[:-2]
    assert (deviation < 4 * density.error[:-2] + 0.01 * truth[:-2]).all()
    assert 0 < density.error.max() < 0.05 and density.resolution < np.diff(density.edges).min() / 3
    assert density.zero == 1


def test_the_estimate_agrees_with_the_count_of_a_packing(swinging):
    exact = ss.modes.density_of_states(swinging, LAW, bins=8)
    density = ss.modes.density_of_states(swinging, LAW, bins=exact.edges, method="polynomials", probes=64)
    width = np.diff(exact.edges)
    assert exact.of_pairs.sum() * width[0] == pytest.approx(2 / exact.n)  # one pair, two modes
    # the estimate's share of neighbouring bins is at most what lies within its resolution of the edges
    smear = 0.5 * density.resolution / width * (exact.density + np.roll(exact.density, 1) + np.roll(exact.density, -1))
    assert (np.abs(density.density - exact.density) < 4 * density.error + smear).all()
    whole = ss.modes.density_of_states(swinging, LAW, method="polynomials")
    assert (whole.density * np.diff(whole.edges)).sum() == pytest.approx((exact.n - 3) / exact.n, rel=1e-12)
    # translations are left out: without them nothing moves as slowly
    assert exact.frequency[0] > whole.edges[1] + 3 * whole.resolution
    assert whole.density[0] * np.diff(whole.edges)[0] < 0.1 / exact.n


def test_participation_of_waves_grains_and_groups():
    n = 10
    state = chain(n)
    free = ss.freedom(state)
    place = np.arange(n)
    grain = np.zeros(n)
    grain[3] = 2.0
    modes = np.stack([np.exp(2j * np.pi * 3 * place / n), np.cos(2 * np.pi * 3 * place / n), grain], axis=1)
    np.testing.assert_allclose(ss.modes.participation_ratio(modes, free), [1, 2 / 3, 1 / n], rtol=1e-12)
    glued = state._replace(control=ss.control.rigid(state.control, [0, 1, 2, 3]))
    free = ss.freedom(glued)
    alike = np.ones((len(free), 1))
    # seven bodies, one of them four times as heavy: (4 + 6)²/(7 (16 + 6))
    assert ss.modes.participation_ratio(alike, free)[0] == pytest.approx(100 / 154)


def test_bad_input_is_reported():
    state = chain(5)
    with pytest.raises(ValueError, match="method must be 'auto', 'dense' or 'polynomials', got 'kpm'"):
        ss.modes.density_of_states(state, CHAIN, method="kpm")
    with pytest.raises(ValueError, match="at least 1"):
        ss.modes.density_of_states(state, CHAIN, bins=0)
    with pytest.raises(ValueError, match=r"bins = 1000000000000 makes .* use fewer bins"):
        ss.modes.density_of_states(state, CHAIN, bins=10**12)
    with pytest.raises(ValueError, match="n = 5"):
        ss.modes.participation_ratio(np.ones((4, 1)), ss.freedom(state))
