"""Energies dissipated by each contact add up to the ledger of a run, and are those of one sliding block."""

import numpy as np
import pytest

import stickslip as ss
from tests.conftest import make_law, make_packing, stirred


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["linear", "hertz_mindlin_reff_rescaled"])
def test_energies_add_up_to_the_ledger(kind, dim):
    law = make_law(kind, "sharp", damping_n=0.3, damping_t=0.2, damping="mass_velocity")
    rng = np.random.default_rng(1)
    state = stirred(make_packing(dim), law, rng)
    velocity = rng.normal(0, 0.02, state.grains.position.shape) * (np.arange(3) < dim)
    state = state._replace(grains=state.grains._replace(velocity=velocity))
    dt, slid = 0.05 * ss.measure.stable_time_step(state, law), 0
    for _ in range(60):
        after, record, _ = ss.run(state, law, 1, dt, every=1, ledger=True)
        parts = ss.measure.dissipation(state, after, law, dt=dt)
        expected = record.ledger.coulomb[-1], record.ledger.viscous[-1]
        assert [part.sum() for part in parts] == pytest.approx(expected, rel=1e-9, abs=1e-15)
        slid += (parts.sliding > 0).sum()
        state = after
    assert slid > 20


def test_a_sliding_block_dissipates_friction_times_distance():
    law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.3)
    cell, floor = ss.box([10, 10, 1], [False, False, False], 2), ss.flat_walls([0, 0, 0], [0, 1, 0])
    states = []
    for x in (0.0, 0.1, 0.3):
        state = states[-1] if states else ss.assembly(ss.disks([[0, 0.49, 0]], [0.5]), floor, cell)
        state = state._replace(grains=state.grains._replace(position=np.array([[x, 0.49, 0]])))
        states.append(ss.accept(state, ss.forces(state, law)[1]))
    force, stretched = 0.3 * 0.01, 0.3 * 0.01 / 0.5
    assert ss.measure.dissipation(*states[1:], law).sliding == pytest.approx([force * 0.2])
    # the force grows until the contact slides; the ledger takes its mean over the step
    assert ss.measure.dissipation(*states[:2], law).sliding == pytest.approx([0.5 * force * (0.1 - stretched)])
    assert not ss.measure.dissipation(*states[1:], law).dashpots.any()


def test_states_of_two_samples_are_refused():
    law = make_law("linear", "sharp")
    with pytest.raises(ValueError, match="the states have 8 and 6 bodies"):
        ss.measure.dissipation(make_packing(2), make_packing(2, n=5), law)
    for dt in (-1.0, np.inf):
        with pytest.raises(ValueError, match=f"dt must be zero or positive.*, got {dt}"):
            ss.measure.dissipation(make_packing(2), make_packing(2), law, dt=dt)
