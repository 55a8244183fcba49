"""Records of a run: samples at intervals, and events of contacts."""

from typing import NamedTuple

import numpy as np
from numba import njit

from ..contacts.forces import EVENT_COLUMNS, OPENED, elastic_pair
from ..contacts.geometry import normal_and_overlap, pair_vector
from ..control import spring_forces
from ..laws.builtin import MU
from ..readable import readable
from ..state import OPEN, SLIDE, State, groups
from .ledger import Books, Ledger, make_ledger

SERIES = (
    "time", "msd", "kinetic_energy", "center_x", "center_y", "center_z", "touching", "sliding",
    *(f"{name}_{a}{b}" for name in ("virial", "fabric", "kinetic") for a in "xyz" for b in "xyz"),
    "rattlers", "held_contacts", "contacts", *(f"cell_{a}{b}" for a in "xyz" for b in "xyz"),
)  # fmt: skip
_VIRIAL, _FABRIC, _KINETIC, _RATTLERS, _HELD, _CONTACTS, _CELL = 8, 17, 26, 35, 36, 37, 38


@readable
class Record(NamedTuple):
    """Record of a run with T samples and P probed grains."""

    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) Σ|Δr|² over grains, from the reference positions [length²]
    kinetic_energy: np.ndarray  # (T,) [energy], translations and rotations of all grains
    center: np.ndarray  # (T, 3) mean position of the grains [length]
    touching: np.ndarray  # (T,) number of closed contacts
    sliding: np.ndarray  # (T,) number of contacts at Coulomb's limit
    virial: np.ndarray  # (T, 3, 3) Σ f ⊗ r over contacts between grains, elastic part [energy]; stress times volume
    fabric: np.ndarray  # (T, 3, 3) mean of n ⊗ n over closed contacts, zero without any
    momentum_flux: np.ndarray  # (T, 3, 3) Σ m v ⊗ v over grains [energy]; kinetic stress times volume
    coordination: np.ndarray  # (T,) mean number of contacts per grain, walls included
    held_coordination: np.ndarray  # (T,) the same without rattlers and their contacts: see `measure.coordination`
    rattlers: np.ndarray  # (T,) number of rattlers
    cell: np.ndarray  # (T, 3, 3) vectors of the cell as rows [length]
    group_position: np.ndarray  # (T, G, 3) centre of mass of each rigid group [length]
    group_velocity: np.ndarray  # (T, G, 3) [length/time]
    group_force: np.ndarray  # (T, G, 3) of contacts on the group, dashpots included [force]
    group_pull: np.ndarray  # (T, G, 3) of springs on the group [force]
    position: np.ndarray  # (T, P, 3) of the probed grains [length]
    angle: np.ndarray  # (T, P, 3) [rad]
    events: np.ndarray  # structured: kind ("closed", "opened", "limit"), time, i, j, image, position of i
    ledger: Ledger | None  # with `ledger=True`

    @property
    def sliding_fraction(self) -> np.ndarray:
        """Fraction of closed contacts at Coulomb's limit, (T,), zero without any."""
        return self.sliding / np.maximum(self.touching, 1)


class RecordBuffers(NamedTuple):
    """Buffers for samples and events."""

    every: int
    reference: np.ndarray  # (N, 3)
    probes: np.ndarray  # (P,)
    series: np.ndarray  # (T, len(SERIES))
    groups: np.ndarray  # (T, G, 4, 3) of rigid groups: position, velocity, force of contacts, force of springs
    tracks: np.ndarray  # (T, P, 6)
    events: np.ndarray  # (E, len(EVENT_COLUMNS))
    event_count: np.ndarray  # (1,)


@njit(cache=True)
def _count_rattlers(contacts, n, bodies, least):
    """Number of rattlers, and of contacts of the other grains; see `measure.rattlers`."""
    loose, number = np.zeros(bodies, np.bool_), np.zeros(bodies, np.int64)
    while True:
        for a in range(bodies):
            number[a] = 0
        for c in range(contacts.count[0]):
            i, j = contacts.i[c], contacts.j[c]
            if contacts.mode[c] != OPEN and not loose[i] and not loose[j]:
                number[i] += 1
                number[j] += 1
        peeled = False
        for a in range(n):
            if number[a] < least and not loose[a]:
                loose[a] = peeled = True
        if not peeled:
            break
    rattlers = held = 0
    for a in range(n):
        rattlers += loose[a]
        held += number[a]
    return rattlers, held


@njit(cache=True)
def _has_friction(p):
    """Return True if some pair of materials has friction."""
    for a in range(len(p)):
        for b in range(len(p)):
            if p[a, b, MU] > 0.0:
                return True
    return False


