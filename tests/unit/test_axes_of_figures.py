"""Figures whose data are worked out before they are drawn: every point, mark and label, against its own arithmetic."""

from types import SimpleNamespace as Made

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba_array
from matplotlib.lines import AxLine
from matplotlib.transforms import Bbox

import stickslip as ss
from stickslip.core.state import empty_contacts
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.figures.grains import bare_frame, layout_of
from stickslip.figures.scene import body_limits, quantities, view_box
from stickslip.figures.style import column_axes, label_axes, plot_fast, styled
from stickslip.solve.freedom import freedom
from stickslip.solve.spectrum import Spectrum
from stickslip.wings.faults.rate_state import figures as rate_state
from stickslip.wings.lammps import watch_record as watch
from stickslip.wings.papers.disk_array import figures as disk_array
from stickslip.wings.papers.gouge import figures as gouge
from stickslip.wings.papers.gouge.measures import Curve
from stickslip.wings.papers.quasi_rigid import figures as quasi_rigid
from stickslip.wings.papers.sphere_shear import figures as sphere_shear
from stickslip.wings.studies.flow import figures as flow
from tests.exchange.packings import spheres
from tests.unit.test_figures import holds, rising

TIME = r"time $t$ [$\sqrt{m/(k_n\sqrt{2R})}$]"
IM = r"$\mathrm{Im}\,\lambda$ [$k_n\sqrt{2\sigma_1}/m$]"
ROOT = r"\sqrt{m/(k_n\sqrt{2R})}"


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def labels(axes):
    return axes.get_xlabel(), axes.get_ylabel()


def bars(container):
    """Middles and heights of the errors that a container of `errorbar` has along y."""
    ends = np.array([segment[:, 1] for segment in container[2][0].get_segments()])
    return np.diff(ends, axis=1)[:, 0] / 2


def test_the_path_of_a_disk_before_and_after_the_first_limit():
    """Two disks spiral about places of their own; the second is asked for, in units in which it is of order one."""
    time, center = np.arange(0.0, 1000.0, 2.0), np.array([[1.0, 0.4], [7.0, 0.5]])
    size = 1e-5 * np.exp(time / 100)
    spiral = np.stack([size * np.cos(time / 7), 0.6 * size * np.sin(time / 7)], axis=1)
    position = center + np.stack([np.zeros_like(spiral), spiral], axis=1)
    data = Made(load=0.083, time=time, position=position, first_limit=600.0, breach=np.array([np.nan, 850.0]))
    figure = disk_array.trajectory(Made(trajectory=data), 1)
    before, after, *colors = figure.axes
    for axes, start, stop in ((before, 450, 600), (after, 600, 850)):
        shown = (time >= start) & (time <= stop)
        moved = spiral[shown] - spiral[shown].mean(axis=0)
        (lines,) = (collection for collection in axes.collections if isinstance(collection, LineCollection))
        parts = np.array(lines.get_segments())
        np.testing.assert_allclose(parts[:, 0], moved[:-1], atol=1e-12)  # round-off of places of order ten
        np.testing.assert_allclose(parts[:, 1], moved[1:], atol=1e-12)
        np.testing.assert_array_equal(lines.get_array(), time[shown][1:])
        assert labels(axes) == (r"$\Delta x$ [diameters]", r"$\Delta y$ [diameters]")
    assert before.get_title().startswith("disk 2, $F_x$ = 0.083, before")
    assert [bar.get_ylabel() for bar in colors] == [TIME, TIME]


