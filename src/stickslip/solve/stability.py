"""Is this packing stable? The verdict on any accepted state, with the modes that decide it."""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import eig

from ..core.contacts.jacobian import linearise
from ..core.laws.builtin import SHARP, Law, rescales
from ..core.measure import touching
from ..core.readable import readable
from ..core.state import SLIDE, STICK, State
from .balance import BALANCED_BELOW, imbalance, likely_causes, motion_imbalance, unjudged, with_modes_under
from .fastest import fastest_pair
from .freedom import ZERO_BELOW, Freedom, backbone, dynamical_matrix, freedom, translations, unsupported_grains
from .pairs import complex_pairs
from .spectrum import SOFTEST, soft_modes

PAIR_ABOVE = 1e-9  # of the largest |λ|
MIXED = "contacts at Coulomb's limit were taken to stick all, and to slide all; not some of each"
UNLOADED = "overlaps that fall, with which this law shortens slips: contacts were taken as if overlaps grew"
DENSE_UP_TO, PAIRS_UP_TO = 2_500, 12_000  # coordinates


@readable(head=lambda found: _summary(found))
class Stability(NamedTuple):
    """What the linearised motion around a state does; rattlers are left out.

    It is a verdict only where the forces balance. Elsewhere it describes how a motion begins.
    """

    n: int  # grains
    contacts: int  # that touch
    rattlers: np.ndarray  # their numbers, from 0
    residual: float  # largest unbalanced force or torque/R over the mean normal contact force, see `imbalance`
    swing: float  # by which share of that force motion changes forces
    pairs: np.ndarray  # (P,) complex λ with Im > 0, fastest growing first [1/time²]
    negative: np.ndarray  # (K,) real λ < 0 [1/time²]
    zero_modes: int
    rigid: int  # zero modes that are translations of everything
    modes: np.ndarray  # (n, P + K) of the pairs, then of the negative ones: generalised displacements
    free: Freedom
    method: str  # "dense", "pairs" or "fastest"
    scope: str  # what was not looked at, in words
    causes: tuple[str, ...]  # why it is not in equilibrium, see `likely_causes`; empty where it is
    at_limit: int = 0  # contacts at Coulomb's limit under sharp friction: all go on sliding in this spectrum
    if_stuck: "Stability | None" = None  # the same with these contacts sticking; None without such contacts

    @property
    def balanced(self) -> bool:
        """True if neither the residual nor the swing exceeds `BALANCED_BELOW`."""
        return max(self.residual, self.swing) <= BALANCED_BELOW

    @property
    def grows(self) -> bool:
        """True if something grows exponentially in the motion linearised around this state, at rest or not."""
        return bool(len(self.pairs) or len(self.negative))

    @property
    def stable(self) -> bool | None:
        """True if nothing was found that grows; floppy modes are counted, not judged.

        None off equilibrium, and where something grows only if contacts at Coulomb's limit go on sliding.
        """
        return combine_stability(self.grows, self.if_stuck) if self.balanced else None

    @property
    def growth_rate(self) -> np.ndarray:
        """(P,) ω_i of the pairs: displacements grow as exp(ω_i t) [1/time]."""
        return np.abs(np.sqrt(self.pairs).imag)

    @property
    def frequency(self) -> np.ndarray:
        """(P,) ω_r of the pairs [1/time]."""
        return np.abs(np.sqrt(self.pairs).real)

    @property
    def verdict(self) -> str:
        """In words: stable, oscillatory instability, buckling, floppy modes; or that this is no equilibrium."""
        if not self.balanced:
            return unjudged(self.residual, self.swing)
        return combine_motions(self.at_limit, self, self.if_stuck)

    @property
    def motion(self) -> str:
        """The spectrum in words: the verdict at an equilibrium, and how a motion begins elsewhere."""
        found = []
        if len(self.pairs):
            rate, frequency = self.growth_rate[0], self.frequency[0]
            period = f"period {2 * np.pi / frequency:.4g}" if frequency > 0 else "no period"
            found.append(
                f"oscillatory instability: {len(self.pairs)} complex pair(s), the fastest with {period} and e-folding "
                f"time {1 / rate:.4g}"
            )
        if len(self.negative):
            e_folding = 1 / np.sqrt(-self.negative.min())
            found.append(f"buckling: {len(self.negative)} negative λ, e-folding time {e_folding:.4g}")
        if self.zero_modes > self.rigid:
            found.append(f"floppy modes: {self.zero_modes - self.rigid} beside {self.rigid} translations")
        if not self.grows:
            found.insert(0, "stable" if self.balanced else "nothing grows")
        return "; ".join(found)


