"""Scenario of an element test: a sample of grains in a periodic cell, its grading and density, and a load path."""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from math import log, pi, sqrt
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ....kit import (
    Finite,
    LawTable,
    Listed,
    NotNegative,
    Positive,
    Ranks,
    ScenarioBase,
    ScenarioTable,
    Seed,
    Size,
    allow_laws,
    require_lammps_for_ranks,
)
from .grading import MISFIT, Grading, diameters, from_d10_d50_d60, grains_needed, misfit, require_span

QUASI_STATIC = 1e-3  # largest inertial number of a quasi-static test (GDR MiDi, doi:10.1140/epje/i2003-10153-0)
NARROWEST = 2.0  # smallest width of the cell over the largest diameter
DENSITY = {2: 0.8, 3: 0.6}  # packing fractions for estimates before the sample is made
FIRST, GROWTH = 1e-6, 1.5  # first strain step of a leg, and growth factor of the following steps
STIFFEST = 1e7  # largest modulus of a pore fluid over the pressure
LOG_STEP = 100.0  # step of ln p on an isotropic path over the strain step on other paths
AT_REST, BALANCED = 1e-4, 1e-9  # tolerances of the compression and of equilibria, over p D^(dim−1)
RESOLVED = 1e3  # smallest strength of a bond over the unbalanced force of an equilibrium
Shares = Annotated[tuple[Annotated[float, Field(ge=0, le=100)], ...], Listed]
Sizes = Annotated[tuple[Positive, ...], Listed]


class UniformSizes(ScenarioTable):
    """Diameters between two bounds, with the same mass in equal intervals of the logarithm."""

    kind: Literal["uniform"] = "uniform"
    smallest: Positive = Field(0.8e-3, description="smallest diameter [length]")
    largest: Positive = Field(1.2e-3, description="largest diameter [length]")

    @model_validator(mode="after")
    def _check_order(self):
        if not self.smallest < self.largest:
            raise ValueError(
                f"grading.smallest must be below grading.largest = {self.largest:g}, got {self.smallest:g}"
            )
        return self

    def curve(self) -> Grading:
        """Curve of passing by mass."""
        return Grading(np.array([self.smallest, self.largest]), np.array([0.0, 1.0]))


class LognormalSizes(ScenarioTable):
    """Diameters whose logarithm has a normal distribution by mass, cut off at two standard deviations."""

    kind: Literal["lognormal"] = "lognormal"
    d50: Positive = Field(1e-3, description="median diameter by mass [length]")
    sigma: Annotated[float, Field(gt=0, le=1)] = Field(0.2, description="standard deviation of the logarithm")

    def curve(self) -> Grading:
        """Curve of passing by mass."""
        from scipy.special import ndtr

        z = np.linspace(-2, 2, 81)
        share = (ndtr(z) - ndtr(-2)) / (ndtr(2) - ndtr(-2))
        return Grading(self.d50 * np.exp(self.sigma * z), share)


class ThreeSizes(ScenarioTable):
    """Grading curve through D10, D50 and D60, linear in the logarithm of the size."""

    kind: Literal["d10-d50-d60"] = "d10-d50-d60"
    d10: Positive = Field(description="diameter below which 10 % of the mass lies [length]")
    d50: Positive = Field(description="diameter below which half of the mass lies [length]")
    d60: Positive = Field(description="diameter below which 60 % of the mass lies [length]")

    @model_validator(mode="after")
    def _check_order(self):
        self.curve()
        return self

    def curve(self) -> Grading:
        """Curve of passing by mass."""
        return from_d10_d50_d60(self.d10, self.d50, self.d60)


