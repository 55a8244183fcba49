"""Records of a run: samples at intervals, and contact events."""

from ctypes import string_at
from functools import cache
from typing import NamedTuple

import numpy as np

from ..contacts.bonds import add_bond_loads
from ..contacts.forces import bodies as bodies_of
from ..control import spring_forces
from ..library import core
from ..measure import contact_numbers, coordination, fabric, least_supports, rattlers, supports, touching
from ..readable import pluralize, readable
from ..state import OPEN, Cell, State, cell_volumes, groups
from .ledger import Books, Ledger, make_ledger

GROUPS = "position", "velocity", "force", "pull"  # samples of each rigid group: see `write_groups`
_SHAPES = {1: (), 3: (3,), 9: (3, 3)}  # shape of an observable, by its number of columns


@cache
def observables() -> dict[str, tuple[slice, tuple[int, ...]]]:
    """Columns and shape of each observable in the table of `observables.h`, by field of `Record`."""
    found, start = {}, 0
    while name := core.observable_name(len(found)):
        end = start + core.observable_width(len(found))
        found[string_at(name).decode()] = slice(start, end), _SHAPES[end - start]
        start = end
    return found


def columns() -> int:
    """Number of columns of all observables."""
    return max(mine.stop for mine, _ in observables().values())


@readable(head=lambda record: _describe(record), rows=lambda record: _rows(record))
class Record(NamedTuple):
    """Record of a run with T samples and P probed grains."""

    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) Σ|Δr|² over grains, from the reference positions [length²]
    kinetic_energy: np.ndarray  # (T,) [energy], translations and rotations of all grains
    center: np.ndarray  # (T, 3) mean position of the grains [length]
    touching: np.ndarray  # (T,) number of closed contacts
    sliding: np.ndarray  # (T,) number of contacts at the Coulomb limit
    virial: np.ndarray  # (T, 3, 3) Σ f ⊗ r over contacts between grains, elastic part [energy]; see `stress`
    fabric: np.ndarray  # (T, 3, 3) mean of n ⊗ n over closed contacts, zero if there are none [1]
    momentum_flux: np.ndarray  # (T, 3, 3) Σ m v ⊗ v over grains [energy]; kinetic stress times volume
    coordination: np.ndarray  # (T,) mean number of contacts per grain, walls included [1]
    held_coordination: np.ndarray  # (T,) mean number of contacts without rattlers: see `measure.coordination`
    rattlers: np.ndarray  # (T,) number of rattlers
    cell: np.ndarray  # (T, 3, 3) vectors of the cell as rows [length]
    group_position: np.ndarray  # (T, G, 3) centre of mass of each rigid group [length]
    group_velocity: np.ndarray  # (T, G, 3) [length/time]
    group_force: np.ndarray  # (T, G, 3) force of contacts on the group, dashpots included [force]
    group_pull: np.ndarray  # (T, G, 3) force of springs on the group [force]
    position: np.ndarray  # (T, P, 3) positions of the probed grains [length]
    angle: np.ndarray  # (T, P, 3) [rad]
    events: np.ndarray  # structured: kind ("closed", "opened", "limit", "broke"), time, i, j, image, position of i
    ledger: Ledger | None  # energy ledger, with `ledger=True`
    periodic: np.ndarray  # (3,) bool: whether the cell repeats along each of its vectors
    dim: int  # 2 for disks in a plane, or 3

    @property
    def sliding_fraction(self) -> np.ndarray:
        """Fraction of closed contacts at the Coulomb limit, (T,), zero if there are none."""
        return self.sliding / np.maximum(self.touching, 1)

    @property
    def volume(self) -> np.ndarray:
        """Volume of the cell, (T,) [length^dim]; raise ValueError if the cell is not periodic in all its dimensions."""
        return cell_volumes(self.cell, self.periodic, self.dim)

    @property
    def stress(self) -> np.ndarray:
        """Stress of the contacts between grains, (T, 3, 3), compression positive [force/length^(dim−1)].

        It is defined as in `measure.stress`: elastic forces, without dashpots and kinetic contributions.
        Raises ValueError if the cell is not periodic in all its dimensions.
        """
        return self.virial / self.volume[:, None, None]

    @property
    def pressure(self) -> np.ndarray:
        """Trace of the stress divided by the number of dimensions, (T,) [force/length^(dim−1)]."""
        return np.trace(self.stress, axis1=1, axis2=2) / self.dim

    @property
    def shear_stress(self) -> np.ndarray:
        """Shear stress −σ_xy, (T,), which resists a positive `shear_strain` [force/length^(dim−1)]."""
        return -self.stress[:, 0, 1]

    @property
    def strain(self) -> np.ndarray:
        """Displacement gradient G of the cell since the first sample, (T, 3, 3), extension positive [1].

        A vector h of the first cell has become h + G h, as in `packings.strained`.
        """
        used = np.where(self.cell.any(axis=2, keepdims=True), self.cell, np.eye(3))  # open space may have no vectors
        return np.swapaxes(np.linalg.solve(used[:1], used), 1, 2) - np.eye(3)

    @property
    def shear_strain(self) -> np.ndarray:
        """Shear strain G_xy since the first sample, (T,), displacement along x per distance along y [1]."""
        return self.strain[:, 0, 1]

    @property
    def volumetric_strain(self) -> np.ndarray:
        """Volumetric strain 1 − V/V_0 since the first sample, (T,), compression positive [1]."""
        return 1.0 - self.volume / self.volume[:1]


