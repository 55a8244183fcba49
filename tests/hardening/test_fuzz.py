"""Mutated files: whatever is in a scenario or a packing, the command line ends with 0, or with 2 and one sentence."""

import base64
import copy
import gc
import json
import signal
import struct
import sys
import tarfile
import tomllib
import tracemalloc
import warnings
from contextlib import contextmanager

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.data.exchange import lammps_restart as memory
from stickslip.data.exchange.frame import read_mode
from stickslip.loading.packing import jammed
from stickslip.reports.packing import check_modes
from tests.exchange.conftest import CASES
from tests.exchange.test_vtk_xml import CASES as VTK_CASES
from tests.unit.test_sample import arrays_of
from tests.unit.test_scenario import EXAMPLES

DAMAGED = (".npz", ".h5", ".gsd", ".data")
PATIENCE = 30  # seconds for one input; most take milliseconds
NASTY = [
    -1, 0, 1, 2, 3, 10**30, -0.0, 1e308, -1e308, 1e-320, float("nan"), float("inf"), -float("inf"), 0.5, True, False,
    None, "", "x", "x" * 5000, "\x00", "ß∂ƒ", "../..", "__import__('os').system('true')", [], {}, [[]], [0],
    [1e300] * 4,
    ["a"], {"a": 1}, [1, 2, 3], [[0, 0, 0]], {"x": 1e9}, {"kind": "slide"},
]  # fmt: skip

WORDS = [
    *(struct.pack("<d", value) for value in (0.0, -5.0, 1.0, 2.5, 3.0, 17.0, 40.0, 1e9, -1e300, np.nan, np.inf)),
    *(struct.pack("<q", value) for value in (0, 1, -1, 9, 2**40, -(2**62))),
]


