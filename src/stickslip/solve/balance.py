"""Linearised state of a packing and its force balance: imbalance, likely causes, and modes under another law."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..core.arguments import checked, knows_bonds
from ..core.contacts.bonds import bond_rows
from ..core.contacts.forces import AT_LIMIT, ROUND_OFF, forces, unbalanced_forces
from ..core.contacts.jacobian import Linearisation, blocks_of, linearise
from ..core.contacts.neighbors import body_radii
from ..core.laws.builtin import LEVER, ROLLING, SHARP, TWISTING, Law
from ..core.measure import Committed, contact_velocity, overlaps, touching, volume
from ..core.state import SLIDE, STICK, State
from .freedom import Freedom, freedom, mass_weighted, stiffness_of, unsupported_grains

# Largest residual, over the mean contact force, in equilibrium; from `python -m benchmarks equilibrium`. Up to 1e-3,
# random displacements of grains change the verdict no more often than at 1e-8. Up to 2e-3, none of 52 packings whose
# slips were deleted had a wrong verdict; the first wrong ones appear beyond that. Positions stored as text with eight
# digits have residuals of 2e-4 in packings of 60 grains and about 1e-3 in larger ones.
BALANCED_BELOW = 2e-3
DIGITS = 13  # number of significant digits; positions with fewer count as truncated by text or single precision


class LinearisedState(NamedTuple):
    """A state linearised under a law, with each contact held in its mode."""

    state: State
    law: Law
    line: Linearisation  # linearisation of all pairs in the list
    rows: np.ndarray  # rows of the touching pairs
    loose: np.ndarray  # (N,) bool, True for rattlers

    @property
    def backbone(self) -> Freedom:
        """Free coordinates of all bodies that are not rattlers."""
        return freedom(self.state).without(self._loose_bodies)

    @property
    def supported(self) -> np.ndarray:
        """(C,) mask of the pairs in the list; False for pairs with a rattler."""
        contacts, count, loose = self.state.contacts, len(self.line.closed), self._loose_bodies
        return ~loose[contacts.i[:count]] & ~loose[contacts.j[:count]]

    @property
    def mean_force(self) -> float:
        """Mean force of touching contacts and their bonds [force]; zero without contacts."""
        return float(self.line.bearing[self.rows].mean()) if len(self.rows) else 0.0

    @property
    def mean_stiffness(self) -> float:
        """Mean dF_n/dδ of touching contacts, plus k_n of their bonds [force/length]; zero without contacts."""
        slope, bonds = self.line.slope_n, self.state.bonds
        if bonds:
            slope = slope.copy()
            np.add.at(slope, bond_rows(bonds, self.state.contacts)[bonds.intact], bonds.stiffness[bonds.intact, 0])
        return slope[self.rows].mean() if len(self.rows) else 0.0

    @property
    def at_limit(self) -> np.ndarray:
        """Rows of contacts at the Coulomb limit under sharp friction; contacts of rattlers do not count."""
        if self.law.coulomb != SHARP:
            return np.zeros(0, np.int64)
        slides = (self.state.contacts.mode[self.rows] == SLIDE) & (self.line.limit[self.rows] > 0)
        return self.rows[slides & self.supported[self.rows]]

    def dynamical_matrix(self, free: Freedom):
        """(n, n) sparse A = −M^(−1/2) J M^(−1/2) in the coordinates `free` [1/time²]."""
        blocks, _ = blocks_of(self.state, self.law, self.line)
        return mass_weighted(stiffness_of(self.state, self.line, blocks, free), free)

    @property
    def _loose_bodies(self) -> np.ndarray:
        return np.append(self.loose, np.zeros(len(self.state.walls.mass), bool))

    def with_modes(self, state: State) -> "LinearisedState":
        """Linearisation of the same contacts with the modes and slips of another state."""
        return self if state is self.state else self._replace(state=state, line=linearise(state, self.law))


def linearised(state: State, law: Law) -> LinearisedState:
    """Linearise an accepted state."""
    return LinearisedState(state, law, linearise(state, law), touching(state), unsupported_grains(state, law))


@checked
@knows_bonds
def imbalance(state: State, law: Law) -> float:
    """Largest component of an unbalanced force or torque/R, divided by the mean normal contact force.

    For each body, |F_n| is averaged over the contacts of its connected group of grains (for rattlers and held bodies,
    over all contacts), so that strong forces in one group do not hide an imbalance in a weaker one. Rattlers and held
    bodies do not connect others. The result is zero if no force acts, and infinite if forces act but no contact carries
    them. If the cell is free, the largest difference between its stress and the imposed stress, divided by the larger
    of the two, also counts as an imbalance.

    Parameters
    ----------
    state : State, accepted

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.linear()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> round(imbalance(pair, law), 12)
    1.0
    """
    return force_imbalance(linearised(state, law))


def force_imbalance(here: LinearisedState) -> float:
    """Largest unbalanced force divided by the mean normal contact force; see `imbalance`."""
    state = here.state
    loads = forces(state, here.law)[0]
    worst = np.abs(unbalanced_forces(state, loads)).max(axis=1)
    ratio = max(map(_ratio, worst, _local_force_scales(here)), default=0.0) if worst.any() else 0.0
    free = state.control.cell_free
    if free.any():
        excess = (loads.virial - volume(state) * state.control.stress)[free]
        largest = max(float(np.abs(loads.virial).max()), float(np.abs(excess).max()))
        ratio = max(ratio, _ratio(float(np.abs(excess).max()), largest))
    return float(ratio)


@checked
@knows_bonds
def residual(state: State, law: Law):
    """Largest component of the unbalanced forces and torques/R in a state [force], and the body on which it acts."""
    size = np.abs(unbalanced_forces(state, forces(state, law)[0])).max(axis=1)
    return float(size.max()), int(size.argmax())


def balanced(state: State, law: Law) -> LinearisedState:
    """Linearised state with each contact in its mode under the law; raise ValueError if its forces do not balance."""
    here = linearised(state, law)
    here = here.with_modes(modes_under(state, law, here.line))
    if (residual := force_imbalance(here)) > BALANCED_BELOW:
        raise ValueError(f"{no_equilibrium_message(residual)}; equilibrate the packing first")
    return here


def _local_force_scales(here: LinearisedState) -> np.ndarray:
    """(N + W,) mean |F_n| in the connected group of each body, or over all contacts if the group has none."""
    state, rows = here.state, here.rows
    if not len(rows):
        return np.zeros(state.n_bodies)
    force = here.line.bearing[rows]
    held = state.control.free[:, : state.cell.dim].any(axis=1)
    held[: len(here.loose)] &= ~here.loose
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


def motion_imbalance(here: LinearisedState) -> float:
    """Force that stops the motion, v √(m k) for a mass m on a spring k, divided by the mean contact force.

    The result is the largest value over all grains that are not rattlers.
    """
    push = _speeds(here) * np.sqrt(here.state.grains.mass * here.mean_stiffness)
    return _ratio(float(push.max(initial=0.0)), here.mean_force)


def _speeds(here: LinearisedState) -> np.ndarray:
    """(N,) speed of each grain: of its centre or, if larger, relative to a neighbour at a contact; 0 for rattlers.

    Spin about the normal of a contact causes no motion there. Velocities are relative to their mean if nothing holds
    the grains in place; velocities of walls and of the cell are ignored.
    """
    state, still, rows = here.state, ~here.loose, here.rows
    if not (len(rows) and still.any()):
        return np.zeros(len(still))
    velocity, walls = state.grains.velocity, state.walls
    if not len(walls.mass) and state.control.free[: len(still), : state.cell.dim].all():
        velocity = velocity - np.average(velocity[still], axis=0, weights=state.grains.mass[still])
    resting = walls._replace(velocity=np.zeros_like(walls.velocity)), state.cell._replace(rate=np.zeros((3, 3)))
    fixed = state._replace(walls=resting[0], cell=resting[1])
    pace, slip = contact_velocity(fixed, rows, here.line.normal[rows])
    speed = np.append(np.linalg.norm(velocity, axis=1), np.zeros(len(walls.mass)))
    between = here.supported[rows]
    for ends in (state.contacts.i[rows], state.contacts.j[rows]):
        np.maximum.at(speed, ends[between], np.hypot(pace, np.linalg.norm(slip, axis=1))[between])
    return speed[: len(still)] * still


def _ratio(part: float, whole: float) -> float:
    if not part:
        return 0.0
    return part / whole if whole else np.inf


def no_equilibrium_message(residual: float, moves: float = 0.0) -> str:
    """Message given in place of a verdict if the state is not in equilibrium."""
    share = f"residual {_percent(residual)} of the mean contact force"
    reason = share if np.isfinite(residual) else "no contact carries the acting forces"
    if residual <= BALANCED_BELOW < moves:
        reason = f"the grains move, which changes forces by {_percent(moves)} of the mean contact force"
    return f"not in equilibrium ({reason}): stability cannot be judged"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %" if share < 100 else f"{100 * share:.1e} %"


@checked
def likely_causes(state: Committed, law: Law) -> tuple[str, ...]:
    """Possible reasons why the forces of a packing do not balance, the most informative first.

    The state can reveal contacts that were never sheared, missing confinement, motion, and positions with few digits.
    A wrong contact law leaves no trace in the state, so it is always listed last.
    """
    return causes_of_imbalance(linearised(state, law))


def causes_of_imbalance(here: LinearisedState) -> tuple[str, ...]:
    """Possible reasons why forces do not balance; see `likely_causes`."""
    causes, state, rows = [], here.state, here.rows
    i, j, moves = state.contacts.i[rows], state.contacts.j[rows], state.control.free.any(axis=1)
    bears = (here.line.limit[rows] > 0) & (moves[i] | moves[j])  # a gap without friction bears no tangential force
    bare = int((~state.contacts.slip[rows[bears]].any(axis=1)).sum())
    if bare:
        which = f"all {bare}" if bare == bears.sum() else f"{bare} of {bears.sum()}"
        causes.append(f"no slip: {which} contacts are treated as never sheared")
    control = state.control
    acts = any(a.any() for a in (control.force, control.torque, control.gravity, control.spring))
    free = control.free[: len(here.loose), : state.cell.dim].all()
    if free and not (state.cell.periodic.any() or len(state.walls.mass) or acts):
        causes.append("no cell: no periodic box, walls or loads hold the grains together")
    if motion_imbalance(here) > BALANCED_BELOW:
        causes.append(f"motion: the grains move, at up to {_speeds(here).max():.2g} relative to each other or in space")
    causes += _load_causes(here)
    lost, error = _precision_loss(state)
    share = _ratio(here.mean_stiffness * error, here.mean_force)
    if share > 0.1 * BALANCED_BELOW:  # errors add up: several contacts per grain, each with errors of two positions
        causes.append(
            f"few digits: positions {lost}, which leaves {_percent(share)} of the mean contact force undetermined"
        )
    return (*causes, "another law, or parameters other than those under which the packing came to rest")


def _load_causes(here: LinearisedState) -> list[str]:
    """Causes that the pattern of the imbalance suggests: loads, gravity, moments, lever arms, and walls."""
    state = here.state
    n, total = len(state.grains.radius), unbalanced_forces(state, forces(state, here.law)[0])
    free = state.control.free[:n, :3].any(axis=1)
    force, torque, mass = total[:n, :3][free], total[:n, 3:][free], state.grains.mass[free, None]
    small, causes = BALANCED_BELOW * here.mean_force, []
    if not len(force) or not small:
        return causes
    pull = np.median(force / mass, axis=0)
    calm = np.abs(force - mass * pull).max(axis=1) <= small
    if calm.mean() > 0.5 and (np.abs(mass * pull) > small).any():
        g = ", ".join(f"{value:.3g}" for value in np.where(np.abs(pull) < 1e-6 * np.abs(pull).max(), 0.0, -pull))
        share, word = f"{calm.sum()} of {len(calm)} grains", _like_a_load(state, pull, small)
        causes.append(
            f"loads: forces on {share} would balance without {word}, under which the packing has not come to rest"
            if word
            else f"gravity: forces on {share} would balance under gravity ({g})"
        )
        force = force - mass * pull
    loose = np.abs(force).max(axis=1) > small
    if not loose.any() and (np.abs(torque) > small).any():
        causes.append(_torque_cause(here.law))
    position, radius = state.grains.position[free], state.grains.radius[free]
    for axis in np.flatnonzero(~state.cell.periodic[: state.cell.dim]) if 0 < loose.mean() <= 0.7 else ():
        for side, edge in ((-1.0, "lowest"), (1.0, "highest")):
            height = side * position[:, axis] + radius
            if (height[loose] > height.max() - 0.5 * radius[loose]).all():
                causes.append(
                    f"a wall: the {loose.sum()} grains with unbalanced forces are the {edge} along {'xyz'[axis]}"
                )
    return causes


def _like_a_load(state: State, pull: np.ndarray, small: float) -> str:
    """Name of the load that would cause an acceleration `pull` of most free grains; empty if there is none."""
    control, n = state.control, len(state.grains.radius)
    free, mass = control.free[:n, :3].any(axis=1), state.grains.mass[:, None]
    push, weight = control.force[:n], mass * control.gravity
    for word, load in (("the external forces", push), ("gravity", weight), ("gravity and the forces", push + weight)):
        if load.any() and (np.abs(load - mass * pull)[free].max(axis=1) <= small).mean() > 0.5:
            return word
    return ""


def _torque_cause(law: Law) -> str:
    """Reason why torques do not balance although forces do."""
    if law.properties & (ROLLING | TWISTING):
        return (
            "moments: forces balance but torques do not, as if the memory of rolling or twisting did not belong to "
            "this packing; LAMMPS reverses it where grains cross a periodic side"
        )
    arms = "R − δ/2, are those of this law; R" if law.properties & LEVER else "R, are those of this law; R − δ/2"
    return f"lever arms: forces balance but torques do not, as with other lever arms ({arms})"


def _precision_loss(state: State) -> tuple[str, float]:
    """Description of how positions were truncated, and the resulting error [length]; zero if they were not.

    Positions do not count as truncated if they have all digits of double precision, or are all whole numbers.
    """
    position = state.grains.position
    largest = max(float(np.abs(position).max()), 1e-30)
    whole = int(np.ceil(np.log10(largest)))
    for decimals in range(DIGITS - whole):
        if np.abs(position - np.round(position, decimals)).max() <= 10.0 ** (whole - DIGITS - 1):
            return f"end at {decimals} decimals", 10.0**-decimals if decimals else 0.0
    if np.array_equal(position, position.astype(np.float32)):
        return "are in single precision", largest * float(np.finfo(np.float32).eps)
    return "", 0.0


def with_modes_under(state: State, law: Law) -> State:
    """State with the mode of each contact, stick or slide, determined by its slip under a given law.

    The law may differ from the one under which the state was accepted. A contact that slid at a smaller limit sticks.
    A contact beyond its limit slides, and its slip is truncated. A contact that slides at its limit, to within
    `AT_LIMIT`, continues to slide.

    Parameters
    ----------
    state : State, accepted under some law

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(10, packing_fraction=0.7)
    >>> found = with_modes_under(state, ss.laws.hertz_mindlin(mu=0.5))
    >>> set(found.contacts.mode[ss.measure.touching(state)].tolist()) == {STICK}
    True
    """
    return modes_under(state, law, linearise(state, law))


def modes_under(state: State, law: Law, line: Linearisation) -> State:
    """State with the contact modes that follow from a linearisation; see `with_modes_under`."""
    contacts, count, radius = state.contacts, len(line.limit), body_radii(state)
    reach = radius[contacts.i[:count]] + radius[contacts.j[:count]]
    pull, mode = line.stiffness_t * np.linalg.norm(line.slip, axis=1), contacts.mode[:count]
    slack = ROUND_OFF * reach * line.stiffness_t
    sticks = (mode == SLIDE) & (pull < np.minimum((1 - AT_LIMIT) * line.limit, line.limit - slack))
    sticks |= (mode == SLIDE) & (pull == 0) & (line.limit > 0)
    slides = (pull > line.limit + slack) | ((mode == STICK) & (line.limit == 0) & (overlaps(state) > 0))
    if not (sticks | slides).any():
        return state
    mode, slip, reached = contacts.mode.copy(), contacts.slip.copy(), contacts.reached.copy()
    mode[:count][sticks], mode[:count][slides] = STICK, SLIDE
    slip[:count][slides] = forces(state, law)[1].slip[:count][slides]
    reached[:count][slides] = slip[:count][slides].any(axis=1)
    reached[:count][sticks] = False
    return state._replace(contacts=contacts._replace(mode=mode, slip=slip, reached=reached))


def with_mode(state: State, rows: np.ndarray, mode: int) -> State:
    """State in which the contacts in the given rows have the given mode."""
    modes = state.contacts.mode.copy()
    modes[rows] = mode
    return state._replace(contacts=state.contacts._replace(mode=modes))
