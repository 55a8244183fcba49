"""Files that are only shown: VTK as written bytes say, extended XYZ as ASE reads it."""

import json
import re
import sys

import ase.io
import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange.table_file import read_xyz
from stickslip.data.exchange.vtk_file import vtk_paths
from stickslip.extras import MissingExtraError

from .packings import SHARP, disks, spheres, walled

KINDS = {"Float64": np.float64, "Int32": np.int32, "UInt8": np.uint8}


def vtk_arrays(path) -> dict[str, np.ndarray]:
    """All arrays of a .vtu file with appended raw data, as VTK's documentation describes it."""
    raw = path.read_bytes()
    head, _, body = raw.partition(b'<AppendedData encoding="raw">')
    body = body[body.index(b"_") + 1 :]
    values = {}
    for tag in re.findall(r"<DataArray (.*?)/>", head.decode()):
        attributes = dict(re.findall(r'(\w+)="(.*?)"', tag))
        start = int(attributes["offset"])
        size = int(np.frombuffer(body[start : start + 8], np.uint64)[0])
        array = np.frombuffer(body[start + 8 : start + 8 + size], KINDS[attributes["type"]])
        width = int(attributes["NumberOfComponents"])
        values[attributes["Name"]] = array.reshape(-1, width) if width > 1 else array
    return values


@pytest.mark.parametrize("make", [lambda: (spheres(), SHARP), lambda: (disks(), SHARP), walled])
def test_vtk_holds_grains_and_contact_lines(make, tmp_path):
    state, law = make()
    notes = ss.io.write_packing(tmp_path / "p.vtu", state, law)
    assert "VTK does not store" in notes[0]
    grains, lines = vtk_arrays(tmp_path / "p.vtu"), vtk_arrays(tmp_path / "p-contacts.vtu")
    g, rows = state.grains, ss.measure.touching(state)
    for name in ("radius", "mass", "velocity", "spin", "angle"):
        assert np.array_equal(grains[name], getattr(g, name))
    assert np.array_equal(grains["diameter"], 2 * g.radius)  # what a glyph of a sphere of diameter 1 is scaled by
    shift = grains["points"] - g.position
    if state.cell.periodic.any():
        shares = (shift @ np.linalg.inv(state.cell.vectors))[:, state.cell.periodic]
        np.testing.assert_allclose(shares, np.round(shares), atol=1e-12)
    ends = lines["points"].reshape(-1, 2, 3)
    np.testing.assert_allclose(ends[:, 0], grains["points"][state.contacts.i[rows]], atol=1e-12)
    np.testing.assert_allclose(ends[:, 0] - ends[:, 1], ss.measure.branch_vectors(state)[rows], atol=1e-12)
    force, branch = ss.measure.contact_forces(state, law)[rows], ss.measure.branch_vectors(state)[rows]
    along = np.einsum("ck,ck->c", force, branch) / np.linalg.norm(branch, axis=1)
    np.testing.assert_allclose(lines["force_n"], along, rtol=1e-12)
    assert lines["connectivity"].tolist() == list(range(2 * len(rows)))


def test_a_series_has_numbered_files(tmp_path):
    states = [spheres(k) for k in range(3)]
    ss.io.write_packing(tmp_path / "p.vtu", [ss.io.frame_of(state, SHARP) for state in states])
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == sorted(path.name for pair in vtk_paths(tmp_path / "p.vtu", 3) for path in pair)
    assert names[:2] == ["p-contacts_0000.vtu", "p-contacts_0001.vtu"]
    assert np.array_equal(vtk_arrays(tmp_path / "p_0002.vtu")["velocity"], states[2].grains.velocity)


def test_a_packing_without_contacts_is_written(tmp_path):
    apart = ss.packings.from_arrays([[0, 0, 0], [3, 0, 0]], [0.5, 0.5], SHARP)
    for name in ("p.vtu", "p.gsd", "p.xyz", "p.npz", "p.data", "p.h5"):
        ss.io.write_packing(tmp_path / name, apart, SHARP)
    assert len(ss.io.read_packing(tmp_path / "p.gsd")[0].grains.radius) == 2
    assert not (tmp_path / "p-contacts.vtu").exists()


@pytest.mark.parametrize("make", [lambda: (spheres(), SHARP), walled])
def test_ase_reads_extended_xyz_to_the_last_bit(make, tmp_path):
    state, law = make()
    ss.io.write_packing(tmp_path / "p.xyz", [ss.io.frame_of(state, law)] * 2)
    atoms = ase.io.read(tmp_path / "p.xyz", index=":", format="extxyz")
    assert len(atoms) == 2
    assert np.array_equal(atoms[1].positions, state.grains.position)
    assert atoms[1].pbc.tolist() == state.cell.periodic.tolist()
    assert np.array_equal(atoms[1].cell.array, state.cell.vectors)
    for theirs, ours in {"radius": "radius", "mass": "mass", "velo": "velocity", "spin": "spin"}.items():
        assert np.array_equal(atoms[1].arrays[theirs], getattr(state.grains, ours)), theirs
    np.testing.assert_array_equal(atoms[1].arrays["contact_force"], ss.forces(state, law)[0].force[: len(atoms[1])])
    kept = atoms[1].info["law"]
    kept = json.loads(kept) if isinstance(kept, str) else kept
    assert kept["table"] == law.table.tolist()


@pytest.mark.parametrize(("name", "library"), [("p.gsd", "gsd"), ("p.vtu", "pyevtk")])
def test_a_missing_library_gives_a_one_sentence_error(name, library, tmp_path, monkeypatch):
    for module in [m for m in sys.modules if m.partition(".")[0] == library]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=r'pip install "stickslip\[exchange\]"'):
        ss.io.write_packing(tmp_path / name, disks(), SHARP)
    assert not list(tmp_path.iterdir())


def test_sides_that_extended_xyz_calls_open_are_open(tmp_path):
    head = 'Lattice="4 0 0 0 4 0 0 0 4" pbc="T F 1" Properties=species:S:1:pos:R:3:radius:R:1'
    (tmp_path / "a.xyz").write_text(f"2\n{head}\nX 1 1 1 0.5\nX 2 1 1 0.5\n")
    assert read_xyz(tmp_path / "a.xyz")[0].arrays["periodic"] == [True, False, True]
