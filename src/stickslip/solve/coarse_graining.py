"""Continuum fields of a packing: density, velocity and stress on a grid, smoothed with a Gaussian.

The fields satisfy the balance of momentum exactly: in equilibrium, ∂_b σ_ab is the density of the other forces.
"""

from typing import TYPE_CHECKING

import numpy as np

from ..core.arguments import Positive, checked
from ..core.laws.builtin import Law
from ..core.measure import branch_vectors, contact_forces, touching
from ..core.state import State, grain_volumes

if TYPE_CHECKING:
    import xarray as xr

CUT = 6.0  # cutoff radius of the Gaussian, in widths
MOST_POINTS, MOST_IMAGES = 10**7, 10**4
CHUNK = 20_000  # number of sources whose weights are stored at once
_FIELDS = {  # names, numbers of entries and units
    "density": (1, "mass/length^{dim}"), "packing_fraction": (1, "1"), "momentum": (3, "mass/(length^{less} time)"),
    "kinetic_stress": (9, "force/length^{less}"), "stress": (9, "force/length^{less}"),
}  # fmt: skip


@checked
def coarse_grained(state: State, law: Law, *, width: Positive, spacing: Positive | None = None) -> "xr.Dataset":
    """Density, packing fraction, velocity and stress as fields on a grid.

    The Gaussian is φ(r) = (2π w²)^(−dim/2) exp(−r²/2w²), cut at 6 w. The density is Σ m φ(x − x_i), the packing
    fraction is this sum with grain volumes in place of m, and the velocity is Σ m v φ/density. `stress` is the sum of
    f ⊗ r ∫₀¹ φ(x − x_i + s r) ds over contacts, with the force f on i and the branch vector r (up to a wall's surface).
    `kinetic_stress` is Σ m v ⊗ v φ − density × velocity ⊗ velocity. Sums include periodic images. The cell is divided
    into equal parts, whose centres are the grid points.

    Parameters
    ----------
    state : State, accepted
    law : Law
    width : standard deviation of the Gaussian [length]
    spacing : grid spacing along each axis of the cell, rounded to fit; default `width` [length]

    Returns
    -------
    xarray.Dataset
        `density`, `packing_fraction`, `velocity`, `stress` of the elastic contact forces and `kinetic_stress` of
        velocity fluctuations, compression positive; tensors have the dimensions `component` (of the force) and
        `along` (of the branch vector). The velocity is NaN far from grains. Dimensions are x, y, z; in a tilted
        cell, they are a, b, c along its vectors, and x, y, z are coordinates. Along directions that are not periodic,
        the grid encloses the grains, and fields decrease to zero outside. The mean of `stress` over a periodic cell is
        `measure.stress`

    Source
    ------
    Goldhirsch, doi:10.1007/s10035-010-0181-z; at walls: Weinhart et al., doi:10.1007/s10035-012-0317-4.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> fields = coarse_grained(state, law, width=0.5)
    >>> round(float(fields.packing_fraction.mean()), 6)
    0.68
    """
    spacing = width if spacing is None else spacing
    origin, vectors, shape = _grid_of(state, spacing)
    axes = [(np.arange(n) + 0.5) / n for n in shape]
    share = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grains, points = state.grains, origin + share @ vectors
    momentum = grains.mass[:, None] * grains.velocity
    of_grains = grains.mass[:, None], grain_volumes(state)[:, None], momentum, _outer(momentum, grains.velocity)
    sources = (grains.position, np.hstack(of_grains)), _contact_sources(state, law, width)
    sums = [_smooth(state.cell, points, origin, vectors, width, *source) for source in sources]
    columns, start = np.concatenate(sums, axis=1), 0
    values = {}
    for name, (count, _) in _FIELDS.items():
        values[name], start = columns[:, start : start + count], start + count
    with np.errstate(divide="ignore", invalid="ignore"):
        velocity = values.pop("momentum") / values["density"]
    drift = np.nan_to_num(velocity)
    values["kinetic_stress"] = values["kinetic_stress"] - values["density"] * _outer(drift, drift)
    return _to_dataset(state, values | {"velocity": velocity}, shape, points.reshape(*shape, 3))


def _outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a[:, :, None] * b[:, None, :]).reshape(len(a), 9)


