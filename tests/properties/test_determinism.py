"""The same bits on any number of threads, in any order of memory, stopped at or not; the fast way equals the plain."""

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.dynamics import driver, moving
from stickslip.loading.packing import jammed
from tests.conftest import make_law

GRAINS = ("position", "angle", "velocity", "spin")


@cache
def packed(n, dim, seed):
    """Made once for all tests, none of which writes to it."""
    return jammed(n, packing_fraction=0.66 if dim == 3 else 0.86, dim=dim, seed=seed)[0]


def flowing(n=150, dim=3, seed=0, walls=False):
    """A packing with random velocities and spins, so fast that contacts open, close and slide within 100 steps."""
    state = packed(n, dim, seed)
    rng = np.random.default_rng(seed)
    velocity, spin = rng.normal(0, 0.01, (2, n, 3))
    if dim == 2:
        velocity[:, 2] = spin[:, :2] = 0
    grains = state.grains._replace(velocity=velocity, spin=spin, mass=rng.uniform(0.5, 2.0, n))
    if not walls:
        return ss.assembly(grains, cell=state.cell, skin=0.1)
    size = state.cell.vectors[0, 0]
    up = np.eye(3)[dim - 1]
    cell = state.cell._replace(periodic=np.array([True, dim == 3, False]))
    grains = grains._replace(position=np.mod(grains.position, size))
    floor = ss.flat_walls([0 * up, size * up], [up, -up], material=1)
    force = np.zeros((n, 3))
    force[:, dim - 1] = -1e-3
    return ss.assembly(grains, floor, cell, ss.control.loads(n, 2, force=force), skin=0.1)


def same_bits(state, other):
    return all(np.array_equal(getattr(state.grains, name), getattr(other.grains, name)) for name in GRAINS)


CASES = [
    ("hertz_mindlin", "sharp", 3, {}, False),
    ("hertz_mindlin", "smooth", 2, {}, True),
    pytest.param(
        "linear",
        "smooth",
        3,
        {"damping": "mass_velocity", "damping_n": 0.02, "damping_t": 0.01},
        True,
        marks=pytest.mark.slow,
    ),
    pytest.param(
        "hertz_mindlin_reff", "sharp", 3, {"damping_n": 0.3, "damping_t": 0.15}, False, marks=pytest.mark.slow
    ),
    pytest.param("hertz_mindlin_rescaled", "sharp", 3, {}, True, marks=pytest.mark.slow),
    pytest.param(
        "hertz_mindlin_reff_rescaled", "smooth", 2, {"damping_n": 0.3, "damping_t": 0.15}, True, marks=pytest.mark.slow
    ),
    pytest.param(
        "hertz_mindlin_reff",
        "sharp",
        2,
        {"damping_n": 0.3, "damping_t": 0.15, "tension": False},
        True,
        marks=pytest.mark.slow,
    ),
]


@pytest.mark.parametrize(("law_name", "coulomb", "dim", "more", "walls"), CASES)
def test_blocks_agree_with_rows(law_name, coulomb, dim, more, walls, monkeypatch):
    law, state = make_law(law_name, coulomb, **more), flowing(dim=dim, walls=walls)
    fast, record, _ = ss.run(state, law, 100, 0.05, drag=0.01, every=10, events=True)
    monkeypatch.setattr(driver, "MIN_BODIES", 10**9)
    slow, plain, _ = ss.run(state, law, 100, 0.05, drag=0.01, every=10, events=True)
    assert plain.sliding[-1] > 10
    assert {"closed", "opened", "limit"} <= set(plain.events["kind"])
    # round-off of the positions, 1e-15, is what differs, and a hundred steps of collisions make more of it
    for name in GRAINS:
        np.testing.assert_allclose(getattr(fast.grains, name), getattr(slow.grains, name), atol=1e-11)
    for name in ("msd", "kinetic_energy", "virial", "touching", "sliding"):
        np.testing.assert_allclose(getattr(record, name), getattr(plain, name), rtol=1e-9, atol=1e-11)
    rows = [c.mode[: c.count[0]] != ss.OPEN for c in (fast.contacts, slow.contacts)]
    for name, tolerance in (("key", 0), ("mode", 0), ("reached", 0), ("slip", 1e-11), ("pair", 1e-11), ("roll", 1e-11)):
        mine, other = (getattr(c, name)[: len(r)][r] for c, r in zip((fast.contacts, slow.contacts), rows, strict=True))
        np.testing.assert_allclose(mine, other, atol=tolerance)
    known = [np.sort(r.events, order=["time", "i", "j", "kind"]) for r in (record, plain)]
    for column in ("kind", "i", "j"):
        assert np.array_equal(known[0][column], known[1][column])


