"""Tasks in processes on this machine, with one thread per process; a process that dies is replaced."""

import queue
import threading

from .worker import WorkerDiedError, WorkerProcess, give_back, take_idle

TRIES = 2  # attempts for a task whose process dies
PAUSE = 0.2  # shortest time between two messages of one task [s]


def run_tasks(packed, workers: int, keep, heard, *, own: bool = False) -> None:
    """Run all tasks.

    Parameters
    ----------
    packed : yields (k, bytes of a task)
    keep : called in this process as keep(k, bytes of the result or None, error message or None)
    heard : called in this process as heard(k, share, words); None if the tasks report no progress
    own : True if only code of this package runs, which does not change: the processes then wait for later tasks
    """
    waiting, events = queue.SimpleQueue(), queue.SimpleQueue()
    source = iter(packed)
    threads = [_WorkerThread(waiting, events, PAUSE if heard else None, own) for _ in range(workers)]
    try:
        left = sum(_enqueue_next(source, waiting) for _ in range(2 * workers))
        for thread in threads:
            thread.start()
        while left:
            kind, *rest = events.get()
            if kind == "said":
                heard(*rest)
                continue
            if kind == "stopped":
                raise rest[0]
            left += _enqueue_next(source, waiting) - 1
            keep(*rest)
    except BaseException:
        for thread in threads:
            thread.kill()
        raise
    finally:
        for _ in threads:
            waiting.put(None)
        for thread in threads:
            thread.end()


def trial(packed: bytes, seconds: float) -> tuple[bytes | None, str | None] | None:
    """Run one task in a process with a time limit [s]; None if the process was killed or died."""
    worker = WorkerProcess()
    clock = threading.Timer(seconds, worker.process.kill)
    clock.start()
    try:
        return worker.call(packed, None, None)
    except WorkerDiedError:
        return None
    finally:
        clock.cancel()
        worker.end()


def _enqueue_next(source, waiting) -> int:
    """Enqueue the next task, if there is one, and return the number of tasks added."""
    task = next(source, None)
    if task is None:
        return 0
    waiting.put((*task, 1))
    return 1


class _WorkerThread(threading.Thread):
    """A thread that drives one process at a time, takes tasks and posts their results."""

    def __init__(self, waiting, events, pause: float | None, own: bool):
        super().__init__(daemon=True)
        self.waiting, self.events, self.pause, self.own = waiting, events, pause, own
        self.worker, self.stopped = None, threading.Event()

    def run(self):
        try:
            while (asked := self.waiting.get()) is not None and not self.stopped.is_set():
                self._do(*asked)
        except Exception as problem:
            if not self.stopped.is_set():
                self.events.put(("stopped", problem))

    def _do(self, k: int, packed: bytes, tries: int) -> None:
        if self.worker and self.worker.process.poll() is not None:  # it had no task for a minute
            self.worker.end()
            self.worker = None
        self.worker = self.worker or take_idle()
        try:
            answer = self.worker.call(packed, self.pause, lambda *said: self.events.put(("said", k, *said)))
        except WorkerDiedError as problem:
            self.worker.end()
            self.worker = None
            if tries < TRIES:  # at the end of the queue: memory may suffice when fewer tasks run
                return self.waiting.put((k, packed, tries + 1))
            answer = None, f"{problem}, {tries} times"
        return self.events.put(("done", k, *answer))

    def kill(self):
        """Kill the process, whatever it is doing."""
        self.stopped.set()
        if self.worker:
            self.worker.process.kill()

    def end(self):
        """Wait for the thread to finish, then end its process, or keep it for later tasks."""
        if self.is_alive():
            self.join(10)
        if self.worker and self.own and not self.stopped.is_set():
            give_back(self.worker)
        elif self.worker:
            self.worker.end()
