"""Every benchmark runs at its smallest size; codes that are not installed are skipped by a line of text."""

import os
from pathlib import Path

import pytest

from benchmarks import BENCHMARKS
from benchmarks.__main__ import line, listing, main, rows
from benchmarks.records import ROOT, files_of, measured

# less than a second each
CHEAP = {"budgets", "device", "first_result", "inclusions", "lammps_ranks", "pairs_by_law", "rigid_clusters", "spheres"}


@pytest.mark.parametrize(
    "name", [name if name in CHEAP else pytest.param(name, marks=pytest.mark.slow) for name in BENCHMARKS]
)
def test_it_runs_at_its_smallest_size(name, monkeypatch):
    monkeypatch.chdir(ROOT)  # packings are kept in results
    monkeypatch.setenv("OMP_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1"))
    found = list(rows(name, smallest=True))
    assert found and all(isinstance(row, str) or (line(row) and measured(row)) for row in found)


def test_the_list_has_every_benchmark_and_their_rooms_exist():
    modules = {path.stem for path in Path(ROOT, "benchmarks").glob("*.py") if "\ndef rows(" in path.read_text()}
    assert {one.place.split(":")[0] or name for name, one in BENCHMARKS.items()} == modules - {"__main__"}
    assert all(files_of(room) for one in BENCHMARKS.values() for room in one.rooms)
    assert listing().row_count == len(BENCHMARKS)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("engin",), "there is no benchmark 'engin': use all, after_instability"),
        (("engine", "--store", "--smallest"), "numbers of the smallest size cannot be stored"),
    ],
)
def test_wrong_words_are_refused(words, message, monkeypatch):
    monkeypatch.setattr("sys.argv", ["benchmarks", *words])
    with pytest.raises(SystemExit, match=message):
        main()
