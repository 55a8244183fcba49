"""What figures draw: data and labels of their lines, from made-up results that are told apart by their numbers."""

from types import SimpleNamespace as Made

import numpy as np
import pytest
from matplotlib import pyplot as plt

from stickslip.figures.claims import Row, claims_chart
from stickslip.wings.faults.friction.loads import LoadStep
from stickslip.wings.faults.friction.model import Data
from stickslip.wings.faults.rate_state import figures as rate_state
from stickslip.wings.papers.disk_array import figures as disk_array
from stickslip.wings.papers.gouge import figures as gouge
from stickslip.wings.papers.gouge.measures import Curve
from stickslip.wings.papers.quasi_rigid import figures as quasi_rigid
from stickslip.wings.papers.sphere_shear import figures as sphere_shear
from stickslip.wings.studies.flow import figures as flow

RNG = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def rising(count=20, start=1.0):
    """Numbers that no other column of a test has."""
    return start + np.cumsum(RNG.uniform(0.1, 1.0, count))


def holds(axes, x, y, **about):
    """Whether some line of the axes has these points, and the label or style asked for."""
    points = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)), axis=-1).reshape(-1, 2)
    for line in axes.lines:
        drawn = line.get_xydata()
        alike = drawn.shape == points.shape and np.allclose(drawn, points, rtol=1e-12, atol=0, equal_nan=True)
        if alike and all(getattr(line, f"get_{name}")() == value for name, value in about.items()):
            return True
    return False


def test_pairs_are_drawn_against_the_push():
    loads, values = rising(6), rising(6)
    family = Made(loads=loads, eigenvalues=5 + 1j * values, birth=Made(load=0.5), death=None)
    (axes,) = disk_array.complex_pairs({"one": Made(families=[family])}, {0.7: 2e-3}).axes
    assert holds(axes, np.r_[0.5, loads], np.r_[0.0, values])
    assert holds(axes, [0.5], [0.0], marker="o")
    assert holds(axes, [0.7], [2e-3], marker="x", label="paper")
    assert axes.get_xlabel() == "push $F_x$ [units of force]"
    assert axes.get_ylabel() == r"$\mathrm{Im}\,\lambda$ [$k_n\sqrt{2R}/m$]"
    legend = axes.get_legend()
    assert legend.get_title().get_text() == "one"
    assert [text.get_text() for text in legend.get_texts()] == ["paper", "complex pair, ○ birth and death"]


def test_displacements_grow_beside_their_prediction():
    """Twice the rate, through the mean of ln M."""
    time, rate = np.linspace(0, 10, 50), 0.3
    run = Made(time=time, msd=2e-9 * np.exp(2 * rate * time), growth=Made(start=2.0, stop=6.0), predicted_growth=rate)
    (axes,) = disk_array.mean_square_displacement(Made(free_runs={0.03: run})).axes
    assert holds(axes, time, run.msd, label="0.030")
    t = np.array([2.0, 6.0])
    assert holds(axes, t, 2e-9 * np.exp(2 * rate * t), linestyle="--")
    assert axes.get_yscale() == "log"
    assert axes.get_xlabel().startswith("time $t$")
    assert axes.get_ylabel().startswith("$M(t)=")


def test_fronts_have_distance_over_delay_and_their_speed_if_they_have_one():
    distance, error = np.arange(5.0), np.r_[0.0, np.full(4, 10.0)]
    even = distance / 0.004 + np.r_[0, 10, -10, 20, 0]  # χ² = 1 + 1 + 4
    arch = np.array([0.0, 300, 500, 300, 200])
    forward, backward = (Made(delay=delay, distance=distance, error=error, speed=v, speed_error=0.01 * v)
                         for delay, v in ((even, 0.004), (arch, 0.01)))  # fmt: skip
    top, bottom = disk_array.traveling_fronts({0.083: forward}, backward, 0.1).axes
    for axes, front, line in ((top, forward, True), (bottom, backward, False)):
        assert holds(axes, front.delay, front.distance)
        assert holds(axes, np.array([0, 4]) / front.speed, [0, 4], linestyle="--") == line
        assert any("fitted speed" in text.get_text() for text in axes.get_legend().get_texts()) == line
    assert "breaching" in top.get_xlabel() and top.get_ylabel() == "distance\nfrom disk 1 [diameters]"
    assert "sliding by 0.1" in bottom.get_xlabel() and bottom.get_ylabel() == "distance\nfrom last disk [diameters]"
    words, others = (axes.get_legend().get_texts()[-1].get_text() for axes in (top, bottom))
    assert r"(4 ± 0.04)\times 10^{-3}" in words and words.endswith(r"$\chi^2$ = 6, 3 degrees of freedom")
    assert others.startswith("$V_2$: no single speed")


