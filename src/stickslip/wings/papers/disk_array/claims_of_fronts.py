"""Evaluation of statements of Charan et al. 2020 on the fronts of breaching and of sliding, and on their speeds."""

import numpy as np

from ....kit import Claim, claim, format_value, standard_error
from .fronts import Front
from .measures import backward_front, backward_order, drift_front, exceeds, forward_front, power_law, speed_proportion
from .printed import FRONT_LOADS, IM_LAMBDA, TOLERANCE, V1, V2_THRESHOLD
from .simulate import DiskArrayResult, point_at_load

CERTAIN = 3.0  # errors: of 27 steps between neighbours, one is as far below zero by chance in 4 % of all cases
MUCH = 10.0  # "much faster": the paper's own numbers differ by a factor of 27 to 54


def evaluate_fronts(main: DiskArrayResult) -> list[Claim]:
    """Evaluate the statements for the main scenario."""
    forward = {load: forward_front(main, main.sliding[load]) for load in FRONT_LOADS}
    return [
        *_front_claims(main), *_ratio_claims(main), *_starts(main), _order(forward), _linear(main),
        *_dependences(main), _drift(main),
    ]  # fmt: skip


def _count_realizations(front: Front, result: DiskArrayResult, loads) -> str:
    failed = sum(len(result.sliding[load].failures) for load in loads)
    counted = f"{front.counted} realizations, {front.complete} of them complete"
    return counted + (f", {failed} failed" if failed else "")


def _speed_claims(name: str, suffix: str, source: str, paper: float, front: Front | None, note: str) -> list[Claim]:
    """Claims about a front speed by both estimators: through the front's start (Eq 9), and with a free intercept."""
    unit, tolerance = "length/time", TOLERANCE["front"]
    if not front:
        note = "no front: too few realizations in which the event happens at every disk before the run ends"
        return [claim(f"{name}{end}{suffix}", source, paper, None, unit, tolerance, note) for end in ("", "-free")]
    other = f"through the start {format_value(front.speed)}, with a free intercept {format_value(front.free_intercept)}"
    return [
        claim(f"{name}{suffix}", source, paper, front.speed, unit, tolerance,
              f"fitted through the start of the front, as in Eq 9; {other}; {note}", error=front.speed_error),
        claim(f"{name}-free{suffix}", source, paper, front.free_intercept, unit, tolerance,
              f"fitted with a free intercept; {other}; the paper does not say which one it used; {note}",
              error=front.free_error),
    ]  # fmt: skip


def _front_claims(main: DiskArrayResult) -> list[Claim]:
    out = []
    for load, paper in V1.items():
        front = forward_front(main, main.sliding[load])
        said = 'Fig 5: "0.0014 ± 0.00013, 0.0022 ± 0.00015 and 0.0028 ± 8e-5"'
        note = _count_realizations(front, main, [load]) if front else ""
        out += _speed_claims(f"forward-front-speed-{load:.3f}", "", said, paper, front, note)
    return [*out, *backward_claims(main, "")]


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
    """Claims about the speed of the backward front by both estimators."""
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
    """Claims about the disk at which each front starts, in more than half of the realizations."""
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
    return claim(
        name, source, True, exceeds(share, error, 0.5), "", 0.0,
        f"disk {disk + 1} is the first in {share:.0%} of {n} complete realizations, and by chance in "
        f"{1 / times.shape[1]:.0%}; the statement is read as more than half",
    )  # fmt: skip


def _order(forward: dict[float, Front | None]) -> Claim:
    """Claim that the mean delays of the forward front increase from disk to disk."""
    fronts = [front for front in forward.values() if front]
    steps = np.concatenate([np.diff(front.delay) for front in fronts]) if fronts else np.zeros(0)
    errors = np.concatenate([np.hypot(front.error[1:], front.error[:-1]) for front in fronts] or [steps])
    back = steps + CERTAIN * errors < 0
    late = ", ".join(f"disk {np.argmax(front.delay) + 1} at {load:g}" for load, front in forward.items() if front)
    holds = None if len(fronts) < len(forward) or (steps.min() <= 0 and not back.any()) else bool(steps.min() > 0)
    return claim(
        "breach-in-order", 'Fig 5: "with τ_{i+1} > τ_i > τ_1 and i being the index of the disk"', True, holds, "", 0.0,
        f"steps between mean delays of neighbours at {len(fronts)} loads: {(steps > 0).sum()} of {len(steps)} are "
        f"positive, {back.sum()} are negative by more than {CERTAIN:g} errors; the last on average is {late}"
        f"{'; more realizations would decide it' if holds is None else ''}",
    )  # fmt: skip


