"""Evaluation of the claims of Charan et al. 2020, doi:10.48550/arXiv.1908.11724, including its supplement."""

import numpy as np

from ....kit import Claim, Report, Task, Workers, claim, pluralize, run_realizations, silent, within
from ....protocols import stable_window
from ....results import KineticThreshold
from .arrest import ARREST_LOADS, Arrest
from .claims_of_fronts import backward_claims, evaluate_fronts
from .claims_of_modes import evaluate_modes
from .claims_of_motion import evaluate_motion, sliding_claims
from .measures import LATE, growth_error, growth_factor, late_birth, saturation_error
from .printed import (
    BISECTED,
    COARSER,
    FRONT_LOADS,
    GROWTH_LOADS,
    IM_LAMBDA,
    RISE,
    SHOWS,
    STABLE_LOAD,
    TOLERANCE,
    UNSTABLE,
)
from .simulate import DiskArrayResult, make_protocol, point_at_load, push_disk_array


def evaluate_claims(
    main: DiskArrayResult, quarter: DiskArrayResult, arrests: list[Arrest], threshold: KineticThreshold,
    workers: Workers = None, report: Report = silent,
) -> list[Claim]:  # fmt: skip
    """Evaluate all claims, those of the main scenario first.

    Parameters
    ----------
    arrests, threshold : of the main scenario
    report : called as report(stage, share done, text) during the ramps with other load steps
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
    printed += evaluate_fronts(main) + evaluate_modes(main) + evaluate_motion(main, arrests)
    return [
        *printed, *quarter_spectra, _stability(quarter, suffix), *backward_claims(quarter, suffix),
        *sliding_claims(quarter, suffix),
    ]  # fmt: skip


def _spectrum_claims(result: DiskArrayResult, suffix: str, near: float, report: Report) -> list[Claim]:
    protocol, paths = make_protocol(result.scenario, result.law), {}
    for k, step in enumerate(COARSER):
        part = within(report, k / len(COARSER), (k + 1) / len(COARSER), stage=f"load step {step:g}{suffix}")
        paths[step] = push_disk_array(result.scenario, step=step, report=part)[2]
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
        UNSTABLE, 0.082, births[step], "F_x", TOLERANCE["birth"],
        f"bisected to 1e-6 from one state; for each load step of the ramp: {_format_by_step(births)}",
        error=_sensitivity(births[step], births[COARSER[-1]]),
    ))  # fmt: skip
    out += [_im_lambda(load, result, paths[COARSER[-1]], births[step], suffix) for load in IM_LAMBDA]
    return out


def _sensitivity(fine, coarse) -> float | None:
    """Largest difference between two load steps, but at least the bisection width; None if either has no value."""
    return None if fine is None or coarse is None else max(BISECTED, float(np.abs(np.subtract(fine, coarse)).max()))


def _format_by_step(values: dict) -> str:
    def text(value):
        return "none" if value is None else "–".join(f"{v:.6f}" for v in np.ravel(value))

    return ", ".join(f"{step:g}: {text(value)}" for step, value in values.items())


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
    said = 'Fig 3: at 0.083 "the oscillatory instability triggers the transition", "the Coulomb law is breached"'
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


def _threshold_claims(threshold: KineticThreshold) -> list[Claim]:
    """Claims about the kinetic threshold, and that it separates the paper's loads of arrest and of sliding."""
    at, (low, high), top = float(threshold.lasting_threshold[0]), threshold.lasting_interval[0], min(FRONT_LOADS)
    outcomes = zip(threshold.loads, threshold.probability[:, 0], threshold.lasting_probability[:, 0], strict=True)
    shares = ", ".join(f"{slid:.2g} and {lasting:.2g} at {load:g}" for load, slid, lasting in outcomes)
    note = (
        f"load at which half of the kicked runs slide on; shares of {threshold.runs[0, 0]} runs from velocities of "
        f"{threshold.kicks[0]:g} that slide by {threshold.distance:g}, and that slide on: {shares}"
    )
    stops, (last, first) = "no sliding array came to rest at a lower load", threshold.arrest_range
    if np.isfinite(last):
        stops = f"{pluralize(len(threshold.arrest), 'sliding array')} stopped between {last:g} and {first:g}"
    known = bool(np.isfinite([at, low, high]).all())
    return [
        claim(
            "kinetic-threshold", "Fig 3: between 0.04 and 0.083; not printed", None, at if known else None, "F_x",
            TOLERANCE["threshold"], f"{note}; 95 % between {low:.4f} and {high:.4f}; {stops}",
            error=(high - low) / 3.92 if known else None,
        ),
        claim(
            "threshold-between-arrest-and-sliding",
            'Fig 3: "the MSD becomes stationary" at 0.03 and 0.04, sliding at 0.083',
            True, bool(max(ARREST_LOADS) < low and high < top) if known else None, "", 0.0,
            f"whether the kinetic threshold, {low:.4f} to {high:.4f} (95 %), lies between 0.04 and {top:g}",
        ),
    ]  # fmt: skip


def shows() -> dict[str, tuple[str, str]]:
    """Figures of the paper, each with its content and the identifier of the claim to quote."""
    return SHOWS
