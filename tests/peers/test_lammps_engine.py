"""LAMMPS as an engine: first steps, contact memory there and back, what it refuses, and what a queue gets."""

import os
import re
import struct
import subprocess
import sys

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FROZEN
from stickslip.core.dynamics.run import Leg, Wave, join_samples, own_engine, take_sample
from stickslip.core.laws.builtin import ROLLING
from stickslip.data import archive
from stickslip.data.checkpoint import read_pieces
from stickslip.data.exchange import lammps_restart as memory
from stickslip.data.schema import ScenarioError
from stickslip.experiments.registry import read_scenario
from stickslip.extras import MissingExtraError
from stickslip.wings.faults.friction.laboratory import steady_mean
from stickslip.wings.lammps import run as process
from stickslip.wings.lammps import script, supported
from stickslip.wings.lammps.run import leg_folder, restart_path, run_in_lammps, run_leg, walls_at
from stickslip.wings.lammps.supported import check_leg
from stickslip.wings.studies.flow import SETTLING, SHEARED
from stickslip.wings.studies.flow import pouring as flow_lammps
from stickslip.wings.studies.flow.pouring import poured
from tests.conftest import stickslip_here
from tests.peers.lammps_scenes import (
    DT,
    GRANULAR,
    LINEAR,
    REFF,
    SCENES,
    STEPS,
    arms,
    between_plates,
    between_walls,
    differ,
    on_a_floor,
    opened,
    stirred,
    under_stress,
)
from tests.wings.studies.test_flow import TOML

# without LAMMPS


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (ss.laws.hertz_mindlin_reff(coulomb="smooth"), "smooth Coulomb friction"),
        (ss.laws.linear(damping="velocity", damping_n=0.1), "does not have these dashpots for linear"),
        (ss.laws.hertz_mindlin_reff(damping="mass_velocity", damping_n=0.1), "dashpots"),
        (ss.laws.hertz_mindlin(), "grains of one size only"),
        (ss.laws.hertz_mindlin_reff(rescaled=True, damping_t=0.1), "as a multiple of damping_n: give both or neither"),
        (ss.laws.walton_braun(k_unload=2.0), "LAMMPS does not have this law in stickslip's form"),
        (ss.laws.liquid_bridge(surface_tension=1e-3, volume=1e-3), "LAMMPS does not have this law in stickslip's form"),
        (ss.laws.jkr(work=1e-3), "separates contacts of jkr at 0.48 of the pull-off gap"),
        (ss.laws.with_twisting(ss.laws.linear(), k_twist=1.0, mu_twist=0.1), "reverses the twisting spring"),
        (ss.laws.dmt(work=1e-3), "dmt with lever arms R"),
        (arms(ss.laws.dmt(work=1e-3, damping="tsuji", damping_n=0.5)), "does not have these dashpots for dmt"),
        (arms(ss.laws.dmt(work=1e-3, tension=False)), "tension = false with dmt"),
        (arms(ss.laws.linear(damping="velocity", damping_t=0.1)), "as a multiple of damping_n: give both or neither"),
        (ss.laws.with_rolling(arms(ss.laws.linear()), "viscous", gamma_roll=0.1), "rolling moments without a spring"),
        (ss.laws.with_rolling(arms(LINEAR), k_roll=0.3, mu_roll=0.1), "reverses the memory of rolling moments"),
        (ss.laws.with_rolling(arms(ss.laws.linear(mu=0.0)), k_roll=0.3, mu_roll=0.1), "without friction"),
        (ss.laws.with_memory(REFF, "force"), "a memory of forces with lever arms R"),
        (ss.laws.linear(damping="tsuji", damping_n=0.5), "does not have these dashpots"),
    ],
)
def test_a_law_that_lammps_does_not_have_is_refused(law, words):
    with pytest.raises(ScenarioError, match=words) as found:
        check_leg(Leg(stirred(), law, DT, STEPS, 1))
    assert "\n" not in str(found.value)


def test_rolling_on_several_processes_and_no_samples_are_refused():
    law = ss.laws.with_rolling(arms(LINEAR), k_roll=0.3, mu_roll=0.1)
    check_leg(Leg(opened(), law, DT, STEPS, 1))
    with pytest.raises(ScenarioError, match="pass to another process: use open sides and one process"):
        check_leg(Leg(opened(), law, DT, STEPS, 1, ranks=2))
    with pytest.raises(ScenarioError, match="samples must be at least 1, got 0"):
        check_leg(Leg(opened(), law, DT, STEPS, 0))


def test_a_law_of_a_user_is_refused():
    law = ss.laws.custom(normal_force=lambda overlap, kn: kn * overlap, parameters={"kn": 1.0})
    with pytest.raises(ScenarioError, match="LAMMPS does not have this law in stickslip's form"):
        check_leg(Leg(stirred(), law, DT, STEPS, 1))