@pytest.mark.parametrize(
    ("law_name", "coulomb", "dim", "more", "walls"), [pytest.param(*CASES[1], marks=pytest.mark.slow), CASES[3]]
)
def test_two_threads_give_the_bits_of_one(law_name, coulomb, dim, more, walls):
    law, state = make_law(law_name, coulomb, **more), flowing(n=600, dim=dim, walls=walls)
    single, _, _ = ss.run(state, law, 150, 0.05, threads=1)
    double, _, _ = ss.run(state, law, 150, 0.05, threads=2)
    assert not np.array_equal(single.grains.position, state.grains.position)
    assert same_bits(single, double)


def test_no_collision_is_missed_between_two_choices_of_blocks():
    """Pairs at all distances meet head-on, as fast as each other: every one turns round, as if it were alone."""
    law, gap, speed = make_law("hertz_mindlin", "sharp"), np.linspace(0.01, 0.6, 40), 0.02
    x = np.zeros((80, 3))
    x[:40, 0], x[40:, 0] = 5.0, 6.0 + gap
    x[:, 1] = np.tile(np.arange(40) * 2.0 + 1.0, 2)
    velocity = np.outer(np.repeat([1.0, -1.0], 40), [speed, 0, 0])
    state = ss.assembly(ss.spheres(x, 0.5, velocity=velocity), cell=ss.box([80.0] * 3), skin=0.3)
    end, _, _ = ss.run(state, law, 800, 0.05)
    alone = ss.assembly(ss.spheres(x[[0, 40]], 0.5, velocity=velocity[[0, 40]]), cell=ss.box([80.0] * 3), skin=0.3)
    back = ss.run(alone, law, 800, 0.05)[0].grains.velocity[0, 0]
    assert back < 0
    # when within a time step they meet is not the same: 2e-5 of the speed at this dt, with dt a quarter of it 5e-7
    np.testing.assert_allclose(end.grains.velocity[:40, 0], back, rtol=1e-4)
    np.testing.assert_allclose(end.grains.velocity[40:, 0], -back, rtol=1e-4)


@pytest.mark.parametrize("size", [7, 64, 400])
def test_order_of_memory_and_tiles_do_not_matter(size, monkeypatch):
    law, state = make_law("hertz_mindlin", "sharp"), flowing(n=300, walls=True)
    plain, _, _ = ss.run(state, law, 120, 0.05)
    order = np.append(np.random.default_rng(size).permutation(300), [300, 301])
    tiles = np.append(np.arange(0, 300, size), 300)
    monkeypatch.setattr(moving, "_memory_order", lambda state, threads: (order, tiles))
    shuffled, _, _ = ss.run(state, law, 120, 0.05)
    assert same_bits(plain, shuffled)


def test_how_tiles_are_shared_out_does_not_matter(monkeypatch):
    law, state = make_law("hertz_mindlin", "sharp"), flowing(n=300, walls=True)
    plain, _, _ = ss.run(state, law, 240, 0.05)
    order, tiles, taken = np.arange(302), np.append(np.arange(0, 300, 40), 300), []

    def shared(share, spent):
        taken.append(1 + len(taken) % 7)
        return np.array([0, taken[-1], share[-1]])

    monkeypatch.setattr(moving, "_memory_order", lambda state, threads: (order, tiles))
    monkeypatch.setattr(driver, "balance_threads", shared)
    uneven, _, _ = ss.run(state, law, 240, 0.05, threads=2)
    assert len(taken) > 1
    assert same_bits(plain, uneven)


