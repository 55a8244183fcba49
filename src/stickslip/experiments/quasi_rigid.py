"""Paper 002, end to end: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues.

The paper proves, and prints no numbers. Its biaxial test is run here with the linear law, K_t = K_n/2 and μ = 1/2 at
P/K_n = 1e-4. Units: K_n = 1, mean diameter 1, masses of disks of density 4/π.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from ..core.state import State
from ..data.quasi_scenario import QuasiScenario
from ..data.scenario import scenario
from ..ensemble import Workers
from ..loading.biaxial import TOP
from ..quasirigid.apex import WORDS, Apex, consistent_statuses
from ..quasirigid.complementarity import complementarity
from ..quasirigid.enumeration import status_map
from ..quasirigid.matrices import Matrices, matrices
from ..quasirigid.mechanisms import DRIVEN, IDLE, RATTLER, RIGID, mechanisms
from ..quasirigid.opening import reduced
from ..quasirigid.uniqueness import certificate
from ..solve.spectrum import damped_growth, spectrum
from .claims import Claim, claim
from .quasi_test import QuasiResult, Report, Tested, silent, simulate_quasi, table_one

CUTS = (
    "2 packings of 60 disks instead of 5 of 100; slow dynamics of 1e4, 3e4 and 1e5 time units instead of 3e4, 1e5, "
    "3e5 and 1e6; increments of the load of 2e-3 instead of 1e-3; 100 constructed cases of each kind instead of 500"
)
NO_NUMBER = "the paper proves and prints no number"
CASES, QUICK_CASES = 500, 100


class Reproduction(NamedTuple):
    """The scenario, run, and the claims that it supports."""

    main: QuasiResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> QuasiScenario:
    """The biaxial test: the force on the lid grows, up to four times what it was, until stability is lost."""
    loading = {"test": "biaxial", "factor": 4.0, "increment": 2e-3 if quick else 1e-3, "unload": True}
    if quick:
        return scenario(
            experiment="quasi-rigid", seed=seed, samples=2, disks={"number": 60}, loading=loading,
            dynamics={"times": (1e4, 3e4, 1e5)},
        )  # fmt: skip
    return scenario(
        experiment="quasi-rigid", seed=seed, samples=5, disks={"number": 100}, loading=loading,
        dynamics={"times": (3e4, 1e5, 3e5, 1e6)},
    )  # fmt: skip


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario and judge its claims; arguments as in `simulate_quasi`. Returns a Reproduction."""
    main = simulate_quasi(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    report("constructed cases", 0.0, "statuses and the apex")
    return Reproduction(main, judged(main, cases=QUICK_CASES if quick else CASES))


def judged(main: QuasiResult, *, cases: int = CASES) -> list[Claim]:
    """All claims; medians over samples, ranges in the notes."""
    drawn, opened = constructed(main, cases), apexes(main, cases)
    return [
        _table_one(main), *_statuses(main, drawn), *_paths(main), *_premise(main), _flutter(main), _apex(opened),
        _mechanisms(main),
    ]  # fmt: skip


def _middle(one: Tested) -> State:
    """The point of a path with most sliding contacts before its last tenth."""
    early = [p for p in one.path.points if p.load <= 0.9 * one.path.points[-1].load]
    return max(early, key=lambda p: p.sliding).state


def _table_one(main: QuasiResult) -> Claim:
    errors = [table_one(_middle(one), one.law) for one in main.tested]
    worst = {name: max(e[name] for e in errors) for name in errors[0]}
    words = ", ".join(f"{name} to {value:.0e}" for name, value in worst.items())
    return claim(
        "table-I-relations", "Table I", True, max(worst.values()) < 1e-5, "", 0.0,
        f"against the engine's own forces, in states with sliding contacts, relative: {words} (steps of 1e-7 radii)",
    )  # fmt: skip


class Constructed(NamedTuple):
    """Cases drawn on states of real packings: which contacts are critical, to which side, and the load."""

    total: int
    p_matrices: int
    agree: int  # cases in which P and a bijective status map come together
    none: int  # cases without a consistent status
    several: int  # with two or more


def constructed(main: QuasiResult, cases: int) -> Constructed:
    """Random critical contacts, slip signs and loads on states of the paths: is the status unique?"""
    rng, count, drawn = np.random.default_rng(main.scenario.seed), np.zeros(4, int), 0
    while drawn < cases:
        m = _some_matrices(main, rng, drawn)
        critical = rng.choice(m.count, int(rng.integers(2, 9)), replace=False)
        m = m._replace(sign=rng.choice([-1.0, 1.0], m.count))
        try:
            problem = complementarity(m, rng.normal(size=len(m.free)), critical=critical)
        except LinAlgError:
            continue  # a contact has just opened, and a disk with it
        whole, mapped = bool(certificate(problem).unique), status_map(problem)
        count += [whole, whole == mapped.bijective, len(mapped.consistent) == 0, len(mapped.consistent) > 1]
        drawn += 1
    return Constructed(cases, *(int(c) for c in count))


def _some_matrices(main: QuasiResult, rng, number: int) -> Matrices:
    """The matrices of a state that is drawn from one sample's path, sample after sample."""
    one = main.tested[number % len(main.tested)]
    return matrices(one.path.states[int(rng.integers(len(one.path.points)))], one.law)


def _statuses(main: QuasiResult, drawn: Constructed) -> list[Claim]:
    before = [one.looks.load < one.looks.load[-1] for one in main.tested]
    known = [(one.looks.bijective >= 0) & b for one, b in zip(main.tested, before, strict=True)]
    sliding = [k & (one.looks.critical > 0) for one, k in zip(main.tested, known, strict=True)]
    number = int(sum(s.sum() for s in sliding))
    whole = int(sum((one.looks.bijective[s] == 1).sum() for one, s in zip(main.tested, sliding, strict=True)))
    bijective = all((one.looks.bijective[k] == 1).all() for one, k in zip(main.tested, known, strict=True))
    single = all((one.looks.consistent[k] == 1).all() for one, k in zip(main.tested, known, strict=True))
    ends = sum(one.looks.consistent[-1] == 0 for one in main.tested)
    example = drawn.none > 0 and drawn.several > 0
    return [
        claim(
            "status-map-bijective", "Eq 5", True, bool(bijective and drawn.agree == drawn.total), "", 0.0,
            f"in {whole} of {number} states with 1 to 10 critical contacts on the paths, all statuses gone through (in "
            f"the others another load could have had none or two); and in {drawn.agree} of {drawn.total} constructed "
            f"cases it is bijective if and only if A is a P-matrix",
        ),
        claim(
            "one-consistent-state", "Sec. II D", True, bool(single), "", 0.0,
            f"exactly one in the same {number} states under the load of the test; none at the end of {ends} of "
            f"{len(main.tested)} paths",
        ),
        claim(
            "non-unique-example", "Sec. V A", True, bool(example), "", 0.0,
            f"where stability is not given, uniqueness is not either: of {drawn.total} constructed cases "
            f"{drawn.total - drawn.p_matrices} have no P-matrix, {drawn.none} no consistent status under the load that "
            f"was drawn, {drawn.several} two or more",
        ),
    ]  # fmt: skip


def _paths(main: QuasiResult) -> list[Claim]:
    errors = np.array([[run.error for run in sorted(one.slow, key=lambda r: r.time)] for one in main.tested])
    times = sorted(main.scenario.dynamics.times)
    middle = np.median(errors, axis=0)
    words = ", ".join(
        f"{m:.1e} ({lo:.1e} to {hi:.1e}) at {t:g}"
        for t, m, lo, hi in zip(times, middle, errors.min(axis=0), errors.max(axis=0), strict=True)
    )
    ratios = [one.collapse / one.path.points[-1].load for one in main.tested if one.collapse]
    found = f"{min(ratios):.4f} to {max(ratios):.4f} in" if ratios else "in none of"
    return [
        claim(
            "path-vs-dynamics-error", "Sec. III D", True, bool((errors[:, -1] < errors[:, 0]).all()), "", 0.0,
            f"the slower the load, the closer dynamics comes to the path: largest difference of strain up to 95 % of "
            f"the load, over the last strain, median and range, by the time of the whole load: {words}",
        ),
        claim(
            "collapse-load-ratio", "Sec. V A", 1.0, float(np.median(ratios)) if ratios else None, "1", 0.02,
            f"load at which slow dynamics starts to move by itself over the load at which the path ends: {found} "
            f"{len(ratios)} of {len(main.tested)} samples; in the others dynamics passed the path's end by "
            f"{main.scenario.dynamics.beyond:.0%} without a burst of kinetic energy",
        ),
    ]  # fmt: skip


def _first(load: np.ndarray, fails: np.ndarray) -> float:
    """Share of the path's load at which something first fails; 1 if it never does."""
    return float(load[np.argmax(fails)] / load[-1]) if fails.any() and load[-1] > 0 else 1.0


def _premise(main: QuasiResult) -> list[Claim]:
    premise = [_first(one.looks.load, one.looks.symmetric < 0) for one in main.tested]
    unique = [_first(one.looks.load, one.looks.unique == 0) for one in main.tested]
    unknown = sum(int((one.looks.unique < 0).sum()) for one in main.tested)
    return [
        claim(
            "stability-premise", "Eq 3, Sec. V A", 1.0, float(np.median(premise)), "share of the final load", 0.1,
            f"Q > 0 for all v first fails at {min(premise):.3g} to {max(premise):.3g} of the load at which the path "
            f"ends; the status stays unique up to {min(unique):.3g} to {max(unique):.3g} (not known at {unknown} of "
            f"{sum(len(one.looks.load) for one in main.tested)} points): the premise is sufficient and much too "
            f"strong, what counts is that A is a P-matrix",
        )
    ]  # fmt: skip


def _flutter(main: QuasiResult) -> Claim:
    best = None
    for one in main.tested:
        found = np.flatnonzero((one.looks.symmetric > 0) & (one.looks.pairs > 0))
        for k in found[np.argsort(-one.looks.growth_rate[found])][:1]:
            if best is None or one.looks.growth_rate[k] > best[1].looks.growth_rate[best[0]]:
                best = k, one
    if best is None:
        return claim("flutter-example", "Sec. III D", False, False, "", 0.0, "no state of the paths has a complex pair")
    k, one = best
    at = int(np.argmin(np.abs(one.path.load - one.looks.load[k])))
    state = one.path.states[at]
    seen = spectrum(state, one.law, modes=False)
    return claim(
        "flutter-example", "Sec. III D", False, bool(len(seen.pairs) > 0), "", 0.0,
        f"that motion is damped out where Q > 0 for all v does not hold for a k that is not symmetric: sample "
        f"{one.seed} at load {one.looks.load[k]:.4g} has Q > 0 and a complex pair of m⁻¹k, growth rate "
        f"{seen.growth_rate[seen.pairs].max():.2e} without dashpots; with those of the samples the fastest growth is "
        f"{damped_growth(state, one.law)[0].real.max():.2e}",
    )  # fmt: skip


class Opened(NamedTuple):
    """Contacts of real packings put at the apex of the cone."""

    total: int
    coherent: int  # all choices of statuses have det k of one sign
    wrong: int  # coherent cases without exactly one consistent choice
    several: int  # other cases, with two or more
    none: int  # other cases, without any
    example: tuple[str, ...]  # statuses that are consistent together, without stability


def counterexample(directions: int = 720) -> tuple[str, ...]:
    """The most statuses that are consistent together for one contact and a surrounding that is not stable.

    K_ext = ((1, 0.3), (0.3, 0.1)) in (n, t) beside K_n = 1, K_t = 0.5, μ = 0.9, over all directions of the load.
    """
    springs = np.diag([1.0, 0.5])
    compliance = np.linalg.inv(np.array([[1.0, 0.3], [0.3, 0.1]]) + springs)
    most = np.zeros((0, 1), int)
    for angle in np.linspace(0, 2 * np.pi, directions, endpoint=False):
        velocity = compliance @ np.array([np.cos(angle), np.sin(angle)])
        apex = Apex(compliance, velocity[None], springs[None], np.array([1.8]), np.zeros(1), np.zeros(1, bool))
        found, _ = consistent_statuses(apex)
        most = found if len(found) > len(most) else most
    return tuple(WORDS[status] for status in most[:, 0])


def apexes(main: QuasiResult, cases: int) -> Opened:
    """One or two contacts at the apex, up to two at the limit, and random loads: do the four statuses exclude?"""
    rng, count, drawn = np.random.default_rng(main.scenario.seed + 1), np.zeros(4, int), 0
    while drawn < cases:
        m = _some_matrices(main, rng, drawn)
        open_ones, critical = int(rng.integers(1, 3)), int(rng.integers(0, 3))
        contacts = rng.choice(m.count, open_ones + critical, replace=False)
        sign = np.append(np.zeros(open_ones), rng.choice([-1.0, 1.0], critical))
        try:
            apex = reduced(m, rng.normal(size=len(m.free)), contacts, sign).apex
        except LinAlgError:
            continue
        found, coherent = consistent_statuses(apex)
        count += [coherent, coherent and len(found) != 1, not coherent and len(found) > 1, not (coherent or len(found))]
        drawn += 1
    return Opened(cases, *(int(c) for c in count), counterexample())


def _apex(opened: Opened) -> Claim:
    return claim(
        "apex-counterexample", "Sec. V B", None, bool(len(opened.example) > 1), "", 0.0,
        f"the paper asks whether the four statuses at the apex exclude each other. They do where no choice has lost "
        f"its stability (det k of one sign): {opened.wrong} of {opened.coherent} such cases on real packings have not "
        f"exactly one; without, {opened.several} of {opened.total - opened.coherent} have two or more and "
        f"{opened.none} none; one contact in an unstable surrounding: {', '.join(opened.example)} together",
    )  # fmt: skip


def _mechanisms(main: QuasiResult) -> Claim:
    """Null modes of a sample whose walls are all free to translate, then to turn; and if every contact slides."""
    one = main.tested[0]
    state, law, n = one.path.states[0], one.law, main.scenario.disks.number
    walls = state.control.free.copy()
    walls[n:, :2] = True
    free = state._replace(control=state.control._replace(free=walls))
    arm = 0.5 * float(np.linalg.norm(state.walls.point.max(axis=0) - state.walls.point.min(axis=0)))
    still, turning = mechanisms(free, law), mechanisms(free, law, wall_arm=arm)
    turn = [m.quotient for m in turning if m.kind == RIGID]
    m = matrices(state, law, rattlers=True)
    load = np.zeros(len(m.free))
    load[(m.free.body == n + TOP) & (m.free.axis == 1)] = -1.0
    loosened = mechanisms(state, law, load, sliding=np.ones(m.count, bool))
    count = {kind: sum(mode.kind == kind for mode in loosened) for kind in (RATTLER, IDLE, DRIVEN)}
    rigid, few = (sum(mode.kind == RIGID for mode in modes) for modes in (turning, still))
    return claim(
        "mechanism-classes", "Sec. III E", 3, rigid, "rigid motions", 0.0,
        f"sample {one.seed}: {few} if its four walls translate; if they turn, too, a third one, which is none exactly: "
        f"its vᵀkv/vᵀv is {max(turn, default=0):.1e} of K_n, of the order of (D/R)². {count[RATTLER]} motions of "
        f"rattlers; if every contact slides, {count[IDLE]} mechanisms that a load on the lid does not excite and "
        f"{count[DRIVEN]} that it drives",
    )  # fmt: skip
