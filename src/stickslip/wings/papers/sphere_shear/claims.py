"""Reproduction of Bonfanti et al. 2020: oscillatory instabilities of sheared packings of spheres.

Bonfanti, Chattoraj, Guerra, Procaccia, Zapperi, doi:10.1103/PhysRevE.101.052902. Units are 2σ_1 = m = k_n = 1. The law
is smooth Coulomb with k_t = 2/7 and μ = 10; I0 = 0.4. The paper does not state the packing fraction; here it is 0.68
for every packing.

Values of claims are medians over packings; notes give ranges. Claims about the contact law are evaluated with a stored
study of packings under several laws.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri
from scipy.stats import binomtest

from .... import Law, State, freedom, jacobian, spectrum
from ....kit import (
    ALWAYS,
    CAN,
    ZERO_BELOW,
    Claim,
    Report,
    Reproduction,
    Workers,
    claim,
    median_error,
    note_quick_run,
    pluralize,
    silent,
    statement,
    validate_scenario,
    volume,
)
from ....measure import fabric, touching
from ....results import Released
from .scenario import ShearScenario
from .simulate import ShearPath, ShearResult, simulate_shear

TOLERANCE = {
    "onset": 1.0,  # not printed, and the packing fraction is not stated: a factor of two
    "exponent": 0.05,  # the next term of the expansion is of the order of the distance to the birth, a few per cent
    "pairs": 0.0,  # counts
    "rate": 1e-3,  # linear theory with Verlet's correction is exact; the ends of the fit window are not
    "frequency": 1e-4,  # the phase is known to a fraction of a turn over the many turns of the fit window
    "decades": 0.2,  # the paper prints "about 10": two more or less
    "constant": 1.0,  # not printed; M grows by a factor of two between two evaluations of the spectrum
    "drop": 1.0,  # from one run of one packing; a factor of two either way
    "contacts": 1.0,  # not printed
    "im-lambda": 1.0,  # one state, chosen by the authors among those with a single pair: a factor of two
    "later": 1.0,  # not printed
    "drag": np.sqrt(10) - 1,  # "of the order of": the nearest power of ten
    "stress": 0.1,  # a tenth of the exponent: M oscillates around its exponential by a factor of about two
}


def _finite(values) -> list[float]:
    return [float(v) for v in values if v is not None and np.isfinite(v)]


def known_median(values) -> float | None:
    """Median of the known values; None if there are none."""
    finite = _finite(values)
    return float(np.median(finite)) if finite else None


def describe_range(values, form: str = "{:.3g}") -> str:
    """Describe the range of values over packings, and their number."""
    finite = _finite(values)
    if not finite:
        return f"none of {len(values)} packings"
    if len(finite) == 1:
        return f"{form.format(finite[0])} in one of {len(values)} packings"
    return f"{form.format(min(finite))} to {form.format(max(finite))} over {len(finite)} of {len(values)} packings"


def median_claim(id: str, source: str, paper, values, unit: str, tolerance: str, note: str, **more) -> Claim:
    """Make a claim about the median over packings, with its error."""
    error = median_error(_finite(values))
    return claim(id, source, paper, known_median(values), unit, TOLERANCE[tolerance], note, error=error, **more)


PARTS = 10  # number of parts of the fit window, in each of which the stress amplitude is measured


def axis_ratios(turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ratios (L, H) of the second and third singular values of each grain's displacements in a turn to the first.

    The ratio of the second is 0 for motion on a line, that of the third for motion in a plane. The motion of a single
    pair is Re(c e^{iωt}) with a complex vector c for each grain, so a grain moves in the plane of Re c and Im c through
    its position at rest.

    Parameters
    ----------
    turns : (L, T, H, 3) displacements from rest, with T samples per turn [length]
    """
    values = np.linalg.svd(turns.transpose(0, 2, 1, 3), compute_uv=False)
    return values[..., 1] / values[..., 0], values[..., 2] / values[..., 0]


class Oscillation(NamedTuple):
    """Change δσ of the shear stress in the fit window of M."""

    offset: float  # mean of δσ e^{−ω_i t} over its root mean square; 0 for an oscillation around zero
    exponent: float  # exponent of the amplitude of δσ as a function of M; 1/2 if stress is linear in displacements


