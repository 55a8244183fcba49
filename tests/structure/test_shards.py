"""Shards of tests together are everything, each once, and take about the same time."""

import pytest

from tests.durations import cut, shard


def test_shards_are_contiguous_and_balanced():
    names = [f"tests/test_{file}.py::test_{k}" for file in "abc" for k in range(20)]
    durations = {names[3]: 30.0, "tests/test_a.py": 19.0, "tests/test_b.py": 60.0}  # nothing is known about c
    parts = cut(names, durations, 4)
    assert parts == sorted(parts)
    assert set(parts) == {0, 1, 2, 3}
    spent = [durations.get(name, {"a": 1.0, "b": 3.0, "c": 1.0}[name[11]]) for name in names]
    totals = [sum(s for s, part in zip(spent, parts, strict=True) if part == k) for k in range(4)]
    assert max(totals) <= sum(totals) / 4 + 30 / 2


@pytest.mark.parametrize("text", ["9/8", "0/8", "3", "3/", "a/8", "-1/8"])
def test_what_is_no_shard_is_refused(text):
    with pytest.raises(Exception, match="the third of eight is 3/8"):
        shard(text)
