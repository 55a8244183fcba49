"""Swept keys in a [sweep] table (lists, spaced values, random points, tables of draws), and the table's options."""

import math
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from ...core.progress import MOST
from ...core.tables import read_table, split_label
from ...core.text import parse_number
from ...data.schema import LARGEST, Finite, Listed, Positive, ScenarioError, ScenarioTable, field_at, validate_table

SPACED, DRAWN = ("linspace", "geomspace"), ("uniform", "loguniform", "integers", "normal")
KINDS = (*SPACED, *DRAWN, "column", "count")
Count = Annotated[int, Field(ge=1, le=MOST)]


def _require(holds: Callable, remedy: str) -> AfterValidator:
    """Validator that rejects values for which `holds` is false; `remedy` ends the error message."""

    def check(value):
        if not holds(value):
            raise PydanticCustomError("value", remedy)
        return value

    return AfterValidator(check)


def _are_numbers(ends) -> bool:
    plain = isinstance(ends, tuple) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in ends)
    return plain and len(ends) == 2 and all(abs(v) <= LARGEST for v in ends)


def _about(text: str):
    return Field(None, description=text)


Ends = Annotated[Any, Listed, _require(_are_numbers, f"use two numbers of at most {LARGEST:g} in magnitude as ends")]
Rising = _require(lambda ends: ends[0] < ends[1], "the first end must be below the second")
BothPositive = _require(lambda ends: min(ends) > 0, "both ends must be positive")
BothWhole = _require(lambda ends: all(isinstance(v, int) for v in ends), "use two whole numbers, both included")


class Normal(ScenarioTable):
    """Normal distribution."""

    mean: Finite
    sd: Positive


class Values(ScenarioTable):
    """Table that defines the values of a swept key, by one of KINDS."""

    linspace: Ends | None = _about("evenly spaced, including both ends")
    geomspace: Annotated[Ends, BothPositive] | None = _about("evenly spaced in the logarithm, including both ends")
    uniform: Annotated[Ends, Rising] | None = _about("random, uniform between two ends")
    loguniform: Annotated[Ends, Rising, BothPositive] | None = _about("random, uniform in the logarithm between ends")
    integers: Annotated[Ends, Rising, BothWhole] | None = _about("random integers, both ends included")
    normal: Normal | None = _about("random, with mean and standard deviation")
    column: str | None = _about("a column of `draws`, multiplied by f (default 1); all columns vary together")
    count: Count | None = _about("for `seed` only: the seed of the scenario and the following ones")
    number: Count | None = None
    times: Annotated[Finite, _require(bool, "use a number other than 0")] | None = None

    @property
    def kinds(self) -> list[str]:
        """Members of KINDS that the table has; a valid table has exactly one."""
        return [kind for kind in KINDS if getattr(self, kind) is not None]

    @model_validator(mode="after")
    def _check_kind(self):
        if len(self.kinds) != 1:
            remedy = f"give one of {', '.join(KINDS)}"
            raise PydanticCustomError("kind", f"it has {len(self.kinds)} kinds of values: {remedy}")
        if self.times is not None and self.column is None:
            raise PydanticCustomError(
                "kind", "times, a factor for the values of a column, requires column: leave it out"
            )
        return self


class Options(ScenarioTable):
    """Options of a [sweep] table."""

    mode: Literal["grid", "zip", "sample"] = Field(
        "grid", description="grid: all combinations; zip: values at equal positions of the lists; sample: random points"
    )
    number: Count | None = Field(None, description='number of points of a sample, or of every key with `mode = "zip"`')
    draw: Literal["latin-hypercube", "sobol"] = Field(
        "latin-hypercube", description="points of a sample: a Latin hypercube, or a scrambled Sobol' sequence"
    )
    draw_seed: Annotated[int, Field(ge=0)] = Field(0, description="seed of all random values")
    where: Any = Field(None, description="conditions on swept keys; points that do not satisfy them are rejected")
    draws: Any = Field(None, description="table whose rows are points, for keys with a `column`")

    @model_validator(mode="after")
    def _check_points(self):
        if self.mode == "sample" and self.number is None:
            raise ValueError('sweep.mode = "sample" needs the number of points: give sweep.number')
        if self.mode == "grid" and self.number is not None:
            raise ValueError(
                "sweep.number applies to zip and sample only: in a grid, give a number for each distribution"
            )
        if self.mode != "sample" and "draw" in self.model_fields_set:
            raise ValueError('sweep.draw requires sweep.mode = "sample"')
        return self


