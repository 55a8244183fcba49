"""Record of the forecasts of `shear_to_failure`: how often their intervals hold, beside naive forecasts; minutes.

    python -m benchmarks forecast [calibrate]

Packings of 30 disks are sheared, and each forecast along the path is compared with what came next. The naive forecasts
are that the next event, or pair, comes after the mean spacing of those so far, and after the last spacing; they need
two earlier ones. `calibrate` prints the quantiles of `loading.forecast.CALIBRATED` from other packings instead. Saddle
nodes of the reference catalogue are also used, whose eigenvalues are known at small distances.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.core.outcome import NotInEquilibriumError
from stickslip.loading.failure import complete_path, follow, signs_of
from stickslip.loading.forecast import CALIBRATED, CONTACT, LEVEL, PAIR, SADDLE, extrapolations, forecast, zero_of_power
from stickslip.wings.studies.catalogue.tables import read_table

from .records import number

PAGE = Path(__file__).parents[1] / "docs/failure.md"
CATALOGUE = Path(__file__).parents[1] / "docs/reference/catalogue/events.csv"
MARK = "<!-- written by python -m benchmarks forecast -->\n"
STEP = 4e-4
ENDS = ((1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2)


class Case(NamedTuple):
    """A law with the packings that are sheared."""

    law: ss.Law
    fraction: float
    strain: float
    packings: int


CASES = {
    "Hertz, no friction": Case(ss.laws.hertz_mindlin(mu=0.0), 0.88, 0.04, 4),
    "linear, sharp, μ = 10": Case(ss.laws.linear(mu=10.0), 0.845, 0.02, 3),
    "Hertz, sharp, μ = 0.5": Case(ss.laws.hertz_mindlin(mu=0.5), 0.845, 0.04, 2),
}
FIRST = {"record": 100, "calibrate": 0}  # seeds


class Made(NamedTuple):
    """One forecast, and what came."""

    basis: str
    left: float  # forecast strain that is left
    low: float
    high: float
    came: float  # strain that was left; infinite if nothing came before the end of the path
    rest: float  # strain to the end of the path
    mean: float  # forecast of the mean spacing, NaN with fewer than two earlier events
    last: float  # and of the last one
    raw: float  # extrapolated strain that is left


def made_along(steps) -> list[Made]:
    """Forecasts along a path that can be judged: the event came, or the path is longer than the interval."""
    events = np.array([event.strain for step in steps for event in step.events])
    births = np.array([b.strain for a, b in zip(steps, steps[1:], strict=False) if b.pairs > a.pairs])
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
            naive = [max(so_far[-1] + x - now, 0.1 * STEP) if np.isfinite(x) else np.nan for x in naive]
            raw = float(np.median(extrapolations(signs, one.basis)[1]))
            out.append(Made(one.basis, one.strain - now, one.low - now, one.high - now, came, rest, *naive, raw))
    return out


def path(case: Case, seed: int, strain: float) -> list:
    """Steps of one packing; fewer if there is no equilibrium."""
    state, _ = ss.packings.jammed(30, packing_fraction=case.fraction, dim=2, law=case.law, seed=seed)
    steps = []
    try:
        for step in follow(complete_path(state, case.law, strain, "simple", False, STEP, None, None), state):
            steps.append(step._replace(state=None))
    except NotInEquilibriumError:
        pass
    return steps


def describe(made: list[Made]) -> list[tuple]:
    """Rows of the table for each basis."""
    out = []
    for basis in (SADDLE, CONTACT, PAIR):
        mine = [one for one in made if one.basis == basis]
        if not mine:
            continue
        came = [one for one in mine if np.isfinite(one.came)]
        inside = sum(one.low <= one.came <= one.high for one in came)
        both = [one for one in came if np.isfinite(one.mean)]
        errors = [[abs(np.log(getattr(one, name) / one.came)) for one in both] for name in ("left", "mean", "last")]
        own = np.median([abs(np.log(one.left / one.came)) for one in came]) if came else np.nan
        out.append(
            (
                basis,
                len(mine),
                len(came),
                inside,
                float(own),
                *(float(np.median(e)) if e else np.nan for e in errors),
                len(both),
            )
        )
    return out


def saddle_nodes(odd: int) -> np.ndarray:
    """ln(strain left / extrapolated) for saddle nodes of the catalogue, from eigenvalues at three distances."""
    table, out = read_table(CATALOGUE), []
    rows = (table["kind"] == "saddle_node") & (table["sample"] % 2 == odd)
    for left, value in zip(table["distances"][rows], table["softest"][rows], strict=True):
        for k in range(len(left) - 2):
            d, v = left[k : k + 3], value[k : k + 3]
            good = np.isfinite(v).all() and (v > 0).all() and (np.diff(v) < 0).all()
            guess = zero_of_power(-d, v) + d[-1] if good else np.nan
            linear = (d[0] - d[-1]) * v[-1] ** 2 / (v[0] ** 2 - v[-1] ** 2) if good else np.nan
            out.append((d[-1], np.log(d[-1] / guess) if guess > 0 else np.nan, np.log(d[-1] / linear)))
    return np.array(out)


def _percent(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / whole:.0f} %)" if whole else "–"


def _number(x: float) -> str:
    return f"{x:.2f}" if np.isfinite(x) else "–"


def rows(*words: str, smallest: bool = False):
    """Write the table of the page, or calibrate."""
    first = FIRST["calibrate" if "calibrate" in words else "record"]
    text = [
        "| law | forecast from | forecasts | event came | in the interval, if it came | in the interval, of all | median error | mean spacing | last spacing |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    pooled: dict[str, list[float]] = {}
    for name, case in list(CASES.items())[: 1 if smallest else None]:
        made = []
        for seed in range(first, first + (1 if smallest else case.packings)):
            made += made_along(path(case, seed, 0.002 if smallest else case.strain))
        for one in made:
            pooled.setdefault(one.basis, []).extend([np.log(one.came / one.raw)] if np.isfinite(one.came) else [])
        for basis, count, came, inside, own, beside, mean, last, several in describe(made):
            cells = (count, _percent(came, count), _percent(inside, came), _percent(inside, count), _number(own))
            naive = f"{_number(mean)} (here {_number(beside)}, {several})", _number(last)
            text.append(f"| {name} | {basis} | {' | '.join(map(str, cells))} | {' | '.join(naive)} |")
            yield number(f"{name}, {basis}: share in the interval if it came", inside / came if came else 0.0)
    for basis, values in pooled.items() if "calibrate" in words else ():
        yield f"{basis}: {np.quantile(values, ENDS).round(2)} of {len(values)}; now {CALIBRATED[basis]}"
    found = saddle_nodes(0 if "calibrate" in words else 1)
    known = [
        "| strain left | saddle nodes | extrapolated | in the interval | median error | from λ² alone |",
        "|---|---|---|---|---|---|",
    ]
    low, shift, high = CALIBRATED[SADDLE]
    for left in sorted({float(x) for x in found[:, 0] if np.isfinite(x)}, reverse=True):
        _, own, linear = found[(found[:, 0] == left) & np.isfinite(found[:, 2])].T
        good = own[np.isfinite(own)]
        inside = int(((good >= low) & (good <= high)).sum())
        if "calibrate" in words:
            yield f"saddle nodes, {left:.2g} left: {np.quantile(good, ENDS).round(2)} of {len(good)}"
        known.append(
            f"| {left:.2g} | {len(own)} | {_percent(len(good), len(own))} | {_percent(inside, len(good))} | {_number(float(np.median(np.abs(good - shift))))} | {_number(float(np.median(np.abs(linear))))} |"
        )
    whole = "\n".join(
        [
            *text,
            "",
            "Saddle nodes of the catalogue, from eigenvalues at three distances, each an eighth of the one before:",
            "",
            *known,
        ]
    )
    yield whole
    if smallest or "calibrate" in words or not PAGE.is_file():
        return
    head, begin, rest = PAGE.read_text(encoding="utf-8").partition(MARK)
    _, end, tail = rest.partition("<!-- end -->")
    PAGE.write_text(f"{head}{begin}\n{whole}\n\n{end}{tail}", encoding="utf-8")
