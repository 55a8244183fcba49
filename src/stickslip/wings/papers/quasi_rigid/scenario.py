"""Scenario of quasi-rigid loading: disks between walls or in a periodic cell, loaded by path and slow dynamics."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ....kit import STATE, LawTable, Listed, NotNegative, Positive, ScenarioBase, ScenarioTable, Seed, Size, allow_laws

Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
Times = Annotated[tuple[Positive, ...], Listed]
Radii = Annotated[tuple[Positive, ...], Listed, Field(min_length=1)]


class Disks(ScenarioTable):
    """Disks with friction, brought to rest under a pressure."""

    number: Annotated[int, Field(ge=10, le=5000)] = Field(100, description="number of disks")
    radius: Radii = Field((0.4, 0.6), description="radii, each for an equal number of disks; masses are 4 R² [length]")
    pressure: Positive = Field(
        1e-4, description="pressure; the typical overlap is pressure/kn diameters [force/length]"
    )


@allow_laws("linear", kn=1.0, kt=0.5, mu=0.5)
class SpringLaw(LawTable):
    """Linear springs with sharp friction, between disks and between disks and walls."""


class Loading(ScenarioTable):
    """Linearly growing load: the force on one wall, or the shear stress of a periodic cell."""

    test: Literal["biaxial", "shear"] = Field(
        "biaxial", description="biaxial: between walls; shear: in a periodic cell"
    )
    wall: Literal["top", "right"] = Field("top", description="wall whose force grows (biaxial)")
    factor: Annotated[float, Field(gt=1, le=100)] = Field(
        4.0, description="final force on the wall over its initial force (biaxial)"
    )
    ratio: Annotated[float, Field(gt=0, le=10)] = Field(
        1.0, description="final ratio of shear stress to pressure (shear)"
    )
    machine: Positive | None = Field(
        None,
        description="stiffness of a machine that displaces the wall; default: the force on the wall "
        "grows (biaxial) [force/length]",
    )
    strain: Annotated[float, Field(gt=0, le=0.3)] | None = Field(
        None, description="final travel of the machine over the initial distance of the walls; default: 0.01"
    )
    collapses: bool = Field(
        False,
        description="whether to follow collapses by dynamics with the drag `dynamics.drag` to the next equilibrium, "
        "and to continue the path there",
    )
    unload: bool = Field(
        False, description="whether to unload, starting from the fraction `turn` of the load at which the path ends"
    )
    turn: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.5, description="fraction of the final load of the path at which unloading begins; see `unload`"
    )
    increment: Share = Field(
        0.005,
        description="load increment as a fraction of the whole load; the geometry is updated after each increment",
    )
    geometric: bool = Field(True, description="whether to include the geometric stiffness")


class Slow(ScenarioTable):
    """Dynamics of the same sample under the same load."""

    times: Times = Field(
        (3e4, 1e5, 3e5), description="durations in which the whole load is applied, one run each; []: no runs [time]"
    )
    drag: NotNegative = Field(
        0.02, description="drag on translations and rotations, in addition to the law's dashpots [1/time]"
    )
    beyond: Annotated[float, Field(ge=0, le=1)] = Field(
        0.1, description="continuation of runs beyond the final load of the path, as a fraction of that load"
    )


class QuasiScenario(ScenarioBase):
    """Complete definition of quasi-rigid loading and of the slow dynamics compared with it."""

    experiment: Literal["quasi-rigid"] = "quasi-rigid"
    seed: Seed = 0
    samples: Annotated[int, Field(ge=1, le=100)] = Field(1, description="packings, prepared from seed, seed + 1, …")
    disks: Disks = Disks()
    law: SpringLaw = SpringLaw()
    loading: Loading = Loading()
    dynamics: Slow = Slow()

    @property
    def dim(self) -> int:
        """Number of dimensions: two."""
        return 2

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: load increments, and memory of the states along a path."""
        steps = 1 / self.loading.increment
        yield Size("loading.increment makes", steps, "load steps", "use a larger increment")
        memory = STATE * self.disks.number * steps
        yield Size("states along a path take", memory, "bytes", "use a larger loading.increment")

    @model_validator(mode="after")
    def _check_loading(self):
        if self.loading.collapses and not self.dynamics.drag:
            raise ValueError("loading.collapses = true requires dynamics.drag > 0, as drag brings a collapse to rest")
        if self.loading.strain and not self.loading.machine:
            raise ValueError(
                f"loading.strain = {self.loading.strain:g} requires loading.machine, the stiffness of the machine "
                "that imposes it"
            )
        if self.loading.machine and self.loading.test == "shear":
            raise ValueError(
                'loading.machine moves a wall and does not apply to test = "shear": use test = "biaxial", or leave it '
                "out"
            )
        return self

    @model_validator(mode="after")
    def _check_law(self):
        overlap = self.disks.pressure / self.law.kn
        if not overlap <= 0.01:
            raise ValueError(
                "disks.pressure / law.kn must be at most 0.01, as quasi-rigid grains overlap only slightly, got "
                f"{overlap:g}"
            )
        for name in ("mu", "kt"):
            if getattr(self.law, name) == 0:
                raise ValueError(f"law.{name} must be positive, as no contact slides or sticks without friction")
        return self
