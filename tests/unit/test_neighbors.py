"""Neighbour search: grains of very different sizes, limits, and what a rebuild keeps."""

import itertools

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import body_positions, body_radii, grid_of, needs_rebuild, rebuild_list
from stickslip.core.state import empty_contacts

RADII = {
    "equal": lambda rng, n: np.full(n, 0.1),
    "narrow": lambda rng, n: rng.uniform(0.08, 0.12, n),
    "ratio 10": lambda rng, n: 0.04 * np.exp(rng.uniform(0, np.log(10), n)),
    "ratio 50": lambda rng, n: 0.01 * np.exp(rng.uniform(0, np.log(50), n)),
    "two sizes": lambda rng, n: np.where(rng.random(n) < 0.1, 0.5, 0.03),
    "one large": lambda rng, n: np.append(np.full(n - 1, 0.04), 0.4),
    "one wider than the cell": lambda rng, n: np.append(np.full(n - 1, 0.04), 1.5),
    "one small": lambda rng, n: np.append(np.full(n - 1, 0.2), 0.004),
    "ratio 1e6": lambda rng, n: 0.5 * np.exp(rng.uniform(-np.log(1e6), 0, n)),
}


def sample(radii, dim, seed):
    """Grains in a sheared cell of size 2, some boxes away from home, periodic along random axes, and walls."""
    rng, n = np.random.default_rng(seed), 60
    vectors = np.diag(rng.uniform(1.5, 2.5, 3)) + np.triu(rng.uniform(-0.5, 0.5, (3, 3)), 1).T
    if dim == 2:
        vectors[2] = vectors[:, 2] = 0, 0, 1
    periodic = (rng.random(3) < 0.7) & (np.arange(3) < dim)
    x = (rng.uniform(0, 1, (n, 3)) + rng.integers(-1, 2, (n, 3)) * periodic) @ vectors
    x[:, dim:] = 0
    order = rng.permutation(n)  # numbers do not follow sizes
    normals = np.array([[0, 1, 0], [-0.8, 0.6, 0]])
    walls = ss.flat_walls([x[np.argmin(x @ normal)] for normal in normals], normals)
    return ss.assembly(ss.spheres(x, RADII[radii](rng, n)[order]), walls, ss.box(vectors, periodic, dim), skin=0.02)


def pairs_within_range(state):
    """All pairs closer than the skin, by comparing everything with everything."""
    x, radius, n, pairs = body_positions(state), body_radii(state), len(state.grains.radius), set()
    reach = radius[:n, None] + radius[:n] + state.contacts.skin
    for image in itertools.product(*(range(-5, 6) if periodic else (0,) for periodic in state.cell.periodic)):
        apart = x[:n, None] - x[:n] + np.array(image) @ state.cell.vectors
        for i, j in np.argwhere((apart**2).sum(axis=2) < reach**2):
            if i < j or (i == j and image > (0, 0, 0)):
                pairs.add((int(i), int(j), image))
    for w in range(n, len(x)):
        gap = (x[:n] - x[w]) @ state.walls.normal[w - n] - radius[:n]
        pairs |= {(int(i), w, (0, 0, 0)) for i in np.flatnonzero(gap < state.contacts.skin)}
    return sorted(pairs)


def rebuilt(state, threads=1, **changes):
    old = state.contacts._replace(**changes)
    return rebuild_list(body_positions(state), body_radii(state), state.walls.normal, grid_of(state.cell), old, threads)


def listed(contacts):
    return list(zip(contacts.i.tolist(), contacts.j.tolist(), map(tuple, contacts.image.tolist()), strict=True))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("radii", RADII)
def test_pairs_equal_a_comparison_of_everything_with_everything(radii, dim):
    for seed in range(3):
        state = sample(radii, dim, seed)
        contacts = rebuilt(state)
        assert listed(contacts) == pairs_within_range(state)
        assert (np.diff(contacts.key) > 0).all()
        assert np.array_equal(rebuilt(state, threads=3).key, contacts.key)


@pytest.mark.parametrize("threads", [1, 3])
def test_memory_of_every_closed_contact_survives_and_rolling_memory_also_of_open_ones(threads):
    state, rng = sample("ratio 10", 3, 0), np.random.default_rng(0)
    old = rebuilt(state, rolling=np.zeros((0, 7)))
    shape = (len(old.i), 3)
    old = old._replace(
        mode=rng.integers(0, 3, len(old.i)).astype(np.int8), reached=rng.random(len(old.i)) < 0.5,
        slip=rng.normal(size=shape), pair=rng.normal(size=shape), roll=rng.normal(size=shape),
        rolling=rng.normal(size=(len(old.i), 7)),
    )  # fmt: skip
    new = rebuilt(state._replace(contacts=old), threads, skin=0.01)
    kept = np.searchsorted(old.key, new.key)
    assert 0 < len(new.key) < len(old.key) and (old.key[kept] == new.key).all()
    closed = old.mode[kept] > 0
    for name in ("mode", "reached", "slip", "pair", "roll"):
        before = getattr(old, name)[kept].copy()
        before[~closed] = 0
        assert np.array_equal(getattr(new, name), before), name
    assert np.array_equal(new.rolling, old.rolling[kept])


def test_a_position_that_is_not_a_number_touches_nothing():
    state = sample("ratio 10", 3, 0)
    state.grains.position[5] = np.nan
    contacts = rebuilt(state)
    assert listed(contacts) == [pair for pair in pairs_within_range(state) if 5 not in pair[:2]]


def test_a_grain_that_moves_to_nowhere_needs_a_new_list():
    state = sample("ratio 10", 3, 0)
    contacts = rebuilt(state)
    position = state.grains.position.copy()
    assert not needs_rebuild(position, contacts)
    for nowhere in (np.nan, np.inf):
        position[5] = nowhere
        assert needs_rebuild(position, contacts)


@pytest.mark.parametrize("boxes, fits", [(63, True), (64, False), (-63, True), (-64, False)])
def test_images_have_seven_bits(boxes, fits):
    grains = ss.spheres([[0.0, 0.5, 0.5], [10.0 * boxes + 0.9, 0.5, 0.5]], [0.5, 0.1])
    state = ss.assembly(grains, cell=ss.box([10, 10, 10], (True,) * 3), skin=0.5)
    contacts = rebuilt(state)
    assert contacts.count[0] == (1 if fits else -1)
    if fits:
        assert contacts.image.tolist() == [[boxes, 0, 0]]


def test_a_box_much_narrower_than_a_grain_is_too_far():
    x = np.zeros((1, 3))
    grid = grid_of(ss.box([1e-6, 1, 1], (True, False, False)))
    contacts = rebuild_list(x, np.ones(1), np.zeros((0, 3)), grid, empty_contacts(1, 0, 0.1))
    assert contacts.count[0] == -1


def test_grains_that_approach_by_less_than_a_skin_each_are_found():
    grains = ss.disks([[0.0, 0.0], [1.11, 0.0]], 0.5)
    law = ss.laws.linear(kn=1.0)
    state = ss.accept(start := ss.assembly(grains, cell=ss.box(dim=2), skin=0.1), ss.forces(start, law)[1])
    assert state.contacts.count[0] == 0  # too far apart for the list
    state.grains.position[:, 0] = 0.08, 1.03
    assert ss.forces(state, law)[0].force[0, 0] == pytest.approx(-0.05)