def stress_oscillation(run: Released) -> Oscillation | None:
    """Oscillation of the shear stress while M grows exponentially; None if M did not cross its fit window."""
    if run.growth is None:
        return None
    inside = (run.time >= run.growth.start) & (run.time <= run.growth.stop)
    change = (run.shear_stress - run.shear_stress[0])[inside]
    scaled = change * np.exp(-run.growth_rate * run.time[inside])
    amplitude = [np.sqrt(np.mean(part**2)) for part in np.array_split(change, PARTS)]
    level = [np.mean(part) for part in np.array_split(run.msd[inside], PARTS)]
    slope = np.polyfit(np.log(level), np.log(amplitude), 1)[0]
    return Oscillation(float(scaled.mean() / np.sqrt(np.mean(scaled**2))), float(slope))


def block_asymmetry(state: State, law: Law) -> dict[str, float]:
    """Largest violation of the symmetries of J under exchange of two grains, over the largest entry of the block.

    A = ∂F/∂r and D = ∂(T/R)/∂(R·angle) are equal for (i, j) and (j, i); C = ∂F/∂(R·angle) and B = ∂(T/R)/∂r change
    sign. "axes" denotes the symmetry of A under exchange of its axes, which a tangential force violates.

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Appendix B.
    """
    free, c, rows = freedom(state), state.contacts, touching(state)
    dim = state.cell.dim
    width = 6 if dim == 3 else 3
    full = jacobian(state, law, free).toarray().reshape(len(state.grains.radius), width, -1, width)
    there, back = full[c.i[rows], :, c.j[rows]], full[c.j[rows], :, c.i[rows]]
    move, turn = slice(0, dim), slice(dim, None)
    a = there[:, move, move]
    axes = float(np.abs(a - a.transpose(0, 2, 1)).max() / np.abs(a).max())
    blocks = {"A": (move, move, 1), "B": (turn, move, -1), "C": (move, turn, -1), "D": (turn, turn, 1)}
    return {"axes": axes} | {
        name: float(np.abs(there[:, a, b] - sign * back[:, a, b]).max() / np.abs(there[:, a, b]).max())
        for name, (a, b, sign) in blocks.items()
    }


BIRTHS = Path(__file__).with_name("births_by_law.csv")  # written by benchmarks/pairs_by_law.py
MU, UNLIMITED = 10.0, 1e6  # friction of the paper; μ above which no contact reaches the Coulomb limit
STUDY = "stored study of examples/pairs_by_law.toml"


class Births(NamedTuple):
    """Counts of first pairs in sheared packings under one law."""

    kind: str
    coulomb: str
    mu: float
    packings: int
    born: int  # packings with a pair
    limited: int  # births at which at least one contact is at the Coulomb limit
    mobilisation: float  # median over births of the largest |F_t|/(μ F_n)

    def __str__(self) -> str:
        limit = f"{self.coulomb}, mu = {self.mu:g}" if self.mu < UNLIMITED else "no limit"
        low, high = share_interval(self.born, self.packings)
        return (
            f"{self.kind.removesuffix('_mindlin')}, {limit}: {self.born} of {self.packings} ({low:.2f} to {high:.2f})"
        )


def read_births() -> dict[tuple[str, str, float], Births]:
    """Births of the stored study, by kind of law, smoothing and friction."""
    with BIRTHS.open(encoding="utf-8", newline="") as file:
        rows = [Births(r[0], r[1], float(r[2]), *map(int, r[3:6]), float(r[6])) for r in list(csv.reader(file))[1:]]
    return {row[:3]: row for row in rows}


