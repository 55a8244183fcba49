"""Foreign files are accounted for: what is used, without influence on forces, or not understood, and then undecided."""

import json
import re

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange import lammps_restart
from stickslip.data.exchange.lammps_course import MOVERS, TAKEN
from stickslip.data.exchange.lammps_series import GRAINS, find_dumps, frames_of
from stickslip.data.sample import Obstacle, account_of
from stickslip.known import HARMLESS, UNKNOWN, USED, group_of, plain_style
from tests.exchange.test_lammps_runs import HERTZ, HOOKE, answer, in_poured


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Modes are written to the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("bond_style harmonic", ""),  # atoms of style sphere have no bonds
        (
            "improper_style harmonic",
            "improper_style harmonic (log.lammps, line 162) was not imported: it exerts forces",
        ),
        ("angle_style charmm\nangle_style none", ""),
        ("kspace_style pppm 1e-4", "kspace_style pppm 1e-4 (log.lammps, line 162)"),
        ("bond_style harmonic\nclear\npair_style gran/hooke/history 2000 NULL 20 10 0.4 1", "has no fix wall/gran at"),
        ("reading bonds ...\n  192 angles\n  0 bonds", "192 angles (log.lammps, line 163) were not imported"),
        ("echo screen", "log.lammps does not repeat the commands that follow `echo screen`"),
        ("fix b all bond/create 1 1 1 1.0 1", "fix b (bond/create) was not imported: it acts on the grains (log.lamm"),
        ("fix e all efield 0 0 1", "fix e (efield)"),
        ("fix m all mystery/style 1", "whether it acts on the grains is unknown"),
        ("fix m all mystery/style 1\nunfix m", ""),
        ("frobnicate all 3", "frobnicate all 3 (log.lammps, line 162) was not imported: it is unknown"),
        ("print 'frobnicate all 3'\nfrobnicate all 3", ""),
        ('print """\nfix a b ${c}\n"""\n\nfix a b c\n', ""),
        ("print 'frobnicate all 3'\nprint x\nx\nfrobnicate all 3", "frobnicate all 3 (log.lammps, line 165)"),
        (
            "run 0\nstep of it\nPer MPI rank memory allocation x\nLoop time of 1 on 1 procs for 0 steps with 24 atoms",
            "",
        ),
        ('variable s string "granular ${a} 1"\ngranular 2 1\ndynamic group low defined', ""),
        ("package omp 0\nset 1 OpenMP thread(s)\nusing multi-threaded lists\n  fix style: X, fix ID: y", ""),
        ("fix p all print 100 'step $(step)'\nfix_modify p energy no\ndump_modify d sort id", ""),
        (
            "minimize 1e-4 1e-6 10 10\nbox tilt large\nprocessors 1 1 1\nreset_atoms image all\nspecial_bonds lj 0 0 0",
            "",
        ),
        ("fix l all langevin/omp 1 1 1 4", "fix l (langevin) was not imported"),
        ("group low id 1:3\nfix z low freeze\nfix h all gravity 1 vector 0 0 -1", "it follows the fix that holds"),
        ("fix w2 all wall/gran 2000 NULL 50 NULL 0.5 1 zplane 0 NULL", ""),
        ("fix q all gravity v_g vector 0 0 -1", "v_g is a variable whose value is unknown outside LAMMPS"),
        ("pair_style hybrid/overlay granular lj/cut 0.5", "no pair_coeff defines a law for the types of the grains"),
        ("fix twice all nve/sphere", "fix twice (nve/sphere) was not imported: it moves 24 grains that another fix"),
        ("group low id 1:3\nfix slow low nve/limit 0.1", "it moves 3 grains that another fix also moves"),
        ("unfix move\ngroup low id 1:3\ngroup up subtract all low\nfix a low nve/sphere\nfix b up nve/sphere", ""),
        ("fix still all momentum 1 linear 1 1 1", "it removes momentum, and walls, loads and held grains change"),
        ("fix back all recenter INIT INIT INIT", "it moves grains back, and walls, loads and held grains change"),
        ("group d dynamic all every 10\nfix a d addforce 0 0 1", "the members of group d change with time"),
        ("group d dynamic all every 10\ngroup d static\nfix z all langevin 1 1 1 4\nunfix z", ""),
        ("fix m all momentum/chunk 1 c linear 1 1 1", "fix m (momentum/chunk) was not imported: it acts"),
        (
            "pair_style gran/hooke 2000 NULL 20 NULL 0.4 1",
            "cannot hold grains at rest, and no equivalent law exists here",
        ),
        ("labelmap atom 1 a 2 b\ngroup low type b\nfix z low spring/self 1\nunfix z\nfix c low freeze\nunfix c", ""),
    ],
)
def test_commands_that_may_make_forces_have_their_names_and_places(line, text, cases, tmp_path):
    """And others raise no alarm."""
    notes = ss.io.read_packing(in_poured(cases, tmp_path, line)).notes
    left_out = [note for note in notes if isinstance(note, Obstacle)]
    assert any(text in note for note in left_out) if text else not left_out


