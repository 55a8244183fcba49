"""Evaluation of the claims of McNamara & Herrmann 2006.

The paper contains proofs and prints no numbers, so its statements are compared with the results.
"""

import numpy as np
from scipy.stats import binomtest

from .... import State, spectrum
from ....kit import Claim, claim, median_error, pluralize
from ....modes import damped_growth
from ....packings import TOP
from ....reports.claims import ALWAYS
from ...status.matrices import linear_system
from ...status.rigidity import DRIVEN, IDLE, RATTLER, RIGID, mechanisms
from .cases import ApexCases, StatusCases, apex_cases, status_cases
from .claims_of_motion import evaluate_motion
from .simulate import QuasiResult, SampleResult, table_one

CASES = 500
RELATIONS = 1e-5  # relative error of Table I: a hundred times the step of 1e-7, which is the size of neglected terms
COLLAPSE = 0.02  # tolerance: two increments of the slow load, which resolve the collapse load
YIELD = '"when the assumption of stability for all possible states is violated, we expect the packing to yield"'
SHOWS = {
    "Table I": ("chain of linear relations", "table-I-relations"),
    "Eq 5": ("the map of statuses is bijective", "status-map-bijective"),
    "Sec. II C": ("number of critical contacts", "hundreds-of-critical-contacts"),
    "Sec. II D": ("one consistent state", "one-consistent-state"),
    "Sec. III D": ("quasi-static balance", "flutter-example"),
    "Sec. III E": ("mechanisms", "mechanism-classes"),
    "Sec. V A": ("stability of all states as a premise", "stability-premise"),
    "Sec. V B": ("open question: the apex of the cone", "apex-counterexample"),
}


def evaluate_claims(main: QuasiResult, *, cases: int = CASES, quick: bool = False) -> list[Claim]:
    """Evaluate all claims; values are medians over samples, and the notes give ranges."""
    drawn, opened = status_cases(main, cases), apex_cases(main, cases)
    return [
        _table_one(main), *_status_claims(main, drawn), _slow_error(main), _collapse(main), _premise(main),
        _flutter(main), _apex(opened), _mechanisms(main), *evaluate_motion(main, quick),
    ]  # fmt: skip


def _most_sliding_state(sample: SampleResult) -> State:
    """State with the most sliding contacts before the last tenth of the path."""
    early = [p for p in sample.path.points if p.load <= 0.9 * sample.path.points[-1].load]
    return max(early, key=lambda p: p.sliding).state


def _table_one(main: QuasiResult) -> Claim:
    errors = [table_one(_most_sliding_state(sample), sample.law) for sample in main.tested]
    worst = {name: max(e[name] for e in errors) for name in errors[0]}
    listed = ", ".join(f"{name} to {value:.0e}" for name, value in worst.items())
    return claim(
        "table-I-relations", "Table I: f = cF, F = −KD, dD/dt = SV, V = cᵀv", True, max(worst.values()) < RELATIONS, "",
        0.0,
        f"compared with the engine's forces in states with sliding contacts; relative errors: {listed} (steps of 1e-7 "
        f"radii)",
    )  # fmt: skip


