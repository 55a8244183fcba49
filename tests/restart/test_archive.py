"""What an archive holds comes back; what cannot be read is refused in one sentence; nothing is left half-written."""

import shutil
import warnings
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import stickslip as ss
from stickslip.core.state import PER_PAIR
from stickslip.data import archive
from tests.conftest import make_law, make_packing, stickslip_here, stirred

words = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)
numbers = st.one_of(st.floats(), st.integers(-(2**62), 2**62), st.booleans(), st.complex_numbers())
arrays = hnp.arrays(st.sampled_from(["f8", "i8", "i4", "bool", "c16"]), hnp.array_shapes(min_side=0, max_side=4))
leaves = st.one_of(numbers, arrays, words, st.none())
names = st.text("abcdefgh_ .-", min_size=1, max_size=6).filter(lambda name: name.strip("."))
trees = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.dictionaries(names, inner, max_size=3),
        st.dictionaries(st.floats(allow_nan=False), inner, max_size=3),
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
    ),
    max_leaves=8,
)


class Inner(NamedTuple):
    rate: float
    words: tuple[str, ...]


class Outer(NamedTuple):
    values: np.ndarray
    inner: Inner | None
    by_load: dict


def same(one, two):
    if isinstance(one, np.ndarray) and one.ndim:
        return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
    if isinstance(one, dict):
        return list(map(repr, sorted(one, key=repr))) == list(map(repr, sorted(two, key=repr))) and all(
            same(one[key], two[key]) for key in one
        )
    if isinstance(one, tuple | list):
        return type(one) is type(two) and len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, np.ndarray):
        one = one.item()
    return type(one) is type(two) and (one == two or one != one)


@given(st.dictionaries(names, trees, max_size=3))
def test_any_tree_comes_back(tmp_path_factory, tree):
    path = tmp_path_factory.mktemp("tree") / "tree.h5"
    archive.write(path, tree)
    assert same(tree, archive.read(path))


def test_states_and_results_come_back_as_what_they_were(tmp_path):
    law = make_law("hertz_mindlin", "smooth")
    state = stirred(make_packing(3), law, np.random.default_rng(0))
    result = Outer(np.arange(3.0), Inner(0.5, ("one", "")), {0.03: Inner(np.nan, ()), -1.0: None})
    archive.write(tmp_path / "a.h5", {"state": state, "law": law, "result": result}, scenario="text", version="0")
    tree = archive.read(tmp_path / "a.h5", nouns=(Outer, Inner))
    assert isinstance(tree["state"], ss.State)
    assert same(tuple(state._replace(contacts=archive.trimmed(state.contacts))), tuple(tree["state"]))
    assert same(tuple(result), tuple(tree["result"]))
    assert isinstance(tree["result"].by_load[0.03], Inner)
    assert archive.read(tmp_path / "a.h5")["result"]["inner"]["rate"] == 0.5  # who has no classes gets dictionaries
    assert archive.attributes(tmp_path / "a.h5")["scenario"] == "text"
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["state/grains/velocity"].attrs["units"] == "length/time"


def test_the_same_tree_gives_the_same_bytes(tmp_path):
    for name in ("a.h5", "b.h5"):
        archive.write(tmp_path / name, {"x": np.arange(5000.0), "words": "a"}, scenario="s")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_bytes_do_not_depend_on_whether_a_part_was_computed_or_read(tmp_path):
    """What is read comes back in the order of names."""
    tree = {"z": Inner(0.5, ("one",)), "loads": {2.0: np.arange(3.0), 0.5: None}, "a": {"c": 1, "b": 2}}
    archive.write(tmp_path / "a.h5", tree)
    archive.write(tmp_path / "b.h5", archive.read(tmp_path / "a.h5", nouns=(Inner,)))
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_cut_short_or_of_another_schema_is_refused(tmp_path, monkeypatch):
    archive.write(tmp_path / "a.h5", {"x": np.random.default_rng(0).random(5000), "y": {"z": 1}})
    whole = (tmp_path / "a.h5").read_bytes()
    for share in np.linspace(0, 0.999, 60):
        (tmp_path / "cut.h5").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(archive.ArchiveError, match=r"cut\.h5"):
            archive.read(tmp_path / "cut.h5")
    for schema, words in ((archive.SCHEMA + 1, "install a later stickslip"), (archive.OLDEST - 1, "run it again")):
        with monkeypatch.context() as patched:
            patched.setattr(archive, "SCHEMA", schema)
            archive.write(tmp_path / "other.h5", {"x": 1})
        with pytest.raises(archive.ArchiveError, match=words):
            archive.read(tmp_path / "other.h5")


