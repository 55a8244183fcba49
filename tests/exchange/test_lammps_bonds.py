"""Bonds of LAMMPS: loads are those of LAMMPS, references are those of its run, and what is not read has its name."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange import lammps_restart
from stickslip.data.exchange.lammps_bonds import format_bonds, replay
from stickslip.data.sample import Absent, Assumption, Obstacle
from tests.exchange.test_lammps_runs import answer


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Modes are written to the working directory."""
    monkeypatch.chdir(tmp_path)


def doubts(notes):
    return [note for note in notes if isinstance(note, Obstacle)]


def columns(path, *names):
    head, *rows = path.read_text().split("ITEM: ATOMS ")[1].strip().split("\n")
    values = np.array(sorted([float(word) for word in row.split()] for row in rows))
    return values[:, [head.split().index(name) for name in names]]


@pytest.mark.parametrize(("run", "count", "forms"), [("glued", 67, {0}), ("cemented", 56, {0, 1})])
def test_loads_are_those_of_lammps(run, count, forms, cases):
    """The second run is strained, turning, damped, near failure, with two styles; LAMMPS takes arc cosines there."""
    state, law, notes = ss.io.read_packing(cases / run)
    assert state.bonds.intact.sum() == count and set(state.bonds.form) == forms
    assert not [note for note in notes if isinstance(note, Assumption)]
    loads, n = ss.forces(state, law)[0], len(state.grains.radius)
    size = np.abs(ss.measure.contact_forces(state, law)).max()
    for ours, names in ((loads.force, ("fx", "fy", "fz")), (loads.torque, ("tqx", "tqy", "tqz"))):
        theirs = columns(cases / run / "dump.grains", *names)
        assert np.abs(ours[:n] - theirs).max() < (1e-12 if run == "glued" else 1e-9) * size
    if run == "cemented":
        assert 0.5 < ss.measure.bond_shares(state).max() < 1 and np.abs(theirs).max() > 0.01 * size


def test_the_order_of_the_styles_of_a_hybrid_does_not_matter(cases, monkeypatch):
    """LAMMPS stores the rest lengths of springs for beams, too, before or after the memory of the beams."""
    read = lammps_restart._read_bonds
    monkeypatch.setattr(lammps_restart, "_read_bonds", lambda *a: read(*a[:-1], dict(reversed(a[-1].items()))))
    state, law, _ = ss.io.read_packing(cases / "cemented")
    there = columns(cases / "cemented" / "dump.grains", "fx", "fy", "fz")
    off = np.abs(ss.forces(state, law)[0].force[: len(there)] - there).max()
    assert off < 1e-9 * np.abs(ss.measure.contact_forces(state, law)).max()


def test_restart_files_do_not_state_which_bonds_are_turned_off(cases, tmp_path):
    """LAMMPS writes their types without the sign, and turns them on again when it reads the file."""
    edits = [("log.lammps", "dump grains", "delete_bonds all bond 1\ndump grains")]
    (said,) = doubts(ss.io.read_packing(copied(cases, tmp_path, edits, run="cemented")).notes)
    assert "delete_bonds all bond 1 (log.lammps, line" in said
    assert "cemented.restart does not state which bonds it turned off" in said


def test_weights_of_contacts_are_those_of_the_restart_file(cases, tmp_path):
    """A run that continues from a restart file does not repeat the command."""
    edits = [("log.lammps", "\nspecial_bonds", "\n# special_bonds")]
    assert not doubts(ss.io.read_packing(copied(cases, tmp_path, edits, run="cemented")).notes)


def copied(cases, folder, edits=(), leave=(), run="glued"):
    """Folder of a run with edited files."""
    for path in (cases / run).iterdir():
        if path.name not in leave:
            (folder / path.name).write_bytes(path.read_bytes())
    for name, old, new in edits:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))
    return folder


