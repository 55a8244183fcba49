"""Watch a running LAMMPS simulation: measure its frames, the newest first, to keep up with the simulation."""

import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ... import SLIDE, Law, State, stability
from ...kit import (
    DENSE_UP_TO,
    Account,
    MemoryNote,
    Report,
    force_imbalance,
    lammps_series,
    least_supports,
    linearised,
    modes_under,
    no_equilibrium_message,
    silent,
    softest_eigenvalue,
    to_dict,
    verdict,
)
from ...measure import BALANCED_BELOW, coordination, stress
from ...packings import PackingError

METHODS = ("auto", "none", "fastest", "all", "dense", "pairs")
TENSOR = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")


class Row(NamedTuple):
    """Measures of a frame, in the units of the simulation; unavailable measures are None."""

    step: int
    digest: str = ""  # digest of the frame; if it changes, the frame is computed again
    grains: int | None = None
    contacts: int | None = None  # number of touching contacts
    rattlers: int | None = None
    coordination: float | None = None  # mean number of contacts per grain, rattlers excluded
    sliding: int | None = None  # number of contacts at the Coulomb limit; None without contact memory
    pressure: float | None = None  # [force/length^(dim−1)]
    shear_stress: float | None = None  # half the largest difference of principal stresses [force/length^(dim−1)]
    stress_xx: float | None = None
    stress_xy: float | None = None
    stress_xz: float | None = None
    stress_yx: float | None = None
    stress_yy: float | None = None
    stress_yz: float | None = None
    stress_zx: float | None = None
    stress_zy: float | None = None
    stress_zz: float | None = None
    residual: float | None = None  # largest unbalanced force over the mean normal contact force
    softest: float | None = None  # smallest real part of the eigenvalues λ, zero modes excluded [1/time²]
    zero_modes: int | None = None
    pairs: int | None = None  # number of growing complex pairs
    growth_rate: float | None = None  # growth rate of the fastest pair [1/time]
    omega: float | None = None  # frequency of the fastest pair [1/time]
    buckling: int | None = None  # number of motions that grow without oscillation
    stable: bool | None = None  # None without a verdict
    balanced: bool | None = None
    verdict: str = ""
    scope: str = ""  # limits of the stability check, if any
    note: str = ""  # reasons for missing values

    @property
    def computed(self) -> bool:
        """True if the frame could be measured."""
        return self.grains is not None


def measure_frame(
    step: int, digest: str, state: State, law: Law, *, memory: bool, method: str = "auto", notes=(),
    report: Report = silent,
) -> Row:  # fmt: skip
    """Measure a frame.

    Parameters
    ----------
    memory : True if the slip of the contacts is known
    method : one of `METHODS`; with "auto", the spectrum of more than 1500 coordinates is computed only in equilibrium
    notes : notes on the import of the frame; if it left out actions on the grains, the verdict is undecided
    report : called as report(stage, share done, text)
    """
    here, mode = linearised(state, law), state.contacts.mode[: state.contacts.count[0]]
    row = Row(
        step, digest, len(state.grains.radius), len(here.rows),
        coordination=coordination(state, least_supports(law, state.cell.dim)),
        sliding=int((mode == SLIDE).sum()) if memory else None, residual=force_imbalance(here),
    )  # fmt: skip
    row = _add_stress(row, state, law)
    free = here.backbone
    if not len(free):
        return _note(row, "no grain is supported by others, so there is no spectrum")
    large = method == "auto" and len(free) > DENSE_UP_TO
    if method == "none" or (large and not row.residual <= BALANCED_BELOW):
        balanced = bool(row.residual is not None and row.residual <= BALANCED_BELOW)
        words = "in equilibrium; the spectrum was not computed" if balanced else no_equilibrium_message(row.residual)
        row = row._replace(balanced=balanced, verdict=words)
        return _note(row, f"no spectrum of {len(free)} coordinates out of equilibrium") if large else row
    result = stability(state, law, method="fastest" if large else method, report=report)
    matrix = here.with_modes(modes_under(state, law, here.line)).dynamical_matrix(free)
    softest, known = softest_eigenvalue(matrix), to_dict(result, notes=notes)  # as in `stickslip stability --json`
    grow = known["pairs"]
    negative = known["negative"] if "negative" in known else known["growing"]
    static = result.undamped or result
    least = min([softest.real, *map(float, static.negative)]) if np.isfinite(softest.real) else None
    return row._replace(
        rattlers=known["rattlers"], softest=least, zero_modes=known["zero_modes"], pairs=len(grow),
        growth_rate=grow[0]["growth_rate"] if grow else None, omega=grow[0]["omega"] if grow else None,
        buckling=len(negative), stable=known["stable"], balanced=known["balanced"],
        verdict=verdict(result, None, notes), scope=known["scope"],
    )  # fmt: skip