@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_the_shape_of_a_mode_by_coordinate(phase):
    """Components times √m, disk by disk: x, y, R·angle; the phase in which the largest is real and positive."""
    part = np.array([[0.1, 2.0, 0.3], [-0.2, 1.5, -0.4], [0.15, -1.0j, 0.5]])  # rows are disks
    mass = np.outer([1.0, 2.0, 3.0], [1.0, 1.0, 0.5])
    norm = np.sqrt((mass * np.abs(part) ** 2).sum())
    mode = np.exp(1j * phase) * part.ravel() / norm
    free = freedom(
        ss.packings.from_arrays(3 * np.diag([1.0, 1.0, 0.0]), [0.5] * 3, ss.laws.linear(), mass=[1.0, 2.0, 3.0], dim=2)
    )
    assert (free.mass == mass.ravel()).all()
    modes = np.eye(9, dtype=complex)
    modes[:, 4] = mode
    eigenvalues = np.arange(9.0) + 0j
    eigenvalues[4] = 0.25
    (axes,) = disk_array.mode_shape(Spectrum(eigenvalues, modes, free, 0.0), 4).axes
    drawn = {box.get_label(): [(r.get_x() + r.get_width() / 2, r.get_height()) for r in box] for box in axes.containers}
    height = part.real * np.sqrt(mass) / norm
    assert list(drawn) == ["$x$", "$y$", r"$R\,\theta$"]
    for k, points in enumerate(drawn.values()):
        np.testing.assert_allclose(points, np.stack([3 * k + np.arange(1.0, 4.0), height[:, k]], axis=1), atol=1e-12)
    share = (mass * np.abs(part) ** 2)[:, 1].sum() / norm**2
    assert axes.get_title() == rf"$\omega$ = 0.5000, fraction in $y$ {share:.3f}"
    assert labels(axes) == (r"degree of freedom $q_\ell$", "mass-weighted component")


def test_forces_in_the_cone_are_over_their_mean_at_the_start():
    """Of eight contacts, six go far across the cone and stay closed; one opens, and one hardly moves."""
    mu, load = 0.5, np.linspace(0, 1, 5)[:, None]
    normal = np.array([2.0, 4.0, 3.0, 5.0, 1.0, 6.0, 2.0, 9.0]) * (1 - load * np.array([0, 0, 0, 0, 0, 0, 1, 0]))
    share = load * np.array([0.9, -0.8, 0.7, -0.6, 0.5, 0.4, 1.0, 0.1])  # of the Coulomb limit
    pairs = np.array([[k, k + 10] for k in range(8)])
    sample = Made(forces=np.stack([normal, share * mu * normal], axis=-1), pairs=pairs, seed=7)
    (axes,) = quasi_rigid.cone(sample, mu).axes
    unit = 4.0  # mean normal force of all eight at the start
    for k in range(6):
        x, y = normal[:, k] / unit, share[:, k] * mu * normal[:, k] / unit
        assert holds(axes, x, y, label=f"{k}–{k + 10}", linestyle="-")
        assert holds(axes, x[:1], y[:1], marker="o") and holds(axes, x[-1:], y[-1:], marker="x")
    far = 1.1 * 6 / unit
    for side in (1, -1):
        assert holds(axes, [0, far], [0, side * mu * far])
    assert len(axes.lines) == 6 * 3 + 2 + 2  # the last two are those of the legend
    assert axes.get_xlim() == pytest.approx((0, far))
    assert labels(axes) == (r"$F_n/\langle F_n\rangle_0$", r"$F_t/\langle F_n\rangle_0$")
    assert axes.get_legend().get_title().get_text() == "sample 7: contacts in the Coulomb cone"
    assert [text.get_text() for text in axes.get_legend().get_texts()][-2:] == ["start", "end"]


