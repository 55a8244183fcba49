"""Durations of tests: `make durations` measures them, stores them in durations.json, and prints the slowest.

Seconds of processor time include those of child processes that have ended. Files start in the order of their stored
durations, the longest first, so that no worker is left with a long one at the end.
"""

import json
import os
from collections import defaultdict
from pathlib import Path

import pytest

STORE = Path(__file__).with_name("durations.json")
LEAST, SHOWN = 0.2, 10  # shortest test that is stored on its own [s], and number of tests printed for each folder
_SPENT = pytest.StashKey[float]()


def pytest_addoption(parser):
    parser.addoption("--store-durations", action="store_true", help="store the processor time of every test")


def stored() -> dict[str, float]:
    """Processor time of tests, and of the remaining tests of each file together [s]."""
    return json.loads(STORE.read_text())["seconds"] if STORE.exists() else {}


def pytest_collection_modifyitems(items):
    """Sort files by their stored durations."""
    files = defaultdict(float)
    for name, seconds in stored().items():
        files[name.partition("::")[0]] += seconds
    items.sort(key=lambda item: -files[item.nodeid.partition("::")[0]])


def _timed(item):
    before = sum(os.times()[:4])
    try:
        return (yield)
    finally:
        item.stash[_SPENT] = sum(os.times()[:4]) - before


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    return (yield from _timed(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    return (yield from _timed(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item):
    return (yield from _timed(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    report.user_properties.append(("processor", item.stash.get(_SPENT, 0.0)))
    return report


def pytest_configure(config):
    if config.getoption("--store-durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Store())


class _Store:
    """Collect the reports of all workers."""

    def __init__(self):
        self.seconds = defaultdict(float)

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] += dict(report.user_properties).get("processor", 0.0)

    def pytest_sessionfinish(self):
        kept = defaultdict(float)
        for name, seconds in self.seconds.items():
            kept[name if seconds >= LEAST else name.partition("::")[0]] += seconds
        rounded = {name: round(seconds, 2) for name, seconds in sorted(kept.items())}
        STORE.write_text(json.dumps({"unit": "s of processor time", "seconds": rounded}, indent=1) + "\n")

    def pytest_terminal_summary(self, terminalreporter):
        folders = defaultdict(list)
        for name, seconds in self.seconds.items():
            folders[name.partition("::")[0].rpartition("/")[0]].append((seconds, name))
        for folder, tests in sorted(folders.items(), key=lambda pair: -sum(s for s, _ in pair[1])):
            total = sum(seconds for seconds, _ in tests)
            terminalreporter.section(f"{folder}: {total:.0f} s of processor time, {len(tests)} tests")
            for seconds, name in sorted(tests, reverse=True)[:SHOWN]:
                terminalreporter.line(f"{seconds:7.2f}  {name.removeprefix(folder + '/')}")
