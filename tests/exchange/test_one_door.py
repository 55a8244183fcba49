"""Every command that reads a packing reads the same inputs, and finds the same in them."""

import json
import re
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.doctor import parts
from stickslip.examples import path as example
from stickslip.extras import EXTRAS
from stickslip.loading.reading import convert
from tests.conftest import stickslip_here

CASES = Path(__file__).parent / "lammps_runs" / "cases.tar.xz"
FORCES = ["--contacts", str(example("measured_forces.csv")), "--mu", "0.3"]
INPUTS = {  # place, options; pages and movies, which take seconds, are made of some
    "npz under another law": ("packing.npz", ["--mu", "9.9"]),
    "archive": ("packing.h5", []),
    "folder of LAMMPS": ("lammps", []),
    "folder of a run": ("run", ["--frame", "frames/000001"]),
    "measured forces": ("disks.csv", FORCES),
}


@pytest.fixture(scope="module")
def here(tmp_path_factory, few_spheres):
    folder = tmp_path_factory.mktemp("inputs")
    shutil.copy(few_spheres, folder / "packing.npz")
    shutil.copy(example("measured_disks.csv"), folder / "disks.csv")
    with tarfile.open(CASES) as packed:
        packed.extractall(folder / "cases", filter="data")
    (folder / "lammps").mkdir()
    for name in ("dump.grains", "contacts.dump", "log.lammps"):
        shutil.copy(folder / "cases" / "sheared" / name, folder / "lammps" / name)
    state, law, _ = ss.io.read_packing(folder / "packing.npz")
    ss.io.write_packing(folder / "packing.h5", state, law)
    (folder / "run").mkdir()
    ss.io.write_packing(folder / "run" / "results.h5", [ss.io.frame_of(state, law)] * 2)
    return folder


def said(folder, *command):
    done = stickslip_here(*command, "--json", cwd=folder)
    assert done.returncode in (0, 3), done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("kind", INPUTS)
# 3 s: all commands read a folder of LAMMPS
def test_all_commands_and_functions_take_every_input(kind, here, tmp_path):
    place, options = INPUTS[kind]
    known = said(here, "stability", place, *options)
    assert known["balanced"] and bool(known["pairs"]) != (kind == "measured forces"), known["verdict"]
    words = {key.removeprefix("--"): value for key, value in zip(options[::2], options[1::2], strict=True)}
    words = {key: float(value) if key in ("mu", "kt") else value for key, value in words.items()}
    state, law, _ = ss.io.read_packing(here / place, **words)
    pairs = ss.stability(state, law).pairs
    assert [pair["im_lambda"] for pair in known["pairs"]] == pytest.approx(pairs.imag, rel=1e-6)
    frame = words.pop("frame", "all")
    ((_, again, *_),) = ss.io.read_packings(here / place, frame=frame, **words)
    np.testing.assert_array_equal(again.contacts.slip, state.contacts.slip)
    made = tmp_path / "made.h5"
    said(here, "convert", place, *options, "--to", made)
    assert said(tmp_path, "stability", made)["verdict"] == known["verdict"]
    convert(here / place, tmp_path / "too.h5", **words | ({"frame": frame} if frame != "all" else {}))
    np.testing.assert_array_equal(ss.io.read_packing(tmp_path / "too.h5").state.contacts.slip, state.contacts.slip)
    if kind in ("archive", "measured forces"):
        report = said(here, "report", place, *options, "--out", tmp_path / "r.html")
        assert report["verdict"] == known["verdict"]
    if kind not in ("folder of LAMMPS", "measured forces"):
        return
    done = stickslip_here("movie", place, *options, "--out", tmp_path / "m.gif", "--frames", "2", cwd=here)
    assert (done.returncode, (tmp_path / "m.gif").exists()) == ((0, True) if known["pairs"] else (2, False)), (
        done.stderr
    )
    assert known["pairs"] or "is stable or has no growing mode" in done.stderr
    if kind == "folder of LAMMPS":
        row = said(here, "watch", place, "--once", "--out", tmp_path / "w.csv")["newest"]
        assert (row["verdict"], row["pairs"]) == (known["verdict"], len(known["pairs"]))
        ((_, followed, its_law, _),) = ss.io.follow_packings(here / place, until_idle=0.0)
        assert ss.stability(followed, its_law).pairs == pytest.approx(pairs, rel=1e-9)


