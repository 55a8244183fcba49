"""Contact status under a load rate, including contacts without force that open or have just closed.

A disk without force at any contact is released as a body, and grains joined by beams are released together. A body
stays released if all of its contacts open in the smallest motion with which it follows its neighbours. Otherwise it
carries load again.

Source: McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. V B, which leaves the question open.
"""

import itertools
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError
from scipy.optimize import linprog

from ... import SLIDE, STICK, Law, State
from ...control import stress_controlled
from ...kit import Numbers, Selfcheck, checked, factorised, require_not_negative, with_neighbor_list
from ...laws import for_pair, linear
from ...measure import stress
from ...packings import disk_array
from .complementarity import critical_numbers
from .cone_apex import (
    ENUMERATED,
    OPENS,
    SIDE,
    SLACK,
    SLIDES,
    SLIDES_BACK,
    STICKS,
    Apex,
    StatusSolution,
    count_choices,
    enumerate_statuses,
    force_change,
    piece_matrix,
    round_cone_stretch,
    status_of_velocity,
    status_on_round_cones,
    statuses_at_apex,
    stiffness_change,
)
from .events import APEX
from .matrices import LinearSystem, linear_system
from .status import ContactStatus, Verdict, status_of_critical
from .system import (
    RESIDUAL,
    driven_motions,
    external_force,
    pinned_coordinates,
    regular_stiffness,
    roll_springs,
    rolling_motions,
)

COMBINED = 3  # largest number of bodies of which all combinations are released; each needs a factorisation of k


class ReducedMap(NamedTuple):
    """Map g of some contacts of a packing, and the resulting velocities of all coordinates."""

    apex: Apex
    free: np.ndarray  # (n,) velocities if all these contacts stick
    reach: np.ndarray  # (n, dE) velocities per unit force of each contact on its first body

    def velocities(self, solution: StatusSolution) -> np.ndarray:
        """Return the velocities (n,) of all coordinates."""
        return self.free - self.reach @ force_change(self.apex, solution).ravel()


def reduce_to_contacts(
    matrix: LinearSystem, load: np.ndarray, contacts: np.ndarray, sign: np.ndarray, *, geometric: bool = True,
    without: np.ndarray | None = None, alone: np.ndarray | None = None,
) -> ReducedMap:  # fmt: skip
    """Compute the map g of some contacts of a packing under a load rate.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    contacts : (E,) indices of the contacts that may change their status; all others stick
    sign : (E,) sgn D_t of contacts that carry a force at the Coulomb limit, 0 for contacts at the apex
    without : coordinates that are held fixed
    alone : (M,) bool, contacts of disks whose contacts are all at the apex

    LinAlgError is raised if k is singular while all contacts stick.
    """
    size, held = len(matrix.free), pinned_coordinates(matrix)
    kept = np.setdiff1d(np.arange(size), held if without is None else np.union1d(held, without))
    stuck = regular_stiffness(matrix, np.zeros(matrix.count, bool), geometric)[kept][:, kept]
    solve = factorised(stuck)
    chosen = (matrix.width * contacts[:, None] + np.arange(matrix.width)).ravel()
    columns = matrix.c.tocsc()[kept][:, chosen].toarray()
    reach, free = np.zeros((size, columns.shape[1])), np.zeros(size)
    free[kept] = solve(load[kept])
    for k, column in enumerate(columns.T):
        reach[kept, k] = solve(column)
    apex = Apex(
        columns.T @ reach[kept], (columns.T @ free[kept]).reshape(-1, matrix.width), matrix.springs[contacts],
        matrix.slope[contacts], np.asarray(sign, float),
        np.zeros(len(contacts), bool) if alone is None else alone[contacts],
    )  # fmt: skip
    return ReducedMap(apex, free, reach)


