"""Output of an event catalogue: tables, figures, archive and terminal summary."""

from functools import partial

import numpy as np

from ....data.run_files import EVENTS, STEPS
from ....kit import archive_fields, console, new_table, pluralize, show_table
from ....results import EventKind
from . import figures as figures_of
from .measures import class_counts, measures, predictor_skills
from .simulate import CatalogueResult
from .tables import event_table, step_table, write_table

WORDS = {
    "softest": "smallest real eigenvalue",
    "nonaffine_rate": "|dq/dγ| of the non-affine motion",
    "growth": "growth rate of the fastest pair",
    "tangent_modulus": "tangent shear modulus",
    "switch": "switch test: smallest eigenvalue with one mobilised contact set to slide",
    "loss_ahead": "strain to the first loss of a contact that leaves an unstable state",
}


def law_label(scenario) -> str:
    """Name of the law of a scenario in a few words."""
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
    yield EVENTS, partial(write_table, table=event_table(result.samples))
    yield STEPS, partial(write_table, table=step_table(result.samples))


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
    values = measures(result)
    console.print(
        f"{pluralize(result.number, 'event')} in {pluralize(len(result.samples), 'packing')}, "
        f"{values['events_per_strain'][0]:.3g} for each unit of strain; drag {result.scenario.shear.drag:g} of the "
        f"highest frequency."
    )
    table = new_table("class", "number", title="Events", left=("class",))
    for kind, number in class_counts(event_table(result.samples)).items():
        table.add_row(EventKind[kind.upper()].value, str(number))
    show_table(table)
    _show_skills(result)
    for failure in result.failures:
        console.print(failure, style="yellow")


def _show_skills(result: CatalogueResult) -> None:
    title = f"Announcements of an event within a strain of {result.scenario.shear.window:g}"
    table = new_table("predictor", "area under ROC", "95 % interval", "steps", title=title, left=("predictor",))
    for skill in predictor_skills(result):
        interval = f"{skill.low:.3f} to {skill.high:.3f}" if np.isfinite(skill.low) else "–"
        area = f"{skill.roc.area:.3f}" if np.isfinite(skill.roc.area) else "–"
        table.add_row(WORDS[skill.predictor], area, interval, str(skill.steps))
    show_table(table)
