"""Files as LAMMPS and other programs leave them, and folders of runs: what is read, and what is said.

`lammps_runs/make.py` makes them with LAMMPS.
"""

import bz2
import gzip
import lzma
import re
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.core.contacts.forces import FREE, FROZEN, bodies
from stickslip.core.dynamics.run import Leg
from stickslip.core.laws.builtin import DAMPING, DAMPING_N, KT, LEVER, PARAMETERS, ROLLING, rescales, with_values
from stickslip.core.laws.compiled import FORCES, law_struct
from stickslip.core.laws.properties import dashpot_coefficients
from stickslip.core.library import core
from stickslip.data.exchange import lammps_restart
from stickslip.data.exchange.columns import packing_of_columns
from stickslip.data.exchange.frame import frame_of
from stickslip.data.exchange.lammps_course import TAKEN, Plane, with_wall_numbers
from stickslip.data.exchange.lammps_file import read_grain_dump
from stickslip.data.exchange.lammps_laws import as_restitution, contact_of, law_of_contacts, mix, of_release
from stickslip.data.exchange.lammps_restart import Restart, restore_memory
from stickslip.data.sample import Obstacle
from stickslip.wings.lammps.script import write_input
from stickslip.wings.lammps.supported import check_leg
from tests.laws import granular_lammps
from tests.peers.lammps_scenes import GRANULAR, LINEAR_DAMPED, REFF_DAMPED, between_walls, walls_law

HERTZ = {"law": "hertz_mindlin_reff", "kn": 1.0, "kt": 0.8, "mu": 0.3, "damping_n": 0.0, "damping_t": 0.0}
HOOKE = {"law": "linear", "kn": 2000.0, "kt": 4000 / 7, "mu": 0.4, "damping_n": 20.0, "damping_t": 10.0}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Modes are written to the working directory."""
    monkeypatch.chdir(tmp_path)


def answer(capsys, *arguments):
    """Exit code and output of the command line."""
    argv, sys.argv = sys.argv, ["stickslip", *map(str, arguments)]
    try:
        with pytest.raises(SystemExit) as end:
            main()
    finally:
        sys.argv = argv
    said = capsys.readouterr()
    return end.value.code or 0, " ".join((said.out + said.err).split())


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("sheared/sheared.restart", "law from the restart file: pair_style gran/hertz/history"),
        ("sheared/dump.grains", "contacts were found from positions"),
        ("sheared/data.packing", "contacts were found from positions"),  # a dump, whatever its name
        ("sheared/scaled.dump", "contacts were found from positions"),
        ("sheared/grains.dump.gz", "contacts were found from positions"),
        ("sheared/bare.lammpstrj", "has no masses: a density of 1 is assumed"),
        ("sheared/sheared.data", "does not state periodic directions"),
        ("sheared/labels.data", "does not state periodic directions"),
        ("dialects/part.dump", "12 grains are in the file: if it is the dump of a group, others may touch them"),
        ("dialects/crlf.dump", "the box is open along z: no walls were read, as the file contains none"),
        ("dialects/liggghts.dump", "has no masses: a density of 1 is assumed"),
        ("dialects/mercury.data", "no walls and periodic boundaries were read, as MercuryDPM's .data has none"),
        ("dialects/yade.txt", "has no box: the grains are treated as an unconfined cluster"),
        ("dialects/bare.txt", "does not name its columns: x y z radius is assumed"),
        ("dialects/pfc.csv", "has no masses: a density of 1 is assumed"),
        ("dialects/packing.xyz", "has no masses: a density of 1 is assumed"),
        ("dialects/packing.vtk", "has no box: the grains are treated as an unconfined cluster"),
    ],
)
def test_what_was_assumed_is_reported(name, text, cases):
    """The grains are the same in every dialect: positions up to whole periods, radii, and masses if there are any."""
    reading = ss.io.read_packing(cases / name)
    assert any(text in note for note in reading.notes)
    assert set(reading.assumed) <= set(reading.notes)
    if "from the restart file" not in text:
        assert any(text in note for note in reading.assumed)
    run = "sheared" if name.startswith("sheared") else "poured"
    known = ss.io.read_packing(cases / run / f"{run}.restart").state
    size, place = known.grains.radius, known.grains.position
    if name != "dialects/part.dump":
        assert sorted(reading.state.grains.radius) == pytest.approx(sorted(size), rel=1e-5)
    cell = np.where(known.cell.periodic[:, None], known.cell.vectors, np.eye(3) * 1e9)
    away = (reading.state.grains.position[:, None] - place[None]) @ np.linalg.inv(cell)
    nearest = np.abs((away - np.round(away)) @ cell).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-4  # of files with six digits


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sheared/contacts.dump", "is a dump of contacts, with columns c_ends[1]"),
        ("dialects/liggghts_named.pairs", "with columns x1 y1 z1 x2 y2 z2 id1 id2 periodic fx fy fz"),
        ("dialects/packing.vtu", "is truncated, or not VTK of points (incomplete XML"),
        ("dialects/empty.vtk", "has no columns: x y z"),
        ("dialects/twice.dump", "has grain 4 twice in one time step"),
        ("dialects/full.data", "could be those of sphere or full: give --atom-style sphere"),
        ("dialects/ellipsoid.data", "could be those of ellipsoid or body: x y z, diameter and density are needed"),
        ("dialects/unnamed.data", "could be those of sphere or full: give --atom-style sphere"),
        ("dialects/hybrid.data", "name the parts of a hybrid style with --atom-style"),
        ("dialects/mercury.restart", "it begins with 'restart_version 1.0 | name x'"),
        ("dialects", "has no LAMMPS restart file, dump of atoms or data file"),
    ],
)
def test_what_is_not_read_says_what_it_is(name, message, cases, tmp_path):
    path = cases / name
    (cases / "dialects" / "packing.vtu").write_text('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid">\n')
    (cases / "dialects" / "empty.vtk").write_text("# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n")
    if name == "dialects":
        path = tmp_path
        (path / "yade.txt").write_bytes((cases / "dialects" / "yade.txt").read_bytes())
    with pytest.raises(ss.packings.PackingError) as problem:
        ss.io.read_packing(path)
    assert message in str(problem.value)
    assert "\n" not in str(problem.value)


def test_atom_styles_are_named(cases):
    known = ss.io.read_packing(cases / "poured" / "poured.restart").state
    length, known = known.cell.vectors[0, 0], known.grains
    for name, style in (("unnamed.data", "sphere"), ("hybrid.data", "hybrid sphere bond")):
        state = ss.io.read_packing(cases / "dialects" / name, atom_style=style, boundary="ppf").state
        away = state.grains.position - known.position
        assert np.abs(away - length * np.round(away / length)).max() < 1e-12
        np.testing.assert_allclose(state.grains.radius, known.radius, rtol=1e-14)
        np.testing.assert_allclose(state.grains.mass, known.mass, rtol=1e-14)


@pytest.mark.parametrize(
    ("grains", "contacts", "law"),
    [
        ("sheared/dump.grains", "sheared/contacts.dump", HERTZ),
        ("sheared/sheared.data", "sheared/shuffled.local", HERTZ),
        ("dialects/liggghts.dump", "dialects/liggghts.pairs", HOOKE),
        ("dialects/liggghts.dump", "dialects/liggghts_named.pairs", HOOKE),
    ],
)
def test_columns_of_contacts_are_found_by_their_contents(grains, contacts, law, cases):
    """Against the memory in the restart file."""
    state, its, _ = ss.io.read_packing(cases / grains, contacts=cases / contacts, **law)
    known = ss.io.read_packing((cases / grains.split("/")[0] / "x").parent if "sheared" in grains else cases / "poured")
    rows, n = ss.measure.touching(state), len(state.grains.radius)
    theirs = ss.measure.touching(known.state)
    theirs = theirs[known.state.contacts.j[theirs] < n]
    assert len(rows) == len(theirs) > 30
    mine, other = (packing.contacts.slip[r] for packing, r in ((state, rows), (known.state, theirs)))
    first, last = (
        np.lexsort((np.round(packing.contacts.slip[r][:, 0], 9), packing.contacts.j[r], packing.contacts.i[r]))
        for packing, r in ((state, rows), (known.state, theirs))
    )
    miss = mine[first] - other[last]
    assert np.abs(miss).max() < 1e-6 * np.abs(other).max()
    assert its.table[0, 0].tolist() == pytest.approx(known.law.table[0, 0].tolist())


def test_columns_in_another_order_are_refused(cases):
    names = "i j dist dx dy dz tx ty tz fx fy fz"
    with pytest.raises(
        ss.packings.PackingError, match="columns tx ty tz of the contacts do not agree with the positions of the grains"
    ):
        ss.io.read_packing(
            cases / "sheared" / "dump.grains", contacts=cases / "sheared" / "contacts.dump", columns=names, **HERTZ
        )


def contact_loads(state, law, memory=FREE):
    """(2, N, 3) forces and torques of contacts with LAMMPS's lever arms of the slip."""
    load, struct = np.zeros((2, state.n_bodies, 3)), law_struct(law, rate=True, members=FORCES)
    trial = ss.forces(state, law)[1]  # arrays that may be overwritten
    for mine, given in zip(trial, state.contacts, strict=True):
        if isinstance(mine, np.ndarray):
            mine[:] = given
    core.evaluate_contacts(struct, 3, bodies(state), trial, state.cell.vectors, memory, *load)
    return load[:, : len(state.grains.radius)]


