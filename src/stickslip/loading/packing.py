"""Initial packings: a row of disks, and jammed disks or spheres; simple shear and reduced cells."""

from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize, whose import takes a tenth of a second, is imported on first use

from ..core.arguments import Positive, Seed, Values, checked, knows_bonds, require_index
from ..core.contacts.forces import accept, forces
from ..core.contacts.neighbors import with_neighbor_list
from ..core.control import body_numbers
from ..core.dynamics.cell_motion import strained
from ..core.fields import pack_keys
from ..core.laws.builtin import DAMPING_N, DAMPING_T, MU, Law, hertz_mindlin
from ..core.measure import (
    coordination,
    elastic_energy,
    least_supports,
    mean_normal_force,
    packing_fraction,
    periodic_box,
    pressure,
    rattlers,
    touching,
)
from ..core.progress import NotInEquilibriumError, Size, require_sizes
from ..core.readable import pluralize, readable
from ..core.scales import Scales, natural_scales
from ..core.state import PER_PAIR, SLIDE, Contacts, State, as_rows, assembly, box, disks, flat_walls, loads, spheres
from ..core.units import units_of
from ..data.law_schema import SUBSTRATE
from ..solve.balance import residual
from ..solve.equilibrate import BALANCED, equilibrate, quench
from ..solve.linear import one_thread


@checked
def disk_array(
    n: int = 10,
    radius: Values = 0.5,
    *,
    press: float,
    push: float = 0.0,
    disk: int = 0,
    mass: Values = 1.0,
    i0: float = 0.5,
    gap: float = 0.0,
) -> State:
    """A row of disks on a substrate at y = 0, periodic along x, not yet in equilibrium.

    Parameters
    ----------
    n : int, number of disks
    radius : float or (n,) [length]
    press : float, force on every disk towards the substrate [force]
    push : float, force along x on disk number `disk`, counted from 0 [force]
    mass : float or (n,) [mass]; i0 : float, for a moment of inertia i0 m R²
    gap : float, initial distance between neighbours, negative if they overlap [length]

    Source
    ------
    doi:10.48550/arXiv.1908.11724, Fig 1.

    Examples
    --------
    >>> disk_array(3, press=5e-5).grains.position[:, 0]
    array([0.5, 1.5, 2.5])
    """
    if n < 1:
        raise ValueError(f"n must be at least 1 disk, got {n}")
    require_sizes([Size(f"n = {n} makes", n, "grains", "use fewer")])
    n = int(n)  # True is 1
    radius = as_rows(radius, n)
    after = np.roll(radius, -1)
    spacing = np.sqrt((radius + after + gap) ** 2 - (radius - after) ** 2)  # centres of unequal disks differ in height
    centers = radius[0] + np.concatenate([[0.0], np.cumsum(spacing[:-1])])
    length = float(spacing.sum())
    grains = disks(np.stack([centers, radius], axis=1), radius, mass=mass, i0=i0)
    force = np.zeros((n, 3))
    force[:, 1] = -press
    require_index(n, disk=disk)
    force[disk, 0] += push
    wall = flat_walls([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], material=SUBSTRATE)
    cell = box([length, 1.0, 1.0], [True, False, False], dim=2)
    return assembly(grains, wall, cell, loads(n, 1, force=force))


@checked
def with_push(state: State, push: float, disk: int = 0) -> State:
    """State with a different force along x on one disk [force]."""
    force = state.control.force.copy()
    force[body_numbers(state.control, disk), 0] = push
    return state._replace(control=state.control._replace(force=force))


DENSEST = 1.5  # packing fraction beyond which grains overlap by a large part of their radius
MANY = 2000  # least number of grains for which FIRE is used; for fewer, stored numbers depend on samples from L-BFGS-B
JAMMED = {2: 0.84, 3: 0.64}  # packing fractions around which frictionless grains jam


@readable(head=lambda info: _describe(info), rows=lambda info: _rows(info))
class PackingInfo(NamedTuple):
    """Properties of a packing. Rattlers have fewer than dim + 1 contacts without friction, or fewer than 2 with it."""

    packing_fraction: float  # [1]
    pressure: float  # [force/length^(dim−1)]
    contacts: int
    coordination: float  # mean number of contacts of grains that are not rattlers [1]
    rattlers: int
    overlap: float  # mean overlap of contacts [length]
    residual: float  # largest unbalanced force or torque/R [force]
    sliding: int  # contacts at the Coulomb limit
    largest_overlap: float  # [length]


