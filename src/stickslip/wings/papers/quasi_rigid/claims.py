"""Reproduction of McNamara & Herrmann 2006, Quasi-rigidity: some uniqueness issues.

The paper contains proofs and prints no numbers; its statements are therefore tested. The biaxial test is run with the
linear law, K_t = K_n/2 and μ = 1/2 at P/K_n = 1e-4. Units are K_n = 1, a mean diameter of 1, and a disk density of 4/π.
"""

import numpy as np
from scipy.stats import binomtest

from .... import State, spectrum
from ....kit import (
    ALWAYS,
    CAN,
    Claim,
    Report,
    Reproduction,
    Workers,
    claim,
    median_error,
    note_quick_run,
    pluralize,
    silent,
    standard_error,
    statement,
    validate_scenario,
)
from ....laws import hertz_mindlin
from ....modes import damped_growth
from ....packings import TOP
from ...status.matrices import linear_system, stiffness_matrix
from ...status.rigidity import DRIVEN, IDLE, RATTLER, RIGID, mechanisms
from .cases import (
    BURST,
    SlidingState,
    StatusCases,
    apex_cases,
    disk_in_groove,
    geometric_slope,
    most_critical,
    sliding_state,
    status_cases,
    through_instability,
    through_mechanism,
    vibrate,
)
from .scenario import QuasiScenario
from .simulate import QuasiResult, SampleResult, simulate_quasi, table_one

LOOKS = 8  # number of states of each path before its last tenth
EXPONENT = 0.02  # tolerance of the exponent: t and t^1.02 differ by 10 % over two decades
SLOPE = 0.25  # tolerance: half the distance to the next half-integer order
RATE = 0.02  # tolerance of a rate, the same as that of the exponent
LINEARISED = 1e-5  # tolerated relative error in Table I: ten times the ratio of motion to overlap
BALANCED = 1e-6  # largest unbalanced fraction of a load; round-off of k is 1e-10
HUNDREDS, DISKS = 100, 1600
MOTION = 1e-10  # random motion of `table_one` for one disk, a millionth of its overlap


def evaluate_motion(main: QuasiResult, quick: bool) -> list[Claim]:
    """Evaluate the claims about motion; a quick run omits other pressures and the packing of 1600 disks."""
    pairs = [(sample, state) for sample in main.tested for state in _sliding_states(sample)]
    loads = [_lid_load(main, state, sample) for sample, state in pairs]
    linearised = max(table_one(*disk_in_groove(make=hertz_mindlin), size=MOTION).values())
    states = [
        (sample.seed, made)
        for (sample, state), load in zip(pairs, loads, strict=True)
        if (made := sliding_state(state, sample.law, load))
    ]
    choices = [s for _, s in states if s.critical > 1]
    by_value = [s.least_eigenvalue for s in choices if s.least_eigenvalue is not None]
    by_det = [s.least_determinant for s in choices if s.least_determinant is not None]
    return [
        *_growth(), _null_modes(main), *_costly_claims(main, quick),
        statement(
            "all-sliding-least-stable",
            'Sec. V A: "most likely to be unstable is the one where all M_c critical contacts are sliding"',
            sum(by_value) > len(by_value) / 2 if by_value else None,
            f"holds in most states: among all statuses, it has the smallest eigenvalue of the symmetric part of k in "
            f"{sum(by_value)} of {len(by_value)} states with 2 to 6 critical contacts, and the smallest det k in "
            f"{sum(by_det)} of {len(by_det)} with 2 to 14",
        ),
        _shares(states), _sliding_share(states), *_vibrations(pairs[::LOOKS] if quick else pairs),
        statement(
            "linear-law-is-no-restriction", 'Sec. V A: "one could always linearise the force law"',
            linearised < LINEARISED,
            f"Table I with Hertz–Mindlin linearised at a point, at the limit: relative errors up to {linearised:.0e}. "
            f"K then has the entry −φ' below its diagonal, and a sticking contact contributes a positive amount to Q "
            f"only if μ² < 24 k_t/k_n",
        ),
    ]  # fmt: skip