def _describe(record: Record) -> str:
    samples, events = pluralize(len(record.time), "sample"), pluralize(len(record.events), "contact event")
    span = f" from t = {record.time[0]:.6g} to {record.time[-1]:.6g}" if len(record.time) else ""
    return f"{samples}{span}, {pluralize(record.position.shape[1], 'probed grain')}, {events}"


def _rows(record: Record):
    """Table rows of a record: values at the first and last sample."""
    pressure = "force/length^(dim-1)"
    rows = [
        ("time", record.time, "time"),
        ("kinetic energy", record.kinetic_energy, "energy", "translations and rotations"),
        ("contacts that touch", record.touching),
        ("contacts that slide", record.sliding, "", "at the Coulomb limit"),
        ("mean contact number", record.held_coordination, "", "of grains that are not rattlers"),
        ("rattlers", record.rattlers),
    ]
    if record.periodic[: record.dim].all():
        rows += [
            ("pressure", record.pressure, pressure, "of contacts"),
            ("shear stress", record.shear_stress, pressure, "−σ_xy of contacts"),
            ("shear strain", record.shear_strain, "", "since the first sample"),
            ("volumetric strain", record.volumetric_strain, "", "since the first sample, compression positive"),
        ]
    yield "samples", len(record.time), "", "values of the first and last are listed below"
    for name, series, *more in rows if len(record.time) else ():
        first, last = f"{series[0]:.6g}", f"{series[-1]:.6g}"
        yield name, first if first == last else f"{first} to {last}", *more
    yield "probed grains", record.position.shape[1]
    yield "contact events", len(record.events) or None, "", "closed, opened or at the limit"


class RecordBuffers(NamedTuple):
    """Buffers for samples and events."""

    every: int
    reference: np.ndarray  # (N, 3)
    mass: np.ndarray  # (N,)
    inertia: np.ndarray  # (N,)
    unit: np.ndarray  # (B,) first member of the body's rigid group: see `measure.supports`
    supports: np.ndarray  # (B,)
    probes: np.ndarray  # (P,)
    series: np.ndarray  # (T, columns of all observables)
    groups: np.ndarray  # (T, G, 4, 3) position, velocity, force of contacts, force of springs of rigid groups
    tracks: np.ndarray  # (T, P, 6)
    events: np.ndarray  # (E, 10) kind, time, i, j, image, position of i
    event_count: np.ndarray  # (1,)


def write_groups(row: np.ndarray, state: State, external, bodies, force, time: float) -> None:
    """Write one sample of all rigid groups; `force` (B, 6) holds the total load on the group at each member."""
    mass, pull = state.grains.mass, spring_forces(state.control, bodies.position, time)
    for g, members in enumerate(groups(state.control)):
        if not len(members):
            continue
        m = mass[members] if members[-1] < len(mass) else np.ones(len(members))
        sprung = pull[members].sum(axis=0)
        row[g, 0], row[g, 1] = m @ bodies.position[members] / m.sum(), bodies.velocity[members[0]]
        row[g, 2], row[g, 3] = force[members[0], :3] - external[0, members].sum(axis=0) - sprung, sprung


