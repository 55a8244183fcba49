"""Figures of earthquake cycles on a fault: slip profiles, maximum slip velocity, and time series at stations."""

from typing import Annotated

import numpy as np

from ....kit import BLACK, BLUE, COLORS, NOT_NEGATIVE, RED, column_axes, label_axes, require_filled, styled
from ..friction.fault_cycles import FaultHistory
from ..friction.fault_record import points
from ..friction.ranges import Positive

YEAR = 365.25 * 86400.0
MOST_CURVES = 6  # largest number of stations drawn


@styled
def slip_contours(history: FaultHistory, events: Annotated[int, NOT_NEGATIVE] | None = None):
    """Slip against depth at regular time intervals, with blue profiles outside events and red ones within events.

    Parameters
    ----------
    history : FaultHistory
    events : number of events to show, counted from the last; default: all
    """
    figure, axes = column_axes(1, 2.7)
    first = history.events.start[-events - 1] if events and events < len(history.events.start) else -np.inf
    kept = history.profile_time >= first
    depth = history.profile_depth / 1e3
    for seismic, color, label in ((False, BLUE, "between events"), (True, RED, "in events")):
        rows = history.profile_slip[kept & (history.profile_seismic == seismic)]
        lines = axes.plot(rows.T, depth, color=color, lw=0.35)
        if lines:
            gap = _interval(history.profile_time[kept & (history.profile_seismic == seismic)], seismic)
            lines[0].set_label(f"{label}, every {gap}" if gap else label)
    axes.set_ylim(depth[-1], depth[0])
    if kept.any() and np.ptp(history.profile_slip[kept]) > 0:
        axes.set_xlim(history.profile_slip[kept].min(), history.profile_slip[kept].max())
    label_axes(axes, x=("slip", "m"), y=(_axis_of(history), "km"))
    legend = figure.legend(loc="outside upper center", ncols=2)
    for line in legend.get_lines():
        line.set_linewidth(1.0)
    return figure


def _interval(times, seismic: bool) -> str:
    """Time between profiles, as text."""
    gap = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if gap <= 0:
        return ""
    return f"{gap:.3g} s" if seismic else f"{gap / YEAR:.3g} years"


@styled
def max_slip_velocity(history: FaultHistory, threshold: Positive = 1e-3):
    """Maximum slip velocity on the fault against time."""
    figure, axes = column_axes(1, 2.1)
    axes.semilogy(history.time / YEAR, history.max_velocity, color=BLUE, lw=0.6)
    axes.axhline(threshold, color=BLACK, ls="--", lw=0.6)
    axes.text(0, threshold, " events", va="bottom", fontsize=7)
    plates = history.fault.plate_rate
    if plates:
        axes.axhline(plates, color=BLACK, ls=":", lw=0.6)
        axes.text(0, plates, " plates", va="top", fontsize=7)
    axes.set_xlim(0, history.time[-1] / YEAR)
    low, high = min(plates or np.inf, history.max_velocity.min()), max(threshold, history.max_velocity.max())
    axes.set_ylim(0.05 * low, 10 * high)
    label_axes(axes, x=("time", "years"), y=("maximum slip velocity", "m/s"))
    if not len(history.events.start):
        axes.set_title(f"no event in {history.time[-1] / YEAR:.3g} years")
    return figure


@styled
def station_series(history: FaultHistory):
    """Slip velocity and shear stress at stations against time."""
    dips = history.fault.dips
    figure, axes = column_axes(2 + dips, 3.6 + 1.2 * dips, sharex=True)
    top, bottom = axes[0], axes[-1]
    for k, color in _shown(len(history.station)):
        label = f"{history.station[k] / 1e3:.3g} km"
        if dips:
            axes[1].plot(history.time / YEAR, history.normal[:, k] / 1e6, color=color, lw=0.6)
            label_axes(axes[1], y=("normal stress", "MPa"))
        top.semilogy(history.time / YEAR, history.velocity[:, k], color=color, lw=0.6, label=label)
        bottom.plot(history.time / YEAR, history.stress[:, k] / 1e6, color=color, lw=0.6)
    label_axes(top, y=("slip velocity", "m/s"))
    label_axes(bottom, x=("time", "years"), y=("shear stress", "MPa"))
    bottom.set_xlim(0, history.time[-1] / YEAR)
    _add_legend(figure, axes, _axis_of(history))
    return figure


@styled
def surface_series(history: FaultHistory):
    """Horizontal and upward displacement against time, at surface stations beside a dipping fault."""
    require_filled("history.surface", history.surface)
    figure, axes = column_axes(2, 3.6, sharex=True)
    for k, color in _shown(len(history.surface)):
        distance, side = history.surface[k], "foot wall" if history.surface[k] < 0 else "hanging wall"
        beside = abs(distance) < history.fault.cell
        label = f"0, {side}" if beside else f"{distance / 1e3:.3g} km".replace("-", "−")
        axes[0].plot(history.time / YEAR, history.horizontal[:, k], color=color, lw=0.6, label=label)
        axes[1].plot(history.time / YEAR, -history.down[:, k], color=color, lw=0.6)
    label_axes(axes[0], y=("horizontal motion", "m"))
    label_axes(axes[1], x=("time", "years"), y=("uplift", "m"))
    axes[1].set_xlim(0, history.time[-1] / YEAR)
    _add_legend(figure, axes, "distance from the trace")
    return figure


@styled
def normal_stress_series(history: FaultHistory):
    """Normal stress change and slip at stations, and the creeping part of the fault, against time."""
    figure, (top, middle, bottom) = column_axes(3, 4.8, sharex=True)
    years, fault = history.time / YEAR, history.fault
    change = history.normal - points(fault, history.station)(fault.normal)
    for k, color in _shown(len(history.station)):
        top.plot(years, change[:, k] / 1e6, color=color, lw=0.6, label=f"{history.station[k] / 1e3:.3g} km")
        middle.plot(years, history.slip[:, k], color=color, lw=0.6)
    creep = history.profile_slip - fault.plate_rate * history.profile_time[:, None]
    crept = creep >= np.interp(history.profile_depth, fault.depth, fault.dc)
    depth = np.where(crept, history.profile_depth / 1e3, np.nan)
    some = crept.any(axis=1)
    if some.any():
        low, high = np.nanmin(depth[some], axis=1), np.nanmax(depth[some], axis=1)
        bottom.fill_between(history.profile_time[some] / YEAR, low, high, color=BLUE, alpha=0.3, lw=0.6)
    label_axes(top, y=("change of σ", "MPa"))
    label_axes(middle, y=("slip", "m"))
    label_axes(bottom, x=("time", "years"), y=("slip ≥ $D_c$ at", "km"))
    bottom.set_xlim(0, years[-1])
    bottom.invert_yaxis()
    _add_legend(figure, (top, middle, bottom), "depth")
    return figure


def _axis_of(history: FaultHistory) -> str:
    return "distance down dip" if history.fault.dips else "depth"


def _shown(number: int):
    """Indices of the stations to draw, with colours."""
    shown = np.unique(np.linspace(0, number - 1, min(number, MOST_CURVES)).round().astype(int))
    return zip(shown, COLORS, strict=False)


def _add_legend(figure, axes, title: str) -> None:
    """Add the legend of the stations."""
    texts = [line.get_label() for line in axes[0].get_lines()]
    columns = min(len(texts), 6 if max(map(len, texts)) < 8 else 3)
    legend = figure.legend(title=title, loc="outside upper center", ncols=columns, columnspacing=0.8, handlelength=1.0)
    for line in legend.get_lines():
        line.set_linewidth(1.0)
    figure.align_ylabels(axes)
