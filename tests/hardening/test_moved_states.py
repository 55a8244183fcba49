"""Measures of contacts are those of the positions of the state, or they are refused."""

import numpy as np
import pytest

import stickslip as ss

LAW = ss.laws.hertz_mindlin()


@pytest.fixture(scope="module")
def packing():
    return ss.packings.jammed(60, packing_fraction=0.9, dim=2, seed=3)[0]


MEASURES = {
    "touching": ss.measure.touching,
    "contact_numbers": ss.measure.contact_numbers,
    "coordination": ss.measure.coordination,
    "rattlers": ss.measure.rattlers,
    "fabric": ss.measure.fabric,
    "backbone": lambda state: ss.modes.backbone(state, LAW),
    "figure": ss.figures.packing,
    "likely_causes": lambda state: ss.measure.likely_causes(state, LAW),
    "stress": lambda state: ss.measure.stress(state, LAW),
    "contact_forces": lambda state: ss.measure.contact_forces(state, LAW),
    "frame": lambda state: ss.io.frame_of(state, LAW),
}


@pytest.mark.parametrize("name", MEASURES)
def test_contacts_of_other_positions_are_refused(packing, name):
    measure = MEASURES[name]
    measure(packing)
    for slip in (True, False):
        with pytest.raises(ValueError, match=r"accept\(state, trial\) first"):
            measure(ss.packings.strained(packing, 0.2 * np.eye(2), slip=slip))
    committed = ss.packings.strained(packing, 0.2 * np.eye(2), slip=False)
    measure(ss.accept(committed, ss.forces(committed, LAW)[1]))


COUNTING = ["touching", "contact_numbers", "coordination", "rattlers", "fabric", "backbone", "figure"]


@pytest.mark.parametrize("name", COUNTING)
def test_moves_within_the_skin_that_open_or_close_contacts_are_refused(packing, name):
    """Moves of a tenth of the skin: the list is valid, but some contacts open and others close."""
    rng = np.random.default_rng(0)
    step = rng.normal(0, 0.1 * packing.contacts.skin, (60, 3)) * [1, 1, 0]
    stirred = packing._replace(grains=packing.grains._replace(position=packing.grains.position + step))
    with pytest.raises(ValueError, match=r"(closed|opened), of .* accept\(state, trial\) first"):
        MEASURES[name](stirred)


def test_moves_that_change_no_contact_are_measured(packing):
    rng = np.random.default_rng(0)
    step = rng.normal(0, 1e-9, (60, 3)) * [1, 1, 0]
    nearby = packing._replace(grains=packing.grains._replace(position=packing.grains.position + step))
    assert ss.measure.coordination(nearby) == ss.measure.coordination(packing)
    assert np.allclose(ss.measure.fabric(nearby), ss.measure.fabric(packing), atol=1e-7)  # directions turn by 1e-9/R


def test_a_state_that_was_never_evaluated_is_refused():
    pair = ss.assembly(ss.spheres([[0, 0, 0], [0.99, 0, 0]], 0.5))
    with pytest.raises(ValueError, match=r"accept\(state, trial\) first"):
        ss.measure.coordination(pair)
    assert ss.measure.coordination(ss.accept(pair, ss.forces(pair, LAW)[1]), least=1) == 1.0
