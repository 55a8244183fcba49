"""Effect of layer thickness on fault gouge: one sample of 14 D compared with the stored samples of 20 D.

Cell, diameter distribution and protocol are those of the paper's size; only the number of grains differs. Unless the
sample is stored, it is run, which takes an hour on one core; a stopped run resumes.

python -m benchmarks gouge_thickness
"""

from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from stickslip.reports.terminal import progress
from stickslip.wings.papers.gouge import measures
from stickslip.wings.papers.gouge.claims import healing_peaks, reslides_after_longest
from stickslip.wings.papers.gouge.paper import MAIN, PAPER, paper_size_scenario, stored_samples
from stickslip.wings.papers.gouge.simulate import GougeResult, simulate_gouge
from stickslip.wings.papers.gouge.statistics import slope

from .records import write_block

STORED = Path(__file__).parents[1] / "docs/reference"
NUMBER = 2900  # mobile grains of a layer of 14 D


def quantities(result: GougeResult) -> dict[str, float]:
    """Numbers of one sample that are printed or shown in the paper."""
    _, after, peaks, _ = reslides_after_longest(result, PAPER)
    return {
        "thickness [D]": result.realizations[0].range.thickness,
        "steady friction at 0.02 m/s": measures.mean_friction(result, PAPER).value,
        "friction per e-fold of hold time": measures.per_efold(measures.hold_curve(result, PAPER)).value,
        "thickness per e-fold of hold time [D]": measures.per_efold(
            measures.hold_curve(result, PAPER, "thickness")
        ).value
        / result.scenario.grains.mean,
        "peak per e-fold of hold time": healing_peaks(result, PAPER)[2].value,
        "peak per e-fold of V_r/V_i": slope(np.log(after / PAPER), peaks).value,
    }


def thin_sample(thick) -> GougeResult:
    """Result of the sample of 14 D."""
    thin = thick.model_copy(update={"grains": thick.grains.model_copy(update={"number": NUMBER})})
    with progress() as report:
        folder = Path("results/gouge-14-D")
        return simulate_gouge(thin, folder=folder, samples=STORED / "gouge_14_D", workers=1, report=report)


def rows(*, smallest: bool = False):
    """Table; the smallest size has only a stored sample of 20 D."""
    thick = paper_size_scenario(realizations=1)
    stored = list(stored_samples(STORED / "gouge_paper_size")[MAIN].values())[: 1 if smallest else None]
    others = [quantities(GougeResult(thick, (sample.realization,), (), 1)) for sample in stored]
    found = others[0] if smallest else quantities(thin_sample(thick))
    count = len(others)
    head = f"quantity | 14 D, one sample | 20 D, mean of {count} | a further sample of 20 D, 95 %"
    lines = [head]
    for name, value in found.items():
        values = np.array([other[name] for other in others])
        half = np.nan
        if count > 1:
            half = stdtrit(count - 1, 0.975) * values.std(ddof=1) * np.sqrt(1 + 1 / count)
        lines.append(f"{name} | {value:.4g} | {values.mean():.4g} | ± {half:.2g}")
    yield from lines
    if not smallest:
        text = [f"| {head} |", "|" + 4 * "---|", *(f"| {line} |" for line in lines[1:])]
        write_block(STORED.parent / "theory/gouge.md", "gouge_thickness", "\n".join(text))
