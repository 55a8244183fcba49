"""LAMMPS's text files: every way to write a box and a position, memory from forces, and what cannot be taken."""

import itertools
import time
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stickslip as ss
from stickslip.data.exchange.columns import contradictions
from stickslip.data.exchange.lammps_text import read_dump
from stickslip.data.sample import Obstacle, notes_about
from stickslip.loading.reading import convert
from stickslip.reports.packing import missing_parts

from .packings import SHARP, disks, spheres

GIVEN = {"law": "hertz_mindlin_reff", "kn": 2.0, "kt": 1.5, "mu": 0.2, "damping_n": 0.3, "damping_t": 0.2}


def back(path, **options):
    return ss.io.read_packing(path, contacts=path.with_name(f"{path.stem}.contacts.dump"), **(GIVEN | options))


@pytest.mark.parametrize("make", [spheres, disks])
def test_data_and_contacts_come_back(make, tmp_path):
    """Slip comes back through the force: to round-off of its division by overlaps."""
    state = make(motion=False)
    notes = ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    assert any("which is in p.contacts.dump: read it back with --contacts " in word for word in notes)
    again, law, _ = back(tmp_path / "p.data", boundary="ppp")
    for name in ("radius", "velocity", "spin"):
        assert np.array_equal(getattr(again.grains, name), getattr(state.grains, name))
    np.testing.assert_allclose(again.grains.mass, state.grains.mass, rtol=1e-14)
    np.testing.assert_allclose(again.grains.position, state.grains.position, atol=1e-13)
    np.testing.assert_allclose(again.cell.vectors, state.cell.vectors, rtol=1e-14)
    mine, theirs = ss.measure.touching(state), ss.measure.touching(again)
    assert len(mine) == len(theirs)
    scale = np.abs(state.contacts.slip).max()
    np.testing.assert_allclose(branches_and_slip(again, theirs), branches_and_slip(state, mine), atol=1e-9 * scale)
    assert sorted(again.contacts.mode[theirs]) == sorted(state.contacts.mode[mine])
    np.testing.assert_allclose(ss.forces(again, law)[0].force, ss.forces(state, SHARP)[0].force, atol=1e-11)


def branches_and_slip(state, rows):
    """Contacts in an order that does not depend on which periods positions are counted in."""
    c = state.contacts
    table = np.column_stack([c.i[rows], c.j[rows], ss.measure.branch_vectors(state)[rows], c.slip[rows]])
    return table[np.lexsort((np.round(table[:, 2], 6), table[:, 1], table[:, 0]))][:, 2:]


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_any_packing_keeps_its_forces(seed, tmp_path_factory):
    state = spheres(seed, motion=False)
    path = tmp_path_factory.mktemp("data") / "p.data"
    ss.io.write_packing(path, state, SHARP)
    again, law, _ = back(path)
    np.testing.assert_allclose(ss.forces(again, law)[0].force, ss.forces(state, SHARP)[0].force, atol=1e-11)


def test_in_motion_sticking_contacts_come_back_and_sliding_ones_are_reported(tmp_path):
    """A sliding contact's force says how far its spring is stretched only up to what its dashpot carries."""
    state = spheres()
    notes = ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    assert any("9 sliding contacts in motion" in word for word in notes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ss.packings.PackingWarning)
        again, _, _ = back(tmp_path / "p.data")
    mine, theirs = ss.measure.touching(state), ss.measure.touching(again)
    miss = np.abs(branches_and_slip(again, theirs) - branches_and_slip(state, mine)).max(axis=1)
    assert (miss > 1e-11).sum() <= 9
    assert miss.max() < 1e-4
    # of two the dashpot carries so much that spring and dashpot together stay below the limit
    assert (again.contacts.mode[theirs] == ss.SLIDE).sum() == 7


def dump(path, state, *, columns, rows, box="", flags="pp pp pp", order=None, step=5):
    """A dump of grains, with its box bounded as LAMMPS does."""
    v = state.cell.vectors
    xy, xz, yz = v[1, 0], v[2, 0], v[2, 1]
    low = [min(0, xy, xz, xy + xz), min(0, yz), 0]
    high = [v[0, 0] + max(0, xy, xz, xy + xz), v[1, 1] + max(0, yz), v[2, 2]]
    lines = [f"{a!r} {b!r} {c!r}" for a, b, c in np.array([low, high, (xy, xz, yz)]).T.tolist()]
    head = f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{len(rows)}\nITEM: BOX BOUNDS xy xz yz {flags}\n"
    order = range(len(rows)) if order is None else order
    body = "\n".join(" ".join(f"{x:.17g}" for x in rows[k]) for k in order)
    with path.open("a") as file:
        file.write(head + "\n".join(lines) + f"\nITEM: ATOMS {columns}\n{body}\n")


