"""Complex moduli: static and affine limits, closed form of a lattice, a run of the engine, and refusals."""

import re

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.jacobian import blocks_of, linearise
from stickslip.solve.freedom import assembled
from stickslip.solve.moduli import with_free_cell
from tests.modes.conftest import sheared, triangular

DASHPOTS = {"damping": "viscoelastic", "damping_n": 0.3, "damping_t": 0.2}
LAW = ss.laws.hertz_mindlin(mu=10.0, **DASHPOTS)


@pytest.fixture(scope="module")
def disks():
    return sheared(20, 2, 0.9, 2e-4, seed=4, law=LAW)


def test_slow_strain_gives_the_elastic_moduli(disks):
    still = ss.modes.elastic_moduli(disks, LAW)
    answer = ss.modes.complex_moduli(disks, LAW, [0.0, 1e-5], drag=0.1)
    np.testing.assert_allclose(answer.tensor[0], still.tensor, atol=1e-12)
    np.testing.assert_allclose(answer.tensor[1].real, still.tensor, atol=1e-8)
    np.testing.assert_allclose([answer.bulk[0], answer.shear[0]], [still.bulk, still.shear], atol=1e-12)


def test_fast_strain_is_affine(disks):
    law = ss.laws.hertz_mindlin(mu=10.0)
    still = ss.modes.elastic_moduli(disks, law)
    answer = ss.modes.complex_moduli(disks, law, 1e4, drag=0.1)
    assert np.abs(still.non_affine).max() > 1e-3
    np.testing.assert_allclose(answer.tensor[0], still.affine, atol=1e-7)


def test_lattice_with_dashpots_has_its_closed_form():
    """The motion is affine by symmetry: springs k become k + iωη."""
    kn, kt, eta_n, eta_t, omega = 1.0, 0.5, 0.3, 0.2, np.array([0.1, 1.0, 3.0])
    law = ss.laws.linear(kn, kt, 0.5, damping="velocity", damping_n=eta_n, damping_t=eta_t)
    answer = ss.modes.complex_moduli(triangular(law), law, omega)
    normal, tangential = kn + 1j * omega * eta_n, kt + 1j * omega * eta_t
    np.testing.assert_allclose(answer.bulk, 3**0.5 / 2 * normal, rtol=1e-6)
    np.testing.assert_allclose(answer.shear, 3**0.5 / 4 * (normal + tangential), rtol=1e-6)


def test_losses_are_positive_without_friction():
    law = ss.laws.hertz_mindlin(mu=0.0, damping="viscoelastic", damping_n=0.3)
    state = sheared(16, 3, 0.7, 0.0, seed=1, law=law)
    answer = ss.modes.complex_moduli(state, law, np.geomspace(1e-2, 10, 8), drag=0.05)
    loss = answer.tensor.imag.reshape(8, 9, 9)
    assert np.linalg.eigvalsh((loss + loss.transpose(0, 2, 1)) / 2).min() > -1e-12
    assert (answer.shear.imag > 0).all()


def elastic_part(state, law, omega, drag):
    """C* without the stress of dashpots, which move the grains all the same, from dense matrices."""
    state, stiff, free, grain, cell = with_free_cell(state, law)
    stiff, volume = stiff.toarray(), np.linalg.det(state.cell.vectors)
    damp = assembled(state, blocks_of(state, law, linearise(state, law))[1], free).toarray()
    whole, own = stiff + 1j * omega * damp, free.mass[grain] * (1j * omega * drag - omega**2)
    motion = np.linalg.solve(np.diag(own) - whole[np.ix_(grain, grain)], whole[np.ix_(grain, cell)])
    both = stiff[np.ix_(cell, cell)] + stiff[np.ix_(cell, grain)] @ motion
    return (-(free.length**2) / volume * both).reshape(2, 2, 2, 2)


@pytest.mark.parametrize(("omega", "law"), [(0.15, LAW), (0.6, LAW), (0.6, ss.laws.hertz_mindlin(mu=10.0))])
def test_run_with_an_oscillating_cell_has_these_moduli(disks, omega, law):
    """A record has no stress of dashpots."""
    drag, size, steps, rounds = 0.3, 1e-7, 400, 12
    dt = 2 * np.pi / omega / steps / (parts := int(np.ceil(2 * np.pi / omega / steps / 0.02)))
    times = np.arange(rounds * steps + 1) * dt * parts
    control = ss.control.strained_at(disks.control, [[0, size * omega], [0, 0]])
    control = ss.control.time_dependent(control, "cell", times, np.cos(omega * times))
    strained = disks._replace(control=control)
    _, record, *_ = ss.run(strained, law, dt=dt, steps=rounds * steps * parts, drag=drag, every=parts)
    stress = np.asarray(record.stress)[-2 * steps :, :2, :2]
    t = np.asarray(record.time)[-2 * steps :]
    basis = np.stack([np.sin(omega * t), np.cos(omega * t), np.ones(len(t))], axis=1)
    storage, loss, _ = -np.linalg.lstsq(basis, stress.reshape(len(t), 4))[0] / size
    answer = elastic_part(disks, law, omega, drag)[:, :, 0, 1].ravel()
    if law is not LAW:
        whole = ss.modes.complex_moduli(disks, law, omega, drag=drag).tensor[0, :, :, 0, 1].ravel()
        np.testing.assert_allclose(whole, answer, atol=1e-9 * np.abs(answer).max())
    np.testing.assert_allclose(storage + 1j * loss, answer, atol=1e-4 * np.abs(answer).max())


def test_bad_input_is_refused_in_a_sentence(disks):
    for omega in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"must be zero or positive|give finite numbers"):
            ss.modes.complex_moduli(disks, LAW, omega)
    with pytest.raises(ValueError, match="equilibrate the packing first"):
        ss.modes.complex_moduli(disks, ss.laws.hertz_mindlin(2.0, 0.1, 10.0), 1.0)
    spring = disks.control.spring.copy()
    spring[0, 0] = 1.0
    with pytest.raises(ValueError, match=r"springs.*complex moduli need"):
        ss.modes.complex_moduli(disks._replace(control=disks.control._replace(spring=spring)), LAW, 1.0)


def test_resonance_without_damping_is_named(disks):
    law = ss.laws.hertz_mindlin(mu=10.0)
    values = ss.spectrum(disks, law, modes=False).eigenvalues
    omega = float(np.sqrt(values[np.abs(values.imag) < 1e-12].real.max()))
    with pytest.raises(ValueError, match=re.escape(f"at frequency = {omega:.9g}, the response is unbounded")):
        ss.modes.complex_moduli(disks, law, omega)
