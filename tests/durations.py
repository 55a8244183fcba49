"""Durations of tests: `make durations` measures them, stores them in durations.json, and prints the slowest.

Processor time includes that of child processes that have ended, and is stored in seconds of a reference machine, to
which a fixed workload compares this machine. Files start in the order of their stored durations,
longest first, so that no worker is left with a long file at the end. `--shard 3/8` runs the third of eight parts of
about equal duration, which together contain all tests; `make slow` stores the durations of its part. Parts follow from
the durations stored at the last commit, so that the parts of one series fit together.
"""

import argparse
import json
import os
import shutil
import subprocess
import time
from collections import Counter, defaultdict
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest

STORE = Path(__file__).with_name("durations.json")
LEAST, SHOWN = 0.2, 10  # shortest test stored individually [s], and number of tests printed per folder
_SPENT = pytest.StashKey[float]()
KINDS = "seconds", "slow"
WORKLOAD = 0.021  # processor time of `slowness` on the reference machine, on which the suite has a limit [s]
UNKNOWN = 1.0  # assumed duration of a test if no test has been measured [s]


def slowness() -> float:
    """Processor time of a fixed workload, Python with small arrays as in most tests, over that of the reference.

    WORKLOAD is not measured there: it follows from the durations of 18 unchanged files of tests, which another machine
    stored 2.1 times as short as one on which the workload takes 0.045 s.
    """
    spent = []
    for _ in range(7):
        start, values = time.process_time(), np.ones((30, 3))
        for k in range(10_000):
            values = np.sqrt(values + values[k % 30])
        spent.append(time.process_time() - start)
    return min(spent) / WORKLOAD


def shard(text: str) -> tuple[int, int]:
    """Number of a part, and number of all parts."""
    part, of, parts = text.partition("/")
    if not (of and part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"{text!r} is no shard: the third of eight is 3/8")
    return int(part), int(parts)


def pytest_addoption(parser):
    parser.addoption("--store-durations", action="store_true", help="store the processor time of every test")
    parser.addoption("--fastest-first", action="store_true", help="run the fastest tests first")
    parser.addoption("--shard", type=shard, help="run one of several parts of the tests, for example 3/8")


def _kind(config) -> str:
    return "slow" if config.option.markexpr == "slow" else "seconds"


def stored(kind: str = "seconds") -> dict[str, float]:
    """Processor time of all tests or of slow tests, and of the remaining tests of each file together [s]."""
    return json.loads(STORE.read_text()).get(kind, {}) if STORE.exists() else {}


def committed(kind: str) -> dict[str, float]:
    """Durations at the last commit, or those stored now if there is no repository [s]."""
    call = ["git", "show", f"HEAD:./{STORE.name}"]
    done = subprocess.run(call, cwd=STORE.parent, capture_output=True, text=True) if shutil.which("git") else None
    return json.loads(done.stdout).get(kind, {}) if done and not done.returncode else stored(kind)


def expected(names: list[str], durations: dict[str, float]) -> list[float]:
    """Duration of each test [s]; unstored tests share the rest of their file, or have the mean duration."""
    rest = Counter(name.partition("::")[0] for name in names if name not in durations)
    measured = [seconds for name, seconds in durations.items() if "::" in name]
    usual = sum(measured) / len(measured) if measured else UNKNOWN
    spent = []
    for name in names:
        file = name.partition("::")[0]
        spent.append(durations[name] if name in durations else durations.get(file, usual * rest[file]) / rest[file])
    return spent


def cut(names: list[str], durations: dict[str, float], parts: int) -> list[int]:
    """Part of each test, from 0; parts are contiguous and take about the same time."""
    spent = expected(names, durations)
    ends = list(accumulate(spent))
    return [min(parts - 1, int((end - own / 2) / ends[-1] * parts)) for end, own in zip(ends, spent, strict=True)]


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Sort files by stored durations, and keep one shard of the tests left by markers."""
    durations = (committed if config.option.shard else stored)(_kind(config))
    files = defaultdict(float)
    for name, seconds in durations.items():
        files[name.partition("::")[0]] += seconds
    items.sort(key=lambda item: -files[item.nodeid.partition("::")[0]])
    if config.option.fastest_first:
        spent = expected([item.nodeid for item in items], durations)
        items[:] = [items[k] for k in sorted(range(len(items)), key=spent.__getitem__)]
    if config.option.shard and items:
        part, parts = config.option.shard
        chosen = [k == part - 1 for k in cut([item.nodeid for item in items], durations, parts)]
        config.hook.pytest_deselected(items=[item for item, kept in zip(items, chosen, strict=True) if not kept])
        items[:] = [item for item, kept in zip(items, chosen, strict=True) if kept]


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
        config.pluginmanager.register(_Store(_kind(config), config.option.shard))


class _Store:
    """Collects the reports of all workers."""

    def __init__(self, kind, shard):
        self.kind, self.shard, self.seconds = kind, shard, defaultdict(float)

    def _is_kept(self, name):
        """Return True if a duration is kept, as its file was not run or belongs to another shard."""
        file = name.partition("::")[0]
        ran = {ran.partition("::")[0] for ran in self.seconds}
        return (STORE.parents[1] / file).exists() and (
            file not in ran or (bool(self.shard) and name not in self.seconds)
        )

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] += dict(report.user_properties).get("processor", 0.0)

    def pytest_sessionfinish(self):
        values = {kind: stored(kind) for kind in KINDS}
        kept = {name: seconds for name, seconds in values[self.kind].items() if self._is_kept(name)}
        slow = slowness()
        for name, seconds in ((name, seconds / slow) for name, seconds in self.seconds.items()):
            entry = name if seconds >= LEAST or self.kind == "slow" else name.partition("::")[0]
            kept[entry] = kept.get(entry, 0.0) + seconds
        values[self.kind] = {name: round(seconds, 2) for name, seconds in sorted(kept.items())}
        STORE.write_text(json.dumps({"unit": "s of processor time of the reference machine"} | values, indent=1) + "\n")

    def pytest_terminal_summary(self, terminalreporter):
        folders = defaultdict(list)
        for name, seconds in self.seconds.items():
            folders[name.partition("::")[0].rpartition("/")[0]].append((seconds, name))
        for folder, tests in sorted(folders.items(), key=lambda pair: -sum(s for s, _ in pair[1])):
            total = sum(seconds for seconds, _ in tests)
            terminalreporter.section(f"{folder}: {total:.0f} s of processor time, {len(tests)} tests")
            for seconds, name in sorted(tests, reverse=True)[:SHOWN]:
                terminalreporter.line(f"{seconds:7.2f}  {name.removeprefix(folder + '/')}")
