"""Lengths, counts and claims in foreign files: refused in one sentence, before memory is taken, and without a hang."""

import gzip
import json
import struct
import tarfile
import time
import tracemalloc
import warnings
import zipfile
import zlib
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import stickslip as ss
from stickslip.core.progress import Outcome
from stickslip.core.reading import LARGE, Budget, Reader, read_bytes
from stickslip.data import checkpoint as records
from stickslip.data.archive import ArchiveError, make_node, to_bytes
from stickslip.data.checkpoint import Checkpoint, load_or_compute, read_pieces
from stickslip.data.exchange import lammps_restart as restart
from stickslip.data.exchange.lammps_commands import read_commands
from tests.exchange.conftest import CASES
from tests.hardening.test_fuzz import answered, ended

MOST = 3 * LARGE  # bytes that reading a small file may take, some of them twice


@pytest.fixture(scope="module")
def sheared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases")
    with tarfile.open(CASES) as packed:
        packed.extractall(folder, filter="data")
    return folder / "sheared"


def test_a_reader_moves_forwards_and_within_its_bytes():
    reader = Reader(b"abcdefgh\nij")
    assert (reader.take(2), reader.line(), reader.left) == (b"ab", b"cdefgh", 2)
    for size in (-1, 3, 2**62, -(2**62)):
        with pytest.raises(ValueError, match=f"{size} bytes are declared, but 2 follow"):
            reader.take(size)
    for count in (-1, 1, 2**60):
        with pytest.raises(ValueError, match="bytes are declared, but 2 follow"):
            reader.array("<f8", count)
    assert (reader.line(), reader.line(), reader.at) == (b"ij", b"", 11)
    for at in (-1, 12):
        with pytest.raises(ValueError, match="bytes are declared"):
            Reader(b"abcdefgh\nij", at)


def test_counts_in_the_header_of_a_restart_file_only_move_forwards(sheared, tmp_path):
    content = (sheared / "sheared.restart").read_bytes()
    memory, path = restart.read_restart(sheared / "sheared.restart"), tmp_path / "a.restart"
    lists = [flag for flag, kind in restart.FLAGS.items() if kind in (restart.INTS, restart.DOUBLES)]
    marks = [struct.pack("<ii", flag, size) for flag in lists for size in (2, 3, 6)]
    found = [at for mark in marks if 0 < (at := content.find(mark)) < content.find(restart.HEADER_END)]
    assert len(found) >= 4
    for at in found:
        for count in (-1, -2, 2**31 - 1):
            path.write_bytes(content[: at + 4] + struct.pack("<i", count) + content[at + 8 :])
            with answered(5):
                restart.group_masks(path, memory)
                restart.time_step(path)
                with pytest.raises(ss.packings.PackingError, match="bytes are declared"):
                    restart.read(path)


def hdf5_record(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in ("time", "friction", "load_point"):
            file.create_dataset(name, (10**9,), "f8", chunks=(10**6,), compression="gzip", fillvalue=1.0)


def matlab_record(path: Path) -> None:
    """A variable that expands a thousand times, in the layout of MATLAB's level 5."""
    packed = zlib.compress(bytes(7 * 10**7), 1)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + struct.pack("<ii", 15, len(packed)) + packed)


def text_bomb(path: Path) -> None:
    path.write_bytes(gzip.compress(b"x y z radius\n" + b"0 0 0 1\n" * 9 * 10**6, 1))


