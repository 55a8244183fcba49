"""Files of VTK itself in all its encodings, in one archive for the tests.

pip install vtk && python tests/exchange/vtk_xml/make.py
"""

import io
import tarfile
import tempfile
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk

HERE = Path(__file__).parent
SPHERES = 7
MODES = {"ascii": "SetDataModeToAscii", "binary": "SetDataModeToBinary", "appended": "SetDataModeToAppended"}


def columns() -> dict[str, np.ndarray]:
    """Columns of grains that every file has."""
    k = np.arange(SPHERES, dtype=float)
    place = np.stack([k / 3, np.sin(k), k * k / 7], axis=1)
    return {"points": place, "radii": 0.3 + 0.01 * k, "linVelVec": place[:, ::-1] / 10, "id": np.arange(SPHERES)}


def data(kind):
    """The grains as a data set of VTK."""
    points, known = vtk.vtkPoints(), columns()
    points.SetData(numpy_to_vtk(known.pop("points"), deep=True))
    grid = vtk.vtkPolyData() if kind == "vtp" else vtk.vtkUnstructuredGrid()
    grid.SetPoints(points)
    for name, column in known.items():
        array = numpy_to_vtk(np.ascontiguousarray(column), deep=True)
        array.SetName(name)
        grid.GetPointData().AddArray(array)
    return grid


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, tarfile.open(HERE / "cases.tar.xz", "w:xz") as archive:
        for kind, writer_class in (("vtu", vtk.vtkXMLUnstructuredGridWriter), ("vtp", vtk.vtkXMLPolyDataWriter)):
            for mode, choose in MODES.items():
                for packed in ("plain", "zlib", "lz4"):
                    for encoding in ("raw", "base64") if mode == "appended" else ("",):
                        name = "-".join(filter(None, (mode, packed, encoding))) + f".{kind}"
                        writer = writer_class()
                        writer.SetFileName(str(Path(folder) / name))
                        writer.SetInputData(data(kind))
                        getattr(writer, choose)()
                        compressors = {"plain": "None", "zlib": "ZLib", "lz4": "LZ4"}
                        getattr(writer, f"SetCompressorTypeTo{compressors[packed]}")()
                        writer.SetBlockSize(64)  # several blocks
                        writer.SetHeaderTypeToUInt64() if kind == "vtp" else writer.SetHeaderTypeToUInt32()
                        writer.SetByteOrder(0 if packed == "plain" else 1)  # big, little
                        writer.SetEncodeAppendedData(encoding == "base64")
                        writer.Write()
                        content = (Path(folder) / name).read_bytes()
                        info = tarfile.TarInfo(name)
                        info.size = len(content)
                        archive.addfile(info, io.BytesIO(content))


if __name__ == "__main__":
    main()