def refused_conditions():
    state, n = stirred(), 200
    control = state.control
    follows, strained, plates = ss.control.stress_controlled, ss.control.strained_at, between_plates(3, "")
    varying = ss.control.time_dependent(strained(control, np.diag([-0.01, 0])), "cell", [0.0, 1.0], [1.0, 0.0])
    both = follows(strained(control, [[0, 0.1, 0], [0, 0, 0.1], [0, 0, 0]]), {"yy": 0.1})
    free_wall = between_walls(3)
    free_wall.control.free[-2, 0] = True
    held, pushed = ss.control.fixed(control, [3]), control._replace(force=np.ones((n, 3)))
    heavy = state._replace(grains=state.grains._replace(inertia=2 * state.grains.inertia))
    shaken = between_walls(2, moving=True)
    many = ss.control.time_dependent(shaken.control, [36], np.linspace(0, 1, 90), np.ones(90), axes=[0])
    return [
        (state._replace(control=follows(control, {"yy": 0.1, "xy": 0.0})), "cannot control a shear stress by the cell"),
        (state._replace(control=strained(control, [[0, 0], [0.1, 0]])), "tilt along yx"),
        (state._replace(control=varying), "rates that vary in time"),
        (state._replace(control=both), "along xy and yz at once"),
        (plates._replace(control=follows(plates.control, {"xx": 0.1})), "rigid groups in a cell whose lengths change"),
        (free_wall, "LAMMPS moves walls at prescribed velocities only, not by forces"),
        (state._replace(control=held), "hold or drive single grains"),
        (state._replace(control=pushed), "forces on single grains"),
        (heavy, "LAMMPS has I0 = 2/5 .* but not 0.8"),
        (shaken._replace(control=many), "91 knots"),
    ]


def test_conditions_that_lammps_cannot_keep_are_refused():
    for state, words in refused_conditions():
        with pytest.raises(ScenarioError, match=words) as found:
            check_leg(Leg(state, LINEAR, 0.02, 500, 1))
        assert "\n" not in str(found.value)
    with pytest.raises(ScenarioError, match="60 samples do not fit into 50 steps"):
        check_leg(Leg(stirred(), LINEAR, DT, STEPS, 60))


def template(leg, ranks):
    """A restart file without memory: the header is only its end, and grains are dealt to ranks."""
    n, state = len(leg.state.grains.radius), leg.state
    content = memory.MAGIC + b"header" + memory.HEADER_END
    for rank in range(ranks):
        doubles = []
        for k in range(rank, n, ranks):
            record = np.zeros(memory.EXTRA + 2 + 2 * len(state.walls.mass))
            record.view("<i8")[memory.TAG] = k + 1
            record.view("<i8")[memory.IMAGE] = 513 | 511 << 10 | 512 << 20
            record[0], record[memory.EXTRA] = len(record), 2
            record[memory.EXTRA + 2 :: 2] = 2
            record[memory.POSITION : memory.POSITION + 3] = state.grains.position[k]
            doubles.append(record)
        block = np.concatenate(doubles)
        content += memory.BLOCK + struct.pack("<i", len(block)) + block.tobytes()
    return content + memory.MAGIC


@pytest.mark.parametrize("ranks", [1, 3])
def test_memory_is_written_and_read_bit_for_bit(tmp_path, ranks):
    """Also when the header happens to contain the mark of its end."""
    state, law = between_walls(3), SCENES["walls, no dashpots"][1]
    state, _, _ = ss.run(state, law, 20, DT, slip_update="rate")
    path, leg = tmp_path / "sample.restart", Leg(state, law, DT, 1, 1)
    made = template(leg, ranks).replace(b"header", memory.HEADER_END + memory.BLOCK + b"\x01\x00\x00\x00")
    path.write_bytes(made)
    memory.write_memory(path, path, state, law)
    found = memory.read_restart(path, walls=2)
    assert (found.position == state.grains.position).all() and (found.image == [1, -1, 0]).all()
    back = memory.restore_memory(state, law, found)
    c, rows = state.contacts, ss.measure.touching(state)
    assert np.count_nonzero(c.j[rows] >= 64) > 5 and len(rows) > 50
    assert (back.contacts.key[ss.measure.touching(back)] == c.key[rows]).all()
    mine, theirs = c.slip[rows], back.contacts.slip[ss.measure.touching(back)]
    assert (mine == theirs).all() and mine.any()
    assert (back.contacts.mode[ss.measure.touching(back)] == c.mode[rows]).all()


