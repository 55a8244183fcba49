"""Tables of bonds of YADE and PFC beside a table of grains."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data.sample import PackingError

GRAINS = "x,y,z,radius\n0,0,0,0.5\n1,0,0,0.4\n0,1,0,0.5\n"
LAW = {"law": "linear", "kn": 1.0, "kt": 0.5, "mu": 0.3, "coulomb": "sharp"}


@pytest.fixture
def read(tmp_path):
    (tmp_path / "grains.csv").write_text(GRAINS)

    def reading(text):
        (tmp_path / "bonds.csv").write_text(text)
        return ss.io.read_packing(tmp_path / "grains.csv", contacts=tmp_path / "bonds.csv", **LAW)

    return reading


def test_columns_of_yade_are_stiffnesses_and_strengths(read):
    state, _, notes = read(
        "id1,id2,kn,ks,kr,ktw,normalAdhesion,shearAdhesion,cohesionBroken\n0,1,10,5,2,1,0.3,0.2,0\n2,0,20,6,3,2,0.4,0.1,1\n"
    )
    bonds = state.bonds
    assert list(zip(bonds.i, bonds.j, strict=True)) == [(0, 1), (0, 2)] and bonds.intact.tolist() == [True, False]
    np.testing.assert_allclose(bonds.stiffness, [[10, 5, 2, 1], [20, 6, 3, 2]])
    np.testing.assert_allclose(bonds.strength[:, :2], [[0.3, 0.2], [0.4, 0.1]])
    assert any("2 bonds of bonds.csv, 1 of them broken" in note for note in notes)
    place = state.grains.position.copy()
    place[1, 0] += 0.02
    pulled = state._replace(grains=state.grains._replace(position=place))
    np.testing.assert_allclose(ss.measure.bond_shares(pulled), [0.2 / 0.3, 0.0])


@pytest.mark.parametrize("radius", [1.0, 0.5])
def test_columns_of_pfc_are_those_of_a_parallel_bond(read, radius):
    state, _, notes = read(
        "end1 end2 pb_kn pb_ks pb_ten pb_coh pb_rmul pb_state pb_fa\n"
        f"1 2 8 3 0.2 0.4 {radius} 3 30\n1 3 8 3 0.2 0.4 1 2 0\n"
    )
    bare = ss.packings.without_bonds(state)
    law = ss.laws.parallel_bond(8.0, 3.0, 0.2, 0.4, radius=radius)
    known = ss.packings.bonded(bare, law, pairs=[[0, 1]]).bonds
    for name in ("stiffness", "strength", "arm", "form", "length"):
        np.testing.assert_allclose(getattr(state.bonds, name)[:1], getattr(known, name), err_msg=name)
    assert state.bonds.intact.tolist() == [True, False] and state.bonds.failed.tolist() == [0, 2]
    assert any("pb_fa" in note for note in notes)


@pytest.mark.parametrize(
    ("text", "pair", "told"),
    [
        ("i,j,kn,ks\n0,1,1,1\n", (0, 1), ""), ("i,j,kn,ks\n2,3,1,1\n", (1, 2), ""),
        ("i,j,kn,ks\n1,2,1,1\n", (1, 2), "numbered from 0, as neither 0 nor 3 occurs"),
        ("end1,end2,pb_kn,pb_ks\n1,2,1,1\n", (0, 1), "numbered from 1, as neither 0 nor 3 occurs"),
    ],
)  # fmt: skip
def test_grains_are_counted_from_the_number_that_occurs_or_as_the_program_counts_them(read, text, pair, told):
    state, _, notes = read(text)
    assert (state.bonds.i[0], state.bonds.j[0]) == pair
    assert [note for note in notes if "numbered" in note] == [note for note in notes if told and told in note]
    assert any("numbered" in note for note in notes) == bool(told)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("i,j,kn\n0,1,1\n", "i, j and kn, ks"),
        ("i,j,kn,ks\n0,7,1,1\n", "0 to 7, but the packing has 3 grains: .* leave out bonds to walls"),
        ("i,j,kn,ks\n0,1,-1,1\n", "kn = -1: it must be positive"),
        ("i,j,kn,ks\n0,0,1,1\n", "grain 0 cannot be bonded to itself"),
        ("i,j,kn,ks,normalAdhesion\n0,1,1,1,0\n", "tension = 0: it must be positive"),
        ("i,j,kn,ks,kt\n0,1,1,1,1\n", "two columns for ks"),
        ("i,j,kn,ks\n0,1,1,1\n1,0,1,1\n", "already bonded: bond each pair only once"),
        ("i,j,kn,ks\n0.5,1,1,1\n", "whole numbers"), ("i,j,kn,ks\n0,1,inf,1\n", "kn = inf: it must be positive"),
        ("i,j,pb_kn,pb_ks,pb_state\n0,1,1,1,1.5\n", "pb_state = 1.5: it must be 0, 1, 2 or 3"),
    ],
)  # fmt: skip
def test_tables_that_cannot_be_are_refused_in_a_sentence(read, text, words):
    with pytest.raises(PackingError, match=words):
        read(text)