@checked
def jammed(
    n: int,
    *,
    packing_fraction: Positive | None = None,
    pressure: Positive | None = None,
    dim: int = 3,
    radius: Values = (0.5, 0.7),
    mass: Values = 1.0,
    i0: float | None = None,
    law: Law | None = None,
    seed: Seed = 0,
    tolerance: float | None = None,
):
    """Frictionless jammed packing in a periodic box, quenched from random positions; reproducible from its seed.

    The energy is minimised by SciPy's L-BFGS-B or, from 2000 grains on, by FIRE; then the forces are balanced by
    `equilibrate`. A given pressure is reached by repeated affine compression (or expansion) and quenching.

    Source of FIRE: Bitzek et al., doi:10.1103/PhysRevLett.97.170201.

    Parameters
    ----------
    packing_fraction : float, volume of all grains (overlaps counted twice) divided by that of the box (area in 2D)
    pressure : float [force/length^(dim−1)], reached to a relative accuracy of 1e-6; give this or the packing fraction
    dim : 2 (disks) or 3 (spheres)
    radius : float; or a few sizes with equal numbers of grains, such as (0.5, 0.7) for half and half; or (n,) radii
        [length]
    mass, i0 : as in `disks`; I0 is 1/2 for disks and 2/5 for spheres unless given
    law : Law whose normal force is used; default `hertz_mindlin()`. Friction and dashpots are ignored until the forces
        balance; with friction, contacts then stick without slip
    tolerance : float, largest unbalanced force [force]; default: as in `equilibrate`

    Returns
    -------
    State, PackingInfo

    Raises
    ------
    ValueError
        If the packing does not jam at this packing fraction, or does not reach the pressure.

    Examples
    --------
    >>> state, report = jammed(30, packing_fraction=0.68, seed=1)
    >>> report.rattlers, round(report.packing_fraction, 3)
    (0, 0.68)
    """
    if (packing_fraction is None) == (pressure is None):
        raise ValueError("give either packing_fraction or pressure")
    if packing_fraction is not None and packing_fraction > DENSEST:
        raise ValueError(f"packing_fraction must be at most {DENSEST}, got {packing_fraction}")
    given = hertz_mindlin() if law is None else law
    law = frictionless(given)
    start = packing_fraction or 1.03 * JAMMED.get(dim, 1.0)
    state = random_grains(n, start, dim, radius=radius, mass=mass, i0=i0, seed=seed)
    state = balance(state, law, tolerance)
    if pressure is not None:
        state = _compress(state, law, pressure, tolerance)
    report = packing_info(state, law)
    if not _is_jammed(state, law, tolerance):
        raise ValueError(
            f"grains do not jam at packing fraction {report.packing_fraction:.4g}: no force between them exceeds the "
            f"tolerance of {_least(state, law, tolerance):g}; frictionless grains need about {JAMMED[dim]} in {dim} "
            "dimensions"
        )
    return accept(state, forces(state, given)[1]), report


@checked
def frictionless(law: Law) -> Law:
    """Law with the same normal force, without friction and dashpots."""
    table = law.table.copy()
    table[..., [MU, DAMPING_N, DAMPING_T]] = 0.0
    return law._replace(table=table)


def packing_info(state: State, law: Law) -> PackingInfo:
    """Properties of an accepted packing."""
    contacts, rows = state.contacts, touching(state)
    radius = state.grains.radius
    overlap = radius[contacts.i[rows]] + radius[contacts.j[rows]] - np.linalg.norm(contacts.pair[rows], axis=1)
    least = least_supports(law, state.cell.dim)
    return PackingInfo(
        packing_fraction(state),
        pressure(state, law),
        len(rows),
        coordination(state, least),
        int(rattlers(state, least).sum()),
        float(overlap.mean()) if len(rows) else 0.0,
        residual(state, law)[0],
        int(((contacts.mode == SLIDE) & contacts.slip.any(axis=1))[rows].sum()),
        float(overlap.max(initial=0.0)),
    )


def _describe(info: PackingInfo) -> str:
    loose = pluralize(info.rattlers, "rattler")
    return (
        f"packing fraction {info.packing_fraction:.4g}, pressure {info.pressure:.4g}, {info.contacts} contacts, {loose}"
    )