class SieveTable(ScenarioTable):
    """Grading curve: fraction by mass that passes each size, interpolated linearly in the logarithm of the size."""

    kind: Literal["table"] = "table"
    sizes: Sizes = Field(min_length=2, description="diameters, increasing [length]")
    passing: Shares = Field(min_length=2, description="mass fraction of smaller grains, from 0 to 100 % [%]")

    @model_validator(mode="after")
    def _check_table(self):
        if len(self.sizes) != len(self.passing):
            raise ValueError(
                f"grading.sizes has {len(self.sizes)} entries, but grading.passing has {len(self.passing)}: give the "
                f"same number"
            )
        if list(self.sizes) != sorted(set(self.sizes)) or list(self.passing) != sorted(set(self.passing)):
            raise ValueError("grading.sizes and grading.passing must increase from each entry to the next: sort them")
        if (self.passing[0], self.passing[-1]) != (0, 100):
            raise ValueError(
                "grading.passing must begin with 0 and end with 100, at the smallest and the largest diameter, got "
                f"{self.passing[0]:g} and {self.passing[-1]:g}"
            )
        return self

    def curve(self) -> Grading:
        """Curve of passing by mass."""
        return Grading(np.array(self.sizes), np.array(self.passing) / 100)


Sizing = Annotated[UniformSizes | LognormalSizes | ThreeSizes | SieveTable, Field(discriminator="kind")]


class ElementSample(ScenarioTable):
    """Grains in a periodic cell, compressed slowly from a loose state to an isotropic pressure."""

    grains: Annotated[int, Field(ge=20, le=100_000)] = Field(400, description="number of grains")
    dim: Literal[2, 3] = Field(3, description="2: disks in the plane, 3: spheres")
    grading: Sizing = UniformSizes()
    density: Positive = Field(2650.0, description="density of the grains [mass/length^dim]")
    pressure: Positive = Field(
        1e5,
        description="isotropic pressure of the sample; for disks of 1 mm, 100 N/m corresponds to 100 kPa "
        "[force/length^(dim−1)]",
    )
    friction: NotNegative | None = Field(
        None,
        description="friction coefficient during the compression, which controls the density; 0 gives the densest "
        "sample; default: that of the law",
    )

    @model_validator(mode="after")
    def _check_grading(self):
        curve = self.grading.curve()
        require_span(curve.size[0], curve.size[-1])
        off = misfit(curve, self.diameters, self.dim)
        if off > MISFIT:
            raise ValueError(
                f"sample.grains = {self.grains} is too few, as the grading would be off by {off:.0%} of the mass: use "
                f"at least {grains_needed(curve, self.dim)} grains, or a narrower grading"
            )
        return self

    @property
    def diameters(self) -> np.ndarray:
        """Diameters of the grains, (N,), increasing [length]."""
        return diameters(self.grading.curve(), self.grains, self.dim)

    @property
    def masses(self) -> np.ndarray:
        """Masses of the grains, (N,) [mass]."""
        return self.density * (pi / 4 * self.diameters**2 if self.dim == 2 else pi / 6 * self.diameters**3)

    @property
    def area(self) -> float:
        """Mean diameter to the power dim − 1; pressure times this area is the scale of forces [length^(dim−1)]."""
        return float(self.diameters.mean()) ** (self.dim - 1)

    @property
    def width(self) -> float:
        """Width of the cell, estimated before the sample is made [length]."""
        solid = (pi / 4 * self.diameters**2 if self.dim == 2 else pi / 6 * self.diameters**3).sum()
        return float(solid / DENSITY[self.dim]) ** (1 / self.dim)

    @property
    def relative_width(self) -> float:
        """Width of the cell over the smallest width allowed."""
        return self.width / (NARROWEST * float(self.diameters[-1]))


def widest_shear(sample: ElementSample) -> float:
    """Shear strain at which the cell of a sample reaches the smallest width allowed."""
    return sqrt(max(sample.relative_width**2 - 1, 0.0))


@allow_laws(
    "hertz_mindlin_reff", "hertz_mindlin", "linear", coulomb="sharp", kn=None, kt=None, young=None, poisson=None,
    mu=0.5, damping="coeff_restitution", damping_n=0.3, damping_ratio=0.5, lever=None, memory=None, rolling=None,
    k_roll=None, mu_roll=None, gamma_roll=None, twisting=None, k_twist=None, mu_twist=None, gamma_twist=None,
    tension=False, file=None, parameters={}, checksum=None,
)  # fmt: skip
class ElementLaw(LawTable):
    """Contact law. Dashpots bring grains to rest; equilibria do not depend on them."""


