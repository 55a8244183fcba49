"""Scenario of the quasi-static shear of a packing."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ....kit import (
    STATE,
    Duration,
    Loads,
    Packing,
    PackingLaw,
    Positive,
    ScenarioBase,
    ScenarioTable,
    Seed,
    Several,
    Size,
)


class Shear(ScenarioTable):
    """Quasi-static simple shear along x with gradient y."""

    strain: Loads = Field((0.0, 2e-3, 0.02), description="turning points of the strain path")
    step: Several = Field((2e-5, 1e-4), description="largest strain step: one value, or one for each leg of the path")
    slip: bool = Field(True, description="whether the affine displacement contributes to the slip of the contacts")
    tolerance: Positive | None = Field(
        None,
        description="largest unbalanced force, or torque over R, at equilibrium; default: 5e-14 kn d^(3/2) under "
        "Hertz's law, with the smallest diameter d [force]",
    )
    on_instability: Literal["tell", "follow-dynamics", "stop"] = Field(
        "tell",
        description="reaction to a step that ends at an unstable equilibrium or on another branch: count it, follow "
        "damped dynamics, or end the path",
    )
    drag: Positive | None = Field(
        None,
        description="drag of damped dynamics, required by follow-dynamics; if given, only pairs that grow despite it "
        "count as unstable [1/time]",
    )

    @model_validator(mode="after")
    def _check_path(self):
        if self.on_instability == "follow-dynamics" and self.drag is None:
            raise ValueError(
                "shear.on_instability = 'follow-dynamics' requires shear.drag, on which the growth of oscillations "
                "depends"
            )
        if len(self.strain) < 2 or self.strain[0] != 0.0:
            raise ValueError("shear.strain needs at least two turning points, the first of them 0.0, as in [0.0, 0.02]")
        legs = len(self.strain) - 1
        if len(self.steps) != legs:
            raise ValueError(f"shear.step has {len(self.steps)} entries for {legs} legs: give one or {legs}")
        return self

    @property
    def steps(self) -> tuple[float, ...]:
        """Strain step of each leg."""
        return self.step if isinstance(self.step, tuple) else (self.step,) * (len(self.strain) - 1)


class Release(ScenarioTable):
    """Newtonian runs from unstable states: one with a single complex pair, and the last state of the path."""

    e_folds: Positive = Field(45.0, description="duration of a run in units of 1/(growth rate)")
    least: Duration = Field(5e4, description="minimum duration, to include the time after fast growth [time]")
    duration: Duration = Field(6e5, description="maximum duration [time]")
    dt: Positive = Field(0.1, description="time step [time]")
    seed_velocity: Positive = Field(
        1e-13, description="root mean square of the random initial velocities [length/time]"
    )
    snapshots: Annotated[int, Field(ge=0, le=1000)] = Field(40, description="number of spectra computed during a run")


class ShearScenario(ScenarioBase):
    """Complete definition of the quasi-static shear of a packing and its failure."""

    experiment: Literal["sphere-shear"] = "sphere-shear"
    seed: Seed = 0
    packings: Annotated[int, Field(ge=1, le=1000)] = Field(5, description="independent packings")
    packing: Packing = Packing()
    law: PackingLaw = PackingLaw()
    shear: Shear = Shear()
    release: Release = Release()

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: strain steps, memory of the states along a path, and time steps of a run."""
        shear, release = self.shear, self.release
        steps = sum(abs(b - a) / d for (a, b), d in zip(pairwise(shear.strain), shear.steps, strict=True))
        yield Size("shear takes", steps, "load steps", "use a larger shear.step")
        yield Size("states along a path take", STATE * self.packing.grains * steps, "bytes", "use a larger shear.step")
        yield Size("release.duration takes", release.duration / release.dt, "time steps", "use a longer release.dt")