@pytest.mark.parametrize("run", ["sheared", "old", "ranks", "dragged", "poured", "classic", "materials"])
def test_one_evaluation_of_forces_is_that_of_lammps(run, cases):
    """With all memory, of grains and walls; mixed types, frozen grains, gravity and `fix addforce` included."""
    state, law, _ = ss.io.read_packing(cases / run)
    n, control = len(state.grains.radius), state.control
    ours = contact_loads(state, law)[0] + state.grains.mass[:, None] * control.gravity + control.force[:n]
    ours[~control.free[:n, 0]] = 0.0
    dump = cases / ("sheared" if run == "dragged" else run) / "dump.grains"
    if run == "dragged":
        theirs = np.zeros((n, 3))  # at rest
    else:
        theirs = read_grain_dump(dump)[0].force
    scale = float(np.abs(frame_of(state, law).contacts["force_n"]).mean())
    assert np.abs(ours - theirs).max() < (1e-9 if run == "dragged" else 1e-12) * scale
    if run == "materials":
        assert len(np.unique(law.table[:2, :2, 0])) == 3
        assert (~control.free[:n].any(axis=1)).sum() > 0 and control.force.any()


@pytest.mark.parametrize("run", ["adhesive", "bouncy", "tsuji", "forces", "marshall", "boxed"])
def test_forces_and_torques_of_the_granular_style_are_those_of_lammps(run, cases):
    """With full memory, all but the first in motion; the last in a block, on another, beside a part of zero."""
    state, law, notes = ss.io.read_packing(cases / run)
    assert not [note for note in notes if isinstance(note, Obstacle)]
    force, torque = contact_loads(state, law, FROZEN)
    names, *rows = (cases / run / "dump.grains").read_text().split("ITEM: ATOMS ")[1].strip().split("\n")
    theirs = np.array(sorted([float(x) for x in row.split()] for row in rows))
    names = names.split()
    force += state.grains.mass[:, None] * state.control.gravity
    scale = float(np.abs(frame_of(state, law).contacts["force_n"]).mean())
    miss = force - theirs[:, [names.index(name) for name in ("fx", "fy", "fz")]]
    assert np.abs(miss).max() < 1e-12 * scale
    torque -= theirs[:, [names.index(name) for name in ("tqx", "tqy", "tqz")]]
    assert np.abs(torque).max() < 1e-12 * scale
    # LAMMPS leaves slips along the normal up to 1e-10 of the limit, and here each step projects them
    rest = contact_loads(state, law)[0] + state.grains.mass[:, None] * state.control.gravity - force
    assert np.abs(rest).max() < 1e-10 * scale
    assert (np.abs(rest).max() > 1e-11 * scale) == (run in ("adhesive", "tsuji"))


@pytest.mark.parametrize(
    ("run", "code", "text"),
    [
        ("adhesive", 0, ["e-11 of the mean contact force stable", "R - delta/2 for torques and R for slip"]),
        ("sheared", 0, ["oscillatory instability: 4 complex pairs", "decisive contacts", "gran/hertz/history"]),
        ("dragged", 3, ["undecided: fix drag (viscous) was not imported", "Without it: oscillatory instability"]),
        ("poured", 0, ["1 wall, gravity", "stable"]),
        ("classic", 3, ["undecided: the k_t of fix wall/gran hooke/history", "Without it: stable"]),
        ("materials", 3, ["not in equilibrium", "lever arms R - delta/2 for torques and R for slip"]),
    ],
)
def test_one_command_on_the_folder_of_a_run(run, code, text, cases, capsys, tmp_path):
    got, said = answer(capsys, "stability", cases / run, "--modes", tmp_path / "m.npz")
    assert got == code, said
    assert all(word in said for word in text), said


def test_a_run_without_a_restart_file(cases, tmp_path):
    """Contacts come from the dump, those with the wall from the resultants: the memory is that of the restart file."""
    for name in ("log.lammps", "dump.grains", "contacts.dump"):
        (tmp_path / name).write_bytes((cases / "poured" / name).read_bytes())
    mine, known = ss.io.read_packing(tmp_path), ss.io.read_packing(cases / "poured")
    assert any("contacts with walls" in note for note in mine.assumed)
    rows = ss.measure.touching(known.state)
    assert (ss.measure.touching(mine.state) == rows).all()
    scale = np.abs(known.state.contacts.slip[rows]).max()
    assert np.abs(mine.state.contacts.slip[rows] - known.state.contacts.slip[rows]).max() < 1e-6 * scale
    (tmp_path / "log.lammps").unlink()
    (tmp_path / "in.poured").write_bytes((cases / "poured" / "in.poured").read_bytes())
    script = ss.io.read_packing(tmp_path)  # `variable kt equal "2/7*2000"` has no value without LAMMPS
    assert any(isinstance(note, Obstacle) and "is unknown without running LAMMPS" in note for note in script.notes)


