"""Text of other programs with a layout of its own: the same grains in each."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange import table_file
from stickslip.data.exchange.columns import packing_of_columns
from stickslip.data.sample import Obstacle

PLACE, DIAMETER = np.array([[0.25, 0.5, 1], [1.2, 0.5, 1], [0.5, 1.25, 1.5]]), np.array([1.0, 1.0, 1.2])
QUERIES = {f"Position {axis}": PLACE[:, k] for k, axis in enumerate("XYZ")} | {"Velocity Z": [0, 0, 2.5]}
QUERIES |= {"ID": [7, 3, 5], "Velocity X": [0, 0, 0], "Velocity Y": [0, 0, 0], "Diameter": DIAMETER, "Mass": [1, 2, 3]}
LATTICE = "4 0 0  0.5 4 0  0 0 4"
ROWS = "\n".join(f"{x} {y} {z}" for x, y, z in PLACE)
SIZED = "\n".join(f"{x} {y} {z} {d}" for (x, y, z), d in zip(PLACE, DIAMETER, strict=True))


def edem(*, below: bool, times=(0.1, 0.4), **other) -> str:
    """Export of EDEM with values below each query, or after it; only those of the last time are the grains'."""
    text = "EDEM\nEXTRACTED DATA\n"
    for time in times:
        text += f"\nTIME:,{time}\nQ01 : Total Number of Particles:,3\n"
        for k, (name, values) in enumerate((QUERIES | other).items(), 2):
            words = [f"{value + (time != times[-1] and name[:3] == 'Pos'):.17g}" for value in values]
            text += (
                f"Q{k:02} : Particle {name}:" + ("\n,".join(["", *words]) if below else " " + " ".join(words)) + "\n"
            )
    return text


def read(tmp_path, text, **options):
    """The packing of a text; grains in the order of the text."""
    (tmp_path / "t").write_text(text)
    return ss.io.read_packing(tmp_path / "t", **options)


@pytest.mark.parametrize("below", [True, False])
def test_queries_of_edem_are_columns(below, tmp_path):
    state, _, notes = read(tmp_path, edem(below=below))
    order = np.argsort(QUERIES["ID"])
    np.testing.assert_array_equal(state.grains.position, PLACE[order])
    np.testing.assert_array_equal(state.grains.radius, DIAMETER[order] / 2)
    assert state.grains.mass.tolist() == [2, 3, 1] and state.grains.velocity[1].tolist() == [0, 0, 2.5]
    assert any("t has 2 states: the last, 0.4, is used" in note for note in notes)
    earlier = read(tmp_path, edem(below=below), frame="0.1").state
    np.testing.assert_array_equal(earlier.grains.position, PLACE[order] + 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (edem(below=True).replace("TIME", "T"), "no line `TIME:` above them"),
        (edem(below=True).replace("Mass", "Diameter"), "has the query 'Diameter' twice at time 0.4"),
        (edem(below=True, Charge=[1, 2]), "has 2 values of 'Charge' at time 0.4, but 3 values of others"),
        (f"3\n3 1\n3\n1.0\n{LATTICE}\nT T T\n1 2 3\n", "has 3 numbers for 3 positions in 3 dimensions"),
        (f"3\n3 2\n1 1\n1 2\n{LATTICE}\nT T T\n{ROWS}\n", "declares 3 spheres, but its kinds have 2 in total"),
        ("N = 3 ,L = 4 ,L1= { 4 , 0 } ,L2= { 1 , 4 } ,P = 1 ,\n{\n0 , 0 , 1 ,\n}\n", "has 3 numbers for 3 disks"),
        ("N = 3 ,L = 4 ,L1= { 4 , 0 } ,L2= { 1 , 4 } ,P = 1 ,\n{\n0 , 0 , 1 ,\n", "is truncated: N, L1, L2"),
        (f"Version 2.0\nDimension: 3\nParticles: 4\nCoordinates: T\nDiameter: F 1\n{ROWS}\n", "has 3 rows for 4"),
        (f"Version 2.0\nDimension: 3\nParticles: 3\nCoordinates: T\nDiameter: T\n{ROWS}\n", "fewer numbers than its 4"),
        (f"Version 4.0\nCoordinates: T\n{ROWS}\n", "has version 4.0 of MFIX"),
    ],
)
def test_damaged_text_of_other_programs(text, message, tmp_path):
    with pytest.raises(ss.packings.PackingError, match=message):
        read(tmp_path, text)