@njit(cache=True)
def write_sample(kind, coulomb, dim, p, k, bodies, contacts, shift, plan, writing, vectors, time):
    """Write row k of the series and of the tracks."""
    x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
    row, track, n = writing.series[k], writing.tracks[k], len(plan.mass)
    for m in range(len(row)):  # loops instead of whole arrays compile faster, see `neighbors._build_list`
        row[m] = 0.0
    row[0] = time
    for a in range(n):
        for m in range(3):
            row[1] += (x[a, m] - writing.reference[a, m]) ** 2
            row[2] += 0.5 * plan.mass[a] * v[a, m] ** 2 + 0.5 * plan.inertia[a] * spin[a, m] ** 2
            row[3 + m] += x[a, m] / n
            for q in range(3):
                row[_KINETIC + 3 * m + q] += plan.mass[a] * v[a, m] * v[a, q]
    for c in range(contacts.count[0]):
        row[6] += contacts.mode[c] != OPEN
        row[7] += contacts.mode[c] == SLIDE
        if contacts.mode[c] == OPEN:
            continue
        i, j = contacts.i[c], contacts.j[c]
        row[_CONTACTS] += 2.0 if j < n else 1.0
        x0, x1, x2 = pair_vector(dim, x, shift, c, i, j)
        n0, n1, n2, _, _ = normal_and_overlap(i, j, j >= n, j - n, bodies.radius, bodies.normal, x0, x1, x2)
        normal = (n0, n1, n2)
        for m in range(3):
            for q in range(3):
                row[_FABRIC + 3 * m + q] += normal[m] * normal[q]
        if j < n:
            r, f = elastic_pair(kind, coulomb, dim, p, bodies, contacts, shift, c)
            for m in range(3):
                for q in range(3):
                    row[_VIRIAL + 3 * m + q] += f[m] * r[q]
    for m in range(9):
        row[_FABRIC + m] /= max(row[6], 1.0)
    row[_RATTLERS], row[_HELD] = _count_rattlers(contacts, n, len(bodies.radius), 2 if _has_friction(p) else dim + 1)
    for m in range(3):
        for q in range(3):
            row[_CELL + 3 * m + q] = vectors[m, q]
    for a in range(len(writing.probes)):
        for m in range(3):
            track[a, m] = x[writing.probes[a], m]
            track[a, 3 + m] = angle[writing.probes[a], m]


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


def allocate_buffers(state: State, steps: int, every: int, probes, events: bool, reference) -> RecordBuffers:
    """Allocate buffers for the samples and events of a run."""
    n, samples = len(state.grains.radius), steps // every + 1 if every else 0
    probes = np.asarray(probes, np.int64)
    if ((probes < 0) | (probes >= n)).any():
        raise ValueError(f"probes {probes.tolist()} were given: they must be grains between 0 and {n - 1}")
    reference = state.grains.position if reference is None else np.ascontiguousarray(reference, dtype=float)
    if reference.shape != (n, 3):
        raise ValueError(f"a reference of shape {reference.shape} was given: it must be {(n, 3)}")
    room = max(1024, 8 * len(state.contacts.i)) if events else 0
    return RecordBuffers(
        every, reference, probes, np.zeros((samples, len(SERIES))),
        np.zeros((samples, state.control.group.max(initial=-1) + 1, 4, 3)), np.zeros((samples, len(probes), 6)),
        np.zeros((room, len(EVENT_COLUMNS))), np.zeros(1, np.int64),
    )  # fmt: skip


def with_lost_contacts(writing: RecordBuffers, before, after, position, time) -> RecordBuffers:
    """Record contacts that left the list in one step as opened."""
    if not len(writing.events):
        return writing
    n, count = int(before.count[0]), int(writing.event_count[0])
    lost = np.flatnonzero((before.mode[:n] != OPEN) & ~np.isin(before.key[:n], after.key[: after.count[0]]))
    if not len(lost):
        return writing
    rows = [(OPENED, time, before.i[c], before.j[c], *before.image[c], *position[before.i[c]]) for c in lost]
    writing.event_count[0] += len(lost)
    return writing._replace(events=np.concatenate([writing.events[:count], rows, writing.events[count:]]))


_EVENT_TYPE = np.dtype(
    [("kind", "U6"), ("time", float), ("i", int), ("j", int), ("image", int, 3), ("position", float, 3)]
)
_EVENT_NAMES = np.array(["closed", "opened", "limit"])


def make_record(writing: RecordBuffers, done: int, books: Books | None) -> Record:
    """Make the record of a run of `done` steps."""
    kept = done // writing.every + 1 if writing.every else 0
    n = len(writing.reference)
    series, tracks, rows = writing.series[:kept], writing.tracks[:kept], writing.events[: writing.event_count[0]]
    events = np.zeros(len(rows), _EVENT_TYPE)
    events["kind"] = _EVENT_NAMES[rows[:, 0].astype(int)]
    events["time"], events["i"], events["j"] = rows[:, 1], rows[:, 2], rows[:, 3]
    events["image"], events["position"] = rows[:, 4:7], rows[:, 7:10]
    column = {name: series[:, k] for k, name in enumerate(SERIES)}
    return Record(
        column["time"],
        column["msd"],
        column["kinetic_energy"],
        series[:, 3:6],
        column["touching"],
        column["sliding"],
        *(series[:, at : at + 9].reshape(-1, 3, 3) for at in (_VIRIAL, _FABRIC, _KINETIC)),
        column["contacts"] / n,
        column["held_contacts"] / np.maximum(n - column["rattlers"], 1),
        column["rattlers"],
        series[:, _CELL : _CELL + 9].reshape(-1, 3, 3),
        *(writing.groups[:kept, :, k] for k in range(4)),
        tracks[..., :3],
        tracks[..., 3:],
        events,
        make_ledger(books, kept) if books else None,
    )