def add_bonds(row: np.ndarray, state: State, law) -> None:
    """Add the bonds of a state to a sample that already has the contributions of contacts; see `measure.touching`."""
    virial, nothing, least = np.zeros((3, 3)), np.zeros((state.n_bodies, 3)), least_supports(law, state.cell.dim)
    add_bond_loads(state.bonds, state.cell.dim, bodies_of(state), state.cell.vectors, nothing, nothing.copy(), virial)
    values = {
        "touching": len(touching(state)), "fabric": fabric(state), "coordination": contact_numbers(state).mean(),
        "held_coordination": coordination(state, least), "rattlers": rattlers(state, least).sum(),
        "virial": row[observables()["virial"][0]] + virial.ravel(),
    }  # fmt: skip
    for name, value in values.items():
        row[observables()[name][0]] = np.ravel(value)


def allocate_buffers(state: State, steps: int, every: int, probes, events: bool, reference) -> RecordBuffers:
    """Allocate buffers for the samples and events of a run."""
    n, samples = len(state.grains.radius), steps // every + 1 if every else 0
    probes = np.atleast_1d(np.asarray(probes, np.int64))
    if ((probes < 0) | (probes >= n)).any():
        raise ValueError(f"probes must be grain numbers from 0 to {n - 1}, got {probes.tolist()}")
    reference = state.grains.position if reference is None else np.asarray(reference, float)
    if reference.shape != (n, 3):
        raise ValueError(f"reference must have shape {(n, 3)}, got {reference.shape}")
    room = max(1024, 8 * len(state.contacts.i)) if events else 0
    known = reference, state.grains.mass, state.grains.inertia, *supports(state), probes
    return RecordBuffers(
        every, *map(np.ascontiguousarray, known), np.zeros((samples, columns())),
        np.zeros((samples, state.control.group.max(initial=-1) + 1, 4, 3)), np.zeros((samples, len(probes), 6)),
        np.zeros((room, core.EVENT)), np.zeros(1, np.int64),
    )  # fmt: skip


def with_lost_contacts(writing: RecordBuffers, before, after, position, time) -> RecordBuffers:
    """Record the contacts that left the list in one step as opened."""
    if not len(writing.events):
        return writing
    n, count = int(before.count[0]), int(writing.event_count[0])
    lost = np.flatnonzero((before.mode[:n] != OPEN) & ~np.isin(before.key[:n], after.key[: after.count[0]]))
    if not len(lost):
        return writing
    rows = [(core.OPENED, time, before.i[c], before.j[c], *before.image[c], *position[before.i[c]]) for c in lost]
    writing.event_count[0] += len(lost)
    return writing._replace(events=np.concatenate([writing.events[:count], rows, writing.events[count:]]))


_EVENT_TYPE = np.dtype(
    [("kind", "U6"), ("time", float), ("i", int), ("j", int), ("image", int, 3), ("position", float, 3)]
)
_EVENT_NAMES = np.array(["closed", "opened", "limit", "broke"])


def make_record(writing: RecordBuffers, done: int, books: Books | None, cell: Cell) -> Record:
    """Make the record of a run of `done` steps."""
    kept = done // writing.every + 1 if writing.every else 0
    series, tracks, rows = writing.series[:kept], writing.tracks[:kept], writing.events[: writing.event_count[0]]
    events = np.zeros(len(rows), _EVENT_TYPE)
    events["kind"] = _EVENT_NAMES[rows[:, 0].astype(int)]
    events["time"], events["i"], events["j"] = rows[:, 1], rows[:, 2], rows[:, 3]
    events["image"], events["position"] = rows[:, 4:7], rows[:, 7:10]
    return Record(
        **{name: series[:, mine].reshape(-1, *shape) for name, (mine, shape) in observables().items()},
        **{f"group_{name}": writing.groups[:kept, :, k] for k, name in enumerate(GROUPS)},
        position=tracks[..., :3],
        angle=tracks[..., 3:],
        events=events,
        ledger=make_ledger(books, kept) if books else None,
        periodic=cell.periodic,
        dim=cell.dim,
    )
