"""Stability of an accepted state, with the decisive modes; with dashpots, from M q̈ = J q + C q̇."""

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eig
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, splu

from ..core.arguments import checked, knows_bonds
from ..core.contacts.bonds import has_damped_bonds
from ..core.contacts.jacobian import blocks_of
from ..core.laws.builtin import Law, damping_model, rescales
from ..core.measure import overlaps
from ..core.progress import Report, silent
from ..core.readable import pluralize, readable
from ..core.state import STICK, State
from ..core.units import with_unit
from .balance import (
    BALANCED_BELOW,
    LinearisedState,
    causes_of_imbalance,
    force_imbalance,
    linearised,
    modes_under,
    motion_imbalance,
    no_equilibrium_message,
    with_mode,
)
from .freedom import PAIR_ABOVE, ZERO_BELOW, Freedom, assembled, freedom, mass_weighted, stiffness_of, translations
from .linear import FACTORS_UP_TO, suitable_threads
from .spectrum import SoftModes, soft_modes

MIXED = (
    "contacts at the Coulomb limit were assumed either all to stick or all to slide; mixed cases were not considered"
)
UNLOADED = "decreasing overlaps, for which this law shortens slips, were not considered: overlaps were assumed to grow"
NEAR = 0.01  # largest gap of grains that nearly touch, over the smaller radius
LEFT_OUT = "the dashpots of the law were ignored"
DENSE_UP_TO, PAIRS_UP_TO = 1_500, 12_000  # numbers of coordinates: LAPACK is fastest below the first
METHODS = {  # description of the computation
    "none": "no spectrum, because the forces do not balance; choose a method to compute it anyway",
    "dense": "all eigenvalues by LAPACK",
    "pairs": "all complex pairs from the modes of the symmetric part",
    "certify": "all complex pairs, and a certificate of the real eigenvalues",
    "fastest": "the lowest modes by shift and invert where factors fit into memory, and tangent dynamics",
}
DAMPED_UP_TO = 1_250  # number of coordinates with dashpots that take seconds; the first-order form has twice as many
DAMPED_AT_MOST = 4_000  # number of coordinates with dashpots that take minutes
NEAR_SHIFT = 4  # number of exponents with dashpots computed near each undamped one
NEAR_ZERO = 18  # number of exponents computed near zero, six of which belong to translations
TOLERANCE = 1e-10  # relative tolerance of the inverse distance from the shift
STARTS = 8  # number of undamped pairs near which exponents are searched for, the fastest first
MOST_PAIRS = 8  # largest number of growing modes in a table


