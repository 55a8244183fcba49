"""Evaluation of statements of Charan et al. 2020 on births of pairs along the push, and on the transverse mode."""

import numpy as np

from .... import NotInEquilibriumError
from ....kit import Claim, claim, pluralize, validate_scenario
from ....loading.protocols import Family
from ....reports.claims import ALWAYS
from .measures import wave_power, y_mode
from .printed import FRONT_LOADS, LINE_TOP, MODE_LOAD, STABLE_LOAD, TOLERANCE, UNSTABLE
from .scenario import DiskArrayScenario
from .simulate import DiskArrayResult, make_protocol, point_at_load, press

VARIED = (  # changes of the printed model, one at a time
    {"array": {"disks": 2}}, {"array": {"disks": 5}}, {"array": {"disks": 20}}, {"law": {"mu": 0.95}},
    {"law": {"mu": 1.05}}, {"law": {"mu": 3.0}}, {"law": {"kt": 0.01}}, {"law": {"kt": 0.6}}, {"load": {"press": 0.01}},
    {"load": {"press": 1.0}},
)  # fmt: skip
PUSHES = np.arange(1, 81) / 40  # in units of F_y
STEPS = 100_000  # of the search for an equilibrium; where there is one, a tenth of them are enough
BEFORE = 2e-6, 3.2e-5  # distances in F_x from a birth, at which Im λ and the gap of the real eigenvalues are compared
SQUARE_ROOT = 0.05  # of the exponent 1/2: an eigenvalue that jumps has 0, two that cross have 1
PURE = 1 - TOLERANCE["share"]  # share in y from which a mode counts as a pure y mode
UNIT = "sqrt(k_n (2R)^1/2/m)"


def evaluate_modes(main: DiskArrayResult) -> list[Claim]:
    """Evaluate the statements on the spectra of the main scenario."""
    return [_variants(), *_births(main), _coalescence(main), _growing(main), *_mode_claims(main), *_wave_claims(main)]


def first_pair(**change) -> float | None:
    """Push, in units of F_y, at which the first pair exists; 0 without equilibrium at any push, None if none is met."""
    chosen = validate_scenario(DiskArrayScenario, dynamics={"loads": ()}, relaxation={"steps": STEPS}, **change)
    state, law = press(chosen)
    protocol = make_protocol(chosen, law)
    for push in PUSHES:
        try:
            point = protocol.step(state, push * chosen.load.press)
        except NotInEquilibriumError:
            return 0.0 if push == PUSHES[0] else None
        if len(point.spectrum.pairs):
            return float(push)
        state = point.state
    return None


def _variants() -> Claim:
    births = {", ".join(f"{k} {v:g}" for table in change.values() for k, v in table.items()): first_pair(**change)
              for change in VARIED}  # fmt: skip
    lost, never = ([name for name, push in births.items() if push == value] for value in (0.0, None))
    reached = ", ".join(f"{push:g} with {name}" for name, push in births.items() if push)
    note = f"pair at F_x/F_y = {reached}, the printed model changed in one quantity at a time"
    if never:
        note += f"; no pair up to {PUSHES[-1]:g} with {', '.join(never)}"
    if lost:
        note += (
            f". Counterexample: with {' or '.join(lost)} no push has an equilibrium, as the last disk touches one "
            f"neighbour only: its torque and force along the row balance if |F_t| = F_n there, which needs mu >= 1"
        )
    return claim(
        "always-a-threshold",
        'Fig 2: "by increasing the external force F_x we always reach a threshold value of this force where a pair '
        'of complex eigenvalues is born"', True, False if lost else None if never else True, "", 0.0, note,
        quantifier=ALWAYS,
    )  # fmt: skip


