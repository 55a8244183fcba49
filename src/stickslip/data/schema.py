"""Building blocks of scenarios: types of entries, tables that reject unknown keys, and one-sentence error messages.

Dotted keys name the entries of tables: `law.mu`, or `legs.2.velocity` for the second entry of a list.
"""

import difflib
import hashlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, TypeVar, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ..core import arguments
from ..core.progress import Size, require_sizes
from ..core.readable import folded, format_value, table
from ..core.text import SentenceError
from ..core.units import SI, Units, units_from

LARGEST, SMALLEST = 1e100, 1e-100  # magnitudes, also of law parameters; products of two or three of these are finite


def _check_size(value: float) -> float:
    if value and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("size", "its magnitude must be 0, or between {small} and {large}", SIZES)
    return value


SIZES = {"small": f"{SMALLEST:g}", "large": f"{LARGEST:g}"}
Sized = AfterValidator(_check_size)
Positive = Annotated[arguments.Positive, Field(gt=0, allow_inf_nan=False), Sized]
NotNegative = Annotated[arguments.NotNegative, Field(ge=0, allow_inf_nan=False), Sized]
Finite = Annotated[float, Field(allow_inf_nan=False), Sized]
Duration = Annotated[float, Field(gt=0, le=1e7, allow_inf_nan=False), Sized]
Listed = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)  # TOML and JSON use lists
Several = Annotated[Positive | tuple[Positive, ...], Listed]
Loads = Annotated[tuple[Finite, ...], Listed]
Ranks = Annotated[int, Field(ge=1, le=100_000)]
Seed = Annotated[
    arguments.Seed, Field(ge=0, le=10**18, description="seed of all random numbers; the same seed gives the same run")
]


class ScenarioError(SentenceError):
    """Raised for a scenario that cannot be run; the message is one sentence for the user."""


def require_lammps_for_ranks(engine: str, ranks: int) -> None:
    """Raise ValueError if several MPI processes are requested for an engine without MPI."""
    if ranks > 1 and engine != "lammps":
        raise ValueError(
            f'ranks = {ranks} requires engine = "lammps", as engine = {engine!r} has no MPI processes: use '
            "that engine, or leave ranks out"
        )


class ScenarioTable(BaseModel):
    """A table of a scenario."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


Table = TypeVar("Table", bound=ScenarioTable)


class UnitNames(ScenarioTable):
    """Names of units, printed with numbers; units of force, stress and other quantities are their products."""

    length: str = Field(description='name of the unit of length, such as "mm": up to 12 letters')
    mass: str = Field(description="name of the unit of mass")
    time: str = Field(description="name of the unit of time")


def _check_units(given):
    if given is None or isinstance(given, UnitNames):
        return given
    units = units_from(given)
    return "SI" if units == SI else dict(zip(("length", "mass", "time"), units[:3], strict=True))


class ScenarioBase(ScenarioTable):
    """Base class of scenarios."""

    MADE_BY: ClassVar[str] = "scenario or read_scenario"
    si: ClassVar[bool] = False  # True if its units are SI by definition
    units: Annotated[Literal["SI"] | UnitNames | None, BeforeValidator(_check_units)] = Field(
        None, description="names of the units, for printing only; nothing is converted; default: no names"
    )
    if TYPE_CHECKING:
        experiment: str  # name of the experiment, a literal in each class

    def sizes(self) -> Iterator[Size]:
        """Iterate over the sizes of the run, each with the keys that determine it and advice on reducing it."""
        yield from ()

    @model_validator(mode="after")  # pydantic calls validators of a base class first, before others create arrays
    def _check_sizes(self):
        require_sizes(self.sizes())
        return self

    @model_validator(mode="after")
    def _keep_si(self):
        if self.si and self.units not in (None, "SI"):
            raise ValueError(
                f"units do not apply to experiment = {self.experiment!r}, which is always in SI units: leave them out"
            )
        return self

    @model_serializer(mode="wrap")
    def _serialise_given_units(self, handler):
        """Omit units that are not named; such a scenario keeps the text and digest of earlier versions."""
        out = handler(self)
        return out if self.units is not None else {key: value for key, value in out.items() if key != "units"}

    @property
    def dim(self) -> int:
        """Number of dimensions in the first table that has one; it determines the unit of stress."""
        tables = (getattr(self, name) for name in type(self).model_fields)
        return next((table.dim for table in tables if hasattr(table, "dim")), 3)

    @property
    def named_units(self) -> Units | None:
        """Units of the results; None if they are not named."""
        if self.si:
            return SI
        given = self.units.model_dump() if isinstance(self.units, UnitNames) else self.units
        return None if given is None else units_from(given, self.dim)

    @property
    def text(self) -> str:
        """Canonical text, identical for identical runs."""
        return self.model_dump_json(indent=1)

    @property
    def digest(self) -> str:
        """Hash of the canonical text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    def _summary(self) -> str:
        given = ", ".join(f"{key} = {format_value(value)}" for key, value, *_ in given_keys(self))
        return f"{self.experiment}, {given or 'all defaults'}"

    def _repr_html_(self) -> str:
        return table(f"scenario: {self.experiment}", given_keys(self)) + "<p>All other keys have their defaults.</p>"

    def __repr__(self) -> str:
        return folded(f"{type(self).__name__}: {self._summary()}")

    __str__ = __repr__


