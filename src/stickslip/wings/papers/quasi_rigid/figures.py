"""Figures of quasi-rigid loading (McNamara & Herrmann 2006): curves, contact forces, stiffness and errors."""

from itertools import cycle
from typing import Annotated, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from .... import State
from ....control import spring_forces
from ....kit import (
    FILLED,
    Committed,
    Result,
    bare_frame,
    body_positions,
    checked,
    contact_segments,
    layout_of,
    require_index,
    require_shape,
    start_drawing,
    style,
)

_KIND = "sample of a QuasiResult"
_WithCurve = Annotated[Any, Result(_KIND, ("curve", "path", "slow", "back"))]
SHOWN = 6  # number of contacts shown in the cone
GREY = "#bbbbbb"
ENDS = {True: "x", False: "o"}  # markers of path ends: True if stability is lost there
ENDS_WORDS = {True: "stability is lost", False: "ends for another reason"}
COLORS = (
    style.BLUE,
    style.ORANGE,
    style.GREEN,
    style.RED,
    style.PURPLE,
    style.SKY,
    style.BLACK,
)  # colours of samples, with contrast between neighbours


@style.styled
def curves(tested: Annotated[list[_WithCurve], FILLED], test: str):
    """Stress ratio and volumetric strain against strain, for the path, slow dynamics and unloading."""
    figure, (top, bottom) = style.column_axes(2, 4.4, sharex=True)
    reach = 1.1 * max(np.abs(sample.curve.strain).max() for sample in tested)  # dynamics may collapse earlier, and far
    for color, sample in zip(cycle(COLORS), tested, strict=False):
        for axes, name in ((top, "ratio"), (bottom, "volumetric")):
            axes.plot(sample.curve.strain, getattr(sample.curve, name), color=color, lw=1.2)
            at = [np.flatnonzero(sample.curve.load <= event.load)[-1] for event in collapses_of(sample)]
            axes.plot(sample.curve.strain[at], getattr(sample.curve, name)[at], "v", mfc="none", color=color, ms=4)
            if not sample.path.complete:
                last = sample.curve.strain[-1], getattr(sample.curve, name)[-1]
                axes.plot(*last, "x" if sample.path.loses_stability else "o", mfc="none", color=color, ms=5)
            if sample.back is not None:
                axes.plot(sample.back.strain, getattr(sample.back, name), ":", color=color, lw=0.9)
            if sample.slow:
                slow = max(sample.slow, key=lambda run: run.time).curve
                near = (slow.load <= sample.curve.load[-1]) & (np.abs(slow.strain) <= reach)
                axes.plot(slow.strain[near], getattr(slow, name)[near], "--", color=style.BLACK, lw=0.6)
        top.plot([], [], color=color, label=f"sample {sample.seed}")
    if any(sample.slow for sample in tested):
        top.plot([], [], "--", color=style.BLACK, lw=0.6, label="slow dynamics")
    if any(sample.back is not None for sample in tested):
        top.plot([], [], ":", color=style.BLACK, lw=0.9, label="unloading")
    for lost, mark in ENDS.items():
        if lost in {sample.path.loses_stability for sample in tested if not sample.path.complete}:
            top.plot([], [], mark, mfc="none", color=style.BLACK, ms=5, label=ENDS_WORDS[lost])
    if any(collapses_of(sample) for sample in tested):
        top.plot([], [], "v", mfc="none", color=style.BLACK, ms=4, label="collapse")
    style.label_axes(top, y="stress ratio" if test == "biaxial" else "shear stress / pressure")
    style.label_axes(bottom, x="axial strain" if test == "biaxial" else "shear strain", y="volumetric strain")
    style.legend_above(top, ncol=2)
    return figure


@checked
def collapses_of(sample: Annotated[Any, Result("SampleResult", ("path",))]) -> list:
    """Collapses on a sample's path whose motion is larger than the load alone would cause."""
    return [event for event in sample.path.collapses if not event.quiet]


@style.styled
def force_displacement(paths: dict[str, Annotated[Any, Result("LoadPath", ("points", "collapses"))]], wall: int):
    """Force on a wall against its displacement along several load paths, with their collapses.

    Parameters
    ----------
    paths : results of `load_path` by name
    wall : index of the body
    """
    figure, axes = style.column_axes(1, 2.6)
    for color, (name, path) in zip(cycle(COLORS), paths.items(), strict=False):
        number = wall - len(path.states[0].grains.radius)
        normal, start = path.states[0].walls.normal[number], path.states[0].walls.point[number]
        moved = np.array([(s.walls.point[number] - start) @ normal for s in path.states])
        force = np.array([force_on(s, wall) @ normal for s in path.states])
        axes.plot(moved, force, color=color, lw=1.2, label=name)
        at = [np.flatnonzero(path.load <= event.load)[-1] for event in path.collapses if not event.quiet]
        axes.plot(moved[at], force[at], "v", mfc="none", color=color, ms=4)
    if any(not event.quiet for path in paths.values() for event in path.collapses):
        axes.plot([], [], "v", mfc="none", color=style.BLACK, ms=4, label="collapse")
    style.label_axes(axes, x=("displacement of the wall", "length"), y=("force on the wall", "force"))
    style.legend_above(axes, ncol=3)
    return figure


@checked
def force_on(state: State, body: int) -> np.ndarray:
    """Load on a body (3,): the dead load plus that of a machine's spring [force]."""
    require_index(state.n_bodies, body=body)
    return state.control.force[body] + spring_forces(state.control, body_positions(state), state.time)[body]


