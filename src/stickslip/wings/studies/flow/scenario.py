"""Scenario of a flow: grains poured between walls and plates, then stages with other walls, plates or gravity.

For plates and pouring, y points upwards; gravity is an arbitrary vector. Any consistent set of units may be used.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from ....kit import (
    BY_NAME,
    LIMITS,
    STATE,
    Finite,
    LawTable,
    Listed,
    NotNegative,
    Positive,
    Ranks,
    ScenarioBase,
    ScenarioTable,
    Seed,
    Several,
    Size,
    allow_laws,
    require_lammps_for_ranks,
)

AXES = "xyz"
Vector = Annotated[tuple[Finite, ...], Listed, Field(min_length=2, max_length=3)]
Knot = Annotated[tuple[Finite, Finite], Listed]
Name = Annotated[str, Field(pattern=r"^[ .]*[\w+-][\w .+-]*$", max_length=40)]  # for tables, files and messages
Names = Annotated[tuple[str, ...], Listed]


class Shaking(ScenarioTable):
    """Velocity A sin(2π f t + φ), with t measured from the start of the stage."""

    amplitude: Finite = Field(description="velocity amplitude A; the displacement amplitude is A/(2π f) [length/time]")
    frequency: Positive = Field(description="frequency f, not the angular frequency [1/time]")
    phase: Finite = Field(0.0, description="phase φ [rad]")


def _check_course(value):
    """Check a prescribed velocity, with a single message instead of pydantic's messages for all union members."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    table = isinstance(value, list | tuple) and len(value) > 1
    if not (number or table or isinstance(value, dict | Shaking)):
        raise ValueError(
            f"a velocity of {str(value)[:100]!r} is not allowed: use a number, a table [[time, velocity], …] of two "
            f"or more rows, or {{amplitude, frequency, phase}}"
        )
    return tuple(value) if table else value


Course = Annotated[Finite | tuple[Knot, ...] | Shaking, BeforeValidator(_check_course)]


class Motion(ScenarioTable):
    """Prescribed velocity along some axes; the motion along the other axes is unchanged."""

    x: Course | None = Field(
        None, description="a number, pairs [[time, velocity], …], or a sinusoidal oscillation [length/time]"
    )
    y: Course | None = Field(None, description="like `x` [length/time]")
    z: Course | None = Field(None, description="like `x`; only in three dimensions [length/time]")

    @model_validator(mode="after")
    def _check_times(self):
        for axis, course in self.prescribed.items():
            times = [t for t, _ in course] if isinstance(course, tuple) else []
            if times and (times[0] < 0 or any(b <= a for a, b in pairwise(times))):
                raise ValueError(
                    f"the velocity along {axis} has a table with times {times}: use increasing, non-negative times"
                )
        return self

    @property
    def prescribed(self) -> dict[str, float | tuple | Shaking]:
        """The prescribed velocities as functions of time, by axis."""
        return {axis: getattr(self, axis) for axis in AXES if getattr(self, axis) is not None}


