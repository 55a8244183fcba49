"""Samples of element tests, and their paths: the imposed strains and stresses of the cell.

The axial direction is the last, y for disks and z for spheres. Compression is positive in strains and stresses.
"""

from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import numpy as np

from .... import Law, State, accept, forces
from ....control import loads, stress_controlled
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
from .scenario import AT_REST, BALANCED, Cement, ElementSample, Loading

AXES = "xyz"


class Drive(NamedTuple):
    """Control of the cell along a path."""

    gradient: np.ndarray  # (3, 3) displacement gradient per unit of the driven strain; zero if the load is a pressure
    free: tuple[int, ...]  # axes along which the normal stress is controlled
    sealed: np.ndarray | None = None  # (K, 3) normal strains that hold the total stress of a cell with a fluid


def drive_of(loading: Loading, dim: int) -> Drive:
    """Control of the cell along a path in `dim` dimensions."""
    gradient, axial = np.zeros((3, 3)), dim - 1
    lateral = tuple(range(axial))
    if loading.kind == "isotropic":
        return Drive(gradient, (), np.eye(3)[:dim]) if loading.fluid_modulus else Drive(gradient, (*lateral, axial))
    if loading.kind == "simple-shear":
        gradient[0, 1] = 1.0
        return Drive(gradient, (1,))
    gradient[axial, axial] = -1.0
    if loading.kind == "undrained":
        gradient[lateral, lateral] = 1 / (dim - 1)
    free = {"oedometric": (), "undrained": (), "plane-strain": (0,)}
    sealed = np.isin(np.arange(3), lateral)[None].astype(float) if loading.fluid_modulus else None
    return Drive(gradient, free.get(loading.kind, lateral), sealed)


def fluid_pressure(void_ratio: float | np.ndarray, start: float, modulus: float) -> float | np.ndarray:
    """Excess pressure K_f ln(e₀/e) of a trapped fluid that fills the pores between rigid grains.

    This is du = −K_f dV_p/V_p = (K_f/n) dε_v with the porosity n, integrated from the void ratio `start`.
    """
    return modulus * np.log(start / void_ratio)


def wanted_stress(loading: Loading, pressure: float, stress: np.ndarray, dim: int) -> np.ndarray:
    """Normal stresses along the axes (3,) that a path prescribes, given the current `stress`."""
    wanted, axial = np.full(3, pressure), float(stress[dim - 1, dim - 1])
    if loading.kind == "constant-p":
        wanted[: dim - 1] = (dim * pressure - axial) / (dim - 1)
    if loading.kind == "true-triaxial":
        wanted[1] = pressure + loading.b * (axial - pressure)
    return wanted


def depends_on_stress(loading: Loading) -> bool:
    """Return True if the prescribed stresses follow the axial stress."""
    return loading.kind in ("constant-p", "true-triaxial")


def controlled(state: State, drive: Drive, wanted: np.ndarray, mass: float = 0.0) -> State:
    """State whose cell follows prescribed stresses along a path's free axes; `mass` as in `stress_controlled`."""
    stress = {AXES[k] * 2: float(wanted[k]) for k in drive.free}
    return state._replace(control=stress_controlled(state.control, stress, mass=mass))


def strain_of(cell: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Strains (ε_xx, ε_yy, ε_zz, γ) of a cell, from its present and initial vectors.

    Normal strains are logarithmic, compression positive, so their sum is the volumetric strain. γ is the change of
    the tangent of the angle by which the second vector is inclined along x.
    """
    lean = cell[1, 0] / cell[1, 1] - start[1, 0] / start[1, 1]
    return np.append(-np.log(np.diag(cell) / np.diag(start)), lean)


def check_pressures(
    sample: ElementSample, law: Law, kept: Checkpoint | None, *, path: Iterable[float] = (),
    cement: Cement | None = None,
) -> None:  # fmt: skip
    """Raise ScenarioError, before anything is saved, if the law cannot carry the pressures of a test or its cement."""
    stresses = [("sample.pressure", sample.pressure), *(("path.pressures", p) for p in path)]
    if cement:
        weaker = min("tensile_strength", "shear_strength", key=partial(getattr, cement))
        more = [(f"cement.{name}", getattr(cement, name)) for name in ("confining", weaker)]
        stresses += [(key, stress) for key, stress in more if stress > sample.pressure]
    for key, pressure in stresses:
        try:
            radius, mass = 0.5 * sample.diameters, sample.masses
            check_pressure(law, pressure, radius=radius, mass=mass, dim=sample.dim, name=key)
        except ValueError as problem:
            if kept:
                abandon(kept)
            raise ScenarioError(str(problem)) from None


def make_sample(sample: ElementSample, law: Law, seed: int, report: Report) -> tuple[State, PackingInfo]:
    """Isotropic sample, compressed with the friction that controls its density, then settled under its law."""
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
