"""Jammed packings, affine strain, cells described in another way."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.measure import branch_vectors, coordination, packing_fraction, pressure, rattlers, stress, touching
from stickslip.loading import packing
from stickslip.loading.packing import frictionless, jammed, reduced_cell, shear_strain, sheared, strained
from tests.conftest import make_law, make_packing, stirred


@pytest.mark.parametrize("dim", [2, 3])
def test_a_packing_has_the_wanted_fraction_and_balanced_forces(dim):
    wanted = {2: 0.86, 3: 0.68}[dim]
    state, report = jammed(40, packing_fraction=wanted, dim=dim, seed=3)
    volume = np.pi * state.grains.radius**2 if dim == 2 else 4 / 3 * np.pi * state.grains.radius**3
    assert volume.sum() / np.prod(np.diag(state.cell.vectors)[:dim]) == pytest.approx(wanted, rel=1e-12)
    assert report.packing_fraction == pytest.approx(wanted, rel=1e-12)
    assert report.residual <= 5e-14
    assert report.pressure > 0
    assert report.contacts == len(touching(state))
    # jammed without friction: at least isostatic, one contact more than degrees of freedom
    held = 40 - report.rattlers
    assert report.contacts >= dim * (held - 1) + 1
    assert report.coordination == pytest.approx(2 * report.contacts / held)
    assert sorted(set(state.grains.radius)) == [0.5, 0.7]
    assert (state.grains.radius == 0.5).sum() == 20


def test_a_packing_is_the_same_for_the_same_seed():
    a, b, c = (jammed(30, packing_fraction=0.68, seed=s)[0].grains.position for s in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_a_packing_reaches_a_wanted_pressure():
    state, report = jammed(40, pressure=2e-3, seed=0)
    assert report.pressure == pytest.approx(2e-3, rel=1e-6)
    assert pressure(state, frictionless(ss.laws.hertz_mindlin())) == pytest.approx(2e-3, rel=1e-6)


def test_a_large_packing_is_quenched_by_fire_to_the_same_tolerance():
    first, again = (jammed(2000, packing_fraction=0.88, dim=2, seed=5) for _ in range(2))
    assert np.array_equal(first[0].grains.position, again[0].grains.position)
    state, report = first
    assert report.residual <= 5e-14
    assert ss.measure.residual(state, frictionless(ss.laws.hertz_mindlin()))[0] == report.residual
    assert report.contacts >= 2 * (2000 - report.rattlers - 1) + 1
    assert report.packing_fraction == pytest.approx(0.88, rel=1e-12)
    assert report.pressure == pytest.approx(jammed(300, packing_fraction=0.88, dim=2)[1].pressure, rel=0.3)


@pytest.mark.parametrize("many", [1, 1000])
def test_grains_of_very_different_sizes_balance_to_the_round_off_of_the_largest(many, monkeypatch):
    monkeypatch.setattr(packing, "MANY", many)  # by FIRE, and by L-BFGS-B
    state, info = jammed(120, packing_fraction=0.85, radius=0.5 * np.geomspace(1.0, 50.0, 120))
    side, stiffness = state.cell.vectors[0, 0], 1.5 * info.largest_overlap**0.5  # of a contact
    assert info.residual < 0.5 * np.finfo(float).eps * side * 30 * stiffness  # a grain has less than 30 contacts


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either packing_fraction or pressure"),
        ({"packing_fraction": 0.68, "pressure": 1e-3}, "give either packing_fraction or pressure"),
        ({"packing_fraction": 0.4}, "do not jam"),
        ({"packing_fraction": -1.0}, "must be positive"),
        ({"packing_fraction": 0.68, "radius": (0.5, -0.7)}, "positive numbers"),
        ({"packing_fraction": 0.68, "radius": [5.0] + [0.5] * 19}, "use more grains"),
    ],
)
def test_an_impossible_packing_gives_a_one_sentence_error(options, message):
    with pytest.raises(ValueError, match=message):
        jammed(20, **options)


def test_stress_of_one_contact_is_force_times_branch_over_volume():
    grains = ss.spheres([[0, 0, 0], [0.9, 0, 0]], 0.5)
    state = ss.assembly(grains, cell=ss.box([5.0, 4.0, 3.0], [True] * 3))
    law = ss.laws.linear(kn=2.0)
    _, trial = ss.forces(state, law)
    tensor = stress(ss.accept(with_neighbor_list(state), trial), law)
    assert tensor[0, 0] == pytest.approx(2.0 * 0.1 * 0.9 / 60)  # compression is positive
    assert np.abs(tensor).sum() == pytest.approx(tensor[0, 0])
    assert packing_fraction(state) == pytest.approx(2 * 4 / 3 * np.pi * 0.125 / 60)


def test_rattlers_are_found_through_each_other():
    """A triangle holds itself; a chain of two hangs on it: the end is loose, then its neighbour."""
    position = [[0, 0], [0.99, 0], [0.495, 0.85], [-0.9, -0.3], [-1.8, -0.6]]
    state = ss.assembly(ss.disks(position, 0.5), cell=ss.box(dim=2))
    _, trial = ss.forces(state, ss.laws.linear())
    state = ss.accept(with_neighbor_list(state), trial)
    assert len(touching(state)) == 5
    assert rattlers(state).tolist() == [False] * 3 + [True] * 2
    assert coordination(state) == 2.0 and coordination(state, 3) == 0


def test_what_a_load_a_spring_or_a_fixed_body_holds_is_no_rattler():
    """Disks 0 and 1 stand apart on a floor; 2 touches 1 and nothing else; 3 touches nothing."""
    law = ss.laws.linear()
    place = [[0, 0.495], [3, 0.495], [3.7, 1.19], [9, 5]]
    state = ss.assembly(ss.disks(place, 0.5), ss.flat_walls([0, 0], [0, 1]), ss.box(dim=2))
    state = ss.accept(with_neighbor_list(state), ss.forces(state, law)[1])
    assert len(touching(state)) == 3 and rattlers(state).all() and coordination(state) == 0

    def loose(control=state.control, **changes):
        held = state._replace(control=control._replace(**changes))
        _, record, _ = ss.run(held, law, 1, 1e-9, every=1)
        assert record.rattlers[0] == rattlers(held).sum()
        assert record.held_coordination[0] == pytest.approx(coordination(held))
        return rattlers(held).tolist()

    down = np.array([0.0, -1e-3, 0.0])
    assert loose(gravity=down) == [False, False, False, True]
    force = np.zeros((5, 3))
    force[0] = down
    assert loose(force=force) == [False, True, True, True]
    force[2] = down  # presses on disk 1, which then has two contacts
    assert loose(force=force) == [False, False, False, True]
    free = state.control.free.copy()
    free[2] = False
    assert loose(free=free) == [True, False, False, True]
    free[3] = False
    assert loose(free=free)[3] is False
    spring = np.zeros((5, 3))
    spring[2, 1] = 1.0
    assert loose(spring=spring) == [True, False, False, True]
    double, single = (
        ss.control.rigid(state.control, members) for members in ([0, 1, 2], [1, 2])
    )  # contacts with the floor
    assert loose(double) == [False, False, False, True] and loose(single) == [True] * 4


def test_affine_strain_moves_grains_and_cell_alike():
    state = jammed(20, packing_fraction=0.68)[0]
    gradient = np.array([[0.01, 0.2, 0], [0, -0.02, 0.1], [0, 0, 0.03]])
    moved = strained(state, gradient)
    deformation = np.eye(3) + gradient
    np.testing.assert_allclose(moved.grains.position, state.grains.position @ deformation.T)
    np.testing.assert_allclose(branch_vectors(moved), branch_vectors(state) @ deformation.T, atol=1e-14)
    assert shear_strain(sheared(state, 0.07)) == pytest.approx(0.07)


@pytest.mark.parametrize("slip", [True, False])
def test_the_affine_displacement_enters_the_slip_if_wanted(slip):
    state = jammed(30, packing_fraction=0.7, seed=1)[0]
    law = ss.laws.hertz_mindlin(mu=10.0)
    moved = sheared(state, 1e-4, slip=slip)
    loads, trial = ss.forces(moved, law)
    rows = np.flatnonzero(trial.mode[: trial.count[0]] == ss.STICK)
    after = branch_vectors(ss.accept(with_neighbor_list(moved), trial))[rows]
    normal = after / np.linalg.norm(after, axis=1)[:, None]
    affine = np.zeros_like(after)
    affine[:, 0] = 1e-4 * after[:, 1]  # displacement of i relative to j: simple shear leaves y as it is
    wanted = affine - np.einsum("ck,ck->c", affine, normal)[:, None] * normal if slip else 0 * affine
    # contacts turn on the way, by the strain
    np.testing.assert_allclose(trial.slip[rows], wanted, rtol=0, atol=1e-14 + 1e-4 * np.abs(wanted).max())
    assert (np.abs(loads.torque).max() > 1e-8) == slip  # else round-off


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(6))
def test_a_cell_described_by_shorter_vectors_is_the_same_packing(dim, seed):
    law = make_law("hertz_mindlin", "smooth")
    state = stirred(make_packing(dim, seed, wall=False), law, np.random.default_rng(seed))
    skew = np.eye(3)
    skew[0, 0 if dim == 2 else 1] += 0 if dim == 2 else 2.3
    state = strained(state, skew - np.eye(3), slip=False)
    loads, trial = ss.forces(state, law)
    state = ss.accept(with_neighbor_list(state), trial)
    shorter = reduced_cell(state)
    again, new = ss.forces(shorter, law)
    assert np.linalg.norm(shorter.cell.vectors) <= np.linalg.norm(state.cell.vectors)
    np.testing.assert_allclose(again.force, loads.force, atol=1e-13)
    np.testing.assert_allclose(again.torque, loads.torque, atol=1e-13)
    fresh = with_neighbor_list(shorter._replace(contacts=shorter.contacts._replace(stale=True)))
    assert np.array_equal(fresh.contacts.key[: fresh.contacts.count[0]], new.key[: new.count[0]])


@pytest.mark.parametrize(
    ("gradient", "message"), [(np.eye(4), "shape"), ([[0, 0, 1], [0, 0, 0], [0, 0, 0]], "z components")]
)
def test_an_impossible_strain_gives_a_one_sentence_error(gradient, message):
    state = jammed(20, packing_fraction=0.86, dim=2)[0]
    with pytest.raises(ValueError, match=message):
        strained(state, gradient)


def test_walls_cannot_be_strained():
    with pytest.raises(ValueError, match="walls"):
        sheared(ss.packings.disk_array(3, press=1e-4), 0.1)