def _sliding_states(sample: SampleResult) -> list[State]:
    """States with sliding contacts before the last tenth of a path."""
    points = [p for p in sample.path.points if p.sliding and p.load <= 0.9 * sample.path.points[-1].load]
    chosen = np.unique(np.linspace(0, len(points) - 1, LOOKS).round().astype(int)) if points else []
    return [points[k].state for k in chosen]


def _lid_load(main: QuasiResult, state: State, sample: SampleResult, rattlers: bool = False) -> np.ndarray:
    free = linear_system(state, sample.law, rattlers=rattlers).free
    return -((free.body == main.scenario.disks.number + TOP) & (free.axis == 1)).astype(float)


def _growth() -> list[Claim]:
    slow, fast = through_mechanism(), through_instability()
    ratio = fast.rate / fast.predicted
    decades = np.log10(fast.speed[-1] / fast.speed[0])
    return [
        claim(
            "growth-through-mechanism", "Sec. III E: Eq 40, |v| ∝ t |f_ext|/|m| without damping", 1.0, slow.power, "1",
            EXPONENT,
            f"exponent of speed against time of a disk between two floors, both of whose contacts are at the limit, "
            f"after a small push: {slow.power:.6f}", error=0.0,
        ),
        statement(
            "growth-through-instability", 'Sec. III D: "v_0 grows exponentially on a short time scale"',
            abs(ratio - 1) < RATE,
            f"a disk in a groove with one contact at the limit and det k(S) < 0: rate {fast.rate:.5f}, √−λ of m⁻¹k "
            f"{fast.predicted:.5f}, over {decades:.1f} decades of speed",
        ),
    ]  # fmt: skip


def _null_modes(main: QuasiResult) -> Claim:
    """Claim that each null mode is either driven by the load, which then cannot be balanced, or irrelevant."""
    driven = irrelevant = wrong = 0
    for sample in main.tested:
        for state in (sample.path.states[0], *_sliding_states(sample)[-1:]):
            m = linear_system(state, sample.law, rattlers=True)
            load = _lid_load(main, state, sample, rattlers=True)
            for sliding in (m.limit, np.ones(m.count, bool)):
                modes = mechanisms(state, sample.law, load, sliding=sliding)
                k = stiffness_matrix(m, sliding, geometric=False).toarray()
                rest = k @ np.linalg.lstsq(k, load, rcond=1e-10)[0] - load
                drives = [mode for mode in modes if mode.kind == DRIVEN]
                wrong += bool(drives) != (np.linalg.norm(rest) > BALANCED * np.linalg.norm(load))
                driven, irrelevant = driven + len(drives), irrelevant + len(modes) - len(drives)
    return statement(
        "null-mode-classes", 'Sec. III E: "null eigenvalues of k can always be put into one of two classes"', not wrong,
        f"{driven} null modes that the load drives, {irrelevant} that it does not, with the statuses of the packings "
        f"and with all contacts sliding; in {wrong} cases they contradict the residual of k v = load, found by least "
        f"squares", quantifier=ALWAYS,
    )  # fmt: skip


def _costly_claims(main: QuasiResult, quick: bool) -> list[Claim]:
    """Claims about the geometric stiffness and the number of critical contacts, which a quick run leaves open."""
    slope = "geometric-stiffness-slope", "Sec. III D: Eq 33, the neglected term is O(D/R)", 1.0
    number = (
        "hundreds-of-critical-contacts",
        'Sec. II C: "it is common to have hundreds of critical contacts" with "thousands of particles"',
    )
    if quick:
        return [
            claim(*slope, None, "1", SLOPE, "needs packings at three pressures"),
            statement(*number, None, f"needs a path of {DISKS} disks", quantifier=CAN),
        ]
    slopes, (count, load) = [geometric_slope(s.seed) for s in main.tested], most_critical(DISKS, main.scenario.seed)
    return [
        claim(
            *slope, float(np.mean(slopes)), "1", SLOPE,
            "slope of the logarithm of |geometric stiffness|/|k| against that of the largest overlap, from packings at "
            f"P/K_n = 1e-5, 1e-4 and 1e-3: {', '.join(f'{s:.3f}' for s in slopes)}", error=standard_error(slopes),
        ),
        statement(
            *number, count >= HUNDREDS,
            f"up to {count} in one path of {DISKS} disks, which ends at load {load:.3g}", quantifier=CAN,
        ),
    ]  # fmt: skip


