"""Figures of what follows an instability: growth at finite amplitude, and the thresholds of sliding."""

from typing import Annotated, Any

import numpy as np
from scipy.signal import find_peaks
from scipy.special import expit

from ..core.arguments import Array, Result
from ..core.state import State
from ..solve.birth import BirthForm
from .style import BLACK, BLUE, COLORS, GREEN, ORANGE, RED, column_axes, label_axes, plot_fast, power_of_ten, styled

_Load = Annotated[Any, Array((0,), finite=False)]  # NaN if it is not known
_Record = Annotated[Any, Result("Record", ("time", "position", "angle"))]
_Form = Annotated[Any, Result("BirthForm", ("growth_rate", "peak", "mode", "free"))]
_Threshold = Annotated[Any, Result("KineticThreshold", ("loads",))]


@styled
def growth_by_amplitude(form: BirthForm):
    """Growth rate of a pair against the displacement of the grain that moves most, with burst and first limit."""
    figure, axes = column_axes(1, 2.4)
    move = np.array([form.displacement(a) for a in form.amplitudes])
    seen = np.isfinite(form.rates)
    x = np.linspace(0, move[-1] if len(move) else form.displacement(form.first), 200)
    square = form.growth_rate**2 + 0.5 * form.beta * (x / form.displacement(1.0)) ** 2
    below = square > 0
    axes.plot(x[below], np.sqrt(square[below]), "--", color=ORANGE, label="third order")
    axes.plot(move[seen], form.rates[seen], ".-", color=BLUE, label="harmonic balance")
    axes.axhline(form.growth_rate, color=BLACK, lw=0.6, ls=":", label="linear")
    inside = x[-1] * 1.02 if len(x) else np.inf
    if form.displacement(form.peak) <= inside:
        axes.axvline(form.displacement(form.peak), color=GREEN, label="burst turns back")
    if form.displacement(form.first) <= inside:
        axes.axvline(form.displacement(form.first), color=RED, label="a contact is lost")
    axes.set_ylim(bottom=0)
    axes.set_xlim(0, x[-1] * 1.03)
    label_axes(axes, x=("largest displacement", "length"), y=("growth rate", "1/time"))
    axes.legend(loc="best")
    return figure


