"""Loading a packing until it fails: stress, complex pairs, contacts, events and forecasts along a quasi-static path."""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np

from ..core.arguments import POSITIVE, Positive, checked, knows_bonds
from ..core.contacts.bonding import bond_shares
from ..core.dynamics.run import stable_time_step
from ..core.laws.builtin import Law, damping_model, with_values
from ..core.measure import touching
from ..core.progress import NotInEquilibriumError, Outcome, Report, Status, silent
from ..core.readable import pluralize, readable
from ..core.state import FAILURES, SLIDE, State
from ..data.checkpoint import Checkpoint, load_or_compute
from ..solve.balance import BALANCED_BELOW, imbalance, no_equilibrium_message
from ..solve.bond_failure import first_break
from ..solve.freedom import backbone
from ..solve.sensitivity import contact_sensitivity
from ..solve.shear_response import PRUNE, softest
from ..solve.spectrum import REAL_BELOW, Spectrum, match_pairs, spectrum
from ..solve.stability import stability
from .event_class import Event, loss_ahead
from .event_path import COUPLED, Forecast, Judge, Point, Signs, forecast, mean_overlap
from .events import SMALLEST, Search, check_packing, first_point
from .protocols import SAME_PAIR, Change, Equilibrium, bisect_change
from .quasistatic import aqs
from .settling import Deformation, Mode, deformation

STEP = 0.02  # default strain step, in units of the mean overlap divided by the mean diameter
STEPS = 500  # default largest number of steps
LONGEST = 0.1  # largest strain step, beyond which the packing does not persist
RESOLUTION = 2.5e-3  # width of the bracket of an event, in strain steps
DRAG = 0.1  # default drag, in units of the highest frequency
AT_MOST = 2500  # largest number of coordinates, because each step needs several dense spectra
MOST_STEPS = 100_000
COUPLES = 8  # number of pairs of coupled real modes that are stored at each step
TRIED, DECISIVE = 25, 5  # numbers of contact changes for which the spectrum is computed, and that are reported
CHANGES = ("opens", "closes", "starts to slide", "sticks again")
TO_BREAK = 20  # least number of default steps before the first break that linear response predicts


@readable(head=lambda step: f"strain {step.strain:.6g}, {pluralize(step.pairs, 'complex pair')}")
class PathStep(NamedTuple):
    """Equilibrium at the end of a strain step, and the changes during the step."""

    strain: float  # strain since the first state, negative if it decreases [1]
    stress: float  # stress conjugate to the strain: −σ_xy, (σ_yy − σ_xx)/2, pressure or σ_yy [force/length^(dim−1)]
    pressure: float  # [force/length^(dim−1)]
    pairs: int  # complex pairs
    growth: float  # growth rate |Im √λ| of the fastest pair without drag, 0 without a pair [1/time]
    softest: float  # smallest real eigenvalue of −M⁻¹J [1/time²]
    exponent: float  # largest exponent of growth under the drag, negative if the state is stable [1/time]
    negative: int  # directions of negative stiffness
    touching: int  # contacts
    sliding: int  # contacts with a force at the Coulomb limit
    loss_ahead: float  # strain at which the linear motion loses a contact and the state becomes unstable
    couples: np.ndarray  # (K, 3) coupled real modes: mean eigenvalue [1/time²], squared gap [1/time^4], overlap [1]
    changes: np.ndarray  # (C, 3) changes of contacts since the last step: index in CHANGES, and the two grains
    events: tuple[Event, ...]  # discontinuities since the last step; strains without the sign of the path
    tolerated: bool  # the spectrum is unstable, but dynamics stays near this state
    state: State
    bonds: int = 0  # intact bonds
    bond_share: float = 0.0  # largest ratio of load to strength of a bond

    @property
    def verdict(self) -> str:
        """Verdict on the motion without drag."""
        if self.negative:
            return "unstable: negative stiffness"
        return "unstable: oscillations grow" if self.pairs else "stable"


@readable
class PairLife(NamedTuple):
    """A complex pair from its birth to its death. Brackets are NaN if the path begins or ends with the pair."""

    born_below: float  # strains between which it was born
    born: float
    died: float  # strains between which it died
    died_above: float
    growth: float  # largest growth rate [1/time]
    at: float  # strain of the largest growth rate
    event: bool  # whether an event lies in one of these brackets: then the pair began or ended with this jump


@readable
class DecisiveContact(NamedTuple):
    """Contact whose opening or sliding changes the growth of a state most; see `contact_sensitivity`."""

    i: int
    j: int
    what: str  # "opens" or "slides"
    mobilised: float  # |F_t|/(μ F_n), NaN without friction
    growth: float  # growth rate after this change [1/time]
    verdict: str  # verdict after this change