class ApexStatuses(NamedTuple):
    """Statuses of contacts at the apex, for all M contacts."""

    apex: np.ndarray  # (M,) bool: contacts at the apex
    status: np.ndarray | None  # (M,) as in `cone_apex`; None if no consistent combination was found
    velocity: np.ndarray | None  # (M, d) V of the contacts that are not released with a body
    stable: bool | None  # whether det k has the same sign as if all contacts stick; None if no status was found
    others: tuple[np.ndarray, ...]  # (M,) other consistent combinations
    complete: bool  # True if all combinations were enumerated, so that there are no others
    motion: np.ndarray | None = None  # (n,) velocities of all coordinates, released bodies included

    @property
    def opens(self) -> np.ndarray:
        """Mask (M,) of the contacts that open."""
        return self.status == OPENS

    @property
    def side(self) -> np.ndarray:
        """Sign (M,) of D_t at sliding contacts, 0 at all others."""
        return SIDE[self.status]


class _Search(NamedTuple):
    """Input of `decide_statuses`, with the contacts of each body."""

    matrix: LinearSystem
    load: np.ndarray
    apex: np.ndarray  # (M,) bool
    geometric: bool
    ours: np.ndarray  # (B, M) bool: contacts of each grain; grains that beams join share the row of the first
    alone: np.ndarray  # (M,) bool: contacts of grains whose contacts are all at the apex
    any_motion: bool = False  # whether bodies are released if any motion opens their contacts, not just the smallest


def decide_statuses(
    matrix: LinearSystem, load: np.ndarray, apex: np.ndarray, *, geometric: bool = True, wedged: bool = False
) -> ApexStatuses:
    """Decide the statuses of contacts at the apex, (M,) bool, together with those at the limit, under a load rate.

    Grains whose contacts are all at the apex may be released as bodies. For up to three such grains, all combinations
    of released and load-carrying grains are tried. For more than three, all are released first; those that are dragged
    along then carry load. Stable combinations come first, led by the one that releases the most bodies, or the fewest
    if some have just been `wedged`. If no combination is found, bodies that would be dragged along are released if they
    can escape at all, unless they have just been `wedged` and so cannot escape.
    """
    ours = _contacts_of_bodies(matrix)
    lone = np.flatnonzero((ours.sum(axis=1) > 0) & ~(ours & ~apex).any(axis=1))
    lone = np.array([body for body in lone if _is_held_by_contacts(matrix, body)], int)
    search = _Search(matrix, load, apex, geometric, ours, ours[lone].any(axis=0))
    if matrix.width == 3 and not len(lone) and (choice := _open_all(search)) is not None:
        return choice
    try_groups = _try_all_groups if len(lone) <= COMBINED else _release_most
    choices, complete = try_groups(search, lone)
    if not choices and len(lone) and not wedged:
        choices, complete = try_groups(search._replace(any_motion=True), lone)
    if wedged:  # without room to open, combinations in which bodies carry load come first
        choices.reverse()
    choices.sort(key=lambda choice: not choice[2])
    if not choices:
        return ApexStatuses(apex, None, None, None, (), complete)
    status, velocity, stable, motion = choices[0]
    return ApexStatuses(apex, status, velocity, stable, tuple(choice[0] for choice in choices[1:]), complete, motion)


def _open_all(search: _Search) -> ApexStatuses | None:
    """Return the statuses in which all contacts of spheres at the apex open, or None if they are not consistent.

    A sphere left with two other contacts may roll about the line through both, which can open its contacts at the apex.
    """
    matrix, apex = search.matrix, search.apex
    c = sparse.csr_array(matrix.c * ~np.repeat(apex, 3))
    c.eliminate_zeros()
    springs = np.where(apex[:, None, None], 0.0, matrix.springs)
    rest = matrix._replace(c=c, springs=springs, limit=matrix.limit & ~apex)
    choice = status_of_critical(rest, search.load, geometric=search.geometric)
    if not choice.ok or choice.stable is False:
        return None
    velocity = (matrix.c.T @ choice.velocity).reshape(-1, 3)
    moves = rolling_motions(rest, search.geometric)
    rolls, motion = (matrix.c.T @ moves.T)[::3][apex], choice.velocity
    size = np.abs(velocity).max(initial=0.0) or 1.0
    apart = velocity[apex, 0] / size
    if (apart < -SLACK).any():
        way = linprog(np.zeros(rolls.shape[1]), -rolls, apart, bounds=(None, None)) if rolls.size else None
        if way is None or way.status != 0:
            return None
        motion = motion + size * way.x @ moves
    status = np.where(apex, OPENS, np.where(choice.sliding, SLIDES, STICKS))
    return ApexStatuses(apex, status, velocity, choice.stable is not False, (), False, motion)


