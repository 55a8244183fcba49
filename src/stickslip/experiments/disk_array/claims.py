"""Evaluation of the claims of Charan et al. 2020, doi:10.48550/arXiv.1908.11724, including its supplement."""

import numpy as np

from ...core.readable import pluralize
from ...ensemble import Workers
from ...loading.protocols import stable_window
from ...loading.threshold import KineticThreshold
from ...reports.claims import Claim, claim, format_value
from ..realizations import Report, Task, run_realizations, silent
from .arrest import ARREST_LOADS, Arrest
from .fronts import Front
from .measures import (
    LATE,
    backward_front,
    forward_front,
    growth_error,
    growth_factor,
    late_birth,
    saturation_error,
    speed_proportion,
    velocity_line,
    y_mode,
)
from .simulate import DiskArrayResult, make_protocol, point_at_load, push_disk_array

FRONT_LOADS = (0.083, 0.087, 0.090)
STABLE_LOAD = 0.062
GROWTH_LOADS = (0.030, 0.040, 0.083, 0.087, 0.090)
V2_THRESHOLD = 0.05
LINE_TOP = 0.090  # largest load in the fit of Eq 10: that of the loads named in the paper
MODE_LOAD = 0.083  # load at which the y mode is shown: the smallest push at which the paper's array slides
COARSER = (5e-3, 2e-3, 1e-3)  # extra load steps; the difference from the last one is the error of a birth
BISECTED = 1e-6  # width to which births and deaths are bisected [F_x]
IM_LAMBDA = {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}
V1 = {0.083: 0.0014, 0.087: 0.0022, 0.090: 0.0028}
# growth of the mean M from the first to the last quarter of a run: beats of stable modes stay far below, pairs above
RISE = 10.0
SHOWS = {
    "Fig 2": ("complex pairs along the push", "late-pair-birth"),
    "Fig 3": ("M(t) at six pushes", "stable-msd-0.062"),
    "Fig 4": ("trajectory of a disk: plotted, without a number", ""),
    "Fig 5": ("fronts of breaching and of sliding", "v1-over-im-lambda"),
    "Fig 6": ("transverse mode", "y-mode-frequency"),
    "Fig 7": ("sliding velocity against push", "sliding-velocity-slope"),
}
TOLERANCE = {
    "pairs": 0.0,  # counts
    "window": 0.02,  # 0.082 and 0.062 are printed with two digits: more than half a unit of the last, 0.8 %
    "birth": 0.01,  # 0.082 is printed with two digits: half a unit of the last is 0.6 %
    "im-lambda": 0.1,  # printed with one or two digits: half a unit of the last is 5 % of 0.001
    "growth": 0.02,  # linear theory is exact; the fit window ends where contacts begin to open
    "saturation": 1.0,  # the paper says "about" and prints a power of ten: a factor of two either way
    "threshold": 0.1,  # the paper's loads of arrest and of sliding differ by a factor of two
    "front": 0.25,  # nearly three times the largest error that the paper gives for V_1 with its 25 realizations, 9 %
    "ratio": 1.5 / 4.3,  # the scatter that the paper prints: 4.3 ± 1.5
    "exponent": 0.21,  # over Im λ from 2.4e-4 to 1.0e-3, this change of the power equals the ratio's scatter of 35 %
    "slope": 0.1,  # printed with two digits and no error: typical of a fit to a handful of velocities
    "intercept": 0.2,  # as for the slope, but the intercept extrapolates over nine tenths of the push
    "share": 0.1,  # the figure shows no x and no rotation: bars of 0.3 would be visible, and their square is 0.1
    "frequency": 0.05,  # "approximately"; printed with three digits, at a push that is not stated
    "closed form": 1e-6,  # exact; the relaxation ends at a residual of 1e-14
}


