"""Reference catalogue of events: at least 1,000 events of several contact laws, in two and three dimensions.

    python -m benchmarks catalogue FOLDER               # runs all unfinished parts: several core-hours, one process
    python -m benchmarks catalogue FOLDER sharp-0.5 …   # only these laws, or gouge; others may run at the same time
    python -m benchmarks catalogue FOLDER --draw        # only tables and figures, from finished parts
    python -m benchmarks catalogue --estimate           # recomputes classes and exponents from stored eigenvalues

Every law is run in parts, each in a separate folder. A stopped run resumes with the packing at which it was stopped.
Tables, figures and the summary of `docs/catalogue.md` are written to `docs/reference/catalogue`.
"""

import re
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.experiments import EXPERIMENTS
from stickslip.loading.event_class import fit_power, vanishes
from stickslip.loading.events import FINER
from stickslip.runs.folder import write_result
from stickslip.wings.studies.catalogue import figures as figures
from stickslip.wings.studies.catalogue.simulate import (
    PREDICTORS,
    Skill,
    Table,
    class_counts,
    law_label,
    read_table,
    rows_of,
    skills,
    stack_tables,
    write_table,
)

from .pictures import save_picture, shrink
from .records import write_block

OUT = Path(__file__).parents[1] / "docs/reference/catalogue"
PAGE = Path(__file__).parents[1] / "docs/catalogue.md"
MARK = "<!-- written by python -m benchmarks catalogue -->\n"
GOUGE = Path(__file__).parents[1] / "examples/gouge_stick_slip.toml"
DISKS, SPHERES = {"grains": 50, "dim": 2, "packing_fraction": 0.845}, {"grains": 40, "dim": 3, "packing_fraction": 0.66}
SHEAR = {"drag": 0.1, "step": 4e-4, "resolution": 1e-6, "window": 4e-4}
APART = 10_000  # distance between the seeds of two parts

PICTURES = {
    "eigenvalue": "Square of the smallest eigenvalue before saddle nodes, and that across contacts that slide",
    "classes": "Classes of events by contact law",
    "drops": "Distributions of stress drops and jumps",
    "roc": "ROC curves of the predictors, by contact law",
    "roc_later": "ROC curves of laws that were run later, with more packings",
}


class Run(NamedTuple):
    """One law: its tables, the number of parts, and the number of events per part."""

    packing: dict
    law: dict
    parts: int
    events: int = 25
    strain: float = 0.1  # largest strain of every packing
    packings: int = 1000  # largest number of packings of a part

    def scenario(self, part: int):
        """Scenario of one part."""
        shear = SHEAR | {"strain": self.strain}
        size = {"events": self.events, "packings": self.packings, "seed": APART * part}
        return ss.scenario(experiment="catalogue", packing=self.packing, law=self.law, shear=shear, **size)


RUNS = {  # with moderate friction, the first events come late
    "frictionless": Run(DISKS | {"packing_fraction": 0.88}, {"mu": 0.0}, 30),
    "linear-sharp-10": Run(DISKS, {"kind": "linear", "coulomb": "sharp", "mu": 10.0}, 16),
    "smooth-10": Run(DISKS, {"coulomb": "smooth", "mu": 10.0}, 24, strain=0.02),  # many events of a packing are alike
    "sharp-0.5": Run(DISKS, {"coulomb": "sharp", "mu": 0.5}, 4, strain=0.4),
    "smooth-0.5": Run(DISKS, {"coulomb": "smooth", "mu": 0.5}, 10, strain=0.4),  # a packing may have 25 events
    "spheres-smooth-0.5": Run(SPHERES, {"coulomb": "smooth", "mu": 0.5}, 10, 20, strain=0.2, packings=2),  # few events
    "spheres-sharp-0.5": Run(SPHERES, {"coulomb": "sharp", "mu": 0.5}, 1, 20),
}