def test_the_centre_of_mass_moves_from_where_it_began():
    time, center = rising(30), np.stack([rising(30), rising(30)], axis=1)
    free, slides = Made(time=time, center=center), Made(time=rising(8), center=np.stack([rising(8), rising(8)], axis=1))
    line = Made(push=rising(3), velocity=rising(3), error=0.1 * rising(3), slope=2.0, intercept=-1.0)
    result = Made(free_runs={0.083: free}, sliding={0.09: slides})
    figure = disk_array.center_of_mass(result, 0.083, line, (3.0, -2.0))
    top, across, bottom, small = figure.axes
    assert holds(top, time, center[:, 0] - center[0, 0])
    assert holds(across, time, center[:, 1] - center[0, 1])
    assert holds(bottom, slides.time, slides.center[:, 0] - slides.center[0, 0], label="0.090")
    ends = np.array([line.push.min(), line.push.max()])
    assert holds(small, line.push, line.velocity)
    assert holds(small, ends, 2 * ends - 1, label="fit")
    assert holds(small, ends, 3 * ends - 2, label="paper")
    assert small.get_xlabel() == "push $F_x$ [units of force]" and "[diameters\n/ time unit]" in small.get_ylabel()


def test_a_slider_is_drawn_against_displacement_or_time():
    n = 12
    columns = {name: rising(n) for name in ("time", "load_point", "friction", "velocity", "theta")}
    history, legs = Made(**columns), (LoadStep(2.0, 3.0), LoadStep(1.0, 5.0))
    top, middle, bottom = rate_state.slid(history, columns["friction"] + 1, legs).axes
    x = columns["load_point"]
    assert holds(top, x, columns["friction"] + 1, label="recorded")
    assert holds(top, x, columns["friction"], label="friction")
    assert holds(middle, x, columns["velocity"], label="slider")
    assert holds(middle, [0, 6], [3, 3], label="load point") and holds(middle, [6, 11], [5, 5])
    assert holds(bottom, x, columns["theta"])
    labels = [axes.get_ylabel() for axes in (top, middle, bottom)]
    assert labels == ["friction", "velocity [m/s]", r"state $\theta$ [s]"]
    assert bottom.get_xlabel() == "displacement [m]"
    held = rate_state.slid(history, columns["friction"], (LoadStep(2.0, 3.0), LoadStep(1.0, 0.0))).axes
    assert holds(held[0], columns["time"], columns["friction"]) and held[2].get_xlabel() == "time [s]"


def test_short_slips_are_drawn_in_units_that_fit_them():
    """A load point that goes 0.02 m is drawn in millimetres, legs too."""
    columns = {name: rising(9) for name in ("time", "load_point", "friction", "velocity", "theta")}
    panels = rate_state.slid(Made(**columns), columns["friction"], (LoadStep(2.0, 5e-3), LoadStep(1.0, 1e-2))).axes
    assert holds(panels[0], 1e3 * columns["load_point"], columns["friction"])
    assert holds(panels[1], [0, 10], [5e-3] * 2) and holds(panels[1], [10, 20], [1e-2] * 2)
    assert panels[2].get_xlabel() == "displacement [mm]"
    time, friction, models, left = np.linspace(0, 2, 9), rising(9), rising(9), rising(9)
    data, best = Data(time, friction, (LoadStep(2.0, 0.01),)), Made(law="slip", models=(models,), residuals=(left,))
    top, bottom = rate_state.fitted(data, [best]).axes
    assert holds(top, 10 * time, friction, label="record")
    assert holds(top, 10 * time, models, label="slip law")
    assert holds(bottom, 10 * time, left)
    assert (bottom.get_xlabel(), bottom.get_ylabel()) == ("displacement [mm]", "record − fit")


