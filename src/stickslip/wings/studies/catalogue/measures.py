"""Measures of an event catalogue: rates, shares of the classes, exponents, drops, and skill of the predictors."""

import numpy as np

from ....results import EventKind
from .predictors import PREDICTORS, Skill, skills
from .simulate import CatalogueResult
from .tables import Table, event_table, step_table

KINDS = tuple(kind.name.lower() for kind in EventKind)


def class_counts(events: Table) -> dict[str, int]:
    """Number of events of each class."""
    return {kind: int((events["kind"] == kind).sum()) for kind in KINDS}


def strain_searched(result: CatalogueResult) -> float:
    """Total strain over which events were searched for."""
    steps = [sample.found.steps.strain for sample in result.samples]
    return float(sum(strain[-1] + result.scenario.shear.step for strain in steps if len(strain)))


def predictor_skills(result: CatalogueResult, **options) -> list[Skill]:
    """Skill of every predictor, see `skills`."""
    return skills(step_table(result.samples), event_table(result.samples), result.scenario.shear.window, **options)


def measures(result: CatalogueResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}; NaN where there are no such events."""
    events, strain = event_table(result.samples), strain_searched(result)
    number, saddles = result.number, events["kind"] == "saddle_node"
    out = {
        "events": (float(number), "1"),
        "packings": (float(len(result.samples)), "1"),
        "events_per_strain": (number / strain if strain else np.nan, "1"),
        **{f"share_{k}": (n / number if number else np.nan, "1") for k, n in class_counts(events).items()},
        "saddle_node_exponent": (_median(events["exponent"][saddles]), "1"),
        "stress_drop_over_pressure": (_median(events["stress_drop"]), "1"),
        "jump_over_diameter": (_median(events["jump"]), "1"),
    }
    areas = {skill.predictor: skill.roc.area for skill in predictor_skills(result, resamples=0)}
    return out | {f"auc_{name}": (areas.get(name, np.nan), "1") for name in PREDICTORS}


def _median(values: np.ndarray) -> float:
    """Median of the finite values; NaN without any."""
    good = values[np.isfinite(values)]
    return float(np.median(good)) if len(good) else np.nan
