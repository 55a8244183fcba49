"""Rigid clusters of disks and spheres against brute-force ranks and lattices with known answers."""

import time

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.state import SLIDE, STICK
from stickslip.quasirigid import rigid_clusters
from stickslip.wings.status.rigidity import PebbleGame

LAW = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4)
BOTH = ("null-space", "pebbles")


def packing(places, dim=2, sliding=0.0, seed=0, radius=0.5, cell=None):
    """Grains that touch with a given share of sliding contacts; distances are those of touching grains, less 1 %."""
    places, rng = 0.99 * np.asarray(places, float), np.random.default_rng(seed)
    cell = None if cell is None else 0.99 * np.asarray(cell, float)
    state = ss.packings.from_arrays(places, np.broadcast_to(radius, len(places)), LAW, dim=dim, cell=cell)
    slide = (rng.random(len(state.contacts.mode)) < sliding) & (state.contacts.mode == STICK)
    mode = np.where(slide, SLIDE, state.contacts.mode).astype(np.int8)
    return state._replace(contacts=state.contacts._replace(mode=mode))


def triangular(n, m):
    return [(x + 0.5 * (y % 2), y * 0.75**0.5) for y in range(m) for x in range(n)]


def square(n):
    return [(x, y) for y in range(n) for x in range(n)]


def in_contact(count, dim, rng):
    """Grains of unequal radii, each put in touch with dim + 1 or fewer earlier ones; overlaps of up to 2 %."""
    place, radius = [np.zeros(dim)], [0.5]
    while len(place) < count:
        r, mates = rng.uniform(0.4, 0.6), rng.integers(0, len(place), dim)
        x = np.mean([place[k] for k in mates], axis=0) + rng.normal(size=dim)
        for _ in range(40):
            for k in mates:
                apart = x - place[k]
                x = place[k] + apart / np.linalg.norm(apart) * (radius[k] + r) * 0.99
        gaps = np.linalg.norm(np.array(place) - x, axis=1) - np.array(radius) - r
        if gaps.min() > -0.02:
            place.append(x)
            radius.append(r)
    return np.array(place) / 0.99, np.array(radius)


def brute_force(state, clusters):
    """Rank, rigid pairs of bodies and stressed contacts from dense matrices, built from positions; nothing is held."""
    grains, rows, n = state.grains, clusters.rows, len(state.grains.radius)
    dim, spins = state.cell.dim, [2] if state.cell.dim == 2 else [0, 1, 2]
    wide, lines, owner = dim + len(spins), [], []
    for k, row in enumerate(rows):
        i, j = state.contacts.i[row], state.contacts.j[row]
        r = grains.position[i] - grains.position[j]
        point = grains.position[j] + r * grains.radius[j] / (grains.radius[i] + grains.radius[j])
        normal = r / np.linalg.norm(r)
        across = np.linalg.svd(normal[None, :dim])[2][1:]
        axes = [normal[:dim]] if clusters.sliding[k] else [normal[:dim], *across]
        for axis in axes:
            full, line = np.append(axis, np.zeros(3 - dim)), np.zeros((n, wide))
            for body, sign in ((i, 1), (j, -1)):
                line[body, :dim] = sign * axis
                line[body, dim:] = sign * np.cross(point - grains.position[body], full)[spins]
            lines.append(line.ravel())
            owner.append(k)
    left, values, right = np.linalg.svd(np.array(lines))
    rank = np.count_nonzero(values > 1e-9)
    motion = right[rank:].reshape(-1, n, wide)
    spin = np.zeros((len(motion), n, 3))
    spin[..., spins] = motion[..., dim:]
    velocity = motion[..., :dim] - np.cross(spin, grains.position)[..., :dim]  # of the origin as a point of the body
    twist = np.concatenate([velocity, spin], axis=2)
    same = (np.abs(twist[:, :, None] - twist[:, None]) < 1e-8).all(axis=(0, 3))
    stressed = np.bincount(owner, (np.abs(left[:, rank:]) > 1e-8).any(axis=1), len(rows)) > 0
    return rank, same, stressed