def arrays_bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed, packed.open("position.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (3 * 10**6, 3)})
        for _ in range(8):
            member.write(bytes(9 * 10**6))


def false_header(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as packed, packed.open("position.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)})


def blocks_bomb(path: Path) -> None:
    """One array of 8 blocks, each below the bound that the whole array exceeds."""
    block = zlib.compress(bytes(10**7), 1)
    sizes = np.array([8, 10**7, 0, *[len(block)] * 8], "<u4").tobytes()
    head = (
        '<VTKFile type="PolyData" compressor="vtkZLibDataCompressor"><PolyData><Piece><Points>'
        '<DataArray type="Float64" NumberOfComponents="3" format="appended" offset="0"/></Points></Piece></PolyData>'
        '<AppendedData encoding="raw">_'
    )
    path.write_bytes(head.encode() + sizes + 8 * block + b"</AppendedData></VTKFile>")


BOMBS = {
    "a.h5": (hdf5_record, ss.friction.read_record), "a.mat": (matlab_record, ss.friction.read_record),
    "a.txt.gz": (text_bomb, ss.io.read_packing), "a.npz": (arrays_bomb, ss.io.read_packing),
    "b.npz": (false_header, ss.io.read_packing), "a.vtp": (blocks_bomb, ss.io.read_packing),
    "modes.npz": (false_header, lambda path: ss.io.read_mode(path, 0, 8)),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_content_is_bounded_before_it_is_allocated(name, tmp_path):
    make, read = BOMBS[name]
    make(tmp_path / name)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError) as caught, answered(10):
            read(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)


def check_matlab_files(count, folder):
    """Lengths, types and single bits of files as SciPy writes them; SciPy itself would crash on some."""
    grains = [(k + 1, 10.0 * k, 9.0, 5.0, 1e-3, np.array([k, k + 2]), np.ones(2), np.zeros(2)) for k in range(5)]
    fields = [(name, "O") for name in ("id", "x", "y", "r", "rm", "neighbours", "forces", "alphas")]
    record = {"time": np.arange(20.0), "friction": np.full(20, 0.6), "load_point": 1e-6 * np.arange(20.0)}
    kinds = ({"particle": np.array(grains, fields)}, ss.io.read_forces), ({"data": record}, ss.friction.read_record)
    rng, path, taken = np.random.default_rng(6), folder / "a.mat", 0
    for k in range(count):
        what, read = kinds[k % 2]
        savemat(path, what, do_compression=k % 4 == 3)
        content = bytearray(path.read_bytes())
        for _ in range(rng.integers(0, 3)):
            at, value = int(rng.integers(30, len(content) // 4)) * 4, rng.choice([-1, 0, 1, 8, 14, 255, 2**31 - 1])
            content[at : at + 4] = content[at] ^ 1 << rng.integers(8), *content[at + 1 : at + 4]
            if rng.random() < 0.5:
                content[at : at + 4] = np.int32(value).tobytes()
        path.write_bytes(content)
        try:
            with answered(5):
                warnings.simplefilter("ignore")
                read(path)
        except ValueError as problem:
            assert "\n" not in str(problem), problem
        else:
            taken += 1
    assert 0 < taken < count


def test_some_mutated_matlab_files(tmp_path):
    check_matlab_files(100, tmp_path)


@pytest.mark.slow
def test_ten_thousand_mutated_matlab_files(tmp_path):
    check_matlab_files(10_000, tmp_path)


def test_a_budget_is_that_of_a_file_and_not_of_an_array():
    budget = Budget("a", 100, remedy="copy it again")
    budget.take(LARGE // 2)
    with pytest.raises(ValueError, match=r"a has 0\.0001 MB, but up to its b it would need"):
        budget.take(LARGE // 2 + 1, "b")


@pytest.mark.parametrize("read", [ss.friction.read_stress_table, ss.friction.read_record, ss.io.read_packing])
def test_devices_are_not_read(read):
    with answered(2), pytest.raises(ValueError, match=r"device|not a file"):
        read("/dev/zero")


def test_legacy_vtk_takes_linear_time(tmp_path):
    rows = "\n".join(["0 0 0"] * 60_000)
    head = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 60000 double\n"
    (tmp_path / "a.vtk").write_text(head + rows + "\n")
    begun = time.process_time()
    with pytest.raises(ss.packings.PackingError, match="radius"):
        ss.io.read_packing(tmp_path / "a.vtk")
    assert time.process_time() - begun < 2  # 10 s if each line copies what follows it


def test_types_and_variables_of_a_run_are_bounded(sheared, tmp_path):
    dump = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n0 9\n0 9\n0 9\n"
    dump += "ITEM: ATOMS id type x y z radius\n"
    (tmp_path / "dump.a").write_text(dump + "1 1 1 1 1 .5\n2 30000 2 1 1 .5\n")
    (tmp_path / "in.a").write_text("atom_style sphere\npair_style gran/hooke/history 1 .5 0 0 .5 0\npair_coeff * *\n")
    with answered(5), pytest.raises(ss.packings.PackingError, match="30000 types: at most 300 are allowed"):
        ss.io.read_packing(tmp_path)
    names = [f"v{k}" for k in range(60)]
    text = [f"variable {b} string ${{{a}}}${{{a}}}" for a, b in pairwise(names)]
    (tmp_path / "in.b").write_text("\n".join(["atom_style sphere", "variable v0 string xxxxxxxx", *text]) + "\n")
    tracemalloc.start()
    with answered(5):
        read_commands(tmp_path / "in.b")
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_control_characters_do_not_reach_the_terminal(tmp_path, capsys):
    state = ss.packings.jammed(12, packing_fraction=0.66, seed=2)[0]
    law, path = ss.laws.hertz_mindlin(), tmp_path / "p.npz"
    frame = ss.io.frame_of(state, law)._replace(assumed=("a\x1b]0;title\x07\x1b[2J b",))
    ss.io.write_packing(path, [frame])
    for arguments in (["stability", path], ["stability", path, "--json"]):
        with answered(), pytest.raises(SystemExit):
            _run(arguments)
        out, err = capsys.readouterr()
        assert "\\x1b]0;title\\x07" in (out + err).replace("\\u00", "\\x").replace("\n", "")
        assert not {"\x1b", "\x07"} & {*out, *err}
    with pytest.raises(ValueError, match=r"\\x1b\[2J"):
        ss.laws.with_lever(law, "\x1b[2J")


def _run(arguments):
    import sys
    from unittest import mock

    from stickslip.cli import main

    with mock.patch.object(sys, "argv", ["stickslip", *map(str, arguments)]):
        main()


def test_modes_of_this_folder_are_named_after_it(tmp_path, monkeypatch, capsys):
    (tmp_path / "run").mkdir()
    monkeypatch.chdir(tmp_path / "run")
    (tmp_path / "run" / "run-modes.npz").write_text("other")
    assert ended(["stability", "."], capsys) == 2
    with pytest.raises(SystemExit):
        _run(["stability", "."])
    assert "modes would replace run-modes.npz" in capsys.readouterr().err


class Piece(NamedTuple):
    """Something a run saves, for N samples."""

    time: np.ndarray  # (N,)
    values: np.ndarray  # (N, 3)
    state: ss.State | None
    count: int


STATE = ss.packings.jammed(8, packing_fraction=0.9, dim=2, seed=1)[0]
GOOD = Piece(np.zeros(4), np.full((4, 3), np.nan), STATE, 4)
BAD_STATE = STATE._replace(grains=STATE.grains._replace(mass=-STATE.grains.mass))
ABOUT = {"scenario": "{}", "stickslip": ss.__version__, "part": "."}
PIECES = {
    "empty": b"", "short": b"abc", "no JSON": struct.pack("<Q", 3) + b"abc", "long": struct.pack("<Q", 2**63) + b"{}",
    "number": to_bytes(make_node(1.0)), "tuple": to_bytes(make_node((1.0, "x"))), "state": to_bytes(make_node(STATE)),
    "list": struct.pack("<Q", 2) + b"[]", "nested": struct.pack("<Q", 20000) + b"[" * 20000,
    "objects": struct.pack("<Q", 18) + b'[{}, "|O8", [1000]]',
    "huge": struct.pack("<Q", 26) + b'[{}, "<f8", [1000000000]] ',
    "negative": struct.pack("<Q", 18) + b'[{}, "<f8", [-11]]',
    **{
        name: to_bytes(make_node(GOOD._replace(**changed)))
        for name, changed in {
            "lengths": {"time": np.zeros(3)}, "words": {"time": np.array(["a"] * 4)}, "shape": {"values": np.zeros(4)},
            "count": {"count": "four"}, "no state": {"state": 1.0}, "bad state": {"state": BAD_STATE},
        }.items()
    },
    "other fields": to_bytes(make_node({"time": 1.0})).replace(b"{}", b'{"noun": "Piece"}', 1),
}  # fmt: skip
ABOUTS = {
    "list": [], "none": {}, "numbers": ABOUT | {"scenario": 1}, "no version": {"scenario": "{}", "part": "."},
    "no scenario": {"stickslip": ss.__version__, "part": "."},
}  # fmt: skip


@pytest.mark.parametrize("what", PIECES)
def test_pieces_with_the_right_checksum_and_other_content_are_refused(what, tmp_path):
    kept = Checkpoint(tmp_path, "{}", (Piece,))
    kept.save("good", GOOD)
    assert kept.load("good", Piece).count == 4
    records.append_record(kept.folder, "bad", PIECES[what], ABOUT)
    with answered(5), pytest.raises(ArchiveError) as caught:
        load_or_compute(kept, "bad", lambda: None, Piece)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("what", ABOUTS)
def test_pieces_that_do_not_say_what_they_belong_to_are_refused(what, tmp_path):
    kept = Checkpoint(tmp_path, "{}", (Outcome,))
    kept.announce()
    file = kept.folder / f"a{records.SUFFIX}"
    file.write_bytes(
        records._to_frame("", json.dumps(ABOUTS[what]).encode()) + records._to_frame("x", PIECES["number"])
    )
    for use in (lambda: kept.has("x"), kept.check, lambda: read_pieces(tmp_path)):
        with pytest.raises(ArchiveError):
            use()


def test_a_name_that_is_no_text_is_refused(tmp_path):
    kept = Checkpoint(tmp_path, "{}")
    kept.announce()
    wrong = struct.pack("<HQ", 2, 0) + b"\xff\xff"
    frame = struct.pack("<I", zlib.crc32(wrong)) + wrong
    (kept.folder / f"a{records.SUFFIX}").write_bytes(records._to_frame("", json.dumps(ABOUT).encode()) + frame)
    with pytest.raises(ArchiveError):
        kept.has("x")


def test_bytes_of_a_file_are_bounded(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(2**40)
    with answered(2), pytest.raises(ValueError, match=r"GB: at most 8\.59 are read"):
        read_bytes(tmp_path / "sparse", remedy="exceeds the cell")
