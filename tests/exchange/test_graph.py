"""Graphs and tables of contacts contain the contacts of a packing, and their files can be read again."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest

import stickslip as ss
from tests.conftest import make_law, make_packing, stirred

LAW = make_law("hertz_mindlin", "sharp")


@pytest.mark.parametrize("dim", [2, 3])
def test_edges_are_contacts(dim):
    state = stirred(make_packing(dim), LAW, np.random.default_rng(1))
    graph, contacts, rows = ss.io.contact_graph(state, LAW), state.contacts, ss.measure.touching(state)
    ends = list(zip(contacts.i[rows].tolist(), contacts.j[rows].tolist(), strict=True))
    number = Counter(map(frozenset, ends))
    assert Counter(frozenset(edge) for edge in graph.edges()) == number
    force = np.linalg.norm(ss.measure.contact_forces(state, LAW), axis=1)[rows]
    for body in range(state.n_bodies):
        mine = [body in end for end in ends]
        edges = [edge for *_, edge in graph.edges(body, data=True)]
        assert np.hypot([e["force_n"] for e in edges], [e["force_t"] for e in edges]).sum() == pytest.approx(
            force[mine].sum()
        )
        assert sum(e["slides"] for e in edges) == (contacts.mode[rows][mine] == ss.SLIDE).sum()
    n = len(state.grains.radius)
    assert [b for b, wall in graph.nodes(data="wall") if wall] == list(range(n, state.n_bodies))
    assert [d for _, d in graph.degree()][:n] == ss.measure.contact_numbers(state).tolist()


def test_a_table_has_the_grains_and_another_their_contacts_to_the_last_bit(tmp_path):
    state = stirred(make_packing(3), LAW, np.random.default_rng(1))
    assert "the cell, 1 wall(s), the contact law" in ss.io.write_packing(tmp_path / "a.csv", state, LAW)[0]
    grains, contacts = (pd.read_csv(tmp_path / name) for name in ("a.csv", "a-contacts.csv"))
    assert np.array_equal(grains[["x", "y", "z"]], state.grains.position)
    rows = ss.measure.touching(state)
    assert contacts.j.tolist() == state.contacts.j[rows].tolist()
    parts = [contacts[[f"{name}_{a}" for a in "xyz"]].to_numpy() for name in ("branch", "tangential", "slip")]
    normal = parts[0] / np.linalg.norm(parts[0], axis=1)[:, None]
    force = contacts.force_n.to_numpy()[:, None] * normal + parts[1]
    assert force == pytest.approx(ss.measure.contact_forces(state, LAW)[rows])
    assert np.array_equal(parts[2], state.contacts.slip[rows])
    assert ((contacts["mode"] == "slide") == (state.contacts.mode[rows] == ss.SLIDE)).all()
    again = ss.io.read_packing(tmp_path / "a.csv")
    assert np.array_equal(again.state.grains.position, state.grains.position)
    assert np.array_equal(again.state.grains.mass, state.grains.mass)


def test_a_graph_is_written_and_read_by_networkx(tmp_path):
    state = stirred(make_packing(3), LAW, np.random.default_rng(1))
    graph = ss.io.contact_graph(state, LAW)
    ss.io.write_packing(tmp_path / "contacts.graphml", state, LAW)
    import networkx  # slow

    again = networkx.read_graphml(tmp_path / "contacts.graphml", node_type=int)
    assert dict(again.nodes(data=True)) == dict(graph.nodes(data=True))
    assert sorted(e["force_n"] for *_, e in again.edges(data=True)) == sorted(
        e["force_n"] for *_, e in graph.edges(data=True)
    )


def test_grains_that_touch_through_two_images_have_two_edges():
    cell = ss.box([1.95, 5.0, 1.0], [True, False, False], 2)
    pair = ss.assembly(ss.disks([[0, 0, 0], [0.975, 0, 0]], [0.5, 0.5]), cell=cell)
    graph = ss.io.contact_graph(ss.accept(pair, ss.forces(pair, LAW)[1]), LAW)
    assert [set(edge) for edge in graph.edges()] == [{0, 1}, {0, 1}]
