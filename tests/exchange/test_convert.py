"""The commands: convert between formats, stability of what was read, and a mode as an animation."""

import json

import gsd.hoomd
import numpy as np
import pytest

import stickslip as ss
from stickslip.data import archive
from stickslip.data.exchange.frame import bounding_box
from stickslip.loading.packing import jammed
from stickslip.loading.protocols import ramp
from stickslip.loading.quasistatic import aqs
from stickslip.loading.reading import convert
from stickslip.solve.freedom import dynamical_matrix
from tests.conftest import stickslip_here as run

from .packings import SHARP, assert_same, disks, spheres, walled

SMOOTH = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")


@pytest.fixture(scope="module")
def unstable():
    """Thirty spheres, sheared until there are complex pairs."""
    state, _ = jammed(30, packing_fraction=0.7, seed=2)
    path = ramp(state, np.arange(0, 21) * 1e-3, aqs(SMOOTH))
    return max(path, key=lambda p: len(p.spectrum.pairs)).state


@pytest.mark.parametrize("tension", [True, False])
@pytest.mark.parametrize("name", ["p.npz", "p.gsd"])
def test_files_keep_whether_dashpots_pull(name, tension, tmp_path):
    law = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2, damping_n=0.3, damping_t=0.2, tension=tension, coulomb="sharp")
    assert not any("dashpots" in note for note in ss.io.write_packing(tmp_path / name, spheres(), law))
    assert ss.io.read_packing(tmp_path / name)[1].damping == law.damping


@pytest.mark.parametrize("make", [spheres, disks])
def test_npz_keeps_state_motion_and_law(make, tmp_path):
    state = make()
    assert ss.io.write_packing(tmp_path / "p.npz", state, SHARP) == []
    back, law, notes = ss.io.read_packing(tmp_path / "p.npz")
    assert not notes
    assert np.array_equal(law.table, SHARP.table)
    assert law[:2] == SHARP[:2]
    assert law.damping == SHARP.damping
    for name in ("position", "radius", "mass", "velocity", "spin", "angle"):
        assert np.array_equal(getattr(back.grains, name), getattr(state.grains, name))
    np.testing.assert_allclose(back.grains.inertia, state.grains.inertia, rtol=1e-15)
    c, d = back.contacts, state.contacts
    mine, theirs = ss.measure.touching(back), ss.measure.touching(state)
    assert np.array_equal(c.key[mine], d.key[theirs])
    assert np.array_equal(c.mode[mine], d.mode[theirs])
    np.testing.assert_allclose(c.slip[mine], d.slip[theirs], atol=1e-17)
    np.testing.assert_allclose(ss.forces(back, law)[0].force, ss.forces(state, SHARP)[0].force, atol=1e-14)


@pytest.fixture
def cemented():
    """A row of three spheres, bonded across gaps, the last bond broken."""
    row = ss.packings.from_arrays([[0, 0, 0], [1.01, 0, 0], [2.02, 0, 0]], np.full(3, 0.5), SHARP)
    row = ss.packings.bonded(row, ss.laws.parallel_bond(3.0, 1.0, 2e-3, 4e-3), within=0.02)
    row = row._replace(bonds=row.bonds._replace(intact=np.array([True, False]), failed=np.array([0, 1], np.int8)))
    return ss.accept(row, ss.forces(row, SHARP)[1])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"bond_arm": None}, "has 'bond_angle_i' but not 'bond_arm': bonds need all of"),
        ({"bond_j": np.array([1, 7], np.int32)}, "bonds.j"),
        ({"bond_length": np.zeros(2)}, "length"),
        ({"bond_turn": np.ones((2, 3))}, "turn"),
        ({"bond_i": np.array([0.5, 1.5])}, "bonds.i"),
        ({"bond_strength": np.full((2, 4), np.nan)}, "strength"),
    ],
)
def test_bonds_of_npz_that_cannot_be_are_named(cemented, wrong, words, tmp_path):
    ss.io.write_packing(tmp_path / "p.npz", cemented, SHARP)
    arrays = dict(np.load(tmp_path / "p.npz")) | wrong
    np.savez(tmp_path / "q.npz", **{name: values for name, values in arrays.items() if values is not None})
    with pytest.raises(ss.packings.PackingError, match=words) as caught:
        ss.io.read_packing(tmp_path / "q.npz")
    assert "\n" not in str(caught.value) and "q.npz" in str(caught.value)


