"""Samples of element tests: imposed strains and stresses of the cell, cement, and directions in which they can fail.

The axial direction is the last, y for disks and z for spheres. Compression is positive in strains and stresses. Cement
is made of bonds. Most signs of failure assume that contacts at the Coulomb limit keep sliding. Second-order work is
instead found by finite steps in each direction, and uniqueness concerns all statuses of these contacts.

Source
------
Cement: Potyondy & Cundall, doi:10.1016/j.ijrmms.2004.09.011.
"""

from collections.abc import Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from .... import Law, State, accept, forces, stability
from ....control import loads, stress_controlled
from ....kit import (
    FAILURES,
    UNBREAKABLE,
    Checkpoint,
    Report,
    Scales,
    ScenarioError,
    abandon,
    bond_limits,
    check_pressure,
    compression_scales,
    packing_info,
    readable,
    servo_mass,
    settle,
    with_values,
    within,
)
from ....laws import parallel_bond
from ....measure import stress
from ....packings import bonded, compressed
from ....protocols import Envelope, localisation, response_envelope
from ....results import Factorisation, Localisation, PackingInfo
from ...status.complementarity import complementarity
from ...status.matrices import linear_system
from ...status.uniqueness import UniquenessVerdict, certificate
from .scenario import AT_REST, BALANCED, Cement, ElementSample, Loading

AXES = "xyz"


class Drive(NamedTuple):
    """Control of the cell along a path."""

    gradient: np.ndarray  # (3, 3) displacement gradient per unit of the driven strain; zero if the load is a pressure
    free: tuple[int, ...]  # axes along which the normal stress is controlled
    sealed: np.ndarray | None = None  # (K, 3) normal strains that keep the total stress of a cell with a fluid


def drive_of(loading: Loading, dim: int) -> Drive:
    """Return the control of the cell along a path in `dim` dimensions."""
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
    """Compress an isotropic sample with the friction that controls its density, then settle it under its law."""
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


STEPS = 5  # number of pressure steps between the pressures of the sample and of the test
CUT = 3.0  # number of standard deviations at which the distribution of strengths is cut off


@readable
class Breaks(NamedTuple):
    """Broken bonds in the order of breakage."""

    row: np.ndarray  # (K,) int, row of the series in whose step the bond broke; 0: before the test
    i: np.ndarray  # (K,) int, indices of the two grains
    j: np.ndarray  # (K,) int
    tension: np.ndarray  # (K,) bool, True if the tensile strength was reached, False for the shear strength
    energy: np.ndarray  # (K,) elastic energy of the bond when it broke [energy]
    position: np.ndarray  # (K, 3) midpoint of the bond in the first periodic cell [length]


class Cemented(NamedTuple):
    """Cemented sample under the pressure of its test."""

    state: State
    breaks: Breaks  # bonds that broke on the way to that pressure


NO_BREAKS = Breaks(*np.zeros((3, 0), int), np.zeros(0, bool), np.zeros(0), np.zeros((0, 3)))


def join(parts: list[Breaks]) -> Breaks:
    """Join several catalogues of broken bonds."""
    return Breaks(*map(np.concatenate, zip(NO_BREAKS, *parts, strict=True)))


def with_cement(state: State, cement: Cement, contact_modulus: float, seed: int) -> State:
    """Bond the grains of a state; the stiffness per area along a bond is E/(R_i + R_j), with modulus E of the cement.

    Parameters
    ----------
    contact_modulus : modulus relative to which `cement.modulus` is stated [force/length^(dim−1)]
    seed : seed for the scatter of strengths
    """
    radius = state.grains.radius
    bond = parallel_bond(
        1.0, 1 / cement.stiffness_ratio, cement.tensile_strength, cement.shear_strength, radius=cement.radius
    )
    state = bonded(state, bond, within=2 * cement.gap * radius.mean())
    bonds = state.bonds
    modulus = cement.modulus * contact_modulus / (radius[bonds.i] + radius[bonds.j])
    share = np.random.default_rng(seed).uniform(ndtr(-CUT), ndtr(CUT), (len(bonds.i), 2))
    factor = 1 + cement.scatter * ndtri(share)[:, [0, 1, 0, 1]]  # for tension and bending, and for shear and twisting
    return state._replace(
        bonds=bonds._replace(
            stiffness=modulus[:, None] * bonds.stiffness, strength=np.minimum(factor * bonds.strength, UNBREAKABLE)
        )
    )