def test_a_script_that_stickslip_writes_is_read_back(tmp_path):
    """Both directions of the table of laws: inclined walls with their own friction, gravity and dashpots."""
    for law in (LINEAR_DAMPED, REFF_DAMPED, *(law for law in GRANULAR.values() if not rescales(law))):
        state, law = between_walls(3), walls_law(law)
        if law.properties & ROLLING:
            state = state._replace(cell=state.cell._replace(periodic=np.zeros(3, bool)))
        leg = Leg(state, law, 0.01, 1, 1)
        check_leg(leg)
        write_input(leg, tmp_path)
        again, its, notes = ss.io.read_packing(tmp_path)
        assert not [note for note in notes if isinstance(note, Obstacle)]
        assert (its.kind, its.properties) == (law.kind, law.properties)
        if law.damping == DAMPING["tsuji"]:
            assert its.damping == DAMPING["coeff_restitution"]
            law = with_values(law, damping_n=its.table[0, 0, DAMPING_N])
            tsuji = GRANULAR["tsuji"]
            np.testing.assert_allclose(dashpot_coefficients(its)[0, 0], dashpot_coefficients(tsuji)[0, 0], rtol=1e-12)
        else:
            assert its.damping == law.damping
        np.testing.assert_allclose(its.table[0, :3], law.table[0, [0, 0, 1]], rtol=1e-15)
        np.testing.assert_allclose(again.walls.normal, state.walls.normal, atol=1e-15)
        heights = [np.einsum("wk,wk->w", packing.walls.point, packing.walls.normal) for packing in (again, state)]
        np.testing.assert_allclose(*heights, atol=1e-15)
        np.testing.assert_allclose(again.control.gravity, state.control.gravity, atol=1e-17)


SPRINGS = "rolling sds 5 6 0.1 twisting sds 7 8 0.2"
MOMENTS = {"k_roll": 5, "gamma_roll": 6, "mu_roll": 0.1, "k_twist": 7, "gamma_twist": 8, "mu_twist": 0.2}


@pytest.mark.parametrize(
    ("coefficients", "kind", "values", "more", "lacks"),
    [
        ("hooke 2 0.5 tangential linear_history 1 0.4 0.3 damping velocity", "linear", (2, 1, 0.3, 0.5, 0.2), {}, ""),
        (
            "hertz 2 0.5 tangential mindlin_rescale 1 0.4 0.3",
            "hertz_mindlin_reff_rescaled", (2, 1, 0.3, 0.5, 0.2), {}, "",
        ),
        (
            "hertz/material 6 0 0.5 tangential mindlin NULL 1 0.3",
            "hertz_mindlin_reff", (16 / 3, 16 / 3, 0.3, 0, 0), {}, "",
        ),
        (
            "hertz 2 0.5 tangential mindlin/force 1 1 0.3",
            "hertz_mindlin_reff", (2, 1, 0.3, 0.5, 0.5), {}, "",
        ),
        (
            "hertz 2 0.5 tangential mindlin_rescale/force 1 1 0.3",
            "hertz_mindlin_reff_rescaled", (2, 1, 0.3, 0.5, 0.5), {}, "",
        ),
        (
            "hooke 2 0.5 tangential mindlin/force 1 1 0.3",
            "linear", (2, 1, 0.3, 0.5, 0.5), {}, "tangential mindlin/force with normal hooke",
        ),
        (
            f"hertz 2 0.5 tangential mindlin 1 1 0.3 {SPRINGS} damping coeff_restitution",
            "hertz_mindlin_reff", (2, 1, 0.3, 0.5, 1), MOMENTS, "",
        ),
        (
            "hertz 2 0.5 tangential mindlin 1 1 0.3 twisting marshall damping tsuji",
            "hertz_mindlin_reff", (2, 1, 0.3, 0.5, 1), {"k_twist": 0.5, "mu_twist": 0.2, "gamma_twist": 0.5}, "",
        ),
        (
            "hertz 2 0 tangential mindlin 1 1 0.3 damping tsuji",
            "hertz_mindlin_reff", (2, 1, 0.3, 0, 1), {}, "damping tsuji with the coefficient 0",
        ),
        (
            "hertz 2 0.5 rolling sds 5 6 0.1", "hertz_mindlin_reff", (2, 0, 0, 0.5, 0),
            {"k_roll": 5, "gamma_roll": 6, "mu_roll": 0.1}, "rolling or twisting without friction",
        ),
        ("jkr 6 0.5 0.5 1 tangential mindlin NULL 1 0.3", "jkr", (16 / 3, 16 / 3, 0.3, 0.5, 0.5), {"work": 2}, ""),
        ("dmt 6 0.5 0.5 1 tangential mindlin NULL 1 0.3", "dmt", (16 / 3, 16 / 3, 0.3, 0.5, 0.5), {"work": 2}, ""),
    ],
)  # fmt: skip
def test_coefficients_of_the_granular_style(coefficients, kind, values, more, lacks):
    contact, rest = contact_of("granular", [*coefficients.split(), "zplane"])
    assert rest == ["zplane"]
    assert contact.law == kind
    assert contact.values == pytest.approx(dict(zip(PARAMETERS, values, strict=True)) | more)
    assert " ".join(contact.lacks) == lacks
    assert contact.properties & LEVER


def test_mixing_of_restitutions_and_of_work():
    """Geometric means of the coefficients of restitution and of the work of adhesion."""
    a, b = (
        contact_of("granular", f"jkr 6 {e} 0.5 {g} tangential mindlin 1 0.3 0.3 damping coeff_restitution".split())[0]
        for e, g in ((0.4, 1), (0.9, 4))
    )
    assert (mix(a, b).values["damping_n"], mix(a, b).values["work"]) == pytest.approx((0.6, 4))
    assert mix(a, b).values["damping_t"] == pytest.approx(0.3)


@pytest.mark.parametrize(("gap", "holds"), [(0.0150, True), (0.0165, False)])
def test_bonds_that_lammps_has_separated_are_left_out(gap, holds):
    """LAMMPS exerts a force on the spheres of `granular_lammps` across the first gap, and none across the second."""
    state = granular_lammps.two_spheres(-gap)
    law = ss.laws.jkr(granular_lammps.KN, granular_lammps.KT, 0.5, work=granular_lammps.WORK)
    values, none = np.zeros((1, 4)), np.zeros(0, int)
    pair = np.array([0]), np.array([1]), np.zeros((1, 3))
    grains = state.grains
    memory = Restart(
        grains.position, np.zeros((2, 3)), grains.velocity, grains.spin, grains.radius, grains.mass, np.zeros(2),
        np.zeros(2), *pair, none, none, np.zeros((0, 3)), values, np.zeros((0, 4)), np.arange(2), none,
    )  # fmt: skip
    assert len(ss.measure.touching(restore_memory(state, law, memory))) == holds


