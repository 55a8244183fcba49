"""Durations of tests: shards are everything, each test once, and take about the same time; long tests have a reason."""

import json
import re

import pytest

from tests import durations, mutants
from tests.durations import cut, shard
from tests.rooms import ROOT


def test_shards_are_contiguous_and_balanced():
    names = [f"tests/test_{file}.py::test_{k}" for file in "abc" for k in range(20)]
    # nothing is known about c, where a test is taken to last the 30 s of the one that was measured
    durations = {names[3]: 30.0, "tests/test_a.py": 19.0, "tests/test_b.py": 60.0}
    parts = cut(names, durations, 4)
    assert parts == sorted(parts)
    assert set(parts) == {0, 1, 2, 3}
    spent = [durations.get(name, {"a": 1.0, "b": 3.0, "c": 30.0}[name[11]]) for name in names]
    totals = [sum(s for s, part in zip(spent, parts, strict=True) if part == k) for k in range(4)]
    assert max(totals) <= sum(totals) / 4 + 30 / 2


@pytest.mark.parametrize("text", ["9/8", "0/8", "3", "3/", "a/8", "-1/8"])
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(Exception, match="the third of eight is 3/8"):
        shard(text)


def test_durations_of_shards_replace_their_own_and_keep_all_others(tmp_path, monkeypatch):
    """Slow tests are stored one by one, so that a test that was never measured is not taken for a short one."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").touch()
    monkeypatch.setattr(durations, "STORE", tmp_path / "tests" / "durations.json")
    monkeypatch.setattr(durations, "slowness", lambda: 2.0)
    for values in ({"test_1": 90.0, "test_2": 0.1}, {"test_1": 80.0}):
        store = durations._Store("slow", (1, 2))
        store.seconds.update({f"tests/test_a.py::{name}": seconds for name, seconds in values.items()})
        store.pytest_sessionfinish()
    assert json.loads(durations.STORE.read_text())["slow"] == {
        "tests/test_a.py::test_1": 40.0,
        "tests/test_a.py::test_2": 0.05,
    }  # fmt: skip  (in seconds of the reference machine)
    assert durations.expected(["tests/test_b.py::test_3"], durations.stored("slow")) == [pytest.approx(20.025)]


MOST = 3.0  # seconds that a test may take without a reason


def test_every_test_that_takes_long_states_a_reason():
    """A comment above its `def`, such as `# 4 s: the emulator is compiled`."""
    silent = []
    for name, seconds in durations.stored().items():
        path, _, test = name.partition("::")
        if seconds <= MOST or not test or not (ROOT / path).exists():
            continue
        text = (ROOT / path).read_text(encoding="utf-8").split(f"\ndef {test.partition('[')[0]}(")
        if len(text) == 2 and not re.search(r"^# \d+ s: \w.{9,}$", text[0].rpartition("\n\n")[2], re.MULTILINE):
            silent.append(name)
    assert not silent


def test_every_stored_fault_applies_to_one_line():
    for fault in mutants.read():
        fault.line(ROOT)
