"""Contact status of cemented grains: rigid bonds as constraints, beside brute force and stiff elastic bonds."""

from itertools import product

import numpy as np
import pytest

import stickslip as ss
from stickslip import quasirigid

LAW = ss.laws.linear(kn=1.0, kt=0.5, mu=0.1)
SPRING, BEAM = ss.laws.spring_bond(1.0), ss.laws.beam_bond(1.0, 0.5, 0.2, 0.2)
CASES = [(2, SPRING), (2, BEAM), (3, SPRING), (3, BEAM)]


def sample(dim, bond):
    """A sheared packing, a few of whose contacts are bonded."""
    state, _ = ss.packings.jammed(14, packing_fraction=0.9 if dim == 2 else 0.72, dim=dim, law=LAW, seed=1)
    state, _ = ss.equilibrate(ss.packings.sheared(state, 5e-3), LAW, check="nothing")
    rows = ss.measure.touching(state)[:: 4 if dim == 2 else 9]
    pairs = np.stack([state.contacts.i[rows], state.contacts.j[rows]], axis=1)
    return ss.packings.bonded(state, bond, pairs=np.unique(pairs, axis=0))


def balanced_load(matrix, seed=0):
    load = np.random.default_rng(seed).normal(size=len(matrix.free))
    return without_mean(matrix, load)


def without_mean(matrix, vector):
    """The same vector without common translations."""
    out = vector.copy()
    for axis in range(matrix.free.dim):
        out[matrix.free.axis == axis] -= out[matrix.free.axis == axis].mean()
    return out


def brute_force(matrix, load, critical):
    """All consistent statuses of the critical contacts, with their velocities, in a null space of what is forbidden."""
    _, size, basis = np.linalg.svd(matrix.rigid.toarray())
    allowed = basis[(size > 1e-9).sum() :].T
    for choice in product([False, True], repeat=len(critical)):
        sliding = np.zeros(matrix.count, bool)
        sliding[critical] = choice
        k = allowed.T @ quasirigid.stiffness_matrix(matrix, sliding).toarray() @ allowed
        wanted = allowed.T @ load
        motion = np.linalg.lstsq(k, wanted, rcond=1e-11)[0]
        if np.abs(k @ motion - wanted).max() > 1e-8:  # k is singular for these statuses
            continue
        velocity = allowed @ motion
        relative = (matrix.c.T @ velocity).reshape(matrix.count, -1)[critical]
        rate = matrix.slope[critical] * relative[:, 0] + matrix.sign[critical] * relative[:, 1]
        if np.array_equal(rate > 0, choice):
            yield sliding, velocity


@pytest.mark.parametrize(("dim", "bond"), CASES)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_status_is_that_of_brute_force(dim, bond, seed):
    matrix = quasirigid.linear_system(sample(dim, bond), LAW)
    load = balanced_load(matrix, seed)
    critical = np.argsort(matrix.margin)[:5]  # the nearest to the Coulomb limit, as if they were at it
    found = quasirigid.contact_status(matrix, load, critical=critical)
    ((sliding, velocity),) = brute_force(matrix, load, critical)
    assert found.verdict is ss.results.Verdict.UNIQUE and np.array_equal(found.sliding, sliding)
    np.testing.assert_allclose(without_mean(matrix, found.velocity), without_mean(matrix, velocity), atol=1e-8)
    np.testing.assert_allclose(matrix.rigid @ found.velocity, 0, atol=1e-12)


@pytest.mark.parametrize(("dim", "bond"), CASES)
def test_stiff_elastic_bonds_approach_rigid_ones_as_one_over_their_stiffness(dim, bond):
    state, off = sample(dim, bond), []
    rigid = quasirigid.linear_system(state, LAW)
    load, critical = balanced_load(rigid), np.argsort(rigid.margin)[:3]
    wanted = quasirigid.contact_status(rigid, load, critical=critical)
    for stiffness in (1e5, 1e6):
        stiff = state._replace(bonds=state.bonds._replace(stiffness=stiffness * state.bonds.stiffness))
        elastic = quasirigid.linear_system(stiff, LAW, bonds="elastic")
        found = quasirigid.contact_status(elastic, load, critical=critical)
        assert np.array_equal(found.sliding, wanted.sliding)
        off.append(np.abs(without_mean(rigid, found.velocity - wanted.velocity)).max())
    assert off[1] < 0.12 * off[0] and off[1] < 2e-3 * np.abs(wanted.velocity).max()


