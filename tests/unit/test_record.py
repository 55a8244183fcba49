"""What a run samples equals what is measured on its states; a perturbation decays as the damped spectrum says."""

import numpy as np
import pytest
from scipy.linalg import expm

import stickslip as ss
from stickslip.loading.packing import jammed
from tests.conftest import make_law
from tests.properties.test_determinism import flowing


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("n", [30, 120])
def test_samples_are_what_the_states_say(n, dim):
    law, state = make_law("hertz_mindlin", "sharp" if dim == 3 else "smooth"), flowing(n=n, dim=dim)
    end, record, _ = ss.run(state, law, 60, 0.05, every=20)
    assert len(record.time) == 4
    moving = end.grains
    start = ss.measure.stress(ss.accept(state, ss.forces(state, law)[1]), law)
    for sample, stress in ((0, start), (-1, ss.measure.stress(end, law))):
        np.testing.assert_allclose(record.stress[sample], stress, atol=1e-13)  # sums in another order
        assert record.pressure[sample] == pytest.approx(np.trace(stress) / dim, rel=1e-10)
        assert record.shear_stress[sample] == pytest.approx(-stress[0, 1], abs=1e-13)
    assert not record.strain.any()
    np.testing.assert_allclose(record.fabric[-1], ss.measure.fabric(end), atol=1e-13)
    assert np.trace(record.fabric[-1]) == pytest.approx(1)
    np.testing.assert_allclose(
        record.momentum_flux[-1], np.einsum("a,ab,ac->bc", moving.mass, moving.velocity, moving.velocity), rtol=1e-12
    )
    energy = 0.5 * (moving.mass @ moving.velocity**2 + moving.inertia @ moving.spin**2).sum()
    assert record.kinetic_energy[-1] == pytest.approx(energy)
    assert record.rattlers[-1] == ss.measure.rattlers(end).sum()
    assert record.held_coordination[-1] == pytest.approx(ss.measure.coordination(end))
    assert record.coordination[-1] == pytest.approx(ss.measure.contact_numbers(end).mean())
    assert 0 < record.sliding_fraction[-1] < 1
    half, _, _ = ss.run(state, law, 20, 0.05)
    assert record.coordination[1] == pytest.approx(ss.measure.contact_numbers(half).mean())


@pytest.mark.parametrize("dim", [2, 3])
def test_grains_without_friction_need_another_support(dim):
    end, record, _ = ss.run(flowing(n=30, dim=dim), ss.laws.hertz_mindlin(mu=0.0), 50, 0.05, every=10)
    held = ss.measure.rattlers(end, least=dim).sum()
    assert record.rattlers[-1] == ss.measure.rattlers(end, least=dim + 1).sum() > held


@pytest.mark.parametrize("dim", [2, 3])
def test_strain_is_the_gradient_imposed_on_the_cell(dim):
    """Also of a cell that leans at first; what is subtracted is 1, so that errors are a few roundings of 1."""
    law, state = make_law("hertz_mindlin", "smooth"), flowing(n=30, dim=dim)
    state = ss.packings.strained(state, [[0.01, 0.1], [0, -0.02]] if dim == 2 else 0.1 * np.eye(3, k=1))
    _, record, _ = ss.run(state, law, 2, 0.05, every=1)
    imposed = np.zeros((3, 3, 3))
    imposed[1, 0, 1], imposed[2] = 0.2, np.diag([-0.01, -0.03, 0 if dim == 2 else -0.02])
    cells = np.stack([ss.packings.strained(state, g).cell.vectors for g in imposed])
    record = record._replace(cell=cells)
    np.testing.assert_allclose(record.strain, imposed, atol=1e-14)
    np.testing.assert_allclose(record.shear_strain, [0, 0.2, 0], atol=1e-14)
    smaller = 0.99 * 0.97 * (1 if dim == 2 else 0.98)
    np.testing.assert_allclose(record.volumetric_strain, [0, 0, 1 - smaller], atol=1e-14)


def test_a_record_between_walls_has_no_stress():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(), 0, 1)
    _, record, _ = ss.run(ss.packings.disk_array(3, press=1e-5), law, 2, 0.05, every=1)
    with pytest.raises(ValueError, match="no volume to average over"):
        record.stress  # noqa: B018
    assert not record.strain.any()
    assert "pressure" not in record._repr_html_()


def test_inertial_number_refuses_what_makes_no_sense():
    with pytest.raises(ValueError, match="pressure must be positive"):
        ss.measure.inertial_number(0.1, -1, diameter=1.0, density=1.0)


@pytest.mark.parametrize(("law_name", "damping"), [("linear", "mass_velocity"), ("hertz_mindlin_reff", "viscoelastic")])
def test_a_small_perturbation_decays_as_the_linearised_form_says(law_name, damping):
    """q(t) = exp(t [[0, 1], [M⁻¹J, M⁻¹C]]) q(0) from an equilibrium whose contacts stick."""
    law = make_law(law_name, "smooth", mu=5.0, damping=damping, damping_n=0.4, damping_t=0.3)
    packed, _ = jammed(40, packing_fraction=0.68, seed=2)
    state, outcome = ss.equilibrate(packed, law)
    assert outcome.ok
    free = ss.freedom(state)
    springs, dashpots = ss.modes.contact_blocks(state, law)
    pull, rub = (ss.modes.assembled(state, b, free).toarray() / free.mass[:, None] for b in (springs, dashpots))
    size = len(free)
    rate = np.random.default_rng(0).normal(0, 1e-9, size)
    full = np.zeros(6 * state.n_bodies)
    full[free.component] = rate
    full = full.reshape(-1, 6)
    grains = state.grains._replace(velocity=full[:, :3].copy(), spin=full[:, 3:] / state.grains.radius[:, None])
    duration, dt = 20.0, 0.01
    end, _, _ = ss.run(state._replace(grains=grains), law, round(duration / dt), dt)
    motion = expm(duration * np.block([[np.zeros((size, size)), np.eye(size)], [pull, rub]]))
    predicted = motion[:size, size:] @ rate
    undamped = expm(duration * np.block([[np.zeros((size, size)), np.eye(size)], [pull, 0 * rub]]))[:size, size:] @ rate
    turned = (end.grains.angle - state.grains.angle) * state.grains.radius[:, None]
    moved = np.concatenate([end.grains.position - state.grains.position, turned], axis=1).ravel()[free.component]
    # second order in the time step; the residual of the equilibrium and what is not linear are far below
    assert np.abs(moved - predicted).max() < 1e-3 * np.abs(predicted).max()
    assert np.abs(undamped - predicted).max() > 0.1 * np.abs(predicted).max()