class Loading(ScenarioTable):
    """Load path from the isotropic state: strain is imposed in one direction; `kind` determines the others."""

    kind: Literal[
        "isotropic",
        "oedometric",
        "triaxial",
        "constant-p",
        "undrained",
        "plane-strain",
        "true-triaxial",
        "simple-shear",
    ] = Field(
        "triaxial",
        description="isotropic: the pressure changes; oedometric: no lateral strain; triaxial: constant lateral stress "
        "(drained; biaxial for disks); constant-p: constant mean stress; undrained: constant volume, or constant total "
        "lateral stress with a compressible fluid; plane-strain: "
        "constant stress along x, no strain along y; true-triaxial: constant stress along x, and along y the "
        "intermediate stress of `b`; simple-shear: γ along x with gradient y, constant stress along y, no other strain",
    )
    strain: Annotated[tuple[Finite, ...] | Finite, Listed] = Field(
        0.1,
        description="axial strain (γ in simple shear) at which the path ends, or several turning points; strains are "
        "logarithmic, and negative in extension",
    )
    pressures: Annotated[tuple[Positive, ...], Listed] | None = Field(
        None, description="successive turning points of an isotropic path [force/length^(dim−1)]"
    )
    step: Annotated[float, Field(gt=FIRST, le=0.1)] = Field(
        5e-4, description="largest strain step; on an isotropic path, the step of ln p is 100 times this value"
    )
    b: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="(σ₂ − σ₃)/(σ₁ − σ₃) of a true triaxial path"
    )
    fluid_modulus: Positive | None = Field(
        None,
        description="bulk modulus of the enclosed pore fluid, on undrained and isotropic paths; default: "
        "incompressible fluid on undrained paths, no fluid on isotropic ones [force/length^(dim−1)]",
    )
    integrator: Literal["quasi-static", "dynamic"] = Field(
        "quasi-static",
        description="quasi-static: equilibria by Newton's method, or by damped dynamics if grains rearrange, without "
        "a rate; dynamic: motion at a strain rate",
    )
    inertial_number: Positive | None = Field(
        None, description="inertial number of the dynamic integrator; default: 1e-4, unless a rate is given"
    )
    rate: Positive | None = Field(None, description="strain rate, instead of the inertial number [1/time]")

    @property
    def turns(self) -> tuple[float, ...]:
        """Strains or pressures at which the path turns or ends, without its start."""
        if self.kind == "isotropic":
            return self.pressures or ()
        return self.strain if isinstance(self.strain, tuple) else (self.strain,)

    @model_validator(mode="after")
    def _check_kind(self):
        for name, kind in (("pressures", "isotropic"), ("b", "true-triaxial")):
            if (getattr(self, name) is not None) != (self.kind == kind):
                advice = "is missing: give it" if self.kind == kind else f"applies to {kind} paths only: leave it out"
                raise ValueError(f"path.{name} {advice}")
        if self.fluid_modulus is not None and self.kind not in ("undrained", "isotropic"):
            raise ValueError(
                f"path.fluid_modulus does not apply to {self.kind} paths, which are drained: leave it out, or use kind "
                f'= "undrained" or "isotropic"'
            )
        if self.inertial_number is not None and self.rate is not None:
            raise ValueError("path.inertial_number and path.rate exclude each other: give only one")
        if self.integrator == "quasi-static" and (self.inertial_number or self.rate):
            name = "rate" if self.rate else "inertial_number"
            raise ValueError(f'path.{name} does not apply to integrator = "quasi-static": leave it out')
        turns = (0.0, *self.turns) if self.kind != "isotropic" else self.turns
        if not self.turns or any(a == b for a, b in pairwise(turns)):
            raise ValueError(f"each entry of path.strain must differ from the previous one, got {self.strain}")
        return self