@pytest.mark.parametrize("name", ["b.h5", "b.gsd"])
def test_whole_formats_keep_everything(name, tmp_path):
    state, law = walled()
    ss.io.write_packing(tmp_path / "a.gsd", state, law)
    convert(tmp_path / "a.gsd", tmp_path / name)
    back, its_law, _ = ss.io.read_packing(tmp_path / name)
    assert np.array_equal(its_law.table, law.table)
    for noun in ("grains", "walls", "cell", "control"):
        for field, x in getattr(state, noun)._asdict().items():
            assert np.array_equal(x, getattr(getattr(back, noun), field)), (noun, field)
    assert np.array_equal(ss.forces(back, law)[0].force, ss.forces(state, law)[0].force)


def test_all_states_of_an_archive_become_a_trajectory(tmp_path):
    states = [spheres(k) for k in range(3)]
    archive.write(tmp_path / "a.h5", {"law": SHARP, "frames": {f"{k}": s for k, s in enumerate(states)}})
    convert(tmp_path / "a.h5", tmp_path / "t.gsd")
    back = ss.io.read_packings(tmp_path / "t.gsd")
    assert len(back) == 3
    for state, (_, again, _, _) in zip(states, back, strict=True):
        assert np.array_equal(state.grains.position, again.grains.position)
    convert(tmp_path / "a.h5", tmp_path / "one.npz", frame="frames/1")
    with pytest.raises(ss.packings.PackingError, match=r"3 states cannot be written as \.npz"):
        convert(tmp_path / "a.h5", tmp_path / "all.npz")
    assert not (tmp_path / "all.npz").exists()


