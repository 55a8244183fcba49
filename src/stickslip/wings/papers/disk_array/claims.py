"""Reproduction of Charan et al. 2020: the transition from static to dynamic friction in an array of disks.

Charan, Chattoraj, Pica Ciamarra, Procaccia, doi:10.48550/arXiv.1908.11724, with its supplement. Units are 2R = m =
k_n = 1. Forces are stated in the paper's numbers (a force of 1 is 1/2000 here, as k_n = 2000 there), and times in
units of √(m/(k_n √(2R))).

There are two scenarios. `main` is the printed model with I0 = 1/2, the value for a disk. `quarter` is a hypothesis
found by a search, without documented justification: the disk–disk normal stiffness is a quarter of the printed value,
and I0 = 1. It is always labelled as a hypothesis.
"""

from typing import NamedTuple

import numpy as np

from .... import NotInEquilibriumError
from ....kit import (
    ALWAYS,
    UNFINISHED,
    Checkpoint,
    Claim,
    Family,
    Report,
    Task,
    Workers,
    claim,
    make_law,
    note_quick_run,
    open_device,
    pluralize,
    run_realizations,
    silent,
    statement,
    validate_scenario,
    within,
)
from ....protocols import stable_window
from ....results import KineticThreshold
from .claims_of_motion import (
    BISECTED,
    COARSER,
    FRONT_LOADS,
    GROWTH_LOADS,
    IM_LAMBDA,
    LINE_TOP,
    MODE_LOAD,
    RISE,
    STABLE_LOAD,
    TOLERANCE,
    UNSTABLE,
    backward_claims,
    evaluate_fronts,
    evaluate_motion,
    sliding_claims,
)
from .measures import (
    ARREST_LOADS,
    LATE,
    Arrest,
    find_arrests,
    growth_error,
    growth_factor,
    kick_array,
    late_birth,
    saturation_error,
    wave_power,
    y_mode,
)
from .scenario import DiskArrayScenario
from .simulate import (
    BIRTHS,
    FREE,
    RAMP,
    DiskArrayResult,
    add_sliding,
    make_protocol,
    open_checkpoint,
    point_at_load,
    press,
    push_disk_array,
    simulate_before_sliding,
)

VARIED = (  # changes of the printed model, one at a time
    {"array": {"disks": 2}}, {"array": {"disks": 5}}, {"array": {"disks": 20}}, {"law": {"mu": 0.95}},
    {"law": {"mu": 1.05}}, {"law": {"mu": 3.0}}, {"law": {"kt": 0.01}}, {"law": {"kt": 0.6}}, {"load": {"press": 0.01}},
    {"load": {"press": 1.0}},
)  # fmt: skip
PUSHES = np.arange(1, 81) / 40  # in units of F_y
STEPS = 100_000  # largest number of steps in the search for an equilibrium; a tenth suffices if one exists
BEFORE = 2e-6, 3.2e-5  # distances in F_x from a birth at which Im λ and the gap between real eigenvalues are compared
SQUARE_ROOT = 0.05  # tolerance of the exponent 1/2; it would be 0 for a jump and 1 for a crossing of eigenvalues
PURE = 1 - TOLERANCE["share"]  # fraction of motion in y above which a mode counts as a pure y mode
UNIT = "sqrt(k_n (2R)^1/2/m)"


def first_pair(**change) -> float | None:
    """Push, in units of F_y, at which the first pair exists; 0 if there is no equilibrium, None if there is no pair."""
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
    return statement(
        "always-a-threshold",
        'Fig 2: "by increasing the external force F_x we always reach a threshold value of this force where a pair '
        'of complex eigenvalues is born"', False if lost else None if never else True, note, quantifier=ALWAYS,
    )  # fmt: skip


