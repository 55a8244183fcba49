"""Is a packing at rest? How far its forces are from balance, the likely reasons, and its contacts under another law."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..core.contacts.forces import forces, unbalanced_forces
from ..core.contacts.jacobian import linearise
from ..core.laws.builtin import MU, Law
from ..core.measure import mean_normal_force, touching, volume
from ..core.state import SLIDE, STICK, Contacts, State
from .freedom import unsupported_grains

# Of the mean contact force, `python -m benchmarks.equilibrium`: up to 1e-3 grains that were moved at random change the
# verdict no more often than at 1e-8, and up to 2e-3 none of 52 packings had a wrong one without its slips; beyond, the
# first have. Text of eight digits leaves 2e-4 in packings of 60 grains, and some 1e-3 in larger ones.
BALANCED_BELOW = 2e-3
AT_LIMIT = 1e-3  # a contact that slides is at its limit as nearly as forces must balance: dashpots leave that much
DIGITS = 13  # significant ones that positions have if no text or single precision took any
ROUND_OFF = 1e-9  # of a contact's pull over its limit: slips are differences of positions, which carry 1e-16


def imbalance(state: State, law: Law) -> float:
    """Largest unbalanced force or torque/R over the mean normal contact force, and that of a free cell's stress.

    The mean is over the contacts of the grains that hang together, without rattlers: strong forces elsewhere do not
    hide what is missing in a weak part. Zero where nothing acts at all; infinite where something acts, but no contact
    bears it. The imbalance of a free cell is the largest difference between its stress and the imposed one, over the
    larger of the two.

    Parameters
    ----------
    state : State, accepted

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> round(imbalance(ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law), law), 12)
    1.0
    """
    loads = forces(state, law)[0]
    worst = np.abs(unbalanced_forces(state, loads)).max(axis=1)
    found = max(map(_ratio, worst, _local_force_scales(state, law)), default=0.0) if worst.any() else 0.0
    free = state.control.cell_free
    if free.any():
        has, wants = loads.virial[free], (volume(state) * state.control.stress)[free]
        found = max(found, _ratio(float(np.abs(has - wants).max()), float(np.abs([has, wants]).max())))
    return float(found)


def _local_force_scales(state: State, law: Law) -> np.ndarray:
    """(N + W,) mean |F_n| around each body: of the part of the packing that it belongs to, or of all contacts."""
    rows, n = touching(state), len(state.grains.radius)
    if not len(rows):
        return np.zeros(state.n_bodies)
    force = np.abs(linearise(state, law).force_n[rows])
    held = state.control.free[:, : state.cell.dim].any(axis=1)
    held[:n] &= ~unsupported_grains(state, law)
    i, j = state.contacts.i[rows], state.contacts.j[rows]
    linked = held[i] & held[j]
    links = coo_array((np.ones(linked.sum()), (i[linked], j[linked])), shape=(state.n_bodies,) * 2)
    part = connected_components(links, directed=False)[1]
    mine = held[i] | held[j]
    part_of = np.where(held[i], part[i], part[j])[mine]
    total, count = np.bincount(part_of, force[mine], len(held)), np.bincount(part_of, minlength=len(held))
    whole = force.mean()
    means = np.divide(total, count, out=np.full(len(total), whole), where=count > 0)
    return np.where(held, means[part], whole)


def motion_imbalance(state: State, law: Law) -> float:
    """By which share of the mean contact force motion changes forces: v √(m k) of a spring k that stops a mass m.

    Of the grains that hang together, relative to their mean velocity where nothing holds them in place.
    """
    rows, still = touching(state), ~unsupported_grains(state, law)
    if not (len(rows) and still.any()):
        return 0.0
    grains, velocity = state.grains, state.grains.velocity[still]
    if not len(state.walls.mass) and state.control.free[: len(still), : state.cell.dim].all():
        velocity = velocity - np.average(velocity, axis=0, weights=grains.mass[still])
    turning = np.linalg.norm(grains.spin[still], axis=1) * grains.radius[still]
    speed = np.maximum(np.linalg.norm(velocity, axis=1), turning)
    stiffness = linearise(state, law).slope_n[rows].mean()
    return _ratio(float((speed * np.sqrt(grains.mass[still] * stiffness)).max()), mean_normal_force(state, law))


def _ratio(part: float, whole: float) -> float:
    if not part:
        return 0.0
    return part / whole if whole else np.inf


def unjudged(residual: float, moves: float = 0.0) -> str:
    """The sentence that stands for a verdict where there is no equilibrium."""
    share = f"residual {_percent(residual)} of the mean contact force"
    words = share if np.isfinite(residual) else "no contact bears the forces that act"
    if residual <= BALANCED_BELOW < moves:
        words = f"the grains move, which changes forces by {_percent(moves)} of the mean contact force"
    return f"not in equilibrium ({words}): stability cannot be judged"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %" if share < 100 else f"{100 * share:.1e} %"


def likely_causes(state: State, law: Law) -> tuple[str, ...]:
    """Why the forces of a packing may not balance, as far as the state itself shows, the most telling first.

    Contacts that were never sheared, nothing that confines the grains, motion, positions with few digits; last, what no
    state shows: another law.
    """
    found, n, rows = [], len(state.grains.radius), touching(state)
    bare = int((~state.contacts.slip[rows].any(axis=1)).sum())
    if law.table[..., MU].any() and bare:
        which = f"all {bare}" if bare == len(rows) else f"{bare} of {len(rows)}"
        found.append(f"no slips: {which} contacts are taken as never sheared")
    control = state.control
    acts = any(a.any() for a in (control.force, control.torque, control.gravity, control.spring))
    if not (state.cell.periodic.any() or len(state.walls.mass) or acts) and control.free[:n, : state.cell.dim].all():
        found.append("no cell: neither a periodic box nor walls or loads hold the grains together")
    if motion_imbalance(state, law) > BALANCED_BELOW:
        speed = np.linalg.norm(state.grains.velocity, axis=1).max()
        found.append(f"motion: the grains move, the fastest at {speed:.2g}")
    lost, error = _precision_loss(state)
    stiffness = linearise(state, law).slope_n[rows].mean() if len(rows) else 0.0
    share = _ratio(stiffness * error, mean_normal_force(state, law))
    if share > 0.1 * BALANCED_BELOW:  # a grain has several contacts, each with the errors of two grains
        found.append(f"few digits: positions {lost}, which leaves {_percent(share)} of the mean contact force open")
    return (*found, "another law, or other parameters, than those under which the packing came to rest")


def _precision_loss(state: State) -> tuple[str, float]:
    """How the positions' digits were cut, in words, and the error that this leaves [length]; zero if they were not.

    Nothing is lost where positions have the digits that numbers of their size can have, or all are whole.
    """
    place = state.grains.position
    largest = max(float(np.abs(place).max()), 1e-30)
    whole = int(np.ceil(np.log10(largest)))
    for decimals in range(DIGITS - whole):
        if np.abs(place - np.round(place, decimals)).max() <= 10.0 ** (whole - DIGITS - 1):
            return f"end at {decimals} decimals", 10.0**-decimals if decimals else 0.0
    if np.array_equal(place, place.astype(np.float32)):
        return "are in single precision", largest * float(np.finfo(np.float32).eps)
    return "", 0.0


def with_modes_under(state: State, law: Law) -> State:
    """The state with each contact in the mode that its slip has under a law, which may be another than it came with.

    A contact that slid at a smaller limit sticks; one beyond the limit slides, its slip cut. What slides at the limit
    goes on sliding, as `AT_LIMIT` has it.

    Parameters
    ----------
    state : State, accepted under some law

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(10, packing_fraction=0.7)
    >>> set(under(state, ss.laws.hertz_mindlin(mu=0.5)).contacts.mode[touching(state)].tolist()) == {STICK}
    True
    """
    contacts, line = state.contacts, linearise(state, law)
    count = len(line.limit)
    pull, mode = line.stiffness_t * np.linalg.norm(line.slip, axis=1), contacts.mode[:count]
    sticks = (mode == SLIDE) & (pull < (1 - AT_LIMIT) * line.limit)
    slides = (pull > (1 + ROUND_OFF) * line.limit) | ((mode == STICK) & (line.limit == 0))
    if not (sticks | slides).any():
        return state
    return state._replace(contacts=_set_modes(contacts, sticks, slides, forces(state, law)[1].slip))


def _set_modes(contacts: Contacts, sticks: np.ndarray, slides: np.ndarray, cut: np.ndarray) -> Contacts:
    count, mode, slip, reached = len(sticks), contacts.mode.copy(), contacts.slip.copy(), contacts.reached.copy()
    mode[:count][sticks], mode[:count][slides] = STICK, SLIDE
    slip[:count][slides] = cut[:count][slides]
    reached[:count][slides] = slip[:count][slides].any(axis=1)
    reached[:count][sticks] = False
    return contacts._replace(mode=mode, slip=slip, reached=reached)
