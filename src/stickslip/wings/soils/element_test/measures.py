"""Quantities of element tests as used in soil engineering.

p and q follow the critical-state literature: p = tr σ/3 and q = √(3 J₂) for spheres, p = (σ₁ + σ₂)/2 and q = σ₁ − σ₂
for disks. q is negative in extension, and for negative γ. Angles are in degrees.
"""

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import Measures, Quantities, Quantity, clear_round_off, estimate, quantities_of
from .sample import SIGNS, ProbedState, first_seen, fluid_pressure
from .scenario import ElementTestScenario
from .simulate import ElementRun, ElementSeries

STEADY = 0.05  # critical state: largest dilatancy, and largest change of q/p and p, over the last third of a leg
PEAK = 0.1  # largest fraction of the leg, on each side of the peak, used to fit the dilatancy
BINS = 20  # number of strain bins in which stress ratio and dilatancy are averaged for Rowe's relation
PARTS = 10  # number of bins in log pressure whose means are used to fit the slope of the void ratio
FEW = 5  # smallest number of rows for a slope
HALF = 0.4, 0.6  # range of q, over the strength, in which the tangent at half of the strength is fitted
MODES = {"tension": True, "shear": False}  # modes in which bonds break; see `Breaks.tension`
NAN = float("nan")
STRESS = "force/length^(dim-1)"


def face_stress(stress: np.ndarray, kind: str) -> np.ndarray:
    """Return the stress on the faces of the cell (T, 3, 3), as in a testing machine; p, q and angles follow from it.

    Except in simple shear, shear stresses on the faces are ignored, as they scatter about zero.
    """
    return stress if kind == "simple-shear" else stress * np.eye(3)


def volumetric_strain(series: ElementSeries) -> np.ndarray:
    """Sum of the normal strains (T,), exactly zero where they cancel, as in an undrained test."""
    normal = series.strain[:, :3]
    return clear_round_off(normal.sum(axis=1), normal)


def pore_pressure(series: ElementSeries, dim: int, fluid: float | None = None) -> np.ndarray:
    """Excess pore pressure of an undrained test (T,) [force/length^(dim-1)].

    The grains carry the effective stress. At constant total lateral stress, an incompressible fluid takes up the loss
    of effective lateral stress since the start. A fluid with the bulk modulus `fluid` has the pressure given by
    `fluid_pressure`.
    """
    if fluid:
        return fluid_pressure(series.void_ratio, series.void_ratio[0], fluid)
    lateral = np.diagonal(series.stress, axis1=1, axis2=2)[:, : dim - 1].mean(axis=1)
    return lateral[0] - lateral


