"""The application, its entry point, options shared by several commands, and output of results.

Exit codes are 2 for bad input and 1 for a failed run, each with one sentence on standard error.
"""

import codecs
import errno
import json
import os
import signal
import sys
import unicodedata
import warnings
from collections.abc import Callable, Iterable
from contextlib import contextmanager
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, NamedTuple, get_args, get_type_hints

import typer

from .. import __version__, reports, runs
from ..extras import MissingExtraError
from ..wing import Command, MissingWingError, Wing, failure_of_foreign_wing, wings

DEVICES = {"cuda": "an NVIDIA graphics processor, with the extra gpu"}
ENGINES = {"stickslip": "this package", "lammps": "LAMMPS, an optional part"}


LABORATORY = Wing(
    package=__package__,
    words="the laboratory",
    commands=(
        Command("reproduce", "Run a paper's experiment and evaluate its claims.", "running.reproduce"),
        Command("run", "Run a scenario, or a sweep of many.", "running.run"),
        Command("resume", "Continue a run that was stopped or killed.", "running.resume"),
        Command("stability", "Is this packing stable?", "packings.stability"),
        Command("convert", "Write a packing for OVITO, ParaView, ASE, LAMMPS.", "packings.convert"),
        Command("report", "Write an HTML report on a run or a packing.", "packings.report"),
        Command("movie", "Write a movie of a run or a mode, GIF or MP4.", "packings.movie"),
        Command("example", "List or copy the examples.", "about.example"),
        Command("docs", "Read the documentation: keys of scenarios, laws, LAMMPS.", "about.docs"),
        Command("cite", "Print BibTeX entries to cite for a run.", "about.cite"),
        Command("doctor", "Check this installation.", "about.doctor"),
    ),
)


def commands() -> dict[str, tuple[Wing, Command]]:
    """Commands by name, in the order of `stickslip --help`, each with the head that names it."""
    own = {one.name: (LABORATORY, one) for one in LABORATORY.commands}
    last = ("example", "docs", "cite", "doctor")
    found = {name: pair for name, pair in own.items() if name not in last}
    for wing in wings().values():
        for one in wing.commands:
            if one.name in own:
                message = f"the command {one.name} of the wing {wing.package} exists already: rename it"
                warnings.warn(message, stacklevel=1)
            else:
                found[one.name] = wing, one
    return found | {name: own[name] for name in last}


class _Commands(typer.core.TyperGroup):
    """Group of commands that are imported when used; for an unknown command, the message suggests similar ones."""

    def list_commands(self, ctx):
        return [*commands(), *super().list_commands(ctx)]

    def get_command(self, ctx, name):
        _, found = commands().get(name, (None, None))
        return typer.core.TyperCommand(name, short_help=found.words) if found else super().get_command(ctx, name)

    def resolve_command(self, ctx, args):
        name = args[0]
        if self.get_command(ctx, name) is None:
            known = self.list_commands(ctx)
            near = commands_like(name, known)
            hint = f"did you mean {' or '.join(near)}?" if near else f"use {', '.join(known)}"
            raise ValueError(f"unknown command {name!r}: {hint}")
        if name not in commands():
            return super().resolve_command(ctx, args)
        wing, one = commands()[name]
        single = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
        function = wing.function(one.function)
        if not hasattr(function, "how"):
            form = "a function decorated with `stickslip.kit.command`"
            raise MissingWingError(f"the command {name} of the wing {wing.package}, {one.function}, is not {form}")
        how = {key: value() if callable(value) else value for key, value in function.how.items()}
        single.command(name, **how)(function)
        return name, typer.main.get_command(single), args[1:]


app = typer.Typer(
    cls=_Commands,
    invoke_without_command=True,
    rich_markup_mode=None,  # plain text, identical in a terminal, a pipe and a log
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A laboratory for frictional grains: build them, load them, know when and how they will slip.",
)

