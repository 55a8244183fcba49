"""GSD: what is ours comes back to the last bit, what others wrote as far as it can, what is broken in one sentence."""

import json
import struct
import subprocess
import sys

import gsd.fl
import gsd.hoomd
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stickslip as ss
from stickslip.data.exchange import arrays

from .packings import SHARP, assert_same, disks, spheres, walled


@pytest.mark.parametrize("make", [lambda: (spheres(), SHARP), lambda: (disks(), SHARP), walled])
def test_our_own_file_is_read_to_the_last_bit(make, tmp_path):
    state, law = make()
    ss.io.write_packing(tmp_path / "p.gsd", state, law)
    back, its_law, notes = ss.io.read_packing(tmp_path / "p.gsd")
    assert not notes
    assert_same(state, back)
    assert its_law[:2] == law[:2]
    assert its_law.damping == law.damping
    assert np.array_equal(its_law.table, law.table)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), flat=st.booleans(), time=st.floats(0, 1e9))
def test_any_packing_comes_back(seed, flat, time, tmp_path_factory):
    state = (disks if flat else spheres)(seed)._replace(time=time)
    path = tmp_path_factory.mktemp("gsd") / "p.gsd"
    ss.io.write_packing(path, state, SHARP)
    assert_same(state, ss.io.read_packing(path)[0])


def test_what_other_programs_see(tmp_path):
    state = spheres()
    assert ss.io.write_packing(tmp_path / "p.gsd", state, SHARP) == []
    with gsd.hoomd.open(tmp_path / "p.gsd") as file:
        (frame,) = list(file)
    rows, c = ss.measure.touching(state), state.contacts
    assert np.array_equal(frame.bonds.group, np.stack([c.i[rows], c.j[rows]], axis=1))
    assert [frame.bonds.types[k] for k in frame.bonds.typeid] == [
        "sliding" if m == ss.SLIDE else "sticking" for m in c.mode[rows]
    ]
    force, branch = ss.measure.contact_forces(state, SHARP)[rows], ss.measure.branch_vectors(state)[rows]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    np.testing.assert_allclose(frame.log["bonds/force_n"], np.einsum("ck,ck->c", force, normal), rtol=1e-12)
    along = frame.log["bonds/force_n"][:, None] * normal + frame.log["bonds/tangential"]
    np.testing.assert_allclose(along, force, atol=1e-15)
    np.testing.assert_allclose(frame.log["bonds/force_t"], np.linalg.norm(frame.log["bonds/tangential"], axis=1))
    # positions in a box around the origin, with images: together they are where the grains are, in single precision
    vectors = state.cell.vectors
    whole = frame.particles.position + frame.particles.image @ vectors + vectors.sum(axis=0) / 2
    np.testing.assert_allclose(whole, state.grains.position, atol=1e-5)
    share = frame.particles.position @ np.linalg.inv(vectors)
    assert np.abs(share).max() < 0.5 + 1e-6
    np.testing.assert_allclose(frame.particles.diameter, 2 * state.grains.radius, rtol=1e-6)
    np.testing.assert_allclose(frame.log["particles/force"], ss.forces(state, SHARP)[0].force[:64])


@pytest.mark.parametrize("make", ["ours", "foreign"])
def test_tilts_are_over_the_edge_that_they_lean_along(make, tmp_path):
    """HOOMD's box: a₂ = (xy L_y, L_y, 0), a₃ = (xz L_z, yz L_z, L_z), with edges that all differ."""
    vectors = np.array([[4.0, 0, 0], [0.9, 5.0, 0], [-0.7, 1.1, 6.0]])
    told = [4.0, 5.0, 6.0, 0.9 / 5.0, -0.7 / 6.0, 1.1 / 6.0]
    state = ss.packings.from_arrays([[1, 1, 1], [1.99, 1, 1]], [0.5, 0.5], SHARP, cell=vectors)
    ss.io.write_packing(tmp_path / "p.gsd", state, SHARP)
    with gsd.hoomd.open(tmp_path / "p.gsd") as file:
        frame = file[0]
    np.testing.assert_allclose(frame.configuration.box, told, rtol=1e-6)  # single precision
    if make == "foreign":
        frame.log.clear()
        with gsd.hoomd.open(tmp_path / "f.gsd", "w") as file:
            file.append(frame)
        back, _, _ = ss.io.read_packing(tmp_path / "f.gsd")
        np.testing.assert_allclose(back.cell.vectors, vectors, rtol=1e-6)


