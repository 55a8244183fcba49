"""Files whose checksum is right and whose indices are not: a sentence, and no compiled code looks beyond an array."""

import re

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.fields import FIELDS
from stickslip.core.state import Bonds, Instant
from stickslip.data import archive
from tests.conftest import make_law, make_packing, stirred

NOUNS = ("grains", "walls", "cell", "contacts", "control")


@pytest.fixture(scope="module")
def state():
    law = make_law("hertz_mindlin", "sharp", damping_n=0.1)
    start = stirred(make_packing(3), law, np.random.default_rng(0))
    return ss.run(start, law, 5, 0.01)[0]


def entries(state, kinds):
    """(noun, entry) of all arrays of some kinds of types that hold something."""
    for noun in NOUNS:
        part = getattr(state, noun)
        for name in part._fields:
            array = np.asarray(getattr(part, name))
            if array.dtype.kind in kinds and array.size and array.ndim:
                yield noun, name


def changed(state, noun, name, array):
    part = getattr(state, noun)
    return state._replace(**{noun: part._replace(**{name: array})})


def test_a_sound_state_comes_back(state, tmp_path):
    archive.write(tmp_path / "a.h5", {"state": state})
    back = archive.read(tmp_path / "a.h5")["state"]
    assert np.array_equal(back.contacts.i, state.contacts.i[: state.contacts.count[0]])
    for dim in (2, 3):
        make_packing(dim).check_entries()


@pytest.mark.parametrize("value", [-2, 10**4, 10**9])
@pytest.mark.parametrize(
    "entry",
    [
        "contacts.i", "contacts.j", "contacts.mode", "control.group", "control.follows", "control.leads",
        "control.cell_follows", "grains.material", "walls.material",
    ],
)  # fmt: skip
def test_indices_out_of_range_are_refused(state, tmp_path, entry, value):
    noun, name = entry.split(".")
    array = np.array(getattr(getattr(state, noun), name))
    if value > np.iinfo(array.dtype).max:
        pytest.skip("such a number does not fit")
    array.flat[0] = value
    bad = changed(state, noun, name, array)
    if name == "material" and value > 0:  # there are laws with any number of materials: this one is asked when it acts
        with pytest.raises(ValueError, match="material"):
            ss.forces(bad, make_law("hertz_mindlin", "sharp"))
        return
    archive.write(tmp_path / "bad.h5", {"state": bad})
    with pytest.raises(archive.ArchiveError, match=r"cannot be read as an archive .*must be (between|at least|-1)"):
        archive.read(tmp_path / "bad.h5")


@pytest.mark.parametrize(
    ("entry", "value", "message"),
    [
        ("grains.mass", np.nan, r"grains\.mass\[0\] is NaN"), ("grains.mass", -1.0, r"grains\.mass\[0\] is -1"),
        ("grains.inertia", 0.0, r"grains\.inertia\[0\] is 0"), ("grains.radius", np.inf, r"grains\.radius\[0\] is inf"),
        ("contacts.slip", np.nan, r"contacts\.slip\[0, 0\] is NaN"), ("control.spring", -1.0, r"spring\[0, 0\] is -1"),
    ],
)  # fmt: skip
def test_values_that_are_impossible_are_refused(state, tmp_path, entry, value, message):
    noun, name = entry.split(".")
    array = np.array(getattr(getattr(state, noun), name))
    array.flat[0] = value
    archive.write(tmp_path / "bad.h5", {"state": changed(state, noun, name, array)})
    with pytest.raises(archive.ArchiveError, match=f"(?i){message}"):
        archive.read(tmp_path / "bad.h5")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s._replace(time="now"), "time has type str: it must be a number"),
        (lambda s: s._replace(time=np.nan), "time is NaN"),
        (lambda s: changed(s, "control", "cell_mass", np.zeros((3, 3))), r"control\.cell_mass has type ndarray"),
        (lambda s: changed(s, "control", "cell_mass", -1.0), r"control\.cell_mass is -1"),
        (
            lambda s: changed(s, "grains", "radius", s.grains.radius.astype("f4")),
            r"radius must be an array of float64 .* got float32",
        ),
        (
            lambda s: changed(s, "grains", "radius", s.grains.radius.astype(">f8")),
            r"radius must be an array of float64 .* got >f8",
        ),
        (
            lambda s: changed(s, "contacts", "i", s.contacts.i.astype("u4")),
            r"contacts\.i must be an array of int32 .* got uint32",
        ),
        (lambda s: s._replace(contacts=None), "contacts must be those of a State, got NoneType"),
    ],
)
def test_scalars_and_types_that_no_state_has_are_refused(state, tmp_path, change, message):
    """Compiled code is compiled for one type of each array; another would end in an error of the compiler."""
    archive.write(tmp_path / "bad.h5", {"state": change(state)})
    with pytest.raises(archive.ArchiveError, match=f"(?i){message}"):
        archive.read(tmp_path / "bad.h5")