def test_what_is_stated_against_the_file_is_told(here):
    (note,) = ss.io.read_packing(here / "packing.h5", mu=8.0).notes
    assert "mu = 10) is replaced by" in note and note.endswith("mu = 8")
    assert ss.io.read_packing(here / "packing.h5", mu=10.0).notes == []
    with pytest.raises(
        ss.packings.PackingError, match=r"atom_style = 'bpm/sphere' contradicts .* whose atoms are of style"
    ):
        ss.io.read_packing(here / "cases" / "sheared" / "sheared.data", atom_style="bpm/sphere")
    notes = ss.io.read_packing(here / "lammps" / "dump.grains", boundary="ppf").notes
    assert "boundary ppf replaces that of the file, ppp" in notes


def test_what_stability_and_doctor_advise_can_be_pasted(here):
    state = ss.io.read_packing(here / "packing.npz").state
    where = {"position": state.grains.position, "radius": state.grains.radius, "cell": state.cell.vectors}
    np.savez(here / "bare.npz", **where)
    first = stickslip_here("stability", "bare.npz", cwd=here)
    assert first.returncode == 3
    known = stickslip_here("stability", "--help").stdout
    named = set(re.findall(r"--[a-z]+(?:-[a-z]+)*", first.stdout))
    assert "--settle" in named and all(f"{option} " in known for option in named)
    law = ["--law", "hertz_mindlin", "--kn", "1", "--kt", "0.3", "--mu", "0.5", "--settle"]
    again = stickslip_here("stability", "bare.npz", *law, "-q", cwd=here)
    assert again.returncode == 0, again.stdout + again.stderr
    assert "--" not in again.stdout
    extras = {extra for part in parts() for extra in re.findall(r"stickslip\[(\w+)\]", part.remedy)}
    assert extras <= {*EXTRAS}


OTHER = ss.laws.linear(mu=0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"law": OTHER, "friction": 0.3}, "a law has no parameter 'friction': it has kn, kt, mu"),
        ({"law": OTHER, "work": 1e-3}, "a law has no parameter 'work': it has kn, kt, mu"),
        ({"law": OTHER, "tension": True}, "tension does not apply to a complete law"),
        ({"friction": 0.3}, "hertz_mindlin has no parameter friction: it has kn, kt, mu, damping_n, damping_t"),
        ({"tension": "no"}, "tension must be True or False, got a value of type str"),
        ({"contacts": 3}, "contacts must be a word or a Path, got a value of type int"),
        ({"i0": "0.5"}, "i0 must be a number, got a value of type str"),
        ({"parameters": [1]}, "parameters must be a dict, got a value of type list"),
        ({"law": [OTHER]}, "law must be a word or a Path or a Law, got a value of type list"),
    ],
)
@pytest.mark.parametrize("place", ["packing.npz", "disks.csv"])
def test_no_option_is_ignored(here, place, options, message):
    more = {"contacts": example("measured_forces.csv"), "mu": 0.3} if place == "disks.csv" else {}
    with pytest.raises((TypeError, ValueError), match=message):
        ss.io.read_packing(here / place, **more | options)


def test_a_frame_may_be_given_as_a_number(here, tmp_path):
    state, law, _ = ss.io.read_packing(here / "packing.npz")
    ss.io.write_packing(tmp_path / "two.gsd", [ss.io.frame_of(state, law)] * 2)
    for read in (ss.io.read_packing, ss.io.read_packings):
        assert repr(read(tmp_path / "two.gsd", frame=1)) == repr(read(tmp_path / "two.gsd", frame="1"))


@pytest.mark.parametrize("assumed", [[5], [["a"], ["b"]], [b"a"]])
def test_notes_in_an_npz_file_are_text(tmp_path, assumed):
    path = tmp_path / "p.npz"
    np.savez(path, position=np.zeros((1, 3)), radius=np.ones(1), assumed=np.array(assumed), law="linear")
    with pytest.raises(ss.packings.PackingError, match=r"^assumed has the shape .* in .*: it must be text"):
        ss.io.read_packing(path)