def test_a_damaged_restart_file_is_one_sentence(tmp_path):
    path = tmp_path / "a.restart"
    path.write_bytes(template(Leg(between_walls(3), LINEAR, DT, 1, 1), 1)[:-40])
    with pytest.raises(ValueError, match="not a complete LAMMPS restart file"):
        memory.read_restart(path)
    path.write_bytes(memory.MAGIC + b"something else" + memory.MAGIC)
    with pytest.raises(ValueError, match="unknown format"):
        memory.read_restart(path)


def evaluate(formula: str, step: int, dt: float) -> float:
    """Value of a formula of LAMMPS."""
    rounded = {"round": lambda x: np.floor(x + 0.5), "floor": np.floor}
    names = rounded | {"step": step, "dt": dt, "cos": np.cos, "ternary": lambda test, yes, no: yes if test else no}
    return float(eval(formula, {"__builtins__": {}}, names))


def test_formulas_of_moving_walls_are_integrals_of_their_velocities():
    state = between_walls(2, moving=True)
    leg, body = Leg(state, LINEAR, DT, 60, 1), 36
    for step in (0, 1, 19, 20, 27, 33, 60):
        fine = np.linspace(0, step * DT, 40_001)
        wanted = np.trapezoid(0.1 * np.interp(fine, [0, 1, 1.5, 9], [1, 1, -1, 2]), fine)
        column = int(state.control.follows[body, 0])
        assert evaluate(script.displacement_formula(leg, 0.1, column), step, DT) == pytest.approx(wanted, abs=1e-9)
        assert walls_at(leg, step * DT).point[0, 0] - 0.02 == pytest.approx(wanted, abs=1e-9)
        waves = leg._replace(waves={column: Wave(2.0, 0.7, 0.3, -0.5)})
        wanted = np.trapezoid(0.1 * 2 * np.sin(2 * np.pi * 0.7 * (fine + 0.5) + 0.3), fine)
        assert evaluate(script.displacement_formula(waves, 0.1, column), step, DT) == pytest.approx(wanted, abs=1e-8)
        assert walls_at(waves, step * DT).point[0, 0] - 0.02 == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("name", ["shear under stress", "shear under stresses", "compressed and sheared"])
def test_the_input_of_a_cell_under_stress_defines_each_variable_before_it_is_used(name):
    make, law = SCENES[name]
    text, known = script.format_input(Leg(make(), law, DT, STEPS)), set()
    for line in text.splitlines():
        if "fix" in line or "variable" in line:
            used = set(re.findall(r"v_(cell_\w+)", line))
            assert used <= known, (line, used - known)
        if line.startswith("variable"):
            known.add(line.split()[1])
    assert len(known) > 10


@pytest.mark.parametrize("choice", [{"samples": 7}, {"samples": 5, "before": (3, 33)}, {"every": 10}, {"every": 45}])
def test_the_formula_of_the_next_sample_gives_the_steps_of_the_samples(choice):
    leg = Leg(stirred(), LINEAR, DT, 45, **choice)
    formula = script._next_sample(leg, "step").replace("&&", " and ")
    steps, step = [], 0
    while step < leg.steps:
        steps.append(step := evaluate(formula, step, DT))
    assert steps == leg.sample_steps and evaluate(formula, step, DT) > leg.steps


def test_legs_that_are_cut_take_the_samples_of_the_whole():
    whole = Leg(stirred(), LINEAR, DT, 103, 9)
    for cut, done in enumerate(whole.sample_steps[:-1], start=1):
        rest = whole._replace(steps=103 - done, samples=9 - cut, before=(cut, done))
        assert [done + step for step in rest.sample_steps] == whole.sample_steps[cut:]


def test_runs_with_another_engine_have_a_record_of_its_states():
    state, choice = stirred(), {"every": 20, "drag": 0.1}
    end, record, outcome = ss.run(state, LINEAR, 50, DT, engine=own_engine(), **choice)
    again, same, _ = ss.run(state, LINEAR, 50, DT, **choice)
    assert outcome.ok and (end.grains.velocity == again.grains.velocity).all() and len(record.time) == 3
    leg = Leg(state, LINEAR, DT, 40, 2, 0.1)
    states = [here for here, _ in own_engine().pieces(leg)]
    for name, values in join_samples([take_sample(here, leg) for here in (state, *states)], leg)._asdict().items():
        assert np.all(values == getattr(same, name)), name
    with pytest.raises(ValueError, match="another engine supports drag and every only, not spin_drag and ledger"):
        ss.run(state, LINEAR, 50, DT, every=10, spin_drag=0.1, ledger=True, engine=own_engine())


