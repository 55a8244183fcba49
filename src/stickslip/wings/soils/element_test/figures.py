"""Figures of element tests as usual in soil mechanics; tables are dictionaries of columns, as in series.csv."""

from typing import Annotated, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import LogLocator, NullFormatter, PercentFormatter

from ....kit import (
    BLACK,
    BLUE,
    COLORS,
    PAGE,
    RED,
    WIDTH,
    Result,
    column_axes,
    label_axes,
    legend_above,
    pluralize,
    styled,
    subplots,
)
from .measures import SERIES, STRESS

HELD = 0.05  # relative range of p below which the axis does not zoom in on servo noise about a constant p
MARKS = 40  # approximate number of points marked in a laboratory test
FEW = 6  # largest number of samples distinguished by colour
DASH, MARGIN = 4.0, 0.05  # length of dashes over the line width; margin as a fraction of an axis
_Table = Annotated[Any, Result("table of a series", keys=("p", "q", "void_ratio"))]
_Probed = Annotated[Any, Result("ProbedState", ("load", "envelope"))]
_Circles = Annotated[Any, Result("Circles", ("sigma1", "sigma3", "envelope"))]
_Ends = Annotated[Any, Result("Ends", ("p", "q", "void_ratio", "critical", "line"))]
_Curve = Annotated[Any, Result("Grading", ("size", "passing", "passing_at"))]


def _axis(name: str, unit: str) -> str | tuple[str, str]:
    """Label of an axis; stresses are in the unit of the figures."""
    quantity = SERIES[name]
    return (quantity.label, unit) if quantity.unit == STRESS else quantity.axis


def _lines(axes, tables, x: str, y: str) -> None:
    """Draw one line per sample; lines of many samples are pale, with their mean if all have the same rows."""
    for k, table in enumerate(tables):
        few, label = len(tables) <= FEW, (pluralize(len(tables), "sample") if k == 0 else None)
        color, width, alpha = (COLORS[k], 0.8, 1) if few else (BLUE, 0.4, 0.4)
        axes.plot(table[x], table[y], color=color, lw=width, alpha=alpha, label=label)
    if len({len(table[x]) for table in tables}) == 1 < len(tables):
        middle = (np.mean([table[name] for table in tables], axis=0) for name in (x, y))
        axes.plot(*middle, color=BLACK, lw=1.4, label="mean")


@styled
def stress_strain(
    tables: list[_Table], strain: str, unit: str, halved: _Table | None = None, axial: str = ""
):  # fmt: skip
    """Deviatoric stress, and volumetric strain or excess pore pressure, against strain, one line per sample.

    For compression tests, void ratio against mean or axial stress.

    Parameters
    ----------
    strain : name of the column of the imposed strain
    unit : unit of stress
    halved : series of the first sample with half the step or rate
    axial : name of the column of axial stress, for an oedometric test
    """
    figure, panels = column_axes(2, 3.8, sharex=True)
    names = "q", "pore_pressure" if "pore_pressure" in tables[0] else "volumetric_strain"
    if axial or strain == "volumetric_strain":
        names = axial or "p", "void_ratio"
    for axes, name in zip(panels, names, strict=True):
        _lines(axes, tables, strain, name)
        if halved is not None:
            axes.plot(halved[strain], halved[name], "--", color=RED, label="first sample, half the step or rate")
        if name != "void_ratio":
            axes.axhline(0, color=BLACK, lw=0.4)
        label_axes(axes, y=_axis(name, unit))
    label_axes(panels[-1], x=SERIES[strain].axis)
    legend_above(panels[0])
    return figure


@styled
def stress_path(tables: list[_Table], unit: str):
    """Stress paths in the plane of mean and deviatoric stress; for undrained tests, also those of total stress."""
    figure, axes = column_axes()
    _lines(axes, tables, "p", "q")
    for k, table in enumerate(tables if "pore_pressure" in tables[0] else ()):
        label = "total stresses" if k == 0 else None
        total = table["p"] + np.sign(table["p"][0]) * table["pore_pressure"]  # p may be negative in compression
        axes.plot(total, table["q"], "--", color=BLACK, lw=0.8, label=label)
    largest = max(np.abs(table["p"]).max() for table in tables)
    label_axes(axes, x=_axis("p", unit), y=_axis("q", unit), least={"x": HELD * largest})
    legend_above(axes, ncol=3)
    return figure


