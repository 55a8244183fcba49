"""Bonds: exact derivatives, balance of momentum, memory, failure, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stickslip as ss
from stickslip import kit
from stickslip.core.contacts.bonding import with_weakest_broken
from stickslip.core.contacts.bonds import add_bond_loads
from stickslip.core.contacts.forces import FREE, HELD, bodies
from stickslip.core.state import FAILURES
from tests.laws import bonds, bonds_lammps

LAW = ss.laws.hertz_mindlin(mu=0.3)
BONDS = {
    "spring": ss.laws.spring_bond(2.0, 0.5, damping=0.1),
    "stiff spring": ss.laws.spring_bond(2.0),
    "beam": ss.laws.beam_bond(2.0, 1.0, 0.3, 0.2, damping=(0.1, 0.2, 0.3, 0.4)),
    "fading beam": ss.laws.beam_bond(2.0, 1.0, 0.3, 0.2, strength=(1.0, 1.0, 1.0, 1.0), damping=(0.1, 0.2, 0.3, 0.4)),
    "parallel": ss.laws.parallel_bond(2.0, 1.0, 10.0, 10.0),
}


def cluster(dim, bond, seed=0, moved=True):
    """Four grains of different sizes, some across gaps, which have moved and turned since they were bonded."""
    place = np.array([[0, 0, 0], [1.05, 0.1, 0.2], [0.3, 1.0, 0.1], [1.2, 1.3, 0.3]])[:, :dim]
    radius = [0.5, 0.55, 0.45, 0.5]
    state = ss.packings.bonded(ss.assembly((ss.disks if dim == 2 else ss.spheres)(place, radius)), bond, within=0.4)
    rng = np.random.default_rng(seed)
    way, angle, velocity, spin = rng.normal(size=(4, 4, 3)) * [[[0.03]], [[0.2]], [[0.1]], [[0.3]]]
    if dim == 2:
        way[:, 2] = velocity[:, 2] = 0
        angle[:, :2] = spin[:, :2] = 0
    grains = state.grains._replace(velocity=velocity, spin=spin)
    if moved:
        grains = grains._replace(position=grains.position + way, angle=angle)
    return state._replace(grains=grains)


def loads(state):
    """Forces and torques over radii, in one row."""
    found, _ = ss.forces(state, LAW)
    return np.hstack([found.force, found.torque / state.grains.radius[:, None]]).ravel()


def differences(state, change, step=1e-6):
    """Derivatives of the loads by central differences of `change(q)`, a state for changes (4, 6) of coordinates."""
    columns = [(loads(change(q)) - loads(change(-q))) / (2 * step) for q in step * np.eye(24).reshape(24, 4, 6)]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("name", BONDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_derivatives_are_those_of_the_loads(dim, name):
    state = cluster(dim, BONDS[name])
    radius = state.grains.radius[:, None]

    def moved(q):
        grains = here.grains._replace(
            position=here.grains.position + q[:, :3], angle=here.grains.angle + q[:, 3:] / radius
        )
        return here._replace(grains=grains)

    def faster(q):
        return here._replace(grains=here.grains._replace(velocity=q[:, :3], spin=q[:, 3:] / radius))

    varied = np.flatnonzero(np.tile([1, 1, dim == 3, dim == 3, dim == 3, 1], 4))
    here = state
    here = faster(np.zeros((4, 6)))
    known, trial = ss.forces(here, LAW)
    for memory in (FREE, HELD):
        here = here._replace(contacts=trial) if memory == FREE else ss.accept(here, trial)
        again, _ = ss.forces(here, LAW)
        np.testing.assert_allclose(again.torque, known.torque, atol=1e-13)
        got = ss.jacobian(here, LAW, memory=memory).toarray()
        np.testing.assert_allclose(got, differences(here, moved)[np.ix_(varied, varied)], atol=1e-8)
    damping = ss.modes.equations_of_motion(here, LAW).damping.toarray()
    np.testing.assert_allclose(damping, differences(here, faster)[np.ix_(varied, varied)], atol=1e-8)


@pytest.mark.parametrize("name", BONDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_and_moments_of_bonds_are_balanced(dim, name):
    state = cluster(dim, BONDS[name])
    force, torque = np.zeros((2, 4, 3))
    add_bond_loads(state.bonds, dim, bodies(state), state.cell.vectors, force, torque)
    assert np.abs(force).max() > 0.01
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose((np.cross(state.grains.position, force) + torque).sum(axis=0), 0, atol=1e-14)


@pytest.mark.parametrize("name", BONDS)
def test_loads_turn_with_the_sample(name):
    """A rotation of all grains by 0.7 about z, also of their orientations, turns the loads."""
    bonded, turn = cluster(3, BONDS[name], moved=False), Rotation.from_rotvec([0, 0, 0.7])
    angle = Rotation.from_rotvec(np.random.default_rng(1).normal(size=(4, 3)) * 0.2)
    grains = bonded.grains._replace(angle=angle.as_rotvec())
    loads = []
    for whole in (Rotation.identity(), turn):
        there = grains._replace(
            position=whole.apply(grains.position), velocity=whole.apply(grains.velocity),
            spin=whole.apply(grains.spin), angle=(whole * angle).as_rotvec(),
        )  # fmt: skip
        found, _ = ss.forces(bonded._replace(grains=there), LAW)
        loads.append((whole.inv().apply(found.force), whole.inv().apply(found.torque)))
    np.testing.assert_allclose(loads[1], loads[0], atol=1e-12)


def test_a_stretched_pair_pulls_with_its_stiffness_and_breaks_at_its_strength():
    pair = ss.assembly(ss.spheres([[0, 0, 0], [1.2, 0, 0]], 0.5))
    bond = ss.laws.beam_bond(3.0, 1.0, 1.0, 1.0, strength=(0.3, 1.0, 1.0, 1.0), smooth=False)
    pair = ss.packings.bonded(pair, bond, within=0.3)
    for stretch, share in ((0.05, 0.5), (0.099, 0.99), (-0.05, 0.0)):
        here = pair._replace(grains=pair.grains._replace(position=np.array([[0, 0, 0], [1.2 + stretch, 0, 0]])))
        found, _ = ss.forces(here, LAW)
        np.testing.assert_allclose(found.force[:, 0], [3 * stretch, -3 * stretch])
        np.testing.assert_allclose(ss.measure.bond_shares(here), [share], atol=1e-12)


def test_newton_leaves_a_bonded_grain_at_its_one_contact():
    """A contact of depth d that a bond holds: k (d₀ − d) = f(d); a loose grain would be pushed out of it."""
    pair = ss.assembly(ss.spheres([[0, 0, 0], [0.98, 0, 0]], 0.5))
    pair = ss.packings.bonded(pair, ss.laws.beam_bond(3.0, 1.0, 1.0, 1.0))
    end, outcome = ss.equilibrate(pair, LAW)
    assert outcome.ok and not outcome.fallback
    assert 0 < ss.measure.overlaps(end)[0] < 0.02


def test_a_twist_beyond_half_a_turn_is_the_shorter_one():
    pair = ss.packings.bonded(PAIR, ss.laws.beam_bond(3.0, 1.0, 1.0, 2.0))
    twisted = pair._replace(grains=pair.grains._replace(angle=np.array([[3.5, 0, 0], [0, 0, 0]])))
    found, _ = ss.forces(twisted, LAW)
    np.testing.assert_allclose(found.torque[:, 0], [2 * (2 * np.pi - 3.5), -2 * (2 * np.pi - 3.5)])


def test_an_imbalance_is_measured_by_what_bonds_bear():
    """Also where no grains touch: the one force of a stretched pair is unbalanced."""
    pair = ss.packings.bonded(ss.assembly(ss.spheres([[0, 0, 0], [1.2, 0, 0]], 0.5)), BONDS["spring"], within=0.3)
    pulled = pair._replace(bonds=pair.bonds._replace(length=np.array([1.19])))
    pulled = ss.accept(pulled, ss.forces(pulled, LAW)[1])
    assert ss.measure.imbalance(pulled, LAW) == pytest.approx(1.0)


def test_disks_bend_and_shear_like_a_short_beam():
    bond = ss.laws.parallel_bond(2.0, 1.0, radius=0.8)
    pair = ss.packings.bonded(ss.assembly(ss.disks([[0, 0], [1, 0]], 0.5)), bond)
    area, inertia = 2 * 0.4, 2 * 0.4**3 / 3
    np.testing.assert_allclose(pair.bonds.stiffness, [[2 * area, area, 2 * inertia, 0]])
    bent = pair._replace(grains=pair.grains._replace(angle=np.array([[0, 0, -0.01], [0, 0, 0.01]])))
    found, _ = ss.forces(bent, ss.laws.frictionless(LAW))
    np.testing.assert_allclose(found.torque[:, 2], [0.02 * 2 * inertia, -0.02 * 2 * inertia], rtol=1e-12)
    np.testing.assert_allclose(found.force, 0, atol=1e-15)
    sheared = pair._replace(grains=pair.grains._replace(angle=np.array([[0, 0, 0.01], [0, 0, 0.01]])))
    found, _ = ss.forces(sheared, ss.laws.frictionless(LAW))
    np.testing.assert_allclose(found.force[:, 1], [-0.01 * area, 0.01 * area], rtol=1e-12)


@pytest.mark.parametrize("name", BONDS)
def test_runs_conserve_momentum_and_restart_with_the_same_bits(name):
    state = cluster(3, BONDS[name], moved=False)
    whole, _, _ = ss.run(state, LAW, steps=90, dt=0.01, every=30)
    half, _, _ = ss.run(state, LAW, steps=1, dt=0.01)
    rest, _, _ = ss.run(half, LAW, steps=89, dt=0.01)
    for part in ("position", "velocity", "angle", "spin"):
        assert np.array_equal(getattr(rest.grains, part), getattr(whole.grains, part)), part
    assert all(np.array_equal(a, b) for a, b in zip(rest.bonds, whole.bonds, strict=True))
    before, after = ((s.grains.mass[:, None] * s.grains.velocity).sum(axis=0) for s in (state, whole))
    np.testing.assert_allclose(after, before, atol=1e-14)


def test_a_bond_that_breaks_in_a_run_is_an_event_and_does_not_return():
    pair = ss.packings.bonded(ss.assembly(ss.spheres([[0, 0, 0], [1, 0, 0]], 0.5)), ss.laws.spring_bond(10.0, 0.01))
    pair = pair._replace(grains=pair.grains._replace(velocity=np.array([[-0.1, 0, 0], [0.1, 0, 0]])))
    end, record, _ = ss.run(pair, LAW, steps=200, dt=0.002, events=True)
    broke = record.events[record.events["kind"] == "broke"]
    assert [(row["i"], row["j"]) for row in broke] == [(0, 1)]
    assert not end.bonds.intact.any() and 0.04 < broke["time"][0] < 0.08
    later, _, _ = ss.run(end, LAW, steps=10, dt=0.002)
    np.testing.assert_allclose(later.grains.velocity, end.grains.velocity)


def test_a_sample_of_a_run_counts_bonds_as_measures_do():
    place, bond = [[0, 0, 0], [1.0, 0.9, 0], [2.0, 0, 0], [3.5, 3.5, 0]], ss.laws.beam_bond(2.0, 1.0, 0.3, 0.2)
    grains = ss.spheres(place, 0.5)._replace(velocity=np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0]]))
    state = ss.packings.bonded(ss.assembly(grains, cell=ss.box([8, 8, 8], (True,) * 3)), bond, within=0.5)
    end, record, _ = ss.run(state, LAW, steps=100, dt=0.01, every=50)  # gaps grow beyond the list
    assert record.touching[-1] == len(ss.measure.touching(end)) == 2
    assert record.rattlers[-1] == ss.measure.rattlers(end).sum() == 1
    assert record.coordination[-1] == 1 and record.held_coordination[-1] == pytest.approx(ss.measure.coordination(end))
    np.testing.assert_allclose(record.fabric[-1], ss.measure.fabric(end), atol=1e-15)
    np.testing.assert_allclose(record.stress[-1], ss.measure.stress(end, LAW), atol=1e-15)
    assert np.abs(record.stress[-1]).max() > 1e-3 and ss.jacobian(end, LAW).shape == (24, 24)


def test_a_bond_beyond_its_strength_that_fades_bears_nothing():
    pair = ss.packings.bonded(PAIR, ss.laws.spring_bond(1.0, 0.1))
    far = pair._replace(grains=pair.grains._replace(position=np.array([[0, 0, 0], [1.3, 0, 0]])))
    found, trial = ss.forces(far, LAW)
    assert not found.force.any() and not ss.jacobian(ss.accept(far, trial), LAW).toarray().any()
    assert ss.measure.bond_shares(far) == pytest.approx([3.0])


def test_a_time_step_beyond_the_bound_of_bonds_is_refused():
    pair = ss.packings.bonded(
        ss.assembly(ss.spheres([[0, 0, 0], [1.1, 0, 0]], 0.5)), ss.laws.beam_bond(4.0, 1.0, 0.1, 0.1), within=0.2
    )
    limit, mass = ss.measure.stable_time_step(pair, LAW), float(pair.grains.mass[0])
    assert limit <= 2 / np.sqrt(2 * 4.0 / mass)  # the spring alone
    spring = ss.packings.bonded(ss.packings.without_bonds(pair), ss.laws.spring_bond(4.0), within=0.2)
    assert ss.measure.stable_time_step(spring, LAW) == pytest.approx(2 / np.sqrt(2 * 4.0 / mass))
    with pytest.raises(ValueError, match="with contacts this stiff"):
        ss.run(pair, LAW, steps=1, dt=3 * limit)


@pytest.fixture(scope="module")
def cemented():
    """A jammed packing whose contacts and near pairs are cemented, without load on the cement."""
    state, _ = ss.packings.jammed(30, packing_fraction=0.66, seed=1)
    return ss.packings.bonded(state, ss.laws.parallel_bond(3.0, 1.0, 0.002, 0.004), within=0.05)


def test_a_cemented_packing_is_stable_until_bonds_break_one_after_the_other(cemented):
    assert ss.stability(cemented, LAW).verdict == "stable"
    assert len(ss.measure.touching(cemented)) == len(cemented.bonds.i)
    free, outcome = ss.equilibrate(ss.packings.sheared(cemented, 1e-4), LAW)
    assert outcome.ok and free.bonds.intact.all() and 0 < ss.measure.bond_shares(free).max() < 1
    end, outcome = ss.equilibrate(ss.packings.sheared(cemented, 2e-3), LAW)
    lost = int((~end.bonds.intact).sum())
    assert outcome.ok and lost > 0 and f"{lost} bonds broke" in outcome.how
    assert ss.measure.bond_shares(end).max() < 1


@pytest.mark.filterwarnings("ignore:the equilibrium is unstable")
def test_damped_dynamics_on_the_way_to_an_equilibrium_breaks_no_bond():
    """Bonds as strong as the equilibrium needs survive a large strain, where Newton's method stalls at first."""
    state, _ = ss.packings.jammed(8, packing_fraction=0.72, seed=3)
    state = ss.packings.sheared(ss.packings.bonded(state, ss.laws.parallel_bond(0.05, 0.05 / 3, 1.0, 1.0)), 0.5)
    lasting = state._replace(bonds=state.bonds._replace(strength=1e3 * state.bonds.strength))
    end, outcome = ss.equilibrate(lasting, LAW)
    assert outcome.fallback and end.bonds.intact.all()
    enough = 1.02 * ss.measure.bond_shares(end).max() * lasting.bonds.strength
    for share, breaks in ((1.0, False), (0.9, True)):
        weak = state._replace(bonds=state.bonds._replace(strength=share * enough))
        end, outcome = ss.equilibrate(weak, LAW)
        lost = int((~end.bonds.intact).sum())
        assert outcome.ok and (lost > 0) == breaks and (f"{lost} bond" in outcome.how) == breaks


