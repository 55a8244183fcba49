"""Printed values and statements of Ferdowsi & Rubin 2021, compared with stored samples of the paper's size.

The samples in `docs/reference/gouge_paper_size` are evaluated, and the table of `docs/theory/gouge.md` is written. Run
both commands after each new sample; the second draws the figures.

python -m benchmarks gouge_samples --store
python docs/gallery.py gouge-paper-size
"""

import json
from pathlib import Path

from stickslip.wings.papers.gouge.paper import reproduce

from .records import number, write_block

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "theory/gouge.md"
WORDS = {None: "–", True: "yes", False: "no"}


def words(value, error: float | None = None, unit: str = "") -> str:
    """Value with the half width of its 95 % interval between samples."""
    if value is None or isinstance(value, bool):
        return WORDS[value]
    half = f" ± {2 * error:.2g}" if error and error == error else ""
    return f"{value:.3g}{half} {'' if unit == '1' else unit}".strip()


def table(claims, tenth: dict[str, dict], count: int) -> str:
    """Rows for printed values and statements, at the paper's size and at a tenth of it."""
    head = f"| claim | printed | {count} samples of the paper's size | verdict | at a tenth | verdict |"
    lines = [head, "|" + 6 * "---|"]
    for claim in claims:
        if claim.paper is not None:
            small = tenth.get(claim.id, {})
            cells = (
                f"`{claim.id}`", words(claim.paper, None, claim.unit), words(claim.measured, claim.error, claim.unit),
                claim.verdict, words(small.get("measured"), small.get("error"), claim.unit), small.get("verdict", "–"),
            )  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def rows(*, smallest: bool = False):
    """Values with half widths of 95 % intervals, and the table, which is not written for the smallest size."""
    found = reproduce(paper_size=True, samples=DOCS / "reference/gouge_paper_size")
    counts = {name: len(result.realizations) for name, result in found.holds.items()}
    for name, count in counts.items():
        yield number(f"samples, {name}", count) | {"digits": 1}
    for claim in found.claims:
        if isinstance(claim.measured, float):
            yield number(
                claim.id, claim.measured, claim.unit.replace("1", ""), 2 * claim.error if claim.error else None
            )
    tenth = {claim["id"]: claim for claim in json.loads((DOCS / "reference/gouge/claims.json").read_text("utf-8"))}
    text = table(found.claims, tenth, max(counts.values()))
    yield text
    if not smallest:
        write_block(PAGE, "gouge_samples", text)