def compute(folder: Path, names: list[str]) -> None:
    """Run unfinished parts: the first part of every law before the second parts, spheres last."""
    parts = [
        (run.packing["dim"], part, name) for name, run in RUNS.items() if name in names for part in range(run.parts)
    ]
    for _, part, name in sorted(parts, key=lambda one: one[:2]):
        place = folder / f"{name}-{part}"
        if not (place / "events.csv").is_file():
            chosen = RUNS[name].scenario(part)
            result = ss.simulate(chosen, folder=place, workers=1, report=_say(f"{name}, part {part}"))
            write_result(place, EXPERIMENTS["catalogue"], result)
    if "gouge" in names and not (folder / "gouge" / "slips.csv").is_file():
        chosen = ss.experiments.registry.read_scenario(GOUGE)
        found = ss.simulate(chosen, folder=folder / "gouge", workers=1, report=_say("gouge"))
        write_result(folder / "gouge", EXPERIMENTS["gouge"], found)


def _say(name: str):
    return lambda stage, share, text: print(f"{name}: {text}", flush=True)


def gathered(folder: Path) -> tuple[dict[str, Table], dict[str, Table]]:
    """Return events and steps of every law, from the finished parts."""
    events, steps = {}, {}
    for name, run in RUNS.items():
        places = [folder / f"{name}-{part}" for part in range(run.parts)]
        done = [place for place in places if (place / "events.csv").is_file()]
        if done:
            label = law_label(run.scenario(0))
            events[label] = stack_tables([(place.name, read_table(place / "events.csv")) for place in done], "part")
            steps[label] = stack_tables([(place.name, read_table(place / "steps.csv")) for place in done], "part")
    return events, steps


def stored(laws, out: Path = OUT) -> dict[str, Table]:
    """Return the stored events of all laws other than the given ones, by label."""
    if not (out / "events.csv").is_file():
        return {}
    table, fresh = read_table(out / "events.csv"), {_plain(law) for law in laws}
    return {
        label: {name: column for name, column in rows_of(table, table["law"] == _plain(label)).items() if name != "law"}
        for label in _labels()
        if _plain(label) not in fresh and (table["law"] == _plain(label)).any()
    }


def write_reference(folder: Path, out: Path = OUT) -> None:
    """Write tables, figures and summary of finished runs; laws that are not in the folder keep their results."""
    events, steps = gathered(folder)
    out.mkdir(parents=True, exist_ok=True)
    found = {law: skills(steps[law], events[law], SHEAR["window"]) for law in events}
    kept, bare = stored(events, out), {law: _without(table, "part") for law, table in events.items()}
    every = {label: (bare | kept)[label] for label in _labels() if label in bare or label in kept}
    whole = stack_tables([(_plain(law), table) for law, table in every.items()], "law")
    write_table(out / "events.csv", whole, digits=7)
    _write_skills(out / "skill.csv", found, kept)
    _draw_events(whole, every, out)
    curves = [[one for one in found[law] if np.isfinite(one.roc.area)] for law in found]
    save_picture(figures.roc_curves(curves, list(found)), out / ("roc_later.png" if kept else "roc.png"))
    for name, target in (("slips.csv", "slips.csv"), ("fig8_slips.png", "slips.png")):
        if (folder / "gouge" / name).is_file():
            (shrink if name.endswith(".png") else shutil.copy)(folder / "gouge" / name, out / target)
    if out == OUT:
        _fill_page(summary(every, steps, found))


