"""Packings handed to another law: what slid without friction sticks from zero slip under a law that has some."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.jacobian import linearise
from stickslip.core.state import SLIDE, STICK
from stickslip.solve.freedom import assembled
from tests.conftest import make_law, make_packing
from tests.derivatives.test_jacobian import CASES, differences

SMOOTH = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


def pressed(dim, law_name="hertz_mindlin", coulomb="smooth"):
    """Grains on a floor that were never sheared, their contacts committed under a law without friction."""
    bare, state = make_law(law_name, coulomb, mu=0.0), make_packing(dim)
    return ss.accept(state, ss.forces(state, bare)[1])


@pytest.mark.parametrize(
    ("law_name", "coulomb", "dim"), [case for case in CASES if case[2] == 2 or case[0] == "hertz_mindlin_reff"]
)
def test_the_jacobian_from_zero_slip_is_that_of_contacts_that_stick(law_name, coulomb, dim):
    state, law = pressed(dim, law_name, coulomb), make_law(law_name, coulomb)
    rows = ss.measure.touching(state)
    assert (state.contacts.mode[rows] == SLIDE).all()
    assert not linearise(state, law).slides.any()
    free = ss.freedom(state)
    exact = assembled(state, ss.modes.contact_blocks(state, law)[0], free).toarray()
    for memory in (ss.FREE, ss.HELD):
        numeric = differences(state, law, free, memory, h=1e-8)
        # the smooth law has k²|s|s/(μF_n) beside k s, a share of h/(μδ) = 1e-8/0.01; round-off over h is 1e-8, too
        np.testing.assert_allclose(exact, numeric, atol=1e-5 * np.abs(exact).max(), rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("coulomb", ["smooth", "sharp"])
def test_one_contact_has_the_stiffness_of_its_closed_form(dim, coulomb):
    """λ = 2 k_n/m along the normal, and k_t (2/m + 2R²/I) across it, but for terms of F_n/|r|."""
    bare, law = (ss.laws.linear(1.0, 0.7, mu, coulomb=coulomb) for mu in (0.0, 0.5))
    pair = ss.packings.from_arrays([[0, 0], [1 - 1e-9, 0]], [0.5, 0.5], bare, mass=1.5, dim=2)
    if dim == 3:
        pair = ss.packings.from_arrays([[0, 0, 0], [1 - 1e-9, 0, 0]], [0.5, 0.5], bare, mass=1.5)
    inertia = 0.5 if dim == 2 else 0.4
    across = 0.7 * (2 + 2 / inertia) / 1.5
    frictional, slippery = (ss.spectrum(pair, kind).eigenvalues for kind in (law, bare))
    count = dim - 1
    np.testing.assert_allclose(np.sort(frictional.real)[-count:], across, rtol=1e-8)
    assert np.abs(slippery).max() == pytest.approx(2 / 1.5, rel=1e-8)
    assert (np.abs(slippery) > 1e-6).sum() == 1


@pytest.mark.parametrize("rolls", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_nothing_depends_on_whether_contacts_slid_without_friction(rolls):
    """Runs, equilibria and spectra of the same packing whose contacts were committed under either law."""
    law = ss.laws.from_file("examples/rolling_law.py") if rolls else SMOOTH
    stuck, _ = ss.packings.jammed(20, packing_fraction=0.7, seed=4)
    slid = ss.accept(stuck, ss.forces(stuck, ss.laws.hertz_mindlin(mu=0.0))[1])
    count = int(slid.contacts.count[0])
    assert (slid.contacts.mode[:count] == SLIDE).any()
    assert not slid.contacts.reached.any()
    a, b = (ss.stability(state, law, method="all") for state in (slid, stuck))
    assert a.zero_modes == b.zero_modes == 3
    values, other = (ss.spectrum(state, law).eigenvalues for state in (slid, stuck))
    assert np.array_equal(values, other)
    assert np.abs(values).max() < 100  # it was 1e33
    push = np.random.default_rng(0).normal(0, 1e-4, slid.grains.velocity.shape)
    ends = [
        ss.run(state._replace(grains=state.grains._replace(velocity=push)), law, 40, 0.1)[0] for state in (slid, stuck)
    ]
    assert np.array_equal(ends[0].contacts.slip, ends[1].contacts.slip)
    assert ends[0].contacts.slip.any()
    rest = [ss.equilibrate(state, law) for state in ends]
    assert np.array_equal(rest[0][0].grains.position, rest[1][0].grains.position)


@pytest.mark.parametrize("coulomb", ["smooth", "sharp"])
def test_a_law_without_friction_takes_tangential_forces_away(coulomb):
    """Whatever mode and slip a contact brings from a law that had some."""
    state, law, bare = pressed(3), make_law("linear", coulomb), make_law("linear", coulomb, mu=0.0)
    turned = state._replace(grains=state.grains._replace(angle=state.grains.angle + 0.01))
    sheared = ss.accept(turned, ss.forces(turned, law)[1])
    assert set(sheared.contacts.mode[ss.measure.touching(sheared)]) == {STICK}
    for memory in (ss.FREE, ss.HELD):
        assert not ss.forces(sheared, bare, memory=memory)[0].torque.any()
    stiff = ss.modes.contact_blocks(sheared, bare)[0]
    assert not stiff[:, 3:, 3:].any()