GRANULAR = "granular hooke 2000 20 tangential linear_history 571.4 0.5 0.4 damping mass_velocity"
HOOKE_HISTORY = "gran/hooke/history 2000 571.4 20 10 0.4 1"


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        (f"hybrid {HOOKE_HISTORY}\npair_coeff * * gran/hooke/history", ""),
        (f"hybrid/overlay {HOOKE_HISTORY} zero 1\npair_coeff * * gran/hooke/history\npair_coeff * * zero", ""),
        (f"hybrid/scaled 1.0 {HOOKE_HISTORY}\npair_coeff * * gran/hooke/history", ""),
        (f"hybrid granular {HOOKE_HISTORY}\npair_coeff 1 * {GRANULAR}\npair_coeff 2 2 gran/hooke/history", ""),
        (f"hybrid granular\npair_coeff 1 1 {GRANULAR}\npair_coeff 2 2 {GRANULAR}", ""),
        (f"granular\nlabelmap atom 1 a 2 b\npair_coeff a a {GRANULAR[9:]}\npair_coeff b b {GRANULAR[9:]}", ""),
        (f"granular\npair_coeff a a {GRANULAR[9:]}", "the type a is neither a number nor a label in a labelmap"),
        (
            f"hybrid {HOOKE_HISTORY}\npair_coeff * * gran/hooke/history\npair_coeff 1 2 none",
            "pair_coeff defines no forces between types 1 and 2, but 22 contacts between them would have some here",
        ),
        (
            f"hybrid/scaled 0.5 {HOOKE_HISTORY} v_a lj/cut 1\npair_coeff * * gran/hooke/history",
            "it multiplies forces by factors (0.5 v_a), but only factors of 1 are supported",
        ),
        (
            f"hybrid/overlay {HOOKE_HISTORY} lj/cut 1\npair_coeff * * gran/hooke/history\npair_coeff 1 2 lj/cut 1 1",
            "it adds the forces of gran/hooke/history and lj/cut, but only one contact law is supported",
        ),
        (
            f"hybrid {HOOKE_HISTORY} lj/cut 1\npair_coeff 1 * gran/hooke/history\npair_coeff 2 2 lj/cut 1 1",
            "its part lj/cut acts between some types: no equivalent law exists here",
        ),
    ],
)
def test_parts_of_hybrid_styles_and_labels_of_types(lines, text, cases, tmp_path):
    """The law is that of the part alone, or the true cause is named."""
    in_poured(cases, tmp_path, f"pair_style {lines}", "poured.data")
    changed(tmp_path, "log.lammps", "write_data poured.data", f"pair_style {lines}\nwrite_data poured.data")
    read = ss.io.read_packing(tmp_path)
    left_out = [note for note in read.notes if isinstance(note, Obstacle)]
    assert any(text in note for note in left_out) if text else not left_out
    if not text:
        np.testing.assert_allclose(read.law.table[:2, :2], np.tile([2000, 571.4, 0.4, 20, 10], (2, 2, 1)), rtol=1e-3)


def obstacles(folder, **options):
    return [note for note in ss.io.read_packing(folder, **options).notes if isinstance(note, Obstacle)]


def changed(folder, name, old, new):
    """Change a file in a folder; the old text must be there."""
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new))


def test_commands_are_those_at_the_time_of_the_grains(cases, tmp_path):
    """A dashpot that was removed later acted on grains that were written before, and one that came later did not."""
    text = (in_poured(cases, tmp_path) / "log.lammps").read_text()
    own = "write_restart poured.restart"
    (tmp_path / "log.lammps").write_text(text.replace(own, f"fix s all spring/self 1\n{own}\nunfix s"))
    assert "fix s (spring/self)" in obstacles(tmp_path)[0]
    later = f"{own}\nfix s all spring/self 1\nrun 9\nLoop time of 1 on 1 procs for 9 steps with 24 atoms"
    (tmp_path / "log.lammps").write_text(text.replace(own, later))
    assert not obstacles(tmp_path)
    restart = text.replace(own, "write_restart other").replace("200000", "300000")
    restart = restart.replace("run 300000", "restart 100000 *.restart\nrun 300000")
    (tmp_path / "log.lammps").write_text(restart)  # written in the middle of the run
    assert any("fix drag (viscous)" in note for note in obstacles(tmp_path))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "2000 571.428571428571 20.0 10.0 0.4 1",
            "2000 571.428571428571 20.0 10.0 0.9 1",
            "not in poured.restart (0.9)",
        ),
        ("2000 571.428571428571 20.0 10.0 0.4 1", "2000 571.428571428571 30.0 10.0 0.4 1", "not in poured.restart (30"),
        ("200000", "1000", "log.lammps goes from 0 to 1000: they belong to another run"),
        ("with 24 atoms", "with 25 atoms", "24 grains were read, but the run of log.lammps had 25"),
        ("fix w all wall/gran", "#", "has no fix wall/gran at that time, but poured.restart has one, w"),
        ("gran/hooke/history 2000", "gran/hooke/history/omp 2000", ""),
        ("\n", "\r\n", ""),
        ("Total wall time", "LAMMPS (22 Jul 2025)\nunits lj\nTotal wall time", ""),
    ],
)
def test_the_log_and_the_restart_file_are_of_one_run(old, new, text, cases, tmp_path):
    changed(in_poured(cases, tmp_path), "log.lammps", old, new)
    left_out = obstacles(tmp_path)
    assert any(text in note for note in left_out) if text else not left_out


