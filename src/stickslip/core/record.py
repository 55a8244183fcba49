"""What a run writes down: samples at intervals and events of contacts."""

from typing import NamedTuple

import numpy as np
from numba import njit

from .forces import EVENT_COLUMNS, OPENED, elastic_pair
from .ledger import Books, Ledger, ledger_of
from .state import OPEN, SLIDE, State

SERIES = (
    "time", "msd", "kinetic_energy", "center_x", "center_y", "center_z", "touching", "sliding",
    *(f"virial_{a}{b}" for a in "xyz" for b in "xyz"),
)  # fmt: skip


class Record(NamedTuple):
    """What a run wrote down, T samples of P probed grains."""

    time: np.ndarray  # (T,) [time]
    msd: np.ndarray  # (T,) Σ|Δr|² over grains, from the reference positions [length²]
    kinetic_energy: np.ndarray  # (T,) [energy], translations and rotations of all grains
    center: np.ndarray  # (T, 3) mean position of the grains [length]
    touching: np.ndarray  # (T,) number of closed contacts
    sliding: np.ndarray  # (T,) number of contacts at Coulomb's limit
    virial: np.ndarray  # (T, 3, 3) Σ f ⊗ r over contacts between grains, elastic part [energy]; over volume: the stress
    position: np.ndarray  # (T, P, 3) of the probed grains [length]
    angle: np.ndarray  # (T, P, 3) [rad]
    events: np.ndarray  # structured: kind ("closed", "opened", "limit"), time, i, j, image, position of i
    ledger: Ledger | None  # with `ledger=True`


class Writing(NamedTuple):
    """Where the loop writes samples and events."""

    every: int
    reference: np.ndarray  # (N, 3)
    probes: np.ndarray  # (P,)
    series: np.ndarray  # (T, len(SERIES))
    tracks: np.ndarray  # (T, P, 6)
    events: np.ndarray  # (E, len(EVENT_COLUMNS))
    event_count: np.ndarray  # (1,)


@njit(cache=True)
def sample(kind, coulomb, dim, p, k, bodies, contacts, shift, plan, writing, time):
    """Row k of the series and of the tracks."""
    x, angle, v, spin = bodies.position, bodies.angle, bodies.velocity, bodies.spin
    row, track, n = writing.series[k], writing.tracks[k], len(plan.mass)
    row[:] = 0.0
    row[0] = time
    for a in range(n):
        for m in range(3):
            row[1] += (x[a, m] - writing.reference[a, m]) ** 2
            row[2] += 0.5 * plan.mass[a] * v[a, m] ** 2 + 0.5 * plan.inertia[a] * spin[a, m] ** 2
            row[3 + m] += x[a, m] / n
    for c in range(contacts.count[0]):
        row[6] += contacts.mode[c] != OPEN
        row[7] += contacts.mode[c] == SLIDE
        if contacts.mode[c] != OPEN and contacts.j[c] < n:
            r, f = elastic_pair(kind, coulomb, dim, p, bodies, contacts, shift, c)
            for m in range(3):
                for q in range(3):
                    row[8 + 3 * m + q] += f[m] * r[q]
    for a in range(len(writing.probes)):
        for m in range(3):
            track[a, m] = x[writing.probes[a], m]
            track[a, 3 + m] = angle[writing.probes[a], m]


def writing_of(state: State, steps: int, every: int, probes, events: bool, reference) -> Writing:
    """Room for the samples and events of a run."""
    n, samples = len(state.grains.radius), steps // every + 1 if every else 0
    probes = np.asarray(probes, np.int64)
    if ((probes < 0) | (probes >= n)).any():
        raise ValueError(f"probes {probes.tolist()} were given: they must be grains between 0 and {n - 1}")
    reference = state.grains.position if reference is None else np.ascontiguousarray(reference, dtype=float)
    if reference.shape != (n, 3):
        raise ValueError(f"a reference of shape {reference.shape} was given: it must be {(n, 3)}")
    room = max(1024, 8 * len(state.contacts.i)) if events else 0
    return Writing(
        every, reference, probes, np.zeros((samples, len(SERIES))), np.zeros((samples, len(probes), 6)),
        np.zeros((room, len(EVENT_COLUMNS))), np.zeros(1, np.int64),
    )  # fmt: skip


def with_lost(writing: Writing, before, after, position, time) -> Writing:
    """Record as opened those contacts that left the list in one step."""
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


def record_of(writing: Writing, done: int, books: Books | None) -> Record:
    """What was written in a run of `done` steps."""
    kept = done // writing.every + 1 if writing.every else 0
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
        series[:, 8:].reshape(-1, 3, 3),
        tracks[..., :3],
        tracks[..., 3:],
        events,
        ledger_of(books, kept) if books else None,
    )
