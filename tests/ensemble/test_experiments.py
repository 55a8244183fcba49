"""Every experiment can be swept: its members leave numbers with units, and its realizations run on a cluster."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.experiments.sweep.dataset import open_sweep
from stickslip.experiments.sweep.run import run_sweep
from tests.unit.test_flow import flow
from tests.unit.test_measures import UNITS

FLOW = {k: v for k, v in flow().items() if k != "experiment"}
GOUGE = {
    "grains": {"number": 70}, "cell": {"length": 0.016, "width": 0.016}, "dt": 2e-7,
    "law": {"gamma_n": 1e4},
    "preparation": {"slip": 0.4, "window": 0.2, "change": 1.0, "approach": 10.0, "unbalanced": 0.03},
    "sample_every": 100, "ledger_steps": 0, "realizations": 1,
    "protocol": [
        {
            "kind": "slide-hold-slide", "before": [0.3], "holds": [2e-4, 1e-4], "after": [0.3], "approach": 0.1,
            "slip": 0.1, "twin": 0.0,
        },
    ],
}  # fmt: skip
SHEAR = {
    "packings": 1, "packing": {"grains": 30}, "shear": {"strain": [0.0, 1e-4], "step": 5e-5},
    "release": {"duration": 100.0},
}  # fmt: skip
DISKS = {"array": {"disks": 3}, "load": {"push": [0.0, 0.02], "step": 5e-3},
         "dynamics": {"loads": [0.02], "duration": 600.0},
         "sliding": {"loads": [0.02], "realizations": 2, "duration": 600.0}}  # fmt: skip
QUASI = {
    "samples": 1,
    "disks": {"number": 40},
    "loading": {"test": "shear", "ratio": 0.02, "increment": 0.25},
    "dynamics": {"times": []},
}
TINY = {
    "disk-array": (DISKS, {"law.mu": [10.0]}, "largest_growth_rate", "1/time"),
    "sphere-shear": (SHEAR, {"law.mu": [10.0]}, "coordination", "1"),
    "quasi-rigid": (QUASI, {"law.mu": [0.5]}, "stress_ratio", "1"),
    "flow": (FLOW, {"grains.number": [40]}, "deposit_top", "length"),
    "gouge": (GOUGE, {"law.mu": [0.5]}, "steady_friction@0.3", "1"),
    "rate-state": ({}, {"surface.law": ["slip"]}, "critical_stiffness", "1/m"),
}


def test_all_experiments_are_here():
    assert set(TINY) == set(EXPERIMENTS)


@pytest.mark.parametrize(
    "experiment", [pytest.param(name, marks=[pytest.mark.slow] * (name == "quasi-rigid")) for name in TINY]
)
def test_a_member_leaves_numbers_with_units(experiment, tmp_path):
    tables, table, name, unit = TINY[experiment]
    swept = run_sweep(ss.sweep(experiment=experiment, **tables, sweep=table), tmp_path, workers=1)
    assert swept.failures == [""]
    found = open_sweep(tmp_path)
    assert found[name].attrs["units"] == unit
    assert np.isfinite(found[name].values).all()
    left = {key.partition("@")[0]: found[key].attrs["units"] for key in found if "units" in found[key].attrs}
    assert left.pop("seconds") == "s"
    assert left.items() <= UNITS[experiment].items()


@pytest.mark.slow
def test_realizations_of_papers_are_the_same_on_a_cluster(cluster):
    disks = ss.scenario(**DISKS)
    here, there = (ss.simulate(disks, workers=workers).sliding[0.02] for workers in (1, cluster.address))
    np.testing.assert_array_equal(here.velocity, there.velocity)
    np.testing.assert_array_equal(here.center, there.center)
    packings = ss.scenario(experiment="sphere-shear", **SHEAR | {"packings": 2})
    here, there = (
        ss.experiments.sphere_shear.simulate_shear(packings, workers=workers) for workers in (2, cluster.address)
    )
    for a, b in zip(here.paths, there.paths, strict=True):
        np.testing.assert_array_equal(a.growth_rate, b.growth_rate)
        np.testing.assert_array_equal(a.last.grains.position, b.last.grains.position)
    gouge = ss.scenario(experiment="gouge", **GOUGE | {"realizations": 2})
    here, there = (ss.experiments.gouge.simulate_gouge(gouge, workers=workers) for workers in (2, cluster.address))
    for a, b in zip(here.realizations, there.realizations, strict=True):
        np.testing.assert_array_equal(a.tests[0].series.friction, b.tests[0].series.friction)