@pytest.mark.parametrize(
    "kind", ["x y z", "xu yu zu", "xs ys zs", "xsu ysu zsu", "x y z ix iy iz", "xs ys zs ix iy iz"]
)
def test_positions_in_all_their_columns(kind, tmp_path):
    state = spheres()
    g, inverse = state.grains, np.linalg.inv(state.cell.vectors)
    share = g.position @ inverse
    whole = np.floor(share)
    n = np.arange(1, 65)[:, None]
    wrapped = share - whole
    parts = {
        "x y z": wrapped @ state.cell.vectors, "xu yu zu": g.position, "xs ys zs": wrapped, "xsu ysu zsu": share,
        "ix iy iz": whole,
    }  # fmt: skip
    chosen = [part for name, part in parts.items() if name in kind]
    rows = np.hstack([n, *chosen, 2 * g.radius[:, None], g.mass[:, None]])
    order = np.random.default_rng(0).permutation(64)
    dump(tmp_path / "g.dump", state, columns=f"id {kind} diameter mass", rows=rows, order=order)
    again, _, notes = ss.io.read_packing(tmp_path / "g.dump", **GIVEN)
    np.testing.assert_allclose(again.cell.vectors, state.cell.vectors, atol=1e-14)
    known = "u" in kind or "ix" in kind
    expected = g.position if known else wrapped @ state.cell.vectors
    np.testing.assert_allclose(again.grains.position, expected, atol=1e-13)
    np.testing.assert_allclose(again.grains.radius, g.radius, rtol=1e-15)
    assert any("without memory" in word for word in notes)


def test_a_general_triclinic_box(tmp_path):
    text = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS abc origin pp ff pp\n"
    text += "0 5 0 -1\n-6 0 0 -2\n0 0 7 -3\nITEM: ATOMS id x y z radius mass\n1 0 0 1 0.5 1\n"
    (tmp_path / "g.dump").write_text(text)
    (table,), _ = read_dump(tmp_path / "g.dump")
    assert table.vectors.tolist() == [[0, 5, 0], [-6, 0, 0], [0, 0, 7]]
    assert table.corner.tolist() == [-1, -2, -3]
    assert table.periodic.tolist() == [True, False, True]
    state, _, notes = ss.io.read_packing(tmp_path / "g.dump", **GIVEN)
    assert state.cell.periodic.tolist() == [True, False, True]
    assert any("the box is open along y: no walls were read, as the file contains none" in word for word in notes)


def test_time_steps_are_chosen_and_reported(tmp_path):
    state = spheres()
    for step in (0, 10, 20):
        rows = np.column_stack([np.arange(1, 65), state.grains.position + step, state.grains.radius])
        dump(tmp_path / "g.dump", state, columns="id xu yu zu radius", rows=rows, step=step)
    last, _, notes = ss.io.read_packing(tmp_path / "g.dump", **GIVEN)
    np.testing.assert_allclose(last.grains.position, state.grains.position + 20)
    assert any("has 3 time steps: the last, 20, is used" in word for word in notes)
    assert any("a density of 1 is assumed" in word for word in notes)
    chosen, _, notes = ss.io.read_packing(tmp_path / "g.dump", frame="10", **GIVEN)
    np.testing.assert_allclose(chosen.grains.position, state.grains.position + 10)
    assert not any("time steps" in word for word in notes)
    assert len(ss.io.read_packings(tmp_path / "g.dump", **GIVEN)) == 3
    with pytest.raises(ss.packings.PackingError, match="no time step 7: it has 0, 10, 20"):
        ss.io.read_packing(tmp_path / "g.dump", frame="7", **GIVEN)


def test_flat_packings_are_two_dimensional(tmp_path):
    state = disks(motion=False)
    ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    again, _, notes = back(tmp_path / "p.data", i0=0.5)
    assert again.cell.dim == 2
    assert any("two-dimensional" in word for word in notes)
    assert np.array_equal(again.grains.inertia, 0.5 * again.grains.mass * again.grains.radius**2)