def _grid_of(state: State, spacing: float) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
    """Corner and vectors of the box that the grid fills, and the number of grid points along each vector."""
    grains, cell = state.grains, state.cell
    low = (grains.position - grains.radius[:, None]).min(axis=0)
    high = (grains.position + grains.radius[:, None]).max(axis=0)
    vectors = np.where(cell.periodic[:, None], cell.vectors, np.diag(high - low))
    origin = np.where(cell.periodic, 0.0, low)
    length = np.linalg.norm(vectors, axis=1)[: cell.dim]
    if (number := np.prod(length / spacing)) > MOST_POINTS:
        raise ValueError(
            f"spacing = {spacing:g} gives a grid of {number:.2g} points, more than {MOST_POINTS:g}: use a larger "
            "spacing"
        )
    shape = [max(1, round(side)) for side in length / spacing]
    if cell.dim == 2:
        vectors[2], origin[2] = (0.0, 0.0, 1.0), -0.5
    return origin, vectors, tuple(shape + [1] * (3 - cell.dim))


def _contact_sources(state: State, law: Law, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points along the branch vectors, and their contributions to the stress."""
    rows = touching(state)
    branch, force = branch_vectors(state)[rows], contact_forces(state, law)[rows]
    longest = np.linalg.norm(branch, axis=1).max(initial=0.0)
    node, weight = np.polynomial.legendre.leggauss(4 + int(np.ceil(3 * longest / width)))
    start = state.grains.position[state.contacts.i[rows]]
    points = start[:, None] - (0.5 + 0.5 * node)[:, None] * branch[:, None]
    values = 0.5 * weight[:, None] * _outer(force, branch)[:, None]
    return points.reshape(-1, 3), values.reshape(-1, 9)


def _smooth(cell, points, origin, vectors, width: float, position, values) -> np.ndarray:
    """Sum of the values at each point, weighted by the Gaussian of the distance to their positions and images."""
    from scipy.spatial import cKDTree  # slow to import

    out, tree = np.zeros((len(points), values.shape[1])), cKDTree(points)
    norm = (2 * np.pi * width**2) ** (-cell.dim / 2)
    for start in range(0, len(position), CHUNK):
        rows, places = _images(cell, origin, vectors, CUT * width, position[start : start + CHUNK])
        near = tree.sparse_distance_matrix(cKDTree(places), CUT * width, output_type="coo_matrix")
        near.data = norm * np.exp(-0.5 * (near.data / width) ** 2)
        out += near.tocsr() @ values[start + rows]
    return out


def _images(cell, origin, vectors, reach: float, position) -> tuple[np.ndarray, np.ndarray]:
    """Rows and positions of all periodic images within reach of the box."""
    inverse = np.linalg.inv(vectors)
    margin = reach * np.linalg.norm(inverse, axis=0)  # reach as a fraction of the heights of the box
    share = (position - origin) @ inverse
    share -= np.where(cell.periodic, np.floor(share), 0.0)
    most = [int(np.ceil(m)) if periodic else 0 for m, periodic in zip(margin, cell.periodic, strict=True)]
    if np.prod([2.0 * m + 1 for m in most]) > MOST_IMAGES:
        raise ValueError(f"width = {reach / CUT:g} exceeds the cell: use a fraction of its size")
    shifts = np.stack(np.meshgrid(*(np.arange(-m, m + 1) for m in most), indexing="ij"), axis=-1).reshape(-1, 3)
    moved = share[:, None] + shifts
    kept = ((moved > -margin) & (moved < 1 + margin)).all(axis=2)
    return np.nonzero(kept)[0], origin + moved[kept] @ vectors


def _to_dataset(state: State, values: dict, shape, points) -> "xr.Dataset":
    """Fields with dimensions, coordinates and units."""
    import xarray as xr

    dim = state.cell.dim
    leans = bool((state.cell.vectors - np.diag(np.diag(state.cell.vectors)))[state.cell.periodic].any())
    axes = tuple("abc" if leans else "xyz")[:dim]
    place = points.reshape(*shape[:dim], 3)
    ranks = {1: (), 3: ("component",), 9: ("component", "along")}
    units = {name: unit for name, (_, unit) in _FIELDS.items()} | {"velocity": "length/time"}
    fields = {}
    for name, column in values.items():
        rank = ranks[column.shape[1]]
        cut = column.reshape(*shape[:dim], *(3,) * len(rank))[(..., *(slice(dim),) * len(rank))]
        unit = units[name].format(dim=dim, less=dim - 1).replace("^1", "")
        fields[name] = ((*axes, *rank), cut, {"units": unit})
    names = list("xyz"[:dim])
    coordinates = {"component": names, "along": names}
    for k, name in enumerate(names):
        along = place[(*(slice(None) if m == k else 0 for m in range(dim)), k)]
        coordinates[name] = (axes, place[..., k]) if leans else (name, along)
    return xr.Dataset(fields, coordinates)
