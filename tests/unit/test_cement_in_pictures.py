"""Bonds, intact and broken, in pictures, in the view in three dimensions, and in files that show packings."""

from collections import Counter

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgba

import stickslip as ss
from stickslip.data.exchange.frame import with_bonds
from stickslip.figures.scene import view_data
from stickslip.figures.style import BOND, BROKEN

LAW = ss.laws.hertz_mindlin(mu=0.3)
PLACE = [[1.0, 1.0, 0.0], [1.99, 1.0, 0.0], [3.1, 1.0, 0.0], [4.15, 1.0, 0.0], [1.0, 2.1, 0.0]]


def chain(dim):
    """Five grains: one contact with a bond, bonds across two gaps, and two that broke, one of them long ago."""
    grains = (ss.disks if dim == 2 else ss.spheres)(np.array(PLACE)[:, :dim], 0.5)
    cell = ss.box([6.0, 6.0, 6.0][:dim] if dim == 2 else [6.0] * 3, [True] * dim + [False] * (3 - dim), dim)
    pairs = [[0, 1], [1, 2], [2, 3], [0, 4], [0, 3]]
    state = ss.packings.bonded(ss.assembly(grains, cell=cell), ss.laws.spring_bond(1.0, 0.1), pairs=pairs)
    intact, failed = np.array([1, 1, 0, 1, 0], bool), np.array([0, 0, 1, 0, 1], np.int8)
    length = state.bonds.length.copy()
    length[4] /= 2
    state = state._replace(bonds=state.bonds._replace(intact=intact, failed=failed, length=length))
    return ss.accept(state, ss.forces(state, LAW)[1])


@pytest.mark.parametrize("dim", [2, 3])
def test_a_drawing_has_a_band_for_each_bond_and_its_legend(dim):
    figure = ss.figures.packing(chain(dim), LAW)
    (axes,) = figure.axes
    drawn = Counter()
    for lines in axes.collections:
        if isinstance(lines, EllipseCollection) and not lines.get_facecolor().size:
            drawn.update(map(tuple, lines.get_edgecolor().tolist()))
    pieces = {to_rgba(BOND): 3, to_rgba(BROKEN): 1}
    count = {color: drawn[color] for color in pieces}
    share = count[to_rgba(BROKEN)]  # in three dimensions a line has several pieces
    assert share >= 1 and count == {color: share * number for color, number in pieces.items()}
    words = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"contact sticks (1)", "bond (3)", "broken (2)"} <= set(words)


def test_the_view_has_lines_for_bonds():
    data = view_data([ss.io.frame_of(chain(3), LAW)], [])
    kinds = Counter(data["frames"][0]["mode"].tolist())
    assert data["lines"] == ["stick", "slide", "bond", "broken"] and kinds == {0: 1, 2: 3, 3: 1}
    bare = view_data([ss.io.frame_of(ss.packings.without_bonds(chain(3)), LAW)], [])
    assert bare["lines"] == ["stick", "slide"]


def test_files_that_show_packings_have_bonds(tmp_path):
    networkx, hoomd = pytest.importorskip("networkx"), pytest.importorskip("gsd.hoomd")
    pytest.importorskip("pyevtk")
    state = chain(3)
    for name in ("p.graphml", "p.gsd", "p.vtu"):
        notes = ss.io.write_packing(tmp_path / name, state, LAW)
        assert any("shows bonds, but not their laws" in note for note in notes) == (name != "p.gsd")
    edges = networkx.read_graphml(tmp_path / "p.graphml").edges(data=True)
    assert Counter(about["bond"] for *_, about in edges) == {0: 1, 1: 3, 2: 2}
    assert sum(about["force_n"] != 0 for *_, about in edges) == 1  # the contact; no bond is stretched
    with hoomd.open(tmp_path / "p.gsd") as file:
        shown = file[0].bonds
    assert Counter(shown.types[k] for k in shown.typeid) == {"sticking": 1, "bond": 3, "broken bond": 2}
    assert (tmp_path / "p-contacts.vtu").exists()
    assert ss.io.read_packing(tmp_path / "p.gsd")[0].bonds.failed.tolist() == [0, 0, 1, 0, 1]


def test_a_bond_that_is_stretched_across_a_gap_has_its_force():
    state = chain(3)
    place = state.grains.position.copy()
    place[4, 1] += 0.05
    moved = state._replace(grains=state.grains._replace(position=place))
    rows = ss.io.frame_of(ss.accept(moved, ss.forces(moved, LAW)[1]), LAW)
    columns = with_bonds(rows)
    pulled = np.flatnonzero(np.abs(columns["force_n"]) > 1e-2)
    assert [(columns["i"][k], columns["j"][k], columns["bond"][k]) for k in pulled] == [(0, 4, 1)]


def drawn_lines(axes) -> list[EllipseCollection]:
    """Lines of contacts."""
    return [c for c in axes.collections if isinstance(c, EllipseCollection) and len(c.get_paths()[0].vertices) == 2]


def test_a_line_across_a_periodic_edge_ends_at_the_contact_of_both_grains():
    place = np.array([[0.5, 1.0], [1.48, 1.0], [3.49, 1.0]])
    state = ss.packings.from_arrays(place, [0.5, 0.5, 0.52], LAW, cell=[4.0, 4.0], dim=2)
    assert len(ss.measure.touching(state)) == 2
    (lines,) = drawn_lines(ss.figures.packing(state, LAW).axes[0])
    ends = lines.get_offsets()[:, :1] + np.outer(lines.get_widths(), [-0.5, 0.5])
    across = 1.01 * 0.5 / 1.02  # from the centre of the first grain to the contact
    expected = [[0.5 - across, 0.5], [0.5, 1.48], [3.49, 3.49 + 1.01 - across]]
    np.testing.assert_allclose(ends[np.argsort(ends[:, 0])], expected, atol=1e-12)


def test_lines_on_coloured_grains_have_a_white_edge():
    state = ss.packings.from_arrays(np.array([[0.5, 1.0], [1.48, 1.0]]), [0.5, 0.5], LAW, cell=[4.0, 4.0], dim=2)
    (plain,) = drawn_lines(ss.figures.packing(state, LAW).axes[0])
    below, above = drawn_lines(ss.figures.packing(state, LAW, colour="pressure").axes[0])
    assert (
        to_rgba("white") == tuple(below.get_edgecolor()[0]) and (below.get_linewidths() > plain.get_linewidths()).all()
    )
    assert np.array_equal(above.get_edgecolor(), plain.get_edgecolor())
    assert below.get_zorder() <= above.get_zorder()
