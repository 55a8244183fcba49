"""A worker process that runs tasks one after another: it receives them on stdin and sends results on stdout.

It is a plain child process, unlike the `multiprocessing` processes of pebble, loky and `concurrent.futures`: these
import the user's script, and Dask workers are daemons, which may not have such children. Dask workers need a child
process because compiled kernels hold the interpreter's lock while they run, and a worker that is silent for minutes is
considered dead. A worker process ends with its parent.

`run_tasks` runs tasks in such processes on this machine, with one thread each, and replaces a process that dies.
"""

import math
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import islice

from .. import __version__

TRIES = 2  # attempts for a task whose process dies
DONE, FAILED, SAID = 0, 1, 2
ONE_CORE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
IDLE = 60.0  # a process ends after this time without a task [s]
# SIGINT, unless it is ignored, ends the process as other signals do: an exception within a task could not be handled
START = """
import signal as s
if s.getsignal(s.SIGINT) != s.SIG_IGN:
    s.signal(s.SIGINT, s.SIG_DFL)
from stickslip.ensemble.worker import serve
serve()
"""


class WorkerDiedError(RuntimeError):
    """Raised if a process ends during a task; the message is one sentence for the user."""


class SchedulerGoneError(RuntimeError):
    """Raised if a cluster's scheduler no longer answers."""


def describe_error(problem: Exception) -> str:
    """Message of an exception, and its type unless the message is a sentence."""
    plain = isinstance(problem, RuntimeError | ValueError) and str(problem)
    return str(problem) if plain else f"{type(problem).__name__}: {problem}"


class WorkerProcess:
    """Parent's handle to a worker process; only one thread at a time may use it."""

    def __init__(self):
        # the cores are already distributed over processes: BLAS and Numba get one thread each
        paths = os.pathsep.join(path for path in sys.path if path)
        environment = os.environ | dict.fromkeys(ONE_CORE, "1") | {"PYTHONPATH": paths, "PYTHONSAFEPATH": "1"}
        # the working directory, needed for functions of an interactive session, comes last: it may contain a random.py
        here = [os.getcwd()] if "" in sys.path else []
        self.origin = _origin()
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", START, *here],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # ctrl-C reaches only the parent, which then ends this process
        )

    def call(self, packed: bytes, pause: float | None, heard) -> tuple[bytes | None, str | None]:
        """Run a task and return (bytes of its result, None) or (None, error message).

        Parameters
        ----------
        packed : bytes of (function, arguments)
        pause : shortest time between two progress messages; None if the function reports no progress [s]
        heard : called as heard(stage, share, text)

        Raises
        ------
        WorkerDiedError
            If the process ends before it has answered.
        """
        try:
            _send(self.process.stdin, (__version__, pause, packed))
            while True:
                kind, *rest = pickle.load(self.process.stdout)
                if kind == DONE:
                    return rest[0], None
                if kind == FAILED:
                    return None, rest[0]
                heard(*rest)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            raise WorkerDiedError(f"worker died ({self._describe_exit()})") from None

    def _describe_exit(self) -> str:
        try:
            code = self.process.wait(5)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        if code == -9:
            return "killed, or out of memory"
        return signal.strsignal(-code).lower() if code < 0 and signal.strsignal(-code) else f"exit code {code}"

    def kill(self) -> None:
        """Kill the process at once."""
        self.process.kill()

    def end(self) -> None:
        """Kill the process and wait until it has ended."""
        self.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):  # buffered data cannot be sent any more
                pipe.close()


# processes that wait for another task; starting one takes a second. They end after a minute, or with this process
waiting_processes: list[WorkerProcess] = []


def _origin() -> tuple:
    """State that a process inherits when it is started."""
    return os.getpid(), os.getcwd(), list(sys.path), dict(os.environ)


def _take(waiting: list[WorkerProcess]) -> WorkerProcess:
    """Return a waiting process whose inherited state is still up to date, or start a new process."""
    with suppress(IndexError):
        while True:
            process = waiting.pop()
            if process.process.poll() is None and process.origin == _origin():
                return process
            process.end()
    return WorkerProcess()


@contextmanager
def borrowed(waiting: list[WorkerProcess]) -> Iterator[WorkerProcess]:
    """Context manager for a waiting or new process, which afterwards waits again or, after an error, is ended."""
    process = _take(waiting)
    try:
        yield process
    except BaseException:
        process.end()
        raise
    waiting.append(process)


def _send(stream, message: tuple) -> None:
    pickle.dump(message, stream, protocol=5)
    stream.flush()


def serve() -> None:
    """Run tasks until the parent ends; their output goes to stderr.

    The arguments of the process are folders to import from, searched after all others. The process always ends in this
    function, because the listening thread holds stdin and the interpreter would otherwise abort at shutdown.
    """
    code = 1
    try:
        with suppress(BrokenPipeError):  # the parent has ended
            _serve()
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def _serve() -> None:
    sys.path += sys.argv[1:]
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    asked = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, asked), daemon=True).start()
    while True:
        try:
            version, pause, packed = asked.get(timeout=IDLE)
        except queue.Empty:
            return
        if version == __version__:
            answer = _run_task(packed, () if pause is None else (_make_reporter(out, pause),))
        else:
            answer = FAILED, f"this worker has stickslip {__version__}, the client {version}: install the same version"
        _send(out, answer)


def _listen(stream, asked) -> None:
    """Queue incoming tasks; end this process at once when the stream ends."""
    try:
        while True:
            asked.put(pickle.load(stream))
    finally:
        os._exit(0)


def _run_task(packed: bytes, more: tuple) -> tuple:
    try:
        function, task = pickle.loads(packed)
        return DONE, pickle.dumps(function(*task, *more), protocol=5)
    except Exception as problem:
        return FAILED, describe_error(problem)


def _make_reporter(out, pause: float):
    """Return report(stage, share, text), which sends the first message at once and later ones only after a pause."""
    last = -math.inf

    def report(stage: str, share: float, text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= pause:
            last = time.monotonic()
            _send(out, (SAID, str(stage), float(share), str(text)))

    return report


PAUSE = 0.2  # shortest time between two messages of one task [s]


def run_tasks(packed, workers: int, keep, heard, *, own: bool = False) -> None:
    """Run all tasks in worker processes on this machine.

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
            if tries < TRIES:  # retry at the end of the queue: memory may suffice when fewer tasks run
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
