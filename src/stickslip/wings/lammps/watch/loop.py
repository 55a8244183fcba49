"""The loop that follows a simulation: the newest frame first, so that it never falls behind; older ones meanwhile."""

import time
from collections.abc import Iterator
from typing import NamedTuple

from ....data.exchange.lammps_series import INTERVAL, Look, Pair, Source, look, missing_frames, read_pair
from ....data.sample import Account, MemoryNote
from ....kit import Report, silent
from ....packings import PackingError
from .measures import Row, measure_frame

NO_MEMORY = (
    "without a dump of contacts, the slip of contacts is unknown and set to zero: stress is that of the normal forces, "
    "sliding contacts are unknown, and forces that friction balances appear unbalanced, which leaves no verdict"
)


class Progress(NamedTuple):
    """State of a watch: the table so far, and how much is left to compute."""

    rows: dict[int, Row]
    notes: tuple[str, ...]
    left: int  # complete frames not computed yet
    fresh: Row | None = None  # row that was computed last, if it is new
    at: int | None = None  # step that is computed next
    live: bool = True  # whether the simulation may still be running

    @property
    def any_computed(self) -> bool:
        """True if at least one frame could be used."""
        return any(row.computed for row in self.rows.values())


def watch(
    source: Source, known: dict[int, Row], *, method: str = "auto", once: bool = False,
    until_idle: float | None = None, interval: float = INTERVAL, report: Report = silent,
) -> Iterator[Progress]:  # fmt: skip
    """Compute every frame that is not `known`, and yield what is known before and after each.

    While a simulation writes, its newest frame is computed first. The others follow while it does not write.

    Parameters
    ----------
    once : end after the frames that are there at the beginning, in the order of their steps
    until_idle : end when all frames are computed and nothing has been written for this time [s]; None: never

    Raises
    ------
    PackingError
        if no frame can be used; the message is that of the last one tried.
    """
    rows, seen, last = dict(known), None, time.monotonic()
    said: dict[str, None] = {} if source.contacts else {NO_MEMORY: None}
    problem: PackingError | None = None
    while True:
        if not (once and seen):
            before, seen = seen, look(source, seen)
            last = time.monotonic() if before is None or before.sizes != seen.sizes else last
        left = _frames_to_compute(seen, rows)
        notes = (*said, *seen.notes)
        if left:
            pair = left[0 if once else -1]
            yield Progress(rows, notes, len(left), at=pair.grains.step)
            try:
                row, remarks = _compute(source, pair, method, report)
                said |= dict.fromkeys(remarks)
            except PackingError as trouble:
                problem = trouble
                row = Row(pair.grains.step, key_of(pair), note=str(trouble))
                said[f"step {row.step} cannot be used: {trouble}"] = None
            rows[row.step] = row
            yield Progress(rows, (*said, *seen.notes), len(left) - 1, fresh=row)
            continue
        if problem and not any(row.computed for row in rows.values()):
            raise problem
        if once or (until_idle is not None and time.monotonic() - last >= until_idle):
            break
        yield Progress(rows, notes, 0)
        time.sleep(interval)
    notes = (*said, *seen.notes, *missing_frames(seen))
    if not any(row.computed for row in rows.values()):
        raise PackingError(f"{source.folder} has no complete frame: {'; '.join(notes[-3:])}")
    yield Progress(rows, notes, 0, live=False)


def _frames_to_compute(seen: Look, rows: dict[int, Row]) -> list[Pair]:
    """Frames to compute: those that are not in the table, or have changed since."""
    return [pair for pair in seen.ready if key_of(pair) != getattr(rows.get(pair.grains.step), "digest", None)]


def key_of(pair: Pair) -> str:
    """Digest of a frame with its contacts."""
    return pair.grains.digest + (pair.contacts.digest if pair.contacts else "")


def _compute(source: Source, pair: Pair, method: str, report) -> tuple[Row, list[str]]:
    state, notes = read_pair(source, pair)
    memory = pair.contacts is not None
    try:
        row = measure_frame(
            pair.grains.step, key_of(pair), state, source.law, memory=memory, method=method, notes=notes, report=report
        )
    except ArithmeticError as problem:
        raise PackingError(f"its spectrum could not be computed ({problem})") from None
    return row, [line for line in notes if not isinstance(line, MemoryNote | Account)]
