"""Run benchmarks: `python -m benchmarks NAME [--store] [--smallest] [WORDS]`; without a name, list them with costs.

Rows are printed as soon as they are available. `--store` also writes them to docs/numbers/NAME.json, and into the pages
that show them. `--smallest` is a quick check that the benchmark works; its numbers are meaningless and cannot be
stored. `all` runs the benchmarks that give ratios to other codes or to budgets; codes that are not installed are
skipped. Further words are options of a benchmark, which its docstring describes.
"""

import importlib
import os
import sys

from rich.box import SIMPLE_HEAD
from rich.table import Table

from . import BENCHMARKS, records
from .records import console


def listing() -> Table:
    """Table of all benchmarks, cheapest first."""
    table, known = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0)), records.read()
    for head in ("name", "measures", "processor time [s]"):
        table.add_column(head, justify="right" if head.endswith("]") else "left", overflow="fold")
    costs = {name: known.get(name, {}).get("seconds", one.seconds) for name, one in BENCHMARKS.items()}
    for name in sorted(BENCHMARKS, key=costs.get):
        table.add_row(name, BENCHMARKS[name].about, f"{costs[name]:,.0f}")
    return table


def line(row: dict) -> str:
    """Format a row for printing."""
    if "value" in row:
        error = f" ± {row['error']:.2g}" if row.get("error") is not None else ""
        return f"{row['case']}: {row['value']:.4g}{error} {row['unit']}".rstrip()
    case = next(iter(records.measured(row)))
    peer = "" if row["peer"] is None else f"; {row['peer_name']} {row['peer']:.4g}"
    return f"{case}: {row['ours']:.4g} {row['unit']}{peer}" + (f"; ratio {row['ratio']:.2f}" if row["ratio"] else "")


def rows(name: str, *words: str, smallest: bool = False):
    """Yield the rows of a benchmark as they become available: dictionaries of numbers, and lines of text."""
    module, _, function = (BENCHMARKS[name].place or f"{name}:rows").partition(":")
    return getattr(importlib.import_module(f"benchmarks.{module}"), function)(*words, smallest=smallest)


def run(name: str, *words: str, smallest: bool = False, store: bool = False) -> None:
    """Run a benchmark and print its rows; store its numbers if requested."""
    for room in BENCHMARKS[name].rooms if store else ():
        records.files_of(room)  # raises for a missing room before anything is measured
    found, lines, start = {}, [], os.times()
    for row in rows(name, *words, smallest=smallest):
        console.print(row if isinstance(row, str) else line(row), markup=False, highlight=False, soft_wrap=True)
        if isinstance(row, str):
            lines.append(row)
        else:
            found |= records.measured(row)
    if store:
        command = " ".join(["python -m benchmarks", name, *words])
        spent = [end - begin for end, begin in zip(os.times()[:4], start, strict=False)]
        alone = sum(spent[2:]) < 0.1  # processes that ran for longer may have imported other modules
        modules = records.imported(BENCHMARKS[name].rooms) if alone else None
        path = records.store(name, command, BENCHMARKS[name].rooms, found, sum(spent), lines, modules)
        console.print(*(f"Written: {one.relative_to(records.ROOT)}" for one in (path, *records.write())), sep="\n")


def main() -> None:
    """Run the benchmark named on the command line."""
    options = {word for word in sys.argv[1:] if word in ("--store", "--smallest")}
    name, *words = [word for word in sys.argv[1:] if word not in options] or [""]
    if not name:
        console.print(listing())
        return
    if name in ("-h", "--help"):
        console.print(__doc__, markup=False, highlight=False)
        return
    if name not in (*BENCHMARKS, "all"):
        sys.exit(f"there is no benchmark {name!r}: use all, {', '.join(BENCHMARKS)}")
    if len(options) == 2:
        sys.exit("numbers of the smallest size cannot be stored: leave out --smallest or --store")
    chosen = [one for one, about in BENCHMARKS.items() if about.ratios] if name == "all" else [name]
    for one in chosen:
        if name == "all":
            console.print(f"[bold]{one}[/]: {BENCHMARKS[one].about}")
        run(one, *words, smallest="--smallest" in options, store="--store" in options)


if __name__ == "__main__":
    main()
