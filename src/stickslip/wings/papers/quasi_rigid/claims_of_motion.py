"""Evaluation of statements of McNamara & Herrmann 2006 on motion, null modes and sliding contacts."""

import numpy as np

from .... import State
from ....kit import Claim, claim, standard_error
from ....laws import hertz_mindlin
from ....packings import TOP
from ....reports.claims import ALWAYS, CAN
from ...status.matrices import linear_system, stiffness_matrix
from ...status.rigidity import DRIVEN, mechanisms
from .growth import disk_in_groove, through_instability, through_mechanism
from .simulate import QuasiResult, SampleResult, table_one
from .sliding import BURST, SlidingState, geometric_slope, most_critical, sliding_state, vibrate

LOOKS = 8  # states of each path, before its last tenth
EXPONENT = 0.02  # tolerance of a closed form: t and t^1.02 differ by 10 % over two decades
SLOPE = 0.25  # tolerance: half the distance to the next half-integer order
RATE = 0.02  # as EXPONENT
LINEARISED = 1e-5  # relative error of Table I, ten times the motion over the overlap
BALANCED = 1e-6  # share of a load without balance; round-off of k is 1e-10
HUNDREDS, DISKS = 100, 1600
MOTION = 1e-10  # of `table_one` for one disk, a millionth of its overlap


def evaluate_motion(main: QuasiResult, quick: bool) -> list[Claim]:
    """Evaluate the statements; a quick run leaves out other pressures and the packing of 1600 disks."""
    pairs = [(sample, state) for sample in main.tested for state in _sliding_states(sample)]
    loads = [_lid_load(main, state, sample) for sample, state in pairs]
    states = [
        (sample.seed, made)
        for (sample, state), load in zip(pairs, loads, strict=True)
        if (made := sliding_state(state, sample.law, load))
    ]
    return [
        *_growth(), _null_modes(main), _geometric(main, quick), _critical_contacts(main, quick), _least_stable(states),
        _shares(states), _sliding_share(states), *_vibrations(pairs[::LOOKS] if quick else pairs), _linear_law(),
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
        claim(
            "growth-through-instability", 'Sec. III D: "v_0 grows exponentially on a short time scale"', True,
            abs(ratio - 1) < RATE, "", 0.0,
            f"a disk in a groove with one contact at the limit and det k(S) < 0: rate {fast.rate:.5f}, √−λ of m⁻¹k "
            f"{fast.predicted:.5f}, over {decades:.1f} decades of speed",
        ),
    ]  # fmt: skip


def _null_modes(main: QuasiResult) -> Claim:
    """Claim that each null mode is either driven by the load, which then has no balance, or irrelevant."""
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
    return claim(
        "null-mode-classes", 'Sec. III E: "null eigenvalues of k can always be put into one of two classes"', True,
        not wrong, "", 0.0,
        f"{driven} null modes that the load drives, {irrelevant} that it does not, with the statuses of the packings "
        f"and with all contacts sliding; in {wrong} cases they contradict the residual of k v = load, found by least "
        f"squares", quantifier=ALWAYS,
    )  # fmt: skip


def _geometric(main: QuasiResult, quick: bool) -> Claim:
    id, source = "geometric-stiffness-slope", "Sec. III D: Eq 33, the neglected term is O(D/R)"
    if quick:
        return claim(id, source, 1.0, None, "1", SLOPE, "needs packings at three pressures")
    slopes = [geometric_slope(sample.seed) for sample in main.tested]
    return claim(
        id, source, 1.0, float(np.mean(slopes)), "1", SLOPE,
        "slope of the logarithm of |geometric stiffness|/|k| against that of the largest overlap, from packings at "
        f"P/K_n = 1e-5, 1e-4 and 1e-3: {', '.join(f'{s:.3f}' for s in slopes)}", error=standard_error(slopes),
    )  # fmt: skip


def _critical_contacts(main: QuasiResult, quick: bool) -> Claim:
    id = "hundreds-of-critical-contacts"
    source = 'Sec. II C: "it is common to have hundreds of critical contacts" with "thousands of particles"'
    if quick:
        return claim(id, source, True, None, "", 0.0, f"needs a path of {DISKS} disks", quantifier=CAN)
    count, load = most_critical(DISKS, main.scenario.seed)
    return claim(
        id, source, True, count >= HUNDREDS, "", 0.0,
        f"up to {count} in one path of {DISKS} disks, which ends at load {load:.3g}", quantifier=CAN,
    )  # fmt: skip


