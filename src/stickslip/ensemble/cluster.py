"""Tasks on an existing Dask cluster; no other module imports Dask.

On a worker of the cluster every task runs in a separate process (`WorkerProcess`), so that compiled kernels, which hold
the interpreter's lock, do not block the worker's heartbeat to its scheduler.
"""

import asyncio
import json
import logging
import os
import queue
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from uuid import uuid4

from ..extras import require
from .worker import (
    TRIES,
    SchedulerGoneError,
    WorkerDiedError,
    WorkerProcess,
    borrowed,
    describe_error,
    waiting_processes,
)

PROTOCOLS = ("tcp", "tls", "ws", "wss", "ucx", "inproc")
PATIENCE = 10.0  # timeout for the scheduler's first answer [s]
PAUSE = 1.0  # shortest time between two messages of one task, because a scheduler receives those of many tasks [s]
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

    A client would keep retrying for a long time.
    """
    if address.endswith(".json"):
        if not os.path.exists(address):
            raise OSError("there is no such file")
        address = str(_read_json(address)["address"])
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


def run_tasks(packed, address, keep, heard) -> None:
    """Run all tasks; arguments as in `local.run_tasks`, and the scheduler's address.

    Raises
    ------
    SchedulerGoneError
        If the scheduler disappears before the last result has arrived.
    """
    topic, events, source, futures = f"stickslip-{uuid4().hex}", queue.SimpleQueue(), iter(packed), {}
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
            raise SchedulerGoneError("the Dask scheduler has disappeared")
        if time.monotonic() - looked >= POLL:
            try:
                looked, slots = time.monotonic(), sum(client.nthreads().values())
            except OSError:  # it has just disappeared
                raise SchedulerGoneError("the Dask scheduler has disappeared") from None
            ahead = max(AHEAD, 2 * slots)
            if not slots:
                yield "said", next(iter(futures)), "the cluster", 0.0, "no workers yet, waiting for the first"
        try:
            yield events.get(timeout=POLL)
        except queue.Empty:
            continue
        ask(ahead)


def _result_of(future) -> tuple[bytes | None, str | None]:
    """Result of a task, or the reason why it failed."""
    killed = require("distributed.scheduler", "cluster").KilledWorker
    if future.cancelled():
        raise SchedulerGoneError("the Dask scheduler has disappeared, or has lost the tasks")
    try:
        return future.result()
    except killed:
        return None, "worker died (killed, or out of memory) each time the scheduler tried the task"
    except WorkerDiedError as problem:
        return None, str(problem)
    except Exception as problem:
        return None, describe_error(problem)


def run_hosted(packed: bytes, k: int, topic: str | None) -> tuple[bytes | None, str | None]:
    """Run one task on a worker of the cluster, in a separate process that is killed if the client cancels the task."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def unwanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is None or task.state == "cancelled"

    def heard(*said) -> None:
        worker.log_event(topic, [k, *said])

    for tries in range(1, TRIES + 1):
        finished = threading.Event()
        try:
            with borrowed(waiting_processes) as process:
                threading.Thread(target=_kill_when_unwanted, args=(process, finished, unwanted), daemon=True).start()
                return process.call(packed, PAUSE if topic else None, heard)
        except WorkerDiedError as problem:
            if tries == TRIES or unwanted():
                return None, f"{problem}, {tries} times"
        finally:
            finished.set()
    raise AssertionError("the last try returns")


def _kill_when_unwanted(process: WorkerProcess, finished: threading.Event, unwanted) -> None:
    """Kill a process whose task was cancelled; the thread that waits for it cannot do so."""
    while not finished.wait(POLL):
        if unwanted():
            process.kill()
            return
