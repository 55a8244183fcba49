"""Closed forms, slow twins and small facts about the core."""

import itertools

import numpy as np
import pytest

import stickslip as ss
from stickslip.builtin_laws import BUILTIN_LAWS, NAMES
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.laws import builtin as laws
from stickslip.core.laws.compiled import evaluate
from stickslip.data.sample import LAWS
from tests.conftest import make_law, make_packing, stirred


def test_disk_on_a_wall_sinks_as_hertz_says():
    state = ss.packings.disk_array(1, press=5e-5, gap=0.5)
    state, outcome = ss.relax(state, ss.laws.for_pair(ss.laws.hertz_mindlin(), 0, 1))
    assert outcome.ok
    assert 0.5 - state.grains.position[0, 1] == pytest.approx((5e-5) ** (2 / 3), rel=1e-9)


def disk_that_cannot_turn():
    """One disk pressed by 0.01 on a wall of friction 0.4, at rest: a mass on a spring of 0.5 that slides at 0.004."""
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.4), 0, 1)
    state = ss.packings.disk_array(1, press=0.01, gap=0.5)
    free = state.control.free.copy()
    free[:, 3:] = False
    state, _ = ss.relax(state._replace(control=state.control._replace(free=free)), law, drag=0.5)
    return state, law


def test_pushed_disk_that_cannot_turn_slips_by_force_over_stiffness_then_slides():
    state, law = disk_that_cannot_turn()
    at_rest, outcome = ss.relax(ss.packings.with_push(state, 0.002), law, drag=0.5)
    assert outcome.ok
    assert at_rest.grains.position[0, 0] - state.grains.position[0, 0] == pytest.approx(0.002 / 0.5, rel=1e-9)
    beyond, outcome = ss.relax(ss.packings.with_push(state, 0.0041), law, drag=0.5, steps=4000)
    assert not outcome.ok  # the Coulomb limit is 0.004
    assert beyond.grains.velocity[0, 0] == pytest.approx((0.0041 - 0.004) / 0.5, rel=1e-3)  # terminal: force over drag


@pytest.mark.parametrize("kind", range(5), ids=NAMES[:5])
def test_scalars_of_every_built_in_law_are_those_of_its_entry(kind):
    r_eff, power = 0.25, BUILTIN_LAWS[kind].exponent
    root = np.sqrt(r_eff) if BUILTIN_LAWS[kind].uses_radius else 1.0
    law = LAWS[NAMES[kind]](2.0, 0.6)
    assert law.kind == kind and laws.rescales(law) == BUILTIN_LAWS[kind].rescales
    overlap = np.array([1e-8, 1e-3, 0.2])
    force, energy, slopes = evaluate(law, "force", "energy", "slopes", overlap=overlap, r_eff=r_eff)
    np.testing.assert_allclose(force, root * 2.0 * overlap**power, rtol=1e-15)
    np.testing.assert_allclose(energy, root * 2.0 * overlap ** (power + 1) / (power + 1), rtol=1e-15)
    expected = root * 2.0 * power * overlap ** (power - 1), root * 0.6 * (power - 1) * overlap ** (power - 2)
    np.testing.assert_allclose(slopes, np.stack(expected, axis=1), rtol=1e-15)


