"""Properties of laws: exact Jacobian, balance of energy, rows and blocks, restart, and what each of them means."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FREE, HELD
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.dynamics import driver
from stickslip.core.laws.builtin import ROLLING, TWISTING, with_values
from stickslip.core.laws.compiled import law_struct
from stickslip.data import archive
from tests.conftest import make_packing, stirred
from tests.derivatives.test_jacobian import random_ways
from tests.laws.test_mechanics import differences, rate_differences


def rolling(law, k_roll=0.1, mu_roll=0.15, **more):
    return ss.laws.with_rolling(law, k_roll=k_roll, mu_roll=mu_roll, **more)


def twisting(law, k_twist=0.01, mu_twist=0.05, **more):
    return ss.laws.with_twisting(law, k_twist=k_twist, mu_twist=mu_twist, **more)


LAWS = {
    "rolling": lambda **more: rolling(ss.laws.hertz_mindlin(kt=0.8, **more)),
    "twisting": lambda **more: twisting(ss.laws.hertz_mindlin(kt=0.8, **more)),
    "dashpots of moments": lambda **more: twisting(
        rolling(ss.laws.hertz_mindlin(kt=0.8, **more), mu_roll=20.0, gamma_roll=0.05), mu_twist=5.0, gamma_twist=0.01
    ),
    "constant": lambda **more: ss.laws.with_rolling(
        ss.laws.hertz_mindlin(kt=0.8, **more), "constant", mu_roll=0.1, gamma_roll=0.05
    ),
    "viscous": lambda **more: ss.laws.with_rolling(ss.laws.linear(kt=0.8, **more), "viscous", gamma_roll=2.0),
    "everything": lambda **more: ss.laws.with_lever(
        twisting(rolling(ss.laws.jkr(kt=0.8, work=5e-3, **more))), "overlap"
    ),
    "arms": lambda **more: ss.laws.with_lever(ss.laws.hertz_mindlin(kt=0.8, **more), "overlap"),
    "smooth arms": lambda **more: ss.laws.with_lever(ss.laws.hertz_mindlin(coulomb="smooth", **more), "overlap"),
    "arms and rescaling": lambda **more: ss.laws.with_lever(
        ss.laws.hertz_mindlin_reff(rescaled=True, **more), "overlap"
    ),
    "marshall": lambda **more: ss.laws.with_twisting(ss.laws.hertz_mindlin_reff(kt=0.8, **more), "marshall"),
    "marshall and jkr": lambda **more: ss.laws.with_twisting(ss.laws.jkr(kt=0.8, work=5e-3, **more), "marshall"),
    "marshall and linear": lambda **more: ss.laws.with_twisting(ss.laws.linear(kt=0.8, **more), "marshall"),
    "forces": lambda **more: ss.laws.with_memory(ss.laws.hertz_mindlin_reff(kt=0.8, **more), "force"),
    "smooth forces": lambda **more: ss.laws.with_memory(ss.laws.hertz_mindlin_reff(coulomb="smooth", **more), "force"),
    "forces and arms": lambda **more: ss.laws.with_lever(
        ss.laws.with_memory(ss.laws.jkr(kt=0.8, work=5e-3, **more), "force"), "overlap"
    ),
    "forces and rescaling": lambda **more: ss.laws.with_memory(
        ss.laws.hertz_mindlin_reff(kt=0.8, rescaled=True, **more), "force"
    ),
    "coeff_restitution": lambda **more: ss.laws.hertz_mindlin_reff(
        **more | {"damping": "coeff_restitution", "damping_n": 0.5}
    ),
    "jkr": lambda **more: ss.laws.jkr(kt=0.8, work=5e-3, **more),
    "dmt": lambda **more: ss.laws.dmt(kt=0.8, work=1e-3, **more),
    "liquid_bridge": lambda **more: ss.laws.liquid_bridge(surface_tension=1e-3, volume=1e-4, **more),
}
PLANE = ("rolling", "everything", "smooth arms", "marshall", "forces and rescaling", "dmt")  # also in the plane
EVERY = pytest.mark.parametrize(("name", "dim"), [*((name, 3) for name in LAWS), *((name, 2) for name in PLANE)])


@cache
def packed(name, dim, **more):
    """A packing whose contacts have committed memory, far from kinks; some slide, some stick; found once."""
    law = ss.laws.for_pair(LAWS[name](**{"mu": 0.5, "damping_n": 0.1} | more), 0, 1, mu=0.3, kn=1.3)
    for seed in range(300):
        state = stirred(make_packing(dim, seed=seed), law, np.random.default_rng(seed), size=0.05)
        count = int(state.contacts.count[0])
        mode, gap = state.contacts.mode[:count], -ss.measure.overlaps(state)
        slips = np.linalg.norm(state.contacts.slip[:count], axis=1)[(mode == ss.SLIDE) & (gap < 0)]
        slightest = np.linalg.norm(state.contacts.slip[:count], axis=1)[(mode == ss.STICK) & (gap < 0)].min(initial=1.0)
        good = (
            (name != "smooth forces" or slightest > 1e-3)
            and len(slips)
            and slips.min() > 0.02
            and (mode == ss.STICK).any()
            and np.abs(gap).min() > 2e-3
        )
        memory = state.contacts.rolling
        if good and memory is not None:
            turned, at_cap = np.linalg.norm(memory[:count, :3], axis=1), memory[:count, 6] > 0
            good = not (at_cap & (turned > 0) & (turned < 0.01)).any()
        if good and state.cell.dim == 3 and name in ("rolling", "twisting", "everything"):
            parts = (6, ROLLING), (8, TWISTING)
            caps = [memory[:count, k][mode > 0] for k, part in parts if law.properties & part]
            good = all(0 < at_cap.sum() < len(at_cap) for at_cap in caps)
        if good:
            return state, law
    raise AssertionError("no suitable packing")


@EVERY
def test_jacobian_and_damping_matrix_are_exact(name, dim):
    state, law = start, _ = packed(name, dim)
    free, count = ss.freedom(state), int(state.contacts.count[0])
    ways = random_ways(free)
    for memory, step in ((HELD, 3e-7), (FREE, 1e-7)):
        if memory == FREE:  # as in a solver: what is not committed moves on
            way = np.random.default_rng(3).normal(0, 3e-4, len(free))
            state = with_neighbor_list(ss.modes.displaced(state, free, way))
        elif "rescaling" in name:
            continue  # only one-sided derivatives where the memory was committed
        exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law, memory=memory)[0], free)
        numerical = differences(state, law, free, memory, step, ways)
        # h² f''' with lengths of 0.02 and round-off over h are both of order 1e-9
        np.testing.assert_allclose(exact @ ways, numerical, rtol=0, atol=3e-8 * np.abs(exact.data).max())
    rub = ss.modes.assembled(start, ss.modes.contact_blocks(start, law)[1], free)
    slow = rate_differences(start, law, free, 1e-7, ways)
    np.testing.assert_allclose(rub @ ways, slow, rtol=0, atol=1e-8 * np.abs(rub.data).max())
    assert count == int(state.contacts.count[0])


def moving(name, dim, speed=0.03, **more):
    """A packing in motion, without dashpots unless they are given."""
    state, law = packed(name, dim, **{"damping_n": 0.0} | more)
    rng, n = np.random.default_rng(0), len(state.grains.radius)
    move, turn = rng.normal(0, speed, (2, n, 3))
    if dim == 2:
        move[:, 2] = turn[:, :2] = 0
    return state._replace(grains=state.grains._replace(velocity=move, spin=6 * turn)), law


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


@pytest.mark.parametrize(
    ("name", "update"),
    [*((name, "difference") for name in LAWS), ("dashpots of moments", "rate"), ("everything", "rate")],
)
def test_a_run_goes_on_to_the_last_bit_through_an_archive(name, update, tmp_path):
    state, law = moving(name, 3, damping_n=0.02, damping_t=0.02)
    whole, _, _ = ss.run(state, law, 120, 0.02, slip_update=update)
    half, _, _ = ss.run(state, law, 60, 0.02, slip_update=update)
    archive.write(tmp_path / "half.h5", {"state": half, "law": law})
    back = archive.read(tmp_path / "half.h5")
    assert repr(back["law"]) == repr(law)
    rest, _, _ = ss.run(back["state"], back["law"], 60, 0.02, slip_update=update)
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
    single, _, _ = ss.run(state, law, 200, 0.02, threads=1)
    double, _, _ = ss.run(state, law, 200, 0.02, threads=2)
    np.testing.assert_array_equal(single.grains.position, double.grains.position)
    monkeypatch.setattr(driver, "MIN_BODIES", 10**9)
    plain, _, _ = ss.run(state, law, 200, 0.02)
    np.testing.assert_allclose(single.grains.position, plain.grains.position, atol=1e-11)
    # the memory that statics need: two forces of one state
    again = ss.forces(single, law, memory=HELD)[0]
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
        law = twisting(
            rolling(ss.laws.linear(kn=1.0, kt=0.5, mu=0.5, damping_n=0.02, damping_t=0.02)), gamma_twist=0.01
        )
        law = ss.laws.with_lever(law, arm)
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
        shorter = ss.laws.with_lever(law, arm)
        here = ss.accept(state, ss.forces(state, shorter)[1])
        here = here._replace(grains=here.grains._replace(position=np.array([[0.01, 0, 0.44]])))
        torques.append(ss.forces(here, shorter)[0].torque[0])
    np.testing.assert_array_equal(*torques)


def test_energy_is_balanced_with_the_slip_of_lammps():
    """Its slip takes R and its torques R − δ/2; the energy so created is `nonpotential`."""
    law = ss.laws.with_lever(ss.laws.linear(kn=1.0, kt=0.5, mu=10.0), "overlap")
    _, record, _ = ss.run(spinning_pair(), law, 150, 0.02, every=1, ledger=True, slip_update="rate")
    assert np.abs(record.ledger.nonpotential).max() > 10 * np.abs(record.ledger.defect).max()


def test_a_wrong_arm_is_refused():
    with pytest.raises(ValueError, match="arm must be 'radius' or 'overlap', got 'centre'"):
        ss.laws.with_lever(ss.laws.linear(), "centre")


# ---- memory of forces


@pytest.mark.parametrize("update", ["difference", "rate"])
def test_a_sticking_contact_keeps_its_force_as_the_overlap_changes(update):
    """F_t is that of the deepest overlap under a memory of forces; rescaled, it shrinks with √δ only."""
    place = [[0, 0, 0], [0.98, 0, 0]]
    deep, shallow = np.sqrt([0.04 / 0.02, 0.01 / 0.02])
    wanted = {
        (False, "slip"): (deep, shallow), (True, "slip"): (deep, shallow**2 / deep),
        (False, "force"): (1.0, 1.0), (True, "force"): (1.0, shallow / deep),
    }  # fmt: skip
    for (rescaled, memory), factors in wanted.items():
        law = ss.laws.with_memory(ss.laws.hertz_mindlin(kt=0.5, mu=5.0, rescaled=rescaled), memory)
        state = ss.assembly(ss.spheres(place, 0.5))
        state = ss.accept(state, ss.forces(state, law)[1])
        state.contacts.slip[0] = [0, 1e-3, 0]
        first = ss.forces(state, law)[0].force[0, 1]
        for gap, factor in zip((0.96, 0.99), factors, strict=True):
            rate = np.zeros((2, 6))
            rate[1, 0] = gap - state.grains.position[1, 0]
            control = ss.control.loads(2)._replace(free=np.zeros((2, 6), bool), rate=rate)
            state, _, _ = ss.run(state._replace(control=control), law, 10, 0.1, slip_update=update)
            assert ss.forces(state, law)[0].force[0, 1] / first == pytest.approx(factor, rel=1e-9)


def test_an_unknown_memory_is_refused():
    with pytest.raises(ValueError, match="of must be 'slip' or 'force', got 'work'"):
        ss.laws.with_memory(ss.laws.linear(), "work")


# ---- rolling and twisting

RADIUS, OVERLAP = 0.5, 0.02


def turning_pair(axis, spin=0.1):
    """Two spheres held in place that rotate against each other: they roll or twist, but do not slip."""
    grains = ss.spheres([[0, 0, 0], [2 * RADIUS - OVERLAP, 0, 0]], RADIUS)
    free = np.zeros((2, 6), bool)
    free[:, 3:] = True
    state = ss.assembly(grains, control=ss.control.loads(2)._replace(free=free))
    turn = np.array([spin, -spin])[:, None] * np.asarray(axis, float)
    return state._replace(grains=state.grains._replace(spin=turn))


def spins_of(law, axis, duration, steps=4000):
    """Spin of the first sphere at the end."""
    end, _, _ = ss.run(turning_pair(axis), law, steps, duration / steps)
    return float(end.grains.spin[0] @ np.asarray(axis, float))


def growing_stiffness(overlap, kn):
    return 0.3 * kn * (1 + 20 * overlap)


def test_the_jacobian_contains_a_rolling_stiffness_that_depends_on_the_overlap():
    """At the cap, where the memory is the cap over the stiffness."""
    law = ss.laws.custom(
        normal_force=lambda overlap, kn: kn * overlap, rolling_stiffness=growing_stiffness,
        rolling_cap=lambda normal_force, r_eff: 0.1 * r_eff * max(normal_force, 0.0),
        parameters={"kn": 1.0, "kt": 0.5, "mu": 0.5},
    )  # fmt: skip
    state, _, _ = ss.run(turning_pair((0, 0.6, 0.8), spin=0.3), law, 100, 0.01)
    assert state.contacts.rolling[0, 6] > 0
    state = state._replace(control=ss.control.loads(2))
    free = ss.freedom(state)
    state = with_neighbor_list(ss.modes.displaced(state, free, np.random.default_rng(1).normal(0, 3e-3, len(free))))
    exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law, memory=FREE)[0], free).toarray()
    numerical = differences(state, law, free, FREE, 1e-7)
    np.testing.assert_allclose(exact, numerical, rtol=0, atol=1e-7 * np.abs(exact).max())


def test_viscous_rolling_decays_exponentially():
    law, inertia = (
        ss.laws.with_rolling(ss.laws.linear(mu=0.5), "viscous", gamma_roll=3.0),
        turning_pair([0, 0, 1]).grains.inertia[0],
    )
    rate = 2 * 3.0 * OVERLAP * (RADIUS / 2) ** 2 / inertia  # both spheres turn
    assert spins_of(law, [0, 0, 1], 2 / rate) == pytest.approx(0.1 * np.exp(-2.0), rel=1e-5)


def test_a_constant_moment_stops_rolling_in_a_given_time():
    law = ss.laws.with_rolling(ss.laws.linear(mu=0.5), "constant", mu_roll=0.2, gamma_roll=20.0)
    slowing = 0.2 * (RADIUS / 2) * OVERLAP / turning_pair([0, 0, 1]).grains.inertia[0]
    stop = 0.1 / slowing
    assert spins_of(law, [0, 0, 1], 0.5 * stop) == pytest.approx(0.05, rel=1e-5)
    assert abs(spins_of(law, [0, 0, 1], 1.5 * stop)) < 1e-6


@pytest.mark.parametrize(("axis", "stiffness"), [([0, 0, 1], 0.3 * (RADIUS / 2) ** 2), ([1, 0, 0], 0.04)])
@pytest.mark.parametrize("gamma", [0.0, 0.2])
def test_springs_of_rolling_and_twisting_swing_freely(axis, stiffness, gamma):
    damping = gamma * stiffness
    law = rolling(ss.laws.linear(mu=0.5), 0.3, mu_roll=50.0, gamma_roll=0.3 * gamma)
    law = twisting(law, 0.04, mu_twist=50.0, gamma_twist=0.04 * gamma)
    inertia = turning_pair(axis).grains.inertia[0]
    decay, omega = damping / inertia, np.sqrt(2 * stiffness / inertia)
    swing = np.sqrt(omega**2 - decay**2)
    time = 2.3 / omega
    expected = 0.1 * np.exp(-decay * time) * (np.cos(swing * time) - decay / swing * np.sin(swing * time))
    assert spins_of(law, axis, time) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("axis", "moment"), [([0, 0, 1], 0.05 * RADIUS / 2), ([1, 0, 0], 0.01)])
def test_moments_have_caps_and_common_rotation_is_free(axis, moment):
    law = twisting(rolling(ss.laws.linear(mu=0.5), mu_roll=0.05), mu_twist=0.01)
    state, axis = turning_pair(axis, 0.0), np.asarray(axis, float)
    state = ss.accept(state, ss.forces(state, law)[1])
    for sign in (1, -1):
        turned = state.grains._replace(angle=sign * np.array([2.0, -2.0])[:, None] * axis)
        torque = ss.forces(state._replace(grains=turned), law)[0].torque
        np.testing.assert_allclose(torque, -sign * moment * OVERLAP * np.outer([1, -1], axis), atol=1e-15)
    turned = state.grains._replace(angle=np.full((2, 3), 0.2) * axis)
    loads = ss.forces(state._replace(grains=turned), law)[0]
    assert np.abs(np.cross(axis, loads.torque)).max() < 1e-15  # friction only, where there is slip


def test_without_friction_there_are_no_moments():
    law = twisting(rolling(ss.laws.linear(mu=0.0), gamma_roll=1.0), gamma_twist=1.0)
    for axis in ([0, 0, 1], [1, 0, 0]):
        assert spins_of(law, axis, 10.0, steps=100) == 0.1


def test_rolling_in_python_is_the_built_in_spring():
    """Model C as a user writes it, with k_r = k R_eff² and the cap μ_r R_eff F_n."""
    law = rolling(ss.laws.linear(kt=0.8, mu=0.5), 0.4, mu_roll=0.1)
    own = ss.laws.custom(
        normal_force=lambda overlap, kn: kn * overlap, rolling_stiffness=lambda r_eff, k: k * r_eff**2,
        rolling_cap=lambda normal_force, r_eff, mu_r: mu_r * r_eff * max(normal_force, 0.0),
        parameters={"kn": 1.0, "kt": 0.8, "mu": 0.5, "k": 0.4, "mu_r": 0.1},
    )  # fmt: skip
    state, _ = moving("rolling", 3)
    state = state._replace(contacts=state.contacts._replace(stale=True, rolling=None))
    ends = [ss.run(state, ss.laws.for_pair(form, 0, 1, mu=0.3), 200, 0.02)[0] for form in (law, own)]
    np.testing.assert_allclose(ends[0].grains.angle, ends[1].grains.angle, atol=1e-12)


def test_marshall_takes_its_numbers_from_each_pair():
    law = ss.laws.with_twisting(ss.laws.for_pair(ss.laws.linear(kt=0.8, mu=0.6), 0, 1, mu=0.3), "marshall")
    np.testing.assert_allclose(law.table[0, :, 5:], [[0.4, 0.4, 0.5], [0.4, 0.2, 0.5]])
    back = twisting(law)
    assert law_struct(law)["twist_scaled"] and not law_struct(back)["twist_scaled"]
    with pytest.raises(ValueError, match="follow from kt and mu: omit them"):
        ss.laws.with_twisting(law, "marshall", k_twist=1.0)
    with pytest.raises(ValueError, match="model must be 'spring' or 'marshall', got 'disc'"):
        ss.laws.with_twisting(law, "disc")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "elastic"}, "model must be 'constant', 'viscous' or 'spring', got 'elastic'"),
        ({"k_roll": 1.0}, "with model = 'spring', mu_roll must be positive, got 0.0"),
        ({"model": "viscous", "gamma_roll": 1.0, "mu_roll": 0.1}, "mu_roll does not apply: leave it out"),
        ({"model": "constant", "mu_roll": 0.1}, "gamma_roll must be positive, got 0.0"),
    ],
)
def test_wrong_parameters_of_rolling_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ss.laws.with_rolling(ss.laws.linear(), **options)


def test_parameters_of_moments_have_names():
    law = twisting(rolling(ss.laws.linear()))
    assert all(text in repr(law) for text in ("k_roll = 0.1, mu_roll = 0.15, k_twist = 0.01", "mu_twist = 0.05"))
    law = ss.laws.for_pair(law, 0, 1, mu_roll=0.3)
    assert law.table[0, 1, 6] == 0.3 and law.table[0, 0, 6] == 0.15
    again = ss.laws.with_rolling(law, "viscous", gamma_roll=1.0)
    assert again.table.shape == law.table.shape and again.table[0, 0, 8] == 0.01
    own = ss.laws.custom(normal_force=lambda overlap, kn: kn * overlap, parameters={"k_roll": 1.0, "mu": 0.5})
    with pytest.raises(ValueError, match="the law already has a parameter k_roll: rename it"):
        rolling(own)
    struct = law_struct(ss.laws.with_lever(twisting(own), "overlap"))
    assert (struct["roll_at"], struct["twist_at"]) == (0, 6)
    with pytest.raises(ValueError, match=r"mu_roll must be finite and not negative, got -1.0"):
        ss.laws.for_pair(law, 0, 1, mu_roll=-1.0)


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
    with pytest.raises(
        ValueError, match=r"damping_n is the coefficient of restitution .* must be from 0 .* to 1, got 1.5"
    ):
        ss.laws.linear(damping="coeff_restitution", damping_n=1.5)
    with pytest.raises(ValueError, match=r"damping_n is .* must be from 0 .* to 1, got 2"):
        ss.laws.for_pair(law, 0, 1, damping_n=2.0)
    with pytest.raises(ValueError, match="already a coefficient of restitution"):
        ss.laws.with_restitution(law, 0.5, radius=0.5, mass=1.0, speed=0.1)


def test_marshall_s_twisting_follows_from_kt_and_mu_whenever_they_change():
    """Between two materials and everywhere; pairs without twisting stay without."""
    plain = ss.laws.linear(kt=0.8, mu=0.6)
    changed = ss.laws.for_pair(ss.laws.with_twisting(plain, "marshall"), 0, 1, mu=0.06, kt=0.4)
    known = ss.laws.with_twisting(ss.laws.for_pair(plain, 0, 1, mu=0.06, kt=0.4), "marshall")
    np.testing.assert_array_equal(changed.table, known.table)
    bare = known._replace(table=known.table.copy())
    bare.table[0, 1, 5:] = bare.table[1, 0, 5:] = 1.0, 0.0, 0.0
    table = with_values(bare, mu=0.3).table
    assert table[0, 0, 6] == pytest.approx(0.2) and table[0, 1, 5:].tolist() == [1.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="a law has no parameter 'k_twist'"):
        ss.laws.for_pair(known, 0, 1, k_twist=0.3)


def test_a_memory_of_forces_is_that_of_slips_where_kt_is_constant():
    law = ss.laws.linear(kt=0.8)
    assert ss.laws.with_memory(law, "force") == law
    assert ss.laws.with_memory(ss.laws.dmt(work=1e-3), "force").properties


def test_a_property_replaces_the_former_one():
    law, remembers = ss.laws.linear(kt=0.8), ss.laws.with_memory(ss.laws.dmt(work=1e-3), "force")
    assert remembers.properties and not ss.laws.with_memory(remembers, "slip").properties
    rolls = ss.laws.with_rolling(law, "viscous", gamma_roll=2.0)
    assert ss.laws.with_rolling(rolls, k_roll=1.0, mu_roll=0.1).properties == ROLLING


def test_events_are_not_sought_with_a_memory_of_forces():
    law = ss.laws.with_memory(ss.laws.hertz_mindlin_reff(mu=0.5), "force")
    with pytest.raises(ValueError, match="memory of forces, but the search for events requires a memory of slips"):
        ss.protocols.find_events(ss.packings.jammed(20, packing_fraction=0.9, dim=2, seed=1)[0], law, to=1e-3, drag=0.1)


def test_files_keep_or_name_what_a_run_with_dashpots_and_a_memory_of_forces_has(tmp_path):
    law = ss.laws.with_memory(ss.laws.hertz_mindlin_reff(damping_n=0.2, damping_t=0.1), "force")
    begin = stirred(ss.packings.jammed(20, packing_fraction=0.7, seed=1)[0], law, np.random.default_rng(3))
    state, _, _ = ss.run(begin, law, 20, 0.01)
    ss.io.write_packing(tmp_path / "p.gsd", state, law)
    again = ss.run(ss.io.read_packing(tmp_path / "p.gsd").state, law, 20, 0.01)[0]
    assert (again.grains.position == ss.run(state, law, 20, 0.01)[0].grains.position).all()
    notes = ss.io.write_packing(tmp_path / "p.npz", state, law)
    assert notes == [".npz does not store the memory of forces of the law"]
    assert ss.io.read_packing(tmp_path / "p.npz").assumed == [
        "left out, as .npz does not store it: the memory of forces of the law"
    ]