@readable(head=lambda found: found.end)
class Failure(NamedTuple):
    """Path of a packing to its failure, or to a given strain."""

    law: Law
    mode: Mode
    sign: int  # −1 if the strain decreases
    step: float
    drag: float  # [1/time]
    resolution: float  # largest width of the bracket of an event
    steps: tuple[PathStep, ...]
    pairs: tuple[PairLife, ...]
    onset: Change | None  # bracket of the birth of the first complex pair
    decisive: tuple[DecisiveContact, ...]  # contacts on which the growth rate in the last state depends most
    verdict: str  # verdict on the last state
    reason: str  # reason why the path ended

    @property
    def events(self) -> tuple[Event, ...]:
        """Events of the path, with strains that carry the sign of the path."""
        found = (event for step in self.steps for event in step.events)
        return tuple(e._replace(strain=self.sign * e.strain, below=self.sign * e.below) for e in found)

    @property
    def signs(self) -> Signs:
        """Series along the path from which forecasts are made."""
        return signs_of(self.steps)

    @property
    def forecasts(self) -> tuple[Forecast, ...]:
        """Forecasts of the next event and of the next pair at the end of the path."""
        return tuple(one.signed(self.sign) for one in forecast(self.signs))

    @property
    def end(self) -> str:
        """Outcome of the path, in one sentence."""
        last, events = self.steps[-1], self.events
        out = f"at strain {last.strain:.6g} {self.reason}"
        if self.onset:
            out += f"; first complex pair at {self.onset.load:.6g}"
        if events:
            out += f"; {pluralize(len(events), 'event')}, the first at {events[0].strain:.6g}: {events[0].kind.value}"
            if events[0].trigger[0] >= 0:
                out += " (grains {} and {})".format(*events[0].trigger)
        return out

    def to_dataframe(self):
        """Table of the path as a pandas DataFrame, with a row for each strain step."""
        import pandas

        names = [name for name, kind in PathStep.__annotations__.items() if kind in (int, float, bool)]
        rows = [[getattr(step, name) for name in names] + [step.verdict] for step in self.steps]
        return pandas.DataFrame(rows, columns=[*names, "verdict"])


class Loading(NamedTuple):
    """Options of a path, with defaults derived from the packing."""

    law: Law  # without dashpots
    way: Deformation
    until: str | float
    limit: float  # largest strain, positive
    step: float
    drag: float
    prune: float

    @property
    def resolution(self) -> float:
        """Largest width of the bracket of an event."""
        return RESOLUTION * self.step


@checked
@knows_bonds
def shear_to_failure(
    state: State, law: Law, *, until: Literal["first-pair", "first-event", "first-break"] | float = "first-event",
    mode: Mode = "simple", reverse: bool = False, step: Positive | None = None, limit: Positive | None = None,
    drag: Positive | None = None, prune: Annotated[float, POSITIVE] = PRUNE, kept: Checkpoint | None = None,
    report: Report = silent,
) -> Failure:  # fmt: skip
    """Shear or compress a packing quasi-statically from its present state until it fails, or to a given strain.

    Each strain step follows the path as `find_events` does: by Newton's method where the path is smooth and stable
    under the drag, and by dynamics with the drag where it is not. Dashpots of the law have no influence on the
    equilibria; they are ignored until the verdict on the last state. Each step depends only on the previous state, so a
    path continued from `kept` is bitwise identical.

    Parameters
    ----------
    state : packing at rest in a periodic cell, without walls or loads
    until : "first-pair", the birth of a complex pair; "first-event", a discontinuity of the path, such as the break of
        a bond; "first-break", the first break of a bond; or a strain, negative for shear in the opposite direction or
        unloading. Bonds that break on the way are events
    mode, reverse : deformation of the cell (see `aqs`); with "first-…", reverse=True makes the strain decrease
    step : largest strain step; default 0.02 mean overlaps divided by the mean diameter, rounded to one digit; with
        bonds, at most a twentieth of the strain at which linear response predicts the first break
    limit : strain at which the path ends even without an instability; default 500 steps
    drag : ν of the dynamics that determine events (see `find_events`); default a tenth of the highest
        frequency [1/time]
    prune : see `find_events`
    kept : storage in which each step is saved as soon as it is finished
    report : called as report(stage, share done, text with strain, stress and growth)

    Raises
    ------
    ValueError
        If the packing is not in equilibrium, carries no load, has walls or no periodic cell, is too large for dense
        spectra, or if options do not fit together.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.88, dim=2, law=law, seed=1)
    >>> found = shear_to_failure(state, law, until=4e-4, step=2e-4)
    >>> found.to_dataframe()[["strain", "verdict"]].values.tolist()
    [[0.0, 'stable'], [0.0002, 'stable'], [0.0004, 'stable']]
    """
    how = complete_path(state, law, until, mode, reverse, step, limit, drag, prune)
    steps: list[PathStep] = []
    reason = ""
    try:
        for now in follow(how, state, kept):
            steps.append(now)
            report("shear", abs(now.strain) / how.limit, _describe(now))
            if reason := _reached(how.until, steps):
                break
    except NotInEquilibriumError as problem:
        if not steps:
            raise
        reason = f"no equilibrium was found beyond ({problem.outcome})"
    names = {
        "first-pair": "without a complex pair", "first-event": "without an event",
        "first-break": "without a broken bond",
    }  # fmt: skip
    return _conclude(how, law, steps, reason or f"the path ended {names.get(how.until, 'as requested')}", report)


