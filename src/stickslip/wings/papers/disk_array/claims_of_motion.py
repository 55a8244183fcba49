"""Statements of Charan et al. 2020 on fronts, the approach to the Coulomb limit, and sliding, with printed numbers.

Tolerances were fixed before anything was measured.
"""

import numpy as np

from ....kit import Claim, claim, format_value, linearise, standard_error, statement
from .fronts import Front
from .measures import (
    Arrest,
    backward_front,
    backward_order,
    drift_front,
    exceeds,
    forward_front,
    power_law,
    speed_proportion,
    velocity_line,
)
from .simulate import DiskArrayResult, point_at_load

UNSTABLE = 'Fig 2: supplement, "the system becomes unstable for all force values F_x > 0.082"'
FRONT_LOADS = (0.083, 0.087, 0.090)
STABLE_LOAD = 0.062
GROWTH_LOADS = (0.030, 0.040, 0.083, 0.087, 0.090)
V2_THRESHOLD = 0.05
LINE_TOP = 0.090  # largest load in the fit of Eq 10, the largest named in the paper
MODE_LOAD = 0.083  # load at which the y mode is shown: the smallest push at which the paper's array slides
COARSER = (5e-3, 2e-3, 1e-3)  # further load steps; the change from the last of them is the error of a birth
BISECTED = 1e-6  # width to which births and deaths are bisected [F_x]
IM_LAMBDA = {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}
V1 = {0.083: 0.0014, 0.087: 0.0022, 0.090: 0.0028}
# limit for the growth of mean M from the first to the last quarter of a run: stable modes stay below, pairs rise above
RISE = 10.0
SHOWS = {
    "Fig 2": ("complex pairs along the push", "late-pair-birth"),
    "Fig 3": ("M(t) at six pushes", "stable-msd-0.062"),
    "Fig 4": ("trajectory of a disk up to the Coulomb limit", "spiral-lifts-disks"),
    "Fig 5": ("fronts of breaching and of sliding", "v1-over-im-lambda"),
    "Fig 6": ("transverse mode", "y-mode-frequency"),
    "Fig 7": ("sliding velocity against push", "sliding-velocity-slope"),
}
TOLERANCE = {
    "pairs": 0.0,  # counts
    "window": 0.02,  # 0.082 and 0.062 are printed with two digits: half a unit of the last digit is 0.8 %
    "birth": 0.01,  # 0.082 is printed with two digits: half a unit of the last digit is 0.6 %
    "im-lambda": 0.1,  # printed with one or two digits: half a unit of the last digit is 5 % of 0.001
    "growth": 0.02,  # linear theory is exact; the fit window ends where contacts begin to open
    "saturation": 1.0,  # the paper prints "about" and a power of ten: a factor of two either way
    "threshold": 0.1,  # the paper's loads of arrest and of sliding differ by a factor of two
    "front": 0.25,  # nearly three times the largest error that the paper gives for V_1 with its 25 realisations, 9 %
    "ratio": 1.5 / 4.3,  # the scatter printed in the paper: 4.3 ± 1.5
    "exponent": 0.21,  # over Im λ from 2.4e-4 to 1.0e-3, this change of the power equals the ratio's scatter of 35 %
    "slope": 0.1,  # printed with two digits and no error: a typical error of a fit to a few velocities
    "intercept": 0.2,  # as for the slope, but extrapolated over nine tenths of the push
    "share": 0.1,  # the figure shows no x and no rotation: bars of 0.3 would be visible, and their square is 0.1
    "frequency": 0.05,  # "approximately"; printed with three digits, at a push that is not stated
    "wave number": 0.25,  # "approximately 2": half a unit of the only digit of the wavelength
    "steady": 0.1,  # "fixed", "without growth": a change that would be visible in a plot
    "power": 0.1,  # t and t^1.1 differ by a quarter over a decade
    "independence": 0.25,  # tolerance of an exponent: from 0.083 to 0.12 the speed then changes by a tenth
    "charging": 0.1,  # smaller changes of t_iw do not count
    "closed form": 1e-6,  # exact; the relaxation ends at a residual of 1e-14
}


