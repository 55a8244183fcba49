"""Paper 000, end to end: the transition from static to dynamic friction in an array of disks.

Charan, Chattoraj, Pica Ciamarra, Procaccia, doi:10.48550/arXiv.1908.11724. Units: 2R = m = k_n = 1, forces in the
paper's numbers (a force of 1 is 1/2000 here, as k_n = 2000 there), time in √(m/(k_n √(2R))).

Two scenarios. `main` is the printed model with I0 = 1/2, a disk's. `quarter` is a hypothesis found by search, without
a documented reason: disk–disk normal stiffness a quarter of the printed one, I0 = 1. It is labelled so everywhere.
"""

from typing import NamedTuple

import numpy as np

from ..data.kept import UNFINISHED
from ..data.scenario import Scenario, scenario
from ..ensemble import Workers
from ..loading import fronts
from ..loading.protocols import Equilibrium, Protocol, dominant_family, stable_window
from ..loading.run import Ensemble, Report, Result, at_load, protocol_of, push, silent, simulate
from ..solve.spectrum import Spectrum
from .claims import NOT_REPRODUCED, Claim, claim

FRONT_LOADS = (0.083, 0.087, 0.090)
V2_THRESHOLD = 0.05
LINE_TOP = 0.090  # Eq 10 is fitted to the loads that the paper names
MODE_LOAD = 0.083  # where the y mode is shown: the smallest push at which the paper's array slides
CUTS = (
    "16 realizations of sliding at each load instead of 200 (quarter: 8 instead of 100); "
    "M(t) for 30000 time units instead of 60000; sliding for 25000 instead of 40000 (quarter: 60000 instead of 80000)"
)


class Reproduction(NamedTuple):
    """Both scenarios, run, and the claims that they support."""

    main: Result
    quarter: Result
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> Scenario:
    """The printed model: N = 10, μ = 10, k_t = 2/7 k_n, smooth Coulomb, F_y = 0.1."""
    return scenario(
        seed=seed,
        load={"push": (0.0, 0.12), "step": 5e-4},
        dynamics={"duration": 30_000.0 if quick else 60_000.0, "watch": 0.083},
        sliding={
            "loads": (*FRONT_LOADS, 0.095, 0.1, 0.12),
            "realizations": 16 if quick else 200,
            "duration": 25_000.0 if quick else 40_000.0,
        },
    )


def quarter_scenario(*, quick: bool = False, seed: int = 0) -> Scenario:
    """The hypothesis: disk–disk normal stiffness divided by four, I0 = 1; everything else as printed."""
    main = paper_scenario(quick=quick, seed=seed)
    return scenario(
        seed=seed,
        array={"i0": 1.0},
        law={"kn": 0.25, "wall": {"kn": 1.0}},
        load=main.load.model_dump(),
        dynamics={"loads": ()},
        sliding=main.sliding.model_dump()
        | {
            "loads": (*FRONT_LOADS, 0.1),
            "realizations": 8 if quick else 100,
            "duration": 60_000.0 if quick else 80_000.0,
        },
    )