def _note(row: Row, text: str) -> Row:
    return row._replace(note="; ".join(filter(None, [row.note, text])))


def _add_stress(row: Row, state: State, law: Law) -> Row:
    try:
        tensor, dim = stress(state, law), state.cell.dim
    except ValueError:
        return _note(row, "the box is open, so there is no volume for the stress")
    principal = np.linalg.eigvalsh(0.5 * (tensor + tensor.T)[:dim, :dim])
    parts = {f"stress_{name}": float(value) for name, value in zip(TENSOR, tensor.ravel(), strict=True)}
    shear = float(principal[-1] - principal[0]) / 2
    return row._replace(pressure=float(np.trace(tensor)) / dim, shear_stress=shear, **parts)


def verdict_word(row: Row) -> str:
    """Return the verdict on a frame as one word."""
    if not row.computed:
        return "damaged"
    if row.stable is not None:
        return "stable" if row.stable else "unstable"
    return "undecided" if row.balanced and row.pairs is not None else "balanced" if row.balanced else "unbalanced"


NO_MEMORY = (
    "without a dump of contacts, slip is unknown and set to zero: stress is due to normal forces only, "
    "sliding contacts are unknown, and forces balanced by friction appear unbalanced, so that there is no verdict"
)


class Progress(NamedTuple):
    """State of a watch: the table so far, and the number of remaining frames."""

    rows: dict[int, Row]
    notes: tuple[str, ...]
    left: int  # complete frames not computed yet
    fresh: Row | None = None  # row that was just computed, if any
    at: int | None = None  # step to be computed next
    live: bool = True  # True if the simulation may still be running

    @property
    def any_computed(self) -> bool:
        """True if at least one frame could be measured."""
        return any(row.computed for row in self.rows.values())


def watch(
    source: lammps_series.Source, known: dict[int, Row], *, method: str = "auto", once: bool = False,
    until_idle: float | None = None, interval: float = lammps_series.INTERVAL, report: Report = silent,
) -> Iterator[Progress]:  # fmt: skip
    """Compute every frame that is not in `known`, and yield the progress before and after each.

    The newest frame is computed first, and the other frames while the simulation is not writing.

    Parameters
    ----------
    once : compute only the frames present at the beginning, in the order of their steps
    until_idle : end when all frames are computed and no output has appeared for this time [s]; None: never

    Raises
    ------
    PackingError
        If no frame can be used; the message is that of the last frame tried.
    """
    rows, seen, last = dict(known), None, time.monotonic()
    said: dict[str, None] = {} if source.contacts else {NO_MEMORY: None}
    problem: PackingError | None = None
    while True:
        if not (once and seen):
            before, seen = seen, lammps_series.look(source, seen)
            last = time.monotonic() if before is None or before.sizes != seen.sizes else last
        # frames that are not in the table, or have changed since they were computed
        left = [p for p in seen.ready if key_of(p) != getattr(rows.get(p.grains.step), "digest", None)]
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
    notes = (*said, *seen.notes, *lammps_series.missing_frames(seen))
    if not any(row.computed for row in rows.values()):
        raise PackingError(f"{source.folder} has no complete frame: {'; '.join(notes[-3:])}")
    yield Progress(rows, notes, 0, live=False)


def key_of(pair: lammps_series.Pair) -> str:
    """Return the digest of a frame and its contacts."""
    return pair.grains.digest + (pair.contacts.digest if pair.contacts else "")


def _compute(source: lammps_series.Source, pair: lammps_series.Pair, method: str, report) -> tuple[Row, list[str]]:
    state, notes = lammps_series.read_pair(source, pair)
    memory = pair.contacts is not None
    try:
        row = measure_frame(
            pair.grains.step, key_of(pair), state, source.law, memory=memory, method=method, notes=notes, report=report
        )
    except ArithmeticError as problem:
        raise PackingError(f"the spectrum of the frame could not be computed ({problem})") from None
    return row, [line for line in notes if not isinstance(line, MemoryNote | Account)]
