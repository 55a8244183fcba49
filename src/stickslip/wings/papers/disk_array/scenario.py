"""Scenario of an array of disks on a substrate."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ....kit import (
    STATE,
    Duration,
    Finite,
    Listed,
    Loads,
    NotNegative,
    PackingLaw,
    Positive,
    ScenarioBase,
    ScenarioTable,
    Seed,
    Several,
    Size,
)


class Array(ScenarioTable):
    """Disks in a row on a substrate, periodic along the row."""

    disks: Annotated[int, Field(ge=1, le=400)] = Field(10, description="number of disks")
    radius: Several = Field(0.5, description="one radius, or one for each disk [length]")
    mass: Several = Field(1.0, description="one mass, or one for each disk [mass]")
    i0: Positive = Field(0.5, description="I0 in the moment of inertia I0 m R²: 1/2 for a disk")
    gap: Finite = Field(
        0.0, description="gap between neighbours before loading; a negative gap presses them together [length]"
    )

    @model_validator(mode="after")
    def _check_sizes(self):
        for name in ("radius", "mass"):
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != self.disks:
                raise ValueError(
                    f"{name} has {len(value)} entries, but there are {self.disks} disks: give one or {self.disks}"
                )
        smallest = min(self.radius) if isinstance(self.radius, tuple) else self.radius
        if self.gap <= -smallest:
            raise ValueError(
                f"gap = {self.gap:g} makes disks overlap by more than a radius: use a gap above {-smallest:g}"
            )
        return self


class Load(ScenarioTable):
    """Forces in units of `unit`: `press` on every disk towards the substrate, `push` along the row on one disk."""

    unit: Positive = Field(1 / 2000, description="unit of the forces in this table, in units of the scenario [force]")
    press: Finite = Field(0.1, description="force on every disk, towards the substrate [`unit`]")
    push: Loads = Field((0.0, 0.09), description="turning points of the quasi-static load path [`unit`]")
    step: Positive = Field(5e-4, description="largest increment of the push between two equilibria [`unit`]")
    disk: Annotated[int, Field(ge=1)] = Field(1, description="number of the pushed disk, counted from 1")

    @field_validator("press")
    @classmethod
    def _check_press(cls, value):
        if value <= 0:
            raise ValueError(
                f"press = {value:g} leaves the disks without contact with the substrate: use a positive force"
            )
        return value

    @field_validator("push")
    @classmethod
    def _check_push(cls, value):
        if len(value) < 2 or value[0] != 0.0:
            raise ValueError("push needs at least two turning points, the first of them 0.0, such as [0.0, 0.09]")
        return value


class Relaxation(ScenarioTable):
    """Search for equilibria by damped dynamics (drag on translations and rotations) or by Newton's method."""

    method: Literal["dynamics", "newton"] = Field(
        "dynamics", description="dynamics: damped dynamics, as in the paper; newton: Newton's method, which is faster"
    )
    drag: Positive = Field(0.05, description="drag on translations per unit mass [1/time]")
    spin_drag: Positive | None = Field(None, description="drag on rotations; default: same as `drag` [1/time]")
    dt: Positive = Field(0.1, description="time step of the damped dynamics [time]")
    tolerance: Positive = Field(1e-14, description="largest unbalanced force, or torque over R, at rest [force]")
    steps: Annotated[int, Field(ge=1)] = Field(2_000_000, description="number of steps after which the search stops")


class Dynamics(ScenarioTable):
    """Newtonian runs with tiny random velocities, from the equilibria at which the path first reaches given loads."""

    loads: Loads = Field((0.03, 0.04, 0.062, 0.083, 0.087, 0.09), description="pushes where runs start [`load.unit`]")
    watch: Finite | None = Field(
        None,
        description="load at which the transition is sampled finely; default: first load with sliding [`load.unit`]",
    )
    duration: Duration = Field(60_000.0, description="duration of each run [time]")
    dt: Positive = Field(0.1, description="time step [time]")
    seed_velocity: Positive = Field(
        1e-13, description="root mean square of the random initial velocities [length/time]"
    )
    drag: NotNegative = Field(0.0, description="drag on translations per unit mass [1/time]")
    spin_drag: NotNegative | None = Field(None, description="drag on rotations; default: same as `drag` [1/time]")

    @property
    def options(self) -> dict:
        """Time step and drags, as options of a free run."""
        return self.model_dump(include={"dt", "drag", "spin_drag"})


