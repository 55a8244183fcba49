"""Laws with a memory of their own, and bonds that form at touch: closed forms, Jacobian, energy, lists, files."""

from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FREE
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.laws.compiled import evaluate
from stickslip.data import archive
from tests.conftest import make_packing, stirred
from tests.laws.test_mechanics import differences

EXAMPLES = Path(__file__).parents[2] / "examples"
SPEED, FAST = 0.01, 0.02


def plastic(**parameters):
    return ss.laws.from_file(EXAMPLES / "walton_braun_law.py", **{"k_unload": 4.0} | parameters)


def wet(**parameters):
    return ss.laws.liquid_bridge(**{"surface_tension": 3e-4, "volume": 1e-5} | parameters)


def moving_pairs(gap=1e-3, speed=SPEED, n=1):
    """Pairs of unit spheres, far apart, that approach head-on."""
    x = 3.0 * np.arange(n)
    position = np.stack([np.stack([x, 0 * x, 0 * x], axis=1), np.stack([x, 0 * x + 1 + gap, 0 * x], axis=1)])
    state = ss.assembly(ss.spheres(position.reshape(-1, 3), 0.5))
    velocity = np.repeat([[0, 0.5 * speed, 0], [0, -0.5 * speed, 0]], n, axis=0)
    return state._replace(grains=state.grains._replace(velocity=velocity))


def relative_speed(state):
    return float(state.grains.velocity[-1, 1] - state.grains.velocity[0, 1])


# ---- memory


@pytest.mark.parametrize(
    ("make", "ratio"), [(plastic, 10.0), (ss.laws.walton_braun, 1.0), (ss.laws.walton_braun, 10.0)]
)
def test_spheres_rebound_as_the_plastic_law_says(make, ratio):
    law, start = make(k_unload=ratio), moving_pairs()
    m_eff = 0.5 * start.grains.mass[0]
    end, record, _ = ss.run(start, law, 4000, 1e-3, every=10, ledger=True)
    assert (end.contacts.mode == ss.OPEN).all()
    assert relative_speed(end) / SPEED == pytest.approx(ratio**-0.5, rel=1e-5)
    energy = 0.5 * m_eff * SPEED**2
    assert record.ledger.nonpotential[-1] == pytest.approx(-energy * (1 - 1 / ratio), rel=1e-4, abs=1e-5 * energy)
    assert np.abs(record.ledger.defect).max() < 1e-5 * energy


def test_the_memory_is_the_deepest_overlap_until_the_contact_opens():
    law, start = plastic(), moving_pairs(gap=-0.0)
    m_eff = 0.5 * start.grains.mass[0]
    half = np.pi * np.sqrt(m_eff)  # until the overlap is largest, and until the force vanishes
    turned, _, _ = ss.run(start, law, 3000, half * (0.5 + 0.5 * 0.3) / 3000)
    assert turned.contacts.rolling[0, 0] == pytest.approx(SPEED * np.sqrt(m_eff), rel=1e-6)
    assert 0 < ss.measure.overlaps(turned)[0] < turned.contacts.rolling[0, 0]
    # spheres that are pushed together again are elastic up to the deepest overlap
    grains = turned.grains
    again, record, _ = ss.run(
        turned._replace(grains=grains._replace(velocity=-0.5 * grains.velocity)), law, 500, 1e-3, every=1, ledger=True
    )
    assert again.contacts.rolling[0, 0] == turned.contacts.rolling[0, 0]
    assert not record.ledger.nonpotential.any()
    loads, _ = ss.forces(turned, law)
    plain = turned.contacts._replace(mode=0 * turned.contacts.mode)
    new, _ = ss.forces(turned._replace(contacts=plain), law)
    assert new.force[0, 1] == pytest.approx(-ss.measure.overlaps(turned)[0], rel=1e-12)  # as if just closed
    assert abs(loads.force[0, 1]) < 0.9 * abs(new.force[0, 1])