def unloaded(
    state: State, law: Law, pressures: tuple[float, float], mass: float, scales: Scales, tolerance: float
) -> Cemented:
    """Change the isotropic pressure of a cemented sample in small steps from the first to the second value.

    Parameters
    ----------
    mass : mass of the cell, see `servo_mass`
    tolerance : largest unbalanced force [force]
    """
    every, broken = Drive(np.zeros((3, 3)), tuple(range(state.cell.dim))), []
    for pressure in np.linspace(*pressures, STEPS + 1)[1:]:
        state, _ = settle(
            controlled(state, every, np.full(3, pressure), mass), law, scales, tolerance=tolerance,
            keep=Factorisation(), broke=lambda before, after: broken.append(describe_break(before, after)),
        )  # fmt: skip
    return Cemented(state._replace(control=loads(len(state.grains.radius))), join(broken))


def describe_break(before: State, after: State, row: int = 0) -> Breaks:
    """Return the single bond that is intact in the equilibrium `before` and broken in `after`."""
    bonds, vectors = before.bonds, before.cell.vectors
    k = np.flatnonzero(bonds.intact & ~after.bonds.intact)
    i, j, position = bonds.i[k], bonds.j[k], before.grains.position
    middle = 0.5 * (position[i] + position[j] + bonds.image[k] @ vectors)
    tension = np.isin(after.bonds.failed[k], [FAILURES.index(load) for load in ("tension", "bending")])
    middle = np.mod(middle, np.where(before.cell.periodic, np.diag(vectors), np.inf))
    return Breaks(np.full(1, row), i, j, tension, bond_limits(before).energy[k], middle)


def has_failed(stress: np.ndarray, cement: Cement, dim: int) -> bool:
    """Return True if the axial stress (T, 3, 3), less the confining stress, has fallen to `until` of its maximum."""
    lead = np.abs(stress[:, dim - 1, dim - 1] - cement.confining)
    return bool(len(lead) and lead[-1] < cement.until * lead.max())


SPECTRA_UP_TO = 6000  # largest number of coordinates for which eigenvalues are computed, in about a minute
SIGNS = {
    "complex pair, fixed strain": "an oscillation grows while the cell is held",
    "complex pair, fixed stress": "an oscillation grows while all stresses are held",
    "divergence, fixed strain": "a motion grows without oscillating while the cell is held",
    "divergence, fixed stress": "a motion grows without oscillating while all stresses are held",
    "not unique": "under some loads none or several statuses of the contacts are possible",
    "negative work": "second-order work is negative in some direction",
    "band": "the acoustic tensor of some plane has no positive determinant",
    "no equilibrium": "a small strain in some direction leads to no equilibrium nearby",
}


class ProbedState(NamedTuple):
    """Responses and signs of failure of a sample at rest, with its cell held at one strain of its path."""

    load: float  # imposed strain
    stress: np.ndarray  # (3, 3) at rest, compression positive [force/length^(dim−1)]
    envelope: Envelope | None  # None if no equilibrium at this strain can be probed
    band: Localisation | None  # weakest plane; None without an envelope
    unique: str  # name of the verdict on the uniqueness of the contact status under all stresses
    pair: np.ndarray  # (2,) growth rate of the fastest complex pair at fixed strain and stress; NaN: unknown [1/time]
    real: np.ndarray  # (2,) growth rate of the fastest motion without oscillation, likewise [1/time]
    reason: str = ""  # reason for a missing envelope

    @property
    def signs(self) -> dict[str, bool]:
        """For each of `SIGNS`, True if the state shows it."""
        if self.envelope is None or self.band is None:
            return dict.fromkeys(SIGNS, False)
        verdict = UniquenessVerdict[self.unique]
        seen = (
            *(self.pair > 0), *(self.real > 0),
            verdict in (UniquenessVerdict.NOT_UNIQUE, UniquenessVerdict.SINGULAR),
            (self.envelope.work < 0).any(), self.band.determinant <= 0, self.envelope.collapsed.any(),
        )  # fmt: skip
        return dict(zip(SIGNS, map(bool, seen), strict=True))

    @property
    def failing(self) -> float:
        """Angle of the weakest direction or, if no work is negative, of the first one without equilibrium [rad]."""
        if self.envelope is None or self.signs["negative work"] or not self.envelope.collapsed.any():
            return self.weakest
        return float(self.envelope.angle[self.envelope.collapsed][0])

    @property
    def weakest(self) -> float:
        """Angle of the direction with the smallest normalised second-order work, among those with a response [rad]."""
        work = self.envelope.normalised_work if self.envelope else np.full(1, np.nan)
        return float(self.envelope.angle[np.nanargmin(work)]) if np.isfinite(work).any() else float("nan")