def test_any_damage_is_told(tmp_path):
    archive.write(tmp_path / "a.h5", {"state": make_packing(2), "words": ("a", "b"), "x": np.arange(2000.0)})
    whole, rng = (tmp_path / "a.h5").read_bytes(), np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.integers(8)
        (tmp_path / "bad.h5").write_bytes(damaged)
        with pytest.raises(archive.ArchiveError, match=r"bad\.h5"):
            archive.read(tmp_path / "bad.h5")


def test_a_full_disk_leaves_the_earlier_file(tmp_path, monkeypatch):
    archive.write(tmp_path / "a.h5", {"x": 1})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        archive.write(tmp_path / "a.h5", {"x": 2})
    assert caught.value.filename == str(tmp_path / "a.h5")
    assert archive.read(tmp_path / "a.h5") == {"x": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def long_arrays():
    """Arrays with columns of at least 64 KiB, with values that only their bytes tell apart."""
    rng = np.random.default_rng(0)
    real = rng.normal(size=(70_001, 3))
    real[:, 2] = 0.0
    special = np.zeros(140_000)
    special[[1, 70_000]] = -0.0, np.frombuffer(np.int64(0x7FF8000000000123).tobytes(), float)[0]
    return {
        "vectors": real, "transposed": np.asfortranarray(rng.random((9000, 2, 2))), "reversed": real[::-1, 0],
        "special": special, "zeros": np.zeros((20_000, 6)), "flags": rng.random(70_000) < 0.1,
        "complex": real[:, 0] + 1j * real[:, 1], "numbers": np.arange(30_000, dtype=np.int32) // 3,
        "small": np.full((70_000, 6), -1, np.int16), "foreign": real[:, 1].astype(">f4"),
        "counts": rng.integers(0, 9, 2**17).astype(np.uint8), "single": real.astype(np.float32),
    }  # fmt: skip


def test_long_arrays_come_back_to_the_last_bit(tmp_path):
    tree = long_arrays()
    archive.write(tmp_path / "a.h5", tree)
    found = archive.read(tmp_path / "a.h5")
    for name, array in tree.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape
        assert found[name].tobytes() == array.tobytes(), name


def test_large_arrays_need_no_other_filters_than_every_hdf5_library_has(tmp_path):
    """The streams are made here and not by HDF5, which reads them in any part."""
    tree = long_arrays() | {"wide": np.random.default_rng(0).random((3, 5000)), "few": np.arange(1001)}
    archive.write(tmp_path / "a.h5", tree)
    with h5py.File(tmp_path / "a.h5") as file:
        for name, array in tree.items():
            plan = file[name].id.get_create_plist()
            filters = [plan.get_filter(k)[0] for k in range(plan.get_nfilters())]
            assert filters == [h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE]
            some = slice(len(array) // 3, None, 7)
            assert file[name][some].tobytes() == array[some].tobytes(), name


def test_large_arrays_take_little_more_space_than_by_the_filters_of_hdf5(tmp_path):
    """The last digits are not compressed, but components that vanish take no space."""
    tree = long_arrays()
    archive.write(tmp_path / "a.h5", tree)
    with h5py.File(tmp_path / "a.h5") as ours, h5py.File(tmp_path / "b.h5", "w") as theirs:
        for name, array in tree.items():
            theirs.create_dataset(name, data=array, compression="gzip", shuffle=True)
        size, usual = (sum(file[name].id.get_storage_size() for name in tree) for file in (ours, theirs))
        assert size < 1.15 * usual < 0.6 * sum(array.nbytes for array in tree.values())
        assert ours["zeros"].id.get_storage_size() == 0


Earlier = NamedTuple("Contacts", [(name, np.ndarray) for name in (*PER_PAIR, "origin", "skin", "count")])


def earlier(contacts: ss.Contacts, **values) -> Earlier:
    """A contact list as schema 4 stored it."""
    count = int(contacts.count[0])
    rows = {name: getattr(contacts, name)[:count] for name in PER_PAIR[:-1]} | {"rolling": np.zeros((0, 7))}
    rest = {"origin": contacts.origin, "skin": np.array([contacts.skin]), "count": contacts.count}
    return Earlier(**(rows | rest | values))


def test_contacts_of_an_earlier_schema_are_read(tmp_path, monkeypatch):
    state, law = make_packing(3), make_law("hertz_mindlin", "sharp")
    now = ss.forces(state, law)[1]
    rolling, unknown = np.ones((now.count[0], 7)), np.full_like(now.origin, np.inf)
    cases = {
        "plain": ({}, (now.skin, 0.0, False)),
        "stale": ({"origin": unknown}, (now.skin, 0.0, True)),
        "reaching": ({"skin": np.array([now.skin, 0.05]), "rolling": rolling}, (now.skin, 0.05, False)),
    }
    monkeypatch.setattr(archive, "SCHEMA", 4)
    tree = {name: state._replace(contacts=earlier(now, **change)) for name, (change, _) in cases.items()}
    archive.write(tmp_path / "earlier.h5", tree)
    monkeypatch.undo()
    found = archive.read(tmp_path / "earlier.h5")
    for name, (_, wanted) in cases.items():
        contacts = found[name].contacts
        assert (contacts.skin, contacts.gap, contacts.stale) == wanted
        assert np.isfinite(contacts.origin).all() and np.array_equal(contacts.slip, now.slip[: now.count[0]])
        assert np.array_equal(contacts.rolling, rolling) if name == "reaching" else contacts.rolling is None
        assert np.array_equal(ss.forces(found[name], law)[0].force, ss.forces(state, law)[0].force)


def test_an_archive_of_an_earlier_version_is_read(tmp_path):
    """The file was written by version 0.2.0, with the filters of HDF5."""
    tree = archive.read(Path(__file__).with_name("archive_0.2.h5"))
    x = np.arange(30_000.0).reshape(10_000, 3) * [1, 0, -1]
    assert tree["x"].tobytes() == x.tobytes() and tree["words"] == ("a", "b")
    assert isinstance(tree["state"], ss.State) and len(tree["state"].grains.radius) == 7
    archive.write(tmp_path / "a.h5", tree)
    again = archive.read(tmp_path / "a.h5")
    assert all(same(tuple(tree[name]), tuple(again[name])) for name in ("state", "law"))


def test_run_folders_of_version_0_3_are_read():
    """Their numbers are those in the tables that version 0.3.0 wrote beside them."""
    stored = Path(__file__).with_name("version_0.3")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        slider, sample = (ss.io.open_dataset(stored / name) for name in ("rate_state", "threshold"))
    table = np.genfromtxt(stored / "rate_state" / "series.csv", delimiter=",", names=True, skip_header=1)
    for name, column in (("friction", "friction_"), ("slip", "slip_m"), ("theta", "theta_s")):
        assert np.allclose(slider["history"][name], table[column], rtol=1e-11)
    assert sample.attrs["stickslip"] == "0.3.0" and sample["frames"].sizes["grain"] == 12
    done = stickslip_here("stability", stored / "threshold" / "results.h5", "--frame", "frames/0.200000")
    assert "2 complex pairs, the fastest with period 43.81 and e-folding time 46.11" in " ".join(done.stdout.split())


@pytest.mark.parametrize("folder", ["rate_state", "threshold"])
def test_run_folders_of_version_0_3_are_finished_runs(folder, tmp_path):
    run = tmp_path / folder
    shutil.copytree(Path(__file__).with_name("version_0.3") / folder, run)
    assert "nothing to resume" in stickslip_here("resume", run).stdout
    assert ss.read_scenario(run / "scenario.json").experiment == folder.replace("_", "-")
