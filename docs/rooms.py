"""Diagram of the rooms and their imports, drawn from the code: `python docs/rooms.py` writes `figures/rooms.svg`.

Rows are the layers of the import contract in `pyproject.toml`; the public namespaces are drawn as one box. An arrow
leads from a room to one that it imports. Imports that follow from others (A needs B, B needs C) are left out, and so
are the modules of the last row, which any room may import.
"""

import re
import tomllib
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "stickslip"
SVG = ROOT / "docs" / "figures" / "rooms.svg"
WIDTH, BOX, HIGH, GAP = 960, 96, 34, 62
INK, FILL, LINE = "#1f2933", "#e8eef4", "#7b8794"


def layers() -> list[list[str]]:
    """Rooms by layer, from the top, as the import contract has them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = next(c["layers"] for c in contracts if c["type"] == "layers")
    return [re.split("[|:]", row.replace(" ", "")) for row in rows]


def imports(rows: list[list[str]]) -> set[tuple[str, str]]:
    """Pairs (box, imported box) without those that follow from others; a box is a room, or the row of namespaces."""
    graph = grimp.build_graph("stickslip", cache_dir=None)
    box = {room: " ".join(row) if row == _namespaces(rows) else room for row in rows[:-1] for room in row}
    for room in box:
        if graph.find_children(f"stickslip.{room}"):
            graph.squash_module(f"stickslip.{room}")
    pairs = {
        (box[a], box[b])
        for a in box
        for b in box
        if box[a] != box[b] and graph.direct_import_exists(importer=f"stickslip.{a}", imported=f"stickslip.{b}")
    }
    for room in _namespaces(rows):  # their imports are in stubs
        stub = (PACKAGE / f"{room}.pyi").read_text(encoding="utf-8")
        pairs |= {(box[room], box[b]) for b in re.findall(r"^from \.(\w+)", stub, flags=re.M) if b in box}
    middle = set(box.values())
    return {(a, b) for a, b in pairs if not any((a, c) in pairs and _reaches(c, b, pairs) for c in middle - {b})}


def _namespaces(rows: list[list[str]]) -> list[str]:
    """The row of modules that only import public names."""
    return max(rows, key=len)


def _reaches(start: str, end: str, pairs: set[tuple[str, str]]) -> bool:
    return (start, end) in pairs or any(_reaches(b, end, pairs) for a, b in pairs if a == start)


def svg() -> str:
    """The diagram."""
    rows = layers()
    boxes = [[" ".join(row)] if row == _namespaces(rows) else row for row in rows]
    place = {
        box: (WIDTH * (k + 1) / (len(row) + 1), 8 + GAP * n) for n, row in enumerate(boxes) for k, box in enumerate(row)
    }
    height = 8 + GAP * (len(rows) - 1) + HIGH + 8
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        'font-family="sans-serif" font-size="14">',
        "<title>Rooms of stickslip and what they import</title>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0L8 4L0 8z" fill="{LINE}"/></marker></defs>',
    ]
    for a, b in sorted(imports(rows)):
        (x, y), (u, v) = place[a], place[b]
        y, bend = y + HIGH, (v - y - HIGH) / 2
        out.append(
            f'<path d="M{x:g} {y:g}C{x:g} {y + bend:g} {u:g} {v - bend:g} {u:g} {v:g}" fill="none" stroke="{LINE}" '
            f'marker-end="url(#head)"><title>{a} imports {b}</title></path>'
        )
    for name, (x, y) in place.items():
        if name == "wings":
            name = f"wings: {', '.join(sorted(path.parent.name for path in PACKAGE.glob('wings/*/wing.py')))}"
        wide = max(BOX, 9 * len(name))
        out.append(
            f'<rect x="{x - wide / 2:g}" y="{y:g}" width="{wide}" height="{HIGH}" rx="5" fill="{FILL}" stroke="{INK}"/>'
            f'<text x="{x:g}" y="{y + HIGH / 2 + 5:g}" text-anchor="middle" fill="{INK}">{name}</text>'
        )
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    SVG.write_text(svg())
    print(SVG.relative_to(ROOT))
