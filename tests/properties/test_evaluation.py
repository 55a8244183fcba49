"""What one evaluation of forces must obey, whatever the packing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stickslip.core.contacts.forces import accept, forces
from stickslip.core.laws.builtin import damping_model
from stickslip.core.state import OPEN, PER_PAIR, SLIDE
from stickslip.solve.freedom import displaced, freedom
from tests.conftest import make_law, make_packing, stirred

seeds = st.integers(0, 10_000)
dims = st.sampled_from([2, 3])
laws = st.sampled_from(["hertz_mindlin", "linear", "hertz_mindlin_reff"])
coulombs = st.sampled_from(["smooth", "sharp"])


def packing(law, dim, seed):
    return stirred(make_packing(dim, seed), law, np.random.default_rng(seed))


@given(laws, coulombs, dims, seeds)
def test_action_equals_reaction(law_name, coulomb, dim, seed):
    law = make_law(law_name, coulomb)
    state = packing(law, dim, seed)
    loads, _ = forces(state, law)
    size = np.abs(loads.force).max()
    # the sum over all bodies, walls included, cancels up to the order of additions
    np.testing.assert_allclose(loads.force.sum(axis=0), 0, atol=1e-14 * max(size, 1) * len(loads.force))


@given(laws, coulombs, dims, seeds)
def test_tangential_force_obeys_coulomb(law_name, coulomb, dim, seed):
    law = make_law(law_name, coulomb)
    state = packing(law, dim, seed)
    c, grains, walls = state.contacts, state.grains, state.walls
    n, material = len(grains.radius), np.append(grains.material, state.walls.material)
    for k in np.flatnonzero(c.mode[: c.count[0]] != OPEN):
        i, j = c.i[k], c.j[k]
        if i == j:
            continue  # a grain that touches its own image feels no net force
        if j < n:
            branch = grains.position[i] - grains.position[j] + c.image[k] @ state.cell.vectors
            normal = branch / np.linalg.norm(branch)
            overlap = grains.radius[i] + grains.radius[j] - np.linalg.norm(branch)
            radius = 1 / (1 / grains.radius[i] + 1 / grains.radius[j])
        else:
            normal, radius = walls.normal[j - n], grains.radius[i]
            overlap = radius - (grains.position[i] - walls.point[j - n]) @ normal
        kn, _, mu = law.table[material[i], material[j], :3]
        f_n = kn * {"linear": overlap, "hertz_mindlin": overlap**1.5}.get(law_name, np.sqrt(radius) * overlap**1.5)
        only = c._replace(mode=np.where(np.arange(len(c.mode)) == k, c.mode, OPEN), count=c.count)
        pair_force = single_contact_force(state, law, only, k)
        along = pair_force @ normal
        across = np.linalg.norm(pair_force - along * normal)
        assert along == pytest.approx(f_n, rel=1e-9)  # round-off of positions over an overlap of a few hundredths
        assert across <= mu * f_n * (1 + 1e-12)
        if c.mode[k] == SLIDE:
            assert across == pytest.approx(mu * f_n, rel=1e-9)


def single_contact_force(state, law, contacts, k):
    """Force of contact k on its body i, from a list that holds this contact only."""
    fields = {f: getattr(contacts, f)[k : k + 1] for f in contacts._fields if f in PER_PAIR and f != "rolling"}
    lonely = contacts._replace(**fields, count=np.array([1]))
    loads, _ = forces(state._replace(contacts=lonely), law)
    body = contacts.i[k]
    return loads.force[body]


@given(laws, coulombs, seeds)
def test_one_evaluation_turns_with_everything(law_name, coulomb, seed):
    law = make_law(law_name, coulomb)
    state = packing(law, 3, seed)
    free = freedom(state)
    pending = displaced(state, free, np.random.default_rng(seed).normal(0, 1e-3, len(free)))
    turn = Rotation.random(random_state=seed).as_matrix()
    plain, trial = forces(pending, law)
    turned, turned_trial = forces(rotated(pending, turn), law)
    scale = np.abs(plain.force).max()
    # the same numbers in another order of roundings
    np.testing.assert_allclose(turned.force, plain.force @ turn.T, atol=1e-12 * max(scale, 1))
    np.testing.assert_allclose(turned.torque, plain.torque @ turn.T, atol=1e-12 * max(scale, 1))
    np.testing.assert_allclose(turned_trial.slip, trial.slip @ turn.T, atol=1e-12)


def rotated(state, turn):
    """Positions, angles, walls, cell and memory turned together."""
    g, w, c = state.grains, state.walls, state.contacts
    vectors = {name: np.ascontiguousarray(getattr(c, name) @ turn.T) for name in ("slip", "pair", "roll")}
    return state._replace(
        grains=g._replace(
            position=np.ascontiguousarray(g.position @ turn.T), angle=np.ascontiguousarray(g.angle @ turn.T)
        ),
        walls=w._replace(point=w.point @ turn.T, normal=np.ascontiguousarray(w.normal @ turn.T)),
        cell=state.cell._replace(vectors=np.ascontiguousarray(state.cell.vectors @ turn.T)),
        contacts=c._replace(**vectors, origin=np.ascontiguousarray(c.origin @ turn.T)),
    )


@given(laws, coulombs, dims, seeds)
def test_trial_evaluations_leave_no_trace(law_name, coulomb, dim, seed):
    law = make_law(law_name, coulomb)
    state = packing(law, dim, seed)
    free = freedom(state)
    before = [np.copy(a) for part in state[:5] for a in part]
    first, _ = forces(state, law)
    for k in range(3):
        forces(displaced(state, free, np.random.default_rng(k).normal(0, 0.01, len(free))), law)
    again, _ = forces(state, law)
    assert all(np.array_equal(a, b) for a, b in zip(before, (x for part in state[:5] for x in part), strict=True))
    assert np.array_equal(first.force, again.force)
    assert np.array_equal(first.torque, again.torque)


@given(laws, dims, seeds)
def test_without_friction_there_is_no_tangential_force(law_name, dim, seed):
    law = make_law(law_name, "smooth", mu=0.0)
    state = packing(law, dim, seed)
    loads, trial = forces(state, law)
    assert not loads.torque.any()
    assert not trial.slip.any()
    assert not damping_model(law)


@given(coulombs, dims, seeds)
def test_committing_nothing_new_changes_nothing(coulomb, dim, seed):
    law = make_law("hertz_mindlin", coulomb)
    state = packing(law, dim, seed)
    loads, trial = forces(state, law)
    again, _ = forces(accept(state, trial), law)
    # projecting a projected slip again moves it by round-off
    np.testing.assert_allclose(again.force, loads.force, atol=1e-14)
