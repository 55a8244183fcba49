"""Files of records: what was appended is found again, wherever a process was killed."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.data import checkpoint as records
from stickslip.data.checkpoint import Checkpoint, read_pieces
from tests.restart.test_archive import same

STATE = ss.assembly(ss.disks([[0.0, 0.0], [0.99, 0.0]], 0.5), cell=ss.box())
VALUE = {"state": STATE, "rows": (1, 2.5, None, "word"), "by": {0.5: b"\x00\xff"}, "z": np.array([1 + 2j, np.nan])}


def again(folder):
    """The checkpoint as another process finds it, which has read nothing yet and appends to a file of its own."""
    records._INDEX.clear()
    records._OWN.clear()
    return Checkpoint(folder, "text")


def test_a_file_cut_anywhere_holds_the_pieces_before_the_cut_and_more_are_kept_beside_it(tmp_path):
    kept, ends = Checkpoint(tmp_path, "text"), []
    for k in range(3):
        kept.save(f"{k}", VALUE | {"number": k})
        (path,) = records.record_files(kept.folder)
        ends.append(path.stat().st_size)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for end in {0, 1, *ends, *(e - 1 for e in ends), *rng.integers(0, len(whole), 40).tolist()}:
        path.write_bytes(whole[:end])
        left = sum(e <= end for e in ends)
        assert again(tmp_path).names == [f"{k}" for k in range(left)], end
    path.write_bytes(whole[: ends[1] + 7])
    kept = again(tmp_path)
    kept.save("2", VALUE | {"number": 2})
    assert [kept.load(name)["number"] for name in again(tmp_path).names] == [0, 1, 2]
    assert same(kept.load("2"), VALUE | {"number": 2})


def test_nothing_is_read_from_the_first_changed_byte_on(tmp_path):
    kept, ends = Checkpoint(tmp_path, "text"), []
    for k in range(3):
        kept.save(f"{k}", {"x": np.arange(4.0)})
        (path,) = records.record_files(kept.folder)
        ends.append(path.stat().st_size)
    whole = path.read_bytes()
    for place in np.random.default_rng(1).integers(0, len(whole), 60).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        assert again(tmp_path).names == [f"{k}" for k in range(sum(e <= place for e in ends))], place


def test_after_a_failed_write_nothing_that_follows_is_lost(tmp_path, monkeypatch):
    kept = Checkpoint(tmp_path, "text")
    kept.save("a", {"x": 1.0})

    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as there, pytest.raises(OSError, match="No space left on device"):
        there.setattr(records, "SYNC", 0.0)
        there.setattr(records.os, "fsync", full)
        kept.save("b", {"x": 2.0})
    (path,) = records.record_files(kept.folder)
    path.write_bytes(path.read_bytes()[:-3])
    kept.save("c", {"x": 3.0})
    assert again(tmp_path).names == ["a", "c"]


def test_a_cleared_part_is_empty_and_can_be_used_again(tmp_path):
    kept = Checkpoint(tmp_path, "text").of("part")
    kept.save("a", {"x": 1.0})
    assert kept.has("a")
    kept.clear()
    assert not kept.has("a")
    kept.save("b", {"x": 2.0, "more": np.zeros(100)})
    assert kept.names == ["b"]
    found, about = read_pieces(tmp_path)
    assert list(found) == ["part/b"]
    assert json.loads(json.dumps(about))["scenario"] == "text"