def test_grains_of_the_beginning_and_logs_without_commands(cases, tmp_path):
    text = (in_poured(cases, tmp_path, name="poured.data") / "log.lammps").read_text()
    begin = text.replace("write_data", "write_data other").replace(
        "timestep 0.002", "timestep 0.002\nwrite_data poured.data"
    )
    (tmp_path / "log.lammps").write_text(begin)
    changed(tmp_path, "poured.data", "timestep = 200000", "timestep = 0")
    assert not any("does not repeat" in note for note in obstacles(tmp_path))
    names = r"(units|atom_style|run|fix|pair_style|pair_coeff|boundary)\b"
    (tmp_path / "log.lammps").write_text("\n".join(line for line in text.split("\n") if not re.match(names, line)))
    assert any("log.lammps does not repeat its commands" in note for note in obstacles(tmp_path))


def test_the_newest_run_of_a_folder_counts(cases, tmp_path):
    """Files of an older run, which went on for longer, are left out, and it is said."""
    in_poured(cases, tmp_path)
    content = (tmp_path / "poured.restart").read_bytes()
    step, later = (np.int64(count).tobytes() for count in (200000, 300000))
    assert step in content
    (tmp_path / "poured.300000.restart").write_bytes(content.replace(step, later))
    changed(tmp_path, "log.lammps", "run 200000", "restart 100000 poured.*.restart\nrun 200000")
    read = ss.io.read_packing(tmp_path)
    told = "poured.300000.restart (time step 300000, and log.lammps goes from 0 to 200000)"
    assert any(told in note for note in read.notes) and "grains from poured.restart, time step 200000" in read.notes
    assert not obstacles(tmp_path)
    (tmp_path / "poured.restart").unlink()
    assert any("they belong to another run" in note for note in obstacles(tmp_path))


AGAIN = (
    "reset_timestep 0\nfix h all gravity 2 vector 0 0 -1\nrun 100\nLoop time of 1 on 1 procs for 100 steps "
    "with 24 atoms"
)


@pytest.mark.parametrize("lines", [f"{AGAIN}\nwrite_restart again.restart", f"restart 100 again.restart\n{AGAIN}"])
def test_after_reset_timestep_the_newest_file_has_an_earlier_step(lines, cases, tmp_path):
    log = (in_poured(cases, tmp_path) / "log.lammps").read_text()
    content = (tmp_path / "poured.restart").read_bytes()
    (tmp_path / "again.restart").write_bytes(content.replace(np.int64(200000).tobytes(), np.int64(100).tobytes()))
    own = "write_restart poured.restart"
    (tmp_path / "log.lammps").write_text(log.replace(own, f"{own}\n{lines}"))
    read = ss.io.read_packing(tmp_path)
    assert "grains from again.restart, time step 100" in read.notes and read.state.control.gravity[2] == -3
    (tmp_path / "again.restart").unlink()
    assert ss.io.read_packing(tmp_path).state.control.gravity[2] == -1 and not obstacles(tmp_path)
    (tmp_path / "again.restart").write_bytes(content)
    (tmp_path / "log.lammps").unlink()
    script = "".join(line for line in (cases / "poured" / "in.poured").open() if not line.startswith("set"))
    (tmp_path / "in.poured").write_text(f"{script}\nreset_timestep 0\nrun 100\n")
    assert any("in.poured resets the time step, and only its log" in note for note in obstacles(tmp_path))


def test_of_two_frames_with_one_time_step_the_last_counts(cases, tmp_path):
    text = (cases / "poured" / "dump.grains").read_text()
    (tmp_path / "twice.dump").write_text(text + text.replace("0.523598775598299", "2"))
    for frame in (None, "200000"):
        assert ss.io.read_packing(tmp_path / "twice.dump", frame=frame).state.grains.mass.max() == 2
    assert len(ss.io.read_packings(tmp_path / "twice.dump")) == 2
    _, notes = frames_of(find_dumps(tmp_path, {}), GRAINS)
    assert notes == ["step 200000 occurs twice in twice.dump, as after `reset_timestep`: the last one is used"]


@pytest.mark.parametrize(
    ("name", "old", "new", "text"),
    [
        ("dump.grains", " type x y z", " mystery x y z", "column mystery of dump.grains is unknown"),
        ("dump.grains", " mass ", " c_stress[1] ", ""),
        ("dump.grains", " mass ", " q ", "charges repel"),
        ("dump.grains", "ITEM: BOX", "ITEM: MYSTERY\n1\nITEM: BOX", "item MYSTERY of dump.grains is unknown"),
        ("poured.data", "\nVelocities", "\nAngles\n\n1 1 1 2 3\n\nVelocities", "section Angles of poured.data"),
        ("poured.data", "\nVelocities", "\nMystery\n\n1 2\n\nVelocities", "section Mystery of poured.data"),
        ("poured.data", "\nVelocities", "\nBond Coeffs\n\n1 2\n\nVelocities", ""),
        ("poured.data", "24 atoms", "24 atoms\n3 angles\n0 bonds", "heading angles of poured.data"),
    ],
)
def test_parts_of_files_that_are_not_understood_have_their_names(name, old, new, text, cases, tmp_path):
    for file in (name, "log.lammps"):
        (tmp_path / file).write_bytes((cases / "poured" / file).read_bytes())
    changed(tmp_path, name, old, new)
    left_out = obstacles(tmp_path)
    assert any(text in note for note in left_out) if text else not left_out