def _try_all_groups(search: _Search, lone: np.ndarray) -> tuple[list, bool]:
    """Return statuses for all sets of released bodies, largest sets first, and True if the list is complete."""
    choices, complete = [], True
    for size in range(len(lone), -1, -1):
        for group in itertools.combinations(lone, size):
            good, _, all_seen = _choices_with_released(search, np.array(group, int))
            choices, complete = choices + good, complete and all_seen
    return choices, complete


def _release_most(search: _Search, released: np.ndarray) -> tuple[list, bool]:
    """Find combinations that release all bodies except those that would be dragged along; there may be more."""
    while True:
        good, caught, _ = _choices_with_released(search, released)
        if good or not len(released):
            return good, False
        released = np.setdiff1d(released, caught)


def _choices_with_released(search: _Search, released: np.ndarray) -> tuple[list, np.ndarray, bool]:
    """Find consistent (statuses, V, stable, motion) with given bodies released.

    The other results are the bodies that stay caught, and True if all combinations were found. Others may exist if a
    body is dragged along by its smallest motion, because another motion might release it.
    """
    matrix, ours = search.matrix, search.ours
    gone = ours[released].any(axis=0)
    special = np.flatnonzero((search.apex | matrix.limit) & ~gone)
    sign = np.where(search.apex, 0.0, matrix.sign)[special]
    loose = np.flatnonzero(np.isin(_owners(matrix), released))
    rest = matrix._replace(springs=np.where(gone[:, None, None], 0.0, matrix.springs))
    try:
        map_of = reduce_to_contacts(
            rest, search.load, special, sign, geometric=search.geometric, without=loose, alone=search.alone
        )
    except LinAlgError:  # the others are unsupported without these bodies, which therefore carry load
        return [], released, True
    answers, all_seen = _stable_statuses(map_of.apex)
    good, caught = [], np.zeros(0, int)
    for solution, stable in answers:
        dragged, motion = _dragged_bodies(search, map_of.velocities(solution), loose, gone)
        drawn = dragged[released]
        if drawn.any():
            caught = np.union1d(caught, released[drawn])
            continue
        status, velocity = np.zeros(matrix.count, int), np.zeros(matrix.force.shape)
        status[special], status[gone], velocity[special] = solution.status, OPENS, solution.velocity
        good.append((status, velocity, stable, motion))
    return good, caught if answers else released, all_seen and (search.any_motion or not len(caught))


def _stable_statuses(apex: Apex) -> tuple[list[tuple[StatusSolution, bool]], bool]:
    """Return the consistent statuses, each with its stability, and True if the list is complete."""
    if apex.velocity.shape[1] == 3:
        solution, sign = status_on_round_cones(apex)
        return [(solution, sign > 0)] if sign else [], False
    if count_choices(apex) <= ENUMERATED:
        every = enumerate_statuses(apex)
        solutions = [StatusSolution(s, v, "one by one") for s, v in zip(every.status, every.velocity, strict=True)]
        return list(zip(solutions, every.stable.tolist(), strict=True)), every.decided
    # most likely, sliding contacts keep sliding, and contacts without force stick or open
    slides, touches = np.where(apex.sign < 0, SLIDES_BACK, SLIDES), apex.sign == 0
    starts = (np.where(touches, STICKS, slides), np.where(touches, OPENS, slides), np.full(len(slides), STICKS))
    solution = statuses_at_apex(apex, *starts)
    if solution.status is None:
        return [], False
    return [(solution, bool(np.linalg.slogdet(piece_matrix(apex, solution.status))[0] > 0))], False


