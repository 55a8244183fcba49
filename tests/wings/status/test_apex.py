"""The four statuses at the apex of Coulomb's cone: one-to-one where no choice has lost its stability, else not."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stickslip as ss
from stickslip.wings.papers.quasi_rigid.cases import counterexample
from stickslip.wings.status import cone_apex as room
from stickslip.wings.status.apex_status import decide_statuses, reduce_to_contacts
from stickslip.wings.status.cone_apex import (
    OPENS,
    SLIDES,
    SLIDES_BACK,
    STICKS,
    Apex,
    StatusSolution,
    consistent_statuses,
    follow_pieces,
    status_of_velocity,
    statuses_at_apex,
)
from stickslip.wings.status.matrices import linear_system, statuses, stiffness_matrix
from tests.wings.status.test_status import jammed_disks

SPRINGS = np.diag([1.0, 0.5])


def single(surrounding, load, mu=0.6):
    compliance = np.linalg.inv(np.asarray(surrounding) + SPRINGS)
    return Apex(
        compliance, (compliance @ load)[None], SPRINGS[None], np.array([2 * mu]), np.zeros(1), np.zeros(1, bool)
    )


def drawn(seed):
    """Up to three contacts, at the apex or at the limit, in a random surrounding that may be unstable."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    a = rng.normal(size=(2 * count, 2 * count))
    outer = a @ a.T * rng.uniform(0.05, 1) + np.eye(2 * count) * rng.uniform(-0.3, 0.5)
    compliance = np.linalg.inv(outer + np.diag(np.tile([1.0, 0.5], count)))
    velocity = (compliance @ rng.normal(size=2 * count)).reshape(-1, 2)
    slope, sign = np.full(count, 2 * rng.uniform(0.1, 0.9)), rng.choice([0.0, 0.0, 1.0, -1.0], count)
    return Apex(compliance, velocity, np.tile(SPRINGS, (count, 1, 1)), slope, sign, np.zeros(count, bool))


@given(st.floats(-1, 1), st.floats(-1, 1), st.sampled_from([0.0, 1.0, -1.0]))
def test_cells_are_disjoint_and_cover_the_plane(normal, along, sign):
    apex = single(np.eye(2), [0, 0])._replace(sign=np.array([sign]))
    velocity, now = np.array([[normal, along]]), np.zeros(1, int)
    status = status_of_velocity(apex, velocity, now)[0]
    if sign == 0 and normal > 0:
        assert status == OPENS
    elif sign >= 0 and 1.2 * normal + along > 0:
        assert status == SLIDES
    elif sign <= 0 and 1.2 * normal - along > 0:
        assert status == SLIDES_BACK
    else:
        assert status == STICKS


def test_a_contact_in_stiff_surroundings_follows_its_push():
    for load, status in (([-1, 0], STICKS), ([1, 0.3], OPENS), ([-0.1, 1], SLIDES), ([-0.1, -1], SLIDES_BACK)):
        answer, coherent = consistent_statuses(single(np.eye(2), load))
        assert coherent
        assert answer.tolist() == [[status]]


@given(st.integers(0, 100_000))
@settings(max_examples=100)
def test_one_to_one_where_all_pieces_are_stable_and_found_wherever_there_is_one(seed):
    apex = drawn(seed)
    every, coherent = consistent_statuses(apex)
    if coherent:
        assert len(every) == 1
        assert follow_pieces(apex).status.tolist() == every[0].tolist()
    solution = statuses_at_apex(apex)
    assert (solution.status is None) == (len(every) == 0)
    if solution.status is not None:
        assert solution.status.tolist() in every.tolist()


@given(st.integers(0, 100_000))
@settings(max_examples=50)
def test_all_choices_together_against_one_by_one(seed):
    """Each choice solved and looked at by itself, without the stacked algebra of `every_choice`."""
    apex = drawn(seed)
    results = []
    for choice in itertools.product(*apex.allowed):
        status = np.array(choice)
        matrix = room.piece_matrix(apex, status)
        if np.linalg.cond(matrix) > 1e8:
            assume(False)  # near a boundary round-off decides
        velocity = np.linalg.solve(matrix, apex.velocity.ravel()).reshape(-1, 2)
        if np.array_equal(status_of_velocity(apex, velocity, status, 1e-9 * np.abs(velocity).max()), status):
            results.append((np.linalg.det(matrix) < 0, choice))
    every = room.enumerate_statuses(apex)
    assert sorted(map(tuple, every.status.tolist())) == sorted(choice for _, choice in results)
    assert every.stable.tolist() == sorted(every.stable.tolist(), reverse=True)
    assert every.stable.sum() == sum(not unstable for unstable, _ in results)
    assert every.decided