def test_everything_is_in_one_of_three_groups(cases, tmp_path, capsys):
    """Also the files of a folder; those that are not understood make no forces, but are named."""
    in_poured(cases, tmp_path, "fix s all spring/self 1")
    for name in ("README.md", "movie.gif", "walls.bin", "notes"):
        (tmp_path / name).write_bytes(b"\0x")
    groups = account_of(ss.io.read_packing(tmp_path).notes)
    assert {"file poured.restart", "file log.lammps", "fix w (wall/gran)", "command boundary"} <= set(groups[USED])
    assert {"file README.md", "file movie.gif", "command velocity"} < set(groups[HARMLESS])
    assert {"file walls.bin", "file notes"} < set(groups[UNKNOWN]) and len(groups[UNKNOWN]) == 3
    code, said = answer(capsys, "stability", tmp_path, "--json")
    assert code == 3 and '"not_understood": ["fix s (spring/self) was not' in said


def test_grains_without_motion_or_types(cases, tmp_path):
    """What is assumed is said; types are needed where their laws differ."""
    for run, several in (("sheared", False), ("materials", True)):
        for name in ("log.lammps", "dump.grains"):
            (tmp_path / name).write_bytes((cases / run / name).read_bytes())
        changed(tmp_path, "dump.grains", " type x y z ", " mol x y z ")
        changed(tmp_path, "dump.grains", " vx vy vz omegax omegay omegaz ", " c_a c_b c_c c_d c_e c_f ")
        read = ss.io.read_packing(tmp_path)
        assert "dump.grains has no velocities and no spins: the grains are assumed to be at rest" in read.assumed
        missing = [note for note in obstacles(tmp_path) if "the grains have no types" in note]
        assert bool(missing) == several
    assert not [note for note in obstacles(tmp_path, law="linear", kn=1e3) if "no types" in note]


@pytest.mark.parametrize(
    ("fix", "velocity", "text"),
    [
        ("freeze", "0.5 0 0 0 0 0", "have velocities and would move on: `velocity low set 0 0 0` stops them"),
        ("freeze", "0 0 0 0 0 1", "have spins and would go on turning: `set group low omega 0 0 0` stops them"),
        ("setforce NULL NULL 0", "0.5 0 0 0 0 1", ""),
        ("setforce 0 NULL NULL", "0.5 0 0 0 0 0", "fix z (setforce) was not imported: its grains have velocities"),
    ],
)
def test_held_grains_that_move_go_on(fix, velocity, text, cases, tmp_path):
    """LAMMPS makes their forces zero, and the fix that moves them takes their velocities."""
    folder = in_poured(cases, tmp_path, f"group low id 2\nfix z low {fix}", "poured.data")
    changed(folder, "poured.data", "\n2 0 0 0 0 0 0\n", f"\n2 {velocity}\n")
    left_out = obstacles(folder)
    assert any(text in note for note in left_out) if text else not left_out


ONLY = "grains, of {} in the run of log.lammps: `{}` leaves out others, which may touch them; give a dump of all"


@pytest.mark.parametrize(
    ("before", "modify", "left", "atoms", "text"),
    [
        ("", "thresh z < 4.5", 20, 24, "contains 20 " + ONLY.format(24, "dump_modify grains thresh z < 4.5")),
        ("delete_atoms group top", "thresh z < 4.5", 20, 24, ONLY.format(24, "dump_modify grains thresh z < 4.5")),
        ("delete_atoms group top", "thresh z < 4.5 thresh none", 20, 20, ""),
        ("delete_atoms group top compress no", "sort id", 20, 20, ""),
        (
            "delete_atoms group top",
            "sort id",
            20,
            24,
            "20 grains were read, but the run of log.lammps had 24 at that time",
        ),
        ("", "thresh z < 45", 24, 24, ""),
        ("group low id 1:20", "sort id", 20, 24, ONLY.format(24, "dump grains low")),
    ],
)
def test_a_dump_that_leaves_grains_out(before, modify, left, atoms, text, cases, tmp_path):
    """Its command is named, also where grains were deleted before, whose ids may be missing then."""
    head, _, rows = (cases / "poured" / "dump.grains").read_text().partition(" tqz\n")
    rows = sorted(rows.splitlines(keepends=True), key=lambda row: int(row.split()[0]))
    rows = rows[4:] if "compress no" in before else rows[:left]
    (tmp_path / "dump.grains").write_text(f"{head} tqz\n{''.join(rows)}".replace("\n24\n", f"\n{left}\n"))
    log = (cases / "poured" / "log.lammps").read_text().replace("dump grains all", f"{before}\ndump grains all")
    log = log.replace("dump grains all", "dump grains low") if "low" in before else log
    first, mark, last = log.partition("dump_modify grains")
    log = first + f"dump_modify grains {modify}\n" + mark + last.replace("with 24 atoms", f"with {atoms} atoms")
    (tmp_path / "log.lammps").write_text(log)
    read = ss.io.read_packing(tmp_path)
    left_out = [note for note in read.notes if isinstance(note, Obstacle)]
    assert any(text in note for note in left_out) if text else not left_out
    assert not any("dump of a group" in note for note in read.notes)


