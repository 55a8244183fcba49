"""Common feature of unresolved events in frictionless packings, for `docs/catalogue.md`.

    python -m benchmarks unresolved_events        # 32 packings of the catalogue: a quarter of an hour, one process

For each event, the contact or gap nearest to touching in the last stable state is found. One of its grains may almost
float; it is then not among the grains whose eigenvalues count. The table of the page is written.
"""

from unittest.mock import patch

import numpy as np

import stickslip as ss
from stickslip.core.progress import silent
from stickslip.loading import events
from stickslip.loading.event_class import Break, EventKind
from stickslip.wings.studies.catalogue.simulate import shear_sample

from .catalogue import PAGE, RUNS
from .records import write_block

PACKINGS, PER_PART = 32, 4
NEAR = 1e-8  # distance from touching, in mean diameters, covered by the strain of the last bracket


def nearest(found: Break) -> tuple[float, bool]:
    """Distance from touching of the nearest contact or gap before an event, and True if one of its grains floats."""
    state, supported = found.last.state, found.last.response.support.grains
    contacts, overlap = state.contacts, ss.measure.overlaps(state)[: int(state.contacts.count[0])]
    row = int(np.argmin(np.abs(overlap)))
    return float(abs(overlap[row])), not (supported[contacts.i[row]] and supported[contacts.j[row]])


def collect(parts: int = PACKINGS // PER_PART, each: int = PER_PART) -> list[tuple[EventKind, float, bool]]:
    """Kind, distance and floating grain of every event of the packings."""
    rows, describe = [], events.describe

    def observe(found, step, bracket):
        event = describe(found, step, bracket)
        rows.append((event.kind, *nearest(found)))
        return event

    with patch.object(events, "describe", observe):
        for part in range(parts):
            scenario = RUNS["frictionless"].scenario(part)
            for seed in range(scenario.seed, scenario.seed + each):
                shear_sample(scenario, seed, silent)
    return rows


def table(rows: list[tuple[EventKind, float, bool]]) -> str:
    """Format the table for the documentation."""
    text = "| class | events | nearest contact or gap belongs to a nearly floating grain | and is within 1e-8 |\n"
    text += "|---|---|---|---|\n"
    for kind in dict.fromkeys(kind for kind, *_ in rows):
        mine = [(distance, floats) for one, distance, floats in rows if one is kind]
        near = sum(floats and distance < NEAR for distance, floats in mine)
        text += f"| `{kind.name.lower()}` | {len(mine)} | {sum(floats for _, floats in mine)} | {near} |\n"
    return text


def rows(*, smallest: bool = False):
    """Write and return the table of the page; the smallest size runs one packing and writes nothing."""
    if smallest:
        yield table(collect(1, 1))
        return
    found = table(collect())
    yield found
    write_block(PAGE, "unresolved_events", found)
