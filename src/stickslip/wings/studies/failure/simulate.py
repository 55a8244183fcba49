"""Failure of a packing: read it, shear it until it fails, and write tables, figure, page and summary."""

import hashlib
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, State, __version__
from ....io import read_packing
from ....kit import (
    CHANGES,
    FAILURES,
    Fields,
    Measures,
    Obstacle,
    Quantities,
    Quantity,
    Report,
    ScenarioError,
    Workers,
    archive_fields,
    capture_warnings,
    checked,
    checkpoint_in,
    complete_path,
    console,
    frame_of,
    let_settle,
    load_or_compute,
    median,
    new_table,
    result_of,
    show_table,
    silent,
    versions,
    with_unit,
)
from ....protocols import shear_to_failure
from ....results import Event, EventKind, Failure, PathStep
from . import EXPERIMENT
from .scenario import FailureScenario


class Packed(NamedTuple):
    """A packing and its law, as read from a file."""

    state: State
    law: Law
    notes: tuple[str, ...]


@result_of(EXPERIMENT, head=lambda result: result.found.end)
class FailureResult(NamedTuple):
    """Result of a failure scenario."""

    scenario: FailureScenario
    notes: tuple[str, ...]  # notes on the input
    found: Failure

    @property
    def law(self) -> Law:
        """Law of the packing."""
        return self.found.law


def read_input(scenario: FailureScenario) -> Packed:
    """Read the packing of a scenario, and let it come to rest if requested; reject a packing that cannot be sheared.

    Raises
    ------
    ValueError
        If the packing cannot be read or sheared, or does not have the digest in the scenario.
    """
    given, law, shear = scenario.packing, scenario.law, scenario.shear
    options = given.model_dump(exclude={"file", "settle", "digest"})
    options["contacts"] = given.contacts and Path(given.contacts)
    options |= law.model_dump(exclude={"kind", "more", "file", "parameters", "checksum"})
    options["law"] = law.file or law.kind
    options["parameters"] = (law.parameters if law.file else law.more) or None
    (state, its_law, notes), said = capture_warnings(read_packing, Path(given.file), **options)
    notes = [*notes, *said]
    if acts := [note.reason for note in notes if isinstance(note, Obstacle)]:
        raise ScenarioError(f"{given.file} cannot be sheared: {'; '.join(acts)}")
    if given.settle:
        state, calm = let_settle(state, its_law)
        notes.append(f"settled: {calm.how}; {calm}")
    complete_path(state, its_law, **shear.model_dump())
    packed = Packed(state, its_law, tuple(map(str, notes)))
    if given.digest not in (None, digest_of(packed)):
        raise ScenarioError(
            f"{given.file} or its law has changed since the run began: restore it, or start again with --overwrite"
        )
    return packed


def digest_of(packed: Packed) -> str:
    """Digest of grains, cell, contacts, bonds and law of a packing."""
    out = hashlib.sha256(repr(packed.law).encode())
    state, count = packed.state, int(packed.state.contacts.count[0])
    parts = [state.grains.position, state.grains.radius, state.grains.mass, state.cell.vectors]
    parts += [state.contacts.key[:count], state.contacts.slip[:count], packed.law.table, *(state.bonds or ())]
    for part in parts:
        out.update(np.ascontiguousarray(part).tobytes())
    return out.hexdigest()[:16]


def keep_packing(folder: Path, scenario: FailureScenario, packed: Packed) -> None:
    """Save the packing of a new run, which then no longer needs the input file."""
    load_or_compute(_kept(folder, scenario), "packing", lambda: packed, Packed)


def _kept(folder: Path | None, scenario: FailureScenario):
    return checkpoint_in(folder, scenario, Packed, PathStep, Event, EventKind)