class Sliding(ScenarioTable):
    """Realisations of the transition at loads at which the array slides, to measure fronts and the sliding velocity."""

    loads: Loads = Field((), description="pushes; default: none, and hence no realisations [`load.unit`]")
    realizations: Annotated[int, Field(ge=1, le=100_000)] = Field(
        25, description="realisations at each load, which differ in their random velocities"
    )
    duration: Duration = Field(40_000.0, description="duration of each run [time]")
    thresholds: Annotated[tuple[Positive, ...], Listed] = Field(
        (0.01, 0.02, 0.05, 0.1), min_length=1, description="displacements at which a disk counts as sliding [length]"
    )


class DiskArrayScenario(ScenarioBase):
    """Complete definition of a disk-array run: disks in a row on a substrate."""

    experiment: Literal["disk-array"] = "disk-array"
    seed: Seed = 0
    array: Array = Array()
    law: PackingLaw = PackingLaw()
    load: Load = Load()
    relaxation: Relaxation = Relaxation()
    dynamics: Dynamics = Dynamics()
    sliding: Sliding = Sliding()

    @property
    def dim(self) -> int:
        """Number of dimensions: two."""
        return 2

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: load steps, memory of the path with its complex modes, time steps, and runs."""
        load, disks, dt = self.load, self.array.disks, self.dynamics.dt
        steps = sum(abs(b - a) for a, b in pairwise(load.push)) / load.step
        yield Size("load.push takes", steps, "load steps", "use a larger load.step")
        memory = steps * (16 * (3 * disks) ** 2 + STATE * disks)
        yield Size("spectra along the path take", memory, "bytes", "use a larger load.step")
        yield Size("relaxation.steps allows", self.relaxation.steps, "time steps", "use fewer")
        for name, table in (("dynamics", self.dynamics), ("sliding", self.sliding)):
            yield Size(f"{name}.duration takes", table.duration / dt, "time steps", "use a longer dynamics.dt")
        runs = len(self.sliding.loads) * self.sliding.realizations
        yield Size("sliding.loads and sliding.realizations make", runs, "runs", "use fewer realisations")

    @model_validator(mode="after")
    def _check_loads(self):
        if self.load.disk > self.array.disks:
            raise ValueError(f"load.disk must be at most {self.array.disks}, the number of disks, got {self.load.disk}")
        if self.dynamics.watch is not None and self.dynamics.watch not in self.dynamics.loads:
            raise ValueError(
                f"dynamics.watch = {self.dynamics.watch:g} is not among dynamics.loads {self.dynamics.loads}: use one "
                f"of them"
            )
        radius = self.array.radius if isinstance(self.array.radius, tuple) else (self.array.radius,)
        if self.law.file is not None:
            return self
        power = 2 / 3 if self.law.kind == "hertz_mindlin" else 1.0
        overlap = (self.load.press * self.load.unit / (self.law.wall.kn or self.law.kn)) ** power
        if overlap > 0.2 * min(radius):
            raise ValueError(
                f"load.press = {self.load.press:g} makes disks overlap the substrate by {overlap:.3g}, more than a "
                "fifth of a radius, where contact laws are invalid: use a smaller press or a larger kn"
            )
        low, high = min(self.load.push), max(self.load.push)
        for table in ("dynamics", "sliding"):
            for value in getattr(self, table).loads:
                if not low <= value <= high:
                    raise ValueError(
                        f"{table}.loads contains {value:g}, which load.push ({low:g} to {high:g}) never reaches: use "
                        f"loads in this range"
                    )
        return self
