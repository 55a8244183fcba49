"""Measures of `experiment = "catalogue"`: names, units and values."""

from types import SimpleNamespace as Made

from tests.events.made import samples
from tests.measures import NUMBER, check

MEANT = {
    NUMBER: "events packings events_per_strain share_saddle_node share_pair share_sliding share_opening "
    "share_breaking share_unstable share_unresolved saddle_node_exponent stress_drop_over_pressure "
    "jump_over_diameter auc_softest auc_nonaffine_rate auc_growth auc_tangent_modulus auc_switch auc_loss_ahead"
}
SWEPT = ({"law.mu": [0.5]}, "events", "1")  # a swept key, and a measure with its unit


def announced():
    """Four packings with five events each, and a switch test that announces all of them."""
    shear = Made(window=4e-4, step=4e-4)
    packings = samples(4, 5)
    strain = 4 * 56 * 4e-4
    return Made(samples=packings, number=20, scenario=Made(shear=shear)), {
        "events": 20, "packings": 4, "events_per_strain": 20 / strain, "saddle_node_exponent": 0.5,
        "share_pair": 2 / 20, "share_breaking": 4 / 20, "auc_switch": 1.0,
    }  # fmt: skip


def test_measures_have_their_values_and_units(monkeypatch):
    check("catalogue", *announced(), monkeypatch)
