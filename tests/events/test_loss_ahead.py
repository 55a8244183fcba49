"""Contacts that will be lost, predicted from one state, against the events that are found later."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.event_class import loss_ahead
from stickslip.loading.event_path import Judge, Point


@pytest.fixture(scope="module")
def found():
    """Disks with the linear law and sharp friction, whose events are mostly contacts that start to slide."""
    law = ss.laws.linear(mu=10.0, coulomb="sharp")
    state, _ = ss.packings.jammed(50, packing_fraction=0.845, dim=2, law=law, seed=0)
    drag = 0.1 * 2 / ss.measure.stable_time_step(state, law)
    return ss.protocols.find_events(state, law, to=0.012, drag=drag)


@pytest.mark.slow
def test_slides_come_where_they_were_announced(found):
    """From the beginning of the strain step of each slide, the strain to it is predicted to a twentieth of a step."""
    slides = [event for event in found.events if event.kind is ss.results.EventKind.SLIDING]
    assert slides
    for event in slides:
        row = np.searchsorted(found.steps.strain, event.strain) - 1
        announced = found.steps.strain[row] + found.steps.loss_ahead[row]
        assert announced == pytest.approx(event.strain, abs=0.05 * found.step)


def test_without_friction_nothing_slides():
    """Without friction contacts are lost by opening only; with large overlaps, no loss is near."""
    law = ss.laws.linear(mu=0.0)
    state, _ = ss.packings.jammed(20, packing_fraction=0.95, dim=2, law=law, seed=3)
    point = Point(0.0, state, Judge(state, law, 0.1))
    ahead = loss_ahead(point, 4e-4)
    assert ahead > 4e-3  # overlaps are large
    assert not len(point.response.sticking(5))