def test_velocities_and_spins_without_a_third_component_are_not_used(tmp_path):
    state = disks()
    g = state.grains
    rows = np.column_stack([np.arange(len(g.radius)) + 1, g.position, g.radius, g.mass, g.velocity[:, :2]])
    columns = "id x y z radius mass"
    dump(tmp_path / "xy.dump", state, columns=f"{columns} vx vy", rows=rows.tolist())
    dump(tmp_path / "turn.dump", state, columns=f"{columns} omegax omegay", rows=rows.tolist())
    for name in ("xy.dump", "turn.dump"):
        again, _, notes = ss.io.read_packing(tmp_path / name, **GIVEN)
        assert not again.grains.velocity.any() and not again.grains.spin.any()
        assert any("no velocities" in note for note in notes)


def contact_dump(path):
    """Bounds of the box (3, 3), and rows of contacts, as OVITO reads them."""
    lines = path.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("ITEM: BOX BOUNDS"))
    return np.array([line.split() for line in lines[first + 1 : first + 4]], float), np.loadtxt(lines[first + 5 :])


@pytest.mark.parametrize("tilt", [(0.4, 0.3, 0.2), (-0.4, -0.3, -0.2), (0.4, -0.3, 0.2)])
def test_bounds_of_a_box_enclose_it(tilt, tmp_path):
    xy, xz, yz = tilt
    vectors = np.array([[3.0, 0, 0], [xy, 3.0, 0], [xz, yz, 3.0]])
    arrays = {"position": [[1.0, 1.0, 1.0], [1.95, 1.0, 1.0]], "radius": [0.5, 0.5], "cell": vectors}
    ss.io.write_packing(tmp_path / "p.data", ss.packings.from_arrays(law=SHARP, **arrays), SHARP)
    corners = np.array(list(itertools.product((0, 1), repeat=3))) @ vectors
    bounds, _ = contact_dump(tmp_path / "p.contacts.dump")
    np.testing.assert_allclose(bounds[:, 1] - bounds[:, 0], np.ptp(corners, axis=0), rtol=1e-12)
    np.testing.assert_array_equal(bounds[:, 2], tilt)


def test_written_forces_of_contacts_include_dashpots(tmp_path):
    state = spheres()
    ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    _, rows = contact_dump(tmp_path / "p.contacts.dump")
    total = np.zeros((len(state.grains.radius), 3))
    for side, sign in ((0, 1), (1, -1)):
        np.add.at(total, rows[:, side].astype(int) - 1, sign * (rows[:, 6:9] + rows[:, 9:12]))
    expected = ss.forces(state, SHARP)[0].force
    np.testing.assert_allclose(total, expected, atol=1e-3 * np.abs(expected).max())  # sliding ones are truncated


def test_a_table_without_grains_is_no_contradiction():
    none = np.zeros(0)
    assert contradictions("empty.csv", {"radius": none, "diameter": none, "mass": none, "density": none}) == []


def test_a_grain_that_touches_two_images_of_another(tmp_path):
    law = ss.laws.linear(1.0, 0.5, 0.5, coulomb="sharp")
    arrays = {"position": [[0.5, 0.5, 0.5], [1.45, 0.5, 0.5]], "radius": [0.5, 0.5], "cell": [1.9, 3, 3]}
    slip, image = [[0, 1e-3, 0], [0, -2e-3, 1e-3]], [[0, 0, 0], [1, 0, 0]]
    state = ss.packings.from_arrays(law=law, pair_i=[0, 0], pair_j=[1, 1], image=image, slip=slip, **arrays)
    ss.io.write_packing(tmp_path / "p.data", state, law)
    given = {"law": "linear", "kn": 1.0, "kt": 0.5, "mu": 0.5, "damping_n": 0.0, "damping_t": 0.0}
    again, _, _ = ss.io.read_packing(tmp_path / "p.data", contacts=tmp_path / "p.contacts.dump", **given)
    rows = ss.measure.touching(again)
    assert len(rows) == 2
    np.testing.assert_allclose(
        branches_and_slip(again, rows), branches_and_slip(state, ss.measure.touching(state)), atol=1e-15
    )