@pytest.mark.filterwarnings("ignore:at strain")
def test_a_ramp_of_shear_breaks_bonds_and_says_so(cemented):
    path = ss.protocols.ramp(cemented, [0.0, 2e-4, 2e-3], ss.protocols.aqs(LAW))
    lost = [int((~point.state.bonds.intact).sum()) for point in path]
    assert lost[:2] == [0, 0] and lost[2] > 0
    assert "broke" in path[2].outcome.how and "broke" not in path[1].outcome.how


def test_a_cell_that_follows_the_stress_breaks_bonds_as_it_settles(cemented):
    scales = kit.compression_scales(cemented, LAW, 1e-3, 1e-12)
    control = ss.control.stress_controlled(cemented.control, {"xx": 1e-3, "yy": 1e-3, "zz": 1e-3})
    pushed = ss.packings.sheared(cemented, 1e-3)._replace(control=control)
    end, outcome = kit.settle(pushed, LAW, scales, tolerance=1e-12, keep=ss.results.Factorisation())
    lost = int((~end.bonds.intact).sum())
    assert lost > 0 and f"{lost} bond" in outcome.how and ss.measure.bond_shares(end).max() < 1
    np.testing.assert_allclose(np.diag(ss.measure.stress(end, LAW)), 1e-3, atol=1e-8)