def estimate_again(out: Path = OUT) -> None:
    """Recompute classes and exponents of saddle nodes from stored eigenvalues; margins of pairs are not stored.

    An event that is no longer a saddle node becomes unresolved, because the states needed to find the responsible
    contact are not stored.
    """
    events = read_table(out / "events.csv")
    for row in np.flatnonzero(np.isin(events["kind"], ["saddle_node", "sliding", "opening", "unresolved"])):
        known = np.isfinite(events["softest"][row])
        width = (events["strain"][row] - events["below"][row]) / FINER
        found = fit_power(events["distances"][row, known], events["softest"][row, known], width)
        if vanishes(*found):
            events["kind"][row], events["exponent"][row], events["exponent_error"][row] = "saddle_node", *found
        elif events["kind"][row] == "saddle_node":
            events["kind"][row], events["exponent"][row], events["exponent_error"][row] = "unresolved", np.nan, np.nan
    write_table(out / "events.csv", events, digits=7)
    page, tables = PAGE.read_text(encoding="utf-8"), {}
    for law in dict.fromkeys(law_label(run.scenario(0)) for run in RUNS.values()):
        if (rows := events["law"] == _plain(law)).any():
            tables[law] = table = rows_of(events, rows)
            cells = rf"(\| {_plain(law)}(?: \|[^|]*){{3}}) \|(?:[^|]*\|){{{len(class_counts(table)) + 1}}}"
            page = re.sub(cells, rf"\1 | {_classes_and_exponent(table)} |", page, count=1)
    PAGE.write_text(page, encoding="utf-8")
    _draw_events(events, tables, out)


def _draw_events(whole: Table, every: dict[str, Table], out: Path) -> None:
    """Draw the figures for which all data are stored."""
    save_picture(figures.eigenvalue_before_events(whole), out / "eigenvalue.png")
    save_picture(figures.classes({law: class_counts(table) for law, table in every.items()}), out / "classes.png")
    save_picture(figures.drops(every), out / "drops.png")


def _labels() -> list[str]:
    """Labels of all laws."""
    return list(dict.fromkeys(law_label(run.scenario(0)) for run in RUNS.values()))


def _without(table: Table, name: str) -> Table:
    return {key: column for key, column in table.items() if key != name}


def _page_rows(law: str) -> list[str]:
    """Rows of a law in the page's tables of classes and of areas."""
    text = PAGE.read_text(encoding="utf-8").partition(MARK)[2]
    return [line for line in text.split("\n") if line.startswith(f"| {_plain(law)} |")]


def _fill_page(text: str) -> None:
    """Replace the tables in the documentation."""
    write_block(PAGE, "catalogue", text)


def _plain(label: str) -> str:
    """Label of a law without figure markup and commas."""
    return label.replace("$\\mu$", "μ").replace(",", "")


