"""Tables of a scenario for laws and packings: sets of keys, of which each experiment takes some.

Experiments have their own defaults of laws.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar, get_args

from pydantic import Field, model_validator

from ..builtin_laws import BY_NAME
from ..core.laws.builtin import DAMPING, DASHPOTS, MOMENTS, ROLLING, TWISTING
from ..core.laws.properties import MODELS
from ..core.units import in_si
from .law_file import LawFile
from .schema import NotNegative, Positive, ScenarioTable, Several, split_unit

OWN_PARAMETERS = {p.name for law in BY_NAME.values() for p in law.parameters}
_ROLL, _TWIST = ({name: f"{text} [{unit}]" for name, (unit, text) in MOMENTS[k].items()} for k in (ROLLING, TWISTING))
NEEDED = {"rolling": MODELS, "twisting": {"spring": ("k_twist", "mu_twist"), "marshall": ()}}  # coefficients, by model
TAKEN = {"rolling": {**MODELS, "spring": (*_ROLL,)}, "twisting": {"spring": (*_TWIST,), "marshall": ()}}
SUBSTRATE = 1  # material of the wall; disks are material 0


class Parameters(ScenarioTable):
    """Parameters of disk–wall contacts, if different from those between disks."""

    kn: Positive | None = Field(None, description="as `law.kn`")
    kt: NotNegative | None = Field(None, description="as `law.kt`")
    mu: NotNegative | None = Field(None, description="as `law.mu`")
    damping_n: NotNegative | None = Field(None, description="as `law.damping_n`")
    damping_t: NotNegative | None = Field(None, description="as `law.damping_t`")


class LawTable(LawFile):
    """Contact law: stiffness from k_n and k_t or elastic constants, damping from coefficients or a restitution."""

    kind: str = Field("", description="name of the law")
    coulomb: Literal["smooth", "sharp"] = Field("sharp", description="how F_t approaches the Coulomb limit μ F_n")
    kn: Positive | None = Field(None, description="k_n, in a unit that depends on `kind`")
    kt: NotNegative | None = Field(None, description="k_t, as `kn`; if it has no value, 2/7 of `kn`")
    young: Positive | None = Field(None, description="E, which determines k_n and k_t, with `poisson` [stress]")
    poisson: Annotated[float, Field(gt=-1, le=0.5)] | None = Field(None, description="ν")
    mu: NotNegative = Field(0.5, description="friction coefficient between grains")
    damping: Literal["velocity", "mass_velocity", "viscoelastic", "tsuji", "coeff_restitution"] | None = Field(
        None,
        description="what γ multiplies; if it has no value, viscoelastic for hertz_mindlin_reff, else mass_velocity",
    )
    damping_n: NotNegative | None = Field(
        None,
        description="γ_n of the normal dashpot, in a unit that depends on `damping`; coefficient of restitution with "
        "tsuji and coeff_restitution",
    )
    damping_t: NotNegative | None = Field(None, description="γ_t of the tangential dashpot, as `damping_n`")
    damping_ratio: NotNegative | None = Field(
        None, description="γ_t/γ_n, instead of `damping_t`; if neither has a value, 1/2 with a restitution, otherwise 0"
    )
    restitution: Annotated[float, Field(gt=0, le=1)] | None = Field(
        None, description="coefficient of restitution of two equal grains, instead of damping coefficients"
    )
    reading: Literal["eq8", "collision"] | None = Field(
        None,
        description="conversion of the restitution to γ_n: eq8, by Eq 8 of Ferdowsi & Rubin 2021 as printed; "
        "collision, such that a collision under this law has the given restitution",
    )
    size: Positive | None = Field(None, description="diameter of the two grains [length]")
    speed: Positive | None = Field(
        None, description="speed of their collision; not needed by a linear law [length/time]"
    )
    work: NotNegative | None = Field(None, description="work of adhesion of jkr and dmt [energy/length^2]")
    k_unload: Positive | None = Field(
        None, description="stiffness of walton_braun as the overlap decreases [force/length]"
    )
    surface_tension: NotNegative | None = Field(None, description="of the liquid of liquid_bridge [force/length]")
    volume: NotNegative | None = Field(None, description="of a bridge of liquid_bridge [length^3]")
    lever: Literal["radius", "overlap"] | None = Field(
        None, description="lever arms of tangential forces: radius, R, also if it has no value; overlap, R − δ/2"
    )
    memory: Literal["slip", "force"] | None = Field(
        None, description="memory of contacts: slip, also if it has no value; force, as in LAMMPS mindlin/force"
    )
    rolling: Literal["constant", "viscous", "spring"] | None = Field(
        None, description="model of a moment that resists rolling; without a value, there is none"
    )
    k_roll: Positive | None = Field(None, description=_ROLL["k_roll"])
    mu_roll: NotNegative | None = Field(None, description=_ROLL["mu_roll"])
    gamma_roll: NotNegative | None = Field(None, description=_ROLL["gamma_roll"])
    twisting: Literal["spring", "marshall"] | None = Field(
        None, description="model of a moment that resists twisting; without a value, there is none"
    )
    k_twist: Positive | None = Field(None, description=_TWIST["k_twist"])
    mu_twist: NotNegative | None = Field(None, description=_TWIST["mu_twist"])
    gamma_twist: NotNegative | None = Field(None, description=_TWIST["gamma_twist"])
    tension: bool = Field(True, description="whether dashpots may make contact forces attractive")
    wall: Parameters | None = None

    @model_validator(mode="after")
    def _check_moments(self):
        for key, names in (("rolling", _ROLL), ("twisting", _TWIST)):
            model = getattr(self, key)
            given = [name for name in names if getattr(self, name) is not None]
            missing = [name for name in NEEDED[key].get(model, ()) if not getattr(self, name)]
            extra = [name for name in given if name not in TAKEN[key].get(model, ())]
            if missing:
                raise ValueError(f"law.{missing[0]} is missing or zero: law.{key} = {model!r} needs it")
            if extra and model is None:
                raise ValueError(f"law.{extra[0]} was given without law.{key}: give both or neither")
            if extra:
                raise ValueError(f"law.{extra[0]} was given with law.{key} = {model!r}, which has none: leave it out")
        return self

    @property
    def dashpots(self) -> str:
        """Dashpots of the law: those of `damping`, or else those that its kind has."""
        return self.damping or BY_NAME[self.kind].damping

    @model_validator(mode="after")
    def _check_parameters(self):
        if self.file is not None:
            return self
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        own = [p.name for p in BY_NAME[self.kind].parameters]
        for name in sorted({*own} ^ {*given} & OWN_PARAMETERS):
            remedy = (
                "is missing: give it" if name in own else f"was given: it is no parameter of {self.kind}, leave it out"
            )
            raise ValueError(f"law.{name} {remedy}")
        elastic = [name for name in ("young", "poisson") if name in given]
        plain = [name for name in ("kn", "kt") if name in given]
        if elastic and plain:
            raise ValueError(
                f"law.{elastic[0]} and law.{plain[0]} were both given: give young and poisson, or kn and kt"
            )
        if len(elastic) == 1:
            raise ValueError(f"law.{elastic[0]} was given alone: give young and poisson")
        if elastic and not BY_NAME[self.kind].uses_radius:
            raise ValueError(f'law.young was given with law.kind = {self.kind!r}: use kind = "hertz_mindlin_reff"')
        if not elastic and self.kn is None:
            raise ValueError("law.kn is missing: give it, or young and poisson")
        if "damping_t" in given and "damping_ratio" in given:
            raise ValueError("law.damping_t and law.damping_ratio were both given: give only one of them")
        if self.restitution is None:
            for name in ("reading", "size", "speed"):
                if name in given:
                    raise ValueError(f"law.{name} was given without law.restitution: give both or neither")
        elif "damping_n" in given or "damping_t" in given:
            raise ValueError("law.restitution and damping coefficients were both given: give only one of them")
        elif self.restitution < 1 and self.kind != "linear" and self.speed is None:
            raise ValueError(
                f"law.restitution was given without law.speed, on which that of a {self.kind} law depends: also give "
                f"law.speed"
            )
        return self


if TYPE_CHECKING:
    Table = TypeVar("Table", bound=type[LawTable])


def allow_laws(*kinds: str, si: bool = False, **defaults) -> "Callable[[Table], Table]":
    """Restrict a law table to some laws, the first of which is the default, and to some keys with their defaults.

    Descriptions name the laws, and the units of the default law; in SI units with `si`.
    """

    def restrict(table: "Table") -> "Table":
        fields, usual = table.model_fields, BY_NAME[kinds[0]]
        for name in fields.keys() - defaults.keys() - {"kind"}:
            setattr(table, name, fields.pop(name).default)
        fields["kind"].annotation = Literal[kinds]
        for name, default in {"kind": kinds[0], **defaults}.items():
            fields[name].default = default
            if default is not None and type(None) in get_args(fields[name].annotation):
                fields[name].annotation = get_args(fields[name].annotation)[0]
        fields["kind"].description = "; ".join(f"{name}: {BY_NAME[name].words}" for name in dict.fromkeys(kinds))
        stiffness, dashpot = usual.stiffness_unit, DASHPOTS[DAMPING[defaults.get("damping") or usual.damping]][0]
        units = {"kn": stiffness, "kt": stiffness, "damping_n": dashpot, "damping_t": dashpot}
        for name, field in fields.items():
            text, unit = split_unit(field.description)
            unit = units.get(name, unit)
            field.description = f"{text} [{in_si(unit) if si else unit}]" if unit else text
        table.model_rebuild(force=True)
        return table

    return restrict


@allow_laws(
    "hertz_mindlin", "linear", coulomb="smooth", kn=1.0, kt=2 / 7, mu=10.0, damping="velocity", damping_n=0.0,
    damping_t=0.0, tension=True, wall=Parameters(), file=None, parameters={}, checksum=None,
)  # fmt: skip
class PackingLaw(LawTable):
    """Contact law and its parameters."""


def renamed_keys(law: dict) -> dict:
    """Law table of a finished run with the present names of its keys, which were others in gouge before version 0.3."""
    if "gamma_n" not in law:
        return law
    kind = "hertz_mindlin_reff" + ("_rescaled" if law.get("rescaled") else "")
    old = {"gamma_n", "rescaled"}
    return {"kind": kind, "damping_n": law["gamma_n"]} | {key: law[key] for key in law if key not in old}


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