def halves_ratio(front: Front) -> float:
    """Speed of a front in the first half of its way over that in the second half."""
    k, d, t = len(front.delay) // 2, front.distance, front.delay
    return float(d[k] / t[k] * (t[-1] - t[k]) / (d[-1] - d[k]))


def _linear(main: DiskArrayResult) -> Claim:
    """Claim that the speed of the forward front is constant along the row."""
    fronts = {load: forward_front(main, ensemble) for load, ensemble in main.sliding.items()}
    ratios = {load: halves_ratio(front) for load, front in fronts.items() if front}
    return claim(
        "forward-front-linear", 'Fig 5: Eq 9, "V_1(F_x) × (τ_i − τ_1) ≈ x_i"', 1.0,
        float(np.mean(list(ratios.values()))) if ratios else None, "1", TOLERANCE["front"],
        f"speed in the first half of the row over that in the second, mean over loads: "
        f"{', '.join(f'{ratio:.2f} at {load:g}' for load, ratio in ratios.items())}; it is negative where the last "
        f"disk is reached before those in the middle",
        error=standard_error(list(ratios.values())),
    )  # fmt: skip


def _dependences(main: DiskArrayResult) -> list[Claim]:
    """Claims that V_1 depends on F_x and V_2 does not, by p in V ∝ F_x^p, and that V_2 is much faster."""
    forward = {load: forward_front(main, ensemble) for load, ensemble in main.sliding.items()}
    backward = {load: backward_front(main, V2_THRESHOLD, [load]) for load in main.sliding}
    (p1, e1), (p2, e2) = (_power_of_push(fronts) for fronts in (forward, backward))
    ratios = {load: backward[load].speed / forward[load].speed for load in FRONT_LOADS
              if backward[load] and forward[load]}  # fmt: skip
    errors = [backward[load].speed_error / forward[load].speed for load in ratios]
    low = min((ratio - 2 * error for ratio, error in zip(ratios.values(), errors, strict=True)), default=np.nan)
    speeds = ", ".join(f"{f.speed:.3f} ± {f.speed_error:.3f} at {load:g}" for load, f in backward.items() if f)
    power = f"p in V ∝ F_x^p over loads from {min(main.sliding):g} to {max(main.sliding):g}"
    return [
        claim("v1-depends-on-push", 'Fig 5: "with a wave speed V_1(F_x) depending on the external force F_x"', True,
              None if p1 is None else exceeds(p1, e1, 0.0), "", 0.0,
              f"{power}: {'not fitted' if p1 is None else f'{p1:.2f} ± {e1:.2f}'}"),
        claim("v2-power-of-push", 'Fig 5: "a velocity V_2 that does not depend on the external force F_x"', 0.0, p2,
              "1", TOLERANCE["independence"],
              f"{power}: {speeds}; loads that differ by 8 %, as the paper's, cannot show it", error=e2),
        claim("v2-much-faster-than-v1", 'Fig 5: "the backward wave of sliding is much faster than V_1"', True,
              bool(low > MUCH) if len(ratios) == len(FRONT_LOADS) else None, "", 0.0,
              f"V_2/V_1: {', '.join(f'{ratio:.0f} at {load:g}' for load, ratio in ratios.items())}; much faster: more "
              f"than {MUCH:g} times, also two errors below"),
    ]  # fmt: skip


def _power_of_push(fronts: dict[float, Front | None]) -> tuple[float | None, float | None]:
    there = {load: front for load, front in fronts.items() if front}
    speeds, errors = (np.array([getattr(f, name) for f in there.values()]) for name in ("speed", "speed_error"))
    return power_law(np.array(list(there)), speeds, errors) or (None, None)


def _drift(main: DiskArrayResult) -> Claim:
    """Claim that the backward front is what a drift with a constant profile of displacements makes."""
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
