"""Files that a command is told to write replace nothing unasked: conversions, pages, movies, modes."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from stickslip.data.exchange import files
from tests.conftest import stickslip_here

PACKING = Path(__file__).parents[2] / "examples" / "sheared_spheres.npz"
SHARP = ("--coulomb", "sharp")
LAW = ["--law", "hertz_mindlin", "--kn", "1", "--kt", "0.28", "--mu", "10", "--damping-n", "0", "--damping-t", "0"]


@pytest.fixture
def here(tmp_path):
    shutil.copy(PACKING, tmp_path / "a.npz")
    return tmp_path


def contents(folder):
    return {path.name: os.readlink(path) if path.is_symlink() else path.read_bytes() for path in folder.iterdir()}


def refused(words, *call, cwd):
    before = contents(cwd)
    run = stickslip_here(*call, cwd=cwd)
    assert run.returncode == 2, run.stdout
    assert run.stderr.count("\n") == 1
    assert words in run.stderr
    assert contents(cwd) == before


@pytest.mark.parametrize("name", ["b.npz", "b.h5", "b.gsd", "b.vtu", "b.xyz", "b.data"])
@pytest.mark.parametrize("kind", ["file", "link", "loose link"])
def test_a_conversion_replaces_a_file_only_if_asked(here, name, kind):
    if name in ("b.gsd", "b.vtu"):
        pytest.importorskip({"b.gsd": "gsd", "b.vtu": "pyevtk"}[name])
    if kind == "file":
        (here / name).write_bytes(b"mine")
    else:
        (here / name).symlink_to("a.npz" if kind == "link" else "absent")
    words = "would replace the file that it is made from" if kind == "link" else f"{name} exists: give another name, or"
    refused(words, "convert", "a.npz", "--to", name, cwd=here)
    if kind != "link":
        assert stickslip_here("convert", "a.npz", "--to", name, "--overwrite", cwd=here).returncode == 0
        assert not (here / name).is_symlink()
        assert (here / name).stat().st_size > 1000
    assert (here / "a.npz").read_bytes() == PACKING.read_bytes()


def test_what_is_written_beside_replaces_nothing_either(here):
    (here / "b.contacts.dump").write_bytes(b"mine")
    words = "b.contacts.dump exists: give another name, or add --overwrite"
    refused(words, "convert", "a.npz", "--to", "b.data", *SHARP, cwd=here)
    run = stickslip_here("convert", "a.npz", "--to", "b.data", "--coulomb", "smooth", "-q", cwd=here)
    assert run.stdout.split() == ["b.data"]  # friction of LAMMPS is sharp: no contacts are written
    assert (here / "b.contacts.dump").read_bytes() == b"mine"
    run = stickslip_here("convert", "a.npz", "--to", "b.data", *SHARP, "--overwrite", "-q", cwd=here)
    assert run.stdout.split() == ["b.data", "b.contacts.dump"]
    words = "b.contacts.dump would replace the file that it is made from: give another name"
    call = ("convert", "b.data", "--contacts", "b.contacts.dump", *LAW, "--to", "b.lammps", "--overwrite")
    refused(words, *call, cwd=here)


def test_modes_and_laws_that_a_conversion_reads_stay(here):
    modes = np.ones((1, 50, 3)) * 1j
    np.savez(here / "m.npz", eigenvalue=[1j], exponent=[1j], translation=modes, rotation=modes, rattlers=[])
    (here / "m.xyz").hardlink_to(here / "m.npz")
    words = "m.xyz would replace the file that it is made from: give another name"
    refused(words, "convert", "a.npz", "--modes", "m.npz", "--to", "m.xyz", "--overwrite", cwd=here)


def test_a_folder_by_the_name_of_a_conversion_is_told(here):
    (here / "b.xyz").mkdir()
    run = stickslip_here("convert", "a.npz", "--to", "b.xyz", "--overwrite", cwd=here)
    assert (run.returncode, run.stderr) == (2, "stickslip: b.xyz is a folder: give the name of a file\n")


def test_frames_for_paraview_replace_nothing(here):
    pytest.importorskip("pyevtk")
    files.convert(here / "a.npz", here / "a.h5")
    state, law, _ = files.read_sample(here / "a.npz")
    files.write_sample(here / "t.h5", [files.frame_of(state, law)] * 2)
    (here / "b_0001.vtu").write_bytes(b"mine")
    refused("b_0001.vtu exists: give another name, or add --overwrite", "convert", "t.h5", "--to", "b.vtu", cwd=here)
    assert stickslip_here("convert", "t.h5", "--to", "b.vtu", "--overwrite", cwd=here).returncode == 0
    assert (here / "b_0001.vtu").stat().st_size > 1000