STYLE = "bond_style bpm/spring overlay/pair yes break no smooth no"
WHOLE = "special_bonds lj 1 1 1 coul"
END = "dump grains"


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (WHOLE, "special_bonds lj 0 1 1 coul", "special_bonds lj 0 1 1: LAMMPS changes or removes contacts between"),
        (WHOLE, "special_bonds lj/coul 1 0 1 coul", "such contacts would act fully here"),
        (WHOLE, "special_bonds fene coul", "special_bonds lj 0 1 1"),
        (
            STYLE,
            "bond_style fene",
            "bonds of glued.data were not imported: fene: stickslip has no equivalent bond (log.l",
        ),
        (STYLE, f"{STYLE} volume/factor yes", "its option volume/factor yes is not supported"),
        (STYLE, f"{STYLE} mystery 1", "its option mystery 1 is not supported"),
        (STYLE, f"{STYLE} volume/factor no store/local broken 10 time id1 id2 normalize yes", ""),
        (STYLE, STYLE.replace("break no smooth no", "break yes"), ""),
        (STYLE, "bond_style none", ""),
        (STYLE, "", "bonds of glued.data were not imported: there is no bond_style"),
        ("bond_coeff * 0.05", "bond_coeff 2* 0.05", "no bond_coeff defines a law for bonds of type 1"),
        (
            "bond_coeff * 0.05",
            "bond_coeff glue 0.05",
            "the type glue of a bond_coeff is neither a number nor a label in a labelmap",
        ),
        ("bond_coeff * 0.05", "labelmap bond 1 glue\nbond_coeff glue 0.05", ""),
        ("bond_coeff * 0.05 10 0.0", "bond_coeff * 0.05 10", "bpm/spring needs 3 coefficients, got 2: 0.05 10"),
        ("bond_coeff * 0.05 10 0.0", "bond_coeff * nan 10 0", "coefficients of bpm/spring must be finite and not nega"),
        ("bond_coeff * 0.05 10 0.0", "bond_coeff * 0.05 10 -1", "be finite and not negative, got 0.05 10 -1"),
        ("bond_coeff * 0.05 10 0.0", "bond_coeff * 0 10 0", "its first stiffness, and strengths of bonds that break"),
        (STYLE, f"{STYLE} normalize", "its option normalize is not supported"),
        (END, f"delete_bonds all bond 1\n{END}", "delete_bonds all bond 1 (log.lammps, line"),
        (END, f"delete_bonds all bond 1 remove\n{END}", ""),
        (END, f"fix c all bond/create 1 1 1 1.0 1\n{END}", "fix c (bond/create) was not imported"),
        (END, f"  7 angles\n{END}", "7 angles (log.lammps, line"),
    ],
)
def test_commands_on_bonds_are_followed_or_named(old, new, text, cases, tmp_path):
    said = doubts(ss.io.read_packing(copied(cases, tmp_path, [("log.lammps", old, new)])).notes)
    assert len(said) == 1 and text in said[0] if text else not said


def test_laws_have_the_numbers_of_lammps(cases, tmp_path):
    """Forces fade by the eighth power of the stretch; the energy of `harmonic` is K (r − r₀)²."""
    edits = [("log.lammps", STYLE, STYLE.replace("break no smooth no", "break yes smooth yes"))]
    edits += [("log.lammps", "bond_coeff * 0.05 10 0.0", "bond_coeff 1 0.05 9 0.0\nbond_coeff 1*2 0.06 0.2 0.3")]
    bonds = ss.io.read_packing(copied(cases, tmp_path, edits)).state.bonds
    assert set(bonds.fading) == {8} and set(bonds.stiffness[:, 0]) == {0.06} and set(bonds.damping[:, 0]) == {0.3}
    np.testing.assert_allclose(bonds.strength[:, 0], 0.06 * 0.2 * bonds.length)
    edits = [("log.lammps", STYLE, "bond_style harmonic"), ("log.lammps", "* 0.05 10 0.0", "1 0.05 1.01")]
    bonds = ss.io.read_packing(copied(cases, tmp_path, edits)).state.bonds
    assert set(bonds.stiffness[:, 0]) == {0.1} and set(bonds.length) == {1.01}


def test_a_spring_without_length_at_rest_is_named(cases, tmp_path):
    """A length of zero means one that is not known."""
    edits = [("log.lammps", STYLE, "bond_style harmonic"), ("log.lammps", "* 0.05 10 0.0", "1 0.05 0.0")]
    (said,) = doubts(ss.io.read_packing(copied(cases, tmp_path, edits)).notes)
    assert "springs of length 0 at rest are not supported" in said


def test_the_fault_of_a_list_of_bonds_has_its_name(cases, tmp_path):
    edits = [("glued.data", "67 bonds", "68 bonds")]
    notes = ss.io.read_packing(copied(cases, tmp_path, edits)).notes
    assert doubts(notes)
    (said,) = [note for note in notes if isinstance(note, Absent)]
    assert said.startswith("bonds were not read: ") and "glued.data" in said and "68" in said