def test_moduli_are_derivatives_of_the_stress(cemented):
    moduli, strain = ss.modes.elastic_moduli(cemented, LAW).tensor, 1e-6
    for a, b in ((0, 0), (0, 1)):
        gradient = np.zeros((3, 3))
        gradient[a, b] = strain
        ends = [
            ss.equilibrate(ss.packings.strained(cemented, sign * gradient), LAW, check="nothing")[0] for sign in (1, -1)
        ]
        change = (ss.measure.stress(ends[1], LAW) - ss.measure.stress(ends[0], LAW)) / (2 * strain)
        np.testing.assert_allclose(change, moduli[:, :, a, b], atol=2e-4 * np.abs(moduli).max())


def test_stress_is_the_virial_of_contacts_and_bonds(cemented):
    pulled, _ = ss.equilibrate(ss.packings.sheared(cemented, 1e-4), LAW)
    force, torque, virial = np.zeros((30, 3)), np.zeros((30, 3)), np.zeros((3, 3))
    add_bond_loads(pulled.bonds, 3, bodies(pulled), pulled.cell.vectors, force, torque, virial)
    bare = ss.measure.stress(ss.packings.without_bonds(pulled), LAW)
    whole = ss.measure.stress(pulled, LAW)
    assert np.abs(whole - bare).max() > 0.01 * np.abs(whole).max()
    np.testing.assert_allclose(whole, bare + virial / np.linalg.det(pulled.cell.vectors), atol=1e-14)