@pytest.mark.parametrize(("model", "make"), [("hooke", ss.laws.linear), ("hertz", ss.laws.hertz_mindlin_reff)])
def test_tsuji_before_and_after_its_factor(model, make):
    tangential = "linear_history" if model == "hooke" else "mindlin"
    arguments = f"{model} 2 0.7 tangential {tangential} 1 0.3 0.3 damping tsuji".split()
    contact = contact_of("granular", arguments)[0]
    old, new = (law_of_contacts({(0, 0): of_release(contact, year)}, 1, 0)[0] for year in (2025, 2026))
    given = make(2.0, 1.0, 0.3, damping="tsuji", damping_n=0.7, damping_t=0.3)
    ours = dashpot_coefficients(given)[0, 0]
    np.testing.assert_allclose(dashpot_coefficients(old)[0, 0], ours / np.sqrt(2), rtol=1e-12)
    np.testing.assert_allclose(dashpot_coefficients(new)[0, 0], ours, rtol=1e-15)


def test_limit_damping_keeps_the_dashpots_of_lammps():
    """LAMMPS takes α = −√5 ln e/√(π² + ln² e) with `limit_damping` as well, so that a collision loses less."""
    for limit, stated in (("", 0.3), (" limit_damping", 0.3968)):
        words = f"hertz 2 0.3 tangential mindlin 1 0.3 0.3 damping coeff_restitution{limit}".split()
        law, _ = law_of_contacts({(0, 0): of_release(contact_of("granular", words)[0], 2025)}, 1, 0)
        alpha = -np.sqrt(5) * np.log(0.3) / np.hypot(np.pi, np.log(0.3))
        assert dashpot_coefficients(law)[0, 0, 0] == pytest.approx(alpha, rel=1e-12)
        assert law.table[0, 0, DAMPING_N] == pytest.approx(stated, abs=5e-4)
        assert as_restitution("hertz_mindlin_reff", law.damping, law.table[0, 0, DAMPING_N]) == pytest.approx(0.3)


@pytest.mark.parametrize("opener", [gzip.open, lzma.open, bz2.open])
def test_compressed_text_is_read(opener, cases, tmp_path):
    plain, packed = cases / "dialects" / "pfc.csv", tmp_path / "p"
    with opener(packed, "wb") as file:
        file.write(plain.read_bytes())
    assert (ss.io.read_packing(packed).state.grains.position == ss.io.read_packing(plain).state.grains.position).all()
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(ss.packings.PackingError, match="cannot be decompressed"):
        ss.io.read_packing(packed)


def test_unknown_compression_is_reported(tmp_path):
    (tmp_path / "p.zst").write_bytes(b"\x28\xb5\x2f\xfd rest")
    with pytest.raises(ss.packings.PackingError, match=r"Zstandard|cannot be decompressed"):
        ss.io.read_packing(tmp_path / "p.zst")
    with gzip.open(tmp_path / "bomb.gz", "wb", compresslevel=9) as file:
        file.write(bytes(2**24))
    with pytest.raises(ss.packings.PackingError, match="it is binary"):
        ss.io.read_packing(tmp_path / "bomb.gz")


def test_what_is_not_taken_over_stays_with_the_packing(cases, capsys, tmp_path):
    answer(capsys, "convert", cases / "dragged", "--to", tmp_path / "p.h5")
    code, said = answer(capsys, "stability", tmp_path / "p.h5", "-q", "--modes", tmp_path / "m.npz")
    assert code == 3
    assert said.startswith("undecided: fix drag (viscous) was not imported")


def test_a_restart_file_that_cannot_be_read_leaves_the_dumps(cases, tmp_path):
    for name in ("log.lammps", "dump.grains", "contacts.dump", "poured.restart"):
        (tmp_path / name).write_bytes((cases / "poured" / name).read_bytes())
    whole = (tmp_path / "poured.restart").read_bytes()
    (tmp_path / "poured.restart").write_bytes(whole[:-100])
    reading = ss.io.read_packing(tmp_path)
    assert any("poured.restart cannot be read" in note and "write_data" in note for note in reading.assumed)
    assert any("contacts in contacts.dump" in note for note in reading.notes)


