"""Lists of grains and contact forces in the dialects of PeGS2, RigidLibrary and plain tables, whole and damaged."""

import numpy as np
import pytest
from typer.testing import CliRunner

import stickslip as ss
from stickslip.cli.app import app
from stickslip.data.exchange.files import is_measured
from stickslip.data.exchange.force_network import measured_frames
from stickslip.examples import path as example


@pytest.fixture(scope="module")
def known():
    """Network of the example, read by NumPy."""
    files = (example(f"measured_{name}.csv") for name in ("disks", "forces"))
    grains, contacts = (np.loadtxt(file, delimiter=",", skiprows=2) for file in files)
    i, j = contacts[:, :2].astype(int).T
    return ss.io.measured_forces(
        grains[:, :2], grains[:, 2], i, j, contacts[:, 2], contacts[:, 3], held=np.flatnonzero(grains[:, 3])
    )


def rows_of(m, first=1):
    """Rows of grains, frame, id, x, y, r, edge, and of contacts, frame, i, j, ft, fn, as PeGS2 writes both."""
    n, count = len(m.radius), len(m.pair_i)
    grains = np.column_stack([np.ones(n), np.arange(n) + first, m.position, m.radius, ~m.free])
    contacts = np.column_stack([np.ones(count), m.pair_i + first, m.pair_j + first, m.force_t, m.force_n])
    return grains, contacts


def twice(contacts, noise=0.0):
    """Contacts listed from both of their grains."""
    both = np.vstack([contacts, contacts[:, [0, 2, 1, 3, 4]]])
    both[:, 3:] += noise * np.random.default_rng(0).normal(size=(len(both), 2))
    return both


def write(path, rows, head="", mark=","):
    lines = [mark.join(np.format_float_positional(v, trim="-") for v in row) for row in np.atleast_2d(rows)]
    path.write_text("\n".join([head] * bool(head) + lines) + "\n")
    return path


def written(folder, grains, contacts, heads=("", ""), mark=","):
    """Network that is read from both lists."""
    names = (
        write(folder / "grains.txt", grains, heads[0], mark),
        write(folder / "contacts.txt", contacts, heads[1], mark),
    )
    assert is_measured(*names)
    return ss.io.read_forces(*names)


def assert_same(found, m, *, rtol=1e-12):
    np.testing.assert_allclose(found.position, m.position, rtol=rtol)
    np.testing.assert_array_equal(found.free, m.free)
    place = {frozenset(e): c for c, e in enumerate(found.ends.T.tolist())}
    order = [place[frozenset(e)] for e in m.ends.T.tolist()]
    assert len(found.force_n) == len(m.force_n)
    np.testing.assert_allclose(found.force_n[order], m.force_n, rtol=rtol)
    np.testing.assert_allclose(found.force_t[order], m.force_t, rtol=rtol, atol=rtol)


def vectors(m):
    """Force on the first grain of each contact."""
    normal = m.position[m.pair_i] - m.position[m.pair_j]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return m.force_n[:, None] * normal + m.force_t[:, None] * np.column_stack([normal[:, 1], -normal[:, 0]])


@pytest.mark.parametrize(
    "dialect", ["PeGS2", "ids from 0", "spaces", "headings", "comment", "plain", "vectors", "opposite", "centers"]
)
def test_every_dialect_has_the_same_network(known, tmp_path, dialect):
    grains, contacts = rows_of(known, first=dialect not in ("ids from 0", "plain"))
    xyr = np.column_stack([known.position, known.radius])
    pairs = np.column_stack([contacts[:, 1:3], known.force_n, known.force_t])
    both = np.column_stack([contacts[:, 1:3], vectors(known) * (-1 if dialect == "opposite" else 1)])
    cases = {
        "PeGS2": (grains, twice(contacts), ("", "")), "ids from 0": (grains, contacts, ("", "")),
        "spaces": (grains, contacts, ("", "")),
        "headings": (grains, contacts, ("frame,id,x,y,r,edge", "frame,id1,id2,tangential,normal")),
        "comment": (grains, contacts[:, 1:], ("# frame id x y radius edge", "# id1 id2 ft fn")),
        "plain": (xyr, pairs, ("", "")), "centers": (np.column_stack([xyr, ~known.free]), pairs, ("", "")),
        "vectors": (grains, both, ("", "i,j,fx,fy")), "opposite": (grains, both, ("", "i,j,fx,fy")),
    }  # fmt: skip
    found = written(tmp_path, *cases[dialect], mark=" " if dialect in ("spaces", "comment") else ",")
    wanted = known._replace(free=np.ones(len(known.radius), bool)) if dialect == "plain" else known
    assert_same(found, wanted, rtol=1e-9)
    text = " ".join(found.notes)
    assert ("does not name its columns" in text) == (dialect not in ("headings", "comment"))
    assert ("listed twice" in text) == (dialect == "PeGS2")
    assert ("on the second grain" in text) == (dialect == "opposite")