class Pour(ScenarioTable):
    """Grains placed on a loose lattice in a region, without overlap, from the bottom up."""

    number: Annotated[int, Field(ge=1, le=LIMITS["grains"])] = Field(description="number of grains")
    low: Vector = Field(description="corner of the region [length]")
    high: Vector = Field(description="opposite corner [length]")
    dim: Literal[2, 3] = Field(2, description="2: disks in the plane, 3: spheres")
    radius: Several = Field(0.5, description="one radius, or several, each for an equal number of grains [length]")
    polydispersity: Annotated[float, Field(ge=0, le=0.5)] = Field(
        0.0, description="largest relative deviation of the radii, uniformly distributed"
    )
    density: Positive | None = Field(
        None, description="mass per unit volume, or per unit area in two dimensions [mass/length^dim]"
    )
    mass: Positive | None = Field(None, description="mass of each grain, instead of density [mass]")
    i0: Positive | None = Field(
        None, description="I0 in the moment of inertia I0 m R²; default: 2/5 for spheres, 1/2 for disks"
    )
    gap: Annotated[float, Field(gt=0, le=2)] = Field(
        0.1, description="gap between lattice sites, in units of the largest diameter"
    )

    @model_validator(mode="after")
    def _check_grains(self):
        if (self.density is None) == (self.mass is None):
            raise ValueError("give exactly one of grains.density and grains.mass")
        if isinstance(self.radius, tuple) and len(self.radius) > self.number:
            raise ValueError(f"grains.radius has {len(self.radius)} sizes for {self.number} grains: give fewer sizes")
        for name in ("low", "high"):
            _check_components(f"grains.{name}", getattr(self, name), self.dim)
        for axis, a, b in zip(AXES, self.low, self.high, strict=False):
            if a >= b:
                raise ValueError(
                    f"grains.low = {a:g} is not below grains.high = {b:g} along {axis}: swap or move the corners"
                )
        return self


@allow_laws(
    "linear", *BY_NAME, coulomb="sharp", kn=None, kt=None, young=None, poisson=None, mu=0.5, damping=None,
    damping_n=None, damping_t=None, damping_ratio=None, restitution=None, speed=None, lever=None, memory=None,
    rolling=None, k_roll=None, mu_roll=None, gamma_roll=None, twisting=None, k_twist=None, mu_twist=None,
    gamma_twist=None, tension=False, file=None, parameters={}, checksum=None,
)  # fmt: skip
class FlowLaw(LawTable):
    """Contact law; a restitution applies to two grains of mean size."""


class Box(ScenarioTable):
    """The cell: its lengths from the origin, and its periodic axes."""

    size: Vector | None = Field(
        None, description="lengths; needed for periodic axes and for plates, which span the cell [length]"
    )
    periodic: Annotated[tuple[Literal["x", "y", "z"], ...], Listed] = Field((), description="periodic axes")


class FlatWall(ScenarioTable):
    """An infinite flat wall: fixed, driven at a velocity, or loaded by a force along its normal."""

    name: Name = Field(description="name in stages and files")
    point: Vector = Field(description="point on the surface [length]")
    normal: Vector = Field(description="normal vector towards the grains, of any length")
    velocity: Motion = Motion()
    force: Finite | None = Field(
        None, description="force along the normal, towards the grains, in addition to the weight [force]"
    )
    mass: Positive | None = Field(None, description="mass, needed with a force [mass]")
    mu: NotNegative | None = Field(None, description="friction coefficient with grains; default: law.mu")


class Plate(ScenarioTable):
    """A rigid rough plate of glued grains across the cell: one row or, in three dimensions, a square lattice."""

    name: Name = Field(description="name in stages and files")
    height: Finite = Field(description="y coordinate of its grains [length]")
    radius: Positive | None = Field(None, description="radius of its grains; default: the mean radius [length]")
    spacing: Positive | None = Field(
        None, description="approximate spacing of its grains; default: 1.2 diameters [length]"
    )
    mass: Positive | None = Field(None, description="mass of the plate; default: that of its grains [mass]")
    velocity: Motion = Motion()
    force: Finite | None = Field(
        None, description="force along y, towards the poured grains, in addition to the weight [force]"
    )
    pressure: Finite | None = Field(None, description="pressure instead of a force [force/length^(dim−1)]")


