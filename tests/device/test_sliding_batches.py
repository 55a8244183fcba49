"""Realizations of sliding side by side on a device."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli.app import ProcessOptions
from stickslip.cli.running import _choose_processes
from stickslip.core.dynamics import device
from stickslip.core.dynamics.batch import Processor
from stickslip.experiments import realizations
from stickslip.experiments.realizations import Together
from stickslip.wings.papers.disk_array.simulate import simulate_disk_array


def scenario(**more):
    return ss.scenario(
        array={"disks": 4},
        load={"push": [0.0, 0.08], "step": 0.01},
        dynamics={"loads": [], "drag": 1e-4, "spin_drag": 2e-4, "seed_velocity": 3e-3},
        sliding={"loads": [0.08, 0.07], "realizations": 2, "duration": 150.0, "thresholds": [1e-3, 1e-2]},
        **more,
    )


def test_realizations_of_sliding_are_those_of_single_runs(monkeypatch, tmp_path):
    monkeypatch.setattr(device, "open_device", lambda name: Processor())
    monkeypatch.setattr(realizations, "MOST", 3)
    monkeypatch.setattr(Together, "SAMPLES", 17)
    mine = simulate_disk_array(scenario(), folder=tmp_path, device="cuda").sliding
    known = simulate_disk_array(scenario(), workers=1).sliding
    assert list(mine) == list(known) == [0.08, 0.07]
    assert np.isfinite(known[0.08].breach).any() and np.isfinite(known[0.08].slide).any()
    assert len(known[0.08].time) > 4 * Together.SAMPLES
    for load, ensemble in known.items():
        for name, values in ensemble._asdict().items():
            if name != "failures":
                scale = np.nanmax(np.abs(values), initial=1e-300)
                np.testing.assert_allclose(getattr(mine[load], name), values, rtol=0, atol=1e-6 * scale, err_msg=name)
        assert not mine[load].failures


def test_a_law_that_a_device_cannot_evaluate_is_refused(tmp_path):
    path = tmp_path / "law.py"
    path.write_text("def normal_force(overlap, kn):\n    return kn * overlap**2\n\n\ncheck = {'kn': 1.0}\n")
    law = {"file": str(path), "parameters": {"kn": 1.0, "mu": 0.5}}
    with pytest.raises(ValueError, match="a user-defined law"):
        simulate_disk_array(scenario(trust=True, law=law), device="cuda")


def test_a_run_shorter_than_a_step_slides_nowhere():
    short = scenario().model_copy(update={"sliding": scenario().sliding.model_copy(update={"duration": 0.01})})
    ensemble = simulate_disk_array(short, workers=1).sliding[0.08]
    assert not ensemble.failures and np.isnan(ensemble.velocity).all() and len(ensemble.time) == 1


def test_the_device_of_the_command_line_reaches_the_run(monkeypatch):
    monkeypatch.setattr(device, "open_device", lambda name: Processor())
    chosen = ProcessOptions(workers=1, device="cuda")
    assert _choose_processes(chosen, scenario()) == {"workers": 1, "device": "cuda"}
    assert _choose_processes(chosen._replace(device=None), scenario()) == {"workers": 1}
