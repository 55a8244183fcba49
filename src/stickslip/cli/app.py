"""The application, the options that many commands share, and how a command ends."""

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import typer

from .. import __version__

ENGINES = {"stickslip": "this package", "lammps": "LAMMPS, an optional part"}

app = typer.Typer(
    invoke_without_command=True,
    rich_markup_mode=None,  # plain text: the same in a terminal, a pipe and a log
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A laboratory for frictional grains: build them, load them, know when and how they will slip.",
)

WELCOME = f"""\
stickslip {__version__}: a laboratory for frictional grains

Type first, in a clone of the repository:
  stickslip doctor                            is this installation sound?
  stickslip run examples/rate_state.toml --out results/rate-state
                                              a scenario of your own: seconds
  stickslip reproduce disk-array --quick      a paper, end to end: a minute
  stickslip stability examples/sheared_spheres.npz
                                              is this packing stable?

All commands: stickslip --help. Of each, with examples: stickslip run --help."""


def complete_from(names: dict[str, str]):
    """Values for shells, with a word on each."""
    return lambda incomplete: [pair for pair in names.items() if pair[0].startswith(incomplete)]


Out = Annotated[Path | None, typer.Option("--out", help="Folder for results; made if it does not exist.")]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", min=1, metavar="N", help="Processes of independent runs, threads of a flow; default: all."
    ),
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", help="Address or JSON file of a Dask scheduler that runs them instead.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results of another scenario in the folder.")]
OverwriteFile = Annotated[bool, typer.Option("--overwrite", help="Replace the file, if it is there.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print the result alone: paths, or one sentence.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead, for programs.")]


def examples(*pairs: tuple[str, str]) -> str:
    """Help text below a command's options: commands that work as typed, each with a comment."""
    lines = [f"  stickslip {words}\n      {said}" for words, said in pairs]
    return "\b\nExamples:\n" + "\n".join(lines)


def check_choice(name: str, got: str, allowed: Iterable[str]) -> None:
    """Raise ValueError with a sentence, unless a word is among those allowed; it suggests the near one."""
    allowed = list(allowed)
    if got not in allowed:
        near = get_close_matches(got, allowed, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"{name} {got!r} is not known: use {', '.join(allowed)}{hint}")


def finish(
    answer: Callable[[], dict], paths: list[Path], show: Callable[[], None], *, quiet: bool, as_json: bool
) -> None:
    """Print the result of a command that writes files: a JSON object, paths alone, or a summary and paths."""
    from ..experiments import json_output, terminal

    if as_json:
        print(json_output.text(answer()))
    elif quiet:
        print("\n".join(map(str, paths)))
    else:
        show()
        terminal.show_paths(paths)


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
