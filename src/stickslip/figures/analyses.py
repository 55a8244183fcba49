"""Figures of analyses: growth, bursts and thresholds of sliding, probes, inflated grains, waves, and contact forces."""

from typing import Annotated, Any

import numpy as np
import scipy  # its submodules are imported on first use, as this takes tenths of a second
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Patch

from ..core.arguments import FILLED, Array, Result, knows_bonds
from ..core.laws.builtin import Law
from ..core.readable import pluralize
from ..core.state import State
from ..solve.birth import BirthForm
from ..solve.force_chains import (
    ForceChains,
    ForceNetwork,
    Source,
    StrongNetwork,
    force_anisotropy,
    force_chains,
    force_network,
    strong_network,
)
from ..solve.inclusion import Inflation, ScreeningFits
from ..solve.waves import Dispersion
from .grains import draw_disks
from .style import (
    BLACK,
    BLUE,
    BROKEN,
    COLORS,
    GREEN,
    ORANGE,
    PAGE,
    PURPLE,
    RED,
    SKY,
    WIDTH,
    OwnFigure,
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
MARKED = 80  # largest number of points that are drawn with markers
ROOM = 1.5  # largest factor by which an axis is extended beyond its curves to show a mark


@styled
def failure_path(found: _Failure):
    """Stress, growth rate and softest eigenvalue along the path of a packing, with events, first pair and forecasts.

    Lines are broken where the path jumps. Without a complex pair, there is no growth rate.
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
    """Growth rate of a pair against the largest displacement, with the ends of growth: a burst, or a lost contact."""
    figure, axes = column_axes(1, 2.4)
    move = np.array([form.displacement(a) for a in form.amplitudes])
    seen = np.isfinite(form.rates)
    x = np.linspace(0, move[-1] if len(move) else form.displacement(form.first), 200)
    square = form.growth_rate**2 + 0.5 * form.beta * (x / form.displacement(1.0)) ** 2
    below = square > 0
    axes.plot(x[below], np.sqrt(square[below]), "--", color=ORANGE, label="third order")
    axes.plot(move[seen], form.rates[seen], ".-", color=BLUE, label="harmonic balance")
    axes.axhline(form.growth_rate, color=BLACK, lw=0.6, ls=":", label="linear")
    end = max([*move[seen], *x[below]])  # end of the curves
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

    Open circles and dashed curves show runs that slid by `found.distance`, and filled circles and solid curves those
    that slid on for another duration. Coloured bands are 95 % intervals of the load at which half of the runs do so.
    The lower panel shows the median time until a run had slid by this distance. The grey band contains the loads at
    which sliding packings stopped; `strength` is the load at which the packing slides spontaneously.
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
                axes.plot(x, scipy.special.expit((x - at) / width), style, color=color)
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
    tops, _ = scipy.signal.find_peaks(size, height=0.5 * form.peak, distance=apart)
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
    """(T,) amplitude along the mode of a pair; `record` must have all grains as probes, and `state` must be at rest."""
    grains, free = state.grains, form.free
    turned = (record.angle - grains.angle) * grains.radius[:, None]
    shift = np.concatenate([record.position - grains.position, turned], axis=2)
    shift = np.concatenate([shift, np.zeros((len(shift), free.bodies - len(grains.radius), 6))], axis=1)
    return shift.reshape(len(shift), -1)[:, free.component] @ (free.mass * form.mode) / 2


@styled
def response_envelopes(
    envelopes: Annotated[list[_Envelope] | tuple[_Envelope, ...], FILLED],
    labels: list[str] | tuple[str, ...] = (),
    names: tuple[str, str] = ("yy", "xx"),
):
    """Responses of several states to probes in one plane: stress per unit strain, and second-order work by direction.

    Dashed curves are the elastic part, the response if no contact slides. Red bands mark directions of strain with
    negative second-order work.

    Parameters
    ----------
    envelopes : results of `protocols.response_envelope` with control="strain"
    labels : one label for each state
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
    """Displacements around an inflated grain, with fits of elasticity and screening, and the prediction of the moduli.

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


GREY, PALER, PALE, SAND = "#b4bac0", "#d3d8dd", "#eef1f4", "#f8dfae"
HEIGHT = 5.6  # inches
FEW, MANY = 6, 24  # smallest and largest numbers of bins of a distribution, and of half the rose
MOST = 5.0  # multiple of the mean force above which lines do not get thicker
SLAB = 30.0  # for spheres, largest angle between the plane of the rose and contacts counted in it [degrees]


@styled
@knows_bonds
def forces(source: Source, law: Law | None = None, *, title: str = ""):
    """Contact forces: distribution, lengths of force chains, strong network, and a rose of contacts and normal forces.

    Pairs that pull, such as bonded ones, are counted and drawn separately. Networks of spheres are viewed along the
    intermediate principal stress; their rose counts contacts within 30° of the plane of the other principal stresses.
    Curves in the rose follow from the anisotropies of `measure.force_anisotropy`.

    Parameters
    ----------
    source : accepted state, or measured forces from `io.read_forces`
    law : contact law of the state; None for measured forces
    """
    net = force_network(source, law)
    if not _is_enough(net):
        raise ValueError(
            f"the figure needs at least {FEW} contacts of grains under compression, got "
            f"{pluralize(np.count_nonzero(net.inner), 'contact')} with a mean normal force of "
            f"{net.force_n.mean() if len(net.force_n) else 0:.3g}"
        )
    chains, strong = force_chains(source, law), strong_network(source, law)
    pulled = force_chains(source, law, tension=True) if (net.force_n < 0).any() else None
    figure = OwnFigure(figsize=(PAGE, HEIGHT), layout="constrained")
    distribution, lengths = figure.add_subplot(2, 2, 1), figure.add_subplot(2, 2, 2)
    network, rose = figure.add_subplot(2, 2, 3), figure.add_subplot(2, 2, 4, projection="polar")
    plane = np.eye(3)[:2]  # directions to the right and up: x and y of disks
    if net.dim == 3:  # axes of the smallest and largest stress
        stress = net.force.T @ net.branch
        axes = np.linalg.eigh(stress + stress.T)[1][:, [0, 2]].T
        plane = axes * np.where(axes[np.arange(2), np.argmax(np.abs(axes), axis=1)] < 0, -1.0, 1.0)[:, None]
    _draw_distribution(distribution, net)
    _draw_lengths(lengths, chains, pulled)
    _draw_network(network, net, strong, chains, plane)
    _draw_rose(rose, net, force_anisotropy(source, law), plane)
    if title:
        figure.suptitle(title, fontsize=8)
    return figure


def enough_contacts(source: Source, law: Law | None = None) -> bool:
    """Return True if there are enough contacts for the figure, and their normal forces add up to a compression."""
    return _is_enough(force_network(source, law))


def _is_enough(net: ForceNetwork) -> bool:
    return np.count_nonzero(net.inner) >= FEW and net.force_n[net.inner].sum() > 0


def _draw_distribution(axes, net: ForceNetwork) -> None:
    mean, least, pulls = net.mean, np.inf, net.force_n < 0
    parts = (
        (net.force_n[~pulls] / mean, "normal", BLUE, "o"), (-net.force_n[pulls] / mean, "pulling", PURPLE, "^"),
        (np.linalg.norm(net.tangential, axis=1) / mean, "tangential", RED, "s"),
    )  # fmt: skip
    for values, name, color, marker in parts:
        if not values.any():
            continue
        number, edges = np.histogram(values, bins=int(np.clip(np.sqrt(len(values)), FEW, MANY)))
        density, seen = number / (len(values) * np.diff(edges)), number > 0
        error, least = density / np.sqrt(np.maximum(number, 1)), min(least, density[seen].min())
        axes.errorbar(
            ((edges[1:] + edges[:-1]) / 2)[seen], density[seen], error[seen], color=color, marker=marker, lw=0.8,
            elinewidth=0.5, label=f"{name}, {len(values)} contacts",
        )  # fmt: skip
    axes.set_yscale("log", nonpositive="clip")
    axes.set_ylim(bottom=0.4 * least)
    axes.set_xlim(left=0)
    axes.legend(loc="upper right")
    label_axes(axes, x=r"contact force $f/\langle f_n\rangle$", y="probability density $P$")


def _draw_lengths(axes, chains: ForceChains, pulled: ForceChains | None) -> None:
    count, share = len(chains.lengths), chains.lengths.sum() / max(chains.loaded.sum(), 1)
    if not count:
        axes.text(0.5, 0.5, "no chains of three or more grains", ha="center", va="center", transform=axes.transAxes)
        axes.set(xlim=(3, 10), ylim=(0, 1))
    else:
        length = np.arange(3, chains.lengths.max() + 1)
        longer = np.array([(chains.lengths >= k).sum() for k in length])
        axes.plot(length, longer / count, "o-", color=BLUE, lw=0.8, label=pluralize(count, "chain"))
        if (mean := chains.lengths.mean()) > 3:
            fit = (1 - 1 / (mean - 2)) ** (length - 3)  # geometric, from the shortest length
            axes.plot(length, fit, color=BLACK, ls="--", lw=0.8, label=f"exponential, mean {mean:.3g} grains")
        if pulled is not None and (most := len(pulled.lengths)):
            length = np.arange(3, pulled.lengths.max() + 1)
            longer = np.array([(pulled.lengths >= k).sum() for k in length])
            axes.plot(length, longer / most, "^-", color=PURPLE, lw=0.8, label=f"{pluralize(most, 'chain')} in tension")
            count = max(count, most)
        axes.set_yscale("log")
        axes.set_ylim(0.5 / count, 1.5)
        legend_above(axes, title=f"in chains: {100 * share:.0f} % of the loaded grains")
    label_axes(axes, x="length of a force chain, $L$ [grains]", y="fraction of chains at least as long", whole="x")


def _draw_network(axes, net: ForceNetwork, strong: StrongNetwork, chains: ForceChains, plane: np.ndarray) -> None:
    position = net.position @ plane.T
    chained = np.isin(np.arange(len(net.radius)), np.concatenate([*chains.chains, np.zeros(0, int)]))
    if net.dim == 2:
        colors = np.where(chained, SAND, PALE)
        draw_disks(axes, position, net.radius, facecolors=colors, edgecolors="0.75", linewidths=0.2, zorder=1)
    start, reach = position[net.pair_i], net.branch @ plane.T
    size, pulls = np.clip(np.abs(net.force_n) / net.mean, 0.1, MOST), net.force_n < 0
    room = 72 * min(PAGE / 2, HEIGHT / 2) * 0.8 / max(np.ptp(position, axis=0).max(), 2 * net.radius.max())
    thick = float(np.clip({2: 0.35, 3: 0.12}[net.dim] * room * np.median(net.radius), 0.15, 1.2))
    grains, inner = len(net.radius), net.inner
    for rows, color, order, name in (
        (~strong.strong & ~pulls, GREY, 2, "below the mean"),
        (strong.strong & ~strong.cluster, BLUE, 3, "above it, other clusters"),
        (strong.cluster, RED, 4, f"above it, cluster of {len(strong.grains)} of {grains} grains"),
        *([(pulls, PURPLE, 3, "pulling")] if pulls.any() else []),
    ):
        ends = [np.stack([start[rows], start[rows] - reach[rows] / 2], axis=1)]  # halves of lines, as images may be far
        if (other := rows & inner).any():
            far = position[net.pair_j[other]]
            ends.append(np.stack([far, far + reach[other] / 2], axis=1))
        width = thick * np.concatenate([size[rows], size[other]])[: sum(map(len, ends))]
        axes.add_collection(LineCollection(np.concatenate(ends), linewidths=width, colors=color, zorder=order))
        axes.plot([], [], color=color, lw=1.5, label=f"{name}")
    low, high = (position - net.radius[:, None]).min(axis=0), (position + net.radius[:, None]).max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.plot([], [], ls="", marker="o", mfc=SAND, mec="0.6", ms=5, label="grain in a chain") if net.dim == 2 else None
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncol=2, columnspacing=1.0, handlelength=1.2)
    axes.set(xticks=[], yticks=[])
    if net.dim == 3:
        axes.set_title("viewed along the intermediate principal stress")


def _draw_rose(axes, net: ForceNetwork, found, plane: np.ndarray) -> None:
    rows = np.flatnonzero(net.inner)
    flat = net.normal[rows] @ plane.T
    near = np.linalg.norm(flat, axis=1) >= np.cos(np.deg2rad(SLAB if net.dim == 3 else 90.0))
    angle, force = np.arctan2(flat[near, 1], flat[near, 0]) % np.pi, net.force_n[rows][near]
    bins = int(np.clip(2 * round(np.sqrt(len(angle)) / 2), FEW, MANY - MANY % 2))
    edges = np.linspace(0, np.pi, bins + 1)
    number = np.histogram(angle, edges)[0]
    mean = np.histogram(angle, edges, weights=force)[0] / np.maximum(number, 1)
    middle = (edges[1:] + edges[:-1]) / 2
    contacts, normal = bins * number / max(len(angle), 1), mean / (mean[number > 0].mean() if len(angle) else 1.0)
    around = np.concatenate([middle, middle + np.pi])
    axes.bar(around, np.tile(contacts, 2), width=np.pi / bins, color=PALER, edgecolor=PALER, lw=0.3, label="contacts")
    axes.plot(np.append(around, around[0]), np.append(np.tile(normal, 2), normal[0]), "o-", color=BLUE, ms=2, lw=0.7,
              label="normal force")  # fmt: skip
    if net.dim == 2:
        turn = np.linspace(0, 2 * np.pi, 181)
        for a, axis, color, name in (
            (found.contacts, found.contact_axis, BLACK, "$1 + a_c\\cos 2(\\theta - \\theta_c)$"),
            (found.normal, found.normal_axis, ORANGE, "$1 + a_n\\cos 2(\\theta - \\theta_n)$"),
        ):
            axes.plot(turn, np.maximum(1 + a * np.cos(2 * (turn - np.arctan2(axis[1], axis[0]))), 0), color=color,
                      lw=1.0, label=name)  # fmt: skip
    axes.set_yticks([1.0], labels=[""])
    axes.plot([], [], color="0.6", lw=0.5, label="mean")
    axes.set_xticks(np.deg2rad(np.arange(0, 360, 45)))
    axes.tick_params(labelsize=7)
    axes.grid(lw=0.5, color="0.6")
    axes.set_axisbelow(False)
    axes.set_title(
        f"$a_c$ = {found.contacts:.2f},  $a_n$ = {found.normal:.2f},  $a_t$ = {found.tangential:.2f}", pad=12
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncol=3, columnspacing=1.0, handlelength=1.2)
