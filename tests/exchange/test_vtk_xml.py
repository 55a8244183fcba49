"""Reading .vtu and .vtp: files that VTK wrote (`vtk_xml/make.py`), our own, and damaged ones."""

import base64
import tarfile
import tracemalloc
import zlib
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


def test_other_compression_is_reported(cases):
    with pytest.raises(ss.packings.PackingError, match="compressed by vtkLZ4DataCompressor: only vtkZLib"):
        ss.io.read_packing(cases / "binary-lz4.vtu")


def test_what_stickslip_writes_is_read(tmp_path):
    pytest.importorskip("pyevtk")
    state, _ = ss.packings.jammed(30, packing_fraction=0.68, seed=1)
    ss.io.write_packing(tmp_path / "p.vtu", state, ss.laws.linear())
    grains = ss.io.read_packing(tmp_path / "p.vtu").state.grains
    assert (grains.radius == state.grains.radius).all() and (grains.mass == state.grains.mass).all()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            b'type="UnstructuredGrid"',
            b'type="ImageData"',
            "unsupported VTK type ImageData: UnstructuredGrid and PolyData are",
        ),
        (b"radii", b"size", "no radii among them"),
        (b"</Piece>", b"", "incomplete XML"),
        (b"AAAA", b"A!AA", "truncated, or not VTK of points"),
    ],
)
def test_damaged_files_are_reported(old, new, message, cases, tmp_path):
    content = (cases / "binary-plain.vtu").read_bytes()
    assert old in content
    (tmp_path / "p.vtu").write_bytes(content.replace(old, new))
    with pytest.raises(ss.packings.PackingError, match=message) as problem:
        ss.io.read_packing(tmp_path / "p.vtu")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("name", ["appended-zlib-raw.vtu", "appended-plain-base64.vtp", "binary-zlib.vtu"])
def test_truncated_files_are_reported(name, cases, tmp_path):
    content = (cases / name).read_bytes()
    for share in np.linspace(0.05, 0.97, 40):
        (tmp_path / "p.vtu").write_bytes(content[: int(share * len(content))])
        with pytest.raises(ss.packings.PackingError):
            ss.io.read_packing(tmp_path / "p.vtu")


POINTS = '<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0</DataArray>'
RADII = '<DataArray type="Float64" Name="radius" format="ascii">0.5 0.6</DataArray>'


def piece(points=POINTS, data=RADII, count=2):
    return f'<Piece NumberOfPoints="{count}"><Points>{points}</Points><PointData>{data}</PointData></Piece>'


def read_grid(folder, *pieces, root='<VTKFile type="PolyData">', end="</VTKFile>"):
    (folder / "p.vtp").write_text(f"{root}<PolyData>{''.join(pieces)}</PolyData>{end}")
    return ss.io.read_packing(folder / "p.vtp").state.grains


def test_pieces_are_put_together_and_empty_ones_left_out(tmp_path):
    far = piece(POINTS.replace("0 0 0 1 0 0", "5 5 5 6 5 5"))
    grains = read_grid(tmp_path, piece(), '<Piece NumberOfPoints="0"><Points/><PointData/></Piece>', far)
    np.testing.assert_array_equal(grains.position[:, 0], [0, 1, 5, 6])


def test_what_vtk_reads_is_read(tmp_path):
    """A long comment before the root, a namespace, ASCII in capitals, a comment after the end, a length by itself."""
    root = f'<!--{"c" * 300}--><VTKFile xmlns="http://vtk.org" type="PolyData">'
    radii = base64.b64encode(np.array([16], "<u4").tobytes()) + base64.b64encode(np.array([0.5, 0.6]).tobytes())
    data = f'<DataArray type="Float64" Name="radius" format="binary">{radii.decode()}</DataArray>'
    grains = read_grid(tmp_path, piece(POINTS.replace("ascii", "ASCII"), data), root=root, end="</VTKFile><!-- end -->")
    np.testing.assert_array_equal(grains.radius, [0.5, 0.6])


def test_points_that_are_missing_are_reported(tmp_path):
    with pytest.raises(ss.packings.PackingError, match="5 points are declared, but there are 2"):
        read_grid(tmp_path, piece(count=5))


@pytest.mark.parametrize("packed", [False, True])
def test_memory_is_bounded_by_the_size_of_the_file(packed, tmp_path):
    """Many arrays at one place, and a block that expands a thousand times."""
    block = zlib.compress(bytes(10**8)) if packed else bytes(10**5)
    sizes = [1, len(block), 0, len(block)] if packed else [len(block)]
    array = '<DataArray type="Int8" Name="a{}" format="appended" offset="0"/>'
    arrays = "".join(array.format(k) for k in range(1 if packed else 300))
    compressor = ' compressor="vtkZLibDataCompressor"' if packed else ""
    head = (
        f'<VTKFile type="PolyData"{compressor}><PolyData>{piece(data=arrays)}</PolyData><AppendedData encoding="raw">_'
    )
    (tmp_path / "p.vtp").write_bytes(
        head.encode() + np.array(sizes, "<u4").tobytes() + block + b"</AppendedData></VTKFile>"
    )
    tracemalloc.start()
    with pytest.raises(ss.packings.PackingError, match="100 times the file size"):
        ss.io.read_packing(tmp_path / "p.vtp")
    assert tracemalloc.get_traced_memory()[1] < 3 * 2**26  # 64 MiB are always allowed
    tracemalloc.stop()