def test_gouge_is_drawn_in_diameters():
    series = Made(slip=rising(), friction=rising(), thickness=rising())
    above, below = gouge.steady_sliding([Made(tests=[Made(series=series)])], 0.25).axes
    assert holds(above, 4 * series.slip, series.friction)
    assert holds(below, 4 * series.slip, 4 * series.thickness)
    assert (above.get_ylabel(), below.get_ylabel()) == (r"friction $\tau/\sigma$", "thickness / $D$")
    assert below.get_xlabel() == "slip of the upper plate / $D$"


def test_bands_of_gouge_are_two_errors_or_two_deviations():
    curve = Curve(rising(5), np.stack([rising(5), rising(5), rising(5)]), np.arange(3), "words")

    def width(axes):
        corners = axes.collections[0].get_paths()[0].vertices
        return np.ptp(corners[np.isclose(corners[:, 0], curve.x[2]), 1])

    (steps,) = gouge.velocity_steps([curve]).axes
    (held,) = gouge.holds([([curve], {"aging": (curve.x, 2 * curve.x)})]).axes
    deviation = curve.rows[:, 2].std(ddof=1)
    assert width(steps) == pytest.approx(4 * deviation / np.sqrt(3))
    assert width(held) == pytest.approx(4 * deviation)
    for axes in (steps, held):
        assert holds(axes, curve.x, curve.rows.mean(axis=0), label="words")
    assert holds(held, curve.x, 2 * curve.x, label="aging law")
    assert (held.get_xscale(), held.get_xlabel()) == ("log", "time held [s]")
    assert (steps.get_xlabel(), steps.get_xscale()) == ("slip of the load point / $D$", "linear")
    longer = curve._replace(x=4 * curve.x, label="longer")
    (steps,) = gouge.velocity_steps([curve, longer]).axes
    assert steps.get_xscale() == "log" and steps.get_xlim() == (curve.x[curve.x > 0][0], longer.x[-1])


def test_grains_in_a_hold_are_drawn_with_their_energy_and_the_plates_creep():
    """What creeps backwards has no logarithm and is left out."""
    ratios, creep = (
        [Curve(1 + rising(5), np.stack([rising(5), rising(5)]), np.arange(2), label) for label in ("weak", "strong")]
        for _ in range(2)
    )
    creep[1] = creep[1]._replace(rows=creep[1].rows * np.array([1, -1, 1, 1, 1]))
    figure = gouge.energies_in_holds(ratios, creep, 0.3)
    above, below = figure.axes
    for curve in ratios:
        assert holds(above, curve.x, curve.rows.mean(axis=0))
    assert holds(above, [0, 1], [0.3, 0.3])
    assert [text.get_text().strip() for text in above.texts] == ["steady sliding"]
    assert holds(below, creep[0].x, creep[0].rows.mean(axis=0), label="weak")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["weak", "strong"]
    seen = below.lines[1].get_ydata()
    assert np.isnan(seen[1]) and (seen[[0, 2, 3, 4]] > 0).all()
    assert (above.get_xscale(), above.get_yscale(), below.get_yscale()) == ("log",) * 3
    assert (below.get_xlabel(), below.get_ylabel()) == ("time held [s]", "creep of the plate [m/s]")
    assert above.get_ylabel() == "kinetic / elastic energy"


def test_healing_has_peaks_and_slopes_through_their_mean():
    times, peaks = np.array([1.0, 10.0, 100.0]), [Made(value=v, half=0.1) for v in (0.2, 0.5, 0.6)]
    curve = Curve(rising(5), np.stack([rising(5), rising(5)]), np.arange(2), "")
    above, below = gouge.healing(times, peaks, Made(value=0.08, half=0.01), 0.05, curve).axes
    assert holds(above, times, [0.2, 0.5, 0.6])
    for rate, label in ((0.08, "fit"), (0.05, "$b$"), (0.025, "$b/2$")):
        assert holds(above, times, 1.3 / 3 + rate * np.log(times / 10), label=label)
    assert holds(below, curve.x, curve.mean)
    assert (above.get_ylabel(), below.get_ylabel()) == (r"$\mu_{peak} - \mu_{ss}$", r"$\Delta H/D$")