def combine_stability(grows: bool, stuck) -> bool | None:
    """A verdict from both spectra: of contacts at Coulomb's limit that go on sliding, and of the same that stick.

    Small disturbances make them stick: what grows then grows. What grows only if they slide on, all in one direction,
    needs a motion that keeps them sliding, and is left open.
    """
    if stuck is None or stuck.grows or not grows:
        return not (grows if stuck is None else stuck.grows)
    return None


def combine_motions(count: int, found, stuck) -> str:
    """The verdict in words, from both spectra if there are two."""
    if stuck is None or not (found.grows or stuck.grows):
        return found.motion
    return (
        f"{'' if stuck.grows else 'not decided: '}if the {count} contact(s) at Coulomb's limit stick, as after small "
        f"disturbances: {stuck.motion}; if all of them go on sliding: {found.motion}"
    )


def stability(state: State, law: Law, *, method: str = "auto", report=None) -> Stability:
    """The verdict on an accepted state: complex pairs, negative λ, floppy modes, rattlers.

    A residual above `BALANCED_BELOW` of the mean contact force is no equilibrium: then `stable` is None, `verdict` says
    so and `causes` name what may be missing. Contacts are in the modes that their slip has under this law, which may be
    another than the one they were committed under. With sharp friction a contact at Coulomb's limit slides or sticks,
    whichever way it is pushed: the spectrum is that of all such contacts sliding, `if_stuck` that of all sticking, and
    the verdict says both where they differ. Under a law with `rescaled=True` the spectrum is that of contacts that are
    not being unloaded, and `scope` says so.

    Parameters
    ----------
    method : "dense" (everything, up to 2500 coordinates within seconds, at most 10,000), "pairs" (all complex pairs, up
        to 12,000), "fastest" (the fastest pair that can be excited); "auto" takes the first that fits
    report : called as report(stage, share done, words)

    Raises
    ------
    ValueError
        if the state is too large for the method; names the one to take.

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Sec. II C and III A.
    """
    if method not in ("auto", "dense", "pairs", "fastest"):
        raise ValueError(f"method {method!r} was given: use auto, dense, pairs or fastest")
    state = with_modes_under(state, law)
    found, rows = _analyse(state, law, method, report), contacts_at_limit(state, law)
    if not len(rows):
        return found
    scope = f"{found.scope}; {MIXED}" if found.scope else MIXED
    stuck = _analyse(with_sticking(state, rows), law, method, report)
    return found._replace(at_limit=len(rows), if_stuck=stuck, scope=scope)


def unloading_scope(law: Law) -> str:
    """What no spectrum of a law looks at whose forces have a kink where the memory was committed."""
    return UNLOADED if rescales(law.kind) else ""


def contacts_at_limit(state: State, law: Law) -> np.ndarray:
    """Numbers of the contacts of grains that are held which are at Coulomb's limit, under sharp friction."""
    if law.coulomb != SHARP:
        return np.zeros(0, np.int64)
    rows = touching(state)
    loose = np.append(unsupported_grains(state, law), np.zeros(len(state.walls.mass), bool))
    slides = (state.contacts.mode[rows] == SLIDE) & (linearise(state, law).limit[rows] > 0)
    return rows[slides & ~loose[state.contacts.i[rows]] & ~loose[state.contacts.j[rows]]]