def law_claims() -> list[Claim]:
    """Claims about the form of the law, its smoothing and the Coulomb limit."""
    births = read_births()
    smooth, sharp, unlimited = (
        births["hertz_mindlin", *law] for law in (("smooth", MU), ("sharp", MU), ("sharp", 1e9))
    )
    linear, cut, bare = (births["linear", *law] for law in (("smooth", MU), ("sharp", MU), ("sharp", 1e9)))
    at_limit = (
        f"{cut.kind}, sharp: a contact at the limit at {cut.limited} of {cut.born} births, smooth: {linear.limited}"
    )
    few = [law for law in births.values() if not law.born]
    free = smooth.born - smooth.limited
    rows = (
        ("pairs-under-a-linear-law", 'Sec. II: "changing the analytic forms of the interaction forces [...] does not '
         'affect [the] appearance of the instability"', _mostly(linear.born, linear.packings),
         f"packings with a pair: {linear}; {smooth}; the strains of the first pairs differ, and so does their cause: "
         f"{at_limit}"),
        ("pairs-without-smoothing", 'Sec. II: "do not depend on this smoothing of the tangential force"',
         _mostly(sharp.born, sharp.packings), f"packings with a pair: {sharp}; {smooth}; "
         f"with a linear law the smoothing decides: {at_limit}"),
        ("pairs-before-the-limit", 'Sec. II: "instabilities are often seen before any Coulomb limit is reached"',
         _mostly(free, smooth.born), f"no contact at the limit at {free} of {smooth.born} births, where the largest "
         f"F_t/(mu F_n) is {smooth.mobilisation:.2g} at the median; {at_limit}"),
        ("threshold-not-responsible", 'Sec. II: "the existence of a Coulomb threshold is not responsible for the '
         'reported phenomenology"', _mostly(unlimited.born, unlimited.packings),
         f"packings with a pair: {unlimited}; with a linear law the limit is responsible: {bare}"),
    )  # fmt: skip
    generic = statement(
        "generic-without-hamiltonian", 'Sec. V: "as long as the dynamics is describable by forces which are not '
        'derivable from a Hamiltonian, this instability should be generic"', not few,
        f"packings with a pair under {len(births)} laws: the fewest are {min(births.values(), key=lambda b: b.born)}, "
        f"where only the rotation of the normal makes J asymmetric. This law has a U(delta, t), and is Hamiltonian by "
        f"App. A; under all others at least {min(b.born for b in births.values() if b != bare)} have one; {STUDY}",
        quantifier=ALWAYS,
    )  # fmt: skip
    return [*(statement(id, said, value, f"{note}; {STUDY}")
              for id, said, value, note in rows), generic]  # fmt: skip


def share_interval(count: int, total: int) -> tuple[float, float]:
    """95 % interval of the fraction `count`/`total`.

    Source
    ------
    Wilson, doi:10.1080/01621459.1927.10502953.
    """
    low, high = binomtest(count, total).proportion_ci(method="wilson")
    return float(low), float(high)


def _mostly(count: int, total: int) -> bool | None:
    """Return True if most cases have a property; None if the 95 % interval of the fraction contains 1/2."""
    low, high = share_interval(count, total)
    return None if low <= 0.5 <= high else bool(low > 0.5)


MANY = 10  # number of pairs that counts as many: ten times the number at the onset
PLANE = 0.01  # ratio of third to first singular value below which a trajectory is planar: thinner than a line in a plot
CENTRED = 0.1  # ratio of mean to amplitude below which stress oscillates around zero: invisible in a plot
SYMMETRIC = 1e-12  # relative difference of equal blocks: round-off, with a margin for sums over contacts


def number_claims(main: ShearResult) -> list[Claim]:
    """Claims about the number of pairs, and the size of the first pair."""
    im = [run.eigenvalue.imag if run and run.pairs == 1 else None for run in main.single]
    last, births = [int(path.pairs[-1]) for path in main.paths], [late_births(path) for path in main.paths]
    many = sum(n >= MANY for n in last)
    return [
        median_claim(
            "im-lambda-one-pair", 'Fig 2: "only a pair of complex eigenvalues, with large lambda_i = 5.87e-5"',
            5.87e-5, im, "1/time^2", "im-lambda", f"the state with one pair and the fastest growth of each path: "
            f"{describe_range(im)}; it depends on pressure and strain, which are not printed",
        ),
        statement(
            "many-pairs-at-larger-strain",
            'Fig 1: "at higher values of gamma one can easily obtain the simultaneous existence of many complex '
            'eigenpairs"', 2 * many > len(last),
            f"at least {MANY} pairs at the last strain in {many} of {len(last)} packings: {', '.join(map(str, last))}",
        ),
        median_claim(
            "births-at-larger-strain",
            'Sec. V: whether the instability "remains macroscopically relevant also for larger strains"; left open',
            None, births, "1", "later", f"births in the second half of the path over those in the first, counted "
            f"between its states: {describe_range(births)}",
        ),
    ]  # fmt: skip


def late_births(path: ShearPath) -> float:
    """Ratio of births in the second half of a path, by strain, to those in the first; NaN if the first has none."""
    late = path.strain[1:] > 0.5 * path.strain[-1]
    born = np.maximum(np.diff(path.pairs), 0)
    return float(born[late].sum() / born[~late].sum()) if born[~late].sum() else np.nan


