"""A scenario: everything that defines a run, validated, hashable, readable from TOML or built in Python."""

import json
import re
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field, ValidationError, field_validator, model_validator

from ..core.text import shortened, text_of
from .flow_scenario import FlowScenario
from .gouge_scenario import GougeScenario
from .law_file import LawFile, check_sealed
from .parts import (
    Duration,
    Finite,
    Listed,
    Loads,
    NotNegative,
    Part,
    Positive,
    ScenarioError,
    Seed,
    Several,
    Whole,
    sentence,
)
from .quasi_scenario import QuasiScenario
from .ratestate_scenario import RateStateScenario


class Array(Part):
    """Disks in a row on a substrate, periodic along the row."""

    disks: Annotated[int, Field(ge=1, le=400)] = Field(10, description="how many")
    radius: Several = Field(0.5, description="one radius, or one for each disk [length]")
    mass: Several = Field(1.0, description="one mass, or one for each disk [mass]")
    i0: Positive = Field(0.5, description="moment of inertia I0 m R²: 1/2 for a disk")
    gap: Finite = Field(0.0, description="between neighbours before loading; negative presses them together [length]")

    @model_validator(mode="after")
    def _one_for_each(self):
        for name in ("radius", "mass"):
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != self.disks:
                raise ValueError(
                    f"{name} has {len(value)} entries but there are {self.disks} disks: give one or {self.disks}"
                )
        smallest = min(self.radius) if isinstance(self.radius, tuple) else self.radius
        if self.gap <= -smallest:
            raise ValueError(
                f"gap = {self.gap:g} pushes disks deeper than a radius into each other: use a gap above {-smallest:g}"
            )
        return self


class Parameters(Part):
    """Parameters of the disk–wall contact where they differ from those between disks."""

    kn: Positive | None = Field(None, description="as `law.kn`")
    kt: NotNegative | None = Field(None, description="as `law.kt`")
    mu: NotNegative | None = Field(None, description="as `law.mu`")
    damping_n: NotNegative | None = Field(None, description="as `law.damping_n` [force time/length]")
    damping_t: NotNegative | None = Field(None, description="as `law.damping_t` [force time/length]")


class LawChoice(LawFile):
    """Contact law and its parameters."""

    kind: Literal["hertz_mindlin", "linear"] = Field("hertz_mindlin", description="F_n = k_n δ^(3/2), or k_n δ")
    coulomb: Literal["smooth", "sharp"] = Field("smooth", description="how F_t comes to Coulomb's limit μ F_n")
    kn: Positive = Field(1.0, description="k_n; of a linear law in force/length [force/length^(3/2)]")
    kt: NotNegative = Field(2 / 7, description="k_t, as `kn` [force/length^(3/2)]")
    mu: NotNegative = Field(10.0, description="friction between grains")
    damping_n: NotNegative = Field(0.0, description="of the normal dashpot [force time/length]")
    damping_t: NotNegative = Field(0.0, description="of the tangential dashpot [force time/length]")
    wall: Parameters = Parameters()


class Load(Part):
    """Forces: `press` on every disk towards the substrate, `push` along the row on one disk, in units of `unit`."""

    unit: Positive = Field(1 / 2000, description="what a force of 1 in this table is, in units of the scenario [force]")
    press: Finite = Field(0.1, description="on every disk, towards the substrate [`unit`]")
    push: Loads = Field((0.0, 0.09), description="turning points of the quasi-static path [`unit`]")
    step: Positive = Field(5e-4, description="largest increment of the push between two equilibria [`unit`]")
    disk: Annotated[int, Field(ge=1)] = Field(1, description="the disk that is pushed, counted from 1")

    @field_validator("press")
    @classmethod
    def _presses(cls, value):
        if value <= 0:
            raise ValueError(
                f"press = {value:g} leaves the disks without contact to the substrate: use a positive force"
            )
        return value

    @field_validator("push")
    @classmethod
    def _has_path(cls, value):
        if len(value) < 2 or value[0] != 0.0:
            raise ValueError("push needs at least two turning points, the first of them 0.0, such as [0.0, 0.09]")
        return value

    @model_validator(mode="after")
    def _affordable(self):
        steps = sum(abs(b - a) for a, b in pairwise(self.push)) / self.step
        if steps > 100_000:
            raise ValueError(
                f"push takes {steps:.0f} steps of {self.step:g}: at most 100000 are allowed, use a larger step"
            )
        return self