@readable(head=lambda result: _summary(result), rows=lambda result: _rows(result))
class Stability(NamedTuple):
    """Stability of the linearised motion around a state, without rattlers.

    It is a verdict only if the forces balance; otherwise it describes the beginning of the motion. With dashpots,
    λ = −s² for the growing exponents s of M q̈ = J q + C q̇.
    """

    n: int  # number of grains
    contacts: int  # number of contacts that touch
    rattlers: np.ndarray  # numbers of the rattlers, from 0
    residual: float  # largest unbalanced force or torque/R, over the mean normal contact force; see `imbalance`
    swing: float  # force that stops the motion, over the same mean force
    pairs: np.ndarray  # (P,) complex λ with Im > 0, fastest growing first [1/time²]
    negative: np.ndarray  # (K,) real λ < 0 [1/time²]
    zero_modes: int
    rigid: int  # number of zero modes that are translations of the whole packing
    modes: np.ndarray  # (n, P + K) generalised displacements of the pairs, then of the negative λ
    free: Freedom
    method: str  # method used: "dense", "pairs", "certify", "fastest" or "none"; `way` describes it
    scope: str  # limits of the analysis, in words
    causes: tuple[str, ...]  # possible reasons why forces do not balance (see `likely_causes`); empty if they do
    at_limit: int = 0  # number of contacts at the Coulomb limit under sharp friction, all assumed to keep sliding here
    if_stuck: "Stability | None" = None  # stability if these contacts stick; None without such contacts
    undamped: "Stability | None" = None  # stability without the dashpots of the law; None if it has none
    slowest: complex | None = None  # exponent of the slowest decay with dashpots, if all were computed [1/time]
    bonded: int = 0  # number of contacts with an intact bond, including those across gaps
    unverified: int = 0  # number of growing peaks in spectra of tangent dynamics without an extracted eigenvalue

    @property
    def way(self) -> str:
        """Description of the computation."""
        return METHODS[self.method]

    @property
    def balanced(self) -> bool:
        """True if neither the residual nor the swing exceeds `BALANCED_BELOW`."""
        return max(self.residual, self.swing) <= BALANCED_BELOW

    @property
    def grows(self) -> bool:
        """True if any mode grows exponentially in the linearised motion around this state, at rest or not.

        It is also False if no spectrum was computed because the forces do not balance (`method` is "none").
        """
        return bool(len(self.pairs) or len(self.negative))

    @property
    def stable(self) -> bool | None:
        """True if no growing mode was found, whether or not there are floppy modes.

        None away from equilibrium, if a mode grows only while contacts at the Coulomb limit keep sliding, or if
        tangent dynamics showed growth but no eigenvalue was extracted.
        """
        return combine_stability(self, self.if_stuck) if self.balanced else None

    @property
    def exponents(self) -> np.ndarray:
        """(P + K,) growing exponents s = −i√λ of exp(st), one of each pair, in the order of `modes` [1/time]."""
        return -1j * np.sqrt(np.append(self.pairs, self.negative.astype(complex)))

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
        """Verdict in words: stable, oscillatory instability, buckling, floppy modes, or not in equilibrium."""
        if not self.balanced:
            return no_equilibrium_message(self.residual, self.swing)
        return combine_motions(self.at_limit, self, self.if_stuck)

    @property
    def motion(self) -> str:
        """Spectrum in words: the verdict at an equilibrium, and the initial motion elsewhere."""
        motions = []
        if len(self.pairs):
            rate, frequency = self.growth_rate[0], self.frequency[0]
            period = with_unit(f"period {2 * np.pi / frequency:.4g}", "time") if frequency > 0 else "no period"
            several = ", the fastest" if len(self.pairs) > 1 else ""
            motions.append(
                f"oscillatory instability: {pluralize(len(self.pairs), 'complex pair')}{several} with {period} and "
                f"e-folding time {with_unit(f'{1 / rate:.4g}', 'time')}"
            )
        if len(self.negative):
            e_folding = with_unit(f"{1 / np.sqrt(-self.negative.min()):.4g}", "time")
            motions.append(f"buckling: {len(self.negative)} negative λ, e-folding time {e_folding}")
        if self.zero_modes > self.rigid:
            motions.append(f"floppy modes: {self.zero_modes - self.rigid} in addition to {self.rigid} translations")
        if not self.grows and self.unverified:
            peaks = pluralize(self.unverified, "peak")
            motions.insert(0, f"not decided: {peaks} grew in spectra of random motion, but no mode was verified")
        elif not self.grows:
            motions.insert(0, "stable" if self.balanced else "nothing grows")
        return "; ".join(motions)


def combine_stability(sliding, stuck) -> bool | None:
    """Combine the verdicts for two cases: contacts at the Coulomb limit all keep sliding, or they all stick.

    These contacts stick after a small disturbance, so the packing is unstable if a mode grows while they stick. A mode
    that grows only while all of them slide requires a motion that keeps them sliding in one direction; the verdict is
    then undecided. It is also undecided if growth was found but not verified.
    """
    if (stuck or sliding).grows:
        return False
    return None if sliding.grows or sliding.unverified or (stuck and stuck.unverified) else True


