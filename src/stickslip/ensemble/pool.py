"""Independent runs, in local processes or on a Dask cluster; failures are reported and do not affect other runs."""

import pickle
import sys
from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from operator import attrgetter
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any, NamedTuple, Protocol, runtime_checkable

from ..core.arguments import checked
from ..core.progress import Report, available_cores
from ..core.readable import readable
from . import worker
from .worker import SchedulerGoneError, describe_error


@runtime_checkable
class DaskClient(Protocol):
    """A `distributed.Client`, which only `cluster` imports."""

    scheduler: Any

    def nthreads(self) -> dict:
        """Threads of each worker."""


# number of local processes, or a Dask scheduler's address or client; None: one process per core
Workers = int | str | None | DaskClient


@readable
class Member(NamedTuple):
    """Outcome of one run: its result, or the error message if it failed."""

    result: Any
    failure: str | None


def default_workers() -> int:
    """Number of cores that this process may use."""
    return available_cores()


@readable
class Spread(NamedTuple):
    """Resources over which runs are distributed."""

    slots: int  # number of simultaneous runs
    words: str


@checked
def reach(workers: Workers) -> Spread:
    """Check that the requested workers are available, and describe them.

    Raises
    ------
    ValueError
        If the number is below 1, or no Dask scheduler answers at the address.
    """
    if workers is None or isinstance(workers, int):
        number = default_workers() if workers is None else workers
        if number < 1:
            raise ValueError(f"workers must be at least 1, got {number}")
        return Spread(number, f"{number} process{'es' if number > 1 else ''}")
    from . import cluster

    with cluster.connect(workers) as client:
        slots = sum(client.nthreads().values())
        now = f"{slots or 'no'} slot{'' if slots == 1 else 's'} now"
        return Spread(slots, f"the Dask cluster at {client.scheduler.address}, {now}")


def _describe(member: Member) -> str:
    return member.failure or "done"


@checked
def run_members(
    function: Callable,
    tasks: Iterable[tuple],
    *,
    workers: Workers = None,
    stage: str = "members",
    report: Report | None = None,
    describe: Callable[[Member], str] = _describe,
    load: Callable[[int], Any] | None = None,
    save: Callable[[int, Any], None] | None = None,
    together: bool = False,
) -> list[Member]:
    """Call `function(*task)` for every task and return the outcomes in order; results do not depend on `workers`.

    If a process dies, only its own member is affected: it is retried once (on a cluster, as often as the scheduler
    allows) and then reported as failed. The others continue.

    Parameters
    ----------
    function : importable by name, so that other processes find it; with `report`, its last argument is a function by
    which it reports its own progress in the same way
    workers : number of processes, each on one core, or 1 to run everything in this process; or the address of a Dask
        scheduler, such as "tcp://host:8786" (or its JSON file, or a `distributed.Client`)
    stage : name of the work, for `report`
    report : called as report(stage, share done, text) with the number of finished members, and a message from one of
    them
    describe : outcome of a member in a few words, for `report`
    load : load(k) returns the result of task k if it has already finished, else None; finished tasks are not run again
    save : called as save(k, result) in this process, as soon as task k has finished
    together : run all tasks at once, each in a thread of this process, for tasks that wait for each other

    Raises
    ------
    ValueError
        If `function` is defined in a script or notebook and more than one process is requested.
    RuntimeError
        If the scheduler of a cluster disappears; the message gives the number of unfinished members.

    Examples
    --------
    >>> [member.result for member in run_members(divmod, [(7, 2), (9, 4)], workers=1)]
    [(3, 1), (2, 1)]
    """
    tasks = list(tasks)
    results = [load(k) if load else None for k in range(len(tasks))]
    members = [None if result is None else Member(result, None) for result in results]
    missing = {k: task for k, task in enumerate(tasks) if members[k] is None}
    done, failed, shares = len(tasks) - len(missing), 0, dict.fromkeys(missing, 0.0)
    share_done = float(done)  # of all members, in members

    def keep(k: int, member: Member) -> None:
        nonlocal done, failed
        members[k], done, failed = member, done + 1, failed + bool(member.failure)
        if save and member.failure is None:
            save(k, member.result)
        heard(k, "", 1.0, describe(member))

    def heard(k: int, part: str, share: float, text: str) -> None:
        nonlocal share_done
        share_done, shares[k] = share_done + share - shares[k], share
        if report:
            count = f"{done} of {len(tasks)}" + (f", {failed} failed" if failed else "")
            report(stage, share_done / len(tasks), f"{count}; {part}: {text}" if part else f"{count}; {text}")

    if missing:
        try:
            run = _run_together if together else partial(_run_tasks, workers=workers)
            run(function, missing, keep=keep, heard=heard if report else None)
        except SchedulerGoneError as problem:
            raise RuntimeError(f"{problem}; {members.count(None)} of {len(tasks)} members did not finish") from None
    return members


@checked
def trial(function: Callable, task: tuple, seconds: float) -> Member | None:
    """Call a function with the arguments `task` in a local process with a time limit [s]; None on timeout."""
    answer = worker.trial(pickle.dumps((function, task), protocol=5), seconds)
    return answer and _unpack_result(*answer)


def _run_together(function, tasks: dict[int, tuple], keep, heard) -> None:
    """Run all tasks at once in threads, which do not keep this process from ending."""
    lock, ended = Lock(), SimpleQueue()

    def tell(*said) -> None:
        with lock:
            heard(*said)

    def run(k: int, task: tuple) -> None:
        ended.put((k, _attempt(function, k, task, tell if heard else None)))

    for started in tasks.items():
        Thread(target=run, args=started, daemon=True).start()
    for _ in tasks:
        finished = ended.get()
        with lock:
            keep(*finished)


def _attempt(function, k: int, task: tuple, heard) -> Member:
    """Run a task in this process."""
    try:
        return Member(function(*task, *((partial(heard, k),) if heard else ())), None)
    except Exception as problem:
        return Member(None, describe_error(problem))


def _run_tasks(function, tasks: dict[int, tuple], workers: Workers, keep, heard) -> None:
    """Run the tasks in this process, in local processes or on a cluster."""

    def unpack(k: int, *answer) -> None:
        keep(k, _unpack_result(*answer))

    if workers is not None and not isinstance(workers, int):
        from . import cluster

        return cluster.run_tasks(_pack_tasks(function, tasks), workers, unpack, heard)
    workers = min(reach(workers).slots, len(tasks))
    if workers > 1:
        own = (getattr(function, "__module__", None) or "").startswith("stickslip.")
        return worker.run_tasks(_pack_tasks(function, tasks), workers, unpack, heard, own=own)
    for k, task in tasks.items():
        keep(k, _attempt(function, k, task, heard))
    return None


def _pack_tasks(function, tasks: dict[int, tuple]):
    """Yield (k, bytes of a task), each on demand."""
    function = _importable(function)
    for k, task in tasks.items():
        yield k, pickle.dumps((function, task), protocol=5)


def _importable(function: Callable) -> Callable:
    """Return the same function from a module that other processes can import."""
    if getattr(function, "__module__", None) != "__main__":
        return function
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is None:
        raise ValueError(
            f"{function.__qualname__} is defined in a script or notebook, where worker processes cannot import it: "
            f"move it to a separate module, run the script with python -m, or use workers=1"
        )
    return attrgetter(function.__qualname__)(import_module(spec.name))


def _unpack_result(packed: bytes | None, failure: str | None) -> Member:
    try:
        return Member(None, failure) if packed is None else Member(pickle.loads(packed), None)
    except Exception as problem:
        return Member(None, f"its result cannot be read here ({describe_error(problem)})")
