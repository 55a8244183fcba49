"""Quasi-static steps: athermal shear with a check of the path, shear under a stress or by a plate, and inflation."""

import warnings
from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np

from ..core.arguments import POSITIVE, Bodies, NotNegative, Positive, checked, require_positive
from ..core.contacts.neighbors import TooFarApartError
from ..core.control import body_numbers, stress_controlled
from ..core.laws.builtin import Law, damping_model
from ..core.measure import touching
from ..core.progress import NotInEquilibriumError, Outcome, Report, Size, Status, require_sizes, silent
from ..core.readable import pluralize
from ..core.state import SLIDE, State
from ..solve.balance import LinearisedState, balanced, linearised
from ..solve.equilibrate import LeftPathError, UnstableEquilibriumWarning, equilibrate
from ..solve.freedom import resized
from ..solve.inclusion import Inflation, as_inflation, inflated_grains
from ..solve.newton import Factorisation
from ..solve.shear_response import damped_exponents, root_mean_square
from ..solve.spectrum import REAL_BELOW, Spectrum, spectrum
from .event_path import Judge, Point, commit, continuous, displacement, distance, fall
from .protocols import Equilibrium, Protocol
from .settling import Deformation, Mode, deformation

STEADY = 0.2  # relative change of the motion per strain between steps below which no other check is needed
LOOSE = 0.2  # relative deviation of a step's motion from the linear prediction below which no other check is needed
HALVINGS = 4  # largest number of halvings of a step in which grains do not move as linear responses predict
BALANCED = 1e-9  # under a stress: default tolerance, in units of the normal force on a grain


@checked
def aqs(
    law: Law, *, slip: bool = True, tolerance: float | None = None, modes: bool = False,
    on_instability: Literal["tell", "follow-dynamics", "stop"] = "tell", drag: Positive | None = None,
    mode: Mode = "simple", sign: Literal[1, -1] = 1,
) -> Protocol:  # fmt: skip
    """Protocol of athermal quasi-static shear: the load is the strain γ, and each step ends with `equilibrate`.

    `ramp` measures γ from the first state, whose cell may be tilted.

    Newton's method finds stable and unstable equilibria, and may end on a branch other than the one on which the step
    began. Stability is checked by the spectrum of the step. The branch is checked by the motion of the grains, which
    must continue that of the previous step or follow from the Jacobians at both ends. Otherwise, the step is repeated
    in up to 16 smaller ones, which must lead to the same state.

    Parameters
    ----------
    slip : whether the affine displacement contributes to the slip; see `strained`
    tolerance : float, largest unbalanced force or torque/R [force]; default: as in `equilibrate`
    modes : whether spectra along the path contain modes
    on_instability : action after a step to an unstable equilibrium or another branch. "tell": the outcome of the step
        has `unstable` or `left` set and contains a warning; the first warning on a path that concerns more than complex
        pairs (which are in the spectra of the path) is also issued as an UnstableEquilibriumWarning. "follow-dynamics":
        if this equilibrium is unstable under the drag or on another branch, the step ends where damped dynamics from
        the previous state leads, also with a warning. "stop": a LeftPathError is raised
    drag : drag of the dynamics, on translations and rotations; required for "follow-dynamics", because it determines
        the oscillations that grow. If given, only pairs that grow despite the drag count as unstable [1/time]
    mode : "simple" shear along x with the gradient along y; "pure" shear, γ = ln(Lx/Ly); "isotropic" compression,
        ε = −ln V; "uniaxial" compression along y, ε = −ln Ly
    sign : −1 reverses the strain: a growing load shears in the opposite direction, or unloads

    Raises
    ------
    ValueError
        If the drag is missing.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, packing_fraction=0.7)
    >>> protocol = ss.protocols.aqs(ss.laws.hertz_mindlin(mu=10, coulomb="smooth"))
    >>> path = ss.protocols.ramp(state, [0.0, 1e-5], protocol)
    >>> [len(point.spectrum.pairs) for point in path]
    [0, 0]
    """
    if on_instability == "follow-dynamics" and drag is None:
        raise ValueError("on_instability='follow-dynamics' requires drag, which determines the oscillations that grow")
    keep, watch = Factorisation(), Watch(law, slip, modes, on_instability, drag, partial(_way, mode, sign))

    def apply(state, strain):
        way = watch.way(state)
        return way.apply(state, strain - way.place(state), slip=slip)

    def settle(state, strain):
        end, outcome = equilibrate(state, law, tolerance=tolerance, keep=keep, check="nothing")
        if not outcome.ok:
            raise NotInEquilibriumError(f"no equilibrium at strain {strain:g}", outcome)
        return end, outcome

    return Protocol(law, apply, settle, modes, watch.check, lambda state: watch.way(state).place(state))