@pytest.mark.parametrize(("sign", "noise", "said"), [(1, 0, ""), (-1, 0, "would balance better"), (1, 2, "not show")])
def test_the_balance_of_forces_is_compared_for_both_signs_of_ft(known, tmp_path, sign, noise, said):
    """RigidLibrary uses both signs: its sums over grains that of a torque, its walls the opposite."""
    grains, contacts = rows_of(known)
    contacts[:, 3] *= sign
    contacts[:, 4] *= 1 + noise * np.random.default_rng(1).random(len(contacts))
    notes = [note for note in written(tmp_path, grains, contacts).notes if "sign" in note]
    assert (notes == []) if not said else (len(notes) == 1 and said in notes[0])


def test_bonds_and_matrices_of_rigidlibrary_have_the_same_network(known, tmp_path):
    """Bonds i, j, slides, ft, fn count rows from 0; matrices stand beside id, x, y, r and a column without meaning."""
    free, (grains, contacts) = known._replace(free=np.ones(len(known.radius), bool)), rows_of(known)
    slides = np.arange(len(contacts)) % 2
    bonds = np.column_stack([contacts[:, 1:3] - 1, slides, contacts[:, 3:]])
    found = written(tmp_path, np.column_stack([known.position, known.radius]), bonds, mark=" ")
    assert_same(found, free, rtol=1e-9)
    assert any("i j slides ft fn is assumed, as in lists of RigidLibrary" in note for note in found.notes)
    n = len(known.radius)
    particles = np.column_stack([grains[:, 1:5], 7.5 + np.arange(n)])
    shuffled = np.random.default_rng(3).permutation(n)  # rows of matrices are those of the table
    for name, values in (("Norm", known.force_n), ("Tan", known.force_t)):
        matrix = np.zeros((n, n))
        matrix[known.pair_i, known.pair_j] = matrix[known.pair_j, known.pair_i] = values
        write(tmp_path / f"a_{name}WeightedAdjacencyMatrix.dlm", matrix[np.ix_(shuffled, shuffled)])
    files = write(tmp_path / "a_ParticleData.dlm", particles[shuffled]), tmp_path / "a_NormWeightedAdjacencyMatrix.dlm"
    assert is_measured(*files)
    found = ss.io.read_forces(*files)
    assert_same(found, free, rtol=1e-9)
    assert any("the fifth, unnamed column is ignored" in note for note in found.notes)
    edges = write(tmp_path / "edges.txt", np.column_stack([grains[:, 1:5], ~known.free]))
    assert_same(ss.io.read_forces(edges, write(tmp_path / "b.txt", contacts)), known, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("TanWeightedAdjacencyMatrix.dlm", lambda m: m, "give that of normal forces"),
        ("NormWeightedAdjacencyMatrix.dlm", lambda m: None, "TanWeightedAdjacencyMatrix.dlm is missing"),
        ("NormWeightedAdjacencyMatrix.dlm", lambda m: m[:-1], r"has shape \(8, 9\), but there are 9 grains"),
        ("NormWeightedAdjacencyMatrix.dlm", lambda m: m[:, :-1], r"has shape \(9, 8\), but there are 9 grains"),
        ("NormWeightedAdjacencyMatrix.dlm", lambda m: m * np.nan, "no contacts|without a number|missing"),
    ],
)
def test_matrices_that_do_not_belong_to_the_grains_are_refused(tmp_path, name, change, sentence):
    place = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    grains = write(tmp_path / "grains.txt", np.column_stack([1.0 + np.arange(9), place, np.full(9, 0.5), np.ones(9)]))
    matrix = np.isclose(np.linalg.norm(place[:, None] - place, axis=2), 1).astype(float)
    write(tmp_path / "NormWeightedAdjacencyMatrix.dlm", matrix)
    if (other := change(matrix)) is not None:
        write(tmp_path / "TanWeightedAdjacencyMatrix.dlm", other)
    with pytest.raises(ss.packings.PackingError, match=sentence) as caught:
        ss.io.read_forces(grains, tmp_path / name)
    assert "\n" not in str(caught.value)