def _births(main: DiskArrayResult) -> list[Claim]:
    """Claims about the number of births, about the death of the first pair, and about pairs above 0.082."""
    born = sorted((f for f in main.families if f.birth), key=lambda f: f.birth.load)
    events = [f.birth.load for f in born if f.birth.load <= LINE_TOP]
    quiet = not any(free.slid for load, free in main.free_runs.items() if load < STABLE_LOAD)
    death = born[0].death.load if born and born[0].death else np.inf
    above = [p for p in main.path if p.load > 0.082]
    without = [p.load for p in above if not len(p.spectrum.pairs)]
    return [
        claim("births-of-pairs", 'Fig 2: "this figure exhibits two events of birth of a complex conjugate pair"', 2,
              len(events), "births", TOLERANCE["pairs"],
              f"up to F_x = {LINE_TOP:g}: {', '.join(f'{load:.5f}' for load in events) or 'none'}", error=0.0),
        claim("first-pair-dies", 'Fig 2: "the first complex pair dies out with increasing F_x without triggering a '
              'transition to dynamical friction"', True, bool(death < STABLE_LOAD and quiet) if born else None, "", 0.0,
              f"it lives from {born[0].birth.load:.5f} to {death:.5f}" if born else "no pair"),
        claim("unstable-above-0.082", UNSTABLE, True, not without if above else None, "", 0.0,
              f"{len(above)} equilibria up to {main.path[-1].load:g}; without a pair: {without or 'none'}",
              quantifier=ALWAYS),
    ]  # fmt: skip


def birth_exponents(family: Family, main: DiskArrayResult) -> tuple[float, float]:
    """Exponents of the gap of the two real eigenvalues before a birth, and of Im λ after it, against the distance.

    The gap is that of the two neighbouring real eigenvalues which are nearest to the pair.
    """
    start = max((p for p in main.path if p.load <= family.birth.below), key=lambda p: p.load).state
    protocol, gaps, heights = make_protocol(main.scenario, main.law), [], []
    for distance in BEFORE:
        after = protocol.step(start, family.birth.above + distance).spectrum.pairs
        pair = after[np.argmin(np.abs(after.real - family.eigenvalues[0].real))]
        values = protocol.step(start, family.birth.below - distance).spectrum.eigenvalues
        real = np.sort(values[values.imag == 0].real)
        k = np.argmin(np.abs(0.5 * (real[1:] + real[:-1]) - pair.real))
        gaps.append(real[k + 1] - real[k])
        heights.append(pair.imag)
    span = np.log(BEFORE[1] / BEFORE[0])
    return tuple(float(np.log(a[1] / a[0]) / span) for a in (gaps, heights))


def _coalescence(main: DiskArrayResult) -> Claim:
    room = [f for f in main.families if f.birth and _distance_before(f, main) > BEFORE[1]]
    exponents = np.array([birth_exponents(f, main) for f in room]).reshape(-1, 2)
    listed = ", ".join(f"{gap:.3f} and {height:.3f}" for gap, height in exponents)
    return claim(
        "real-pair-coalesces",
        'Fig 2: "A pair of real eigenvalues coalesces when the pair of imaginary eigenvalues bifurcates"', True,
        bool((np.abs(exponents - 0.5) < SQUARE_ROOT).all()) if len(room) else None, "", 0.0,
        f"exponents of the gap between two real eigenvalues below the birth, and of Im λ above it, against the "
        f"distance in F_x, at {pluralize(len(room), 'birth')}: {listed}; both are 1/2 where two real eigenvalues meet",
    )  # fmt: skip


def _distance_before(family: Family, main: DiskArrayResult) -> float:
    """Distance in F_x of a birth from the point of the path before it."""
    return family.birth.below - max(p.load for p in main.path if p.load <= family.birth.below)


def _growing(main: DiskArrayResult) -> Claim:
    """Claim that Im λ grows with the push over the loads of the fronts."""
    points = [p for p in main.path if p.load >= FRONT_LOADS[0]]
    largest = np.array([p.spectrum.im_lambda.max() for p in points])
    printed = np.array([p.load for p in points]) <= FRONT_LOADS[-1] + 1e-12
    note = (
        f"largest Im λ at {printed.sum()} equilibria between {FRONT_LOADS[0]:g} and {FRONT_LOADS[-1]:g}; up to "
        f"{points[-1].load:g} it falls at {(np.diff(largest) <= 0).sum()} of {len(points) - 1} steps"
    )
    return claim(
        "im-lambda-grows", 'Fig 5: "the imaginary part of the eigenvalues grows with increasing F_x"', True,
        bool((np.diff(largest[printed]) > 0).all()), "", 0.0, note,
    )  # fmt: skip


