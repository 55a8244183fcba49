"""Scenario of fault gouge: polydisperse spheres between two rough plates, sheared through a spring, in SI units.

x is the direction of shear, y that of the normal stress, and z the transverse direction; the cell is periodic along x
and z. Values stated in Ferdowsi & Rubin 2021 are marked as such. All others are choices, each with a separate key.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ....kit import (
    LIMITS,
    STATE,
    LawTable,
    Listed,
    NotNegative,
    Positive,
    Ranks,
    ScenarioBase,
    ScenarioTable,
    Seed,
    Several,
    Size,
    Sized,
    allow_laws,
    require_lammps_for_ranks,
)

Share = Annotated[float, Field(gt=0, lt=1)]
Number = Annotated[int, Field(ge=1)]
Many = Annotated[tuple[Positive, ...], Listed, Field(min_length=1)]
MOST = LIMITS["grains"]
LEAST = 8  # minimum number of samples of a leg, for a mean with an error
FASTEST = 1e7  # number of grain-steps per second and process, for a cost estimate before the start


class GougeGrains(ScenarioTable):
    """Spheres with diameters distributed uniformly between two sizes."""

    number: Annotated[int, Field(ge=20, le=MOST)] = Field(500, description="approximate number of mobile grains")
    diameter: Annotated[tuple[Positive, Positive], Listed] = Field(
        (2e-3, 4e-3), description="smallest and largest diameter [m]"
    )
    density: Positive = Field(2500.0, description="density of the grains; Ferdowsi & Rubin 2021, Table S1 [kg/m³]")

    @model_validator(mode="after")
    def _check_diameter(self):
        low, high = self.diameter
        if not low <= high <= 5 * low:
            raise ValueError(
                "grains.diameter must be the smallest and the largest diameter, with a ratio of at most five, got "
                f"[{low:g}, {high:g}]"
            )
        return self

    @property
    def mean(self) -> float:
        """Mean diameter D [m]."""
        return sum(self.diameter) / 2


@allow_laws(
    "hertz_mindlin_reff", "hertz_mindlin_reff_rescaled", young=50e9, poisson=0.3, mu=0.5, damping_n=None,
    damping_ratio=0.5, restitution=None, reading=None, size=None, speed=None, tension=True, lever=None, memory=None,
    rolling=None, k_roll=None, mu_roll=None, gamma_roll=None, twisting=None, k_twist=None, mu_twist=None,
    gamma_twist=None, si=True,
)  # fmt: skip
class GougeLaw(LawTable):
    """Hertz–Mindlin law with √(δ R_eff) and sharp Coulomb friction, with Eqs 1–2 and defaults of Ferdowsi & Rubin 2021.

    The normal dashpot is set either by `damping_n`, or by a `restitution` with the `reading` that converts it to γ_n
    and the `size` and `speed` of the collision. The two readings differ by a factor of thousands.
    """

    @model_validator(mode="after")
    def _check_damping(self):
        if self.restitution is None and self.damping_n is None:
            raise ValueError(
                "law has no damping: give damping_n [1/(m s)], or restitution with reading, size and speed"
            )
        lacking = [name for name in ("reading", "size", "speed") if getattr(self, name) is None]
        if self.restitution is not None and lacking:
            raise ValueError(
                f"law.restitution requires law.{lacking[0]}: give reading ('eq8' or 'collision'), size and speed of "
                "the collision, or damping_n instead"
            )
        return self

    @model_validator(mode="after")
    def _check_eq8(self):
        if self.reading != "eq8" or self.restitution == 1:
            return self
        if abs(3 * self.damping_ratio - 1) < 1e-9:
            raise ValueError(
                f"law.reading = 'eq8' has no solution for restitution = {self.restitution:g} with damping_ratio = 1/3, "
                f"where Eq 8 dissipates nothing: give another ratio, or damping_n"
            )
        if not 0 < abs(self.poisson) < 0.5:
            raise ValueError(
                f"law.reading = 'eq8' has no solution for poisson = {self.poisson:g}, where A is zero or infinite: "
                f"give another value between 0 and 1/2, or damping_n"
            )
        return self


class GougeCell(ScenarioTable):
    """Cell that is periodic along x and z, with the height required by the grains."""

    length: Positive = Field(0.03, description="length along x; Ferdowsi & Rubin 2021: 20 D, reduced scale: 10 D [m]")
    width: Positive = Field(0.018, description="width along z [m]")
    coverage: Share = Field(
        0.8, description="area of the glued grains over that of the plate; 0.8 is typical of a layer at a flat wall"
    )
    plate_mass: Annotated[float, Field(ge=1, le=1e4)] = Field(
        1.0, description="mass of the upper plate over that of its grains; not stated in Ferdowsi & Rubin 2021"
    )


class GougeLoad(ScenarioTable):
    """Normal stress on the upper plate, and the spring that pulls it along x."""

    normal_stress: Positive = Field(5e6, description="normal stress σ; Ferdowsi & Rubin 2021 [Pa]")
    stiffness: Positive = Field(4.3, description="stiffness of the spring, in terms of `definition`")
    definition: Literal["per_area", "per_stress", "grain", "rate_state"] = Field(
        "grain",
        description=(
            "meaning of `stiffness`: per_area, k [Pa/m]; per_stress, k/σ [1/m]; grain, k D/σ; rate_state, k dc/(b σ). "
            "Ferdowsi & Rubin 2021 state 425 without a definition; as rate_state, with their b and dc, this is 4.3 as "
            "grain"
        ),
    )


class RateState(ScenarioTable):
    """Rate-and-state parameters that normalise stiffness and hold times; defaults are from Ferdowsi & Rubin 2021."""

    a: Positive = Field(0.0247, description="direct effect")
    b: Positive = Field(0.0178, description="evolution effect")
    dc: Positive = Field(5.3e-3, description="slip over which the state evolves [m]")


class Settling(ScenarioTable):
    """Preparation of a sample at rest; each stage ends when its criterion is met, or fails after `most` steps."""

    approach: Positive = Field(5.0, description="velocity of the upper wall until it carries the normal stress [m/s]")
    drag: NotNegative = Field(
        1.0, description="drag on grains and plate while settling, in 1/√(m/(P D)) of a mean grain; none afterwards"
    )
    unbalanced: Positive = Field(
        1e-2, description="mean unbalanced force over mean contact force below which the sample is settled"
    )
    most: Positive = Field(1e5, description="maximum number of steps for settling")


class Preparation(Settling):
    """Preparation of a steadily sliding sample; a stage ends when its criterion is met, or fails after `most` steps."""

    velocity: Positive = Field(0.3, description="velocity of the load point until sliding is steady [m/s]")
    slip: Positive = Field(
        8.0, description="minimum slip before steadiness is checked; before that, friction is at its peak [D]"
    )
    window: Positive = Field(2.0, description="slip over which friction is averaged [D]")
    change: Positive = Field(
        0.02,
        description=("steady: friction in two successive windows differs by at most this value or the standard error"),
    )
    longest: Positive = Field(40.0, description="slip after which the preparation fails if sliding is not steady [D]")
    steady: bool = Field(True, description="whether to slide until friction is steady; false: exactly `slip`")


class Slide(ScenarioTable):
    """Slide of the load point at one velocity (0 for a hold), for a given slip or time, or until it is steady."""

    kind: Literal["slide"] = "slide"
    velocity: NotNegative = Field(description="velocity of the load point; 0 is a hold [m/s]")
    slip: Positive | None = Field(None, description="slip of the load point [D]")
    time: Positive | None = Field(None, description="duration, instead of a slip [s]")
    steady: bool = Field(
        False, description="whether to slide until steady as in the preparation; `slip` is then the maximum"
    )

    branches: ClassVar[int] = 0

    @property
    def starts(self) -> tuple[float, ...]:
        """Velocities of the trunk, one after another."""
        return (self.velocity,)

    def trunk(self, velocity: float, size: float) -> list[float]:
        """Duration of each leg of the trunk [s]; `size` is D [m]."""
        return [self.time if self.time is not None else self.slip * size / velocity]

    def branch(self, velocity: float, size: float) -> list[float]:
        """Return an empty list, as no tests branch off."""
        return []

    @model_validator(mode="after")
    def _check_end(self):
        ends = (self.slip is not None) + (self.time is not None)
        if ends != 1:
            raise ValueError(
                "a slide ends after a given slip or a given time: give only one, which must be slip if steady = true"
            )
        if self.velocity == 0 and self.time is None:
            raise ValueError("a slide at velocity = 0 never reaches a given slip: give its time instead")
        if self.steady and self.slip is None:
            raise ValueError("a slide with steady = true needs a maximum slip: give slip")
        return self


class Branching(ScenarioTable):
    """Tests that start from copies of the states along one steady slide."""

    branches: Number = Field(1, description="number of states from which the test starts, each in its own process")
    spacing: Annotated[float, Field(ge=0.1), Sized] = Field(
        0.7, description="slip between these states; friction is correlated over 0.1 to 0.35 D [D]"
    )
    twin: NotNegative = Field(
        0.0,
        description=(
            "slip over which a copy continues as before; the difference between a test and its copy is free of the "
            "fluctuations that they share [D]"
        ),
    )

    def trunk(self, velocity: float, size: float) -> list[float]:
        """Durations of the trunk's slides, each of which leads to one of the states [s]; `size` is D [m]."""
        return [slip * size / velocity for slip in (self.first, *[self.spacing] * (self.branches - 1))]