def _way(mode: Mode, sign: Literal[1, -1], state: State) -> Deformation:
    return deformation(mode, 2 if state.cell.dim == 2 else 3, sign)


class Watch:
    """Check of the steps of quasi-static shear."""

    def __init__(self, law: Law, slip: bool, modes: bool, choice: str, drag: float | None, way):
        self.way: Callable[[State], Deformation] = way
        self.law, self.slip, self.modes, self.choice, self.drag = law, slip, modes, choice, drag
        self.rate: np.ndarray | None = None  # (N, 6) motion per strain in the last step
        self.warned = False

    def check(self, start: State, point: Equilibrium) -> Equilibrium:
        """Equilibrium at the end of a step, with a warning if it is unstable or on another branch."""
        off = self._distance(start, point)
        unstable, left = instability(point.spectrum, point.state, self.law, self.drag), off != 0
        away = f", {off:.2g} mean diameters away" if np.isfinite(off) else ""
        notes = [str(unstable)] if unstable else []
        notes += [f"the step left its branch: smaller steps do not lead to this state{away}"] if left else []
        if not notes:
            return point
        if self.choice == "stop":
            raise LeftPathError(f"at strain {point.load:g} {' and '.join(notes)}: use smaller steps, or dynamics")
        if self.choice == "follow-dynamics":
            point, followed = self._follow(start, point, left)
            notes += ["damped dynamics led to another state"] if followed else []
        if not self.warned and (left or unstable.negative):  # complex pairs are already in the spectrum
            self.warned = True
            more = "further warnings are in the outcomes of the path"
            said = f"at strain {point.load:g} {'; '.join(notes)}; {more}"
            warnings.warn(said, UnstableEquilibriumWarning, stacklevel=3)
        warning = "; ".join(filter(None, [point.outcome.warning, *notes]))
        return point._replace(outcome=point.outcome._replace(warning=warning, unstable=unstable is not None, left=left))

    def _distance(self, start: State, point: Equilibrium) -> float:
        """Distance of the end of a step from its branch, in mean diameters; see `branch_distance`."""
        way = self.way(start)
        strain, before = way.place(point.state) - way.place(start), self.rate
        if not strain:
            return 0.0
        moved = displacement(start, point.state, strain, way) / strain
        everything = np.ones(len(start.grains.radius), bool)
        self.rate = moved
        if before is not None and before.shape == moved.shape:
            change = root_mean_square(moved - before, everything)
            if change <= STEADY * root_mean_square(before, everything):
                return 0.0
        start = commit(start, self.law)
        judge = self._judge(start)
        begin, end = (Point(way.place(s), s, judge) for s in (start, point.state))
        off = branch_distance(begin, end)
        self.rate = self.rate if off == 0 else None
        return off / judge.diameter

    def _judge(self, state: State) -> Judge:
        return Judge(state, self.law, self.drag or 0.0, slip=self.slip, way=self.way(state))

    def _follow(self, start: State, point: Equilibrium, left: bool) -> tuple[Equilibrium, bool]:
        """Equilibrium reached by damped dynamics, and whether it differs from the given one."""
        way = self.way(start)
        start, begin, goal = commit(start, self.law), way.place(start), way.place(point.state)
        judge = self._judge(start)
        if not left and Point(goal, point.state, judge).stable:
            return point, False  # stable under the drag
        end = fall(Point(begin, start, judge), goal)
        if end is None:
            problem = "damped dynamics did not come to rest"
            raise NotInEquilibriumError(f"{problem} at strain {point.load:g}", point.outcome)
        self.rate = None
        modes = spectrum(end.state, self.law, modes=self.modes)
        return point._replace(state=end.state, spectrum=modes), True


class Instability(NamedTuple):
    """Growing modes of an equilibrium, and the assumptions made."""

    negative: int  # directions of negative stiffness
    pairs: int  # complex pairs
    at_limit: bool  # whether contacts at the Coulomb limit are assumed to keep sliding
    undamped: bool  # whether the dashpots of the law are ignored

    def __str__(self) -> str:
        parts = [f"{pluralize(self.negative, 'direction')} of negative stiffness"] if self.negative else []
        parts += [pluralize(self.pairs, "complex pair")] if self.pairs else []
        limit = ", if contacts at the Coulomb limit keep sliding" if self.at_limit else ""
        limit += ", without the dashpots of the law" if self.undamped else ""
        return f"the equilibrium is unstable ({' and '.join(parts)}{limit})"


