"""Derivatives of eigenvalues and moduli by the adjoint method, and the effect of position errors on a verdict."""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from scipy.linalg import eig
from scipy.special import betaincinv

from ..core.arguments import POSITIVE, Numbers, Positive, Seed, checked, require_shape
from ..core.contacts.forces import accept, forces
from ..core.contacts.jacobian import Linearisation, blocks_of, linearise
from ..core.contacts.neighbors import with_neighbor_list
from ..core.laws.builtin import PARAMETERS, Law, damping_model, parameter_names, with_values
from ..core.laws.properties import angular_columns
from ..core.measure import branch_vectors, overlaps, volume
from ..core.progress import Report, Size, require_sizes, silent
from ..core.readable import readable
from ..core.state import OPEN, STICK, State
from .balance import ROUND_OFF, LinearisedState, balanced, linearised, modes_under
from .freedom import (
    PAIR_ABOVE,
    ZERO_BELOW,
    Freedom,
    assembled,
    displaced,
    freedom,
    incidence,
    mass_weighted,
    residual_vector,
    resized,
    stiffness_of,
    translations,
)
from .linear import suitable_threads
from .moduli import adjoint_motion, elastic_moduli, solve_resisted
from .stability import combine_stability, stability

AT_MOST = 2_500  # number of coordinates for which all modes are computed within minutes
STENCIL = ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))  # central differences of fourth order
SMALL, LEAST = 0.02, 1e-3  # step over the smallest slip at a body; smallest slip considered, over the overlap
CONFIDENCE = 0.95  # confidence of the interval of a probability


@readable
class Gradient(NamedTuple):
    """Derivatives of an eigenvalue, of a modulus, or of the norm of unbalanced forces at given positions and slips."""

    value: complex  # λ [1/time²]; s [1/time] with dashpots; or the modulus, which is real [force/length^(dim−1)]
    condition: float  # ‖u‖‖v‖/|uᴴv| of λ or s, NaN for others; diverges, as the derivatives do, where a pair is born
    by_force: np.ndarray  # (N + W, 6) complex, with respect to forces and torques/R; grains and slips relax
    by_radius: np.ndarray  # (N,) complex, with respect to radii at constant M; grains and slips relax
    by_parameter: dict[str, complex]  # with respect to nonzero parameters common to all materials; grains relax
    by_position: np.ndarray  # (N + W, 3) complex, with respect to positions at given slips: effect of their errors
    by_contact: np.ndarray  # (C, 3) complex, the same with respect to the vector r_i − r_j of each pair in the list
    damped: bool = False  # whether the value is s of motions exp(st)

    @property
    def growth_rate(self) -> float:
        """ω_i = |Im √λ|, or Re s with dashpots [1/time]."""
        if self.damped:
            return float(self.value.real)
        return abs(np.sqrt(complex(self.value)).imag)

    def growth_derivative(self, derivative: np.ndarray) -> np.ndarray:
        """Derivative of the growth rate, given that of λ or s."""
        if self.damped:
            return np.real(derivative)
        root = np.sqrt(complex(self.value))
        return np.sign(root.imag) * np.imag(derivative / (2 * root))