class VelocitySteps(Branching):
    """Sequence of velocities; tests branch off the slide at the first velocity."""

    kind: Literal["velocity-steps"] = "velocity-steps"
    velocities: Many = Field(description="velocities of the load point, one after another [m/s]")
    slip: Several = Field(description="slip of the load point at each velocity, or one value for all [D]")

    @model_validator(mode="after")
    def _check_slips(self):
        if isinstance(self.slip, tuple) and len(self.slip) != len(self.velocities):
            raise ValueError(
                f"slip must be one value, or one for each of the {len(self.velocities)} velocities, got "
                f"{len(self.slip)}"
            )
        return self

    @property
    def slips(self) -> tuple[float, ...]:
        """Slip of the load point at each velocity [D]."""
        return self.slip if isinstance(self.slip, tuple) else (self.slip,) * len(self.velocities)

    @property
    def starts(self) -> tuple[float, ...]:
        """Velocities of the trunk, one after another."""
        return self.velocities[:1]

    @property
    def first(self) -> float:
        """Slip of the trunk up to the first state [D]."""
        return self.slips[0]

    def branch(self, velocity: float, size: float) -> list[float]:
        """Duration of each leg of one branch [s]; `size` is D [m]."""
        twins = [self.twin * size / v for v in self.velocities[:-1] if self.twin]
        return [*(slip * size / v for v, slip in zip(self.velocities[1:], self.slips[1:], strict=True)), *twins]