@pytest.mark.parametrize("n", [30, 150])
def test_recording_changes_no_bit(n):
    law, state = make_law("hertz_mindlin", "sharp"), flowing(n=n)
    silent, _, _ = ss.run(state, law, 300, 0.05, drag=0.002)
    watched, _, _ = ss.run(state, law, 300, 0.05, drag=0.002, every=7, probes=(0, 3), events=True)
    relaxed, _, _ = ss.run(state, law, 300, 0.05, drag=0.002, tolerance=1e-30)
    audited, _, _ = ss.run(state, law, 300, 0.05, drag=0.002, every=100, ledger=True)
    assert same_bits(silent, watched)
    assert same_bits(silent, relaxed)
    assert same_bits(silent, audited)


@pytest.mark.parametrize("skin", [0.05, 0.3])
def test_the_skin_changes_no_bit(skin):
    law, state = make_law("hertz_mindlin", "sharp"), flowing()
    usual, _, _ = ss.run(state, law, 200, 0.05)
    other = ss.assembly(state.grains, state.walls, state.cell, state.control, skin=skin)
    two, _, _ = ss.run(other, law, 200, 0.05)
    assert same_bits(usual, two)
    assert two.contacts.skin == skin  # whatever skin the run itself preferred


@pytest.mark.parametrize("memory", ["difference", pytest.param("rate", marks=pytest.mark.slow)])
def test_a_run_continued_is_the_run(memory):
    law, state = make_law("hertz_mindlin", "sharp"), flowing()
    whole, _, _ = ss.run(state, law, 160, 0.05, slip_update=memory)
    half, _, _ = ss.run(state, law, 63, 0.05, slip_update=memory)
    rest, _, _ = ss.run(half, law, 97, 0.05, slip_update=memory)
    assert same_bits(whole, rest)


def test_grains_that_touch_their_own_images_move_alike_in_blocks_and_by_rows(monkeypatch):
    """A cell narrower than a grain: the loads of such a pair were written to one place, and another was left out."""
    law = make_law("hertz_mindlin", "sharp")
    grains = ss.disks([[0.3, 0.5], [1.28, 0.6]], 0.5, velocity=[[0.01, 0.0], [0.0, 0.02]], spin=[0.05, -0.02])
    state = ss.assembly(grains, cell=ss.box([1.96, 0.98], [True, True], dim=2))
    ends = []
    for least in (0, 10**9):
        monkeypatch.setattr(driver, "MIN_BODIES", least)
        ends.append(ss.run(state, law, 200, 0.05)[0])
    assert (ends[0].contacts.i == ends[0].contacts.j)[: ends[0].contacts.count[0]].any()
    np.testing.assert_allclose(ends[0].grains.position, ends[1].grains.position, atol=1e-12)
    np.testing.assert_allclose(ends[0].grains.spin, ends[1].grains.spin, atol=1e-12)


def run_on(threads, state=None):
    return ss.run(state or flowing(), make_law("hertz_mindlin", "sharp"), 60, 0.05, threads=threads)[0]


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted as on Linux")
def test_threads_are_started_once_and_sleep_between_runs():
    single = run_on(1)
    assert same_bits(run_on(3), single)
    started = os.listdir("/proc/self/task")
    assert all(same_bits(run_on(threads), single) for threads in (2, 3, 2))
    assert os.listdir("/proc/self/task") == started
    time.sleep(0.01)  # while they may still spin
    used = time.process_time()
    time.sleep(0.1)
    assert time.process_time() - used < 0.01


def test_simultaneous_runs_have_threads_of_their_own():
    single = run_on(1)
    with ThreadPoolExecutor(3) as executor:
        assert all(same_bits(end, single) for end in executor.map(run_on, [2, 3, 2, 3, 2]))


@pytest.mark.filterwarnings("ignore:.*fork")  # Python warns of threads, which BLAS may have started too
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_child_of_a_fork_starts_threads_of_its_own():
    single = run_on(1)
    run_on(2)
    if not (child := os.fork()):
        os._exit(0 if same_bits(run_on(2), single) else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert same_bits(run_on(2), single)