def test_all_fields_of_a_state_are_described(state):
    nouns = {noun: getattr(state, noun)._fields for noun in NOUNS}
    nouns |= {"instant": Instant._fields, "bonds": Bonds._fields}
    assert {noun: tuple(FIELDS[noun]) for noun in nouns} == nouns
    assert set(state._fields) - set(nouns) == set(FIELDS[""])


def test_contacts_of_others_are_refused(state):
    contacts = archive.trimmed(state.contacts)
    for name in ("i", "j", "image", "key"):
        array = np.array(getattr(contacts, name))
        array[0] = array[-1] + 1
        assert not np.array_equal(array, getattr(contacts, name))
        with pytest.raises(ValueError, match=r"not sorted|contacts\.[ij]\[0\] is"):
            state._replace(contacts=contacts._replace(**{name: array})).check_entries()
    with pytest.raises(ValueError, match=r"contacts.count"):
        state._replace(contacts=contacts._replace(count=contacts.count + 1)).check_entries()


def test_shapes_and_types_that_are_wrong_are_refused(state):
    state = state._replace(contacts=archive.trimmed(state.contacts))
    for name, bad in (("skin", np.ones(1)), ("gap", None), ("stale", 0.0), ("rolling", np.zeros((1, 7)))):
        with pytest.raises(ValueError, match=rf"contacts\.{name} has (type|shape)"):
            changed(state, "contacts", name, bad).check_entries()
    for noun, name in entries(state, "iufb"):
        array = np.asarray(getattr(getattr(state, noun), name))
        for bad in (array[:-1], array[..., None], array.astype(complex)):
            with pytest.raises(ValueError, match=r"\.|row"):
                changed(state, noun, name, np.ascontiguousarray(bad)).check_entries()


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("kind", 99), ("kind", "x"), ("coulomb", 2**31 - 1), ("damping", 0), ("damping", 2**31 - 1), ("damping", "x"),
        ("table", "x"), ("table", np.ones((1, 1, 5, 1))), ("table", np.ones((1, 1, 4))),
        ("table", np.full((1, 1, 5), np.nan)),
    ],
)  # fmt: skip
def test_a_law_that_compiled_code_does_not_know_is_refused(tmp_path, entry, value):
    law = make_law("linear", "smooth", damping="viscoelastic", damping_n=0.1, tension=False)
    archive.write(tmp_path / "a.h5", {"law": law})
    assert archive.read(tmp_path / "a.h5")["law"]._replace(table=law.table) == law
    archive.write(tmp_path / "a.h5", {"law": law._replace(**{entry: value})})
    with pytest.raises(
        archive.ArchiveError,
        match=rf"law\.{entry}(\[0, 0, 0\])? (is|has|must)|built-in laws have kinds 0 to 8, got {re.escape(str(value))}",
    ):
        archive.read(tmp_path / "a.h5")
