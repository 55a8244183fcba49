"""Numbers that soil engineers read off an element test, with their intervals over samples.

p and q are those of the critical-state literature: p = tr σ/3 and q = √(3 J₂) for spheres, p = (σ₁ + σ₂)/2 and
q = σ₁ − σ₂ for disks. q is negative in extension, and for negative γ. Angles are in degrees.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....core.scales import clear_round_off
from .probes import describe_direction, directions_seen, first_seen
from .scenario import ElementTestScenario
from .simulate import MODULI_UP_TO, ElementRun, ElementSeries, ElementTestResult

STEADY = 0.05  # at a critical state: largest dilatancy, and change of q/p and p over the last third of a leg
PEAK = 0.1  # share of the leg around the peak from which the dilatancy there is fitted
BINS = 20  # of strain, in which stress ratio and dilatancy are averaged for Rowe's relation
FEW = 5  # rows that a slope needs
NAN = float("nan")

PARTIAL = ("G0", "E0", "nu0", "strain_at_cone", "cone_direction")  # numbers that some samples may lack
STRESS = "force/length^(dim-1)"
UNITS = {
    "e0": "1", "coordination": "1", "G0": STRESS, "E0": STRESS, "nu0": "1", "E50": STRESS, "phi_peak": "degrees",
    "strain_at_peak": "1", "psi": "degrees", "phi_residual": "degrees", "e_critical": "1", "p_critical": STRESS,
    "K0": "1", "compression_index": "1", "phi_rowe": "degrees", "rowe_correlation": "1", "largest_unbalanced": "1",
    "rearranged_share": "1", "strain_at_cone": "1", "cone_direction": "degrees", "u_at_peak": STRESS, "skempton": "1",
}  # fmt: skip
MEANING = {
    "e0": "void ratio of the sample", "coordination": "mean contact number of the sample",
    "G0": "shear modulus at small strain", "E0": "Young's modulus at small strain",
    "nu0": "Poisson's ratio at small strain", "E50": "secant modulus at half of the largest q",
    "phi_peak": "largest angle of friction", "strain_at_peak": "strain at the peak",
    "psi": "angle of dilatancy at the peak", "phi_residual": "angle of friction at the critical state",
    "e_critical": "void ratio at the critical state", "p_critical": "mean stress at the critical state",
    "K0": "lateral over axial stress", "compression_index": "−de/d log10 p", "phi_rowe": "angle of Rowe's relation",
    "rowe_correlation": "correlation of σ₁/σ₃ and 1 − dε_v/dε₁", "largest_unbalanced": "unbalanced over contact forces",
    "rearranged_share": "share of steps in which grains rearranged",
    "strain_at_cone": "strain at which second-order work is first seen to be negative, first sample",
    "cone_direction": "direction in which it is; 0 is axial compression, 90 lateral",
    "u_at_peak": "excess pore pressure at the peak, at constant lateral pressure",
    "skempton": "Skempton's A at the peak: excess pore pressure over q",
}  # fmt: skip


def face_stress(series: ElementSeries, kind: str) -> np.ndarray:
    """Stress (T, 3, 3) from which p, q and angles follow: what acts on the faces of the cell, as in a test machine.

    Shear stresses on the faces, which scatter about zero, are left out unless the path is simple shear.
    """
    return series.stress if kind == "simple-shear" else series.stress * np.eye(3)


def volumetric_strain(series: ElementSeries) -> np.ndarray:
    """Sum of the normal strains (T,), zero where these cancel, as they do in an undrained test."""
    normal = series.strain[:, :3]
    return clear_round_off(normal.sum(axis=1), normal)


def pore_pressure(series: ElementSeries, dim: int) -> np.ndarray:
    """Excess pore pressure of an undrained test at constant lateral pressure (T,) [force/length^(dim-1)].

    The grains carry the effective stress. What its lateral part has lost since the start, water carries.
    """
    lateral = np.diagonal(series.stress, axis1=1, axis2=2)[:, : dim - 1].mean(axis=1)
    return lateral[0] - lateral


def invariants(stress: np.ndarray, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean stress p and deviatoric stress q of stresses (T, 3, 3), negative in extension and if −σ_xy is."""
    part = 0.5 * (stress + stress.swapaxes(1, 2))[:, :dim, :dim]
    p = np.trace(part, axis1=1, axis2=2) / dim
    deviator = part - p[:, None, None] * np.eye(dim)
    size = np.sqrt((1.5 if dim == 3 else 2.0) * (deviator**2).sum(axis=(1, 2)))
    lead = np.where(part[:, 0, 1] != 0, -part[:, 0, 1], deviator[:, -1, -1] + 1e-9 * p)
    return p, np.where(lead < 0, -size, size)