def combine_motions(count: int, sliding, stuck) -> str:
    """Verdict in words, combining both spectra if there are two."""
    if stuck is None or not (sliding.grows or stuck.grows):
        return (stuck if stuck and not sliding.unverified else sliding).motion
    undecided, verb = "" if stuck.grows else "not decided: ", "sticks" if count == 1 else "stick"
    return (
        f"{undecided}if the {pluralize(count, 'contact')} at the Coulomb limit {verb}, as after small disturbances: "
        f"{stuck.motion}; if all of them keep sliding: {sliding.motion}"
    )


@checked
@knows_bonds
def stability(
    state: State,
    law: Law,
    *,
    method: Literal["auto", "fastest", "all", "certify", "dense", "pairs"] = "auto",
    dashpots: bool = True,
    saved: Path | None = None,
    report: Report = silent,
) -> Stability:
    """Analyse the stability of an accepted state: complex pairs, negative λ, floppy modes, and rattlers.

    A state with a residual above `BALANCED_BELOW` of the mean contact force is not in equilibrium. Then `stable` is
    None, `verdict` states this, `causes` lists possible reasons, and the spectrum is computed only with a method other
    than "auto". The mode of each contact is determined by its slip under this law, which may differ from the law under
    which the state was accepted. With sharp friction, a contact at the Coulomb limit slides or sticks depending on the
    direction in which it is pushed. The spectrum assumes that all such contacts slide, and `if_stuck` assumes that all
    of them stick; the verdict states both results if they differ. Under a law with `rescaled=True`, the spectrum
    assumes that no contact is being unloaded, as `scope` states.

    Dashpots of the law may stabilise a packing or destabilise it. They are included: the verdict is that of the
    exponents s of M q̈ = J q + C q̇, and `undamped` holds the analysis without them.

    Parameters
    ----------
    dashpots : if False, dashpots of the law are ignored, and every complex pair grows
    method : task: "fastest" (the fastest-growing pair), "all" (all complex pairs), "certify" (also a
        certificate of the real eigenvalues; the estimated time is reported first), or "auto" ("all" up to 12,000
        coordinates, "fastest" beyond). Each uses the cheapest algorithm, which `Stability.method` names: LAPACK up to
        1500 coordinates. "dense" (up to 10,000 coordinates) and "pairs" (up to 12,000) select an algorithm. With
        dashpots, all exponents are computed up to 1250 coordinates (with "dense", 4000). In larger packings, exponents
        are searched for near those of the undamped motion, which the chosen method finds; beyond 90,000 coordinates,
        probes find the fastest-growing one. With dashpots, there is no certificate
    saved : file in which a search for the fastest pair is saved every minute, and from which it continues; it is
        removed at the end
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        If the state is too large for the method; the message names one that can be used.

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Sec. II C and III A; with dashpots, Tisseur & Meerbergen,
    doi:10.1137/S0036144500381988, Sec. 3.4.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> ss.stability(state, law).verdict
    'stable'
    """
    here, has_dashpots = linearised(state, law), bool(damping_model(law)) or has_damped_bonds(state)
    here = here.with_modes(modes_under(state, law, here.line))
    slid = _analyse(here, method, has_dashpots and dashpots, report, saved)
    if has_dashpots and not dashpots:
        slid = slid._replace(scope=join_scopes(slid.scope, LEFT_OUT))
    rows = here.at_limit
    if not len(rows) or slid.method == "none":
        _remove_saved(saved)
        return slid
    sticking = here.with_modes(with_mode(here.state, rows, STICK))
    beside = saved and saved.with_stem(f"{saved.stem}-stuck")
    stuck = _analyse(sticking, method, has_dashpots and dashpots, report, beside)
    _remove_saved(saved, beside)
    both = (slid, stuck), (slid.undamped, stuck.undamped)
    slid, undamped = (
        one and one._replace(at_limit=len(rows), if_stuck=other, scope=join_scopes(one.scope, MIXED))
        for one, other in both
    )
    return slid._replace(undamped=undamped)


def _remove_saved(*searches: Path | None) -> None:
    """Remove the files of finished searches, which are kept until all searches have finished."""
    for path in filter(None, searches):
        for file in (path, path.with_stem(f"{path.stem}-damped")):
            file.unlink(missing_ok=True)