def _least_stable(states: list[tuple[int, SlidingState]]) -> Claim:
    by_value = [s.least_eigenvalue for _, s in states if s.critical > 1 and s.least_eigenvalue is not None]
    by_det = [s.least_determinant for _, s in states if s.critical > 1 and s.least_determinant is not None]
    return claim(
        "all-sliding-least-stable",
        'Sec. V A: "most likely to be unstable is the one where all M_c critical contacts are sliding"',
        True, sum(by_value) > len(by_value) / 2 if by_value else None, "", 0.0,
        f"holds in most states: among all statuses, it has the smallest eigenvalue of the symmetric part of k in "
        f"{sum(by_value)} of {len(by_value)} states with 2 to 6 critical contacts, and the smallest det k in "
        f"{sum(by_det)} of {len(by_det)} with 2 to 14",
    )  # fmt: skip


def _shares(states: list[tuple[int, SlidingState]]) -> Claim:
    """Claim about the mean share of sliding contacts in Q; its error is that between samples."""
    seeds = sorted({seed for seed, _ in states})
    means = [float(np.mean(np.concatenate([s.shares for k, s in states if k == seed]))) for seed in seeds]
    shares = np.concatenate([s.shares for _, s in states]) if states else np.zeros(0)
    error = standard_error(means)
    mean = float(np.mean(means)) if means else 0.0
    decided = error is not None and abs(mean) > 2 * error
    return claim(
        "sliding-contributions-negative",
        'Sec. V A: "the contributions of sliding contacts to the quadratic form are on the average negative"', True,
        mean < 0 if decided else None, "", 0.0,
        f"{(shares < 0).mean() if len(shares) else 0:.0%} of {len(shares)} are negative; mean over samples of the "
        f"share of one contact in Q {mean:.4f} ± {2 * (error or 0):.4f}, for v under the load; more "
        f"samples would decide it",
    )  # fmt: skip


def _sliding_share(states: list[tuple[int, SlidingState]]) -> Claim:
    """Claim that nearly all critical contacts slide; the reversal of the load is a counterexample."""
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
    return claim(
        "close-to-all-sliding", 'Sec. V A: "the packing is always close to this state", where all critical contacts '
        "slide", True, holds, "", 0.0, note, quantifier=ALWAYS,
    )  # fmt: skip


def _vibrations(pairs: list[tuple[SampleResult, State]]) -> list[Claim]:
    made = [vibrate(state, sample.law) for sample, state in pairs]
    kicked, still = ([getattr(v, name) for v in made] for name in ("kicked", "still"))
    most = max((v.energy for v in made), default=0.0)
    switches = f"median switches of a critical contact {np.median(kicked):.2g}" if made else "no state"
    return [
        claim(
            "vibrations-switch-statuses",
            'Sec. V A: "the contact status will therefore switch between non-sliding and sliding"', True,
            None if not made or np.median(still) else bool(np.median(kicked)), "", 0.0,
            f"after random velocities of 1e-2 overlaps per time of a contact, {switches} in 200 looks during 200 time "
            f"units; without them {np.median(still) if made else 0:.2g}. States whose contacts keep their status "
            f"without a kick would decide it",
        ),
        claim(
            "vibrations-collapse", 'Sec. V A: "if it finds an unstable one, it may collapse"', True,
            most > BURST, "", 0.0,
            f"largest kinetic energy of {len(made)} states: {most:.2g} times that of the kick, {BURST:g} being a "
            f"collapse; kicks at loads closer to the end of the path would decide it", quantifier=CAN,
        ),
    ]  # fmt: skip


def _linear_law() -> Claim:
    errors = table_one(*disk_in_groove(make=hertz_mindlin), size=MOTION)
    return claim(
        "linear-law-is-no-restriction", 'Sec. V A: "one could always linearize the force law"', True,
        max(errors.values()) < LINEARISED, "", 0.0,
        f"Table I with Hertz–Mindlin linearised at a point, at the limit: relative errors up to "
        f"{max(errors.values()):.0e}. K then has the entry −φ' below its diagonal, and a sticking contact contributes "
        f"a positive amount to Q only if μ² < 24 k_t/k_n",
    )  # fmt: skip