def test_a_pair_style_that_is_in_the_restart_file_only(cases, tmp_path):
    """As in a run that begins with `read_restart`."""
    for name in ("log.lammps", "poured.restart"):
        (tmp_path / name).write_bytes((cases / "poured" / name).read_bytes())
    log = tmp_path / "log.lammps"
    log.write_text("\n".join(line for line in log.read_text().split("\n") if not line.startswith("pair_")))
    mine, known = ss.io.read_packing(tmp_path).law, ss.io.read_packing(cases / "poured").law
    np.testing.assert_allclose(mine.table, known.table, rtol=1e-14)
    (tmp_path / "poured.restart").unlink()
    (tmp_path / "poured.data").write_bytes((cases / "poured" / "poured.data").read_bytes())
    state, _, notes = ss.io.read_packing(tmp_path)
    assert len(state.walls.mass) == 1
    assert any("pair_style none was not imported" in note for note in notes)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("neigh_modify exclude type 1 2", "neigh_modify exclude type 1 2 was not imported"),
        ("fix s all spring/self 1.0", "fix s (spring/self) was not imported: it acts on the grains"),
        (
            "fix q all wall/gran hooke/history 1 1 0 0 0.5 1 zcylinder 3",
            "only fixed planes for all grains are supported",
        ),
        ("fix q all wall/gran 50 0.2 zplane 0 NULL", "a number is expected in place of 'zplane'"),
        ("fix q low addforce 0 0 v_push", "the members of group low are uncertain"),
        ("fix q all addforce 0 0 v_push", "fix q (addforce) was not imported"),
        ("fix q all setforce 0 NULL 1", "only zero or NULL forces in the whole box are supported"),
        ("units real", "units real, in which LAMMPS converts forces"),
        ("pair_style hybrid/overlay granular", "pair_style hybrid/overlay was not imported"),
        ("pair_coeff 1 1 hertz 1", "pair_style granular was not imported"),
        ("fix x all print 10 'now'", ""),
        (
            "pair_style hybrid/overlay gran/hooke/history 2000 571.428571428571 20 10 0.4 1 coul/cut 2\n"
            "pair_coeff * * gran/hooke/history\npair_coeff * * coul/cut 0",
            "it adds the forces of gran/hooke/history and coul/cut",
        ),
        (
            "fix q all wall/gran hertz/history 1 1 0 0 0.5 1 zplane NULL 9",
            "the model between type 1 and wall 2, which differs",
        ),
        (
            "pair_style gran/hertz/history 1 1 0 0 0.5 1",
            "but the restart file has gran/hooke/history: it belongs to an",
        ),
        ("group a union b\ngroup b union a\nfix w b freeze", "the members of group b are uncertain"),
    ],
)
def test_what_acts_and_is_not_taken_over_has_its_name(line, text, cases, tmp_path):
    run = "materials" if line.startswith("pair_coeff") else "poured"
    for name in ("log.lammps", f"{run}.restart"):
        (tmp_path / name).write_bytes((cases / run / name).read_bytes())
    log = tmp_path / "log.lammps"
    log.write_text(log.read_text().replace("write_restart", f"{line}\nwrite_restart"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.packings.PackingWarning)
        left_out = [note for note in ss.io.read_packing(tmp_path).notes if isinstance(note, Obstacle)]
    assert any(text in note for note in left_out) if text else not left_out


def test_grains_that_have_crossed_the_box_many_times(cases, tmp_path):
    """As in long shear: positions are then those in the box."""
    text = (cases / "sheared" / "dump.grains").read_text().split("\n")
    names = next(line for line in text if line.startswith("ITEM: ATOMS")).split()[2:]
    first, at = text.index(next(line for line in text if line.startswith("ITEM: ATOMS"))) + 1, names.index("ix")
    row = text[first].split()
    row[at] = "70"
    (tmp_path / "dump").write_text("\n".join([*text[:first], " ".join(row), *text[first + 1 :]]))
    given = {"contacts": cases / "sheared" / "contacts.dump"} | HERTZ
    state, law, _ = ss.io.read_packing(tmp_path / "dump", **given)
    known, _, _ = ss.io.read_packing(cases / "sheared" / "dump.grains", **given)
    assert ss.stability(state, law).verdict == ss.stability(known, law).verdict


def test_options_take_precedence_over_the_law_of_a_run(cases):
    """A number alone changes that number between all types and walls; a law replaces it everywhere."""
    law = ss.io.read_packing(cases / "materials").law
    other = ss.io.read_packing(cases / "materials", mu=0.05).law
    assert (other.table[..., :2] == law.table[..., :2]).all() and (other.table[..., 2] == 0.05).all()
    state, other, _ = ss.io.read_packing(cases / "materials", law="linear", kn=500.0)
    assert len(state.walls.mass) == 1
    assert (other.table[..., 0] == 500.0).all() and other.kind == ss.laws.linear().kind


def test_a_folder_of_dumps_asks_for_the_law(cases, tmp_path):
    for name in ("dump.grains", "contacts.dump"):
        (tmp_path / name).write_bytes((cases / "sheared" / name).read_bytes())
    reading = ss.io.read_packing(tmp_path)
    assert any(
        "the memory of contacts in contacts.dump needs the law: give --law, --kn" in note for note in reading.assumed
    )
    state, law, notes = ss.io.read_packing(tmp_path, **HERTZ)
    assert any("no log.lammps and no input script" in note for note in notes)
    assert ss.stability(state, law).stable is False


def test_causes_point_to_what_the_file_lacks(cases, capsys, tmp_path):
    """Gravity and the wall are seen in the forces, the types in the file."""
    law = [word for name, value in HOOKE.items() for word in (f"--{name.replace('_', '-')}", value)]
    run = cases / "poured"
    code, said = answer(capsys, "stability", run / "dump.grains", "--contacts", run / "contacts.dump", *law)
    assert code == 3
    assert "would balance under gravity (0, 0, -1)" in said
    assert "a wall: the 8 grains with unbalanced forces are the lowest along z" in said
    assert "one law is used for all grains, although they are of 2 types" in said
    code, said = answer(capsys, "stability", cases / "sheared" / "short.dump", "--modes", tmp_path / "m.npz")
    assert "positions have at most 6 digits," in said


def test_positions_and_radii_get_as_far_as_geometry_goes(cases, capsys, tmp_path):
    path, modes = cases / "dialects" / "yade.txt", tmp_path / "m.npz"
    code, said = answer(capsys, "stability", path, "--modes", modes)
    assert code == 3
    assert "no verdict: the file has no contact law and no memory of tangential contacts" in said
    assert "give the law (--law, --kn, --kt, --mu) and the memory of contacts" in said
    state = ss.io.read_packing(path).state
    assert f"coordination {ss.measure.coordination(state):.4g}" in said
    assert f"geometry: {len(ss.measure.touching(state))} contacts" in said


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z,radius\n0,0,0,0.5\n0.9,0,1,0.5\n",
        '"Points:0","Points:1","Points:2","Radius"\n0,0,0,0.5\n0.9,0,1,0.5\n',
        "# made by hand\nid; pos_x [m]; pos_y [m]; pos_z [m]; Diameter (m)\n7; 0; 0; 0; 1\n3; 0.9; 0; 1; 1\n",
        "# 2 grains\n0 0 0 0.5\n0.9 0 1 0.5\n",
        "#format x_y_z_r_mask\n0\t0\t0\t0.5\t1\n0.9\t0\t1\t0.5\t1\n",
        "\ufeffX Y Z R vx vy vz\r\n0 0 0 0.5 0 0 1\r\n0.9 0 1 0.5 0 0 1\r\n",
        "% x y z radius\n% of a script\n0 0 0 0.5\n0.9 0 1 0.5\n",
        "ball_id,xc,yc,zc,rad,rho\n1,0,0,0,0.5,2\n2,0.9,0,1,0.5,2\n",
        "x;y;z;r\n0;0;0;0,5\n0,9;0;1;0,5\n",
        "x\ty\tz\tr\n0\t0\t0\t0,5\n0,9\t0\t1\t0,5\n",
        "# x y z r\n0 0 0 0,5\n0,9 0 1 0,5\n",
        "0 0 0 0,5\n0,9 0,0 1 0,5\n",
        "x_um,y_um,z_um,diameter_um\n0,0,0,1\n0.9,0,1,1\n",
        "x [m],y [m],z [m],radius (mm)\n0,0,0,500\n0.9,0,1,500\n",
        "Nr;x [µm];y [µm];z [µm];Durchmesser [µm]\n1;0;0;0;1\n2;0,9;0;1;1\n",
        "1 0 0 0 0.5\n2 0.9 0 1 0.5\n",
        "0,0,0,0,0.5\n1,0.9,0,1,0.5\n",
        "2\nAtoms. Timestep: 100\n1 0 0 0 0.5\n1 0.9 0 1 0.5\n",
        "x,y,z,r\n0,0,0,.5\nnan,,nan,\n0.9,0,1,.5\nTotal:,,,1\n",
    ],
)
def test_tables_under_their_usual_names(text, tmp_path):
    (tmp_path / "t").write_text(text, encoding="utf-8", newline="")
    state, _, notes = ss.io.read_packing(tmp_path / "t")
    assert sorted(map(tuple, state.grains.position.tolist())) == [(0, 0, 0), (0.9, 0, 1)]
    assert state.grains.radius.tolist() == [0.5, 0.5]
    assert state.grains.mass[0] == pytest.approx((2 if "rho" in text else 1) * np.pi / 6)
    assert state.grains.velocity[0, 2] == ("vx" in text)
    assert any("a density of 1 is assumed" in note for note in notes) != ("rho" in text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z,size\n0,0,0,1\n", "has columns x y z size: no radii among them"),
        ("2\n\nA 0 0 0\nA 1 0 0\n", "no radii after species x y z: add them as a fifth column"),
        ("2 0 0 0 1\n4 5 6 0 1\n", "it begins with '2 0 0 0 1 | 4 5 6 0 1'"),
        ("1 2 3\n4 5 6\n", "it begins with '1 2 3 | 4 5 6'"),
        ("x y z r\n0 0 0\n", "has 3 entries in row 1, but 4 columns"),
        ("x y z r\n0 0 0 one\n", "is not a number"),
        ("x y z r\n0 0 0 nan\n", "radius contains NaN or infinity"),
        ("x y z r\n0 0 0 1", "ends in the middle of a line"),
        ("x;y;z;r\n0;1,900;0;1.500\n", "one of which may separate thousands: write all numbers with decimal points"),
        ("x [mm],y [mm],z [mm],r [px]\n0,0,0,1\n", "has lengths in mm and px"),
        ("x [mm],y [mm],z,r [m]\n0,0,0,1\n", "has lengths in mm and m"),
        ("\n\n", "it is empty"),
        ("x y z r\n", "at least one grain|empty|0 grains"),
    ],
)
def test_tables_that_are_none(text, message, tmp_path):
    (tmp_path / "t").write_text(text)
    with pytest.raises(
        ss.packings.PackingError, match=message.replace("|", r"\|") if "begins" in message else message
    ) as problem:
        ss.io.read_packing(tmp_path / "t")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("end", "normal"),
    [("", [0, 0, 1]), (" side in", [0, 0, 1]), (" side out", [0, 0, -1]), (" move v_a NULL NULL", None)],
)
def test_walls_of_regions(end, normal, cases, tmp_path):
    """Also with the words for the default side; what a region does otherwise is quoted."""
    (tmp_path / "poured.restart").write_bytes((cases / "poured" / "poured.restart").read_bytes())
    log = (cases / "poured" / "log.lammps").read_text()
    style = re.search(r"(?m)^fix w all wall/gran (granular hooke 2000 20 [^$]* mass_velocity) zplane 0 NULL$", log)[1]
    wall = f"region low plane 0 0 0 0 0 2{end}\nfix w all wall/gran/region {style} region low\n"
    (tmp_path / "log.lammps").write_text(log.replace("write_restart", f"unfix w\n{wall}write_restart"))
    read, known = ss.io.read_packing(tmp_path), ss.io.read_packing(cases / "poured").state
    if normal is None:
        assert any("not `plane 0 0 0 0 0 2 move v_a NULL NULL`" in note for note in read.notes)
        return
    np.testing.assert_array_equal(read.state.walls.normal, [normal])
    if normal == [0, 0, 1]:
        np.testing.assert_array_equal(read.state.contacts.slip, known.contacts.slip)


