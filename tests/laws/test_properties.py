"""Properties of laws: exact Jacobian, balance of energy, rows and blocks, restart, and what each of them means."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.memory import FREE, HELD
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.dynamics import driver
from stickslip.data import archive
from tests.conftest import make_packing, stirred
from tests.laws.test_mechanics import differences, rate_differences

LAWS = {
    "arms": lambda **more: ss.laws.with_lever(ss.laws.hertz_mindlin(kt=0.8, **more), "overlap"),
    "smooth arms": lambda **more: ss.laws.with_lever(ss.laws.hertz_mindlin(coulomb="smooth", **more), "overlap"),
    "arms and rescaling": lambda **more: ss.laws.with_lever(
        ss.laws.hertz_mindlin_reff(rescaled=True, **more), "overlap"
    ),
    "coeff_restitution": lambda **more: ss.laws.hertz_mindlin_reff(
        **more | {"damping": "coeff_restitution", "damping_n": 0.5}
    ),
    "jkr": lambda **more: ss.laws.jkr(kt=0.8, work=5e-3, **more),
    "dmt": lambda **more: ss.laws.dmt(kt=0.8, work=1e-3, **more),
    "liquid_bridge": lambda **more: ss.laws.liquid_bridge(surface_tension=1e-3, volume=1e-4, **more),
}
EVERY = pytest.mark.parametrize("name", LAWS)


def packed(name, dim, **more):
    """A packing whose contacts have committed memory, far from kinks; some slide, some stick."""
    law = ss.laws.for_pair(LAWS[name](**{"mu": 0.5, "damping_n": 0.1} | more), 0, 1, mu=0.3, kn=1.3)
    for seed in range(300):
        state = stirred(make_packing(dim, seed=seed), law, np.random.default_rng(seed), size=0.05)
        count = int(state.contacts.count[0])
        mode, gap = state.contacts.mode[:count], -ss.measure.overlaps(state)
        slips = np.linalg.norm(state.contacts.slip[:count], axis=1)[(mode == ss.SLIDE) & (gap < 0)]
        if len(slips) and slips.min() > 0.02 and (mode == ss.STICK).any() and np.abs(gap).min() > 2e-3:
            return state, law
    raise AssertionError("no suitable packing")


@pytest.mark.parametrize("dim", [2, 3])
@EVERY
def test_jacobian_and_damping_matrix_are_exact(name, dim):
    state, law = start, _ = packed(name, dim)
    free, count = ss.freedom(state), int(state.contacts.count[0])
    for memory, step in ((HELD, 1e-6), (FREE, 1e-7)):
        if memory == FREE:  # as in a solver: what is not committed moves on
            way = np.random.default_rng(3).normal(0, 3e-4, len(free))
            state = with_neighbor_list(ss.modes.displaced(state, free, way))
        elif "rescaling" in name:
            continue  # only one-sided derivatives where the memory was committed
        exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law, memory=memory)[0], free).toarray()
        found = differences(state, law, free, memory, step)
        # h² f''' with lengths of 0.02 and round-off over h are both of order 1e-9
        np.testing.assert_allclose(exact, found, atol=3e-8 * np.abs(exact).max())
    rub = ss.modes.assembled(start, ss.modes.contact_blocks(start, law)[1], free).toarray()
    np.testing.assert_allclose(rub, rate_differences(start, law, free, 1e-7), atol=1e-8 * np.abs(rub).max())
    assert count == int(state.contacts.count[0])


def moving(name, dim, speed=0.03, **more):
    """A packing in motion, without dashpots unless they are given."""
    state, law = packed(name, dim, **{"damping_n": 0.0} | more)
    rng, n = np.random.default_rng(0), len(state.grains.radius)
    move, turn = rng.normal(0, speed, (2, n, 3))
    if dim == 2:
        move[:, 2] = turn[:, :2] = 0
    return state._replace(grains=state.grains._replace(velocity=move, spin=6 * turn)), law


@pytest.mark.parametrize("dim", [2, 3])
@EVERY
def test_energy_is_balanced_as_the_time_step_goes_to_zero(name, dim):
    state, law = moving(name, dim, damping_n=0.02, damping_t=0.02)
    defect = []
    for dt in (0.02, 0.005):
        _, record, _ = ss.run(state, law, round(2 / dt), dt, every=round(0.1 / dt), ledger=True)
        defect.append(np.abs(record.ledger.defect).max() / record.ledger.kinetic[0])
    assert record.ledger.tangential.max() > 1e-3 * record.ledger.kinetic[0] and record.ledger.coulomb[-1] > 0
    # second order but for the instants at which contacts close, open and slide, each of them of first order
    assert defect[1] < 2e-3 and (defect[1] < 0.5 * defect[0] or name == "dmt")  # whose force jumps at touch


@EVERY
def test_a_run_goes_on_to_the_last_bit_through_an_archive(name, tmp_path):
    state, law = moving(name, 3, damping_n=0.02, damping_t=0.02)
    whole, _, _ = ss.run(state, law, 200, 0.02)
    half, _, _ = ss.run(state, law, 100, 0.02)
    archive.write(tmp_path / "half.h5", {"state": half, "law": law})
    back = archive.read(tmp_path / "half.h5")
    assert repr(back["law"]) == repr(law)
    rest, _, _ = ss.run(back["state"], back["law"], 100, 0.02)
    np.testing.assert_array_equal(rest.grains.position, whole.grains.position)
    rows, count = ss.measure.touching(whole), len(ss.measure.touching(rest))
    assert len(rows) == count
    for field in ("slip", "rolling"):
        mine, theirs = (getattr(end.contacts, field) for end in (rest, whole))
        if mine is None:
            assert theirs is None
            continue
        np.testing.assert_array_equal(mine[ss.measure.touching(rest)], theirs[rows])


@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_move_as_rows_on_any_number_of_threads(dim, monkeypatch):
    law, rng, side = LAWS["arms"](damping_n=0.1, damping_t=0.05), np.random.default_rng(0), 10 if dim == 2 else 5
    place = np.stack(np.meshgrid(*dim * [np.arange(side)]), axis=-1).reshape(-1, dim) * 0.98
    radius = rng.uniform(0.46, 0.52, len(place))
    grains = (ss.disks if dim == 2 else ss.spheres)(place + rng.normal(0, 0.01, place.shape), radius)
    move, turn = rng.normal(0, 0.05, (2, len(place), 3))
    if dim == 2:
        move[:, 2] = turn[:, :2] = 0
    grains = grains._replace(velocity=move, spin=5 * turn)
    size = [side * 0.98] * dim + [1.0] * (3 - dim)
    state = ss.assembly(grains, cell=ss.box(size, [True] * dim + [False] * (3 - dim), dim))
    one, _, _ = ss.run(state, law, 200, 0.02, threads=1)
    two, _, _ = ss.run(state, law, 200, 0.02, threads=2)
    np.testing.assert_array_equal(one.grains.position, two.grains.position)
    monkeypatch.setattr(driver, "MIN_BODIES", 10**9)
    plain, _, _ = ss.run(state, law, 200, 0.02)
    np.testing.assert_allclose(one.grains.position, plain.grains.position, atol=1e-11)
    # the memory that statics need: two forces of one state
    again = ss.forces(one, law, memory=HELD)[0]
    np.testing.assert_allclose(again.torque, ss.forces(plain, law, memory=HELD)[0].torque, atol=1e-10)


# ---- lever arms


def spinning_pair(radii=(0.5, 0.8)):
    """Two spheres that meet off-centre, spinning."""
    state = ss.assembly(ss.spheres([[0, 0, 0], [sum(radii) + 0.01, 0.2, 0.1]], np.array(radii)))
    velocity, spin = np.array([[0.05, 0.02, 0], [-0.05, 0, 0.01]]), np.array([[0.1, -0.2, 0.15], [0, 0.1, -0.3]])
    return state._replace(grains=state.grains._replace(velocity=velocity, spin=spin))


def angular_momentum(state):
    g = state.grains
    return (g.mass[:, None] * np.cross(g.position, g.velocity) + g.inertia[:, None] * g.spin).sum(axis=0)


@pytest.mark.parametrize("update", ["difference", "rate"])
def test_contacts_conserve_angular_momentum(update):
    start = spinning_pair()
    changes = []
    for arm in ("radius", "overlap"):
        law = ss.laws.with_lever(ss.laws.linear(kn=1.0, kt=0.5, mu=0.5, damping_n=0.02, damping_t=0.02), arm)
        end, _, _ = ss.run(start, law, 3000, 1e-3, slip_update=update)
        assert (ss.run(start, law, 1000, 1e-3)[0].contacts.mode[:1] != ss.OPEN).all()
        changes.append(np.abs(angular_momentum(end) - angular_momentum(start)).max())
    assert changes[0] > 1e-4 and changes[1] < 1e-14


def test_a_rigid_rotation_does_not_slip():
    radii, angle, slips = np.array([0.5, 0.8]), 0.3, []
    state = ss.assembly(ss.spheres([[0, 0, 0], [1.2, 0, 0]], radii))
    for arm in ("radius", "overlap"):
        law = ss.laws.with_lever(ss.laws.linear(kt=1.0, mu=10.0), arm)
        here = ss.accept(state, ss.forces(state, law)[1])
        for k in range(1, 301):
            a = angle * k / 300
            turned = [[0, 0, 0], [1.2 * np.cos(a), 1.2 * np.sin(a), 0]]
            grains = here.grains._replace(position=np.array(turned), angle=np.full((2, 3), [0, 0, a]))
            here = here._replace(grains=grains)
            here = ss.accept(here, ss.forces(here, law)[1])
        slips.append(np.linalg.norm(here.contacts.slip[0]))
    assert slips[0] == pytest.approx(0.1 * angle, rel=1e-4)  # δ times the angle
    assert slips[1] < 1e-6


def test_walls_keep_the_radius():
    law = ss.laws.linear(kt=1.0, mu=10.0)
    state = ss.assembly(ss.spheres([[0, 0, 0.45]], 0.5), ss.flat_walls([0, 0, 0], [0, 0, 1]))
    torques = []
    for arm in ("radius", "overlap"):
        one = ss.laws.with_lever(law, arm)
        here = ss.accept(state, ss.forces(state, one)[1])
        here = here._replace(grains=here.grains._replace(position=np.array([[0.01, 0, 0.44]])))
        torques.append(ss.forces(here, one)[0].torque[0])
    np.testing.assert_array_equal(*torques)


def test_energy_is_balanced_with_the_slip_of_lammps():
    """Its slip takes R and its torques R − δ/2; the energy so created is `nonpotential`."""
    law = ss.laws.with_lever(ss.laws.linear(kn=1.0, kt=0.5, mu=10.0), "overlap")
    _, record, _ = ss.run(spinning_pair(), law, 150, 0.02, every=1, ledger=True, slip_update="rate")
    assert np.abs(record.ledger.nonpotential).max() > 10 * np.abs(record.ledger.defect).max()


def test_a_wrong_arm_is_refused():
    with pytest.raises(ValueError, match="arm='centre' was given: 'radius' and 'overlap' are allowed"):
        ss.laws.with_lever(ss.laws.linear(), "centre")


# ---- dashpots for a coefficient of restitution


@pytest.mark.parametrize(
    "size", [{"radius": 0.5, "mass": 1.0, "speed": 0.01}, {"radius": 3.0, "mass": 7.0, "speed": 1.0}]
)
@pytest.mark.parametrize("make", [ss.laws.linear, ss.laws.hertz_mindlin, ss.laws.hertz_mindlin_reff])
def test_a_collision_has_the_given_restitution_at_any_size_and_speed(make, size):
    for restitution in (0.05, 0.5, 0.95):
        law = make(damping="coeff_restitution", damping_n=restitution)
        assert ss.laws.collision(law, **size).restitution == pytest.approx(restitution, abs=1e-8)
        if make is not ss.laws.linear:  # a fit to simulations
            law = make(damping="tsuji", damping_n=restitution)
            assert ss.laws.collision(law, **size).restitution == pytest.approx(restitution, abs=5e-3)


def test_a_run_has_the_restitution_of_a_collision():
    start = ss.assembly(ss.spheres([[0, 0, 0], [1.001, 0, 0]], 0.5))
    velocity = np.array([[0.05, 0, 0], [-0.05, 0, 0]])
    law = ss.laws.hertz_mindlin_reff(damping="coeff_restitution", damping_n=0.6)
    end, _, _ = ss.run(start._replace(grains=start.grains._replace(velocity=velocity)), law, 20_000, 5e-4)
    assert end.grains.velocity[1, 0] == pytest.approx(0.6 * 0.05, rel=1e-4)


def test_without_restitution_there_are_no_dashpots_and_more_than_one_is_refused():
    law = ss.laws.linear(damping="tsuji")
    assert ss.laws.collision(law, radius=0.5, mass=1.0, speed=0.1).restitution == pytest.approx(1.0, abs=1e-9)
    with pytest.raises(ValueError, match=r"damping_n = 1.5 was given: .* the coefficient of restitution, from 0"):
        ss.laws.linear(damping="coeff_restitution", damping_n=1.5)
    with pytest.raises(ValueError, match="damping_n = 2 was given"):
        ss.laws.for_pair(law, 0, 1, damping_n=2.0)
    with pytest.raises(ValueError, match="a coefficient of restitution already"):
        ss.laws.with_restitution(law, 0.5, radius=0.5, mass=1.0, speed=0.1)
