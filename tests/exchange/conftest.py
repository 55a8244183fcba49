"""Folders of runs of LAMMPS, which `lammps_runs/make.py` makes."""

import tarfile
from pathlib import Path

import pytest

CASES = Path(__file__).parent / "lammps_runs" / "cases.tar.xz"


@pytest.fixture(scope="session")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases")
    with tarfile.open(CASES) as packed:
        packed.extractall(folder, filter="data")
    return folder
