"""A scenario of rate-and-state friction: a slider on a spring under a history of load."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ...data.schema import Finite, Listed, NotNegative, Part, Positive, Seed, Whole


class Surface(Part):
    """μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c)."""

    law: Literal["aging", "slip"] = Field("slip", description="by which the state θ evolves")
    a: Positive = Field(0.0247, description="direct effect; these three are paper 003's")
    b: NotNegative = Field(0.0178, description="evolution effect")
    dc: Positive = Field(5.3e-3, description="slip over which the state evolves [m]")
    mu0: Finite = Field(0.4, description="steady friction at v0")
    v0: Positive = Field(0.02, description="at which steady friction is mu0 [m/s]")
    alpha: NotNegative = Field(
        0.0, description="of Linker and Dieterich: how changes of normal stress act on the state"
    )


class Drive(Part):
    """The spring between load point and slider."""

    stiffness: Positive = Field(200.0, description="friction per displacement [1/m]")
    damping: NotNegative = Field(0.0, description="radiation damping over normal stress; 0 is quasi-static [s/m]")


class Stretch(Part):
    """One leg of the load point: its velocity, and how long or how far."""

    velocity: NotNegative = Field(description="0 is a hold [m/s]")
    duration: Positive | None = Field(None, description="of the leg [s]")
    distance: Positive | None = Field(None, description="of the load point, in place of duration [m]")
    normal: Positive = Field(1.0, description="normal stress over its reference")

    @model_validator(mode="after")
    def _one_length(self):
        if (self.duration is None) == (self.distance is None):
            raise ValueError("a leg needs either duration or distance: give one of them")
        if self.velocity == 0 and self.duration is None:
            raise ValueError("a leg with velocity 0 (a hold) has no distance: give its duration")
        return self

    @property
    def time(self) -> float:
        """How long it lasts [s]."""
        return self.duration if self.duration is not None else self.distance / self.velocity


class Samples(Part):
    """What is recorded."""

    number: Annotated[int, Field(ge=10, le=100_000)] = Field(150, description="for each leg, the first ones closer")
    noise: NotNegative = Field(0.0, description="standard deviation of noise added to the recorded friction")
    correlation: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="of the noise of neighbouring samples")


class RateStateScenario(Whole):
    """Everything that defines the history of a slider with rate-and-state friction."""

    si: ClassVar[bool] = True
    experiment: Literal["rate-state"] = "rate-state"
    seed: Seed = 0
    surface: Surface = Surface()
    spring: Drive = Drive()
    legs: Annotated[tuple[Stretch, ...], Listed, Field(min_length=1, max_length=1000)] = (
        Stretch(velocity=0.02, distance=0.02),
        Stretch(velocity=0.1, distance=0.05),
        Stretch(velocity=0.02, distance=0.05),
    )
    samples: Samples = Samples()

    @model_validator(mode="after")
    def _starts(self):
        if self.legs[0].velocity == 0:
            raise ValueError("the first leg is a hold: start with a leg of positive velocity, where sliding is steady")
        if self.surface.alpha > 0 and self.surface.b == 0:
            raise ValueError("surface.alpha acts through the state: give surface.b > 0, or leave alpha out")
        return self