@pytest.mark.parametrize("name", ["law", "kn", "kt", "mu", "damping_n", "damping_t"])
def test_every_parameter_of_the_law_is_needed(name, tmp_path):
    ss.io.write_packing(tmp_path / "p.data", spheres(), SHARP)
    with pytest.raises(ss.packings.PackingError, match=f"give --{name.replace('_', '-')} as in its pair_style"):
        back(tmp_path / "p.data", **{name: None})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kn": 3.0}, "differ from those in the dump"),
        ({"coulomb": "smooth"}, "friction is sharp"),
        ({"law": "hooke"}, "law must be hertz_mindlin or linear .*, got 'hooke'"),
        ({"columns": "i j"}, "has 12 columns, but --columns has 2 names"),
        ({"boundary": "xyz"}, "three letters"),
    ],
)
def test_what_does_not_fit_gives_a_one_sentence_error(change, message, tmp_path):
    ss.io.write_packing(tmp_path / "p.data", spheres(), SHARP)
    with pytest.raises(ss.packings.PackingError, match=message) as problem:
        back(tmp_path / "p.data", **change)
    assert "\n" not in str(problem.value)


STYLES = {  # rows of LAMMPS's data files with as many columns as those of `sphere`
    "full": "{k} 1 1 0.25 {x} {y} {z}",
    "ellipsoid": "{k} 1 1 2.5 {x} {y} {z}",
    "body": "{k} 1 0 2.5 {x} {y} {z} 0 0 0",
    "peri": "{k} 1 1 2.5 {x} {y} {z}",
}


UNNAMED = {"body": "ellipsoid or body: x y z, diameter and density are needed"}  # its fourth column is no type


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("named", [True, False])
def test_other_styles_are_not_taken_for_spheres(style, named, tmp_path):
    path, site = tmp_path / "p.data", [(0.0, 0.0, 0.0), (0.9, 0.0, 0.0), (1.8, 0.1, 0.1)]
    rows = [STYLES[style].format(k=k, x=x, y=y, z=z) for k, (x, y, z) in enumerate(site, start=1)]
    head = f"by LAMMPS\n\n3 atoms\n0 3 xlo xhi\n0 3 ylo yhi\n0 3 zlo zhi\n\nAtoms{f' # {style}' if named else ''}\n\n"
    path.write_text(head + "\n".join(rows) + "\n")
    with pytest.raises(
        ss.packings.PackingError, match=f"style {style}" if named else UNNAMED.get(style, "--atom-style sphere")
    ):
        ss.io.read_packing(path, law="linear", mu=0.5)
    if named:
        with pytest.raises(ss.packings.PackingError, match=f"atom_style = 'sphere' contradicts .* style {style}"):
            ss.io.read_packing(path, law="linear", mu=0.5, atom_style="sphere")


def test_spheres_without_a_style_are_asked_for_or_reported(tmp_path):
    ss.io.write_packing(tmp_path / "p.data", spheres(), SHARP)
    edited(tmp_path / "p.data", "Atoms # sphere", "Atoms")
    state, _, notes = ss.io.read_packing(tmp_path / "p.data", law="linear", mu=0.5)  # radii that are no whole numbers
    assert "the section Atoms names no style: sphere is assumed" in notes
    asked, _, notes = ss.io.read_packing(tmp_path / "p.data", law="linear", mu=0.5, atom_style="sphere")
    assert not [line for line in notes if "sphere" in line]
    assert (asked.grains.radius == state.grains.radius).all()
    with pytest.raises(ss.packings.PackingError, match=r"atoms of style full with 10 columns .* diameter and density"):
        ss.io.read_packing(tmp_path / "p.data", law="linear", mu=0.5, atom_style="full")


