"""Load paths of cemented packings: closed forms, Newton's method in small steps, and slow dynamics."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.bonding import broken_since
from stickslip.core.control import between
from stickslip.core.laws.builtin import with_values
from stickslip.loading.compression import TOP, biaxial_box, with_load
from stickslip.quasirigid import contact_status, linear_system, load_path
from stickslip.wings.status.increment import CROWD, Increment, unbalanced_force
from stickslip.wings.status.matrices import loose_grains
from stickslip.wings.status.path import _balancing_control, _place
from stickslip.wings.status.status import Verdict
from stickslip.wings.status.system import rolling_motions
from tests.wings.status.five_packings import spheres

LAW = ss.laws.linear(1.0, 0.5, 0.4, coulomb="sharp")
UNBREAKABLE = ss.laws.beam_bond(2.0, 1.0, 0.3, 0.3)


def beam(tension, shear=1.0, bending=1.0, *, stiffness=2.0):
    strength = (tension, shear, bending, 1.0)
    return ss.laws.beam_bond(stiffness, 1.0, 0.3, 0.3, strength=strength, smooth=False)


def committed(state, law=LAW):
    return ss.accept(state, ss.forces(state, law)[1])


def row(*bonds, walls=None):
    """Disks in a row with gaps of 0.1, joined by bonds (None: not joined), the first of them fixed."""
    count = len(bonds) + 1
    control = ss.control.loads(count, 0 if walls is None else len(walls.mass))
    control.free[0] = False
    state = ss.assembly(ss.disks(np.outer(np.arange(count), [1.1, 0.0]), 0.5), walls, ss.box(dim=2), control)
    for k, bond in enumerate(bonds):
        state = state if bond is None else ss.packings.bonded(state, bond, pairs=[[k, k + 1]])
    return committed(state)


def pulled(control, body, force):
    out = control._replace(force=control.force.copy())
    out.force[body, : len(force)] = force
    return out


def breaks(path):
    return [(e.load, e.kind, e.i, e.j) for e in path.events if e.kind.startswith("bond breaks")]


@pytest.mark.parametrize(
    ("force", "bond", "mode"),
    [
        ((2e-3, 0), beam(1e-3), "tension"),
        ((-2e-3, 0), beam(1.0, 1.0, 1.0), None),
        ((0, 2e-3), beam(1, 1e-3, 1), "shear"),
    ],
)
def test_two_grains_break_at_the_strength_of_their_bond(force, bond, mode):
    state = row(bond)
    path = load_path(state, LAW, pulled(state.control, 1, force), increment=0.25)
    if mode is None:
        assert path.complete and not breaks(path)
        return
    ((load, kind, i, j),) = breaks(path)
    assert (kind, i, j) == (f"bond breaks by {mode}", 0, 1)
    if mode == "tension":
        assert load == pytest.approx(0.5, abs=1e-9)
        assert path.states[-1].grains.position[1, 0] - 1.1 == pytest.approx(1e-3 / 2, rel=1e-9)
    else:
        assert load == pytest.approx(1 / (2 * (1 + 1e-3 * 0.55)), rel=1e-3)  # bending by half the length
    assert path.verdict is Verdict.MECHANISM  # nothing holds the grain any more
    assert "1 bond broke" in path.summary


def test_the_load_of_a_broken_bond_is_passed_on():
    """Springs of 2 and 1 side by side, of which the stiffer breaks when it carries 1e-3: at half the load of 3e-3."""
    state = row(beam(1e-3), beam(1.0, stiffness=1.0))
    state.control.free[2] = False
    path = load_path(state, LAW, pulled(state.control, 1, (3e-3,)), increment=0.25)
    assert path.complete
    assert breaks(path) == [(pytest.approx(0.5, abs=1e-9), "bond breaks by tension", 0, 1)]
    at = np.array([state.grains.position[1, 0] - 1.1 for state in path.states])
    before = path.load <= 0.5 + 1e-9
    before[np.flatnonzero(before)[-1]] = False  # the load is the same before and after
    np.testing.assert_allclose(at[before], path.load[before] * 1e-3, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(at[~before], path.load[~before] * 3e-3, rtol=1e-9)
    assert max(point.residual for point in path.points) < 1e-9


def test_further_bonds_break_as_the_load_of_the_first_is_passed_on():
    """Each of two bonds carries half of a force across; after the first breaks, the second would carry all of it."""
    state = row(beam(1, 1e-3), beam(1, 1.2e-3))
    state.control.free[2] = False
    path = load_path(state, LAW, pulled(state.control, 1, (0, 3e-3)), increment=0.25)
    assert [e[0] for e in breaks(path)] == pytest.approx([2 / 3, 2 / 3], rel=1e-5)  # the bonds stretch a little, too
    assert [e[1:] for e in breaks(path)] == [("bond breaks by shear", 0, 1), ("bond breaks by shear", 1, 2)]
    assert path.verdict is Verdict.MECHANISM


def test_with_drag_dynamics_goes_on_after_the_break():
    """The grain flies into a corner of two walls, which hold it."""
    normals = np.array([[-1, 1], [-1, -1]]) / np.sqrt(2)
    state = row(beam(1e-3), walls=ss.flat_walls(np.array([1.3, 0]) - 0.5 * normals, normals))
    end = pulled(state.control, 1, (2e-3,))
    path = load_path(state, LAW, end, increment=0.25, drag=0.3)
    assert path.complete, path.summary
    assert len(breaks(path)) == 1 and len(path.collapses) == 1
    # between F/(k_n + k_t) beyond the corner, if it sticks to both walls, and F/k_n, if it slides along them
    assert 1.3 + 2e-3 / 1.5 < path.states[-1].grains.position[1, 0] < 1.3 + 2e-3
    assert path.points[-1].residual < 1e-9


def test_a_grain_on_a_bond_and_a_wall_opens_and_closes_once():
    """One bond holds a grain, so that it does not become a rattler when the wall no longer touches it."""
    state = row(UNBREAKABLE, walls=ss.flat_walls([[0, -0.499]], [[0, 1]]))
    state = ss.equilibrate(state, LAW)[0]
    legs = [pulled(state.control, 1, (0, force)) for force in (5e-3, -5e-3)]
    path = load_path(state, LAW, *legs, increment=0.1)
    assert path.complete
    kinds = [e.kind for e in path.events]
    assert (kinds.count("opens"), kinds.count("closes")) == (1, 1)
    end = ss.equilibrate(state._replace(control=legs[0]), LAW)[0]
    here = next(p.state for p in path.points if p.load == 1)
    np.testing.assert_allclose(here.grains.position, end.grains.position, atol=1e-13)
    assert max(point.residual for point in path.points) < 1e-6  # over a mean force that passes zero


def test_grains_that_a_bond_joins_are_rattlers_together_and_carry_load_together():
    """A pair between two columns below a lid, which touches it only under a large load."""
    radius = np.array([0.5, 0.499, 0.499, 0.5])
    control = ss.control.loads(4, 2)
    control.free[5, 1], control.force[5, 1] = True, -2e-3
    at = np.stack([[0, 2, 3.02, 5], [0.5, 0.499, 0.499, 0.5]], axis=1)
    walls = ss.flat_walls([[0, 0.0005], [0, 0.9995]], [[0, 1], [0, -1]])
    state = ss.packings.bonded(
        ss.assembly(ss.disks(at, radius), walls, ss.box(dim=2), control), UNBREAKABLE, within=0.1
    )
    state = ss.equilibrate(committed(state), LAW)[0]
    assert loose_grains(state).tolist() == [False, True, True, False]
    legs = [pulled(control, 5, (0, -force)) for force in (1e-2, 1e-3, 1e-2)]
    path = load_path(state, LAW, *legs, increment=0.2)
    assert path.complete
    for number, (height, loose) in enumerate(((0.9945, False), (0.9995, True), (0.9945, False)), 1):
        here = [p.state for p in path.points if p.load == number][-1]
        # 4 or 2 springs of k_n = 1 on each side; the pair is lower by 2e-3 in all
        assert here.walls.point[1, 1] == pytest.approx(height, abs=1e-9)
        assert loose_grains(here)[1] == loose
        assert loose_grains(here)[2] == loose


def cemented(seed, n=30, strength=2e-4):
    """A box of cemented disks whose strengths scatter."""
    state, law = biaxial_box(n, seed=seed)
    state = ss.packings.bonded(state, ss.laws.parallel_bond(0.5, 0.2, strength, 2 * strength), within=0.02)
    bonds, factor = state.bonds, np.exp(0.3 * np.random.default_rng(seed).normal(size=len(state.bonds.i)))
    strengths = np.where(bonds.strength < 1e300, bonds.strength * factor[:, None], bonds.strength)
    return committed(state._replace(bonds=bonds._replace(strength=strengths)), law), law


def shift(here, start):
    return here.walls.point[TOP, 1] - start.walls.point[TOP, 1]


def steps_of_newton(state, law, end, step, until):
    """Breaks in steps of `equilibrate`, each with the load at the end of its step, and the last state."""
    here, out = state, []
    for load in np.arange(1, round(until / step) + 1) * step:
        after, outcome = ss.equilibrate(here._replace(control=between(state.control, end, load)), law, check="nothing")
        assert outcome.ok
        out += [(load, *ends) for ends in broken_since(after, here)[:, :2].tolist()]
        here = after
    return out, here


def test_increments_of_unbreakable_bonds_agree_with_newton():
    """Without sliding, to the accuracy of the balance."""
    state, law = biaxial_box(20, seed=1)
    law = with_values(law, mu=5.0)
    state = committed(ss.packings.bonded(state, UNBREAKABLE, within=0.02), law)
    end = with_load(state.control, 20 + TOP, 1.2)
    path = load_path(state, law, end, increment=0.25)
    assert path.complete and not path.events
    for point in path.points:
        here = ss.equilibrate(state._replace(control=between(state.control, end, point.load)), law)[0]
        moved = np.abs(here.grains.position - state.grains.position).max()
        assert np.abs(here.grains.position - point.state.grains.position).max() <= 1e-6 * moved + 1e-12


def test_bonds_of_a_box_break_at_the_loads_of_small_steps():
    state, law = cemented(3, n=12)
    end = with_load(state.control, 12 + TOP, 3.0)
    path = load_path(state, law, end, increment=0.1)
    assert path.complete
    agree_with_newton(path, state, law, end, 0.02, 1.0)


def before_avalanche(path):
    """Breaks until three bonds break at once; then inertia may break more bonds than a quasi-static path."""
    load, count = np.unique([load for load, *_ in breaks(path)], return_counts=True)
    return [one for one in breaks(path) if one[0] < min(load[count >= 3], default=np.inf)]


def agree_with_newton(path, state, law, end, step, until):
    reached = path.points[-1].load * until
    early = before_avalanche(path)
    mine = [(load * until, i, j) for load, _, i, j in early if load * until < reached - step or path.complete]
    found, here = steps_of_newton(state, law, end, step, np.floor(reached / step) * step)
    assert mine
    for load in sorted({load for load, *_ in mine}):
        theirs = {(i, j) for at, i, j in found if load <= at <= load + 1.01 * step}
        assert {(i, j) for at, i, j in mine if at == load} <= theirs
    if path.complete and len(mine) == len(breaks(path)):
        assert len(found) == len(mine)
        assert shift(here, state) == pytest.approx(shift(path.states[-1], state), rel=0.03)


UNTIL = 0.6


@cache
def boxes():
    """Three boxes of which two bonds or more break. Which boxes these are depends on the last bits of packings."""
    found = []
    for seed in range(1, 100):
        state, law = cemented(seed)
        end = with_load(state.control, 30 + TOP, 3.0)
        path = load_path(state, law, between(state.control, end, UNTIL), increment=0.05)
        if path.complete and len(before_avalanche(path)) >= 2:
            found.append((state, law, end, path))
        if len(found) == 3:
            return found
    raise AssertionError("bonds of three boxes should break")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_bonds_of_boxes_break_at_the_loads_of_small_steps(number):
    state, law, end, path = boxes()[number]
    agree_with_newton(path, state, law, end, 0.002, UNTIL)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(2))
def test_slow_dynamics_break_the_same_bonds_at_the_same_loads(number):
    state, law, end, path = boxes()[number]
    here, found, off, steps = state, [], [], 200
    for load in np.arange(1, steps + 1) * UNTIL / steps:
        after, _, outcome = ss.run(here._replace(control=between(state.control, end, load)), law, 1500, 0.2, drag=0.05)
        assert outcome.ok
        found += [(load, i, j) for i, j, _ in broken_since(after, here).tolist()]
        off.append(shift(after, state) / np.interp(load, UNTIL * path.load, [shift(s, state) for s in path.states]) - 1)
        here = after
    mine = {(i, j): UNTIL * load for load, _, i, j in before_avalanche(path)}
    found = found[: len(mine)]
    assert sorted((i, j) for _, i, j in found) == sorted(mine)
    assert [at for at, *_ in found] == pytest.approx([mine[i, j] for _, i, j in found], abs=2 * UNTIL / steps)
    assert np.median(np.abs(off)) < 3e-3


def test_broken_bonds_change_nothing():
    state, law = biaxial_box(20, seed=1)
    bonded = committed(ss.packings.bonded(state, UNBREAKABLE, within=0.0), law)
    broken = bonded._replace(bonds=bonded.bonds._replace(intact=np.zeros(len(bonded.bonds.i), bool)))
    end = with_load(state.control, 20 + TOP, 1.2)
    with_bonds, without = (load_path(s, law, end, increment=0.1) for s in (broken, committed(state, law)))
    assert [e.kind for e in with_bonds.events] == [e.kind for e in without.events]
    there, here = (path.states[-1].grains.position for path in (with_bonds, without))
    np.testing.assert_allclose(there, here, atol=1e-9)


def test_cemented_spheres_agree_with_newton():
    state, law, end = cemented_spheres()
    path = load_path(state, law, end, increment=0.25)
    assert path.complete
    here = ss.equilibrate(state._replace(control=end), law)[0]
    moved, off = (here.grains.position - s.grains.position for s in (state, path.states[-1]))
    # but for a translation
    assert np.ptp(off[~loose_grains(state)], axis=0).max() < 1e-6 * np.abs(moved).max()


def cemented_spheres():
    state, law, _ = spheres("sheared", 1)
    state = committed(ss.packings.bonded(state, UNBREAKABLE, within=0.0), law)
    control = ss.control.stress_controlled(state.control, ss.measure.stress(state, law))
    stress = control.stress.copy()
    stress[2, 2] *= 1.01
    return state._replace(control=control), law, control._replace(stress=stress)


def test_bonds_that_a_path_cannot_follow_are_refused_in_one_sentence():
    state = row(ss.laws.beam_bond(1.0, 1.0, 0.3, 0.3, strength=(1, 1, 1, 1)))
    with pytest.raises(ValueError, match=r"bonds that fade .* smooth=False"):
        load_path(state, LAW, pulled(state.control, 1, (1e-3,)))
    state = row(ss.laws.spring_bond(1.0))
    with pytest.raises(
        ValueError, match=r"bonds on a load path must resist shear, bending .* use beam_bond or parallel_bond"
    ):
        load_path(state, LAW, pulled(state.control, 1, (1e-3,)))


def test_a_load_of_zero_moves_nothing():
    """All forces are zero, so that they are compared to no load and no mean force."""
    state = row(beam(1e-3))
    path = load_path(state, LAW, state.control, increment=0.5)
    assert path.complete and not path.events
    np.testing.assert_array_equal(path.states[-1].grains.position, state.grains.position)
    assert path.points[-1].residual == 0.0


def test_a_load_on_a_rattler_alone_is_refused_in_one_sentence():
    state = row(beam(1e-3), None)
    with pytest.raises(ValueError, match="body 2 is loaded but is a rattler"):
        load_path(state, LAW, pulled(state.control, 2, (1e-3,)))


def test_the_residual_of_a_pure_torque_is_over_the_load():
    """No normal force is exerted."""
    state = row(UNBREAKABLE)
    torque = state.control.torque.copy()
    torque[1, 2] = 1e-4
    path = load_path(state, LAW, state.control._replace(torque=torque), increment=1.0)
    assert path.complete and path.points[-1].residual < 1e-9


@pytest.fixture(scope="module")
def bridge():
    """Two spheres on a tilted bond, with a gap between them, that touch a floor and a lid."""
    at = np.array([[0, 0, 0.499], [0.66, 0, 1.379]])
    control = ss.control.loads(2, 2)
    control.free[3, 2], control.force[3, 2] = True, -1e-3
    walls = ss.flat_walls([[0, 0, 0], [0, 0, 1.878]], [[0, 0, 1], [0, 0, -1]])
    state = ss.packings.bonded(
        ss.assembly(ss.spheres(at, 0.5), walls, ss.box(dim=3), control), UNBREAKABLE, pairs=[[0, 1]]
    )
    return ss.equilibrate(committed(state), LAW)[0]


def test_spheres_that_a_bond_joins_roll_about_their_two_contacts(bridge):
    """Nothing resists the motion, which a force along the line through the contacts does not drive."""
    path = load_path(bridge, LAW, pulled(bridge.control, 3, (0, 0, -2e-3)), increment=1.0)
    assert path.complete
    with pytest.raises(ValueError, match="unbalanced torque on spheres 0 to 1, which bonds join, about their two cont"):
        load_path(bridge, LAW, pulled(bridge.control, 1, (0, 1e-5, 0)))


@pytest.mark.parametrize("bonds", ["rigid", "elastic"])
def test_a_force_that_makes_spheres_roll_has_no_status(bridge, bonds):
    matrix = linear_system(bridge, LAW, bonds=bonds)
    (motion,) = rolling_motions(matrix)
    assert np.abs(matrix.c.T @ motion).max() < 1e-12
    load = np.zeros(len(matrix.free))
    load[-1] = -1.0
    assert contact_status(matrix, load).ok
    load[(matrix.free.body == 1) & (matrix.free.axis == 1)] = 1.0
    assert contact_status(matrix, load).verdict is Verdict.MECHANISM


def test_a_torque_on_a_sphere_that_spins_between_its_contacts_is_refused_in_one_sentence():
    control = ss.control.loads(1, 2)
    walls = ss.flat_walls([[0, 0, 0], [0, 0, 0.998]], [[0, 0, 1], [0, 0, -1]])
    state = committed(ss.assembly(ss.spheres([[0, 0, 0.499]], 0.5), walls, ss.box(dim=3), control))
    torque = control.torque.copy()
    torque[0, 2] = 1e-6
    with pytest.raises(ValueError, match="unbalanced torque on sphere 0 about its two contacts"):
        load_path(state, LAW, control._replace(torque=torque))


def test_a_path_ends_where_it_crawls(monkeypatch):
    """Every part of an increment is made short, although the load rises by more than PROGRESS in each."""
    monkeypatch.setattr(Increment, "run", lambda self, start: (self.place, 5e-5, Verdict.CONSISTENT))
    state = row(UNBREAKABLE)
    path = load_path(state, LAW, pulled(state.control, 1, (1e-3,)), increment=1.0)
    assert path.verdict is Verdict.NO_PROGRESS
    assert len(path.points) == CROWD + 2


def chains(strengths):
    """Two rows of three bonded disks around a cell that is free along them; bonds of stiffness 2 and 1."""
    across = np.arange(3)[:, None] * [1.1, 0.0]
    cell = ss.box([3.3, 4.0, 1.0], (True, True, False), 2)
    state = ss.assembly(ss.disks(np.vstack([across, np.add(across, [0.0, 2.0])]), 0.5), None, cell)
    for strength, pair in zip(strengths, ([0, 1], [1, 2], [0, 2]), strict=True):
        state = ss.packings.bonded(state, beam(strength), pairs=[pair])
    state = committed(ss.packings.bonded(state, beam(1.0, stiffness=1.0), pairs=[[3, 4], [4, 5], [3, 5]]))
    control = ss.control.stress_controlled(state.control, np.zeros((3, 3)))
    free = np.zeros((3, 3), bool)
    free[0, 0] = True
    return state._replace(control=control._replace(cell_free=free))


@pytest.mark.parametrize("strengths", [(1e-5, 2e-5, 3e-5), (1e-5, 1e-5, 1e-5)])
def test_one_bond_of_a_row_around_the_cell_breaks_and_the_others_lose_their_load(strengths):
    """The stiffer row bears 2/3 of a force of 4e-5, and breaks at 1e-5; the other one then bears all of it."""
    state = chains(strengths)
    stress = state.control.stress.copy()
    stress[0, 0] = -1e-5
    path = load_path(state, LAW, state.control._replace(stress=stress), increment=0.5)
    assert path.complete
    ((load, kind, *_),) = breaks(path)
    assert (load, kind) == (pytest.approx(0.375, rel=1e-5), "bond breaks by tension")
    end = path.states[-1]
    assert loose_grains(end).tolist() == [True] * 3 + [False] * 3
    assert end.cell.vectors[0, 0] - 3.3 == pytest.approx(3 * 4e-5, rel=1e-8)
    assert ss.measure.stress(end, LAW)[0, 0] == pytest.approx(-1e-5, rel=1e-8)
    np.testing.assert_allclose(ss.measure.bond_shares(end), [0.0] * 3 + [4e-5] * 3, atol=1e-8)


@pytest.mark.parametrize("around", [False, True])
def test_forces_torques_and_stresses_replace_the_loads_of_a_broken_bond(around):
    """In a row that is bent, and in one around a cell that is strained."""
    if around:
        state = chains((1.0, 1.0, 1.0))
        state = state._replace(cell=state.cell._replace(vectors=state.cell.vectors * [[1.001], [1.0], [1.0]]))
    else:
        state = row(UNBREAKABLE, UNBREAKABLE)
        state.control.free[2] = False
        state.grains.angle[1, 2], state.grains.position[1, 1] = 1e-3, 2e-3
    state = committed(state)
    broken = state._replace(bonds=state.bonds._replace(intact=np.arange(len(state.bonds.i)) > 0))
    free = ss.freedom(state)
    place = _place(broken)._replace(loose=np.zeros(len(state.grains.radius), bool))
    before = unbalanced_force(place, LAW, free)
    assert np.abs(before).max() > 1e-4
    held = place._replace(state=broken._replace(control=_balancing_control(place, LAW)))
    assert np.abs(unbalanced_force(held, LAW, free)).max() < 1e-12


def test_a_bond_breaks_at_its_load_after_a_contact_began_to_slide_in_the_same_increment():
    """A grain on a bond and on a floor, along which it slides: the bond bears the force without 0.4 times 1e-3."""
    state = row(beam(3e-3), walls=ss.flat_walls([[0, -0.499]], [[0, 1]]))
    state.control.free[1, 1:] = False
    path = load_path(state, LAW, pulled(state.control, 1, (4e-3, 0)), increment=1.0)
    assert [e.kind for e in path.events[:2]] == ["reaches the cone", "bond breaks by tension"]
    assert path.events[1].load == pytest.approx((3e-3 + 0.4e-3) / 4e-3, rel=1e-9)


def test_spheres_that_touch_within_a_cluster_spin_about_its_two_contacts():
    at, walls = (
        np.array([[0, 0, 0.499], [0, 0, 1.497]]),
        ss.flat_walls([[0, 0, 0], [0, 0, 1.996]], [[0, 0, 1], [0, 0, -1]]),
    )
    state = ss.assembly(ss.spheres(at, 0.5), walls, ss.box(dim=3), ss.control.loads(2, 2))
    matrix = linear_system(committed(ss.packings.bonded(state, UNBREAKABLE, pairs=[[0, 1]])), LAW)
    assert matrix.count == 3
    (motion,) = rolling_motions(matrix)
    np.testing.assert_allclose(np.abs(motion), (matrix.free.axis == 5) / np.sqrt(2), atol=1e-12)