def evaluate_claims(
    main: DiskArrayResult, quarter: DiskArrayResult, arrests: list[Arrest], threshold: KineticThreshold,
    workers: Workers = None, report: Report = silent,
) -> list[Claim]:  # fmt: skip
    """Evaluate all claims, those of the main scenario first.

    Parameters
    ----------
    arrests, threshold : of the main scenario
    report : called as report(stage, share done, words) during the ramps with other load steps
    """
    suffix = "@quarter"
    tasks = [
        Task("claims about spectra", (result, *about), about[0], None)
        for result, *about in ((main, "", 0.05), (quarter, suffix, 0.07))
    ]
    ramps = run_realizations(_spectrum_claims, tasks, stage="claims", workers=workers, report=report)
    printed_spectra, quarter_spectra = ramps.complete
    printed = printed_spectra + _dynamics_claims(main)
    printed += [row for arrest in arrests for row in _arrest_claims(arrest)] + _threshold_claims(threshold)
    printed += _front_claims(main) + _ratio_claims(main) + _mode_claims(main) + _sliding_claims(main, "")
    return [
        *printed, *quarter_spectra, _stability(quarter, suffix), *_backward_claims(quarter, suffix),
        *_sliding_claims(quarter, suffix),
    ]  # fmt: skip


def _spectrum_claims(result: DiskArrayResult, suffix: str, near: float, tell) -> list[Claim]:
    protocol, paths = make_protocol(result.scenario, result.law), {}
    for k, step in enumerate(COARSER):

        def heard(_, share: float, words: str, k=k, step=step) -> None:
            tell((k + share) / len(COARSER), f"load step {step:g}{suffix}: {words}")

        paths[step] = push_disk_array(result.scenario, step=step, report=heard)[2]
    step = result.scenario.load.step
    paths[step] = result.path
    windows = {s: stable_window(path, near, protocol) for s, path in paths.items()}
    births = {s: late_birth(path, protocol) for s, path in paths.items()}
    out = [_pair_count(result, load, suffix) for load in (0.030, 0.040, STABLE_LOAD)]
    out.append(claim(
        f"stable-window{suffix}", "Fig 2: range without pairs; its ends are not printed", None, windows[step] or [],
        "F_x", TOLERANCE["window"], f"for each load step of the ramp: {_format_by_step(windows)}",
        error=_sensitivity(windows[step], windows[COARSER[-1]]), reference=[STABLE_LOAD, 0.082],
        reference_source="a push that the text calls stable, and the push above which the supplement finds instability",
    ))  # fmt: skip
    out.append(claim(
        f"late-pair-birth{suffix}",
        'Fig 2: supplement, "the system becomes unstable for all force values F_x > 0.082"', 0.082, births[step],
        "F_x", TOLERANCE["birth"],
        f"bisected to 1e-6 from one state; for each load step of the ramp: {_format_by_step(births)}",
        error=_sensitivity(births[step], births[COARSER[-1]]),
    ))  # fmt: skip
    out += [_im_lambda(load, result, paths[COARSER[-1]], births[step], suffix) for load in IM_LAMBDA]
    return out


def _sensitivity(fine, coarse) -> float | None:
    """Largest difference between two load steps, but at least the bisection width; None if either has no value."""
    return None if fine is None or coarse is None else max(BISECTED, float(np.abs(np.subtract(fine, coarse)).max()))


def _format_by_step(values: dict) -> str:
    def words(value):
        return "none" if value is None else "–".join(f"{v:.6f}" for v in np.ravel(value))

    return ", ".join(f"{step:g}: {words(value)}" for step, value in values.items())


def _pair_count(result: DiskArrayResult, load: float, suffix: str) -> Claim:
    modes = point_at_load(result.path, load).spectrum
    said = '"for ... F_x = 0.03 and 0.04 the oscillatory instability exists", one pair in the figure'
    if load == STABLE_LOAD:
        said = '"for F_x = 0.062 all the eigenvalues of J are real"'
    note = "Im lambda " + (", ".join(f"{v:.2e}" for v in modes.pairs.imag) or "zero throughout")
    return claim(
        f"pairs-at-{load:.3f}{suffix}", f"Fig 2: {said}", 0 if load == STABLE_LOAD else 1, len(modes.pairs), "pairs",
        TOLERANCE["pairs"], note, error=0.0,
    )  # fmt: skip