@styled
def static_and_kinetic(found: _Threshold, *, label: str = "load", strength: _Load = np.nan):
    """Shares of kicked runs that slide, and that slide on, against the load, beside the static thresholds.

    Open circles and dashed curves are runs that slid by the distance, full ones those that slid on for another
    duration; coloured bands are 95 % intervals of the loads at which half do so, and the lower panel shows the median
    time until a run had slid. The grey band contains the loads at which sliding samples stopped; `strength` is the load
    at which the sample slides by itself.
    """
    figure, (axes, below) = column_axes(2, 4.0, sharex=True, height_ratios=(3, 2))
    loads = found.loads
    top = loads[-1] if np.isnan(strength) else max(strength, loads[-1])
    x = np.linspace(loads[0], top, 400)
    for k, kick in enumerate(found.kicks):
        color = COLORS[k % len(COLORS)]
        axes.plot(loads, found.probability[:, k], "o", color=color, ms=5, mfc="none")
        axes.plot(
            loads, found.lasting_probability[:, k], "o", color=color, ms=3, label=f"kicked by {power_of_ten(kick)}"
        )
        below.plot(loads, found.lifetime[:, k], "o-", color=color, ms=3.5, lw=0.6)
        for at, interval, width, style in (
            (found.threshold[k], found.interval[k], found.width[k], "--"),
            (found.lasting_threshold[k], found.lasting_interval[k], found.lasting_width[k], "-"),
        ):
            if np.isfinite(at):
                axes.plot(x, expit((x - at) / width), style, color=color)
                axes.axvspan(*np.clip(interval, loads[0], top), color=color, alpha=0.12, lw=0)
    axes.fill_between([], [], color=BLUE, alpha=0.25, lw=0, label="half do: 95 % interval of load")
    axes.plot([], [], "o--", color=BLACK, ms=5, mfc="none", label=f"slid by {found.distance:g}")
    axes.plot([], [], "o-", color=BLACK, ms=3, label="then slid on as long again")
    if len(found.arrest):
        axes.axvspan(
            *np.clip(found.arrest_range, loads[0], top),
            color=BLACK,
            alpha=0.2,
            lw=0,
            label="sliding stops when lowered",
        )
    static = (
        (found.first_pair, "first pair", ":"), (found.first_limit, "first limit", "--"),
        (strength, "slides by itself", "-"),
    )  # fmt: skip
    for load, name, style in static:
        if x[0] <= load <= top:
            axes.axvline(load, color=BLACK, ls=style, lw=0.8, label=name)
            below.axvline(load, color=BLACK, ls=style, lw=0.8)
    axes.set_ylim(-0.03, 1.03)
    label_axes(axes, y="share of runs")
    below.set_ylim(0, 1.1 * found.duration)
    below.axhline(found.duration, color=BLACK, lw=0.5, ls=":")
    label_axes(below, x=label, y=("half have slid after\n", "time"))
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@styled
def bursts(record: _Record, state: State, form: _Form):
    """Amplitude along the mode of a pair in a free run, with the predicted envelopes of its bursts.

    Near the birth of the pair a burst has the envelope ±a₀/cosh(σ(t − t₀)), with the growth rate σ and the peak a₀ of
    the form; only the times t₀ are those of the run.
    """
    time, amplitude = record.time, along_mode(record, state, form)
    figure, (above, below) = column_axes(2, 3.4, sharex=True)
    size = np.abs(amplitude)
    apart = max(1, round(3 / form.growth_rate / (time[1] - time[0])))
    tops, _ = find_peaks(size, height=0.5 * form.peak, distance=apart)
    below.set_yscale("log")
    plot_fast(above, time, amplitude / form.peak, color=BLUE, middle=False)
    plot_fast(below, time, np.maximum(size / form.peak, 1e-12), color=BLUE, middle=False, label="run: range of $a$")
    edges = [time[0], *(0.5 * (time[tops][1:] + time[tops][:-1])), time[-1]]
    for k, top in enumerate(tops):
        t = time[(time >= edges[k]) & (time <= edges[k + 1])]
        wave = 1 / np.cosh(form.growth_rate * (t - time[top]))
        for axes, sign in ((above, 1), (above, -1), (below, 1)):
            axes.plot(
                t, sign * wave, color=RED, ls="--", lw=1.0, label=None if k or axes is above else "predicted envelope"
            )
    for sign in (-1, 1):
        above.axhline(sign, color=BLACK, ls=":", lw=0.7)
    above.set_ylim(-1.25, 1.25)
    below.set_ylim(np.clip(np.quantile(size, 0.02) / form.peak, 1e-9, 1e-2), 3)
    below.axhline(1, color=BLACK, ls=":", lw=0.7, label="predicted peak $a_0$")
    label_axes(above, y="amplitude $a/a_0$")
    label_axes(below, x=("time $t$", "time"), y="$|a|/a_0$")
    figure.legend(*below.get_legend_handles_labels(), loc="outside upper center", ncols=3, columnspacing=1.0)
    return figure


def along_mode(record, state, form) -> np.ndarray:
    """(T,) amplitude along the mode of a pair; `record` must have all grains as probes, and `state` be at rest."""
    grains, free = state.grains, form.free
    turned = (record.angle - grains.angle) * grains.radius[:, None]
    shift = np.concatenate([record.position - grains.position, turned], axis=2)
    shift = np.concatenate([shift, np.zeros((len(shift), free.bodies - len(grains.radius), 6))], axis=1)
    return shift.reshape(len(shift), -1)[:, free.component] @ (free.mass * form.mode) / 2