def scattered(dim, seed):
    """Grains at random in a sheared cell, some boxes away from home, periodic along random axes, between walls."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    vectors = np.diag(rng.uniform(1.5, 6.0, 3)) + np.triu(rng.uniform(-2.0, 2.0, (3, 3)), 1).T
    if dim == 2:
        vectors[2] = 0, 0, 1
        vectors[:, 2] = 0, 0, 1
    periodic = rng.random(3) < 0.7
    periodic[2] &= dim == 3
    position = rng.uniform(0, 1, (n, 3)) @ vectors + rng.integers(-2, 3, (n, 3)) * periodic @ vectors
    position[:, dim:] = 0
    walls = ss.flat_walls([[0, position[:, 1].min(), 0]], [[0, 1, 0]]) if seed % 2 else ss.flat_walls()
    grains = ss.spheres(position, rng.uniform(0.2, 0.7, n))
    return ss.assembly(grains, walls, ss.box(vectors, periodic, dim))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("make", [make_packing, scattered])
def test_candidate_pairs_equal_a_slow_twin(make, dim):
    for seed in range(6):  # many more kinds of radii are in test_neighbors.py
        check_candidate_pairs(with_neighbor_list(make(dim, seed)))


def check_candidate_pairs(state):
    x = np.concatenate([state.grains.position, state.walls.point])
    n, skin, pairs = len(state.grains.radius), state.contacts.skin, set()
    span = [range(-9, 10) if p else (0,) for p in state.cell.periodic]
    images = np.array(list(itertools.product(*span)))
    offset = images @ state.cell.vectors
    for i, j in itertools.combinations_with_replacement(range(n), 2):
        reach = state.grains.radius[i] + state.grains.radius[j] + skin
        for image in images[np.linalg.norm(x[i] - x[j] + offset, axis=1) < reach]:
            if i < j or tuple(image) > (0, 0, 0):
                pairs.add((i, j, tuple(int(m) for m in image)))
    for i, w in itertools.product(range(n), range(len(state.walls.mass))):
        if (x[i] - state.walls.point[w]) @ state.walls.normal[w] < state.grains.radius[i] + skin:
            pairs.add((i, n + w, (0, 0, 0)))
    c = state.contacts
    listed = [(int(c.i[k]), int(c.j[k]), tuple(int(m) for m in c.image[k])) for k in range(c.count[0])]
    assert listed == sorted(pairs)
    assert (np.diff(c.key[: c.count[0]]) > 0).all()


def test_two_disks_touch_through_two_images():
    state = ss.packings.disk_array(2, press=5e-5, gap=-0.01)
    loads, trial = ss.forces(state, ss.laws.for_pair(ss.laws.hertz_mindlin(), 0, 1))
    pairs = trial.j[: trial.count[0]] < 2
    assert pairs.sum() == 2
    assert sorted(trial.image[: trial.count[0], 0][pairs]) == [0, 1]
    assert np.abs(loads.force[:2, 0]).max() < 1e-17  # pressed from both sides alike


@pytest.mark.parametrize("height", [1e-300, 2.2e-309, 5e-324])
def test_grains_in_a_row_may_differ_by_the_smallest_numbers(height):
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        state = ss.assembly(ss.spheres([[0, 0, 0], [0.98, height, 0]], 0.5), skin=0.5)
        loads, _ = ss.forces(state, ss.laws.linear(1.0, 0.8, 0.5))
    assert loads.force[1, 0] == pytest.approx(0.02)


def test_one_disk_that_touches_its_own_image_is_pressed_but_not_moved():
    state = ss.packings.disk_array(1, press=5e-5, gap=-0.01)
    loads, trial = ss.forces(state, ss.laws.for_pair(ss.laws.hertz_mindlin(), 0, 1))
    assert (trial.mode[: trial.count[0]] > 0).sum() == 1
    assert loads.force[0, 0] == 0


def test_memory_survives_a_rebuild():
    law = make_law("hertz_mindlin", "sharp")
    state = stirred(make_packing(3, 2), law, np.random.default_rng(0))
    bigger = state.contacts._replace(stale=True, skin=0.6)
    rebuilt = with_neighbor_list(state._replace(contacts=bigger))
    assert rebuilt.contacts.count[0] > state.contacts.count[0]
    before, after = ss.forces(state, law), ss.forces(rebuilt, law)
    assert np.array_equal(before[0].force, after[0].force)


def test_wall_friction_may_differ():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=0.5), 0, 1, mu=0.1)
    assert law.table[0, 1, laws.MU] == law.table[1, 0, laws.MU] == 0.1
    assert law.table[0, 0, laws.MU] == 0.5


def test_unlike_disks_start_in_touch():
    state = ss.packings.disk_array(3, [0.5, 0.3, 0.4], press=1e-5)
    x, r = state.grains.position, state.grains.radius
    ring = np.vstack([x, x[:1] + state.cell.vectors[0]])
    np.testing.assert_allclose(np.linalg.norm(np.diff(ring, axis=0), axis=1), r + np.roll(r, -1), rtol=1e-14)


def test_nan_is_not_an_equilibrium():
    state = ss.assembly(ss.disks([[0, 0], [0, 0], [5, 0]], 0.5), cell=ss.box(dim=2))
    with np.errstate(all="ignore"):
        for _, outcome in (ss.relax(state, ss.laws.linear()), ss.newton(state, ss.laws.linear())):
            assert outcome.status is ss.Status.NOT_A_NUMBER


def test_jacobian_refuses_contacts_that_were_never_committed():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(), 0, 1)
    with pytest.raises(ValueError, match="equilibrate, or accept"):
        ss.spectrum(ss.packings.disk_array(3, press=5e-5, gap=-0.01), law)


def test_newton_leaves_alone_what_nothing_resists():
    """Without friction the rotations, and a disk that touches nothing, have no stiffness."""
    grains = ss.disks([[0, 0.499], [5, 3.0]], 0.5)
    control = ss.control.loads(2, 1, force=[[0, -1e-3, 0], [0, 0, 0]])
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2), control)
    free = state.control.free.copy()
    free[0, 0] = False  # nothing holds the disk along the wall
    state = state._replace(control=state.control._replace(free=free))
    end, outcome = ss.newton(state, ss.laws.linear(mu=0.0))
    assert outcome.ok, outcome
    assert end.grains.position[0, 1] == pytest.approx(0.499, rel=1e-12)
    pulled = state._replace(control=ss.control.loads(2, 1, force=[[0, -1e-3, 0], [1e-3, 0, 0]]))
    assert ss.newton(pulled, ss.laws.linear(mu=0.0))[1].status is ss.Status.SINGULAR


def test_an_equilibrium_forgets_which_contacts_were_at_the_limit_on_the_way():
    state, law = disk_that_cannot_turn()
    overshot, outcome = ss.relax(ss.packings.with_push(state, 0.003), law, drag=0.05)
    assert outcome.ok
    assert not overshot.contacts.reached.any()
    _, record, _ = ss.run(ss.packings.with_push(overshot, 0.01), law, 1000, 0.1, events=True)
    assert "limit" in record.events["kind"]


@pytest.mark.parametrize("solve", [ss.newton, lambda *at: ss.equilibrate(*at, check="nothing")])
def test_an_equilibrium_found_at_once_forgets_it_too(solve):
    """What slid in a run and sticks where a solver brings it has not reached the limit; what slides there has."""
    state, law = disk_that_cannot_turn()
    slid, _, _ = ss.run(ss.packings.with_push(state, 0.0045), law, 400, 0.1, drag=0.5)
    assert slid.contacts.reached.any()
    back, outcome = solve(ss.packings.with_push(slid, 0.0035), law)
    assert outcome.ok
    count = int(back.contacts.count[0])
    assert back.contacts.mode[:count].tolist() == [ss.STICK]
    assert not back.contacts.reached.any()
    smooth = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.0), 0, 1)
    free = state.control.free.copy()
    free[0, 0] = False  # nothing holds it along the wall
    end, outcome = solve(state._replace(control=state.control._replace(free=free)), smooth)
    assert outcome.ok
    assert end.contacts.mode[0] == ss.SLIDE
    assert not end.contacts.reached.any()  # without friction there is no limit


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ss.laws.hertz_mindlin(mu=-0.1), "mu must be finite and not negative, got -0.1"),
        (lambda: ss.laws.hertz_mindlin(kn=float("nan")), "kn must be finite and positive, got nan"),
        (lambda: ss.laws.hertz_mindlin(coulomb="soft"), "'sharp' or 'smooth'"),
        (lambda: ss.laws.for_pair(ss.laws.linear(), 0, 1, nu=0.3), "no parameter 'nu'"),
        (lambda: ss.assembly(ss.disks([[0, 0]], -1.0)), r"grains\.radius\[0\] is -1: it must be positive"),
        (lambda: ss.assembly(ss.disks([[0, np.nan]], 1.0)), "NaN"),
        (lambda: ss.assembly(ss.disks([[0, 0], [1, 0]], [0.5, 0.5, 0.5])), "shape"),
        (lambda: ss.assembly(ss.disks([[0, 0]], 1.0), cell=ss.box(dim=4)), r"dim is 4: it must be between 2 and 3"),
        (lambda: ss.flat_walls([0, 0, 0], [0, 0, 0]), "the normal of a wall has zero length"),
        (lambda: ss.run(ss.packings.disk_array(1, press=1e-5), ss.laws.linear(), 1, 0.1), "material 1 is used"),
        (lambda: ss.run(ss.assembly(ss.disks([[0, 0]], 1.0)), ss.laws.linear(), 1, -0.1), "dt must be positive"),
        (lambda: ss.assembly(ss.disks([[0, 0]], 1.0), cell=ss.box([10, 5])), r"cell\.vectors has shape \(2, 2\)"),
        (lambda: ss.run(ss.assembly(ss.disks([[0, 0]], 1.0)), ss.laws.linear(), 1, 0.1, probes=[9]), "from 0 to 0"),
        (
            lambda: ss.run(ss.assembly(ss.disks([[0, 0]], 1.0)), ss.laws.linear(), 1, 0.1, reference=np.zeros((2, 3))),
            "shape",
        ),
        (
            lambda: ss.run(ss.assembly(ss.disks([[0, 0]], 1.0)), ss.laws.linear(), 1, 0.1, tolerance=1.0),
            "requires drag",
        ),
        (
            lambda: ss.forces(ss.assembly(ss.disks([[0, 0]], 1.0, material=-1)), ss.laws.linear()),
            r"material\[0\] is -1",
        ),
        (lambda: ss.nonsense, "no attribute 'nonsense'"),
    ],
)
def test_bad_input_is_one_clear_sentence(make, message):
    with pytest.raises((ValueError, AttributeError), match=message):
        make()


@pytest.mark.parametrize("kind", [-1, 9, 99])
def test_an_unknown_kind_of_law_is_refused(kind):
    state, law = make_packing(2), make_law("hertz_mindlin", "sharp")._replace(kind=kind)
    for call in (lambda: ss.forces(state, law), lambda: ss.run(state, law, 1, 1e-3)):
        with pytest.raises(ValueError, match=f"built-in laws have kinds 0 to 8, got {kind}"):
            call()
    with pytest.raises(ValueError, match="built-in laws have kinds 0 to 8"):
        ss.laws.collision(law._replace(table=law.table[:1, :1]), radius=1.0, mass=1.0, speed=1e-3)
