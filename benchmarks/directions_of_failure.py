"""First signs of failure on a biaxial path: the table and the figure of `docs/directions_of_failure.md`.

python -m benchmarks directions_of_failure     # about five minutes, one process
"""

import csv
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

import stickslip as ss

from .pictures import save_picture
from .records import write_block

ROOT = Path(__file__).parents[1]
OUT, PAGE = ROOT / "docs/reference/directions_of_failure", ROOT / "docs/directions_of_failure.md"
DISKS, PRESSURE, MU, SEEDS = 100, 1e-3, 0.3, range(1, 9)
STEP, STEPS, EVERY, DIRECTIONS = 2e-4, 160, 10, 72
SHOWN = 0.5, 0.9, 1.0  # strains at which the figure shows seed 1, as fractions of the strain of the first cone
SIGNS = {
    "flutter, strain": "a complex pair grows at fixed strain",
    "flutter, stress": "a complex pair grows under fixed stress",
    "divergence, stress": "a real eigenvalue grows under fixed stress",
    "cone": "second-order work is negative in some direction",
    "band": "the acoustic tensor has a negative determinant",
}


class Look(NamedTuple):
    """Signs of failure of one state."""

    strain: float  # axial strain
    ratio: float  # (σ_yy − σ_xx)/(σ_yy + σ_xx) = sin φ
    least_work: float  # smallest normalised second-order work
    determinant: float  # smallest determinant of an acoustic tensor
    signs: dict[str, bool]
    envelope: object


def look(state, law, strain: float) -> Look:
    """Examine one state of a path."""
    stress, zero = ss.measure.stress(state, law), np.zeros((3, 3))
    held = state._replace(control=state.control._replace(cell_free=zero.astype(bool), stress=zero))
    target = {"xx": stress[0, 0], "yy": stress[1, 1], "xy": stress[0, 1]}
    loose = held._replace(control=ss.control.stress_controlled(held.control, target))
    envelope = ss.protocols.response_envelope(state, law, directions=DIRECTIONS)
    fixed, free = ss.stability(held, law), ss.stability(loose, law)
    determinant = ss.protocols.localisation(state, law).determinant
    signs = {
        "flutter, strain": len(fixed.growth_rate) > 0,
        "flutter, stress": len(free.growth_rate) > 0,
        "divergence, stress": len(free.negative) > 0,
        "cone": bool(envelope.cones),
        "band": determinant < 0,
    }
    ratio = (stress[1, 1] - stress[0, 0]) / (stress[1, 1] + stress[0, 0])
    return Look(strain, ratio, float(np.nanmin(envelope.normalised_work)), determinant, signs, envelope)


def follow(seed: int, disks: int = DISKS, steps: int = STEPS) -> tuple[list[Look], float]:
    """Compress one packing along y at constant σ_xx; also return the strain of the first rearrangement."""
    law = ss.laws.hertz_mindlin(mu=MU)
    state, _ = ss.packings.jammed(disks, pressure=PRESSURE, dim=2, seed=seed)
    state, _ = ss.equilibrate(state, law, check="nothing")
    side = {"xx": ss.measure.stress(state, law)[0, 0]}
    state = state._replace(control=ss.control.stress_controlled(state.control, side))
    looks = [look(state, law, 0.0)]
    for k in range(1, steps + 1):
        end, outcome = ss.equilibrate(ss.packings.strained(state, np.diag([0, -STEP])), law, check="nothing")
        if not outcome.ok or outcome.fallback:
            looks.append(look(state, law, STEP * (k - 1)))
            return looks, STEP * k
        state = end
        if k % EVERY == 0:
            looks.append(look(state, law, STEP * k))
    return looks, np.nan


def first(looks: list[Look], sign: str) -> float:
    """Strain of the first state that shows a sign of failure; NaN if there is none."""
    return next((one.strain for one in looks if one.signs[sign]), np.nan)


def table(paths: dict[int, tuple[list[Look], float]]) -> str:
    """Markdown table: for each sample, the strains of the first appearance of each sign and of the rearrangement."""
    lines = [f"| sample | {' | '.join(SIGNS)} | first rearrangement | sin φ there |", "|---" * (len(SIGNS) + 3) + "|"]
    for seed, (looks, end) in paths.items():
        cells = [f"{first(looks, sign):.3f}" if np.isfinite(first(looks, sign)) else "–" for sign in SIGNS]
        last = f"{end:.4f}" if np.isfinite(end) else f"none up to {STEP * STEPS:g}"
        lines.append(f"| {seed} | {' | '.join(cells)} | {last} | {looks[-1].ratio:.3f} |")
    return "\n".join(lines) + "\n"


def rows(*, smallest: bool = False):
    """Follow all samples, and write table, CSV and figure."""
    warnings.simplefilter("ignore")
    if smallest:
        yield table({1: follow(1, 20, 2)})
        return
    OUT.mkdir(parents=True, exist_ok=True)
    paths = {seed: follow(seed) for seed in SEEDS}
    yield table(paths)
    with (OUT / "looks.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["sample", "strain [1]", "sin_phi [1]", "least_work [1]", "determinant [1]", *SIGNS])
        for seed, (looks, _) in paths.items():
            for one in looks:
                numbers = [f"{x:.6g}" for x in (one.strain, one.ratio, one.least_work, one.determinant)]
                writer.writerow([seed, *numbers, *map(int, one.signs.values())])
    looks = next(looks for looks, _ in paths.values() if np.isfinite(first(looks, "cone")))
    ends = [share * first(looks, "cone") for share in SHOWN]
    shown = [min(looks, key=lambda one: abs(one.strain - end)) for end in ends]
    labels = [f"ε = {one.strain:.3f}, sin φ = {one.ratio:.2f}" for one in shown]
    save_picture(ss.figures.response_envelopes([one.envelope for one in shown], labels), OUT / "envelopes.png")
    write_block(PAGE, "directions_of_failure", table(paths))