def matrix_claim(main: ShearResult) -> Claim:
    """Claim about the blocks of J at the last state of each path."""
    differences = [block_asymmetry(path.last, main.law) for path in main.paths]
    worst = {name: max(d[name] for d in differences) for name in "ABCD"}
    axes = min(d["axes"] for d in differences)
    return statement(
        "symmetries-of-blocks",
        "App. B: A_ij = A_ji, B_ij = -B_ji, C_ij = -C_ji, D_ij = D_ji; not under exchange of the axes of A",
        max(worst.values()) < SYMMETRIC < axes,
        f"largest violation in the last state of {pluralize(len(differences), 'path')}, over the largest entry: "
        f"{', '.join(f'{name} {value:.0e}' for name, value in worst.items())}; of A under exchange of its "
        f"axes: at least {axes:.0e}",
    )  # fmt: skip


def motion_claims(main: ShearResult) -> list[Claim]:
    """Claims about trajectories and stress while M grows exponentially."""
    runs = [run for run in main.single if run and run.pairs == 1]
    ratios = [np.median(axis_ratios(run.turns), axis=(1, 2)) for run in runs if len(run.turns)]
    wide, flat = zip(*ratios, strict=True) if ratios else ((), ())
    waves = [wave for wave in map(stress_oscillation, runs) if wave]
    offsets, slopes = [abs(wave.offset) for wave in waves], [wave.exponent for wave in waves]
    return [
        statement(
            "trajectories-spiral", 'Fig 4: Sec. IV, "induce a spiral motion in three dimensions"',
            bool(np.median(wide) > PLANE) if wide else None,
            f"second over first singular value of a turn, 0 on a line and 1 on a circle, median over grains and turns: "
            f"{describe_range(wide)}; by Eq 9 as printed every grain would move on a line",
        ),
        statement(
            "trajectories-three-dimensional", 'Fig 4: "the particle trajectories [...] display a 3D funnel motion"',
            bool(np.median(flat) > PLANE) if flat else None,
            f"with one pair every grain spirals in a plane, that of Re c and Im c, another one for every grain; third "
            f"over first singular value of a turn, median over grains and turns: {describe_range(flat, '{:.1e}')}; "
            f"against time, or with a drift, a plane spiral looks like a funnel",
        ),
        statement(
            "stress-around-zero", 'Fig 5: "during the linear stage [...] the stress oscillates around zero"',
            bool(np.median(offsets) < CENTRED) if offsets else None,
            f"change of the stress: mean over root mean square, both of δσ exp(-omega_i t): {describe_range(offsets)}",
        ),
        median_claim(
            "stress-amplitude-exponent", "Fig 5: amplitude of the stress; no exponent is printed", None, slopes, "1",
            "stress", f"amplitude against M: {describe_range(slopes, '{:.3f}')}", reference=0.5,
            reference_source="the stress is linear in small displacements",
        ),
    ]  # fmt: skip


DRAG = 2.2e-2  # η_0 of the paper [1/time]
DIAMETER = 1.0  # 2σ_1, the unit of length
LEVEL = 0.05  # significance level of the test of isotropy


