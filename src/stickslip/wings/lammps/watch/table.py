"""The table of a watched simulation: a CSV file with a comment that says how it was computed."""

import json
from pathlib import Path

from .... import __version__
from ....data.exchange.lammps_series import Source
from ....kit import format_table, parse_number, read_table, read_text, write_atomically
from ....reports.packing import describe_law
from .measures import Row

MARK = "written by stickslip watch "
NUMBERS = {name: kind for name, kind in Row.__annotations__.items() if kind is not str}


def describe(source: Source, method: str) -> dict:
    """What determines the numbers of a row besides its frame."""
    law = source.law
    return {
        "law": describe_law(law), "parameters": law.table.tolist(), "kind": str(law.kind),
        "memory": source.contacts is not None, "columns": source.columns, "boundary": source.boundary,
        "i0": source.i0, "method": method,
    }  # fmt: skip


def write_rows(path: Path, rows: dict[int, Row], how: dict) -> None:
    """Write all rows, by step, all or nothing."""
    ordered = [row for _, row in sorted(rows.items())]
    comment = f"{MARK}{__version__}: {json.dumps(how)}"
    write_atomically(path, format_table(Row._fields, ordered, digits=None, comments=[comment]).encode())


def read_rows(path: Path, how: dict, *, overwrite: bool = False) -> dict[int, Row]:
    """Rows of an earlier watch, without those that could not be computed; none if there is no table.

    Raises
    ------
    ValueError
        if the file is not such a table, or was computed in another way; the message is one sentence.
    """
    if not path.exists() or overwrite:
        return {}
    remedy = "give another --out, or --overwrite to compute it anew"
    text = read_text(path, remedy=remedy)
    head = text.partition("\n")[0]
    try:
        if not head.startswith(f"# {MARK}"):
            raise ValueError("it has no such comment")
        before = json.loads(head.partition(": ")[2])
        if not isinstance(before, dict):
            raise ValueError("its comment is no JSON object")
        (_, names), *lines = read_table(path)
        rows = [_parse(dict(zip(names, fields, strict=True))) for _, fields in lines]
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{path} is not a table that stickslip watch wrote: {remedy}") from None
    other = [name for name, value in json.loads(json.dumps(how)).items() if before.get(name) != value]
    if other:
        told = "law" if "parameters" in other or "kind" in other else other[0]
        raise ValueError(f"{path} was computed with another {told} ({before.get(told)}): {remedy}")
    return {row.step: row for row in rows if row.computed}


def _parse(line: dict[str, str]) -> Row:
    values = {name: line[name] for name in Row._fields} | {"step": str(int(line["step"]))}
    return Row(**{name: _number(text) if name in NUMBERS else text for name, text in values.items()})


def _number(text: str) -> int | float | bool | None:
    if text in ("", "True", "False"):
        return {"": None, "True": True, "False": False}[text]
    return int(text) if text.lstrip("-").isdigit() else parse_number(text)