def _births(main: DiskArrayResult) -> list[Claim]:
    """Claims about the number of births, the death of the first pair, and pairs above F_x = 0.082."""
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
        statement(
            "first-pair-dies", 'Fig 2: "the first complex pair dies out with increasing F_x without triggering a '
            'transition to dynamical friction"', bool(death < STABLE_LOAD and quiet) if born else None,
            f"it lives from {born[0].birth.load:.5f} to {death:.5f}" if born else "no pair",
        ),
        statement(
            "unstable-above-0.082", UNSTABLE, not without if above else None,
            f"{len(above)} equilibria up to {main.path[-1].load:g}; without a pair: {without or 'none'}",
            quantifier=ALWAYS,
        ),
    ]  # fmt: skip


def birth_exponents(family: Family, main: DiskArrayResult) -> tuple[float, float]:
    """Exponents, in the distance from a birth, of the gap between two real eigenvalues before it and of Im λ after it.

    The two are the neighbouring real eigenvalues nearest to the pair.
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
    loads = np.array([p.load for p in main.path])  # a birth must be far enough from the previous point of the path
    born = [f for f in main.families if f.birth]
    room = [f for f in born if f.birth.below - loads[loads <= f.birth.below].max() > BEFORE[1]]
    exponents = np.array([birth_exponents(f, main) for f in room]).reshape(-1, 2)
    listed = ", ".join(f"{gap:.3f} and {height:.3f}" for gap, height in exponents)
    return statement(
        "real-pair-coalesces",
        'Fig 2: "A pair of real eigenvalues coalesces when the pair of imaginary eigenvalues bifurcates"',
        bool((np.abs(exponents - 0.5) < SQUARE_ROOT).all()) if len(room) else None,
        f"exponents of the gap between two real eigenvalues below the birth, and of Im λ above it, against the "
        f"distance in F_x, at {pluralize(len(room), 'birth')}: {listed}; both are 1/2 where two real eigenvalues meet",
    )  # fmt: skip


def _growing(main: DiskArrayResult) -> Claim:
    """Claim that Im λ grows with the push in the range of loads at which fronts are measured."""
    points = [p for p in main.path if p.load >= FRONT_LOADS[0]]
    largest = np.array([p.spectrum.im_lambda.max() for p in points])
    printed = np.array([p.load for p in points]) <= FRONT_LOADS[-1] + 1e-12
    note = (
        f"largest Im λ at {printed.sum()} equilibria between {FRONT_LOADS[0]:g} and {FRONT_LOADS[-1]:g}; up to "
        f"{points[-1].load:g} it falls at {(np.diff(largest) <= 0).sum()} of {len(points) - 1} steps"
    )
    return statement(
        "im-lambda-grows", 'Fig 5: "the imaginary part of the eigenvalues grows with increasing F_x"',
        bool((np.diff(largest[printed]) > 0).all()), note,
    )  # fmt: skip


def _mode_claims(main: DiskArrayResult) -> list[Claim]:
    """Claims about the mode along y, and the paper's explanation of the backward front by this mode."""
    modes = point_at_load(main.path, MODE_LOAD).spectrum
    k, shares = y_mode(modes), modes.shares()
    others = f"x {shares[k, 0]:.1%}, rotation {shares[k, 5]:.1%}, at F_x = {MODE_LOAD}"
    press = main.scenario.load.press * main.scenario.load.unit
    wave, power = wave_power(modes)
    best = int(np.argmax(power[-1] * shares[:, 1]))
    strongest, speed = float(wave[np.argmax(power[:, k])]), modes.frequency / wave[-1]
    counts = {f"{p.load:g}": int((p.spectrum.shares()[:, 1] > PURE).sum()) for p in main.path[:: len(main.path) // 8]}
    parts = ", ".join(f"{share:.2f} at {q:.2f}" for q, share in zip(wave, power[:, k], strict=True))
    with np.errstate(divide="ignore"):
        measured = float(np.divide(modes.frequency[k], strongest))
    return [
        claim("y-mode-share", 'Fig 6: "no projection on either longitudinal or angular degrees of freedom"', 1.0,
              float(shares[k, 1]), "fraction", TOLERANCE["share"], others, error=0.0),
        claim("y-mode-frequency", 'Fig 6: "an eigen-frequency ω ≈ 0.235"', 0.235, float(modes.frequency[k]), UNIT,
              TOLERANCE["frequency"], "mode with the largest fraction in y", error=0.0),
        claim("wall-mode-frequency", "Fig 6: not printed; the same mode before any push", None,
              float(main.pressed_spectrum.frequency[y_mode(main.pressed_spectrum)]), UNIT, TOLERANCE["closed form"],
              "checks the units", error=0.0, reference=float(np.sqrt(1.5 * press ** (1 / 3))),
              reference_source="closed form sqrt(1.5 sqrt(δ_w)), δ_w = (F_y/k_n)^(2/3)"),
        claim("pure-y-modes", 'Fig 6: "one identifies only one which consists of a pure y transverse wave"', 1,
              int((shares[:, 1] > PURE).sum()), "modes", TOLERANCE["pairs"],
              f"modes with more than {PURE:.0%} in y at F_x = {MODE_LOAD}; along the push: "
              f"{', '.join(f'{n} at {load}' for load, n in counts.items())}", error=0.0),
        claim("y-mode-wave-number", 'Fig 6: "a wavelength of approximately 2. Thus the associated k vector is k ≈ π"',
              float(np.pi), strongest, "1/length", TOLERANCE["wave number"],
              f"strongest Fourier component of y in the mode with most power in y; by wavenumber: {parts}", error=0.0),
        claim("y-wave-speed", 'Fig 6: "determining a velocity V_2 ≈ 0.235/π ≈ 0.075"', 0.075, measured, "length/time",
              TOLERANCE["front"],
              f"frequency over wave number of the same mode; the mode with most power at wavelength 2, "
              f"{power[-1, best]:.0%} of its motion along y, has ω = {modes.frequency[best]:.4f} and ω/π = "
              f"{speed[best]:.4f}", error=0.0),
    ]  # fmt: skip


def evaluate_claims(
    main: DiskArrayResult, quarter: DiskArrayResult, arrests: list[Arrest], threshold: KineticThreshold,
    workers: Workers = None, report: Report = silent,
) -> list[Claim]:  # fmt: skip
    """Evaluate all claims, those of the main scenario first.

    Parameters
    ----------
    arrests, threshold : results for the main scenario
    report : called as report(stage, share done, text) during the ramps with other load steps
    """
    suffix = "@quarter"
    tasks = [
        Task("claims about spectra", (result, *about), about[0], None)
        for result, *about in ((main, "", 0.05), (quarter, suffix, 0.07))
    ]
    ramps = run_realizations(_spectrum_claims, tasks, stage="claims", workers=workers, report=report)
    printed_spectra, quarter_spectra = ramps.complete
    printed = printed_spectra + [_growth(main, load) for load in GROWTH_LOADS] + [_stability(main, "")]
    printed += _free_run_claims(main)
    printed += [row for arrest in arrests for row in _arrest_claims(arrest)] + _threshold_claims(threshold)
    printed += [*evaluate_fronts(main), _variants(), *_births(main), _coalescence(main), _growing(main)]
    printed += [*_mode_claims(main), *evaluate_motion(main, arrests)]
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
    out = []
    for load in (0.030, 0.040, STABLE_LOAD):
        modes = point_at_load(result.path, load).spectrum
        said = '"for ... F_x = 0.03 and 0.04 the oscillatory instability exists", one pair in the figure'
        if load == STABLE_LOAD:
            said = '"for F_x = 0.062 all the eigenvalues of J are real"'
        note = "Im lambda " + (", ".join(f"{v:.2e}" for v in modes.pairs.imag) or "zero throughout")
        out.append(claim(
            f"pairs-at-{load:.3f}{suffix}", f"Fig 2: {said}", 0 if load == STABLE_LOAD else 1, len(modes.pairs),
            "pairs", TOLERANCE["pairs"], note, error=0.0,
        ))  # fmt: skip
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
    for load, paper in IM_LAMBDA.items():
        modes, other = (point_at_load(path, load).spectrum for path in (result.path, paths[COARSER[-1]]))
        note = pluralize(len(modes.pairs), "pair")
        if born := births[step]:
            note += f"; {load - born:.5f} above the birth, from which Im lambda rises as a square root"
        out.append(claim(
            f"im-lambda-{load:.3f}{suffix}", 'Fig 2: text before Eq 10, "0.00024, 0.00077 and 0.001 respectively"',
            paper, float(modes.im_lambda.max()), "k_n (2R)^1/2/m", TOLERANCE["im-lambda"], note,
            error=abs(modes.im_lambda.max() - other.im_lambda.max()),
        ))  # fmt: skip
    return out


def _sensitivity(fine, coarse) -> float | None:
    """Largest difference between two load steps, at least the bisection width; None if either has no value."""
    return None if fine is None or coarse is None else max(BISECTED, float(np.abs(np.subtract(fine, coarse)).max()))


def _format_by_step(values: dict) -> str:
    def text(value):
        return "none" if value is None else "–".join(f"{v:.6f}" for v in np.ravel(value))

    return ", ".join(f"{step:g}: {text(value)}" for step, value in values.items())


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
    return statement(
        f"stable-msd-{STABLE_LOAD:.3f}{suffix}",
        'Fig 3: "for F_x = 0.062 the system is stable and M(t) remains minute", "never increases"', measured, note,
    )  # fmt: skip


def _free_run_claims(main: DiskArrayResult) -> list[Claim]:
    """Claims about the saturation of M, and the onset of sliding."""
    out = []
    for load in (0.030, 0.040):
        free = main.free_runs[load]
        wall = "a wall contact reaches" if np.isfinite(free.breach).any() else "no wall contact reaches"
        out.append(claim(
            f"msd-saturation-{load:.3f}",
            'Fig 3: "the MSD becomes stationary at a minute fraction the disk radius (about 10^-5)"', 1e-5,
            free.saturation, "(2R)^2", TOLERANCE["saturation"],
            f"{wall} the Coulomb limit; error from block averages of one run", error=saturation_error(free),
        ))  # fmt: skip
    free = main.free_runs[0.083]
    note = "no contact reaches the Coulomb limit"
    if np.isfinite(free.breach).any():
        _, i, j = free.first_limit
        first = np.nanargmin(free.breach) + 1
        note = (
            f"contact {i + 1:.0f}–{j + 1:.0f} is the first at the limit; disk {first} is the first among wall contacts"
        )
    said = 'Fig 3: at 0.083 "the oscillatory instability triggers the transition", "the Coulomb law is breached"'
    return [*out, statement("sliding-0.083", said, free.slid, note)]


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
            reference_source="M of the same late states in motion: if both agree, M is a displacement at rest",
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
    """Claims about the kinetic threshold: its value, and that it separates the paper's loads of arrest and sliding."""
    at, (low, high), top = float(threshold.lasting_threshold[0]), threshold.lasting_interval[0], min(FRONT_LOADS)
    outcomes = zip(threshold.loads, threshold.probability[:, 0], threshold.lasting_probability[:, 0], strict=True)
    shares = ", ".join(f"{slid:.2g} and {lasting:.2g} at {load:g}" for load, slid, lasting in outcomes)
    note = (
        f"load at which half of the kicked runs keep sliding; fractions of {threshold.runs[0, 0]} runs from velocities "
        f"of {threshold.kicks[0]:g} that slide by {threshold.distance:g}, and that keep sliding: {shares}"
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
        statement(
            "threshold-between-arrest-and-sliding",
            'Fig 3: "the MSD becomes stationary" at 0.03 and 0.04, sliding at 0.083',
            bool(max(ARREST_LOADS) < low and high < top) if known else None,
            f"whether the kinetic threshold, {low:.4f} to {high:.4f} (95 %), lies between 0.04 and {top:g}",
        ),
    ]  # fmt: skip


MODELS, PUSHED = ("printed", "quarter"), "ramps and free runs"  # names of the models, and of a stage
SHARES = {RAMP: (0.0, 0.6), BIRTHS: (0.6, 0.8), FREE: (0.8, 1.0)}  # stages as fractions of a quick run before sliding


class Reproduction(NamedTuple):
    """Results of both scenarios and the evaluated claims."""

    main: DiskArrayResult
    quarter: DiskArrayResult
    arrests: list[Arrest]  # arrests of the main scenario
    threshold: KineticThreshold  # kinetic threshold of the main scenario
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> DiskArrayScenario:
    """Return the scenario of the printed model: N = 10, μ = 10, k_t = 2/7 k_n, F_y = 0.1, and smooth Coulomb."""
    return validate_scenario(
        DiskArrayScenario,
        seed=seed,
        load={"push": (0.0, 0.12), "step": 5e-4},
        dynamics={"duration": 30_000.0 if quick else 60_000.0, "watch": 0.083},
        sliding={
            "loads": (*FRONT_LOADS, 0.095, 0.1, 0.12),
            "realizations": 16 if quick else 200,
            "duration": 25_000.0 if quick else 40_000.0,
        },
    )


def quarter_scenario(*, quick: bool = False, seed: int = 0) -> DiskArrayScenario:
    """Return the hypothetical scenario: disk–disk normal stiffness divided by four, I0 = 1, otherwise as printed."""
    main = paper_scenario(quick=quick, seed=seed)
    return validate_scenario(
        DiskArrayScenario,
        seed=seed,
        array={"i0": 1.0},
        law={"kn": 0.25, "wall": {"kn": 1.0}},
        load=main.load.model_dump(),
        dynamics={"loads": (STABLE_LOAD,), "duration": main.dynamics.duration},
        sliding=main.sliding.model_dump()
        | {
            "loads": (*FRONT_LOADS, 0.1),
            "realizations": 8 if quick else 100,
            "duration": 60_000.0 if quick else 80_000.0,
        },
    )


def reproduce(
    *, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, device: str | None = None,
    report: Report = silent,
) -> Reproduction:  # fmt: skip
    """Run both scenarios and evaluate every claim of the paper.

    Parameters
    ----------
    quick : use fewer realisations and shorter runs
    seed : seed of all random velocities
    workers : number of processes for the realisations, or the address of a Dask scheduler
    device : "cuda" to run realisations of sliding on a graphics processor; raises the errors of `simulate_disk_array`
    report : called as report(stage, share done, text)
    """
    ones = paper_scenario(quick=quick, seed=seed), quarter_scenario(quick=quick, seed=seed)
    where = device and open_device(device, make_law(ones[0].law))
    folders = folder, folder and folder / UNFINISHED / "quarter"
    kept = [open_checkpoint(*here) for here in zip(folders, ones, strict=True)]
    tasks = [Task(name, (name, *case), name, None) for name, *case in zip(MODELS, ones, kept, strict=True)]
    report(PUSHED, 0.0, f"models: {', '.join(MODELS)}")
    main, quarter = run_realizations(_before_sliding, tasks, stage=PUSHED, workers=workers, report=report).complete
    main = add_sliding(main, kept[0], workers, report, where)
    quarter = add_sliding(quarter, kept[1], workers, within(report, prefix="quarter: "), where)
    threshold = kick_array(main, quick=quick, folder=folder, workers=workers, report=report)
    arrests = find_arrests(main, folder)
    report("claims", 0.0, "births by bisection, for four load steps")
    claims = evaluate_claims(main, quarter, arrests, threshold, workers, report)
    return Reproduction(main, quarter, arrests, threshold, note_quick_run(claims) if quick else claims)


def _before_sliding(name: str, scenario: DiskArrayScenario, kept: Checkpoint | None, report: Report) -> DiskArrayResult:
    def tell(stage: str, share: float, text: str) -> None:
        within(report, *SHARES[stage], prefix=f"{name}: ")(stage, share, text)

    return simulate_before_sliding(scenario, kept, report=tell)
