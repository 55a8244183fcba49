"""Tasks in processes of this machine, one thread here for each; a process that dies is replaced."""

import queue
import threading

from .worker import WorkerDiedError, WorkerProcess, ensure_running

TRIES = 2  # of a task whose process dies
PAUSE = 0.2  # at least, between two words of one task [s]


def run_tasks(packed, workers: int, keep, heard) -> None:
    """Run all tasks.

    Parameters
    ----------
    packed : yields (k, bytes of a task)
    keep : called here as keep(k, bytes of the result or None, sentence of the failure or None)
    heard : called here as heard(k, share, words); None if the tasks tell nothing
    """
    waiting, events = queue.SimpleQueue(), queue.SimpleQueue()
    source = iter(packed)
    hands = [_WorkerThread(waiting, events, PAUSE if heard else None) for _ in range(workers)]
    try:
        left = sum(_enqueue_next(source, waiting) for _ in range(2 * workers))
        for hand in hands:
            hand.start()
        while left:
            kind, *rest = events.get()
            if kind == "said":
                heard(*rest)
                continue
            if kind == "stopped":
                raise rest[0]
            left += _enqueue_next(source, waiting) - 1
            keep(*rest)
    finally:
        for hand in hands:
            hand.stop()
        for hand in hands:
            hand.end()


def trial(packed: bytes, seconds: float) -> tuple[bytes | None, str | None] | None:
    """One task in a process that is ended after some seconds; None if it was, or died."""
    helper = WorkerProcess()
    clock = threading.Timer(seconds, helper.process.kill)
    clock.start()
    try:
        return helper.call(packed, None, None)
    except WorkerDiedError:
        return None
    finally:
        clock.cancel()
        helper.end()


def _enqueue_next(source, waiting) -> int:
    """Ask for one more task, if there is one: how many were added."""
    task = next(source, None)
    if task is None:
        return 0
    waiting.put((*task, 1))
    return 1


class _WorkerThread(threading.Thread):
    """A thread with one process at a time; it takes tasks and says what becomes of them."""

    def __init__(self, waiting, events, pause: float | None):
        super().__init__(daemon=True)
        self.waiting, self.events, self.pause = waiting, events, pause
        self.helper, self.stopped = None, threading.Event()

    def run(self):
        try:
            while (asked := self.waiting.get()) is not None and not self.stopped.is_set():
                self._do(*asked)
        except Exception as problem:
            if not self.stopped.is_set():
                self.events.put(("stopped", problem))

    def _do(self, k: int, packed: bytes, tries: int) -> None:
        self.helper = ensure_running(self.helper)
        try:
            answer = self.helper.call(packed, self.pause, lambda *said: self.events.put(("said", k, *said)))
        except WorkerDiedError as problem:
            self.helper.end()
            self.helper = None
            if tries < TRIES:  # at the end of the queue: with fewer others beside it memory may suffice
                return self.waiting.put((k, packed, tries + 1))
            answer = None, f"{problem}, {tries} times"
        return self.events.put(("done", k, *answer))

    def stop(self):
        """End the process, whatever it is doing."""
        self.stopped.set()
        self.waiting.put(None)
        if self.helper:
            self.helper.process.kill()

    def end(self):
        """Wait for the thread, which has nothing to do any more."""
        if self.is_alive():
            self.join(10)
        if self.helper:
            self.helper.end()