def test_slides_after_holds_collapse_over_the_ratio_of_velocities():
    ratios, offset = np.array([0.0068, 1.0, 10.0]), 5.0  # C + ln 0.0068 is next to nothing
    curves = [Curve(rising(6), np.stack([rising(6) for _ in range(3)]), np.arange(3), "") for _ in ratios]
    peaks = [Made(value=v, half=h) for v, h in ((0.01, 0.002), (0.02, np.nan), (0.06, 0.004))]
    panels = gouge.reslides(curves, ratios, peaks, Made(value=0.008, half=0.001), offset).axes
    above, below, peak = panels
    for curve, ratio, label in zip(curves, ratios, ("0.0068", "1", "10"), strict=True):
        mean = curve.rows.sum(axis=0) / 3
        assert holds(above, curve.x, mean, label=f"$V_r/V_i$ = {label}")
        assert holds(below, curve.x, mean / (5.0 + np.log(ratio))) == (ratio > 0.01)
    deviation = np.sqrt(((curves[1].rows - curves[1].rows.mean(axis=0)) ** 2).sum(axis=0) / 2)
    corners = above.collections[1].get_paths()[0].vertices
    at = np.isclose(corners[:, 0], curves[1].x[3])
    assert np.ptp(corners[at, 1]) == pytest.approx(4 * deviation[3] / np.sqrt(3))  # two errors to either side
    x = np.log(ratios)
    assert holds(peak, x, [0.01, 0.02, 0.06], marker="o")
    assert holds(peak, x, 0.03 + 0.008 * (x - x.mean()), label="slope 0.008 ± 0.001")
    np.testing.assert_allclose(bars(peak.containers[0]), [0.002, 0.0, 0.004], atol=1e-12)
    assert above.get_ylabel() == r"$\mu - \mu_{ss}$"
    assert labels(below) == ("slip of the load point / $D$", r"$(\mu - \mu_{ss})/(5 + \ln V_r/V_i)$")
    assert labels(peak) == (r"$\ln V_r/V_i$", r"peak of $\mu - \mu_{ss}$")
    assert len(gouge.reslides(curves[1:2], ratios[1:2], peaks[1:2], None, offset).axes) == 2


def released(**more):
    """A run whose M is e^{2 ω_i t} [A + B cos 2ω_r t + C sin 2ω_r t] from a time on that is sampled closely."""
    time = np.linspace(0.0, 400.0, 81)
    run = {"time": time, "msd": 1e-18 * (1 + rising(81)), "strain": 0.0123, "pairs": 2, "growth_rate": 2.5e-2}
    return Made(**run | more)


def test_growth_beside_prediction_and_fit():
    fit, first = Made(growth_rate=0.026, frequency=0.3, start=100.0, stop=300.0), 210.0

    def shape(x):
        return 4e-14 * np.exp(2 * 0.026 * x) * (1 + 0.3 * np.cos(0.6 * x) + 0.2 * np.sin(0.6 * x))

    x = np.linspace(0, 25, 60)
    run = released(growth=fit, corrected_rate=0.024, close_time=first + x, close_msd=shape(x))
    top, bottom = sphere_shear.growth(run).axes
    assert holds(top, run.time[1:], run.msd[1:])
    t = np.linspace(100, 300, 200)  # twice the predicted rate, through the mean of ln M of the close samples
    rise = np.exp(np.mean(np.log(shape(x))) + 2 * 0.024 * (t - np.mean(first + x)))
    assert holds(top, t, rise, linestyle="--", label=r"predicted $e^{2\omega_i t}$, $\omega_i$ = 0.025")
    assert holds(bottom, x, shape(x), marker="o", label="$M$")
    (fitted,) = (line for line in bottom.lines if line.get_label() == "fit")
    np.testing.assert_array_equal(fitted.get_xdata(), np.linspace(0, 25, 600))
    np.testing.assert_allclose(fitted.get_ydata(), shape(np.linspace(0, 25, 600)), rtol=1e-9)
    assert top.get_yscale() == "log" and top.get_title() == r"$\gamma$ = 0.0123"
    assert labels(top) == (TIME, r"$M$ [diameters²]")
    assert labels(bottom) == (f"$t$ − 210 [${ROOT}$]", r"$M$ [diameters²]")


def test_growth_that_was_never_fitted_says_so():
    run = released(growth=None, close_time=np.zeros(0))
    top, bottom = sphere_shear.growth(run).axes
    assert holds(top, run.time[1:], run.msd[1:]) and len(top.lines) == 1
    assert not bottom.lines and bottom.texts[0].get_text() == "M did not cross the fit window"


