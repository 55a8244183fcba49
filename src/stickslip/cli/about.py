"""Commands about the package: what a run rests on, and whether this installation is sound."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .app import AsJson, app, examples

CITE = examples(
    ("cite examples/gouge.toml", "of a scenario; > paper.bib keeps them"),
    ("cite examples/rate_state_sweep.toml --json", "the same as one object"),
)
DOCTOR = examples(
    ("doctor", "the first time a minute, while kernels are compiled; later seconds"),
    ("doctor --json", "for a bug report, or a test of an installation"),
)


@app.command(epilog=CITE, short_help="BibTeX of what a run rests on.")
def cite(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, or the folder of a run's results.")],
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="As ever: BibTeX alone.")] = False,
    as_json: AsJson = False,
) -> None:
    """BibTeX of what a run rests on: this package, papers, laws, libraries."""
    from ..experiments.bibliography import bibtex, scenarios_of

    text = bibtex(*scenarios_of(scenario))
    if as_json:
        from ..experiments import json_output

        print(json_output.text(json_output.common("cite") | {"bibtex": text}))
    else:
        print(text, end="")


@app.command(epilog=DOCTOR, short_help="Is this installation sound?")
def doctor(
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the verdict alone.")] = False,
    as_json: AsJson = False,
) -> None:
    """Is this installation sound? Versions, threads, caches, optional parts, a self-check; exit code 1 if it fails."""
    from ..doctor import report as examined
    from ..experiments import json_output, terminal

    with terminal.speaking(quiet=quiet, as_json=as_json):
        ok, told = examined.examine(as_json=as_json)
    if as_json:
        about = json_output.common("doctor", status="finished" if ok else "failed")
        print(json_output.text(about | json.loads(told)))
    elif quiet:
        print(told)
    raise typer.Exit(0 if ok else 1)