class SlideHoldSlide(Branching):
    """Slide at each velocity in `before`, hold, and slide again at each velocity in `after` after each hold time.

    A single hold, as long as the longest hold time, serves for all times. Slides start from copies of its states.
    """

    kind: Literal["slide-hold-slide"] = "slide-hold-slide"
    before: Many = Field(description="velocities before the hold [m/s]")
    holds: Many = Field(description="hold times [s]")
    after: Annotated[tuple[Positive, ...], Listed] | None = Field(
        None, description="velocities after the hold; default: the velocity before it; []: no slides follow [m/s]"
    )
    approach: Positive = Field(2.0, description="slip at each velocity before the first hold [D]")
    slip: Positive = Field(2.0, description="slip of the load point after each hold [D]")

    def reslides(self, before: float) -> tuple[float, ...]:
        """Velocities after each hold [m/s]."""
        return (before,) if self.after is None else self.after

    @property
    def starts(self) -> tuple[float, ...]:
        """Velocities of the trunk, one after another."""
        return self.before

    @property
    def first(self) -> float:
        """Slip of the trunk up to the first state [D]."""
        return self.approach

    def branch(self, velocity: float, size: float) -> list[float]:
        """Duration of each leg of one branch [s]; `size` is D [m]."""
        twin = [self.twin * size / velocity] if self.twin else []
        return [max(self.holds), *twin, *[self.slip * size / w for w in self.reslides(velocity)] * len(self.holds)]


Protocol = Annotated[Slide | VelocitySteps | SlideHoldSlide, Field(discriminator="kind")]