def instability(modes: Spectrum, state: State, law: Law, drag: float | None = None) -> Instability | None:
    """Growing modes of an equilibrium, under a drag if given [1/time]; None if it is stable."""
    real = modes.eigenvalues.real[modes.eigenvalues.imag == 0]
    negative = int((real < -REAL_BELOW * np.abs(modes.eigenvalues).max(initial=0.0)).sum())
    pairs = modes.pairs if drag is None else modes.pairs[damped_exponents(modes.pairs, drag) > 0]
    if not (negative or len(pairs)):
        return None
    return Instability(negative, len(pairs), len(linearised(state, law).at_limit) > 0, bool(damping_model(law)))


def branch_distance(start: Point, end: Point) -> float:
    """Distance of the point `end` from the state that smaller steps from `start` reach [length].

    Returns
    -------
    float
        zero if grains moved as the linear responses predict, or if smaller steps lead to the same state; infinite if
        smaller steps fail
    """
    if continuous(start, end, LOOSE):
        return 0.0
    there = _trace(start, end.strain, HALVINGS)
    if there is None:
        return np.inf
    off = distance(there.state, end.state, start.response.support.grains & end.response.support.grains)
    largest = abs(end.strain - start.strain) * max(start.response.speed, end.response.speed)
    return off if off > LOOSE * largest else 0.0


def _trace(start: Point, strain: float, halvings: int) -> Point | None:
    """Point of a path at a strain if all steps, halved if necessary, are continuous."""
    end = start.newton(strain) if halvings else start.equilibrium(strain)
    if end is not None and continuous(start, end, LOOSE):
        return end
    if not halvings:
        return None
    middle = _trace(start, 0.5 * (start.strain + strain), halvings - 1)
    return None if middle is None else _trace(middle, strain, halvings - 1)


@checked
def cell_shear(law: Law, normal_stress: Positive, *, tolerance: Positive = BALANCED) -> Protocol:
    """Protocol of simple shear of a periodic cell under stress: the load is −σ_xy/σ_yy, absolute, not an increment.

    The cell's height follows the normal stress, and its shear along x follows the shear stress. Its other dimensions
    are fixed. Each step ends with `equilibrate`.

    Parameters
    ----------
    normal_stress : σ_yy, compression positive [force/length^(dim−1)]
    tolerance : largest unbalanced force or torque/R, in units of σ_yy D^(dim−1) with the mean diameter D

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> path = ss.protocols.ramp(state, [0.0, 0.05], ss.protocols.cell_shear(law, 1e-3))
    >>> ss.measure.stress(path[-1].state, law)[[0, 1], 1].round(9).tolist()
    [-5e-05, 0.001]
    """
    require_positive(normal_stress=normal_stress)

    def apply(state, load):
        control = stress_controlled(state.control, {"yy": normal_stress, "xy": -load * normal_stress})
        return state._replace(control=control)

    def settle(state, load):
        area = (2 * state.grains.radius.mean()) ** (state.cell.dim - 1)
        return _settle(state, load, law, tolerance * normal_stress * area)

    return Protocol(law, apply, settle, modes=False)


@checked
def plate_shear(law: Law, plate: Bodies, *, tolerance: Positive = BALANCED) -> Protocol:
    """Protocol of shear by a plate: the load is its force along x divided by the force that presses it along −y.

    The load is absolute: the force replaces any previous one along x.

    Parameters
    ----------
    plate : numbers of the bodies of the plate: a rigid group that is pressed along −y
    tolerance : largest unbalanced force or torque/R, in units of the normal force on a body of the plate

    Raises
    ------
    ValueError
        On the first step, if the given bodies are not pressed along −y.

    Examples
    --------
    A single grain on a fixed one, as a plate:

    >>> import numpy as np
    >>> import stickslip as ss
    >>> law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.5)
    >>> control = ss.control.rigid(ss.control.fixed(ss.control.loads(2), [0]), [1])
    >>> control = ss.control.force_controlled(control, [1], [0, -0.01])
    >>> state = ss.assembly(ss.spheres([[0, 0, 0], [0, 0.99, 0]], 0.5), control=control)
    >>> path = ss.protocols.ramp(state, [0.0, 0.2], plate_shear(law, [1]))
    >>> start, end = (point.state.grains.position for point in path[:2])
    >>> float((end - start)[1, 0].round(4))
    0.0041
    """

    def apply(state, load):
        control, bodies = state.control, body_numbers(state.control, plate)
        force, free, rate = control.force.copy(), control.free.copy(), control.rate.copy()
        if not (force[bodies, 1] < 0).all():
            raise ValueError(f"the plate must be pressed along −y, but bodies {np.asarray(plate).tolist()} are not")
        free[bodies, 0], rate[bodies, 0] = True, 0.0
        force[bodies, 0] = -load * force[bodies, 1]
        return state._replace(control=control._replace(force=force, free=free, rate=rate))

    def settle(state, load):
        return _settle(state, load, law, tolerance * float(np.abs(state.control.force[plate, 1]).mean()))

    return Protocol(law, apply, settle, modes=False)