def _status_claims(main: QuasiResult, drawn: StatusCases) -> list[Claim]:
    before = [sample.looks.load < sample.looks.load[-1] for sample in main.tested]
    known = [(sample.looks.bijective >= 0) & b for sample, b in zip(main.tested, before, strict=True)]
    sliding = [k & (sample.looks.critical > 0) for sample, k in zip(main.tested, known, strict=True)]
    number = int(sum(s.sum() for s in sliding))
    whole = int(sum((sample.looks.bijective[s] == 1).sum() for sample, s in zip(main.tested, sliding, strict=True)))
    stable = [s & (sample.looks.unique == 1) for sample, s in zip(main.tested, sliding, strict=True)]
    bijective = all((sample.looks.bijective[s] == 1).all() for sample, s in zip(main.tested, stable, strict=True))
    held = [k & (sample.looks.lowest > 0) for sample, k in zip(main.tested, known, strict=True)]
    wrong = [
        f"sample {sample.seed} at load {load:.4g}"
        for sample, h in zip(main.tested, held, strict=True)
        for load in sample.looks.load[h & (sample.looks.consistent != 1)]
    ]
    checked = int(sum((h & s).sum() for h, s in zip(held, sliding, strict=True)))
    ends = sum(sample.looks.consistent[-1] == 0 for sample in main.tested)
    example = drawn.none > 0 and drawn.several > 0
    return [
        claim(
            "status-map-bijective",
            'Eq 5: "the mapping C is bijective", if "all possible states lead to a stable packing"', True,
            bool(bijective and drawn.agree == drawn.total), "", 0.0,
            f"tested where A is a P-matrix, which follows from that premise: in all such states on the paths; in "
            f"{drawn.agree} of {drawn.total} constructed cases the map is bijective if and only if A is a P-matrix; "
            f"regardless of the premise, the map is bijective in {whole} of {number} states with 1 to 10 critical "
            f"contacts, by enumeration of all statuses",
            quantifier=ALWAYS,
        ),
        claim(
            "one-consistent-state", 'Sec. II D: "always one, and only one choice of contact status"', True,
            not wrong if checked else None, "", 0.0,
            f"{f'not in {wrong[0]}, elsewhere ' if wrong else ''}exactly one under the load of the test in each of "
            f"{checked} states with 1 to 10 critical contacts that are stable (the premise); {number - checked} more "
            f"have an eigenvalue of k that is not positive, for example where rattlers have just been wedged; no "
            f"consistent status at the end of {ends} of {len(main.tested)} paths", quantifier=ALWAYS,
        ),
        claim(
            "non-unique-example", "Sec. V A: unstable states, not treated", None, bool(example), "", 0.0,
            f"without stability, uniqueness is not guaranteed either: of {drawn.total} constructed cases, "
            f"{drawn.total - drawn.p_matrices} do not yield a P-matrix, {drawn.none} have no consistent status "
            f"under the load that was drawn, and {drawn.several} have two or more",
            reference=True,
            reference_source="linear complementarity problems are uniquely solvable for every load only for P-matrices",
        ),
    ]  # fmt: skip


def _slow_error(main: QuasiResult) -> Claim:
    """Claim that path and dynamics differ less at the slowest load than at the fastest."""
    times = sorted(main.scenario.dynamics.times)
    compared = [sample for sample in main.tested if len(sample.slow) == len(times)]
    source = "Sec. III D: quasi-static balance as the limit of Newton's second law"
    if not compared:
        note = "no sample has slow dynamics at every duration"
        return claim("path-vs-dynamics-error", source, True, None, "", 0.0, note)
    errors = np.array([[run.error for run in sorted(sample.slow, key=lambda r: r.time)] for sample in compared])
    middle = np.median(errors, axis=0)
    listed = ", ".join(
        f"{m:.1e} ({lo:.1e} to {hi:.1e}) at {t:g}"
        for t, m, lo, hi in zip(times, middle, errors.min(axis=0), errors.max(axis=0), strict=True)
    )
    falls, left = int((errors[:, -1] < errors[:, 0]).sum()), len(main.tested) - len(compared)
    rest = f"; {pluralize(left, 'sample')} without dynamics at every duration" if left else ""
    return claim(
        "path-vs-dynamics-error", source, True, sign_test(falls, len(errors)), "", 0.0,
        f"largest difference of strain up to 95 % of the load, over the last strain, median and range for each "
        f"duration of the whole load: {listed}; smaller at the slowest load than at the fastest in {falls} of "
        f"{len(errors)} samples{rest}",
    )  # fmt: skip


def sign_test(yes: int, total: int) -> bool | None:
    """Decide by a sign test at the 5 % level whether `yes` outcomes prevail.

    The result is None if there are too few cases, such as four.
    """
    if binomtest(yes, total, alternative="greater").pvalue <= 0.05:
        return True
    return False if binomtest(yes, total, alternative="less").pvalue <= 0.05 else None


def collapse_ratio(sample: SampleResult, beyond: float) -> tuple[float, float]:
    """Bounds on the ratio of the collapse load of slow dynamics to the load at which the path loses stability.

    The bounds are equal if both loads are known. Dynamics that continued beyond the end of the path by the share
    `beyond`, or reached the whole load, gives only a lower bound. A path that did not end with a loss of stability
    gives only an upper bound.
    """
    end = sample.path.points[-1].load
    followed = min(1.0, (1 + beyond) * end)
    lost = sample.path.loses_stability
    fell = sample.collapse is not None
    if end <= 0:
        return 0.0, np.inf
    return ((sample.collapse if fell else followed) / end if lost else 0.0, sample.collapse / end if fell else np.inf)


