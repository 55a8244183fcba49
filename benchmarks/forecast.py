"""Record of the forecasts of `shear_to_failure`: hit rates of their intervals, and comparison with naive forecasts.

    python -m benchmarks forecast [TIMES] [calibrate]

Packings of 30 disks are sheared, and each forecast along the path is compared with the next event or pair. Naive
forecasts assume that the next event, or pair, comes after the mean spacing of the previous ones, or after the last
spacing; they require two earlier events or pairs. TIMES multiplies the number of packings. `calibrate` instead prints
the quantiles of `loading.event_path.CALIBRATED`, from other packings. Saddle nodes of the reference catalogue, whose
eigenvalues are known at small distances, are used as well. The benchmark takes minutes.
"""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.core.progress import NotInEquilibriumError
from stickslip.loading.event_path import CALIBRATED, LEVEL, SADDLE, extrapolations, forecast, zero_of_power
from stickslip.loading.failure import complete_path, follow, signs_of
from stickslip.wings.studies.catalogue.simulate import read_table

from .records import number, write_block

PAGE = Path(__file__).parents[1] / "docs/failure.md"
CATALOGUE = Path(__file__).parents[1] / "docs/reference/catalogue/events.csv"
STEP = 4e-4
ENDS = ((1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2)


class Case(NamedTuple):
    """A law, and its sheared packings."""

    law: ss.Law
    fraction: float
    strain: float
    packings: int


CASES = {
    "Hertz, no friction": Case(ss.laws.hertz_mindlin(mu=0.0), 0.88, 0.024, 3),
    "linear, sharp, μ = 10": Case(ss.laws.linear(mu=10.0), 0.845, 0.02, 2),
    "Hertz, sharp, μ = 0.5": Case(ss.laws.hertz_mindlin(mu=0.5), 0.845, 0.024, 1),
}


class Made(NamedTuple):
    """One forecast and its outcome."""

    basis: str
    left: float  # forecast remaining strain
    low: float
    high: float
    came: float  # true remaining strain; infinite if nothing came before the end of the path
    rest: float  # strain to the end of the path
    mean: float  # forecast from the mean spacing; NaN with fewer than two earlier events
    last: float  # forecast from the last spacing; NaN likewise
    raw: float  # extrapolated remaining strain


def made_along(steps) -> list[Made]:
    """Forecasts along a path that can be judged because the event came or the path is longer than the interval."""
    events = np.array([event.strain for step in steps for event in step.events])
    births = np.array([b.strain for a, b in pairwise(steps) if b.pairs > a.pairs])
    births = births - 0.5 * STEP  # middle of the step
    out = []
    for k in range(1, len(steps) - 1):
        signs, now = signs_of(steps[: k + 1]), steps[k].strain
        for one in forecast(signs):
            all_of_them = events if one.of == "event" else births
            came = next(iter(all_of_them[all_of_them > now]), np.inf) - now
            rest = steps[-1].strain - now
            if not np.isfinite(came) and rest < one.high - now:
                continue
            so_far = all_of_them[all_of_them <= now]
            spacing = np.diff(so_far)
            naive = (spacing.mean(), spacing[-1]) if len(spacing) else (np.nan, np.nan)
            elapsed = now - so_far[-1] if len(so_far) else 0.0
            naive = [x - elapsed if x > elapsed else x for x in naive]  # if overdue, counted from now
            raw = float(np.median(extrapolations(signs, one.basis)[1]))
            out.append(Made(one.basis, one.strain - now, one.low - now, one.high - now, came, rest, *naive, raw))
    return out


def path(case: Case, seed: int, strain: float) -> list:
    """Steps of one packing: fewer if no equilibrium exists, none if the packing does not jam."""
    steps = []
    try:
        state, _ = ss.packings.jammed(30, packing_fraction=case.fraction, dim=2, law=case.law, seed=seed)
    except ValueError:
        return steps
    try:
        for step in follow(complete_path(state, case.law, strain, "simple", False, STEP, None, None), state):
            steps.append(step._replace(state=None))
    except NotInEquilibriumError:
        pass
    return steps


class Judged(NamedTuple):
    """Record of the forecasts that have the same basis."""

    made: int
    came: int  # number of forecasts whose event came before the end of the path
    inside: int  # number of those whose interval contains the event
    error: float  # median |ln(forecast/true)| of the remaining strain, where the event came
    several: int  # number of forecasts with two earlier events
    beside: float  # median error of these forecasts
    mean: float  # median error if the mean spacing is the forecast
    last: float  # median error if the last spacing is the forecast


def judge(made: list[Made]) -> Judged:
    """Compare a number of forecasts with their outcomes."""
    came = [one for one in made if np.isfinite(one.came)]
    several = [one for one in came if np.isfinite(one.mean)]

    def error(of: list[Made], name: str) -> float:
        return float(np.median([abs(np.log(getattr(one, name) / one.came)) for one in of])) if of else np.nan

    inside = sum(bool(one.low <= one.came <= one.high) for one in came)
    naive = (error(several, name) for name in ("left", "mean", "last"))
    return Judged(len(made), len(came), inside, error(came, "left"), len(several), *naive)


def saddle_nodes(odd: int) -> np.ndarray:
    """Saddle nodes of half of the catalogue, extrapolated from eigenvalues at three distances.

    Returns
    -------
    (K, 3)
        remaining strain at the nearest distance; ln of its ratio to the extrapolated strain, NaN without one; the same
        from λ² alone
    """
    table, out = read_table(CATALOGUE), []
    rows = (table["kind"] == "saddle_node") & (table["sample"] % 2 == odd)
    for left, value in zip(table["distances"][rows], table["softest"][rows], strict=True):
        for k in range(len(left) - 2):
            d, v = left[k : k + 3], value[k : k + 3]
            if np.isfinite(v).all() and (v > 0).all() and (np.diff(v) < 0).all():
                guess, square = zero_of_power(-d, v) + d[-1], v**2
                linear = (d[0] - d[-1]) * square[-1] / (square[0] - square[-1])
                out.append((d[-1], np.log(d[-1] / guess) if guess > 0 else np.nan, np.log(d[-1] / linear)))
    return np.array(out)


def catalogue_table(found: np.ndarray) -> list[str]:
    """Lines of the saddle node table."""
    out = ["| strain left | saddle nodes | extrapolated | in the interval | median error | from λ² alone |", _rule(6)]
    low, shift, high = CALIBRATED[SADDLE]
    for left in sorted({float(x) for x in found[:, 0]}, reverse=True):
        _, own, linear = found[found[:, 0] == left].T
        good = own[np.isfinite(own)]
        inside = int(((good >= low) & (good <= high)).sum())
        errors = (_number(float(np.median(np.abs(x)))) for x in (good - shift, linear))
        out.append(_line(f"{left:.2g}", len(own), _share(len(good), len(own)), _share(inside, len(good)), *errors))
    return out


def _share(part: int, whole: int) -> str:
    return f"{part} ({100 * part / whole:.0f} %)" if whole else "–"


def _number(x: float) -> str:
    return f"{x:.2f}" if np.isfinite(x) else "–"


def _rule(columns: int) -> str:
    return "|" + "---|" * columns


def _line(*cells) -> str:
    return f"| {' | '.join(map(str, cells))} |"


HEAD = ("law", "from", "forecasts", "event came", "in the interval", "error", "with two before", "mean", "last")


def forecasts_of(first: int, times: int, smallest: bool) -> dict[str, list[Made]]:
    """Forecasts, by law, in packings whose seeds begin at `first`."""
    out = {}
    for name, case in list(CASES.items())[: 1 if smallest else None]:
        seeds = range(first, first + (1 if smallest else times * case.packings))
        strain = 0.002 if smallest else case.strain
        out[name] = [one for seed in seeds for one in made_along(path(case, seed, strain))]
    return out


def calibrated(made: dict[str, list[Made]]):
    """Quantiles on which `CALIBRATED` is based."""
    for basis in CALIBRATED:
        every = [one for several in made.values() for one in several if one.basis == basis and np.isfinite(one.came)]
        values = [np.log(one.came / one.raw) for one in every]
        if values:
            yield f"{basis}: {np.quantile(values, ENDS).round(2)} of {len(values)}; now {CALIBRATED[basis]}"
    found = saddle_nodes(0)
    for left in sorted({float(x) for x in found[:, 0]}, reverse=True):
        good = found[(found[:, 0] == left) & np.isfinite(found[:, 1]), 1]
        yield f"saddle nodes, {left:.2g} left: {np.quantile(good, ENDS).round(2)} of {len(good)}"


def rows(*words: str, smallest: bool = False):
    """Write the tables of the page, or print the calibration."""
    times = next((int(word) for word in words if word.isdigit()), 1)
    if "calibrate" in words:
        yield from calibrated(forecasts_of(0, times, smallest))
        return
    text = [_line(*HEAD), _rule(len(HEAD))]
    for name, made in forecasts_of(100, times, smallest).items():
        for basis in CALIBRATED:
            if found := [one for one in made if one.basis == basis]:
                n = judge(found)
                several = f"{n.several}: {_number(n.beside)}"
                shares = _share(n.came, n.made), _share(n.inside, n.came)
                rest = (_number(n.error), several, _number(n.mean), _number(n.last))
                text.append(_line(name, basis, n.made, *shares, *rest))
                yield number(f"{name}, {basis}: share that came", n.came / n.made)
                yield number(f"{name}, {basis}: share in the interval", n.inside / n.came if n.came else 0.0)
    where = "three distances, each an eighth of the previous one"
    about = f"Saddle nodes of the catalogue are extrapolated from eigenvalues at {where}:"
    whole = "\n".join([*text, "", about, "", *catalogue_table(saddle_nodes(1))])
    yield whole
    if not smallest and PAGE.is_file():
        write_block(PAGE, "forecast", whole)