def _rows(info: PackingInfo):
    pressure = units_of(PackingInfo)["pressure"]
    yield "packing fraction", info.packing_fraction, "", "volume of the grains over that of the cell"
    yield "pressure", info.pressure, pressure
    yield "contacts", info.contacts, "", f"{info.sliding} of them at the Coulomb limit"
    yield "mean contact number", info.coordination, "", "without rattlers"
    yield "rattlers", info.rattlers, "", "grains without support"
    yield "largest overlap", info.largest_overlap, "length", f"{info.overlap:.4g} on average"
    yield "residual", info.residual, "force", "largest unbalanced force or torque/R"


def random_grains(
    n: int, fraction: float, dim: int, *, radius, mass, i0: float | None, seed: int, length: float | None = None
) -> State:
    """State of grains at random positions in a square or cubic periodic box of a given packing fraction.

    Powers are evaluated in units of `length`, by default the smallest diameter, so that results do not depend on units.
    """
    if dim not in JAMMED:
        raise ValueError(f"dim must be 2 (disks) or 3 (spheres), got {dim}")
    sizes = check_radii(radius, n)
    length = 2.0 * float(sizes.min()) if length is None else length
    volume = np.sum(np.pi * sizes**2 if dim == 2 else 4 / 3 * np.pi * sizes**3)
    side = length * float(volume / length**dim / fraction) ** (1 / dim)
    if side < 2 * sizes.max():
        raise ValueError(
            f"{n} grains at packing fraction {fraction:g} need a box of side {side:.3g}, narrower than the largest "
            f"grain ({2 * sizes.max():g}): use more grains"
        )
    n = len(sizes)
    position = np.zeros((n, 3))
    position[:, :dim] = np.random.default_rng(seed).uniform(0, side, (n, dim))
    make = disks if dim == 2 else spheres
    grains = make(position, sizes, mass=mass, **({} if i0 is None else {"i0": i0}))
    return assembly(grains, cell=box([side, side, side if dim == 3 else 1.0], [True, True, dim == 3], dim))


