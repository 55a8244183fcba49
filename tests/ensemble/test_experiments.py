"""Every experiment can be swept: its members leave numbers with units, and its realizations run on a cluster."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.units import in_units
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.runs.sweep.dataset import open_sweep
from stickslip.runs.sweep.run import run_sweep
from tests import measures
from tests.restart.test_resume import FEWER


@pytest.mark.parametrize(
    "experiment",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("quasi-rigid", "gouge", "cyclic-shear")))
        for name in EXPERIMENTS
    ],
)
def test_a_member_leaves_numbers_with_units(experiment, tmp_path):
    tables = EXPERIMENTS[experiment].smallest[0] | FEWER.get(experiment, {})
    table, name, unit = measures.tested(experiment).SWEPT
    swept = run_sweep(ss.sweep(experiment=experiment, **tables, sweep=table), tmp_path, workers=1)
    assert swept.failures == [""]
    found = open_sweep(tmp_path)
    assert found[name].attrs["units"] == unit
    assert np.isfinite(found[name].values).all()
    left = {key.partition("@")[0]: found[key].attrs["units"] for key in found if "units" in found[key].attrs}
    assert left.pop("seconds") == "s"
    units = ss.scenario(experiment=experiment, **tables).named_units
    wanted = measures.units(experiment)
    assert left.items() <= {name: in_units(unit, units) for name, unit in wanted.items()}.items()


@pytest.mark.slow
def test_realizations_of_papers_are_the_same_on_a_cluster(cluster):
    disks = ss.scenario(**EXPERIMENTS["disk-array"].smallest[0])
    here, there = (ss.simulate(disks, workers=workers).sliding[0.02] for workers in (1, cluster.address))
    np.testing.assert_array_equal(here.velocity, there.velocity)
    np.testing.assert_array_equal(here.center, there.center)
    packings = ss.scenario(experiment="sphere-shear", **EXPERIMENTS["sphere-shear"].smallest[0] | {"packings": 2})
    here, there = (
        ss.experiments.sphere_shear.simulate_shear(packings, workers=workers) for workers in (2, cluster.address)
    )
    for a, b in zip(here.paths, there.paths, strict=True):
        np.testing.assert_array_equal(a.growth_rate, b.growth_rate)
        np.testing.assert_array_equal(a.last.grains.position, b.last.grains.position)
    gouge = ss.scenario(experiment="gouge", **EXPERIMENTS["gouge"].smallest[0] | {"realizations": 2})
    here, there = (ss.experiments.gouge.simulate_gouge(gouge, workers=workers) for workers in (2, cluster.address))
    for a, b in zip(here.realizations, there.realizations, strict=True):
        np.testing.assert_array_equal(a.tests[0].series.friction, b.tests[0].series.friction)
