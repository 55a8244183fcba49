"""Simple shear of a periodic cell, reduced cells, and grains inside them."""

import numpy as np

from ..core.arguments import checked
from ..core.dynamics.cell_motion import strained
from ..core.fields import pack_keys
from ..core.state import PER_PAIR, Contacts, State


@checked
def sheared(state: State, strain: float, *, slip: bool = True) -> State:
    """Simple shear by `strain` along x, with the gradient along y; see `strained`.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> round(ss.measure.shear_strain(ss.packings.sheared(state, 1e-3)), 9)
    0.001
    """
    gradient = np.zeros((3, 3))
    gradient[0, 1] = strain
    return strained(state, gradient, slip=slip)


@checked
def reduced_cell(state: State) -> State:
    """Same packing in the least skewed cell of its lattice, for unlimited shear.

    Nothing physical changes; only images and keys of the contacts are rewritten.
    """
    vectors, change = state.cell.vectors.copy(), np.eye(3, dtype=np.int64)
    axes = [k for k in range(3) if state.cell.periodic[k]]
    moved = True
    while moved:
        moved = False
        for a in axes:
            for b in axes:
                if a != b and (k := round(float(vectors[a] @ vectors[b] / (vectors[b] @ vectors[b])))):
                    shorter = vectors[a] - k * vectors[b]
                    if shorter @ shorter < vectors[a] @ vectors[a] * (1 - 1e-12):
                        vectors[a], moved = shorter, True
                        change[a] -= k * change[b]
    count = int(state.contacts.count[0])
    back = np.round(np.linalg.inv(change)).astype(np.int64)
    rows = _with_images(state.contacts, state.contacts.image[:count] @ back)
    return state._replace(cell=state.cell._replace(vectors=vectors), contacts=rows)


def wrapped(state: State) -> State:
    """Same packing with every grain in the cell, for unlimited flow; for states without springs to load points.

    Nothing physical changes: positions shift by whole cells, and images, keys and pair vectors are rewritten.
    """
    cell, contacts, n, count = state.cell, state.contacts, len(state.grains.radius), int(state.contacts.count[0])
    used = np.where(cell.vectors.any(axis=1)[:, None], cell.vectors, np.eye(3))
    box = np.zeros((state.n_bodies, 3), np.int64)  # walls stay where they are
    box[:n] = np.where(cell.periodic, np.floor(state.grains.position @ np.linalg.inv(used)), 0.0)
    i, j, pair = contacts.i[:count], contacts.j[:count], contacts.pair.copy()
    between, shift = (j < n)[:, None], box @ cell.vectors
    pair[:count] -= np.where(between, 0.0, shift[i])
    image = contacts.image[:count] + np.where(between, box[i] - box[j], 0)
    rows = _with_images(contacts._replace(pair=pair, origin=contacts.origin - shift), image)
    return state._replace(grains=state.grains._replace(position=state.grains.position - shift[:n]), contacts=rows)


def _with_images(contacts: Contacts, images: np.ndarray) -> Contacts:
    """List with other images for its valid rows, sorted by its new keys."""
    count = len(images)
    image, key, slip, pair = (a.copy() for a in (contacts.image, contacts.key, contacts.slip, contacts.pair))
    image[:count] = images
    lead = np.take_along_axis(image, np.argmax(image != 0, axis=1)[:, None], axis=1)[:, 0]
    mirrored = (contacts.i == contacts.j) & (lead < 0)  # a grain and its own image: such pairs are listed once
    for a in (image, slip, pair):
        a[mirrored] *= -1
    key[:count] = pack_keys(contacts.i[:count], contacts.j[:count], image[:count])
    order = np.concatenate([np.argsort(key[:count]), np.arange(count, len(key))])
    rows = contacts._replace(image=image, key=key, slip=slip, pair=pair)
    parts = {name: getattr(rows, name) for name in PER_PAIR}
    return rows._replace(
        **{name: np.ascontiguousarray(p[order]) for name, p in parts.items() if p is not None and len(p)}
    )


@checked
def shear_strain(state: State) -> float:
    """Shear strain γ, the tangent of the angle by which the second cell vector leans along x.

    In a turned cell whose second vector has no height, it is that of the vector that is highest along y.
    """
    vectors = state.cell.vectors
    lean = vectors[1] if vectors[1, 1] else vectors[np.argmax(np.abs(vectors[:, 1]))]
    return float(lean[0] / lean[1])
