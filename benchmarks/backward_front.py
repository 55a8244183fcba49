"""Explanations of the speed of the backward front in a pushed disk array: the table of `docs/disk_array.md`.

python -m benchmarks backward_front     # about ten minutes; writes front.csv and the table
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.wings.papers.disk_array.measures import backward_front, backward_order, drift_front, y_mode

from .records import write_block

ROOT = Path(__file__).parents[1]
OUT, PAGE = ROOT / "docs/reference/disk_array/front.csv", ROOT / "docs/disk_array.md"
REALIZATIONS, PUSH, THRESHOLD = 60, 0.087, 0.05
THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2)


class Speeds(NamedTuple):
    """Measured and predicted speeds of the backward front of one ensemble."""

    change: str
    realizations: int  # number of realisations in which all disks slid
    front: float  # front speed as measured in the paper [length/time]
    front_error: float
    smooth: float  # front speed without the oscillation of the disks [length/time]
    smooth_error: float
    drift: float  # front speed of a row that drifts with a constant profile [length/time]
    drift_error: float
    wave: float  # front speed by the paper's explanation: ω_y/π with the frequency ω_y along y [length/time]
    velocity: float  # velocity of the row [length/time]
    lead: float  # displacement of the last disk minus the mean displacement [length]


def cases() -> list[tuple[str, dict, tuple[float, ...], tuple[float, ...]]]:
    """Name of each changed array, with the tables of its scenario, pushes and thresholds."""
    stiff = [(f"disk–disk k_n × {kn:g}", {"law": {"kn": kn, "wall": {"kn": 1.0}}}) for kn in (0.25, 0.5, 2.0, 4.0)]
    soft = [(f"k_t = {kt:g} k_n", {"law": {"kt": kt}}) for kt in (0.1, 0.6)]
    rows = [(f"N = {n}, F_x = {PUSH * n / 10:g}", {"array": {"disks": n}}, (PUSH * n / 10,)) for n in (5, 20)]
    return [
        ("", {}, (PUSH,), THRESHOLDS),
        *((f"F_x = {push:g}", {}, (push,), (THRESHOLD,)) for push in (0.06, 0.083, 0.1, 0.12, 0.2)),
        *((*row, (THRESHOLD,)) for row in rows),
        *((words, tables, (PUSH,), (THRESHOLD,)) for words, tables in (*stiff, *soft)),
    ]  # fmt: skip


def measure(words: str, tables: dict, pushes, thresholds, realizations: int = REALIZATIONS) -> list[Speeds]:
    """Run one ensemble, and return one row for each threshold."""
    result = ss.simulate(ss.scenario(
        experiment="disk-array", **tables, load={"push": (0.0, *pushes), "step": 2e-3}, dynamics={"loads": ()},
        sliding={"loads": pushes, "realizations": realizations, "thresholds": thresholds},
    ))  # fmt: skip
    modes, ensemble, last = result.path[-1].spectrum, result.sliding[pushes[0]], backward_order(result)[0][0]
    rows = []
    for k, threshold in enumerate(thresholds):
        front, smooth = (backward_front(result, threshold, smooth=kind) for kind in (False, True))
        printed = words or f"none: F_x = {PUSH:g}, threshold {THRESHOLD:g}"
        rows.append(Speeds(
            printed if threshold == THRESHOLD else f"threshold {threshold:g}", front.complete, front.speed,
            front.speed_error, smooth.speed, smooth.speed_error, *drift_front(result, threshold, pushes),
            float(modes.frequency[y_mode(modes)] / np.pi), float(np.nanmean(ensemble.drift[:, k])),
            float(np.nanmean(ensemble.profile[:, k, last])),
        ))  # fmt: skip
    return rows


def read() -> list[Speeds]:
    """Read the measured speeds from the CSV file."""
    with OUT.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    return [Speeds(change, int(count), *map(float, rest)) for change, count, *rest in rows]


def write(rows: list[Speeds]) -> None:
    """Write the speeds to the CSV file, and the table to the page of the documentation."""
    OUT.parent.mkdir(parents=True, exist_ok=True)
    with OUT.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(Speeds._fields)
        out.writerows((change, count, *(f"{value:.3g}" for value in rest)) for change, count, *rest in rows)
    write_block(PAGE, "backward_front", table(read()))


def table(rows: list[Speeds]) -> str:
    """Format the table for the documentation."""
    head = "| change | V_2 | V_2, oscillation averaged | by the drift | ω_y/π | velocity of the row "
    head += "| lead of the last disk |\n"
    return head + "|---|---|---|---|---|---|---|\n" + "".join(
        f"| {r.change} | {r.front:.3f} ± {r.front_error:.3f} | {r.smooth:.3f} ± {r.smooth_error:.3f} | "
        f"{r.drift:.3f} ± {r.drift_error:.3f} | {r.wave:.3f} | {r.velocity:.1e} | {r.lead:.1e} |\n"
        for r in rows
    )  # fmt: skip


def rows(*, smallest: bool = False):
    """Measure all cases, and write the table of the page."""
    if smallest:
        yield from map(str, measure("", {"array": {"disks": 5}}, (PUSH / 2,), (THRESHOLD,), 2))
        return
    found = []
    for case in cases():
        found += measure(*case)
        yield str(found[-1])
    write(found)