OPTIONS = tuple(Options.model_fields)


class Axis(NamedTuple):
    """A swept key and its values; `values` is empty if they are still to be sampled."""

    key: str
    values: tuple
    kind: str  # "list", or one of KINDS
    parameters: Any = None  # parameters of a distribution: its two ends, or Normal


def flatten(table: dict, ends: Callable[[dict], bool] = lambda inner: False, above: str = "") -> dict:
    """Flatten tables to dotted keys, except tables for which `ends` is true; [law] mu = … becomes "law.mu" = …"""
    out = {}
    for key, value in table.items():
        inner = isinstance(value, dict) and not ends(value)
        out |= flatten(value, ends, f"{above}{key}.") if inner else {above + key: value}
    return out


def swept_entries(table: dict) -> dict:
    """Return the entries of the swept keys of a [sweep] table."""
    return flatten({key: value for key, value in table.items() if key not in OPTIONS}, _is_distribution)


def short_names(keys: Iterable[str], others: Iterable[str] = ()) -> dict[str, str]:
    """Return the shortest endings of dotted keys that are unique among them and other names.

    Examples
    --------
    >>> short_names(["packing.friction.mu", "law.kn", "law.mu"])
    {'packing.friction.mu': 'friction.mu', 'law.kn': 'kn', 'law.mu': 'law.mu'}
    """
    keys, others, out = list(keys), set(others), {}
    for key in keys:
        parts = key.split(".")
        tails = [".".join(parts[k:]) for k in reversed(range(len(parts))) if not parts[k].isdecimal()]
        same = [sum(f".{other}".endswith(f".{tail}") for other in keys) for tail in tails]
        free = (tail for tail, count in zip(tails, same, strict=True) if count == 1 and tail not in others)
        out[key] = next(free, key)
    return out


def _is_distribution(value: dict) -> bool:
    return not value or not all(isinstance(item, list | dict) for item in value.values()) or bool(set(value) & {*KINDS})


def parse_entry(key: str, entry) -> list | Values:
    """Return a list unchanged, and a table as `Values`."""
    if isinstance(entry, dict) and "logspace" not in entry:
        return validate_table(Values, entry, f"sweep.{key}")
    if isinstance(entry, dict):
        raise ScenarioError(f"sweep.{key}.logspace is not supported: use geomspace with the end values")
    if not isinstance(entry, list):
        raise ScenarioError(
            f"sweep.{key} = {entry!r} is not allowed: use a list of values, or {{{' | '.join(KINDS)} = …}}"
        )
    if not entry:
        raise ScenarioError(f"sweep.{key} is an empty list: give at least one value")
    return entry


def make_axis(key: str, entry: list | Values, seed, options: Options, draws: dict) -> Axis:
    """Return the axis of a swept key; `seed` is that of the scenario, and `draws` are the columns of a draws table."""
    if isinstance(entry, list):
        value, count = Counter(map(str, entry)).most_common(1)[0]
        if options.mode == "grid" and count > 1:
            raise ScenarioError(f"sweep.{key} contains {value} more than once: give each value once")
        return Axis(key, tuple(entry), "list")
    (kind,) = entry.kinds
    parameters = getattr(entry, kind)
    if kind == "count":
        return Axis(key, _seeds(key, seed, parameters), kind)
    if options.mode == "sample" and entry.number is not None:
        raise ScenarioError(f"sweep.{key}.number is not allowed: a sample has one number for all keys, sweep.number")
    if kind == "column":
        return Axis(key, tuple((entry.times or 1.0) * value for value in draws[parameters]), kind)
    if options.mode == "sample":
        return Axis(key, (), kind, parameters)
    number = entry.number or options.number
    if number is None:
        raise ScenarioError(f"sweep.{key} needs a number of values, as in {{{kind} = …, number = 5}}")
    if kind in SPACED:
        values = getattr(np, kind)(*map(float, parameters), number)
        whole = all(isinstance(end, int) for end in parameters) and (values == np.round(values)).all()
        return Axis(key, tuple((values.astype(int) if whole else values).tolist()), kind)
    share = generator(options.draw_seed, key).random(number)
    return Axis(key, quantiles(kind, parameters, np.sort(share) if options.mode == "grid" else share), kind)


