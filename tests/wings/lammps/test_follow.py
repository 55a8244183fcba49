"""Frames of growing dumps: complete ones and no others, in one file or many, with damage told."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange import lammps_series as follow
from stickslip.data.exchange.lammps_series import find_dumps, look, open_source

from .dumps import LAW, SHEARED, STEPS, copy, frames, simulate


def test_only_complete_frames_are_found_wherever_the_file_ends(tmp_path):
    """At every cut near the end of a frame, and at many others, whether files are read on or anew."""
    parts = frames("contacts.dump")
    ends = np.cumsum([len(part) for part in parts])
    whole, path, known = b"".join(parts), tmp_path / "contacts.dump", {}
    near = [end + shift for end in ends for shift in (-2, -1, 0, 1, 5, 14, 15, 40)]
    for cut in sorted({*near, *range(0, len(whole), 1999)} & set(range(len(whole) + 1))):
        path.write_bytes(whole[:cut])
        known, anew = find_dumps(tmp_path, known), find_dumps(tmp_path, {})
        assert known == anew
        dump = known[path]
        complete = int((ends <= cut).sum())
        assert [frame.step for frame in dump.frames] == STEPS[:complete]
        assert [frame.stop for frame in dump.frames] == list(ends[:complete])
        assert dump.partial == (cut > 0 and cut not in ends)


def test_a_file_that_is_rewritten_is_read_again(tmp_path):
    path = copy(tmp_path, contacts=False) / "grains.dump"
    known = find_dumps(tmp_path, {})
    path.write_bytes(frames("grains.dump")[2])
    assert [frame.step for frame in find_dumps(tmp_path, known)[path].frames] == [80000]


@pytest.mark.parametrize("each", [False, True], ids=["one file", "a file for each frame"])
def test_a_simulation_is_followed_while_it_writes(each, tmp_path):
    writer = simulate(tmp_path / "run", each=each)
    while not any(path.stat().st_size for path in (tmp_path / "run").glob("*.dump")):
        pass
    followed = list(ss.io.follow_packings(tmp_path / "run", until_idle=1.0, interval=0.01, **LAW))
    writer.join()
    assert [name for name, *_ in followed] == [str(step) for step in STEPS]
    for name, state, law, notes in followed:
        files = {"contacts": SHEARED / "contacts.dump", "frame": name}
        twin, its_law, said = ss.io.read_packing(SHEARED / "grains.dump", **files, **LAW)
        assert np.array_equal(law.table, its_law.table)
        assert np.array_equal(state.contacts.slip, twin.contacts.slip)
        assert np.array_equal(state.grains.position, twin.grains.position)
        assert notes == said


def test_a_frame_waits_for_its_contacts(tmp_path):
    copy(tmp_path, contacts=False)
    (tmp_path / "contacts.dump").write_bytes(frames("contacts.dump")[0] + frames("contacts.dump")[1][:-1])
    source = open_source(tmp_path, **LAW)
    first = look(source)
    assert [pair.grains.step for pair in first.ready] == [0]
    assert first.waiting == (40000, 80000)
    with (tmp_path / "contacts.dump").open("ab") as file:
        file.write(b"\n" + frames("contacts.dump")[2])
    second = look(source, first)
    assert [pair.grains.step for pair in second.ready] == STEPS
    (tmp_path / "contacts.dump").write_bytes(frames("contacts.dump")[2])
    third = look(source, second)
    assert third.lost == (0, 40000)


@pytest.mark.parametrize(
    ("harm", "text"),
    [
        (lambda part: part[: len(part) // 2], "cut off after"),
        (lambda part: part[:25], "the header was cut off"),
        (lambda part: part.replace(b"ATOMS\n27", b"ATOMS\n2x7"), "2x7"),
        (lambda part: part.replace(b"ATOMS\n27", b"ATOMS\n29"), "cut off after 27 of 29 rows"),
    ],
)  # fmt: skip
def test_damaged_frames_are_reported_and_the_others_read(harm, text, tmp_path, monkeypatch):
    monkeypatch.setattr(follow, "FRESH", 0.0)  # no contacts are waited for
    parts = frames("grains.dump")
    (tmp_path / "grains.dump").write_bytes(parts[0] + harm(parts[1]) + parts[2])
    source = open_source(tmp_path, **LAW)
    seen = look(source)
    assert [pair.grains.step for pair in seen.ready] == [0, 80000]
    (note,) = seen.notes
    assert text in note
    assert "grains.dump" in note


def test_of_two_files_with_the_same_step_the_last_one_is_used_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(follow, "FRESH", 0.0)  # no contacts are waited for
    copy(tmp_path, contacts=False)
    (tmp_path / "again.dump").write_bytes(frames("grains.dump")[1])
    source = open_source(tmp_path, **LAW)
    seen = look(source)
    assert seen.ready[1].grains.path.name == "again.dump"
    assert "step 40000 is in grains.dump and in again.dump" in seen.notes[0]
