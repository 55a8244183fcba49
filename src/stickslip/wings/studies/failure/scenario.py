"""Scenario for the failure of a packing from a file; `stickslip shear` creates one from its options."""

from typing import Literal

from pydantic import Field

from ....kit import BY_NAME, Finite, LawFile, LawOrFile, NotNegative, Positive, ScenarioBase, ScenarioTable


class Input(ScenarioTable):
    """Packing, as `ss.io.read_packing` reads it."""

    file: str = Field(description="packing in any format, or the folder of a LAMMPS run; relative to the scenario")
    frame: str | None = Field(None, description="state to read from an archive, GSD file or dump")
    contacts: str | None = Field(
        None, description="`dump local` with the contact forces, or a table of measured forces"
    )
    columns: str | None = Field(None, description="names of the columns of a table in `contacts`")
    boundary: str | None = Field(None, description="boundaries as in LAMMPS, if the file does not specify them")
    atom_style: str | None = Field(None, description="`sphere`, if a data file does not state its atom style")
    i0: Positive | None = Field(None, description="I0 in the moment of inertia I0 m R²")
    settle: bool = Field(False, description="whether the packing is first brought to rest under its law")
    digest: str | None = Field(
        None, description="digest of the packing, added by `stickslip shear`; a packing with another digest is rejected"
    )


class InputLaw(LawOrFile):
    """Law of the packing, required if its file has none; keys that are missing here are taken from the file."""

    kind: Literal[*BY_NAME] | None = Field(None, description="name of a built-in law")
    coulomb: Literal["smooth", "sharp"] | None = Field(None, description="transition of F_t to the Coulomb limit")
    kn: Positive | None = Field(None, description="normal stiffness k_n, in a unit that depends on `kind`")
    kt: NotNegative | None = Field(None, description="tangential stiffness k_t, in the unit of `kn`")
    mu: NotNegative | None = Field(None, description="friction coefficient")
    young: Positive | None = Field(None, description="Young's modulus E, instead of `kn` and `kt` [stress]")
    poisson: Finite | None = Field(None, description="Poisson's ratio ν")
    damping: str | None = Field(None, description="model of the dashpots")
    damping_n: NotNegative | None = Field(None, description="coefficient γ_n of the normal dashpot")
    damping_t: NotNegative | None = Field(None, description="coefficient γ_t of the tangential dashpot")
    more: dict[str, Finite] = Field({}, description="parameters that only this law has, such as `work` of jkr")
    file: str | None = LawFile.model_fields["file"]
    parameters: dict[str, Finite] = LawFile.model_fields["parameters"]
    checksum: str | None = LawFile.model_fields["checksum"]


class Until(ScenarioTable):
    """Loading of the packing, and the end of the path."""

    until: Literal["first-pair", "first-event", "first-break"] | Finite = Field(
        "first-event",
        description="end of the path: first pair, first event, first break of a bond, or a strain (negative to shear "
        "back or unload)",
    )
    mode: Literal["simple", "pure", "isotropic", "uniaxial"] = Field(
        "simple", description="simple: shear γ along x; pure: γ = ln(Lx/Ly); isotropic: ε = −ln V; uniaxial: ε = −ln Ly"
    )
    reverse: bool = Field(False, description="whether the strain decreases, if `until` is not a strain")
    step: Positive | None = Field(
        None, description="largest strain step; default: 0.02 times the mean overlap over the mean diameter"
    )
    limit: Positive | None = Field(
        None, description="strain at which the path ends without an instability; default: 500 steps"
    )
    drag: Positive | None = Field(
        None,
        description="drag of the dynamics that determine events; default: a tenth of the highest frequency [1/time]",
    )


class FailureScenario(ScenarioBase):
    """Complete definition of the failure of a packing."""

    experiment: Literal["failure"] = "failure"
    packing: Input
    law: InputLaw = InputLaw()
    shear: Until = Until()
