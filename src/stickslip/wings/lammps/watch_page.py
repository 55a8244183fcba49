"""The live page of a watched simulation, with its charts: one self-contained file, which reloads itself."""

import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ... import __version__
from ...kit import Array, page, pluralize, render, staged_file, style
from ...measure import BALANCED_BELOW
from .watch import Progress, Row, verdict_word

Column = Annotated[Any, Array((1,), finite=False)]  # NaN where a quantity is not known
COLOURS = {"stable": style.GREEN, "unstable": style.RED}  # of a verdict; others have none


def _line(axes, step, values, color, label=None, quantity=None):
    known = np.isfinite(values)
    axes.plot(step[known], values[known], "o-", color=color, ms=2, lw=0.8, label=label)
    if quantity:
        style.label_axes(axes, y=quantity)


@style.styled
def watched_stress(step: Column, pressure: Column, shear: Column):
    """Pressure, and shear stress over pressure, against the time step."""
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, pressure, style.BLUE, quantity=("pressure", "stress"))
    ratio = np.divide(shear, pressure, out=np.full(len(step), np.nan), where=np.abs(pressure) > 0)
    _line(below, step, ratio, style.ORANGE, quantity="shear / pressure")
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_contacts(step: Column, coordination: Column, sliding: Column):
    """Coordination and the fraction of sliding contacts against the time step."""
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, coordination, style.BLUE, quantity="contacts per grain")
    _line(below, step, sliding, style.ORANGE, quantity="sliding fraction")
    below.set_ylim(0, 1.1 * max(np.nanmax(sliding, initial=0.0), 0.01))
    if not np.isfinite(sliding).any():
        below.text(0.5, 0.5, "unknown without memory", ha="center", va="center", transform=below.transAxes)
        below.set_yticks([])
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_spectrum(step: Column, softest: Column, growth: Column, verdicts: list[str]):
    """Softest eigenvalue, and growth rate of the fastest pair, against the time step; filled where there is a verdict.

    Parameters
    ----------
    growth : growth rates, zero if no pair grows, NaN without a spectrum
    verdicts : for each frame, stable, unstable, or another word
    """
    figure, (above, below) = style.column_axes(2, 2.8, sharex=True)
    _line(above, step, softest, style.BLUE, quantity=(r"softest $\lambda$", "1/time$^2$"))
    if (softest < 0).any():
        above.axhline(0, color="0.6", lw=0.6)
    known = np.isfinite(growth)
    below.plot(step[known], growth[known], "-", color="0.7", lw=0.8, zorder=1)
    for word, color in COLOURS.items():
        chosen = known & np.array([verdict == word for verdict in verdicts], bool)
        if chosen.any():
            below.plot(step[chosen], growth[chosen], "o", color=color, ms=2.5, label=word)
    rest = known & np.array([verdict not in COLOURS for verdict in verdicts], bool)
    if rest.any():
        below.plot(step[rest], growth[rest], "o", mfc="white", mec=style.SKY, ms=2.5, mew=0.7, label="no verdict")
    if known.any():
        style.legend_above(below, ncol=3)
    style.label_axes(below, y=("growth rate", "1/time"))
    below.set_ylim(bottom=0)
    style.label_axes(below, x="time step")
    return figure


@style.styled
def watched_balance(step: Column, residual: Column, limit: float):
    """Largest unbalanced force over the mean contact force against the time step, with the limit for a verdict."""
    figure, axes = style.column_axes(1, 1.7)
    good = np.where(residual > 0, residual, np.nan)
    _line(axes, step, good, style.BLUE)
    axes.axhline(limit, color=style.RED, lw=0.7, ls="--", label="limit for a verdict")
    axes.set_yscale("log")
    style.label_axes(axes, x="time step", y="unbalanced force / mean")
    style.legend_above(axes)
    return figure


RELOAD = 10  # time after which the page is loaded again [s]
ROWS = 60  # of the table of frames
COLUMNS = (
    "step", "contacts", "per grain", "sliding", "pressure", "shear/pressure", "unbalanced", "softest λ", "pairs",
    "growth rate", "verdict",
)  # fmt: skip


