"""Report of `stickslip doctor`, on the terminal or as JSON."""

import json
import math
from pathlib import Path

from rich.table import Table
from rich.text import Text

from ..reports.terminal import STYLE, console, progress, show_pairs, show_table
from . import machine
from .machine import OptionalPart
from .selfcheck import SelfcheckResult, selfcheck


def examine(*, as_json: bool = False) -> tuple[bool, str]:
    """Examine this installation and show the results.

    Return whether every number is right, together with the JSON or the verdict.
    """
    tables = machine.versions(), machine.threads(), machine.compiled_core(), machine.parts()
    if not as_json:
        show_machine(*tables)
    with progress(transient=True) as tell:
        check = selfcheck(tell)
    if as_json:
        return check.ok, to_json(*tables, check)
    show_checks(check)
    return check.ok, _verdict(check)


def show_machine(versions: dict, threads: dict, core: dict, parts: list[OptionalPart]) -> None:
    """Print tables of versions, threads, the compiled core and optional parts."""
    show_pairs("Versions", versions)
    show_pairs("Threads", threads)
    home, place = str(Path.home()), core["folder"]
    show_pairs("Compiled core", core | {"folder": f"~{place[len(home) :]}" if place.startswith(f"{home}/") else place})
    table = Table("extra", "for", "found", title="Optional parts", **STYLE)
    for part in parts:
        color = "green" if part.ok else "yellow"
        text = part.found + (f"\n{part.remedy}" if part.remedy else "")
        table.add_row(part.name, part.purpose, Text(text, color))
    show_table(table)


def show_checks(result: SelfcheckResult) -> None:
    """Print the self-check line by line, then the verdict."""
    table = Table("number", "measured", "deviation", "allowed", "", title="Self-check against stored numbers", **STYLE)
    for check in result.checks:
        color, word = ("green", "ok") if check.ok else ("red", "failed")
        if check.deviation is None:
            table.add_row(check.name, str(check.measured), check.note, "", Text(word, color))
        else:
            numbers = f"{check.measured:.9g}", f"{check.deviation:.1e}", f"{check.tolerance:.0e}"
            table.add_row(check.name, *numbers, Text(word, color))
    show_table(table)
    wrong = [check for check in result.checks if not check.ok]
    for check in wrong:
        message = f"{check.name}: stored {check.stored}, measured {check.measured}; tolerance for {check.note}"
        console.print(message, style="red")
    if result.problem:
        console.print(result.problem, style="red")
    console.print(_verdict(result), style="red" if wrong else "green")


def _verdict(result: SelfcheckResult) -> str:
    wrong = sum(not check.ok for check in result.checks)
    verdict = f"{wrong} of {len(result.checks)} numbers are wrong" if wrong else "all is well"
    return f"{verdict}, in {result.seconds:.1f} s"


def to_json(versions: dict, threads: dict, core: dict, parts: list[OptionalPart], result: SelfcheckResult) -> str:
    """JSON object with the keys of the tables; a number that could not be measured is null."""
    rows = [
        {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in check._asdict().items()
        }
        for check in result.checks
    ]
    out = {
        "ok": result.ok,
        "versions": versions,
        "threads": threads,
        "core": core,
        "parts": [part._asdict() for part in parts],
        "selfcheck": rows,
        "problem": result.problem,
        "seconds": round(result.seconds, 2),
    }
    return json.dumps(out, indent=1, ensure_ascii=False, allow_nan=False)
