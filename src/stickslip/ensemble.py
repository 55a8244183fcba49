"""Many independent runs in local processes; one that fails is reported and the rest kept."""

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, NamedTuple


class Member(NamedTuple):
    """What became of one run: its result, or the sentence of its failure."""

    result: Any
    failure: str | None


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_members(
    function: Callable, tasks: Iterable[tuple], *, workers: int | None = None, report=None, live=None
) -> list[Member]:
    """function(*task) for every task, in order; the number of processes does not change the results.

    Parameters
    ----------
    function : importable by name, so that other processes find it; with `live` it is called with a last argument
        `tell`, to be called as tell(share of this task done, words) as it goes
    workers : number of processes, each of them on one core; 1 runs everything here
    report : called as report(number done, number of tasks, member)
    live : called as live(share of all tasks done, words) with what the tasks tell
    """
    tasks = list(tasks)
    workers = min(workers or default_workers(), max(1, len(tasks)))
    members: list[Member | None] = [None] * len(tasks)
    shares = [0.0] * len(tasks)

    def keep(index, attempt):
        try:
            members[index] = Member(attempt(), None)
        except Exception as problem:
            members[index] = Member(None, f"{type(problem).__name__}: {problem}")
        shares[index] = 1.0
        if report:
            report(sum(m is not None for m in members), len(tasks), members[index])

    def heard(index, share, words):
        shares[index] = share
        live(sum(shares) / len(tasks), words)

    if workers == 1:
        for index, task in enumerate(tasks):
            more = (partial(heard, index),) if live else ()
            keep(index, lambda task=task, more=more: function(*task, *more))
        return members
    context = multiprocessing.get_context("spawn")
    with ExitStack() as stack:
        stack.enter_context(_one_core_each())
        pool = stack.enter_context(ProcessPoolExecutor(workers, mp_context=context))
        said = stack.enter_context(context.Manager()).Queue() if live else None
        more = [(partial(_tell, said, k),) if live else () for k in range(len(tasks))]
        futures = {pool.submit(function, *task, *more[k]): k for k, task in enumerate(tasks)}
        waiting = set(futures)
        while waiting:
            done, waiting = wait(waiting, timeout=0.3 if live else None, return_when=FIRST_COMPLETED)
            while live and not said.empty():
                heard(*said.get())
            for future in done:
                keep(futures[future], future.result)
    return members


def _tell(queue, index: int, share: float, words: str) -> None:
    queue.put((index, share, words))


@contextmanager
def _one_core_each():
    """Processes started in here use one thread in BLAS and in Numba: the cores are shared out already."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