WELCOME = f"""\
stickslip {__version__}: a laboratory for frictional grains

First steps:
  stickslip example --all                     copy the examples to the folder examples
  stickslip stability examples/sheared_spheres.npz
                                              is this packing stable?
  stickslip run examples/rate_state.toml --out results/rate-state
                                              run a scenario: seconds
  stickslip reproduce disk-array --quick      reproduce a paper: a minute
  stickslip doctor                            check this installation

All commands: stickslip --help. One command, with examples: stickslip run --help."""


def number_option(*names: str, help: str):
    """Option whose value is a number, parsed as numbers in files are."""
    return typer.Option(*names, help=help, parser=_parse_option, metavar="<float>")


def _parse_option(word: str | float) -> float:
    from ..core.text import parse_number

    try:
        return parse_number(str(word))
    except ValueError:
        raise typer.BadParameter(f"{word!r} is not a number: write it as in 0.5 or 1e-3") from None


def numbers_by_name(tokens: list[str] | None) -> dict[str, float] | None:
    """Numbers by name, from texts such as work=1e-3; None if there are none."""
    if tokens and (odd := [word for word in tokens if "=" not in word]):
        raise typer.BadParameter(f"expected a name and a number as in work=1e-3, got {odd[0]!r}")
    pairs = [word.partition("=") for word in tokens or ()]
    return {name.strip(): _parse_option(number.strip()) for name, _, number in pairs} or None


def complete_from(names: dict[str, str] | Callable[[], dict[str, str]]):
    """Shell completion from names and their descriptions, or from a function that returns them."""

    def complete(incomplete: str) -> list[tuple[str, str]]:
        choices = names() if callable(names) else names
        return [pair for pair in choices.items() if pair[0].startswith(incomplete)]

    return complete


Out = Annotated[Path | None, "Folder for results; created if it does not exist."]
Overwrite = Annotated[bool, "Replace results of another scenario in the folder."]
OverwriteFile = Annotated[bool, "Replace the file if it exists."]
Trust = Annotated[bool, "Allow the Python file in law.file to run, now and in future."]
Slides = Annotated[bool, "For slides: 16:9, with large type and thick lines."]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead, for programs.")]


class Output(NamedTuple):
    """Options for the output of a command."""

    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the result: paths, or one sentence.")] = False
    as_json: AsJson = False


class FigureOptions(NamedTuple):
    """Options for the figures that a command writes."""

    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="pdf or svg: also write figures in this format, besides PNG; repeatable."),
    ] = None
    width: Annotated[
        int | None, typer.Option(metavar="MM", help="Width of figures: 86 mm (one column, default) or 178 mm.")
    ] = None
    letters: Annotated[
        bool, typer.Option("--letters/--no-letters", help="Letter the panels of figures: (a), (b) …")
    ] = True
    slides: Slides = False

    def look(self):
        """Return the look of figures; raise ValueError for an unavailable format or width."""
        from ..figures.style import FORMATS, WIDTHS, look_of

        for kind in self.formats or ():
            check_choice("format", kind, FORMATS)
        if self.width not in (None, *WIDTHS):
            raise ValueError(f"--width must be 86 or 178 [mm], got {self.width}")
        formats = "png", *(self.formats or ())
        return look_of(formats, width=self.width, letters=self.letters, slides=self.slides)


class EngineOptions(NamedTuple):
    """Options for the engine that runs a scenario."""

    engine: Annotated[
        str | None, "stickslip or lammps, for flows and fault gouge; overrides the scenario.", ENGINES
    ] = None
    ranks: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="MPI processes of LAMMPS; overrides the scenario.")
    ] = None

    def values(self) -> dict:
        """Specified options as a dictionary; raise ValueError for an unknown engine."""
        if self.engine is not None:
            check_choice("engine", self.engine, ENGINES)
        return {name: value for name, value in self._asdict().items() if value is not None}


class ProcessOptions(NamedTuple):
    """Options for the processes of independent runs."""

    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Processes for independent runs, threads for a flow; default: all."),
    ] = None
    scheduler: Annotated[
        str | None, "Address or JSON file of a Dask scheduler that executes independent runs instead."
    ] = None
    device: Annotated[
        str | None,
        "cuda: run all realisations of gouge or of a sliding array side by side on a graphics processor.",
        DEVICES,
    ] = None


