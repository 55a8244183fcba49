"""Scenario of rate-and-state friction: a spring-slider under a load history."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ....kit import Finite, Listed, NotNegative, Positive, ScenarioBase, ScenarioTable, Seed, Size
from ..friction.laws import EvolutionLaw, Form, RateState


class Surface(ScenarioTable):
    """Friction of the surface: μ = μ0 + a ln(V/V0) + b ln(V0 θ/D_c), or a variant."""

    law: EvolutionLaw = Field("slip", description="evolution law of the state θ")
    a: Positive = Field(0.0247, description="direct effect; defaults of a, b and dc are those of Ferdowsi & Rubin 2021")
    b: NotNegative = Field(0.0178, description="evolution effect")
    dc: Positive = Field(5.3e-3, description="characteristic slip of the state evolution [m]")
    mu0: Finite = Field(0.4, description="steady-state friction at v0")
    v0: Positive = Field(0.02, description="velocity at which steady-state friction is mu0 [m/s]")
    alpha: NotNegative = Field(0.0, description="effect of normal-stress changes on the state (Linker and Dieterich)")
    form: Form = Field(
        "logarithmic", description="dependence of friction on velocity: logarithmic, or regularized at rest by arcsinh"
    )
    b2: NotNegative = Field(0.0, description="evolution effect of a second state; 0: one state")
    dc2: Positive = Field(0.1, description="characteristic slip of the second state [m]")
    v1: Positive | None = Field(None, description="cut-off velocity of the direct effect; default: none [m/s]")
    v2: Positive | None = Field(None, description="cut-off velocity of the evolution effect; default: none [m/s]")

    @property
    def rate_state(self) -> RateState:
        """Rate-and-state parameters of the surface."""
        given = {name: value for name, value in self.model_dump().items() if value is not None}
        return RateState(**given)


class Drive(ScenarioTable):
    """The spring between load point and slider."""

    stiffness: Positive = Field(200.0, description="stiffness: friction per displacement [1/m]")
    damping: NotNegative = Field(0.0, description="radiation damping over normal stress; 0: quasi-static [s/m]")


class Stretch(ScenarioTable):
    """One leg of the load point: its velocity, and its duration or distance."""

    velocity: NotNegative = Field(description="velocity; 0 is a hold [m/s]")
    duration: Positive | None = Field(None, description="duration of the leg [s]")
    distance: Positive | None = Field(None, description="distance moved by the load point, instead of duration [m]")
    normal: Positive = Field(1.0, description="normal stress over its reference value")

    @model_validator(mode="after")
    def _check_length(self):
        if (self.duration is None) == (self.distance is None):
            raise ValueError("a leg needs either duration or distance: give exactly one of them")
        if self.velocity == 0 and self.duration is None:
            raise ValueError("a leg with velocity 0 (a hold) has no distance: give its duration")
        return self

    @property
    def time(self) -> float:
        """Duration [s]."""
        return self.duration if self.duration is not None else self.distance / self.velocity


class Samples(ScenarioTable):
    """Recorded samples."""

    number: Annotated[int, Field(ge=10, le=100_000)] = Field(
        150, description="number of samples in each leg; they are closer together at the beginning of the leg"
    )
    noise: NotNegative = Field(0.0, description="standard deviation of noise added to the recorded friction")
    correlation: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.0, description="correlation between the noise of neighbouring samples"
    )


class RateStateScenario(ScenarioBase):
    """Complete definition of the history of a slider with rate-and-state friction."""

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

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: the number of samples."""
        number = self.samples.number * len(self.legs)
        yield Size("samples.number and legs make", number, "samples", "use fewer samples or legs")

    @model_validator(mode="after")
    def _check_start(self):
        if self.legs[0].velocity == 0:
            raise ValueError("the first leg is a hold: start with a leg of steady sliding at positive velocity")
        self.surface.rate_state.check_entries()
        return self
