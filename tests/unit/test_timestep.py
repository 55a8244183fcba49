"""The largest stable time step: closed forms, a dense eigenvalue, refusal above it, a stop where nobody foresaw it."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.solve.spectrum import spectrum
from tests.conftest import make_law, make_packing, stirred


@pytest.mark.parametrize("law_name", ["hertz_mindlin", "linear", "hertz_mindlin_reff"])
@pytest.mark.parametrize("dim", [2, 3])
def test_it_is_that_of_the_stiffest_mode(dim, law_name):
    law = make_law(law_name, "sharp", mu=1e6)
    state = stirred(make_packing(dim, seed=2), law, np.random.default_rng(0), size=0.001)
    stiffest = spectrum(state, law).eigenvalues.real.max()
    # the springs alone: the pre-stress changes a mode's stiffness by the overlap over the radius, a few per cent
    assert ss.measure.stable_time_step(state, law) == pytest.approx(2 / np.sqrt(stiffest), rel=0.05)


@pytest.mark.parametrize("n", [2, 60])
def test_verlet_is_stable_below_and_refused_above(n):
    """A chain of balls on springs between walls."""
    position = np.zeros((n, 3))
    position[:, 0] = 0.999 * np.arange(n) + 0.4995
    walls = ss.flat_walls([[0, 0, 0], [0.999 * n, 0, 0]], [[1, 0, 0], [-1, 0, 0]])
    law = ss.laws.linear(kn=1.0, kt=0.0, mu=0.0)
    state = ss.assembly(ss.spheres(position, 0.5, velocity=[1e-5, 0, 0]), walls)
    longest = ss.measure.stable_time_step(state, law)
    assert longest == pytest.approx(1 / np.sin(np.pi * n / (2 * (n + 1))), rel=1e-3)  # ω = 2 sin(πk/2(n+1))
    end, _, outcome = ss.run(state, law, 20_000, 0.98 * longest)
    assert outcome.ok
    assert np.abs(end.grains.velocity).max() < 1e-3
    with pytest.raises(ValueError, match=f"use at most {longest:.4g}"):
        ss.run(state, law, 1, 1.05 * longest)


@pytest.mark.parametrize("n", [2, 60])
def test_an_unforeseen_blow_up_stops_at_once_and_says_where(n):
    """Nothing touches at the start, so no time step can be refused; then a contact throws the grains apart."""
    position = np.zeros((n, 3))
    position[:, 0] = 1.5 * np.arange(n)
    position[1, 0] = 1.001
    velocity = np.zeros((n, 3))
    velocity[1, 0] = -0.1
    state = ss.assembly(ss.spheres(position, 0.5, velocity=velocity))
    end, _, outcome = ss.run(state, ss.laws.linear(kn=1e6), 1000, 0.1)
    assert outcome.status is ss.Status.BLOWN_UP
    assert outcome.broken
    assert not outcome.ok
    assert outcome.iterations <= 2
    assert outcome.where in (0, 1)
    assert end.time == pytest.approx(0.1 * outcome.iterations)
    assert f"step {outcome.iterations}, time " in str(outcome)
    assert "the grains were initially without contacts" in str(outcome)