@pytest.mark.parametrize(
    ("modify", "old", "new"),
    [
        ("colname radius RAD", " radius ", " RAD "),
        ("colname 3 PX", " x y", " PX y"),
        ("colname mass density", " mass ", " density "),
        ("colname x y colname y x", " x y ", " y x "),
        ("colname -1 fx colname fx TZ", " fx fy fz tqx tqy tqz", " TZ fy fz tqx tqy fx"),
    ],
)
def test_columns_that_a_run_renames_keep_their_meaning(modify, old, new, cases, tmp_path):
    known = ss.io.read_packing(cases / "poured" / "dump.grains", law="linear")
    for name in ("dump.grains", "log.lammps"):
        (tmp_path / name).write_bytes((cases / "poured" / name).read_bytes())
    changed(tmp_path, "dump.grains", old, new)
    changed(tmp_path, "log.lammps", "dump_modify grains", f"dump_modify grains {modify}\ndump_modify grains")
    read = ss.io.read_packing(tmp_path)
    assert not [note for note in read.notes if isinstance(note, Obstacle)]
    np.testing.assert_array_equal(read.state.grains.position, known.state.grains.position)
    np.testing.assert_array_equal(read.state.grains.mass, known.state.grains.mass)


def test_columns_that_were_renamed_are_told_without_a_log(cases, tmp_path):
    (tmp_path / "dump.grains").write_bytes((cases / "poured" / "dump.grains").read_bytes())
    changed(tmp_path, "dump.grains", " fx fy", " PUSH fy")
    remedy = "or, if `dump_modify colname` renamed it, give its name in LAMMPS"
    assert any("column PUSH of dump.grains" in note and remedy in note for note in obstacles(tmp_path))
    for name in ("x", "radius"):
        changed(tmp_path, "dump.grains", f" {name} ", f" RENAMED_{name} ")
        with pytest.raises(ss.packings.PackingError, match="`dump_modify colname` may have renamed them"):
            ss.io.read_packing(tmp_path / "dump.grains")


def test_setforce_leaves_rotations_free_and_nve_holds_them(cases, tmp_path):
    line = "group low id 1:3\nfix z low setforce 0 0 0\ngroup high id 24\nfix y high setforce NULL NULL 0"
    free = ss.io.read_packing(in_poured(cases, tmp_path, line)).state.control.free
    assert (~free[:3, :3]).all() and free[:3, 3:].all() and free[23].tolist() == [True, True, False, True, True, True]
    line = "group low id 1:3\nfix z low freeze"
    assert not ss.io.read_packing(in_poured(cases, tmp_path, line)).state.control.free[:3].any()
    changed(in_poured(cases, tmp_path), "log.lammps", "nve/sphere", "nve")
    read = ss.io.read_packing(tmp_path)
    assert "fix nve does not rotate 24 grains: their rotations are held" in read.notes
    assert read.state.control.free[:24, :3].all() and not read.state.control.free[:24, 3:].any()


UNSURE = "are uncertain"


@pytest.mark.parametrize(
    ("lines", "held"),
    [
        ("group low id 1:3\ngroup low clear\ngroup low id 24", [24]),
        ("group a id 1:3\ngroup low union a\ngroup a id 20:24", [1, 2, 3]),
        ("group low id 1:5\ngroup b id 4:5\ngroup low subtract low b", [1, 2, 3]),
        ("group low id 1:5\ngroup b id 4:5\ngroup c id 24\ngroup low subtract c b", [1, 2, 3, 24]),
        ("group low id 24\n3 atoms in group low", UNSURE),  # the group was there in a restart file
        ("group low id 24\n1 atoms in group low", [24]),
        ("group low type 1\nset atom 24 type 2", UNSURE),
        ("group low id 24\nset atom 24 type 2", [24]),
        ("group a type 2\ngroup low union a\nset atom 24 type/fraction 2 0.5 1", UNSURE),
        ("group low id 24\ndelete_atoms overlap 0.1 all all", UNSURE),
        ("group low id 24\ndelete_atoms overlap 0.1 all all compress no", [24]),
        ("group low id 24\nreplicate 2 1 1\ngroup low clear\ngroup low id 1", [1]),
    ],
)
def test_groups_are_those_when_their_commands_ran(lines, held, cases, tmp_path):
    """LAMMPS adds the grains that are there at that time; later ids, types and groups change nothing."""
    read = ss.io.read_packing(in_poured(cases, tmp_path, f"{lines}\nfix z low freeze"))
    left_out = [note for note in read.notes if isinstance(note, Obstacle)]
    if held == UNSURE:
        assert any(f"the members of group low {UNSURE}" in note for note in left_out)
    else:
        assert not left_out
        assert (np.flatnonzero(~read.state.control.free[:24, 0]) + 1).tolist() == held


