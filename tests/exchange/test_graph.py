"""Graphs of contacts contain the contacts of a packing, and files of graphs can be read again."""

from collections import Counter

import networkx
import numpy as np
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


def test_a_graph_is_written_and_read_by_networkx(tmp_path):
    state = stirred(make_packing(3), LAW, np.random.default_rng(1))
    graph = ss.io.contact_graph(state, LAW)
    networkx.write_graphml(graph, tmp_path / "contacts.graphml")
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
