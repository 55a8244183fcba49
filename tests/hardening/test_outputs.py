"""Files that a command is told to write replace nothing unasked: conversions, pages, movies, modes."""

import os
import shutil

import numpy as np
import pytest

from stickslip.data.exchange import files
from stickslip.loading import reading
from tests.conftest import stickslip_here

SHARP = ("--coulomb", "sharp")
LAW = ["--law", "hertz_mindlin", "--kn", "1", "--kt", "0.28", "--mu", "10", "--damping-n", "0", "--damping-t", "0"]


@pytest.fixture
def here(few_spheres, tmp_path):
    shutil.copy(few_spheres, tmp_path / "a.npz")
    return tmp_path


def contents(folder):
    return {path.name: os.readlink(path) if path.is_symlink() else path.read_bytes() for path in folder.iterdir()}


def refused(message, *call, cwd):
    before = contents(cwd)
    run = stickslip_here(*call, cwd=cwd)
    assert run.returncode == 2, run.stdout
    assert run.stderr.count("\n") == 1
    assert message in run.stderr
    assert contents(cwd) == before


@pytest.mark.parametrize("name", ["b.npz", "b.h5", "b.gsd", "b.vtu", "b.xyz", "b.data"])
@pytest.mark.parametrize("kind", ["file", "link", "loose link"])
def test_a_conversion_replaces_a_file_only_if_asked(here, few_spheres, name, kind):
    if name in ("b.gsd", "b.vtu"):
        pytest.importorskip({"b.gsd": "gsd", "b.vtu": "pyevtk"}[name])
    if kind == "file":
        (here / name).write_bytes(b"mine")
    else:
        (here / name).symlink_to("a.npz" if kind == "link" else "absent")
    text = "would replace its own input file" if kind == "link" else f"{name} exists: give another name, or"
    refused(text, "convert", "a.npz", "--to", name, cwd=here)
    if kind != "link":
        assert stickslip_here("convert", "a.npz", "--to", name, "--overwrite", cwd=here).returncode == 0
        assert not (here / name).is_symlink()
        assert (here / name).stat().st_size > 1000
    assert (here / "a.npz").read_bytes() == few_spheres.read_bytes()


def test_what_is_written_beside_replaces_nothing_either(here):
    (here / "b.contacts.dump").write_bytes(b"mine")
    text = "b.contacts.dump exists: give another name, or add --overwrite"
    refused(text, "convert", "a.npz", "--to", "b.data", *SHARP, cwd=here)
    run = stickslip_here("convert", "a.npz", "--to", "b.data", "--coulomb", "smooth", "-q", cwd=here)
    assert run.stdout.split() == ["b.data"]  # friction of LAMMPS is sharp: no contacts are written
    assert (here / "b.contacts.dump").read_bytes() == b"mine"
    run = stickslip_here("convert", "a.npz", "--to", "b.data", *SHARP, "--overwrite", "-q", cwd=here)
    assert run.stdout.split() == ["b.data", "b.contacts.dump"]
    text = "b.contacts.dump would replace its own input file: give another name"
    call = ("convert", "b.data", "--contacts", "b.contacts.dump", *LAW, "--to", "b.lammps", "--overwrite")
    refused(text, *call, cwd=here)


def test_modes_and_laws_that_a_conversion_reads_stay(here):
    modes = np.ones((1, 18, 3)) * 1j
    np.savez(here / "m.npz", eigenvalue=[1j], exponent=[1j], translation=modes, rotation=modes, rattlers=[])
    (here / "m.xyz").hardlink_to(here / "m.npz")
    text = "m.xyz would replace its own input file: give another name"
    refused(text, "convert", "a.npz", "--modes", "m.npz", "--to", "m.xyz", "--overwrite", cwd=here)


def test_a_folder_by_the_name_of_a_conversion_is_reported(here):
    (here / "b.xyz").mkdir()
    run = stickslip_here("convert", "a.npz", "--to", "b.xyz", "--overwrite", cwd=here)
    assert (run.returncode, run.stderr) == (2, "stickslip: b.xyz is a folder: give the name of a file\n")


def test_frames_for_paraview_replace_nothing(here):
    pytest.importorskip("pyevtk")
    reading.convert(here / "a.npz", here / "a.h5")
    state, law, _ = reading.read_packing(here / "a.npz")
    files.write_packing(here / "t.h5", [files.frame_of(state, law)] * 2)
    (here / "b_0001.vtu").write_bytes(b"mine")
    refused("b_0001.vtu exists: give another name, or add --overwrite", "convert", "t.h5", "--to", "b.vtu", cwd=here)
    assert stickslip_here("convert", "t.h5", "--to", "b.vtu", "--overwrite", cwd=here).returncode == 0
    assert (here / "b_0001.vtu").stat().st_size > 1000


def modes_of(folder):
    modes = np.ones((1, 18, 3)) * 1j
    np.savez(folder / "m.npz", eigenvalue=[1j], exponent=[1j], translation=modes, rotation=modes, rattlers=[])