def follow(how: Loading, state: State, kept: Checkpoint | None = None) -> Iterator[PathStep]:
    """Steps of a path up to its largest strain, each of them loaded from a file, or computed and saved."""
    before = None
    for k in range(int(np.ceil(round(how.limit / how.step, 9))) + 1):
        goal = min(how.limit, k * how.step)
        make = partial(_advance, how, before, goal) if before else partial(_begin, how, state)
        before = load_or_compute(kept, f"strain-{k:06d}", make, PathStep)
        yield before
        if _fell_apart(before):
            return


def complete_path(state, law, until, mode, reverse, step, limit, drag, prune=PRUNE) -> Loading:
    """Check a packing and the options of a path, and derive missing options from the packing."""
    bare = with_values(law, damping_n=0.0, damping_t=0.0) if damping_model(law) else law
    if until == "first-break" and not (state.bonds and state.bonds.intact.any()):
        raise ValueError("first-break requires intact bonds: create them with packings.bonded")
    check_packing(state, bare)
    if len(touching(state)) and not len(backbone(state, law)):
        raise ValueError("all grains of the packing are rattlers, so that it carries no load: compress it first")
    if not len(touching(state)):
        raise ValueError("the packing has no contacts and carries no load: compress it first")
    if not (rest := imbalance(state, law)) <= BALANCED_BELOW:
        raise ValueError(f"{no_equilibrium_message(rest)}; let it come to rest first (--settle)")
    if (size := len(backbone(state, law))) > AT_MOST:
        raise ValueError(
            f"the packing has {size} coordinates: each step needs several dense spectra, which are limited to "
            f"{AT_MOST} coordinates; use a smaller packing"
        )
    if not isinstance(until, str):
        if not (np.isfinite(until) and until):
            raise ValueError(f"until must be a nonzero strain, first-pair, first-event or first-break, got {until:g}")
        if limit is not None or reverse:
            raise ValueError("limit and reverse do not apply if until is a strain, whose size and sign replace them")
        limit, reverse = abs(until), until < 0
    sign = -1 if reverse else 1
    way = deformation(mode, 2 if state.cell.dim == 2 else 3, sign)
    if step is None:
        share = min(STEP * mean_overlap(state) / float(2 * state.grains.radius.mean()), _break_ahead(state, law, way))
        step = float(f"{share:.0e}") if limit is None else min(float(f"{share:.0e}"), limit)
    if step > LONGEST:
        raise ValueError(f"step must be at most {LONGEST:g}, got {step:g}; use a hundredth of that for a smooth path")
    limit = STEPS * step if limit is None else limit
    if not step <= limit <= MOST_STEPS * step:
        raise ValueError(
            f"step must be between {limit / MOST_STEPS:.3g} and {limit:g} for a strain of {limit:g}, got {step:g}"
        )
    drag = DRAG * 2 / stable_time_step(state, bare) if drag is None else drag
    return Loading(bare, way, until, limit, step, drag, prune)


def _break_ahead(state: State, law: Law, way: Deformation) -> float:
    """Longest step, a fraction of the strain at which linear response predicts a break; infinite without bonds."""
    if not state.bonds or not state.bonds.intact.any():
        return np.inf
    dim = state.cell.dim
    return first_break(state, law, strain=way.gradient[:dim, :dim]).at / TO_BREAK or np.inf