def _write_skills(path: Path, found: dict[str, list[Skill]], kept) -> None:
    names = tuple(f"{_plain(law)}," for law in kept)
    old = path.read_text(encoding="utf-8").split("\n")[1:] if names else []
    lines = ["law,predictor,area,low,high,steps,followed,packings", *(line for line in old if line.startswith(names))]
    for law, several in found.items():
        lines += [
            f"{_plain(law)},{s.predictor},{s.roc.area:.4f},{s.low:.4f},{s.high:.4f},{s.steps},{s.followed},{s.packings}"
            for s in several
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def summary(events: dict[str, Table], steps: dict[str, Table], found: dict[str, list[Skill]]) -> str:
    """Tables of the page, in Markdown."""
    total = sum(len(table["strain"]) for table in events.values())
    rows = [_row_of_classes(law, t, steps[law]) if law in found else _page_rows(law)[0] for law, t in events.items()]
    areas = [_row_of_areas(law, found[law]) if law in found else _page_rows(law)[1] for law in events]
    return "\n".join(
        [
            f"The table classifies {total} events. It gives the number of events in each class, the median exponent p "
            f"of λ ∝ (γ_c − γ)^p at saddle nodes with quartiles, and the median stress drop over pressure:",
            "",
            "| law | packings | strain | events | real λ → 0 | pair | slides | opens | was unstable | unresolved "
            "| exponent | drop |",
            "|---|" + "---|" * 11,
            *rows,
            "",
            "The next table gives the area under the ROC curve for an event within a strain of "
            f"{SHEAR['window']:g}, with 95 % intervals from resampled packings:",
            "",
            "| law | smallest λ | \\|dq/dγ\\| | growth rate | tangent modulus | switch test | loss ahead |",
            "|---|" + "---|" * len(PREDICTORS),
            *areas,
            "",
            _published(found),
            "",
            *(
                f"![{words}](reference/catalogue/{name}.png)\n"
                for name, words in PICTURES.items()
                if (OUT / f"{name}.png").is_file()
            ),
        ]
    )


def _row_of_classes(law: str, table: Table, steps: Table) -> str:
    paths = [steps["strain"][steps["sample"] == one] for one in np.unique(steps["sample"])]
    strain = sum(path[-1] + path[1] - path[0] for path in paths)
    return (
        f"| {_plain(law)} | {len(np.unique(steps['sample']))} | {strain:.3g} | {len(table['strain'])} | "
        f"{_classes_and_exponent(table)} | {np.nanmedian(table['stress_drop']):.2g} |"
    )


def _classes_and_exponent(table: Table) -> str:
    """Cells with the number of events in each class, and the median exponent at saddle nodes with its quartiles."""
    exponents = table["exponent"][table["kind"] == "saddle_node"]
    low, middle, high = np.quantile(exponents, [0.25, 0.5, 0.75]) if len(exponents) else [np.nan] * 3
    cells = [*map(str, class_counts(table).values()), f"{middle:.3f} ({low:.2f}–{high:.2f})" if len(exponents) else "–"]
    return " | ".join(cells)


def _row_of_areas(law: str, several: list[Skill]) -> str:
    cells = {
        one.predictor: f"{one.roc.area:.2f}" + (f" ({one.low:.2f}–{one.high:.2f})" if np.isfinite(one.low) else "")
        for one in several
    }
    return f"| {_plain(law)} | " + " | ".join(cells.get(name, "–") for name in PREDICTORS) + " |"


def _published(found: dict[str, list[Skill]]) -> str:
    """Sentence about the published statement that eigenvalues do not predict stress drops."""
    law = next((law for law in found if law.startswith("linear, sharp")), None)
    if law is None:  # keep the sentence of the page
        lines = PAGE.read_text(encoding="utf-8").split("\n")
        return next((line for line in lines if line.startswith("Ishima et al.")), "")
    by = {one.predictor: one for one in found[law]}
    flat, switch, rate, loss = (by[name] for name in ("softest", "switch", "nonaffine_rate", "loss_ahead"))
    inside = "contains" if flat.low <= 0.5 <= flat.high else "does not contain"
    return (
        "Ishima et al. (arXiv:2212.04628) report that eigenvalues of frictional packings with a harmonic potential do "
        f"not predict stress drops. With the linear sharp law the area of the smallest λ is {_area(flat)}; this "
        f"interval {inside} 1/2. The area is {_area(loss)} for the predictor loss ahead, {_area(rate)} for |dq/dγ|, "
        f"and {_area(switch)} for the switch test."
    )


def _area(one: Skill) -> str:
    return f"{one.roc.area:.3f} ({one.low:.3f} to {one.high:.3f})"


def rows(*words: str, smallest: bool = False):
    """Compute, or only draw, and write the reference; the smallest size summarises the stored tables."""
    if smallest:
        yield from (f"{law}: {class_counts(table)}" for law, table in stored(()).items())
    elif words == ("--estimate",):
        estimate_again()
    elif not words:
        sys.exit("give the folder of the runs, as in python -m benchmarks catalogue results/catalogue")
    elif unknown := set(words[1:]) - {*RUNS, "gouge", "--draw"}:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}; use {', '.join(RUNS)}, gouge or --draw")
    else:
        if "--draw" not in words:
            compute(Path(words[0]), list(words[1:]) or [*RUNS, "gouge"])
        write_reference(Path(words[0]))
    yield "Written: docs/reference/catalogue" if not smallest else ""
