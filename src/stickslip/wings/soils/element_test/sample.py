"""Samples of element tests: grains of a grading, compressed to an isotropic pressure and a density."""

from collections.abc import Iterable

import numpy as np

from .... import Law, State, accept, forces
from ....control import loads
from ....kit import (
    Checkpoint,
    Report,
    ScenarioError,
    abandon,
    check_pressure,
    compression_scales,
    packing_info,
    servo_mass,
    settle,
    with_values,
    within,
)
from ....packings import compressed
from ....results import Factorisation, PackingInfo
from .paths import Drive, controlled
from .scenario import ElementSample

AT_REST, BALANCED = 1e-4, 1e-9  # tolerance of the compression, and of equilibria, over p D^(dim−1)


def check_pressures(sample: ElementSample, law: Law, kept: Checkpoint | None, *, path: Iterable[float] = ()) -> None:
    """Raise ScenarioError, before anything is saved, if the law cannot carry the pressures of a sample and a path."""
    for key, pressure in (("sample.pressure", sample.pressure), *(("path.pressures", p) for p in path)):
        try:
            check_pressure(law, pressure, radius=0.5 * sample.diameters, mass=sample.masses, dim=sample.dim)
        except ValueError as problem:
            if kept:
                abandon(kept)
            raise ScenarioError(str(problem).replace("pressure =", f"{key} =", 1)) from None


def make_sample(sample: ElementSample, law: Law, seed: int, report: Report) -> tuple[State, PackingInfo]:
    """Isotropic sample, compressed with the friction that controls its density, then settled under its own law."""
    friction = sample.friction
    slippery = law if friction is None else with_values(law, mu=friction)
    state, _ = compressed(
        sample.grains, pressure=sample.pressure, dim=sample.dim, radius=0.5 * sample.diameters, mass=sample.masses,
        law=slippery, seed=seed, tolerance=AT_REST * sample.pressure * sample.area,
        report=within(report, 0.0, 0.0, prefix=f"sample {seed}: "),
    )  # fmt: skip
    tolerance = BALANCED * sample.pressure * sample.area
    every = Drive(np.zeros((3, 3)), tuple(range(sample.dim)))
    scales = compression_scales(state, law, sample.pressure, tolerance)
    mass = servo_mass(state, sample.pressure, scales)
    state = controlled(accept(state, forces(state, law)[1]), every, np.full(3, sample.pressure), mass)
    end, _ = settle(state, law, scales, tolerance=tolerance, keep=Factorisation())
    end = end._replace(control=loads(sample.grains))
    return end, packing_info(end, law)
