"""Table of a scenario that describes a jammed packing."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema import Positive, ScenarioTable, Several


class Packing(ScenarioTable):
    """Frictionless jammed packing of disks (dim = 2) or spheres (dim = 3) in a periodic box."""

    grains: Annotated[int, Field(ge=10, le=1600)] = Field(100, description="number of grains")
    dim: Literal[2, 3] = Field(3, description="2: disks in the plane, 3: spheres")
    radius: Several = Field(
        (0.5, 0.7), description="one radius, several shared by equal numbers of grains, or one for each grain [length]"
    )
    mass: Positive = Field(1.0, description="mass of every grain [mass]")
    i0: Positive | None = Field(
        None, description="I0 in the moment of inertia I0 m R²; default: 2/5 for spheres, 1/2 for disks"
    )
    packing_fraction: Annotated[float, Field(gt=0, le=1.2, allow_inf_nan=False)] | None = Field(
        None, description="packing fraction; default without a pressure: 0.68 for spheres, 0.86 for disks"
    )
    pressure: Positive | None = Field(
        None, description="pressure, instead of a packing fraction [force/length^(dim−1)]"
    )

    @model_validator(mode="after")
    def _check_packing(self):
        if self.packing_fraction is not None and self.pressure is not None:
            raise ValueError("packing.packing_fraction and packing.pressure were both given: give only one of them")
        if isinstance(self.radius, tuple) and len(self.radius) > self.grains:
            raise ValueError(
                f"packing.radius has {len(self.radius)} entries for {self.grains} grains: give at most {self.grains}"
            )
        return self