def _im_lambda(load: float, result: DiskArrayResult, coarse, born: float | None, suffix: str) -> Claim:
    modes, other = point_at_load(result.path, load).spectrum, point_at_load(coarse, load).spectrum
    note = pluralize(len(modes.pairs), "pair")
    if born:
        note += f"; {load - born:.5f} above the birth, from which Im lambda rises as a square root"
    return claim(
        f"im-lambda-{load:.3f}{suffix}", 'Fig 2: text before Eq 10, "0.00024, 0.00077 and 0.001 respectively"',
        IM_LAMBDA[load], float(modes.im_lambda.max()), "k_n (2R)^1/2/m", TOLERANCE["im-lambda"], note,
        error=abs(modes.im_lambda.max() - other.im_lambda.max()),
    )  # fmt: skip


def _dynamics_claims(main: DiskArrayResult) -> list[Claim]:
    return [*(_growth(main, load) for load in GROWTH_LOADS), _stability(main, ""),
            *(_saturation(main, load) for load in (0.030, 0.040)), _sliding_onset(main)]  # fmt: skip


def _growth(main: DiskArrayResult, load: float) -> Claim:
    free = main.free_runs[load]
    ratio, error, note = None, None, f"predicted {free.predicted_growth:.4e}"
    if free.growth:
        ratio, spread = free.growth.growth_rate / free.predicted_growth, growth_error(free)
        error = None if spread is None else spread / free.predicted_growth
        note += f", fitted {free.growth.growth_rate:.4e} over {free.growth.decades:.1f} decades of M"
    return claim(
        f"growth-rate-ratio-{load:.3f}", "Fig 3: growth of M; no rate is printed", None,
        ratio, "1", TOLERANCE["growth"], note, error=error, reference=1.0,
        reference_source="linear theory: M grows as exp(2 ω_i t), doi:10.1103/PhysRevE.101.052902, Eq 9",
    )  # fmt: skip


def _stability(result: DiskArrayResult, suffix: str) -> Claim:
    """Claim about M(t) at the push where the paper's array is stable: no growth and no pair."""
    free = result.free_runs.get(STABLE_LOAD)
    measured, note = None, "no run at this push"
    if free is not None:
        rise = growth_factor(free)
        measured = bool(rise < RISE)
        note = (
            f"mean M in the last 1/{LATE} of {free.time[-1]:.0f} time units over that in the first: {rise:.2g}; "
            f"M at the end: {free.msd[-1]:.1e}; fastest growth rate of the spectrum: {free.predicted_growth:.1e}"
        )
    return claim(
        f"stable-msd-{STABLE_LOAD:.3f}{suffix}",
        'Fig 3: "for F_x = 0.062 the system is stable and M(t) remains minute", "never increases"', True, measured, "",
        0.0, note,
    )  # fmt: skip


def _saturation(main: DiskArrayResult, load: float) -> Claim:
    free = main.free_runs[load]
    wall = "a wall contact reaches" if np.isfinite(free.breach).any() else "no wall contact reaches"
    return claim(
        f"msd-saturation-{load:.3f}",
        'Fig 3: "the MSD becomes stationary at a minute fraction the disk radius (about 10^-5)"', 1e-5,
        free.saturation, "(2R)^2", TOLERANCE["saturation"],
        f"{wall} the Coulomb limit; error from block averages of one run",
        error=saturation_error(free),
    )  # fmt: skip


