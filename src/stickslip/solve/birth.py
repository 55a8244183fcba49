"""Normal form of the oscillatory instability near the birth of a complex pair.

In mass-weighted coordinates y, the motion around an equilibrium is ÿ = −A y + N(y). A pair λ_r ± iλ_i has the
eigenvector p + iq, whose phase is chosen so that p·q = 0 and |p| ≥ |q|. The vectors u₀ = p and u₁ = q/λ_i satisfy

    (A − λ_r) u₁ = u₀,   (A − λ_r) u₀ = −λ_i² u₁,

and their duals w₀, w₁ (wᵢ·uⱼ = δᵢⱼ) span the left invariant plane. At the birth, λ_i = 0, two modes of equal frequency
ω = √λ_r coalesce (a reversible 1:1 resonance; no potential is needed). With y = 2 Re(a e^{iωt}) u₀ + …, the amplitude a
varies slowly, and at third order

    a″ = σ² a + β |a|² a,   σ² = λ_i²/(4λ_r),   β = w₁·[½ C(u₀, u₀, u₀) + B(u₀, m) + B(u₀, s)]/(4λ_r),

where N = ½ B(y, y) + C(y, y, y)/6, and m and s are the mean displacement and the second harmonic caused by quadratic
forces: A m = B(u₀, u₀), (A − 4λ_r) s = ½ B(u₀, u₀). If β < 0, the growth ends at |a| = σ √(2/|β|) and the motion
returns: a burst. If β > 0, growth becomes faster. There is no term of first order in a′, because motion in which all
contacts stick is reversible in time.

At finite amplitude, harmonic balance of a motion with all harmonics gives σ²(a) = [λ_i² + w₁·N₁(a)/a]/(4λ_r), where N₁
is the first harmonic of N; then a′² = 2 ∫ σ²(a) a da.

Smooth friction has a term |s| s. If a slip s changes sign, this term makes N₁ of second order in a. β is then valid for
smaller amplitudes only, and the harmonic balance distinguishes bursts from runaway.

Sources: Iooss & Pérouème, doi:10.1006/jdeq.1993.1034, for the 1:1 resonance of reversible systems; Nayfeh & Mook,
doi:10.1002/9783527617586, Ch. 6, for slaved modes and amplitude equations.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, eigvals, svd
from scipy.sparse.linalg import eigs, splu

from ..core.arguments import checked
from ..core.contacts.forces import FREE, forces
from ..core.laws.builtin import Law, damping_model
from ..core.measure import overlaps
from ..core.readable import pluralize, readable
from ..core.state import OPEN, SLIDE, State
from ..core.units import with_unit
from .balance import BALANCED_BELOW, LinearisedState, force_imbalance, linearised, modes_under, no_equilibrium_message
from .freedom import ZERO_BELOW, Freedom, displaced, dynamical_matrix, jacobian, moving, residual_vector
from .linear import DENSE_BELOW, one_thread, suitable_threads
from .spectrum import SOFTEST, near_zero
from .stability import DENSE_UP_TO, stability

NEAR_BIRTH = 1 / 3  # largest |q|/|p| at which a pair counts as near its birth
MOST_DETUNED = 0.5  # relative change of β if the second harmonic grows with the pair
PHASES = 24  # number of points per period of the mode at which contacts are examined for changes
LADDER, ROOT, SMALLEST = 1.5, 1e-6, 1e-9  # search for changes: factor between amplitudes, accuracy, first amplitude
AFTER = 1.5  # largest amplitude of the harmonic balance, over that at which a contact is lost in linear growth
TIMES = 32  # number of points per period in the harmonic balance; there are at most a third as many harmonics
SAMPLES = 36  # number of amplitudes at which the growth rate is computed
MOST_ROUNDS, SETTLED = 60, 1e-8  # harmonic balance: largest number of iterations, and relative change that ends them
LARGEST = 1.0  # ratio of slaved motion to motion along the mode above which the harmonic balance is meaningless
PROBE = 0.02  # displacement for measuring nonlinear forces, over the amplitude of the first limit


class Motion(NamedTuple):
    """Mass-weighted motion ÿ = −A y + N(y) around an equilibrium."""

    matrix: sparse.csr_array  # (n, n) A
    force: Callable[[np.ndarray], np.ndarray]  # −A y + N(y)
    tangent: Callable[[np.ndarray], sparse.csr_array]  # −∂force/∂y at y
    zero: np.ndarray  # (n, k) zero modes, which are held fixed


class Balance(NamedTuple):
    """Growth at finite amplitude, from harmonic balance."""

    amplitudes: np.ndarray  # (S,) amplitudes at which the harmonic balance converged
    rates: np.ndarray  # (S,) growth rate a′/a; NaN beyond the peak [1/time]
    peak: float  # amplitude at which growth ends; infinite if it does not
    harmonics: np.ndarray  # (S + 1, H, n) mean displacement and harmonics of the slaved motion, from amplitude zero on


class Plane(NamedTuple):
    """Invariant plane of a pair: vectors and duals."""

    value: complex  # λ [1/time²]
    u0: np.ndarray  # (n,)
    u1: np.ndarray  # (n,)
    w0: np.ndarray  # (n,)
    w1: np.ndarray  # (n,)

    @property
    def nearness(self) -> float:
        """|q|/|p|, zero at the birth of the pair and 1 for a circular mode."""
        return float(self.value.imag * np.linalg.norm(self.u1) / np.linalg.norm(self.u0))


@readable(head=lambda form: form.verdict)
class BirthForm(NamedTuple):
    """Normal form of a pair: its growth at finite amplitude, and the end of growth.

    An amplitude a means a displacement 2 a cos(ω t) along `mode`, in the mass-weighted scalar product; the unit of a is
    length times √mass.
    """

    eigenvalue: complex  # λ_r + iλ_i [1/time²]
    frequency: float  # Re √λ, near the birth ω = √λ_r [1/time]
    growth_rate: float  # |Im √λ| at infinitesimal amplitude; near the birth σ = λ_i/(2ω) [1/time]
    nearness: float  # 0 at the birth, 1 for a circular mode; the form is valid near the birth
    beta: float  # cubic coefficient β [1/(amplitude time)²]
    bare: float  # β without slaved modes
    peak: float  # amplitude at which a burst turns back, from the harmonic balance or, beyond its range, from β
    cubic_peak: float  # σ √(2/|β|), the limit of `peak` near the birth; infinite for β > 0
    amplitudes: np.ndarray  # (S,) amplitudes at which the harmonic balance converged, up to `first`
    rates: np.ndarray  # (S,) growth rate a′/a at each amplitude, NaN beyond the peak [1/time]
    limit: float  # amplitude at which a contact first reaches the Coulomb limit; infinite if none does
    limit_contact: tuple[int, int]  # the bodies of that contact; (−1, −1) if there is none
    opening: float  # amplitude at which a contact first opens
    opening_contact: tuple[int, int]
    closing: float  # amplitude at which two grains first come into contact; the form is valid up to it
    closing_contact: tuple[int, int]
    resonance: float  # |ω_k − 2ω|/(2ω) of the mode nearest to the second harmonic
    detuned: float  # relative change of β if the second harmonic grows at the rate 2σ: the error of slaving it
    mode: np.ndarray  # (n,) u₀/√mass: displacement at unit 2a [length/amplitude]
    free: Freedom  # coordinates of `mode`, without rattlers

    @property
    def first(self) -> float:
        """Amplitude at which a contact first opens or reaches the Coulomb limit."""
        return min(self.limit, self.opening)

    def displacement(self, amplitude: float) -> float:
        """Largest displacement of a grain in one direction at an amplitude [length]."""
        return float(2 * amplitude * np.abs(self.mode[self.free.axis < 3]).max())

    def _displacement_text(self, amplitude: float) -> str:
        return with_unit(f"{self.displacement(amplitude):.3g}", "length")

    @property
    def fate(self) -> str:
        """Prediction: "bounded bursts", "runaway", "limit first", "not near a birth" or "resonance"."""
        if not self.nearness <= NEAR_BIRTH:
            return "not near a birth"
        if not self.detuned <= MOST_DETUNED:
            return "resonance"
        if self.peak < self.first:
            return "bounded bursts"
        faster = self.rates[-1] > self.growth_rate if len(self.rates) else self.beta > 0
        return "runaway" if faster else "limit first"

    @property
    def verdict(self) -> str:
        """Prediction of the normal form, in words."""
        i, j = self.limit_contact if self.limit <= self.opening else self.opening_contact
        what = "reaches the Coulomb limit" if self.limit <= self.opening else "opens"
        until = ", and no contact is lost up to the largest amplitude examined"
        if np.isfinite(self.first):
            until = f" until contact {i}–{j} {what}, when grains move by {self._displacement_text(self.first)}"
        sentences = {
            "bounded bursts": f"bounded bursts, in which grains move by up to {self._displacement_text(self.peak)}; no "
            f"contact is lost (the first would be {i}–{j} at {self._displacement_text(self.first)})",
            "runaway": f"runaway: growth becomes faster{until}",
            "limit first": f"limit first: growth becomes slower{until}"
            + (f"; the burst would go on to {self._displacement_text(self.peak)}" if np.isfinite(self.peak) else ""),
            "not near a birth": f"not near a birth (|q|/|p| = {self.nearness:.2f}): linear growth{until}",
            "resonance": f"no normal form, since a mode {100 * self.resonance:.2g} % from twice the frequency leaves β "
            f"uncertain by {100 * self.detuned:.0f} %: linear growth{until}",
        }
        closes = ""
        if self.closing < min(self.first, self.peak if self.fate == "bounded bursts" else np.inf):
            i, j = self.closing_contact
            closes = f"; before that, {i} and {j} come into contact, at {self._displacement_text(self.closing)}"
        return sentences[self.fate] + closes


@checked
def birth_form(state: State, law: Law, *, pair: int = 0) -> BirthForm:
    """Normal form of a complex pair near its birth: bursts or runaway, and the contact that is lost first.

    Forces are evaluated with trial memory around the accepted state, without velocities; dashpots are not supported.
    In free runs of the disk array, a burst reached the predicted amplitude within 2 %, and the predicted contact was
    lost at the predicted amplitude within 8 % (`tests/modes/test_birth.py`). Rattlers are assumed not to move, and
    collisions with them are ignored.

    Parameters
    ----------
    pair : index of the pair; 0 is the fastest growing

    Raises
    ------
    ValueError
        If the state is not in equilibrium, has contacts at the Coulomb limit, or has no such pair.

    Source
    ------
    doi:10.1006/jdeq.1993.1034; see the docstring of the module.
    """
    if damping_model(law):
        raise ValueError("the law has dashpots, but the normal form describes undamped motion: omit damping")
    here = linearised(state, law)
    here = here.with_modes(modes_under(state, law, here.line))
    (state, law, _, rows, _), residual, at_limit = here, force_imbalance(here), int(_at_limit(here).sum())
    if not residual <= BALANCED_BELOW:
        raise ValueError(no_equilibrium_message(residual, 0.0))
    if at_limit:
        raise ValueError(
            f"{pluralize(at_limit, 'contact')} at the Coulomb limit, where forces have a kink: there is no normal form"
        )
    pairs = stability(state, law).pairs
    pair = int(pair)
    if not 0 <= pair < len(pairs):
        raise ValueError(f"pair {pair} does not exist: the state has {pluralize(len(pairs), 'complex pair')}")
    if not pairs[pair].real > 0:
        raise ValueError(f"pair {pair} has λ = {pairs[pair]:.3g}, but the normal form needs Re λ > 0")
    free = here.backbone
    motion = _motion(state, law, free)
    plane = invariant_plane(motion.matrix, pairs[pair])
    root = np.sqrt(free.mass)
    size = np.abs(overlaps(state)[rows]).mean() * root.max() / np.abs(plane.u0).max()
    changes = first_changes(here, free, ellipse(plane), SMALLEST * size)
    value, omega = plane.value, np.sqrt(plane.value.real)
    sigma, exact = value.imag / (2 * omega), np.sqrt(value)
    scale = min(amplitude for amplitude, _ in changes[:2])
    scale = scale if np.isfinite(scale) else size
    beta, bare, retarded = cubic_coefficient(motion, plane, 2 * min(PROBE * scale, 0.5 * changes[3][0]))
    detuned = abs(retarded - beta) / max(abs(beta), np.finfo(float).tiny)
    cubic_peak = sigma * np.sqrt(2 / -beta) if beta < 0 else np.inf
    balance = growth_by_amplitude(motion, plane, AFTER * scale * (np.arange(1, SAMPLES + 1) / SAMPLES) ** 2)
    reached, peak = balance.amplitudes.max(initial=0.0), balance.peak
    if not np.isfinite(peak) and cubic_peak > reached:
        peak = float(cubic_peak)
    if plane.nearness <= NEAR_BIRTH and detuned <= MOST_DETUNED and len(balance.amplitudes):
        later = first_changes(here, free, balanced_motion(plane, balance, sigma), 0.1 * scale)
        changes[:3] = [new if np.isfinite(new[0]) else old for old, new in zip(changes[:3], later[:3], strict=True)]
    before = balance.amplitudes <= min(amplitude for amplitude, _ in changes[:2])
    return BirthForm(
        value, float(exact.real), float(abs(exact.imag)), plane.nearness, beta, bare, peak, float(cubic_peak),
        balance.amplitudes[before], balance.rates[before],
        *(x for change in changes[:3] for x in change), resonance_gap(motion.matrix, omega), float(detuned),
        plane.u0 / root, free,
    )  # fmt: skip


def _at_limit(here: LinearisedState) -> np.ndarray:
    """(C,) mask of contacts at the Coulomb limit, except rattlers'; smooth friction has a jump in curvature there."""
    return (here.line.closed > 0) & (here.line.slides > 0) & (here.line.limit > 0) & here.supported