def split_unit(description: str | None) -> tuple[str, str]:
    """Split the description of a key into its text and the unit in brackets at its end, empty if there is none.

    Examples
    --------
    >>> split_unit("density of the grains [kg/m³]")
    ('density of the grains', 'kg/m³')
    """
    text, bracket, unit = (description or "").rpartition("[")
    return (text.strip(), unit[:-1]) if bracket and unit.endswith("]") else (description or "", "")


def given_keys(
    table: ScenarioTable, above: str = "", usual: ScenarioTable | None = None
) -> Iterator[tuple[str, object, str, str]]:
    """Iterate over the dotted keys of a scenario that differ from their defaults: key, value, unit and meaning.

    `usual` is the default of the whole table, in which values may differ from the defaults of its class.
    """
    for name, field in type(table).model_fields.items():
        value, words_and_unit = getattr(table, name), split_unit(field.description)
        alike = type(usual) is type(table)
        default = getattr(usual, name) if alike else field.get_default(call_default_factory=True)
        if name == "experiment" or value == default:
            continue
        entries = value if isinstance(value, tuple) and any(isinstance(v, ScenarioTable) for v in value) else [value]
        for number, entry in enumerate(entries, start=1):
            key = f"{above}{name}" + (f".{number}" if entries is value else "")
            if isinstance(entry, ScenarioTable):
                yield from given_keys(entry, f"{key}.", None if entries is value else default)
            else:
                yield key, entry, *reversed(words_and_unit)