def _sliding_onset(main: DiskArrayResult) -> Claim:
    free = main.free_runs[0.083]
    note = "no contact reaches the Coulomb limit"
    if np.isfinite(free.breach).any():
        _, i, j = free.first_limit
        first = np.nanargmin(free.breach) + 1
        note = (
            f"contact {i + 1:.0f}–{j + 1:.0f} is the first at the limit; disk {first} is the first among wall contacts"
        )
    said = 'Fig 3: at 0.083 "the Coulomb law is breached", "subsequently M(t) increases linearly in time"'
    return claim("sliding-0.083", said, True, free.slid, "", 0.0, note)


def _arrest_claims(arrest: Arrest) -> list[Claim]:
    """Claims that the array comes to rest in another equilibrium, and that M is the displacement to it."""
    static, count = arrest.static, len(arrest.static)
    kept = ", ".join(map(str, arrest.neighbours))
    return [
        claim(
            f"arrest-msd-{arrest.load:.3f}",
            'Fig 3: "the MSD becomes stationary at a minute fraction the disk radius (about 10^-5)"', 1e-5,
            float(static.mean()), "(2R)^2", TOLERANCE["saturation"],
            f"M of the equilibria to which {count} late states of the run relax: {static.min():.2e} to "
            f"{static.max():.2e}; of {arrest.before} disk–disk contacts they have {kept}",
            error=float(static.std(ddof=1)), reference=float(arrest.late.mean()),
            reference_source="M of the same late states in motion: if the two agree, M is a displacement at rest",
        ),
        claim(
            f"arrest-pairs-{arrest.load:.3f}", "Fig 3: the MSD becomes stationary; not explained", None,
            float(np.median(arrest.pairs)), "pairs", TOLERANCE["pairs"],
            f"median of the equilibria to which {count} late states relax; {(arrest.pairs == 0).sum()} have none",
            error=0.0, reference=0.0,
            reference_source="arrest in a stable equilibrium",
        ),
    ]  # fmt: skip


def _threshold_claims(found: KineticThreshold) -> list[Claim]:
    """Claims about the kinetic threshold, and that it separates the paper's loads of arrest and of sliding."""
    at, (low, high), top = float(found.lasting_threshold[0]), found.lasting_interval[0], min(FRONT_LOADS)
    outcomes = zip(found.loads, found.probability[:, 0], found.lasting_probability[:, 0], strict=True)
    shares = ", ".join(f"{slid:.2g} and {lasting:.2g} at {load:g}" for load, slid, lasting in outcomes)
    note = (
        f"load at which half of the kicked runs slide on; shares of {found.runs[0, 0]} runs from velocities of "
        f"{found.kicks[0]:g} that slide by {found.distance:g}, and that slide on: {shares}"
    )
    stops, (last, first) = "no sliding array came to rest at a lower load", found.arrest_range
    if np.isfinite(last):
        stops = f"{pluralize(len(found.arrest), 'sliding array')} stopped between {last:g} and {first:g}"
    known = bool(np.isfinite([at, low, high]).all())
    return [
        claim(
            "kinetic-threshold", "Fig 3: between 0.04 and 0.083; not printed", None, at if known else None, "F_x",
            TOLERANCE["threshold"], f"{note}; 95 % between {low:.4f} and {high:.4f}; {stops}",
            error=(high - low) / 3.92 if known else None,
        ),
        claim(
            "threshold-between-arrest-and-sliding",
            'Fig 3: "the MSD becomes stationary" at 0.03 and 0.04, "M(t) increases linearly in time" at 0.083',
            True, bool(max(ARREST_LOADS) < low and high < top) if known else None, "", 0.0,
            f"whether the kinetic threshold, {low:.4f} to {high:.4f} (95 %), lies between 0.04 and {top:g}",
        ),
    ]  # fmt: skip


def _count_realizations(found: Front, result: DiskArrayResult, loads) -> str:
    failed = sum(len(result.sliding[load].failures) for load in loads)
    words = f"{found.counted} realizations, {found.complete} of them complete"
    return words + (f", {failed} failed" if failed else "")