def test_quasi_rigid_curves_stand_over_strain():
    def curve(n):
        return Made(strain=1e-3 * rising(n), ratio=rising(n), volumetric=1e-3 * rising(n), load=np.linspace(0, 1, n))

    slow = [Made(time=1.0, curve=curve(4), error=0.1), Made(time=2.0, curve=curve(6), error=0.05)]
    collapses = [Made(load=3 / 7, quiet=False), Made(load=5 / 7, quiet=True)]
    path = Made(complete=False, loses_stability=True, collapses=collapses)
    sample = Made(curve=curve(8), back=curve(5), path=path, seed=3, slow=slow)
    top, bottom = quasi_rigid.curves([sample], "biaxial").axes
    for axes, name in ((top, "ratio"), (bottom, "volumetric")):
        assert holds(axes, sample.curve.strain, getattr(sample.curve, name), linestyle="-")
        assert holds(axes, sample.back.strain, getattr(sample.back, name), linestyle=":")
        slow = sample.slow[1].curve
        assert holds(axes, slow.strain, getattr(slow, name), linestyle="--")
        assert holds(axes, sample.curve.strain[-1:], getattr(sample.curve, name)[-1:], marker="x")
        assert holds(axes, sample.curve.strain[3:4], getattr(sample.curve, name)[3:4], marker="v")
    assert (top.get_ylabel(), bottom.get_xlabel()) == ("stress ratio", "axial strain")
    texts = [text.get_text() for text in top.get_legend().get_texts()]
    assert texts == ["sample 3", "slow dynamics", "unloading", "stability is lost", "collapse"]
    (axes,) = quasi_rigid.errors([sample]).axes
    assert holds(axes, [1.0, 2.0], [0.1, 0.05], label="sample 3")
    slow.strain[-1] *= 10.0  # a collapse
    top, _ = quasi_rigid.curves([sample], "biaxial").axes
    assert holds(top, slow.strain[:-1], slow.ratio[:-1], linestyle="--")


def test_stiffness_along_a_path():
    n = 6
    looks = Made(load=np.linspace(0, 1, n), lowest=rising(n), symmetric=rising(n), pairs=np.arange(n))
    path = Made(load=np.linspace(0, 1, 4), points=[Made(sliding=k) for k in (3, 1, 4, 2)])
    top, middle, bottom = quasi_rigid.stiffness(Made(path=path, looks=looks, seed=1)).axes
    assert holds(top, path.load, [3, 1, 4, 2])
    assert holds(middle, looks.load, looks.lowest, label=r"of the stiffness $\mathbf{k}$, real part")
    assert holds(middle, looks.load, looks.symmetric)
    assert holds(bottom, looks.load, looks.pairs)
    assert bottom.get_xlabel() == "load (fraction of the path)"
    lines = ["sliding contacts", "smallest eigenvalue\n[$K_n$]", "complex pairs\nof $\\mathbf{m}^{-1}\\mathbf{k}$"]
    assert [axes.get_ylabel() for axes in (top, middle, bottom)] == lines


def test_pairs_of_a_sheared_packing():
    n = 9
    path = Made(strain=1e-4 * np.arange(1, n + 1), pairs=np.array([0, 0, 1, 1, 2, 2, 3, 3, 3]), largest=rising(n),
                smallest=0.1 * rising(n), onset=None, seed=4)  # fmt: skip
    top, bottom = sphere_shear.pairs_along_strain([path], 7e-4).axes
    for name in ("largest", "smallest"):
        assert holds(top, path.strain[:7], np.where(path.pairs > 0, getattr(path, name), np.nan)[:7], marker=".")
        assert name in [line.get_label() for line in top.lines]
    assert holds(bottom, path.strain, path.pairs, label="packing 4")
    assert top.get_xlabel() == bottom.get_xlabel() == r"strain $\gamma$"