def censored_median(bounds: list[tuple[float, float]]) -> float | None:
    """Median of values, some of which are known only within bounds; None if the bounds do not determine it."""
    low, high = np.median(np.array(bounds), axis=0) if bounds else (0.0, np.inf)
    return float(low) if low == high else None


def _collapse(main: QuasiResult) -> Claim:
    """Claim about the collapse load of all samples, including those whose path or dynamics does not end."""
    beyond = main.scenario.dynamics.beyond
    bounds = [collapse_ratio(sample, beyond) for sample in main.tested]
    exact = [low for low, high in bounds if low == high]
    passed = [low for low, high in bounds if 0 < low < high]
    parts = [f"{min(exact):.4f} to {max(exact):.4f} in {len(exact)}" if exact else "in none"]
    parts += [f"above {min(passed):.4f} in {len(passed)}, where the dynamics showed no burst"] if passed else []
    unlost = sum(low == 0 for low, _ in bounds)
    parts += [f"{unlost} whose path did not end with a loss of stability"] if unlost else []
    return claim(
        "collapse-load-ratio", f"Sec. V A: {YIELD}; no load is printed", None, censored_median(bounds), "1", COLLAPSE,
        f"load at which slow dynamics collapses, divided by that at which the path ends; median over all {len(bounds)} "
        f"samples: {'; '.join(parts)}",
        error=median_error(exact) if len(exact) == len(bounds) else None, reference=1.0,
        reference_source="the load at which the path of this package loses its stability",
    )  # fmt: skip


def _first_failure(load: np.ndarray, fails: np.ndarray) -> float:
    """Share of the path's load at which a condition first fails; 1 if it never does."""
    return float(load[np.argmax(fails)] / load[-1]) if fails.any() and load[-1] > 0 else 1.0


def _premise(main: QuasiResult) -> Claim:
    """Claim about the premise Q > 0; without it, a state with a unique status that loads on is a counterexample."""
    premise = [_first_failure(sample.looks.load, sample.looks.symmetric < 0) for sample in main.tested]
    unique = [_first_failure(sample.looks.load, sample.looks.unique == 0) for sample in main.tested]
    unknown = sum(int((sample.looks.unique < 0).sum()) for sample in main.tested)
    points = sum(len(sample.looks.load) for sample in main.tested)
    shown = min(
        (sample for sample in main.tested if _unique_without_premise(sample).any()),
        key=lambda sample: sample.looks.load[np.argmax(_unique_without_premise(sample))] / sample.looks.load[-1],
        default=None,
    )
    note = "no state with Q ≤ 0 for some v has a unique status"
    if shown is not None:
        k = int(np.argmax(_unique_without_premise(shown)))
        note = (
            f"counterexample: sample {shown.seed} at load {shown.looks.load[k]:.4g} has Q < 0 for some v (the smallest "
            f"eigenvalue of the symmetric part of k is {shown.looks.symmetric[k]:.1e} K_n) and a unique status for "
            f"every load, and the path continues to {shown.looks.load[-1]:.4g}"
        )
    return claim(
        "stability-premise", f"Sec. V A: {YIELD}", True, shown is None, "", 0.0,
        f"{note}; Q > 0 for all v first fails at {min(premise):.3g} to {max(premise):.3g} of the load at which the "
        f"path ends, median {np.median(premise):.3g}; the status stays unique up to {min(unique):.3g} to "
        f"{max(unique):.3g} (not known at {unknown} of {points} points): the premise is sufficient but much too "
        f"strong; the condition that matters is that A is a P-matrix", quantifier=ALWAYS,
    )  # fmt: skip


def _unique_without_premise(sample: SampleResult) -> np.ndarray:
    """Points at which Q ≤ 0 for some v, the status is unique for any load, and the path continues.

    Shape (L,).
    """
    looks = sample.looks
    return (looks.symmetric < 0) & (looks.unique == 1) & (looks.load < looks.load[-1])