def packed(dim=3, make=plastic):
    """A packing with contacts that unload; each has a memory."""
    law = ss.laws.for_pair(make(damping_n=0.1, kt=0.8, k_unload=4.0), 0, 1, mu=0.3, k_unload=3.0)
    for seed in range(100):
        state = stirred(make_packing(dim, seed=seed), law, np.random.default_rng(seed), size=0.03)
        rows = ss.measure.touching(state)
        kept, overlap = state.contacts.rolling[rows, 0], ss.measure.overlaps(state)[rows]
        presses = overlap - 0.75 * kept
        unloads = (kept > overlap + 1e-3) & (presses > 1e-3)
        if unloads.any() and (kept == overlap).any() and np.abs(presses).min() > 1e-3:
            return state, law
    raise AssertionError("no suitable packing")


@pytest.mark.parametrize(("dim", "make"), [(2, plastic), (3, plastic), (3, ss.laws.walton_braun)])
def test_the_jacobian_is_exact_at_a_memory_that_is_kept(dim, make):
    state, law = packed(dim, make)
    free = ss.freedom(state)
    for seed in range(20):  # away from where loading turns to unloading
        moved = ss.modes.displaced(state, free, np.random.default_rng(seed).normal(0, 1e-3, len(free)))
        moved = with_neighbor_list(moved, law)
        trial = ss.forces(moved, law)[1]
        rows = np.flatnonzero(trial.mode[: trial.count[0]] != ss.OPEN)
        kept, overlap = moved.contacts.rolling[rows, 0], ss.measure.overlaps(moved)[rows]
        if np.abs(kept - overlap).min() > 1e-5 and ((kept > overlap).any() and (kept < overlap).any()):
            break
    exact = ss.modes.assembled(moved, ss.modes.contact_blocks(moved, law, memory=FREE)[0], free).toarray()
    numerical = differences(moved, law, free, FREE, 1e-7)
    np.testing.assert_allclose(exact, numerical, atol=3e-7 * np.abs(exact).max())


@pytest.mark.parametrize("make", [plastic, ss.laws.walton_braun])
def test_memory_is_trial_until_accepted_kept_by_new_lists_and_by_archives(make, tmp_path):
    state, law = packed(make=make)
    before = state.contacts.rolling.copy()
    shift = np.zeros_like(state.grains.position)
    shift[::2, 2] = 0.01
    ss.forces(state._replace(grains=state.grains._replace(position=state.grains.position + shift)), law)
    np.testing.assert_array_equal(state.contacts.rolling, before)
    renewed = with_neighbor_list(state._replace(contacts=state.contacts._replace(stale=True)), law)
    count = int(state.contacts.count[0])
    np.testing.assert_array_equal(renewed.contacts.rolling[:count], before[:count])
    _, trial = ss.forces(state, law)
    np.testing.assert_array_equal(trial.rolling, before)  # a second update changes nothing
    whole, _, _ = ss.run(state, law, 400, 0.02)
    half, _, _ = ss.run(state, law, 200, 0.02, threads=2)
    archive.write(tmp_path / "half.h5", {"state": half, "law": law})
    back = archive.read(tmp_path / "half.h5")
    rest, _, _ = ss.run(back["state"], back["law"], 200, 0.02)
    np.testing.assert_array_equal(rest.grains.position, whole.grains.position)
    rows = ss.measure.touching(whole)
    np.testing.assert_array_equal(rest.contacts.rolling[ss.measure.touching(rest)], whole.contacts.rolling[rows])


