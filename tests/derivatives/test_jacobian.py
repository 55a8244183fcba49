"""The analytic Jacobian against fourth-order central differences of trial evaluations."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FREE, HELD, forces
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.laws.builtin import linear
from stickslip.core.measure import overlaps
from stickslip.core.state import SLIDE, STICK
from stickslip.solve.freedom import assembled, displaced, freedom, jacobian, residual_vector
from tests.conftest import make_law, make_packing, stirred

CASES = [
    (law, coulomb, dim)
    for law in ("hertz_mindlin", "linear", "hertz_mindlin_reff")
    for coulomb in ("smooth", "sharp")
    for dim in (2, 3)
]


def differences(state, law, free, memory, h, ways=None):
    """Fourth-order central differences of the unbalanced force along each column of `ways`, or each free coordinate."""
    ways = np.eye(len(free)) if ways is None else ways
    out = np.zeros(ways.shape)
    for k, way in enumerate(ways.T):
        for weight, shift in ((1, -2), (-8, -1), (8, 1), (-1, 2)):
            moved = displaced(state, free, shift * h * way)
            out[:, k] += weight * residual_vector(moved, forces(moved, law, memory=memory)[0], free)
    return out / (12 * h)


def random_ways(free):
    """Six directions in which all coordinates move by 0.5 to 1: a wrong entry of J is seen in each of them."""
    rng, shape = np.random.default_rng(0), (len(free), 6)
    return rng.uniform(0.5, 1, shape) * rng.choice([-1, 1], shape)


FIRST = {(2, 0): 43, (2, 1): 24, (3, 1): 31}  # attempts that succeed on many processors, by dimension and seed


@cache
def sample(law_name, coulomb, dim, seed):
    """A stirred packing with sticking and sliding at grains and at the wall.

    Without grazing contacts, whose force has no second derivative, and without contacts of zero slip, where the smooth
    law's |s| s has none.
    """
    law = make_law(law_name, coulomb)
    for attempt in (FIRST.get((dim, seed), 0), *range(1000)):
        rng = np.random.default_rng(1000 * seed + attempt)
        state = stirred(make_packing(dim, seed=1000 * seed + attempt), law, rng)
        modes = state.contacts.mode[: state.contacts.count[0]]
        at_wall = state.contacts.j[: len(modes)] >= len(state.grains.radius)
        wanted = SLIDE if seed % 2 else STICK
        if (
            np.abs(overlaps(state)).min() > 2e-3
            and np.linalg.norm(state.contacts.slip[: len(modes)][modes > 0], axis=1).min() > 2e-3
            and {STICK, SLIDE} <= set(modes[~at_wall])
            and wanted in modes[at_wall]
        ):
            return state, law
    raise AssertionError("no suitable packing in a thousand attempts")


@pytest.mark.parametrize(  # seeds: sticking and sliding at the wall
    ("law_name", "coulomb", "dim", "seed"), [(*case, 0) for case in CASES] + [(*case, 1) for case in CASES[2:4]]
)
def test_jacobian_of_an_accepted_state(law_name, coulomb, dim, seed):
    state, law = sample(law_name, coulomb, dim, seed)
    modes = state.contacts.mode[: state.contacts.count[0]]
    free = freedom(state)
    exact, ways = assembled(state, contact_blocks(state, law)[0], free), random_ways(free)
    # of a contact, up to twelve coordinates move at once
    numeric = differences(state, law, free, HELD, 2e-5 * overlaps(state)[modes > 0].min() ** 0.5, ways)
    # h⁴ and round-off/h balance near 1e-10 of the largest entry; 1e-8 is what the project promises
    np.testing.assert_allclose(exact @ ways, numeric, atol=1e-8 * np.abs(exact.data).max(), rtol=0)


RESCALED = [
    ("hertz_mindlin_rescaled", "smooth", 2),
    ("hertz_mindlin_rescaled", "sharp", 3),
    ("hertz_mindlin_reff_rescaled", "smooth", 3),
]


@pytest.mark.parametrize(
    ("law_name", "coulomb", "dim", "size"),
    [(*case, 1e-2) for case in CASES + RESCALED] + [(*case, 3e-4) for case in CASES[2:4] + RESCALED[:2]],
)
def test_jacobian_of_a_trial_state_with_pending_increments(law_name, coulomb, dim, size):
    """Large increments turn contacts by a hundredth and sliding slips by a radian on the way."""
    state, law = sample(law_name, coulomb, dim, seed=1)
    free = freedom(state)
    rng = np.random.default_rng(0)
    pending = with_neighbor_list(displaced(state, free, rng.normal(0, size, len(free))))
    exact, ways = assembled(pending, contact_blocks(pending, law, memory=FREE)[0], free), random_ways(free)
    numeric = differences(pending, law, free, FREE, 1e-6, ways)
    # a contact on the edge between stick and slide would be off by its whole stiffness, not by round-off
    np.testing.assert_allclose(exact @ ways, numeric, atol=1e-8 * np.abs(exact.data).max(), rtol=0)


@pytest.mark.parametrize("dim", [2, 3])
def test_jacobian_of_a_free_wall(dim):
    state, law = sample("hertz_mindlin", "smooth", dim, seed=1)
    free_wall = state.control.free.copy()
    free_wall[-1, :3] = True
    state = state._replace(control=state.control._replace(free=free_wall))
    free = freedom(state)
    assert (free.body == state.n_bodies - 1).sum() == dim
    exact = assembled(state, contact_blocks(state, law)[0], free).toarray()
    numeric = differences(state, law, free, HELD, h=1e-6)
    np.testing.assert_allclose(exact, numeric, atol=1e-8 * np.abs(exact).max(), rtol=0)


def test_matrices_of_many_grains_are_assembled():
    """Beyond 46,340 bodies, the number of a pair exceeds 32 bits."""
    n, law = 46_400, linear(1.0, mu=0.0)
    state = ss.packings.from_arrays(np.arange(n)[:, None] * [0.99, 0, 0], np.full(n, 0.5), law)
    matrix = jacobian(state, law)[::6, ::6]  # along the chain
    assert matrix.diagonal().tolist() == pytest.approx([-1.0, *[-2.0] * (n - 2), -1.0])
    assert matrix.diagonal(1).tolist() == pytest.approx([1.0] * (n - 1))


def test_jacobian_is_symmetric_without_friction():
    law = make_law("hertz_mindlin", "sharp", mu=0.0)
    state = stirred(make_packing(3), law, np.random.default_rng(1))
    free = freedom(state)
    jacobian = assembled(state, contact_blocks(state, law)[0], free).toarray()
    # equal up to the order of additions
    np.testing.assert_allclose(jacobian, jacobian.T, atol=1e-14 * np.abs(jacobian).max())


@pytest.mark.parametrize("damping", ["velocity", "mass_velocity", "viscoelastic"])
@pytest.mark.parametrize("law_name", ["hertz_mindlin", "linear", "hertz_mindlin_reff"])
@pytest.mark.parametrize("dim", [2, 3])
def test_dashpot_matrix_against_differences_in_velocity(dim, law_name, damping):
    law = make_law(law_name, "smooth", damping=damping, damping_n=0.3, damping_t=0.2)
    state = stirred(make_packing(dim, seed=3), law, np.random.default_rng(3), size=0.001)
    count = state.contacts.count[0]
    stick_only = state.contacts.mode[:count] != SLIDE
    assert stick_only.all(), "the dashpot of a sliding contact has two one-sided derivatives"
    free = freedom(state)
    exact, ways = assembled(state, contact_blocks(state, law)[1], free), random_ways(free)
    numeric = np.zeros_like(ways)
    h, n = 1e-6, len(state.grains.radius)
    for k, way in enumerate(ways.T):
        for sign in (1, -1):
            rate = free.spread(sign * h * way)[:n]
            grains = state.grains._replace(velocity=rate[:, :3], spin=rate[:, 3:] / state.grains.radius[:, None])
            moving = state._replace(grains=grains)
            numeric[:, k] += sign * residual_vector(moving, forces(moving, law, memory=HELD)[0], free) / (2 * h)
    # the limit's dependence on velocity is quadratic at rest: central differences are good to h² and round-off/h
    np.testing.assert_allclose(exact @ ways, numeric, atol=1e-8 * np.abs(exact.data).max(), rtol=0)