@pytest.mark.parametrize("suffix", ["h5", "gsd", "npz"])
def test_files_keep_bonds(cemented, tmp_path, suffix):
    if suffix == "gsd":
        pytest.importorskip("gsd")
    end, _ = ss.equilibrate(ss.packings.sheared(cemented, 1e-3), LAW)
    assert not ss.io.write_packing(tmp_path / f"p.{suffix}", end, LAW)
    back, _ = ss.io.read_packing(tmp_path / f"p.{suffix}")[:2]
    assert all(np.array_equal(a, b) for a, b in zip(back.bonds, end.bonds, strict=True))
    np.testing.assert_allclose(ss.forces(back, LAW)[0].force, ss.forces(end, LAW)[0].force, atol=1e-12)
    notes = ss.io.write_packing(tmp_path / "p.csv", end, LAW)
    ss.io.write_packing(tmp_path / "bare.csv", ss.packings.without_bonds(end), LAW)
    written = [sorted(path.read_text() for path in tmp_path.glob(f"{name}*.csv")) for name in ("p", "bare")]
    assert any("does not store bonds" in note for note in notes) and written[0] == written[1]


def test_functions_that_would_ignore_bonds_refuse_them(cemented):
    with pytest.raises(ValueError, match=r"dissipation\(\) does not support bonds yet: .*without_bonds"):
        ss.measure.dissipation(cemented, cemented, LAW)