def friction_angle(stress: np.ndarray, dim: int) -> np.ndarray:
    """Mobilised angle of friction, sin φ = (σ₁ − σ₃)/(σ₁ + σ₃) of the principal stresses, (T,) [degrees].

    Examples
    --------
    >>> friction_angle(np.diag([1.0, 1.0, 3.0])[None], 3).round(6)
    array([30.])
    """
    principal = np.linalg.eigvalsh(0.5 * (stress + stress.swapaxes(1, 2))[:, :dim, :dim])
    least, most = principal[:, 0], principal[:, -1]
    return np.degrees(np.arcsin(np.clip((most - least) / (most + least), -1, 1)))


def dilatancy_angle(rate: np.ndarray, dim: int) -> float:
    """Angle of dilatancy, sin ψ = −ε̇_v/(2 ε̇₁ − ε̇_v), of strain rates (ε̇_xx, ε̇_yy, ε̇_zz, γ̇) [degrees].

    Source
    ------
    Vermeer & de Borst, Non-associated plasticity for soils, concrete and rock, HERON 29(3), 1984.

    Examples
    --------
    >>> round(dilatancy_angle(np.array([-0.5, 0.0, 0.5, 0.0]), 3), 6) + 0.0
    0.0
    """
    tensor = np.diag(rate[:3])
    tensor[0, 1] = tensor[1, 0] = -0.5 * rate[3]
    most, volumetric = np.linalg.eigvalsh(tensor[:dim, :dim])[-1], rate[:dim].sum()
    volumetric = float(clear_round_off(volumetric, rate))
    return float(np.degrees(np.arcsin(np.clip(-volumetric / (2 * most - volumetric), -1, 1)))) + 0.0


def work(series: ElementSeries) -> np.ndarray:
    """Work done on a sample over its initial volume, (T,), by the trapezoidal rule [energy/length^dim]."""
    normal = np.diagonal(series.stress, axis1=1, axis2=2)
    force = np.column_stack([normal, -series.stress[:, 0, 1]]) * np.exp(-series.strain[:, :3].sum(axis=1))[:, None]
    change = np.diff(series.strain, axis=0)
    change[:, 3] -= 0.5 * (series.strain[1:, 3] + series.strain[:-1, 3]) * change[:, 1]  # of the lean by its own height
    steps = 0.5 * (force[1:] + force[:-1]) * change
    return np.append(0.0, np.cumsum(steps.sum(axis=1)))