def _shares(states: list[tuple[int, SlidingState]]) -> Claim:
    """Claim about the mean contribution of sliding contacts to Q, with the error between samples."""
    seeds = sorted({seed for seed, _ in states})
    means = [float(np.mean(np.concatenate([s.shares for k, s in states if k == seed]))) for seed in seeds]
    shares = np.concatenate([s.shares for _, s in states]) if states else np.zeros(0)
    error = standard_error(means)
    mean = float(np.mean(means)) if means else 0.0
    decided = error is not None and abs(mean) > 2 * error
    return statement(
        "sliding-contributions-negative",
        'Sec. V A: "the contributions of sliding contacts to the quadratic form are on the average negative"',
        mean < 0 if decided else None,
        f"{(shares < 0).mean() if len(shares) else 0:.0%} of {len(shares)} are negative; mean over samples of the "
        f"contribution of one contact to Q {mean:.4f} ± {2 * (error or 0):.4f}, for v under the load; more "
        f"samples would decide it",
    )  # fmt: skip


def _sliding_share(states: list[tuple[int, SlidingState]]) -> Claim:
    """Claim that nearly all critical contacts slide; load reversal is a counterexample."""
    share = np.array([s.slide / s.critical for _, s in states])
    back = [(s.reverse / s.critical, seed, s.critical, s.reverse) for seed, s in states if s.critical > 1]
    lowest = min(back, default=None)
    note = f"under the load, {share.min(initial=1):.0%} to {share.max(initial=0):.0%} of the critical contacts slide"
    if lowest:
        note += (
            f"; under the reverse load {np.mean([b[0] for b in back]):.0%} on average. Counterexample: in sample "
            f"{lowest[1]}, {lowest[3]} of {lowest[2]} slide when the load is reversed, before the others leave the cone"
        )
    holds = bool(share.min() > 0.5 and (lowest is None or lowest[0] > 0.5)) if states else None
    return statement(
        "close-to-all-sliding", 'Sec. V A: "the packing is always close to this state", where all critical contacts '
        "slide", holds, note, quantifier=ALWAYS,
    )  # fmt: skip


def _vibrations(pairs: list[tuple[SampleResult, State]]) -> list[Claim]:
    made = [vibrate(state, sample.law) for sample, state in pairs]
    kicked, still = ([getattr(v, name) for v in made] for name in ("kicked", "still"))
    most = max((v.energy for v in made), default=0.0)
    switches = f"median switches of a critical contact {np.median(kicked):.2g}" if made else "no state"
    return [
        statement(
            "vibrations-switch-statuses",
            'Sec. V A: "the contact status will therefore switch between non-sliding and sliding"',
            None if not made or np.median(still) else bool(np.median(kicked)),
            f"after random velocities of 1e-2 overlaps per time of a contact, {switches} in 200 looks during 200 time "
            f"units; without them {np.median(still) if made else 0:.2g}. States whose contacts keep their status "
            f"without a kick would decide it",
        ),
        statement(
            "vibrations-collapse", 'Sec. V A: "if it finds an unstable one, it may collapse"', most > BURST,
            f"largest kinetic energy of {len(made)} states: {most:.2g} times that of the kick, {BURST:g} being a "
            f"collapse; kicks at loads closer to the end of the path would decide it", quantifier=CAN,
        ),
    ]  # fmt: skip