def edited(path, old, new, count=1):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("p.data", "64 atoms", "65 atoms", "declares 65 atoms"),
        ("p.data", "Atoms # sphere", "Atoms # atomic", "atom_style sphere is supported"),
        ("p.data", "Atoms # sphere", "Bonds", "no section Atoms"),
        ("p.data", "xlo xhi", "ylo", "truncated or not a LAMMPS data file"),
        ("p.data", "64 atoms", "some atoms", "truncated or not a LAMMPS data file"),
        ("p.contacts.dump", "tx ty tz", "a b c", "i j tx ty tz are needed"),
        ("p.contacts.dump", "tx ty tz", "tx tx tz", "two columns tx with different numbers"),
        ("p.contacts.dump", "ITEM: TIMESTEP", "ITEM: TIME", "no ITEM: TIMESTEP"),
        ("p.contacts.dump", "ITEM: TIMESTEP\n0", "ITEM: TIMESTEP\n3", "no time step 0: it has 3"),
        ("p.contacts.dump", "tx ty tz\n", "tx ty tz\n999 ", "truncated|grain 999"),
    ],
)
def test_broken_files_give_a_one_sentence_error(name, old, new, message, tmp_path):
    ss.io.write_packing(tmp_path / "p.data", spheres(), SHARP)
    edited(tmp_path / name, old, new)
    with pytest.raises(ss.packings.PackingError, match=message) as problem:
        back(tmp_path / "p.data")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("name", ["p.data", "p.contacts.dump"])
def test_truncated_files_give_a_one_sentence_error(name, tmp_path):
    ss.io.write_packing(tmp_path / "p.data", spheres(), SHARP)
    whole = (tmp_path / name).read_bytes()
    for share in (0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
        (tmp_path / name).write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(ss.packings.PackingError) as problem:
            back(tmp_path / "p.data")
        assert "\n" not in str(problem.value)


def test_dashpots_need_velocities(tmp_path):
    state = spheres()
    ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    rows = np.column_stack([np.arange(1, 65), state.grains.position, state.grains.radius, state.grains.mass])
    dump(tmp_path / "p.dump", state, columns="id xu yu zu radius mass", rows=rows, step=0)
    with pytest.raises(ss.packings.PackingError, match="needs every grain's spin and velocity"):
        back(tmp_path / "p.dump")


@pytest.mark.slow
def test_a_hundred_thousand_grains_are_read_in_seconds(tmp_path):
    side = 47
    place = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * 1.0
    state = ss.packings.from_arrays(place, np.full(len(place), 0.51), SHARP, cell=[side] * 3)
    start = time.perf_counter()
    ss.io.write_packing(tmp_path / "p.data", state, SHARP)
    again, _, _ = ss.io.read_packing(tmp_path / "p.data", **GIVEN)
    assert len(again.grains.radius) == side**3
    assert time.perf_counter() - start < 30  # 6 seconds here


def test_assumptions_in_files_of_0_3_are_sentences(tmp_path):
    told = ["undecided: fix wall was not imported", "no contact law was given: the defaults are assumed", "a guess"]
    np.savez(tmp_path / "pair.npz", position=[[0, 0, 0], [0.99, 0, 0]], radius=[0.5, 0.5], kn=1.0, assumed=told)
    notes = ss.io.read_packing(tmp_path / "pair.npz").assumed
    assert [note for note in notes if isinstance(note, Obstacle)] == told[:1]
    assert notes_about(notes, "law") == told[1:2] and told[2] in notes


@pytest.mark.parametrize("to", ["x.gsd", "x.npz", "x.h5"])
def test_what_was_assumed_travels_with_the_file(tmp_path, to):
    """A law that nobody has given is still a guess in the files that are made from the packing."""
    np.savez(tmp_path / "pair.npz", position=[[0, 0, 0], [0.99, 0, 0]], radius=[0.5, 0.5])
    _, notes = convert(tmp_path / "pair.npz", tmp_path / to)
    law = "hertz_mindlin, smooth Coulomb, kn = 1, kt = 0.285714, mu = 10"
    said = f"the contact law is missing: the defaults are assumed ({law})"
    assert said in notes
    kinds = {(type(note), note.about, note) for note in ss.io.read_packing(tmp_path / "pair.npz").assumed}
    assert len({kind for kind, _, _ in kinds}) > 1
    for again in (to, f"y{to[1:]}"):
        assert {(type(note), note.about, note) for note in ss.io.read_packing(tmp_path / again).assumed} == kinds
        assert missing_parts(ss.io.read_packing(tmp_path / again).notes)
        if again == to:
            convert(tmp_path / to, tmp_path / f"y{to[1:]}")
    assert not any("assumed" in note for note in ss.io.read_packing(tmp_path / to, kn=2.0)[2])
    convert(tmp_path / to, tmp_path / f"z{to[1:]}", kn=2.0)
    assert not any("assumed" in note for note in ss.io.read_packing(tmp_path / f"z{to[1:]}")[2])