def plane_of(path: Loading, dim: int) -> tuple[np.ndarray, tuple[str, str]]:
    """Two tensors that span the plane of probed strains, and their names."""
    unit = np.eye(dim)
    axial, along = np.outer(unit[-1], unit[-1]), np.outer(unit[0], unit[0])
    if path.kind == "simple-shear":
        shear = np.outer(unit[0], unit[1])
        return np.array([-(shear + shear.T), np.outer(unit[1], unit[1])]), ("shear", "normal")
    return np.array([axial, along if path.kind == "plane-strain" else np.eye(dim) - axial]), ("axial", "lateral")


def probe(state: State, law: Law, load: float, plane: np.ndarray, directions: int) -> ProbedState:
    """Probe an equilibrium, whose cell is held, in all directions within a plane of strains."""
    sigma, unknown = stress(state, law), np.full(2, np.nan)
    try:
        envelope = response_envelope(state, law, directions=directions, plane=plane)
        band = localisation(state, law)
    except ValueError as problem:
        return without_answer(load, sigma, str(problem))
    dim = state.cell.dim
    loose = state._replace(control=stress_controlled(state.control, sigma[:dim, :dim]))
    pair, real = unknown, unknown
    if len(state.grains.radius) * (3 if dim == 2 else 6) <= SPECTRA_UP_TO:
        spectra = [stability(each, law, dashpots=False, method="fastest") for each in (state, loose)]
        pair = np.array([each.growth_rate.max(initial=0.0) for each in spectra])
        real = np.array([np.sqrt(-each.negative).max(initial=0.0) for each in spectra])
    return ProbedState(load, sigma, envelope, band, _uniqueness(loose, law), pair, real)


def without_answer(load: float, sigma: np.ndarray, reason: str) -> ProbedState:
    """Return the result for a state that has no equilibrium, or whose equilibrium cannot be probed."""
    return ProbedState(load, sigma, None, None, "UNDECIDED", np.full(2, np.nan), np.full(2, np.nan), reason)


def _uniqueness(loose: State, law: Law) -> str:
    """Name of the verdict on the contact status under all stresses of the cell."""
    try:
        system = linear_system(loose, law)
        return certificate(complementarity(system, np.zeros(len(system.free)))).verdict.name
    except ValueError:  # an unresisted motion, or a law without a sharp limit
        return UniquenessVerdict.UNDECIDED.name


def first_seen(probes: tuple[ProbedState, ...]) -> dict[str, ProbedState | None]:
    """Return, for each sign, the first state of a path that shows it."""
    return {sign: next((state for state in probes if state.signs[sign]), None) for sign in SIGNS}


def directions_seen(probes: tuple[ProbedState, ...]) -> ProbedState | None:
    """First state with a failing direction: second-order work is negative, or no equilibrium is nearby."""
    return next((each for each in probes if each.signs["negative work"] or each.signs["no equilibrium"]), None)


def describe_direction(angle: float, path: Loading, dim: int, sign: int = 1) -> str:
    """Components of the unit strain in a direction, and the sense of its volume change.

    Examples
    --------
    >>> describe_direction(np.radians(315), Loading(), 2)
    '315° (axial strain 0.71, lateral strain -0.71, constant volume)'
    """
    plane, names = plane_of(path, dim)
    unit = plane / np.linalg.norm(plane, axis=(1, 2), keepdims=True)
    strain = np.cos(angle) * unit[0] + np.sin(angle) * unit[1]
    parts = [(strain * tensor).sum() / (tensor != 0).sum() for tensor in np.sign(plane)]
    volume = float(strain.trace())
    change = "constant volume" if abs(volume) < 1e-9 else "compression" if volume > 0 else "dilation"
    named = ", ".join(f"{name} strain {sign * part:.2f}" for name, part in zip(names, parts, strict=True))
    return f"{np.degrees(angle):.4g}° ({named}, {change})"