def _motion(state: State, law: Law, free: Freedom) -> Motion:
    """Mass-weighted motion of a state with trial memory."""
    root = np.sqrt(free.mass)

    def force(y):
        moved = displaced(state, free, y / root)
        return residual_vector(moved, forces(moved, law)[0], free) / root

    def tangent(y):
        scale = sparse.diags_array(1 / root)
        return sparse.csr_array(-scale @ jacobian(displaced(state, free, y / root), law, free, memory=FREE) @ scale)

    matrix = dynamical_matrix(state, law, free)
    return Motion(matrix, force, tangent, zero_modes(matrix))


def zero_modes(matrix) -> np.ndarray:
    """(n, k) orthonormal zero modes: translations, and motions without resistance, such as a disk that rolls."""
    if matrix.shape[0] <= DENSE_UP_TO:
        with suitable_threads(matrix.shape[0]):
            _, size, vectors = svd(matrix.toarray())
        return vectors[size <= ZERO_BELOW * size[0]].T
    values, vectors, scale = near_zero(matrix, SOFTEST, ZERO_BELOW)
    zeros = vectors[:, np.abs(values) < ZERO_BELOW * scale]
    basis, _, _ = svd(np.hstack([zeros.real, zeros.imag]), full_matrices=False)
    return basis[:, : zeros.shape[1]]