def _speed_claims(name: str, suffix: str, source: str, paper: float, found: Front | None, note: str) -> list[Claim]:
    """Claims about a front speed by both estimators: through the front's start (Eq 9), and with a free intercept."""
    unit, tolerance = "length/time", TOLERANCE["front"]
    if not found:
        note = "no front: too few realizations in which the event happens at every disk before the run ends"
        return [claim(f"{name}{end}{suffix}", source, paper, None, unit, tolerance, note) for end in ("", "-free")]
    other = f"through the start {format_value(found.speed)}, with a free intercept {format_value(found.free_intercept)}"
    return [
        claim(f"{name}{suffix}", source, paper, found.speed, unit, tolerance,
              f"fitted through the start of the front, as in Eq 9; {other}; {note}", error=found.speed_error),
        claim(f"{name}-free{suffix}", source, paper, found.free_intercept, unit, tolerance,
              f"fitted with a free intercept; {other}; the paper does not say which one it used; {note}",
              error=found.free_error),
    ]  # fmt: skip


def _front_claims(main: DiskArrayResult) -> list[Claim]:
    out = []
    for load, paper in V1.items():
        found = forward_front(main, main.sliding[load])
        said = 'Fig 5: "0.0014 ± 0.00013, 0.0022 ± 0.00015 and 0.0028 ± 8e-5"'
        note = _count_realizations(found, main, [load]) if found else ""
        out += _speed_claims(f"forward-front-speed-{load:.3f}", "", said, paper, found, note)
    return [*out, *_backward_claims(main, "")]


def _ratio_claims(main: DiskArrayResult) -> list[Claim]:
    """Claims about V_1/Im λ at the paper's loads, and about p in V_1 ∝ (Im λ)^p over all sliding loads."""
    printed = float(np.polyfit(np.log(list(IM_LAMBDA.values())), np.log(list(V1.values())), 1)[0])
    strongest = {load: float(point_at_load(main.path, load).spectrum.im_lambda.max()) for load in main.sliding}
    said = '"an approximate constant value 4.3 ± 1.5" for velocities divided by Im λ'
    out = []
    for free, end in ((False, ""), (True, "-free")):
        three = speed_proportion(main, {load: strongest[load] for load in FRONT_LOADS}, free=free)
        wide = speed_proportion(main, strongest, free=free)
        ratio = three.mean_ratio if len(three.load) == len(FRONT_LOADS) else (None, None)
        power = wide.exponent or (None, None)
        words = ", ".join(f"{r:.2f} at {load:g}" for load, r in zip(wide.load, wide.ratio, strict=True)) or "no front"
        how = "with a free intercept" if free else "through the start of the front"
        out += [
            claim(f"v1-over-im-lambda{end}", f"Fig 5: {said}", 4.3, ratio[0], "length·time",
                  TOLERANCE["ratio"], f"fit {how}, mean over the paper's three loads; {words}", error=ratio[1]),
            claim(f"v1-power-of-im-lambda{end}", f"Fig 5: {said}: V_1 ∝ Im λ", 1.0, power[0], "1",
                  TOLERANCE["exponent"], f"p in V_1 ∝ (Im λ)^p, fit {how}, over {len(wide.load)} loads from "
                  f"{min(strongest):g} to {max(strongest):g}", error=power[1], reference=printed,
                  reference_source="fitted to the three pairs of V_1 and Im λ that the paper prints"),
        ]  # fmt: skip
    return out