@pytest.mark.parametrize("constant", [3e-13, np.nan])
def test_all_eigenvalues_in_time_above_the_motion(constant):
    when, moved = rising(4), 1e-15 * rising(4)
    snapshots = (2 + rising(12) + 1j * rising(12, -4.0)).reshape(4, 3)
    run = released(snapshot_time=when, snapshot_msd=moved, snapshots=snapshots, eigenvalue=0.5 + 2e-4j,
                   constant=(constant, 9e-13))  # fmt: skip
    top, bottom = sphere_shear.spectrum_in_time(run).axes
    points = [(t, value.imag) for t, row in zip(when, snapshots, strict=True) for value in row]
    assert holds(top, *np.transpose(points), marker=".")
    assert holds(bottom, run.time[1:], run.msd[1:])
    assert holds(bottom, when, moved, marker=".", label="spectrum taken")
    assert holds(bottom, [0, 1], [constant] * 2, label="spectrum constant below") == np.isfinite(constant)
    assert (top.get_yscale(), bottom.get_yscale()) == ("symlog", "log")
    assert top.get_title() == r"$\gamma$ = 0.012, 2 pairs at the start" and top.get_ylabel() == IM
    assert labels(bottom) == (TIME, r"$M$ [diameters²]")


LENGTH, RADIUS = 10.0, np.array([0.5, 0.4, 0.3, 0.6])
PLACE = np.array([[11.0, 2.0, 0.8], [3.0, 4.0, 0.2], [6.0, 1.0, 0.5], [5.0, 0.5, 0.0]])  # the first outside of the cell
SEEN = np.array([[1.0, 2.0], [3.0, 4.0], [6.0, 1.0], [5.0, 0.5]])
LOOSE, ORDER, GLUED = np.array([0, 1, 2]), [1, 2, 0], [3]  # those nearest to the eye come last