def invariant_plane(matrix, value: complex) -> Plane:
    """Vectors u₀, u₁ and duals of the pair nearest to a value, by inverse iteration."""
    size = matrix.shape[0]
    shift = value * (1 + 1e-9)
    solve = splu(sparse.csc_array(matrix - shift * sparse.eye_array(size), dtype=complex))
    rng = np.random.default_rng(0)
    right, left = (rng.normal(size=size) + 1j * rng.normal(size=size) for _ in range(2))
    for _ in range(6):
        right, left = solve.solve(right), solve.solve(left, trans="T")
        right, left = right / np.linalg.norm(right), left / np.linalg.norm(left)
    value = (left @ (matrix @ right)) / (left @ right)
    if value.imag < 0:
        value, right, left = value.conjugate(), right.conjugate(), left.conjugate()
    right = right * np.exp(-0.5j * np.angle(right @ right))
    right = right / np.linalg.norm(right.real)
    u = np.stack([right.real, right.imag / value.imag], axis=1)
    span, _ = np.linalg.qr(np.stack([left.real, left.imag], axis=1))
    w0, w1 = np.linalg.solve(span.T @ u, span.T)
    return Plane(complex(value), u[:, 0], u[:, 1], w0, w1)


def _solver(matrix, shift: float, columns=None, rows=None):
    """Solve (A − shift) y + columns c = b with rowsᵀ y = 0."""
    size = matrix.shape[0]
    whole, extra = matrix - shift * sparse.eye_array(size), 0
    if columns is not None and columns.shape[1]:
        extra = columns.shape[1]
        whole = sparse.block_array([[whole, sparse.csr_array(columns)], [sparse.csr_array(rows.T), None]])
    try:
        factor = splu(sparse.csc_array(whole))
    except RuntimeError:
        raise LinAlgError("floppy modes") from None
    return lambda b: factor.solve(np.append(b, np.zeros(extra)))[:size]