def test_bonds_that_no_file_lists_leave_the_verdict_undecided(cases, tmp_path):
    said = doubts(ss.io.read_packing(copied(cases, tmp_path, leave=["glued.data"])).notes)
    assert [note.split()[1] for note in said] == ["create_bonds", "bond_style"] and "no file lists the bonds" in said[0]
    alone = tmp_path / "alone"
    alone.mkdir()
    copied(cases, alone, leave=["dump.grains", "log.lammps", "in.glued", "contacts.dump"])
    options = {"atom_style": "hybrid sphere bond"}
    said = doubts(ss.io.read_packing(alone / "glued.data", **options).notes)
    assert (
        len(said) == 1
        and "67 bonds of glued.data were not imported: give the run folder, whose log contains their laws" in said[0]
    )


def bonds_of(text):
    """Lines of the section Bonds."""
    return text.partition("Bonds\n\n")[2]


@pytest.mark.parametrize(
    ("change", "count", "text"),
    [
        (
            lambda lines: ["1 0 " + lines[0].split(" ", 2)[2], *lines[1:]],
            66,
            "1 bond of glued.data with types that are not",
        ),
        (
            lambda lines: ["1 -1 " + lines[0].split(" ", 2)[2], *lines[1:]],
            66,
            "1 bond of glued.data with types that are not",
        ),
        (lambda lines: [], 0, ""),
        (
            lambda lines: ["1 1 5 99", *lines[1:]],
            None,
            "has a bond between atoms 5 and 99, which are not both among its 27",
        ),
        (lambda lines: ["1 1 5 5", *lines[1:]], None, "has a bond from atom 5 to itself"),
        (lambda lines: [*lines[:-1], lines[0]], None, "twice: list each bond once"),
        (lambda lines: [" ".join(np.array(lines[0].split())[[0, 1, 3, 2]]), *lines[1:]], 67, ""),
        (lambda lines: ["1 1 5", *lines[1:]], None, "is truncated or not a LAMMPS data file"),
        (lambda lines: [line + " 7" for line in lines], None, "section Bonds must have four whole numbers"),
        (lambda lines: lines[1:], None, "section Bonds has 66 lines but the file declares 67 bonds"),
        (lambda lines: [line.replace(" 1 ", " glue ", 1) for line in lines], 67, ""),
    ],
)
def test_lists_of_bonds(change, count, text, cases, tmp_path):
    """No bonds at all are as good as any; a broken list is refused where it is the grains' own."""
    whole = (cases / "glued" / "glued.data").read_text()
    lines = change(bonds_of(whole).strip().split("\n"))
    new = whole.replace(bonds_of(whole), "\n".join(lines) + "\n")
    if not lines:
        new = new.replace("67 bonds", "0 bonds").replace("Bonds\n\n\n", "")
    if " glue " in new:
        new = new.replace("Bonds\n\n", "Bond Type Labels\n\n1 glue\n2 else\n\nBonds\n\n")
    folder = copied(cases, tmp_path, leave=["dump.grains", "contacts.dump"])
    (folder / "glued.data").write_text(new)
    if count is None:
        with pytest.raises(ss.packings.PackingError, match=text) as problem:
            ss.io.read_packing(folder)
        assert "\n" not in str(problem.value)
        return
    state, _, notes = ss.io.read_packing(folder)
    assert (len(state.bonds.i) if state.bonds else 0) == count and not doubts(notes)
    assert any(text in note for note in notes)


@pytest.mark.parametrize(
    ("commands", "strained", "turned", "origin"),
    [
        ("create_bonds x;bond_style s;run 0", False, False, ""),
        ("run 100;create_bonds x;bond_style s;run 0", False, True, ""),
        ("create_bonds x;bond_style s;run 1", True, False, ""),
        ("create_bonds x;bond_style s;run 0;displace_atoms all", True, False, ""),
        ("create_bonds x;displace_atoms all;bond_style s;run 0", False, False, ""),
        ("create_bonds x;bond_style s;run 9;bond_style s;run 0", False, True, ""),
        ("read_data a.data;bond_style s;run 5", True, False, "a.data"),
        ("bond_style s;read_data a.data;run 0;minimize 1", True, False, "a.data"),
        ("read_data a.data;change_box all;bond_style s;run 5", True, False, ""),
        ("read_data a.data;run 5;bond_style s;run 5", True, True, ""),
        ("read_data a.data;create_bonds x;bond_style s;run 5", True, False, ""),
        ("read_restart a;bond_style s;run 0", True, True, ""),
        ("bond_style s;run ${n}", True, True, ""),
    ],
)
def test_bonds_are_at_rest_when_lammps_first_evaluates_them(commands, strained, turned, origin):
    told = replay([["", *command.split()] for command in commands.split(";")])
    assert (told.strained, told.turned, told.origin) == (strained, turned, origin)