def invariants(stress: np.ndarray, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Return p and q of stresses (T, 3, 3); q is negative in extension and where the shear stress −σ_xy is negative."""
    part = 0.5 * (stress + stress.swapaxes(1, 2))[:, :dim, :dim]
    p = np.trace(part, axis1=1, axis2=2) / dim
    deviator = part - p[:, None, None] * np.eye(dim)
    size = np.sqrt((1.5 if dim == 3 else 2.0) * (deviator**2).sum(axis=(1, 2)))
    lead = np.where(part[:, 0, 1] != 0, -part[:, 0, 1], deviator[:, -1, -1] + 1e-9 * p)
    return p, np.where(lead < 0, -size, size)


def friction_angle(stress: np.ndarray, dim: int) -> np.ndarray:
    """Mobilised friction angle, sin φ = (σ₁ − σ₃)/(σ₁ + σ₃) of the principal stresses (T,) [degrees].

    Examples
    --------
    >>> friction_angle(np.diag([1.0, 1.0, 3.0])[None], 3).round(6)
    array([30.])
    """
    principal = np.linalg.eigvalsh(0.5 * (stress + stress.swapaxes(1, 2))[:, :dim, :dim])
    least, most = principal[:, 0], principal[:, -1]
    whole = most + least
    sine = np.divide(most - least, whole, out=np.zeros_like(whole), where=whole != 0)
    return np.degrees(np.arcsin(np.clip(sine, -1, 1)))


def dilatancy_angle(rate: np.ndarray, dim: int) -> float:
    """Angle of dilatancy, sin ψ = −ε̇_v/Σ|ε̇_k|, of strain rates (ε̇_xx, ε̇_yy, ε̇_zz, γ̇) [degrees].

    ε̇_k are the principal rates. This is the Mohr–Coulomb flow rule wherever two principal stresses are equal or one
    rate is zero: −ε̇_v/(2 ε̇₁ − ε̇_v) in compression and plane strain, and −ε̇_v/(ε̇_v − 2 ε̇₃) in extension.

    Source
    ------
    Vermeer & de Borst, Non-associated plasticity for soils, concrete and rock, HERON 29(3), 1984, for compression.

    Examples
    --------
    >>> round(dilatancy_angle(np.array([-0.5, 0.0, 0.5, 0.0]), 3), 6) + 0.0
    0.0
    """
    tensor = np.diag(rate[:3])
    tensor[0, 1] = tensor[1, 0] = -0.5 * rate[3]
    size = np.abs(np.linalg.eigvalsh(tensor[:dim, :dim])).sum()
    volumetric = float(clear_round_off(rate[:dim].sum(), rate))
    return float(np.degrees(np.arcsin(-volumetric / size))) + 0.0 if size else NAN


class Slope(NamedTuple):
    """Decrease of the void ratio with the logarithm of pressure, and half of its 95 % interval."""

    index: float  # −de/d log10 of the pressure
    error: float


def log_slope(pressure: np.ndarray, void_ratio: np.ndarray) -> Slope:
    """Slope of void ratio (T,) against the logarithm of pressure (T,); NaN if there are too few rows.

    A line is fitted to means in `PARTS` equal bins of the logarithm, because rows are dense after turns and
    neighbouring rows are not independent. The error, from Student's t, is that of this line.

    Examples
    --------
    >>> p = np.geomspace(1.0, 8.0, 50)
    >>> round(log_slope(p, 0.7 - 0.2 * np.log10(p)).index, 6)
    0.2
    """
    x = np.log10(pressure)
    part = np.digitize(x, np.linspace(x.min(), x.max(), PARTS + 1)[1:-1]) if len(x) else x
    x, e = (np.array([values[part == k].mean() for k in np.unique(part)]) for values in (x, void_ratio))
    if len(x) < FEW:
        return Slope(NAN, NAN)
    off = x - x.mean()
    slope = (off @ e) / (off @ off)
    rest = e - e.mean() - slope * off
    return Slope(float(-slope), float(stdtrit(len(x) - 2, 0.975) * np.sqrt(rest @ rest / (len(x) - 2) / (off @ off))))


def work(series: ElementSeries) -> np.ndarray:
    """Work done on a sample per initial volume (T,), by the trapezoidal rule [energy/length^dim]."""
    normal = np.diagonal(series.stress, axis1=1, axis2=2)
    force = np.column_stack([normal, -series.stress[:, 0, 1]]) * np.exp(-series.strain[:, :3].sum(axis=1))[:, None]
    change = np.diff(series.strain, axis=0)
    change[:, 3] -= 0.5 * (series.strain[1:, 3] + series.strain[:-1, 3]) * change[:, 1]  # minus change of height
    steps = 0.5 * (force[1:] + force[:-1]) * change
    return np.append(0.0, np.cumsum(steps.sum(axis=1)))


class Leg(NamedTuple):
    """Part of a path between turns: its rows, and measures of each row."""

    load: np.ndarray
    strain: np.ndarray
    p: np.ndarray
    q: np.ndarray
    angle: np.ndarray
    void_ratio: np.ndarray

    def slope(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Slope of values against the load over some rows; NaN if there are too few."""
        if rows.sum() < FEW or not np.ptp(self.load[rows]) > 0:
            return np.full(values.shape[1:], NAN)
        return np.polyfit(self.load[rows], values[rows], 1)[0]


def legs_of(series: ElementSeries, dim: int, kind: str) -> list[Leg]:
    """Split a path into legs at its turns."""
    way = np.sign(np.diff(series.load))
    moves = np.flatnonzero(way)
    turns = moves[1:][np.diff(way[moves]) != 0]
    edges = [0, *turns, len(series.load) - 1]
    stress = face_stress(series.stress, kind)
    columns = (series.load, series.strain, *invariants(stress, dim), friction_angle(stress, dim), series.void_ratio)
    return [Leg(*(column[a : b + 1] for column in columns)) for a, b in pairwise(edges) if b > a] or [Leg(*columns)]


class LoadedSample:
    """One sample and its scenario; `SERIES` and `SAMPLE` are computed from it."""

    def __init__(self, run: ElementRun, scenario: ElementTestScenario):
        self.run, self.series, self.scenario = run, run.series, scenario
        self.dim, self.kind = scenario.sample.dim, scenario.path.kind
        self.stress = face_stress(self.series.stress, self.kind)
        self.legs = legs_of(self.series, self.dim, self.kind)
        self.first, self.last = self.legs[0], self.legs[-1]
        self.cement, self.breaks = scenario.cement, run.breaks
        rise = np.abs(self.first.q - self.first.q[0])
        self.top = int((rise if self.cement else self.first.angle).argmax())  # index of the peak
        self.compressed = self.kind in ("isotropic", "oedometric")
        self.sheared = not self.compressed and not self.cement  # sheared without cement, up to a critical state

    def signed(self, values: np.ndarray) -> np.ndarray:
        """Values with the scenario's sign, without negative zeros."""
        return self.scenario.sign * values + 0.0

    @cached_property
    def pore_pressure(self) -> np.ndarray | None:
        """Excess pore pressure; None unless the test is undrained."""
        fluid = self.scenario.path.fluid_modulus
        return pore_pressure(self.series, self.dim, fluid) if fluid or self.kind == "undrained" else None

    @cached_property
    def cell_pressure(self) -> np.ndarray | None:
        """Total mean stress on an isotropic path with a fluid; None on other paths."""
        if self.kind != "isotropic" or self.pore_pressure is None:
            return None
        return invariants(self.stress, self.dim)[0] + self.pore_pressure

    @cached_property
    def measured_b(self) -> np.ndarray | None:
        """B = Δu/Δσ since the start of an isotropic path; NaN at the start, None on other paths."""
        if self.cell_pressure is None:
            return None
        change = self.cell_pressure - self.cell_pressure[0]
        small = np.abs(change) <= 1e-6 * self.cell_pressure
        return np.divide(self.pore_pressure, change, out=np.full(len(change), NAN), where=~small)

    @property
    def skempton(self) -> float:
        """A at the peak, from Δu = B (Δσ₃ + A (Δσ₁ − Δσ₃)) with total principal stresses; NaN unless undrained.

        The total lateral stress is constant. It is σ₃ in compression, where A = Δu/(B q), and σ₁ in extension, where
        Δσ₃ is q and A = 1 − Δu/(B q). For an isotropic elastic sample of spheres, A is 1/3 in compression and 2/3 in
        extension.

        Source
        ------
        Skempton, doi:10.1680/geot.1954.4.4.143.
        """
        if self.kind != "undrained":
            return NAN
        q = self.first.q[self.top]
        a = self.at_peak(self.pore_pressure, q) / self.skempton_b
        return 1 - a if q < 0 else a

    @property
    def skempton_b(self) -> float:
        """B = Δu/Δσ of the sample under an isotropic total stress Δσ, if no fluid leaves.

        It is measured over the first leg of an isotropic path, and computed at the start of an undrained test.
        """
        if self.measured_b is not None:
            return float(self.measured_b[len(self.first.load) - 1])
        return self.elastic_b if self.kind == "undrained" else NAN

    @property
    def elastic_b(self) -> float:
        """B of the sample before the test, from its elastic bulk modulus; 1 with an incompressible fluid.

        Grains are incompressible, so the volume lost by the sample, Δσ′/K, is lost by the pores and equals that
        lost by the fluid in them, n Δu/K_f. With Δσ = Δσ′ + Δu, B = 1/(1 + n K/K_f).
        """
        e, fluid = float(self.series.void_ratio[0]), self.scenario.path.fluid_modulus
        return 1 / (1 + e / (1 + e) * self.run.elastic.bulk / fluid) if fluid else 1.0

    def at_peak(self, values: np.ndarray | None, over: float = 1.0) -> float:
        """Value at the peak, divided by a number; NaN without values."""
        return NAN if values is None or not over else float(values[self.top] / over)

    @property
    def psi(self) -> float:
        """Dilatancy angle at the peak; NaN if it cannot be fitted, or if cement makes the peak brittle."""
        leg = self.first
        length = leg.load[-1] - leg.load[0]
        reach = min(PEAK * abs(length), 0.5 * abs(leg.load[self.top] - leg.load[0]))  # without the elastic start
        near = np.abs(leg.load - leg.load[self.top]) <= reach * (1 + 1e-9)
        rate = leg.slope(leg.strain, near) * np.sign(length)
        return dilatancy_angle(rate, self.dim) if self.sheared and np.isfinite(rate).all() else NAN

    @property
    def secant(self) -> float:
        """E50: secant slope of the axial stress difference from the start to half of its maximum."""
        leg, axis = self.first, self.dim - 1
        rise, axial = np.abs(leg.q - leg.q[0]), np.abs(leg.strain[:, axis] - leg.strain[0, axis])
        half = 0.5 * rise.max()
        after = int((rise >= half).argmax())
        if self.kind != "triaxial" or not after:
            return NAN
        at = np.interp(half, rise[after - 1 : after + 1], axial[after - 1 : after + 1])
        return float(half / at)

    @property
    def late(self) -> np.ndarray:
        """Mask of the last third of the last leg (T,)."""
        leg = self.last
        return (leg.load - leg.load[0]) / ((leg.load[-1] - leg.load[0]) or 1.0) >= 2 / 3

    @cached_property
    def drifts(self) -> np.ndarray:
        """Volumetric over imposed strain rate, and relative changes of q/p and p, in the last third of the last leg."""
        leg, rows = self.last, self.late
        out = [leg.slope(leg.strain, rows)[: self.dim].sum()]
        for values in (leg.q / leg.p, leg.p):
            change = leg.slope(values, rows) * (leg.load[-1] - leg.load[0]) / 3
            out.append(change / values[rows].mean() if np.isfinite(change) else NAN)
        return np.abs(out)

    @cached_property
    def steady(self) -> np.ndarray | None:
        """Mask of the critical state, the last third of a leg; None unless volume, q/p and p are steady there."""
        return self.late if self.sheared and (self.drifts <= STEADY).all() else None

    @property
    def principal_stresses(self) -> dict[str, tuple[float, float]]:
        """Major and minor principal stress at the peak, at the critical state (NaN if not reached), and at the end."""
        if self.compressed:
            return {}
        stress = self.stress[:, : self.dim, : self.dim]
        values = np.linalg.eigvalsh(0.5 * (stress + stress.swapaxes(1, 2)))[:, [-1, 0]].T
        values = clear_round_off(values, self.scenario.stress_scale)
        end = values[:, -len(self.last.load) :]
        return {
            "peak": tuple(self.at_peak(each) for each in values), "critical": tuple(map(self.critical, end)),
            "end": tuple(map(self.at_end, end)),
        }  # fmt: skip

    def critical(self, values: np.ndarray) -> float:
        """Mean of values of the last leg at the critical state; NaN if not reached."""
        return NAN if self.steady is None else self.at_end(values)

    def at_end(self, values: np.ndarray) -> float:
        """Mean of values over the last third of the last leg; NaN if the sample was not sheared."""
        return float(values[self.late].mean()) if self.sheared and self.late.any() else NAN

    @property
    def compression_stress(self) -> np.ndarray:
        """Stress against which compression is drawn: axial stress in an oedometric test, mean stress otherwise."""
        return self.stress[:, self.dim - 1, self.dim - 1] if self.kind == "oedometric" else invariants(
            self.stress, self.dim)[0]  # fmt: skip

    @cached_property
    def indices(self) -> dict[str, Slope]:
        """Slopes of first compression, unloading and reloading; NaN if the path has no such part.

        First compression is loading beyond all previous stresses. If a kind has several parts, the slope is fitted to
        the part with the largest range of the logarithm; for first compression, only to its upper half.
        """
        stress, e = self.compression_stress, self.series.void_ratio
        if not self.compressed or not (stress > 0).all():
            return dict.fromkeys(("compression", "swelling", "reloading"), Slope(NAN, NAN))
        beyond, rises = stress[1:] >= np.maximum.accumulate(stress)[:-1], np.diff(stress) > 0
        kind = np.where(rises & beyond, 2, rises)  # kinds of steps: 0 unloading, 1 reloading, 2 first compression
        edges = [0, *(np.flatnonzero(np.diff(kind)) + 1), len(kind)]
        parts = [(kind[a], slice(a, b + 1)) for a, b in pairwise(edges) if b > a]

        def longest(wanted: int) -> slice:
            some = (rows for each, rows in parts if each == wanted)
            return max(some, key=lambda rows: np.ptp(np.log(stress[rows])), default=slice(0))

        rows = {"swelling": longest(0), "reloading": longest(1), "compression": longest(2)}
        there = stress[rows["compression"]]
        late = there >= np.sqrt(there[:1] * there[-1:])
        rows["compression"] = np.arange(len(stress))[rows["compression"]][late]
        return {name: log_slope(stress[here], e[here]) for name, here in rows.items()}

    @property
    def k0(self) -> float:
        """Ratio of lateral to axial stress at the largest axial stress of an oedometric test."""
        normal = np.diagonal(self.series.stress, axis1=1, axis2=2)[:, : self.dim]
        top = normal[normal[:, -1].argmax()]
        return float(top[:-1].mean() / top[-1]) if self.kind == "oedometric" else NAN

    @cached_property
    def rowe(self) -> tuple[float, float]:
        """Friction angle and correlation coefficient of Rowe's relation in triaxial compression.

        σ₁/σ₃ = K (1 − dε_v/dε₁), K = (1 + sin φ)/(1 − sin φ).

        Source
        ------
        Rowe, doi:10.1098/rspa.1962.0193.
        """
        leg = self.first
        if self.kind != "triaxial" or self.cement or leg.load[-1] < leg.load[0]:
            return NAN, NAN
        edges = np.linspace(leg.load[0], leg.load[-1], BINS + 1)
        ratio, dilatancy = [], []
        for a, b in pairwise(edges[1:]):  # without the first bin, which is elastic
            rows = (leg.load >= a) & (leg.load <= b)
            sine = np.sin(np.radians(leg.angle[rows].mean())) if rows.any() else NAN
            ratio.append((1 + sine) / (1 - sine))
            dilatancy.append(1 - leg.slope(leg.strain, rows)[:3].sum())
        ratio, dilatancy = np.array(ratio), np.array(dilatancy)
        if not np.isfinite(ratio + dilatancy).all():
            return NAN, NAN
        k = (ratio @ dilatancy) / (dilatancy @ dilatancy)
        angle = float(np.degrees(np.arcsin((k - 1) / (k + 1))))
        varies = min(np.ptp(ratio), np.ptp(dilatancy)) > 1e-9
        return angle, float(np.corrcoef(ratio, dilatancy)[0, 1]) if varies else NAN

    def elastic(self, rows: np.ndarray) -> tuple[float, float]:
        """Young's modulus and Poisson's ratio from a line through some rows of the first leg of a triaxial path."""
        leg, axis = self.first, self.dim - 1
        if rows.sum() < 2 or not np.ptp(leg.load[rows]) > 0:
            return NAN, NAN
        slope = np.polyfit(leg.load[rows], np.column_stack([leg.q, leg.strain])[rows], 1)[0]
        stiffness, axial, lateral = slope[0], slope[1 + axis], slope[1 : 1 + axis].mean()
        return float(stiffness / axial), float(-lateral / axial)

    @property
    def small(self) -> tuple[float, float]:
        """E and ν between the first two rows."""
        return self.elastic(np.arange(len(self.first.load)) < 2)

    @property
    def half(self) -> tuple[float, float]:
        """E and ν at half of the strength, from a line through the two rows around it and those within `HALF`.

        Only rows up to the peak count.
        """
        rise = np.abs(self.first.q - self.first.q[0])[: self.top + 1]
        share = rise / (rise[-1] or 1.0)
        first = int((share >= 0.5).argmax())
        around = np.arange(len(self.first.q))
        near = (around >= first - 1) & (around <= first)
        near[: len(share)] |= (share >= HALF[0]) & (share <= HALF[1])
        return self.elastic(near)

    @property
    def strength(self) -> float:
        """Largest change of the deviatoric stress."""
        return float(abs(self.first.q[self.top] - self.first.q[0]))

    def uniaxial(self, sign: int) -> float:
        """Strength of a cemented sample without confining pressure, in compression (1) or tension (-1); else NaN."""
        if self.cement.confining or self.first.load[-1] * sign <= 0:
            return NAN
        return self.strength

    @property
    def holds(self) -> bool:
        """False if a sample without confining pressure lost all of its bonds before the test."""
        return bool(self.cement.confining) or int((self.breaks.row == 0).sum()) < len(self.run.end.bonds.i)

    def broken(self, row: int | np.ndarray, tension: bool) -> int | np.ndarray:
        """Number of bonds broken in tension or in shear up to given rows, including those broken before the test."""
        rows = np.sort(self.breaks.row[self.breaks.tension == tension])
        return np.searchsorted(rows, row, side="right")

    @property
    def crack_initiation(self) -> float:
        """Change of deviatoric stress at which 1 % of the bonds that break up to the peak have broken.

        Source
        ------
        Potyondy & Cundall, doi:10.1016/j.ijrmms.2004.09.011.
        """
        count = self.broken(np.arange(self.top + 1), True) + self.broken(np.arange(self.top + 1), False)
        if count[-1] == count[0]:
            return NAN
        first = int((count - count[0] >= 0.01 * (count[-1] - count[0])).argmax())
        return float(abs(self.first.q[max(first, 1)] - self.first.q[0]))

    @property
    def cone(self) -> ProbedState | None:
        """First state with negative second-order work in some direction."""
        return first_seen(self.run.probes)["negative work"]


SERIES = Quantities([
    Quantity("sample", "1", "seed of the sample", "run.seed"),
    Quantity("axial_strain", "1", "axial strain", lambda t: t.signed(t.series.strain[:, t.dim - 1]),
             r"axial strain $\varepsilon_a$"),
    Quantity("volumetric_strain", "1", "volumetric strain", lambda t: t.signed(volumetric_strain(t.series)),
             r"volumetric strain $\varepsilon_v$"),
    Quantity("gamma", "1", "shear strain along x with gradient y", lambda t: t.series.strain[:, 3],
             r"shear strain $\gamma$"),
    Quantity("p", STRESS, "mean stress", lambda t: t.signed(invariants(t.stress, t.dim)[0]), "$p$"),
    Quantity("q", STRESS, "deviatoric stress", lambda t: t.signed(invariants(t.stress, t.dim)[1]), "$q$"),
    Quantity("pore_pressure", STRESS, "excess pore pressure of an undrained test",
             label="excess pore\npressure $\\Delta u$"),
    Quantity("cell_pressure", STRESS, "total mean stress of an undrained isotropic path", label="cell pressure"),
    Quantity("skempton_B", "1", "excess pore pressure over the change of the cell pressure", "measured_b",
             "Skempton's $B$"),
    *(Quantity(f"sigma_{ij}", STRESS, "component of the stress",
               lambda t, i=i, j=j: t.signed(t.series.stress[:, i, j]), rf"$\sigma_{{{ij}}}$")
      for ij, i, j in (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1))),
    *quantities_of(ElementSeries, of="series.{}".format, void_ratio="void ratio $e$", coordination="contact number",
                   fabric_anisotropy="fabric\nanisotropy", sliding_fraction="share of\nsliding contacts").values(),
    Quantity("phi", "degrees", "mobilised angle of friction",
             lambda t: None if t.cement else friction_angle(t.stress, t.dim)),
    Quantity("work", "energy/length^dim", "work done on the sample", lambda t: work(t.series)),
    *quantities_of(ElementSeries, "unbalanced", of="series.{}".format).values(),
    *(Quantity(f"broken_{mode}", "1", f"bonds that broke in {mode}",
               lambda t, tension=tension: t.broken(np.arange(len(t.series.load)), tension) if t.cement else None,
               f"in {mode}")
      for mode, tension in MODES.items()),
])  # fmt: skip