def protocol_claims(main: ShearResult) -> list[Claim]:
    """Claims about the drag, from moduli and spectra along the paths, and about the fabric at the first pairs."""
    said = (
        'Sec. III: "this value of eta_0 ensures that the dynamics is overdamped as the damping timescale is of the '
        'order of the time that sounds needs to travel one particle diameter"'
    )
    times = [sound_time(path) for path in main.paths]
    spectra = [spectrum(path.last, main.law, modes=False).eigenvalues for path in main.paths]
    shares, softest = zip(*map(damping_shares, spectra), strict=True)
    dim, first = main.scenario.packing.dim, [path.single for path in main.paths if path.single is not None]
    values, last = ([isotropy_statistic(s) for s in some] for some in (first, [path.last for path in main.paths]))
    limit = chdtri(max(len(first), 1) * (dim * (dim + 1) // 2 - 1), LEVEL)
    return [
        median_claim(
            "drag-time-over-sound-time", said, 1.0, [1 / (DRAG * time) for time in times], "1", "drag",
            f"1/eta_0 = {1 / DRAG:.3g}; sound of the slower, transverse kind takes {describe_range(times)}, from the "
            f"shear modulus of the first step",
        ),
        statement(
            "dynamics-overdamped", said, max(shares) > 0.5,
            "fraction of the modes with omega <= eta_0/2, which are overdamped by this drag: "
            f"{describe_range(shares)}; softest mode: {describe_range(softest)}",
        ),
        statement(  # isotropic unless the test rejects isotropy
            "isotropic-contacts", 'Sec. V: "prepared in a way that leads to an isotropic contact distribution"',
            sum(values) < limit if first else None,
            f"chi-square of the fabric tensor in the states with one pair: {describe_range(values)}, together "
            f"{sum(values):.3g}, and {limit:.3g} would reject isotropy at {LEVEL:.0%}; at the last strain "
            f"{describe_range(last)}",
        ),
    ]  # fmt: skip


def sound_time(path: ShearPath) -> float:
    """Time d √(ρ/G) in which a shear wave travels one diameter d = 2σ_1, with G from the first strain step."""
    modulus = (path.shear_stress[1] - path.shear_stress[0]) / (path.strain[1] - path.strain[0])
    density = path.last.grains.mass.sum() / volume(path.last)
    return float(DIAMETER * np.sqrt(density / modulus)) if modulus > 0 else np.nan


def damping_shares(eigenvalues: np.ndarray) -> tuple[float, float]:
    """Fraction of modes (except zero modes) with ω ≤ η_0/2, and the smallest ω [1/time]."""
    size = np.abs(eigenvalues)
    frequency = np.sqrt(size[size > ZERO_BELOW * size.max()])
    return float(np.mean(frequency <= DRAG / 2)), float(frequency.min())


def isotropy_statistic(state: State) -> float:
    """Statistic of the fabric tensor that has a χ² distribution for many independent, isotropic normals.

    For n contacts in d dimensions, it is n d (d + 2)/2 |D|², where D is the deviator of the fabric tensor. It has d (d
    + 1)/2 − 1 degrees of freedom, and components of D have the variance 2/(n d (d + 2)).
    """
    dim = state.cell.dim
    deviator = fabric(state)[:dim, :dim] - np.eye(dim) / dim
    return float(len(touching(state)) * dim * (dim + 2) / 2 * (deviator**2).sum())


DECADES = 10.0  # decades of M over which the paper finds exponential growth
MISFIT = np.log10(2.0)  # decades by which M may deviate from the predicted line, due to oscillation alone
LEAST_DURATION = (
    "to be read with care, as the minimum duration of a run was set after runs of only 45 growth times had ended at a "
    "median of 0.13 while the stress was still falling"
)
SHOWS = {
    "Fig 1": ("complex pairs along the strain", "pairs-reappear"),
    "Fig 2": ("eigenvalues during a run", "spectrum-constant-until"),
    "Fig 3": ("growth of M", "growth-rate-ratio"),
    "Fig 4": ("trajectories of spheres", "trajectories-three-dimensional"),
    "Fig 5": ("stress through failure", "stress-drop-one-pair"),
    "Sec. II": ("form of the law, its smoothing and its limit", "pairs-under-a-linear-law"),
    "Sec. III": ("drag that finds equilibria", "dynamics-overdamped"),
    "Sec. V": ("generality", "generic-without-hamiltonian"),
    "App. B": ("blocks of J", "symmetries-of-blocks"),
}


def evaluate_claims(main: ShearResult) -> list[Claim]:
    """Evaluate all claims."""
    on_paths = [*_path_claims(main), *number_claims(main), matrix_claim(main), *protocol_claims(main)]
    return on_paths + _growth_claims(main) + motion_claims(main) + _failure_claims(main) + law_claims()


def _path_claims(main: ShearResult) -> list[Claim]:
    paths = main.paths
    births = [p.onset.strain if p.onset else None for p in paths]
    exponents = [p.onset.exponent if p.onset else None for p in paths]
    fraction = [p.packed.packing_fraction for p in paths]
    pressures = [p.packed.pressure for p in paths]
    dim = main.scenario.packing.dim  # zero modes are translations, and all coordinates of rattlers
    drift = [abs(p.zero_modes - dim - (6 if dim == 3 else 3) * p.packed.rattlers) for p in paths]
    back = sum(p.reappears for p in paths)
    return [
        median_claim(
            "onset-strain", "Fig 1: first pair; no strain is printed", None, births, "strain", "onset",
            f"the packing fraction is not printed either; it is {np.median(fraction):.3g} here, with pressure "
            f"{describe_range(pressures)}; onset {describe_range(births)}; bisected to 1e-6 from the last saved state "
            f"without a pair",
        ),
        median_claim(
            "im-lambda-at-birth-exponent", "Fig 1: birth of a pair; no exponent is printed", None, exponents, "1",
            "exponent", describe_range(exponents, "{:.4f}"), reference=0.5,
            reference_source="when two real eigenvalues meet, they leave the real axis as a square root",
        ),
        claim(
            "pairs-at-zero-slip", 'Fig 1: Sec. III, the frictionless start "has no complex eigenvalues"', 0,
            max(float(p.pairs[0]) for p in paths), "pairs", TOLERANCE["pairs"],
            f"maximum over {len(paths)} packings; zero modes other than translations and rattlers: {max(drift)}",
            error=0.0,
        ),
        statement(
            "pairs-reappear",
            'Fig 1: "with increasing strain the imaginary component can reduce and disappear, then reappear"',
            bool(back),
            f"all pairs vanish and some reappear in {back} of {len(paths)} packings; pairs at the last strain "
            f"{paths[0].strain[-1]:g}: {', '.join(f'{p.pairs[-1]:.0f}' for p in paths)}", quantifier=CAN,
        ),
    ]  # fmt: skip


class Stretch(NamedTuple):
    """Part of a run in which M follows the predicted exponential."""

    decades: float  # decades of M between its ends
    first: float  # M where it leaves its initial level [length²]
    last: float  # M where it leaves the exponential [length²]
    ended: bool  # False if M was still following the exponential when the run ended


def exponential_stretch(run: Released) -> Stretch | None:
    """Find the part of a run in which M follows exp(2 ω_i t) with the predicted ω_i.

    In this part, the running maximum of M lies within a factor of two of this exponential, which is matched to M in the
    fit window. Before it, M is at its initial level; after it, the spectrum changes. Returns None if M did not cross
    the fit window.
    """
    if run.growth is None:
        return None
    envelope = np.maximum.accumulate(run.msd)
    there = envelope > 0
    time, decade = run.time[there], np.log10(envelope[there])
    line = decade - 2 * run.growth_rate / np.log(10) * time
    inside = np.flatnonzero((time >= run.growth.start) & (time <= run.growth.stop))
    near = np.abs(line - np.median(line[inside])) < MISFIT
    middle = int(inside[len(inside) // 2])
    before, after = np.flatnonzero(~near[:middle]), np.flatnonzero(~near[middle:])
    first = int(before[-1]) + 1 if len(before) else 0
    last = middle + int(after[0]) - 1 if len(after) else len(near) - 1
    return Stretch(float(decade[last] - decade[first]), 10 ** decade[first], 10 ** decade[last], bool(len(after)))


def _growth_claims(main: ShearResult) -> list[Claim]:
    runs = main.single
    fitted = [r if r and r.growth else None for r in runs]
    rates = [r and r.growth.growth_rate / r.corrected_rate for r in fitted]
    frequencies = [r and r.growth.frequency / r.corrected_frequency for r in fitted]
    constant = [r.constant[0] if r and np.isfinite(r.constant[1]) else None for r in runs]
    changed = [r.constant[1] if r else None for r in runs]
    rate = describe_range([r.growth_rate if r else None for r in runs], "{:.2e}")
    said = 'Fig 3: "fitted ω_r and ω_i correspond perfectly to those expected"'
    return [
        median_claim(
            "growth-rate-ratio", said, 1.0, rates, "1", "rate",
            f"from states with one pair, predicted rates {rate}; ratio after Verlet's correction "
            f"1 + (omega_r dt)^2/8: {describe_range(rates, '{:.6f}')}",
        ),
        median_claim(
            "frequency-ratio", said, 1.0, frequencies, "1", "frequency",
            f"ratio after Verlet's correction 1 + (omega_r dt)^2/24: {describe_range(frequencies, '{:.8f}')}",
        ),
        *_decade_claims(main),
        median_claim(
            "spectrum-constant-until", 'Fig 2: "eigenvalues remain constant for a period of time"; no M is printed',
            None, constant, "(2 sigma_1)^2", "constant",
            f"M at the last spectrum before the fastest Im lambda had changed by 1 %: {describe_range(constant)}; at "
            f"the next one: {describe_range(changed)}",
        ),
    ]  # fmt: skip


def _decade_claims(main: ShearResult) -> list[Claim]:
    """Claims about the number of decades over which M follows the prediction."""
    stretches = [exponential_stretch(r) if r else None for r in main.single]
    known = [s for s in stretches if s]
    decades, growing = [s and s.decades for s in stretches], sum(not s.ended for s in known)
    said = 'Fig 3: "an increase in time of about 10 orders of magnitude following an oscillatory exponential growth"'
    ends = "; M " + ", ".join(f"{s.first:.0e} to {s.last:.0e}" for s in known) if known else ""
    note = f"M within a factor of two of exp(2 omega_i t), omega_i predicted: {describe_range(decades, '{:.1f}')}{ends}"
    note += f"; {growing} still grew when the run ended" if growing else ""
    return [
        statement(
            "growth-follows-prediction", said, all(s.decades >= DECADES for s in known) if known else None,
            f"over at least ten decades; {note}",
        ),
        claim(
            "decades-of-growth", said, DECADES, known_median(decades), "decades of M", TOLERANCE["decades"],
            f"{note}; the number depends on the initial perturbation, velocities of "
            f"{main.scenario.release.seed_velocity:g} here; the paper does not print its value",
        ),
    ]  # fmt: skip


def _ended_runs(runs: list[Released | None]) -> list[Released]:
    """Select the runs whose exponential growth ended before the run did; only these can have failed."""
    stretches = [(r, exponential_stretch(r)) for r in runs if r]
    return [r for r, stretch in stretches if stretch and stretch.ended]


def _failure_claims(main: ShearResult) -> list[Claim]:
    lost = [r.contacts_lost for r in _ended_runs(main.later)]
    first = [r.contacts_lost for r in _ended_runs(main.single)]
    return [
        _stress_drop(
            "stress-drop-one-pair", main.single, 'Fig 5: "a macroscopic drop, in the present case of 22%"', 0.22, {}
        ),
        _stress_drop(
            "stress-drop-later", main.later, "Fig 5: none is printed for states with many pairs", None,
            {"reference": 0.22, "reference_source": "the paper's single run, from a state with one pair"},
        ),
        median_claim(
            "contacts-lost", 'Fig 5: "induced by granules losing contacts"; no number is printed', None, lost,
            "contacts", "contacts",
            f"from later states {describe_range(lost)}; from one-pair states {describe_range(first)}",
        ),
    ]  # fmt: skip


def _stress_drop(
    id: str, source_runs: list[Released | None], source: str, paper: float | None, reference: dict
) -> Claim:
    """Claim about the loss of shear stress relative to its initial value; the note states it relative to pressure."""
    there = _ended_runs(source_runs)
    relative = [r.drop / abs(r.shear_stress[0]) for r in there]
    to_pressure = [r.drop / r.pressure[0] for r in there]
    listed = ", ".join(
        f"{pluralize(r.pairs, 'pair')} at {r.strain:.2g}: {a:.3g} ({b:.3g} of p), M {r.msd[-1]:.0e}, "
        f"{r.contacts_lost} lost"
        for r, a, b in zip(there, relative, to_pressure, strict=True)
    )
    note = (
        f"the paper's 22 % is from one run; fraction of the initial shear stress, which may be near zero; relative to "
        f"pressure {describe_range(to_pressure)}; {listed or 'in no run did the exponential growth end'}"
    )
    if paper is None:
        note += f"; {LEAST_DURATION}"
    return median_claim(id, source, paper, relative, "1", "drop", note, **reference)


def paper_scenario(*, quick: bool = False, seed: int = 0) -> ShearScenario:
    """Return the scenario: N = 100 spheres, radii 0.5 and 0.7, strain steps of 2e-5, then of 1e-4 up to 0.02."""
    if quick:
        return validate_scenario(
            ShearScenario, seed=seed, packings=4, packing={"grains": 40},
            shear={"strain": (0.0, 1e-3, 0.02), "step": (2e-5, 1e-3)},
            release={"e_folds": 25.0, "least": 2e4, "duration": 3e5, "snapshots": 12},
        )  # fmt: skip
    return validate_scenario(ShearScenario, seed=seed)


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario with the arguments of `simulate_shear`, and evaluate its claims."""
    main = simulate_shear(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    claims = evaluate_claims(main)
    return Reproduction(main, note_quick_run(claims) if quick else claims)
