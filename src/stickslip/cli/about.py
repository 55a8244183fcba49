"""Commands about the package: citations for a run, and a check of the installation."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import reports, runs
from .app import AsJson, Output, command, complete_from, examples

CITE = examples(
    ("cite examples/gouge.toml", "for a scenario; > paper.bib saves them"),
    ("cite examples/rate_state_sweep.toml --json", "the same as one JSON object"),
)
DOCTOR = examples(("doctor", "a few seconds"), ("doctor --json", "for a bug report, or to test an installation"))
EXAMPLE = examples(
    ("example", "a list"),
    ("example --all", "all of them, in the folder examples"),
    ("example column_collapse", "examples/column_collapse.toml, to run or to change"),
)
DOCS = examples(("docs", "a list"), ("docs scenario/flow", "all keys of flow scenarios"))


@command(epilog=EXAMPLE)
def example(
    *,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]...", help="Examples to copy.", autocompletion=complete_from(lambda: runs.bundled.names())
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Copy all examples.")] = False,
    to: Annotated[Path, "Folder for the copies."] = Path("examples"),
    overwrite: Annotated[bool, "Replace files."] = False,
    output: Output,
) -> None:
    """List the examples that come with the package, or copy them: scenarios, packings, laws, and LAMMPS input."""
    if names and every:
        raise ValueError("give either --all or names, not both")
    known = runs.bundled.names()
    paths = runs.bundled.copy(*names or (), to=to, overwrite=overwrite) if names or every else []
    if output.as_json:
        runs.json_output.show("example", {"examples": known}, files=paths)
    elif output.quiet:
        print("\n".join(map(str, paths or known)))
    elif paths:
        reports.terminal.show_paths(paths)
    else:
        reports.terminal.show_pairs("Examples: stickslip example NAME copies one, --all copies all", known)


@command(epilog=DOCS)
def docs(
    page: Annotated[
        str | None,
        typer.Argument(
            metavar="[PAGE]",
            help="Page to show; default: a list.",
            autocompletion=complete_from(lambda: runs.bundled.pages()),
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the Markdown text of the page.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show a page of the documentation: the keys of every scenario, contact laws, and files of other programs."""
    text = runs.bundled.page(page) if page else "\n".join(runs.bundled.pages())
    if as_json:
        runs.json_output.show("docs", {"pages": runs.bundled.pages(), "text": text})
    elif quiet:
        print(text)
    elif page:
        reports.terminal.show_markdown(text)
    else:
        reports.terminal.show_pairs("Pages: stickslip docs PAGE shows one", runs.bundled.pages())


@command(epilog=CITE)
def cite(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, or a run folder.")],
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No effect: only BibTeX is printed.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print BibTeX entries to cite for a run: this package, papers, contact laws, and libraries."""
    text = runs.bundled.bibtex(*runs.bundled.read_scenarios(scenario))
    if as_json:
        runs.json_output.show("cite", {"bibtex": text})
    else:
        print(text, end="")


@command(epilog=DOCTOR)
def doctor(
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the verdict.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check this installation: versions, threads, core, optional parts, and a self-check; exit code 1 if it fails."""
    from ..doctor import examine

    with reports.terminal.console_output(quiet=quiet, as_json=as_json):
        ok, text = examine(as_json=as_json)
    if as_json:
        runs.json_output.show("doctor", json.loads(text), status="finished" if ok else "failed")
    elif quiet:
        print(text)
    raise typer.Exit(0 if ok else 1)
