"""Scenario tables for laws and packings: sets of keys from which each experiment selects.

Experiments have their own default laws.

A law can be a Python file, that is, a program, and scenarios may come from untrusted sources. Reading a scenario
therefore executes nothing: it stores the checksum of the file, so a resumed run notices a change. The file is
executed only when a run builds its law, and only if this user has allowed its present text. Digests of allowed texts
are in the user's cache folder, where the author of a scenario cannot write.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import Field, create_model, model_serializer, model_validator

from ..builtin_laws import BUILTIN_LAWS, BY_NAME
from ..core.laws.builtin import DAMPING, DASHPOTS, MOMENTS, ROLLING, TWISTING, Law
from ..core.laws.compiled import FORCES, law_struct
from ..core.laws.properties import ARMS, MEMORIES, MODELS, TWISTINGS
from ..core.laws.user import from_text
from ..core.text import read_text
from ..core.units import in_si
from ..extras import cache_folder
from .schema import Finite, NotNegative, Positive, ScenarioError, ScenarioTable, Several, split_unit, validate_scenario

CHECKED = 16  # number of digits of a digest that form the checksum of a file
TRUSTED = "trusted_laws.txt"  # file in the user's cache folder with the SHA-256 of every text that may be executed


class LawOrFile(ScenarioTable):
    """Law table that may name a file if its class has the keys of `LawFile`."""

    @model_validator(mode="before")
    @classmethod
    def _of_a_file(cls, given):
        if "file" not in cls.model_fields:
            return given
        if not isinstance(given, dict) or given.get("file") is None:
            if isinstance(given, dict) and {"parameters", "checksum"} & set(given):
                raise ValueError("law.parameters requires law.file: name the file, or give kn, kt, mu …")
            return given
        others = [name for name in given if name not in ("file", "parameters", "checksum", "wall")]
        if others:
            raise ValueError(
                f"law.{others[0]} does not apply with law.file: set the parameters of the file in law.parameters"
            )
        return _with_checksum(given)

    @model_serializer(mode="wrap")
    def _serialise_given_fields(self, handler):
        """Omit fields that were not given; a scenario without a file keeps the text and digest of earlier versions."""
        out = handler(self)
        if self.file is None:
            return {k: v for k, v in out.items() if k not in LawFile.model_fields}
        return {k: v for k, v in out.items() if k in (*LawFile.model_fields, "wall")}


class LawFile(LawOrFile):
    """A law in a Python file, instead of a kind and its parameters."""

    file: str | None = Field(
        None,
        description="Python file with a contact law, relative to the scenario; it is executed only if allowed by "
        "`--trust`",
    )
    parameters: dict[str, Finite] = Field({}, description="parameters that differ from the defaults in the file")
    checksum: str | None = Field(None, description="checksum of the file; added automatically")


def _read(path: Path) -> str:
    if not path.is_file():
        raise ScenarioError(f"law.file = {path} is not a file: give a Python file with a function normal_force")
    return read_text(path, remedy="give a Python file")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _with_checksum(law: dict) -> dict:
    """Law table to which the checksum of its file is added, if there is a file and the checksum is missing."""
    if not isinstance(law.get("file"), str) or "checksum" in law:
        return law
    path = Path(law["file"]).absolute()
    return law | {"file": str(path), "checksum": _digest(_read(path))[:CHECKED]}


def with_laws(tables: dict, change: Callable[[dict], dict]) -> dict:
    """Scenario tables in which every table `law`, at the top level or in a table `sample`, is changed."""
    out = dict(tables)
    if isinstance(tables.get("law"), dict):
        out["law"] = change(tables["law"])
    if isinstance(tables.get("sample"), dict):
        out["sample"] = with_laws(tables["sample"], change)
    return out


def with_checksums(tables: dict) -> dict:
    """Add the checksums of law files to the tables of a scenario; nothing is executed."""
    return with_laws(tables, _with_checksum)


def trust_law_files(tables: dict) -> None:
    """Allow this user's runs to execute the present texts of the law files that a scenario names."""

    def trust(law: dict) -> dict:
        if isinstance(law.get("file"), str) and not _is_trusted(text := _read(Path(law["file"]))):
            with (cache_folder() / TRUSTED).open("a", encoding="ascii") as file:
                file.write(f"{_digest(text)}\n")
        return law

    with_laws(with_checksums(tables), trust)


def _is_trusted(text: str) -> bool:
    path = cache_folder() / TRUSTED
    return path.is_file() and _digest(text) in path.read_text(encoding="ascii", errors="replace").split()


def check_law_files(tables: dict) -> None:
    """Build and compile the laws that a scenario names, before anything is written.

    Raises
    ------
    ScenarioError
        As in `load_law`. Errors in the file raise ValueError, as in `laws.from_file`.
    """

    def check(law: dict) -> dict:
        if law.get("file") is not None:
            choice = {k: v for k, v in law.items() if k in LawFile.model_fields}
            law_struct(load_law(validate_scenario(LawFile, **choice)), members=FORCES)
        return law

    with_laws(tables, check)