def cubic_coefficient(motion: Motion, plane: Plane, probe: float) -> tuple[float, float, float]:
    """β, β without slaved modes, and β if the second harmonic grows at twice the rate of the pair.

    All three follow from exact Jacobians at displacements along u₀ of ±`probe` and ±`probe`/2.
    """
    u0, w1, square = plane.u0, plane.w1, plane.value.real
    plus, minus = ([motion.tangent(sign * size * u0) for size in (probe, 0.5 * probe)] for sign in (1, -1))
    first = [(p - m) / (2 * size) for p, m, size in zip(plus, minus, (probe, 0.5 * probe), strict=True)]
    quadratic = (first[0] - 4 * first[1]) / 3  # Richardson: −B(u₀, ·) to fourth order
    second = [
        ((p @ u0) + (m @ u0) - 2 * (motion.matrix @ u0)) / size**2
        for p, m, size in zip(plus, minus, (probe, 0.5 * probe), strict=True)
    ]
    cubic = (second[0] - 4 * second[1]) / 3  # −C(u₀, u₀, u₀)
    forced = -(quadratic @ u0)
    mean = _solver(motion.matrix, 0.0, motion.zero, motion.zero)(forced)
    double = _solver(motion.matrix, 4 * square)(0.5 * forced)
    grown = (2 * np.sqrt(square) - 1j * plane.value.imag / np.sqrt(square)) ** 2
    growing = splu(sparse.csc_array(motion.matrix - grown * sparse.eye_array(len(u0)))).solve(0.5 * forced + 0j).real
    bare, *slaved = np.array([0.5 * (w1 @ cubic), *(-w1 @ (quadratic @ s) for s in (mean, double, growing))]) / (
        4 * square
    )
    return float(bare + slaved[0] + slaved[1]), float(bare), float(bare + slaved[0] + slaved[2])


