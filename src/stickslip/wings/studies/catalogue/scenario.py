"""Scenario of an event catalogue: packings sheared quasi-statically until enough events are found."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ....kit import Packing, PackingLaw, Positive, ScenarioBase, ScenarioTable, Seed, Size


class EventShear(ScenarioTable):
    """Quasi-static simple shear along x with the gradient along y, and the search for discontinuities."""

    drag: Positive = Field(
        description=(
            "drag of the dynamics between the last stable state and the end of an event, over the largest frequency "
            "of the packing (2/dt for its largest stable step dt); there is no default, because the drag determines "
            "which oscillations are unstable"
        )
    )
    strain: Positive = Field(0.4, description="largest strain of each packing")
    step: Positive = Field(4e-4, description="strain step between events")
    resolution: Positive = Field(1e-6, description="width of the bracket around the strain of an event")
    window: Positive = Field(
        4e-4, description="strain within which an event must follow a warning for the warning to count as correct"
    )

    @model_validator(mode="after")
    def _check_lengths(self):
        if self.resolution >= self.step:
            raise ValueError(
                f"shear.resolution must be smaller than shear.step = {self.step:g}, got {self.resolution:g}"
            )
        if self.step > self.strain:
            raise ValueError(f"shear.step must be at most the largest strain, {self.strain:g}, got {self.step:g}")
        if self.window < self.step * (1 - 1e-9):
            raise ValueError(
                f"shear.window must be at least shear.step = {self.step:g}, or events between steps would be missed, "
                f"got {self.window:g}"
            )
        return self


class CatalogueScenario(ScenarioBase):
    """Complete definition of a catalogue of events."""

    experiment: Literal["catalogue"] = "catalogue"
    seed: Seed = 0
    events: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        20, description="number of events after which no further packing is sheared; the current one is completed"
    )
    packings: Annotated[int, Field(ge=1, le=100_000)] = Field(
        100, description="largest number of packings, with seeds seed, seed + 1, …"
    )
    packing: Packing = Packing(grains=50, dim=2, packing_fraction=0.845)
    law: PackingLaw = PackingLaw()
    shear: EventShear

    def sizes(self) -> Iterator[Size]:
        """Yield the number of strain steps of a packing."""
        steps = self.shear.strain / self.shear.step
        yield Size("the shear of a packing takes", steps, "load steps", "use a larger shear.step")

    @model_validator(mode="before")
    @classmethod
    def _name_missing_drag(cls, tables):
        """Add an empty table [shear] if it is missing, so that the error message names shear.drag."""
        return {"shear": {}} | tables if isinstance(tables, dict) else tables