def join_scopes(*scope: str) -> str:
    """Scope joined from those of its parts that are not empty."""
    return "; ".join(filter(None, scope))


def _analyse(here: LinearisedState, method: str, dashpots: bool, report, saved: Path | None) -> Stability:
    """Stability with every contact held in its mode."""
    (state, law, line, rows, loose), free = here, here.backbone
    size = len(free)
    if not size:
        near = _near_contacts(state)
        raise ValueError(f"the packing has only rattlers{near}: stability needs grains that support each other")
    residual, moves = force_imbalance(here), motion_imbalance(here)
    causes = () if max(residual, moves) <= BALANCED_BELOW else causes_of_imbalance(here)
    about = len(loose), len(rows), np.flatnonzero(loose), residual, moves
    bonded = int(state.bonds.intact.sum()) if state.bonds else 0
    if causes and method == "auto":
        nothing = np.zeros(0)
        modes = np.zeros((size, 0))
        return Stability(*about, nothing + 0j, nothing, 0, 0, modes, free, "none", "", causes, bonded=bonded)
    asked, method = method, _cheapest_way(method, size)
    if dashpots:
        check_damped_method(asked, size)
    blocks, dampers = blocks_of(state, law, line)
    matrix = mass_weighted(stiffness_of(state, line, blocks, free), free)
    unverified = 0
    if method == "dense":
        pairs, negative, zero_modes, vectors = _analyse_dense(matrix)
        modes, scope = vectors / np.sqrt(free.mass)[:, None], ""
    else:
        pairs, modes, scope, soft, unverified = _analyse_large(here, free, matrix, method, report, saved)
        if soft is None:
            negative, zero_modes = np.zeros(0), translations(matrix, free).shape[1]
            scope += "; the search covered neither floppy modes nor buckling slower than that"
        else:
            negative, zero_modes, vectors = soft.negative, soft.zero, soft.vectors
            modes = np.hstack([modes, vectors])
            scope += "; negative and zero λ were searched for among the smallest"
    unloaded = UNLOADED if rescales(law) else ""
    scope = join_scopes(scope, unloaded)
    rigid = int(state.control.free[: len(loose), : state.cell.dim].all()) * translations(matrix, free).shape[1]
    result = Stability(
        *about, pairs, negative, zero_modes, rigid, modes, free, method, scope, causes,
        bonded=bonded, unverified=unverified,
    )  # fmt: skip
    if not dashpots:
        return result
    drag = assembled(state, dampers, free)
    if size > FACTORS_UP_TO:
        pairs, modes, scope, soft, unverified = _find_fastest(
            here, free, matrix, report, saved and saved.with_stem(f"{saved.stem}-damped"), drag
        )
        return result._replace(
            pairs=pairs, negative=np.zeros(0) if soft is None else soft.negative,
            modes=modes if soft is None else np.hstack([modes, soft.vectors]),
            scope=join_scopes(f"{scope}; the search did not cover buckling slower than that", unloaded),
            undamped=result, unverified=unverified,
        )  # fmt: skip
    s, modes, slowest, near = growing_exponents(matrix, drag, free, result.exponents, asked, report)
    swings = s.imag < 0
    return result._replace(
        pairs=-(s[swings] ** 2), negative=-(s[~swings].real ** 2), modes=modes[:, np.argsort(~swings, kind="stable")],
        scope=join_scopes(near, result.scope if near else unloaded), undamped=result, slowest=slowest,
    )  # fmt: skip


def _near_contacts(state: State) -> str:
    """Sentence on grains that nearly touch, as in packings of rigid grains; empty otherwise."""
    gap, size = -overlaps(state), np.append(state.grains.radius, np.full(len(state.walls.mass), np.inf))
    count = int(state.contacts.count[0])
    small = np.minimum(size[state.contacts.i[:count]], size[state.contacts.j[:count]])
    near = int(((gap[:count] > 0) & (gap[:count] < NEAR * small)).sum())
    told = "as in packings of rigid grains, for which forces must also be given"
    return f", and {near} pairs have gaps below {100 * NEAR:g} % of a radius, {told}" if near else ""