def _reached(until: str | float, steps: list[PathStep]) -> str:
    """Return the reason why a path ends here; empty if it continues."""
    now = steps[-1]
    if _fell_apart(now):
        return "the packing fell apart and no longer carries any load"
    if until == "first-pair" and now.pairs:
        return "the packing has a complex pair" + (" in its present state" if len(steps) == 1 else "")
    if until == "first-break" and (lost := [row for event in now.events for row in event.broken]):
        return "a bond broke: that of grains {} and {}, by {}".format(*lost[0][:2], FAILURES[lost[0][2]])
    if until == "first-event":
        if len(steps) == 1 and now.exponent > 0 and not now.tolerated:
            return "the packing is unstable in its present state"
        if now.events:
            return "the path jumped to another state"
    return ""


def _fell_apart(now: PathStep) -> bool:
    return bool(np.isneginf(now.exponent))  # there are no eigenvalues


def _describe(now: PathStep) -> str:
    growth = f"growth rate {now.growth:.2e}" if now.pairs else f"softest eigenvalue {now.softest:.2e}"
    return f"strain {now.strain:.4g}, stress {now.stress:.4g}, {pluralize(now.pairs, 'pair')}, {growth}"


def _begin(how: Loading, state: State) -> PathStep:
    point = first_point(state, how.law, how.drag, how.prune, how.way)
    return _measure(how, point, None)


def _advance(how: Loading, before: PathStep, goal: float) -> PathStep:
    """Strain step from an equilibrium to the next one; it depends on that equilibrium only."""
    judge = Judge(before.state, how.law, how.drag, how.prune, way=how.way)
    start = Point(abs(before.strain), before.state, judge, tolerated=before.tolerated)
    search = Search(start, how.step, how.resolution, SMALLEST)
    if not search.advance(goal):
        stuck = Outcome(Status.STEPS_SPENT, np.inf, 0)
        raise NotInEquilibriumError(f"no equilibrium at strain {how.way.sign * goal:g}", stuck)
    return _measure(how, search.point, start, tuple(search.events))


def _measure(how: Loading, point: Point, before: Point | None, events: tuple[Event, ...] = ()) -> PathStep:
    """Quantities of the point at the end of a step."""
    state, response = point.state, point.response
    modes = spectrum(state, how.law)
    real = modes.eigenvalues.real[modes.eigenvalues.imag == 0]
    stress, pressure = point.stress
    slides = response.support.contacts & (state.contacts.mode[: len(response.branch)] == SLIDE)
    friction = np.isfinite(response.mobilisation) & (response.line.limit > 0)
    return PathStep(
        how.way.sign * point.strain + 0.0, how.way.sign * stress + 0.0, pressure, len(modes.pairs),
        float(modes.growth_rate[modes.pair_indices].max(initial=0.0)), softest(point.eigenvalues),
        float(point.exponents.max(initial=-np.inf)),
        int((real < -REAL_BELOW * np.abs(modes.eigenvalues).max(initial=0.0)).sum()), len(touching(state)),
        int((slides & friction).sum()), loss_ahead(point, how.step), _couples(modes),
        _changes(before, point) if before else np.zeros((0, 3), int), events, bool(point.tolerated), state,
        int(state.bonds.intact.sum()) if state.bonds else 0, float(bond_shares(state).max(initial=0.0)),
    )  # fmt: skip


def _couples(modes: Spectrum) -> np.ndarray:
    """(K, 3) pairs of real modes that are far from orthogonal: mean eigenvalue, squared gap, overlap.

    When two real eigenvalues meet and become complex, their modes coincide; when they only cross, they do not.
    """
    real = np.flatnonzero((modes.eigenvalues.imag == 0) & (modes.eigenvalues.real > 0))
    values, shapes = modes.eigenvalues.real[real], modes.modes[:, real].real * np.sqrt(modes.free.mass)[:, None]
    overlap = np.abs(
        np.triu((shapes / np.linalg.norm(shapes, axis=0)).T @ (shapes / np.linalg.norm(shapes, axis=0)), 1)
    )
    first, second = np.nonzero(overlap > COUPLED)
    most = np.argsort(-overlap[first, second], kind="stable")[:COUPLES]
    first, second = first[most], second[most]
    mean, gap = 0.5 * (values[first] + values[second]), values[first] - values[second]
    return np.stack([mean, gap**2, overlap[first, second]], axis=1)


def _changes(a: Point, b: Point) -> np.ndarray:
    """(C, 3) contacts that opened, closed, started to slide or stuck again, except those that carry no force."""
    (old, holds), (new, bears) = (
        ({key: row for row, key in _touching_pairs(p.state)}, p.response.support.contacts) for p in (a, b)
    )
    out = [(0, *key[:2]) for key, row in old.items() if holds[row] and key not in new]
    out += [(1, *key[:2]) for key, row in new.items() if bears[row] and key not in old]
    for key in old.keys() & new.keys():
        if holds[old[key]] and bears[new[key]]:
            slid, slides = (bool(p.state.contacts.mode[rows[key]] == SLIDE) for p, rows in ((a, old), (b, new)))
            out += [(2 if slides else 3, *key[:2])] * (slid != slides)
    return np.array(sorted(out), int).reshape(-1, 3)