class Stage(ScenarioTable):
    """Stage of the run, with the changes made at its start; everything else remains as before."""

    name: Name = Field(description="name in progress messages and files")
    duration: Positive = Field(description="duration, or maximum duration with `until` [time]")
    until: Literal["rest"] | None = Field(
        None, description='"rest" ends the stage early, as soon as the grains are at rest'
    )
    unbalanced: Positive = Field(
        1e-2, description="limit for rest: mean unbalanced force on grains over mean contact force"
    )
    kinetic: Positive = Field(
        1e-4, description="limit for rest: kinetic over elastic energy; at 1e-4, forces still oscillate by 1 %"
    )
    remove: Names = Field((), description="names of walls to remove")
    velocity: dict[str, Motion] = Field(
        {}, description="velocity of walls and plates, by name; see [[walls]] [length/time]"
    )
    force: dict[str, Finite] = Field({}, description="force on walls and plates, by name, towards the grains [force]")
    gravity: Vector | None = Field(None, description="gravity from this stage on; default: as before [length/time²]")
    drag: NotNegative | None = Field(None, description="drag from this stage on; default: as before [1/time]")


class FlowScenario(ScenarioBase):
    """Complete definition of a flow."""

    experiment: Literal["flow"] = "flow"
    seed: Seed = 0
    engine: Literal["stickslip", "lammps"] = Field("stickslip", description="engine that runs the stages")
    ranks: Ranks = Field(1, description="MPI processes of LAMMPS")
    grains: Pour
    law: FlowLaw
    cell: Box = Box()
    walls: Annotated[tuple[FlatWall, ...], Listed] = ()
    plates: Annotated[tuple[Plate, ...], Listed] = ()
    gravity: Vector | None = Field(None, description="gravity; default: none [length/time²]")
    drag: NotNegative = Field(0.0, description="drag on translations and rotations [1/time]")
    stages: Annotated[tuple[Stage, ...], Listed, Field(min_length=1)]
    dt: Positive | None = Field(
        None, description="time step; default: a twentieth of the duration of a collision [time]"
    )
    samples: Annotated[int, Field(ge=2, le=100_000)] = Field(400, description="rows of the time series")
    frames: Annotated[int, Field(ge=2, le=10_000)] = Field(20, description="number of saved states")

    @property
    def duration(self) -> float:
        """Longest possible duration of all stages together [time]."""
        return sum(stage.duration for stage in self.stages)

    def sizes(self) -> Iterator[Size]:
        """Yield the numbers of time steps and of periods of shaking, and the memory of saved states."""
        if self.dt is not None:
            yield Size("the stages take", self.duration / self.dt, "time steps", "use shorter stages or a longer dt")
        frames = self.frames + len(self.stages) + 1
        yield Size("saved states take", STATE * self.grains.number * frames, "bytes", "use fewer frames")
        motions = [(body.name, body.velocity) for body in (*self.walls, *self.plates)]
        motions += [item for stage in self.stages for item in stage.velocity.items()]
        for name, way in ((name, way) for name, motion in motions for way in motion.prescribed.values()):
            if isinstance(way, Shaking):
                periods = way.frequency * self.duration
                yield Size(f"{name} shakes", periods, "times", "use a lower frequency or shorter stages")

    @model_validator(mode="after")
    def _check_engine(self):
        require_lammps_for_ranks(self.engine, self.ranks)
        return self

    @model_validator(mode="after")
    def _check_dimensions(self):
        dim = self.grains.dim
        vectors = {"gravity": self.gravity, "cell.size": self.cell.size}
        for wall in self.walls:
            vectors |= {f"point of wall {wall.name!r}": wall.point, f"normal of wall {wall.name!r}": wall.normal}
        vectors |= {f"gravity of stage {stage.name!r}": stage.gravity for stage in self.stages}
        for name, vector in vectors.items():
            if vector is not None:
                _check_components(name, vector, dim)
        motions = {body.name: body.velocity for body in (*self.walls, *self.plates)}
        for stage in self.stages:
            motions |= {f"{name} in stage {stage.name}": m for name, m in stage.velocity.items()}
        for name, motion in motions.items():
            if dim == 2 and motion.z is not None:
                raise ValueError(f"the velocity of {name} has a z component, but grains.dim = 2: leave it out")
        return self

    @model_validator(mode="after")
    def _check_cell(self):
        dim, size, periodic = self.grains.dim, self.cell.size, self.cell.periodic
        if (periodic or self.plates) and size is None:
            raise ValueError("cell.size is missing: periodic axes and plates need it")
        if size is not None and min(size) <= 0:
            raise ValueError(f"all lengths of cell.size must be positive, got {list(size)}")
        for axis in periodic:
            k = AXES.index(axis)
            if k >= dim:
                raise ValueError(f'cell.periodic contains "{axis}", but grains.dim = {dim}: leave it out')
            if self.grains.high[k] - self.grains.low[k] > size[k] * (1 + 1e-12):
                raise ValueError(f"the region of grains is longer than the periodic cell along {axis}: shorten it")
            for wall in self.walls:
                if wall.normal[k]:
                    raise ValueError(
                        f"wall {wall.name!r} crosses the cell, which is periodic along {axis}: leave one of them out"
                    )
        if "y" in periodic and self.plates:
            raise ValueError('plates bound the cell along y, but cell.periodic contains "y": leave it out')
        return self

    @model_validator(mode="after")
    def _check_bodies(self):
        bodies = (*self.walls, *self.plates)
        names = [body.name for body in bodies]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two walls or plates are called {name!r}: give each a different name")
        for wall in self.walls:
            if not any(wall.normal):
                raise ValueError(
                    f"wall {wall.name!r} has a normal of length zero: give a vector that points towards the grains"
                )
        for plate in self.plates:
            if plate.force is not None and plate.pressure is not None:
                raise ValueError(f"plate {plate.name!r} has both a force and a pressure: give only one of them")
        for body in bodies:
            if body.force is not None or getattr(body, "pressure", None) is not None:
                _check_control(body, body.velocity, "")
        return self

    @model_validator(mode="after")
    def _check_stages(self):
        bodies = {body.name: body for body in (*self.walls, *self.plates)}
        walls, gone = {wall.name for wall in self.walls}, set()
        for stage in self.stages:
            for name in stage.remove:
                if name not in walls:
                    what = "is a plate" if name in bodies else "is unknown"
                    known = ", ".join(sorted(walls - gone)) or "none"
                    raise ValueError(f"stage {stage.name!r} removes {name!r}, which {what}: the walls are {known}")
            for name in (*stage.remove, *stage.velocity, *stage.force):
                if name not in bodies:
                    raise ValueError(
                        f"stage {stage.name!r} moves {name!r}, which is unknown: the walls and plates are "
                        f"{', '.join(bodies) or 'none'}"
                    )
                if name in gone:
                    raise ValueError(
                        f"stage {stage.name!r} names {name!r}, which an earlier stage removed: leave it out"
                    )
            gone |= set(stage.remove)
            for name in stage.force:
                _check_control(bodies[name], stage.velocity.get(name, Motion()), f" in stage {stage.name!r}")
        return self


def _check_components(name: str, vector: tuple, dim: int) -> None:
    if len(vector) != dim:
        raise ValueError(f"{name} has {len(vector)} components, but grains.dim = {dim}: give {dim}")


def force_axis(body: FlatWall | Plate) -> str | None:
    """Return the axis along which a force moves a body: y for plates, a wall's normal, or None if inclined."""
    if isinstance(body, Plate):
        return "y"
    along = [axis for axis, n in zip(AXES, body.normal, strict=False) if n]
    return along[0] if len(along) == 1 else None


def _check_control(body: FlatWall | Plate, velocity: Motion, where: str) -> None:
    """Raise ValueError if a body cannot be controlled by a force or is also controlled by a velocity."""
    axis = force_axis(body)
    if axis is None:
        raise ValueError(
            f"wall {body.name!r} has a force{where} but an inclined normal: a force needs a normal along an axis"
        )
    if isinstance(body, FlatWall) and body.mass is None:
        raise ValueError(f"wall {body.name!r} has a force{where} but no mass: give its mass")
    if axis in velocity.prescribed:
        raise ValueError(f"{body.name!r} has a force and a velocity along {axis}{where}: give only one of them")
