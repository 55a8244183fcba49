"""Measures of an event catalogue, its tables, figures, archive and terminal summary."""

from functools import partial

import numpy as np

from ....kit import Measures, Quantity, archive_fields, console, median, new_table, pluralize, show_table
from ....results import EventKind
from . import figures as figures_of
from .simulate import CatalogueResult
from .tables import PREDICTORS, Skill, Table, event_table, skills, step_table, write_table

KINDS = tuple(kind.name.lower() for kind in EventKind)


def class_counts(events: Table) -> dict[str, int]:
    """Number of events of each class."""
    return {kind: int((events["kind"] == kind).sum()) for kind in KINDS}


def strain_searched(result: CatalogueResult) -> float:
    """Total strain searched for events."""
    steps = [sample.found.steps.strain for sample in result.samples]
    return float(sum(strain[-1] + result.scenario.shear.step for strain in steps if len(strain)))


def predictor_skills(result: CatalogueResult, **options) -> list[Skill]:
    """Skill of every predictor (see `skills`)."""
    return skills(step_table(result.samples), event_table(result.samples), result.scenario.shear.window, **options)


def _share(kind: str) -> Quantity:
    return Quantity(f"share_{kind}", "1", f"fraction of events of this class: {EventKind[kind.upper()].value}",
                    lambda c: class_counts(c.events)[kind] / c.number if c.number else np.nan)  # fmt: skip


class Catalogue:
    """Events of a run and their number, to which `MEASURES` apply."""

    def __init__(self, result: CatalogueResult):
        self.result, self.number, self.events = result, result.number, event_table(result.samples)
        self.areas = {skill.predictor: skill.roc.area for skill in predictor_skills(result, resamples=0)}
        self.strain = strain_searched(result)


MEASURES = Measures([
    Quantity("events", "1", "number of events", lambda c: float(c.number)),
    Quantity("packings", "1", "number of packings", lambda c: float(len(c.result.samples))),
    Quantity("events_per_strain", "1", "events for each unit of strain",
             lambda c: c.number / c.strain if c.strain else np.nan),
    *map(_share, KINDS),
    Quantity("saddle_node_exponent", "1", "exponent of the smallest eigenvalue before saddle nodes, median",
             lambda c: median(c.events["exponent"][c.events["kind"] == "saddle_node"])),
    Quantity("stress_drop_over_pressure", "1", "drop of the shear stress over the pressure, median",
             lambda c: median(c.events["stress_drop"])),
    Quantity("jump_over_diameter", "1", "jump of the grains over their diameter, median",
             lambda c: median(c.events["jump"])),
    *(Quantity(f"auc_{name}", "1", f"area under the ROC curve of a predictor: {words}",
               lambda c, name=name: c.areas.get(name, np.nan)) for name, (_, words) in PREDICTORS.items()),
], subject=Catalogue)  # fmt: skip


def law_label(scenario) -> str:
    """Short description of a scenario's law."""
    law = scenario.law
    if law.file is not None:
        return "law from a file"
    name = {"hertz_mindlin": "Hertz", "linear": "linear"}[law.kind]
    friction = f"{law.coulomb}, $\\mu$ = {law.mu:g}" if law.mu else "no friction"
    return f"{name}, {friction}, {scenario.packing.dim}D"


def figures(result: CatalogueResult):
    """Yield (file name, Figure) for each figure of a run."""
    events, label = event_table(result.samples), law_label(result.scenario)
    if result.number:
        yield "fig1_eigenvalue.png", figures_of.eigenvalue_before_events(events)
        yield "fig2_classes.png", figures_of.classes({label: class_counts(events)})
        yield "fig3_drops.png", figures_of.drops({label: events})
    skills = [skill for skill in predictor_skills(result) if np.isfinite(skill.roc.area)]
    if skills:
        yield "fig4_roc.png", figures_of.roc_curves(skills, (label,))


def files(result: CatalogueResult):
    """Yield (file name, function that writes it) for the tables of events and of strain steps."""
    yield "events.csv", partial(write_table, table=event_table(result.samples))
    yield "steps.csv", partial(write_table, table=step_table(result.samples))


def numbers(result: CatalogueResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    return {
        "scenario": result.scenario.text,
        "law": result.law,
        "units": "those of the scenario: force, length, mass",
        "events": event_table(result.samples),
        "steps": step_table(result.samples),
        "packings": {f"{sample.seed:04d}": archive_fields(sample.packed) for sample in result.samples},
        "ends": {f"{sample.seed:04d}": sample.found.state for sample in result.samples},
        "failures": "\n".join(result.failures),
    }


def show(result: CatalogueResult) -> None:
    """Print the classes of the events and the skill of the predictors."""
    values = MEASURES(result)
    console.print(
        f"{pluralize(result.number, 'event')} in {pluralize(len(result.samples), 'packing')}, "
        f"{values['events_per_strain'][0]:.3g} for each unit of strain; drag {result.scenario.shear.drag:g} of the "
        f"highest frequency."
    )
    table = new_table("class", "number", title="Events", left=("class",))
    for kind, number in class_counts(event_table(result.samples)).items():
        table.add_row(EventKind[kind.upper()].value, str(number))
    show_table(table)
    title = f"Announcements of an event within a strain of {result.scenario.shear.window:g}"
    table = new_table("predictor", "area under ROC", "95 % interval", "steps", title=title, left=("predictor",))
    for skill in predictor_skills(result):
        interval = f"{skill.low:.3f} to {skill.high:.3f}" if np.isfinite(skill.low) else "–"
        area = f"{skill.roc.area:.3f}" if np.isfinite(skill.roc.area) else "–"
        table.add_row(PREDICTORS[skill.predictor][1], area, interval, str(skill.steps))
    show_table(table)
    for failure in result.failures:
        console.print(failure, style="yellow")
