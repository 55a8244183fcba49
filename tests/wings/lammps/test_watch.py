"""`stickslip watch`: the numbers of `stability` and `ss.measure`, resumed, ended, with what is missing said."""

import csv
import json
from itertools import islice

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.exchange import lammps_series as follow
from stickslip.data.exchange.lammps_series import open_source
from stickslip.data.sample import PackingError
from stickslip.solve.freedom import ZERO_BELOW, backbone, dynamical_matrix
from stickslip.solve.spectrum import softest_eigenvalue
from stickslip.wings.lammps import watch as watching
from stickslip.wings.lammps.watch import watch
from stickslip.wings.lammps.watch_record import describe, read_rows, watched_stress, write_rows
from tests.conftest import stickslip_here
from tests.exchange.packings import SHARP, spheres

from .dumps import LAW, SHEARED, STEPS, WORDS, copy, frames, simulate


def table_of(path) -> list[dict]:
    text = path.read_text().partition("\n")[2].splitlines()
    return list(csv.DictReader(text))


@pytest.mark.parametrize("damping", ["0.0", "0.3"])
def test_numbers_are_those_of_stability_and_measure(damping, tmp_path):
    arguments = [*WORDS[:-3], damping, "--damping-t", "0.0"]
    run = stickslip_here("watch", SHEARED, *arguments, "--once", "--out", "w.csv", "-q", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["w.csv", "w.html"]
    rows = table_of(tmp_path / "w.csv")
    assert [int(row["step"]) for row in rows] == STEPS
    options = LAW | {"damping_n": float(damping)}
    for row in rows:
        files = {"contacts": SHEARED / "contacts.dump", "frame": row["step"]}
        state, law, _ = ss.io.read_packing(SHEARED / "grains.dump", **files, **options)
        assert float(row["pressure"]) == pytest.approx(ss.measure.pressure(state, law), rel=1e-12)
        tensor = [[float(row[f"stress_{a}{b}"]) for b in "xyz"] for a in "xyz"]
        np.testing.assert_allclose(tensor, ss.measure.stress(state, law), rtol=1e-12)
        assert float(row["coordination"]) == ss.measure.coordination(state)
        assert int(row["contacts"]) == len(ss.measure.touching(state))
        assert int(row["sliding"]) == (state.contacts.mode[ss.measure.touching(state)] == ss.SLIDE).sum()
        assert float(row["residual"]) == pytest.approx(ss.measure.imbalance(state, law), rel=1e-9)
        low = ss.spectrum(state, law).eigenvalues
        low = low[np.abs(low) > ZERO_BELOW * np.abs(low).max()].real.min()
        assert float(row["softest"]) == pytest.approx(low, rel=1e-8)
    row = rows[1]
    command = ["stability", SHEARED / "grains.dump", "--contacts", SHEARED / "contacts.dump", "--frame", row["step"]]
    known = json.loads(stickslip_here(*command, *arguments, "--json", cwd=tmp_path).stdout)
    assert row["verdict"] == known["verdict"]
    assert row["stable"] == str(known["stable"])
    assert int(row["pairs"]) == len(known["pairs"])
    assert int(row["zero_modes"]) == known["zero_modes"]
    if damping == "0.0":
        assert known["pairs"]
        assert float(row["growth_rate"]) == pytest.approx(known["pairs"][0]["growth_rate"], rel=1e-9)
        assert float(row["omega"]) == pytest.approx(known["pairs"][0]["omega"], rel=1e-9)


@pytest.mark.parametrize("seed", [0, 3])
def test_the_softest_eigenvalue_is_that_of_the_whole_spectrum(seed):
    """By shift and invert, and by LAPACK of a small matrix."""
    state = spheres(seed, motion=False)
    matrix = dynamical_matrix(state, SHARP, backbone(state, SHARP))
    for part in (matrix, matrix[:90, :90]):
        values = np.linalg.eigvals(part.toarray())
        values = values[np.abs(values) > ZERO_BELOW * np.abs(values).max()]
        assert softest_eigenvalue(part).real == pytest.approx(values.real.min(), rel=1e-7)


def test_a_running_simulation_is_watched_to_its_end(tmp_path):
    """The page reloads itself while the simulation runs, and no longer afterwards; no frame is missed."""
    folder, seen = tmp_path / "run", []
    writer = simulate(folder)
    source = open_source(folder, **LAW)
    for done in watch(source, {}, until_idle=1.0, interval=0.01):
        seen.append(done)
    writer.join()
    assert sorted(seen[-1].rows) == STEPS
    assert not seen[-1].live
    assert all(done.live for done in seen[:-1])
    assert seen[-1].notes == ()
    once = list(watch(open_source(SHEARED, **LAW), {}, once=True))[-1]
    assert once.rows == seen[-1].rows


def test_the_newest_frame_comes_first_and_the_others_are_reported(tmp_path):
    source = open_source(SHEARED, **LAW)
    some = list(islice(watch(source, {}), 6))
    assert [done.fresh.step for done in some if done.fresh] == STEPS[::-1]
    assert [(done.at, done.left) for done in some if done.at is not None] == [(80000, 3), (40000, 2), (0, 1)]


def test_frames_in_the_table_are_not_computed_again(tmp_path, monkeypatch):
    folder = copy(tmp_path / "run")
    call = ("watch", folder, *WORDS, "--once", "-q")
    assert stickslip_here(*call).returncode == 0
    before = (folder / "watch.csv").read_bytes()
    computed, measure = [], watching.measure_frame

    def count(step, *given, **more):
        computed.append(step)
        return measure(step, *given, **more)

    monkeypatch.setattr(watching, "measure_frame", count)
    assert stickslip_here(*call).returncode == 0
    assert computed == []
    assert (folder / "watch.csv").read_bytes() == before
    moved = frames("grains.dump")[2].replace(b"\n80000\n", b"\n40000\n")  # another frame in place of the second
    local = frames("contacts.dump")[2].replace(b"\n80000\n", b"\n40000\n")
    for name, part in (("grains.dump", moved), ("contacts.dump", local)):
        parts = frames(name)
        (folder / name).write_bytes(parts[0] + part + parts[2])
    assert stickslip_here(*call).returncode == 0
    assert computed == [40000]
    run = stickslip_here("watch", folder, *WORDS[:-5], "0.3", *WORDS[-4:], "--once")
    assert run.returncode == 2
    assert "computed with another law" in run.stderr
    assert run.stderr.count("\n") == 1


def test_a_table_comes_back_as_it_was_written(tmp_path):
    source = open_source(SHEARED, **LAW)
    how = describe(source, "auto")
    rows = list(watch(source, {}, once=True))[-1].rows
    rows = rows | {5: watching.Row(5, "x", note='damaged, "quite"')}
    write_rows(tmp_path / "t.csv", rows, how)
    assert read_rows(tmp_path / "t.csv", how) == {step: row for step, row in rows.items() if step != 5}
    with pytest.raises(ValueError, match=r"was computed with another law \(hertz_.*\): give another --out"):
        read_rows(tmp_path / "t.csv", how | {"parameters": [0.0]})  # of a law with the same description
    (tmp_path / "t.csv").write_text("time,friction\n0,1\n")
    with pytest.raises(ValueError, match="is not a table that stickslip watch wrote"):
        read_rows(tmp_path / "t.csv", how)


def test_without_contacts_it_says_what_that_means(tmp_path):
    run = stickslip_here("watch", SHEARED, *WORDS, "--no-contacts", "--once", "--out", "w.csv", cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("without a dump of contacts, slip is unknown")
    assert "unbalanced" in run.stdout
    rows = table_of(tmp_path / "w.csv")
    assert all(row["sliding"] == "" and row["stable"] == "" for row in rows)
    assert "without a dump of contacts" in (tmp_path / "w.html").read_text()


def test_damaged_frames_are_rows_without_numbers(tmp_path):
    folder, parts = copy(tmp_path / "run"), frames("grains.dump")
    ragged = parts[1].rstrip(b"\n").rpartition(b" ")[0] + b"\n"
    (folder / "grains.dump").write_bytes(parts[0] + ragged + parts[2][:-9])
    run = stickslip_here("watch", folder, *WORDS, "--until-idle", "0", "--json")
    assert run.returncode == 0, run.stderr
    answer = json.loads(run.stdout)
    assert answer["frames"] == 2
    assert any("step 40000 is damaged" in note for note in answer["notes"])
    assert any("grains.dump ends in the middle of a frame" in note for note in answer["notes"])
    bad = table_of(folder / "watch.csv")[1]
    assert bad["grains"] == ""
    assert "damaged" in bad["note"]


def test_large_packings_out_of_equilibrium_have_no_spectrum(monkeypatch):
    state, law, _ = ss.io.read_packing(SHEARED / "grains.dump", **LAW)
    monkeypatch.setattr(watching, "DENSE_UP_TO", 100)
    row = watching.measure_frame(1, "", state, law, memory=False)
    assert row.pairs is row.softest is row.stable is None
    assert "no spectrum of 162 coordinates out of equilibrium" in row.note
    assert "not in equilibrium" in row.verdict
    row = watching.measure_frame(1, "", state, law, memory=False, method="fastest")
    assert row.pairs is not None


def test_ctrl_c_ends_with_a_sentence_that_names_the_table(tmp_path, monkeypatch):
    folder = copy(tmp_path / "run")

    def interrupt(seconds):
        assert 'http-equiv="refresh"' in (folder / "watch.html").read_text()
        raise KeyboardInterrupt

    monkeypatch.setattr(watching.time, "sleep", interrupt)
    run = stickslip_here("watch", folder, *WORDS)
    assert run.returncode == 130
    assert f"{folder / 'watch.csv'} has 3 frames, and the same command continues" in run.stderr
    assert run.stderr.count("\n") == 1
    page = (folder / "watch.html").read_text()
    assert 'http-equiv="refresh"' not in page
    assert page.count("data:image/png") == 4
    assert len(table_of(folder / "watch.csv")) == 3


TABLE, NAMES = "# written by stickslip watch 0.2.0", ",".join(watching.Row._fields) + "\n"
EMPTY = frames("grains.dump")[0].partition(b"ITEM: ATOMS")[0].replace(b"ATOMS\n27", b"ATOMS\n0")
LAWLESS = [word for word in WORDS if word not in ("--law", "hertz_mindlin_reff")]


@pytest.mark.parametrize(
    ("spoil", "arguments", "sentence"),
    [
        (lambda d: [p.unlink() for p in d.iterdir()], WORDS, "is empty"),
        (lambda d: [p.rename(p.with_suffix(".txt")).write_text("1 2 3\n") for p in list(d.iterdir())], WORDS,
         "has no LAMMPS text dump of grains"),
        (lambda d: (d / "grains.dump").write_bytes(b"\x1f\x8b\x08rest"), WORDS, "is compressed"),
        (lambda d: (d / "grains.dump").write_bytes(frames("grains.dump")[0].replace(b"radius", b"c_size")), WORDS,
         "radius or diameter is not among them"),
        (lambda d: (d / "contacts.dump").write_bytes(frames("contacts.dump")[0].replace(b" c_pairs[10]", b" ten")),
         WORDS, "i j tx ty tz are needed"),
        (lambda d: (d / "grains.dump").write_bytes(frames("grains.dump")[0][:-9]), WORDS, "has no complete frame"),
        (lambda d: None, LAWLESS, "do not contain the contact law"),
        (lambda d: None, WORDS[:-2], "--damping-t"),
        (lambda d: None, [*WORDS, "--frame", "0"], "--frame does not apply"),
        (lambda d: None, [*WORDS, "--atom-style", "sphere"], "--atom-style does not apply"),
        (lambda d: None, [*WORDS, "--contacts", "others.dump"], "others.dump is not a text file of contacts from "
        "`dump local`"),
        (lambda d: None, [*WORDS, "--method", "fast"], "did you mean 'fastest'?"),
        (lambda d: None, [*WORDS, "--until-idle", "0"], "exclude each other"),
        (lambda d: None, [*WORDS, "--out", "w.txt"], "must end in .csv"),
        (lambda d: (d / "watch.csv").write_text("1,2\n"), WORDS, "is not a table that stickslip watch wrote"),
        (lambda d: (d / "watch.csv").write_text(f"{TABLE}: {{}}\n{NAMES}5,1\n"), WORDS, "is not a table that"),
        (lambda d: (d / "watch.csv").write_text(f"{TABLE}: {{}}\n{NAMES}{'5,' * 40}\n"), WORDS, "is not a table that"),
        (lambda d: (d / "watch.csv").write_text(f"{TABLE}: []\n{NAMES}"), WORDS, "is not a table that"),
        (lambda d: (d / "watch.csv").write_text(f"{TABLE}: 5\n{NAMES}"), WORDS, "is not a table that"),
        (lambda d: (d / "grains.dump").write_bytes(EMPTY + b"ITEM: ATOMS id x y z radius mass vx\n"), WORDS,
         "none of which contain ids of touching grains"),
        (lambda d: (d / "grains.dump").write_bytes(EMPTY + b"ITEM: ATOMS id x y z radius mass vx\n"),
         [*WORDS, "--no-contacts"], "a state needs at least one grain"),
    ],
)  # fmt: skip
def test_bad_input_has_one_sentence(spoil, arguments, sentence, tmp_path, monkeypatch):
    monkeypatch.setattr(follow, "FRESH", 0.0)  # the files look as if they had been there for long
    folder = copy(tmp_path / "run")
    spoil(folder)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    run = stickslip_here("watch", folder, *arguments, "--once", cwd=tmp_path)
    assert run.returncode == 2
    assert sentence in run.stderr
    assert run.stderr.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_folder_without_any_usable_frame_is_refused_in_python_too(tmp_path):
    with pytest.raises(PackingError, match="does not exist"):
        list(ss.io.follow_packings(tmp_path / "none", **LAW))


def test_shear_stress_is_half_the_difference_of_principal_stresses():
    for row in list(watch(open_source(SHEARED, **LAW), {}, once=True))[-1].rows.values():
        tensor = np.array([[getattr(row, f"stress_{a}{b}") for b in "xyz"] for a in "xyz"])
        low, *_, high = np.linalg.eigvalsh(0.5 * (tensor + tensor.T))
        assert row.shear_stress == pytest.approx(0.5 * (high - low))
        assert row.pressure == pytest.approx(np.trace(tensor) / 3)
    figure = watched_stress(np.array([1, 2, 3]), np.array([2.0, 4.0, 0.0]), np.array([1.0, 1.0, 1.0]))
    assert figure.axes[1].lines[0].get_ydata().tolist() == [0.5, 0.25]


@pytest.mark.parametrize("dim", [2, 3])
def test_the_pressure_of_a_frame_is_that_of_the_plane_or_of_space(dim):
    law = ss.laws.hertz_mindlin()
    state, _ = ss.packings.jammed(10, dim=dim, packing_fraction=0.9 if dim == 2 else 0.7, seed=1)
    row = watching._add_stress(watching.Row(0, "x"), state, law)
    assert row.pressure == pytest.approx(ss.measure.pressure(state, law)) and row.pressure > 0