def test_an_unknown_query_of_edem_makes_the_verdict_undecided(tmp_path):
    notes = read(tmp_path, edem(below=True, Charge=[1, 2, 3])).notes
    assert any("Charge" in note for note in notes if isinstance(note, Obstacle))


@pytest.mark.parametrize("word", [" ! dimension", " HS poly", " HS mono 1"])
@pytest.mark.parametrize("sizes", ["2 1\n1.0 1.2", "2 1", "3"])
def test_packings_of_packlsd(sizes, word, tmp_path):
    """Diameters of kinds, or of each sphere; hard walls are named."""
    kinds = len(sizes.split("\n")[0].split())
    rows = ROWS if "\n" in sizes else SIZED
    text = f"3{word}\n3 {kinds}\n{sizes} ! sizes\n{LATTICE}\nT T F\n{rows}\n"
    state, _, notes = read(tmp_path, text)
    np.testing.assert_array_equal(state.grains.position, PLACE)
    np.testing.assert_allclose(state.grains.radius, DIAMETER / 2, rtol=1e-15)
    np.testing.assert_array_equal(state.cell.vectors, np.array(LATTICE.split(), float).reshape(3, 3))
    assert state.cell.periodic.tolist() == [True, True, False]
    assert any("hard walls of t (F)" in note for note in notes if isinstance(note, Obstacle))


def test_packings_of_jambashbulk(tmp_path):
    """Two of a series, in the plane and in a tilted cell."""
    text = "# a comment\n"
    for shift in (0.0, 0.5):
        text += "N = 3 ,L = 4.0 ,L1= { 4.0 , 0.0 }  ,L2= { 0.5 , 4.0 }  ,P = 0.001 ,P0= 0.001 ,\n{\n"
        rows = zip(PLACE[:, 0] + shift, PLACE[:, 1], DIAMETER / 2, strict=True)
        text += "".join(f"{x} ,\t{y} ,\t{r} ,\t\n" for x, y, r in rows) + "}\n\n\n"
    for frame, shift in ((None, 0.5), ("0", 0.0)):
        state = read(tmp_path, text, frame=frame).state
        np.testing.assert_array_equal(state.grains.position[:, :2], PLACE[:, :2] + [shift, 0])
        np.testing.assert_array_equal(state.grains.radius, DIAMETER / 2)
        np.testing.assert_array_equal(state.cell.vectors[:2, :2], [[4, 0], [0.5, 4]])
        assert state.cell.dim == 2 and state.cell.periodic[:2].all()


MFIX = "Version 2.0\n# Dimension: 2D or 3D\n# Particles: how many\nDimension: 3\nParticles: 3\n" + (
    "Coordinates: T\nPhase_ID: F 1\nDiameter: T\nDensity: F 2500.0\nVelocity: F 0.0 0.0 2.5\nTemperature: F 300\n"
    "# x y z d\n"
)


def test_packings_of_mfix(tmp_path):
    """With a header, properties are columns or one value for all; without, as a table of x y z r rho vx vy vz."""
    bare = "\n".join(f"{x} {y} {z} {d / 2} 2500 0 0 2.5" for (x, y, z), d in zip(PLACE, DIAMETER, strict=True))
    for text in (MFIX + SIZED.replace("1.25", "1.25D0") + "\n", bare + "\n"):
        state = read(tmp_path, text).state
        np.testing.assert_array_equal(state.grains.position, PLACE)
        np.testing.assert_array_equal(state.grains.radius, DIAMETER / 2)
        np.testing.assert_allclose(state.grains.mass, 2500 * np.pi / 6 * DIAMETER**3)
        assert (state.grains.velocity == [0, 0, 2.5]).all()
    told = MFIX.replace("Particles: 3", "Particles to read:    3").replace("Temperature: F", "Temperature: T")
    rows = "\n".join(f"{row} 293" for row in SIZED.split("\n"))
    found = read(tmp_path, told.replace("# Dim", 'Dimension: Enter "2" for 2D\n# Dim') + rows + "\n")
    np.testing.assert_array_equal(found.state.grains.position, PLACE)
    assert any("columns after x y z diameter are not used: 1" in note for note in found.notes)
    plane = "0 0 .5 2 1 0\n.9 0 .5 2 1 0\n"
    assert read(tmp_path, plane).state.grains.mass == pytest.approx([np.pi / 2] * 2)