def test_a_foreign_file_gives_what_it_has(tmp_path):
    """Without our chunks: positions, radii, masses, velocities and spins in single precision; no slip, no law."""
    state = disks()
    ss.io.write_packing(tmp_path / "p.gsd", state, SHARP)
    with gsd.hoomd.open(tmp_path / "p.gsd") as ours, gsd.hoomd.open(tmp_path / "f.gsd", "w") as file:
        frame = ours[0]
        frame.log.clear()
        file.append(frame)
    back, _, notes = ss.io.read_packing(tmp_path / "f.gsd", law="linear")
    assert any("was not written by stickslip" in word for word in notes)
    assert not any(word.startswith("undecided") for word in notes)  # its bonds are our contacts
    shift = back.grains.position - state.grains.position
    shift -= shift[0]
    np.testing.assert_allclose(shift - np.round(shift / 5.7) * [5.7, 5.7, 0], 0, atol=1e-5)
    for name in ("radius", "mass", "inertia", "velocity", "spin"):
        np.testing.assert_allclose(getattr(back.grains, name), getattr(state.grains, name), rtol=1e-5, atol=1e-9)
    assert back.cell.dim == 2
    assert not back.contacts.slip.any()
    _, _, notes = ss.io.read_packing(tmp_path / "f.gsd")
    assert any("the contact law is missing" in word for word in notes)


def test_spins_of_turned_grains_are_read(tmp_path):
    """HOOMD's angular momentum is in the frame of the grain: a grain that was turned has its spin turned back."""
    turn = arrays.quaternion(np.array([[0.3, -0.5, 0.7], [0.0, 0.0, 0.0]]))
    spin, inertia = np.array([[1.0, 2.0, 3.0], [0.5, 0.0, -1.0]]), 0.1
    inverse = turn * [1, -1, -1, -1]
    body = arrays.quaternion_product(arrays.quaternion_product(inverse, np.pad(spin, ((0, 0), (1, 0)))), turn)
    frame = gsd.hoomd.Frame()
    frame.configuration.box = [5, 5, 5, 0, 0, 0]
    p = frame.particles
    p.N, p.position, p.diameter, p.orientation = 2, [[0, 0, 0], [2, 0, 0]], [1.0, 1.2], turn
    p.moment_inertia = np.full((2, 3), inertia)
    p.angmom = 2 * arrays.quaternion_product(turn, inertia * body)
    with gsd.hoomd.open(tmp_path / "f.gsd", "w") as file:
        file.append(frame)
    back, _, _ = ss.io.read_packing(tmp_path / "f.gsd")
    np.testing.assert_allclose(back.grains.spin, spin, rtol=1e-5)


@pytest.mark.parametrize(("part", "text"), [("bonds", "part bonds of the file"), ("charge", "charges repel")])
def test_forces_that_a_foreign_file_tells_of_are_not_left_out_silently(part, text, tmp_path):
    frame = gsd.hoomd.Frame()
    frame.particles.N, frame.particles.position = 2, [[0, 0, 0], [0.99, 0, 0]]
    frame.particles.diameter, frame.configuration.box = [1, 1], [9, 9, 9, 0, 0, 0]
    if part == "bonds":
        frame.bonds.N, frame.bonds.group = 1, [[0, 1]]
    else:
        frame.particles.charge = [1, -1]
    with gsd.hoomd.open(tmp_path / "f.gsd", "w") as file:
        file.append(frame)
    assert any(text in note and note.startswith("undecided") for note in ss.io.read_packing(tmp_path / "f.gsd").assumed)


def test_frames_are_chosen(tmp_path):
    states = [spheres(k) for k in range(3)]
    ss.io.write_packing(tmp_path / "p.gsd", [ss.io.frame_of(state, SHARP) for state in states])
    assert_same(states[1], ss.io.read_packing(tmp_path / "p.gsd", frame="1")[0])
    last, _, notes = ss.io.read_packing(tmp_path / "p.gsd")
    assert_same(states[2], last)
    assert "p.gsd has 3 frames: the last, 2, is used; choose another with --frame" in notes
    for state, (_, back, _, _) in zip(states, ss.io.read_packings(tmp_path / "p.gsd"), strict=True):
        assert_same(state, back)
    with pytest.raises(ss.packings.PackingError, match=r"no frame '7': it has 0, 1, 2"):
        ss.io.read_packing(tmp_path / "p.gsd", frame="7")


CUT = """
import sys
import stickslip as ss
whole = open(sys.argv[1], "rb").read()
for share in range(0, 100, 5):
    path = sys.argv[1] + "-cut.gsd"
    open(path, "wb").write(whole[: len(whole) * share // 100])
    try:
        ss.io.read_packing(path)
        print("read", share)
    except ss.packings.PackingError as problem:
        assert "\\n" not in str(problem)
"""