@pytest.mark.parametrize("name", ["stiff spring", "spring", "beam", "fading beam"])
@pytest.mark.parametrize("dim", [2, 3])
def test_loads_of_bonds_do_the_work_that_their_energy_loses(dim, name):
    """Exactly of springs; of beams to first order in the rotations, which leaves 2 % of forces at 0.02 rad."""
    rest = cluster(dim, BONDS[name], moved=False)
    rest = rest._replace(grains=rest.grains._replace(velocity=np.zeros((4, 3)), spin=np.zeros((4, 3))))
    way = np.random.default_rng(3).normal(size=(4, 6)) * np.repeat([0.03, 0.02], 3)
    if dim == 2:
        way[:, 2:5] = 0

    def moved(share):
        grains = rest.grains
        return rest._replace(
            grains=grains._replace(position=grains.position + share * way[:, :3], angle=share * way[:, 3:])
        )

    after, before = (ss.measure.elastic_energy(moved(share), NOTHING) for share in (1 + 1e-6, 1 - 1e-6))
    force, torque = np.zeros((2, 4, 3))
    add_bond_loads(rest.bonds, dim, bodies(moved(1)), rest.cell.vectors, force, torque)
    work = (force * way[:, :3]).sum() + (torque * way[:, 3:]).sum()
    assert work < 0
    assert (after - before) / 2e-6 == pytest.approx(-work, rel=1e-7 if "spring" in name else 0.02)


