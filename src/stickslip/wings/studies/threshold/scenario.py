"""Scenario of the kinetic threshold of a sample: an array of disks, a periodic packing, or gouge between plates.

For every sample, the load is the macroscopic friction, shear force over normal force.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from ....kit import Listed, NotNegative, PackingLaw, Positive, ScenarioBase, ScenarioTable, Seed, Size
from ...papers.disk_array.scenario import Array, DiskArrayScenario, Relaxation
from ...papers.gouge.scenario import (
    GougeCell,
    GougeGrains,
    GougeLaw,
    GougeLoad,
    GougeScenario,
    Preparation,
    Settling,
    Slide,
)
from ...papers.sphere_shear.scenario import Packing

LEGS_AT_LEAST = 40  # smallest number of time steps of a run


def _list_of_numbers(name: str, example: str) -> BeforeValidator:
    def require_list(value):
        if not isinstance(value, list | tuple) or not value:
            raise ValueError(f"{name} must be a list of one or more numbers, such as {example}, got {value!r}")
        return value

    return BeforeValidator(require_list)


class ArraySample(Array):
    """Row of disks on a substrate; the load is the push on one disk over the normal force on all disks."""

    kind: Literal["disk-array"] = "disk-array"
    press: Positive = Field(5e-5, description="force on every disk, towards the substrate [force]")
    disk: Annotated[int, Field(ge=1)] = Field(1, description="number of the pushed disk, counted from 1")
    law: PackingLaw = PackingLaw()
    relaxation: Relaxation = Relaxation()

    def recipe(self, top: float, step: float) -> DiskArrayScenario:
        """Scenario of the quasi-static path up to a load, with forces in units of the normal force on all disks."""
        return DiskArrayScenario(
            array=Array(**self.model_dump(include=set(Array.model_fields))), law=self.law, relaxation=self.relaxation,
            load={"unit": self.press * self.disks, "press": 1 / self.disks, "push": (0.0, top), "step": step,
                  "disk": self.disk},
            dynamics={"loads": ()},
        )  # fmt: skip

    @model_validator(mode="after")
    def _check_sample(self):
        self.recipe(1.0, 1.0)
        return self


class PackingSample(Packing):
    """Packing in a periodic box under a constant stress along y; the load is the shear stress −σ_xy over σ_yy.

    The height and the shear along x follow the stress; the other dimensions are fixed.
    """

    kind: Literal["packing"] = "packing"
    law: PackingLaw = PackingLaw()


class GougeSample(ScenarioTable):
    """Spheres between two rough plates; the load is the shear force on the upper plate over the normal force."""

    kind: Literal["gouge"] = "gouge"
    grains: GougeGrains = GougeGrains()
    law: GougeLaw
    cell: GougeCell = GougeCell()
    normal_stress: Positive = Field(5e6, description="normal stress σ [Pa]")
    preparation: Settling = Settling()
    dt: Positive = Field(1e-7, description="time step of the preparation [s]")

    @property
    def recipe(self) -> GougeScenario:
        """Scenario of the gouge experiment that prepares the sample, without further tests."""
        later = Preparation(velocity=self.grains.mean / self.dt * 1e-6, **self.preparation.model_dump())
        return GougeScenario(
            grains=self.grains, law=self.law, cell=self.cell, load=GougeLoad(normal_stress=self.normal_stress),
            preparation=later, dt=self.dt, sample_every=1, protocol=(Slide(velocity=0.0, time=1e3 * self.dt),),
        )  # fmt: skip

    @model_validator(mode="after")
    def _check_sample(self):
        self.recipe  # noqa: B018 - raises ValueError
        return self


Sample = Annotated[ArraySample | PackingSample | GougeSample, Field(discriminator="kind")]


class Raise(ScenarioTable):
    """Quasi-static path on which the load rises from zero until the sample slides; this load is its static strength."""

    loads: Annotated[tuple[NotNegative, ...], Listed, _list_of_numbers("load.loads", "[0.03, 0.04]")] = Field(
        (0.03, 0.04, 0.0425, 0.045, 0.0475, 0.05, 0.055, 0.06, 0.083),
        min_length=1,
        description="loads (shear force over normal force) at which the sample is kicked",
    )
    step: Positive = Field(1e-3, description="largest increment of the load between two equilibria")

    @field_validator("loads")
    @classmethod
    def _check_loads(cls, value):
        if list(value) != sorted(set(value)):
            raise ValueError(f"load.loads must increase, got {list(value)}: sort them")
        return value


class Kicks(ScenarioTable):
    """Runs that start from equilibria with random velocities; the load on samples that slide is then lowered."""

    velocities: Annotated[tuple[NotNegative, ...], Listed, _list_of_numbers("kicks.velocities", "[1e-13, 1e-4]")] = (
        Field((1e-13, 1e-4), min_length=1, description="root mean square of the initial velocities [length/time]")
    )
    realizations: Annotated[int, Field(ge=1, le=100_000)] = Field(
        10, description="runs at each load and velocity, which differ in their random numbers"
    )
    duration: Positive = Field(
        40_000.0, description="duration of a run; a sliding sample continues for the same duration once more [time]"
    )
    dt: Positive | None = Field(None, description="time step; default: a fifth of the largest stable one [time]")
    drag: NotNegative = Field(0.0, description="drag on translations and rotations per unit mass [1/time]")
    distance: Positive = Field(
        0.1,
        description=(
            "distance after which a sample counts as sliding: shear strain of a packing; displacement of the upper "
            "plate of gouge, or median displacement of an array, in mean diameters; sliding is lasting if a quarter "
            "of this distance follows in each quarter of a further duration"
        ),
    )
    ramp_down: bool = Field(True, description="whether to lower the load on sliding samples until they stop")
    ramps: Annotated[int, Field(ge=1, le=1000)] = Field(
        3, description="largest number of sliding samples whose load is lowered"
    )

    @field_validator("velocities")
    @classmethod
    def _check_velocities(cls, value):
        if len(set(value)) < len(value):
            raise ValueError(f"kicks.velocities must be distinct, got {list(value)}")
        return value

    @model_validator(mode="after")
    def _check_time_step(self):
        if self.dt is not None and not LEGS_AT_LEAST * self.dt <= self.duration:
            raise ValueError(
                f"kicks.dt = {self.dt:g} is too large for runs of {self.duration:g}, which need at least "
                f"{LEGS_AT_LEAST} steps"
            )
        return self


class ThresholdScenario(ScenarioBase):
    """Complete definition of a study of the static and the kinetic friction of a sample."""

    experiment: Literal["threshold"] = "threshold"
    seed: Seed = 0
    sample: Sample = ArraySample()
    load: Raise = Raise()
    kicks: Kicks = Kicks()

    def sizes(self) -> Iterator[Size]:
        """Yield the numbers of load steps, runs, and time steps per run."""
        load, kicks = self.load, self.kicks
        runs = len(load.loads) * len(kicks.velocities) * kicks.realizations
        yield Size("load takes", load.loads[-1] / load.step, "load steps", "use a larger load.step")
        yield Size("load.loads, kicks.velocities and kicks.realizations make", runs, "runs", "use fewer realisations")
        if kicks.dt is not None:
            yield Size("kicks.duration takes", kicks.duration / kicks.dt, "time steps", "use a longer kicks.dt")