def moment(time):
    """Three grains that fall faster and faster beside a glued one; a floor, a slope, and a wall that faces the eye."""
    velocity = np.outer([1.0, 2.0, 3.0, 99.0], [0.6, -0.8, 0.0]) * time / 8
    grains = ss.spheres(PLACE - [0, 0.01 * time, 0], RADIUS, velocity=velocity)
    cell = ss.box([LENGTH, 20.0, 2.0], periodic=(True, False, False))
    normal = np.array([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    walls = ss.flat_walls([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.0]], normal)
    return ss.State(grains, walls, cell, empty_contacts(7, 0, 0.1), ss.control.loads(4, 3), time)


def snapshots_of_fall(**how):
    """Axes of snapshots, those with a picture, and that of the colours."""
    frames = [moment(t) for t in (0.0, 3.0, 4.0, 4.2, 4.4, 5.0, 5.7, 6.5, 7.1, 8.0)]
    stages = [Made(name="settle", start=0.0), Made(name="flow", start=3.0)]
    *snapshots, bar = flow.snapshots(Made(frames=frames, stages=stages, poured=Made(loose=LOOSE)), **how).axes
    return [axes for axes in snapshots if axes.axison], bar


@pytest.fixture
def panels():
    """Snapshots as they are drawn by default."""
    return snapshots_of_fall()


SHOWN = (3.0, 4.0, 5.0, 5.7, 7.1, 8.0)  # of the last stage, nearest to 3, 4, 5, 6, 7 and 8


def test_snapshots_show_where_grains_are_and_how_fast(panels):
    for axes, t in zip(panels[0], SHOWN, strict=True):
        values = [disks for disks in axes.collections if isinstance(disks, EllipseCollection)]
        left = []
        for disks in values:
            loose = len(disks.get_offsets()) == 3
            rows = ORDER if loose else GLUED
            moved = disks.get_offsets() - SEEN[rows] + [0, 0.01 * t]
            left.append((loose, round(float(moved[0, 0]))))
            np.testing.assert_allclose(moved, [[left[-1][1], 0]] * len(rows), atol=1e-12)
            for size in (disks.get_widths(), disks.get_heights()):
                np.testing.assert_allclose(size, 2 * RADIUS[rows])
            if loose:
                np.testing.assert_allclose(disks.get_array(), np.array([2.0, 3.0, 1.0]) * t / 8)
                assert disks.get_clim() == pytest.approx((0, 2.98))  # of speeds 1, 2, 3 at the end, 99 % are below
            else:
                np.testing.assert_allclose(disks.get_facecolor(), to_rgba_array("0.6"))
        # once where they are, and once a cell to either side, as grains at an edge are seen at both
        assert sorted(left) == [(kind, shift) for kind in (False, True) for shift in (-10, 0, 10)]


def test_lengths_are_diameters_where_their_mean_is_one(monkeypatch):
    monkeypatch.setattr(f"{__name__}.RADIUS", np.array([0.5, 0.45, 0.55, 0.6]))
    shown, bar = snapshots_of_fall()
    assert labels(shown[-1])[0] == "$x$ [diameters]" and bar.get_xlabel() == "speed [diameters / time unit]"
    with ss.io.units_in_use("mm, g, s"):
        shown, bar = snapshots_of_fall()
    assert labels(shown[-1])[0] == "$x$ [mm]" and bar.get_xlabel() == "speed [mm/s]"


def test_snapshots_of_a_heap_share_rows_and_end_at_their_grains():
    """Twelve grains in a column that becomes a low heap of thirteen times the width."""

    def heap(time):
        k = np.arange(12)
        place = np.stack([0.5 + time * k, 0.5 + (1 - time / 6) * k, 0 * k], axis=1)
        grains = ss.spheres(place, 0.5)
        cell = ss.box([1.0, 1.0, 1.0], periodic=(False, False, False))
        return ss.State(grains, ss.flat_walls([], []), cell, empty_contacts(7, 0, 0.1), ss.control.loads(12, 0), time)

    frames, stages = [heap(t) for t in range(7)], [Made(name="flow", start=0.0)]
    result = Made(frames=frames, stages=stages, poured=Made(loose=np.arange(12)))
    *shown, _ = flow.snapshots(result, zoom=1).axes
    boxes = [axes.get_subplotspec().get_position(axes.figure) for axes in shown]
    starts = np.array([box.y0 for box in boxes])
    assert len(shown) == 6 and starts[0] == starts[2] > starts[3] > starts[4] > starts[5]
    for axes, t in zip(shown[:3], (0, 1, 2), strict=True):  # later, grains are apart
        (left, right), top = axes.get_xlim(), axes.get_ylim()[1]
        assert left < 0 and 11 * t + 1 <= right <= 11 * t + 4 and top >= 11 * (1 - t / 6) + 1


def test_snapshots_are_enlarged_around_the_median():
    for axes, t in zip(snapshots_of_fall(zoom=4)[0], SHOWN, strict=True):
        (low, high), place = axes.get_xlim(), SEEN - [0, 0.01 * t]
        assert (low, high) == pytest.approx((4 - LENGTH / 8, 4 + LENGTH / 8))  # of 1, 3, 5 and 6
        inside = (place > [low, axes.get_ylim()[0]]) & (place < [high, axes.get_ylim()[1]])
        away = np.count_nonzero(~inside.all(axis=1))
        assert away > 0 and f"{away} grain" in axes.get_title() and "outside the view" in axes.get_title()


def test_snapshots_have_walls_times_and_units(panels):
    for axes in panels[0]:
        walls = [(line.get_xy1(), line.get_xy2()) for line in axes.lines if isinstance(line, AxLine)]
        assert len(walls) == 2  # not that which faces the eye
        for (start, end), point, normal in zip(walls, ([0, 0], [1, 2]), ([0, 1], [0.6, 0.8]), strict=True):
            np.testing.assert_allclose(start, point)
            assert np.hypot(*np.subtract(end, start)) > 0.1
            assert np.subtract(end, start) @ normal == pytest.approx(0, abs=1e-12)
        assert (axes.get_aspect(), axes.get_xlim()) == (1, (0, LENGTH))
        assert axes.get_ylim()[0] < -0.2 and axes.get_ylim()[1] > 4.4  # all of every grain
    shown, bar = panels
    assert [axes.get_title() for axes in shown] == [f"$t$ = {t:g} time units" for t in SHOWN]
    x, y = (f"${name}$ [units of length]" for name in "xy")
    assert {labels(axes) for axes in shown} <= {("", ""), (x, ""), ("", y), (x, y)}
    assert labels(shown[0])[1] == y and labels(shown[-1])[0] == x
    assert bar.get_xlabel() == "speed [units of length/time]"


def shape(text) -> Bbox:
    """Box of a text; of a slanted one, a strip as wide as its letters are high, which must not meet the next one."""
    box = text.get_window_extent()
    if not text.get_rotation():
        return box
    half = 0.7 * text.get_fontsize() * text.figure.dpi / 72
    return Bbox([[box.x1 - half, box.y0], [box.x1 + half, box.y1]])


def clashes(figure) -> list[tuple[str, str]]:
    """Pairs of tick labels of one axis that overlap where they are drawn, and offset texts, which must be in labels."""
    figure.draw_without_rendering()
    results = []
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis) if axes.name == "rectilinear" and axes.axison else ():
            results += [(axis.get_label_text(), text) for text in [axis.get_offset_text().get_text()] if text]
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            texts = [t.label1 for t in ticks if t.label1.get_visible() and t.label1.get_text()]
            boxes = sorted(((shape(t), t.get_text()) for t in texts), key=lambda pair: tuple(pair[0].p0))
            results += [
                (a, b) for k, (first, a) in enumerate(boxes) for second, b in boxes[k + 1 :] if first.overlaps(second)
            ]
    return results


