"""Commands that read a laboratory record."""

import json
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from ...kit import FigureOptions, Out, Output, check_choice, command, examples

LAWS = {
    "aging": "heals with time at rest (Dieterich)", "slip": "evolves only with slip (Ruina)",
    "both": "both laws, and the preferred one",
}  # fmt: skip
FORMS = {"logarithmic": "the usual form", "regularized": "with arcsinh, regular at rest"}
FIT = examples(
    ("run examples/rate_state.toml --out results/rate-state", "makes a record to fit; any other CSV will do"),
    ("fit results/rate-state/series.csv --stiffness 200", "both laws, and the preferred one"),
    ("fit results/rate-state/series.csv --stiffness 200 --json", "the same as one JSON object"),
    ("fit results/rate-state/series.csv --stiffness 200 --posterior", "also the posterior of the preferred law"),
)


class ModelOptions(NamedTuple):
    """Options of the fitted law."""

    law: Annotated[str, "aging, slip or both.", LAWS] = "both"
    stiffness: Annotated[float | None, "Known stiffness, as friction per displacement [1/m]."] = None
    free_stiffness: Annotated[bool, "Also fit the stiffness."] = False
    v0: Annotated[float | None, "Velocity at which friction is mu0; default: the first velocity [m/s]."] = None
    before: Annotated[float | None, "Slip velocity before the record starts [m/s]."] = None
    detrend: Annotated[bool, "Also fit a trend, linear in displacement."] = False
    normal: Annotated[bool, "Include measured changes of normal stress."] = False
    form: Annotated[str, "logarithmic or regularized.", FORMS] = "logarithmic"
    free: Annotated[str | None, "Also fit these: 'b2,dc2' (a second state), 'v1', 'trend_length', 'drift' …"] = None

    def fixed_values(self) -> dict[str, float]:
        """Values of the fixed parameters, by name."""
        return {name: getattr(self, name) for name in ("stiffness", "v0") if getattr(self, name) is not None}

    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters fitted in addition to the usual ones."""
        names = ["stiffness"] * self.free_stiffness + ["trend"] * self.detrend
        names += [name.strip() for name in self.free.split(",")] if self.free else []
        return tuple(dict.fromkeys(names))


@command(epilog=FIT)
def fit(
    *,
    file: Annotated[Path, typer.Argument(help="A record as text, HDF5, MATLAB or XLOOK: time [s], load_point [um], …")],
    model: ModelOptions,
    columns: Annotated[str | None, "Columns by number or heading: 'time=0,friction=F/N'."] = None,
    velocity: Annotated[str | None, "Velocities of the load point: '1e-6 until 120 s, then 10 um/s'."] = None,
    posterior: Annotated[bool, "Also sample the posterior: percentiles, draws, corner plot."] = False,
    steps: Annotated[int, "Longest chain of --posterior."] = 4000,
    out: Out = None,
    overwrite: Annotated[bool, "Replace an earlier fit in the folder."] = False,
    drawing: FigureOptions,
    output: Output,
) -> None:
    """Fit rate-and-state friction to a record: a, b, D_c and more with intervals, and the preferred law."""
    check_choice("law", model.law, LAWS)
    check_choice("form", model.form, FORMS)
    from ...kit import json_output, terminal
    from .rate_state import fit_report

    look = drawing.look()
    if out is not None:
        fit_report.check_folder(out, overwrite)
    with terminal.console_output(*output):
        result = fit_report.fit_record(
            file, laws=("aging", "slip") if model.law == "both" else (model.law,), fixed=model.fixed_values(),
            free=model.free_names(), before=model.before, normal=model.normal, columns=columns, form=model.form,
            steps=steps if posterior else None, velocity=velocity,
        )  # fmt: skip
    paths = fit_report.write(out, result, look) if out else []
    if output.as_json:
        json_output.show("fit", json.loads(fit_report.as_json(result)), files=paths, folder=out)
    elif output.quiet:
        print("\n".join(fit_report.conclusions(result)))
    else:
        fit_report.show(result)
        if paths:
            terminal.show_paths(paths)
        elif posterior:
            terminal.show_lines(("Give --out FOLDER for the draws and the figure of the posterior.",))
