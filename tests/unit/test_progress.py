"""Progress: every public function that tells it does so to one kind of callable, and refuses another in a sentence."""

import importlib
import inspect
import pkgutil

import pytest

import stickslip as ss
from stickslip.core.progress import Report, silent, within


def functions_with_report():
    """All public functions of the package that take `report`."""
    for module in pkgutil.walk_packages(ss.__path__, "stickslip."):
        if "_core" in module.name or module.name.endswith("__main__"):
            continue
        for name, function in inspect.getmembers(importlib.import_module(module.name), inspect.isfunction):
            own = function.__module__ == module.name and not name.startswith("_")
            if own and "report" in inspect.signature(function).parameters:
                yield f"{module.name}.{name}", inspect.signature(function).parameters["report"].annotation


def test_all_functions_tell_progress_to_one_kind_of_callable():
    annotations = dict(functions_with_report())
    assert len(annotations) > 30
    assert {name for name, kind in annotations.items() if kind not in (Report, Report | None)} == set()


@pytest.mark.parametrize("report", [lambda share, words: None, lambda: None, lambda a, b, c, d: None])
def test_a_function_of_other_arguments_is_refused_before_anything_runs(report):
    with pytest.raises(ValueError, match=r"report was given a function .* called as report\(stage, share done, text\)"):
        ss.packings.compressed(30, mu=0.5, pressure=1e-3, dim=2, report=report)
    with pytest.raises(TypeError, match="report must be a function"):
        ss.packings.compressed(30, mu=0.5, pressure=1e-3, dim=2, report="report")


@pytest.mark.parametrize("report", [print, silent, lambda *told: None, lambda stage, share, text, left=None: None])
def test_whatever_takes_three_arguments_is_accepted(report):
    ss.packings.compressed(10, mu=0.5, pressure=1e-2, dim=2, report=report)


def test_a_part_tells_its_share_of_the_whole():
    told = []
    part = within(within(lambda *now: told.append(now), 0.5, 1.0, stage="all"), 0.0, 0.5, prefix="sample 3: ")
    part("shear", 0.5, "2 pairs")
    assert told == [("all", 0.625, "2 pairs")]
