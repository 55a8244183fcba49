"""Quasi-static inflation of grains in a packing, with committed contact memory."""

import numpy as np

from ..core.arguments import Bodies, checked, require_positive
from ..core.laws.builtin import Law
from ..core.measure import touching
from ..core.outcome import NotInEquilibriumError
from ..core.progress import Report, silent
from ..core.sizes import Size, require_sizes
from ..core.state import SLIDE, State
from ..solve.balance import balanced
from ..solve.equilibrate import equilibrate
from ..solve.freedom import resized
from ..solve.inclusion import Inflation, as_inflation, inflated_grains
from ..solve.linearised import LinearisedState
from ..solve.newton import Factorisation


@checked
def inflate(
    state: State, law: Law, grain: Bodies | None = None, *, growth: float = 1e-3, within: float = 0.0, steps: int = 10,
    tolerance: float | None = None, report: Report = silent,
) -> Inflation:  # fmt: skip
    """Inflate a grain in quasi-static steps, each of which ends with `equilibrate`, which commits the contact memory.

    Growth is measured from the radii of the state. Contacts may open, close and slide; `changes` of the result counts
    them, without those of grains that were rattlers. At small growth the displacements are those of `modes.inflate`.
    Masses do not change.

    Parameters
    ----------
    grain, growth, within : as in `modes.inflate`
    steps : number of steps of equal size
    tolerance : largest unbalanced force or torque/R [force]; default: as in `equilibrate`
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        where `modes.inflate` raises it, but for contacts that change.
    NotInEquilibriumError
        if a step has no equilibrium.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(300, packing_fraction=0.95, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.0)
    >>> field = inflate(state, law, growth=0.02, steps=4)
    >>> field.changes.shape, field.states[0].n_bodies
    ((1, 4, 4), 300)
    """
    require_positive(steps=steps)
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
    """State at the end of steps, and how many contacts opened, closed, began and stopped sliding in each."""
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