@pytest.mark.parametrize("name", BONDS)
def test_a_ledger_of_bonds_balances_to_second_order(name):
    """Also in a cell that is sheared, with a driven grain and dashpots."""
    state = cluster(3, BONDS[name], moved=False)
    control = ss.control.driven(state.control, [0], [0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = state._replace(
        cell=ss.box([9, 9, 9], (True,) * 3), control=ss.control.strained_at(control, 0.02 * np.eye(3, k=1))
    )
    off = []
    for dt in (0.02, 0.01):
        _, record, _ = ss.run(state, NOTHING, round(1.0 / dt), dt, every=round(1.0 / dt), ledger=True)
        book = record.ledger
        off.append(abs(book.defect[-1]) / book.kinetic[0])
        assert book.bonded[-1] > 1e-4 and not book.broken.any()
        assert (book.viscous[-1] > 0) == (name not in ("stiff spring", "parallel"))
        assert book.bonded[0] == pytest.approx(0, abs=1e-15)
    assert off[1] < 2e-3 and off[1] < 0.3 * off[0]


def test_a_bond_that_breaks_loses_the_energy_that_it_stored():
    bond, speed = ss.laws.beam_bond(10.0, 1.0, 1.0, 1.0, strength=(0.1, 1.0, 1.0, 1.0), smooth=False), 0.1
    pair = ss.packings.bonded(PAIR, bond)
    pair = pair._replace(grains=pair.grains._replace(velocity=np.array([[-speed, 0, 0], [speed, 0, 0]])))
    end, record, _ = ss.run(pair, NOTHING, 2000, 1e-4, every=100, ledger=True)
    book = record.ledger
    assert not end.bonds.intact.any() and FAILURES[end.bonds.failed[0]] == "tension"
    assert book.broken[-1] == pytest.approx(0.1**2 / 10 / 2, rel=2e-3) and book.bonded[-1] == 0
    assert abs(book.defect).max() < 1e-7 * book.kinetic[0]


@pytest.mark.parametrize(
    ("bond", "moved", "by"),
    [
        (ss.laws.spring_bond(1.0, 0.01), {"x": -0.02}, "compression"),
        (ss.laws.spring_bond(1.0, 0.01), {"x": 0.02}, "tension"),
        (ss.laws.parallel_bond(1.0, 1.0, 1e-3, 1.0), {"turn": (0, 0, 0.1)}, "bending"),
        (ss.laws.parallel_bond(1.0, 1.0, 1.0, 1e-3), {"turn": (0.1, 0, 0)}, "twisting"),
        (ss.laws.beam_bond(1.0, 1.0, 1e-9, 1e-9, strength=(1.0, 1e-3, 1.0, 1.0)), {"y": 0.01}, "shear"),
    ],
)  # fmt: skip
def test_a_broken_bond_remembers_the_load_that_broke_it(bond, moved, by):
    """Where it breaks between equilibria, and where it breaks in a run."""
    pair = ss.packings.bonded(PAIR, bond)
    place, angle = pair.grains.position.copy(), np.zeros((2, 3))
    place[1] += [moved.get("x", 0), moved.get("y", 0), 0]
    angle[1] = moved.get("turn", (0, 0, 0))
    far = pair._replace(grains=pair.grains._replace(position=place, angle=angle))
    assert [FAILURES[k] for k in with_weakest_broken(far).bonds.failed] == [by]
    assert [FAILURES[k] for k in ss.run(far, LAW, 1, 1e-3)[0].bonds.failed] == [by]


THEIRS = np.load(bonds_lammps.STORE)
NOTHING = ss.laws.linear(kn=1e-30, kt=0.0, mu=0.0)


def law_of_case(case):
    """The bond of a case of LAMMPS; columns of LAMMPS are tension, shear, twisting, bending."""
    options = dict(case.options)
    smooth = {"smooth": options["smooth"], "normalized": options["normalize"]}
    if case.law == "spring":
        return ss.laws.spring_bond(options["k"], options["ecrit"], damping=options["gamma"], **smooth)
    (kr, ks, kt, kb), (fr, fs, ft, fb) = options["stiffness"], options["strength"]
    return ss.laws.beam_bond(kr, ks, kb, kt, strength=(fr, fs, fb, ft), damping=options["damping"], **smooth)


def sample_of(name):
    """The spheres of a case when they were bonded, and moved and turned since."""
    case = bonds_lammps.CASES[name]
    pairs, reference, start = (THEIRS[f"{name}/{key}"] for key in ("bonds", "reference", "start"))
    radius, mass = THEIRS[f"{name}/radius"], THEIRS[f"{name}/mass"]
    grains = (ss.disks if case.dim == 2 else ss.spheres)(start[:, : case.dim], radius)
    grains = grains._replace(
        mass=mass,
        inertia=(0.5 if case.dim == 2 else 0.4) * mass * radius**2,
        velocity=start[:, 3:6],
        spin=start[:, 6:9],
    )
    cell = ss.box([*case.cells[:2], 1.0], (True, True, False)) if case.periodic else None
    state = ss.packings.bonded(ss.assembly(grains, cell=cell), law_of_case(case), pairs=pairs)
    length = np.linalg.norm(reference, axis=1)
    turned = [Rotation.from_quat(start[ends, 9:], scalar_first=True) for ends in pairs.T]
    made = ss.packings.bonded(  # stiffness of a bond of the length at rest
        ss.assembly(ss.spheres(np.vstack([reference, 0 * reference]), 0.1)), law_of_case(case),
        pairs=np.arange(2 * len(pairs)).reshape(2, -1).T,
    ).bonds  # fmt: skip
    bonds = state.bonds._replace(
        length=length, direction=turned[1].apply(reference / length[:, None]), stiffness=made.stiffness,
        strength=made.strength, turn=(turned[0] * turned[1].inv()).as_quat(scalar_first=True),
    )  # fmt: skip
    return state._replace(bonds=bonds)


@pytest.mark.parametrize("name", [name for name, case in bonds_lammps.CASES.items() if not case.motion])
def test_loads_are_those_of_lammps(name):
    state, case = sample_of(name), bonds_lammps.CASES[name]
    kept = ss.measure.bond_shares(state) < 1
    assert np.array_equal(kept, THEIRS[f"{name}/kept"])
    state = state._replace(bonds=state.bonds._replace(intact=kept))
    force, torque = np.zeros((2, state.n_bodies, 3))
    add_bond_loads(state.bonds, case.dim, bodies(state), state.cell.vectors, force, torque)
    scale = np.abs(THEIRS[f"{name}/force"]).max()
    np.testing.assert_allclose(force, THEIRS[f"{name}/force"], atol=1e-12 * scale)
    np.testing.assert_allclose(torque, THEIRS[f"{name}/torque"], atol=1e-12 * scale)


@pytest.mark.parametrize(
    ("name", "tolerance"),  # LAMMPS finds angles by acos, whose rounding is 1e-8 at angles near zero
    [
        ("spring, moves", 1e-11), ("rotational, moves", 1e-8), ("rotational, moves, periodic", 3e-6),
        ("rotational, moves in a plane", 1e-8), ("rotational, breaks", 3e-6),
    ],
)  # fmt: skip
def test_motion_is_that_of_lammps(name, tolerance):
    """A thousand steps; "rate" evaluates dashpots at the half step, as LAMMPS does."""
    end, record, _ = ss.run(sample_of(name), NOTHING, 1000, bonds_lammps.STEP, slip_update="rate", events=True)
    states, broken = THEIRS[f"{name}/states"], THEIRS[f"{name}/broken"]
    assert list(THEIRS[f"{name}/steps"])[-1] == 1000
    assert np.array_equal(end.bonds.intact, broken < 0)
    got = np.hstack([end.grains.position, end.grains.velocity, end.grains.spin])
    np.testing.assert_allclose(got, states[-1][:, :9], atol=tolerance)
    times = np.sort(record.events["time"][record.events["kind"] == "broke"])
    np.testing.assert_allclose(times / bonds_lammps.STEP, np.sort(broken[broken >= 0]), atol=1e-6)


def test_increments_of_parallel_bonds_are_those_of_potyondy_and_cundall():
    """Their incremental form, written plainly, along a path of small rotations of two unequal spheres."""
    radii, kn, ks, steps = np.array([[0.5], [0.35]]), 800.0, 500.0, 40
    place = np.array([[0.5, 0.6, 0.3], [0, 0, 0]])
    bond = ss.laws.parallel_bond(kn, ks, 1e3, 1e3, radius=0.8)
    state = ss.packings.bonded(ss.assembly(ss.spheres(place, radii[:, 0])), bond, pairs=[[0, 1]])
    way = 2e-3 * np.random.default_rng(4).normal(size=(2, 2, 3))
    cement, pair = bonds.no_cement(1), place[:1] - place[1:]
    for _ in range(steps):
        after = pair + (way[0, :1] - way[0, 1:]) / steps
        motion = way[:, :, None] / steps
        cement, pair = bonds.cemented(cement, pair, after, *motion, 1.0, kn=kn, ks=ks, radii=radii, ratio=0.8), after
    known = bonds.parallel(cement, pair, kn=kn, ks=ks, radii=radii, tensile=1e3, shear=1e3, ratio=0.8)
    moved = state._replace(grains=state.grains._replace(position=place + way[0], angle=way[1]))
    force, torque = np.zeros((2, 2, 3))
    share = add_bond_loads(moved.bonds, 3, bodies(moved), moved.cell.vectors, force, torque)
    scale = np.abs(known.torque_i).max()
    np.testing.assert_allclose(force, [known.force_i[0], known.force_j[0]], atol=0.01 * np.abs(known.force_i).max())
    np.testing.assert_allclose(torque, [known.torque_i[0], known.torque_j[0]], atol=0.01 * scale)
    np.testing.assert_allclose(share, known.share, rtol=0.01)


@pytest.mark.parametrize("name", ["stiff spring", "parallel"])
def test_bonds_across_gaps_bear_a_hanging_chain(name):
    """Forces that bonds alone carry are the scale of what is unbalanced."""
    chain = ss.assembly(ss.spheres(np.arange(4)[:, None] * [0, -1.1, 0], 0.5))
    chain = ss.packings.bonded(chain, BONDS[name], within=0.2)
    control = ss.control.fixed(chain.control, [0])._replace(gravity=np.array([0, -1e-3, 0]))
    chain, outcome = ss.equilibrate(chain._replace(control=control), LAW)
    assert outcome.ok and ss.measure.imbalance(chain, LAW) < 1e-10
    assert ss.stability(chain, LAW).verdict.startswith("stable")


def test_a_chain_bends_and_vibrates_as_its_closed_form():
    n, spacing, stiff = 6, 0.9, (400.0, 300.0, 30.0, 40.0)  # Kr, Ks, Kt, Kb
    beam = ss.laws.beam_bond(stiff[0], stiff[1], stiff[3], stiff[2])
    chain = ss.assembly(ss.spheres(spacing * np.arange(n + 1)[:, None] * [1.0, 0, 0], 0.4))
    free = np.ones((n + 1, 6), bool)
    free[0] = False
    chain = ss.packings.bonded(chain, beam, within=0.2)
    chain = chain._replace(control=chain.control._replace(free=free))
    chain = ss.accept(chain, ss.forces(chain, LAW)[1])
    motion, known = ss.modes.equations_of_motion(chain, LAW), bonds.rotational_chain(n, spacing, stiff)
    mass, inertia = float(chain.grains.mass[0]), float(chain.grains.inertia[0])
    squares = np.sort(np.linalg.eigvals(-motion.jacobian.toarray() / motion.mass[:, None]).real)
    bending = bonds.bending_frequencies(known, mass, inertia)
    expected = [bonds.line_frequencies(known, known.stretch, mass), bonds.line_frequencies(known, known.twist, inertia)]
    np.testing.assert_allclose(squares, np.sort(np.concatenate([*expected, bending, bending])) ** 2, rtol=1e-9)
    stretch, deflection, slope, bend, twist = bonds.compliance(known)
    yields = np.linalg.inv(-motion.jacobian.toarray())[-6:, -6:]
    got = yields[0, 0], yields[1, 1], yields[5, 1] / 0.4, yields[5, 5] / 0.4**2, yields[3, 3] / 0.4**2
    np.testing.assert_allclose(got, [stretch, deflection, slope, bend, twist], rtol=1e-9)


PAIR = ss.assembly(ss.spheres([[0, 0, 0], [1, 0, 0]], 0.5))
FAR = ss.assembly(ss.spheres([[0, 0, 0], [4e4 + 1, 0, 0]], 0.5), cell=ss.box([4, 4, 4], (True,) * 3))
BOX = ss.assembly(ss.spheres([[0, 0, 0], [2, 0, 0]], 0.5), ss.flat_walls(), ss.box([4, 4, 4], (True,) * 3))


@pytest.mark.parametrize(
    ("state", "pairs", "words"),
    [
        (FAR, [[0, 1]], "periodic boxes apart"),
        (FAR, None, "periodic boxes apart"),
        (PAIR, [[1, 1]], "grain 1 cannot be bonded to itself"),
        (PAIR, [[0, 2]], "numbered 0 to 1"),
        (PAIR, [[0, 1], [1, 0]], "already bonded"),
        (BOX, [[0, 1]], "half a periodic box apart"),
        (PAIR, [[0, 1, 2]], r"\(K, 2\)"),
        (ss.assembly(ss.spheres([[0, 0, 0], [0, 0, 0]], 0.5)), [[0, 1]], "have the same position"),
    ],
)
def test_bonds_that_cannot_be_are_refused(state, pairs, words):
    with pytest.raises(ValueError, match=words):
        ss.packings.bonded(state, ss.laws.spring_bond(1.0), pairs=pairs and np.array(pairs))


def test_bonds_reach_half_a_periodic_cell_at_most(cemented):
    bare, bond = ss.packings.without_bonds(cemented), ss.laws.spring_bond(1.0)
    with pytest.raises(ValueError, match="within must be at most half the smallest height of the periodic cell, "):
        ss.packings.bonded(bare, bond, within=0.51 * np.diag(bare.cell.vectors).min())
    with pytest.raises(ValueError, match="within and pairs exclude each other"):
        ss.packings.bonded(bare, bond, within=0.1, pairs=np.array([[0, 1]]))


@pytest.mark.parametrize("wrong", [{"i": 1, "j": 0}, {"turn": 0.0}, {"direction": 2.0}])
def test_bonds_that_were_changed_by_hand_are_refused(wrong):
    pair = ss.packings.bonded(PAIR, ss.laws.spring_bond(1.0))
    parts = {name: np.full_like(getattr(pair.bonds, name), value) for name, value in wrong.items()}
    with pytest.raises(ValueError, match="i < j"):
        ss.forces(pair._replace(bonds=pair.bonds._replace(**parts)), LAW)


@pytest.mark.parametrize("strength", [(1, 1, 1), (1, 1, 1, -1), (1, 1, 1, 0), (1, 1, 1, np.nan)])
def test_strengths_are_positive(strength):
    with pytest.raises(ValueError, match="strength"):
        ss.laws.beam_bond(1.0, 1.0, 1.0, 1.0, strength=strength)


@pytest.mark.parametrize("strength", [0.0, 1e-300, np.inf])
def test_strengths_out_of_range_are_named_with_the_one_that_is_never_reached(strength):
    with pytest.raises(ValueError, match=r"four finite numbers of at least 1e-150, .* \(1e300: never\), got \("):
        ss.laws.beam_bond(1.0, 1.0, 1.0, 1.0, strength=(strength, 1.0, 1.0, 1.0))
    assert ss.laws.beam_bond(1.0, 1.0, 1.0, 1.0, strength=(1e300, 1.0, 1.0, 1.0)).strength[0] == 1e300
