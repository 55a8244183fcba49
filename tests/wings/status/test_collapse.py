"""Load paths that go on through a collapse: closed forms, the ledger, and a machine that drives a displacement."""

import numpy as np
import pytest

import stickslip as ss
from benchmarks.collapses import Case, disks_in_machine, disks_under_load, first_collapse, spheres_under_stress
from stickslip.wings.papers.quasi_rigid.simulate import simulate_quasi
from stickslip.wings.status import collapse as dynamics
from stickslip.wings.status.path import COLLAPSE
from stickslip.wings.status.status import Verdict
from tests.wings.status.five_packings import spheres

GAP, PRESS, MU = 0.02, 0.01, 0.4


def block(dim, stop=True):
    """One grain between a floor and a lid, neither of which can turn it, and a stop at a distance GAP along x."""
    up, along = np.eye(3)[1], np.eye(3)[0]
    points = [(PRESS - 0.5) * up, (0.5 - PRESS) * up, (0.5 + GAP) * along]
    walls = ss.flat_walls(points[: 2 + stop], [up, -up, -along][: 2 + stop])
    make = ss.disks if dim == 2 else ss.spheres
    law = ss.laws.linear(1.0, 0.5, MU, coulomb="sharp", damping="mass_velocity", damping_n=0.2, damping_t=0.2)
    state = ss.assembly(make([[0, 0, 0]], 0.5), walls, ss.box(dim=dim), ss.control.loads(1, 2 + stop))
    return ss.accept(state, ss.forces(state, law)[1]), law


def pushed(state, force):
    """Control with a force on the grain along x."""
    push = state.control._replace(force=state.control.force.copy())
    push.force[0, 0] = force
    return push


@pytest.mark.parametrize("dim", [2, 3])
def test_a_block_slides_to_the_stop(dim):
    state, law = block(dim)
    force = 2 * MU * PRESS * 1.25  # friction gives way at 0.8 of it
    path = ss.quasirigid.load_path(state, law, pushed(state, force), increment=0.1, drag=0.1)
    assert path.complete
    assert path.summary.startswith("the full load was reached, after 1 collapse")
    (event,) = path.collapses
    assert not event.quiet
    assert event.load == pytest.approx(0.8)
    assert [e.load for e in path.events if e.kind == COLLAPSE] == [event.held]
    number = [p.load for p in path.points].index(event.held)
    before, after = path.points[number - 1 : number + 1]
    moved = after.state.grains.position[0, 0] - before.state.grains.position[0, 0]
    assert event.largest == event.total == pytest.approx(moved)
    assert event.motion == pytest.approx(moved)
    at = after.state.grains.position[0, 0]
    assert GAP < at < GAP + 0.8 * force  # the stop carries what friction does not
    assert (event.lost, event.gained) == (0, 1)
    assert event.sliding == (2, 0)
    assert event.participation == pytest.approx(1)
    assert event.overlap > 0.999  # of a motion along x
    # the push works along the way; friction stores what it carries in two springs, the stop in a third
    friction = event.held * force - (at - GAP)
    stored = 0.5 * (at - GAP) ** 2 + friction**2 / (2 * 2 * 0.5) - (2 * MU * PRESS) ** 2 / (2 * 2 * 0.5)
    assert event.work == pytest.approx(event.held * force * moved, rel=1e-3)
    assert event.released == pytest.approx(event.work - stored, rel=1e-3)


def test_without_drag_the_path_ends_there():
    state, law = block(2)
    end = pushed(state, 2 * MU * PRESS * 1.25)
    path = ss.quasirigid.load_path(state, law, end, increment=0.1)
    assert path.verdict is Verdict.MECHANISM
    assert not path.collapses


@pytest.mark.parametrize("limit", [{"travel": 0.3}, {"duration": 50.0}])
def test_a_block_that_nothing_stops_flows(limit):
    state, law = block(2, stop=False)
    end = pushed(state, 2 * MU * PRESS * 1.25)
    path = ss.quasirigid.load_path(state, law, end, increment=0.1, drag=0.1, **limit)
    assert path.verdict is Verdict.FLOWS
    assert path.loses_stability
    assert not path.complete
    assert "it flows under this load" in path.summary
    assert "or creeps, if the drag is large" in path.summary and "a longer duration" in path.summary
    assert path.points[-1].load == pytest.approx(0.8, abs=1e-3)
    (event,) = path.collapses
    assert not event.rests
    assert event.largest > 0.3 or event.duration > 50