def test_three_commands_make_an_animation(unstable, tmp_path):
    ss.io.write_packing(tmp_path / "p.npz", unstable, SMOOTH)
    done = run("convert", str(tmp_path / "p.npz"), "--to", str(tmp_path / "p.gsd"))
    assert done.returncode == 0, done.stderr
    done = run("stability", str(tmp_path / "p.gsd"), "--modes", str(tmp_path / "m.npz"))
    assert done.returncode == 0, done.stderr
    assert "oscillatory instability" in done.stdout
    done = run(
        "convert", str(tmp_path / "p.gsd"), "--modes", str(tmp_path / "m.npz"), "--frames", "16", "--amplitude", "0.2",
        "--to", str(tmp_path / "mode.gsd"),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "mode.gsd" in done.stdout
    with gsd.hoomd.open(tmp_path / "mode.gsd") as file:
        moves = np.array([frame.log["particles/displacement"] for frame in file])
        assert (file[0].bonds.group == file[9].bonds.group).all()
    assert len(moves) == 16
    # one period of an oscillation: its mean vanishes, and no grain goes beyond a fifth of its radius
    assert np.abs(moves.mean(axis=0)).max() < 1e-12
    share = np.linalg.norm(moves, axis=2).max(axis=0) / unstable.grains.radius
    assert 0.1 < share.max() <= 0.2
    done = run("stability", str(tmp_path / "mode.gsd"))
    assert done.returncode == 2
    assert "animation of a mode" in done.stderr


def test_the_animation_is_what_the_linearised_motion_does(unstable):
    """M q̈ = J q for q = Re(mode exp(st)): second differences of a growing animation against the Jacobian."""
    result = ss.stability(unstable, SMOOTH)
    mode, free = result.modes[:, 0], result.free
    full = free.spread(mode)
    s = complex(-1j * np.sqrt(result.pairs[0]))
    assert s.real > 0
    frames = ss.io.mode_frames(
        ss.io.frame_of(unstable, SMOOTH), full[:, :3], full[:, 3:], s, count=400, amplitude=1e-3, grow=True
    )
    q = np.array(
        [np.hstack([f.grains["displacement"], f.grains["rotation"] * unstable.grains.radius[:, None]]) for f in frames]
    )
    times = np.array([f.state.time for f in frames]) - unstable.time
    dt, period = times[1], 2 * np.pi / abs(s.imag)
    unit = 1e-3 / (np.linalg.norm(full[:, :3], axis=1) / unstable.grains.radius).max()  # reached after a period
    np.testing.assert_allclose(
        q, unit * np.real(full * np.exp(s * times - s.real * period)[:, None, None]), atol=1e-9 * np.abs(q).max()
    )
    turned = np.array([f.state.grains.angle - unstable.grains.angle for f in frames])
    np.testing.assert_allclose(turned * unstable.grains.radius[:, None], q[..., 3:], atol=1e-9 * np.abs(q).max())
    bend = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
    root = np.sqrt(free.mass)
    pull = -(dynamical_matrix(unstable, SMOOTH, free) @ (root * q[1:-1].reshape(398, -1)[:, free.component]).T).T / root
    np.testing.assert_allclose(bend.reshape(398, -1)[:, free.component], pull, atol=2e-4 * np.abs(pull).max())


def test_with_dashpots_the_damped_spectrum_answers(unstable, tmp_path):
    ss.io.write_packing(tmp_path / "p.npz", unstable, SMOOTH)
    options = ["stability", str(tmp_path / "p.npz"), "--law", "hertz_mindlin", "--coulomb", "smooth", "--kn", "1"]
    options += ["--kt", str(2 / 7), "--mu", "10", "--damping-n", "1e-3", "--damping-t", "5e-4"]
    done = run(*options, "--modes", str(tmp_path / "m.npz"))
    assert done.returncode == 0, done.stderr
    assert "spectrum: damped" in done.stdout
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth", damping_n=1e-3, damping_t=5e-4)
    truth = ss.modes.damped_growth(unstable, law)
    fastest = truth[truth.real.argmax()]
    done = run(*options, "--json")
    answer = json.loads(done.stdout)
    assert answer["spectrum"] == "damped"
    assert answer["pairs"][0]["growth_rate"] == pytest.approx(fastest.real, rel=1e-6)
    assert np.load(tmp_path / "m.npz")["exponent"][0].real == pytest.approx(fastest.real, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["convert", "{p}", "--to", "{d}/x.gds"], "did you mean '.gsd'"),
        (["convert", "{p}", "--to", "{p}"], "would replace its own input file"),
        (["convert", "{p}", "--to", "{d}/no/x.gsd"], "does not exist: create it first"),
        (["convert", "{d}/none.npz", "--to", "{d}/x.gsd"], "is not a file"),
        (["convert", "{p}", "--to", "{d}/x.gsd", "--modes", "{d}/none.npz"], "is not a file"),
        (["convert", "{p}", "--to", "{d}/x.gsd", "--modes", "{p}"], "contains no modes"),
        (["convert", "{p}", "--to", "{d}/x.gsd", "--frame", "3"], "which has only one state"),
        (["stability", "{p}", "--contacts", "{p}"], "this option is for LAMMPS data and dump files"),
        (["stability", "{p}", "--young", "1"], "young and poisson must be given together"),
        (["stability", "{p}", "--damping-n", "-1"], "not negative"),
    ],
)
def test_bad_input_ends_with_code_2_and_one_sentence(arguments, said, tmp_path):
    path = tmp_path / "p.npz"
    ss.io.write_packing(path, disks(), SHARP)
    done = run(*(word.format(p=path, d=tmp_path) for word in arguments))
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["p.npz"]


def test_modes_of_another_packing_are_refused(unstable, tmp_path):
    np.savez(tmp_path / "m.npz", exponent=np.ones(1), translation=np.ones((1, 3, 3)), rotation=np.ones((1, 3, 3)))
    with pytest.raises(ss.packings.PackingError, match="modes of 3 grains, but the packing has 30"):
        ss.io.read_mode(tmp_path / "m.npz", 0, 30)
    with pytest.raises(ss.packings.PackingError, match=r"mode 5 does not exist: .* has modes 0 to 0"):
        ss.io.read_mode(tmp_path / "m.npz", 5, 3)