@checked
def simulate_failure(
    scenario: FailureScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> FailureResult:
    """Shear or compress the packing of a scenario until it fails; see `ss.protocols.shear_to_failure`.

    Parameters
    ----------
    folder : run folder, in which the packing and each strain step are saved as soon as they are finished; a killed run
        resumes bitwise identically
    workers : unused, as each step starts from the previous one
    report : called as report(stage, share done, text)
    """
    kept = _kept(folder, scenario)
    packed = load_or_compute(kept, "packing", partial(read_input, scenario), Packed)
    found = shear_to_failure(packed.state, packed.law, **scenario.shear.model_dump(), kept=kept, report=report)
    return FailureResult(scenario, packed.notes, found)


STRESS, RATE, SQUARE = "force/length^(dim-1)", "1/time", "1/time^2"
SHOWN = 12  # largest number of rows in a terminal table
RECORD = (
    "An interval should contain 80 % of the events that occur. Many predicted events do not occur, above all "
    "with friction; the softest eigenvalue predicts few at usual step sizes, and forecasts of pairs were no better "
    "than their last spacing: see stickslip docs failure."
)


def _of_rows(*columns: tuple[str, str]) -> Quantities:
    """Return the quantities of a table whose rows are tuples, given the name and meaning of each entry."""
    return Quantities([Quantity(name, "1", meaning, itemgetter(k)) for k, (name, meaning) in enumerate(columns)])


CURVE = Quantities([
    Quantity("strain", "1", "strain from the first state"),
    Quantity("stress", STRESS, "stress that does work on the strain"),
    Quantity("pressure", STRESS, "pressure"),
    Quantity("pairs", "1", "complex pairs"),
    Quantity("growth rate", RATE, "growth rate of the fastest pair without drag", "growth"),
    Quantity("softest", SQUARE, "smallest real eigenvalue"),
    Quantity("exponent", RATE, "largest exponent of growth under the drag"),
    Quantity("negative", "1", "directions of negative stiffness"),
    Quantity("touching", "1", "contacts"),
    Quantity("sliding", "1", "contacts at the Coulomb limit"),
    Quantity("loss ahead", "1", "strain to the loss of a contact that causes instability", "loss_ahead"),
    Quantity("verdict", "1", "verdict on the motion without drag"),
    Quantity("bonds", "1", "intact bonds"),
    Quantity("bond share", "1", "largest share of its strength that a bond carries", "bond_share"),
])  # fmt: skip
LIVES = Quantities([
    Quantity("born below", "1", "strain at which the pair does not yet exist", "born_below"),
    Quantity("born", "1", "first strain at which it exists"),
    Quantity("died", "1", "last strain at which it exists"),
    Quantity("died above", "1", "strain at which it no longer exists", "died_above"),
    Quantity("growth rate", RATE, "largest growth rate", "growth"),
    Quantity("at", "1", "strain of the largest growth rate"),
    Quantity("event", "1", "1 if an event lies in one of the brackets", lambda life: int(life.event)),
])  # fmt: skip
EVENTS = Quantities([
    Quantity("strain", "1", "upper end of the bracket"),
    Quantity("below", "1", "lower end of the bracket"),
    Quantity("kind", "1", "class of the event", lambda event: event.kind.name.lower()),
    Quantity("i", "1", "grain of the contact that starts it; −1 if none", lambda event: event.trigger[0]),
    Quantity("j", "1", "other grain of that contact", lambda event: event.trigger[1]),
    Quantity("mobilisation", "1", "|F_t|/(μ F_n) of that contact before the event"),
    Quantity("growth rate", RATE, "growth rate of the instability under the drag", "growth_rate"),
    Quantity("stress drop", "1", "stress drop over the pressure", "stress_drop"),
    Quantity("jump", "1", "non-affine displacement in mean diameters"),
    Quantity("opened", "1", "contacts that opened"),
    Quantity("closed", "1", "contacts that closed"),
])  # fmt: skip
CONTACTS = _of_rows(
    ("above", "strain before the step"), ("strain", "strain after the step"), ("what", "change of the contact"),
    ("i", "grain"), ("j", "other grain"), ("event", "1 in a step with an event"),
)  # fmt: skip
BREAKS = _of_rows(
    ("below", "last strain without the event in which the bond breaks"), ("strain", "first strain with it"),
    ("i", "grain"), ("j", "other grain"), ("by", "load that broke it"),
)  # fmt: skip
FORECASTS = Quantities([
    Quantity("made at", "1", "strain at which the forecast was made", "made"),
    Quantity("of", "1", "next event or next pair", "of"),
    Quantity("from", "1", "basis of the forecast", "basis"),
    Quantity("strain", "1", "forecast strain"),
    Quantity("low", "1", "lower end of the interval"),
    Quantity("high", "1", "upper end of the interval"),
    Quantity("windows", "1", "number of extrapolations"),
])  # fmt: skip


def _first(values) -> float:
    return float(next(iter(values), np.nan))


MEASURES = Measures([
    Quantity("strain", "1", "strain at the end", lambda f: f.steps[-1].strain),
    Quantity("stress", STRESS, "stress at the end", lambda f: f.steps[-1].stress),
    Quantity("first_pair", "1", "strain of the first complex pair", lambda f: f.onset.load if f.onset else np.nan),
    Quantity("first_event", "1", "strain of the first event", lambda f: _first(e.strain for e in f.events)),
    Quantity("first_break", "1", "strain at which the first bond breaks",
             lambda f: _first(e.strain for e in f.events if len(e.broken))),
    Quantity("broken", "1", "bonds that broke", lambda f: float(sum(len(e.broken) for e in f.events))),
    Quantity("events", "1", "number of events", lambda f: float(len(f.events))),
    Quantity("pairs", "1", "complex pairs at the end", lambda f: float(f.steps[-1].pairs)),
    Quantity("growth_rate", RATE, "growth rate at the end, without drag", lambda f: f.steps[-1].growth),
    Quantity("first_slide", "1", "strain by which the first contact slides", lambda f: _first(
        step.strain for step in f.steps if (step.changes[:, 0] == 2).any())),
    Quantity("drop", "1", "median stress drop of the events over the pressure",
             lambda f: median(e.stress_drop for e in f.events)),
], subject=lambda result: result.found)  # fmt: skip


def figures(result: FailureResult):
    """Yield (file name, Figure) of a run."""
    from ....figures import failure_path

    yield "fig1_path.png", failure_path(result.found)


def files(result: FailureResult):
    """Yield (file name, function that writes it) for the tables and the page."""
    found = result.found
    yield "curve.csv", lambda path: CURVE.write(path, found.steps, digits=None)
    yield "pairs.csv", lambda path: LIVES.write(path, found.pairs, digits=None)
    yield "events.csv", lambda path: EVENTS.write(path, found.events, digits=None)
    yield "contacts.csv", lambda path: CONTACTS.write(path, _contact_rows(found), digits=None)
    if found.steps[0].state.bonds:
        yield "breaks.csv", lambda path: BREAKS.write(path, _break_rows(found), digits=None)
    yield "forecasts.csv", lambda path: FORECASTS.write(path, found.forecasts, digits=None)
    yield "report.html", partial(_write_page, result)


def _break_rows(found) -> list[tuple]:
    """Rows of the table of broken bonds: bracket of the event, grains, and load."""
    rows = [(event, *row) for event in found.events for row in event.broken.tolist()]
    return [(event.below, event.strain, i, j, FAILURES[how]) for event, i, j, how in rows]


def _contact_rows(found) -> list[tuple]:
    """Rows of the table of contacts: step, change and grains."""
    return [
        (before.strain, step.strain, CHANGES[what], int(i), int(j), int(bool(step.events)))
        for before, step in zip(found.steps, found.steps[1:], strict=False)
        for what, i, j in step.changes
    ]


def decisive_points(found) -> dict[str, PathStep]:
    """Steps whose states are stored: both ends of the path, and both sides of the first pair and of events."""
    steps = found.steps
    chosen = {0, len(steps) - 1}
    born = next((k for k, step in enumerate(steps) if step.pairs), 0)
    for k in [born, *(k for k, step in enumerate(steps) if step.events)]:
        chosen |= {max(0, k - 1), k}
    return {f"{steps[k].strain:+.8f}": steps[k] for k in sorted(chosen)}


def numbers(result: FailureResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    found = result.found
    curve = {name: np.array([getattr(step, name) for step in found.steps]) for name in PathStep._fields
             if name not in ("couples", "changes", "events", "state")}  # fmt: skip
    return {
        "scenario": result.scenario.text,
        "law": found.law,
        "units": "those of the packing",
        "curve": Fields(curve, PathStep),
        "pairs": {f"{k:04d}": archive_fields(life) for k, life in enumerate(found.pairs)},
        "events": {
            f"{k:04d}": archive_fields(event._replace(kind=event.kind.name)) for k, event in enumerate(found.events)
        },
        "frames": {name: step.state for name, step in decisive_points(found).items()},
        "remarks": "\n".join(sentences(result)),
    }


def sentences(result: FailureResult) -> list[str]:
    """Return sentences on outcome, verdict, forecasts and notes."""
    found = result.found
    out = [f"{found.end[0].upper()}{found.end[1:]}.", f"Verdict on the last state: {found.verdict}."]
    out += [f"{one}." for one in found.forecasts] or ["No forecast: no quantity approaches zero in the last steps."]
    return [*out, *result.notes]


def _event_rows(found) -> list[list[str]]:
    rows = []
    for event in found.events:
        contact = "–" if event.trigger[0] < 0 else "{}–{}".format(*event.trigger)
        rows.append([f"{event.strain:.6g}", event.kind.value, contact, f"{event.stress_drop:.3g}", f"{event.jump:.2g}"])
    return rows


def _broken_rows(found) -> list[list[str]]:
    return [[f"{strain:.6g}", f"{i}–{j}", how] for _, strain, i, j, how in _break_rows(found)]


def _decisive_rows(found) -> list[list[str]]:
    return [
        [f"{one.i}–{one.j}", one.what, f"{one.mobilised:.3g}" if np.isfinite(one.mobilised) else "–",
         f"{one.growth:.3g}", one.verdict or "–"]
        for one in found.decisive
    ]  # fmt: skip


BREAK_HEAD = ("strain", "bond of grains", "broke by")
EVENT_HEAD = ("strain", "event", "contact", "stress drop over p", "jump in diameters")


def _decisive_head() -> tuple[str, ...]:
    return ("contact", "if it", "mobilisation", with_unit("growth rate then", "1/time", unnamed=""), "verdict then")


def show(result: FailureResult) -> None:
    """Print the outcome for the packing."""
    found = result.found
    for line in sentences(result):
        console.print(line)
    for title, head, rows, file in (
        ("Events", EVENT_HEAD, _event_rows(found), "events.csv"),
        ("Bonds", BREAK_HEAD, _broken_rows(found), "breaks.csv"),
        ("Decisive contacts", _decisive_head(), _decisive_rows(found), ""),
    ):
        if rows:
            table = new_table(*head, title=title, left=head[:3])
            for row in rows[: SHOWN if file else None]:
                table.add_row(*row)
            show_table(table)
            if file and len(rows) > SHOWN:
                console.print(f"  and {len(rows) - SHOWN} more in {file}")


def _write_page(result: FailureResult, path: Path) -> None:
    """Write the page of a run, with three-dimensional views of the states at decisive points."""
    from ....figures import failure_path
    from ....kit import PageContent, page, render, write_page

    found, given = result.found, result.scenario.packing.file
    points = decisive_points(found)
    frames = [frame_of(step.state, found.law) for step in points.values()]
    labels = [f"strain {step.strain:.5g}, {step.verdict}" for step in points.values()]
    sections = [
        ("Path", page.pictures({"stress, growth and softest mode along the path": render(failure_path(found))}))
    ]
    if found.forecasts:
        head = ["forecast", "made at", "strain", "interval", "from"]
        rows = [
            [f.of, f"{f.made:.6g}", f"{f.strain:.6g}", f"{f.low:.6g} to {f.high:.6g}", f.basis] for f in found.forecasts
        ]
        sections.append(("Forecasts", page.table(head, rows) + page.paragraph(RECORD, kind="soft")))
    if rows := _event_rows(found):
        sections.append(("Events", page.table(list(EVENT_HEAD), rows, file="events.csv")))
    if rows := _broken_rows(found):
        sections.append(("Bonds that broke", page.table(list(BREAK_HEAD), rows, file="breaks.csv")))
    if rows := _decisive_rows(found):
        sections.append(("Decisive contacts of the last state", page.table(list(_decisive_head()), rows)))
    if rows := [[f"{a:.5g} to {b:.5g}", what, f"{i}–{j}"] for a, b, what, i, j, _ in _contact_rows(found)]:
        table = page.table(["strain", "what", "contact"], rows, file="contacts.csv")
        sections.append(("Contacts, from the beginning", table))
    rows = [["packing", Path(given).name], ["deformation", found.mode + (", strain falls" if found.sign < 0 else "")],
            ["strain step", f"{found.step:g}"], ["drag", with_unit(f"{found.drag:.4g}", "1/time")]]  # fmt: skip
    rows += [["note", note] for note in result.notes]
    sections.append(("Packing and options", page.table(["", "value"], rows)))
    sentence = f"{found.end}; at the end: {found.verdict}"
    title, about = f"failure of {Path(given).name}", f"stickslip {__version__}, {versions()}"
    write_page(PageContent(title, about, frames, labels, len(frames) - 1, [], sections, verdict=sentence), path)