def test_the_game_is_right_on_random_networks_of_bodies_and_bars():
    rng, alike = np.random.default_rng(0), 0
    for _ in range(300):
        n, m = int(rng.integers(2, 9)), int(rng.integers(1, 26))
        bars = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(m)]
        a = np.zeros((m, n, 3))
        for k, ends in enumerate(bars):
            a[k, ends, :] = np.outer([1, -1], rng.normal(size=3))
        left, values, right = np.linalg.svd(a.reshape(m, -1))
        rank = np.count_nonzero(values > 1e-9)
        motion = right[rank:].reshape(-1, n, 3)
        game = PebbleGame(n, bars)
        assert m - len(game.redundant) == rank
        assert game.stressed() == set(np.flatnonzero((np.abs(left[:, rank:]) > 1e-8).any(axis=1)).tolist())
        same = (np.abs(motion[:, :, None] - motion[:, None]) < 1e-8).all(axis=(0, 3))
        block = np.array([game.block(body) for body in range(n)])
        assert np.array_equal(same, block[:, None] == block)
        alike += 1 < same.sum() - n < n * n - n
    assert alike > 50  # networks with clusters and hinges


@pytest.mark.parametrize("dim", [2, 3])
def test_the_null_space_is_that_of_dense_matrices(dim):
    rng = np.random.default_rng(dim)
    hinges, generic = 0, 0
    for seed in range(25):
        places, radius = in_contact(int(rng.integers(3, 14)), dim, rng)
        state = packing(places, dim, sliding=rng.choice([0.0, 0.2, 0.5]), seed=seed, radius=radius)
        clusters = rigid_clusters(state, LAW)
        rank, same, stressed = brute_force(state, clusters)
        assert clusters.constraints - clusters.redundant == rank
        together = (clusters.body[:, None] == clusters.body) & (clusters.body >= 0)
        assert np.array_equal(same, together | np.eye(len(same), dtype=bool))
        assert np.array_equal(clusters.overconstrained, stressed)
        hinges += (clusters.contact < 0).any() and (clusters.contact >= 0).any()
        if dim == 2:
            game = rigid_clusters(state, LAW, method="pebbles")
            generic += np.array_equal(game.contact < 0, clusters.contact < 0) and game.floppy == clusters.floppy
    assert hinges > 5
    assert dim == 3 or generic > 15


@pytest.mark.parametrize("method", BOTH)
def test_a_triangular_lattice_that_sticks_is_one_cluster(method):
    clusters = rigid_clusters(packing(triangular(6, 5)), LAW, method=method)
    assert clusters.sizes.tolist() == [30]
    assert clusters.floppy == 3
    assert clusters.redundant == 2 * len(clusters.rows) - 3 * 30 + 3
    assert clusters.overconstrained.all()
    assert (clusters.contact == 0).all()


def test_disks_that_slide_everywhere_spin_freely_which_the_game_does_not_see():
    state = packing(triangular(6, 5), sliding=1.0)
    exact, game = (rigid_clusters(state, LAW, method=method) for method in BOTH)
    assert exact.floppy == 30 + 3  # spins, and a rigid lattice of centres
    assert not len(exact.sizes)
    assert game.floppy == 90 - len(game.rows)
    assert not game.redundant


def test_disks_of_a_square_lattice_counter_rotate_which_the_game_does_not_see():
    exact, game = (rigid_clusters(packing(square(5)), LAW, method=method) for method in BOTH)
    assert exact.floppy == game.floppy + 1 == 4
    assert not len(exact.sizes)
    assert game.sizes.tolist() == [25]
    slides = packing(square(5), sliding=1.0)
    assert [rigid_clusters(slides, LAW, method=method).floppy for method in BOTH] == [75 - 40] * 2


@pytest.mark.parametrize("method", BOTH)
def test_rings_of_a_honeycomb_lattice_bend(method):
    """A ring of six disks has 18 coordinates and 12 constraints; no contact of an isolated ring is rigid."""
    ring = [(np.cos(k * np.pi / 3), np.sin(k * np.pi / 3)) for k in range(6)]
    clusters = rigid_clusters(packing(ring), LAW, method=method)
    assert clusters.floppy == 6
    assert (clusters.contact == -1).all()
    assert clusters.body.tolist() == [-1] * 6