@styled
def pore_pressure(tables: list[_Table], unit: str):
    """Excess pore pressure and Skempton's B against cell pressure on undrained isotropic paths."""
    figure, panels = column_axes(2, 3.8, sharex=True)
    for axes, name in zip(panels, ("pore_pressure", "skempton_B"), strict=True):
        _lines(axes, tables, "cell_pressure", name)
    label_axes(panels[0], y=_axis("pore_pressure", unit))
    label_axes(panels[1], x=_axis("cell_pressure", unit), y=SERIES["skempton_B"].axis, least={"y": 0.01})
    legend_above(panels[0])
    return figure


def _show_numbers(axes) -> None:
    """Label a logarithmic x axis of less than two decades with numbers such as 50 instead of powers."""
    if axes.get_xscale() == "log" and np.divide(*np.array(axes.get_xlim())[::-1]) < 100:
        axes.xaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())


@styled
def void_ratio(tables: list[_Table], unit: str, stress: str = "p"):
    """Void ratio against a stress, on a logarithmic axis unless the stress changes by less than a factor of 3.

    Parameters
    ----------
    stress : name of the stress column: mean stress, or axial stress in an oedometric test
    """
    figure, axes = column_axes()
    tables = [table | {stress: np.abs(table[stress])} for table in tables]
    _lines(axes, tables, stress, "void_ratio")
    low, high = (bound([bound(table[stress]) for table in tables]) for bound in (np.min, np.max))
    axes.set_xscale("log" if high > 3 * low > 0 else "linear")
    label_axes(axes, x=_axis(stress, unit), y=SERIES["void_ratio"].axis)
    _show_numbers(axes)
    legend_above(axes)
    return figure


@styled
def contacts(tables: list[_Table], strain: str):
    """Contact number, fabric anisotropy and fraction of sliding contacts against imposed strain."""
    figure, panels = column_axes(3, 4.6, sharex=True)
    for axes, name in zip(panels, ("coordination", "fabric_anisotropy", "sliding_fraction"), strict=True):
        _lines(axes, tables, strain, name)
        label_axes(axes, y=SERIES[name].axis)
    label_axes(panels[-1], x=SERIES[strain].axis)
    legend_above(panels[0])
    return figure


@styled
def broken_bonds(tables: list[_Table], strain: str, unit: str):
    """Deviatoric stress, and numbers of bonds broken in tension and in shear, against strain."""
    figure, (above, below) = column_axes(2, 3.8, sharex=True)
    _lines(above, tables, strain, "q")
    for color, mode in ((RED, "tension"), (BLUE, "shear")):
        for k, table in enumerate(tables):
            label = f"in {mode}" if k == 0 else None
            below.plot(table[strain], table[f"broken_{mode}"], color=color, drawstyle="steps-post", label=label)
    label_axes(above, y=_axis("q", unit))
    label_axes(below, x=SERIES[strain].axis, y="broken bonds")
    below.legend()
    legend_above(above)
    return figure


@styled
def grading(curve: _Curve, diameter: np.ndarray, dim: int):
    """Grading curve: passing by mass, prescribed and measured."""
    figure, axes = column_axes()
    mass = diameter**dim
    sizes = np.geomspace(curve.size[0], curve.size[-1], 200)
    axes.plot(sizes, 100 * curve.passing_at(sizes), color=BLACK, lw=1.4, label="wanted")
    axes.step(diameter, 100 * np.cumsum(mass) / mass.sum(), where="post", color=BLUE, label=f"{len(diameter)} grains")
    axes.set_xscale("log" if curve.size[-1] > 5 * curve.size[0] else "linear")
    label_axes(axes, x=("diameter", "length"), y="passing by mass")
    axes.yaxis.set_major_formatter(PercentFormatter(decimals=0))
    axes.set_ylim(0, 100)
    axes.legend(loc="upper left")
    return figure