def long_run(most: float):
    time, n = np.linspace(0, most, 50), 50
    columns = {name: 1e-5 * rising(n) for name in ("shear_stress", "pressure")} | {"msd": np.full(n, 1e-12)}
    return Made(time=time, touching=300 + rising(n), growth_rate=0.01, pairs=2, strain=0.1, **columns)


NAMES = ("a", "b", "dc")


@pytest.mark.parametrize("most", [5.6e5, 2e-5, 0.0175])
def test_tick_labels_neither_overlap_nor_have_an_offset(most):
    """Time steps and strains of any size: the power of ten is in the label of the axis."""
    step = np.linspace(0, most, 30)
    flat = Made(strain=step, ratio=step, volumetric=-step, load=step)
    path = Made(curve=flat, back=None, slow=(), path=Made(complete=True, loses_stability=False, collapses=()), seed=1)
    figures = [
        watch.watched_stress(step, 1.0 + step, step), sphere_shear.stress_through_failure(long_run(most)),
        quasi_rigid.curves([path], "shear"),
        rate_state.corner(
            dict.fromkeys(NAMES, step + 10 * most), dict.fromkeys(NAMES, (10 * most, 11 * most)), {"dc": "m"}
        ),
    ]  # fmt: skip
    for figure in figures:
        assert not clashes(figure)
    power = {5.6e5: 5, 2e-5: -5}.get(most)
    label = figures[0].axes[1].get_xlabel()
    assert label == (rf"time step [$10^{{{power}}}$]" if power else "time step")
    assert ("10^" in label) == (power is not None)


@pytest.mark.parametrize("name", ["rate-state", "flow", "fault"])
def test_no_figure_of_a_run_has_overlapping_tick_labels(name):
    experiment = EXPERIMENTS[name]
    result = ss.simulate(ss.scenario(experiment=name, **experiment.smallest[0]))
    drawn = list(experiment.figures(result))
    assert drawn
    assert {file: pairs for file, figure in drawn if (pairs := clashes(figure))} == {}