def with_sticking(state: State, rows: np.ndarray) -> State:
    """The state with some contacts sticking."""
    mode = state.contacts.mode.copy()
    mode[rows] = STICK
    return state._replace(contacts=state.contacts._replace(mode=mode))


def _analyse(state: State, law: Law, method: str, report) -> Stability:
    """The verdict with every contact held in its mode."""
    loose = unsupported_grains(state, law)
    free = backbone(state, law)
    size = len(free)
    if not size:
        raise ValueError("nothing but rattlers was given: stability needs grains that hold each other")
    if method == "auto":
        method = "dense" if size <= DENSE_UP_TO else "pairs" if size <= PAIRS_UP_TO else "fastest"
    if method == "dense" and size > 10_000:
        raise ValueError(f"{size} coordinates are too many for the method 'dense' (10000): take 'pairs' or 'fastest'")
    if method == "pairs" and size > PAIRS_UP_TO:
        raise ValueError(f"{size} coordinates are too many for the method 'pairs' ({PAIRS_UP_TO}): take 'fastest'")
    matrix = dynamical_matrix(state, law, free)
    if method == "dense":
        pairs, negative, zero_modes, vectors = _analyse_dense(matrix)
        modes, scope = vectors / np.sqrt(free.mass)[:, None], ""
    else:
        pairs, modes, scope = _analyse_large(state, law, free, method, report)
        negative, zero_modes, soft = soft_modes(matrix)
        modes = np.hstack([modes, soft / np.sqrt(free.mass)[:, None]])
        scope += f"; negative and zero λ were looked for among the {SOFTEST} smallest"
    scope = "; ".join(filter(None, [scope, unloading_scope(law)]))
    residual, moves = imbalance(state, law), motion_imbalance(state, law)
    causes = () if max(residual, moves) <= BALANCED_BELOW else likely_causes(state, law)
    rigid = int(state.control.free[: len(loose), : state.cell.dim].all()) * translations(matrix, free).shape[1]
    return Stability(
        len(loose), len(touching(state)), np.flatnonzero(loose), residual, moves, pairs, negative, zero_modes, rigid,
        modes, free, method, scope, causes,
    )  # fmt: skip


def _analyse_dense(matrix):
    values, vectors = eig(matrix.toarray(), overwrite_a=True)
    scale = np.abs(values).max(initial=0.0)
    pair = np.flatnonzero(values.imag > PAIR_ABOVE * scale)
    pair = pair[np.argsort(-np.abs(np.sqrt(values[pair]).imag))]
    real = np.abs(values.imag) <= PAIR_ABOVE * scale
    zero = np.abs(values) < ZERO_BELOW * scale
    negative = np.flatnonzero(real & ~zero & (values.real < 0))
    negative = negative[np.argsort(values.real[negative])]
    return values[pair], values.real[negative], int(zero.sum()), vectors[:, [*pair, *negative]]


def _analyse_large(state: State, law: Law, free: Freedom, method: str, report):
    """Pairs, their modes in the coordinates `free`, and what was not looked at."""
    if method == "pairs":
        found = complex_pairs(state, law, report=report and partial(report, "complex pairs"))
        values, modes, scope = found.eigenvalues, found.modes, "all complex pairs that floating point can tell"
    else:
        one = fastest_pair(state, law, report=report)
        there = one.eigenvalue is not None and one.eigenvalue.imag != 0
        values = np.array([one.eigenvalue] if there else [], complex)
        modes = one.mode[:, None] if there else np.zeros((len(one.free), 0), complex)
        scope = str(one)
    place = np.searchsorted(freedom(state).component, free.component)
    return values, modes[place], scope


def _summary(found: Stability) -> str:
    return f"{found.verdict}; {found.n} grains, {found.contacts} contacts, residual {found.residual:.1e}"