@pytest.mark.slow
def test_a_run_in_lammps_has_a_record(peer):
    state, choice = stirred(), {"every": 20}
    end, record, _ = ss.run(state, LINEAR, 50, DT, engine=ss.protocols.lammps_engine(), **choice)
    ours, same, _ = ss.run(state, LINEAR, 50, DT, slip_update="rate", **choice)
    assert record.time == pytest.approx(same.time) and len(record.time) == 3
    assert differ(ours.grains.velocity, end.grains.velocity) < 1e-10
    for name in ("kinetic_energy", "touching", "msd", "virial"):
        assert differ(getattr(same, name), getattr(record, name)) < 1e-10, name


def test_what_is_missing_is_one_sentence(monkeypatch):
    monkeypatch.setattr(process, "find_spec", lambda name: True)
    monkeypatch.setattr(process, "CHILD", "print('RIGID')")
    with pytest.raises(MissingExtraError, match="built without its package GRANULAR"):
        process.require_lammps()
    monkeypatch.setattr(process, "CHILD", "print('RIGID GRANULAR')")
    process.require_lammps()
    monkeypatch.setattr(process, "find_mpirun", lambda: "mpirun")
    with pytest.raises(ScenarioError, match=r"ranks = 100000 exceeds the \d+ cores of this machine"):
        process.require_lammps(100_000)
    monkeypatch.setattr(process, "find_mpirun", lambda: None)
    with pytest.raises(MissingExtraError, match="2 ranks, but mpirun is missing"):
        process.require_lammps(2)
    assert process.last_error("a warning\nERROR: Lost atoms\nLast command: run 5") == "ERROR: Lost atoms"


def test_ranks_need_lammps():
    with pytest.raises(ScenarioError, match=r"ranks = 2 requires engine = \"lammps\", as engine = 'stickslip'"):
        ss.scenario(experiment="flow", ranks=2, **SETTLING)


def test_a_flow_is_written_for_a_queue(tmp_path):
    """Legs that follow each other, with the walls that each has where they then are."""
    stages = [
        *SETTLING["stages"],
        {"name": "open", "duration": 1.0, "remove": ["left"], "velocity": {"gate": {"x": 0.5}}},
    ]
    last = {"name": "on", "duration": 1.0, "drag": 0.1}
    scenario = ss.scenario(experiment="flow", engine="lammps", ranks=7, **SETTLING | {"stages": [*stages, last]})
    flow_lammps.export(scenario, tmp_path)
    first, second, third = ((leg_folder(tmp_path, k) / "in.lammps").read_text() for k in range(3))
    assert "read_data grains.data" in first and "region wall1" in first
    steps = flow_lammps.stage_legs(scenario, poured(scenario))[0].steps
    assert f"read_restart ../leg-01/sample.{steps}.restart" in second
    assert "region wall1" not in second and "wall2_dx equal 0.5*(step*dt)" in second
    assert "region wall2 plane 6.5" in third and "langevin" in third and "langevin" not in second
    assert "mpirun -np 7 lmp" in (tmp_path / "run.sh").read_text()
    assert "--ntasks=7" in (tmp_path / "job.slurm").read_text()
    restart_path(Leg(stirred(), LINEAR, DT, 1, 1), leg_folder(tmp_path, 0), 1).touch()
    with pytest.raises(ScenarioError, match="contains states that LAMMPS wrote"):
        flow_lammps.export(scenario, tmp_path)


