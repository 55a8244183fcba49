"""Scenario of cyclic shear: samples of element tests, and cycles of the shear strain at several amplitudes."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ....kit import Listed, Positive, ScenarioTable, Size
from ..element_test.scenario import NARROWEST, ElementLaw, SampleScenario, widest_shear

SMALLEST = 1e-8  # smallest amplitude; its stress is about 1e-6 of the pressure, and equilibria are accurate to 1e-9


class Cycles(ScenarioTable):
    """Cycles γ = γ₀ sin θ of the shear strain (along x, gradient along y), in steps between equilibria."""

    amplitudes: Annotated[tuple[Positive, ...], Listed] = Field(
        (1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3), min_length=1, description="amplitudes γ₀ of the strain, increasing"
    )
    number: Annotated[int, Field(ge=1, le=10_000)] = Field(3, description="number of cycles at each amplitude")
    steps: Annotated[int, Field(ge=12, le=100_000, multiple_of=4)] = Field(
        40, description="number of steps in a cycle, evenly spaced in θ; a multiple of 4"
    )
    normal: Literal["constant-volume", "constant-stress"] = Field(
        "constant-volume",
        description="constant-volume: the cell is only sheared; constant-stress: its height changes so that the stress "
        "along y stays equal to the pressure of the sample",
    )
    start: Literal["sample", "previous"] = Field(
        "sample", description="start of each amplitude: the prepared sample, or the end of the previous amplitude"
    )

    @model_validator(mode="after")
    def _check_amplitudes(self):
        if any(a >= b for a, b in pairwise(self.amplitudes)):
            raise ValueError(f"cycles.amplitudes must increase, got {list(self.amplitudes)}: sort them")
        if self.amplitudes[0] < SMALLEST:
            raise ValueError(
                f"cycles.amplitudes must be at least {SMALLEST:g}, or stresses would be below round-off, got "
                f"{self.amplitudes[0]:g}"
            )
        return self


class CyclicShearScenario(SampleScenario):
    """Complete definition of cyclic shear of samples. Units are SI unless others are named."""

    experiment: Literal["cyclic-shear"] = "cyclic-shear"
    law: ElementLaw = ElementLaw(young=70e9, poisson=0.2)
    cycles: Cycles = Cycles()
    check: bool = Field(False, description="whether to shear the first sample again, in twice as many steps")

    @model_validator(mode="after")
    def _check_width(self):
        most, longest = self.cycles.amplitudes[-1], widest_shear(self.sample)
        if most > longest:
            raise ValueError(
                f"at cycles.amplitudes = {most:g}, the cell of {self.sample.grains} grains would become narrower than "
                f"{NARROWEST:g} times the largest diameter: use at most {longest:.2g}, or more grains"
            )
        return self

    def sizes(self) -> Iterator[Size]:
        """Yield the number of load steps in all cycles."""
        count = len(self.cycles.amplitudes) * self.cycles.number * self.cycles.steps
        yield Size("cycles.amplitudes, number and steps require", count, "load steps", "use fewer of them")
