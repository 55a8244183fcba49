"""A stress-controlled cell is a degree of freedom: in J, in Newton's method, in the spectrum and in dynamics alike."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.solve.freedom import jacobian
from tests.conftest import make_law, stirred
from tests.derivatives.test_jacobian import differences, overlaps, random_ways

EVERYTHING = {2: ["xx", "xy", "yx", "yy"], 3: [a + b for a in "xyz" for b in "xyz"]}


@cache
def jammed(dim, n, seed):
    """Made once for all tests, none of which writes to it."""
    return ss.packings.jammed(n, packing_fraction=0.7 if dim == 3 else 0.9, dim=dim, seed=seed)[0]


def packed(dim, n=20, pressure=1e-2, seed=3):
    state = jammed(dim, n, seed)
    components = dict.fromkeys(["xx", "yy", "zz"][:dim], pressure)
    return state._replace(control=ss.control.stress_controlled(state.control, components))


@pytest.mark.parametrize(
    ("dim", "coulomb", "memory"),
    [
        *((2, coulomb, memory) for coulomb in ("smooth", "sharp") for memory in (ss.HELD, ss.FREE)),
        (3, "smooth", ss.HELD),
        (3, "sharp", ss.FREE),
        pytest.param(3, "smooth", ss.FREE, marks=pytest.mark.slow),
        pytest.param(3, "sharp", ss.HELD, marks=pytest.mark.slow),
    ],
)
def test_jacobian_with_a_free_cell_against_differences(dim, coulomb, memory):
    law, start = make_law("hertz_mindlin", coulomb), packed(dim, n=12)
    control = ss.control.stress_controlled(start.control, dict.fromkeys(EVERYTHING[dim], 0.01) | {"xy": 3e-3})
    for seed in range(100):
        state = stirred(start._replace(control=control), law, np.random.default_rng(seed), size=5e-3)
        rows = ss.measure.touching(state)
        slip = np.linalg.norm(state.contacts.slip[rows], axis=1)
        if np.abs(overlaps(state)).min() > 1e-3 and slip.min() > 1e-3:  # a contact that grazes, or (with the smooth
            break  # law) has no slip, has no second derivative
    free = ss.freedom(state)
    if memory == ss.FREE:  # at rest a sliding contact is on the edge between stick and slide
        state = with_neighbor_list(ss.modes.displaced(state, free, np.random.default_rng(0).normal(0, 3e-4, len(free))))
    assert (free.axis == 6).sum() == dim**2
    free = ss.freedom(state)
    assert free.length == pytest.approx(np.linalg.det(state.cell.vectors[:dim, :dim]) ** (1 / dim))
    exact, ways = jacobian(state, law, free, memory=memory).toarray(), random_ways(free)
    # a step that takes a contact across the edge between stick and slide gives no derivative
    numeric = differences(state, law, free, memory, 2e-6 if memory == ss.HELD else 1e-6, ways)
    scale = np.abs(exact).max()
    np.testing.assert_allclose(exact @ ways, numeric, atol=1e-7 * scale, rtol=0)
    assert np.abs(exact[free.axis == 6][:, free.axis == 6]).max() > 1e-3 * scale


def test_newton_and_dynamics_find_the_wanted_stress():
    dim, law = 3, make_law("hertz_mindlin", "sharp", mu=0.3)
    state = packed(dim, n=60)
    calm, outcome = ss.relax(state, law, tolerance=1e-10, drag=0.1, dt=0.1)
    assert outcome.ok
    solved, outcome = ss.newton(calm, law, tolerance=1e-13)
    assert outcome.ok
    np.testing.assert_allclose(np.diag(ss.measure.stress(solved, law))[:dim], 1e-2, rtol=1e-9)
    np.testing.assert_allclose(solved.cell.vectors, calm.cell.vectors, atol=1e-5)
    more = ss.control.stress_controlled(solved.control, dict.fromkeys(["xx", "yy", "zz"][:dim], 1.02e-2))
    end, outcome = ss.equilibrate(solved._replace(control=more), law)
    assert outcome.ok
    np.testing.assert_allclose(np.diag(ss.measure.stress(end, law))[:dim], 1.02e-2, rtol=1e-9)
    assert ss.measure.packing_fraction(end) > ss.measure.packing_fraction(solved)


@pytest.mark.slow
def test_the_spectrum_says_how_a_pressed_packing_rings():
    """q(t) = exp(t [[0, 1], [M⁻¹J, M⁻¹C]]) q(0), the cell's strain among the coordinates, dashpots included."""
    law = make_law("hertz_mindlin_reff", "smooth", mu=5.0, damping="viscoelastic", damping_n=0.4, damping_t=0.3)
    state, outcome = ss.equilibrate(packed(3, n=40), law)
    assert outcome.ok
    free = ss.freedom(state)
    size, bodies = len(free), state.n_bodies
    pull = jacobian(state, law, free).toarray() / free.mass[:, None]
    rub = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[1], free).toarray() / free.mass[:, None]
    rate = np.random.default_rng(0).normal(0, 1e-9, size)
    rate[free.axis == 6] *= 10
    full = free.spread(rate)
    grains = state.grains._replace(velocity=full[:, :3].copy(), spin=full[:, 3:] / state.grains.radius[:, None])
    moving = state._replace(grains=grains, cell=state.cell._replace(rate=free.strain(rate)))
    duration, dt = 20.0, 0.01
    end, _, _ = ss.run(moving, law, round(duration / dt), dt)
    motion = expm(duration * np.block([[np.zeros((size, size)), np.eye(size)], [pull, rub]]))
    predicted = motion[:size, size:] @ rate
    strain = np.linalg.solve(state.cell.vectors, end.cell.vectors).T - np.eye(3)
    turned = (end.grains.angle - state.grains.angle) * state.grains.radius[:, None]
    moved = end.grains.position - state.grains.position - state.grains.position @ strain.T
    measured = np.append(np.concatenate([moved, turned], axis=1), free.length * strain)[free.component]
    assert len(measured) == 6 * bodies + 3
    assert np.abs(predicted[free.axis == 6]).max() > 1e-9
    # second order in the time step; what is not linear is far below
    np.testing.assert_allclose(measured, predicted, atol=1e-3 * np.abs(predicted).max(), rtol=0)
    assert len(ss.modes.damped_growth(state, law)) == 2 * size