def test_without_stability_statuses_are_consistent_together_or_not_at_all():
    assert set(counterexample()) == {"sticks", "slides back", "opens"}
    number = [len(consistent_statuses(drawn(seed))[0]) for seed in range(400)]
    assert 0 in number
    assert max(number) > 1


def test_too_many_choices_are_refused():
    many = Apex(np.eye(14), np.zeros((7, 2)), np.tile(SPRINGS, (7, 1, 1)), np.ones(7), np.zeros(7), np.zeros(7, bool))
    with pytest.raises(ValueError, match=r"7 contacts have 1.64e\+04 combinations .* at most 4096"):
        consistent_statuses(many)


@pytest.mark.parametrize("seed", range(4))
def test_reduced_map_of_a_packing_against_the_whole_stiffness(seed):
    """Velocities by the small map, and by a dense solution with the k of the statuses that it found."""
    m, rng = jammed_disks(seed)
    contacts = rng.choice(m.count, 3, replace=False)
    sign = np.array([0.0, 0.0, m.sign[contacts[2]]])
    load = rng.normal(size=len(m.free))
    small = reduce_to_contacts(m, load, contacts, sign, geometric=False)
    for status in ([OPENS, SLIDES, STICKS], [SLIDES_BACK, STICKS, STICKS], [STICKS, OPENS, STICKS]):
        status = np.array(status)
        velocity = room._velocity(small.apex, status)
        v = small.velocities(StatusSolution(status, velocity, ""))
        slides = np.zeros(m.count, bool)
        slides[contacts] = np.isin(status, [SLIDES, SLIDES_BACK])
        side = np.where(status == SLIDES_BACK, -1.0, 1.0)
        turned = m._replace(sign=m.sign.copy(), springs=m.springs.copy())
        turned.sign[contacts[slides[contacts]]] = side[slides[contacts]]
        turned.springs[contacts[status == OPENS]] = 0.0
        k = stiffness_matrix(turned, slides, geometric=False)
        np.testing.assert_allclose(_without_translation(k @ v, m), _without_translation(load, m), atol=1e-9)
        relative = (m.c.T @ v).reshape(-1, 2)[contacts]
        np.testing.assert_allclose(relative, velocity, atol=1e-9 * np.abs(velocity).max())
    assert statuses(m, slides).shape == (m.count, 2, 2)


def _without_translation(force, m):
    """Forces without their sums along x and y, which the held coordinates take."""
    out = force.copy()
    for axis in range(2):
        out[np.flatnonzero(m.free.axis == axis)[0]] = 0.0
    return out


def chain(gap):
    """A disk between two walls that are pushed together (gap < 0) or pulled apart: two contacts, nothing else."""
    grains = ss.disks([[0, 0.5]], 0.5)
    walls = ss.flat_walls([[0, 1e-9], [0, 1 - 1e-9]], [[0, 1], [0, -1]])
    law = ss.laws.linear(1.0, 0.5, 0.4, coulomb="sharp")
    state = ss.assembly(grains, walls, ss.box(dim=2), ss.control.loads(1, 2))
    free = state.control.free.copy()
    free[2, 1] = True
    state = state._replace(control=state.control._replace(free=free))
    state = ss.accept(state, ss.forces(state, law)[1])
    m = linear_system(state, law)
    load = np.zeros(len(m.free))
    load[(m.free.body == 2) & (m.free.axis == 1)] = gap
    return m, load


def test_a_disk_without_forces_is_released_as_a_body_or_carries():
    pressed = decide_statuses(*chain(-1.0), np.ones(2, bool), geometric=False)
    assert pressed.status.tolist() == [STICKS, STICKS]
    assert pressed.stable
    pulled = decide_statuses(*chain(1.0), np.ones(2, bool), geometric=False)
    assert pulled.status is None  # nothing holds the lid
    assert pressed.others == ()


def test_a_velocity_on_the_boundary_of_cells_counts_once():
    """V_n = 0 at one contact: stick, slide and open meet there, and lead to the same velocities."""
    counts = []
    for seed in range(300):
        apex = drawn(seed)
        status = statuses_at_apex(apex).status
        if status is None or not consistent_statuses(apex)[1]:
            continue
        at = room._velocity(apex, status)
        at[0, 0] = 0.0
        here = status_of_velocity(apex, at, status)
        moved = apex._replace(velocity=(room.piece_matrix(apex, here) @ at.ravel()).reshape(-1, 2))
        counts.append(len(consistent_statuses(moved)[0]))
    assert len(counts) > 100
    assert set(counts) == {1}