def _cheapest_way(method: str, size: int) -> str:
    """Cheapest algorithm for a task with `size` coordinates, as a key of METHODS."""
    if method == "dense" and size > 10_000:
        raise ValueError(f"the method 'dense' supports at most 10000 coordinates, got {size}: use 'pairs' or 'fastest'")
    if method in ("all", "pairs", "certify") and size > PAIRS_UP_TO:
        from .pairs import certificate_seconds, format_seconds

        time = f", and would take about {format_seconds(certificate_seconds(size))}" if method == "certify" else ""
        raise ValueError(
            f"the method {method!r} supports at most {PAIRS_UP_TO} coordinates{time}, got {size}: use 'fastest'"
        )
    if method in ("auto", "fastest", "all") and size <= DENSE_UP_TO:
        return "dense"
    return {"auto": "pairs" if size <= PAIRS_UP_TO else "fastest", "all": "pairs"}.get(method, method)


def _analyse_dense(matrix):
    with suitable_threads(matrix.shape[0]):
        values, vectors = eig(matrix.toarray(), overwrite_a=True)
    scale = np.abs(values).max(initial=0.0)
    pair = np.flatnonzero(values.imag > PAIR_ABOVE * scale)
    pair = pair[np.argsort(-np.abs(np.sqrt(values[pair]).imag))]
    real = np.abs(values.imag) <= PAIR_ABOVE * scale
    zero = np.abs(values) < ZERO_BELOW * scale
    negative = np.flatnonzero(real & ~zero & (values.real < 0))
    negative = negative[np.argsort(values.real[negative])]
    return values[pair], values.real[negative], int(zero.sum()), vectors[:, [*pair, *negative]]


def _find_fastest(here: LinearisedState, free: Freedom, matrix, report, saved: Path | None, dampers=None):
    """Fastest pair with its mode, scope, negative and zero λ, and unverified peaks; with dashpots, λ = −s²."""
    from .fastest import find_fastest

    root, drag = np.sqrt(1 / free.mass), None
    if dampers is not None:
        drag = sparse.csr_array(sparse.diags_array(root) @ dampers @ sparse.diags_array(root))
    fastest = find_fastest(here.state, free, matrix, report, saved=saved, drag=drag)
    there = fastest.eigenvalue is not None and fastest.eigenvalue.imag != 0
    values = np.array([fastest.eigenvalue] if there else [], complex)
    modes = fastest.mode[:, None] if there else np.zeros((len(free), 0), complex)
    soft = fastest.soft
    if soft is None and fastest.eigenvalue is not None and not there:
        soft = SoftModes(np.array([fastest.eigenvalue.real]), fastest.mode[:, None].real, 0)
    return values, modes, str(fastest), soft, fastest.unverified


def _analyse_large(here: LinearisedState, free: Freedom, matrix, method: str, report, saved: Path | None):
    """Pairs, modes in the coordinates `free`, the scope of the search, negative and zero λ, and unverified peaks."""
    if method == "fastest":
        return _find_fastest(here, free, matrix, report, saved)
    from .pairs import find_pairs

    whole, certify = freedom(here.state), method == "certify"

    def matrix_of(whole: Freedom):
        return matrix if len(whole) == len(free) else here.dynamical_matrix(whole)  # includes rattlers

    search = find_pairs(whole, matrix_of, certify, report)
    complete = f"certificate: {search.certified}" if certify else "that all others were found was not proved"
    scope = f"pairs within round-off of the real axis; {complete}"
    negative, zero, vectors = soft_modes(matrix)
    index = np.searchsorted(whole.component, free.component)
    return (
        search.eigenvalues,
        search.modes[index],
        scope,
        SoftModes(negative, vectors / np.sqrt(free.mass)[:, None], zero),
        0,
    )