def check_radii(radius, n: int) -> np.ndarray:
    """Radii of n grains, from one radius, a few radii shared by equal numbers of grains, or n radii."""
    if n < 2:
        raise ValueError(f"a packing needs at least 2 grains, got n = {n}")
    require_sizes([Size(f"n = {n} makes", n, "grains", "use fewer")])
    n = int(n)
    sizes = np.atleast_1d(np.asarray(radius, float))
    if sizes.ndim != 1 or len(sizes) > n or not ((sizes >= 1e-100) & (sizes <= 1e100)).all():
        got = f"{radius}" if np.ndim(radius) == 0 else f"{len(sizes)} numbers from {sizes.min():g}"
        raise ValueError(f"radius must be one, a few, or {n} positive numbers, got {got}")
    return sizes.copy() if len(sizes) == n else sizes[np.arange(n) * len(sizes) // n]


def balance(state: State, law: Law, tolerance: float | None, length: float | None = None) -> State:
    """Minimise the elastic energy from the given positions, then balance the forces.

    `length` is the Euclidean norm of the first displacement over all grains; default: the smallest diameter. The
    default tolerance is that of `equilibrate`.
    """
    many, scales = len(state.grains.radius) >= MANY, natural_scales(state, law, length)
    near = quench(state, law, 0.5 * _least(state, law, tolerance)) if many else _minimise(state, law, scales)
    end, outcome = equilibrate(near, law, tolerance=tolerance, check="nothing")
    if not outcome.ok:
        raise NotInEquilibriumError("the forces of the packing could not be balanced", outcome)
    return end


def _minimise(state: State, law: Law, scales: Scales) -> State:
    """Minimise the elastic energy by L-BFGS-B, whose first step has the size 1 in its coordinates."""
    n, dim, length = len(state.grains.radius), state.cell.dim, scales.length
    scale = scales.force / length * float(state.grains.radius.mean()) ** 2  # [energy]
    latest = [state]  # keep the neighbour list, which stays valid for many evaluations

    def state_at(q):
        position = np.zeros((n, 3))
        position[:, :dim] = length * q.reshape(n, dim)
        latest[0] = with_neighbor_list(latest[0]._replace(grains=state.grains._replace(position=position)))
        return latest[0]

    def energy(q):
        here = state_at(q)
        loads, trial = forces(here, law)
        return elastic_energy(accept(here, trial), law) / scale, -loads.force[:n, :dim].ravel() * length / scale

    with one_thread():  # many tiny systems: on a busy machine, BLAS threads would take ten times as long
        best = scipy.optimize.minimize(
            energy,
            state.grains.position[:, :dim].ravel() / length,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": 20_000, "maxfun": 40_000, "ftol": 0.0, "gtol": 1e-9, "maxcor": 20},
        )
    return state_at(best.x)


def _least(state: State, law: Law, tolerance: float | None) -> float:
    """Tolerance for the balance of forces, by default that of `equilibrate` without round-off [force]."""
    return BALANCED * natural_scales(state, law).force if tolerance is None else tolerance


def _is_jammed(state: State, law: Law, tolerance: float | None) -> bool:
    """Return True if the contact forces exceed the residuals of a balanced packing."""
    return mean_normal_force(state, law) > _least(state, law, tolerance)


def _compress(state: State, law: Law, wanted: float, tolerance: float | None) -> State:
    """Compress and quench until the given pressure is reached; p^(2/3) is nearly linear in the strain."""
    dim, strain, step, before = state.cell.dim, 0.0, -0.003, None
    reference, scales = state, natural_scales(state, law)
    unit = scales.force / scales.length ** (dim - 1)  # unit of pressure
    for _ in range(60):
        now = pressure(state, law) if _is_jammed(state, law, tolerance) else 0.0
        if abs(now / wanted - 1) < 1e-6:
            return state
        here = (strain, (now / unit) ** (2 / 3))
        if now > 0 and before and before[1] > 0 and abs(here[1] - before[1]) > 1e-14:
            step = ((wanted / unit) ** (2 / 3) - here[1]) * (here[0] - before[0]) / (here[1] - before[1])
            step = float(np.clip(step, -0.02, 0.02))
        elif now > wanted:
            step = abs(step)
        before, strain = here, strain + step
        gradient = np.zeros((3, 3))
        gradient[:dim, :dim] = step * np.eye(dim)
        state = balance(strained(state, gradient), law, tolerance)
    raise ValueError(
        f"pressure {wanted:g} was not reached within 60 compressions (from {pressure(reference, law):.3g} to "
        f"{pressure(state, law):.3g}): give a packing fraction instead"
    )


@checked
@knows_bonds
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

    Nothing physical changes; only images of contacts and bonds, and keys of contacts, are rewritten.
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
    bonds = state.bonds and state.bonds._replace(image=(state.bonds.image @ back).astype(np.int16))
    return state._replace(cell=state.cell._replace(vectors=vectors), contacts=rows, bonds=bonds)


def wrapped(state: State) -> State:
    """Same packing with every grain in the cell, for unlimited flow; the state must have no springs to load points.

    Nothing physical changes: positions shift by whole cells, and images, keys and pair vectors are rewritten.
    """
    cell, contacts, n, count = state.cell, state.contacts, len(state.grains.radius), int(state.contacts.count[0])
    box = np.zeros((state.n_bodies, 3), np.int64)  # walls keep their positions
    box[:n] = periodic_box(state)
    i, j, pair = contacts.i[:count], contacts.j[:count], contacts.pair.copy()
    between, shift = (j < n)[:, None], box @ cell.vectors
    pair[:count] -= np.where(between, 0.0, shift[i])
    image = contacts.image[:count] + np.where(between, box[i] - box[j], 0)
    rows = _with_images(contacts._replace(pair=pair, origin=contacts.origin - shift), image)
    return state._replace(grains=state.grains._replace(position=state.grains.position - shift[:n]), contacts=rows)


def _with_images(contacts: Contacts, images: np.ndarray) -> Contacts:
    """Contact list with other images for its valid rows, sorted by its new keys."""
    count = len(images)
    image, key, slip, pair = (a.copy() for a in (contacts.image, contacts.key, contacts.slip, contacts.pair))
    image[:count] = images
    lead = np.take_along_axis(image, np.argmax(image != 0, axis=1)[:, None], axis=1)[:, 0]
    mirrored = (contacts.i == contacts.j) & (lead < 0)  # pairs of a grain and its own image are listed once
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

    If the second vector of a rotated cell has no height, it is the strain of the vector with the largest y component.
    """
    vectors = state.cell.vectors
    lean = vectors[1] if vectors[1, 1] else vectors[np.argmax(np.abs(vectors[:, 1]))]
    return float(lean[0] / lean[1])