CERTAIN = 3.0  # in standard errors: among 27 steps between neighbours, chance puts one this far below 0 in 4 % of cases
MUCH = 10.0  # "much faster": the paper's numbers differ by a factor of 27 to 54


def evaluate_fronts(main: DiskArrayResult) -> list[Claim]:
    """Evaluate the statements about fronts for the main scenario."""
    forward = {load: forward_front(main, ensemble) for load, ensemble in main.sliding.items()}
    ratios = {load: halves_ratio(front) for load, front in forward.items() if front}
    speeds = []
    for load, paper in V1.items():
        front, said = forward[load], 'Fig 5: "0.0014 ± 0.00013, 0.0022 ± 0.00015 and 0.0028 ± 8e-5"'
        note = _count_realizations(front, main, [load]) if front else ""
        speeds += _speed_claims(f"forward-front-speed-{load:.3f}", "", said, paper, front, note)
    return [
        *speeds, *backward_claims(main, ""), *_ratio_claims(main), *_starts(main),
        _order({load: forward[load] for load in FRONT_LOADS}),
        claim(
            "forward-front-linear", 'Fig 5: Eq 9, "V_1(F_x) × (τ_i − τ_1) ≈ x_i"', 1.0,
            float(np.mean(list(ratios.values()))) if ratios else None, "1", TOLERANCE["front"],
            f"speed in the first half of the row over that in the second, mean over loads: "
            f"{', '.join(f'{ratio:.2f} at {load:g}' for load, ratio in ratios.items())}; it is negative where the last "
            f"disk is reached before those in the middle", error=standard_error(list(ratios.values())),
        ),
        *_dependences(main, forward), _drift(main),
    ]  # fmt: skip


def _count_realizations(front: Front, result: DiskArrayResult, loads) -> str:
    failed = sum(len(result.sliding[load].failures) for load in loads)
    counted = f"{front.counted} realisations, {front.complete} of them complete"
    return counted + (f", {failed} failed" if failed else "")


def _speed_claims(name: str, suffix: str, source: str, paper: float, front: Front | None, note: str) -> list[Claim]:
    """Claims about a front speed with both estimators: through the front's start (Eq 9), and with a free intercept."""
    unit, tolerance = "length/time", TOLERANCE["front"]
    if not front:
        note = "no front: too few realisations in which the event happens at every disk before the run ends"
        return [claim(f"{name}{end}{suffix}", source, paper, None, unit, tolerance, note) for end in ("", "-free")]
    other = f"through the start {format_value(front.speed)}, with a free intercept {format_value(front.free_intercept)}"
    return [
        claim(f"{name}{suffix}", source, paper, front.speed, unit, tolerance,
              f"fitted through the start of the front, as in Eq 9; {other}; {note}", error=front.speed_error),
        claim(f"{name}-free{suffix}", source, paper, front.free_intercept, unit, tolerance,
              f"fitted with a free intercept; {other}; the paper does not state its choice; {note}",
              error=front.free_error),
    ]  # fmt: skip


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
        listed = ", ".join(f"{r:.2f} at {load:g}" for load, r in zip(wide.load, wide.ratio, strict=True)) or "no front"
        how = "with a free intercept" if free else "through the start of the front"
        out += [
            claim(f"v1-over-im-lambda{end}", f"Fig 5: {said}", 4.3, ratio[0], "length·time",
                  TOLERANCE["ratio"], f"fit {how}, mean over the paper's three loads; {listed}", error=ratio[1]),
            claim(f"v1-power-of-im-lambda{end}", f"Fig 5: {said}: V_1 ∝ Im λ", 1.0, power[0], "1",
                  TOLERANCE["exponent"], f"p in V_1 ∝ (Im λ)^p, fit {how}, over {len(wide.load)} loads from "
                  f"{min(strongest):g} to {max(strongest):g}", error=power[1], reference=printed,
                  reference_source="fitted to the three pairs of V_1 and Im λ that the paper prints"),
        ]  # fmt: skip
    return out