@pytest.mark.parametrize(("command", "name"), [("report", "b.html"), ("movie", "b.gif")])
@pytest.mark.parametrize("kind", ["file", "link", "loose link", "device", "folder", "default"])
def test_pages_and_movies_replace_a_file_only_if_asked(here, command, name, kind):
    modes_of(here)
    call = (command, "a.npz", "--modes", "m.npz", "--out", name)
    text = f"{name} exists: give another name, or add --overwrite"
    if kind == "default":
        name, call = f"a-{'report.html' if command == 'report' else 'movie.gif'}", call[:-2]
        text = f"{name} exists: give another name, or add --overwrite"
    if kind in ("file", "default"):
        (here / name).write_bytes(b"mine")
    elif kind == "folder":
        (here / name).mkdir()
        run = stickslip_here(*call, "--overwrite", cwd=here)
        assert (run.returncode, run.stderr) == (2, f"stickslip: {name} is a folder: give the name of a file\n")
        return
    else:
        (here / name).symlink_to({"link": "a.npz", "loose link": "absent", "device": "/dev/full"}[kind])
    if kind == "link":
        refused("would replace its own input file", *call, "--overwrite", cwd=here)
        return
    refused(text, *call, cwd=here)
    if kind in ("file", "default"):
        few = ("--frames", "2") if command == "movie" else ()
        assert stickslip_here(*call, *few, "--overwrite", cwd=here).returncode == 0
        if kind == "file":
            assert stickslip_here(*call, *few, cwd=here).returncode == 0  # its own earlier one
        assert (here / name).stat().st_size > 1000


def test_in_the_folder_of_a_run_its_own_page_is_replaced_and_no_other(here):
    (here / "s.toml").write_text('experiment = "rate-state"\nsamples.number = 10\n')
    assert stickslip_here("run", "s.toml", "--out", "out", cwd=here).returncode == 0
    for arguments in ((), (), ("--out", "out/report.html")):
        assert stickslip_here("report", "out", *arguments, cwd=here).returncode == 0
    (here / "out" / "report.html").write_text("mine")
    run = stickslip_here("report", "out", cwd=here)
    assert (run.returncode, "was not written by stickslip" in run.stderr) == (2, True)
    assert (here / "out" / "report.html").read_text() == "mine"
    assert stickslip_here("report", "out", "--overwrite", cwd=here).returncode == 0
    assert stickslip_here("report", "out", cwd=here).returncode == 0
    (here / "out" / "manifest.json").unlink()
    (here / "out" / "report.html").write_text("mine")
    assert "exists: give another name" in stickslip_here("report", "out", cwd=here).stderr


@pytest.mark.slow
def test_a_movie_in_mp4_is_known_as_one(here):
    pytest.importorskip("imageio_ffmpeg")
    modes_of(here)
    for _ in range(2):
        run = stickslip_here("movie", "a.npz", "--modes", "m.npz", "--frames", "2", "--out", "b.mp4", cwd=here)
        assert run.returncode == 0, run.stderr
    shutil.copy(here / "a.npz", here / "b.mp4")
    assert "b.mp4 exists" in stickslip_here("movie", "a.npz", "--modes", "m.npz", "--out", "b.mp4", cwd=here).stderr


def test_who_is_killed_as_a_page_takes_its_place_leaves_what_is_known(here, monkeypatch):
    (here / "s.toml").write_text('experiment = "rate-state"\nsamples.number = 10\n')
    assert stickslip_here("run", "s.toml", "--out", "out", cwd=here).returncode == 0

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as now:
        now.setattr("stickslip.reports.page.add_to_manifest", killed)
        assert stickslip_here("report", "out", cwd=here).returncode == 130
    assert (here / "out" / "report.html").exists()
    assert stickslip_here("report", "out", cwd=here).returncode == 0
    assert stickslip_here("run", "s.toml", "--out", "out", cwd=here).returncode == 0


def test_modes_replace_modes_only_also_under_a_name_that_was_given(here):
    (here / "b.npz").write_bytes(b"mine")
    (here / "c.npz").symlink_to("absent")
    (here / "d.npz").mkdir()
    for name in ("b.npz", "c.npz"):
        text = f"--modes {name} exists and does not contain modes: give another name, or move it away"
        run = stickslip_here("stability", "a.npz", "--modes", name, cwd=here)
        assert (run.returncode, run.stderr) == (2, f"stickslip: {text}\n")
    assert (here / "b.npz").read_bytes() == b"mine"
    assert "d.npz is a folder" in stickslip_here("stability", "a.npz", "--modes", "d.npz", cwd=here).stderr
    assert "e is not a folder: create it" in stickslip_here("stability", "a.npz", "--modes", "e/m.npz", cwd=here).stderr
    modes_of(here)
    assert stickslip_here("stability", "a.npz", "--modes", "m.npz", cwd=here).returncode == 0


@pytest.mark.parametrize("command", ["movie", "convert"])
@pytest.mark.parametrize("amplitude", ["1e308", "1e31", "inf", "nan", "0", "-1"])
def test_amplitudes_that_leave_no_picture_are_refused(here, command, amplitude):
    modes_of(here)
    out = ("--out", "b.gif") if command == "movie" else ("--to", "b.xyz")
    text = "amplitude is NaN" if amplitude == "nan" else "at least 2 frames and an amplitude"
    refused(text, command, "a.npz", "--modes", "m.npz", "--frames", "2", "--amplitude", amplitude, *out, cwd=here)
