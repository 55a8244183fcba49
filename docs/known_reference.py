"""Write the table of foreign commands, columns and sections into docs/exchange.md, from `stickslip.known`.

python docs/known_reference.py          # also run by `make docs`; a test compares the result
"""

from pathlib import Path

from stickslip.known import TABLE

PAGE = Path(__file__).parent / "exchange.md"
BEGIN, END = "<!-- the table of known.py begins -->\n", "<!-- it ends -->\n"


def table() -> str:
    """The table, a row for each kind and group."""
    rows: dict[tuple[str, str], list[str]] = {}
    for row in TABLE:
        names = ", ".join(f"`{name}`".replace("|", "\\|") for name in row.names.split())
        rows.setdefault((row.kind, row.group), []).append(f"{names}: {row.why}" if row.why else names)
    lines = [f"| {kind} | {group} | {'; '.join(names)} |" for (kind, group), names in rows.items()]
    return "\n".join(["| | group | names |", "|---|---|---|", *lines]) + "\n"


def write(page: Path = PAGE) -> None:
    """Replace the table in a page that has its marks; an unchanged page is not rewritten."""
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    new = f"{before}{BEGIN}{table()}{END}{rest.partition(END)[2]}"
    if new != text:
        page.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    write()
