"""An experiment is one value: once it is in the list, `ss.simulate`, the command line, sweeps and `resume` know it."""

import json
import sys
from importlib import import_module
from typing import Literal, NamedTuple

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.data.checkpoint import checkpoint_in, load_or_compute
from stickslip.data.schema import NotNegative, ScenarioBase, Seed
from stickslip.experiments import EXPERIMENTS, Experiment


class Coins(ScenarioBase):
    """So many tosses of a coin."""

    experiment: Literal["coins"] = "coins"
    seed: Seed = 0
    bias: NotNegative = 0.5


class Tosses(NamedTuple):
    scenario: Coins
    heads: np.ndarray


CALLS = []


def simulate(scenario, *, folder=None, workers=None, report=lambda *now: None):
    kept = checkpoint_in(folder, scenario)
    heads = load_or_compute(kept, "tosses", lambda: np.random.default_rng(scenario.seed).random(100) < scenario.bias)
    CALLS.append(scenario.seed)
    if len(CALLS) == 1 and folder:
        raise KeyboardInterrupt
    return Tosses(scenario, np.asarray(heads))


@pytest.fixture(autouse=True)
def coins(monkeypatch):
    toy = Experiment(
        Coins, "tosses of a coin", simulate,
        numbers=lambda result: {"heads": result.heads.astype(float)},
        measures=lambda result: {"share": (result.heads.mean(), "1")},
        show=lambda result: print(f"{result.heads.sum()} heads"),
    )  # fmt: skip
    monkeypatch.setitem(EXPERIMENTS, toy.name, toy)
    CALLS[:] = [None]


def call(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["stickslip", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


def test_from_python():
    result = ss.simulate(ss.scenario(experiment="coins", bias=0.7))
    assert 0.5 < result.heads.mean() < 0.9


def test_from_the_command_line_and_after_it_was_stopped(tmp_path, monkeypatch, capsys):
    (tmp_path / "coins.toml").write_text('experiment = "coins"\nbias = 1.0\n')
    CALLS.clear()  # the first call is stopped by ctrl-C after its piece is saved
    assert call(monkeypatch, "run", tmp_path / "coins.toml", "--out", tmp_path / "out") == 130
    assert call(monkeypatch, "resume", tmp_path / "out") == 0
    assert "100 heads" in capsys.readouterr().out
    assert ss.io.open_dataset(tmp_path / "out")["numbers"].heads.sum() == 100
    assert call(monkeypatch, "cite", tmp_path / "coins.toml") == 0


def test_in_a_sweep(tmp_path):
    swept = ss.run_sweep(ss.sweep(experiment="coins", sweep={"bias": [0.0, 1.0]}), tmp_path, workers=1)
    assert swept.failures == ["", ""]
    assert list(ss.io.open_sweep(tmp_path).share.values) == [0.0, 1.0]
    assert json.loads((tmp_path / "sweep.json").read_text())["experiment"] == "coins"


def test_bad_keys_are_named():
    with pytest.raises(ss.experiments.ScenarioError, match="bias"):
        ss.scenario(experiment="coins", bias=-1)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_what_is_imported_late_is_there(name):
    first = EXPERIMENTS[name]
    for value in (*first, *(first.paper or ())):
        package, _, path = getattr(value, "__qualname__", "").rpartition(".experiments.")
        if package:
            module, _, function = path.rpartition(".")
            assert callable(getattr(import_module(f"{package}.experiments.{module}"), function)), path