class Cement(ScenarioTable):
    """Cement between the grains: parallel bonds of Potyondy & Cundall, formed under the pressure of the sample.

    The cemented sample is then unloaded to the confining pressure of the test.
    """

    tensile_strength: Positive = Field(description="mean tensile strength of the bonds [force/length^(dim−1)]")
    shear_strength: Positive = Field(description="mean shear strength of the bonds [force/length^(dim−1)]")
    scatter: Annotated[float, Field(ge=0, le=0.3)] = Field(
        0.0,
        description="standard deviation of both strengths over their means; the normal distributions are cut off at "
        "three standard deviations",
    )
    modulus: Positive = Field(
        1.0,
        description="Young's modulus of the cement over that of the grains, or over kn/D50^(dim−2) for linear springs",
    )
    stiffness_ratio: Annotated[float, Field(ge=1e-3, le=1e6)] = Field(
        2.5, description="normal over shear stiffness of the bonds"
    )
    radius: Annotated[float, Field(ge=1e-3, le=1)] = Field(
        1.0, description="radius of a bond over that of the smaller grain"
    )
    gap: Annotated[float, Field(ge=0, le=1)] = Field(
        0.01, description="largest gap between bonded grains, over the mean diameter"
    )
    confining: NotNegative = Field(
        0.0,
        description="confining pressure; 0: uniaxial compression, or direct tension with a negative strain "
        "[force/length^(dim−1)]",
    )
    until: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.8, description="ratio of deviatoric stress to its peak at which the path ends, after the peak"
    )


class Probing(ScenarioTable):
    """Small probes of the first sample along its path, which show the directions in which it can fail."""

    strains: Annotated[tuple[Finite, ...], Listed] | None = Field(
        None,
        min_length=1,
        description="strains at which to probe, rounded to the nearest step; none beyond the first turning point",
    )
    states: Annotated[int, Field(ge=1, le=200)] | None = Field(
        None,
        description="number n of probed strains, instead of a list: (k/n)² of the first turning point, k = 1, 2, … n; "
        "default: 8",
    )
    directions: Annotated[int, Field(ge=8, le=3600)] = Field(64, description="directions of the strain, evenly spaced")


class SampleScenario(ScenarioBase):
    """Scenario of tests of samples. Units are SI unless others are named."""

    experiment: str = ""
    seed: Seed = 0
    realizations: Annotated[int, Field(ge=1, le=10_000)] = Field(
        1, description="number of samples, with seeds seed, seed + 1, …"
    )
    sample: ElementSample = ElementSample()
    law: ElementLaw = ElementLaw(young=1e9, poisson=0.2)

    @model_validator(mode="before")
    @classmethod
    def _name_units(cls, tables):
        return tables | {"units": tables.get("units") or "SI"} if isinstance(tables, dict) else tables


