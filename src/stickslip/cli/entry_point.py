"""How a process ends: bad input with one sentence and exit code 2, a failed run with one and exit code 1."""

import codecs
import errno
import json
import os
import sys
import unicodedata
from contextlib import contextmanager

from ..extras import MissingExtraError
from .app import app

MAX_LENGTH = 1000  # characters of a sentence
STOPPED = 130  # what shells expect of a process that ctrl-C ended
ASCII_SPELLING = {
    "λ": "lambda", "ω": "omega", "φ": "phi", "σ": "sigma", "μ": "mu", "θ": "theta", "δ": "delta", "Δ": "Delta",
    "×": "x", "±": "+-", "−": "-", "–": "-", "—": "-", "√": "sqrt", "≤": "<=", "≥": ">=", "°": "deg", "─": "-",
}  # fmt: skip


class FailedError(RuntimeError):
    """A run of which a part failed, with what programs are told of all of it."""

    def __init__(self, sentence: str, answer: dict):
        super().__init__(sentence)
        self.answer = answer


@contextmanager
def convert_errors():
    """Turn errors that occur after the input was accepted into a failed run (exit code 1)."""
    from ..data.archive import ArchiveError
    from ..data.schema import ScenarioError

    try:
        yield
    except (ScenarioError, ArchiveError, MissingExtraError):
        raise  # seen late: grains that do not fit, pieces that belong to another run, parts that are not installed
    except (ValueError, ArithmeticError, MemoryError) as problem:
        raise RuntimeError(f"the run failed ({type(problem).__name__}: {problem})") from problem


def main() -> None:
    """Entry point: bad input ends with one sentence and exit code 2, a failed run with one and exit code 1."""
    codecs.register_error("spelled", _transliterate)
    _reopen_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="spelled")
    try:
        code = app(prog_name="stickslip", standalone_mode=False)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()  # who read has heard enough
        sys.exit(1)
    except (ValueError, OSError) as problem:
        _fail(_error_message(problem), 2)
    except RuntimeError as problem:
        _fail(str(problem), 1, getattr(problem, "answer", None))
    except KeyboardInterrupt:
        code = STOPPED
    except Exception as problem:
        if not hasattr(problem, "format_message"):
            raise
        _fail(problem.format_message().rstrip(".") or "say what to do: stickslip --help lists it", 2)
    if code == STOPPED:
        _fail("stopped by the user: stickslip resume FOLDER goes on with what is kept", STOPPED)
    sys.exit(code or 0)


def _reopen_closed_streams() -> None:
    """Connect closed standard streams to the null device; a results file could otherwise get their number."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w", encoding="utf-8"))


def _transliterate(problem: UnicodeError) -> tuple[str, int]:
    """Transliterate characters that the terminal's code page lacks to ASCII."""
    lacking = problem.object[problem.start : problem.end]
    near = (
        ASCII_SPELLING.get(c) or unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() for c in lacking
    )
    return "".join(letters or "?" for letters in near), problem.end


def _error_message(problem: Exception) -> str:
    if isinstance(problem, OSError) and problem.strerror:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = ": what was there before is whole; make room, then a run's own call goes on" if full else ""
        if full and not problem.filename:
            _discard_stdout()
            return f"standard output cannot be written ({problem.strerror.lower()}): send it elsewhere"
        place = f"{problem.filename}: " if problem.filename else ""
        return f"{place}{problem.strerror.lower()}{remedy}"
    return str(problem)


def _discard_stdout() -> None:
    """Say no more on standard output, which cannot be written: what is left in its buffer goes nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(sentence: str, code: int, answer: dict | None = None) -> None:
    """End with a sentence for people, and with --json also with an object for programs."""
    line = " ".join(sentence.split())
    line = line if len(line) <= MAX_LENGTH else line[:MAX_LENGTH] + " …"
    if "--json" in sys.argv[1:]:
        told = {"status": "stopped" if code == STOPPED else "failed", "error": line, "exit_code": code}
        print(json.dumps((answer or {}) | told), flush=True)
    print(f"stickslip: {line}", file=sys.stderr)
    sys.stderr.flush()
    sys.exit(code)
