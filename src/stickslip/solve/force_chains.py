"""Statistics of a network of contact forces: chains, the strong network, and anisotropies of contacts and forces.

All functions accept a state with its law, or measured forces. The force of a bonded pair is that of its contact plus
that of its bond, as in the stress: a pair whose contact and bond balance each other transmits no force. Bonded pairs
may pull; `tension` selects the chains and the strong network of pulling pairs.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ..core.arguments import Result, checked, knows_bonds
from ..core.contacts.jacobian import linearise
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors, touching
from ..core.readable import readable
from ..core.state import State

ANGLE = 45.0  # largest angle between a chain and the stress of its grains [degrees]
SHORTEST = 3  # smallest number of grains in a chain
Source = State | Annotated[Any, Result("MeasuredForces", ("position", "pair_i", "force_n", "force_t"))]


@readable
class ForceNetwork(NamedTuple):
    """Touching contacts and bonded pairs, including contacts with walls, and their forces."""

    dim: int
    position: np.ndarray  # (N, 3) positions of grains [length]
    radius: np.ndarray  # (N,) [length]
    pair_i: np.ndarray  # (C,) number of the first grain i
    pair_j: np.ndarray  # (C,) number of the second grain j, or of a wall, from N on
    branch: np.ndarray  # (C, 3) vectors from j, or from the surface of a wall, to i [length]
    normal: np.ndarray  # (C, 3) unit vectors along `branch`
    force: np.ndarray  # (C, 3) force on i [force]
    force_n: np.ndarray  # (C,) normal part of the force, positive in compression [force]

    @property
    def tangential(self) -> np.ndarray:
        """(C, 3) tangential part of the force on i."""
        return self.force - self.force_n[:, None] * self.normal

    @property
    def inner(self) -> np.ndarray:
        """(C,) mask of contacts between two grains."""
        return self.pair_j < len(self.radius)

    @property
    def mean(self) -> float:
        """Mean normal force of contacts that do not pull; 0 if there are none [force]."""
        pushing = self.force_n[self.force_n >= 0]
        return float(pushing.mean()) if len(pushing) else 0.0

    def reversed(self) -> "ForceNetwork":
        """Network of the opposite forces, in which pulling contacts push."""
        return self._replace(force=-self.force, force_n=-self.force_n)


@readable
class ForceChains(NamedTuple):
    """Chains of grains that carry more than the mean force, and their lengths."""

    chains: list[np.ndarray]  # grains of each chain in order, longest chain first
    lengths: np.ndarray  # (K,) number of grains in each chain
    loaded: np.ndarray  # (N,) bool, True for grains whose largest principal stress is above the mean
    stress: np.ndarray  # (N,) largest principal value of Σ f ⊗ r, compression (or `tension`) positive [force length]


@readable
class StrongNetwork(NamedTuple):
    """Contacts whose normal force is above the mean, and the largest cluster of grains that they join."""

    strong: np.ndarray  # (C,) bool over the touching contacts, True for strong ones
    cluster: np.ndarray  # (C,) bool, True for contacts of the largest cluster
    grains: np.ndarray  # (n,) grains of the largest cluster
    clusters: int  # number of clusters of two grains or more
    share_of_pressure: float  # fraction of the pressure borne by strong contacts, 1 if all are strong


@readable
class Anisotropy(NamedTuple):
    """Anisotropies of contact directions, of normal forces and of tangential forces, and two of their axes."""

    contacts: float  # a_c
    normal: float  # a_n
    tangential: float  # a_t
    contact_axis: np.ndarray  # (3,) direction in which most contacts point
    normal_axis: np.ndarray  # (3,) direction of the largest normal forces
    deviator: float  # deviator of the stress of these contacts, (σ₁ − σ₂)/(σ₁ + σ₂) in a plane, q/p otherwise
    dim: int

    @property
    def predicted_deviator(self) -> float:
        """(a_c + a_n + a_t)/2 in a plane, 2 (a_c + a_n + 3 a_t/2)/5 in three dimensions, if all have the same axes."""
        a_c, a_n, a_t = self.contacts, self.normal, self.tangential
        return (a_c + a_n + a_t) / 2 if self.dim == 2 else 0.4 * (a_c + a_n + 1.5 * a_t)


@checked
@knows_bonds
def force_network(source: Source, law: Law | None = None) -> ForceNetwork:
    """Touching contacts and bonded pairs with their forces, from a state and its law or from measured forces.

    Parameters
    ----------
    source : accepted state, or the result of `io.read_forces`
    law : contact law of the state; None for measured forces

    Examples
    --------
    >>> import stickslip as ss
    >>> row = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]
    >>> measured = ss.io.measured_forces(row, 0.5, [0, 1], [1, 2], [1.0, 1.1])
    >>> force_network(measured).force.round(2).tolist()
    [[-1.0, 0.0, 0.0], [-1.1, 0.0, 0.0]]
    """
    if isinstance(source, State):
        if law is None:
            raise ValueError("a state also needs its law, from which its forces follow")
        rows, line = touching(source), linearise(source, law)
        contacts, branch = source.contacts, branch_vectors(source)[rows]
        length = np.linalg.norm(branch, axis=1, keepdims=True)
        force, normal = line.force[rows], np.where(line.closed[rows, None], line.normal[rows], branch / length)
        return ForceNetwork(
            source.cell.dim, source.grains.position, source.grains.radius, contacts.i[rows].astype(int),
            contacts.j[rows].astype(int), branch, normal, force, np.einsum("ck,ck->c", force, normal),
        )  # fmt: skip
    if law is not None:
        raise ValueError("measured forces need no law: leave it out")
    m = source
    m.check_entries()
    position = np.pad(m.position, ((0, 0), (0, 3 - m.position.shape[1])))
    branch = position[m.pair_i] - position[m.pair_j]
    normal = branch / np.linalg.norm(branch, axis=1, keepdims=True)
    across = m.force_t if m.force_t.ndim == 2 else m.force_t[:, None] * np.cross(normal, [0.0, 0.0, 1.0])
    force = m.force_n[:, None] * normal + across
    return ForceNetwork(m.dim, position, m.radius, m.pair_i, m.pair_j, branch, normal, force, m.force_n)


@checked
@knows_bonds
def force_chains(source: Source, law: Law | None = None, *, angle: float = ANGLE, tension: bool = False) -> ForceChains:
    """Force chains: rows of three or more grains, each of which carries more than the mean and passes the force on.

    A grain is loaded if the largest principal value σ₁ of its Σ f ⊗ r is above the mean over grains with contacts, in
    which negative values count as zero. On each side of it, the next grain is the loaded grain that pushes it in the
    direction nearest to that of σ₁, within `angle`. Two grains are linked if each is the next of the other, so that
    chains do not branch.

    Parameters
    ----------
    source, law : as in `force_network`
    angle : largest angle between a link and the direction of σ₁ of both of its grains [degrees]
    tension : if True, find chains of pulling grains, such as bonded ones, by the same rules with opposite forces

    Source
    ------
    Peters, Muthuswamy, Wibowo & Tordesillas, doi:10.1103/PhysRevE.72.041307, who allow branches.

    Examples
    --------
    >>> import stickslip as ss
    >>> rows = [[float(k % 5), 2.0 * (k // 5)] for k in range(10)]
    >>> i, j = [0, 1, 2, 3, 5, 6, 7, 8], [1, 2, 3, 4, 6, 7, 8, 9]
    >>> force = [2.0] * 4 + [1.0] * 4
    >>> measured = ss.io.measured_forces(rows, 0.5, i, j, force)
    >>> force_chains(measured).chains[0].tolist()
    [1, 2, 3]
    """
    if not 0 < angle <= 90:
        raise ValueError(f"angle must be from 0 to 90 degrees, got {angle}")
    net = force_network(source, law)
    net = net.reversed() if tension else net
    n, c = len(net.radius), net.inner
    first, second = net.pair_i, np.where(c, net.pair_j, 0)
    moment = np.zeros((n, 3, 3))
    arm = net.radius[first][:, None] * net.normal  # from the contact to the centre of i
    np.add.at(moment, first, net.force[:, :, None] * arm[:, None])
    other = net.radius[second][:, None] * net.normal
    np.add.at(moment, second[c], net.force[c][:, :, None] * other[c][:, None])
    values, vectors = np.linalg.eigh((moment + moment.transpose(0, 2, 1)) / 2)
    stress, way = values[:, -1], vectors[:, :, -1]
    borne = np.zeros(n, bool)
    borne[first], borne[second[c]] = True, True
    loaded = borne & (stress > np.maximum(stress[borne], 0.0).mean()) if borne.any() else borne
    i, j, normal = first[c], second[c], net.normal[c]
    both = loaded[i] & loaded[j] & (net.force_n[c] > 0)
    i, j, normal = i[both], j[both], normal[both]
    ends, out = np.append(i, j), np.vstack([-normal, normal])
    along = np.einsum("ck,ck->c", out, way[ends])
    side = 2 * ends + (along > 0)
    best: dict[int, int] = {}
    for k in np.argsort(-np.abs(along), kind="stable"):
        if abs(along[k]) >= np.cos(np.deg2rad(angle)):
            best.setdefault(int(side[k]), int(k))
    half = len(i)
    chosen = {*best.values()}
    links = np.array([k for k in range(half) if k in chosen and k + half in chosen], int)
    chains = _paths(n, i[links], j[links])
    return ForceChains(chains, np.array([len(chain) for chain in chains], int), loaded, stress)


def _paths(n: int, i: np.ndarray, j: np.ndarray) -> list[np.ndarray]:
    """Paths of at least SHORTEST grains, in their order, longest path first; no grain has more than two links."""
    near: list[list[int]] = [[] for _ in range(n)]
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        near[a].append(b)
        near[b].append(a)
    seen, out = np.zeros(n, bool), []
    starts = [k for k in range(n) if len(near[k]) == 1] + [k for k in range(n) if len(near[k]) > 1]  # ends, then rings
    for start in starts:
        path, at = [], start if not seen[start] else None
        while at is not None:
            seen[at] = True
            path.append(at)
            at = next((k for k in near[at] if not seen[k]), None)
        if len(path) >= SHORTEST:
            out.append(np.array(path))
    return sorted(out, key=len, reverse=True)


@checked
@knows_bonds
def strong_network(source: Source, law: Law | None = None, *, tension: bool = False) -> StrongNetwork:
    """Contacts with a normal force above the mean, and the largest cluster of grains that they join.

    The mean force, and the pressure of which these contacts carry a share, are those of contacts that do not pull.

    Parameters
    ----------
    source, law : as in `force_network`
    tension : if True, use pulling contacts, such as bonds, instead

    Source
    ------
    Radjai, Wolf, Jean & Moreau, doi:10.1103/PhysRevLett.80.61.

    Examples
    --------
    >>> import stickslip as ss
    >>> row = [[float(k), 0.0] for k in range(4)]
    >>> i, j, force = [0, 1, 2], [1, 2, 3], [3.0, 3.0, 1.0]
    >>> measured = ss.io.measured_forces(row, 0.5, i, j, force)
    >>> strong_network(measured).grains.tolist()
    [0, 1, 2]
    """
    net = force_network(source, law)
    net = net.reversed() if tension else net
    n = len(net.radius)
    strong = net.force_n > net.mean
    rows = np.flatnonzero(strong & net.inner)
    graph = sparse.coo_array((np.ones(len(rows)), (net.pair_i[rows], net.pair_j[rows])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label, minlength=1)
    grains = np.flatnonzero(label == np.argmax(size)) if len(rows) else np.zeros(0, int)
    borne = np.maximum(net.force_n, 0.0) * np.linalg.norm(net.branch, axis=1)
    share = float(borne[strong].sum() / borne.sum()) if borne.any() else 0.0
    return StrongNetwork(strong, strong & np.isin(net.pair_i, grains), grains, int((size > 1).sum()), share)


@checked
@knows_bonds
def force_anisotropy(source: Source, law: Law | None = None) -> Anisotropy:
    """Anisotropies a_c, a_n, a_t of contact directions, normal forces and tangential forces, from second-order tensors.

    In a plane, the frequency of contacts is proportional to 1 + a_c cos 2(θ − θ_c), their mean normal force is f₀ (1 +
    a_n cos 2(θ − θ_n)), and their mean tangential force is f₀ a_t sin 2(θ − θ_t). In three dimensions, with unit
    vectors n, these are 1 + n·A n and so on, and a is √(3/2) |A|. a_t is negative if tangential forces reduce the
    deviator of the stress. Only contacts between grains count.

    Parameters
    ----------
    source, law : as in `force_network`; the normal forces must add up to a compression

    Source
    ------
    Rothenburg & Bathurst, doi:10.1680/geot.1989.39.4.601; in three dimensions Guo & Zhao,
    doi:10.1016/j.compgeo.2012.07.001.

    Examples
    --------
    >>> import numpy as np
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(100, packing_fraction=0.9, dim=2, seed=1)
    >>> found = force_anisotropy(state, ss.laws.hertz_mindlin(mu=0.5))
    >>> bool(abs(found.contacts) < 0.3)
    True
    """
    net = force_network(source, law)
    dim, rows = net.dim, np.flatnonzero(net.inner)
    normal, force_n, across = net.normal[rows, :dim], net.force_n[rows], net.tangential[rows, :dim]
    if not force_n.sum() > 0:
        raise ValueError(
            f"the normal forces of {len(rows)} contacts of grains add up to {force_n.sum():.3g}: anisotropies are "
            "defined under compression"
        )
    pairs = normal[:, :, None] * normal[:, None]
    of_contacts = _deviator(pairs.mean(axis=0)) * {2: 4.0, 3: 7.5}[dim]
    weight = 1 / np.maximum(1 + np.einsum("ca,ab,cb->c", normal, of_contacts, normal), 1 / len(rows))
    mean_n = np.einsum("c,cab->ab", weight * force_n, pairs) / len(rows)
    mean_t = np.einsum("c,ca,cb->ab", weight, across, normal) / len(rows)
    scale = np.trace(mean_n)
    of_normal = _deviator(mean_n) * {2: 4.0, 3: 7.5}[dim] / scale
    of_tangential = _deviator((mean_t + mean_t.T) / 2) * {2: 4.0, 3: 5.0}[dim] / scale
    stress = np.einsum("ca,cb->ab", net.force[rows, :dim], net.branch[rows, :dim])
    stress = (stress + stress.T) / 2
    main = _deviator(stress)
    sign = -1.0 if np.tensordot(of_tangential, main) < 0 else 1.0
    return Anisotropy(
        _size(of_contacts), _size(of_normal), sign * _size(of_tangential), _axis(of_contacts), _axis(of_normal),
        _size(main) / float(np.trace(stress)) * dim, dim,
    )  # fmt: skip


def _deviator(tensor: np.ndarray) -> np.ndarray:
    return tensor - np.trace(tensor) / len(tensor) * np.eye(len(tensor))


def _size(deviator: np.ndarray) -> float:
    """Largest principal value in a plane, √(3/2) times the norm in three dimensions."""
    return float(np.sqrt((deviator**2).sum() * (0.5 if len(deviator) == 2 else 1.5)))


def _axis(deviator: np.ndarray) -> np.ndarray:
    axis = np.linalg.eigh(deviator)[1][:, -1]
    return np.pad(axis * (1 if axis[np.argmax(np.abs(axis))] > 0 else -1), (0, 3 - len(axis)))