HEAD = """of grains

3 atoms
1 atom types
2 bonds
1 bond types

0 9 xlo xhi
0 9 ylo yhi
0 9 zlo zhi

Atoms # hybrid

1 1 0.1 1 1 1 1 0
2 1 1.1 1 1 1 1 0
3 1 8.6 1 1 1 1 0

Bonds

1 1 1 2
2 1 1 3
"""
INPUT = """atom_style hybrid sphere bond
boundary p p p
read_data bonded.data
pair_style gran/hertz/history 1.0 0.8 0.0 0.0 0.3 1
pair_coeff * *
bond_style bpm/spring overlay/pair yes break {breaks} smooth no
bond_coeff 1 2.0 0.1 0.0
special_bonds lj 1 1 1 coul 1 1 1
fix move all nve/sphere
dump d all custom 100 pair.dump id type x y z vx vy vz omegax omegay omegaz radius mass
run {steps}
"""
DUMP = """ITEM: TIMESTEP
100
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS pp pp pp
0 9
0 9
0 9
ITEM: ATOMS id type x y z vx vy vz omegax omegay omegaz radius mass
1 1 0.1000000000 1.000000000 1.000000000 0 0 0 0 0 0 0.5 0.5236
2 1 1.1500000000 1.000000000 1.000000000 0 0 0 0 0 0 0.5 0.5236
3 1 8.6000000000 1.000000000 1.000000000 0 0 0 0 0 0 0.5 0.5236
"""


@pytest.mark.parametrize(("breaks", "steps"), [("no", "100"), ("yes", "100"), ("no", "${steps}")])
def test_bonds_of_the_data_file_that_a_run_began_with(breaks, steps, tmp_path):
    """They are as long at rest as there, across the box as well; those that may have broken since are doubtful."""
    (tmp_path / "bonded.data").write_text(HEAD)
    (tmp_path / "pair.dump").write_text(DUMP)
    (tmp_path / "in.pair").write_text(INPUT.format(breaks=breaks, steps=steps))
    state, law, notes = ss.io.read_packing(tmp_path)
    np.testing.assert_allclose(state.bonds.length, [1.0, 0.5])
    np.testing.assert_allclose(ss.forces(ss.packings.without_bonds(state), law)[0].force[1], 0)
    np.testing.assert_allclose(ss.forces(state, law)[0].force[1], [-2.0 * 0.05, 0, 0])
    assert [note for note in doubts(notes) if "may have broken" in note] == doubts(notes)
    assert len(doubts(notes)) == (breaks == "yes")


def test_references_that_are_not_known_are_assumed(cases, tmp_path):
    """Data files have no lengths at rest, and dumps no orientations."""
    edits = [("log.lammps", END, f"run 50\n{END}")]
    notes = ss.io.read_packing(copied(cases, tmp_path, edits)).notes
    assert [note for note in notes if "are assumed to be at rest in this state: rest lengths" in note]
    law = "bond_style bpm/rotational break no smooth no", "* 1 1 1 1 1 1 1 1 0 0 0 0"
    edits = [("log.lammps", STYLE, law[0]), ("log.lammps", "* 0.05 10 0.0", law[1])]
    notes = ss.io.read_packing(copied(cases, tmp_path, edits)).notes
    assert [note for note in notes if "are assumed not to be bent, twisted or sheared" in note]


def test_a_restart_file_alone_lists_bonds_without_their_laws(cases):
    said = doubts(ss.io.read_packing(cases / "cemented" / "cemented.restart").notes)
    assert len(said) == 1 and "56 bonds of cemented.restart were not imported" in said[0]