class GougeScenario(ScenarioBase):
    """Complete definition of an experiment on fault gouge."""

    si: ClassVar[bool] = True
    experiment: Literal["gouge"] = "gouge"
    seed: Seed = 0
    realizations: Annotated[int, Field(ge=1, le=1000)] = Field(
        1, description="number of samples, with seeds seed, seed + 1, …"
    )
    engine: Literal["stickslip", "lammps"] = Field(
        "stickslip", description="engine that runs the protocol after the preparation"
    )
    ranks: Ranks = Field(1, description="MPI processes of LAMMPS, for each realisation")
    grains: GougeGrains = GougeGrains()
    law: GougeLaw
    cell: GougeCell = GougeCell()
    load: GougeLoad = GougeLoad()
    scales: RateState = RateState()
    preparation: Preparation = Preparation()
    protocol: Annotated[tuple[Protocol, ...], Listed, Field(min_length=1)]
    dt: Positive = Field(
        1e-7,
        description="time step; Ferdowsi & Rubin 2021: 2e-8, 1/100 of a collision time of their smallest grains [s]",
    )
    sample_every: Number = Field(500, description="number of steps between samples")
    slip_threshold: Annotated[float, Field(ge=1, le=1e6)] = Field(
        10.0,
        description=(
            "ratio of the velocity of the upper plate to that of the load point from which the motion in a slide "
            "counts as a slip event of stick–slip"
        ),
    )
    ledger_steps: Annotated[int, Field(ge=0, le=10_000_000)] = Field(
        0, description="steps with an energy ledger after the protocol; each takes as long as ten ordinary steps"
    )
    most_steps: Positive = Field(5e7, description="maximum number of steps of one realisation")

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: grains, branches, memory of their states, and samples."""
        yield Size(
            "cell.length and cell.width make plates of",
            self.plate_grains,
            "grains",
            "use a smaller cell or larger grains",
        )
        branches = sum(part.branches * len(part.starts) for part in self.protocol)
        yield Size("the protocol makes", branches, "branches", "use fewer in each of its entries")
        memory = STATE * (self.grains.number + 2 * self.plate_grains) * branches
        yield Size("states at the branches take", memory, "bytes", "use fewer branches or grains")
        if self.steps <= self.most_steps:  # beyond this limit of time steps, a message estimates the computing time
            yield Size("sample_every makes", self.steps / self.sample_every, "samples", "use a larger one")

    @model_validator(mode="after")
    def _check_engine(self):
        require_lammps_for_ranks(self.engine, self.ranks)
        return self

    @model_validator(mode="after")
    def _check_cell(self):
        largest = self.grains.diameter[1]
        for name in ("length", "width"):
            if getattr(self.cell, name) < 4 * largest:
                raise ValueError(
                    f"cell.{name} must be at least {4 * largest:g} for grains of diameter {largest:g} to stay clear "
                    f"of their periodic images, got {getattr(self.cell, name):g}"
                )
        return self

    @model_validator(mode="after")
    def _check_cost(self):
        if self.steps > self.most_steps:
            raise ValueError(
                f"a realisation takes about {self.steps:.2g} steps of dt = {self.dt:g}, more than most_steps = "
                f"{self.most_steps:.2g} ({self.expected_cost}): raise velocities, shorten holds and slips, use softer "
                f"grains (law.young) with a longer dt, or raise most_steps"
            )
        return self

    @model_validator(mode="after")
    def _check_time_step(self):
        if self.dt > self.longest_step:
            raise ValueError(
                f"dt = {self.dt:g} is unstable for contacts of the smallest grains under this stress, whose limit is "
                f"about {self.longest_step:.2g}: use about {0.2 * self.longest_step:.1g}, or softer grains (law.young)"
            )
        return self

    @model_validator(mode="after")
    def _check_sampling(self):
        size, chosen = self.grains.mean, self.preparation
        least = max(chosen.slip, 2 * chosen.window)
        if chosen.steady and chosen.longest < least:
            raise ValueError(
                f"preparation.longest must be at least slip plus two windows, {least:g}, got {chosen.longest:g}"
            )
        name = "preparation.window" if chosen.steady else "preparation.slip"
        legs = {name: (chosen.window if chosen.steady else chosen.slip) * size / chosen.velocity}
        for number, part in enumerate(self.protocol, start=1):
            name = f"protocol entry {number}"
            legs[name] = min(min([*part.trunk(v, size), *part.branch(v, size)]) for v in part.starts)
            if part.kind == "slide-hold-slide":
                marks = [round(hold / self.interval) for hold in sorted(part.holds)]
                if marks[0] < 2 or marks[-1] < LEAST or any(b <= a for a, b in pairwise(marks)):
                    raise ValueError(
                        f"{name}: holds must last at least two samples and differ by at least one sample, "
                        f"{self.interval:.2g} s, and the longest must last at least {LEAST} samples, got "
                        f"{list(part.holds)}: lower sample_every"
                    )
            if part.kind == "slide" and part.steady:
                legs[f"{name}, its window"] = chosen.window * size / part.velocity
                if part.slip < 2 * chosen.window:
                    raise ValueError(
                        f"{name}: slip must be at least two windows, {2 * chosen.window:g}, to judge steadiness, got "
                        f"{part.slip:g}"
                    )
        for name, seconds in legs.items():
            if seconds < LEAST * self.interval * (1 - 1e-9):
                raise ValueError(
                    f"the shortest leg of {name} takes {seconds:.2g} s, fewer than {LEAST} samples of "
                    f"{self.interval:.2g} s: lower sample_every or use a longer slip"
                )
        return self

    @property
    def interval(self) -> float:
        """Time between samples [s]."""
        return self.sample_every * self.dt

    @property
    def longest_step(self) -> float:
        """Approximate largest stable time step [s].

        It is 2/√12 times √(m/k) for one of the smallest grains, pressed by six grains of the same size, each with a
        force of σ d².
        """
        d, kn = self.grains.diameter[0], 2 / 3 * self.law.young / (1 - self.law.poisson**2)
        root, force = (d / 4) ** 0.5, self.load.normal_stress * d * d
        stiffness = 1.5 * kn * root * (force / (kn * root)) ** (1 / 3)
        return 0.58 * (self.grains.density * pi / 6 * d**3 / stiffness) ** 0.5

    @property
    def area(self) -> float:
        """Area of a plate [m²]."""
        return self.cell.length * self.cell.width

    @property
    def plate_grains(self) -> int:
        """Number of grains whose total area covers the requested share of one plate."""
        low, high = (d / 2 for d in self.grains.diameter)
        number = self.cell.coverage * self.area / (pi * (low * low + low * high + high * high) / 3)
        return max(4, round(min(number, 1e18)))

    @property
    def trunk_duration(self) -> float:
        """Duration of the trunk: the slides from which tests branch off, and the shortest possible preparation [s]."""
        size = self.grains.mean
        preparation = self.preparation.slip * size / self.preparation.velocity
        return preparation + sum(sum(part.trunk(v, size)) for part in self.protocol for v in part.starts)

    @property
    def duration(self) -> float:
        """Simulated time of one realisation with all its branches [s]."""
        size = self.grains.mean
        return self.trunk_duration + sum(
            part.branches * sum(part.branch(v, size)) for part in self.protocol for v in part.starts
        )

    @property
    def steps(self) -> float:
        """Approximate number of time steps of one realisation."""
        return self.duration / self.dt

    @property
    def expected_cost(self) -> str:
        """Approximate computing time of a realisation, as text."""
        return self.estimate_cost(self.duration)

    @property
    def longest_hold(self) -> float:
        """Longest hold of the load point in one leg; 0 if there are no holds [s]."""
        holds = [max(part.holds) for part in self.protocol if part.kind == "slide-hold-slide"]
        return max([*holds, *(p.time for p in self.protocol if p.kind == "slide" and p.velocity == 0)], default=0.0)

    def estimate_cost(self, duration: float) -> str:
        """Approximate time that one core needs to simulate a given duration [s], as text."""
        seconds = duration / self.dt * (self.grains.number + 2 * self.plate_grains) / FASTEST
        for size, unit in ((86400, "days"), (3600, "hours"), (60, "minutes")):
            if seconds >= 2 * size:
                return f"about {seconds / size:.2g} {unit} on one core"
        return f"about {seconds:.2g} seconds on one core"