def load_law(choice: LawFile) -> Law:
    """Load the law from the file that a scenario names.

    Raises
    ------
    ScenarioError
        If the file is missing, has changed since the scenario was read, or may not be executed.
    """
    path = Path(choice.file)
    if not path.is_file():
        raise ScenarioError(f"law.file = {choice.file} no longer exists: restore it, or name another file")
    text = _read(path)
    if _digest(text)[:CHECKED] != choice.checksum:
        raise ScenarioError(f"law.file = {choice.file} has changed since the run began: restore it, or start a new run")
    if not _is_trusted(text):
        raise ScenarioError(
            f"law.file = {choice.file} is a Python program that you have not allowed to run: read it, then add --trust "
            f"(in Python, trust=True)"
        )
    return from_text(text, path, choice.parameters)


OWN_PARAMETERS = {p.name: p for law in BUILTIN_LAWS for p in law.parameters}
_ROLL, _TWIST = MOMENTS[ROLLING], MOMENTS[TWISTING]
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


class Key(NamedTuple):
    """Properties of a key of law tables."""

    kind: Any  # annotation of its values; None is also allowed where it is the default
    words: str | None  # description, with the unit in brackets at the end
    default: Any = None  # value in tables without this key


def _own_key(name: str) -> Key:
    laws = ", ".join(law.name for law in BUILTIN_LAWS if name in (p.name for p in law.parameters))
    one = OWN_PARAMETERS[name]
    return Key(Positive if one.positive else NotNegative, f"{one.words} ({laws}) [{one.unit}]")


def _moment_keys(part: int, stiffness: str) -> dict[str, Key]:
    parts = MOMENTS[part].items()
    return {
        name: Key(Positive if name == stiffness else NotNegative, f"{text} [{unit}]") for name, (unit, text) in parts
    }


KEYS = {name: Key(field.annotation, field.description, field.default) for name, field in LawFile.model_fields.items()}
KEYS |= {
    "kind": Key(str, "name of the law", ""),
    "coulomb": Key(Literal["smooth", "sharp"], "approach of F_t to the Coulomb limit μ F_n", "sharp"),
    "kn": Key(Positive, "normal stiffness k_n, in a unit that depends on `kind`"),
    "kt": Key(NotNegative, "tangential stiffness k_t, in the unit of `kn`; default: 2/7 of `kn`"),
    "young": Key(Positive, "Young's modulus E; with `poisson` it determines k_n and k_t [stress]"),
    "poisson": Key(Annotated[float, Field(gt=-1, le=0.5)], "Poisson's ratio ν"),
    "mu": Key(NotNegative, "friction coefficient between grains", 0.5),
    "damping": Key(
        Literal[*DAMPING],
        "model of the dashpots, which determines the factor that multiplies γ; default: viscoelastic for "
        "hertz_mindlin_reff, otherwise mass_velocity",
    ),
    "damping_n": Key(
        NotNegative,
        "coefficient γ_n of the normal dashpot, in a unit that depends on `damping`; with tsuji and "
        "coeff_restitution, the coefficient of restitution",
    ),
    "damping_t": Key(NotNegative, "coefficient γ_t of the tangential dashpot, in the unit of `damping_n`"),
    "damping_ratio": Key(NotNegative, "γ_t/γ_n, instead of `damping_t`; default: 1/2 with a restitution, otherwise 0"),
    "restitution": Key(
        Annotated[float, Field(gt=0, le=1)],
        "coefficient of restitution of two equal grains, instead of damping coefficients",
    ),
    "reading": Key(
        Literal["eq8", "collision"],
        "conversion of the restitution to γ_n; eq8: by Eq 8 of Ferdowsi & Rubin 2021 as printed; collision: such that "
        "a collision under this law has the given restitution",
    ),
    "size": Key(Positive, "diameter of the two colliding grains [length]"),
    "speed": Key(Positive, "speed at which two grains collide; not needed with a linear law [length/time]"),
    **{name: _own_key(name) for name in OWN_PARAMETERS},
    "lever": Key(Literal[*ARMS], "lever arms of tangential forces: radius (R, the default) or overlap (R − δ/2)"),
    "memory": Key(Literal[*MEMORIES], "memory of contacts: slip (default) or force, as in LAMMPS mindlin/force"),
    "rolling": Key(Literal[*MODELS], "model of rolling resistance; default: none"),
    **_moment_keys(ROLLING, "k_roll"),
    "twisting": Key(Literal[*TWISTINGS], "model of twisting resistance; default: none"),
    **_moment_keys(TWISTING, "k_twist"),
    "tension": Key(bool, "whether dashpots may make contact forces attractive", True),
    "wall": Key(Parameters, None),
}