def test_a_cluster_around_a_periodic_cell_does_not_rotate_which_the_game_does_not_see():
    cell = np.diag([6, 6 * 0.75**0.5, 1])
    exact, game = (rigid_clusters(packing(triangular(6, 6), cell=cell), LAW, method=method) for method in BOTH)
    assert (exact.floppy, game.floppy) == (2, 3)
    assert exact.sizes.tolist() == game.sizes.tolist() == [36]


@pytest.mark.parametrize("method", BOTH)
def test_walls_groups_and_fixed_bodies_are_bodies(method):
    state, law = ss.packings.biaxial_box(20, seed=3)
    free = rigid_clusters(state, law, method=method)
    loose = np.count_nonzero(free.body[:20] < 0)
    assert (free.body[20:] == 0).all()
    assert free.floppy == 3 * loose  # the floor and one side are fixed
    held = state._replace(control=ss.control.fixed(state.control, range(20, 24)))
    assert rigid_clusters(held, law, method=method).floppy == 3 * loose
    places = triangular(3, 2)
    alone = packing([(x, y + 3) for x, y in places] + [(0, 0), (1, 0)])
    glued = alone._replace(control=ss.control.rigid(alone.control, [6, 0]))
    assert rigid_clusters(glued, LAW, method=method).floppy == 2 + 1  # the whole translates, disk 7 rolls on disk 6
    fixed = alone._replace(control=ss.control.fixed(alone.control, [0, 1, 6]))
    clusters = rigid_clusters(fixed, LAW, method=method)
    assert clusters.body.tolist() == [0] * 7 + [-1]
    assert clusters.floppy == 1
    still = alone._replace(control=ss.control.fixed(alone.control, range(8)))
    clusters = rigid_clusters(still, LAW, method=method)
    assert (clusters.sizes.tolist(), clusters.floppy) == ([8], 0)
    assert clusters.redundant == clusters.constraints
    assert clusters.overconstrained.all()


def test_spheres_roll_about_the_line_through_two_contacts():
    corners = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]]) / 2**0.5
    assert rigid_clusters(packing(corners, 3), LAW).floppy == 6
    clusters = rigid_clusters(packing(corners[:3], 3), LAW)
    assert clusters.floppy == 18 - 9
    assert (clusters.contact == -1).all()


def test_thousands_of_disks_take_seconds():
    rng = np.random.default_rng(0)
    places = np.array(triangular(60, 66))[rng.random(3960) < 0.91]
    state = packing(places, sliding=0.3)
    for method in BOTH:
        start = time.process_time()
        clusters = rigid_clusters(state, LAW, method=method)
        assert time.process_time() - start < 3
        assert clusters.sizes[0] > 0.95 * len(places)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"state": packing([(0, 0), (3, 0)])}, "the packing has no contacts"),
        ({"law": ss.laws.linear(kn=1.0, kt=0.5, mu=0.0)}, "rigid clusters need friction"),
        ({"state": packing([(0, 0, 0), (1, 0, 0)], 3), "method": "pebbles"}, "is valid for disks only"),
        ({"method": "peebles"}, "method"),
    ],
)
def test_bad_input_gets_one_sentence(change, message):
    given = {"state": packing(triangular(3, 2)), "law": LAW} | change
    with pytest.raises(ValueError, match=message) as error:
        rigid_clusters(**given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_figure_tells_hinges_from_clusters(dim):
    places = [(0, 0), (1, 0), (0.5, 0.75**0.5), (2, 0)]
    if dim == 3:
        places = [(*place, 0) for place in places]
    state = packing(places, dim)
    clusters = rigid_clusters(state, LAW)
    axes = ss.figures.quasi_rigid.rigid_clusters(state, clusters).axes[0]
    drawn = [len(lines.get_segments()) for lines in axes.collections if lines.get_zorder() in (60, 61)]
    assert drawn == ([3, 1] if dim == 2 else [0, 4])
    with pytest.raises(ValueError, match="clusters"):
        ss.figures.quasi_rigid.rigid_clusters(packing(triangular(3, 2)), clusters)