@pytest.mark.parametrize(
    ("text", "said", "place"),
    [
        ("1 0 0 .5\n2 1 0.1 .5\n", "id x y radius is assumed", [1, 0.1, 0]),
        ("0 0 0 .5\n1 0 0 .5\n", "x y z radius is assumed", [1, 0, 0]),  # grains in a line
        ("0 0 0 .5\n1 0 0.1 .5\n", "x y z radius is assumed", [1, 0, 0.1]),
        ("1 1 0 0 .5 0\n1 2 1 0.1 .5 1\n", "frame id x y radius edge is assumed", [1, 0.1, 0]),
        ("id,x,y,z,r\n4,0,0,0,.5\n4,1,0,0,.5\n", "has grain 4 2 times: ids are ignored", [1, 0, 0]),
        ("id,x,y,z,r\n1,0,0,0,.5\n.5,1,0,0,.5\n", "has ids that are not whole numbers", [1, 0, 0]),
        ("x [mm],y [mm],r [m]\n0,0,.5e-3\n1,0,.5e-3\n", "in several units: r [m] converted to mm", [1, 0, 0]),
        ("x,y,r\n0,0,.5\n1,0,.5\nSum,,1\n", "the last row, 'Sum,,1', is treated as a total", [1, 0, 0]),
        ("x,y,r\n0,0,.5\n1,0,.5\n,,nan\n", "has 1 of 3 rows without a number", [1, 0, 0]),
        ("2\n\nA 0 0 0 .5\nA 1 0 0 .5\n", "species x y z radius is assumed", [1, 0, 0]),
    ],
)
def test_what_is_assumed_of_tables_is_said(text, said, place, tmp_path):
    found = read(tmp_path, text)
    assert any(said in note for note in found.assumed) and len(found.state.grains.radius) == 2
    assert found.state.grains.position[1].tolist() == place and found.state.grains.radius == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize("head", ["frame,particle", "frame,track_id", "t,id"])
def test_frames_may_be_in_the_order_of_grains(head, tmp_path):
    """As in tables of tracked grains: all frames of a grain, then those of the next; one enters late."""
    text = f"{head},x,y,r\n0,4,0,0,.5\n1,4,0,1,.5\n2,4,0,2,.5\n0,3,1,0,.5\n1,3,1,1,.5\n2,3,1,2,.5\n2,9,2,2,.5\n"
    found = read(tmp_path, text)
    assert found.state.grains.position[:, :2].tolist() == [[1, 2], [0, 2], [2, 2]]
    assert any("t has 3 time steps: the last, 2, is used" in note for note in found.notes)
    assert read(tmp_path, text, frame="1").state.grains.position[:, :2].tolist() == [[1, 1], [0, 1]]


def test_steps_without_a_time_are_named(tmp_path):
    """Grains that are listed once more lie on themselves."""
    with pytest.raises(ss.packings.PackingError, match="has grain 1 2 times"):
        read(tmp_path, "id,x,y,z,r\n" + "1,0,0,0,.5\n2,1,0,0,.5\n" * 2)


def test_damaged_numbers_and_columns_of_other_lengths_are_reported():
    assert not table_file.recognize(b"1 2 3 4 5\n1 2.9876031640.5 3 4 5\n")
    columns = {"position": PLACE, "radius": np.ones(len(PLACE)), "id": np.zeros(0)}
    with pytest.raises(ss.packings.PackingError, match="has 0 values of id for 3 grains"):
        packing_of_columns(columns, "a.vtu")