def write_page(path: Path, place: Path, table: Path, done: Progress, how: dict) -> None:
    """Write the page; it reloads itself only while the simulation may be running."""
    rows = [row for _, row in sorted(done.rows.items())]
    text = page.page(
        f"Watching {place.resolve().name}", _about(done), _sections(rows, table, done, how),
        reload=RELOAD if done.live else None,
    )  # fmt: skip
    with staged_file(path) as part:
        part.write_bytes(text.encode())


def _about(done: Progress) -> str:
    now = time.strftime("%Y-%m-%d %H:%M:%S")
    live = f"written at {now}; this page reloads every {RELOAD} s" if done.live else f"ended at {now}"
    return f"stickslip {__version__}, {live}"


def _sections(rows: list[Row], table: Path, done: Progress, how: dict) -> list[tuple[str, str]]:
    usable = [row for row in rows if row.computed]
    sections = [("Newest frame", _newest(usable[-1], done) if usable else page.paragraph("No frame yet.", kind="soft"))]
    if usable:
        sections.append(("Charts", _charts(usable)))
        sections.append(("Frames", _frame_table(rows, table)))
    facts = [["law", how["law"]], *(["note", line] for line in done.notes)]
    return [*sections, ("Conditions", page.table(["", "value"], facts))]


def _newest(row: Row, done: Progress) -> str:
    verdict = row.verdict or row.note
    html = page.paragraph(f"Step {row.step}: {verdict}.", kind="verdict" if row.stable is not None else "")
    if row.scope:
        html += page.paragraph(f"What was checked: {row.scope}.", kind="soft")
    if row.note and row.verdict:
        html += page.paragraph(row.note[:1].upper() + row.note[1:] + ".", kind="soft")
    if done.left:
        html += page.paragraph(
            f"Not computed yet: {pluralize(done.left, 'frame')}. The newest one comes first, the others while the "
            f"simulation does not write.",
            kind="warning",
        )
    return html


def _charts(rows: list[Row]) -> str:
    step = np.array([row.step for row in rows], float)
    series = {name: _series(rows, name) for name in ("pressure", "shear_stress", "coordination", "softest", "residual")}
    sliding = _series(rows, "sliding") / np.maximum(_series(rows, "contacts"), 1)
    growth = np.where(np.isfinite(_series(rows, "pairs")), np.nan_to_num(_series(rows, "growth_rate")), np.nan)
    verdicts = [verdict_word(row) for row in rows]
    return page.pictures({
        "stress": render(watched_stress(step, series["pressure"], series["shear_stress"])),
        "contacts": render(watched_contacts(step, series["coordination"], sliding)),
        "softest mode, and fastest growing pair": render(watched_spectrum(step, series["softest"], growth, verdicts)),
        "unbalanced force": render(watched_balance(step, series["residual"], BALANCED_BELOW)),
    })  # fmt: skip


def _series(rows: list[Row], name: str) -> np.ndarray:
    values = [getattr(row, name) for row in rows]
    return np.array([np.nan if value is None else value for value in values], float)


def _frame_table(rows: list[Row], table: Path) -> str:
    lines = [[str(row.step), *cells(row), verdict_word(row)] for row in reversed(rows[-ROWS:])]
    text = page.table(list(COLUMNS), lines, classes=dict.fromkeys(COLUMNS[:-1], "number"))
    rest = f"and {len(rows) - ROWS} earlier ones" if len(rows) > ROWS else "all frames with all measures"
    return text + page.paragraph(f"{rest[:1].upper() + rest[1:]} in {table.name}.", kind="soft")


def cells(row: Row) -> list[str]:
    """Numbers of a row as text, a dash where there is none."""

    def text(value, form: str) -> str:
        return "–" if value is None else format(value, form)

    share = None if row.sliding is None or not row.contacts else row.sliding / row.contacts
    ratio = None if row.shear_stress is None or not row.pressure else row.shear_stress / row.pressure
    return [
        text(row.contacts, "d"), text(row.coordination, ".3f"), text(share, ".1%"), text(row.pressure, ".4g"),
        text(ratio, ".3f"), text(row.residual, ".1e"), text(row.softest, ".3g"), text(row.pairs, "d"),
        text(row.growth_rate, ".3g"),
    ]  # fmt: skip
