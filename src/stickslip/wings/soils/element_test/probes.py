"""Probes of element test states: directions in which the sample can fail, and the first sign of failure.

Most signs assume that contacts at the Coulomb limit keep sliding. Second-order work follows each direction by finite
steps instead, and uniqueness concerns all statuses of these contacts.
"""

from typing import NamedTuple

import numpy as np

from .... import Law, State, stability
from ....control import stress_controlled
from ....measure import stress
from ....protocols import Envelope, localisation, response_envelope
from ....results import Localisation, Stability
from ...status.complementarity import complementarity
from ...status.matrices import linear_system
from ...status.uniqueness import UniquenessVerdict, certificate
from .scenario import Loading

SPECTRA_UP_TO = 6000  # largest number of coordinates for eigenvalues, which take about a minute
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
    real: np.ndarray  # (2,) the same for real eigenvalues [1/time]
    reason: str = ""  # reason for a missing envelope

    @property
    def signs(self) -> dict[str, bool]:
        """Presence of each of `SIGNS`."""
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
        """Angle of the weakest direction or, if no work is negative, of the first without equilibrium [rad]."""
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
    """Probe an equilibrium with a held cell in all directions of a plane of strains."""
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
        pair, real = np.array([_growth_rates(each) for each in spectra]).T
    return ProbedState(load, sigma, envelope, band, _uniqueness(loose, law), pair, real)


def without_answer(load: float, sigma: np.ndarray, reason: str) -> ProbedState:
    """State that has no equilibrium, or whose equilibrium cannot be probed."""
    return ProbedState(load, sigma, None, None, "UNDECIDED", np.full(2, np.nan), np.full(2, np.nan), reason)


def _growth_rates(spectrum: Stability) -> tuple[float, float]:
    """Growth rates of the fastest complex pair and of the fastest real mode; zero without one."""
    return float(spectrum.growth_rate.max(initial=0.0)), float(np.sqrt(-spectrum.negative).max(initial=0.0))


def _uniqueness(loose: State, law: Law) -> str:
    """Name of the verdict on the contact status under all stresses of the cell."""
    try:
        system = linear_system(loose, law)
        return certificate(complementarity(system, np.zeros(len(system.free)))).verdict.name
    except ValueError:  # an unresisted motion, or a law without a sharp limit
        return UniquenessVerdict.UNDECIDED.name


def first_seen(probes: tuple[ProbedState, ...]) -> dict[str, ProbedState | None]:
    """First state of a path that shows each sign."""
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
