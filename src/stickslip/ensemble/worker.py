"""A process that does one task after another for somebody: what it is told comes on its stdin, what it says goes out.

It is a plain child process, and no `multiprocessing` one, because workers of Dask are daemons, which may not have such
children. They need a child: compiled kernels hold the interpreter's lock for as long as they run, and a worker that is
silent for minutes is taken for dead. A helper also survives nobody: it ends when whoever started it is gone.
"""

import math
import os
import pickle
import queue
import signal
import struct
import subprocess
import sys
import threading
import time
import traceback
from contextlib import suppress

from .. import __version__

DONE, FAILED, SAID = 0, 1, 2
ONE_CORE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
IDLE = 60.0  # a process that nobody asks for so long ends [s]
# SIGINT, unless it is ignored, ends it as other signals do: an exception in the middle of a task has nobody to go to
START = """
import signal as s
if s.getsignal(s.SIGINT) != s.SIG_IGN:
    s.signal(s.SIGINT, s.SIG_DFL)
from stickslip.ensemble.worker import serve
serve()
"""


class WorkerDiedError(RuntimeError):
    """A process ended in the middle of a task; the message is one sentence for the user."""


class SchedulerGoneError(RuntimeError):
    """A cluster's scheduler does not answer any more."""


def describe_error(problem: Exception) -> str:
    """What went wrong, with its kind."""
    return f"{type(problem).__name__}: {problem}"


def ensure_running(helper: "WorkerProcess | None") -> "WorkerProcess":
    """The same, or a new one if there is none or it has ended."""
    return helper if helper and helper.process.poll() is None else WorkerProcess()


class WorkerProcess:
    """The process, from the side of whoever started it; one thread at a time may use it."""

    def __init__(self):
        # the cores are shared out already: BLAS and Numba get one thread each
        paths = os.pathsep.join(path for path in sys.path if path)
        environment = os.environ | dict.fromkeys(ONE_CORE, "1") | {"PYTHONPATH": paths, "PYTHONSAFEPATH": "1"}
        # a folder that someone works in may hold a random.py: it comes last, for functions of an interactive session
        here = [os.getcwd()] if "" in sys.path else []
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-c", START, *here],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # ctrl-C is for whoever started it, who ends it then
        )

    def call(self, packed: bytes, pause: float | None, heard) -> tuple[bytes | None, str | None]:
        """Have a task done: (bytes of its result, None) or (None, the sentence of its failure).

        Parameters
        ----------
        packed : bytes of (function, arguments)
        pause : least time between two words that are passed on; None if the function tells nothing [s]
        heard : called as heard(share, words)

        Raises
        ------
        WorkerDiedError
            if the process ends before it has answered.
        """
        try:
            _send(self.process.stdin, pickle.dumps((__version__, pause, packed)))
            while True:
                kind, *rest = pickle.loads(_receive(self.process.stdout))
                if kind == DONE:
                    return rest[0], None
                if kind == FAILED:
                    return None, rest[0]
                heard(*rest)
        except (OSError, EOFError, ValueError):
            raise WorkerDiedError(f"worker died ({self._describe_exit()})") from None

    def _describe_exit(self) -> str:
        try:
            code = self.process.wait(5)
        except subprocess.TimeoutExpired:
            return "it closed its pipe"
        if code == -9:
            return "killed, or out of memory"
        return signal.strsignal(-code).lower() if code < 0 and signal.strsignal(-code) else f"exit code {code}"

    def end(self) -> None:
        """End the process now."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):  # what was to be sent cannot be sent any more
                pipe.close()


def _send(stream, data: bytes) -> None:
    stream.write(struct.pack("<Q", len(data)))
    stream.write(data)
    stream.flush()


def _receive(stream) -> bytes:
    return _read_exactly(stream, struct.unpack("<Q", _read_exactly(stream, 8))[0])


def _read_exactly(stream, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return data


def serve() -> None:
    """Do tasks until there is nobody left to ask for them; what they print goes to stderr.

    Arguments of the process are folders to import from, after all others. The process ends here, whatever happens: the
    thread that listens holds stdin, and an interpreter that shuts down would abort.
    """
    code = 1
    try:
        _serve()
        code = 0
    except BrokenPipeError:
        code = 0  # nobody is left to be told
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
            answer = FAILED, f"this worker has stickslip {__version__}, but {version} asks: install the same there"
        _send(out, pickle.dumps(answer, protocol=5))


def _listen(stream, asked) -> None:
    """Pass on what comes in; the end of it is the end of this process, whatever it is doing."""
    try:
        while True:
            asked.put(pickle.loads(_receive(stream)))
    finally:
        os._exit(0)


def _run_task(packed: bytes, more: tuple) -> tuple:
    try:
        function, task = pickle.loads(packed)
        return DONE, pickle.dumps(function(*task, *more), protocol=5)
    except Exception as problem:
        return FAILED, describe_error(problem)


def _make_reporter(out, pause: float):
    """tell(share, words), which lets through the first words, and others after a pause."""
    last = -math.inf

    def tell(share: float, words: str) -> None:
        nonlocal last
        if time.monotonic() - last >= pause:
            last = time.monotonic()
            _send(out, pickle.dumps((SAID, float(share), str(words))))

    return tell