def _cemented(of: Callable[[LoadedSample], float], *, holds: bool = False) -> Callable[[LoadedSample], float]:
    """Restrict a quantity to cemented samples or, with `holds`, to those that hold together; it is NaN for others."""
    return lambda t: of(t) if t.cement and (t.holds or not holds) else NAN


SAMPLE = Quantities([
    Quantity("e0", "1", "void ratio of the sample", lambda t: float(t.series.void_ratio[0])),
    Quantity("coordination", "1", "mean contact number of the sample", lambda t: float(t.series.coordination[0])),
    Quantity("stiffness_number", "1", "κ: stiffness of contacts over pressure; overlaps are of order D50/κ",
             "scenario.stiffness_number"),
    Quantity("G0", STRESS, "shear modulus at small strain", "run.elastic.shear", partial=True),
    Quantity("E0", STRESS, "Young's modulus at small strain", "run.elastic.young", partial=True),
    Quantity("nu0", "1", "Poisson's ratio at small strain", "run.elastic.poisson", partial=True),
    *(Quantity(f"{name}{end}", unit, f"{words} {where}",
               _cemented(lambda t, of=of, k=k: getattr(t, of)[k], holds=True))
      for of, end, where in (("small", "", "along the axis, tangent of the first step"),
                             ("half", "_half", "along the axis, tangent at half of the strength"))
      for k, (name, unit, words) in enumerate((("E", STRESS, "Young's modulus"), ("nu", "1", "Poisson's ratio")))),
    Quantity("UCS", STRESS, "uniaxial compressive strength", _cemented(lambda t: t.uniaxial(1), holds=True)),
    Quantity("tensile_strength", STRESS, "direct tensile strength", _cemented(lambda t: t.uniaxial(-1), holds=True)),
    Quantity("strength", STRESS, "largest change of q of a cemented sample",
             _cemented(lambda t: t.strength, holds=True)),
    Quantity("crack_initiation", STRESS, "change of q when 1 % of the bonds that break up to the peak have broken",
             _cemented(lambda t: t.crack_initiation, holds=True)),
    Quantity("bonds", "1", "bonds of the cemented sample",
             _cemented(lambda t: len(t.run.end.bonds.i))),
    Quantity("broken_before", "1", "bonds that broke before the test",
             _cemented(lambda t: int((t.breaks.row == 0).sum()))),
    *(Quantity(f"broken_{mode}{end}", "1", f"bonds that broke in {mode}, {where}",
               _cemented(lambda t, tension=tension, row=row: int(t.broken(row(t), tension))))
      for end, where, row in (("_peak", "up to the peak", lambda t: t.top),
                              ("", "up to the end", lambda t: len(t.series.load)))
      for mode, tension in MODES.items()),
    Quantity("E50", STRESS, "secant modulus at half of the largest q", "secant"),
    Quantity("phi_peak", "degrees", "largest angle of friction",
             lambda t: t.at_peak(t.first.angle) if t.sheared else NAN),
    Quantity("strain_at_peak", "1", "strain at the peak",
             lambda t: NAN if t.compressed else t.at_peak(np.abs(t.first.load - t.first.load[0]))),
    Quantity("psi", "degrees", "angle of dilatancy at the peak"),
    *(Quantity(f"sigma{name}_{state}", STRESS, f"{words} principal stress at the {where}",
               lambda t, k=k, state=state: NAN if t.compressed else t.principal_stresses[state][k])
      for state, where in (("peak", "peak"), ("critical", "critical state"), ("end", "end, over the last third"))
      for k, (name, words) in enumerate((("1", "major"), ("3", "minor")))),
    Quantity("critical_reached", "1", "1 if the sample is in a critical state at the end",
             lambda t: float(t.steady is not None) if t.sheared else NAN),
    Quantity("critical_from", "1", "strain from which values at the critical state are averaged",
             lambda t: NAN if t.steady is None else float(abs(t.last.load[t.steady][0]))),
    Quantity("critical_ratio", "1", "q/p at the critical state", lambda t: abs(t.critical(t.last.q / t.last.p))),
    Quantity("phi_residual", "degrees", "angle of friction at the critical state",
             lambda t: t.critical(t.last.angle)),
    Quantity("e_critical", "1", "void ratio at the critical state", lambda t: t.critical(t.last.void_ratio)),
    Quantity("p_critical", STRESS, "mean stress at the critical state", lambda t: t.critical(t.last.p)),
    Quantity("end_ratio", "1", "q/p over the last third of the path, steady or not",
             lambda t: abs(t.at_end(t.last.q / t.last.p))),
    Quantity("e_end", "1", "void ratio over the last third of the path", lambda t: t.at_end(t.last.void_ratio)),
    Quantity("p_end", STRESS, "mean stress over the last third of the path", lambda t: t.at_end(t.last.p)),
    Quantity("K0", "1", "lateral over axial stress", "k0"),
    *(row for name, words in (("compression", "first compression"), ("swelling", "unloading"),
                              ("reloading", "reloading"))
      for row in (
          Quantity(f"{name}_index", "1", f"{words}: −de/d log10 σ (σ: axial in oedometric tests, else p)",
                   lambda t, name=name: t.indices[name].index),
          Quantity(f"{name}_misfit", "1", "half of the 95 % interval of this slope in one sample",
                   lambda t, name=name: t.indices[name].error),
      )),
    Quantity("phi_rowe", "degrees", "angle of Rowe's relation", lambda t: t.rowe[0]),
    Quantity("rowe_correlation", "1", "correlation of σ₁/σ₃ and 1 − dε_v/dε₁", lambda t: t.rowe[1]),
    Quantity("largest_unbalanced", "1", "largest ratio of unbalanced force to contact force",
             lambda t: float(t.series.unbalanced.max())),
    Quantity("rearranged_share", "1", "fraction of steps with rearrangements",
             lambda t: float(t.series.rearranged[1:].mean()) if len(t.series.load) > 1 else NAN),
    Quantity("strain_at_cone", "1", "strain at which second-order work is first negative, first sample",
             lambda t: abs(t.cone.load) if t.cone else NAN, partial=True),
    Quantity("cone_direction", "degrees", "direction of negative work; 0 is axial compression, 90 lateral",
             lambda t: float(np.degrees(t.cone.weakest)) if t.cone else NAN, partial=True),
    Quantity("u_at_peak", STRESS, "excess pore pressure at the peak, at constant lateral pressure",
             lambda t: t.at_peak(t.pore_pressure) if t.sheared else NAN),
    Quantity("skempton", "1", "Skempton's A at the peak", partial=True),
    Quantity("skempton_B", "1", "Skempton's B of the sample", "skempton_b", partial=True),
])  # fmt: skip