@contextmanager
def answered(patience=PATIENCE):
    """End a hang, and let nothing warn."""

    def hangs(*_):
        raise AssertionError(f"no answer within {patience} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(patience)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def ended(arguments, capsys):
    """Exit code of the command line in this process, which ends a hang itself; on 2 there is one sentence."""
    argv, sys.argv = sys.argv, ["stickslip", *map(str, arguments)]
    try:
        with pytest.raises(SystemExit) as caught, answered():
            main()
    finally:
        sys.argv = argv
    code, said = caught.value.code or 0, capsys.readouterr().err
    assert code in (0, 2, 3), said  # 3: read, and not in equilibrium
    if code == 2:
        assert said.startswith("stickslip: ")
        assert said.count("\n") == 1, said
        assert len(said) < 2000, said
    return code


def places(tree, above=()):
    """Paths to everything in nested dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield (*above, key)
        yield from places(value, (*above, key))


def with_change(tree, rng):
    """The tree with an entry replaced, removed, doubled or renamed."""
    tree = copy.deepcopy(tree)
    known = list(places(tree))
    *above, last = known[rng.integers(len(known))]
    holder = tree
    for key in above:
        holder = holder[key]
    way = rng.integers(5)
    if way == 0:
        del holder[last]
    elif way == 1 and isinstance(holder, dict):
        holder[str(last) + "s"] = holder.pop(last)
    elif way == 2 and isinstance(holder[last], int | float):
        holder[last] = holder[last] * float(10.0 ** rng.integers(-20, 20)) * rng.choice([-1, 1])
    elif way == 3:
        holder[last] = [copy.deepcopy(holder[last])]
    else:
        holder[last] = copy.deepcopy(NASTY[rng.integers(len(NASTY))])
    return tree


def with_damage(content: bytes, rng) -> bytes:
    """The content cut, with bytes changed, or with a piece of it moved."""
    out = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        a, b = sorted(rng.integers(0, len(out) + 1, 2))
        way = rng.integers(4)
        if way == 0:
            out = out[:a] or out
        elif way == 1 and a < len(out):
            out[a] = rng.integers(256)
        elif way == 2:
            out = (out[:a] + out[b:]) or out
        else:
            out = out[:b] + out[a : min(b, a + 200)] + out[b:]
    return bytes(out)


def check_scenarios(count, tmp_path, capsys):
    rng, texts = np.random.default_rng(0), [path.read_bytes() for path in sorted(EXAMPLES.glob("*.toml"))]
    codes = []
    for _ in range(count):
        text = texts[rng.integers(len(texts))]
        if rng.random() < 0.3:
            path = tmp_path / "s.toml"
            path.write_bytes(with_damage(text, rng))
        else:
            path, tree = tmp_path / "s.json", tomllib.loads(text.decode())
            for _ in range(rng.integers(1, 4)):
                tree = with_change(tree, rng) if tree else tree
            path.write_text(json.dumps(tree))
        codes.append(ended(["cite", path], capsys))
    assert 0 < sum(code == 0 for code in codes) < count


def packing():
    state, _ = jammed(12, packing_fraction=0.66, seed=2)
    return {**arrays_of(state), "mass": np.ones(12), "kn": 1.0, "kt": 0.3, "mu": 0.4, "law": "hertz_mindlin"}


def with_array_changed(arrays, rng):
    arrays = dict(arrays)
    name = list(arrays)[rng.integers(len(arrays))]
    value = np.array(arrays[name])
    way = rng.integers(7)
    if way == 0:
        del arrays[name]
    elif way == 1:
        arrays[name] = value[..., :-1] if value.ndim else np.array([value])
    elif way == 2:
        arrays[name + "s"] = arrays.pop(name)
    elif way == 3 and value.size and value.dtype.kind in "fi":
        flat = value.astype(float).reshape(-1)
        flat[rng.integers(flat.size)] = rng.choice([np.nan, np.inf, -1.0, 0.0, 1e300, 1e-300, 7.5, -(2.0**40)])
        arrays[name] = flat.reshape(value.shape)
    elif way == 4:
        arrays[name] = value.astype(str)
    elif way == 5 and value.dtype.kind in "fi":
        arrays[name] = value * rng.choice([-1.0, 0.0, 1e-12, 1e12, 1.01])
    else:
        arrays[name] = np.zeros((0, 3)) if rng.random() < 0.5 else value[:0] if value.ndim else value
    return arrays


def check_packings(count, tmp_path, capsys):
    rng, whole, codes = np.random.default_rng(1), packing(), []
    state, _ = jammed(12, packing_fraction=0.66, seed=2)
    np.savez(tmp_path / "whole.npz", **whole)
    for suffix in DAMAGED[1:]:
        ss.io.write_packing(tmp_path / f"whole{suffix}", state, ss.laws.hertz_mindlin())
    for _ in range(count):
        way = rng.integers(8)
        path = tmp_path / f"p{DAMAGED[way] if way < len(DAMAGED) else '.npz'}"
        if way < len(DAMAGED):
            path.write_bytes(with_damage((tmp_path / f"whole{path.suffix}").read_bytes(), rng))
        else:
            arrays = whole
            with np.errstate(all="ignore"):
                for _ in range(rng.integers(1, 3)):
                    arrays = with_array_changed(arrays, rng) if arrays else arrays
            np.savez(path, **arrays)
        codes.append(ended(["stability", path, "--json"], capsys))
    assert 0 < sum(code == 0 for code in codes) < count


def test_some_mutated_scenarios(tmp_path, capsys):
    check_scenarios(80, tmp_path, capsys)


def test_some_mutated_packings(tmp_path, capsys):
    check_packings(50, tmp_path, capsys)


def test_damaged_archives_are_closed(tmp_path, capsys):
    path = tmp_path / "p.npz"
    path.write_bytes(b"PK\x03\x04" + bytes(40))
    gc.collect()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ended(["stability", path], capsys)
        with pytest.raises(ValueError, match="contains no modes"):
            read_mode(path, 0, 3)
        with pytest.raises(ValueError, match="does not contain modes"):
            check_modes(path, tmp_path / "packing.npz", asked=True)
        gc.collect()
    assert not [str(w.message) for w in caught]


def write_restart(path, state, law):
    """Write a restart file as LAMMPS does, in two blocks, with the memory of a state."""
    walls, records = len(state.walls.mass), []
    for k, place in enumerate(state.grains.position):
        record = np.zeros(memory.EXTRA)
        record[memory.POSITION : memory.POSITION + 3], record[memory.OWN] = place, state.grains.radius[k]
        record.view("<i8")[[memory.TAG, memory.IMAGE]] = k + 1, 512 << 20 | 512 << 10 | 512
        record = np.concatenate([record, [2.0, 0.0], [2.0, 0.0] * walls])
        record[0] = len(record)
        records.append(record)
    blocks = [np.concatenate(some) for some in (records[::2], records[1::2])]
    parts = [memory.BLOCK + struct.pack("<i", len(block)) + block.tobytes() for block in blocks]
    path.write_bytes(memory.MAGIC + memory.HEADER_END + b"".join(parts) + memory.MAGIC)
    memory.write_memory(path, path, state, law)


def test_some_mutated_restart_files(tmp_path):
    """Lengths that are zero, negative, huge or no numbers end in one sentence, within a second and a few megabytes."""
    law = ss.laws.for_pair(ss.laws.linear(1.0, 0.5, 0.5), 0, 1, mu=0.4)
    state, path, rng = (
        ss.packings.disk_array(8, press=5e-3, gap=-0.01),
        tmp_path / "a.restart",
        np.random.default_rng(2),
    )
    state.grains.position[:, 1] -= 1e-3  # into the floor
    state = ss.accept(state, ss.forces(state, law)[1])
    write_restart(path, state, law)
    content, read = path.read_bytes(), lambda: memory.read_restart(path, walls=1)
    right = read()
    assert (len(right.i), len(right.wall)) == (8, 8)
    taken, first = 0, len(memory.MAGIC + memory.HEADER_END + memory.BLOCK) + 4
    tracemalloc.start()
    for number in range(300):
        if number % 3:
            place, value = first + 8 * rng.integers((len(content) - first) // 8 - 2), rng.choice(WORDS)
            changed = content[:place] + value + content[place + 8 :]
        else:
            changed = with_damage(content, rng)
        path.write_bytes(changed)
        try:
            with answered(5):
                restart = read()
        except ValueError as problem:
            assert str(problem).startswith("a LAMMPS restart file") or "not a complete LAMMPS restart" in str(
                problem
            ), problem
        else:
            taken += 1
            assert ((restart.i >= 0) & (restart.j < len(restart.position))).all()
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()
    assert 50 < taken < 500


FOREIGN = (
    "sheared/sheared.restart", "sheared/dump.grains", "sheared/grains.dump.gz", "sheared/labels.data",
    "sheared/log.lammps", "dialects/yade.txt", "dialects/pfc.csv", "dialects/mercury.data", "dialects/packing.xyz",
    "dialects/packing.vtk", "dialects/liggghts.pairs", "p.npy", "binary.vtk",
    "binary-zlib.vtu", "appended-zlib-raw.vtp", "appended-plain-base64.vtu",
)  # fmt: skip


def foreign_files(folder):
    """Files of other programs, of 24 to 27 grains."""
    for cases in (CASES, VTK_CASES):
        with tarfile.open(cases) as packed:
            packed.extractall(folder, filter="data")
    state = ss.io.read_packing(folder / "sheared" / "sheared.restart").state
    place, radius = state.grains.position, state.grains.radius
    np.save(folder / "p.npy", np.column_stack([place, radius]))
    head = f"# vtk DataFile Version 3.0\ngrains\nBINARY\nDATASET POLYDATA\nPOINTS {len(place)} double\n".encode()
    data = f"\nPOINT_DATA {len(place)}\nSCALARS radius double 1\nLOOKUP_TABLE default\n".encode()
    (folder / "binary.vtk").write_bytes(head + place.astype(">f8").tobytes() + data + radius.astype(">f8").tobytes())
    return {name: (folder / name).read_bytes() for name in FOREIGN}


def check_foreign(count, folder):
    """Whatever is in a file: a packing, or one sentence, within seconds and a few megabytes."""
    rng, whole, taken = np.random.default_rng(3), foreign_files(folder), 0
    for k in range(count):
        name = FOREIGN[k % len(FOREIGN)]
        content = with_damage(whole[name], rng)
        if rng.random() < 0.2:  # a piece of another format
            other = whole[FOREIGN[rng.integers(len(FOREIGN))]]
            content = content[: len(content) // 2] + other[len(other) // 3 :]
        (folder / name).write_bytes(content)
        given = {"law": "linear", "kn": 1.0, "kt": 1.0, "mu": 0.5, "damping_n": 0.0, "damping_t": 0.0}
        what = folder / "sheared" if name.endswith("log.lammps") else folder / name
        if name.endswith(".pairs"):
            what, given = folder / "dialects" / "liggghts.dump", given | {"contacts": folder / name}
        try:
            with answered(10):
                warnings.simplefilter("ignore", ss.packings.PackingWarning)
                ss.io.read_packing(what, **(given if name.endswith(".pairs") else {}))
        except ValueError as problem:
            assert isinstance(problem, ss.packings.PackingError), (name, problem)
            assert "\n" not in str(problem), problem
        else:
            taken += 1
        (folder / name).write_bytes(whole[name])
    assert 0 < taken < count


def test_some_damaged_files_of_other_programs(tmp_path):
    check_foreign(120, tmp_path)


@pytest.mark.slow
def test_ten_thousand_damaged_files_of_other_programs(tmp_path):
    check_foreign(10_000, tmp_path)


HUGE = base64.b64encode(b"\0\xca\x9a\x3b" + bytes(20))  # a billion bytes in the header of an array
BILLION = {
    "a.vtu": b'<VTKFile type="PolyData"><Piece><Points><DataArray type="Float64" NumberOfComponents="3" '
    b'format="binary">'
    + HUGE + b"</DataArray></Points></Piece></VTKFile>",
    "b.vtu": b'<VTKFile type="PolyData" compressor="vtkZLibDataCompressor"><Piece><Points><DataArray type="Float64" '
    b'NumberOfComponents="3" format="binary">' + HUGE + b"</DataArray></Points></Piece></VTKFile>",
    "a.vtk": b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 1000000000 double\n" + bytes(600),
    "a.xyz": b'1000000000\nProperties=pos:R:3:radius:R:1\n0 0 0 1\n',
    "mercury.data": b"1000000000 0 0 0 0 1 1 1\n0 0 0 0 0 0 1 0 0 0 0 0 0 0\n",
    "a.data": b"x\n\n1000000000 atoms\n0 1 xlo xhi\n0 1 ylo yhi\n0 1 zlo zhi\n\nAtoms # sphere\n\n1 1 1 1 0 0 0\n",
    "a.dump": b"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1000000000\nITEM: BOX BOUNDS pp pp pp\n0 1\n0 1\n0 1\n"
    b"ITEM: ATOMS id x y z radius\n1 0 0 0 1\n",
    "a.npy": b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 4), }".ljust(117)
    + b"\n",
    "a.restart": memory.MAGIC + memory.HEADER_END + memory.BLOCK + struct.pack("<i", 10**9) + bytes(400) + memory.MAGIC,
}  # fmt: skip


@pytest.mark.parametrize("name", BILLION)
def test_a_billion_grains_in_a_kilobyte_are_refused_before_memory_is_taken(name, tmp_path):
    (tmp_path / name).write_bytes(BILLION[name])
    tracemalloc.start()
    with pytest.raises(ss.packings.PackingError), answered(5):
        ss.io.read_packing(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


@pytest.mark.slow
def test_ten_thousand_mutated_scenarios(tmp_path, capsys):
    check_scenarios(10_000, tmp_path, capsys)


@pytest.mark.slow
def test_ten_thousand_mutated_packings(tmp_path, capsys):
    check_packings(10_000, tmp_path, capsys)


@pytest.mark.parametrize("name", ["p.npz", "p.h5", "s.toml", "s.json"])
def test_nothing_of_a_file_is_executed(name, tmp_path, capsys):
    """Pickles and code are words like any others."""
    path, made = tmp_path / name, tmp_path / "made"
    if name == "p.npz":
        np.savez(path, position=np.array([_Evil(str(made))], object), radius=np.ones(1))
    elif name == "p.h5":
        import pickle

        path.write_bytes(pickle.dumps(_Evil(str(made))))
    else:
        word = f"__import__('pathlib').Path({str(made)!r}).touch()"
        path.write_text(json.dumps({"seed": word}) if name == "s.json" else f"seed = {json.dumps(word)}")
    arguments = ["stability", path, "--json"] if name.startswith("p") else ["cite", path]
    assert ended(arguments, capsys) == 2
    assert not made.exists()


class _Evil:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        import pathlib

        return pathlib.Path.touch, (pathlib.Path(self.path),)
