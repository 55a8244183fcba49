"""Reading .vtu and .vtp: files that VTK wrote (`vtk_xml/make.py`), our own, and damaged ones."""

import tarfile
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss

CASES = Path(__file__).parent / "vtk_xml/cases.tar.xz"


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vtk")
    with tarfile.open(CASES) as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize("kind", ["vtu", "vtp"])
def test_every_encoding_of_vtk_is_read(kind, cases):
    k, readable = np.arange(7.0), [path for path in cases.glob(f"*.{kind}") if "lz4" not in path.name]
    place = np.stack([k / 3, np.sin(k), k * k / 7], axis=1)
    assert len(readable) == 8
    for path in readable:
        grains = ss.io.read_packing(path).state.grains
        np.testing.assert_allclose(grains.position, place, atol=1e-6, err_msg=path.name)
        np.testing.assert_allclose(grains.radius, 0.3 + 0.01 * k, rtol=1e-12, err_msg=path.name)
        np.testing.assert_allclose(grains.velocity, place[:, ::-1] / 10, atol=1e-12, err_msg=path.name)


def test_other_compression_is_told(cases):
    with pytest.raises(ss.packings.PackingError, match="compressed by vtkLZ4DataCompressor: only vtkZLib"):
        ss.io.read_packing(cases / "binary-lz4.vtu")


def test_what_stickslip_writes_is_read(tmp_path):
    pytest.importorskip("pyevtk")
    state, _ = ss.packings.jammed(30, packing_fraction=0.68, seed=1)
    ss.io.write_packing(tmp_path / "p.vtu", state, ss.laws.linear())
    grains = ss.io.read_packing(tmp_path / "p.vtu").state.grains
    assert (grains.radius == state.grains.radius).all() and (grains.mass == state.grains.mass).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b'type="UnstructuredGrid"', b'type="ImageData"', "VTK of type ImageData: UnstructuredGrid and PolyData are"),
        (b"radii", b"size", "no radii among them"),
        (b"</Piece>", b"", "no complete XML"),
        (b"AAAA", b"A!AA", "truncated, or not VTK of points"),
    ],
)
def test_damaged_files_are_told(old, new, words, cases, tmp_path):
    content = (cases / "binary-plain.vtu").read_bytes()
    assert old in content
    (tmp_path / "p.vtu").write_bytes(content.replace(old, new))
    with pytest.raises(ss.packings.PackingError, match=words) as problem:
        ss.io.read_packing(tmp_path / "p.vtu")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("name", ["appended-zlib-raw.vtu", "appended-plain-base64.vtp", "binary-zlib.vtu"])
def test_truncated_files_are_told(name, cases, tmp_path):
    content = (cases / name).read_bytes()
    for share in np.linspace(0.05, 0.97, 40):
        (tmp_path / "p.vtu").write_bytes(content[: int(share * len(content))])
        with pytest.raises(ss.packings.PackingError):
            ss.io.read_packing(tmp_path / "p.vtu")
