"""Simulation of an event catalogue: tables, skill of quantities that may announce an event, output files and summary.

Packings are sheared one after another until enough events are found. Tables are dictionaries of columns; in CSV files,
the header contains the units. Every table has the column `sample`, the seed of the packing. Columns with several values
per event, such as the eigenvalue at several distances, are two-dimensional arrays; in a file they are spread over
numbered columns. Skill is measured by receiver operating characteristics with intervals.
"""

import re
from collections.abc import Iterable
from functools import partial
from itertools import accumulate
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, kit
from ....kit import (
    EVENT_RATIO,
    Fields,
    Measures,
    Member,
    Quantity,
    Report,
    Task,
    Workers,
    archive_fields,
    checked,
    checkpoint_in,
    console,
    current_units,
    heading_of,
    in_units,
    make_law,
    make_packing,
    median,
    new_table,
    pluralize,
    reach,
    readable,
    result_of,
    run_realizations,
    show_table,
    silent,
    split_label,
    units_of,
    within,
)
from ....measure import stable_time_step
from ....protocols import find_events
from ....results import Event, EventKind, Events, PackingInfo, StrainStep
from . import EXPERIMENT
from .scenario import CatalogueScenario


class Sample(NamedTuple):
    """Events of one packing."""

    seed: int
    packed: PackingInfo
    found: Events


@result_of(EXPERIMENT, head=lambda r: f"{pluralize(r.number, 'event')} of {pluralize(len(r.samples), 'packing')}")
class CatalogueResult(NamedTuple):
    """Events of all packings, in the order of their seeds."""

    scenario: CatalogueScenario
    law: Law
    samples: tuple[Sample, ...]
    failures: tuple[str, ...]  # one sentence per failed packing

    @property
    def number(self) -> int:
        """Number of events."""
        return sum(len(sample.found.events) for sample in self.samples)