def test_nothing_is_executed(tmp_path):
    """Pickles in numpy files are refused before they are looked at."""
    np.savez(tmp_path / "p.npz", position=np.array([print], object), radius=np.ones(1))
    with pytest.raises(ss.packings.PackingError, match=r"cannot be read as \.npz"):
        ss.io.read_packing(tmp_path / "p.npz")
    with pytest.raises(ss.packings.PackingError, match="contains no modes"):
        ss.io.read_mode(tmp_path / "p.npz", 0, 1)


@pytest.mark.parametrize("name", ["p.npz", "p.h5", "p.gsd", "p.data", "m.npz"])
def test_truncated_files_end_with_one_sentence(name, tmp_path):
    ss.io.write_packing(tmp_path / name.replace("m.", "p."), spheres(), SHARP)
    modes = {"exponent": np.ones(1), "translation": np.ones((1, 64, 3)), "rotation": np.ones((1, 64, 3))}
    np.savez_compressed(tmp_path / "m.npz", **modes)
    path = tmp_path / name
    whole = path.read_bytes()
    for share in (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=name) as problem:
            ss.io.read_mode(path, 0, 64) if name == "m.npz" else ss.io.read_packing(path, law="linear")
        assert "\n" not in str(problem.value)


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "p.gsd"
    ss.io.write_packing(path, disks(), SHARP)
    before = path.read_bytes()
    broken = ss.io.frame_of(disks(1), SHARP)
    broken.grains["force"] = np.zeros((2, 2, 2, 2))
    with pytest.raises(ValueError, match="GSD"):
        ss.io.write_packing(path, [broken])
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["p.gsd"]


def test_a_state_keeps_its_sliding_contacts(tmp_path):
    """Read again, a contact at the Coulomb limit is still there, whatever round-off says."""
    state = spheres()
    for name in ("p.npz", "p.h5", "p.gsd"):
        ss.io.write_packing(tmp_path / name, state, SHARP)
        back, _, _ = ss.io.read_packing(tmp_path / name)
        assert (back.contacts.mode == ss.SLIDE).sum() == (state.contacts.mode == ss.SLIDE).sum() > 5
    assert_same(state, back)


@pytest.mark.parametrize("end", ["h5", "gsd"])
def test_the_memory_of_a_run_comes_back_to_the_last_bit(end, tmp_path):
    """Sums may be rounded otherwise where products are contracted, or where a contact crosses two tilted sides."""
    start, _ = jammed(30, packing_fraction=0.7, seed=2)
    grains = start.grains._replace(radius=0.998 * start.grains.radius, spin=1e-3 * start.grains.position)
    start = ss.packings.strained(start._replace(grains=grains), [[0, 0.05, 0.02], [0, 0, 0.03], [0, 0, 0]])
    state, _, _ = ss.run(start, SHARP, 20, 0.05)
    path = tmp_path / f"p.{end}"
    ss.io.write_packing(path, state, SHARP)
    back = ss.io.read_packing(path).state
    for name in ("slip", "mode", "pair", "roll"):
        assert getattr(back.contacts, name).tobytes() == getattr(state.contacts, name).tobytes(), name


def test_numbers_that_are_given_change_the_law_of_an_archive(tmp_path):
    state, law = spheres(), SHARP
    ss.io.write_packing(tmp_path / "p.h5", state, law)
    with pytest.warns(ss.packings.PackingWarning, match="slip beyond the Coulomb limit at 20 contacts"):
        mine = ss.io.read_packing(tmp_path / "p.h5", mu=0.123).law
    assert (mine.kind, mine.coulomb, mine.properties) == (law.kind, law.coulomb, law.properties)
    assert mine.table[0, 0].tolist() == [*law.table[0, 0, :2].tolist(), 0.123, *law.table[0, 0, 3:].tolist()]


def test_the_box_of_an_open_state_encloses_all_grains():
    state = ss.assembly(ss.spheres([[0, 0, 0], [3, 1, 0.2]], [0.5, 0.7]), cell=ss.box([1.0] * 3, [False] * 3, 3))
    vectors, corner = bounding_box(state, "x")
    reach = state.grains.radius[:, None]
    assert (corner < state.grains.position - reach).all()
    assert (corner + np.diag(vectors) > state.grains.position + reach).all() and not np.triu(vectors, 1).any()