def test_differences_of_both_readings_are_the_error(known, tmp_path):
    grains, contacts = rows_of(known)
    noise = 0.02 * known.force_n.mean()
    found = written(tmp_path, grains, twice(contacts, noise))
    assert found.force_n_error[0] == pytest.approx(noise / np.sqrt(2), rel=0.3)
    assert found.force_t_error[0] == pytest.approx(noise / np.sqrt(2), rel=0.3)
    alone = written(tmp_path, grains, twice(contacts, noise)[:-1])
    assert len(alone.force_n) == len(found.force_n) - 1 and any("only one" in note for note in alone.notes)
    same = written(tmp_path, grains, twice(contacts))
    assert np.isnan(same.force_n_error).all() and any(
        "both are equal, so that errors remain unknown" in note for note in same.notes
    )


def test_walls_hold_their_grains_and_weak_tension_is_left_out(known, tmp_path):
    grains, contacts = rows_of(known)
    inside = int(np.flatnonzero(known.free)[0])
    walls = [[1, inside + 1, -1, 0.1, 0.2], [1, inside + 1, -2, 0.0, 0.1]]
    found = written(tmp_path, grains, np.vstack([contacts, walls]))
    assert not found.free[inside] and len(found.force_n) == len(known.force_n)
    assert any("with walls, which have negative numbers" in note and "held: 2 of" in note for note in found.notes)
    weak = contacts.copy()
    weak[3, 4] = -1e-3 * known.force_n.mean()
    found = written(tmp_path, grains, weak)
    assert len(found.force_n) == len(known.force_n) - 1
    assert any("negative normal forces are left out: 1" in note for note in found.notes)
    apart = int(np.argmax(np.linalg.norm(known.position - known.position[inside], axis=1))) + 1
    found = written(tmp_path, grains, np.vstack([contacts, [1, inside + 1, apart, 0.0, 0.1]]))
    assert_same(found, known)
    assert any("do not touch are left out: 1 of" in note for note in found.notes)
    far = grains.copy()
    far[:, 4] *= 0.8
    assert any("gaps of up to" in note for note in written(tmp_path, far, contacts).notes)


def test_frames_are_chosen_and_rows_without_numbers_are_counted(known, tmp_path):
    grains, contacts = rows_of(known)
    several = [np.vstack([rows + np.eye(1, rows.shape[1])[0] * k for k in range(3)]) for rows in (grains, contacts)]
    several[1][:, 4] *= several[1][:, 0]
    paths = write(tmp_path / "p.txt", several[0]), write(tmp_path / "a.txt", several[1])
    last, first = ss.io.read_forces(*paths), ss.io.read_forces(*paths, frame="1")
    np.testing.assert_allclose(last.force_n, 3 * first.force_n)
    assert any("3 frames: the last, 3" in note for note in last.notes)
    with pytest.raises(ValueError, match="no frame '9': it has 1, 2, 3"):
        ss.io.read_forces(*paths, frame="9")
    assert measured_frames(*paths) == ["1", "2", "3"]
    grains[int(np.flatnonzero(~known.free)[0]), 2] = np.nan
    contacts[0, 4] = np.nan
    found = written(tmp_path, grains, contacts)
    text = " ".join(found.notes)
    assert (
        len(found.radius) == len(known.radius) - 1
        and "grains with incomplete rows in grains.txt are left out: 1" in text
    )
    assert "incomplete rows of contacts.txt are left out: 1" in text


def test_report_draws_forces_that_nothing_balances(known, tmp_path):
    grains, contacts = rows_of(known)
    contacts[::3, 4] *= 3
    paths = write(tmp_path / "grains.txt", grains), write(tmp_path / "contacts.txt", twice(contacts))
    command = ["report", str(paths[0]), "--contacts", str(paths[1]), "--out", str(tmp_path / "forces.png")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "forces.png").read_bytes().startswith(b"\x89PNG")
    assert "drawn as measured, not balanced" in " ".join(done.output.split())
    (tmp_path / "forces.png").unlink()
    done = CliRunner().invoke(app, [*command, "--settle"])
    folder = CliRunner().invoke(app, ["report", str(tmp_path), "--out", str(tmp_path / "forces.png")])
    assert "is a run folder, for which --out must end in .html" in str(folder.exception)
    assert "shows contact forces only" in str(done.exception) and not (tmp_path / "forces.png").exists()


