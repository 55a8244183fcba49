"""Tasks in processes on this machine, with one thread per process; a process that dies is replaced."""

import queue
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import islice

from .worker import TRIES, WorkerDiedError, WorkerProcess, borrowed, waiting_processes

PAUSE = 0.2  # shortest time between two messages of one task [s]


def run_tasks(packed, workers: int, keep, heard, *, own: bool = False) -> None:
    """Run all tasks.

    Parameters
    ----------
    packed : yields (k, bytes of a task)
    keep : called in this process as keep(k, bytes of the result or None, error message or None)
    heard : called in this process as heard(k, stage, share, text); None if the tasks report no progress
    own : True if only code of this package runs, which does not change: the processes then wait for later tasks
    """
    events, source, stopped = queue.SimpleQueue(), iter(packed), threading.Event()
    waiting, used = waiting_processes if own else [], set()

    def attempt(k: int, task: bytes, tries: int) -> None:
        try:
            with borrowed(waiting) as process:
                used.add(process)
                if stopped.is_set():
                    process.kill()
                answer = process.call(task, PAUSE if heard else None, lambda *said: events.put(("said", k, *said)))
            events.put(("done", k, *answer))
        except WorkerDiedError as problem:
            if tries < TRIES:  # at the end of the queue: memory may suffice when fewer tasks run
                threads.submit(attempt, k, task, tries + 1)
            else:
                events.put(("done", k, None, f"{problem}, {tries} times"))
        except Exception as problem:
            events.put(("stopped", problem))

    def submit(most: int) -> int:
        return sum(threads.submit(attempt, *task, 1) is not None for task in islice(source, most))

    try:
        with ThreadPoolExecutor(workers) as threads:
            try:
                left = submit(2 * workers)
                while left:
                    kind, *rest = events.get()
                    if kind == "said":
                        heard(*rest)
                    elif kind == "stopped":
                        raise rest[0]
                    else:
                        left += submit(1) - 1
                        keep(*rest)
            except BaseException:
                stopped.set()
                for process in tuple(used):
                    process.kill()
                threads.shutdown(cancel_futures=True)
                raise
    finally:
        while waiting and not own:
            waiting.pop().end()


def trial(packed: bytes, seconds: float) -> tuple[bytes | None, str | None] | None:
    """Run one task in a process with a time limit [s]; None if the process was killed or died."""
    process = WorkerProcess()
    clock = threading.Timer(seconds, process.kill)
    clock.start()
    try:
        return process.call(packed, None, None)
    except WorkerDiedError:
        return None
    finally:
        clock.cancel()
        process.end()