class Leg(NamedTuple):
    """Part of a path without a turn: its rows, and measures of each."""

    load: np.ndarray
    strain: np.ndarray
    p: np.ndarray
    q: np.ndarray
    angle: np.ndarray
    void_ratio: np.ndarray

    def slope(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Slope of values against the load over some rows; NaN if they are too few."""
        if rows.sum() < FEW or not np.ptp(self.load[rows]) > 0:
            return np.full(values.shape[1:], NAN)
        return np.polyfit(self.load[rows], values[rows], 1)[0]


def legs_of(series: ElementSeries, dim: int, kind: str) -> list[Leg]:
    """Parts of the path between its turns."""
    way = np.sign(np.diff(series.load))
    moves = np.flatnonzero(way)
    turns = moves[1:][np.diff(way[moves]) != 0]
    edges = [0, *turns, len(series.load) - 1]
    stress = face_stress(series, kind)
    columns = (series.load, series.strain, *invariants(stress, dim), friction_angle(stress, dim), series.void_ratio)
    return [Leg(*(column[a : b + 1] for column in columns)) for a, b in pairwise(edges) if b > a] or [Leg(*columns)]


def numbers_of(run: ElementRun, scenario: ElementTestScenario) -> dict[str, float]:
    """Numbers of one sample by name; NaN where the path does not give them."""
    series, dim, kind = run.series, scenario.sample.dim, scenario.path.kind
    legs, out = legs_of(series, dim, kind), dict.fromkeys(UNITS, NAN)
    out |= {
        "e0": float(series.void_ratio[0]), "coordination": float(series.coordination[0]), "G0": run.elastic.shear,
        "E0": run.elastic.young, "nu0": run.elastic.poisson, "largest_unbalanced": float(series.unbalanced.max()),
        "rearranged_share": float(series.rearranged[1:].mean()) if len(series.load) > 1 else NAN,
    }  # fmt: skip
    if (cone := first_seen(run.probes)["negative work"]) is not None:
        out |= {"strain_at_cone": abs(cone.load), "cone_direction": float(np.degrees(cone.weakest))}
    if kind in ("isotropic", "oedometric"):
        return out | _compression(legs[0], series, dim, kind)
    if kind == "undrained":
        top = int(legs[0].angle.argmax())
        u, q = float(pore_pressure(series, dim)[top]), float(legs[0].q[top])
        out |= {"u_at_peak": u, "skempton": u / q if q else NAN}
    return out | _peak(legs[0], dim, kind) | _critical(legs[-1], dim) | _rowe(legs[0], kind)


def _compression(leg: Leg, series: ElementSeries, dim: int, kind: str) -> dict[str, float]:
    late = leg.p > np.sqrt(leg.p[0] * leg.p[-1])
    index = -np.polyfit(np.log10(leg.p[late]), leg.void_ratio[late], 1)[0] if late.sum() >= FEW else NAN
    normal = np.diagonal(series.stress, axis1=1, axis2=2)[:, :dim]
    top = normal[normal[:, -1].argmax()]
    out = {"compression_index": float(index)}
    return out | ({"K0": float(top[:-1].mean() / top[-1])} if kind == "oedometric" else {})


def _peak(leg: Leg, dim: int, kind: str) -> dict[str, float]:
    top = int(leg.angle.argmax())
    near = np.abs(leg.load - leg.load[top]) <= PEAK * abs(leg.load[-1] - leg.load[0])
    rate = leg.slope(leg.strain, near) * np.sign(leg.load[-1] - leg.load[0])
    out = {"phi_peak": float(leg.angle[top]), "strain_at_peak": float(abs(leg.load[top] - leg.load[0]))}
    if np.isfinite(rate).all():
        out["psi"] = dilatancy_angle(rate, dim)
    return out | ({"E50": _secant(leg, dim)} if kind == "triaxial" else {})


def _secant(leg: Leg, dim: int) -> float:
    """E50: slope of the axial stress difference between the start and half of its largest value."""
    rise, axial = np.abs(leg.q - leg.q[0]), np.abs(leg.strain[:, dim - 1] - leg.strain[0, dim - 1])
    half = 0.5 * rise.max()
    after = int((rise >= half).argmax())
    if not after:
        return NAN
    at = np.interp(half, rise[after - 1 : after + 1], axial[after - 1 : after + 1])
    return float(half / at)


def _critical(leg: Leg, dim: int) -> dict[str, float]:
    """Numbers of the critical state, if volume, q/p and p are steady over the last third of a leg."""
    length = leg.load[-1] - leg.load[0]
    rows = (leg.load - leg.load[0]) / (length or 1.0) >= 2 / 3
    rate = leg.slope(leg.strain, rows)
    if not np.isfinite(rate).all():
        return {}
    drifts = [abs(rate[:dim].sum())]
    for values in (leg.q / leg.p, leg.p):
        drifts.append(abs(leg.slope(values, rows) * length / 3 / values[rows].mean()))
    if not max(drifts) <= STEADY:
        return {}
    means = {"phi_residual": leg.angle, "e_critical": leg.void_ratio, "p_critical": leg.p}
    return {name: float(values[rows].mean()) for name, values in means.items()}


def _rowe(leg: Leg, kind: str) -> dict[str, float]:
    """Rowe's relation σ₁/σ₃ = K (1 − dε_v/dε₁), K = (1 + sin φ)/(1 − sin φ), fitted to a triaxial compression.

    Source
    ------
    Rowe, doi:10.1098/rspa.1962.0193.
    """
    if kind != "triaxial" or leg.load[-1] < leg.load[0]:
        return {}
    edges = np.linspace(leg.load[0], leg.load[-1], BINS + 1)
    ratio, dilatancy = [], []
    for a, b in pairwise(edges[1:]):  # without the first bin, which is elastic
        rows = (leg.load >= a) & (leg.load <= b)
        sine = np.sin(np.radians(leg.angle[rows].mean())) if rows.any() else NAN
        ratio.append((1 + sine) / (1 - sine))
        dilatancy.append(1 - leg.slope(leg.strain, rows)[:3].sum())
    ratio, dilatancy = np.array(ratio), np.array(dilatancy)
    if not np.isfinite(ratio + dilatancy).all():
        return {}
    k = (ratio @ dilatancy) / (dilatancy @ dilatancy)
    angle = float(np.degrees(np.arcsin((k - 1) / (k + 1))))
    varies = min(np.ptp(ratio), np.ptp(dilatancy)) > 1e-9
    return {"phi_rowe": angle, "rowe_correlation": float(np.corrcoef(ratio, dilatancy)[0, 1]) if varies else NAN}


class Estimate(NamedTuple):
    """Mean over samples of a number, and half of its 95 % interval; NaN with fewer than two samples."""

    mean: float
    half_width: float
    scatter: float  # standard deviation between samples

    def __str__(self) -> str:
        spread = f" ± {self.half_width:.2g}" if np.isfinite(self.half_width) else ""
        return f"{self.mean:.4g}{spread}"


def estimate(values: np.ndarray) -> Estimate:
    """Mean of independent values and half of its 95 % interval by Student's t; NaN if any value is NaN.

    Examples
    --------
    >>> str(estimate(np.array([1.0, 2.0, 3.0])))
    '2 ± 2.5'
    """
    n = len(values)
    if n < 2:
        return Estimate(float(values.mean()), NAN, NAN)
    scatter = float(values.std(ddof=1))
    return Estimate(float(values.mean()), float(stdtrit(n - 1, 0.975)) * scatter / np.sqrt(n), scatter)


def estimates(result: ElementTestResult) -> dict[str, Estimate]:
    """Estimates of all numbers that the path gives: of moduli and cones, over the samples that have them."""
    rows = [numbers_of(run, result.scenario) for run in result.runs]
    columns = {name: np.array([row[name] for row in rows]) for name in UNITS}
    for name in PARTIAL:
        known = np.isfinite(columns[name])
        columns[name] = columns[name][known] if known.any() else columns[name]
    numbers = {name: estimate(values) for name, values in columns.items()}
    return {name: number for name, number in numbers.items() if np.isfinite(number.mean)}


def measures(result: ElementTestResult) -> dict[str, tuple[float, str]]:
    """Return {name: (value, unit)} for sweeps: means over samples, and halves of their 95 % intervals."""
    numbers, nothing = estimates(result), Estimate(NAN, NAN, NAN)
    out = {}
    for name, unit in UNITS.items():
        number = numbers.get(name, nothing)
        out |= {name: (number.mean, unit), f"{name}_error": (number.half_width, unit)}
    return out


def sentences(result: ElementTestResult) -> list[str]:
    """Remarks for readers of the numbers: scatter, what the path did not reach, rate, and halved steps."""
    return [*_first_failure(result), *_scatter(result), *_missing(result), *_quasi_static(result), *_finer(result)]


def _first_failure(result: ElementTestResult) -> list[str]:
    """Direction in which the first sample could fail first, and its peak."""
    run, scenario = result.runs[0], result.scenario
    if not run.probes:
        return []
    here, sign = directions_seen(run.probes), scenario.strain_sign
    unanswered = [
        f"No equilibrium could be probed at a strain of {sign * each.load:.3g}: {each.reason}."
        for each in run.probes if each.envelope is None
    ]  # fmt: skip
    if here is None:
        last = sign * run.probes[-1].load
        return [
            f"No direction was seen in which sample {run.seed} could fail, up to a strain of {last:.3g}.",
            *unanswered,
        ]
    numbers = numbers_of(run, scenario)
    why = "second-order work is negative" if here.signs["negative work"] else "no equilibrium is nearby"
    where = describe_direction(here.failing, scenario.path, scenario.sample.dim, scenario.sign)
    peak = f"; the peak angle is at {top:.3g}" if np.isfinite(top := numbers["strain_at_peak"]) else ""
    return [
        f"Sample {run.seed} wanted to fail in the direction {where} first at a strain of {sign * here.load:.3g}, where "
        f"{why}{peak}.",
        *unanswered,
    ]


def _scatter(result: ElementTestResult) -> list[str]:
    n, peak = result.scenario.sample.grains, estimates(result).get("phi_peak")
    if len(result.runs) < 2:
        return ["One sample gives no interval: use more realizations."]
    if peak is None or not peak.scatter > 0:
        return []
    share = peak.scatter / peak.mean
    size = f"{n * (share / 0.01) ** 2:.2g} grains" if share > 0.01 else f"{n} grains suffice"
    return [
        f"The peak angle of samples of {n} grains scatters by {share:.1%}. If the scatter falls as 1/√N, a scatter of "
        f"1 % needs {size.replace(' suffice', ', which is what the samples have')}."
    ]


def _missing(result: ElementTestResult) -> list[str]:
    out = [f"Sample {run.seed} ended early: {run.ended}." for run in result.runs if run.ended]
    rigid = sum(bool(np.isfinite(run.elastic.shear)) for run in result.runs)
    if rigid < len(result.runs):
        out.append(
            f"{rigid} of {len(result.runs)} samples have elastic moduli; in others a strain drives motions that "
            f"nothing resists, or they have more than {MODULI_UP_TO} grains."
        )
    sheared = result.scenario.path.kind not in ("isotropic", "oedometric")
    number = sum(bool(np.isfinite(numbers_of(run, result.scenario)["phi_residual"])) for run in result.runs)
    if sheared and number < len(result.runs):
        out.append(
            f"{number} of {len(result.runs)} samples reached a critical state, in which volume, q/p and p change by "
            f"less than {STEADY:.0%} over the last third of the path, so that the residual angle is undecided: use a "
            f"larger strain or more grains."
        )
    return out


def _quasi_static(result: ElementTestResult) -> list[str]:
    scenario, numbers = result.scenario, estimates(result)
    if scenario.path.integrator == "dynamic":
        return [
            f"The strain rate of {scenario.rate:.3g} is an inertial number of {scenario.rate * scenario.time:.2g}; the "
            f"mean unbalanced force was at most {numbers['largest_unbalanced'].mean:.2g} of the mean contact force."
        ]
    share = numbers["rearranged_share"].mean if "rearranged_share" in numbers else 0.0
    return [f"Grains rearranged in {share:.0%} of the steps, whose equilibria were found by damped dynamics."]


def _finer(result: ElementTestResult) -> list[str]:
    what = "step" if result.scenario.path.integrator == "quasi-static" else "rate"
    if result.checked is None:
        return [f"It was not checked whether half the {what} gives the same: use check = true."]
    before, after = (numbers_of(run, result.scenario)["phi_peak"] for run in (result.runs[0], result.checked))
    scatter = estimates(result).get("phi_peak", Estimate(NAN, NAN, NAN)).scatter
    change = f"With half the {what}, the peak angle of the first sample is {after:.2f} instead of {before:.2f} degrees"
    if not np.isfinite(scatter):
        return [f"{change}."]
    reach = float(stdtrit(len(result.runs) - 1, 0.975)) * scatter
    verdict = "less" if abs(after - before) <= reach else "more"
    return [f"{change}, a change of {verdict} than the scatter of samples (95 %: {reach:.2f} degrees)."]