@styled
def drawn_fast(x, y, **how):
    _, axes = column_axes(1, 2.0)
    plot_fast(axes, x, y, color="C0", **how)
    return axes


@pytest.mark.parametrize("middle", [True, False])
def test_an_oscillation_denser_than_pixels_is_drawn_as_its_envelope(middle):
    x = np.linspace(0, 1, 200_001)
    size = np.exp(3 * x)
    axes = drawn_fast(x, size * np.sin(2e4 * x) + x, middle=middle, label="a")
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    for end in (1, -1):  # at the middle of each bin, both edges are those of the oscillation
        edge = corners[end * (corners[:, 1] - corners[:, 0]) > 0]
        true = end * np.exp(3 * edge[:, 0]) + edge[:, 0]
        assert np.abs(edge[:, 1] / true - 1).max() < 0.06  # growth of e³ over at least a hundred bins
    assert all(len(line.get_xdata()) < 300 for line in axes.lines)
    if middle:
        np.testing.assert_allclose(
            axes.lines[0].get_ydata(), axes.lines[0].get_xdata(), atol=0.7
        )  # half an oscillation
    assert axes.get_legend_handles_labels()[1] == ["a"]


def test_what_can_be_seen_is_drawn_point_by_point():
    x = np.linspace(0, 1, 5000)
    axes = drawn_fast(x, np.sin(60 * x))
    assert not axes.collections and holds(axes, x, np.sin(60 * x))


@pytest.mark.parametrize("high", [0.41, 0.445, 0.62])
def test_low_panels_have_two_numbers(high):
    """One number, such as 0.4 on the friction of a slide, gives no scale."""
    figure, axes = column_axes(1, 0.9)
    axes.plot([0, 1], [0.245, high])
    label_axes(axes, x="time", y="friction")
    figure.draw_without_rendering()
    low, top = axes.get_ylim()
    assert np.count_nonzero([low <= place <= top for place in axes.get_yticks()]) > 1


@pytest.mark.parametrize("values, least, wide", [
    ([0.7, 0.7 + 3e-12], 0.0, (0.03, 0.1)),  # round-off of a constant
    ([1e5, 1e5 + 0.1], 1e3, (1e3, 1.2e3)),  # held by a servo
    ([1e9, 1e9 + 1e3], 0.0, (1e3, 1.2e3)),  # late time steps
    ([0.0, 3e-7], 0.0, (3e-7, 4e-7)),  # small, but not beside anything
])  # fmt: skip
def test_axes_do_not_zoom_into_noise(values, least, wide):
    figure, axes = styled(column_axes)()
    axes.plot(values, values)
    label_axes(axes, x="a", y="b", least={"x": least, "y": least})
    figure.draw_without_rendering()
    for low, high in (axes.get_xlim(), axes.get_ylim()):
        assert wide[0] < high - low < wide[1] and low < values[0] and values[1] < high


def test_grains_that_have_left_the_heap_do_not_shrink_it():
    heap = np.random.default_rng(0).uniform(0, [30, 5], (1200, 2))
    away = np.r_[heap, [[55.0, 0.5], [80.0, 0.5], [140.0, 0.5]]]
    np.testing.assert_array_equal(body_limits(away, 3.0), [heap.min(axis=0), heap.max(axis=0)])
    np.testing.assert_array_equal(body_limits(heap, 3.0), [heap.min(axis=0), heap.max(axis=0)])  # none of it is hidden
    np.testing.assert_array_equal(body_limits(away, 3.0, 0.0), [away.min(axis=0), away.max(axis=0)])
    spray = np.column_stack([np.arange(32.0, 150.0, 2.0), np.zeros(59)])  # each within a gap of the next
    assert 60 < body_limits(np.r_[heap, spray], 3.0)[1, 0] < 80 < spray[-1, 0]
    few = np.r_[heap[:9], [[90.0, 0.0]]]
    assert body_limits(few, 3.0)[1, 0] == heap[:9, 0].max() and body_limits(few[1:], 3.0)[1, 0] == 90.0
    column = np.append(np.zeros(40), 2.0)[:, None]  # the last grain is within the gap of a column without width
    assert body_limits(column, 3.0)[1, 0] == 2.0 and body_limits(column, 1.0)[1, 0] == 0.0
    halves = np.r_[heap[:600], heap[600:] + np.array([100.0, 0.0])]  # two heaps
    np.testing.assert_array_equal(body_limits(halves, 3.0), [halves.min(axis=0), halves.max(axis=0)])