def _as_option(name: str, annotation):
    """Annotation of an option named after its parameter, from a type and a help text; unchanged without a text."""
    kind, (about, *choices) = getattr(annotation, "__origin__", None), getattr(annotation, "__metadata__", (None,))
    if not isinstance(about, str):
        return annotation
    option = f"--{name.replace('_', '-')}"
    if float in (kind, *get_args(kind)):
        return Annotated[kind, number_option(option, help=about)]
    completion = complete_from(*choices) if choices else None
    return Annotated[kind, typer.Option(option, help=about, autocompletion=completion)]


def command(**how):
    """Turn a function into a command; the fields of its parameters that are NamedTuples become options.

    `how` holds options of `typer.Typer.command`, or functions that return their values when the command is used.

    `Annotated[bool, "Words."]` is an option named after its parameter, with these words as its help; for shell
    completion, values and their descriptions may follow. Floats are parsed as numbers in files are.
    """

    def register(function):
        """Expand the groups of a function's options, and turn it into a command."""
        own = signature(function).parameters.values()
        groups = {
            p.name: p.annotation for p in own if isinstance(p.annotation, type) and hasattr(p.annotation, "_fields")
        }

        @wraps(function)
        def call(**given):
            filled = {name: kind(*(given.pop(field) for field in kind._fields)) for name, kind in groups.items()}
            return function(**given, **filled)

        single = []
        for p in own:
            if p.name not in groups:
                single.append(p)
                continue
            kinds, defaults = get_type_hints(p.annotation, include_extras=True), p.annotation._field_defaults
            single += [Parameter(name, p.kind, default=defaults[name], annotation=kinds[name]) for name in kinds]
        single = [p.replace(kind=Parameter.KEYWORD_ONLY, annotation=_as_option(p.name, p.annotation)) for p in single]
        del call.__wrapped__
        call.__signature__ = Signature(single)
        call.__annotations__ = {p.name: p.annotation for p in single}
        call.how = how
        return call

    return register


def examples(*pairs: tuple[str, str]) -> str:
    """Text for the end of a command's help: example commands that work as typed, each with a comment."""
    lines = [f"  stickslip {typed}\n      {said}" for typed, said in pairs]
    if any("examples/" in typed for typed, _ in pairs):
        lines.append("  The files in examples: stickslip example --all copies them.")
    return "\b\nExamples:\n" + "\n".join(lines)


def commands_like(word: str, commands: list[str]) -> list[str]:
    """Commands, scenarios, public names or pages similar to an unknown command."""
    from ..experiments.registry import EXPERIMENTS, papers
    from ..words import suggestions, with_rarest_parts

    plain = word.lower().replace("_", "-")
    examples = {
        name.partition(".")[0].replace("_", "-"): name for name in runs.bundled.names() if name.endswith(".toml")
    }
    advice = {name: f"`stickslip {name}`" for name in commands}
    advice |= {name: f'`stickslip run SCENARIO` with experiment = "{name}"' for name in EXPERIMENTS}
    advice |= {name: f"`stickslip example {file}`, and `stickslip run`" for name, file in examples.items()}
    advice |= {name: f"`stickslip reproduce {name}`" for name in papers()}
    found = suggestions(word, limit=9)
    typed = [one for one in found if one.startswith("`stickslip ")]
    spelled = [advice[name] for name in get_close_matches(plain, advice, 1) if name[0] == plain[0]]
    if plain in advice:
        return spelled
    named = (one.rpartition(".")[2].replace("_", "-") for one in found if one.startswith("experiments."))
    experiments = [advice[name] for name in named if name in advice]
    in_python = [f"stickslip.{one} in Python" for one in found[:2] if not one.startswith("`")]
    pages = [f"`stickslip docs {page}`" for page in with_rarest_parts(word, runs.bundled.headings())]
    return typed[:2] or spelled or experiments[:2] or in_python or pages[:2]