def test_the_command_line_writes_for_a_queue_or_says_what_is_missing(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(TOML.format(number=30, gate="gate"))
    words = ["run", "s.toml", "--engine", "lammps", "--ranks", "2"]
    done = stickslip_here(*words, "--export", "job", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "twin.toml").write_text('engine = "lammps"\nranks = 2\n' + TOML.format(number=30, gate="gate"))
    flow_lammps.export(read_scenario(tmp_path / "twin.toml"), tmp_path / "twin")
    mine, theirs = ((leg_folder(tmp_path / name, 0) / "in.lammps").read_text() for name in ("job", "twin"))
    assert mine == theirs and "mpirun -np 2 lmp" in (tmp_path / "job" / "run.sh").read_text()
    monkeypatch.setattr(process, "find_spec", lambda name: None)
    done = stickslip_here(*words[:4], "--out", "out", cwd=tmp_path)
    assert done.returncode == 2 and "LAMMPS is not installed" in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


# with it


def test_the_command_line_runs_lammps(peer, tmp_path):
    (tmp_path / "s.toml").write_text(TOML.format(number=30, gate="gate"))
    done = stickslip_here("run", "s.toml", "--engine", "lammps", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (tmp_path / "twin.toml").write_text('engine = "lammps"\n' + TOML.format(number=30, gate="gate"))
    twin = ss.simulate(read_scenario(tmp_path / "twin.toml"))
    series = archive.read(tmp_path / "out" / "results.h5")["series"]
    np.testing.assert_allclose(series["kinetic_energy"], twin.series.kinetic_energy, rtol=1e-6)


@pytest.fixture(scope="module")
def peer():
    try:
        process.require_lammps()
    except MissingExtraError as problem:
        pytest.skip(f"LAMMPS is absent: {problem}")


@pytest.mark.slow
@pytest.mark.parametrize("name", GRANULAR)
def test_first_steps_of_the_granular_style(peer, name):
    """The first step agrees; later, LAMMPS keeps the length of a slip that it turns with the normal."""
    law = GRANULAR[name]
    state = opened() if law.properties & ROLLING else stirred()
    for steps, most in ((1, 1e-14), (STEPS, 1e-4)):
        ours, _, _ = ss.run(state, law, steps, DT, slip_update="rate")
        theirs = run_in_lammps(state, law, steps, DT)[-1]
        assert differ(theirs.grains.velocity, ours.grains.velocity) < most
        assert differ(theirs.grains.spin, ours.grains.spin) < most


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forces", "rescaled forces"])
def test_memory_of_forces_goes_to_lammps(peer, name):
    law = GRANULAR[name]
    state, _, _ = ss.run(stirred(), law, STEPS, DT, slip_update="rate")
    ours, _, _ = ss.run(state, law, STEPS, DT, slip_update="rate")
    compare(ours, run_in_lammps(state, law, STEPS, DT)[-1])


@pytest.mark.slow
@pytest.mark.parametrize("make", [opened, on_a_floor])
def test_memory_of_rolling_goes_to_lammps(peer, make):
    """And comes back; within the step, LAMMPS keeps the lengths of what it turns with the normal."""
    law = GRANULAR["rolling"]
    state, _, _ = ss.run(make(), law, STEPS, DT, slip_update="rate")
    ours, _, _ = ss.run(state, law, 1, DT, slip_update="rate")
    theirs = run_in_lammps(state, law, 1, DT)[-1]
    rows, others = ss.measure.touching(ours), ss.measure.touching(theirs)
    assert differ(theirs.grains.spin, ours.grains.spin) < 1e-6
    assert differ(theirs.contacts.rolling[others, :3], ours.contacts.rolling[rows, :3]) < 1e-5
    without = state.contacts._replace(rolling=0 * state.contacts.rolling)
    lost = run_in_lammps(ss.accept(state, without), law, 1, DT)[-1]
    assert differ(lost.grains.spin, ours.grains.spin) > 1e-4


def compare(ours, theirs):
    """Grains, walls, cell and memory of the end of a run of ours and of one in LAMMPS."""
    for name in ("position", "velocity", "spin"):
        assert differ(getattr(theirs.grains, name), getattr(ours.grains, name)) < 1e-10, name
    assert differ(theirs.walls.point, ours.walls.point) < 1e-10
    assert differ(theirs.cell.vectors, ours.cell.vectors) < 1e-12
    assert differ(theirs.cell.rate, ours.cell.rate) < 1e-10
    rows, others = ss.measure.touching(ours), ss.measure.touching(theirs)
    assert (ours.contacts.key[rows] == theirs.contacts.key[others]).all() and len(rows) > 20
    assert differ(theirs.contacts.slip[others], ours.contacts.slip[rows]) < 1e-10
    return rows, others


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_first_steps_agree(peer, name):
    """Fifty steps from zero memory; contacts close, open, stick and slide on the way."""
    make, law = SCENES[name]
    state = make()
    ours, record, _ = ss.run(state, law, STEPS, DT, every=STEPS, slip_update="rate")
    assert 10 < record.sliding[-1] < record.touching[-1] - 10
    rows, others = compare(ours, run_in_lammps(state, law, STEPS, DT)[-1])
    if law.damping & 3 == 1 or not law.table[..., 3].any():  # without dashpots, modes are certain
        theirs = run_in_lammps(state, law, STEPS, DT)[-1]
        assert (ours.contacts.mode[rows] == theirs.contacts.mode[others]).all()


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 4])
@pytest.mark.parametrize(
    "name", ["packing with dashpots", "walls, disks", "spring", "cell sheared along xy", "shear under stresses"]
)
def test_several_ranks_agree(peer, tmp_path, name, ranks):
    """Also four of them on fewer cores, which `require_lammps` would refuse."""
    if process.find_mpirun() is None:
        pytest.skip("mpirun is absent")
    make, law = SCENES[name]
    state = make()
    ours, _, _ = ss.run(state, law, STEPS, DT, slip_update="rate")
    compare(ours, list(run_leg(Leg(state, law, DT, STEPS, 1, ranks=ranks), tmp_path))[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["packing", "walls, no dashpots", "shaken plate", "cell sheared along xz", "shear under stress"]
)
def test_memory_goes_to_lammps(peer, name):
    """A run of ours goes on in LAMMPS as it does here; with dashpots, a start is not exact on either side."""
    make, law = SCENES[name]
    state, _, _ = ss.run(make(), law, STEPS, DT, slip_update="rate")
    ours, _, _ = ss.run(state, law, STEPS, DT, slip_update="rate")
    compare(ours, run_in_lammps(state, law, STEPS, DT)[-1])
    lost = run_in_lammps(ss.accept(state, state.contacts._replace(slip=0 * state.contacts.slip)), law, STEPS, DT)[-1]
    assert differ(lost.grains.velocity, ours.grains.velocity) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("dim", [2, 3])
def test_drag_slows_translations_and_rotations_alike(peer, dim):
    """Of disks and spheres that fly freely: first order in dt, as LAMMPS takes velocities of the half step."""
    make = ss.disks if dim == 2 else ss.spheres
    spin = [0, 0, 0.3] if dim == 2 else [0.2, 0.1, 0.3]
    grains = make([[0, 0, 0], [3, 1, 0]], [0.5, 0.7], mass=[1.0, 3.0], velocity=[0.1, 0.2, 0], spin=spin)
    state, missed = ss.assembly(grains, cell=ss.box([1.0] * 3, [False] * 3, dim)), []
    for dt in (0.05, 0.025):
        ours, _, _ = ss.run(state, LINEAR, round(5 / dt), dt, drag=0.2)
        theirs = run_in_lammps(state, LINEAR, round(5 / dt), dt, drag=0.2)[-1]
        missed.append([differ(getattr(theirs.grains, n), getattr(ours.grains, n)) for n in ("velocity", "spin")])
    for coarse, fine in zip(*missed, strict=True):
        assert 1e-6 < coarse < 0.01 and fine == pytest.approx(coarse / 2, rel=0.1)


@pytest.mark.slow
def test_drag_in_a_deforming_cell_is_relative_to_its_flow(peer):
    """Exact where nothing turns: LAMMPS's own drag, which acts on rotations, is first order in dt."""
    law = ss.laws.hertz_mindlin_reff(1.0, 0.0, 0.0)
    for stress in ({}, {"yy": 0.05}):
        state = under_stress(stress, [[0, 0.05], [0, 0]])
        state.grains.spin[:] = 0.0
        ours, _, _ = ss.run(state, law, STEPS, DT, slip_update="rate", drag=0.1)
        free, _, _ = ss.run(state, law, STEPS, DT, slip_update="rate")
        theirs = run_in_lammps(state, law, STEPS, DT, drag=0.1)[-1]
        for name in ("position", "velocity"):
            assert differ(getattr(theirs.grains, name), getattr(ours.grains, name)) < 1e-10, name
        assert differ(theirs.cell.vectors, ours.cell.vectors) < 1e-12
        assert differ(free.grains.velocity, ours.grains.velocity) > 0.05


def test_formulas_of_a_deforming_cell_are_those_of_matrices():
    """Formulas of LAMMPS's variables for upper triangular matrices, as those of Python, beside NumPy."""
    a, b = np.triu(np.random.default_rng(0).uniform(0.5, 2.0, (2, 3, 3)))
    left, right = ({(i, j): f"({m[i, j]})" for i in range(3) for j in range(i, 3)} for m in (a, b))

    def value(formulas):
        out = np.zeros((3, 3))
        for place, text in formulas.items():
            out[place] = eval(text)
        return out

    np.testing.assert_allclose(value(supported._inverse(left)), np.linalg.inv(a), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(value(supported._product(left, right, left)), a @ b @ a, rtol=1e-12)
    np.testing.assert_allclose(value(supported._sum((2.0, left), (-0.5, right))), 2 * a - 0.5 * b, rtol=1e-12)
    one, turn = np.eye(3), value(supported._turn(right, 0.1))
    np.testing.assert_allclose(turn, np.linalg.solve(one + 0.025 * b, one - 0.025 * b), rtol=1e-12, atol=1e-15)


def test_drag_slows_a_cell_by_half_before_and_half_after_its_pull(tmp_path):
    leg = Leg(under_stress({"yy": 0.02}), REFF, DT, 10, 1, drag=0.3)
    text = script.write_input(leg, tmp_path).read_text()
    h, kept = 0.5 * DT, [float(x) for x in re.findall(r"cell_next_y equal v_cell_rate_y\*\(?([-\d.e]+)", text)]
    assert kept == pytest.approx([1 - 0.3 * h, (1 - 0.3 * h) / (1 + 0.3 * h)], rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_inertia_of_a_cell_depends_on_the_dimension(dim, tmp_path):
    leg = Leg(under_stress({"yy": 0.02}, dim=dim), REFF, DT, 10, 1)
    mass, power = re.search(r"/\(([\d.]+)\*vol\^([\d.]+)\)", script.write_input(leg, tmp_path).read_text()).groups()
    assert (float(mass), float(power)) == pytest.approx((20.0, 2 / dim))


@pytest.mark.slow
@pytest.mark.parametrize("stress", [{"yy": 0.02}, {"xx": 0.02, "yy": 0.02}])
def test_a_cell_in_shear_under_stress_agrees_while_its_tilt_grows(peer, stress):
    """To a strain of 1. LAMMPS flips its cell at 1/2 if the vector that it takes away stays as it is."""
    state = under_stress(stress, [[0, 0.1], [0, 0]])
    ours, _, _ = ss.run(state, REFF, 200, DT, slip_update="rate")
    theirs = run_in_lammps(state, REFF, 200, DT)[-1]
    whole = (theirs.cell.vectors - ours.cell.vectors) @ np.linalg.inv(ours.cell.vectors)
    assert np.abs(whole - np.round(whole)).max() < 1e-10 and np.round(whole).any() == (len(stress) == 1)
    for name in ("position", "velocity", "spin"):
        assert differ(getattr(theirs.grains, name), getattr(ours.grains, name)) < 1e-10, name


@pytest.mark.slow
def test_a_cell_comes_to_rest_under_its_stress(peer):
    law, wanted = SCENES["packing with dashpots"][1], np.array([0.018, 0.02, 0.022])
    state = under_stress(dict(zip(("xx", "yy", "zz"), wanted, strict=True)))
    state = state._replace(control=state.control._replace(cell_mass=0.0))
    end = run_in_lammps(state, law, 20_000, DT, drag=0.1)[-1]
    assert np.diag(ss.measure.stress(end, law)) == pytest.approx(wanted, rel=1e-3)
    assert np.abs(end.cell.rate).max() < 1e-5


FORCES = """
run 0
dump f all custom 1 forces.dump id fx fy fz tqx tqy tqz
dump_modify f sort id format float %.17g
run 0
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["packing", "packing with dashpots", "linear packing", "walls, no dashpots"])
def test_forces_with_the_memory_of_lammps_are_its_forces(peer, tmp_path, name):
    """LAMMPS evaluates its own state, in another process; we evaluate what came back of it.

    With dashpots once the grains have come to rest: in motion, we cut the spring of a sliding contact at the limit and
    then the sum, LAMMPS the sum only.
    """
    make, law = SCENES[name]
    steps, drag = (20_000, 0.05) if law.table[0, 0, 3] else (200, 0.0)
    leg = Leg(make(), law, DT, steps, 1, drag)
    leg = leg._replace(state=leg.state._replace(control=leg.state.control._replace(gravity=np.zeros(3))))
    theirs = list(run_leg(leg, tmp_path))[-1]
    loads, _ = ss.forces(theirs, law, memory=FROZEN)
    begin = restart_path(leg, tmp_path, steps).name
    still = leg._replace(state=theirs)
    words = script.contact_commands(still, begin) + "\nfix loose all nve/sphere\n" + FORCES
    (tmp_path / "in.forces").write_text(words)
    done = process.run_lammps("in.forces", folder=tmp_path)
    assert done.returncode == 0, process.error_line(done)
    rows = (tmp_path / "forces.dump").read_text().split("ITEM: ATOMS")[1].splitlines()[1:]
    found = np.array([row.split() for row in rows], float)
    n = len(found)
    scale = np.abs(ss.measure.contact_forces(theirs, law)).max()
    assert np.abs(loads.force[:n] - found[:, 1:4]).max() < 1e-10 * scale
    assert np.abs(loads.torque[:n] - found[:, 4:7]).max() < 1e-10 * scale
    lost = ss.accept(theirs, theirs.contacts._replace(slip=0 * theirs.contacts.slip))
    assert np.abs(ss.forces(lost, law, memory=FROZEN)[0].force[:n] - found[:, 1:4]).max() > 1e-3 * scale


@pytest.mark.slow
def test_the_stability_of_a_state_that_lammps_made_is_judged(peer, tmp_path):
    """A packing that came to rest in LAMMPS balances with its memory, and without it does not."""
    law = SCENES["packing with dashpots"][1]
    state = run_in_lammps(stirred(), law, 40_000, DT, drag=0.05)[-1]
    lost = ss.accept(state, state.contacts._replace(slip=0 * state.contacts.slip))
    for one, words, code in ((state, "stable", 0), (lost, "equilibrium", 3)):
        ss.io.write_packing(tmp_path / "made.npz", one, law)
        command = [sys.executable, "-m", "stickslip", "stability", str(tmp_path / "made.npz"), "--quiet"]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == code and words in done.stdout, (done.stdout, done.stderr)


SHEAR = SHEARED | {
    "samples": 400,
    "grains": SHEARED["grains"] | {"number": 45},
    "stages": [
        {"name": "compress", "duration": 20.0},
        {"name": "shear", "duration": 150.0, "velocity": {"top": {"x": 1.0}}},
    ],
}


@pytest.mark.slow
def test_steady_shear_agrees(peer):
    """Friction of plane shear: means over the second half, from the same start; what they differ by is chance."""
    means = []
    for engine, ranks in (("stickslip", 1), ("lammps", 1), ("lammps", 2)):
        result = ss.simulate(ss.scenario(experiment="flow", engine=engine, ranks=ranks, **SHEAR))
        late = result.series.time > 95.0
        force = result.series.plate_force[late, 1]
        series, friction = result.series, -force[:, 0] / force[:, 1].mean()
        parts = friction, force[:, 1], series.plate_position[late, 1, 1], series.coordination[late]
        means.append([steady_mean(part) for part in parts])
        print(engine, ranks, means[-1])
    for mine, *theirs in zip(*means, strict=True):
        for one in theirs:
            # three combined standard errors, and a floor where errors of short series are too small
            assert abs(mine.mean - one.mean) < 3 * np.hypot(mine.error, one.error) + 0.02 * abs(mine.mean)


@pytest.mark.slow
def test_a_stage_ends_at_rest_and_a_crash_keeps_what_was_finished(peer, tmp_path, monkeypatch):
    """The message is the last line of LAMMPS's log; the run goes on from there."""
    stages = [
        {"name": "settle", "duration": 60.0, "until": "rest", "drag": 1.0},
        {"name": "open", "duration": 1.0, "remove": ["gate"]},
    ]
    scenario = ss.scenario(experiment="flow", engine="lammps", **SETTLING | {"stages": stages, "samples": 200})
    place = script._place_commands

    def broken(leg):
        return "print oh\nunknown_command 3\n" if leg.number == 1 else place(leg)

    monkeypatch.setattr(script, "_place_commands", broken)
    with pytest.raises(RuntimeError, match=r"LAMMPS stopped at step 0 of .*: unknown_command 3") as found:
        ss.simulate(scenario, folder=tmp_path)
    assert "\n" not in str(found.value)
    monkeypatch.setattr(script, "_place_commands", place)
    assert read_pieces(tmp_path)[0]
    result = ss.simulate(scenario, folder=tmp_path)
    settle, after = result.stages
    assert settle.rested and settle.end < 59.0 and after.end == pytest.approx(settle.end + 1.0, rel=1e-3)


@pytest.mark.slow
def test_a_folder_written_for_a_queue_is_read_back(peer, tmp_path):
    """`run.sh` runs LAMMPS without this package; the result is that of the same legs run here."""
    stages = [{"name": "settle", "duration": 2.0}, {"name": "open", "duration": 0.2, "remove": ["gate"]}]
    tables = SETTLING | {"stages": stages, "law": SETTLING["law"] | {"restitution": 1.0}}
    scenario = ss.scenario(experiment="flow", engine="lammps", **tables)
    flow_lammps.export(scenario, tmp_path)
    with pytest.raises(ScenarioError, match=r"LAMMPS has not run in .*leg-01: let it finish there first"):
        ss.simulate(scenario, folder=tmp_path)
    lmp = process.which("lmp", path=os.path.dirname(sys.executable)) or process.which("lmp")
    if lmp is None:
        pytest.skip("the executable of LAMMPS is absent")
    done = subprocess.run(
        ["sh", "run.sh", lmp], cwd=tmp_path, capture_output=True, text=True, env=process._environment()
    )
    assert done.returncode == 0, done.stderr
    found, here = ss.simulate(scenario, folder=tmp_path), ss.simulate(scenario)
    assert [stage.name for stage in found.stages] == ["settle", "open"]
    assert found.series.wall_point[-1, 2, 0] != found.series.wall_point[-1, 2, 0]  # the gate is gone
    k = np.flatnonzero(here.series.kinetic_energy > 0)[5]
    assert differ(found.series.center[: k + 1], here.series.center[: k + 1]) < 1e-10
    assert found.series.time == pytest.approx(here.series.time)


def test_grains_of_different_inertia_have_no_factor():
    state = stirred()
    assert supported.inertia_factor(state) == pytest.approx(0.4)
    other = state.grains.inertia * np.where(np.arange(len(state.grains.mass)) % 2, 1.0, 1.5)
    assert np.isnan(supported.inertia_factor(state._replace(grains=state.grains._replace(inertia=other))))
