"""Response of a packing to small probes in all directions of a plane, second-order work, and localisation."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from scipy.optimize import minimize

from ..core.arguments import POSITIVE, Numbers, Positive, checked
from ..core.contacts.neighbors import TooFarApartError
from ..core.control import stress_controlled
from ..core.dynamics.cell_motion import strained
from ..core.laws.builtin import Law
from ..core.measure import Committed, mean_normal_force, overlaps, stress, touching
from ..core.progress import Size, require_sizes
from ..core.readable import readable
from ..core.state import SLIDE, STICK, State
from ..solve.balance import BALANCED_BELOW, imbalance, with_mode
from ..solve.equilibrate import equilibrate
from ..solve.moduli import VOIGT, elastic_moduli, isotropic_tensor, voigt
from ..solve.newton import Factorisation
from .compression import stopped

SIZE = 1e-4  # size of a probe, in mean overlaps per diameter
BALANCED = 1e-7  # residual, in units of the change of forces in a probe
ROUND_OFF = 1e-15  # round-off of a position, in units of the width of the cell
NORMALS = 90  # number of band normals tried over half a circle, before the smallest value is refined


@readable
class Envelope(NamedTuple):
    """Responses to probes in M directions cos(angle) e₁ + sin(angle) e₂ in a plane of symmetric tensors.

    Strain and stress are increments, compression positive, per unit strain (or stress, if that was imposed). They are
    NaN where no equilibrium was found near the state.
    """

    angle: np.ndarray  # (M,) [rad]
    plane: np.ndarray  # (2, dim, dim) e₁ and e₂, orthonormal
    strain: np.ndarray  # (M, dim, dim) [1]
    stress: np.ndarray  # (M, dim, dim) [force/length^(dim−1)]
    elastic: np.ndarray  # (M, dim, dim) response if contacts at the limit stick
    slides: np.ndarray  # (M,) number of contacts that slide
    control: str  # imposed quantity, "strain" or "stress"

    @property
    def work(self) -> np.ndarray:
        """Second-order work dσ:dε, (M,)."""
        return np.einsum("mab,mab->m", self.stress, self.strain)

    @property
    def normalised_work(self) -> np.ndarray:
        """Second-order work divided by |dσ| |dε|, (M,), from −1 to 1."""
        return self.work / (np.linalg.norm(self.stress, axis=(1, 2)) * np.linalg.norm(self.strain, axis=(1, 2)))

    @property
    def cones(self) -> list[tuple[float, float]]:
        """Ranges of angle [rad] with negative second-order work, anticlockwise; a range may start below zero."""
        return negative_ranges(self.angle, self.work)

    @property
    def collapsed(self) -> np.ndarray:
        """(M,) bool: no equilibrium was found near the state."""
        return np.isnan(self.work)

    def components(self, name: str) -> np.ndarray:
        """Components along e₁ and e₂ of "strain", "stress" or "elastic", (M, 2)."""
        return np.einsum("mab,kab->mk", getattr(self, name), self.plane)


@checked
def response_envelope(
    state: Committed,
    law: Law,
    *,
    directions: Annotated[int, POSITIVE] = 64,
    control: Literal["strain", "stress"] = "strain",
    plane: Numbers | None = None,
    size: Positive = SIZE,
) -> Envelope:
    """Probe a packing with small increments of strain or stress in all directions of a plane, by quasi-static steps.

    Increments are measured from the state, which is first brought to rest; its cell may be tilted or turned.
    Contacts may start or stop sliding, so the response is linear only within sectors of directions. Its elastic
    part is the response if contacts at the Coulomb limit stick.

    For 30 disks with sliding contacts, slow dynamics over strains of 2e-7 gave the same stress to 0.7 % after 400 units
    of time, and to 0.07 % after 4000; `quasirigid.probe_statuses`, without a finite step, gives the same strains to
    2e-4 (`tests/unit/test_envelope.py`).

    Parameters
    ----------
    state : State in equilibrium, in a fully periodic cell, without walls or rigid groups; its control is ignored
    directions : int, number of directions, evenly spaced in angle
    control : "strain" imposes all components of the strain, "stress" all components of the stress
    plane : two symmetric (dim, dim) tensors that span the plane; default: yy and xx for disks, yy and (xx + zz)/√2 for
        spheres, the planes of biaxial and triaxial tests along y
    size : size of the probes, in units of the mean overlap per diameter, at most 1

    Raises
    ------
    ValueError
        If the packing is not in equilibrium, has walls, rigid groups or open sides, or consists of rattlers only, or
        if the probes would be lost in the round-off of positions.

    Source
    ------
    Gudehus, 1979, A comparison of some constitutive laws for soils under radially symmetric loading and unloading;
    Calvetti, Viggiani & Tamagnini, doi:10.1007/s10035-003-0132-5 (grains); Nicot & Darve,
    doi:10.1016/j.ijsolstr.2007.04.001 (cones of negative second-order work).

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> envelope = ss.protocols.response_envelope(state, law, directions=16)
    >>> envelope.cones, bool((envelope.work > 0).all())
    ([], True)
    """
    require_sizes([Size("these are", directions, "directions", "use fewer")])
    least = 1e3 * _round_off(state) if len(touching(state)) else 0.0  # forces are then accurate to 1e-3
    if not least <= size <= 1:
        raise ValueError(f"size must be from {least:.1g} to 1 for probes of this packing, got {size:g}")
    if plane is None:
        along = np.diag(np.eye(state.cell.dim)[1])
        plane = [along, np.eye(state.cell.dim) - along]  # yy, and the other normal components together
    span = _orthonormal(np.asarray(plane, float), state.cell.dim)
    angle = 2 * np.pi * np.arange(directions) / directions
    probes = np.cos(angle)[:, None, None] * span[0] + np.sin(angle)[:, None, None] * span[1]
    moduli = elastic_moduli(_sticking(state), law).tensor
    step = size * float(overlaps(state)[touching(state)].mean() / (2 * state.grains.radius.mean()))
    probe = _StrainProbe(state, law, step) if control == "strain" else _StressProbe(state, law, step, moduli)
    answers = [probe.answer(direction) for direction in probes]
    strain, change = (np.array([answer[k] for answer in answers]) for k in range(2))
    if control == "strain":
        elastic = np.einsum("abcd,mcd->mab", moduli, probes)
    else:  # symmetric strains with σ = C:ε
        elastic, (first, second) = np.zeros_like(probes), np.array(VOIGT[len(moduli)]).T
        values = np.linalg.solve(voigt(moduli), probes[:, first, second].T).T / np.where(first == second, 1, 2)
        elastic[:, first, second] = elastic[:, second, first] = values
    return Envelope(angle, span, strain, change, elastic, np.array([answer[2] for answer in answers]), control)


def negative_ranges(angle: np.ndarray, work: np.ndarray) -> list[tuple[float, float]]:
    """Return the ranges of angle in which the work is negative; NaN counts as negative, up to the adjacent probes.

    Examples
    --------
    >>> negative_ranges(np.radians([0, 90, 180, 270]), np.array([1.0, 1.0, -1.0, 1.0]))
    [(2.356194490192345, 3.9269908169872414)]
    """
    below = ~(work >= 0)
    if below.all() or not below.any():
        return [(0.0, 2 * np.pi)] if below.all() else []
    count, ranges = len(angle), []
    for k in np.flatnonzero(below & ~np.roll(below, 1)):
        last = k
        while below[(last + 1) % count]:
            last += 1
        ranges.append((_zero(angle, work, k - 1), _zero(angle, work, last)))
    return ranges


def _zero(angle: np.ndarray, work: np.ndarray, k: int) -> float:
    """Angle between probes k and k + 1 at which the interpolated work is zero."""
    count, spacing = len(angle), 2 * np.pi / len(angle)
    before, after = work[k % count], work[(k + 1) % count]
    share = before / (before - after) if np.isfinite(before) and np.isfinite(after) else float(np.isnan(before))
    return float(k * spacing + share * spacing)


def _round_off(state: State) -> float:
    """Round-off of forces, in units of the mean force."""
    return float(ROUND_OFF * np.abs(state.cell.vectors).max() / overlaps(state)[touching(state)].mean())


class _StrainProbe:
    """Probes of imposed strain."""

    def __init__(self, state: State, law: Law, step: float):
        control = state.control._replace(cell_free=np.zeros((3, 3), bool), cell_rate=np.zeros((3, 3)))
        self.law, self.step, self.keep = law, step, Factorisation()
        self.tolerance = mean_normal_force(state, law) * max(BALANCED * SIZE, _round_off(state))
        held = stopped(state._replace(control=control))
        self.state = self.settle(held) if imbalance(held, law) <= BALANCED_BELOW else None
        if self.state is None:
            raise ValueError("the packing is not in equilibrium: use `equilibrate` first")
        self.before = stress(self.state, law)

    def answer(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Return strain and stress per unit strain, and the number of contacts that slide."""
        end = self.settle(strained(self.state, -self.step * direction))
        if end is None:
            return direction, np.full_like(direction, np.nan), -1
        dim, change = len(direction), stress(end, self.law) - self.before
        return direction, 0.5 * (change + change.T)[:dim, :dim] / self.step, _slides(end)

    def settle(self, state: State) -> State | None:
        """Return the equilibrium found by Newton's method, or None."""
        try:
            end, outcome = equilibrate(
                state, self.law, tolerance=self.tolerance, keep=self.keep, check="nothing", steps=1
            )
        except TooFarApartError:
            return None
        return end if outcome.ok else None