@styled
def laboratory(tables: list[_Table], test: dict, pairs: list[tuple[str, str]], unit: str, name: str):
    """Laboratory test drawn over the samples, in one panel per pair of columns.

    Parameters
    ----------
    test : columns of the laboratory test, named like those of the samples
    pairs : names of the columns along x and y
    name : name of the laboratory test
    """
    figure, grid = subplots(1, len(pairs), figsize=(PAGE if len(pairs) > 1 else WIDTH, 2.4), squeeze=False)
    for axes, (x, y) in zip(grid.flat, pairs, strict=True):
        _lines(axes, tables, x, y)
        every = max(1, len(test[x]) // MARKS)
        axes.plot(
            test[x], test[y], "o", color=BLACK, mfc="none", mew=0.6, ms=3, ls="-", lw=0.3, markevery=every, label=name
        )
        low, high = (bound([bound(table[x]) for table in (test, *tables)]) for bound in (np.min, np.max))
        if y == "void_ratio" and high > 3 * low > 0:
            axes.set_xscale("log")
        label_axes(axes, x=_axis(x, unit), y=_axis(y, unit))
        _show_numbers(axes)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncol=len(handles))
    return figure


@styled
def mohr_circles(circles: list[_Circles], factor: float, unit: str):
    """Mohr circles with their envelopes, in one panel per state and group of members.

    Parameters
    ----------
    factor : factor that converts stresses to `unit`
    """
    groups = list(dict.fromkeys(each.group for each in circles))
    columns = 1 + any(each.state != "peak" for each in circles)
    most = 1.06 * factor * max(each.sigma1.max() for each in circles)
    high = 0.62 * factor * max((each.sigma1 - each.sigma3).max() for each in circles)
    least = min(0.0, *(-factor * each.envelope.cohesion / np.tan(np.radians(each.envelope.phi)) for each in circles
                       if each.envelope.phi > 0))  # fmt: skip
    least = min(max(least, -0.25 * most), 1.06 * factor * min(each.sigma3.min() for each in circles))
    wide = PAGE if columns > 1 else WIDTH
    panel = (wide / columns - 0.5) * high / (most - least) + 0.5
    figure, grid = subplots(
        len(groups), columns, figsize=(wide, panel * len(groups) + 0.3), sharex=True, sharey=True, squeeze=False
    )
    turn = np.linspace(0, np.pi, 181)
    for each in circles:
        axes = grid[groups.index(each.group), int(each.state != "peak")]
        order = np.argsort(each.sigma3, kind="stable")
        for k, (major, minor) in enumerate(factor * np.column_stack([each.sigma1, each.sigma3])[order]):
            middle, radius = 0.5 * (major + minor), 0.5 * (major - minor)
            color = COLORS[k] if len(order) <= FEW else BLUE
            axes.plot(middle + radius * np.cos(turn), radius * np.sin(turn), color=color, lw=0.9)
        cohesion, slope = factor * each.envelope.cohesion, np.tan(np.radians(each.envelope.phi))
        sigma = np.array([least, most])
        axes.plot(sigma, cohesion + slope * sigma, color=BLACK, lw=1.2)
        title = {"peak": "at the peak", "critical": "at the critical state"}.get(each.state, "at the end, not steady")
        lines = [f"{title}{f', {each.group}' * bool(each.group)}", each.envelope.describe(factor, unit)]
        axes.set_title("\n".join(lines))
    for axes in grid.flat:
        axes.set_aspect("equal")
        axes.set_xlim(least, most)
        axes.set_ylim(0, high)
    for axes in grid[-1]:
        label_axes(axes, x=(r"$\sigma$", unit))
    for axes in grid[:, 0]:
        label_axes(axes, y=(r"$\tau$", unit))
    return figure