@checked
def simulate_catalogue(
    scenario: CatalogueScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> CatalogueResult:
    """Shear at most `packings` packings, with the seeds seed, seed + 1, …, until `events` events are found.

    Each batch contains as many packings as can be sheared simultaneously. Packings after the one that completes the
    number of events are excluded, so that the result does not depend on the number of workers.

    Parameters
    ----------
    folder : run folder, in which each packing is saved as soon as it is finished
    workers : number of processes, or the address of a Dask scheduler
    report : called as report(stage, share done, text)

    Raises
    ------
    RuntimeError
        If every packing failed.
    """
    kept = checkpoint_in(folder, scenario, Sample, PackingInfo, Events, Event, EventKind, StrainStep)
    slots = max(1, reach(workers).slots)
    results: list[Sample | None] = []
    sentences: list[str | None] = []
    while len(results) < scenario.packings and (count := _count(results)) < scenario.events:
        done, size = len(results), 1
        if slots > 1:  # all slots, or a multiple up to half of the number of packings that are expected to be needed
            needed = ceil((scenario.events - count) * done / count) if count else done
            size = min(max(slots, needed // 2 // slots * slots), scenario.packings - done)
        seeds = [scenario.seed + k for k in range(done, done + size)]
        tasks = [Task(f"packing {seed}", (scenario, seed), f"packing-{seed}", kept) for seed in seeds]
        batch = run_realizations(
            shear_sample,
            tasks,
            stage=f"packings {seeds[0]} to {seeds[-1]}" if size > 1 else f"packing {seeds[0]}",
            workers=workers,
            report=report,
            describe=lambda member, before=count: _describe(member, before, scenario.events),
        )
        results += batch.results
        sentences += batch.sentences
    totals = accumulate(0 if sample is None else len(sample.found.events) for sample in results)
    used = 1 + sum(total < scenario.events for total in totals)  # number of packings up to the last one needed
    samples = tuple(sample for sample in results[:used] if sample is not None)
    failures = tuple(failure for failure in sentences[:used] if failure)
    if not samples:
        raise RuntimeError(f"every packing failed; first message: {failures[0]}")
    return CatalogueResult(scenario, make_law(scenario.law), samples, failures)


def shear_sample(scenario: CatalogueScenario, seed: int, report: Report) -> Sample:
    """Pack one sample and find its events."""
    law, shear = make_law(scenario.law), scenario.shear
    report(f"packing {seed}", 0.0, f"packing {scenario.packing.grains} grains")
    state, packed = make_packing(scenario.packing, law, seed)
    events = find_events(
        state,
        law,
        to=shear.strain,
        drag=shear.drag * 2 / stable_time_step(state, law),
        step=shear.step,
        resolution=shear.resolution,
        most=scenario.events,
        report=within(report, stage=f"packing {seed}"),
    )
    return Sample(seed, packed, events)


def _count(results) -> int:
    return sum(len(sample.found.events) for sample in results if sample is not None)


def _describe(member: Member, before: int, wanted: int) -> str:
    """Describe the outcome of one packing."""
    if member.failure:
        return member.failure
    record = member.result.found
    return (
        f"packing {member.result.seed}: {pluralize(len(record.events), 'event')}, {record.end} "
        f"({before} of {wanted} events before this batch)"
    )


Table = dict[str, np.ndarray]
LENGTHS = {"jump": "D", "newton_distance": "D"}  # in mean diameters
_WHOLE = ("sample", "trigger_i", "trigger_j", "opened", "closed")
_SPREAD = re.compile(r"(\w+)_(\d+)")


def event_table(samples) -> Table:
    """Return one row per event of several samples: sample, kind, and the other fields of `Event` except `broken`.

    Packings in a catalogue have no bonds.
    """
    rows = [(sample.seed, event) for sample in samples for event in sample.found.events]
    events = [event for _, event in rows]
    places = [
        np.round(np.log(sample.found.step / event.distances) / np.log(EVENT_RATIO)).astype(int)  # k of step · 8^(−k)
        for sample in samples
        for event in sample.found.events
    ]
    out: Table = {"sample": np.array([seed for seed, _ in rows], int)}
    for name in Event._fields:
        if name == "broken":
            continue
        values = [getattr(event, name) for event in events]
        if name == "kind":
            out[name] = np.array([kind.name.lower() for kind in values], str)
        elif name == "trigger":
            pairs = np.array(values, int).reshape(-1, 2)
            out |= {"trigger_i": pairs[:, 0], "trigger_j": pairs[:, 1]}
        elif name in ("opened", "closed"):
            out[name] = np.array(values, int)
        elif name in ("distances", "softest", "re_pair", "growth"):
            # one column for each distance; NaN if there is no value
            table = np.full((len(values), 1 + max((int(k.max()) for k in places if len(k)), default=-1)), np.nan)
            for row, value, k in zip(table, values, places, strict=True):
                row[k] = value
            out[name] = table
        else:
            out[name] = np.array(values, float)
    return Fields(out, Event)


def step_table(samples) -> Table:
    """Return one row per strain step of several samples: sample, and the fields of `StrainStep`."""
    counts = [len(sample.found.steps.strain) for sample in samples]
    out: Table = {"sample": np.repeat([sample.seed for sample in samples], counts)}
    for name in StrainStep._fields:
        out[name] = np.concatenate([getattr(sample.found.steps, name) for sample in samples])
    return Fields(out, StrainStep)


def write_table(path: Path, table: Table, digits: int = 8) -> None:
    """Write a table as CSV, with units in the header and a given number of significant digits."""
    columns, units = {}, units_of(Event) | units_of(StrainStep) | LENGTHS
    for name, values in table.items():
        unit = units.get(name, "1")
        unit = in_units(unit, current_units()) if current_units() else unit.replace("force/length^(dim-1)", "stress")
        flat = {name: values} if values.ndim == 1 else {f"{name}_{k}": v for k, v in enumerate(values.T)}
        columns |= {
            label if values.dtype.kind == "U" else heading_of(label, unit.replace("^", "")): column
            for label, column in flat.items()
        }
    kit.write_table(path, columns, zip(*columns.values(), strict=True), digits=digits)


@checked
def read_table(path: str | Path) -> Table:
    """Read a table written by a catalogue; columns have the names used in the archive, without units.

    Parameters
    ----------
    path : events.csv or steps.csv in a run folder

    Examples
    --------
    >>> import stickslip as ss
    >>> read_table = ss.experiments.catalogue.read_table
    >>> events = read_table("results/catalogue/events.csv")  # doctest: +SKIP
    """
    (_, labels), *rows = kit.read_table(path, remedy="give events.csv or steps.csv in a run folder")
    out: dict[str, list] = {}
    for label, cells in zip(labels, np.array([fields for _, fields in rows]).reshape(-1, len(labels)).T, strict=True):
        name, unit = split_label(label)
        spread = _SPREAD.fullmatch(name)
        kind = int if name in _WHOLE else str if unit is None else float
        out.setdefault(spread[1] if spread else name, []).append(cells.astype(kind))
    return {name: parts[0] if len(parts) == 1 else np.stack(parts, axis=1) for name, parts in out.items()}


def stack_tables(tables: Iterable[tuple[str, Table]], label: str) -> Table:
    """Stack tables with the same columns, preceded by a column that names the table of each row.

    Tables without rows may lack the columns with several values per row.
    """
    tables = list(tables)
    full = max((table for _, table in tables), key=len)
    width = {
        name: max(t[name].shape[1] for _, t in tables if name in t) for name, values in full.items() if values.ndim > 1
    }
    out: Table = {label: np.repeat([name for name, _ in tables], [len(t["sample"]) for _, t in tables])}
    for name in full:
        columns = [t[name] for _, t in tables if name in t]
        if name in width:
            columns = [np.pad(c, ((0, 0), (0, width[name] - c.shape[1])), constant_values=np.nan) for c in columns]
        out[name] = np.concatenate(columns)
    return out


def rows_of(table: Table, rows) -> Table:
    """Select rows of all columns."""
    return {name: values[rows] for name, values in table.items()}


# columns of the steps: 1 if large values announce an event, −1 if small values do; and a description
PREDICTORS = {
    "softest": (-1, "smallest real eigenvalue"),
    "nonaffine_rate": (1, "|dq/dγ| of the non-affine motion"),
    "growth": (1, "growth rate of the fastest pair"),
    "tangent_modulus": (-1, "tangent shear modulus"),
    "switch": (-1, "switch test: smallest eigenvalue with one mobilised contact set to slide"),
    "loss_ahead": (-1, "strain to the first loss of a contact that causes instability"),
}
LARGEST = 1e300  # replaces infinite values, so that they count as equal
RESAMPLES = 1000
LEVEL = 0.95  # level of intervals and bands
GRID = np.linspace(0, 1, 101)  # fractions of false alarms at which bands are computed


@readable(head=lambda r: f"area {r.area:.3f}")
class Roc(NamedTuple):
    """Receiver operating characteristic: fractions of announced steps as the threshold decreases.

    Each point is the fraction of announced steps among those followed by an event (`hits`) and among all others
    (`false_alarms`). The area is the probability that a random step followed by an event has a larger score than a
    random other step; ties count one half.
    """

    false_alarms: np.ndarray  # (T,) from 0 to 1
    hits: np.ndarray  # (T,) from 0 to 1
    area: float  # 1/2 without skill; NaN if all steps, or none, are followed by an event


@checked
def roc(score: np.ndarray, followed: np.ndarray, weight: np.ndarray | None = None) -> Roc:
    """Receiver operating characteristic of a score.

    Parameters
    ----------
    score : (S,) larger where an event is expected
    followed : (S,) bool, True if an event follows
    weight : (S,) number of times that each step counts; default 1

    Source
    ------
    Hanley & McNeil 1982, doi:10.1148/radiology.143.1.7063747: the area is the statistic of Mann and Whitney.

    Examples
    --------
    >>> roc([3.0, 2.0, 1.0, 0.0], [True, False, True, False]).area
    0.75
    """
    score = np.asarray(score, float)
    if not len(score) == len(followed) or not np.isfinite(score).all():
        raise ValueError(
            f"score and followed must be finite and have equal lengths, got {len(score)} and {len(followed)}"
        )
    return _curve(*_ranking(score), np.asarray(followed, bool), np.ones(len(score)) if weight is None else weight)


def _ranking(score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the order of decreasing scores, and the last position of each group of equal scores in it."""
    order = np.argsort(-score, kind="stable")
    return order, np.flatnonzero(np.diff(score[order], append=np.nan) != 0)


def _curve(order: np.ndarray, last: np.ndarray, followed: np.ndarray, weight: np.ndarray) -> Roc:
    hits, false_alarms = (
        np.concatenate([[0.0], np.cumsum(np.where(kind, weight, 0.0)[order])[last]]) for kind in (followed, ~followed)
    )
    if not hits[-1] or not false_alarms[-1]:
        return Roc(np.array([0.0, 1.0]), np.full(2, np.nan), np.nan)
    hits, false_alarms = hits / hits[-1], false_alarms / false_alarms[-1]
    return Roc(false_alarms, hits, float(np.trapezoid(hits, false_alarms)))


@readable(head=lambda s: f"{s.predictor}, area {s.roc.area:.3f} ({s.low:.3f} to {s.high:.3f})")
class Skill(NamedTuple):
    """Skill of one predictor, with 95 % intervals from resampling of packings."""

    predictor: str
    roc: Roc
    low: float  # interval of the area; NaN with fewer than two packings
    high: float
    band: np.ndarray  # (2, 101) interval of the hits at fractions of false alarms 0, 0.01, …, 1
    steps: int  # number of steps with a value
    followed: int  # number of steps followed by an event within the window
    packings: int


@checked
def resampled_skill(
    predictor: str, score: np.ndarray, followed: np.ndarray, sample: np.ndarray, *, resamples: int = RESAMPLES, seed=0
) -> Skill:
    """Skill of a score, with intervals from a bootstrap over whole packings.

    Neighbouring steps of a packing are similar and thus not independent observations. Each resample therefore draws
    packings with replacement; every step counts as often as its packing was drawn.

    Parameters
    ----------
    score, followed : as in `roc`
    sample : (S,) packing to which each step belongs
    """
    order, last = _ranking(score)
    whole = _curve(order, last, followed, np.ones(len(score)))
    blocks, block = np.unique(sample, return_inverse=True)
    areas, hits = np.full(resamples, np.nan), np.full((resamples, len(GRID)), np.nan)
    rng = np.random.default_rng(seed)
    for k in range(resamples if len(blocks) > 1 else 0):
        drawn = rng.multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)))
        curve = _curve(order, last, followed, drawn[block].astype(float))
        areas[k], hits[k] = curve.area, np.interp(GRID, curve.false_alarms, curve.hits)
    good = np.isfinite(areas)
    ends = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    low, high = np.quantile(areas[good], ends) if good.any() else (np.nan, np.nan)
    band = np.quantile(hits[good], ends, axis=0) if good.any() else np.full((2, len(GRID)), np.nan)
    return Skill(predictor, whole, float(low), float(high), band, len(score), int(followed.sum()), len(blocks))


def skills(steps: Table, events: Table, window: float, *, resamples: int = RESAMPLES) -> list[Skill]:
    """Skill of every predictor for an event within the next `window` of strain.

    A step counts if an event follows within the window, or if the path continues beyond the window. Steps at which a
    predictor has no value (NaN) do not count for that predictor.
    """
    followed, known = label_steps(steps, events, window)
    out = []
    for name, (sign, _) in PREDICTORS.items():
        rows = known & ~np.isnan(steps[name])
        if rows.any():
            score = sign * np.clip(steps[name][rows], -LARGEST, LARGEST)
            out.append(resampled_skill(name, score, followed[rows], steps["sample"][rows], resamples=resamples))
    return out


def label_steps(steps: Table, events: Table, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Return masks of the steps followed by an event within a window of strain, and of steps where this is known."""
    followed, known = np.zeros(len(steps["strain"]), bool), np.zeros(len(steps["strain"]), bool)
    reach = window * (1 + 1e-9)
    for packing in np.unique(steps["sample"]):
        rows, at = np.flatnonzero(steps["sample"] == packing), np.sort(events["strain"][events["sample"] == packing])
        strain = steps["strain"][rows]
        following = np.append(at, np.inf)[np.searchsorted(at, strain, side="right")]
        followed[rows] = following - strain <= reach
        end = max(strain[-1], at[-1] if len(at) else -np.inf)
        known[rows] = followed[rows] | (strain + window <= end + 1e-9 * window)
    return followed, known


KINDS = tuple(kind.name.lower() for kind in EventKind)


def class_counts(events: Table) -> dict[str, int]:
    """Number of events of each class."""
    return {kind: int((events["kind"] == kind).sum()) for kind in KINDS}


def strain_searched(result: CatalogueResult) -> float:
    """Total strain searched for events."""
    steps = [sample.found.steps.strain for sample in result.samples]
    return float(sum(strain[-1] + result.scenario.shear.step for strain in steps if len(strain)))


def predictor_skills(result: CatalogueResult, **options) -> list[Skill]:
    """Skill of every predictor (see `skills`)."""
    return skills(step_table(result.samples), event_table(result.samples), result.scenario.shear.window, **options)


def _share(kind: str) -> Quantity:
    return Quantity(f"share_{kind}", "1", f"fraction of events of this class: {EventKind[kind.upper()].value}",
                    lambda c: class_counts(c.events)[kind] / c.number if c.number else np.nan)  # fmt: skip


class Catalogue:
    """Events of a run and their number, from which `MEASURES` are computed."""

    def __init__(self, result: CatalogueResult):
        self.result, self.number, self.events = result, result.number, event_table(result.samples)
        self.areas = {skill.predictor: skill.roc.area for skill in predictor_skills(result, resamples=0)}
        self.strain = strain_searched(result)


MEASURES = Measures([
    Quantity("events", "1", "number of events", lambda c: float(c.number)),
    Quantity("packings", "1", "number of packings", lambda c: float(len(c.result.samples))),
    Quantity("events_per_strain", "1", "events per unit of strain",
             lambda c: c.number / c.strain if c.strain else np.nan),
    *map(_share, KINDS),
    Quantity("saddle_node_exponent", "1", "median exponent of the smallest eigenvalue before saddle nodes",
             lambda c: median(c.events["exponent"][c.events["kind"] == "saddle_node"])),
    Quantity("stress_drop_over_pressure", "1", "median drop of the shear stress over the pressure",
             lambda c: median(c.events["stress_drop"])),
    Quantity("jump_over_diameter", "1", "median jump of the grains over their diameter",
             lambda c: median(c.events["jump"])),
    *(Quantity(f"auc_{name}", "1", f"area under the ROC curve of a predictor: {words}",
               lambda c, name=name: c.areas.get(name, np.nan)) for name, (_, words) in PREDICTORS.items()),
], subject=Catalogue)  # fmt: skip


def law_label(scenario) -> str:
    """Short description of a scenario's law."""
    law = scenario.law
    if law.file is not None:
        return "law from a file"
    name = {"hertz_mindlin": "Hertz", "linear": "linear"}[law.kind]
    friction = f"{law.coulomb}, $\\mu$ = {law.mu:g}" if law.mu else "no friction"
    return f"{name}, {friction}, {scenario.packing.dim}D"


def figures(result: CatalogueResult):
    """Yield (file name, Figure) for each figure of a run."""
    from . import figures as figures_of

    events, label = event_table(result.samples), law_label(result.scenario)
    if result.number:
        yield "fig1_eigenvalue.png", figures_of.eigenvalue_before_events(events)
        yield "fig2_classes.png", figures_of.classes({label: class_counts(events)})
        yield "fig3_drops.png", figures_of.drops({label: events})
    if found := [skill for skill in predictor_skills(result) if np.isfinite(skill.roc.area)]:
        yield "fig4_roc.png", figures_of.roc_curves(found, (label,))


def files(result: CatalogueResult):
    """Yield (file name, function that writes it) for the tables of events and of strain steps."""
    yield "events.csv", partial(write_table, table=event_table(result.samples))
    yield "steps.csv", partial(write_table, table=step_table(result.samples))


def numbers(result: CatalogueResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    return {
        "scenario": result.scenario.text,
        "law": result.law,
        "units": "those of the scenario: force, length, mass",
        "events": event_table(result.samples),
        "steps": step_table(result.samples),
        "packings": {f"{sample.seed:04d}": archive_fields(sample.packed) for sample in result.samples},
        "ends": {f"{sample.seed:04d}": sample.found.state for sample in result.samples},
        "failures": "\n".join(result.failures),
    }


def show(result: CatalogueResult) -> None:
    """Print the classes of the events and the skill of the predictors."""
    values = MEASURES(result)
    console.print(
        f"{pluralize(result.number, 'event')} in {pluralize(len(result.samples), 'packing')}, "
        f"{values['events_per_strain'][0]:.3g} per unit strain; drag {result.scenario.shear.drag:g} of the "
        f"highest frequency."
    )
    table = new_table("class", "number", title="Events", left=("class",))
    for kind, number in class_counts(event_table(result.samples)).items():
        table.add_row(EventKind[kind.upper()].value, str(number))
    show_table(table)
    title = f"Announcements of an event within a strain of {result.scenario.shear.window:g}"
    table = new_table("predictor", "area under ROC", "95 % interval", "steps", title=title, left=("predictor",))
    for skill in predictor_skills(result):
        interval = f"{skill.low:.3f} to {skill.high:.3f}" if np.isfinite(skill.low) else "–"
        area = f"{skill.roc.area:.3f}" if np.isfinite(skill.roc.area) else "–"
        table.add_row(PREDICTORS[skill.predictor][1], area, interval, str(skill.steps))
    show_table(table)
    for failure in result.failures:
        console.print(failure, style="yellow")