@pytest.mark.parametrize(
    ("region", "told"),
    [
        ("block -9 9 INF INF INF 0.1 side out units box", ""),
        ("block INF 1.5 INF INF INF 0.1 side out units box", "grains touch several faces of its block from outside"),
        (
            "block INF INF INF INF INF 0.1 side out open 5",
            "a block with open faces and grains outside is not supported",
        ),
        ("block INF INF INF INF EDGE INF", "'EDGE'"),
        ("cylinder z 0 0 9 INF INF units box", "planes or blocks for all grains are supported, not `cylinder z 0 0 9"),
        ("block INF INF INF INF 0.1 INF units box", ""),
    ],
)
def test_blocks_that_are_flat_walls_and_others(region, told, cases, tmp_path):
    (tmp_path / "boxed.restart").write_bytes((cases / "boxed" / "boxed.restart").read_bytes())
    log = (cases / "boxed" / "log.lammps").read_text()
    (tmp_path / "log.lammps").write_text(
        re.sub(r"(?m)^(region ground) block [^&]*side out units box", rf"\1 {region}", log)
    )
    state, _, notes = ss.io.read_packing(tmp_path)
    left_out = [str(note) for note in notes if isinstance(note, Obstacle)]
    assert len(state.walls.mass) == 5 + (not told)
    assert len(left_out) == bool(told) and all("fix v (wall/gran/region)" in note and told in note for note in left_out)
    if not told:
        known = ss.io.read_packing(cases / "boxed").state
        np.testing.assert_array_equal(state.walls.normal, known.walls.normal)
        np.testing.assert_array_equal(
            state.walls.point @ state.walls.normal.T, known.walls.point @ known.walls.normal.T
        )


def test_the_parts_of_a_restart_file_are_one_packing(cases, tmp_path):
    """As its ranks wrote them at the same time step as the whole file."""
    for name, other in (("", ""), ("parts.base.restart", "ranks.restart"), ("parts.1.restart", "ranks.restart")):
        state, whole = (ss.io.read_packing(cases / run).state for run in (f"parts/{name}", f"ranks/{other}"))
        for mine, theirs in zip([*state.grains, *state.contacts], [*whole.grains, *whole.contacts], strict=True):
            np.testing.assert_array_equal(mine, theirs)
    base, first = cases / "parts" / "parts.base.restart", cases / "parts" / "parts.0.restart"
    for names, told in (
        ([base, first], "lacks its part parts.1.restart: copy all parts, or write the restart file without %"),
        ([first], "is one part of a restart file: give the file named base, beside all its parts"),
        ([base, first, first], "is damaged|with a contact of a missing grain"),
    ):
        folder = tmp_path / str(len(names))
        folder.mkdir()
        for path, name in zip(names, ("base", 0, 1) if base in names else (0,), strict=False):
            (folder / f"parts.{name}.restart").write_bytes(path.read_bytes())
        with pytest.raises(ss.packings.PackingError, match=told):
            ss.io.read_packing(next(folder.iterdir()))


@pytest.mark.parametrize(("release", "scaled"), [("22 Jul 2025", True), ("29 Oct 2021", False)])
def test_releases_that_multiply_the_stiffness_of_walls(release, scaled, cases, tmp_path):
    """Neither LAMMPS 23 Jun 2022 nor its source before 2019 does, and LAMMPS 2 Aug 2023 does."""
    (tmp_path / "classic.restart").write_bytes((cases / "classic" / "classic.restart").read_bytes())
    log = re.sub(r"\ALAMMPS \(.*", f"LAMMPS ({release})", (cases / "classic" / "log.lammps").read_text())
    (tmp_path / "log.lammps").write_text(log)
    _, law, notes = ss.io.read_packing(tmp_path)
    assert (law.table[0, -1, KT] == law.table[0, 0, KT]) != scaled
    assert any("multiplies by the contact radius" in note for note in notes if isinstance(note, Obstacle)) == scaled