def _summary(result: Stability) -> str:
    return f"{result.verdict}; {result.n} grains, {result.contacts} contacts, residual {result.residual:.1e}"


def _rows(result: Stability):
    """Table rows: the verdict and its basis, then the growing modes, fastest first."""
    yield "verdict", result.verdict
    for cause in result.causes:
        yield "possible reason", cause
    yield "grains", result.n
    yield "contacts that touch", result.contacts
    yield "bonded contacts", result.bonded or None
    yield "contacts at the Coulomb limit", result.at_limit or None
    yield "rattlers", len(result.rattlers), "", "grains without support, excluded"
    yield "residual", result.residual, "", "largest unbalanced force over the mean contact force"
    slides = "if all contacts at the limit keep sliding" if result.if_stuck else ""
    for k, (rate, frequency) in enumerate(zip(result.growth_rate, result.frequency, strict=True)):
        if k == MOST_PAIRS:
            yield "more growing pairs", len(result.pairs) - MOST_PAIRS
            break
        period = f"period {2 * np.pi / frequency:.4g}, " if frequency > 0 else ""
        yield f"growing pair {k + 1}", f"{period}e-folding time {1 / rate:.4g}", "time", slides
    for k, rate in enumerate(np.sqrt(-result.negative[:MOST_PAIRS])):
        yield f"buckling mode {k + 1}", f"e-folding time {1 / rate:.4g}", "time", slides
    yield "more buckling modes", max(len(result.negative) - MOST_PAIRS, 0) or None
    yield "floppy modes", max(result.zero_modes - result.rigid, 0), "", "besides translations of the whole packing"
    yield "if contacts at the limit stick", result.if_stuck and result.if_stuck.motion
    yield "without dashpots", result.undamped and result.undamped.verdict
    yield "computed", result.way
    yield "not considered", result.scope or None


def check_damped_method(method: str, size: int) -> None:
    """Raise ValueError if a method of `stability` does not support `size` coordinates with dashpots."""
    if method == "certify":
        raise ValueError("method 'certify' does not support dashpots: use 'all', or omit them")
    if method == "dense" and size > DAMPED_AT_MOST:
        raise ValueError(
            f"the method 'dense' with dashpots supports at most {DAMPED_AT_MOST} coordinates, got {size}: use 'pairs' "
            "or 'fastest', or omit the dashpots"
        )


def growing_exponents(
    pull, dampers, free: Freedom, undamped: np.ndarray, method: str, report: Report
) -> tuple[np.ndarray, np.ndarray, complex | None, str]:
    """Growing exponents s of exp(st) with dashpots, with each contact held in its mode.

    Parameters
    ----------
    pull : (n, n) sparse A of `dynamical_matrix` [1/time²]
    dampers : (n, n) sparse ∂(Pᵀf)/∂q̇ [force time/length]
    undamped : (P,) complex, growing exponents without dashpots; large packings are searched near them only [1/time]
    method : of `stability`; "dense", "all", "auto" and "fastest" compute all exponents of up to 1250 coordinates

    Returns
    -------
    exponents : (K,) Re s > 0, Im s ≤ 0, one of each conjugate pair, fastest growing first [1/time]
    modes : (n, K) complex: generalised displacements of unit mass-weighted norm
    slowest : exponent of the slowest decay [1/time]; None if not all were computed
    scope : limits of the search, in words

    Source
    ------
    Tisseur & Meerbergen, doi:10.1137/S0036144500381988, Sec. 3.4, for the first-order form of the quadratic
    eigenvalue problem.
    """
    root = 1 / np.sqrt(free.mass)
    drag = sparse.csr_array(sparse.diags_array(-root) @ dampers @ sparse.diags_array(root))
    unit = np.sqrt(np.abs(pull.data).max())  # [1/time]: in this unit both blocks are of order one
    pull, drag = pull / unit**2, drag / unit
    if method == "dense" or (method in ("auto", "all", "fastest") and len(free) <= DAMPED_UP_TO):
        values, vectors, slowest, scope = *_solve_dense(pull, drag), ""
    else:
        values, vectors = _search_near_shifts(pull, drag, undamped / unit, report)
        slowest = None
        scope = (
            f"exponents were searched for near the {min(len(undamped), STARTS)} fastest of the undamped motion and "
            "near zero; the search did not cover growth caused by dashpots alone"
        )
    order = np.lexsort((values.imag, -values.real))
    modes = vectors[:, order].conj() * root[:, None]
    return unit * values[order].conj(), modes, None if slowest is None else unit * slowest, scope


