"""The time loop: closed forms, events, splits, drag, driven bodies, blow-ups."""

import numpy as np
import pytest

import stickslip as ss
from tests.conftest import make_law, make_packing, stirred


def test_bouncing_disk_closes_and_opens_once_after_half_a_period():
    grains = ss.disks([[0.0, 0.6]], 0.5, velocity=[0.0, -0.01, 0.0])
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2))
    dt = 0.01
    end, record, outcome = ss.run(state, ss.laws.linear(kn=1.0, mu=0.0), 3000, dt, events=True)
    kinds = list(record.events["kind"])
    assert kinds == ["closed", "opened"]
    closed, opened = (record.events["time"][kinds.index(k)] for k in ("closed", "opened"))
    assert closed == pytest.approx(10.0, abs=2 * dt)  # 0.1 at speed 0.01
    assert opened - closed == pytest.approx(np.pi, abs=2 * dt)  # half a period of sqrt(k/m) = 1
    assert end.grains.velocity[0, 1] == pytest.approx(0.01, rel=1e-4)  # O(dt²)
    assert outcome.iterations == 3000


def test_dashpot_gives_the_restitution_of_the_damped_oscillator():
    grains = ss.disks([[0.0, 0.5]], 0.5, velocity=[0.0, -0.01, 0.0])
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2))
    gamma = 0.4
    end, _, _ = ss.run(state, ss.laws.linear(kn=1.0, mu=0.0, damping_n=gamma), 20_000, 0.0005)
    # separation at zero overlap: the rebound is exp(-γπ/2ω) of the impact, ω² = k/m − γ²/4
    omega = np.sqrt(1 - gamma**2 / 4)
    assert end.grains.velocity[0, 1] / 0.01 == pytest.approx(np.exp(-0.5 * gamma * np.pi / omega), rel=2e-3)


def test_contact_reaches_the_limit_when_the_spring_does():
    law = ss.laws.for_pair(ss.laws.linear(kn=1.0, kt=0.5, mu=0.4), 0, 1)
    state = ss.packings.disk_array(1, press=0.01, gap=0.5)
    state, _ = ss.relax(state, law, drag=0.5)
    moving = state._replace(control=ss.control.driven(state.control, [0], [1e-3, 0, 0, 0, 0, 0]))
    _, record, _ = ss.run(moving, law, 2000, 0.01, events=True)
    limit = record.events[record.events["kind"] == "limit"]
    assert len(limit) == 1  # the first time only
    # overlap 0.01, so μ F_n = 0.004 and the spring of stiffness 0.5 yields at 0.008, at speed 1e-3
    assert limit["time"][0] - state.time == pytest.approx(8.0, abs=0.02)
    assert limit["position"][0, 0] == pytest.approx(state.grains.position[0, 0] + 0.008, abs=2e-5)