def test_doubtful_columns_are_noted(known, tmp_path):
    """Forces are read as they are; columns that are not used, or seem to be others, are not passed over in silence."""
    grains, contacts = rows_of(known)
    both = np.column_stack([contacts[:, 1:3], vectors(known), known.force_n])
    unsigned, swapped = contacts.copy(), contacts.copy()
    unsigned[:, 3] = np.abs(contacts[:, 3])
    swapped[:, 3:] = unsigned[:, [4, 3]]
    flat = np.column_stack([both[:, :4], np.ones(len(both))])
    spheres, more = np.insert(grains, 4, 0.0, axis=1), grains + np.eye(1, 6)
    cases = [
        ("column fn of contacts.txt is not used", grains, both, ("", "i,j,fx,fy,fn")),
        ("along z in contacts.txt are left out", spheres, flat, ("frame,id,x,y,z,r,edge", "i,j,fx,fy,fz")),
        ("have the same sign", grains, unsigned, ("", "")),
        (f"normal ones at 43 of {len(swapped)} contacts", grains, swapped, ("", "")),
        ("frames in only one of grains.txt and contacts.txt are left out: 2", np.vstack([grains, more]), contacts,
         ("", "")),
    ]  # fmt: skip
    for text, left, right, head in cases:
        found = written(tmp_path, left, right, head)
        assert text in " ".join(found.notes), found.notes
        if "i,j" in head[1]:
            assert_same(found, known, rtol=1e-9)
    assert not any("same sign" in note or "exceed" in note for note in written(tmp_path, grains, contacts).notes)


def test_lists_that_do_not_belong_together_are_refused_in_one_sentence(known, tmp_path):
    grains, contacts = rows_of(known)
    flags, pulls, other, swapped = (contacts.copy() for _ in range(4))
    flags[:, 2] = np.arange(len(flags)) % 2
    pulls[5, 4] = -10 * known.force_n.max()
    other[:, 0] = 7
    swapped[:, [3, 4]] = swapped[:, [4, 3]]
    opposite, edge = twice(contacts), grains.copy()
    opposite[len(contacts) :, 3] *= -1
    edge[0, 5] = np.nan
    alike = np.vstack([np.column_stack([ends, vectors(known)]) for ends in (contacts[:, 1:3], contacts[:, [2, 1]])])
    heads = ("frame,id,x [px],y [px],r [px],edge", "frame,id1,id2,ft,fn")
    cases = [
        ("names grain 99", grains, np.vstack([contacts, [1, 99, 2, 0, 0.1]]), ("", "")),
        (
            "names grain 30, .* seem to start at 1", grains[:30, 2:5],
            np.array([[1, 30, 0.1, 0], [2, 3, 0.1, 0]]), ("x,y,r", "i,j,fn,ft"),
        ),
        ("third contains flags", grains, flags, ("", "")),
        ("contacts of .* pull by more than errors explain, the contact of grains", grains, pulls, ("", "")),
        ("check the order of the columns", grains, swapped, ("", "")),
        ("frames 1 and contacts.txt has 7", grains, other, ("", "")),
        ("7 columns without names: 3", grains[:, [0, *range(6)]], contacts, ("", "")),
        ("no column ft", grains, contacts[:, [1, 2, 4]], ("", "i,j,fn")),
        ("more than once", np.vstack([grains, grains[:1]]), contacts, ("", "")),
        ("3 times", grains, np.vstack([contacts[:1], twice(contacts)]), ("", "")),
        ("must be whole numbers", grains, contacts + np.array([0, 0.5, 0, 0, 0]), ("", "")),
        ("in pixels", grains, contacts, heads),
        ("with opposite tangential forces", grains, opposite, ("", "")),
        ("with opposite normal forces", grains, alike, ("", "i,j,fx,fy")),
        ("no force directions: give the force on grain i, fx fy", grains, alike, ("", "i,j,tx,ty")),
        ("column edge must be 1", edge, contacts, ("", "")),
        ("itself", grains, np.vstack([contacts, [1, 2, 2, 0, 0.1]]), ("", "")),
        ("the other table has 3 frames", grains[:, 1:5], np.vstack([contacts, contacts + np.eye(1, 5), other]),
         ("id,x,y,r", "")),
    ]  # fmt: skip
    for text, left, right, head in cases:
        paths = write(tmp_path / "grains.txt", left, head[0]), write(tmp_path / "contacts.txt", right, head[1])
        with pytest.raises(ValueError, match=text) as refused:
            ss.io.read_forces(*paths)
        assert "\n" not in str(refused.value), text
    for text, match in (
        ("# nothing\n", "has no rows"),
        ("i,j,fn,ft\n", "contacts.txt: measured contact forces are missing"),
    ):
        paths[1].write_text(text)
        with pytest.raises(ValueError, match=match):
            ss.io.read_forces(*paths)