def test_truncated_files_are_refused(tmp_path):
    """In a process of its own: a reader in C could end it."""
    ss.io.write_packing(tmp_path / "p.gsd", spheres(), SHARP)
    done = subprocess.run([sys.executable, "-c", CUT, str(tmp_path / "p.gsd")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not done.stdout


def rewritten(path, change):
    """The file with another meta chunk."""
    with gsd.hoomd.open(path) as file:
        frame, names = file[0], file.file.find_matching_chunk_names("stickslip/")
        chunks = {name: file.file.read_chunk(0, name) for name in names}
    meta = json.loads(chunks[arrays.META].tobytes())
    change(meta, chunks)
    chunks[arrays.META] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    with gsd.hoomd.open(path, "w") as file:
        for name, chunk in chunks.items():
            file.file.write_chunk(name, chunk)
        file.append(frame)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda meta, chunks: meta.update(schema=9), "has stickslip GSD schema 9"),
        (lambda meta, chunks: meta.pop("law"), "cannot be read"),
        (lambda meta, chunks: meta["law"].update(table=[[[1, 2]]]), "law's table"),
        (lambda meta, chunks: meta["shapes"].update({"grains/radius": ["|O", [64]]}), "has type object"),
        (lambda meta, chunks: meta["shapes"].update({"grains/radius": ["<f8", [65]]}), "cannot be read"),
        (lambda meta, chunks: chunks["stickslip/contacts/j"].__setitem__(0, 9999), r"contacts\.j\[0\] is 9999"),
        (lambda meta, chunks: chunks["stickslip/contacts/key"].__setitem__(0, 1), "not sorted"),
        (lambda meta, chunks: chunks["stickslip/grains/position"].__setitem__(0, np.nan), "NaN"),
    ],
)
def test_files_of_another_kind_are_refused(change, message, tmp_path):
    ss.io.write_packing(tmp_path / "p.gsd", spheres(), SHARP)
    rewritten(tmp_path / "p.gsd", change)
    with pytest.raises(ss.packings.PackingError, match=message) as problem:
        ss.io.read_packing(tmp_path / "p.gsd")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [
        (16, 2**63 + 128, "declares an index of 9223372036854775936 entries and 32 names"),  # 0 bytes, modulo 2**64
        (32, 2**58 + 1, "128 entries and 288230376151711745 names"),
        (256 + 8, 2**61, "a chunk is declared beyond the end"),  # rows of the first chunk
        (256 + 16, 2**63, "a chunk is declared beyond the end"),  # its place
    ],
)
def test_numbers_of_the_header_and_the_index_are_checked_before_the_library_trusts_them(at, value, message, tmp_path):
    """It read beyond the end of memory, and the process ended."""
    ss.io.write_packing(tmp_path / "p.gsd", spheres(), SHARP)
    content = bytearray((tmp_path / "p.gsd").read_bytes())
    assert struct.unpack_from("<Q", content, 8)[0] == 256
    struct.pack_into("<Q", content, at, value)
    (tmp_path / "p.gsd").write_bytes(content)
    with pytest.raises(ss.packings.PackingError, match=message):
        ss.io.read_packing(tmp_path / "p.gsd")


@pytest.mark.parametrize("of", ["particles", "bonds", "frames", "chunks"])
def test_a_small_file_does_not_fill_the_memory(of, tmp_path):
    """All but the number of particles may be left out, frames repeat the first one, and chunks may overlap."""
    path, many = tmp_path / "p.gsd", 1000
    with gsd.fl.open(path, "w", "made", "hoomd", [1, 4]) as file:
        file.write_chunk(
            "bonds/N" if of == "bonds" else "particles/N", np.array([2000 if of == "frames" else 2**30], "u4")
        )
        for name in range(many if of == "chunks" else 0):
            file.write_chunk(f"log/{name}", np.zeros(1 if name else 20_000))
        for k in range(many if of == "frames" else 1):
            file.write_chunk("configuration/step", np.array([k + 1], "u8"))
            file.end_frame()
    if of == "chunks":
        content = np.fromfile(path, np.uint8)
        start, number = content[8:24].view("<u8")
        index = content[start : start + number * arrays.ENTRY.itemsize].view(arrays.ENTRY)
        index["rows"][1:many], index["at"][1:many] = index["rows"][1], index["at"][1]
        content.tofile(path)
    what = {"frames": "particles", "chunks": "frame 0"}.get(of, of)
    with pytest.raises(ss.packings.PackingError, match=f"up to its {what} it would need more than"):
        ss.io.read_packings(path, law=SHARP)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "it is empty"),
        (b"no gsd at all", "it begins with 'no gsd at all'"),
        (b"\xdf\x65\xdf\x65\xdf\x65\xdf\x65" + bytes(300), "cannot be read as GSD"),
    ],
)
def test_what_is_no_gsd_is_refused(content, message, tmp_path):
    (tmp_path / "p.gsd").write_bytes(content)
    with pytest.raises(ss.packings.PackingError, match=message):
        ss.io.read_packing(tmp_path / "p.gsd")
