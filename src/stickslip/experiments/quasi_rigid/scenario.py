"""A scenario of quasi-rigid loading: disks between walls or in a periodic cell, by path and by slow dynamics."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ...data.schema import Listed, NotNegative, Part, Positive, Seed, Whole

Size = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
Times = Annotated[tuple[Positive, ...], Listed]
Radii = Annotated[tuple[Positive, ...], Listed, Field(min_length=1)]


class Disks(Part):
    """Disks that are brought to rest under a pressure, with friction."""

    number: Annotated[int, Field(ge=10, le=5000)] = Field(100, description="of disks")
    radius: Radii = Field((0.4, 0.6), description="sizes of equally many disks each [length]; masses are 4 R²")
    pressure: Positive = Field(1e-4, description="over kn the typical overlap in diameters [force/length]")


class Springs(Part):
    """The law `linear` with sharp friction."""

    kn: Positive = Field(1.0, description="K_n [force/length]")
    kt: Positive = Field(0.5, description="K_t [force/length]")
    mu: NotNegative = Field(0.5, description="friction between disks, and with walls")


class Loading(Part):
    """What grows, linearly: the force on one wall, or the shear stress of a periodic cell."""

    test: Literal["biaxial", "shear"] = Field("biaxial", description="between walls, or in a periodic cell")
    wall: Literal["top", "right"] = Field("top", description="whose force grows (biaxial)")
    factor: Annotated[float, Field(gt=1, le=100)] = Field(4.0, description="to which the wall's force grows (biaxial)")
    ratio: Annotated[float, Field(gt=0, le=10)] = Field(
        1.0, description="of shear stress to pressure at the end (shear)"
    )
    unload: bool = Field(
        False, description="whether the load goes back, from `turn` of the load at which the path ends"
    )
    turn: Annotated[float, Field(gt=0, lt=1)] = Field(0.5, description="where unloading begins, see `unload`")
    increment: Size = Field(0.005, description="of the load, as a share; the geometry is updated after each")
    geometric: bool = Field(True, description="whether the geometric stiffness enters")


class Slow(Part):
    """Dynamics of the same sample under the same load."""

    times: Times = Field((3e4, 1e5, 3e5), description="that the whole load takes, one run each; [] for none [time]")
    drag: NotNegative = Field(0.02, description="of translations and rotations, beside the law's dashpots [1/time]")
    beyond: Annotated[float, Field(ge=0, le=1)] = Field(
        0.1, description="how far past the path's end, as a share of it"
    )


class QuasiScenario(Whole):
    """Everything that defines a quasi-rigid loading and the dynamics beside it."""

    experiment: Literal["quasi-rigid"] = "quasi-rigid"
    seed: Seed = 0
    samples: Annotated[int, Field(ge=1, le=100)] = Field(1, description="packings, prepared from seed, seed + 1, …")
    disks: Disks = Disks()
    law: Springs = Springs()
    loading: Loading = Loading()
    dynamics: Slow = Slow()

    @model_validator(mode="after")
    def _soft_enough(self):
        overlap = self.disks.pressure / self.law.kn
        if not overlap <= 0.01:
            raise ValueError(
                f"disks.pressure / law.kn = {overlap:g} was given: quasi-rigid grains overlap little, use at most 0.01"
            )
        if self.law.mu == 0:
            raise ValueError("law.mu = 0 was given: without friction no contact slides or sticks; use a positive mu")
        return self