class Relaxation(Part):
    """How equilibria are found: damped dynamics (drag on translations and rotations) or Newton's method."""

    method: Literal["dynamics", "newton"] = Field("dynamics", description="the paper's way, or the fast one")
    drag: Positive = Field(0.05, description="on translations, by mass [1/time]")
    spin_drag: Positive | None = Field(None, description="on rotations; that on translations unless given [1/time]")
    dt: Positive = Field(0.1, description="of damped dynamics [time]")
    tolerance: Positive = Field(1e-14, description="largest unbalanced force, or torque over R [force]")
    steps: Annotated[int, Field(ge=1)] = Field(2_000_000, description="after which the search is given up")


class Dynamics(Part):
    """Newtonian runs from the equilibria where the path first passes some loads, seeded by a tiny random velocity."""

    loads: Loads = Field((0.03, 0.04, 0.062, 0.083, 0.087, 0.09), description="pushes where runs start [`load.unit`]")
    watch: Finite | None = Field(
        None, description="load whose transition is sampled finely; else the first that slides [`load.unit`]"
    )
    duration: Duration = Field(60_000.0, description="of each run [time]")
    dt: Positive = Field(0.1, description="time step [time]")
    seed_velocity: Positive = Field(1e-13, description="root mean square of the random start [length/time]")
    drag: NotNegative = Field(0.0, description="on translations, by mass [1/time]")
    spin_drag: NotNegative | None = Field(None, description="on rotations; that on translations unless given [1/time]")


class Sliding(Part):
    """Many realizations of the transition at loads where the array slides: fronts and sliding velocity."""

    loads: Loads = Field((), description="pushes; none, no realizations [`load.unit`]")
    realizations: Annotated[int, Field(ge=1, le=100_000)] = Field(25, description="of each load, by random velocities")
    duration: Duration = Field(40_000.0, description="of each run [time]")
    thresholds: Annotated[tuple[Positive, ...], Listed] = Field(
        (0.01, 0.02, 0.05, 0.1), min_length=1, description="displacements at which a disk counts as sliding [length]"
    )


class Scenario(Whole):
    """Everything that defines a run of an array of disks on a substrate."""

    experiment: Literal["disk-array"] = "disk-array"
    seed: Seed = 0
    array: Array = Array()
    law: LawChoice = LawChoice()
    load: Load = Load()
    relaxation: Relaxation = Relaxation()
    dynamics: Dynamics = Dynamics()
    sliding: Sliding = Sliding()

    @model_validator(mode="after")
    def _reachable(self):
        if self.load.disk > self.array.disks:
            raise ValueError(f"load.disk = {self.load.disk} is pushed but there are {self.array.disks} disks")
        if self.dynamics.watch is not None and self.dynamics.watch not in self.dynamics.loads:
            raise ValueError(
                f"dynamics.watch = {self.dynamics.watch:g} is not among dynamics.loads {self.dynamics.loads}"
            )
        if max(self.dynamics.duration, self.sliding.duration) / self.dynamics.dt > 1e9:
            raise ValueError(
                f"dynamics.dt = {self.dynamics.dt:g} makes more than 1e9 steps of one run: use shorter runs"
            )
        radius = self.array.radius if isinstance(self.array.radius, tuple) else (self.array.radius,)
        if self.law.file is not None:
            return self
        power = 2 / 3 if self.law.kind == "hertz_mindlin" else 1.0
        overlap = (self.load.press * self.load.unit / (self.law.wall.kn or self.law.kn)) ** power
        if overlap > 0.2 * min(radius):
            raise ValueError(
                f"load.press = {self.load.press:g} presses disks {overlap:.3g} deep into the substrate, more than a "
                f"fifth of a radius, beyond any contact law: use a smaller press or a larger kn"
            )
        low, high = min(self.load.push), max(self.load.push)
        for table in ("dynamics", "sliding"):
            for value in getattr(self, table).loads:
                if not low <= value <= high:
                    raise ValueError(
                        f"{table}.loads holds {value:g}, which load.push ({low:g} to {high:g}) never reaches"
                    )
        return self