@pytest.mark.parametrize("dimension", ["", "dimension 2\n"])
def test_a_layer_in_three_dimensions_may_buckle(dimension, tmp_path):
    """All grains at z = 0 mean two dimensions only where the run has two."""
    heads = "id type x y z vx vy vz omegax omegay omegaz radius mass"
    rows = "1 1 1 1 0 0 0 0 0 0 0 0.5 1\n2 1 1.99 1 0 0 0 0 0 0 0 0.5 1\n"
    box = "ITEM: BOX BOUNDS ff ff ff\n0 5\n0 5\n-1 1\n"
    head = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\n{box}ITEM: ATOMS {heads}\n"
    (tmp_path / "layer.dump").write_text(head + rows)
    script = f"{dimension}atom_style sphere\npair_style {HOOKE_HISTORY}\npair_coeff * *\nfix m all nve/sphere\n"
    (tmp_path / "in.layer").write_text(f"{script}dump d all custom 1 layer.dump {heads}\n")
    assert any("motion along z is left out" in note for note in obstacles(tmp_path)) == (not dimension)


def test_a_script_changes_nothing_in_a_dump_that_it_closed(cases, tmp_path):
    (tmp_path / "dump.grains").write_bytes((cases / "poured" / "dump.grains").read_bytes())
    law = f"pair_style {HOOKE_HISTORY}\npair_coeff * *\nfix m all nve/sphere\ndump d all custom 1 dump.grains id\nrun 9"
    later = "pair_style gran/hooke/history 2000 571.4 20 10 0.1 1\nrun 9"
    for end, friction in (("undump d", 0.4), ("", 0.1), ("undump d\ndump d all custom 1 dump.grains id", 0.1)):
        (tmp_path / "in.poured").write_text(f"atom_style sphere\n{law}\n{end}\n{later}\n")
        assert ss.io.read_packing(tmp_path).law.table[0, 0, 2] == friction


def test_regions_in_units_of_the_lattice(cases, tmp_path):
    """The spacing of 1.49 is in the log; `units box` has its own."""
    log = (in_poured(cases, tmp_path) / "log.lammps").read_text()
    style = re.search(r"(?m)^fix w all wall/gran (granular hooke 2000 20 [^$]* mass_velocity) zplane 0 NULL$", log)[1]
    for units, height in (("", -1.4938016), (" units lattice side in", -1.4938016), (" side in units box", -1.0)):
        lines = f"region low plane 0 0 -1 0 0 1{units}\nfix q all wall/gran/region {style} region low"
        read = ss.io.read_packing(in_poured(cases, tmp_path, lines))
        assert read.state.walls.point[-1, 2] == pytest.approx(height)


def test_the_spacing_is_that_of_the_lattice_before_the_region(cases, tmp_path):
    lines = "region low plane 0 0 -1 0 0 1\nfix q all wall/gran/region hooke/history 1 1 0 0 0.5 1 region low"
    log = (in_poured(cases, tmp_path) / "log.lammps").read_text()
    (tmp_path / "log.lammps").write_text(log.replace("lattice sc 0.3", f"{lines}\nlattice sc 0.3"))
    assert ss.io.read_packing(tmp_path).state.walls.point[:, 2].min() == pytest.approx(-1)


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ("fix p all addforce 0 0 -0.3", "loads: forces on 24 of 24 grains would balance without the external forces"),
        ("unfix g", "gravity: forces on 24 of 24 grains would balance under gravity (0, 0, -1)"),
        (
            "unfix g\nfix g all gravity 9 vector 0 0 -1\nfix p all addforce 0 0 5.2359878",
            "gravity: forces on 24 of 24 grains would balance under gravity (0, 0, -2)",
        ),
    ],
)
def test_loads_that_were_read_are_not_missing(lines, text, cases, capsys, tmp_path):
    """A push that the packing has not come to rest under is a cause of its own."""
    _, said = answer(capsys, "stability", in_poured(cases, tmp_path, lines), "--modes", tmp_path / "m.npz")
    assert text in said and ("likely causes: - gravity" in said) == text.startswith("gravity")


def test_grains_without_memory_of_contacts(cases, tmp_path):
    """A restart file of a style without history: its records end where memory would begin."""
    content = (cases / "sheared" / "sheared.restart").read_bytes()
    _, (block,) = lammps_restart._blocks(content)
    lists = content.index(b"\1\0\0\0\x12\0\0\0NEIGH_HISTORY_HH0")
    head = content[:lists].replace(b"\x13\0\0\0gran/hertz/history\0", b"\x0b\0\0\0gran/hooke\0")
    records = np.stack([block[k : k + lammps_restart.EXTRA] for k in lammps_restart._record_starts(block)[:-1]])
    records[:, 0] = lammps_restart.EXTRA
    parts = [head, bytes(8), lammps_restart.HEADER_END, lammps_restart.BLOCK, np.int32(records.size).tobytes()]
    (tmp_path / "a.restart").write_bytes(b"".join([*parts, records.tobytes(), lammps_restart.MAGIC]))
    read, known = ss.io.read_packing(tmp_path / "a.restart"), ss.io.read_packing(cases / "sheared" / "sheared.restart")
    assert (read.state.grains.position == known.state.grains.position).all()
    assert (
        "pair_style gran/hooke of the restart file was not imported: it has no tangential springs"
        in obstacles(tmp_path)[0]
    )