@style.styled
def cone(one: Annotated[Any, Result(_KIND, ("forces",))], mu: float):
    """Contact forces along the path in the Coulomb cone, for the contacts that move farthest across it (Fig 3)."""
    figure, axes = style.column_axes(1, 3.0)
    force = one.forces / one.forces[0, :, 0].mean()
    mobilised = np.abs(force[..., 1]) / (mu * np.maximum(force[..., 0], 1e-12))
    reach = np.where(force[..., 0].min(axis=0) > 0.05, np.ptp(mobilised, axis=0), 0.0)
    shown = np.argsort(-reach)[:SHOWN]
    far = 1.1 * force[:, shown, 0].max()
    axes.fill([0, far, far], [0, mu * far, -mu * far], color="#eef1f4", lw=0)
    for side in (1, -1):
        axes.plot([0, far], [0, side * mu * far], color=GREY, lw=0.8)
    for color, k in zip(COLORS, shown, strict=False):
        axes.plot(force[:, k, 0], force[:, k, 1], color=color, lw=1.0, label=f"{one.pairs[k, 0]}–{one.pairs[k, 1]}")
        axes.plot(*force[0, k], "o", color=color, ms=2.5)
        axes.plot(*force[-1, k], "x", color=color, ms=4)
    axes.plot([], [], "o", color=style.BLACK, ms=2.5, label="start")
    axes.plot([], [], "x", color=style.BLACK, ms=4, label="end")
    axes.set_xlim(0, far)
    style.label_axes(axes, x=r"$F_n/\langle F_n\rangle_0$", y=r"$F_t/\langle F_n\rangle_0$")
    style.legend_above(axes, ncol=4, title=f"sample {one.seed}: contacts in the Coulomb cone")
    return figure


@style.styled
def stiffness(one: Annotated[Any, Result(_KIND, ("path", "looks", "seed"))]):
    """Number of sliding contacts, smallest eigenvalues of the stiffness matrix k, and complex pairs along a path.

    While the smallest eigenvalue of the symmetric part is positive, Q = v·k v is positive for all velocities v.
    """
    figure, (top, middle, bottom) = style.column_axes(3, 5.0, sharex=True)
    load = one.path.load
    top.step(load, [p.sliding for p in one.path.points], where="post", color=style.RED)
    style.label_axes(top, y="sliding contacts", whole="y")
    looks = one.looks
    middle.plot(looks.load, looks.lowest, color=style.BLUE, label=r"of the stiffness $\mathbf{k}$, real part")
    middle.plot(looks.load, looks.symmetric, color=style.ORANGE, label="of its symmetric part")
    middle.axhline(0, color=GREY, lw=0.6)
    middle.set_yscale("symlog", linthresh=1e-3)
    style.label_axes(middle, y=("smallest eigenvalue\n", "$K_n$"))
    style.legend_above(middle, ncol=2)
    bottom.step(looks.load, looks.pairs, where="mid", color=style.GREEN)
    style.label_axes(
        bottom, x="load (fraction of the path)", y="complex pairs\nof $\\mathbf{m}^{-1}\\mathbf{k}$", whole="y"
    )
    top.set_title(f"sample {one.seed}")
    return figure


@style.styled
def errors(tested: list[Annotated[Any, Result(_KIND, ("slow", "seed"))]]):
    """Difference between path and dynamics against the duration of loading."""
    figure, axes = style.column_axes(1, 2.4)
    for color, sample in zip(cycle(COLORS), tested, strict=False):
        runs = sorted(sample.slow, key=lambda run: run.time)
        time, error = [r.time for r in runs], [r.error for r in runs]
        axes.loglog(time, error, "o-", color=color, label=f"sample {sample.seed}")
    style.label_axes(axes, x=("duration of loading", r"$\sqrt{m/K_n}$"), y="difference of strain")
    axes.legend(loc="best", ncol=2)
    return figure


@style.styled
def rigid_clusters(
    state: Committed, clusters: Annotated[Any, Result("RigidClusters", ("body", "contact", "overconstrained"))],
    *, width: float = style.WIDTH,
):  # fmt: skip
    """Draw the contacts of each rigid cluster in one colour; hinges are dotted, overconstrained contacts thick.

    The largest cluster is blue; the five other colours are repeated.

    Parameters
    ----------
    state : accepted state
    clusters : result of `rigid_clusters` for this state
    width : width of the figure [inches]
    """
    frame = bare_frame(state)
    require_shape((len(frame.contacts["i"]),), clusters=clusters.contact)
    figure, axes = start_drawing(frame, layout_of([frame]), width)
    lines, hinge = contact_segments(frame), clusters.contact < 0
    number = clusters.contact
    colors = np.array(COLORS[:-1])[np.where(number > 0, 1 + (number - 1) % (len(COLORS) - 2), 0)]
    thick = np.where(clusters.overconstrained, 1.8, 0.8)
    axes.add_collection(LineCollection(lines[~hinge], colors=colors[~hinge], linewidths=thick[~hinge], zorder=60))
    axes.add_collection(LineCollection(lines[hinge], colors=style.BLACK, linewidths=0.8, linestyles=":", zorder=61))
    handles = [
        Line2D([], [], color=style.BLUE, lw=0.8, label="largest rigid cluster"),
        Line2D([], [], color=style.BLUE, lw=1.8, label="overconstrained"),
        Line2D([], [], color=style.BLACK, lw=0.8, ls=":", label=f"hinges ({np.count_nonzero(hinge)})"),
    ]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncol=3 if width > style.WIDTH else 2)
    return figure