def backward_claims(result: DiskArrayResult, suffix: str) -> list[Claim]:
    """Claims about the speed of the backward front with both estimators."""
    thresholds = result.scenario.sliding.thresholds
    fronts = {t: backward_front(result, t, FRONT_LOADS) for t in thresholds}
    middle, note = fronts[V2_THRESHOLD], ""
    if middle:
        note = (
            f"{_count_realizations(middle, result, FRONT_LOADS)}; for each threshold: "
            f"{', '.join(f'{t:g}: {f.speed:.3f}' for t, f in fronts.items() if f)}; a value near 0.075 does not "
            f"confirm the explanation by a wave: see backward-front-by-drift and y-mode-wave-number"
        )
    said = 'Fig 5: "V_2 ≈ 0.235/π ≈ 0.075 in excellent agreement with the measured value"'
    return _speed_claims("backward-front-speed", suffix, said, 0.075, middle, note)


def _starts(main: DiskArrayResult) -> list[Claim]:
    """Claims about the disk at which each front starts in more than half of the realisations."""
    k = main.scenario.sliding.thresholds.index(V2_THRESHOLD)
    groups = [main.sliding[load] for load in FRONT_LOADS]
    pushed, last = main.scenario.load.disk - 1, int(backward_order(main)[0][0])
    rows = (
        ("breach-starts-at-first-disk", '"The first disk reaches the Coulomb limit at some time τ_1"', pushed,
         np.concatenate([g.breach for g in groups])),
        ("sliding-starts-at-last-disk", '"The actual sliding begins at the leading (last) disk"', last,
         np.concatenate([g.slide[:, k] for g in groups])),
    )  # fmt: skip
    return [_start(name, f"Fig 5: {said}", disk, times) for name, said, disk, times in rows]


def _start(name: str, source: str, disk: int, times: np.ndarray) -> Claim:
    times = times[np.isfinite(times).all(axis=1)]
    share, n = float((times.argmin(axis=1) == disk).mean()) if len(times) else np.nan, len(times)
    error = np.sqrt(share * (1 - share) / n) if n else np.inf
    return statement(
        name, source, exceeds(share, error, 0.5),
        f"disk {disk + 1} is the first in {share:.0%} of {n} complete realisations, by chance in "
        f"{1 / times.shape[1]:.0%}; the statement is interpreted as more than half",
    )  # fmt: skip


def _order(forward: dict[float, Front | None]) -> Claim:
    """Claim that the mean delays of the forward front increase from disk to disk."""
    fronts = [front for front in forward.values() if front]
    steps = np.concatenate([np.diff(front.delay) for front in fronts]) if fronts else np.zeros(0)
    errors = np.concatenate([np.hypot(front.error[1:], front.error[:-1]) for front in fronts] or [steps])
    back = steps + CERTAIN * errors < 0
    late = ", ".join(f"disk {np.argmax(front.delay) + 1} at {load:g}" for load, front in forward.items() if front)
    holds = None if len(fronts) < len(forward) or (steps.min() <= 0 and not back.any()) else bool(steps.min() > 0)
    return statement(
        "breach-in-order", 'Fig 5: "with τ_{i+1} > τ_i > τ_1 and i being the index of the disk"', holds,
        f"steps between mean delays of neighbours at {len(fronts)} loads: {(steps > 0).sum()} of {len(steps)} are "
        f"positive, {back.sum()} are negative by more than {CERTAIN:g} errors; the last on average is {late}"
        f"{'; more realisations would decide it' if holds is None else ''}",
    )  # fmt: skip


def halves_ratio(front: Front) -> float:
    """Speed of a front in the first half of its path over that in the second half."""
    k, d, t = len(front.delay) // 2, front.distance, front.delay
    return float(d[k] / t[k] * (t[-1] - t[k]) / (d[-1] - d[k]))