def test_labels_of_types_are_those_of_the_file(cases, tmp_path):
    """Of a restart file, as in a run that begins with `read_restart`, and of a data file."""
    law = f"pair_style granular\npair_coeff small small {GRANULAR[9:]}\npair_coeff large large {GRANULAR[9:]}\n"
    for name in ("sheared.restart", "labels.data"):
        folder = tmp_path / name[:2]
        folder.mkdir()
        (folder / name).write_bytes((cases / "sheared" / name).read_bytes())
        (folder / "in.x").write_text(
            f"{law}fix m all nve/sphere\nwrite_restart sheared.restart\nwrite_data labels.data"
        )
        assert not any("labelmap" in note for note in obstacles(folder))
        assert ss.io.read_packing(folder).law.table[0, 1, 0] == pytest.approx(2000)


def test_the_law_of_every_pair_is_shown(cases, capsys):
    _, said = answer(capsys, "stability", cases / "materials")
    assert "types 1 and 1, type 1 and wall 1, type 2 and wall 1: kn = 732.6" in said
    assert "types 1 and 2: kn = 959.2" in said and "types 2 and 2: kn = 1389" in said


def test_modes_are_sought_for_a_movie_of_a_folder_of_lammps(cases, capsys, tmp_path, monkeypatch):
    def load(place, *, search, **_):
        raise ValueError(f"search is {search}")

    monkeypatch.setattr("stickslip.runs.page.load_content", load)
    for folder, search in ((cases / "sheared", True), (tmp_path, False)):
        assert answer(capsys, "movie", folder, "--out", "a.gif") == (2, f"stickslip: search is {search}")


TABLE = "x,y,z,radius,vx,vy,vz,wx,wy,wz{heads}\n0,0,0,0.5,0,0,0,0,0,0{a}\n0.99,0,0.01,0.5,0,0,0,0,0,0{b}\n"


@pytest.mark.parametrize(
    ("heads", "a", "b", "text"),
    [
        (",charge", ",1", ",-1", "column charge of t.csv is unknown: remove the column if it has no influence"),
        (",charge", ",0", ",0", ""),
        (",force_x", ",1", ",-1", "it may be an external load, not due to contacts"),
        (",contact_force_x,coordination,stress_xx", ",1,1,1", ",1,1,1", ""),
        (",bond", ",1", ",2", "column bond of t.csv"),
        (",material", ",0", ",1", ""),
        (",box", ",1", ",1", "grains may touch across a periodic box"),
        (",ay", ",-9.81", ",-9.81", "column ay of t.csv is unknown: the same acceleration of all grains may be"),
        (",accel_x,accel_y", ",0,-9.81", ",0,-9.81", "column accel_y of t.csv is unknown"),
        (",ax,ay", ",0.1,0", ",-0.1,0", ""),
        (",|U|,mask,dstV_x", ",1,1,1", ",1,1,1", ""),
    ],
)
def test_columns_of_tables_that_are_not_understood(heads, a, b, text, tmp_path):
    (tmp_path / "t.csv").write_text(TABLE.format(heads=heads, a=a, b=b))
    read = ss.io.read_packing(tmp_path / "t.csv")
    left_out = [note for note in read.notes if isinstance(note, Obstacle)]
    assert any(text in note for note in left_out) if text else not left_out
    assert not any("assumed to be at rest" in note for note in read.notes)
    assert read.state.grains.material.max() == 0 and len(account_of(read.notes)[USED]) >= 10


@pytest.mark.parametrize(
    ("heads", "a", "b", "text", "undecided"),
    [
        ("mass,density", "1,1.9098593", "1,1.9098593", "", False),  # 1 / (4/3 π 0.5³)
        ("mass,density", "1,1", "1,1", "mass is 1, and density times volume 0.5236: mass is used", False),
        ("mass,density", "1,1", "2,1", "mass is 2, and density times volume 0.5236, in row 2 of 2", True),
        ("diameter,mass", "1,1", "1,1", "", False),
        ("diameter,mass", "1,1", "1.1,1", "radius is 0.5, and half the diameter 0.55, in row 2 of 2", True),
    ],
)
@pytest.mark.parametrize("form", ["table", "dump"])
def test_sizes_and_masses_that_contradict_each_other(form, heads, a, b, text, undecided, tmp_path):
    table = TABLE.format(heads=f",{heads}", a=f",{a}", b=f",{b}")
    if form == "dump":
        head, *rows = table.replace(",", " ").splitlines()
        head = head.replace("wx wy wz", "omegax omegay omegaz")
        box = "ITEM: BOX BOUNDS ff ff ff\n-2 2\n-2 2\n-2 2\n"
        rows = "\n".join(f"{k} {row}" for k, row in enumerate(rows, 1))
        table = f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\n{box}ITEM: ATOMS id {head}\n{rows}\n"
    (tmp_path / "t.csv").write_text(table)
    notes = ss.io.read_packing(tmp_path / "t.csv").notes
    found = [note for note in notes if " is used" in note or "leave out one of them" in note]
    assert len(found) == bool(text) and all(text in note for note in found)
    assert [isinstance(note, Obstacle) for note in found] == [undecided] * bool(text)