class _Mode(NamedTuple):
    """λ or s and its modes at contacts: dλ = Σ left · dB right, ds = Σ left · (dB + s dB') right with blocks B, B'."""

    value: complex
    condition: float
    left: np.ndarray  # (C, w) complex left mode with the factor −1/(uᴴv), or 1/(uᴴ(2s − C)v)
    right: np.ndarray  # (C, w) complex right mode
    rate: complex = 0.0  # s, if dashpots act

    def contributions(self, state: State, line: Linearisation, blocks: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """(C,) complex contributions of the contacts to λ or s, at fixed modes and s."""
        return np.einsum("ca,cab,cb->c", self.left, blocks[0] + self.rate * blocks[1], self.right)


class _Modulus(NamedTuple):
    """E:C:E for a strain E, with the non-affine motion of the contacts to the left and to the right of J."""

    value: float
    strain: np.ndarray  # (3, 3) E
    left: np.ndarray  # (C, 6)
    right: np.ndarray  # (C, 6)
    volume: float
    condition: float = np.nan

    def contributions(self, state: State, line: Linearisation, blocks: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """(C,) contributions of the contacts to the modulus, at fixed non-affine motion."""
        force, branch = line.closed[:, None] * line.force, branch_vectors(state)
        affine = np.hstack([branch @ self.strain.T, np.zeros_like(branch)])
        stiff = np.einsum("ca,cab,cb->c", self.left + affine, blocks[0], self.right + affine)
        work = np.einsum("ca,ab,cb->c", force, self.strain, (self.right + affine)[:, :3])
        swells = np.trace(self.strain) * np.einsum("ca,ab,cb->c", force, self.strain, branch)
        return -(stiff + work - swells) / self.volume


@checked
def eigenvalue_gradient(state: State, law: Law) -> Gradient:
    """Derivatives of the eigenvalue that decides stability: dλ = −uᴴ dJ v/(uᴴ M v) at the equilibrium Pᵀf(q) = 0.

    A load, radius or stiffness p also moves the equilibrium, by dq = −J⁻¹ ∂f/∂p, and slips follow. One solve with Jᵀ
    for the adjoint μ, Jᵀμ = −∂λ/∂q, gives dλ/dp = ∂λ/∂p + μᵀ ∂f/∂p for all p. The blocks of contacts are differentiated
    by central differences, at once for all grains of one colour, none of which are neighbours. With dashpots, λ is
    replaced by the fastest-growing exponent s of M s² v = (J + s C) v, with ds = uᴴ(dJ + s dC)v/(uᴴ(2 s M − C)v).

    Raises
    ------
    ValueError
        If there are more than 2500 coordinates (1250 with dashpots) or the forces do not balance; for laws with
        moments; for cells that follow a stress.

    Source
    ------
    Seyranian & Mailybaev, doi:10.1142/5305, Ch. 2, for eigenvalues; Cao, Li, Petzold & Serban,
    doi:10.1137/S1064827501380630, for adjoints.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> slope = eigenvalue_gradient(state, law)
    >>> sorted(slope.by_parameter), slope.by_force.shape
    (['kn', 'kt', 'mu'], (20, 6))
    """
    return _eigenvalue_gradient(_balanced(state, law))


def _eigenvalue_gradient(here: LinearisedState) -> Gradient:
    damped = damping_model(here.law) != 0
    return _gradient(here, (_deciding_exponent if damped else _deciding_mode)(here))._replace(damped=damped)


@checked
def modulus_gradient(state: State, law: Law, strain: Numbers) -> Gradient:
    """Derivatives of the modulus E:C:E of a displacement gradient E; see `elastic_moduli` and `eigenvalue_gradient`.

    E = [[0, 1], [0, 0]] gives C_xyxy, and the unit matrix gives dim² times the bulk modulus.

    Parameters
    ----------
    strain : (dim, dim) E [1]

    Raises
    ------
    ValueError
        As in `elastic_moduli` and `eigenvalue_gradient`.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> shear = [[0, 1, 0], [0, 0, 0], [0, 0, 0]]
    >>> slope = modulus_gradient(state, law, shear)
    >>> found = ss.modes.elastic_moduli(state, law).tensor[0, 1, 0, 1]
    >>> bool(abs(slope.value - found) < 1e-9)
    True
    """
    here, dim = _balanced(state, law), state.cell.dim
    strain = np.asarray(strain, float)
    require_shape((dim, dim), strain=strain)
    found = elastic_moduli(here.state, law)
    right, left = np.einsum("ncd,cd->n", found.motion, strain), adjoint_motion(here.state, law, strain)
    q, wide = incidence(here.state, len(here.line.closed), found.free).T, np.zeros((3, 3))
    wide[:dim, :dim] = strain
    value = float(np.einsum("ab,abcd,cd", strain, found.tensor, strain))
    sides = [(q @ side).reshape(-1, 6) for side in (left, right)]
    gradient = _gradient(here, _Modulus(value, wide, *sides, volume(here.state)))
    real = [
        np.real(part) for part in (gradient.by_force, gradient.by_radius, gradient.by_position, gradient.by_contact)
    ]
    by_parameter = {name: part.real for name, part in gradient.by_parameter.items()}
    return Gradient(value, np.nan, *real[:2], by_parameter, *real[2:])


@checked
def residual_gradient(state: State, law: Law) -> Gradient:
    """Derivatives of the norm of the unbalanced forces, |Pᵀf|, of a state at rest off equilibrium.

    The unit vector μ along Pᵀf is its own adjoint: d|Pᵀf| = μᵀ d(Pᵀf). Positions and slips are fixed; radii and
    parameters change forces only. Rattlers are excluded.

    Raises
    ------
    ValueError
        If all forces balance to round-off, where the norm has no derivative; for laws and cells that
        `eigenvalue_gradient` rejects.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> state.grains.position[0, 0] += 1e-3
    >>> bool(residual_gradient(state, law).value > 1e-5)
    True
    """
    here = linearised(state, law)
    here = _differentiable(here.with_modes(modes_under(state, law, here.line)))
    state, free = here.state, here.backbone
    force = residual_vector(state, forces(state, law)[0], free)
    if not (value := float(np.linalg.norm(force))) > ROUND_OFF * here.mean_force:
        raise ValueError("all forces balance: the norm of zero has no derivative; give a state off equilibrium")
    mu = force / value
    task, push = _Task(here, None, _steps(state), _colours(state)), free.spread(mu)
    pushed = (incidence(state, len(here.line.closed), free).T @ mu).reshape(-1, 6)
    by_end = _by_given_position(task, pushed).real
    by_position = np.stack([task.by_body(side) for side in by_end], axis=1).real
    by_parameter = {name: part.real for name, part in _by_parameter(task, pushed).items()}
    return Gradient(
        value, np.nan, push, _by_radius(task, pushed).real, by_parameter,
        by_position - state.control.spring * push[:, :3], (by_end[:, 0] - by_end[:, 1]).T / 2,
    )  # fmt: skip


def _gradient(here: LinearisedState, answer: _Mode | _Modulus) -> Gradient:
    """Derivatives of a sum over contacts at the equilibrium, by one solve with Jᵀ."""
    task = _Task(here, answer, _steps(here.state), _colours(here.state))
    law, state, free, whole = here.law, here.state, here.backbone, _every_coordinate(here.state)
    by_end = np.zeros((6, 2, len(here.line.closed)), complex)  # indices: axis, first or second body, contact
    for axis in np.unique(whole.axis):
        by_end[axis] = task.by_end(
            lambda h, axis=axis: task.contributions(
                accept(moved := _moved(state, whole, axis, h), forces(moved, law)[1])
            )
        )
    given = _by_given_position(task)
    follow = np.stack([task.by_body(side) for side in by_end], axis=1)
    mu = _adjoint(here, free, follow.ravel()[free.component])
    pushed = (incidence(state, len(here.line.closed), free).T @ mu).reshape(-1, 6)
    return Gradient(
        answer.value, answer.condition, free.spread(mu.real) + 1j * free.spread(mu.imag),
        _by_radius(task, pushed), _by_parameter(task, pushed),
        np.stack([task.by_body(side) for side in given], axis=1), (given[:, 0] - given[:, 1]).T / 2,
    )  # fmt: skip


def _moved(state: State, whole: Freedom, axis: int, h: np.ndarray) -> State:
    """State with bodies moved along an axis by h (B,)."""
    return displaced(state, whole, h[whole.body] * (whole.axis == axis))


def _by_given_position(task: "_Task", loads: np.ndarray | None = None) -> np.ndarray:
    """(3, 2, C) derivatives of the contributions with respect to positions along x, y, z, at given slips."""
    state, whole = task.here.state, _every_coordinate(task.here.state)
    out = np.zeros((3, *task.ends.shape), complex)
    for axis in range(state.cell.dim):
        out[axis] = task.by_end(
            lambda h, axis=axis: task.contributions(with_given_slips(_moved(state, whole, axis, h)), loads=loads)
        )
    return out


def _by_radius(task: "_Task", pushed: np.ndarray) -> np.ndarray:
    """(N,) derivatives with respect to radii; `pushed` contains the `loads` of `contributions`."""
    state, radius = task.here.state, task.here.state.grains.radius

    def grown(h: np.ndarray) -> np.ndarray:
        return task.contributions(resized(state, radius + h[: len(radius)]), loads=pushed)

    return task.by_body(task.by_end(grown))[: len(radius)]


class _Task(NamedTuple):
    """A linearised state, the quantity to be differentiated, and data for finite differences."""

    here: LinearisedState
    answer: _Mode | _Modulus | None
    steps: np.ndarray  # (B,) [length]
    colours: np.ndarray  # (B,) such that no two bodies of a pair in the list have the same colour

    def contributions(self, state: State, law: Law | None = None, loads=None) -> np.ndarray:
        """(C,) complex contributions of contacts to the answer, plus those to μᵀf if `loads` (C, 6) gives μ there."""
        law = law or self.here.law
        line = linearise(state, law)
        blocks = blocks_of(state, law, line)
        out = np.zeros(len(line.closed)) if self.answer is None else self.answer.contributions(state, line, blocks)
        if loads is None:
            return out
        force = line.closed[:, None] * line.force
        return out + (loads * np.hstack([force, np.cross(force, line.normal)])).sum(axis=1)

    def by_end(self, function: Callable) -> np.ndarray:
        """(2, C) derivatives of each contact's contribution with respect to a property of its first and second body.

        function(h) returns the contributions (C,) for changes h (B,) of this property of all bodies.
        """
        ends = self.ends
        out = np.zeros(ends.shape, complex)
        for colour in range(self.colours.max() + 1):
            h = np.where(self.colours == colour, self.steps, 0.0)
            slope = sum(weight * function(k * h) for k, weight in STENCIL)
            out += np.where(self.colours[ends] == colour, slope / self.steps[ends], 0.0)
        return out

    def by_body(self, by_end: np.ndarray) -> np.ndarray:
        """(B,) sums over the contacts of each body."""
        out = np.zeros(len(self.steps), complex)
        np.add.at(out, self.ends, by_end)
        return out

    @property
    def ends(self) -> np.ndarray:
        """(2, C) bodies of each contact."""
        contacts, count = self.here.state.contacts, len(self.here.line.closed)
        return np.stack([contacts.i[:count], contacts.j[:count]])


def _adjoint(here: LinearisedState, free: Freedom, slope: np.ndarray) -> np.ndarray:
    """(n,) complex solution μ of Jᵀμ = −slope; free translations do not matter, up to finite-difference errors."""
    matrix = stiffness_of(here.state, here.line, blocks_of(here.state, here.law, here.line)[0], free)
    rigid, _ = np.linalg.qr(translations(here.dynamical_matrix(free), free) / np.sqrt(free.mass)[:, None])
    slope = slope - rigid @ (rigid.T @ slope)
    size = np.abs(slope).max(initial=1e-300)
    return size * (solve_resisted(matrix.T.tocsr(), np.stack([slope.real, slope.imag], axis=1) / size, free) @ [1, 1j])


def _by_parameter(task: _Task, pushed: np.ndarray) -> dict[str, complex]:
    """Derivatives with respect to nonzero law parameters that are equal between all materials."""
    law, out = task.here.law, {}
    for name in PARAMETERS:
        values = law.table[..., parameter_names(law).index(name)] if name in parameter_names(law) else np.zeros(1)
        value, step = float(values.flat[0]), 1e-3 * float(values.flat[0])
        if value > 0 and (values == value).all():
            terms = [
                weight * task.contributions(task.here.state, with_values(law, **{name: value + k * step}), pushed).sum()
                for k, weight in STENCIL
            ]
            out[name] = complex(sum(terms) / step)
    return out


def _balanced(state: State, law: Law) -> LinearisedState:
    """Linearised state in equilibrium; raise ValueError if derivatives of its eigenvalues are not implemented."""
    _differentiable(linearised(state, law))
    return balanced(state, law)


def _differentiable(here: LinearisedState) -> LinearisedState:
    """The same linearised state; raise ValueError if derivatives of its forces are not implemented."""
    state, law = here.state, here.law
    if angular_columns(law):
        raise ValueError("derivatives do not support laws with moments or lever arms R − δ/2")
    if state.control.cell_free.any() or (state.control.group >= 0).any():
        raise ValueError(
            "cells that follow a stress and rigid groups are not supported: hold the cell, and dissolve the groups"
        )
    if not len(here.backbone):
        raise ValueError("the packing has only rattlers: derivatives need grains that support each other")
    most = AT_MOST // 2 if damping_model(law) else AT_MOST
    if len(here.backbone) > most:
        raise ValueError(f"derivatives support at most {most} coordinates, got {len(here.backbone)}")
    return here


def _deciding_mode(here: LinearisedState) -> _Mode:
    value, left, right = deciding_vectors(here)
    return _Mode(value, float(np.linalg.norm(left) * np.linalg.norm(right)), *_at_contacts(here, left, right))


def deciding_vectors(here: LinearisedState) -> tuple[complex, np.ndarray, np.ndarray]:
    """λ that grows fastest or, if none grows, the softest, with modes u and v such that dλ = uᵀ dA' v.

    A' = −A is the mass-weighted J. Translations and floppy modes (λ = 0) are excluded.
    """
    free = here.backbone
    with suitable_threads(len(free)):
        values, left, right = eig(here.dynamical_matrix(free).toarray(), left=True)
    scale = np.abs(values).max()
    values = np.where(np.abs(values.imag) <= PAIR_ABOVE * scale, values.real, values)
    grows = np.where(np.abs(values) < ZERO_BELOW * scale, -np.inf, np.abs(np.sqrt(values.astype(complex)).imag))
    k = int(np.argmax(grows))
    if grows[k] <= 0:
        k = int(np.argmin(np.where(np.isfinite(grows), values.real, np.inf)))
    k = k if values[k].imag >= 0 else int(np.argmin(np.abs(values - values[k].conj())))
    u, v = left[:, k], right[:, k]
    return complex(values[k]), u.conj() / -np.vdot(u, v), v


def _deciding_exponent(here: LinearisedState) -> _Mode:
    """Nonzero exponent s of positive frequency with the largest real part."""
    free, n = here.backbone, len(here.backbone)
    damping = -mass_weighted(assembled(here.state, blocks_of(here.state, here.law, here.line)[1], free), free).toarray()
    first = np.block([[np.zeros((n, n)), np.eye(n)], [-here.dynamical_matrix(free).toarray(), damping]])
    with suitable_threads(2 * n):
        values, left, right = eig(first, left=True)
    moves = (np.abs(values) > np.sqrt(ZERO_BELOW) * np.abs(values).max()) & (values.imag >= 0)
    k = int(np.argmax(np.where(moves, values.real, -np.inf)))
    u, v, s = left[n:, k], right[:n, k], complex(values[k])
    product = np.vdot(u, 2 * s * v - damping @ v)
    condition = float(1 / abs(np.vdot(left[:, k], right[:, k])))
    return _Mode(s, condition, *_at_contacts(here, u.conj() / product, v), s)


def _at_contacts(here: LinearisedState, *modes: np.ndarray) -> list[np.ndarray]:
    """(C, 6) components of mass-weighted modes at the contacts."""
    free, q = here.backbone, incidence(here.state, len(here.line.closed), here.backbone).T
    return [(q @ (mode / np.sqrt(free.mass))).reshape(-1, 6) for mode in modes]


def _every_coordinate(state: State) -> Freedom:
    """Freedom with every component of every body free."""
    return freedom(state._replace(control=state.control._replace(free=np.ones_like(state.control.free))))


def _steps(state: State) -> np.ndarray:
    """(B,) steps of finite differences, small compared with the overlaps, gaps and slips of each body."""
    contacts, size = state.contacts, np.abs(overlaps(state))
    slip = np.linalg.norm(contacts.slip[: len(size)], axis=1)
    size = np.clip(slip, LEAST * size, size)
    least = np.full(state.n_bodies, state.grains.radius.min())
    for end in (contacts.i, contacts.j):
        np.minimum.at(least, end[: len(size)], size)
    return SMALL * least


def _colours(state: State) -> np.ndarray:
    """(B,) colours such that no two bodies of a pair in the list have the same colour."""
    near: list[set[int]] = [set() for _ in range(state.n_bodies)]
    count = int(state.contacts.count[0])
    for a, b in zip(state.contacts.i[:count].tolist(), state.contacts.j[:count].tolist(), strict=True):
        near[a].add(b)
        near[b].add(a)
    out = np.full(len(near), -1)
    for body in sorted(range(len(near)), key=lambda k: -len(near[k])):
        taken = {int(out[other]) for other in near[body]}
        out[body] = next(colour for colour in range(len(near)) if colour not in taken)
    return out


def with_given_slips(state: State) -> State:
    """State of moved grains in which contacts keep their slips; pairs that now touch stick, without slip."""
    contacts, count = state.contacts, int(state.contacts.count[0])
    branch, over = branch_vectors(state), overlaps(state)
    normal = branch / np.linalg.norm(branch, axis=1, keepdims=True)
    pair, slip, mode = contacts.pair.copy(), contacts.slip.copy(), contacts.mode.copy()
    pair[:count] = branch
    slip[:count] -= np.einsum("ck,ck->c", slip[:count], normal)[:, None] * normal
    mode[:count] = np.where(over <= 0, OPEN, np.where(mode[:count] == OPEN, STICK, mode[:count]))
    slip[:count][over <= 0] = 0.0
    return state._replace(contacts=contacts._replace(pair=pair, slip=slip, mode=mode))


@readable
class VerdictProbability(NamedTuple):
    """Probability of the verdict on a packing whose positions have errors."""

    stable: int  # number of samples without a growing mode
    samples: int
    low: float  # lower bound of the probability that the packing is stable, with a confidence of 95 %
    high: float  # upper bound of this probability
    eigenvalue: complex  # decisive λ of the given packing [1/time²]
    deviation: float  # standard deviation of Re λ, or of Im λ of a pair, to first order [1/time²]
    contact: tuple[int, int]  # bodies of the contact that contributes most to the variance
    share: float  # share of this contact in the variance

    @property
    def probability(self) -> float:
        """Share of the samples that are stable."""
        return self.stable / self.samples


@checked
def verdict_probability(
    state: State,
    law: Law,
    *,
    position_error: Positive,
    samples: Annotated[int, POSITIVE] = 100,
    seed: Seed = 0,
    report: Report = silent,
) -> VerdictProbability:
    """Probability that a packing is stable, given measurement errors of its positions, and the decisive contact.

    Normal errors are added to all positions; slips keep their given values. Errors of X-ray or photoelastic data are
    much larger than the displacements to which forces are sensitive, so the samples need not balance: the balancing
    forces of the given positions are assumed. The decisive contact is the one whose distance contributes most, to first
    order, to the variance of λ. For errors of 1e-4, the first-order `deviation` was within 3 % of the spread of 200
    samples (`tests/modes/test_gradient.py`).

    Parameters
    ----------
    position_error : standard deviation of each coordinate over the mean radius
    samples : number of packings with random errors

    Raises
    ------
    ValueError
        As in `eigenvalue_gradient`.
    """
    require_sizes([Size("these are", samples, "members", "use fewer samples")])
    if position_error > 1:
        raise ValueError(f"position_error is a fraction of the mean radius, at most 1, got {position_error:g}")
    if damping_model(law):
        raise ValueError(
            "the law has dashpots, but the probability of a verdict is computed without them: omit damping"
        )
    here, error = _balanced(state, law), position_error * state.grains.radius.mean()
    slope = _eigenvalue_gradient(here)
    by_position, by_contact = (
        part.imag if slope.value.imag else part.real for part in (slope.by_position, slope.by_contact)
    )
    parts = (by_contact**2).sum(axis=1)
    worst = int(np.argmax(parts))
    rng, dim, stable = np.random.default_rng(seed), state.cell.dim, 0
    for k in range(samples):
        report("position error", k / samples, f"{stable} of {k} stable")
        grains, position = here.state.grains, here.state.grains.position.copy()
        position[:, :dim] += error * rng.normal(size=(len(position), dim))
        moved = with_neighbor_list(here.state._replace(grains=grains._replace(position=position)), law)
        result = stability(with_given_slips(moved), law, method="all")
        stable += bool(combine_stability(result, result.if_stuck))
    tail = (1 - CONFIDENCE) / 2
    low = betaincinv(stable, samples - stable + 1, tail) if stable else 0.0
    high = betaincinv(stable + 1, samples - stable, 1 - tail) if stable < samples else 1.0
    deviation = error * np.linalg.norm(by_position[: len(state.grains.radius)])
    contact = int(state.contacts.i[worst]), int(state.contacts.j[worst])
    share = float(parts[worst] / max(parts.sum(), 1e-300))
    return VerdictProbability(stable, samples, float(low), float(high), slope.value, float(deviation), contact, share)