def _dependences(main: DiskArrayResult, forward: dict[float, Front | None]) -> list[Claim]:
    """Claims that V_1 depends on F_x and V_2 does not, from p in V ∝ F_x^p, and that V_2 is much faster."""
    backward = {load: backward_front(main, V2_THRESHOLD, [load]) for load in main.sliding}
    (p1, e1), (p2, e2) = (_power_of_push(fronts) for fronts in (forward, backward))
    ratios = {load: backward[load].speed / forward[load].speed for load in FRONT_LOADS
              if backward[load] and forward[load]}  # fmt: skip
    errors = [backward[load].speed_error / forward[load].speed for load in ratios]
    low = min((ratio - 2 * error for ratio, error in zip(ratios.values(), errors, strict=True)), default=np.nan)
    speeds = ", ".join(f"{f.speed:.3f} ± {f.speed_error:.3f} at {load:g}" for load, f in backward.items() if f)
    power = f"p in V ∝ F_x^p over loads from {min(main.sliding):g} to {max(main.sliding):g}"
    return [
        statement(
            "v1-depends-on-push", 'Fig 5: "with a wave speed V_1(F_x) depending on the external force F_x"',
            None if p1 is None else exceeds(p1, e1, 0.0),
            f"{power}: {'not fitted' if p1 is None else f'{p1:.2f} ± {e1:.2f}'}",
        ),
        claim("v2-power-of-push", 'Fig 5: "a velocity V_2 that does not depend on the external force F_x"', 0.0, p2,
              "1", TOLERANCE["independence"],
              f"{power}: {speeds}; loads that differ by 8 %, as the paper's, cannot show it", error=e2),
        statement(
            "v2-much-faster-than-v1", 'Fig 5: "the backward wave of sliding is much faster than V_1"',
            bool(low > MUCH) if len(ratios) == len(FRONT_LOADS) else None,
            f"V_2/V_1: {', '.join(f'{ratio:.0f} at {load:g}' for load, ratio in ratios.items())}; much faster: more "
            f"than {MUCH:g} times, also at the mean minus two standard errors",
        ),
    ]  # fmt: skip


def _power_of_push(fronts: dict[float, Front | None]) -> tuple[float | None, float | None]:
    there = {load: front for load, front in fronts.items() if front}
    speeds, errors = (np.array([getattr(f, name) for f in there.values()]) for name in ("speed", "speed_error"))
    return power_law(np.array(list(there)), speeds, errors) or (None, None)


def _drift(main: DiskArrayResult) -> Claim:
    """Claim that the backward front results from a drift with a constant profile of displacements."""
    raw, front = (backward_front(main, V2_THRESHOLD, FRONT_LOADS, smooth=smooth) for smooth in (False, True))
    drift = drift_front(main, V2_THRESHOLD, FRONT_LOADS)
    name, source = "backward-front-by-drift", "Fig 5: speed of the backward front; its explanation by a drift"
    unit, tolerance = "length/time", TOLERANCE["front"]
    if not raw or not front or not drift:
        return claim(name, source, None, None, unit, tolerance, "no front, or no run that passes the threshold")
    return claim(
        name, source, None, front.speed, unit, tolerance,
        f"disks that slide keep a nearly constant profile of displacements u_i while the row drifts at a speed V, and "
        f"pass the threshold in its order, (u_N − u_i)/V after the last one: no wave is needed. Measured without the "
        f"oscillation of the disks, with which first crossings are early: then it is {raw.speed:.3f}",
        error=front.speed_error, reference=drift[0],
        reference_source=f"from mean profile and mean drift, ± {drift[1]:.2g}",
    )  # fmt: skip


TRANSITION = 0.083  # push of Figs 3 and 4 at which the array slides


def evaluate_motion(main: DiskArrayResult, arrests: list[Arrest]) -> list[Claim]:
    """Evaluate the statements about single disks, slip and sliding for the main scenario."""
    return [
        *(_charging(arrest) for arrest in arrests), _msd_at_breach(main), _where_first(main), _power(main),
        *_spiral(main), *_center(main), *sliding_claims(main, ""),
    ]  # fmt: skip