@pytest.mark.parametrize("dim", [2, 3])
def test_a_machine_that_drives_a_displacement_keeps_a_sliding_block_stable(dim):
    """Pulled by a spring instead of a dead load, it slides as far as the load point does, at constant force."""
    state, law = block(dim, stop=False)
    stiff = 3.0
    control = ss.control.spring_loaded(state.control, [0], [[0, 0, 0]], stiff)
    state = state._replace(control=control)
    end = ss.quasirigid.with_travel(control, 0, [0.04, 0, 0])
    path = ss.quasirigid.load_path(state, law, end, increment=0.1)
    assert path.complete
    slides = 2 * MU * PRESS
    reached = {round(e.load, 6) for e in path.events if e.kind == "reaches the cone"}
    assert reached == {round((slides / stiff + slides) / 0.04, 6)}  # elongation of the machine and of two springs
    force = [stiff * (s.control.anchor - s.grains.position[0])[0, 0] for s in path.states[-4:]]
    assert force == pytest.approx([slides] * 4)
    assert path.states[-1].grains.position[0, 0] == pytest.approx(0.04 - slides / stiff)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_stiffness_with_a_machine_is_the_jacobian(dim):
    if dim == 2:
        state, law = ss.packings.biaxial_box(30, pressure=1e-3, seed=1)
    else:
        state, law, _ = spheres("box", 1)
    wall = int(np.flatnonzero(state.control.force.any(axis=1))[-1])
    held = ss.quasirigid.with_machine(state, wall, 7.0)
    m, dead = (ss.quasirigid.linear_system(s, law) for s in (held, state))
    rate = ss.quasirigid.stiffness_matrix(m) + ss.jacobian(held, law, m.free)
    assert np.abs(rate).max() < 1e-12
    more = (ss.quasirigid.stiffness_matrix(m) - ss.quasirigid.stiffness_matrix(dead)).tocoo()
    assert m.free.body[more.row[np.abs(more.data) > 1e-9]].tolist() == [wall]
    for geometric in (True, False):  # a machine is no part of the geometric stiffness
        load = (m.free.body == wall).astype(float)
        soft, hard = (
            ss.quasirigid.contact_status(x, load, geometric=geometric).velocity[m.free.body == wall][0]
            for x in (dead, m)
        )
        assert 1 / hard == pytest.approx(1 / soft + 7.0)


def energies(monkeypatch, case, increment=0.01):
    """Sum of what friction, dashpots and drag dissipate in the first collapse, and its record."""
    ledgers = []

    def run(*given, **options):
        out = original(*given, **options, ledger=True)
        ledgers.append(out[1].ledger)
        return out

    original = dynamics.run
    monkeypatch.setattr(dynamics, "run", run)
    (event, *_) = ss.quasirigid.load_path(case.state, case.law, case.end, increment=increment, drag=0.1).collapses
    spent = sum(float((x.coulomb + x.viscous + x.drag - x.nonpotential)[-1]) for x in ledgers)
    work = sum(float(x.external[-1]) for x in ledgers)
    return event, spent, work