def _contacts_of_bodies(matrix: LinearSystem) -> np.ndarray:
    """Return the mask (B, M) of the contacts of each grain that is free to rotate; rows of other bodies are empty.

    Grains that beams join share the row of the first of them, which is empty unless all are free to rotate.
    """
    body, c = matrix.free.body, matrix.c.tocoo()
    out = np.zeros((int(body.max(initial=-1)) + 1, matrix.count), bool)
    out[body[c.row[c.data != 0]], c.col[c.data != 0] // matrix.width] = True
    turns = np.zeros(len(out), bool)
    turns[body[matrix.free.axis == 5]] = True
    if matrix.unit is None:
        return out & turns[:, None]
    joined, held = np.zeros_like(out), np.ones(len(matrix.unit), bool)
    np.logical_or.at(joined, matrix.unit[: len(out)], out)
    held[: len(turns)] = ~turns
    turns[np.intersect1d(matrix.unit[held], np.arange(len(turns)))] = False
    return joined & turns[:, None]


def _dragged_bodies(
    search: _Search, velocity: np.ndarray, loose: np.ndarray, gone: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a mask (B,) of released bodies that close contacts even if they follow neighbours, and the motion (n,)."""
    matrix, ours, motion = search.matrix, search.ours, velocity.copy()
    if not len(loose):
        return np.zeros(len(ours), bool), motion
    columns = np.repeat(gone, matrix.width)
    apart = (matrix.c.T @ velocity)[columns]
    rigid = _rigid_motions(matrix, loose)
    own = rigid.T @ matrix.c[loose][:, np.flatnonzero(columns)].toarray()
    if search.any_motion:
        size = np.abs(apart).max(initial=0.0) or 1.0
        way = linprog(np.zeros(len(own)), -own.T[:: matrix.width], apart[:: matrix.width] / size, bounds=(None, None))
        if way.status == 0:
            motion[loose] = rigid @ (size * way.x)
        return (ours & gone).any(axis=1) & (way.status != 0), motion
    follow = np.linalg.lstsq(own.T, -apart, rcond=None)[0]
    motion[loose] = rigid @ follow
    normal = (own.T @ follow + apart)[:: matrix.width]
    closes = np.zeros(matrix.count, bool)
    closes[gone] = normal < -SLACK * np.abs(velocity).max(initial=0.0)
    return (ours & closes).any(axis=1), motion


def _is_held_by_contacts(matrix: LinearSystem, body: int) -> bool:
    """Return True if only contacts resist rigid motions of a grain and the grains that beams join to it."""
    if matrix.unit is None:
        return True
    contacts = np.flatnonzero(_owners(matrix) == body)
    return _rigid_motions(matrix, contacts).shape[1] == (3 if matrix.free.dim == 2 else 6)


def _owners(matrix: LinearSystem) -> np.ndarray:
    """Return the body of each coordinate (n,); bodies that beams join are represented by the first of them."""
    body = matrix.free.body
    return body if matrix.unit is None else np.append(matrix.unit, len(matrix.unit))[body]


def _rigid_motions(matrix: LinearSystem, loose: np.ndarray):
    """Return a sparse basis (L, K) of the motions of the coordinates `loose` that deform no bond."""
    if matrix.unit is None:
        return sparse.eye_array(len(loose), format="csr")
    resisted, moves = np.linalg.eigh(matrix.machine[loose][:, loose].toarray())
    return sparse.csr_array(moves[:, np.abs(resisted) <= RESIDUAL * np.abs(resisted).max(initial=0.0)])


@checked
def contact_status(
    matrix: LinearSystem, load: Numbers, *, critical: np.ndarray | None = None, start: np.ndarray | None = None,
    geometric: bool = True, unique: bool | None = None,
) -> ContactStatus:  # fmt: skip
    """Find the contact status by the principle of minimum sliding.

    A contact slides if and only if it would otherwise leave the Coulomb cone. All inconsistent contacts are flipped
    together, which nearly always converges after a few rounds. If this cycles, principal pivoting flips one contact at
    a time (if A may be a P-matrix), and then Lemke's algorithm is used. Every status found is verified contact by
    contact with a factor of k(S) itself. For up to 14 critical contacts, all statuses are enumerated unless A is a
    P-matrix. Those with det k > 0 come first; if no status exists, this is proven. If many statuses are singular,
    solutions may exist within the error bounds although none balances the load under k(S) itself: then there is no
    proof, and the verdict is NOT_FOUND. For more contacts, a proof of absence needs a Farkas certificate.

    A critical contact without force may also open (`ContactStatus.opens`), and in three dimensions it may slide in any
    direction. The status is then searched for as on a load path, and verified by the balance of the force rates that
    the law itself gives at the velocities. The verdict is CONSISTENT, NEGATIVE or NOT_FOUND; other
    statuses are not searched for.

    Parameters
    ----------
    load : (n,) rate of the external load on the free coordinates [force/time]
    critical : indices of the contacts at the Coulomb limit; default: those of `matrix.limit`, and those without force
    start : (M,) bool, initial status, such as that of the last step; default: all critical contacts slide
    geometric : whether the forces rotate with the contacts
    unique : whether stability and uniqueness of the status are tested; default: only for up to 14 critical contacts

    Returns
    -------
    ContactStatus
    """
    faint = matrix.force[:, 0] <= APEX * matrix.force[:, 0].mean() if matrix.count else np.zeros(0, bool)
    numbers = critical_numbers(matrix, matrix.limit | faint if critical is None else critical)
    if not faint[numbers].any() or len(driven_motions(matrix, load, geometric)):
        return status_of_critical(
            matrix, load, critical=numbers, start=start, geometric=geometric, unique=unique
        )  # fmt: skip
    if matrix.rigid is not None:
        raise ValueError(
            "rigid bonds and contacts without force exclude each other, as it is not decided which contacts open: use "
            "linear_system(..., bonds='elastic')"
        )
    mask = np.isin(np.arange(matrix.count), numbers)
    return _status_at_apex(matrix._replace(limit=mask & ~faint), np.asarray(load, float), mask & faint, geometric)


def _status_at_apex(matrix: LinearSystem, load: np.ndarray, apex: np.ndarray, geometric: bool) -> ContactStatus:
    """Return a verified status with contacts at the apex, (M,) bool, or the verdict NOT_FOUND."""
    critical = np.flatnonzero(apex | matrix.limit)
    choice = decide_statuses(matrix, load, apex, geometric=geometric)
    if choice.status is None or not is_balanced(matrix, load, choice, geometric):
        nothing, unknown = np.zeros(matrix.count, bool), np.full(len(critical), np.nan)
        return ContactStatus(
            Verdict.NOT_FOUND, nothing, critical, np.full(len(load), np.nan), unknown, "", 0, opens=nothing
        )  # fmt: skip
    verdict = Verdict.CONSISTENT if choice.stable else Verdict.NEGATIVE
    normal, along = _relative_velocities(matrix, choice.motion)[critical, :2].T
    across = np.linalg.norm(_relative_velocities(matrix, choice.motion)[critical, 1:], axis=1)
    sign = np.where(apex, SIDE[choice.status], matrix.sign)[critical]
    out = matrix.slope[critical] * normal
    out += np.where(apex[critical] & (matrix.width == 3), across, sign * along)
    rate = np.where(choice.opens[critical], np.nan, out)
    return ContactStatus(
        verdict, choice.side != 0, critical, choice.motion, rate, "at the apex", 0, choice.stable, opens=choice.opens
    )  # fmt: skip


def _relative_velocities(matrix: LinearSystem, motion: np.ndarray) -> np.ndarray:
    """Return the relative velocities V (M, d) of all contacts."""
    return (matrix.c.T @ motion).reshape(-1, matrix.width)


def is_balanced(matrix: LinearSystem, load: np.ndarray, choice: ApexStatuses, geometric: bool) -> bool:
    """Return True if, with these statuses and velocities, the force rates that the law gives balance the load."""
    velocity = _relative_velocities(matrix, choice.motion)
    special = np.flatnonzero(choice.apex | matrix.limit)
    part = Apex(
        np.zeros((0, 0)), velocity[special], matrix.springs[special], matrix.slope[special],
        np.where(choice.apex, 0.0, matrix.sign)[special], np.zeros(len(special), bool),
    )  # fmt: skip
    stretch = np.einsum("mab,mb->ma", matrix.springs, velocity)
    status, slack = choice.status[special], SLACK * np.abs(velocity).max(initial=0.0)
    if matrix.width == 2:
        if not np.array_equal(status_of_velocity(part, part.velocity, status, slack), status):
            return False
        stretch[special] += np.einsum("mab,mb->ma", stiffness_change(part, status), part.velocity)
    else:
        stretch[special] = np.einsum("mab,mb->ma", part.springs, round_cone_stretch(part, part.velocity)[0])
    held = matrix.machine + roll_springs(matrix, geometric) + geometric * matrix.geometric
    missed = matrix.c @ stretch.ravel() + held @ choice.motion - load
    return bool(np.abs(missed).max(initial=0.0) <= RESIDUAL * np.abs(load).max(initial=0.0))


class Probed(NamedTuple):
    """Response to one increment of stress."""

    status: ContactStatus
    strain: np.ndarray  # (dim, dim) per unit of the stress, compression positive; NaN without a consistent status


@checked
def probe_statuses(state: State, law: Law, stresses: Numbers, *, unique: bool | None = True) -> tuple[Probed, ...]:
    """Find the contact status of a periodic packing for each of several stress rates.

    In 30 disks and 60 spheres with sliding contacts, small increments of stress, as in `protocols.response_envelope`,
    made the same contacts slide, and strains agreed to within 1.5e-4 of the largest strain
    (`tests/unit/test_envelope.py`).

    Parameters
    ----------
    state : State in equilibrium, in a fully periodic cell
    stresses : (M, dim, dim) symmetric, compression positive, for example those of `protocols.response_envelope`
    unique : as in `contact_status`, but by default every status comes with its certificate

    Source
    ------
    McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. IV, with the strain of the cell as coordinates.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> (probed,) = ss.quasirigid.probe_statuses(state, law, [[[1.0, 0.0], [0.0, 1.0]]])
    >>> probed.status.ok, bool(probed.strain.trace() > 0)
    (True, True)
    """
    dim = state.cell.dim
    stresses = np.asarray(stresses, float)
    require_not_negative(stresses=float(np.abs(stresses).max(initial=0.0)))
    if stresses.shape[1:] != (dim, dim) or not np.allclose(stresses, stresses.transpose(0, 2, 1)):
        raise ValueError(f"stresses must be symmetric, of shape (M, {dim}, {dim}), got shape {stresses.shape}")
    matrix = linear_system(_under(state, stress(state, law)[:dim, :dim]), law)
    still = external_force(_under(state, np.zeros((dim, dim))), matrix.free)
    answers = []
    for rate in stresses:
        load = external_force(_under(state, rate), matrix.free) - still
        status = contact_status(matrix, load, unique=unique)
        gradient = matrix.free.strain(status.velocity)[:dim, :dim]
        answers.append(Probed(status, -0.5 * (gradient + gradient.T) if status.ok else np.full((dim, dim), np.nan)))
    return tuple(answers)


def _under(state: State, target: np.ndarray) -> State:
    return state._replace(control=stress_controlled(state.control, target))


SOLVE = 1e-9, "one sparse or dense solve"


def selfchecks() -> dict[str, Selfcheck]:
    """Check the status of four critical contacts in a row of disks with given slip (McNamara & Herrmann 2006)."""
    law = for_pair(linear(kn=1.0, kt=0.5, mu=0.5), 0, 1)
    state = disk_array(5, press=1e-3, gap=-1e-3)
    lifted = state.grains.position - [0, 1e-3, 0]
    state = with_neighbor_list(state._replace(grains=state.grains._replace(position=lifted)))
    contacts, near = state.contacts, state.contacts.count[0]
    mode, slip = np.zeros_like(contacts.mode), np.zeros_like(contacts.slip)
    mode[:near] = STICK
    critical = np.flatnonzero((contacts.j[:near] >= 5) & (contacts.i[:near] < 4))  # not the last disk on the floor
    mode[critical], slip[critical, 0] = SLIDE, 1e-3
    matrix = linear_system(state._replace(contacts=contacts._replace(mode=mode, slip=slip)), law)
    load = np.zeros(matrix.c.shape[0])
    load[0], load[9] = 0.3, -0.4  # along x on the first disk and on the fourth
    choice = contact_status(matrix, load)
    sliding = float(choice.sliding.sum()) if choice.ok else -1.0
    return {
        "quasi-rigid, number sliding": Selfcheck(sliding, 2.0, *SOLVE),
        "quasi-rigid, slip rate": Selfcheck(float(np.abs(choice.rate).max()), 0.20790189518075392, *SOLVE),
    }