def _backward_claims(result: DiskArrayResult, suffix: str) -> list[Claim]:
    thresholds = result.scenario.sliding.thresholds
    found = {t: backward_front(result, t, FRONT_LOADS) for t in thresholds}
    middle, note = found[V2_THRESHOLD], ""
    if middle:
        times = np.concatenate([result.sliding[load].slide[:, thresholds.index(V2_THRESHOLD)] for load in FRONT_LOADS])
        times = times[np.isfinite(times).all(axis=1)]
        last = float((times.argmin(axis=1) == times.shape[1] - 1).mean()) if len(times) else 0.0
        note = (
            f"{_count_realizations(middle, result, FRONT_LOADS)}; for each threshold: "
            f"{', '.join(f'{t:g}: {f.speed:.3f}' for t, f in found.items() if f)}; the last disk slides first in "
            f"{last:.0%} of the complete realizations"
        )
    said = 'Fig 5: "V_2 ≈ 0.235/π ≈ 0.075 in excellent agreement with the measured value"'
    return _speed_claims("backward-front-speed", suffix, said, 0.075, middle, note)


def _sliding_claims(result: DiskArrayResult, suffix: str) -> list[Claim]:
    line = velocity_line(result, LINE_TOP)
    slope, error, note = None, None, "fewer than three loads at which realizations slide before the run ends"
    if line:
        slope, error = line.slope, line.slope_error
        wider = {top: velocity_line(result, top).slope for top in line.push if top > LINE_TOP}
        slid = [int(np.isfinite(result.sliding[load].velocity).sum()) for load in FRONT_LOADS]
        note = (
            f"fitted to the loads named in the paper, where {'+'.join(map(str, slid))} realizations slide before "
            f"the run ends; V is convex: slopes from fits up to larger loads are "
            f"{', '.join(f'{value:.2e} up to {top:g}' for top, value in wider.items())}"
        )
    out = [claim(
        f"sliding-velocity-slope{suffix}", "Fig 7: Eq 10, 4.5e-4", 4.5e-4, slope, "velocity per F_x",
        TOLERANCE["slope"], note, error=error,
    )]  # fmt: skip
    if not suffix:
        out.append(claim(
            "sliding-velocity-intercept", "Fig 7: Eq 10, -1.3e-3", -1.3e-3, line.intercept if line else None,
            "velocity", TOLERANCE["intercept"], "as printed, every velocity up to F_x = 2.9 would be negative",
            error=line.intercept_error if line else None, reference=-1.3e-5,
            reference_source="Eq 10 with the intercept corrected by two decades: V > 0 from F_x = 0.029 upwards",
        ))  # fmt: skip
    return out


def _mode_claims(main: DiskArrayResult) -> list[Claim]:
    modes = point_at_load(main.path, MODE_LOAD).spectrum
    k, shares = y_mode(modes), modes.shares()
    others = f"x {shares[k, 0]:.1%}, rotation {shares[k, 5]:.1%}, at F_x = {MODE_LOAD}"
    press = main.scenario.load.press * main.scenario.load.unit
    unit = "sqrt(k_n (2R)^1/2/m)"
    return [
        claim("y-mode-share", 'Fig 6: "no projection on either longitudinal or angular degrees of freedom"', 1.0,
              float(shares[k, 1]), "fraction", TOLERANCE["share"], others, error=0.0),
        claim("y-mode-frequency", 'Fig 6: "an eigen-frequency ω ≈ 0.235"', 0.235, float(modes.frequency[k]), unit,
              TOLERANCE["frequency"], "mode with the largest share in y", error=0.0),
        claim("wall-mode-frequency", "Fig 6: not printed; the same mode before any push", None,
              float(main.pressed_spectrum.frequency[y_mode(main.pressed_spectrum)]), unit, TOLERANCE["closed form"],
              "checks the units", error=0.0, reference=float(np.sqrt(1.5 * press ** (1 / 3))),
              reference_source="closed form sqrt(1.5 sqrt(δ_w)), δ_w = (F_y/k_n)^(2/3)"),
    ]  # fmt: skip


def shows() -> dict[str, tuple[str, str]]:
    """Figures of the paper, each with its content and the identifier of the claim to quote."""
    return SHOWS