MEASURES = Measures(
    SAMPLE, samples=lambda result: [LoadedSample(run, result.scenario) for run in result.runs], over=estimate
)


class Probed(NamedTuple):
    """Probed state, with its scenario."""

    state: ProbedState
    scenario: ElementTestScenario

    @property
    def strain(self) -> float:
        """Imposed strain with the sign of tables."""
        return self.scenario.strain_sign * self.state.load

    @property
    def phi(self) -> float:
        """Mobilised friction angle."""
        stress = face_stress(self.state.stress[None], self.scenario.path.kind)
        return float(friction_angle(stress, self.scenario.sample.dim)[0])

    @property
    def least_work(self) -> float:
        """Smallest normalised second-order work; NaN if there is none."""
        return float(np.nanmin(self.state.envelope.normalised_work)) if np.isfinite(self.state.weakest) else NAN


def _growth(kind: str, words: str, k: int, held: str) -> Quantity:
    return Quantity(f"{kind}_fixed_{held}", "1/time", f"growth rate of the fastest {words} while the {held} is held",
                    lambda p: float(getattr(p.state, "pair" if kind == "pair" else "real")[k]))  # fmt: skip


PROBE = Quantities([
    Quantity("strain", "1", "imposed strain"),
    Quantity("phi", "degrees", "mobilised angle of friction"),
    Quantity("least_work", "1", "smallest normalised second-order work"),
    Quantity("direction", "degrees", "strain direction of smallest work", lambda p: float(np.degrees(p.state.weakest))),
    Quantity("determinant", "1", "smallest determinant of an acoustic tensor, normalised",
             lambda p: p.state.band.determinant if p.state.band else NAN),
    *(_growth(kind, words, k, held) for kind, words in (("pair", "oscillation"), ("divergence", "other motion"))
      for k, held in enumerate(("strain", "stress"))),
    Quantity("uniqueness", "1", "whether the contact status is unique under all stresses",
             lambda p: p.state.unique.lower()),
    *(Quantity(name, "1", f"1 if {words}", lambda p, name=name: int(p.state.signs[name]))
      for name, words in SIGNS.items()),
])  # fmt: skip