def error_message(problem: ValidationError, kind: type[BaseModel], place: str = "") -> str:
    """Message about an unknown key or, if there is none, the first error: the given value, and the values allowed.

    `place` is the dotted name of the table, empty for a whole scenario.
    """
    errors = problem.errors()
    first = next((error for error in errors if error["type"] == "extra_forbidden"), errors[0])
    if first["type"] == "extra_forbidden":
        return unknown_key(first["loc"], kind, place)
    name, _, entry = _locate(first["loc"], kind, place)
    message = first["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    if first["type"] == "value_error":
        return message
    if first["type"].startswith("union_tag"):
        given = f"has kind = {first['ctx']['tag']!r}" if "tag" in first["ctx"] else "has no kind"
        key = name.rpartition(".")[2]
        _, parent, _ = _locate(first["loc"][: first["loc"].index(key)], kind, place)
        kinds = [table.model_fields["kind"].default for table in tables_in(parent.model_fields[key].annotation)]
        return f"{name}{entry} {given}: use {', '.join(map(repr, kinds))}"
    if first["type"] == "missing":
        return f"{name}{entry} is missing: give it"
    got = repr(list(first["input"]) if isinstance(first["input"], tuple) else first["input"])
    if first["type"] == "too_short":
        least = first["ctx"]["min_length"]
        message = f"input should have at least {least} {'entry' if least == 1 else 'entries'}"
    elif first["type"] == "tuple_type":
        message = "input should be a list"
    elif first["type"] == "literal_error":  # the key may be a word or a number
        others = [error["msg"] for error in errors[1:] if error["loc"][:-1] == first["loc"][:-1]]
        message = ", or ".join([message, *(other.removeprefix("Input should be ") for other in others)])
    got = got if len(got) <= 100 else f"{got[:97]}…"
    what = f"{name or 'the scenario'}{entry}"
    if message.startswith("input should"):
        return f"{what} {message.replace('input should', 'must')}, got {got}"
    return f"{what} = {got} is not allowed: {message}"


def _locate(where, table: type[BaseModel], place: str):
    """Dotted name of a location (without pydantic's names of union branches), its table, and the entry in words."""
    keys, entry, branches = [place] if place else [], "", []
    for part in where:
        if isinstance(part, int):
            entry = entry or f" (entry {part + 1})"
        elif part in table.model_fields:
            keys.append(part)
            branches = tables_in(table.model_fields[part].annotation)
            table = branches[0] if branches else table
        else:
            kinds = {
                branch.model_fields["kind"].default: branch for branch in branches if "kind" in branch.model_fields
            }
            table = kinds.get(part, table)
    return ".".join(keys), table, entry


def tables_in(annotation) -> list[type[BaseModel]]:
    """Classes of the tables in an annotation, including those within a tuple, dictionary or union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [kind for inner in get_args(annotation) for kind in tables_in(inner)]


def unknown_key(where, kind: type[BaseModel], place: str = "") -> str:
    """Error message for an unknown key of a table, with the closest known key."""
    name, table, entry = _locate(where[:-1], kind, place)
    keys, key = list(table.model_fields), str(where[-1])
    place = f"the table [{name}]{entry}" if name else "a scenario"
    near = difflib.get_close_matches(key, keys, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {', '.join(keys)}"
    return f"{place} has no key {key!r}: {hint}"


def validate_scenario(kind: type[ScenarioBase], /, **tables):
    """Create a scenario of a given class from nested dictionaries, as in its TOML file.

    Raises
    ------
    ScenarioError
        If a scenario is invalid; the message names the key, the value, and the values allowed.
    """
    return validate_table(kind, tables)


def validate_table(kind: type[Table], table: dict, place: str = "") -> Table:
    """Create a table of a given class; messages are those of `validate_scenario`, with the table's dotted name."""
    try:
        return kind.model_validate(table)
    except ValidationError as problem:
        raise ScenarioError(error_message(problem, kind, place)) from None


def field_at(kind: type[BaseModel], key: str) -> tuple[str, str]:
    """Text and unit in the description of a dotted key, for a class of scenarios.

    Raises
    ------
    ScenarioError
        If there is no such key; the message suggests the closest one.
    """
    parts, tables, above, annotation = key.split("."), [kind], [], None
    for k, part in enumerate(parts):
        if part.isdigit() and above:
            continue
        if get_origin(annotation) is dict and k == len(parts) - 1:  # names that a user chooses
            return f"{part} of {'.'.join(above)}", ""
        if not tables:
            raise ScenarioError(f"sweep.{key}: {'.'.join(above)} is not a table and has no key {part!r}")
        field = next((table.model_fields[part] for table in tables if part in table.model_fields), None)
        if field is None:
            raise ScenarioError(f"sweep.{key}: {unknown_key((*above, part), kind)}")
        annotation = field.annotation
        above, tables = [*above, part], tables_in(annotation)
        if k == len(parts) - 1 and get_origin(annotation) is dict:
            raise ScenarioError(f"sweep.{key} is a table: name one of its entries, as in {key}.NAME")
        if k == len(parts) - 1 and tables and not get_args(annotation):
            raise ScenarioError(f"sweep.{key} is a table: name one of its keys, {', '.join(tables[0].model_fields)}")
    return split_unit(field.description)


def with_value(tables: dict, key: str, value) -> dict:
    """Return a copy of nested tables with another value at a dotted key.

    Examples
    --------
    >>> with_value({"law": {"mu": 0.3, "kn": 1.0}}, "law.mu", 0.5)
    {'law': {'mu': 0.5, 'kn': 1.0}}
    """
    return _with_value(tables, key.split("."), value, key)


def _with_value(tables, parts: list[str], value, key: str):
    part, below = parts[0], parts[1:]
    if part.isdigit():
        if not isinstance(tables, list | tuple) or not 1 <= int(part) <= len(tables):
            many = len(tables) if isinstance(tables, list | tuple) else "no"
            raise ScenarioError(f"sweep.{key} refers to entry {part}, but the scenario gives {many} entries there")
        here = int(part) - 1
        new = _with_value(tables[here], below, value, key) if below else value
        return [*tables[:here], new, *tables[here + 1 :]]
    if not isinstance(tables, dict):
        raise ScenarioError(f"sweep.{key}: {part!r} is in a list; give the number of the entry, as in legs.2.velocity")
    default = [] if below and below[0].isdigit() else {}
    return tables | {part: _with_value(tables.get(part, default), below, value, key) if below else value}