class ElementTestScenario(SampleScenario):
    """Complete definition of an element test. Units are SI unless others are named."""

    experiment: Literal["element-test"] = "element-test"
    path: Loading = Loading()
    signs: Literal["compression", "tension"] = Field(
        "compression", description="stresses and strains that are positive in tables and figures"
    )
    check: bool = Field(
        False, description="whether to load the first sample again, with steps (or a rate) half as large"
    )
    probes: Probing | None = None
    cement: Cement | None = None
    engine: Literal["stickslip", "lammps"] = Field(
        "stickslip", description="engine of a dynamic test; samples are always prepared by stickslip"
    )
    ranks: Ranks = Field(1, description="MPI processes of LAMMPS")

    @property
    def sign(self) -> int:
        """Sign of compression in tables and figures."""
        return 1 if self.signs == "compression" else -1

    @property
    def strain_sign(self) -> int:
        """Sign of the imposed strain in tables and figures; γ always has its own sign."""
        return 1 if self.path.kind == "simple-shear" else self.sign

    @property
    def time(self) -> float:
        """Time in which the pressure moves a grain by its diameter: D50 √(density/p) for spheres [time]."""
        s = self.sample
        size = float(s.grading.curve().size_at(0.5))
        return size * sqrt(s.density / s.pressure)

    @property
    def stiffness_number(self) -> float:
        """κ = (E/((1 − ν²) p))^(2/3) for Hertzian spheres, kn/(p D50^(dim−2)) for linear springs; NaN for other laws.

        Overlaps are of the order of D50/κ. For disks, p in the first expression becomes p D50^−1.

        Source
        ------
        Agnolin & Roux, doi:10.1103/PhysRevE.76.061302.
        """
        law, sample = self.law, self.sample
        size, dim = float(sample.grading.curve().size_at(0.5)), sample.dim
        if law.kind == "linear" and law.kn:
            return law.kn / (sample.pressure * size ** (dim - 2))
        if law.young is None or law.poisson is None:
            return float("nan")
        return (law.young * size ** (3 - dim) / (1 - law.poisson**2) / sample.pressure) ** (2 / 3)

    @property
    def contact_modulus(self) -> float | None:
        """Young's modulus of grains, or kn/D50^(dim−2) of linear springs; None for other laws [force/length^(dim−1)].

        For disks it is a force per length, E D50.
        """
        law, dim, size = self.law, self.sample.dim, float(self.sample.grading.curve().size_at(0.5))
        if law.kind == "linear":
            return law.kn and law.kn / size ** (dim - 2)
        return law.young and law.young * size ** (3 - dim)

    @property
    def confining(self) -> float:
        """Isotropic pressure at which the path begins [force/length^(dim−1)]."""
        return self.sample.pressure if self.cement is None else self.cement.confining

    @property
    def stress_scale(self) -> float:
        """Typical stress along the path, to which tolerances refer [force/length^(dim−1)]."""
        cement, pressure = self.cement, self.sample.pressure
        if cement is None:
            return pressure
        return max(pressure, cement.confining, min(cement.tensile_strength, cement.shear_strength))

    @property
    def rate(self) -> float:
        """Strain rate of the dynamic integrator [1/time]."""
        return self.path.rate or (self.path.inertial_number or 1e-4) / self.time

    @model_validator(mode="after")
    def _check_engine(self):
        require_lammps_for_ranks(self.engine, self.ranks)
        if self.engine == "lammps" and self.path.integrator != "dynamic":
            raise ValueError('engine = "lammps" has no quasi-static steps: use integrator = "dynamic"')
        return self

    @property
    def probed_strains(self) -> tuple[float, ...]:
        """Imposed strains at which the first sample is probed."""
        if self.probes is None:
            return ()
        count = self.probes.states or 8
        return self.probes.strains or tuple(self.path.turns[0] * (k / count) ** 2 for k in range(1, count + 1))

    @model_validator(mode="after")
    def _check_probes(self):
        if self.probes is None:
            return self
        if self.path.kind == "isotropic":
            raise ValueError('probes do not apply to path.kind = "isotropic": choose a path with a strain')
        if self.probes.strains is not None and self.probes.states is not None:
            raise ValueError("probes.strains and probes.states exclude each other: give only one")
        turn = self.path.turns[0]
        for strain in self.probes.strains or ():
            if not 0 <= strain / turn <= 1:
                raise ValueError(f"probes.strains must be from 0 to {turn:g}, where the path turns, got {strain:g}")
        return self

    @model_validator(mode="after")
    def _check_cement(self):
        if self.cement is None:
            return self
        if self.path.kind != "triaxial":
            raise ValueError(
                f'cement requires path.kind = "triaxial", which includes uniaxial compression and tension '
                f'(cement.confining = 0), got "{self.path.kind}"'
            )
        if len(self.path.turns) > 1:
            raise ValueError(f"cement requires a single path.strain, beyond failure, got {list(self.path.turns)}")
        if self.path.integrator == "dynamic":
            raise ValueError(
                'cement requires path.integrator = "quasi-static", in which bonds break one by one, got "dynamic"'
            )
        if self.probes is not None:
            raise ValueError("cement and probes exclude each other: probes do not support bonds yet")
        if self.contact_modulus is None:
            raise ValueError(
                "cement.modulus is relative to the modulus of the law, which this law lacks: use law.kind = "
                '"hertz_mindlin_reff" with young, or "linear" with kn'
            )
        return self._check_bonds()

    def _check_bonds(self):
        """Check whether the forces of bonds can be computed.

        Round-off of positions in a cell of N^(1/dim) diameters, times the stiffness, must stay below the unbalanced
        force of an equilibrium. Strengths must be well above that force. Bonds must break before they double their
        length.
        """
        cement, dim, modulus = self.cement, self.sample.dim, self.contact_modulus
        unbalanced, area = BALANCED * self.stress_scale, cement.radius ** (dim - 1)
        weaker = min("tensile_strength", "shear_strength", key=partial(getattr, cement))
        strength = getattr(cement, weaker)
        weakest = RESOLVED * unbalanced
        round_off = 0.5 * np.finfo(float).eps * self.sample.grains ** (1 / dim) * max(1.0, 1 / cement.stiffness_ratio)
        inf, unresolved = float("inf"), "or bonds carry less than the unbalanced forces of equilibria"
        for name, least, most, why in (
            (weaker, weakest, inf, unresolved),
            ("radius", (weakest / strength) ** (1 / (dim - 1)), 1.0, unresolved),
            ("modulus", strength / modulus, inf, f"or bonds with {weaker} = {strength:g} would double their length"),
            ("modulus", 0.0, unbalanced / (round_off * area * modulus), "or round-off prevents an equilibrium"),
        ):
            value, least, most = getattr(cement, name), float(f"{least:.2g}"), float(f"{most:.2g}")
            if not least <= value <= most:
                limit = f"least {least:g}" if value < least else f"most {most:g}"
                raise ValueError(f"cement.{name} must be at {limit} in this test, {why}, got {value:g}")
        return self

    @model_validator(mode="after")
    def _check_dimensions(self):
        if self.sample.dim == 2 and self.path.kind in ("true-triaxial", "plane-strain"):
            raise ValueError(
                f'path.kind = "{self.path.kind}" is not available for disks: use "triaxial", the biaxial test'
            )
        return self

    @model_validator(mode="after")
    def _check_fluid(self):
        most = STIFFEST * self.sample.pressure
        if (self.path.fluid_modulus or 0.0) > most:
            raise ValueError(
                f"path.fluid_modulus must be at most {STIFFEST:g} sample.pressure = {most:g}, beyond which round-off "
                f"of the volume matters, got {self.path.fluid_modulus:g}: leave it out for an incompressible fluid"
            )
        return self

    @model_validator(mode="after")
    def _check_rate(self):
        number = self.rate * self.time
        if self.path.integrator == "dynamic" and number > QUASI_STATIC * (1 + 1e-9):
            name, most = ("rate", QUASI_STATIC / self.time) if self.path.rate else ("inertial_number", QUASI_STATIC)
            given = getattr(self.path, name)
            raise ValueError(
                f"path.{name} = {given:g} gives an inertial number of {number:.2g}, too large for a quasi-static "
                f"test: use at most {most:.2g}"
            )
        return self

    @model_validator(mode="after")
    def _check_width(self):
        kind, sample = self.path.kind, self.sample
        if kind == "isotropic":
            return self
        most = max(map(abs, self.path.turns))
        longest = widest_shear(sample) if kind == "simple-shear" else log(sample.relative_width)
        if most > longest:
            raise ValueError(
                f"at path.strain = {most:g}, the cell of {sample.grains} grains would become narrower than "
                f"{NARROWEST:g} times the largest diameter: use at most {max(longest, 0):.2g}, or more grains"
            )
        return self

    def sizes(self) -> Iterator[Size]:
        """Yield the number of steps of the path."""
        isotropic = self.path.kind == "isotropic"
        turns = tuple(log(p) / LOG_STEP for p in self.path.turns) if isotropic else (0.0, *self.path.turns)
        length = sum(abs(b - a) for a, b in pairwise(turns))
        yield Size("path.strain takes", length / self.path.step, "load steps", "use a larger path.step")
