"""Figures of analyses: growth, bursts and thresholds of sliding, probes, inflated grains, waves."""

from typing import Annotated, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from scipy.signal import find_peaks
from scipy.special import expit

from ..core.arguments import Array, Requirement, Result, require_filled
from ..core.state import State
from ..solve.birth import BirthForm
from ..solve.inclusion import Inflation, ScreeningFits
from ..solve.waves import Dispersion
from .style import (
    BLACK,
    BLUE,
    BROKEN,
    COLORS,
    GREEN,
    ORANGE,
    PAGE,
    RED,
    SKY,
    WIDTH,
    column_axes,
    label_axes,
    legend_above,
    plot_fast,
    power_of_ten,
    styled,
    subplots,
)

CONE = {"color": RED, "alpha": 0.15, "lw": 0}  # directions in which second-order work is negative
_Load = Annotated[Any, Array((0,), finite=False)]  # NaN if it is not known
_Record = Annotated[Any, Result("Record", ("time", "position", "angle"))]
_Form = Annotated[Any, Result("BirthForm", ("growth_rate", "peak", "mode", "free"))]
_Threshold = Annotated[Any, Result("KineticThreshold", ("loads",))]
_Failure = Annotated[Any, Result("Failure", ("steps", "events", "onset", "forecasts", "sign"))]
_Envelope = Annotated[Any, Result("Envelope", ("angle", "plane", "strain", "stress", "elastic"))]
LOOK = {"elastic": (SKY, "-", 4.0), "dipole": (GREEN, "-", 2.0), "odd": (RED, ":", 1.4)}  # visible where they coincide
MARKED = 80  # number of points up to which each has a marker
ROOM = 1.5  # length of an axis over that of its curves up to which a mark beyond them is drawn


@styled
def failure_path(found: _Failure):
    """Stress, growth rate and softest eigenvalue along the path of a packing, with events, first pair and forecasts.

    Lines are broken where the path jumps. Without a complex pair there is no growth rate.
    """
    steps, word = found.steps, {"isotropic": "pressure\n", "uniaxial": "$\\sigma_{yy}$\n"}
    strain, stress, growth, soft, pairs = (
        np.array([getattr(step, name) for step in steps]) for name in ("strain", "stress", "growth", "softest", "pairs")
    )
    stress_unit = "force/length" if steps[0].state.cell.dim == 2 else "force/length^2"
    rows = [(stress, BLUE, (word.get(found.mode, "shear stress\n"), stress_unit))]
    rows += [(np.where(pairs > 0, growth, 0.0), SKY, ("growth rate\n", "1/time"))] if pairs.any() else []
    rows += [(soft, GREEN, ("softest real $\\lambda$\n", "1/time^2"))]
    figure, panels = column_axes(len(rows), 0.6 + 1.6 * len(rows), sharex=True)
    jumps = [k for k, step in enumerate(steps) if step.events]
    broken = {
        name: np.insert(x, jumps, np.nan) for name, x in (("strain", strain), *((k, r[0]) for k, r in enumerate(rows)))
    }
    for k, (axes, (value, color, label)) in enumerate(zip(panels, rows, strict=True)):
        axes.plot(broken["strain"], broken[k], marker="." if len(strain) <= MARKED else None, ms=3, color=color)
        for name, color, events in (
            ("event", RED, [e for e in found.events if not len(e.broken)]),
            ("bond breaks", BROKEN, [e for e in found.events if len(e.broken)]),
        ):
            for first, event in enumerate(events):
                axes.axvline(event.strain, color=color, lw=0.8, label=None if first else name)
        if found.onset:
            axes.axvline(found.onset.load, color=ORANGE, ls="--", lw=0.8, label="first pair")
        for one in found.forecasts:
            color = RED if one.of == "event" else ORANGE
            axes.axvspan(one.low, one.high, color=color, alpha=0.15, lw=0, label=f"next {one.of}, 80 %")
            axes.axvline(one.strain, color=color, ls=":", lw=0.8)
        if k:
            finite = value[np.isfinite(value)]
            axes.set_ylim(min(0.0, 1.08 * finite.min(initial=0.0)), 1.08 * finite.max(initial=0.0) or None)
        label_axes(axes, y=label)
    ends = np.array([strain.min(), strain.max(), *(end for one in found.forecasts for end in (one.low, one.high))])
    room = 1.5 * np.ptp(strain)  # a wide interval is cut off at half the length of the path
    first, last = max(ends.min(), strain.max() - room), min(ends.max(), strain.min() + room)
    if last > first:
        panels[-1].set_xlim(first - 0.03 * (last - first), last + 0.03 * (last - first))
    label_axes(panels[-1], x=r"strain $\gamma$" if found.mode in ("simple", "pure") else r"strain $\varepsilon$")
    legend_above(panels[0])
    return figure


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
    end = max([*move[seen], *x[below]])  # of the curves
    for amplitude, color, label in ((form.peak, GREEN, "burst turns back"), (form.first, RED, "a contact is lost")):
        at = form.displacement(amplitude)
        if at <= ROOM * end:
            axes.axvline(at, color=color, label=label)
            end = max(end, at)
    axes.set_ylim(bottom=0)
    axes.set_xlim(0, 1.05 * end)
    label_axes(axes, x=("largest displacement", "length"), y=("growth rate\n", "1/time"))
    axes.legend(loc="best")
    return figure