@pytest.mark.parametrize(("dim", "bond"), CASES)
def test_the_stiffness_with_elastic_bonds_is_the_jacobian(dim, bond):
    """Also where bonds carry load: their forces turn with them."""
    state = sample(dim, bond)
    state, _ = ss.equilibrate(ss.packings.sheared(state, 1e-3), LAW, check="nothing")
    matrix = quasirigid.linear_system(state, LAW, bonds="elastic")
    stiffness = quasirigid.stiffness_matrix(matrix).toarray()
    wanted = -ss.jacobian(state, LAW, matrix.free).toarray()
    np.testing.assert_allclose(stiffness, wanted, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize(("dim", "bond"), CASES)
def test_forbidden_rates_are_those_of_the_deformations(dim, bond):
    """A small motion that is not forbidden loads no bond, to second order; others do."""
    state = sample(dim, bond)
    matrix = quasirigid.linear_system(state, LAW)
    _, size, basis = np.linalg.svd(matrix.rigid.toarray())
    rank = (size > 1e-9).sum()
    for rows, loads in ((basis[rank:], False), (basis[:rank], True)):
        way = np.random.default_rng(1).normal(size=len(rows)) @ rows
        moved = ss.modes.displaced(state, matrix.free, 1e-4 * way / np.abs(way).max())
        energy = ss.measure.elastic_energy(moved, LAW)
        energy -= ss.measure.elastic_energy(ss.packings.without_bonds(moved), LAW)
        assert (energy > 1e-10) == loads and (loads or energy < 1e-14)


def test_contacts_within_a_rigid_cluster_neither_slide_nor_open():
    state = sample(2, BEAM)
    matrix, elastic = (quasirigid.linear_system(state, LAW, bonds=how) for how in ("rigid", "elastic"))
    i, j = state.contacts.i[matrix.rows], state.contacts.j[matrix.rows]
    pairs = set(zip(state.bonds.i.tolist(), state.bonds.j.tolist(), strict=True))
    bonded = np.array([pair in pairs for pair in zip(i.tolist(), j.tolist(), strict=True)])
    mode = np.where(state.contacts.mode == ss.OPEN, ss.OPEN, ss.SLIDE).astype(np.int8)
    slides = state._replace(contacts=state.contacts._replace(mode=mode))
    limit = quasirigid.linear_system(slides, LAW).limit
    assert bonded.any() and not limit[bonded].any() and limit.any()
    assert matrix.count == elastic.count and matrix.rigid.shape[1] == len(matrix.free) and elastic.rigid is None


@pytest.mark.parametrize("around", [False, True])
def test_a_cluster_slides_at_its_own_image_unless_its_bonds_go_around_the_cell(around):
    """Where allowed motions move a contact; lever arms R in place of the distance add 0.02 times the rotation."""
    row = np.arange(3)[:, None] * [0.98, 0.0] + [0.3, 1.0]
    cell = ss.box([2.94, 1.7, 1.0], (True, True, False), 2)
    state = ss.assembly(ss.disks(np.vstack([row, row + np.array([0.49, 0.85])]), 0.5), cell=cell)
    state = ss.packings.bonded(state, BEAM, pairs=[[0, 1], [1, 2], *[[0, 2]] * around])
    state = ss.accept(state, ss.forces(state, LAW)[1])
    mode = np.where(state.contacts.mode == ss.OPEN, ss.OPEN, ss.SLIDE).astype(np.int8)
    matrix = quasirigid.linear_system(state._replace(contacts=state.contacts._replace(mode=mode)), LAW)
    _, size, basis = np.linalg.svd(matrix.rigid.toarray())
    moves = np.abs(matrix.c.T @ basis[(size > 1e-9).sum() :].T).reshape(matrix.count, -1).max(axis=1)
    np.testing.assert_array_equal(matrix.limit, moves > 0.02)
    assert (~matrix.limit).sum() == 2 + around


def test_a_broken_bond_forbids_nothing():
    state = sample(2, BEAM)
    intact = np.zeros(len(state.bonds.i), bool)
    bare = quasirigid.linear_system(ss.packings.without_bonds(state), LAW)
    broken = quasirigid.linear_system(state._replace(bonds=state.bonds._replace(intact=intact)), LAW)
    load = balanced_load(bare)
    np.testing.assert_allclose(
        quasirigid.contact_status(broken, load).velocity, quasirigid.contact_status(bare, load).velocity, atol=1e-12
    )
