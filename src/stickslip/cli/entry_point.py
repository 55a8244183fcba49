"""Entry point and exit codes: 2 for bad input, 1 for a failed run, each with one sentence on standard error."""

import codecs
import errno
import json
import os
import sys
import unicodedata
import warnings
from contextlib import contextmanager

from ..extras import MissingExtraError
from .app import app

MAX_LENGTH = 1000  # of an error message, as in core.text [characters]
STOPPED = 130  # exit code that shells expect from a process ended by ctrl-C
ASCII_SPELLING = {
    "λ": "lambda", "ω": "omega", "φ": "phi", "σ": "sigma", "μ": "mu", "θ": "theta", "δ": "delta", "Δ": "Delta",
    "×": "x", "±": "+-", "−": "-", "–": "-", "—": "-", "√": "sqrt", "≤": "<=", "≥": ">=", "°": "deg", "─": "-",
}  # fmt: skip


class FailedError(RuntimeError):
    """Raised for a run that failed in part; `answer` is the JSON object for the whole run."""

    def __init__(self, sentence: str, answer: dict):
        super().__init__(sentence)
        self.answer = answer


class StoppedError(Exception):
    """Raised for a run that was stopped by ctrl-C; the message says how to continue."""


@contextmanager
def convert_errors():
    """Report as a failed run (exit code 1) any error raised after the input was accepted."""
    from ..data.archive import ArchiveError
    from ..data.schema import ScenarioError

    try:
        yield
    except (ScenarioError, ArchiveError, MissingExtraError):
        raise  # bad input found late: grains that do not fit, checkpoints of another run, missing extras
    except (ValueError, ArithmeticError, MemoryError) as problem:
        raise RuntimeError(f"the run failed ({type(problem).__name__}: {problem})") from problem


def _show_warning(message, *where, **more) -> None:
    """Show a warning like any other message, without the line of code that issued it."""
    from ..core.text import printable

    print(printable(f"stickslip: {message}"), file=sys.stderr)


def main() -> None:
    """Run the command line; exit code 2 for bad input and 1 for a failed run, each with one sentence."""
    codecs.register_error("spelled", _transliterate)
    _reopen_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="spelled")
    warnings.showwarning = _show_warning
    try:
        code = app(prog_name="stickslip", standalone_mode=False)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()  # the reader closed the pipe
        sys.exit(1)
    except (ValueError, OSError) as problem:
        _fail(_error_message(problem), 2)
    except MemoryError as problem:
        _fail(f"the memory does not suffice ({problem}): use fewer grains, samples or frames", 1)
    except StoppedError as problem:
        _fail(str(problem), STOPPED)
    except RuntimeError as problem:
        _fail(str(problem), 1, getattr(problem, "answer", None))
    except KeyboardInterrupt:
        code = STOPPED
    except Exception as problem:
        if not hasattr(problem, "format_message"):
            raise
        _fail(problem.format_message().rstrip(".") or "no command was given: stickslip --help lists them", 2)
    if code == STOPPED:
        _fail("stopped by the user", STOPPED)
    sys.exit(code or 0)


def _reopen_closed_streams() -> None:
    """Connect closed standard streams to the null device; a results file could otherwise receive their descriptors."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w", encoding="utf-8"))


def _transliterate(problem: UnicodeError) -> tuple[str, int]:
    """Transliterate to ASCII the characters that the terminal's code page lacks."""
    lacking = problem.object[problem.start : problem.end]
    near = (
        ASCII_SPELLING.get(c) or unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() for c in lacking
    )
    return "".join(letters or "?" for letters in near), problem.end


def _error_message(problem: Exception) -> str:
    if isinstance(problem, OSError) and problem.strerror:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = ": existing files are unchanged; free some space and repeat the command to continue" if full else ""
        if full and not problem.filename:
            _discard_stdout()
            return f"standard output cannot be written ({problem.strerror.lower()}): redirect it elsewhere"
        place = f"{problem.filename}: " if problem.filename else ""
        return f"{place}{problem.strerror.lower()}{remedy}"
    return str(problem)


def _discard_stdout() -> None:
    """When standard output can no longer be written to, redirect it to the null device and discard its buffer."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(sentence: str, code: int, answer: dict | None = None) -> None:
    """Exit with a sentence on standard error and, with --json, an object on standard output."""
    line = " ".join(sentence.split())
    if len(line) > MAX_LENGTH or not line.isprintable():
        from ..core.text import bounded  # not at the top: it loads NumPy

        line = bounded(line)
    if "--json" in sys.argv[1:]:
        ending = {"status": "stopped" if code == STOPPED else "failed", "error": line, "exit_code": code}
        print(json.dumps((answer or {}) | ending), flush=True)
    print(f"stickslip: {line}", file=sys.stderr)
    sys.stderr.flush()
    sys.exit(code)