@styled
def critical_state(ends: list[_Ends], unit: str):
    """Ends of the paths of a sweep in the p–q and p–e planes, with critical-state lines.

    Unsteady states are shown as open marks. Members that differ only in pressure have the same colour.
    """
    figure, (left, right) = subplots(1, 2, figsize=(PAGE, 2.6))
    for color, each in zip(COLORS, ends, strict=False):
        for axes, values in ((left, each.q), (right, each.void_ratio)):
            for rows, face, words in ((each.critical, color, "critical state"), (~each.critical, "none", "not steady")):
                label = (f"{each.group}: {words}" if each.group else words) if rows.any() else None
                axes.plot(each.p[rows], values[rows], "o", color=color, mfc=face, ms=4, label=label)
        if each.line is not None:
            p = np.geomspace(each.p.min(), each.p.max())
            left.plot([0, p[-1]], [0, each.line.ratio * p[-1]], color=color, label=f"M = {each.line.ratio:.3g}")
            right.plot(p, each.line.intercept - each.line.slope * np.log(p), color=color)
    left.set_xlim(0, None)
    left.set_ylim(0, None)
    right.set_xscale("log")
    label_axes(left, x=_axis("p", unit), y=_axis("q", unit))
    label_axes(right, x=_axis("p", unit), y=SERIES["void_ratio"].axis)
    _show_numbers(right)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncol=min(4, len(labels)))
    return figure


@styled
def failure_directions(
    probes: list[_Probed], table: _Table, strain: tuple[str, int], first: dict[str, float], names: tuple[str, str]
):
    """Friction angle and, by direction of strain, normalised second-order work along a path.

    Parameters
    ----------
    probes : probed states with envelopes
    table : series of the sample
    strain : name of the column of the imposed strain, and the sign of that strain in compression
    first : strain at which each sign of failure first appears
    names : names of the components along the two axes of the strain plane
    """
    strain, sign = strain
    figure, (above, below) = column_axes(2, 4.4, sharex=True, height_ratios=(1, 1.3))
    above.plot(table[strain], table["phi"], color=BLUE)
    for k, (name, at) in enumerate(sorted(first.items(), key=lambda one: one[1])):
        same = [other for other in first if first[other] == at]  # dashes of one sign are in the gaps of another
        dashes = DASH * same.index(name), (DASH, DASH * max(1, len(same) - 1))
        above.axvline(at, color=COLORS[1 + k % (len(COLORS) - 1)], ls=dashes, lw=1.2, label=name)
    at = sign * np.array([each.load for each in probes])
    middle = 0.5 * (at[1:] + at[:-1])
    reach = np.sign(at[-1] or 1.0) * np.ptp(table[strain]) / 40
    edges = np.concatenate([[at[0] - min([reach, *(middle - at[0])[:1]], key=abs)], middle, [at[-1] + reach]])
    envelope = probes[0].envelope
    turn = 360 / len(envelope.angle)
    rows = turn * (np.arange(len(envelope.angle) + 2) - 0.5)  # repeats the first direction at 360°
    work = np.ma.masked_invalid(np.array([each.envelope.normalised_work for each in probes]).T)
    work = np.ma.concatenate([work, work[:1]])
    shades = colormaps["RdBu"].with_extremes(bad=BLACK)
    drawn = below.pcolormesh(edges, rows, work, cmap=shades, vmin=-1, vmax=1)
    below.plot(at, np.zeros(len(at)), "|", color=BLACK, clip_on=False)
    label = r"$d\sigma:d\varepsilon/(|d\sigma||d\varepsilon|)$"
    bar = figure.colorbar(drawn, ax=below, label=label, pad=0.02)
    bar.ax.set_ylim(min(-MARGIN, float(work.min())), 1)  # colours range from −1 to 1
    label_axes(above, y=r"$\phi$ [°]")
    label_axes(below, x=SERIES[strain].axis, y=f"direction [°]: 0 is {names[0]}, 90 {names[1]}")
    below.set(yticks=range(0, 361, 90), ylim=(0, 360))
    room = np.sign(reach) * MARGIN * np.ptp(edges)
    below.set_xlim(edges[0] - room, edges[-1] + room)
    legend_above(above, ncol=1)
    return figure