def test_two_memories_and_rolling_stand_side_by_side():
    law = ss.laws.custom(
        normal_force=lambda overlap, deepest, kn: kn * (overlap + 0.1 * (deepest - overlap)),
        update=lambda overlap, r_eff, deepest, widest: (max(overlap, deepest), max(r_eff, widest)),
        rolling_stiffness=lambda widest, kn: kn * widest, rolling_cap=lambda normal_force: 0.1 * normal_force,
        memory={"deepest": 0.0, "widest": 0.125}, parameters={"kn": 2.0, "kt": 1.0, "mu": 0.5},
    )  # fmt: skip
    start = moving_pairs(gap=-0.01)
    start = start._replace(grains=start.grains._replace(spin=np.array([[0, 0, 0.01], [0, 0, 0]])))
    end, record, _ = ss.run(start, law, 100, 1e-2, every=1, ledger=True)
    assert end.contacts.rolling.shape == (1, 9)
    assert end.contacts.rolling[0, 8] == 0.25 and end.contacts.rolling[0, 7] > 0.01
    assert end.contacts.rolling[0, 2] != 0
    assert np.abs(record.ledger.defect).max() < 1e-3 * record.ledger.kinetic.max()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"memory": {"deepest": 0.0}}, "a law with memory needs both memory and update"),
        ({"update": lambda overlap: overlap}, "a law with memory needs both memory and update"),
        ({"memory": {"kn": 0.0}, "update": lambda overlap: overlap}, "name of a memory must be a unique identifier"),
        ({"memory": {"old": "x"}, "update": lambda overlap: overlap}, "must be a finite number"),
        ({"memory": {"old": 0.0}, "update": lambda old: old + 1}, "a second update must not change it"),
        ({"memory": {"old": 0.0}, "update": lambda old, overlap: (old, overlap)}, "must be a finite number"),
        ({"memory": {"old": 0.0}, "update": lambda far: far}, "'far', which is not a parameter: .*, old"),
        ({"bonds": True}, "requires contact_range"),
    ],
)
def test_a_memory_that_cannot_be_used_is_refused(more, message):
    with pytest.raises(ValueError, match=message):
        ss.laws.custom(normal_force=lambda overlap, kn: kn * overlap, **more)


# ---- bonds


@pytest.mark.parametrize("n", [1, 60])  # by rows, and in blocks
def test_a_bridge_forms_at_touch_and_breaks_at_its_range(n):
    law, start = wet(), moving_pairs(n=n, gap=0.015, speed=FAST)
    reach = law.table[0, 0, -1] ** (1 / 3)
    states = [start]
    for _ in range(24):
        states.append(ss.run(states[-1], law, 500, 1e-3, threads=1)[0])
    gaps = np.array([float(state.grains.position[-1, 1] - state.grains.position[0, 1]) - 1 for state in states])
    holds = np.array([(state.contacts.mode != ss.OPEN).sum() for state in states])
    assert set(holds) == {0, n}
    assert (gaps[0] > 0) and (gaps[0] < reach) and holds[0] == 0 and relative_speed(states[1]) == -FAST
    away = np.array([relative_speed(state) > 0 for state in states])
    assert (holds[away] == n * (gaps[away] < reach)).all() and (holds[away] == n).any() and (holds[away] == 0).any()
    across = states[int(np.flatnonzero(away & (gaps > 0) & (holds > 0))[0])]
    pull = ss.forces(across, law)[0].force[0, 1]
    gap = ss.measure.overlaps(across)[-1]
    assert pull == pytest.approx(-evaluate(law, "force", overlap=gap, r_eff=0.25), rel=1e-9) and pull > 0
    energy = 0.25 * start.grains.mass[0] * FAST**2
    lost = energy - 0.25 * start.grains.mass[0] * relative_speed(states[-1]) ** 2
    bond = -evaluate(law, "energy", overlap=1e-12, r_eff=0.25)
    assert lost == pytest.approx(bond, rel=1e-2)  # what tears the bridge


def test_rows_and_blocks_agree_on_bonds():
    ends = [ss.run(moving_pairs(n=n, gap=0.01), wet(damping_n=0.01), 6000, 1e-3)[0] for n in (1, 60)]
    np.testing.assert_allclose(ends[0].grains.position[-1, 1], ends[1].grains.position[-1, 1], rtol=1e-12)


def test_the_energy_of_a_bond_is_lost_as_it_forms_and_none_as_it_breaks():
    law, start = wet(), moving_pairs(gap=0.01, speed=FAST)
    _, record, _ = ss.run(start, law, 12000, 1e-3, every=10, ledger=True)
    bond = -evaluate(law, "energy", overlap=1e-12, r_eff=0.25)
    lost = record.ledger.nonpotential
    assert set(np.round(lost / bond, 2)) == {0.0, -1.0}
    assert np.abs(record.ledger.defect).max() < 1e-4 * bond
    assert record.ledger.normal[-1] == 0.0 and record.ledger.normal.min() < 0


