"""Contact laws that lead to complex pairs: tables and figure of `docs/pairs_by_law.md`, from a sweep.

    python -m benchmarks pairs_by_law results/pairs     # runs the sweep if there is no such folder, writes births.csv
    python -m benchmarks pairs_by_law --draw            # only the figure, the table and the summary, from births.csv

`docs/reference/pairs/births.csv` contains the results of every packing.
"""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.wings.papers.sphere_shear.claims import BIRTHS, share_interval
from stickslip.wings.papers.sphere_shear.figures import births_by_law as births_figure

from .births import UNLIMITED, Births, births_by_law, law_words
from .pictures import save_picture
from .records import write_block

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "examples/pairs_by_law.toml"
OUT, PAGE = ROOT / "docs/reference/pairs", ROOT / "docs/pairs_by_law.md"
COLUMNS = {
    "strain": "onset_strain", "exponent": "onset_exponent", "at_limit": "onset_share_at_limit",
    "mobilisation": "onset_mobilisation", "pairs": "pairs_at_last_strain", "unstable": "unstable_steps",
    "left": "steps_off_branch",
}  # fmt: skip


def read_births() -> list[dict]:
    """Return one dictionary per packing and law; missing values are None."""
    with (OUT / "births.csv").open(encoding="utf-8", newline="") as file:
        return [{k: v if k in ("kind", "coulomb") else float(v or "nan") for k, v in row.items()}
                for row in csv.DictReader(file)]  # fmt: skip


def collect(folder: Path) -> None:
    """Write births.csv from a sweep, which is run first if its folder does not exist."""
    if not folder.exists():
        subprocess.run([sys.executable, "-m", "stickslip", "run", str(SCENARIO), "--out", str(folder)], check=True)
    table = ss.io.open_sweep(folder).to_dataframe().reset_index()
    rows = table[["law.kind", "law.coulomb", "law.mu", "seed", *COLUMNS.values()]]
    rows.columns = ["kind", "coulomb", "mu", "seed", *COLUMNS]
    OUT.mkdir(parents=True, exist_ok=True)
    rows.to_csv(OUT / "births.csv", index=False, float_format="%.5g", lineterminator="\n")


def draw() -> None:
    """Write the figure, the table of the page, and the summary used by the claims on the paper."""
    packings = read_births()
    found = births_by_law(packings)
    write_summary(found)
    save_picture(births_figure(found, packings), OUT / "births.png")
    write_block(PAGE, "pairs_by_law", table(found))


def write_summary(found: list[Births]) -> None:
    """Write the file used by the claims on sheared spheres."""
    names = ("kind", "coulomb", "mu", "packings", "born", "limited", "mobilisation")
    with BIRTHS.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(names)
        out.writerows(
            [*(getattr(one, name) for name in names[:2]), f"{one.mu:g}", *one[3:6], f"{one.mobilisation:.5g}"]
            for one in found
        )


def table(found: list[Births]) -> str:
    """Format the table for the documentation."""
    head = "| law | sources | packings with a pair | strain of the first pair | contact at the limit at its birth "
    head += "| largest F_t/(μ F_n) | pairs at 0.02 |\n|---|---|---|---|---|---|---|\n"
    return head + "".join(_row(one) for one in found)


def _row(one: Births) -> str:
    strain = f"{one.strain:.2g} ({one.low:.2g}–{one.high:.2g})" if np.isfinite(one.strain) else "∞"
    mobilisation = f"{one.mobilisation:.2g}" if one.born and one.mu < UNLIMITED else "–"
    at_limit = _share(one.limited, one.born) if one.born else "–"
    cells = (law_words(one), one.sources, _share(one.born, one.packings), strain, at_limit, mobilisation,
             f"{one.pairs:.3g}")  # fmt: skip
    return f"| {' | '.join(cells)} |\n"


def _share(count: int, total: int) -> str:
    low, high = share_interval(count, total)
    return f"{count} of {total} ({low:.2f}–{high:.2f})"


def rows(*words: str, smallest: bool = False):
    """Write the results in a sweep folder; only the table for the smallest size."""
    if smallest:
        yield table(births_by_law(read_births()))
        return
    if len(words) != 1:
        sys.exit("give the folder of the sweep, as in python -m benchmarks pairs_by_law results/pairs, or --draw")
    if words[0] != "--draw":
        collect(Path(words[0]))
    draw()
    yield table(births_by_law(read_births()))
