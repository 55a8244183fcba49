"""Many independent runs in local processes; one that fails is reported and the rest kept."""

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple


class Member(NamedTuple):
    """What became of one run: its result, or the sentence of its failure."""

    result: Any
    failure: str | None


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_members(function: Callable, tasks: Iterable[tuple], *, workers: int | None = None, report=None) -> list[Member]:
    """function(*task) for every task, in order; the number of processes does not change the results.

    Parameters
    ----------
    function : importable by name, so that other processes find it
    workers : number of processes; 1 runs everything here
    report : called as report(number done, number of tasks, member)
    """
    tasks = list(tasks)
    workers = min(workers or default_workers(), max(1, len(tasks)))
    members: list[Member | None] = [None] * len(tasks)

    def keep(index, attempt, done):
        try:
            members[index] = Member(attempt(), None)
        except Exception as problem:
            members[index] = Member(None, f"{type(problem).__name__}: {problem}")
        if report:
            report(done, len(tasks), members[index])

    if workers == 1:
        for index, task in enumerate(tasks):
            keep(index, lambda task=task: function(*task), index + 1)
        return members
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(function, *task): index for index, task in enumerate(tasks)}
        for done, future in enumerate(as_completed(futures), 1):
            keep(futures[future], future.result, done)
    return members