def test_drag_alone_slows_exponentially():
    grains = ss.disks([[0.0, 0.0]], 0.5, velocity=[1.0, 0, 0], spin=[0, 0, 2.0])
    state = ss.assembly(grains, cell=ss.box(dim=2))
    end, record, _ = ss.run(state, ss.laws.linear(), 1000, 0.01, drag=0.1, spin_drag=0.2, every=10, ledger=True)
    assert end.grains.velocity[0, 0] == pytest.approx(np.exp(-1.0), rel=1e-6)
    assert end.grains.spin[0, 2] == pytest.approx(2 * np.exp(-2.0), rel=1e-6)
    assert record.ledger.kinetic[-1] == pytest.approx(record.ledger.kinetic[0] - record.ledger.drag[-1], rel=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("coulomb", ["smooth", "sharp"])
def test_a_run_split_in_two_gives_the_same_bits(dim, coulomb):
    law = make_law("hertz_mindlin", coulomb)
    state = ss.packings.perturbed(stirred(make_packing(dim, 4), law, np.random.default_rng(4), size=0.005), 1, 0.01)
    whole, _, _ = ss.run(state, law, 400, 0.05)
    half, _, _ = ss.run(state, law, 150, 0.05)
    rest, _, _ = ss.run(half, law, 250, 0.05)
    for name in ("position", "angle", "velocity", "spin"):
        assert np.array_equal(getattr(whole.grains, name), getattr(rest.grains, name)), name
    count = whole.contacts.count[0]
    assert np.array_equal(
        whole.contacts.slip[:count][whole.contacts.mode[:count] > 0],
        rest.contacts.slip[: rest.contacts.count[0]][rest.contacts.mode[: rest.contacts.count[0]] > 0],
    )


def test_recording_and_events_do_not_change_the_motion():
    law = make_law("hertz_mindlin", "sharp")
    state = ss.packings.perturbed(stirred(make_packing(2, 4), law, np.random.default_rng(4), size=0.005), 1, 0.05)
    quiet, _, _ = ss.run(state, law, 500, 0.05)
    loud, record, _ = ss.run(state, law, 500, 0.05, every=7, probes=[0, 3], events=True)
    assert np.array_equal(quiet.grains.position, loud.grains.position)
    assert record.position.shape == (500 // 7 + 1, 2, 3)
    assert record.time[-1] == pytest.approx(state.time + 497 * 0.05)
    moved = state.grains.position[:2] * 0 + record.position[0]
    assert np.array_equal(moved, state.grains.position[[0, 3]])


def test_events_beyond_the_first_buffer_are_kept():
    """A disk hopping under gravity on a frictionless floor closes and opens more often than the first buffer holds."""
    state = ss.assembly(
        ss.disks([[0.0, 0.52]], 0.5),
        ss.flat_walls([0, 0, 0], [0, 1, 0]),
        ss.box(dim=2),
        ss.control.loads(1, 1, gravity=(0, -1.0, 0)),
    )
    law = ss.laws.linear(kn=1e4, mu=0.0)
    _, record, _ = ss.run(state, law, 400_000, 1e-3, events=True)
    kinds = record.events["kind"]
    assert len(kinds) > 1024
    assert (kinds[::2] == "closed").all()
    assert (kinds[1::2] == "opened").all()
    assert (np.diff(record.events["time"]) >= 0).all()


def test_no_event_is_lost_when_the_list_is_rebuilt_at_every_step():
    """A fast disk between two walls: every step leaves the skin, and so do contacts that open."""
    values = {}
    for skin in (0.01, 1.0):
        walls = ss.flat_walls([[0, 0, 0], [3, 0, 0]], [[1, 0, 0], [-1, 0, 0]])
        grains = ss.disks([[1.0, 0.0], [2.2, 0.0]], 0.5, velocity=[[20.0, 0, 0], [-7.0, 0, 0]])
        state = ss.assembly(grains, walls, ss.box(dim=2), skin=skin)
        _, record, _ = ss.run(state, ss.laws.linear(kn=1e5, mu=0.0), 40_000, 1e-3, events=True)
        values[skin] = record.events
    assert len(values[0.01]) > 1024
    few, many = (sorted(zip(e["time"], e["kind"], e["i"], e["j"], strict=True)) for e in values.values())
    assert few == many  # sorted, as events of one step may come in another order


def test_the_first_step_sees_slip_that_is_not_yet_committed():
    law = ss.laws.linear(kn=1.0, kt=0.5, mu=10.0)
    state = ss.assembly(ss.disks([[0.0, 0.45]], 0.5), ss.flat_walls([0, 0, 0], [0, 1, 0]), ss.box(dim=2))
    state = ss.accept(state, ss.forces(state, law)[1])
    free = ss.freedom(state)
    moved = ss.modes.displaced(state, free, np.array([1e-3, 0.0, 0.0]))
    end, _, _ = ss.run(moved, law, 1, 0.1)
    assert end.grains.velocity[0, 0] == pytest.approx(-0.5 * 1e-3 * 0.1, rel=2e-2)  # O(dt²) of the step itself


def test_driven_bodies_move_as_prescribed_and_frozen_ones_stay():
    law = ss.laws.linear(mu=0.3)
    state = make_packing(2, 1)._replace(control=ss.control.fixed(make_packing(2, 1).control, [0]))
    state = state._replace(control=ss.control.driven(state.control, [1], [0, 1e-3, 0, 0, 0, 2e-3]))
    law = ss.laws.for_pair(law, 0, 1)
    end, _, _ = ss.run(state, law, 200, 0.05)
    assert np.array_equal(end.grains.position[0], state.grains.position[0])
    assert end.grains.position[1, 1] - state.grains.position[1, 1] == pytest.approx(1e-2, rel=1e-12)
    assert end.grains.angle[1, 2] == pytest.approx(2e-2, rel=1e-12)


def test_a_free_wall_carries_the_load_as_a_body():
    """A piston pressed on a disk on a floor: the overlaps at both walls are the load over the stiffness."""
    walls = ss.flat_walls([[0, 0, 0], [0, 0.98, 0]], [[0, 1, 0], [0, -1, 0]], mass=2.0)
    state = ss.assembly(ss.disks([[0.0, 0.49]], 0.5), walls, ss.box(dim=2), ss.control.loads(1, 2))
    control = state.control
    control.free[2, 1] = True
    control.force[2, 1] = -0.01
    end, outcome = ss.relax(state, ss.laws.linear(kn=1.0), drag=0.3)
    assert outcome.ok
    assert 0.5 - end.grains.position[0, 1] == pytest.approx(0.01, rel=1e-9)
    assert end.walls.point[1, 1] == pytest.approx(0.98, rel=1e-9)
    solved, outcome = ss.newton(state, ss.laws.linear(kn=1.0))
    assert outcome.ok
    assert solved.walls.point[1, 1] == pytest.approx(0.98, rel=1e-9)


def test_a_blow_up_names_the_grain():
    grains = ss.disks([[0.0, 0.6], [5.0, 0.5]], 0.5, mass=[1e-150, 1.0])
    pull = ss.control.loads(2, force=[[1e150, 0.0, 0.0], [0.0, 0.0, 0.0]])
    state = ss.assembly(grains, cell=ss.box(dim=2), control=pull)
    with np.errstate(all="ignore"):
        _, _, outcome = ss.run(state, ss.laws.linear(), 5000, 1e10)
    assert outcome.status is ss.Status.NOT_A_NUMBER
    assert outcome.where == 0
    assert "grain 1" in str(outcome)


@pytest.mark.parametrize("n", [20, 60])
def test_a_run_ends_once_it_is_at_rest(n):
    """Few bodies are evaluated row by row, many in blocks; both look for rest."""
    law = ss.laws.hertz_mindlin(mu=0.5)
    state, _ = ss.packings.jammed(n, packing_fraction=0.88, dim=2, seed=1)
    moved = ss.packings.sheared(state, 1e-5)
    _, outcome = ss.relax(moved, law, tolerance=1e-8, drag=0.3, steps=100_000)
    assert outcome.ok and outcome.residual <= 1e-8
    assert outcome.iterations < 10_000  # the residual is 1e-12 after that


def test_a_word_for_an_engine_is_answered_with_what_makes_one():
    state = ss.assembly(ss.disks([[0, 0]], 1.0))
    with pytest.raises(TypeError, match=r"an Engine as protocols.lammps_engine makes it"):
        ss.run(state, ss.laws.linear(), 1, 0.1, engine="lammps")