def _mode_claims(main: DiskArrayResult) -> list[Claim]:
    modes = point_at_load(main.path, MODE_LOAD).spectrum
    k, shares = y_mode(modes), modes.shares()
    others = f"x {shares[k, 0]:.1%}, rotation {shares[k, 5]:.1%}, at F_x = {MODE_LOAD}"
    press = main.scenario.load.press * main.scenario.load.unit
    return [
        claim("y-mode-share", 'Fig 6: "no projection on either longitudinal or angular degrees of freedom"', 1.0,
              float(shares[k, 1]), "fraction", TOLERANCE["share"], others, error=0.0),
        claim("y-mode-frequency", 'Fig 6: "an eigen-frequency ω ≈ 0.235"', 0.235, float(modes.frequency[k]), UNIT,
              TOLERANCE["frequency"], "mode with the largest share in y", error=0.0),
        claim("wall-mode-frequency", "Fig 6: not printed; the same mode before any push", None,
              float(main.pressed_spectrum.frequency[y_mode(main.pressed_spectrum)]), UNIT, TOLERANCE["closed form"],
              "checks the units", error=0.0, reference=float(np.sqrt(1.5 * press ** (1 / 3))),
              reference_source="closed form sqrt(1.5 sqrt(δ_w)), δ_w = (F_y/k_n)^(2/3)"),
    ]  # fmt: skip


def _wave_claims(main: DiskArrayResult) -> list[Claim]:
    """Claims about the paper's explanation of the backward front: one pure y mode of wavelength 2, and its speed."""
    modes = point_at_load(main.path, MODE_LOAD).spectrum
    pure, k = modes.shares()[:, 1] > PURE, y_mode(modes)
    wave, power = wave_power(modes)
    best = int(np.argmax(power[-1] * modes.shares()[:, 1]))
    strongest, speed = float(wave[np.argmax(power[:, k])]), modes.frequency / wave[-1]
    counts = {f"{p.load:g}": int((p.spectrum.shares()[:, 1] > PURE).sum()) for p in main.path[:: len(main.path) // 8]}
    shares = ", ".join(f"{share:.2f} at {q:.2f}" for q, share in zip(wave, power[:, k], strict=True))
    with np.errstate(divide="ignore"):
        measured = float(np.divide(modes.frequency[k], strongest))
    return [
        claim("pure-y-modes", 'Fig 6: "one identifies only one which consists of a pure y transverse wave"', 1,
              int(pure.sum()), "modes", TOLERANCE["pairs"],
              f"modes with more than {PURE:.0%} in y at F_x = {MODE_LOAD}; along the push: "
              f"{', '.join(f'{n} at {load}' for load, n in counts.items())}", error=0.0),
        claim("y-mode-wave-number", 'Fig 6: "a wavelength of approximately 2. Thus the associated k vector is k ≈ π"',
              float(np.pi), strongest, "1/length", TOLERANCE["wave number"],
              f"strongest Fourier component of y in the mode with the largest share in y; shares by wave number: "
              f"{shares}", error=0.0),
        claim("y-wave-speed", 'Fig 6: "determining a velocity V_2 ≈ 0.235/π ≈ 0.075"', 0.075, measured, "length/time",
              TOLERANCE["front"],
              f"frequency over wave number of the same mode; the mode with most power at wavelength 2, "
              f"{power[-1, best]:.0%} of its motion along y, has ω = {modes.frequency[best]:.4f} and ω/π = "
              f"{speed[best]:.4f}", error=0.0),
    ]  # fmt: skip