def _charging(arrest: Arrest) -> Claim:
    """Claim that slip at the substrate is "charged": it must grow by more than the tolerance."""
    mean, error = float(arrest.charge.mean()), standard_error(arrest.charge)
    return statement(
        f"charging-{arrest.load:.3f}", 'Fig 3: "static friction with charging of t_iw" at 0.03 and 0.04',
        exceeds(mean, error, 1 + TOLERANCE["charging"]),
        f"mean |t_iw| of {len(arrest.charge)} late states over that before the run: {mean:.3f} ± {error:.3f}; at rest "
        "the forces of the substrate add up to F_x, so that t_iw can change sign or position, but not its sum",
    )  # fmt: skip


def _msd_at_breach(main: DiskArrayResult) -> Claim:
    values = main.sliding[TRANSITION].msd_at_breach
    values = values[np.isfinite(values)]
    root = 2 * np.sqrt(values)  # in units of R
    return claim(
        "root-msd-at-breach-0.083", 'Fig 3: at 0.083 "bringing M(t) to about 10^-2 R where for the first time the '
        'Coulomb law is breached at the contact with the substrate"', 1e-2, float(root.mean()) if len(root) else None,
        "R", TOLERANCE["saturation"],
        f"√M, as M is an area, when the first contact with the substrate reaches the limit in {len(root)} "
        f"realisations; M itself is {4 * values.mean() if len(values) else np.nan:.1e} R²", error=standard_error(root),
    )  # fmt: skip


def _where_first(main: DiskArrayResult) -> Claim:
    first = np.concatenate([main.sliding[load].wall_first for load in FRONT_LOADS])
    first = first[np.isfinite(first)]
    share = float(first.mean()) if len(first) else np.nan
    return statement(
        "substrate-first", 'Fig 3: at 0.083 "for the first time the Coulomb law is breached at the contact with the '
        'substrate"', exceeds(share, _share_error(first), 0.5),
        f"in {int(first.sum())} of {len(first)} realisations the first contact at the limit is with the substrate; in "
        f"the others it is between two disks",
    )  # fmt: skip


def _share_error(yes: np.ndarray) -> float:
    """Standard error of the fraction of realisations with an outcome; infinite if there are none."""
    return float(np.sqrt(yes.mean() * (1 - yes.mean()) / len(yes))) if len(yes) else np.inf


def _power(main: DiskArrayResult) -> Claim:
    power = main.sliding[TRANSITION].power
    power = power[np.isfinite(power)]
    return claim(
        "msd-exponent", 'Fig 3: "subsequently M(t) increases linearly in time with a fixed average velocity"', 1.0,
        float(power.mean()) if len(power) else None, "1", TOLERANCE["power"],
        f"p in M ∝ (t − t_b)^p, t_b the first breach at the substrate, over the last third of {len(power)} "
        f"realisations that slide; the sentence contradicts itself", error=standard_error(power), reference=2.0,
        reference_source="a fixed velocity V: M = N V² (t − t_b)²",
    )  # fmt: skip