class _StressProbe(_StrainProbe):
    """Probes of imposed stress."""

    def __init__(self, state: State, law: Law, step: float, moduli: np.ndarray):
        super().__init__(state, law, step)
        self.size = step * np.linalg.norm(moduli) / len(moduli)

    def answer(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Return strain and stress per unit stress, and the number of contacts that slide."""
        dim = len(direction)
        wanted = self.before[:dim, :dim] + self.size * direction
        end = self.settle(self.state._replace(control=stress_controlled(self.state.control, wanted)))
        if end is None:
            return np.full_like(direction, np.nan), direction, -1
        vectors = self.state.cell.vectors[:dim, :dim]
        gradient = np.linalg.solve(vectors, end.cell.vectors[:dim, :dim] - vectors).T
        return -0.5 * (gradient + gradient.T) / self.size, direction, _slides(end)


def _slides(state: State) -> int:
    return int((state.contacts.mode[touching(state)] == SLIDE).sum())


def _sticking(state: State) -> State:
    """Return the state with contacts at the limit treated as sticking."""
    return with_mode(state, state.contacts.mode == SLIDE, STICK)


def _orthonormal(plane: np.ndarray, dim: int) -> np.ndarray:
    """Return an orthonormal basis of the plane of two tensors."""
    if plane.shape != (2, dim, dim) or not np.allclose(plane, plane.transpose(0, 2, 1)):
        raise ValueError(
            f"plane must be two symmetric tensors of shape {(dim, dim)}, got an array of shape {plane.shape}"
        )
    first = plane[0] / np.linalg.norm(plane[0])
    second = plane[1] - (plane[1] * first).sum() * first
    if not np.linalg.norm(second) > 1e-9 * np.linalg.norm(plane[1]):
        raise ValueError("the two tensors are multiples of each other: they must span a plane")
    return np.array([first, second / np.linalg.norm(second)])


@readable
class Localisation(NamedTuple):
    """Plane with the lowest resistance to a shear band: its acoustic tensor n·C·n has the smallest determinant."""

    normal: np.ndarray  # (dim,) normal of the plane
    determinant: float  # that of the acoustic tensor over that of the isotropic tensor nearest to the moduli [1]


@checked
def localisation(state: Committed, law: Law) -> Localisation:
    """Return the plane whose acoustic tensor n_b C_abcd n_d has the smallest determinant of all orientations.

    C is the tangent modulus with contacts at the limit sliding, as under continued loading. A determinant of zero means
    that a band across n may form.

    None of 20,000 random planes of a packing of spheres had a smaller determinant; the smallest of their determinants
    was 2e-5 larger (`tests/unit/test_envelope.py`).

    Source
    ------
    Rudnicki & Rice, doi:10.1016/0022-5096(75)90001-0.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> weakest = ss.protocols.localisation(state, ss.laws.hertz_mindlin(mu=0.5))
    >>> 0.3 < weakest.determinant < 1
    True
    """
    moduli, stuck = elastic_moduli(state, law).tensor, elastic_moduli(_sticking(state), law)
    dim = len(moduli)
    whole = _acoustic(isotropic_tensor(dim, stuck.bulk, stuck.shear), np.eye(dim)[0])
    normals = _half_sphere(dim)
    start = normals[np.argmin(_acoustic(moduli, normals))]
    best = minimize(lambda n: _acoustic(moduli, n / np.linalg.norm(n)) / whole, start, method="Nelder-Mead",
                    options={"xatol": 1e-6, "fatol": 1e-9})  # fmt: skip
    return Localisation(best.x / np.linalg.norm(best.x), float(best.fun))


def _half_sphere(dim: int) -> np.ndarray:
    """(M, dim) normals evenly spread over half a circle or, along a spiral, over half a sphere."""
    if dim == 2:
        angle = np.pi * np.arange(NORMALS) / NORMALS
        return np.column_stack([np.cos(angle), np.sin(angle)])
    count = NORMALS**2 // 2
    height, turn = (np.arange(count) + 0.5) / count, np.pi * (1 + 5**0.5) * np.arange(count)
    level = np.sqrt(1 - height**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), height])


def _acoustic(moduli: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Determinants of the acoustic tensors of normals (…, dim)."""
    return np.linalg.det(np.einsum("...b,abcd,...d->...ac", normal, moduli, normal))