def _seeds(key: str, first, count: int) -> tuple:
    if key != "seed":
        raise ScenarioError(
            f"sweep.{key}.count is not allowed, except for seed: use a list, linspace or a distribution"
        )
    if type(first) is not int or first < 0:
        raise ScenarioError(f"seed must be a whole number, 0 or more, got {first!r}")
    return tuple(range(first, first + count))


FEWEST = 0.01  # fraction of accepted points below which sampling is abandoned
LEAST_TRIED, MOST_TRIED = 1000, 10_000_000  # fewest points after which sampling may be abandoned, and most points


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one key."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def latin_hypercubes(names, number: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield Latin hypercubes of `number` points in the unit cube endlessly, {name: coordinates}.

    Each coordinate has `number` intervals of equal probability, with one point in each (McKay, Beckman and Conover
    1979, doi:10.1080/00401706.1979.10489755).
    """
    generators = {name: generator(seed, name) for name in names}
    while True:
        yield {name: (rng.permutation(number) + rng.random(number)) / number for name, rng in generators.items()}


def sobol_points(names, number: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield successive sets of `number` points of a scrambled Sobol' sequence in the unit cube, {name: coordinates}.

    Each coordinate is scrambled by its own generator, so that it depends only on the seed, its name and its position
    among the names (Owen 1998, doi:10.1006/jcom.1998.0487; Matoušek 1998, doi:10.1006/jcom.1998.0489).
    """
    from scipy.stats import qmc

    sequences = [qmc.Sobol(k + 1, seed=generator(seed, name)) for k, name in enumerate(names)]
    while True:
        with warnings.catch_warnings():  # SciPy's advice on powers of two is in the documentation
            warnings.simplefilter("ignore", UserWarning)
            yield {name: sobol.random(number)[:, -1] for name, sobol in zip(names, sequences, strict=True)}


BATCHES = {"latin-hypercube": latin_hypercubes, "sobol": sobol_points}


def quantiles(kind: str, parameters, share: np.ndarray) -> tuple:
    """Return the quantiles of a distribution at given probabilities; its parameters are two ends, or `Normal`."""
    if kind == "normal":
        from scipy.special import ndtri

        return tuple((parameters.mean + parameters.sd * ndtri(np.clip(share, 1e-16, 1 - 1e-16))).tolist())
    low, high = parameters
    if kind == "integers":
        return tuple(np.minimum(low + np.floor(share * (high - low + 1)), high).astype(int).tolist())
    if kind in ("loguniform", "geomspace"):
        return tuple(np.exp(math.log(low) + share * math.log(high / low)).tolist())
    return tuple((low + share * (high - low)).tolist())


def check_effort(accepted: int, tried: int, refused: dict[str, int]) -> None:
    """Raise ScenarioError if conditions reject nearly all points."""
    few = accepted < FEWEST * tried and tried >= LEAST_TRIED
    if few or tried > MOST_TRIED:
        raise ScenarioError(
            f"sweep.where rejects {tried - accepted} of {tried} points ({describe_refusals(refused)}): use a weaker "
            "condition, or narrower distributions"
        )


def describe_refusals(refused: dict[str, int]) -> str:
    """Return the conditions with the number of points rejected by each."""
    return ", ".join(f"{count} by {text}" for text, count in refused.items() if count)


