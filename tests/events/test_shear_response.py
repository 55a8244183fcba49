"""Linear response to shear against finite differences and elastic moduli, pruning, and damped stability."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.event_path import commit, displacement
from stickslip.solve.shear_response import Response, damped_exponents, margin, root_mean_square, support

LAWS = {
    "smooth": ss.laws.hertz_mindlin(mu=0.5, coulomb="smooth"),
    "sharp": ss.laws.hertz_mindlin(mu=0.1),
    "linear": ss.laws.linear(mu=0.3),
    "frictionless": ss.laws.hertz_mindlin(mu=0.0),
}


def sheared(law, dim, slip=True, seed=3):
    state, _ = ss.packings.jammed(20, packing_fraction={2: 0.88, 3: 0.68}[dim], dim=dim, seed=seed, law=law)
    for _ in range(4):
        state, outcome = ss.equilibrate(ss.packings.sheared(state, 5e-4, slip=slip), law, check="nothing")
        assert outcome.ok
    return commit(state, law)


@pytest.mark.parametrize("slip", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_motion_and_modulus_are_those_of_a_small_step(name, dim, slip):
    law, step = LAWS[name], 1e-7
    for seed in range(3, 20):  # until no contact is at its limit; samples differ among processors
        state = sheared(law, dim, slip, seed)
        response = Response(state, law, slip=slip)
        end, outcome = ss.newton(ss.packings.sheared(state, step, slip=slip), law, tolerance=1e-15)
        assert outcome.ok or outcome.residual < 1e-14
        rest = displacement(state, end, step) / step - response.rate
        if root_mean_square(rest, response.support.grains) < 1e-4 * response.speed:  # of the order of the step
            break
    else:
        raise AssertionError("in no sample is the motion that of a small step")
    if slip:
        tensor = ss.modes.elastic_moduli(state, law).tensor
        assert response.modulus == pytest.approx(tensor[0, 1, 0, 1], rel=1e-8)


def test_large_systems_have_the_same_motion(monkeypatch):
    state, law = sheared(LAWS["smooth"], 2), LAWS["smooth"]
    dense = Response(state, law)
    monkeypatch.setattr("stickslip.solve.shear_response.DENSE_BELOW", 1)
    sparse = Response(state, law)
    gap = root_mean_square(sparse.rate - dense.rate, dense.support.grains)
    assert gap < 1e-5 * dense.speed  # the shift of the diagonal


def test_the_spectrum_is_that_of_the_packing_without_translations():
    state, law = sheared(LAWS["smooth"], 2), LAWS["smooth"]
    everything = np.sort(ss.spectrum(state, law, modes=False).eigenvalues.real)
    response = Response(state, law)
    values = response.eigenvalues.real.tolist()
    for value in everything[np.abs(everything) > 1e-9]:
        values.remove(min(values, key=lambda x, value=value: abs(x - value)))
    assert len(everything) == len(response.eigenvalues)
    assert len(values) == 2 and values[0] == pytest.approx(values[1]) and values[0] > 0.1  # translations are lifted
    np.testing.assert_allclose(
        np.sort(np.setdiff1d(response.eigenvalues.real, values)), everything[np.abs(everything) > 1e-9], rtol=1e-8
    )


def test_a_contact_that_slides_or_opens_has_another_spectrum():
    state, law = sheared(LAWS["linear"], 2), LAWS["linear"]
    response = Response(state, law)
    row = response.sticking(1)[0]
    mode = state.contacts.mode.copy()
    mode[row] = ss.SLIDE
    slid = Response(state._replace(contacts=state.contacts._replace(mode=mode)), law)
    np.testing.assert_allclose(np.sort(response.eigenvalues_if(row).real), np.sort(slid.eigenvalues.real), atol=1e-10)
    opened = response.eigenvalues_if(row, ss.OPEN)
    assert opened.real.sum() < response.eigenvalues.real.sum()  # stiffness is taken away
    assert response.mobilisation[row] == np.nanmax(
        response.mobilisation[response.support.contacts & (state.contacts.mode == ss.STICK)[: len(response.branch)]]
    )


def test_grains_that_almost_float_are_pruned():
    law = LAWS["linear"]
    side, gap = 4, 0.02
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) * (1 - gap)
    place = np.vstack([grid, [0.5 * (1 - gap), 0.5 * (1 - gap)]])
    small = (
        np.sqrt(0.5) * (1 - gap) - 0.5 + 1e-6
    )  # a grain in a hole of the lattice that hardly touches its four neighbours
    radius = np.append(np.full(side**2, 0.5), small)
    state = ss.packings.from_arrays(place, radius, law, cell=[side * (1 - gap)] * 2, dim=2)
    loose, bound = support(state, law), support(state, law, prune=1e-6)
    assert loose.grains.sum() == side**2 and not loose.grains[-1]
    assert bound.grains.all()
    assert bound.contacts.sum() == loose.contacts.sum() + 4


@pytest.mark.parametrize("value", [2.0, -0.01, 1.0 + 0.05j, 1.0 + 0.3j, 1.0 - 0.3j, 0.04 + 0.01j])
@pytest.mark.parametrize("drag", [0.1, 0.5, 3.0])
def test_the_margin_tells_whether_a_damped_mode_grows(value, drag):
    """Against the roots of s² + ν s + λ."""
    values = np.array([value], complex)
    largest = np.roots([1.0, drag, value]).real.max()
    assert damped_exponents(values, drag)[0] == pytest.approx(largest, abs=1e-12)
    assert (margin(values, drag) < 0) == (largest > 0)