def check_choice(name: str, got: str, allowed: Iterable[str]) -> None:
    """Raise ValueError if a word is not among those allowed; the message suggests the closest one."""
    allowed = list(allowed)
    if got not in allowed:
        near = get_close_matches(got, allowed, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown {name} {got!r}: use {', '.join(allowed)}{hint}")


def finish(answer: Callable[[], dict], paths: list[Path], show: Callable[[], None], output: Output) -> None:
    """Print the result of a command that writes files: a JSON object, only paths, or a summary and paths."""
    if output.as_json:
        print(runs.json_output.to_json(answer()))
    elif output.quiet:
        print("\n".join(map(str, paths)))
    else:
        show()
        reports.terminal.show_paths(paths)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip {__version__}")
        raise typer.Exit


@app.callback()
def _show_welcome(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(WELCOME)


MAX_LENGTH = 1000  # longest error message, as in core.text [characters]
STOPPED = 130  # exit code that shells expect from a process ended by ctrl-C, here also by SIGTERM
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
    """Raised for a run stopped by ctrl-C or SIGTERM; the message names the command that continues it."""


@contextmanager
def convert_errors():
    """Report as a failed run (exit code 1) any error raised after the input was accepted."""
    from ..data.archive import ArchiveError
    from ..data.schema import ScenarioError

    try:
        yield
    except (ScenarioError, ArchiveError, MissingExtraError, MissingWingError):
        raise  # bad input that is detected late: grains that do not fit, checkpoints of another run, missing extras
    except (ValueError, ArithmeticError, MemoryError) as problem:
        raise RuntimeError(f"the run failed ({type(problem).__name__}: {problem})") from problem


def _show_warning(message, *where, **more) -> None:
    """Show a warning like any other message, without the line of code that issued it."""
    from ..core.text import printable

    print(printable(f"stickslip: {message}"), file=sys.stderr)


def _raise_interrupt(number: int, _) -> None:
    """Exit as after ctrl-C, with the name of the signal; SIGTERM is sent, for example, at a job's time limit."""
    raise KeyboardInterrupt(signal.Signals(number).name)


def main() -> None:
    """Run the command line; exit code 2 for bad input and 1 for a failed run, each with one sentence."""
    codecs.register_error("spelled", _transliterate)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: open the null device, or a results file could get its descriptor
            number = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w", encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="spelled")
    warnings.showwarning = _show_warning
    if signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _raise_interrupt)
    stopped = "stopped by the user"
    try:
        code = app(prog_name="stickslip", standalone_mode=False)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()  # the reader closed the pipe
        sys.exit(1)
    except (ValueError, OSError) as problem:
        _fail(_error_message(problem), 2)
    except MemoryError as problem:
        _fail(f"out of memory ({problem}): use fewer grains, samples or frames", 1)
    except StoppedError as problem:
        _fail(str(problem), STOPPED)
    except RuntimeError as problem:
        _fail(str(problem), 1, getattr(problem, "answer", None))
    except KeyboardInterrupt as problem:
        code, stopped = STOPPED, f"stopped by {problem}" if str(problem) else stopped
    except Exception as problem:
        if hasattr(problem, "format_message"):
            _fail(_usage_message(problem), 2)
        failure = None if sys.flags.dev_mode else failure_of_foreign_wing(problem)
        if failure is None:
            raise
        _fail(failure, 1)
    if code == STOPPED:
        _fail(stopped, STOPPED)
    sys.exit(code or 0)


def _usage_message(problem) -> str:
    """Message about unknown or missing options and arguments."""
    from ..words import options_like

    word, context = getattr(problem, "option_name", ""), getattr(problem, "ctx", None)
    if not (word and context and hasattr(problem, "possibilities")):
        return problem.format_message().rstrip(".") or "a command is missing: stickslip --help lists them"
    options = [one[2:] for part in context.command.params for one in part.opts if one.startswith("--")]
    near = " or ".join(f"--{one}" for one in options_like(word, options))
    hint = f"did you mean {near}? " if near else ""
    return f"unknown option {word}: {hint}`{context.command_path} --help` lists the options"


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
        location = f"{problem.filename}: " if problem.filename else ""
        return f"{location}{problem.strerror.lower()}{remedy}"
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
