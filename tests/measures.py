"""Measures of experiments, each described in a module of its own, `tests/wings/WING/test_measures_of_PACKAGE.py`.

Its `MEANT` has the names of all measures by their dimensions, without what stands behind an @, and `SWEPT` a swept key.
"""

from importlib import import_module

import pytest

from stickslip.core import arguments
from stickslip.experiments.registry import EXPERIMENTS, meaning_of

LENGTH, TIME, VELOCITY, RATE, RATE_SQUARED, PER_LENGTH, FORCE, ENERGY, STRESS, LINE_ENERGY, NUMBER = range(11)
WRITTEN = {  # as dimensions, and in SI
    LENGTH: ("length", "m"), TIME: ("time", "s"), VELOCITY: ("length/time", "m/s"), FORCE: ("force", "N"),
    ENERGY: ("energy", "J"), STRESS: ("force/length^(dim-1)", "Pa"), RATE: ("1/time", "1/s"),
    RATE_SQUARED: ("1/time^2", "1/s^2"), LINE_ENERGY: ("energy/length", "J/m"), NUMBER: ("1", "1"),
}  # fmt: skip


def both(names: str) -> str:
    """Names of measures and of their errors."""
    return " ".join(f"{name} {name}_error" for name in names.split())


WORDS = WRITTEN | {"load": ("load",) * 2, "angle": ("degrees",) * 2, PER_LENGTH: ("1/length", "1/m")}


def tested(experiment: str):
    """Module that tests the measures of an experiment."""
    wing, entry = EXPERIMENTS.entries()[experiment]
    return import_module(f"tests.wings.{wing.package.rpartition('.')[2]}.test_measures_of_{entry.package}")


def units(experiment: str) -> dict[str, str]:
    """Units of all measures of an experiment; "load" is the scenario's `load.unit`."""
    si = EXPERIMENTS[experiment].scenario.si
    return {name: WORDS[kind][si] for kind, names in tested(experiment).MEANT.items() for name in names.split()}


def check(experiment: str, result, values: dict[str, float], monkeypatch) -> None:
    """Check measures: every branch is taken, so that the tables have all that a run can leave, and nothing else."""
    monkeypatch.setattr(arguments._door, "passed", True, raising=False)  # results that only look like them
    measured = EXPERIMENTS[experiment].measures(result)
    assert {name.partition("@")[0]: unit for name, (_, unit) in measured.items()} == units(experiment)
    assert {name: measured[name][0] for name in values} == {name: pytest.approx(v) for name, v in values.items()}
    assert all(meaning_of(EXPERIMENTS[experiment], name) for name in measured)