def _spiral(main: DiskArrayResult) -> list[Claim]:
    """Claims that disks are lifted before they reach the limit, and that this holds for each of them."""
    left = main.sliding[TRANSITION].unloading
    reached, start = np.isfinite(left), point_at_load(main.path, TRANSITION).state
    lifted = left[reached] < 1
    here = linearise(start, main.law).mobilisation[start.contacts.j[: start.contacts.count[0]] >= left.shape[1]]
    used, overlap = float(np.nanmedian(here)), float(np.median(left[reached])) if reached.any() else np.nan
    each = [exceeds(float(np.mean(row)), _share_error(row), 0.5) for row in _columns(left < 1, reached)]
    whole = None if None in each else all(each)
    reached_at = main.free_runs[TRANSITION].breach
    return [
        statement(
            "spiral-lifts-disks", 'Fig 4: "A spiral in the x-y plane leads in time to an increase in y_i to the point '
            'that breaching the Coulomb law at the contact with the substrate becomes inevitable"',
            exceeds(float(lifted.mean()) if len(lifted) else np.nan, _share_error(lifted), 0.5),
            f"{lifted.sum()} of {len(lifted)} disks have risen when their contact with the substrate first reaches the "
            f"limit; by the median F_n has then fallen to {overlap**1.5:.2g} of its value before the run, and F_t from "
            f"{used:.2g} to {overlap**1.5:.2g} of mu times that value: the limit falls to F_t",
        ),
        statement(
            "spiral-is-representative", 'Fig 4: the trajectory of the fourth disk "is representative for all the other '
            'disks"', whole, f"median overlap with the substrate at the limit, over that before the run, disk by disk: "
            f"{', '.join(f'{np.median(column):.2f}' for column in _columns(left, reached))}",
        ),
        claim(
            "time-of-trajectory", 'Fig 4: "The actual trajectory (for t ≈ 17500) that is induced by the instability"',
            17500.0, None, "time", TOLERANCE["saturation"],
            f"from velocities of {main.scenario.dynamics.seed_velocity:g} all contacts with the substrate have reached "
            f"the limit after {np.max(reached_at):.0f}; the time changes with the logarithm of the first velocities, "
            f"which are not printed: they would decide it",
        ),
    ]  # fmt: skip


def _columns(values: np.ndarray, there: np.ndarray) -> list[np.ndarray]:
    """Entries of each column for which `there` is True."""
    return [column[mask] for column, mask in zip(values.T, there.T, strict=True)]


def _center(main: DiskArrayResult) -> list[Claim]:
    """Claims about the centre of mass while the array slides: constant velocity, steady height, and abrupt onset."""
    groups = [main.sliding[load] for load in FRONT_LOADS]
    k = main.scenario.sliding.thresholds.index(V2_THRESHOLD)
    velocity, height = (np.concatenate([getattr(g, name) for g in groups]) for name in ("late_velocity", "late_height"))
    onset = np.concatenate([np.column_stack([g.velocity, g.drift[:, k]]) for g in groups])
    rows = (
        ("fixed-velocity", '"a simple first order transition from static to dynamics with a fixed velocity"', velocity,
         "steady", "velocity of the centre in the last sixth of the runs over that in the previous sixth"),
        ("height-without-growth", '"the y component of the center of mass that oscillates without growth"', height,
         "steady", "standard deviation of the height of the centre in the last sixth over that in the previous sixth"),
        ("first-order-onset", '"appears like a simple first order transition"', onset, "front",
         f"velocity when the centre has moved by {V2_THRESHOLD:g} over that in the last third of the runs: one if "
         f"the velocity jumps"),
    )  # fmt: skip
    return [_ratio(name, f"Fig 7: {said}", values, TOLERANCE[kind], note) for name, said, values, kind, note in rows]


def _ratio(name: str, source: str, values: np.ndarray, tolerance: float, note: str) -> Claim:
    """Claim that the mean of the second column equals that of the first, with a jackknife error."""
    before, after = values[np.isfinite(values).all(axis=1)].T
    n = len(before)
    left_out = (after.sum() - after) / (before.sum() - before) if n > 1 else np.zeros(0)
    error = float(np.sqrt((n - 1) * left_out.var())) if n > 1 else None
    measured = float(after.mean() / before.mean()) if n else None
    return claim(name, source, 1.0, measured, "1", tolerance, f"{note}, ratio of means over {n} runs", error=error)


def sliding_claims(result: DiskArrayResult, suffix: str) -> list[Claim]:
    """Claims about the slope in Eq 10 and, for the printed model only, its intercept."""
    line = velocity_line(result, LINE_TOP)
    slope, error, note = None, None, "fewer than three loads at which realisations slide before the run ends"
    if line:
        slope, error = line.slope, line.slope_error
        wider = {top: velocity_line(result, top).slope for top in line.push if top > LINE_TOP}
        slid = [int(np.isfinite(result.sliding[load].velocity).sum()) for load in FRONT_LOADS]
        note = (
            f"fitted to the loads named in the paper, where {'+'.join(map(str, slid))} realisations slide before "
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
