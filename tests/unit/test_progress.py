"""Progress: every public function that tells it does so to one kind of callable, and refuses another in a sentence."""

import importlib
import inspect
import pkgutil
from io import StringIO

import pytest

import stickslip as ss
from stickslip.core.progress import Report, announced, silent, within
from stickslip.reports import terminal
from stickslip.reports.terminal import console_output


def functions_with_report():
    """All public functions of the package that take `report`."""
    for module in pkgutil.walk_packages(ss.__path__, "stickslip."):
        if "_core" in module.name or module.name.endswith("__main__"):
            continue
        try:
            found = dict(vars(importlib.import_module(module.name)))
        except ModuleNotFoundError as problem:
            assert problem.name.startswith("stickslip.wings.")  # hidden, see tests/hidden.py
            continue
        for name, function in found.items():
            own = inspect.isfunction(function) and function.__module__ == module.name and not name.startswith("_")
            if own and "report" in inspect.signature(function).parameters:
                yield f"{module.name}.{name}", inspect.signature(function).parameters["report"].annotation


def test_all_functions_tell_progress_to_one_kind_of_callable():
    annotations = dict(functions_with_report())
    assert len(annotations) > 30
    assert {name for name, kind in annotations.items() if kind not in (Report, Report | None)} == set()


@pytest.mark.parametrize("report", [lambda share, words: None, lambda: None, lambda a, b, c, d: None])
def test_a_function_of_other_arguments_is_refused_before_anything_runs(report):
    with pytest.raises(
        ValueError, match=r"report has the wrong arguments: it is called as report\(stage, share done, text\)"
    ):
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


class Terminal(StringIO):
    """Standard error of a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("stream, options, words", [
    (Terminal, {}, "compiling a user's law: normal_force …"),
    (StringIO, {}, ""),
    (Terminal, {"quiet": True}, ""),
    (Terminal, {"as_json": True}, ""),
])  # fmt: skip
def test_the_compilation_of_a_law_is_shown_on_a_terminal(stream, options, words, monkeypatch):
    scale = 1.0 + 0.1 * len(words) + len(options) + 0.01 * (stream is StringIO) + 0.001 * ("quiet" in options)
    law = ss.laws.custom(normal_force=lambda overlap, kn: scale * kn * overlap)  # a law of its own for each case
    monkeypatch.setattr("sys.stderr", said := stream())
    monkeypatch.setenv("TERM", "xterm")
    with console_output(**options):
        ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    shown = said.getvalue()
    assert shown.startswith(words) and (shown.endswith("\r\x1b[K") if words else not shown)


def test_the_compilation_of_a_law_is_a_line_of_the_stages_that_are_shown(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(terminal, "console", terminal._Console(file=screen, force_terminal=True, width=100))
    with terminal.progress(transient=True) as tell:
        tell("packing", 0.5, "")
        with announced("compiling mine: cap"):
            terminal.console.file.flush()
    assert "compiling mine: cap" in screen.getvalue()
