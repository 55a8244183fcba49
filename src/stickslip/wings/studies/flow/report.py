"""Output of a flow: files, archive, terminal summary and measures."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....kit import (
    Fields,
    Measures,
    Quantity,
    archive_fields,
    console,
    heading,
    new_table,
    show_table,
    units_of,
    with_unit,
    write_table,
)
from . import figures as figures_of
from .measures import Deposit, PlaneShear, deposit, plane_shear, profile_deviation, velocity_profile
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
    yield "series.csv", partial(_write_series, result)


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


class Flow(NamedTuple):
    """Result of a flow with its final deposit and its plane shear: the subject of `MEASURES`."""

    series: FlowSeries
    deposit: Deposit
    shear: PlaneShear | None
    around: bool  # whether the cell is periodic along x, so that the deposit has no ends


def _of_shear(name: str, meaning: str, unit: str = "1") -> Quantity:
    return Quantity(f"plane_{name}", unit, meaning, lambda flow: getattr(flow.shear, name, None))


MEASURES = Measures([
    Quantity("end", "time", "end of the last stage", lambda flow: flow.series.time[-1]),
    Quantity("kinetic_energy", "energy", "kinetic energy at the end", lambda flow: flow.series.kinetic_energy[-1]),
    Quantity("coordination", "1", "mean contact number at the end", lambda flow: flow.series.coordination[-1]),
    Quantity("deposit_top", "length", "height of the deposit", lambda flow: flow.deposit.high[1]),
    Quantity("grains_in_deposit", "1", "grains in the deposit", lambda flow: len(flow.deposit.grains)),
    Quantity("deposit_length", "length", "length of the deposit along x, unless the cell is periodic",
             lambda flow: None if flow.around else flow.deposit.high[0] - flow.deposit.low[0]),
    Quantity("run_out", "length", "largest x of the deposit", lambda f: None if f.around else f.deposit.high[0]),
    _of_shear("friction", "shear over normal force on the upper of two plates"),
    _of_shear("friction_deviation", "standard deviation of it in time"),
    _of_shear("pressure", "normal force over the area of the plate", PRESSURE),
    _of_shear("shear_rate", "relative velocity of the plates over their distance", "1/time"),
    _of_shear("inertial_number", "inertial number between the plates"),
    _of_shear("packing_fraction", "packing fraction between the plates"),
    _of_shear("height", "distance of the plates", "length"),
], subject=lambda r: Flow(r.series, deposit(r.frames[-1], r.poured.loose), plane_shear(r),
                          "x" in r.scenario.cell.periodic))  # fmt: skip
