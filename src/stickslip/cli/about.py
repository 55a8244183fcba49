"""Commands about the package: citations for a run, and a check of the installation."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .app import AsJson, app, examples

CITE = examples(
    ("cite examples/gouge.toml", "for a scenario; > paper.bib saves them"),
    ("cite examples/rate_state_sweep.toml --json", "the same as one JSON object"),
)
DOCTOR = examples(
    ("doctor", "a minute the first time, while kernels are compiled; seconds later"),
    ("doctor --json", "for a bug report, or to test an installation"),
)


@app.command(epilog=CITE, short_help="Print BibTeX entries to cite for a run.")
def cite(
    scenario: Annotated[Path, typer.Argument(help="A scenario in TOML, or the folder of a run's results.")],
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No effect: only BibTeX is printed.")] = False,
    as_json: AsJson = False,
) -> None:
    """Print BibTeX entries to cite for a run: this package, papers, contact laws, libraries."""
    from ..experiments.bibliography import bibtex, read_scenarios

    text = bibtex(*read_scenarios(scenario))
    if as_json:
        from ..experiments import json_output

        print(json_output.to_json(json_output.common_fields("cite") | {"bibtex": text}))
    else:
        print(text, end="")


@app.command(epilog=DOCTOR, short_help="Check this installation.")
def doctor(
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print only the verdict.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check this installation: versions, threads, caches, optional parts and a self-check; exit code 1 if it fails."""
    from ..doctor import report as doctor_report
    from ..experiments import json_output, terminal

    with terminal.console_output(quiet=quiet, as_json=as_json):
        ok, text = doctor_report.examine(as_json=as_json)
    if as_json:
        about = json_output.common_fields("doctor", status="finished" if ok else "failed")
        print(json_output.to_json(about | json.loads(text)))
    elif quiet:
        print(text)
    raise typer.Exit(0 if ok else 1)