def test_the_work_of_the_load_is_stored_or_dissipated(monkeypatch):
    state, law = block(2)
    event, spent, work = energies(monkeypatch, Case("", state, law, pushed(state, 2 * MU * PRESS * 1.25)), 0.1)
    assert event.released > 0
    assert event.work == pytest.approx(work, rel=1e-3)
    assert event.released == pytest.approx(spent, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("make", [disks_under_load, disks_in_machine, spheres_under_stress])
def test_the_energy_balance_of_a_collapse_closes(monkeypatch, make):
    for seed in range(2, 10):
        case = make(seed)
        path = ss.quasirigid.load_path(case.state, case.law, case.end, drag=0.1)
        if len(path.collapses) and not path.collapses[0].quiet:
            short = case._replace(end=ss.control.between(case.state.control, case.end, path.collapses[0].held))
            event, spent, work = energies(monkeypatch, short)
            if case.state.control.cell_free.any():  # the ledger has the work of the cell on grains, less its own drag
                assert event.work > work
                spent += event.work - work
            else:
                assert event.work == pytest.approx(work, rel=1e-2)
            assert event.released == pytest.approx(spent, rel=1e-2)
            return
    pytest.fail("no sample collapses")


@pytest.mark.slow
def test_the_path_after_a_collapse_is_that_of_slow_dynamics():
    """Tolerances: the duration of the collapse and two steps of the load, a tenth of the motion of the wall."""
    for seed in (2, 4, 6, 7, 8):
        case = disks_under_load(seed)
        path = ss.quasirigid.load_path(case.state, case.law, case.end, increment=0.005, drag=0.02)
        real = [c for c in path.collapses if not c.quiet]
        until = min(1.0, real[0].load + 0.05)
        run = ss.quasirigid.slow_dynamics(case.state, case.law, case.end, time=1e6, until=until, drag=0.02)
        off, _, wall = first_collapse(case, path, run, real[0])
        if abs(off) < real[0].duration / 1e6 + 2 * until / 500:
            assert wall < 0.1
            return
    pytest.fail("no sample collapses at the load at which the path does")


def test_a_drag_needs_controls_that_do_not_move():
    state, law = block(2)
    for wrong in (0.0, -1.0):
        with pytest.raises(ValueError, match=r"drag must be positive, got .*"):
            ss.quasirigid.load_path(state, law, state.control, drag=wrong)
    moving = state._replace(control=ss.control.driven(state.control, [1], [0, 1e-3, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match="as dynamics holds the load"):
        ss.quasirigid.load_path(moving, law, moving.control, drag=0.1)


def test_a_machine_replaces_a_force():
    state, _ = block(2)
    with pytest.raises(ValueError, match="body 1 carries no load that a machine could exert"):
        ss.quasirigid.with_machine(state, 1, 10.0)
    with pytest.raises(ValueError, match="body 1 is not pulled by a spring: use `with_machine` first"):
        ss.quasirigid.with_travel(state.control, 1, [0, 0.1])
    with pytest.raises(ValueError, match="stiffness must be positive"):
        ss.quasirigid.with_machine(state, 1, 0.0)


@pytest.mark.parametrize("travel", [-0.1, [-0.1], [[0, -0.1]]])
def test_a_travel_is_a_vector(travel):
    state, _ = ss.packings.biaxial_box(10, pressure=1e-3, seed=1)
    lid = 10 + ss.packings.TOP
    held = ss.quasirigid.with_machine(state, lid, 10.0)
    with pytest.raises(ValueError, match=r"travel has the shape \(.*\): it must be \(3,\) or \(2,\)"):
        ss.quasirigid.with_travel(held.control, lid, travel)


# 5 s: a scenario whose path goes through collapses
def test_scenarios_go_through_collapses(tmp_path):
    table = {"experiment": "quasi-rigid", "seed": 2, "disks": {"number": 30}, "dynamics": {"times": ()}}
    loading = {"factor": 1.5, "increment": 0.05, "collapses": True}
    scenario = ss.scenario(**table, loading=loading)
    result = simulate_quasi(scenario, folder=tmp_path, workers=1)
    (sample,) = result.tested
    assert sample.path.complete
    assert sample.path.collapses
    again = simulate_quasi(scenario, folder=tmp_path, workers=1)  # resumed from what is in the folder
    for old, new in zip(sample.path.collapses, again.tested[0].path.collapses, strict=True):
        assert old.load == new.load
        np.testing.assert_array_equal(old.direction, new.direction)
    with pytest.raises(ValueError, match=r"collapses = true requires dynamics.drag > 0"):
        ss.scenario(**table | {"dynamics": {"times": (), "drag": 0}}, loading=loading)
    with pytest.raises(ValueError, match=r"does not apply to test = \"shear\""):
        ss.scenario(**table, loading={"test": "shear", "machine": 10.0})
    with pytest.raises(ValueError, match=r"loading.strain = 0.02 requires loading.machine"):
        ss.scenario(**table, loading={"strain": 0.02})