class LawTable(LawOrFile):
    """Contact law: stiffness from k_n and k_t or elastic constants, damping from coefficients or a restitution.

    `allow_laws` adds keys to a table. Keys that a table lacks have their defaults in `KEYS`.
    """

    def __getattr__(self, name: str):
        if name in KEYS:
            return KEYS[name].default
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

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
                raise ValueError(f"law.{extra[0]} requires law.{key}: give both or neither")
            if extra:
                raise ValueError(f"law.{key} = {model!r} does not use law.{extra[0]}: leave it out")
        return self

    @property
    def dashpots(self) -> str:
        """Dashpots of the law: those of `damping`, or else the default of its kind."""
        return self.damping or BY_NAME[self.kind].damping

    @model_validator(mode="after")
    def _check_parameters(self):
        if self.file is not None:
            return self
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        names = [p.name for p in BY_NAME[self.kind].parameters]
        for name in sorted({*names} ^ {*given} & OWN_PARAMETERS.keys()):
            remedy = "is missing: give it" if name in names else f"is not a parameter of {self.kind}: leave it out"
            raise ValueError(f"law.{name} {remedy}")
        elastic = [name for name in ("young", "poisson") if name in given]
        plain = [name for name in ("kn", "kt") if name in given]
        if elastic and plain:
            raise ValueError(
                f"law.{elastic[0]} and law.{plain[0]} exclude each other: give either young and poisson, or kn and kt"
            )
        if len(elastic) == 1:
            raise ValueError(f"law.{elastic[0]} is not sufficient: give both young and poisson")
        if elastic and not BY_NAME[self.kind].uses_radius:
            raise ValueError(f'law.young does not apply to law.kind = {self.kind!r}: use kind = "hertz_mindlin_reff"')
        if not elastic and self.kn is None:
            raise ValueError("law.kn is missing: give it, or young and poisson")
        if "damping_t" in given and "damping_ratio" in given:
            raise ValueError("law.damping_t and law.damping_ratio exclude each other: give only one")
        if self.restitution is None:
            for name in ("reading", "size", "speed"):
                if name in given:
                    raise ValueError(f"law.{name} requires law.restitution: give both or neither")
        elif "damping_n" in given or "damping_t" in given:
            raise ValueError("law.restitution and damping coefficients exclude each other: give only one")
        elif self.restitution < 1 and self.kind != "linear" and self.speed is None:
            raise ValueError(
                f"law.restitution requires law.speed, on which the restitution of a {self.kind} law depends"
            )
        return self


if TYPE_CHECKING:
    Table = TypeVar("Table", bound=type[LawTable])


def allow_laws(*kinds: str, si: bool = False, **defaults) -> "Callable[[Table], Table]":
    """Add keys to a law table: those of some laws, the first of which is the default, and others with their defaults.

    Descriptions name the laws, and the units of the default law (SI units with `si`).
    """
    usual, names = BY_NAME[kinds[0]], tuple(dict.fromkeys(kinds))
    own = {p.name: None for kind in names for p in BY_NAME[kind].parameters}
    defaults = own | defaults | {"kind": usual.name}
    stiffness, dashpot = usual.stiffness_unit, DASHPOTS[DAMPING[defaults.get("damping") or usual.damping]][0]
    units = {"kn": stiffness, "kt": stiffness, "damping_n": dashpot, "damping_t": dashpot}

    def field(name: str) -> tuple[Any, Any]:
        kind, words, _ = KEYS[name]
        if name == "kind":
            kind, words = Literal[names], "; ".join(f"{name}: {BY_NAME[name].words}" for name in names)
        text, unit = split_unit(words)
        unit = units.get(name, unit)
        words = f"{text} [{in_si(unit) if si else unit}]" if unit else text
        default = defaults[name]
        return kind | None if default is None else kind, Field(default, description=words)

    def make(table: "Table") -> "Table":
        fields = {name: field(name) for name in KEYS if name in defaults}
        return create_model(
            table.__name__, __base__=table, __module__=table.__module__, __doc__=table.__doc__, **fields
        )

    return make


@allow_laws(
    "hertz_mindlin", "linear", coulomb="smooth", kn=1.0, kt=2 / 7, mu=10.0, damping="velocity", damping_n=0.0,
    damping_t=0.0, tension=True, wall=Parameters(), file=None, parameters={}, checksum=None,
)  # fmt: skip
class PackingLaw(LawTable):
    """Contact law and its parameters."""


def renamed_keys(law: dict) -> dict:
    """Law table of a finished run with the present names of its keys; gouge used other names before 0.3."""
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
            raise ValueError("packing.packing_fraction and packing.pressure exclude each other: give only one")
        if isinstance(self.radius, tuple) and len(self.radius) > self.grains:
            raise ValueError(
                f"packing.radius must have at most {self.grains} entries for {self.grains} grains, got "
                f"{len(self.radius)}"
            )
        return self