class Packing(Part):
    """Frictionless jammed packing of disks (dim = 2) or spheres (dim = 3) in a periodic box."""

    grains: Annotated[int, Field(ge=10, le=1600)] = Field(100, description="how many")
    dim: Literal[2, 3] = Field(3, description="2: disks in the plane, 3: spheres")
    radius: Several = Field((0.5, 0.7), description="one, sizes of equally many grains each, or one for each [length]")
    mass: Positive = Field(1.0, description="of every grain [mass]")
    i0: Positive | None = Field(None, description="moment of inertia I0 m R²; 2/5 for spheres, 1/2 for disks")
    packing_fraction: Annotated[float, Field(gt=0, le=1.2, allow_inf_nan=False)] | None = Field(
        None, description="without it and without pressure: 0.68 for spheres, 0.86 for disks"
    )
    pressure: Positive | None = Field(None, description="in place of a packing fraction [force/length^(dim−1)]")

    @model_validator(mode="after")
    def _one_measure(self):
        if self.packing_fraction is not None and self.pressure is not None:
            raise ValueError("packing.packing_fraction and packing.pressure were both given: give one of them")
        if isinstance(self.radius, tuple) and len(self.radius) > self.grains:
            raise ValueError(f"packing.radius has {len(self.radius)} sizes for {self.grains} grains: give fewer")
        return self


class Shear(Part):
    """Quasi-static simple shear along x with gradient y."""

    strain: Loads = Field((0.0, 2e-3, 0.02), description="turning points of the path")
    step: Several = Field((2e-5, 1e-4), description="largest strain step, one or one for each leg of the path")
    slip: bool = Field(True, description="whether the affine displacement enters the slip of the contacts")
    tolerance: Positive = Field(5e-14, description="largest unbalanced force, or torque over R [force]")

    @model_validator(mode="after")
    def _path(self):
        if len(self.strain) < 2 or self.strain[0] != 0.0:
            raise ValueError("shear.strain needs at least two turning points, the first of them 0.0, as in [0.0, 0.02]")
        legs = len(self.strain) - 1
        if len(self.steps) != legs:
            raise ValueError(f"shear.step has {len(self.steps)} entries for {legs} legs: give one or {legs}")
        steps = sum(abs(b - a) / d for (a, b), d in zip(pairwise(self.strain), self.steps, strict=True))
        if steps > 100_000:
            raise ValueError(f"shear takes {steps:.0f} steps: at most 100000 are allowed, use larger steps")
        return self

    @property
    def steps(self) -> tuple[float, ...]:
        """One step for each leg."""
        return self.step if isinstance(self.step, tuple) else (self.step,) * (len(self.strain) - 1)


class Release(Part):
    """Newtonian runs from unstable states: one with a single complex pair, and the last one of the path."""

    e_folds: Positive = Field(45.0, description="length of a run in units of 1/(growth rate)")
    least: Duration = Field(5e4, description="shortest run, for what follows a fast growth [time]")
    duration: Duration = Field(6e5, description="longest run [time]")
    dt: Positive = Field(0.1, description="time step [time]")
    seed_velocity: Positive = Field(1e-13, description="root mean square of the random start [length/time]")
    snapshots: Annotated[int, Field(ge=0, le=1000)] = Field(40, description="spectra during the run")


class ShearScenario(Whole):
    """Everything that defines the quasi-static shear of a packing and its failure."""

    experiment: Literal["sphere-shear"] = "sphere-shear"
    seed: Seed = 0
    packings: Annotated[int, Field(ge=1, le=1000)] = Field(5, description="independent packings")
    packing: Packing = Packing()
    law: LawChoice = LawChoice()
    shear: Shear = Shear()
    release: Release = Release()


