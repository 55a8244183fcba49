"""Energy ledger, updated after every step. It does not affect the trajectory.

Over a step from 0 to 1, velocity Verlet changes the kinetic energy by ½(F₀ + F₁)·Δx up to the change of a function of
state, so trapezoidal sums balance to second order in the time step. With the energy U(|s|, k_t, L) of a tangential
spring and the Coulomb limit L,

    −F_t·v_t dt = dU − ∂U/∂k_t dk_t − ∂U/∂L dL + |F_t| d(slid distance):

F_t has no potential, and the terms in ∂U are the energy that a contact creates or destroys when it is sheared at one
overlap and released at another. These terms have a separate column. That column also contains the energy destroyed by
laws that shorten the slip as the overlap decreases, −|F_t| |s| d ln f with f the factor applied to the slip.
"""

from typing import NamedTuple

import numpy as np

from ..arguments import NotNegative, checked
from ..contacts.bonds import follow_rotations
from ..contacts.forces import Bodies, check_materials
from ..contacts.forces import bodies as bodies_of
from ..contacts.neighbors import shifts
from ..control import spring_forces
from ..fields import Field, check_entry
from ..laws.builtin import Law
from ..laws.compiled import FORCES, law_struct
from ..library import core
from ..readable import readable
from ..state import Bonds, State
from .coefficients import Plan

COLUMNS = ("kinetic", "normal", "tangential", "external", "coulomb", "rolling", "viscous", "drag", "nonpotential",
           "bonded", "broken")  # fmt: skip
UNBALANCED = 1e-2  # largest defect of a small step, in units of its energy changes
_STORED = [COLUMNS.index(name) for name in ("kinetic", "normal", "tangential", "bonded")]  # not sums over steps


@readable
class Ledger(NamedTuple):
    """Energies at T samples, and work and dissipation since the start of the run [energy]."""

    kinetic: np.ndarray  # (T,) kinetic energy of grains and walls, translations and rotations
    normal: np.ndarray  # (T,) stored in normal springs
    tangential: np.ndarray  # (T,) stored in tangential springs
    external: np.ndarray  # (T,) work of forces, springs, torques, gravity, driven bodies, and the cell
    coulomb: np.ndarray  # (T,) dissipated by sliding
    rolling: np.ndarray  # (T,) dissipated by rolling and twisting beyond their limits
    viscous: np.ndarray  # (T,) dissipated by dashpots
    drag: np.ndarray  # (T,) dissipated by drag
    # (T,) created (negative: destroyed) by tangential springs whose stiffness changed or whose slip was rescaled, and
    # by bonds, whose loads derive from an energy only to first order in the rotations
    nonpotential: np.ndarray
    bonded: np.ndarray | float = 0.0  # (T,) stored in bonds
    broken: np.ndarray | float = 0.0  # (T,) lost when bonds broke: stored energy minus their work in half of that step

    @property
    def defect(self) -> np.ndarray:
        """Energy stored + dissipated − supplied, less its initial value, (T,): zero up to the integration error."""
        stored = self.kinetic + self.normal + self.tangential + self.bonded
        lost = self.coulomb + self.rolling + self.viscous + self.drag + self.broken
        total = stored + lost - self.external - self.nonpotential
        return total - total[0]


class Books(NamedTuple):
    """Data for adding one step to the ledger: the state before it, and the running sums."""

    bodies: Bodies
    contacts: tuple
    vectors: np.ndarray  # (3, 3) vectors of the cell
    pull: np.ndarray  # (B, 3) forces of springs
    stride: int  # steps between two entries
    step: int  # step of the last entry
    row: np.ndarray  # (len(COLUMNS),)
    rows: np.ndarray  # (T, len(COLUMNS))
    law: object  # struct `Law` of the compiled core
    mass: np.ndarray  # (B,)
    inertia: np.ndarray  # (B,)
    bonds: Bonds | None


def open_books(samples: int, stride: int, bodies: Bodies, state: State, law: Law, rate: bool) -> Books:
    """Open the books before the first entry; `rate` is true with `slip_update="rate"`."""
    row, rows = np.zeros(len(COLUMNS)), np.zeros((samples, len(COLUMNS)))
    pull, walls = spring_forces(state.control, bodies.position, state.time), state.walls.mass
    mass, inertia = np.append(state.grains.mass, walls), np.append(state.grains.inertia, np.zeros(len(walls)))
    struct = core.fill("Law", law_struct(law, rate=rate, members=(*FORCES, "energy")))
    return Books(
        _copy(bodies), _copy(state.contacts), state.cell.vectors, pull, stride, 0, row, rows, struct, mass, inertia,
        state.bonds and follow_rotations(state.bonds, state.cell.dim, bodies, state.cell.vectors),
    )  # fmt: skip