CASES = 500
RELATIONS = 1e-5  # tolerated relative error in Table I: a hundred times 1e-7, the step and size of neglected terms
COLLAPSE = 0.02  # tolerance: two increments of the slow load, the resolution of the collapse load
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
    drawn, opened, errors = status_cases(main, cases), apex_cases(main, cases), []
    for sample in main.tested:  # at the state with the most sliding contacts before the last tenth of the path
        early = [p for p in sample.path.points if p.load <= 0.9 * sample.path.points[-1].load]
        errors.append(table_one(max(early, key=lambda p: p.sliding).state, sample.law))
    worst = {name: max(e[name] for e in errors) for name in errors[0]}
    return [
        statement(
            "table-I-relations", "Table I: f = cF, F = −KD, dD/dt = SV, V = cᵀv", max(worst.values()) < RELATIONS,
            f"compared with the engine's forces in states with sliding contacts; relative errors: "
            f"{', '.join(f'{name} to {value:.0e}' for name, value in worst.items())} (steps of 1e-7 radii)",
        ),
        *_status_claims(main, drawn), _slow_error(main), _collapse(main), _premise(main),
        _flutter(main),
        claim(
            "apex-counterexample", 'Sec. V B: "are these four states mutually exclusive?" is left open', None,
            bool(len(opened.example) > 1), "", 0.0,
            f"the four statuses at the apex are mutually exclusive where no choice has lost stability (det k of one "
            f"sign): {opened.wrong} of {opened.coherent} such cases on real packings do not have exactly one "
            f"consistent choice; otherwise, {opened.several} of {opened.total - opened.coherent} have two or more and "
            f"{opened.none} have none; one contact in unstable surroundings has several at once: "
            f"{', '.join(opened.example)}",
        ),
        _mechanisms(main), *evaluate_motion(main, quick),
    ]  # fmt: skip


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
        statement(
            "status-map-bijective",
            'Eq 5: "the mapping C is bijective", if "all possible states lead to a stable packing"',
            bool(bijective and drawn.agree == drawn.total),
            f"tested where A is a P-matrix, which follows from that premise: in all such states on the paths; in "
            f"{drawn.agree} of {drawn.total} constructed cases the map is bijective if and only if A is a P-matrix; "
            f"regardless of the premise, the map is bijective in {whole} of {number} states with 1 to 10 critical "
            f"contacts, by enumeration of all statuses", quantifier=ALWAYS,
        ),
        statement(
            "one-consistent-state", 'Sec. II D: "always one, and only one choice of contact status"',
            not wrong if checked else None,
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
    """Claim that path and dynamics differ less under the slowest load than under the fastest."""
    times = sorted(main.scenario.dynamics.times)
    compared = [sample for sample in main.tested if len(sample.slow) == len(times)]
    source = "Sec. III D: quasi-static balance as the limit of Newton's second law"
    if not compared:
        note = "no sample has slow dynamics at every duration"
        return statement("path-vs-dynamics-error", source, None, note)
    errors = np.array([[run.error for run in sorted(sample.slow, key=lambda r: r.time)] for sample in compared])
    middle = np.median(errors, axis=0)
    listed = ", ".join(
        f"{m:.1e} ({lo:.1e} to {hi:.1e}) at {t:g}"
        for t, m, lo, hi in zip(times, middle, errors.min(axis=0), errors.max(axis=0), strict=True)
    )
    falls, left = int((errors[:, -1] < errors[:, 0]).sum()), len(main.tested) - len(compared)
    rest = f"; {pluralize(left, 'sample')} without dynamics at every duration" if left else ""
    return statement(
        "path-vs-dynamics-error", source, sign_test(falls, len(errors)),
        f"largest difference of strain up to 95 % of the load, over the last strain, median and range for each "
        f"duration of the whole load: {listed}; smaller at the slowest load than at the fastest in {falls} of "
        f"{len(errors)} samples{rest}",
    )  # fmt: skip


def sign_test(yes: int, total: int) -> bool | None:
    """Decide by a sign test at the 5 % level whether `yes` outcomes prevail.

    None if there are too few cases, such as four.
    """
    if binomtest(yes, total, alternative="greater").pvalue <= 0.05:
        return True
    return False if binomtest(yes, total, alternative="less").pvalue <= 0.05 else None


def collapse_ratio(sample: SampleResult, beyond: float) -> tuple[float, float]:
    """Bounds on the ratio of the collapse load in slow dynamics to the load at which the path loses stability.

    The bounds are equal if both loads are known. Dynamics that continues beyond the end of the path by the fraction
    `beyond`, or reaches the whole load, gives only a lower bound. A path that does not end with a loss of stability
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
    """Claim about the collapse load, including samples whose path or dynamics does not end in collapse."""
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
    """Fraction of the path's load at which a condition first fails; 1 if it never does."""
    return float(load[np.argmax(fails)] / load[-1]) if fails.any() and load[-1] > 0 else 1.0


def _premise(main: QuasiResult) -> Claim:
    """Claim about the premise Q > 0; a state with Q < 0 and a unique status on a continuing path refutes it."""
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
    return statement(
        "stability-premise", f"Sec. V A: {YIELD}", shown is None,
        f"{note}; Q > 0 for all v first fails at {min(premise):.3g} to {max(premise):.3g} of the load at which the "
        f"path ends, median {np.median(premise):.3g}; the status stays unique up to {min(unique):.3g} to "
        f"{max(unique):.3g} (not known at {unknown} of {points} points): the premise is sufficient but much too "
        f"strong; the condition that matters is that A is a P-matrix", quantifier=ALWAYS,
    )  # fmt: skip


def _unique_without_premise(sample: SampleResult) -> np.ndarray:
    """Mask (L,) of points at which Q ≤ 0 for some v, the status is unique for any load, and the path continues."""
    looks = sample.looks
    return (looks.symmetric < 0) & (looks.unique == 1) & (looks.load < looks.load[-1])


def _flutter(main: QuasiResult) -> Claim:
    """Claim that motion is damped if Q > 0; a state with Q > 0 for all v and a growing motion refutes it."""
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
        return statement("flutter-example", source, True if seen else None, note, quantifier=ALWAYS)
    k, sample = best
    state = sample.path.states[int(np.argmin(np.abs(sample.path.load - sample.looks.load[k])))]
    modes = spectrum(state, sample.law, modes=False)
    growth = float(modes.growth_rate[modes.pair_indices].max(initial=0.0))
    return statement(
        "flutter-example", source, not growth > 0,
        f"does not hold if k is not symmetric; counterexample among {seen} states with Q > 0: sample {sample.seed} at "
        f"load {sample.looks.load[k]:.4g} has Q > 0 for all v and a complex pair of m⁻¹k, which grows at a rate of "
        f"{growth:.2e} without dashpots, and therefore also with weak ones; with the dashpots of the samples the "
        f"largest growth rate is {damped_growth(state, sample.law)[0].real.max():.2e}", quantifier=ALWAYS,
    )  # fmt: skip


def _mechanisms(main: QuasiResult) -> Claim:
    """Claim about the null modes of a sample if walls only translate, if they also turn, or if all contacts slide."""
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


QUICK_CASES = 60


def paper_scenario(*, quick: bool = False, seed: int = 0) -> QuasiScenario:
    """Return the scenario of the biaxial test: the lid force grows, at most fourfold, until stability is lost."""
    loading = {"test": "biaxial", "factor": 4.0, "increment": 2e-3 if quick else 1e-3, "unload": True}
    if quick:
        return validate_scenario(
            QuasiScenario, seed=seed, samples=2, disks={"number": 60}, loading=loading,
            dynamics={"times": (1e4, 2e4, 4e4)},
        )  # fmt: skip
    return validate_scenario(
        QuasiScenario, seed=seed, samples=5, disks={"number": 100}, loading=loading,
        dynamics={"times": (3e4, 1e5, 3e5, 1e6)},
    )  # fmt: skip


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario with the arguments of `simulate_quasi`, and evaluate its claims."""
    main = simulate_quasi(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    report("constructed cases", 0.0, "statuses and the apex")
    claims = evaluate_claims(main, cases=QUICK_CASES if quick else CASES, quick=quick)
    return Reproduction(main, note_quick_run(claims) if quick else claims)
