"""Networks of contacts as graphs of networkx, for centrality, communities, cycles or files such as GraphML."""

from pathlib import Path
from typing import TYPE_CHECKING

from ...core.arguments import checked
from ...core.laws.builtin import Law
from ...core.state import SLIDE, State
from ...extras import require
from ..atomic import replace_atomically
from .frame import Frame, frame_of, list_losses

if TYPE_CHECKING:
    import networkx


@checked
def contact_graph(state: State, law: Law) -> "networkx.MultiGraph":
    """Network of the touching contacts of an accepted state.

    Parameters
    ----------
    state : State, accepted
    law : Law

    Returns
    -------
    networkx.MultiGraph
        Nodes are bodies, walls after grains, with `wall`, `radius`, x, y, z [length]. Edges are contacts, several
        between grains that touch through different images, with `force_n`, `force_t` [force] and `slides`

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> list(contact_graph(pair, law).edges())
    [(0, 1)]
    """
    return _graph_of(frame_of(state, law))


def write_graph(path: str | Path, frame: Frame) -> list[str]:
    """Write the network of contacts as GraphML; return notes on what it does not store."""
    graph = _graph_of(frame)
    with replace_atomically(path) as part:
        require("networkx", "exchange").write_graphml(graph, part)
    return [f"GraphML stores positions and forces, and not {', '.join(['the cell', *list_losses(frame)])}"]


def _graph_of(frame: Frame) -> "networkx.MultiGraph":
    """Graph of the columns of a frame."""
    graph, columns, state = require("networkx", "exchange").MultiGraph(), frame.contacts, frame.state
    n = len(state.grains.radius)
    places = [*state.grains.position.tolist(), *state.walls.point.tolist()]
    sizes = [*state.grains.radius.tolist(), *[0.0] * len(state.walls.mass)]
    for body, (place, radius) in enumerate(zip(places, sizes, strict=True)):
        graph.add_node(body, wall=body >= n, radius=radius, **dict(zip("xyz", place, strict=True)))
    names = "i", "j", "force_n", "force_t", "mode"
    for i, j, force_n, force_t, mode in zip(*(columns[name].tolist() for name in names), strict=True):
        graph.add_edge(i, j, force_n=force_n, force_t=force_t, slides=mode == SLIDE)
    return graph