@pytest.mark.parametrize("dim", [2, 3])
def test_the_jacobian_and_trials_of_bonds(dim):
    """Contacts that have touched pull across gaps; pairs as close that have not do nothing."""
    law = ss.laws.for_pair(wet(volume=1e-3), 0, 1, mu=0.3)
    for seed in range(100):
        state = stirred(make_packing(dim, seed=seed), law, np.random.default_rng(seed), size=0.03)
        count = int(state.contacts.count[0])
        gap, mode = -ss.measure.overlaps(state), state.contacts.mode[:count]
        far = (mode == ss.OPEN) & (gap < 0.099)
        if ((gap > 1e-3) & (mode != ss.OPEN)).any() and far.any() and np.abs(gap).min() > 1e-3:
            break
    assert far.any() and (gap[far] > 0).all()
    free = ss.freedom(state)
    exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[0], free).toarray()
    numerical = differences(state, law, free, 1, 1e-7)
    np.testing.assert_allclose(exact, numerical, atol=1e-6 * np.abs(exact).max())
    assert state.contacts.mode[np.flatnonzero(far)].max() == ss.OPEN


def test_the_bridge_is_that_of_rabinovich():
    law = wet(surface_tension=1.0, volume=1e-3)
    radius, gap = 0.5, np.array([0.0, 0.01, 0.05])

    def form(g):
        return 2 * np.pi * radius * (1 - 1 / np.sqrt(1 + 2e-3 / (np.pi * radius * np.maximum(g, 1e-30) ** 2)))

    np.testing.assert_allclose(
        -evaluate(law, "force", overlap=-gap, r_eff=0.25), form(gap) - form(np.array(0.1)), rtol=1e-12
    )


def jkr(**parameters):
    return ss.laws.jkr(**{"kt": 0.8, "work": 1e-3} | parameters)


def test_the_adhesive_law_is_that_of_johnson_kendall_and_roberts():
    law, work, r_eff = jkr(), 1e-3, 0.25
    modulus = 0.75
    pull_off = (r_eff / 4 * np.sqrt(2 * np.pi * work / modulus)) ** (2 / 3)
    a = np.geomspace(1.001 * pull_off, 0.2, 400)
    overlap = a**2 / r_eff - np.sqrt(2 * np.pi * work * a / modulus)
    force = 4 * modulus * a**3 / (3 * r_eff) - np.sqrt(8 * np.pi * work * modulus * a**3)
    computed = evaluate(law, "force", overlap=overlap, r_eff=r_eff)
    np.testing.assert_allclose(computed, force, rtol=0, atol=1e-10 * np.abs(force).max())
    fine = np.linspace(overlap[0], 0.01, 100_001)
    assert evaluate(law, "force", overlap=fine, r_eff=r_eff).min() == pytest.approx(
        -1.5 * np.pi * work * r_eff, rel=1e-8
    )
    reach = evaluate(law, "range", overlap=0.0, r_eff=r_eff)
    end = evaluate(law, "force", overlap=-reach * (1 - 1e-9), r_eff=r_eff)
    assert end == pytest.approx(-5 / 6 * np.pi * work * r_eff, rel=1e-3)  # displacement, not force, is imposed
    weak, hertz = jkr(work=1e-8), ss.laws.hertz_mindlin_reff(kn=1.0, kt=0.8)
    for name in ("force", "stiffness"):
        values = [evaluate(either, name, overlap=[0.01, 0.02], r_eff=r_eff) for either in (weak, hertz)]
        np.testing.assert_allclose(*values, rtol=2e-2)


def test_the_energy_of_pull_off_is_booked():
    law, start = jkr(mu=0.0), moving_pairs(gap=0.001, speed=0.05)
    energy = 0.25 * start.grains.mass[0] * 0.05**2
    defects = []
    for dt in (8e-3, 2e-3):
        end, record, _ = ss.run(start, law, round(10 / dt), dt, every=5, ledger=True)
        defects.append(np.abs(record.ledger.defect).max() / energy)
    assert (end.contacts.mode == ss.OPEN).all() and relative_speed(end) > 0
    bond = -evaluate(law, "energy", overlap=1e-12, r_eff=0.25)
    lost = energy - 0.25 * start.grains.mass[0] * relative_speed(end) ** 2
    assert lost == pytest.approx(bond, rel=1e-2)
    assert defects[1] < 1e-4 and defects[1] < 0.3 * defects[0]