def post_step(
    books: Books, state: State, plan: Plan, here: Bodies, contacts, bonds: Bonds | None, step: int, every: int
) -> Books:
    """Add one step, from the state in the books to `here`, `contacts` and `bonds`, which are not modified."""
    vectors, row = state.cell.vectors, books.row
    pull = spring_forces(state.control, here.position, state.time + step * plan.dt)
    row[_STORED] = 0.0
    core.add_ledger_step(_ends_of_step(books.bodies, here, books.contacts, contacts, books.vectors, vectors) | {
        "bonds_old": books.bonds, "bonds_now": bonds,
        "law": books.law, "dim": state.cell.dim, "free": np.ascontiguousarray(state.control.free),
        "mass": books.mass, "inertia": books.inertia, "force": plan.external[0] + 0.5 * (pull + books.pull),
        "torque": plan.external[1], "drag": plan.drags[0], "spin_drag": plan.drags[1],
        "dt": (step - books.step) * plan.dt, "first": step == 0, "row": row, "shares": None,
    })  # fmt: skip
    if step % every == 0:
        books.rows[step // every] = books.row
    return books._replace(
        bodies=_copy(here),
        contacts=_copy(contacts),
        vectors=vectors,
        pull=pull,
        step=step,
        bonds=bonds and _copy(bonds),
    )


def _ends_of_step(old: Bodies, now: Bodies, before, after, old_vectors, vectors) -> dict:
    """Struct members that describe the beginning and the end of a step."""
    strain = np.zeros((3, 3))
    if (vectors != old_vectors).any():  # dt L of the step that moved the cell
        strain = 2 * np.linalg.solve(vectors + old_vectors, vectors - old_vectors).T
    return {
        "old": old, "now": now, "before": before, "after": after, "shift_old": shifts(after, old_vectors),
        "shift_now": shifts(after, vectors), "strain": np.ascontiguousarray(strain),
        "way": now.position - old.position - 0.5 * (now.position + old.position) @ strain.T,
        "vectors_old": old_vectors, "vectors_now": vectors,
    }  # fmt: skip


@readable
class Dissipation(NamedTuple):
    """Energy that each pair in the list has dissipated [energy]."""

    sliding: np.ndarray  # (C,) dissipated by sliding friction
    dashpots: np.ndarray  # (C,) dissipated by dashpots

    def check_entries(self) -> None:
        """Raise ValueError if an entry is not a finite number."""
        for name, values in self._asdict().items():
            check_entry(f"dissipation.{name}", values, Field(np.float64, ("contacts",)), {"contacts": len(values)})


@checked
def dissipation(before: State, after: State, law: Law, *, dt: NotNegative = 0.0) -> Dissipation:
    """Energy dissipated by each pair in the list of `after` between two accepted states that are one small step apart.

    Sliding dissipates the spring's |F_t|, averaged over both ends of the step, times the distance slid, which is the
    slip implied by the motion less the remaining slip. Dashpots dissipate (F_n − F_n,spring) and (F_t − F_t,spring)
    times the relative velocities, averaged over both ends, times dt.

    The energy ledger of a run, `run(…, ledger=True)`, adds up the same numbers for all contacts.

    Parameters
    ----------
    before, after : states of the same grains
    law : Law
    dt : duration of the step, for dashpots; 0 for quasi-static steps [time]

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.3)
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.9, 0, 0]], [0.5, 0.5], law, dim=2)
    >>> place = pair.grains.position + [[0, 1e-3, 0], [0, 0, 0]]
    >>> moved = pair._replace(grains=pair.grains._replace(position=place))
    >>> moved = ss.accept(moved, ss.forces(moved, law)[1])
    >>> dissipation(pair, moved, law).sliding  # the contact sticks
    array([0.])
    """
    if before.n_bodies != after.n_bodies:
        raise ValueError(
            f"the states have {before.n_bodies} and {after.n_bodies} bodies: give two states of the same sample"
        )
    check_materials(after, law)
    return _post(np.zeros(len(COLUMNS)), before, after, law, dt=dt)


def _post(row: np.ndarray, before: State, after: State, law: Law, *, dt: float = 0.0, first: bool = False):
    """Add a step between accepted states to a row, without kinetic energy; return the dissipation at each contact."""
    ends, still = [bodies_of(before), bodies_of(after)], np.zeros((after.n_bodies, 3))
    shares, none = np.zeros((len(after.contacts.i), 2)), np.zeros(after.n_bodies)
    row[_STORED] = 0.0
    core.add_ledger_step(
        _ends_of_step(*ends, before.contacts, after.contacts, before.cell.vectors, after.cell.vectors) | {
        "bonds_old": before.bonds, "bonds_now": after.bonds,
        "law": law_struct(law, members=(*FORCES, "energy")), "dim": after.cell.dim,
        "free": np.ones((after.n_bodies, 6), bool), "mass": none, "inertia": none, "force": still, "torque": still,
        "drag": 0.0, "spin_drag": 0.0, "dt": dt, "first": first, "row": row, "shares": shares,
    })  # fmt: skip
    return Dissipation(*shares[: int(after.contacts.count[0])].T.copy())


class PathLedger:
    """Running ledger along a path of equilibria, in which small steps and runs may alternate."""

    def __init__(self, state: State, law: Law):
        self.law, self.here, self.row = law, state, np.zeros(len(COLUMNS))
        _post(self.row, state, state, law, first=True)

    def post(self, end: State) -> None:
        """Add a small step to another accepted state."""
        _post(self.row, self.here, end, self.law)
        self.here = end

    def balances(self, end: State) -> bool:
        """Return True if the energies of a step balance, as in small steps that do not cross an instability."""
        row = self.row.copy()
        _post(row, self.here, end, self.law)
        defect = Ledger(*np.array([self.row, row]).T).defect[1]
        return bool(abs(defect) <= UNBALANCED * np.abs(row - self.row).sum())

    def post_run(self, end: State, ledger: Ledger) -> None:
        """Add a run from the present state, given its ledger, which has a sample at its end; `stop` may follow."""
        self.row[_STORED], self.here = 0.0, end
        self.row += [column[-1] for column in ledger]

    def stop(self, end: State) -> None:
        """Add the removal of the kinetic energy of the present state."""
        self.row[COLUMNS.index("drag")] += self.row[0]
        self.row[0], self.here = 0.0, end


def _copy(record):
    return type(record)(*(value.copy() if isinstance(value, np.ndarray) else value for value in record))


def make_ledger(books: Books, kept: int) -> Ledger:
    """Make the ledger from the first `kept` samples."""
    return Ledger(*books.rows[:kept].T)