def test_walls_in_the_syntax_of_old_releases(cases, tmp_path):
    """Without a style of its own, a wall has that of the pair style, and k_t as it is given."""
    old = "fix w all wall/gran 2000 NULL 20 10 0.4 1 zplane 0 NULL"
    state, law, notes = ss.io.read_packing(in_poured(cases, tmp_path, f"unfix w\n{old}"))
    assert not [note for note in notes if isinstance(note, Obstacle)]
    known = ss.io.read_packing(cases / "poured").state
    force = contact_loads(state, law)[0] + state.grains.mass[:, None] * state.control.gravity
    scale = float(np.abs(frame_of(state, law).contacts["force_n"]).mean())
    assert np.abs(force - read_grain_dump(cases / "poured" / "dump.grains")[0].force).max() < 1e-6 * scale
    np.testing.assert_array_equal(state.contacts.slip, known.contacts.slip)
    log = tmp_path / "log.lammps"
    log.write_text(log.read_text().replace("pair_style gran/hooke/history", "pair_style gran/hooke"))
    left_out = " ".join(note for note in ss.io.read_packing(tmp_path).notes if isinstance(note, Obstacle))
    assert (
        "names no style, as in old releases, which used that of pair_style hooke: it has no tangential springs"
        in left_out
    )


def test_gravity_on_a_group(cases, tmp_path):
    """As is usual where other grains are frozen: each grain of the group has its weight as a load."""
    (tmp_path / "materials.restart").write_bytes((cases / "materials" / "materials.restart").read_bytes())
    log = (cases / "materials" / "log.lammps").read_text()
    log = log.replace("fix g all gravity", "group top id 22:24\ngroup low subtract all top\nfix g low gravity")
    (tmp_path / "log.lammps").write_text(log)
    mine, whole = ss.io.read_packing(tmp_path), ss.io.read_packing(cases / "materials").state
    assert not any("gravity" in note for note in mine.notes if isinstance(note, Obstacle))
    free, state = whole.control.free[:, 0], mine.state
    weight = np.append(whole.grains.mass, whole.walls.mass)[:, None] * whole.control.gravity
    np.testing.assert_allclose(state.control.force[free], (whole.control.force + weight)[free], atol=1e-15)


def test_a_dump_without_radii_beside_one_with_them(cases, tmp_path):
    """Such as a dump of forces, whatever its name and time."""
    for name in ("log.lammps", "dump.grains", "contacts.dump"):
        (tmp_path / name).write_bytes((cases / "poured" / name).read_bytes())
    text = (cases / "poured" / "dump.grains").read_text()
    (tmp_path / "forces.dump").write_text(text.replace(" radius", " c_radius"))
    assert any("grains from dump.grains" in note for note in ss.io.read_packing(tmp_path).notes)


@pytest.mark.parametrize("line", ["include more.in", 'if "1 == 1" then "unfix g"'])
def test_what_a_script_leaves_open(line, cases, tmp_path):
    """Commands in other files and branches are in the log only."""
    (tmp_path / "poured.restart").write_bytes((cases / "poured" / "poured.restart").read_bytes())
    script = (cases / "poured" / "in.poured").read_text()
    (tmp_path / "in.poured").write_text(f"{line}\njump SELF loop\n{script}")
    notes = [note for note in ss.io.read_packing(tmp_path).notes if "what follows from" in note]
    assert [line.replace('"', "") in note.replace('"', "") for note in notes] == [True]


@pytest.mark.parametrize(
    ("dim", "text", "direction"),
    [
        (3, "chute 20", [0.34202, 0, -0.93969]),
        (2, "chute 20", [0.34202, -0.93969, 0]),
        (3, "spherical 30 200", [-0.29620, -0.17101, -0.93969]),
        (2, "spherical 30 200", [-0.34202, -0.93969, 0]),
        (2, "vector 3 -4 0", [0.6, -0.8, 0]),
    ],
)
def test_directions_of_gravity(dim, text, direction):
    """Those of LAMMPS, whose forces of runs in two dimensions balance with them."""
    packing, everybody = SimpleNamespace(arrays={"dim": dim}), np.ones(3, bool)
    course = SimpleNamespace(
        packing=packing, members=lambda group: everybody, push=lambda members: None, gravity=np.zeros(3)
    )
    TAKEN["gravity"](course, "g", "all", ["2.0", *text.split()])
    np.testing.assert_allclose(course.gravity, 2 * np.array(direction), atol=2e-5)


def test_defaults_of_the_gran_style():
    contact, _ = contact_of("hooke/history", ["7", "NULL", "2", "NULL", "0.3", "1"])
    assert contact.values == {"kn": 7, "kt": 2, "mu": 0.3, "damping_n": 2, "damping_t": 1}


def test_memory_of_a_fix_with_two_walls_goes_to_the_nearer():
    planes = [Plane(0.0, np.array([0, 0, 1.0]), 0), Plane(-3.0, np.array([0, 0, -1.0]), 0)]
    arrays = {"position": np.array([[0, 0, 0.49], [0, 0, 2.51]]), "radius": np.full(2, 0.5)}
    memory = Restart(*[None] * len(Restart._fields))
    memory = memory._replace(wall=np.array([0, 0]), grain=np.array([1, 0]), wall_slip=np.eye(3)[:2])
    memory = memory._replace(more=np.zeros((0, 7)), wall_more=np.zeros((2, 7)), face=np.full(2, -1))
    contact, _ = contact_of("hooke/history", ["7", "NULL", "2", "NULL", "0.3", "1"])
    contacts = dict.fromkeys([(0, 0), (0, 1), (0, 2)], contact)
    packing = SimpleNamespace(arrays=arrays)
    placed = with_wall_numbers(memory, SimpleNamespace(packing=packing, walls=planes, contacts=contacts, kinds=1))
    assert placed.wall.tolist() == [1, 0] and placed.grain.tolist() == [1, 0]


def test_grains_are_sorted_by_their_numbers():
    columns = {
        name: np.array(rows) for name, rows in {"id": [7.0, 3], "x": [1.0, 0], "y": [0.0, 0], "r": [2.0, 1]}.items()
    }
    packing = packing_of_columns(columns, "t")
    assert packing.ids.tolist() == [3, 7] and packing.arrays["radius"].tolist() == [1, 2]


def test_commands_after_the_data_file_do_not_count(cases, tmp_path):
    (tmp_path / "end.data").write_bytes((cases / "poured" / "poured.data").read_bytes())
    log = (cases / "poured" / "log.lammps").read_text()
    (tmp_path / "log.lammps").write_text(f"{log}\nwrite_data end.data\nfix later all spring/self 1.0\n")
    assert not any("fix later" in note for note in ss.io.read_packing(tmp_path).notes)


def in_poured(cases, folder, line="", name="poured.restart"):
    """Folder with the log of a poured packing, one more command in it, and one file of grains."""
    (folder / name).write_bytes((cases / "poured" / name).read_bytes())
    log = (cases / "poured" / "log.lammps").read_text()
    (folder / "log.lammps").write_text(log.replace("write_restart", f"{line}\nwrite_restart"))
    return folder