RUNAWAYS = ss.packings.from_arrays(
    [*np.mgrid[:12, :5, :1].reshape(3, -1).T.tolist(), [40, 0, 0], [70, 0, 0]], [0.5] * 62, ss.laws.linear(), dim=2
)


@pytest.mark.parametrize("zoom, wide, words", [
    (1.0, 12.0, "2 grains are outside the view"),
    ("all", 71.0, ""),
    (2, 6.0, "outside the view"),
    (0.5, 24.0, "2 grains are outside the view"),
])  # fmt: skip
def test_the_view_is_that_of_grains_that_are_together(zoom, wide, words):
    (axes,) = ss.figures.packing(RUNAWAYS, zoom=zoom).axes
    assert np.diff(axes.get_xlim())[0] == pytest.approx(wide, rel=0.03)
    (said,) = (text.get_text() for text in axes.texts)
    assert said.endswith(words) and said.startswith(" mean diameter") and bool(words) == (";" in said)
    box = view_box([bare_frame(RUNAWAYS)], zoom)
    assert box[1, 0] - box[0, 0] == pytest.approx(wide, rel=0.03)  # of the page, by the same rule


@pytest.mark.parametrize("zoom", [0, -1, np.nan, np.inf, 1e9, True, None, "some", [1.0]])
def test_a_zoom_without_sense_is_refused(zoom):
    with pytest.raises(ValueError, match=r"zoom must be from 0\.01 to 1000, or all"):
        ss.figures.packing(RUNAWAYS, zoom=zoom)


def test_logarithmic_axes_of_a_decade_show_two_and_five():
    _, axes = column_axes(1, 2.0)
    axes.loglog([1.5e5, 6e5], [1e-3, 1e7])
    label_axes(axes, x=("time", "s"), y="energy")
    axes.figure.canvas.draw()
    texts = [[t.label1.get_text() for t in axis.get_minor_ticks()] for axis in (axes.xaxis, axes.yaxis)]
    assert [text for text in texts[0] if text] == [r"$2\times 10^{5}$", r"$5\times 10^{5}$"]
    assert not any(texts[1]) and not clashes(axes.figure)


def test_colours_span_all_but_the_largest_values():
    speed = np.concatenate([np.linspace(1.0, 2.0, 999), [1e6]])
    grains = ss.disks(
        np.stack([2.0 * np.arange(1000), np.zeros(1000)], axis=1), 0.5, velocity=speed[:, None] * [1, 0, 0]
    )
    state, law = ss.assembly(grains), ss.laws.linear(1.0, 0.5, 0.5)
    state = ss.accept(state, ss.forces(state, law)[1])
    layout = layout_of([bare_frame(state)], colour="speed")
    assert layout.limits == pytest.approx((1.0, np.quantile(speed, 0.995))) and layout.limits[1] < 2.0
    assert layout.cut


def test_sliding_contacts_are_counted_by_grain():
    state = spheres()
    c, rows = state.contacts, ss.measure.touching(state)
    rows = rows[c.mode[rows] == ss.SLIDE]
    found, unit = quantities(bare_frame(state))["sliding contacts"]
    assert 0 < len(rows) < len(ss.measure.touching(state)) and unit == ""
    np.testing.assert_array_equal(found, np.bincount(np.append(c.i[rows], c.j[rows]), minlength=len(found)))