AnyScenario = Scenario | ShearScenario | FlowScenario | QuasiScenario | GougeScenario | RateStateScenario
LARGEST_WHOLE = 2**63 - 1
WHOLE = "whole numbers are read up to 64 bits, give a smaller one, or write it as 1e30"
EXPERIMENTS = {kind.model_fields["experiment"].default: kind for kind in get_args(AnyScenario)}


def kind_of(tables: dict) -> type[Whole]:
    """The class of scenario that `experiment` names; without it, a disk array."""
    name = tables.get("experiment", "disk-array")
    if not isinstance(name, str) or name not in EXPERIMENTS:
        raise ScenarioError(f"experiment = {str(name)[:100]!r} was given: use {', '.join(map(repr, EXPERIMENTS))}")
    return EXPERIMENTS[name]


def scenario(**tables) -> AnyScenario:
    """A scenario from nested dictionaries, as in the TOML file; `experiment` says of what.

    Raises
    ------
    ScenarioError
        with one sentence that names the key, what was got and what is allowed.

    Examples
    --------
    >>> scenario(array={"disks": 5}, load={"push": (0.0, 0.05)}, dynamics={"loads": (0.03,)}).array.disks
    5
    """
    kind = kind_of(tables)
    try:
        return kind.model_validate(tables)
    except ValidationError as problem:
        raise ScenarioError(sentence(problem, kind)) from None


def read(path: str | Path) -> AnyScenario:
    """A scenario from a TOML file, or from the canonical text that a run left behind."""
    tables = tables_of(path)
    if "sweep" in tables:
        raise ScenarioError(f"{path} holds a [sweep], which is many scenarios: use read_sweep, or leave the table out")
    return scenario(**tables)


def tables_of(path: str | Path) -> dict:
    """What a TOML or JSON file holds.

    Raises
    ------
    ScenarioError
        with one sentence, if it cannot be read.
    """
    path = Path(path)
    try:
        text = text_of(path, remedy="give the path of a TOML file")
    except OSError as problem:
        raise ScenarioError(
            f"the scenario {path} cannot be read ({problem.strerror}): give the path of a TOML file"
        ) from None
    except ValueError as problem:
        raise ScenarioError(str(problem)) from None
    tables = _parsed(text, path)
    if not isinstance(tables, dict):
        raise ScenarioError(f"the scenario {path} holds {type(tables).__name__}, not an object: give that of a run")
    _check_whole_numbers(tables, path)
    if path.suffix == ".json":
        check_sealed(tables, path)
        return tables
    return _placed(tables, path.parent)


def _parsed(text: str, path: Path):
    try:
        return json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise ScenarioError(f"the scenario {path} is not valid TOML: {problem}") from None
    except json.JSONDecodeError as problem:
        raise ScenarioError(f"the scenario {path} is not valid JSON: {problem}") from None
    except RecursionError:
        raise ScenarioError(
            f"the scenario {path} is nested too deeply: tables of a scenario are five deep at most"
        ) from None
    except ValueError:  # of all numbers, Python reads whole ones up to some length only
        found = max(re.finditer(r"\d[\d_]*", text), key=lambda digits: len(digits[0].replace("_", "")))
        line, digits = text.count("\n", 0, found.start()) + 1, len(found[0].replace("_", ""))
        raise ScenarioError(
            f"the scenario {path}, line {line}, holds a whole number of {digits} digits: {WHOLE}"
        ) from None


def _check_whole_numbers(tree, path: Path, above: tuple = ()) -> None:
    """Refuse what other readers of TOML and JSON, and files of results, do not hold."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree, start=1) if isinstance(tree, list) else ()
    for key, value in items:
        if isinstance(value, int) and not -LARGEST_WHOLE <= value <= LARGEST_WHOLE:
            where = shortened(".".join(map(str, (*above, key))))
            raise ScenarioError(f"the scenario {path} has a whole number beyond 64 bits at {where}: {WHOLE}")
        _check_whole_numbers(value, path, (*above, key))


def _placed(tables: dict, folder: Path) -> dict:
    """Tables in which the name of a law's file starts from the folder of the scenario."""
    law = tables.get("law")
    if isinstance(law, dict) and isinstance(law.get("file"), str):
        tables["law"] = law | {"file": str(folder.absolute() / law["file"])}
    return tables
