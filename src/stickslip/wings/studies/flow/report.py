"""Output of a flow: files, archive, terminal summary and measures."""

from functools import partial
from pathlib import Path

import numpy as np

from ....data.run_files import SERIES
from ....kit import Fields, archive_fields, console, heading, new_table, show_table, units_of, with_unit, write_table
from . import figures as figures_of
from .measures import deposit, plane_shear, profile_deviation, velocity_profile
from .pouring import Poured
from .simulate import FlowResult, FlowSeries, StageEnd

PRESSURE = "force/length^(dim-1)"


def figures(result: FlowResult):
    """Yield (file name, Figure) of a run."""
    yield "fig1_snapshots.png", figures_of.snapshots(result)
    yield "fig2_time_series.png", figures_of.time_series(result)
    if result.poured.plates or "x" in result.scenario.cell.periodic:
        profile = figures_of.velocity_profile(result.edges, velocity_profile(result), profile_deviation(result))
        yield "fig3_velocity_profile.png", profile


def files(result: FlowResult):
    """Yield (file name, function that writes it) for the time series as CSV."""
    yield SERIES, partial(_write_series, result)


def numbers(result: FlowResult) -> dict:
    """Return the contents of the archive other than scenario and version."""
    extra, shear = {}, plane_shear(result)
    if shear:
        extra["plane_shear"] = archive_fields(shear)
    tree = {
        "scenario": result.scenario.text,
        "law": result.law,
        "dt": result.poured.dt,
        "walls": "\n".join(result.poured.walls),
        "plates": result.poured.plates,
        "stages": {
            f"{k:02d}": Fields({"name": s.name, "start": s.start, "end": s.end, "rested": str(s.rested)}, StageEnd)
            for k, s in enumerate(result.stages)
        },
        "series": archive_fields(result.series),
        "profile": Fields(
            {"edges": result.edges, "velocity": velocity_profile(result)},
            FlowResult,
            velocity=units_of(FlowSeries)["profile_velocity"],
        ),
        "frame_walls": {f"{k:04d}": "\n".join(names) for k, names in enumerate(result.frame_walls)},
        "frames": {f"{k:04d}": state for k, state in enumerate(result.frames)},
        "units": "those of the scenario",
        **extra,
    }
    return Fields(tree, Poured)


def _write_series(result: FlowResult, path: Path) -> None:
    """Write a header and a row per sample.

    Vectors have columns _x, _y, _z; columns of walls and plates are prefixed with their names.
    """
    series, columns, units = result.series, {}, units_of(FlowSeries)
    bodies = {"wall": result.poured.walls, "plate": tuple(result.poured.plates)}
    for name in FlowSeries._fields:
        values, kind, unit = getattr(series, name), name.split("_")[0], units.get(name, "1")
        if kind in bodies:
            for k, body in enumerate(bodies[kind]):
                what = f"{body}_{name.split('_')[1]}".replace(",", " ")
                columns |= {heading(f"{what}_{a}", unit): values[:, k, m] for m, a in enumerate("xyz")}
        elif values.ndim == 1:
            columns[heading(name, unit)] = values
        elif name in ("center", "low", "high"):
            columns |= {heading(f"{name}_{a}", unit): values[:, m] for m, a in enumerate("xyz")}
    write_table(path, columns, zip(*columns.values(), strict=True))


def show(result: FlowResult) -> None:
    """Print the end of each stage and the measures of plane shear."""
    units = {"until": "time", "energy": "energy", "deposit along x": "length", "top": "length"}
    names = ("stage", "until", "energy", "unbalanced", "z", "deposit along x", "top")
    table = new_table(*names, title="Stages", units=units)
    series, around = result.series, "x" in result.scenario.cell.periodic
    for number, stage in enumerate(result.stages):
        k = np.flatnonzero(series.stage == number)[-1]
        left = deposit(next(f for f in result.frames if f.time == stage.end), result.poured.loose)
        table.add_row(
            stage.name, f"{stage.end:.4g}", f"{series.kinetic_energy[k]:.1e}",
            f"{series.unbalanced[k]:.1e}", f"{series.coordination[k]:.3g}",
            "periodic" if around else f"{left.low[0]:.3g} … {left.high[0]:.3g}", f"{left.high[1]:.3g}",
        )  # fmt: skip
    show_table(table)
    for stage in result.stages:
        if stage.rested is False:
            warning = (
                f"stage {stage.name!r} reached its duration before the grains came to rest: "
                "use a longer duration or more drag"
            )
            console.print(warning, style="yellow")
    if shear := plane_shear(result):
        console.print(
            f"Plane shear: friction {shear.friction:.3f} ± {shear.friction_deviation:.3f} (standard deviation in time) "
            f"at pressure {with_unit(f'{shear.pressure:.4g}', PRESSURE)}, shear rate "
            f"{with_unit(f'{shear.shear_rate:.3g}', '1/time')}, inertial number "
            f"{shear.inertial_number:.2e}, packing fraction {shear.packing_fraction:.3f}."
        )


def measures(result: FlowResult) -> dict[str, tuple[float, str]]:
    """Return {name: (value, unit)} for sweeps: the final deposit, in units of the scenario, and plane shear."""
    series, left = result.series, deposit(result.frames[-1], result.poured.loose)
    out = {
        "end": (series.time[-1], "time"),
        "kinetic_energy": (series.kinetic_energy[-1], "energy"),
        "coordination": (series.coordination[-1], "1"),
        "deposit_top": (left.high[1], "length"),
        "grains_in_deposit": (len(left.grains), "1"),
    }
    if "x" not in result.scenario.cell.periodic:
        out |= {"deposit_length": (left.high[0] - left.low[0], "length"), "run_out": (left.high[0], "length")}
    if shear := plane_shear(result):
        units = {"pressure": PRESSURE, "shear_rate": "1/time", "height": "length"}
        out |= {f"plane_{name}": (value, units.get(name, "1")) for name, value in shear._asdict().items()}
    return out
