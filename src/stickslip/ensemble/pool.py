"""Independent runs, in local processes or on a Dask cluster; failures are reported and do not affect other runs.

No other module imports Dask. On a worker of the cluster every task runs in a separate process (`WorkerProcess`), so
that compiled kernels, which hold the interpreter's lock, do not block the worker's heartbeat to its scheduler.
"""

import json
import logging
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import islice
from operator import attrgetter
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any, NamedTuple, Protocol, runtime_checkable
from uuid import uuid4

from ..core.arguments import checked
from ..core.progress import Report, available_cores
from ..core.readable import readable
from ..extras import require
from . import worker


@runtime_checkable
class DaskClient(Protocol):
    """A `distributed.Client`."""

    scheduler: Any

    def nthreads(self) -> dict:
        """Number of threads of each worker."""


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
    with connect(workers) as client:
        slots = sum(client.nthreads().values())
        now = f"{slots or 'no'} slot{'' if slots == 1 else 's'} now"
        return Spread(slots, f"the Dask cluster at {client.scheduler.address}, {now}")


@checked
def run_members(
    function: Callable,
    tasks: Iterable[tuple],
    *,
    workers: Workers = None,
    stage: str = "members",
    report: Report | None = None,
    describe: Callable[[Member], str] = lambda member: member.failure or "done",
    load: Callable[[int], Any] | None = None,
    save: Callable[[int, Any], None] | None = None,
    together: bool = False,
) -> list[Member]:
    """Call `function(*task)` for every task and return the outcomes in order; results do not depend on `workers`.

    If a process dies, only its own member is affected: it is retried once (on a cluster, as often as the scheduler
    allows) and then reported as failed. The others continue.

    Parameters
    ----------
    function : importable by name, so that other processes find it; with `report`, its last argument is a function with
    which it reports its progress in the same way
    workers : number of processes, each on one core, or 1 to run everything in this process; or the address of a Dask
        scheduler, such as "tcp://host:8786" (or its JSON file, or a `distributed.Client`)
    stage : name of the work, for `report`
    report : called as report(stage, share done, text); the text contains the number of finished members and a message
    from one of them
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
    share_done = float(done)  # sum of the finished shares of all members

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
        except worker.SchedulerGoneError as problem:
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
        return Member(None, worker.describe_error(problem))


def _run_tasks(function, tasks: dict[int, tuple], workers: Workers, keep, heard) -> None:
    """Run the tasks in this process, in local processes or on a cluster."""

    def unpack(k: int, *answer) -> None:
        keep(k, _unpack_result(*answer))

    if workers is not None and not isinstance(workers, int):
        return _run_on_cluster(_pack_tasks(function, tasks), workers, unpack, heard)
    workers = min(reach(workers).slots, len(tasks))
    if workers > 1:
        own = (getattr(function, "__module__", None) or "").startswith("stickslip.")
        return worker.run_tasks(_pack_tasks(function, tasks), workers, unpack, heard, own=own)
    for k, task in tasks.items():
        keep(k, _attempt(function, k, task, heard))
    return None


def _pack_tasks(function, tasks: dict[int, tuple]):
    """Yield (k, bytes of a task) on demand; raise ValueError if other processes could not import the function."""
    if getattr(function, "__module__", None) == "__main__":
        spec = getattr(sys.modules["__main__"], "__spec__", None)
        if spec is None:
            raise ValueError(
                f"{function.__qualname__} is defined in a script or notebook, where worker processes cannot import it: "
                f"move it to a separate module, run the script with python -m, or use workers=1"
            )
        function = attrgetter(function.__qualname__)(import_module(spec.name))
    for k, task in tasks.items():
        yield k, pickle.dumps((function, task), protocol=5)


def _unpack_result(packed: bytes | None, failure: str | None) -> Member:
    try:
        return Member(None, failure) if packed is None else Member(pickle.loads(packed), None)
    except Exception as problem:
        return Member(None, f"its result cannot be read here ({worker.describe_error(problem)})")


PROTOCOLS = ("tcp", "tls", "ws", "wss", "ucx", "inproc")
PATIENCE = 10.0  # timeout for the scheduler's first answer [s]
PAUSE = 1.0  # shortest time between two messages of one task; a scheduler receives messages of many tasks [s]
POLL = 2.0  # time between two queries of the cluster [s]
AHEAD = 256  # smallest number of tasks kept waiting on the scheduler for a free worker


@contextmanager
def connect(address):
    """Yield a client of the scheduler at an address or in a JSON file; an existing client is yielded unchanged.

    Raises
    ------
    ValueError
        If Dask is not installed or no scheduler answers.
    """
    distributed = require("distributed", "cluster")
    if isinstance(address, distributed.Client):
        yield address
        return
    try:
        client = distributed.Client(_resolve_address(str(address)), timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError) as problem:
        said = " ".join(str(problem).split())[:150] or type(problem).__name__
        raise ValueError(
            f"no Dask scheduler answers at {address!r} ({said}): start one with `dask scheduler` and give its address, "
            "such as tcp://host:8786, or its JSON file"
        ) from None
    log = logging.getLogger("distributed.client")
    before, _ = log.level, log.setLevel(logging.CRITICAL)  # errors are reported in one sentence, without tracebacks
    try:
        with client:
            yield client
    finally:
        log.setLevel(before)


def _read_json(path: str, tries: int = 10):
    """Read a JSON file, with retries: a scheduler that has just started may not have finished writing it."""
    with open(path, encoding="utf-8-sig") as file:
        try:
            return json.load(file)
        except json.JSONDecodeError:
            if not tries:
                raise
    time.sleep(0.1)
    return _read_json(path, tries - 1)


def _resolve_address(address: str) -> str:
    """Return the address, or the one in a JSON file, once a scheduler answers there.

    Without this check, a client would keep retrying for a long time.
    """
    if address.endswith(".json"):
        if not os.path.exists(address):
            raise OSError("there is no such file")
        address = str(_read_json(address)["address"])
    import asyncio
    import socket
    from concurrent.futures import ThreadPoolExecutor

    kind, separator, host = address.rpartition("://")
    if separator and kind not in PROTOCOLS:
        raise ValueError(f"its protocol is {kind}, not {', '.join(PROTOCOLS)}")
    name, _, port = host.rpartition(":")
    if kind != "inproc" and not port.isdigit():
        raise ValueError("it has no port")
    if kind in ("", "tcp", "tls"):  # fails immediately if nothing listens there
        socket.create_connection((name.strip("[]"), int(port)), timeout=PATIENCE).close()
    try:
        with ThreadPoolExecutor(1) as apart:  # an event loop may be running already, as in notebooks
            kind = apart.submit(asyncio.run, asyncio.wait_for(_request_identity(address), PATIENCE)).result()["type"]
    except TimeoutError:
        raise OSError(f"the program listening there did not answer within {PATIENCE:g} s") from None
    except Exception:  # parsing another program's answer can raise any exception
        raise ValueError("the program listening there is not a scheduler") from None
    if kind != "Scheduler":
        raise ValueError(f"a Dask {kind} listens there")
    return address


async def _request_identity(address: str) -> dict:
    """Request the identity of the program that listens at an address."""
    core, security = require("distributed.core", "cluster"), require("distributed.security", "cluster")
    comm = await core.connect(address, timeout=PATIENCE, **security.Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        return dict(await comm.read())
    finally:
        comm.abort()


def _run_on_cluster(packed, address, keep, heard) -> None:
    """Run all tasks on the cluster of the scheduler at `address`; other arguments are those of `worker.run_tasks`.

    Raises
    ------
    SchedulerGoneError
        If the scheduler disappears before the last result has arrived.
    """
    topic, events, source, futures = f"stickslip-{uuid4().hex}", SimpleQueue(), iter(packed), {}
    with connect(address) as client:

        def ask(most: int) -> None:
            for k, task in islice(source, max(0, most - len(futures))):
                name = f"{topic}-{k}"
                futures[k] = client.submit(run_hosted, task, k, topic if heard else None, key=name, pure=False)
                futures[k].add_done_callback(lambda future, k=k: events.put(("done", k)))

        if heard:
            client.subscribe_topic(topic, lambda event: events.put(("said", *event[1])))
        try:
            for kind, *rest in _events(client, events, futures, ask):
                if kind == "done":
                    keep(rest[0], *_result_of(futures.pop(rest[0])))
                elif heard and rest[0] in futures:
                    heard(*rest)
        finally:
            if client.status == "running":
                client.cancel(list(futures.values()))
                if heard:
                    client.unsubscribe_topic(topic)


def _events(client, events, futures: dict, ask):
    """Yield events until no task is left; wait, with a message, while the cluster has no workers."""
    ahead, looked = AHEAD, -POLL
    ask(ahead)
    while futures:
        if client.status != "running":
            raise worker.SchedulerGoneError("the Dask scheduler has disappeared")
        if time.monotonic() - looked >= POLL:
            try:
                looked, slots = time.monotonic(), sum(client.nthreads().values())
            except OSError:  # the scheduler has just disappeared
                raise worker.SchedulerGoneError("the Dask scheduler has disappeared") from None
            ahead = max(AHEAD, 2 * slots)
            if not slots:
                yield "said", next(iter(futures)), "the cluster", 0.0, "no workers yet, waiting for the first"
        try:
            yield events.get(timeout=POLL)
        except Empty:
            continue
        ask(ahead)


def _result_of(future) -> tuple[bytes | None, str | None]:
    """Result of a task, or the reason why it failed."""
    killed = require("distributed.scheduler", "cluster").KilledWorker
    if future.cancelled():
        raise worker.SchedulerGoneError("the Dask scheduler has disappeared, or has lost the tasks")
    try:
        return future.result()
    except killed:
        return None, "worker died (killed, or out of memory) each time the scheduler tried the task"
    except worker.WorkerDiedError as problem:
        return None, str(problem)
    except Exception as problem:
        return None, worker.describe_error(problem)


def run_hosted(packed: bytes, k: int, topic: str | None) -> tuple[bytes | None, str | None]:
    """Run one task on a worker of the cluster, in a separate process that is killed if the client cancels the task."""
    from distributed import get_worker

    host = get_worker()
    key = host.get_current_task()

    def unwanted() -> bool:
        task = host.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    def heard(*said) -> None:
        host.log_event(topic, [k, *said])

    def end_if_unwanted(process: worker.WorkerProcess, finished: Event) -> None:
        while not finished.wait(POLL):  # the thread that waits for the process cannot kill it
            if unwanted():
                process.kill()
                return

    for tries in range(1, worker.TRIES + 1):
        finished = Event()
        try:
            with worker.borrowed(worker.waiting_processes) as process:
                Thread(target=end_if_unwanted, args=(process, finished), daemon=True).start()
                return process.call(packed, PAUSE if topic else None, heard)
        except worker.WorkerDiedError as problem:
            if tries == worker.TRIES or unwanted():
                return None, f"{problem}, {tries} times"
        finally:
            finished.set()
    raise AssertionError("the last try returns")