@styled
def static_and_kinetic(found: _Threshold, *, label: str = "load", strength: _Load = np.nan):
    """Shares of kicked runs that slide, and that keep sliding, against the load, with the static thresholds.

    Open circles and dashed curves: runs that slid by the distance; full ones: runs that slid on for another duration.
    Coloured bands are 95 % intervals of the load at which half of the runs do so. The lower panel shows the median time
    until a run had slid. The grey band contains the loads at which sliding samples stopped; `strength` is the load at
    which the sample slides spontaneously.
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
    axes.fill_between([], [], color=BLUE, alpha=0.25, lw=0, label="load at which half slide, 95 %")
    axes.plot([], [], "o--", color=BLACK, ms=5, mfc="none", label=f"slid by {found.distance:g}")
    axes.plot([], [], "o-", color=BLACK, ms=3, label="slid for as long again")
    if len(found.arrest):
        axes.axvspan(
            *np.clip(found.arrest_range, loads[0], top), color=BLACK, alpha=0.2, lw=0, label="stops at a lower load"
        )
    static = (
        (found.first_pair, "first pair", ":"), (found.first_limit, "first limit", "--"),
        (strength, "slides spontaneously", "-"),
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

    Near the birth of the pair, a burst has the envelope ±a₀/cosh(σ(t − t₀)), with growth rate σ and peak a₀ from the
    normal form; only the times t₀ are taken from the run.
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
    figure.legend(
        *below.get_legend_handles_labels(), loc="outside upper center", ncols=3, columnspacing=0.8, handlelength=1.4
    )
    return figure


def along_mode(record, state, form) -> np.ndarray:
    """(T,) amplitude along the mode of a pair; `record` must have all grains as probes, and `state` be at rest."""
    grains, free = state.grains, form.free
    turned = (record.angle - grains.angle) * grains.radius[:, None]
    shift = np.concatenate([record.position - grains.position, turned], axis=2)
    shift = np.concatenate([shift, np.zeros((len(shift), free.bodies - len(grains.radius), 6))], axis=1)
    return shift.reshape(len(shift), -1)[:, free.component] @ (free.mass * form.mode) / 2


@styled
def response_envelopes(
    envelopes: Annotated[list[_Envelope] | tuple[_Envelope, ...], Requirement(require_filled)],
    labels: list[str] | tuple[str, ...] = (),
    names: tuple[str, str] = ("yy", "xx"),
):
    """Responses of several states to probes in one plane: stress per unit strain, and second-order work by direction.

    Dashed curves are the elastic part, the response if no contact slides. Red bands are directions of strain with
    negative second-order work.

    Parameters
    ----------
    envelopes : results of `protocols.response_envelope` with control="strain"
    labels : one for each
    names : components along the two axes of the plane
    """
    figure, (left, right) = subplots(1, 2, figsize=(PAGE, 3.0))
    closed = [np.append(np.arange(len(e.angle)), 0) for e in envelopes]
    for k, (envelope, rows) in enumerate(zip(envelopes, closed, strict=True)):
        color, label = COLORS[k % len(COLORS)], labels[k] if k < len(labels) else None
        left.plot(*envelope.components("elastic")[rows, ::-1].T, "--", color=color, lw=0.6)
        left.plot(*envelope.components("stress")[rows, ::-1].T, color=color)
        angle = np.degrees(np.append(envelope.angle, 2 * np.pi))
        right.plot(angle, envelope.normalised_work[rows], color=color, label=label)
        for begin, end in np.degrees(envelope.cones):
            for turn in (0, 360):
                right.axvspan(begin + turn, end + turn, **CONE)
    left.axhline(0, color=BLACK, lw=0.4)
    left.axvline(0, color=BLACK, lw=0.4)
    left.set_aspect("equal", "datalim")
    unit = "force/length" if envelopes[0].stress.shape[-1] == 2 else "force/length^2"
    label_axes(left, **{k: (f"dσ/|dε| along {name}", unit) for k, name in zip("yx", names, strict=True)})
    right.axhline(0, color=BLACK, lw=0.4)
    right.set(xlim=(0, 360), xticks=range(0, 361, 90), ylabel="dσ:dε/(|dσ||dε|)")
    right.set_xlabel(f"direction of the strain [°]: 0 is {names[0]}, 90 is {names[1]}")
    left.plot([], [], color=BLACK, label="response")
    left.plot([], [], "--", color=BLACK, lw=0.6, label="elastic part: no contact slides")
    handles, words = (a + b for a, b in zip(*map(Axes.get_legend_handles_labels, (right, left)), strict=True))
    if any(envelope.cones for envelope in envelopes):
        handles, words = [*handles, Patch(**CONE)], [*words, "second-order work is negative"]
    figure.legend(handles, words, loc="outside upper center", ncols=min(4, len(words)))
    return figure


@styled
def inclusion(field: Inflation, fits: ScreeningFits | None = None):
    """Radial and tangential displacements around an inflated grain, with elasticity, screening and the moduli.

    Bars are standard errors.

    Parameters
    ----------
    field : from `modes.inflate` or `protocols.inflate`
    fits : `field.fit()` unless given
    """
    fits = field.fit() if fits is None else fits
    rings, size, diameter = fits.rings, 1 / (field.growth * field.diameter), field.diameter
    figure, panels = subplots(1, len(rings.mean), figsize=((WIDTH, PAGE)[len(rings.mean) > 1], 2.7), squeeze=False)
    r = np.linspace(rings.radius[0], rings.radius[-1], 300)
    for k, (axes, name) in enumerate(zip(panels[0], ("radial", "tangential"), strict=False)):
        mean, error = size * rings.mean[k], size * rings.error[k]
        axes.errorbar(rings.radius / diameter, mean, error, fmt="o", color=BLACK, label="grains", zorder=3)
        for fit in fits.models:
            color, dashes, width = LOOK[fit.model]
            w = size * fit.displacement(r)
            axes.plot(r / diameter, (w.real, w.imag)[k], dashes, color=color, lw=width, label=fit.model)
        if k == 0 and np.isfinite(fits.lame):
            line = size * field.elastic(r)
            axes.plot(r / diameter, line, "--", color=BLACK, lw=0.7, label="elastic, from the moduli")
        axes.axhline(0, color=BLACK, lw=0.4)
        unit = "mean diameters"
        label_axes(axes, x=("distance", unit), y=(f"{name} displacement\nover growth", unit))
    panels[0, 0].legend()
    return figure


@styled
def dispersion(waves: Dispersion, speeds: np.ndarray | None = None):
    """Frequency and damping of each branch against the length of the wave vector.

    Parameters
    ----------
    waves : from `modes.dispersion`
    speeds : (K, dim) from `modes.elastic_speeds` for these wave vectors, drawn as lines ω = c k with the mean speeds c
    """
    if speeds is not None and (speeds.ndim != 2 or not len(speeds)):
        raise ValueError(f"speeds must have shape (K, dim), as from `elastic_speeds`, got {speeds.shape}")
    figure, (left, right) = subplots(1, 2, figsize=(PAGE, 3.0))
    k, names = np.linalg.norm(waves.wavevector, axis=1), waves.names
    order, kinds = np.argsort(k, kind="stable"), list(dict.fromkeys(names))
    for name, marker in zip(kinds, "os^", strict=True):
        color, columns = COLORS[kinds.index(name)], np.flatnonzero(np.array(names) == name)
        for axes, values in ((left, waves.frequency), (right, waves.damping)):
            lines = axes.plot(k[order], values[order][:, columns], marker, ms=3.5, color=color)
            lines[0].set_label(name)
        if speeds is not None and columns[0] < speeds.shape[1]:
            for c in np.unique(speeds[:, columns].mean(axis=0)):
                left.plot([0, k.max()], [0, c * k.max()], color=color, lw=0.8)
    label_axes(left, x=("wave number k", "1/length"), y=("frequency ω", "1/time"))
    label_axes(right, x=("wave number k", "1/length"), y=("damping −Re s", "1/time"))
    for axes in (left, right):
        axes.set_xlim(0, None)
        axes.set_ylim(min(0, axes.get_ylim()[0]) if axes is right else 0, None)
    left.legend()
    return figure