def _is_growing(values: np.ndarray) -> np.ndarray:
    """Mask of growing nonzero exponents, one of each pair. Translations give s = 0 twice, split by round-off."""
    return (values.real > PAIR_ABOVE) & (values.imag >= 0) & (np.abs(values) ** 2 > ZERO_BELOW)


def _solve_dense(pull, drag) -> tuple[np.ndarray, np.ndarray, complex]:
    """Growing exponents, their mass-weighted modes, and the slowest decay, in units of the largest λ."""
    n = pull.shape[0]
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-pull.toarray(), -drag.toarray()]])
    with suitable_threads(n):
        values, vectors = eig(form, overwrite_a=True)
    chosen = np.flatnonzero(_is_growing(values))
    decaying = values[(np.abs(values) ** 2 > ZERO_BELOW) & (values.real <= PAIR_ABOVE)]
    slowest = complex(decaying[np.argmax(decaying.real)]) if len(decaying) else None
    return values[chosen], vectors[:n, chosen] / np.linalg.norm(vectors[:n, chosen], axis=0), slowest


def _search_near_shifts(pull, drag, starts: np.ndarray, report) -> tuple[np.ndarray, np.ndarray]:
    """Growing exponents near those of the undamped motion and near zero, by shift and invert, without duplicates."""
    n = pull.shape[0]
    chosen = starts[np.argsort(-starts.real)][:STARTS]
    shifts = [1e-3, *(complex(s.real, abs(s.imag)) for s in chosen)]
    values, vectors = np.zeros(0, complex), np.zeros((n, 0), complex)
    for k, shift in enumerate(shifts):
        report("exponents with dashpots", k / len(shifts), f"{len(values)} growing so far")
        found, modes = _exponents_near(pull, drag, complex(shift), NEAR_SHIFT if k else NEAR_ZERO)
        found = np.where(np.abs(found.imag) <= PAIR_ABOVE, found.real, found)  # imaginary round-off of a real one
        found, modes = found[_is_growing(found)], modes[:, _is_growing(found)]
        new = [not np.any(np.abs(values - s) < 1e-8) for s in found]
        values, vectors = np.append(values, found[new]), np.hstack([vectors, modes[:, new]])
    return values, vectors / np.linalg.norm(vectors, axis=0)


def _exponents_near(pull, drag, shift: complex, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Exponents nearest to a shift σ, and their modes; (A − σ)⁻¹ takes one factorisation of σ² + σ C + K."""
    n = pull.shape[0]
    quadratic = sparse.csc_array(shift**2 * sparse.eye_array(n) + shift * drag + pull)
    # an ordering that uses the symmetric pattern has a tenth of the fill of the default
    solve = splu(quadratic, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-2, options={"SymmetricMode": True})

    def inverse(x):
        u, v = x[:n].astype(complex), x[n:].astype(complex)
        top = -solve.solve(v + drag @ u + shift * u)
        return np.concatenate([top, u + shift * top])

    operator = LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=complex)
    start = np.random.default_rng(0).normal(size=2 * n).astype(complex)
    try:
        theta, vectors = eigs(operator, k=min(count, n - 2), which="LM", v0=start, tol=TOLERANCE)
    except ArpackNoConvergence as problem:
        theta, vectors = problem.eigenvalues, problem.eigenvectors
    return shift + 1 / theta, vectors[:n]