@pytest.mark.parametrize(
    ("text", "how"),
    [
        ("1 xy erate 1e-4 remap x", "xy erate 1e-4"),
        ("1 x trate 2e-3 z volume remap v", "x trate 2e-3, z volume"),
        ("1 y final 0 2 xz delta 0.1 units box", "y final 0 2, xz delta 0.1"),
    ],
)
def test_a_cell_that_was_being_strained_is_judged_as_it_is(text, how, cases, tmp_path):
    read = ss.io.read_packing(in_poured(cases, tmp_path, f"fix shear all deform {text}"))
    assert (
        f"fix shear (deform) was straining the cell ({how}): the verdict is for the instant, with the cell fixed"
        in read.assumed
    )
    assert not any(isinstance(note, Obstacle) for note in read.notes)


def test_a_run_that_left_no_later_state(cases, tmp_path):
    """As after a crash: the only grains are those it began from."""
    log = in_poured(cases, tmp_path, "read_data poured.data", "poured.data") / "log.lammps"
    log.write_text(log.read_text().replace("write_data poured.data", "write_data other.data"))
    read = ss.io.read_packing(tmp_path)
    assert any("poured.data is the initial state of the run, which left no later one" in note for note in read.assumed)


def test_runs_in_one_folder_are_not_mixed_silently(cases, tmp_path):
    (in_poured(cases, tmp_path) / "poured.restart").rename(tmp_path / "other.restart")
    (tmp_path / "log.first").write_bytes((tmp_path / "log.lammps").read_bytes())
    read = ss.io.read_packing(tmp_path)
    wanted = "none of log.first, log.lammps names other.restart, which may belong to another run"
    assert [note for note in read.notes if isinstance(note, Obstacle) and wanted in note]


@pytest.mark.parametrize("plane", ["zplane nan NULL", "zplane 0 inf"])
def test_planes_at_no_place_are_refused(plane, cases, tmp_path):
    line = f"fix q all wall/gran hooke/history 1 1 0 0 0.5 1 {plane}"
    notes = ss.io.read_packing(in_poured(cases, tmp_path, line)).notes
    assert any("fix q (wall/gran) was not imported" in note and "is not a finite number" in note for note in notes)


DUMP = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS pp pp ff\n0 3\n0 3\n{z}\n"
DUMP += "ITEM: ATOMS id x y z radius\n"


@pytest.mark.parametrize("content", [DUMP + "1 1 1 1 nan\n", DUMP + "1 1 nan 1 0.5\n", "x y z r\n0 0 0 nan\n"])
def test_messages_name_the_file(content, tmp_path):
    (tmp_path / "grains.txt").write_text(content.format(z="0 3"))
    with pytest.raises(ss.packings.PackingError, match=r"grains\.txt"):
        ss.io.read_packing(tmp_path / "grains.txt")


@pytest.mark.parametrize("z", ["3 0", "nan 3", "0 inf"])
def test_bounds_that_span_no_box(z, tmp_path):
    (tmp_path / "dump").write_text(DUMP.format(z=z) + "1 1 1 1 0.5\n")
    with pytest.raises(ss.packings.PackingError, match=r"dump .*lengths 3 3 \S+ along x y z, which must be positive"):
        ss.io.read_packing(tmp_path / "dump")


def test_arrays_of_objects_are_refused(tmp_path):
    np.save(tmp_path / "p.npy", np.array([{"x": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ss.packings.PackingError, match=r"p\.npy cannot be read"):
        ss.io.read_packing(tmp_path / "p.npy")


@pytest.mark.parametrize("before", ["pair_style", "run", "units"])
def test_a_log_that_another_one_began_goes_on_with_its_commands(before, cases, tmp_path):
    """The command `log` begins a file without a head; what was set before it counts."""
    lines = (cases / "poured" / "log.lammps").read_text().split("\n")
    k = next(k for k, line in enumerate(lines) if line.split()[:1] == [before])
    (tmp_path / "log.lammps").write_text("\n".join([*lines[:k], "log rest.log", ""]))
    (tmp_path / "rest.log").write_text("\n".join(lines[k:]))
    (tmp_path / "poured.restart").write_bytes((cases / "poured" / "poured.restart").read_bytes())
    read, whole = ss.io.read_packing(tmp_path), ss.io.read_packing(cases / "poured")
    assert any("from rest.log" in note for note in read.notes)
    assert (read.law.table == whole.law.table).all()
    assert (read.state.walls.point == whole.state.walls.point).all()
    assert (read.state.control.gravity == whole.state.control.gravity).all()
    assert len(read.notes) == len(whole.notes)


def test_two_logs_that_name_the_grains_with_other_laws(cases, tmp_path):
    """Not the newest one silently: copies have other dates."""
    in_poured(cases, tmp_path)
    log = (tmp_path / "log.lammps").read_text()
    (tmp_path / "log.old").write_text(log)
    assert not [note for note in ss.io.read_packing(tmp_path).notes if "keep only one of them" in note]
    (tmp_path / "log.old").write_text(log.replace(" 0.4 1", " 0.9 1"))  # the restart file has the friction of the other
    assert not [note for note in ss.io.read_packing(tmp_path).notes if isinstance(note, Obstacle)]
    (tmp_path / "log.old").write_text(log.replace("gravity 1.0", "gravity 2.0"))
    notes = ss.io.read_packing(tmp_path).notes
    wanted = "log.lammps and log.old name poured.restart with different laws or fixes"
    assert [note for note in notes if isinstance(note, Obstacle) and wanted in note]


@pytest.mark.parametrize(("plane", "behind"), [("zplane 2 NULL", True), ("zplane -9 NULL contacts", False)])
def test_grains_behind_a_wall_are_reported(plane, behind, cases, tmp_path):
    line = f"fix q all wall/gran granular hooke 2000 20 tangential linear_history 600 0.5 0.4 {plane}"
    notes = ss.io.read_packing(in_poured(cases, tmp_path, line)).notes
    assert any("behind the wall of fix q" in note for note in notes if isinstance(note, Obstacle)) == behind
    assert not any("was not imported" in note for note in notes if "fix q" in note)


def test_memory_that_is_written_is_read_again(cases, tmp_path):
    """The template's own memory is another one."""
    for run in ("forces", "sheared"):
        read = ss.io.read_packing(cases / run)
        state, path = read.state, cases / run / f"{run}.restart"
        turned = state._replace(contacts=state.contacts._replace(slip=-0.5 * state.contacts.slip))
        lammps_restart.write_memory(path, tmp_path / "new.restart", turned, read.law)
        walls = len(state.walls.mass)
        size = lammps_restart.Places.of(read.law).size
        new = lammps_restart.read_restart(tmp_path / "new.restart", walls=walls, values=size)
        again = lammps_restart.restore_memory(state, read.law, new)
        rows = ss.measure.touching(state)
        scale = np.abs(state.contacts.slip[rows]).max()
        np.testing.assert_allclose(again.contacts.slip[rows], turned.contacts.slip[rows], atol=1e-9 * scale)