def _settle(state: State, load: float, law: Law, tolerance: float) -> tuple[State, Outcome]:
    """Equilibrium at a load, by `equilibrate`."""
    try:
        end, outcome = equilibrate(state, law, tolerance=tolerance, check="nothing")
    except TooFarApartError:
        end, outcome = state, Outcome(Status.STEPS_SPENT, np.inf, 0)  # the sample flowed without coming to rest
    if not outcome.ok:
        raise NotInEquilibriumError(f"no equilibrium at a load of {load:.4g}", outcome)
    return end, outcome


@checked
def inflate(
    state: State, law: Law, grain: Bodies | None = None, *, growth: float = 1e-3, within: NotNegative = 0.0,
    steps: Annotated[int, POSITIVE] = 10, tolerance: float | None = None, report: Report = silent,
) -> Inflation:  # fmt: skip
    """Inflate a grain in quasi-static steps, each of which ends with `equilibrate` and commits the contact memory.

    Growth is measured from the radii of the state. Contacts may open, close and slide; the field `changes` of the
    result counts these changes, except at initial rattlers. At small growth, the displacements are those of
    `modes.inflate`. Masses do not change.

    Parameters
    ----------
    grain, growth, within : as in `modes.inflate`
    steps : number of steps of equal size
    tolerance : largest unbalanced force or torque/R [force]; default: as in `equilibrate`
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        As in `modes.inflate`, except that contacts may change.
    NotInEquilibriumError
        If a step has no equilibrium.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(300, packing_fraction=0.95, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.0)
    >>> field = inflate(state, law, growth=0.02, steps=4)
    >>> field.changes.shape, field.states[0].n_bodies
    ((1, 4, 4), 300)
    """
    require_sizes([Size(f"steps = {steps} makes", steps, "load steps", "use fewer")])
    here = balanced(state, law)
    centers, grown = inflated_grains(here, grain, growth, within)
    ends, changes = [], []
    for k, rows in enumerate(grown):
        end, changed = _steps(here, rows, growth * np.arange(1, steps + 1) / steps, tolerance)
        report("inflation", (k + 1) / len(centers), f"grain {centers[k]}")
        ends.append(end)
        changes.append(changed)
    displacement = np.array([end.grains.position for end in ends]) - state.grains.position
    return as_inflation(here, centers, grown, growth, displacement, ends, changes)


def _steps(here: LinearisedState, grown: np.ndarray, growths: np.ndarray, tolerance) -> tuple[State, list]:
    """State after all steps; for each step, numbers of contacts that opened, closed, started and stopped sliding."""
    state, radius, keep, changes = here.state, here.state.grains.radius, Factorisation(), []
    before = _modes(here, state)
    for growth in growths:
        larger = resized(state, radius * (1 + growth * grown))
        larger = larger._replace(contacts=larger.contacts._replace(stale=True))
        state, outcome = equilibrate(larger, here.law, tolerance=tolerance, keep=keep, check="nothing")
        if not outcome.ok:
            raise NotInEquilibriumError(f"no equilibrium at growth {growth:g}", outcome)
        after = _modes(here, state)
        kept = before.keys() & after.keys()
        began, stopped = (sum(b[key] == SLIDE != a[key] for key in kept) for a, b in ((before, after), (after, before)))
        changes.append([len(before.keys() - kept), len(after.keys() - kept), began, stopped])
        before = after
    return state, changes


def _modes(here: LinearisedState, state: State) -> dict[int, int]:
    """Mode of each touching contact by its key, without those of rattlers."""
    contacts, loose = state.contacts, np.append(here.loose, np.zeros(len(state.walls.mass), bool))
    rows = [row for row in touching(state) if not (loose[contacts.i[row]] or loose[contacts.j[row]])]
    return dict(zip(contacts.key[rows].tolist(), contacts.mode[rows].tolist(), strict=True))
