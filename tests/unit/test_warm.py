"""`stickslip warm` compiles kernels ahead of their use, once, and every experiment has runs for it."""

import json
import os
import subprocess
import sys

import pytest

from stickslip.doctor import warm
from stickslip.experiments.registry import EXPERIMENTS, scenario
from tests.conftest import stickslip_here


def test_kernels_are_compiled_once(tmp_path):
    command = [sys.executable, "-m", "stickslip", "warm", "rate-state", "--json"]
    away = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    away["XDG_CACHE_HOME"] = str(tmp_path)
    first, again = (json.loads(subprocess.run(command, capture_output=True, env=away).stdout) for _ in range(2))
    assert first["new_files"] > 0 and again["new_files"] == 0
    assert first["kernels"] == str(tmp_path / "stickslip")


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["gouje"], "name 'gouje' is not known: use stability, disk-array, sphere-shear, quasi-rigid, flow, gouge, "
                    "rate-state, fault, threshold, catalogue; did you mean 'gouge'?"),
        (["gouge", "--all"], "--all was given with names: give one or the other"),
    ],
)  # fmt: skip
def test_wrong_words_are_refused(words, sentence):
    run = stickslip_here("warm", *words)
    assert (run.returncode, run.stderr) == (2, f"stickslip: {sentence}\n")


def test_a_run_that_fails_is_reported(monkeypatch):
    monkeypatch.setitem(EXPERIMENTS, "rate-state", EXPERIMENTS["rate-state"]._replace(smallest=({"seed": "no"},)))
    said = []
    failures = warm.compile_kernels(["rate-state"], workers=1, report=lambda *words: said.append(words))
    assert len(failures) == 1 and failures[0].startswith("rate-state: ") and "seed" in failures[0]
    assert said[0] == ("kernels", 0.0, "rate-state")


def test_every_experiment_has_a_smallest_run():
    for name, experiment in EXPERIMENTS.items():
        assert experiment.smallest, name
        for tables in experiment.smallest:
            scenario(experiment=name, **tables)
