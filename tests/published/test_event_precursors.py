"""What announces the events of frictional packings, against Ishima et al., arXiv:2212.04628.

Their disks have a harmonic potential and contacts that do not slide; eigenvalues show no precursors of stress drops.
Here the law is linear with sharp friction and μ = 10.
"""

import pytest

import stickslip as ss
from stickslip.wings.studies.catalogue.simulate import predictor_skills

SCENARIO = {
    "experiment": "catalogue", "events": 40, "packings": 20, "seed": 500,
    "packing": {"grains": 50, "dim": 2, "packing_fraction": 0.845},
    "law": {"kind": "linear", "coulomb": "sharp", "mu": 10.0},
    "shear": {"drag": 0.1, "strain": 0.03},
}  # fmt: skip


@pytest.mark.slow
def test_eigenvalues_do_not_announce_events_but_the_next_loss_of_a_contact_does():
    values = {skill.predictor: skill for skill in predictor_skills(ss.simulate(ss.scenario(**SCENARIO), workers=1))}
    flat, loss = values["softest"], values["loss_ahead"]
    assert flat.followed >= 30 and flat.packings >= 3
    assert loss.low > 0.5 and loss.low > flat.high  # the softest mode is hardly better than chance
    assert loss.roc.area > values["switch"].roc.area  # where the contact is on its way to the limit counts