def test_stress_falls_beside_its_contacts():
    n = 40
    columns = {name: rising(n) for name in ("time", "shear_stress", "touching")}
    columns |= {"pressure": np.full(n, 4.0), "msd": np.full(n, 1e-12)}
    run = Made(growth_rate=0.01, pairs=1, strain=0.1, **columns)
    figure = sphere_shear.stress_through_failure(run, run)
    beside = [axes for axes in figure.axes if axes.get_ylabel() == "contacts"]
    over = [axes for axes in figure.axes if axes.get_ylabel() == r"$-\sigma_{xy}/p(0)$"]
    assert len(beside) == len(over) == 2
    assert all(holds(axes, run.time, run.touching) for axes in beside)
    assert all(holds(axes, run.time, run.shear_stress / 4) for axes in over)


def test_a_profile_has_the_middle_of_its_bins():
    edges, velocity, deviation = rising(6), RNG.normal(size=(5, 3)), RNG.uniform(0.1, 1, (5, 3))
    (axes,) = flow.velocity_profile(edges, velocity, deviation).axes
    assert holds(axes, velocity[:, 0], (edges[1:] + edges[:-1]) / 2)
    (bars,) = axes.collections
    ends = np.array([segment[:, 0] for segment in bars.get_segments()])
    np.testing.assert_allclose(ends[:, 1] - ends[:, 0], 2 * deviation[:, 0])
    assert "velocity" in axes.get_xlabel() and axes.get_ylabel() == "height $y$ [units of length]"


def test_series_of_a_flow():
    n = 30
    columns = {name: rising(n) for name in ("kinetic_energy", "elastic_energy", "unbalanced", "coordination")}
    columns |= {name: np.stack([rising(n)] * 3, axis=1) * [1, 2, 3] for name in ("center", "high")}
    series = Made(time=rising(n), sliding_fraction=RNG.uniform(0, 1, n), **columns)
    result = Made(series=series, poured=Made(plates=()), stages=[Made(start=0.0, end=9.0, name="fall")])
    energy, force, contacts, place, share = flow.time_series(result).axes
    for axes, name, label in ((energy, "kinetic_energy", "energy\n[units of energy]"),
                              (energy, "elastic_energy", "energy\n[units of energy]"),
                              (force, "unbalanced", "unbalanced force\nover contact force"),
                              (contacts, "coordination", "coordination $z$"),
                              (share, "sliding_fraction", "sliding fraction")):  # fmt: skip
        assert holds(axes, series.time, getattr(series, name)), name
        assert axes.get_ylabel() == label
    for k, name in enumerate("xy"):
        assert holds(place, series.time, series.center[:, k], label=f"centre of mass, ${name}$")
        assert holds(place, series.time, series.high[:, k], linestyle="--")


def test_claims_stand_at_their_deviation():
    rows = [
        Row("speed", "Fig 1", "reproduced", (0.4,), 0.2, "0.08", "0.075", False),
        Row("window", "Fig 1", "partly", (-0.5, 2.5), 0.0, "0.1–0.5", "0.1–0.2", False),
        Row("far", "Fig 2", "not reproduced", (-9.0,), 0.0, "1", "9", False, "pairs"),
        Row("far", "Fig 2 @other", "not reproduced", (), 0.0, "2", "9", False, own=False),
    ]
    figure = claims_chart(rows, "Paper 9")
    (axes,) = figure.axes
    assert holds(axes, [0.4], [0], marker="o")
    assert holds(axes, [0.2, 0.6], [0, 0])  # one error to either side
    assert holds(axes, [-0.5, 2.5], [1, 1])
    assert holds(axes, [-4.2], [2], marker="<")
    assert axes.get_xlabel() == "(measured − paper) / tolerance"
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "Fig 1:  speed", "window", "Fig 2:  far", "Fig 2 @other:  far",
    ]  # fmt: skip
    assert {"unit", "pairs"} <= {text.get_text() for text in axes.texts}
    (legend,) = figure.legends  # counts as on the terminal: those of variants are not added to those of the paper
    assert "not reproduced (1 + 1 of variants)" in [text.get_text() for text in legend.get_texts()]
