"""Scenario of earthquake cycles on a straight fault. The defaults are the SEAS benchmark problem BP1-QD."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from ....kit import YEAR, Finite, Listed, NotNegative, Positive, ScenarioBase, ScenarioTable, Seed, Size
from ..friction.fault import Fault, Shear, Slip, check_normal, line_fault
from ..friction.laws import EvolutionLaw
from ..friction.stress_transfer import Boundary, Injection, Oscillation, StressTable, read_stress_table

STATIONS = (0.0, 2500.0, 5000.0, 7500.0, 10e3, 12.5e3, 15e3, 17.5e3, 20e3, 25e3, 30e3, 35e3)
Point = Annotated[tuple[NotNegative, NotNegative], Listed]
Profile = Annotated[NotNegative | tuple[Point, ...], Listed]
Numbers = Annotated[tuple[Finite, ...], Listed]


class Line(ScenarioTable):
    """The fault: a straight line of cells from depth 0 downwards."""

    width: Positive = Field(40e3, description="length of the part with rate-and-state friction [m]")
    cell: Positive = Field(
        50.0, description="length of a cell, at most a third of the cohesive length, G dc/(b normal) [m]"
    )
    shear: Shear = Field("antiplane", description="direction of slip")
    dip: Annotated[float, Field(gt=0, le=90)] = Field(
        90.0, description="dip, for in-plane shear with a free surface; depths are then distances down dip [degrees]"
    )
    slip: Slip = Field("thrust", description="direction of in-plane slip, with a free surface")
    boundary: Boundary = Field(
        "surface",
        description="surface: free surface at depth 0; infinite: segment in an infinite body; periodic: period `width`",
    )
    thickness: Positive | None = Field(None, description="thickness of the plates beside a periodic fault [m]")
    strike_length: Positive | None = Field(
        None,
        description="length of the ruptures along strike, normal to the plane of the model, for seismic moments and "
        "magnitudes; default: moments per metre, without magnitudes [m]",
    )


class Medium(ScenarioTable):
    """The elastic body."""

    density: Positive = Field(2670.0, description="density of the body [kg/m³]")
    wave_speed: Positive = Field(3464.0, description="speed of shear waves [m/s]")
    poisson: Annotated[float, Field(gt=-1, lt=0.5)] = Field(0.25, description="Poisson's ratio, for in-plane shear")


class FaultFriction(ScenarioTable):
    """Friction; a, b, dc, b2, dc2 and normal are numbers, or pairs [depth, value], interpolated linearly."""

    law: EvolutionLaw = Field("aging", description="evolution law of the state θ")
    form: Literal["regularized", "logarithmic"] = Field(
        "regularized", description="dependence of friction on velocity: arcsinh or logarithm"
    )
    a: Profile = Field(((15e3, 0.010), (18e3, 0.025)), description="direct effect")
    b: Profile = Field(0.015, description="evolution effect")
    dc: Profile = Field(8e-3, description="characteristic slip [m]")
    normal: Profile = Field(50e6, description="effective normal stress [Pa]")
    mu0: NotNegative = Field(0.6, description="steady-state friction at v0")
    v0: Positive = Field(1e-6, description="reference velocity [m/s]")
    b2: Profile = Field(0.0, description="evolution effect of a second state; 0: one state")
    dc2: Profile | None = Field(None, description="characteristic slip of the second state; needed with b2 [m]")
    v1: Positive | None = Field(
        None, description="cut-off velocity of the direct effect, for the logarithmic form; default: none [m/s]"
    )
    v2: Positive | None = Field(
        None, description="cut-off velocity of the evolution effect, for the logarithmic form; default: none [m/s]"
    )
    alpha: NotNegative = Field(0.0, description="effect of normal-stress changes on the states (Linker and Dieterich)")


class FluidInjection(ScenarioTable):
    """Fluid injected at one depth; it spreads along the fault and lowers the effective normal stress."""

    flux: NotNegative = Field(
        0.0, description="injected volume per time and cross-section of the fault, half to each side; 0: none [m/s]"
    )
    storage: Positive = Field(1e-9, description="porosity × compressibility of pores and fluid [1/Pa]")
    diffusivity: Positive = Field(0.1, description="hydraulic diffusivity along the fault [m²/s]")
    start: NotNegative = Field(0.0, description="start of the injection [s]")
    stop: Positive | None = Field(None, description="end of the injection; default: none [s]")
    at: NotNegative = Field(0.0, description="depth of the source [m]")


class NormalStress(ScenarioTable):
    """Changes added to the effective normal stress: an oscillation, a table, or both."""

    amplitude: NotNegative = Field(0.0, description="amplitude of a sinusoidal oscillation; 0: none [Pa]")
    period: Positive = Field(44714.0, description="period of the oscillation; default: that of the main lunar tide [s]")
    times: Numbers = Field((), description="times of a table, increasing [s]")
    depths: Numbers = Field((0.0,), description="depths of a table, increasing [m]")
    changes: Annotated[tuple[Numbers, ...], Listed] = Field(
        (),
        description="changes in a table: one list over depth for each time, interpolated linearly; pressures count "
        "as negative [Pa]",
    )
    file: str | None = Field(
        None, description="CSV file, instead of times, depths and changes; see `ss.friction.read_stress_table`"
    )

    @model_validator(mode="before")
    @classmethod
    def _read_file(cls, given: Any):
        if isinstance(given, dict) and isinstance(given.get("file"), str):
            if given.keys() & {"times", "depths", "changes"}:
                raise ValueError("normal_stress.file and a table exclude each other: give one")
            table = read_stress_table(given["file"])
            names = {"times": table.time, "depths": table.depth, "changes": table.values}
            return {key: value for key, value in given.items() if key != "file"} | {
                name: values.tolist() for name, values in names.items()
            }
        return given


class Loading(ScenarioTable):
    """Plate motion and initial state."""

    plate_rate: NotNegative = Field(
        1e-9, description="slip velocity of the rest of the plane, or of the plates; 0: none [m/s]"
    )
    velocity: Positive | None = Field(None, description="slip velocity at the start; default: plate_rate [m/s]")
    stress: Literal["steady"] | Profile | None = Field(
        None,
        description="initial shear stress: a number, pairs [depth, value], or `steady`: steady sliding of each cell; "
        "default: the steady stress of the deepest cell everywhere [Pa]",
    )


class FaultRun(ScenarioTable):
    """Duration and output."""

    years: Annotated[float, Field(gt=0, le=1e6)] = Field(
        1200.0, description="duration, in years of 365.25 days; an event in progress is completed"
    )
    tolerance: Annotated[float, Field(ge=1e-12, le=1e-2)] = Field(
        1e-4, description="error tolerance of each step, for slip over dc and for ln θ"
    )
    stations: Annotated[tuple[NotNegative, ...], Listed] = Field(
        STATIONS, description="depths of time series [m], by default those on the fault"
    )
    surface: Numbers = Field(
        (),
        description="stations at the surface, for in-plane shear: distances from the trace of the fault, positive "
        "above the hanging wall, such as −0.01 and 0.01 for the two sides of the trace [m]",
    )
    threshold: Positive = Field(1e-3, description="an event lasts while any cell slips at least this fast [m/s]")
    sampling: Positive = Field(
        0.1 * YEAR,
        description="time between samples outside events; longest time step if the normal stress changes [s]",
    )
    interval: Positive = Field(5.0, description="years between profiles of slip outside events")
    seismic_interval: Positive = Field(1.0, description="time between profiles of slip within events [s]")
    spacing: Positive = Field(500.0, description="distance between the points of a profile [m]")


class FaultScenario(ScenarioBase):
    """Complete definition of earthquake cycles on a straight fault."""

    si: ClassVar[bool] = True
    experiment: Literal["fault"] = "fault"
    seed: Seed = 0
    line: Line = Line()
    medium: Medium = Medium()
    friction: FaultFriction = FaultFriction()
    injection: FluidInjection = FluidInjection()
    normal_stress: NormalStress = NormalStress()
    loading: Loading = Loading()
    run: FaultRun = FaultRun()

    def sizes(self) -> Iterator[Size]:
        """Iterate over sizes: cells, points and profiles; an event is assumed to last one transit of a shear wave."""
        line, run = self.line, self.run
        points, quiet = line.width / run.spacing, run.years / run.interval
        seismic = line.width / self.medium.wave_speed / run.seismic_interval
        yield Size("line.width and line.cell make", line.width / line.cell, "cells", "use longer cells")
        yield Size("run.spacing makes", points, "points", "use a larger spacing")
        yield Size("run.years and run.interval make", quiet, "profiles", "use a longer interval")
        yield Size("run.seismic_interval makes", seismic, "profiles", "use a longer interval")
        tables = 3 if line.shear == "in-plane" and line.boundary == "surface" else 1
        yield Size("profiles take", 8 * tables * points * (quiet + seismic), "bytes", "use a larger run.spacing")

    @model_validator(mode="after")
    def _check_fault(self):
        check_normal(self.fault, self.run.years * YEAR)
        deep = [depth for depth in self.run.stations if depth > self.line.width]
        if deep and "stations" not in self.run.model_fields_set:
            on_fault = tuple(depth for depth in STATIONS if depth not in deep)
            object.__setattr__(self, "run", self.run.model_copy(update={"stations": on_fault}))  # scenarios are frozen
        elif deep:
            raise ValueError(f"run.stations contains {deep[0]:g} m: use depths from 0 to line.width")
        if self.run.surface and not self.fault.dips:
            raise ValueError('run.surface requires line.shear = "in-plane" and line.boundary = "surface"')
        if 0 in self.run.surface:
            raise ValueError("run.surface contains 0: use 0.01 and −0.01 for the two sides of the trace")
        if self.run.threshold <= self.loading.plate_rate:
            raise ValueError(f"run.threshold must exceed loading.plate_rate, got {self.run.threshold:g} m/s")
        return self

    @property
    def changes(self) -> tuple[Injection | Oscillation | StressTable, ...]:
        """Imposed changes of the normal stress over time."""
        fluid, stress = self.injection.model_dump(), self.normal_stress
        stop = fluid.pop("stop") or float("inf")
        source = (Injection(**fluid, stop=stop),) if fluid["flux"] else ()
        wave = (Oscillation(stress.amplitude, stress.period),) if stress.amplitude else ()
        if not (stress.times or stress.changes):
            return source + wave
        if len({len(row) for row in stress.changes}) > 1:
            raise ValueError("the rows of normal_stress.changes differ in length: use a value for each depth")
        table = StressTable(*(np.array(values, float) for values in (stress.times, stress.depths, stress.changes)))
        return (*source, *wave, table)

    @property
    def fault(self) -> Fault:
        """Fault of the scenario."""
        surface = {name: value for name, value in self.friction.model_dump().items() if value is not None}
        profiles = {name: surface.pop(name, None) for name in ("a", "b", "dc", "normal", "b2", "dc2")}
        return line_fault(
            self.line.width, self.line.cell, **profiles, **surface, shear=self.line.shear, dip=self.line.dip,
            slip=self.line.slip,
            boundary=self.line.boundary, thickness=self.line.thickness or float("inf"),
            shear_modulus=self.medium.density * self.medium.wave_speed**2, wave_speed=self.medium.wave_speed,
            poisson=self.medium.poisson, plate_rate=self.loading.plate_rate, changes=self.changes,
        )  # fmt: skip