def reproduce(
    *, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent
) -> Reproduction:
    """Run both scenarios and judge every claim of the paper.

    Parameters
    ----------
    quick : fewer realizations and shorter runs (CUTS says which)
    seed : of all random velocities
    workers : processes for the realizations, or a Dask scheduler's address
    report : called as report(stage, share done, words)
    """
    main = simulate(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    quarter = simulate(
        quarter_scenario(quick=quick, seed=seed),
        folder=folder and folder / UNFINISHED / "quarter",
        workers=workers,
        report=lambda stage, share, words: report(f"{stage} (quarter)", share, words),
    )
    report("claims", 0.0, "births by bisection, for four load steps")
    return Reproduction(main, quarter, judged(main, quarter, lambda share, words: report("claims", share, words)))


def judged(main: Result, quarter: Result, report=lambda share, words: None) -> list[Claim]:
    """All claims, the main scenario's first; `report(share done, words)` is called along ramps of other steps."""
    printed = _wall_mode(main) + _spectra(main, "", 0.05, lambda s, w: report(0.5 * s, w)) + _dynamics(main)
    printed += _fronts(main) + _sliding(main, "") + _y_mode(main)
    suffix = "@quarter"
    return (
        printed
        + _spectra(quarter, suffix, 0.07, lambda s, w: report(0.5 + 0.5 * s, w))
        + _sliding(quarter, suffix)
        + [_backward(quarter, suffix)]
    )


def _wall_mode(main: Result) -> list[Claim]:
    modes = main.pressed_spectrum
    k = y_mode(modes)
    press = main.scenario.load.press * main.scenario.load.unit
    closed = np.sqrt(1.5 * press ** (1 / 3))
    note = f"closed form sqrt(1.5 sqrt(delta_w)), delta_w = (F_y/k_n)^(2/3): {closed:.6f}; fixes the units"
    return [claim("wall-mode-frequency", "Fig 6", 0.235, float(modes.frequency[k]), "sqrt(k_n (2R)^1/2/m)", 0.01, note)]


def _spectra(result: Result, suffix: str, near: float, report) -> list[Claim]:
    out = []
    for load, paper in {0.030: 1, 0.040: 1, 0.062: 0}.items():
        modes = at_load(result.path, load).spectrum
        note = "Im lambda " + (", ".join(f"{v:.2e}" for v in modes.im_lambda[modes.pairs]) or "zero throughout")
        out.append(claim(f"pairs-at-{load:.3f}{suffix}", "Figs 2, 3", paper, len(modes.pairs), "pairs", 0.0, note))
    protocol = protocol_of(result.scenario, result.law)
    paths = {}
    for k, step in enumerate((5e-3, 2e-3, 1e-3)):

        def heard(_, share: float, words: str, k=k, step=step) -> None:
            report((k + share) / 3, f"load step {step:g}: {words}")

        paths[step] = push(result.scenario, step=step, report=heard)[2]
    paths[result.scenario.load.step] = result.path
    windows = {step: stable_window(path, near, protocol) for step, path in paths.items()}
    births = {step: late_birth(path, protocol) for step, path in paths.items()}
    window, born = windows[result.scenario.load.step], births[result.scenario.load.step]
    note = f"the paper prints no lower end; by load step of the ramp {_by_step(windows)}"
    out.append(claim(f"stable-window{suffix}", "Fig 2", [0.062, 0.082], window, "F_x", 0.02, note))
    note = f"bisected to 1e-6 from one state; by load step of the ramp {_by_step(births)}"
    out.append(claim(f"late-pair-birth{suffix}", "Fig 2", 0.082, born, "F_x", 0.01, note))
    for load, paper in {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}.items():
        modes = at_load(result.path, load).spectrum
        note = f"{len(modes.pairs)} pair(s)"
        if born:
            note += f"; {load - born:.5f} above the birth, from where Im lambda rises as a square root"
        found = float(modes.im_lambda.max())
        out.append(claim(f"im-lambda-{load:.3f}{suffix}", "p. 4", paper, found, "k_n (2R)^1/2/m", 0.1, note))
    if suffix:
        return out
    why = "; Fig 2 does not follow from the printed model, but see @quarter"
    return [c._replace(note=c.note + why) if c.verdict == NOT_REPRODUCED else c for c in out]


def _by_step(values: dict) -> str:
    def words(value):
        return "none" if value is None else "–".join(f"{v:.6f}" for v in np.ravel(value))

    return ", ".join(f"{step:g}: {words(value)}" for step, value in values.items())


def late_birth(path: list[Equilibrium], protocol: Protocol, load: float = 0.083) -> float | None:
    """F_x at which the pair that dominates (largest Im λ) at `load` was born, on a rising path."""
    found = dominant_family([point for point in path if point.load <= load], protocol)
    if found is None:
        return None
    return found.birth.load if found.birth else float(found.loads[0])


def _dynamics(main: Result) -> list[Claim]:
    out = []
    for load in (0.030, 0.040, 0.083, 0.087, 0.090):
        free = main.free_runs[load]
        ratio = free.growth.growth_rate / free.predicted_growth if free.growth else None
        note = f"predicted {free.predicted_growth:.4e}"
        if free.growth:
            note += f", fitted {free.growth.growth_rate:.4e} over {free.growth.decades:.1f} decades of M"
        out.append(claim(f"growth-rate-ratio-{load:.3f}", "p. 3", 1.0, ratio, "1", 0.02, note))
    for load in (0.030, 0.040):
        free = main.free_runs[load]
        wall = "a wall contact reaches" if np.isfinite(free.breach).any() else "no wall contact reaches"
        note = f"the paper says about 1e-5, read as within a factor of two; {wall} Coulomb's limit"
        out.append(claim(f"msd-saturation-{load:.3f}", "Fig 3", 1e-5, free.saturation, "(2R)^2", 1.0, note))
    free = main.free_runs[0.083]
    note = "no contact reaches Coulomb's limit"
    if np.isfinite(free.breach).any():
        _, i, j = free.first_limit
        first = np.nanargmin(free.breach) + 1
        note = f"contact {i + 1:.0f}–{j + 1:.0f} is first at the limit, disk {first} is first among wall contacts"
    out.append(claim("sliding-0.083", "Fig 3", True, free.slid, "", 0.0, note))
    return out


def forward_front(result: Result, ensemble: Ensemble) -> fronts.Front | None:
    """Breaching of Coulomb's limit at the substrate, from the pushed disk along the row."""
    order, distance = fronts.along_row(result.pressed, result.scenario.load.disk - 1)
    return fronts.front(ensemble.breach, order, distance, result.scenario.seed)


def backward_front(result: Result, threshold: float, loads=None) -> fronts.Front | None:
    """Actual sliding by more than a threshold, from the last disk against the row, over all realizations at `loads`."""
    n, how = result.scenario.array.disks, result.scenario.sliding
    order, distance = fronts.along_row(result.pressed, (result.scenario.load.disk - 2) % n, backward=True)
    times = [result.sliding[load].slide[:, how.thresholds.index(threshold)] for load in loads or result.sliding]
    return fronts.front(np.concatenate(times), order, distance, result.scenario.seed)


def _about(found: fronts.Front, result: Result, loads) -> str:
    failed = sum(len(result.sliding[load].failures) for load in loads)
    words = f"± {found.speed_error:.1e}, {found.counted} realizations, {found.complete} of them complete"
    return words + (f", {failed} failed" if failed else "")


def _fronts(main: Result) -> list[Claim]:
    out = []
    for load, paper in zip(FRONT_LOADS, (0.0014, 0.0022, 0.0028), strict=True):
        found = forward_front(main, main.sliding[load])
        speed, error, note = None, 0.0, "no front"
        if found:
            speed, error = found.speed, found.speed_error
            strongest = float(at_load(main.path, load).spectrum.im_lambda.max())
            note = (
                f"{_about(found, main, [load])}; with free intercept {found.free_intercept:.2e}; "
                f"V_1/Im lambda {speed / strongest:.2f} (paper 4.3 ± 1.5)"
            )
        name = f"forward-front-speed-{load:.3f}"
        out.append(claim(name, "Fig 5", paper, speed, "length/time", 0.25, note, error))
    return [*out, _backward(main, "")]


def _backward(result: Result, suffix: str) -> Claim:
    name, thresholds = f"backward-front-speed{suffix}", result.scenario.sliding.thresholds
    found = {t: backward_front(result, t, FRONT_LOADS) for t in thresholds}
    middle = found[V2_THRESHOLD]
    if not middle:
        return claim(name, "Fig 5", 0.075, None, "length/time", 0.25, "no front")
    times = np.concatenate([result.sliding[load].slide[:, thresholds.index(V2_THRESHOLD)] for load in FRONT_LOADS])
    times = times[np.isfinite(times).all(axis=1)]
    last = float((times.argmin(axis=1) == times.shape[1] - 1).mean()) if len(times) else 0.0
    note = (
        f"{_about(middle, result, FRONT_LOADS)}; by threshold "
        f"{', '.join(f'{t:g}: {f.speed:.3f}' for t, f in found.items() if f)}; "
        f"with free intercept {middle.free_intercept:.3f}; the last disk slides first in {last:.0%}"
    )
    return claim(name, "Fig 5", 0.075, middle.speed, "length/time", 0.25, note, middle.speed_error)


class Line(NamedTuple):
    """Sliding velocity against push, with V = intercept + slope F_x fitted to some of the loads."""

    push: np.ndarray  # (L,) all loads
    velocity: np.ndarray  # (L,) means over realizations that slid in time
    error: np.ndarray  # (L,) standard errors of the means
    slope: float
    intercept: float
    slope_error: float
    intercept_error: float


def velocity_line(result: Result, top: float = np.inf) -> Line | None:
    """Fit of Eq 10, weighted, to mean sliding velocities at pushes up to `top`; None with fewer than three of them."""
    rows = []
    for load, ensemble in result.sliding.items():
        good = ensemble.velocity[np.isfinite(ensemble.velocity)]
        if len(good) > 2:
            rows.append((load, good.mean(), good.std(ddof=1) / np.sqrt(len(good))))
    if sum(load <= top for load, *_ in rows) < 3:
        return None
    load, mean, error = np.array(rows).T
    use = load <= top
    (slope, intercept), covariance = np.polyfit(load[use], mean[use], 1, w=1 / error[use], cov="unscaled")
    slope_error, intercept_error = np.sqrt(np.diag(covariance))
    return Line(load, mean, error, float(slope), float(intercept), float(slope_error), float(intercept_error))


def _sliding(result: Result, suffix: str) -> list[Claim]:
    line = velocity_line(result, LINE_TOP)
    slope, error, note = None, 0.0, "fewer than three loads at which realizations slide in time"
    if line:
        slope, error = line.slope, line.slope_error
        wider = {top: velocity_line(result, top).slope for top in line.push if top > LINE_TOP}
        slid = [int(np.isfinite(result.sliding[load].velocity).sum()) for load in FRONT_LOADS]
        note = (
            f"± {error:.1e} from the loads that the paper names, {'+'.join(map(str, slid))} realizations in time; "
            f"V is convex, up to {', '.join(f'{top:g}: {value:.2e}' for top, value in wider.items())}"
        )
    out = [claim(f"sliding-velocity-slope{suffix}", "Eq 10", 4.5e-4, slope, "velocity per F_x", 0.1, note, error)]
    if not suffix:
        if line:
            note = (
                f"± {line.intercept_error:.1e}; -1.3e-3 as printed would make every velocity negative, -1.3e-5 "
                f"is what the paper's figure implies"
            )
        intercept = line.intercept if line else None
        out.append(claim("sliding-velocity-intercept", "Eq 10", -1.3e-3, intercept, "velocity", 0.2, note))
    return out


def y_mode(modes: Spectrum) -> int:
    """Index of the mode with the largest share in y."""
    return int(np.argmax(modes.shares()[:, 1]))


def _y_mode(main: Result) -> list[Claim]:
    modes = at_load(main.path, MODE_LOAD).spectrum
    k, shares = y_mode(modes), modes.shares()
    others = f"x {shares[k, 0]:.1%}, rotation {shares[k, 5]:.1%}, at F_x = {MODE_LOAD}"
    return [
        claim("y-mode-share", "Fig 6", 1.0, float(shares[k, 1]), "fraction", 0.1, others),
        claim(
            "y-mode-frequency",
            "Fig 6",
            0.235,
            float(modes.frequency[k]),
            "sqrt(k_n (2R)^1/2/m)",
            0.05,
            "the mode with the largest share in y",
        ),
    ]