def _touching_pairs(state: State) -> Iterator[tuple[int, tuple[int, int, int]]]:
    """Yield rows of touching contacts with their grains and their number among the contacts of the same grains.

    Images are not suitable keys: they change with the choice of a less skewed cell.
    """
    contacts, seen = state.contacts, {}
    for row in touching(state).tolist():
        pair = int(contacts.i[row]), int(contacts.j[row])
        seen[pair] = seen.get(pair, -1) + 1
        yield row, (*pair, seen[pair])


def signs_of(steps) -> Signs:
    """Series for forecasts, since the last event."""
    last = max((k for k, step in enumerate(steps) if step.events), default=0)
    after, events = steps[last:], [event.strain for step in steps for event in step.events]
    return Signs(
        np.abs([step.strain for step in after]), np.array([step.softest for step in after]),
        np.array([step.loss_ahead for step in after]), [step.couples for step in after],
        np.array([step.pairs for step in after]), np.array(events),
    )  # fmt: skip


def _conclude(how: Loading, law: Law, steps: list[PathStep], reason: str, report: Report) -> Failure:
    """Result of a path: births and deaths of pairs, decisive contacts, and the verdict with the dashpots of the law."""
    born = next((k for k, step in enumerate(steps) if step.pairs), 0)
    onset = None
    if born and not steps[born].events:
        before = steps[born - 1]
        protocol = aqs(how.law, mode=how.way.mode, sign=how.way.sign)._replace(check=None)
        modes = spectrum(before.state, how.law, modes=False)
        clean = Equilibrium(abs(before.strain), before.state, modes, Outcome(Status.CONVERGED, 0.0, 0))
        found = bisect_change(clean, abs(steps[born].strain), protocol, lambda s: bool(len(s.pairs)))
        onset = Change(how.way.sign * found.below, how.way.sign * found.above)
    last, decisive = steps[-1].state, ()
    verdict = "only rattlers remain" if _fell_apart(steps[-1]) else stability(last, law, report=report).verdict
    if steps[-1].pairs:
        found = contact_sensitivity(last, how.law, most=TRIED, report=report)
        decisive = tuple(
            DecisiveContact(
                int(found.i[k]), int(found.j[k]), str(found.what[k]), float(found.mobilised[k]), float(found.after[k]),
                str(found.verdict_after[k]),
            )
            for k in np.flatnonzero(found.verified)[:DECISIVE]
        )  # fmt: skip
    return Failure(
        law, how.way.mode, how.way.sign, how.step, how.drag, how.resolution, tuple(steps),
        tuple(_lives(how.law, steps)), onset, decisive, verdict, reason,
    )  # fmt: skip


def _lives(law: Law, steps: list[PathStep]) -> Iterator[PairLife]:
    """Complex pairs, matched from step to step by the overlap of their modes; an event ends all of them."""
    cuts = [0, *(k for k, step in enumerate(steps) if step.events), len(steps)]
    for first, beyond in pairwise(cuts):
        inside = steps[first:beyond]
        spectra = [_pairs_alone(law, step) for step in inside]
        for life in match_pairs(spectra, at_least=SAME_PAIR):
            rates = {k: float(spectra[k].growth_rate[row]) for k, row in life.items()}
            most, (born, *_, last) = max(rates, key=rates.get), (min(life), max(life))
            before, after = first + born - 1, first + last + 1
            yield PairLife(
                steps[before].strain if before >= 0 else np.nan, inside[born].strain if before >= 0 else np.nan,
                inside[last].strain if after < len(steps) else np.nan,
                steps[after].strain if after < len(steps) else np.nan,
                rates[most], inside[most].strain, bool(before >= 0 and born == 0) or after == beyond < len(steps),
            )  # fmt: skip


def _pairs_alone(law: Law, step: PathStep) -> Spectrum:
    """Spectrum of the complex pairs of a step."""
    if not step.pairs:
        return Spectrum(np.zeros(0, complex), np.zeros((0, 0)), backbone(step.state, law), 0.0)
    modes = spectrum(step.state, law)
    keep = modes.pair_indices
    return modes._replace(eigenvalues=modes.eigenvalues[keep], modes=modes.modes[:, keep])