def growth_by_amplitude(motion: Motion, plane: Plane, amplitudes) -> Balance:
    """Growth rate at finite amplitudes by harmonic balance, up to an amplitude at which the balance diverges."""
    from scipy.interpolate import CubicSpline  # slow to import

    square, half = plane.value.real, TIMES // 2
    harmonics = np.arange(TIMES // 3)
    waves = np.cos(np.pi * np.outer(harmonics, np.arange(half + 1)) / half)  # the motion is even in time
    weights = np.full(half + 1, 1.0 / half)
    weights[[0, -1]] *= 0.5
    u, w = np.stack([plane.u0, plane.u1], axis=1), np.stack([plane.w0, plane.w1], axis=1)
    solvers = [_solver(motion.matrix, 0.0, motion.zero, motion.zero), _solver(motion.matrix, square, u, w)]
    solvers += [_solver(motion.matrix, h * h * square) for h in harmonics[2:]]
    rest, slaved = motion.force(0 * plane.u0), np.zeros((len(harmonics), len(plane.u0)))
    squares, kept, shapes = [plane.value.imag**2 / (4 * square)], [0.0], [slaved]
    for a in amplitudes:
        last = zip(kept[1:][-3:], shapes[1:][-3:], strict=True)
        slaved = a**2 * _extrapolated(a, [(x, shape / x**2) for x, shape in last]) + 0 * shapes[0]
        for _ in range(MOST_ROUNDS):
            y = 2 * waves[1:].T @ slaved[1:] + slaved[0] + 2 * a * waves[1][:, None] * plane.u0
            pushed = np.array([motion.force(x) - rest + motion.matrix @ x for x in y])
            spectrum = (waves * weights) @ pushed
            before, slaved = slaved, np.array([solve(b) for solve, b in zip(solvers, spectrum, strict=True)])
            change = np.abs(slaved - before).max()
            if change <= SETTLED * a * np.abs(plane.u0).max() or not np.linalg.norm(slaved) <= LARGEST * 2 * a:
                break
        if not change <= SETTLED * a * np.abs(plane.u0).max():
            if len(kept) > 1:
                break
            slaved = 0 * slaved  # round-off dominates at such a small amplitude
            continue
        kept.append(a)
        shapes.append(slaved)
        squares.append((plane.value.imag**2 + plane.w1 @ spectrum[1] / a) / (4 * square))
    kept, squares = np.array(kept), np.array(squares)
    if len(kept) < 4:
        return Balance(np.zeros(0), np.zeros(0), np.inf, np.array(shapes[:1]))
    energy = CubicSpline(kept, squares * kept).antiderivative()(kept)
    ends = CubicSpline(kept, energy).roots(extrapolate=False)
    peak = float(ends[ends > 0.5 * kept[1]].min(initial=np.inf))
    rates = np.sqrt(np.where(kept < peak, np.maximum(2 * energy, 0.0), np.nan))[1:] / kept[1:]
    return Balance(kept[1:], rates, peak, np.array(shapes))


def _extrapolated(x: float, points: list):
    """Value at x of the polynomial through points (x, value); zero without points."""
    return sum(value * np.prod([(x - b) / (a - b) for b, _ in points if b != a]) for a, value in points)


def resonance_gap(matrix, omega: float) -> float:
    """Relative distance |ω_k − 2ω|/(2ω) of the mode nearest to twice a frequency."""
    size = matrix.shape[0]
    if size < DENSE_BELOW:
        with one_thread():
            values = eigvals(matrix.toarray())
    else:
        values = eigs(matrix, k=6, sigma=4 * omega**2, v0=np.ones(size), return_eigenvectors=False)
    frequency = np.sqrt(values.astype(complex)).real
    return float(np.abs(frequency - 2 * omega).min() / (2 * omega))


def first_changes(
    here: LinearisedState, free: Freedom, motion, start: float, rates=None
) -> list[tuple[float, tuple[int, int]]]:
    """Amplitudes at which a contact first reaches the Coulomb limit, opens, closes, or reverses its slip.

    The amplitude is raised from `start` by factors of LADDER until contacts are lost, or grains move by a quarter of
    the skin of the contact list; then the interval is bisected. Contacts of rattlers are left out.

    Parameters
    ----------
    motion : motion(a) returns (K, n) mass-weighted displacements during a period, or None if unknown
    rates : rates(a) returns the corresponding velocities, for dashpots; default: at rest

    Returns
    -------
    list of four (float, (int, int))
        each amplitude with the bodies of the contact; infinite and (−1, −1) if there is none
    """
    state, law, first, *_ = here
    contacts, root, count, watched = state.contacts, np.sqrt(free.mass), len(first.closed), here.supported
    closed, apart = watched & (first.closed > 0), watched & (first.closed == 0)
    stuck = closed & (first.slides == 0) & (first.limit > 0)

    def changes_at(a, phases=slice(None)):
        """(P, 4, C) contacts that stop sticking, open, close, or reverse their slip; None beyond the motion's range."""
        out, ways = [], motion(a)
        if ways is None or not np.abs(ways / root).max() <= 0.25 * contacts.skin:
            return None
        for way, speed in zip(ways[phases], (0 * ways if rates is None else rates(a))[phases], strict=True):
            there = forces(moving(displaced(state, free, way / root), free, speed / root), law)[1]
            opened, slides = closed & (there.mode[:count] == OPEN), there.mode[:count] == SLIDE
            reversed_ = stuck & ((there.slip[:count] * first.slip).sum(axis=1) < 0)
            out.append([stuck & (opened | slides), opened, apart & (there.mode[:count] != OPEN), reversed_])
        return np.array(out)

    changes, low, high = [(np.inf, -1)] * 4, 0.0, start
    while not np.isfinite([changes[0][0], changes[1][0]]).all() and (now := changes_at(high)) is not None:
        for kind in range(4):
            if changes[kind][1] < 0 and now[:, kind].any():
                lost = lambda a, phases, kind=kind: changes_at(a, phases)[:, kind]  # noqa: E731
                changes[kind] = _bisect(lost, low, high, now[:, kind])
        low, high = high, LADDER * high
    return [(a, (int(contacts.i[c]), int(contacts.j[c])) if c >= 0 else (-1, -1)) for a, c in changes]


def _bisect(lost, low: float, high: float, rows) -> tuple[float, int]:
    """Smallest amplitude between two at which a contact is lost, and that contact.

    `rows` (P, C) marks losses at the upper amplitude; phases without a loss there are not examined at smaller ones.
    """
    phases = np.arange(len(rows))
    while high - low > ROOT * high:
        phases, rows = phases[rows.any(axis=1)], rows[rows.any(axis=1)]
        middle = 0.5 * (low + high)
        now = lost(middle, phases)
        if now.any():
            high, rows = middle, now
        else:
            low = middle
    return high, int(np.argmax(rows.any(axis=0)))


def ellipse(plane: Plane):
    """Motion of linear growth: p cos φ + q sin φ at PHASES phases φ."""
    angle = 2 * np.pi * np.arange(PHASES)[:, None] / PHASES
    unit = 2 * (np.cos(angle) * plane.u0 + np.sin(angle) * plane.value.imag * plane.u1)
    return lambda a: a * unit


def balanced_motion(plane: Plane, balance: Balance, sigma: float):
    """Motion of the harmonic balance; its part along q is proportional to the growth rate."""
    amplitudes = np.append(0.0, balance.amplitudes)
    shapes = balance.harmonics / np.maximum(amplitudes, amplitudes[1])[:, None, None] ** 2
    shapes[0] = shapes[1]
    rates = np.append(sigma, np.nan_to_num(balance.rates)) / sigma
    angle = 2 * np.pi * np.arange(TIMES)[:, None] / TIMES
    waves = np.cos(angle * np.arange(balance.harmonics.shape[1]))
    waves[:, 1:] *= 2

    def motion(a):
        if a > amplitudes[-1]:
            return None
        k = max(1, int(np.searchsorted(amplitudes, a)))
        share = (a - amplitudes[k - 1]) / (amplitudes[k] - amplitudes[k - 1])
        slaved, rate = (x[k - 1] + share * (x[k] - x[k - 1]) for x in (shapes, rates))
        turning = np.cos(angle) * plane.u0 + rate * np.sin(angle) * plane.value.imag * plane.u1
        return a**2 * (waves @ slaved) + 2 * a * turning

    return motion