def _flutter(main: QuasiResult) -> Claim:
    """Claim that motion is damped if Q > 0; a state with Q > 0 for all v and a growing motion is a counterexample."""
    best, seen = None, 0
    for sample in main.tested:
        positive = sample.looks.symmetric > 0
        seen += int(positive.sum())
        for k in np.flatnonzero(positive & (sample.looks.pairs > 0)):
            if best is None or sample.looks.growth_rate[k] > best[1].looks.growth_rate[best[0]]:
                best = k, sample
    source = 'Sec. III D: "if vᵀkv > 0 then ... v undergoes damped oscillations"'
    if best is None:
        note = f"none of {seen} states with Q > 0 has a complex pair of m⁻¹k"
        return claim("flutter-example", source, True, True if seen else None, "", 0.0, note, quantifier=ALWAYS)
    k, sample = best
    state = sample.path.states[int(np.argmin(np.abs(sample.path.load - sample.looks.load[k])))]
    modes = spectrum(state, sample.law, modes=False)
    growth = float(modes.growth_rate[modes.pair_indices].max(initial=0.0))
    return claim(
        "flutter-example", source, True, not growth > 0, "", 0.0,
        f"does not hold if k is not symmetric; counterexample among {seen} states with Q > 0: sample {sample.seed} at "
        f"load {sample.looks.load[k]:.4g} has Q > 0 for all v and a complex pair of m⁻¹k, which grows at a rate of "
        f"{growth:.2e} without dashpots, and therefore also with weak ones; with the dashpots of the samples the "
        f"largest growth rate is {damped_growth(state, sample.law)[0].real.max():.2e}",
        quantifier=ALWAYS,
    )  # fmt: skip


def _apex(opened: ApexCases) -> Claim:
    return claim(
        "apex-counterexample", 'Sec. V B: "are these four states mutually exclusive?" is left open', None,
        bool(len(opened.example) > 1), "", 0.0,
        f"the four statuses at the apex are mutually exclusive where no choice has lost stability (det k of one sign): "
        f"{opened.wrong} of {opened.coherent} such cases on real packings do not have exactly one consistent choice; "
        f"otherwise, {opened.several} of {opened.total - opened.coherent} have two or more and {opened.none} have "
        f"none; one contact in unstable surroundings has several at once: {', '.join(opened.example)}",
    )  # fmt: skip


def _mechanisms(main: QuasiResult) -> Claim:
    """Claim about the null modes of a sample if its walls translate, if they also turn, and if all contacts slide."""
    sample = main.tested[0]
    state, law, n = sample.path.states[0], sample.law, main.scenario.disks.number
    walls = state.control.free.copy()
    walls[n:, :2] = True
    free = state._replace(control=state.control._replace(free=walls))
    arm = 0.5 * float(np.linalg.norm(state.walls.point.max(axis=0) - state.walls.point.min(axis=0)))
    still, turning = mechanisms(free, law), mechanisms(free, law, wall_arm=arm)
    turn = [m.quotient for m in turning if m.kind == RIGID]
    m = linear_system(state, law, rattlers=True)
    load = np.zeros(len(m.free))
    load[(m.free.body == n + TOP) & (m.free.axis == 1)] = -1.0
    loosened = mechanisms(state, law, load, sliding=np.ones(m.count, bool))
    count = {kind: sum(mode.kind == kind for mode in loosened) for kind in (RATTLER, IDLE, DRIVEN)}
    rigid, few = (sum(mode.kind == RIGID for mode in modes) for modes in (turning, still))
    return claim(
        "mechanism-classes", 'Sec. III E: "the stiffness matrix automatically has three null eigenvalues"', 3, rigid,
        "rigid motions", 0.0,
        f"sample {sample.seed}: {few} if its four walls translate; if they also turn, there is a third one, which is "
        f"not an exact null mode: its vᵀkv/vᵀv is {max(turn, default=0):.1e} K_n, of the order of (D/R)². There are "
        f"{count[RATTLER]} motions of rattlers; if every contact slides, there are {count[IDLE]} mechanisms that a "
        f"load on the lid does not excite and {count[DRIVEN]} that it drives", error=0.0,
    )  # fmt: skip


def shows() -> dict[str, tuple[str, str]]:
    """Figures of the paper, each with its content and the identifier of the claim to quote."""
    return SHOWS