@pytest.mark.parametrize("seed", range(3))
def test_damaged_restart_files_with_bonds_end_in_a_sentence(seed, cases, tmp_path):
    content = bytearray((cases / "cemented" / "cemented.restart").read_bytes())
    rng = np.random.default_rng(seed)
    for _ in range(25):
        part = bytearray(content)
        for at in rng.integers(len(content) // 4, len(content) - 16, 3):
            part[at] = rng.integers(256)
        (tmp_path / "a.restart").write_bytes(part)
        try:
            ss.io.read_packing(tmp_path / "a.restart")
        except ss.packings.PackingError as problem:
            assert "\n" not in str(problem)


def test_one_command_on_the_folder_of_a_bonded_run(cases, capsys, tmp_path):
    code, said = answer(capsys, "stability", cases / "glued", "--modes", tmp_path / "m.npz")
    assert code == 0 and "gran/hertz/history, 67 bonds" in said and "67 of them bonded" in said
    assert "oscillatory instability: 4 complex pairs" in said


BEAM = ss.laws.beam_bond(1.0, 0.5, 0.1, 0.2, strength=(0.1, 0.2, 0.05, 0.04), damping=(0.1, 0.2, 0.3, 0.4))
WRITTEN = {
    "springs": ([ss.laws.spring_bond(0.3), ss.laws.spring_bond(0.2)], "bond_style harmonic"),
    "breakable": (
        [ss.laws.spring_bond(0.3), ss.laws.spring_bond(0.3, 0.5, damping=0.1)],
        "bond_style bpm/spring overlay/pair yes break yes smooth yes",
    ),
    "beams": ([BEAM], "bond_style bpm/rotational overlay/pair yes break yes smooth yes"),
    "mixed": (
        [ss.laws.spring_bond(0.3, 0.5, smooth=False), BEAM, ss.laws.parallel_bond(3.0, 1.0)],
        "bond_style hybrid bpm/spring overlay/pair yes break yes smooth no bpm/rotational overlay/pair yes break yes",
    ),
}


GLUED = ss.laws.hertz_mindlin_reff(kn=1e-30, kt=1e-30)


def glued(bonds):
    """Spheres on a lattice, periodic along x, with bonds of several laws and no contacts."""
    site = np.stack(np.meshgrid(*[np.arange(3.0)] * 3), -1).reshape(-1, 3) + 0.5
    state = ss.assembly(ss.spheres(site, 0.48), cell=ss.box([3.3, 3.0, 3.0], (True, False, False)))
    pairs = [(i, j) for i in range(27) for j in range(i) if np.linalg.norm(site[i] - site[j]) < 1.1]
    for k, bond in enumerate(bonds):
        state = ss.packings.bonded(state, bond, pairs=np.array(pairs[k :: len(bonds)]))
    return accepted(state)


def accepted(state):
    return ss.accept(state, ss.forces(state, GLUED)[1])


@pytest.mark.parametrize("kind", WRITTEN)
def test_a_data_file_has_the_bonds_and_their_laws(kind, tmp_path):
    """Loads of the packing that is read back, then moved, are those of the original, except for lost rest lengths."""
    bonds, style = WRITTEN[kind]
    state = glued(bonds)
    notes = ss.io.write_packing(tmp_path / "p.data", state, GLUED)
    assert f"`{style}" in " ".join(notes) and "LAMMPS takes to be at rest" not in " ".join(notes)
    assert ("LAMMPS has no parallel bonds: 18 bonds" in " ".join(notes)) == (kind == "mixed")
    again, _, said = ss.io.read_packing(tmp_path / "p.data", boundary="pff")
    assert len(again.bonds.i) == len(state.bonds.i) and not doubts(said)
    text = (tmp_path / "p.data").read_text()
    (tmp_path / "r.data").write_text(text.replace("# bond_coeff 1 ", "# bond_coeff 9 "))
    said = doubts(ss.io.read_packing(tmp_path / "r.data", boundary="pff").notes)
    assert len(said) == 1 and "were not imported: no bond_coeff defines a law for bonds of type 1" in said[0]
    rng = np.random.default_rng(1)
    way, turn = rng.uniform(-0.02, 0.02, (2, 27, 3))
    loads = []
    for one in (state, again):
        moved = one.grains._replace(position=one.grains.position + way, angle=one.grains.angle + turn)
        loads.append(np.hstack(ss.forces(one._replace(grains=moved), GLUED)[0][:2]))
    np.testing.assert_allclose(loads[0], loads[1], atol=1e-12)
    deformed = accepted(state._replace(grains=state.grains._replace(position=state.grains.position + way)))
    intact = np.arange(len(state.bonds.i)) > 1
    deformed = deformed._replace(bonds=deformed.bonds._replace(intact=intact))
    notes = ss.io.write_packing(tmp_path / "q.data", deformed, GLUED)
    count = len(intact) - 2
    lost = "2 bonds that broke" if kind == "springs" else (
        f"the deformation of {count} bonds, which LAMMPS takes to be at rest; 2 bonds that broke"
    )  # fmt: skip
    assert f"LAMMPS data files do not store {lost}" in notes
    again = ss.io.read_packing(tmp_path / "q.data", boundary="pff").state
    assert len(again.bonds.i) == count
    assert (np.abs(ss.forces(again, GLUED)[0].force).max() > 1e-6) == (kind == "springs")
    image = deformed.bonds.image + np.eye(count + 2, 3, -2, np.int16)
    notes = format_bonds(deformed._replace(bonds=deformed.bonds._replace(image=image))).notes
    assert "1 bond to images that are not the nearest" in notes[0]