MOST_ROWS = 100_000  # largest number of rows, limited because the values are part of the text of the sweep
PLAIN = ("", "-", "1")  # units of dimensionless numbers


def read_draws(draws, entries: dict, kind) -> dict[str, list[float]]:
    """Return the columns of a draws table that a sweep uses, {name: values}.

    Parameters
    ----------
    draws : path of a CSV file with headers such as `dc [m]`, or {name: values}
    entries : entries of all swept keys
    kind : class of the scenario; the unit in a header must be that of the key, unless the entry has a factor `times`
    """
    columns = {key: entry for key, entry in entries.items() if isinstance(entry, Values) and entry.column is not None}
    if draws is None:
        if columns:
            raise ScenarioError(f"sweep.{next(iter(columns))} refers to a column: give its file in sweep.draws")
        return {}
    if not columns:
        raise ScenarioError('sweep.draws is not used by any key: add one, such as "surface.a" = {column = "a"}')
    of_file = isinstance(draws, str | Path)
    table, out = _read_file(Path(draws)) if of_file else _check_table(draws), {}
    for key, entry in columns.items():
        name = entry.column
        if name not in table:
            raise ScenarioError(f"sweep.{key}: sweep.draws has no column {name!r}: its columns are {', '.join(table)}")
        unit, out[name] = table[name]
        if of_file and entry.times is None:
            wanted = field_at(kind, key)[1]
            if unit != wanted and not (unit in PLAIN and wanted in PLAIN):
                raise ScenarioError(
                    f"sweep.{key}: column {name!r} is in [{unit or '-'}] and the key in [{wanted or '-'}]: give the "
                    f'factor between them, as in {{column = "{name}", times = 1e-6}}'
                )
    lengths = {name: len(values) for name, values in out.items()}
    if len(set(lengths.values())) > 1:
        raise ScenarioError(f"the columns of sweep.draws have different lengths: {lengths}")
    return out


def _read_file(path: Path) -> dict[str, tuple[str, list[float]]]:
    try:
        (_, header), *rows = read_table(path)
    except OSError as problem:
        raise ScenarioError(f"sweep.draws = {path} cannot be read ({problem.strerror}): give a CSV file") from None
    except ValueError as problem:
        raise ScenarioError(f"sweep.draws: {problem}") from None
    if not 1 <= len(rows) <= MOST_ROWS:
        raise ScenarioError(f"sweep.draws = {path} has {len(rows)} rows: give 1 to {MOST_ROWS}")
    names = [(name, unit or "") for name, unit in map(split_label, header)]
    if len({name for name, _ in names}) < len(names):
        raise ScenarioError(f"sweep.draws = {path} has two columns of the same name: keep only one")
    return {name: (unit, [_parse(path, row, k, name) for row in rows]) for k, (name, unit) in enumerate(names)}


def _parse(path: Path, row: tuple[int, list[str]], k: int, name: str) -> float:
    number, fields = row
    try:
        value = parse_number(fields[k])
    except ValueError:
        value = np.nan
    if not abs(value) <= LARGEST:
        raise ScenarioError(
            f"sweep.draws = {path}, line {number}: {name} is {fields[k][:40]!r}, not a finite number: remove the line"
        )
    return value


def _check_table(draws) -> dict[str, tuple[str, list[float]]]:
    out = {}
    for name, values in draws.items() if isinstance(draws, dict) else ():
        try:
            column = np.asarray(values, float)
        except (TypeError, ValueError):
            column = np.array([np.nan])
        if column.ndim != 1 or not 1 <= len(column) <= MOST_ROWS or not (np.abs(column) <= LARGEST).all():
            raise ScenarioError(f"sweep.draws.{name} is not a list of 1 to {MOST_ROWS} finite numbers")
        out[name] = ("", column.tolist())
    if not out:
        raise ScenarioError("sweep.draws must be the path of a CSV file, or a table of columns")
    return out