def test_tables_with_several_times_and_without_headings(tmp_path):
    rows = [f"{t},{k},0,{t},0.5" for t in (0, 2) for k in range(3)]
    (tmp_path / "t.csv").write_text("\n".join(["time,x,y,z,radius", *rows, ""]))
    read = ss.io.read_packing(tmp_path / "t.csv")
    assert len(read.state.grains.radius) == 3 and any("the last, 2, is used" in note for note in read.notes)
    assert ss.io.read_packing(tmp_path / "t.csv", frame="0").state.grains.position[:, 2].max() == 0
    (tmp_path / "bare.txt").write_text("0 0 0 1\n0.9 0 0.1 1\n")
    with pytest.raises(ss.packings.PackingError, match="x y z radius is assumed"):
        ss.io.read_packing(tmp_path / "bare.txt")
    for box in (np.ones(3), np.ones(6), np.array([[0, 1]])):  # with a value for each grain or without
        np.savez(tmp_path / "p.npz", positions=np.eye(3) * 5, radii=np.full(3, 0.5), box=box)
        notes = ss.io.read_packing(tmp_path / "p.npz").assumed
        assert any("column box" in note for note in notes)
        assert ("p.npz: box has no row for each grain" in notes) is (len(box) != 3)


def test_dumps_of_a_group_and_names_of_columns(cases):
    with pytest.raises(ss.packings.PackingError, match="as in the dump of a group"):
        ss.io.read_packing(cases / "dialects" / "part.dump", contacts=cases / "poured" / "contacts.dump", **HOOKE)
    given = {"contacts": cases / "sheared" / "contacts.dump"} | HERTZ
    with pytest.raises(ss.packings.PackingError, match=r"unknown column 'bananas'; .* or - for a column to skip"):
        ss.io.read_packing(cases / "sheared" / "dump.grains", columns="i j bananas dx dy dz fx fy fz tx ty tz", **given)
    names = "i j - dx dy dz fx fy fz tx ty tz"
    assert ss.io.read_packing(cases / "sheared" / "dump.grains", columns=names, **given).state.contacts.slip.any()


def test_species_of_extended_xyz_are_types(tmp_path):
    """Also the materials of a file that this package wrote, whose law has a table of them."""
    text = "2\nProperties=species:S:1:pos:R:3:radius:R:1\nA 0 0 0 0.5\nB 0.99 0 0.1 0.5\n"
    (tmp_path / "a.xyz").write_text(text)
    read = ss.io.read_packing(tmp_path / "a.xyz", law="linear", kn=1.0)
    assert any("one law is used for all grains, although they are of 2 types" in note for note in read.assumed)
    state, law = read.state, read.law
    table = np.tile(law.table, (2, 2, 1)) * np.array([[1.0, 0.5], [0.5, 0.2]])[..., None]
    state = state._replace(grains=state.grains._replace(material=np.array([0, 1])))
    ss.io.write_packing(tmp_path / "b.xyz", state, law._replace(table=table))
    again = ss.io.read_packing(tmp_path / "b.xyz")
    assert again.state.grains.material.tolist() == [0, 1] and not obstacles(tmp_path / "b.xyz")


def test_files_of_this_package_raise_no_alarm(cases, tmp_path, capsys):
    """Forces and torques of contacts are not taken for loads."""
    for name in ("a.csv", "a.vtu", "a.xyz", "a.data"):
        code, said = answer(capsys, "convert", cases / "sheared", "--to", tmp_path / name, "--json")
        assert code == 0 and "command atom_style" in json.loads(said)["met"]["used"]
        assert not obstacles(tmp_path / name)
    assert "contact_torque_x" in (tmp_path / "a.csv").read_text()


def test_grains_that_nearly_touch_are_told(cases):
    """As in packings of rigid grains, which have no overlaps."""
    place = 1.003 * np.array([(a, b, c) for a in range(3) for b in range(3) for c in range(3)])
    law = ss.laws.linear()
    with pytest.raises(
        ValueError, match="only rattlers, and 54 pairs have gaps below 1 % of a radius, as in packings of rigid grains"
    ):
        ss.stability(ss.packings.from_arrays(place, np.full(27, 0.5), law), law)
    with pytest.raises(ValueError, match="only rattlers: stability needs"):
        ss.stability(ss.packings.from_arrays(2 * place, np.full(27, 0.5), law), law)


def test_what_is_used_is_taken_over():
    """The table and the code agree on fixes and pair styles."""
    assert {group_of("fix", style) for style in TAKEN} == {USED}
    assert {group_of("fix", style) for style in MOVERS} == {USED, UNKNOWN}
    assert plain_style("gran/hooke/history/kk/device") == "gran/hooke/history" and plain_style("lj/cut") == "lj/cut"
    assert group_of("fix", "mystery") == group_of("command", "mystery") == group_of("a kind", "mystery") == UNKNOWN


@pytest.mark.parametrize(("velocity", "undecided"), [("0 0 0", False), ("0.5 0 0", True)])
def test_grains_that_no_fix_moves_may_have_velocities(velocity, undecided, cases, tmp_path):
    """As a belt: LAMMPS does not move them, and their contacts have dashpots."""
    lines = "unfix move\ngroup low id 1:3\ngroup mob subtract all low\nfix move mob nve/sphere"
    folder = in_poured(cases, tmp_path, lines, "poured.data")
    changed(folder, "poured.data", "\n2 0 0 0 0 0 0\n", f"\n2 {velocity} 0 0 0\n")
    read = ss.io.read_packing(folder)
    assert "3 grains that no fix moves are held" in read.notes
    assert any("no fix moves have velocities" in note for note in read.notes) == undecided
