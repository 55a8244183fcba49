"""Translation of a leg to LAMMPS: supported conditions, atom types, rigid groups, and formulas for a deforming cell.

A cell may also follow a stress. LAMMPS evaluates the formulas at each step, unless the cell is in simple shear. LAMMPS
moves grains with their laboratory velocities u = v + L x at mid-step, where v are the velocities used here. The effect
of the cell on the grains is therefore applied as a force of `fix addforce`. This force changes u of one step to u⁺ of
the next one, through v at the end of the step:

    v = σ (T ((1 + ½ dt L) u − L x) + ½ dt F/m),    u⁺ = K⁺ (T⁺ (κ v + ½ dt F/m) + L⁺ x),

with T and K = (1 − ½ dt L)⁻¹ of `core.dynamics.cell_motion`, and κ = 1 − ½ dt ν and σ = 1/(1 + ½ dt ν) for the drag ν.

Free components of L are internal variables, which `fix controller` increases by dt L̇. Σ m v² must be known at the end
of the step, when `fix deform` changes the cell; it is computed as the energy of another `fix addforce` with zero force.
"""

from typing import NamedTuple

import numpy as np

from ... import Law, State
from ...kit import (
    BUILTIN_LAWS,
    Kind,
    Leg,
    ScenarioError,
    builtin,
    cell_mass,
    critical_coefficient,
    dashpot_coefficients,
    driven_bodies,
    lammps_laws,
    restitution_of,
)

LOOSE = 1  # atom type of grains outside rigid groups; group g has type g + 2


def warm_up(leg: Leg) -> int:
    """Return the number of steps of zero duration before the first step."""
    return 2 if leg.state.control.cell_rate.any() or leg.state.control.cell_free.any() else 0


def digits(*numbers: float) -> str:
    """Format numbers with seventeen digits, so that they are read back exactly."""
    return " ".join(f"{number:.17g}" for number in numbers)


def atom_types(state: State) -> np.ndarray:
    """Atom type of each grain, (N,)."""
    group = state.control.group[: len(state.grains.radius)]
    return np.where(group < 0, LOOSE, group + 2)


def members_of(state: State) -> dict[int, np.ndarray]:
    """Return the indices of the grains in each rigid group, by group number."""
    group = state.control.group[: len(state.grains.radius)]
    return {int(g): np.flatnonzero(group == g) for g in np.unique(group[group >= 0])}


def is_held(state: State, members: np.ndarray) -> bool:
    """Return True if no component of a rigid group is free."""
    return not state.control.free[members[0], : state.cell.dim].any()


def leg_course(leg: Leg, column: int, elapsed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the times and values of the knots of a varying velocity between the start of a leg and an elapsed time."""
    control, begin, end = leg.state.control, leg.state.time, leg.state.time + elapsed
    times = np.array([begin, *control.knots[(control.knots > begin) & (control.knots < end)], end])
    return times, np.interp(times, control.knots, control.course[:, column])


def inertia_factor(state: State) -> float:
    """Return I0, the inertia over m R², of the grains outside rigid groups; NaN if it differs between grains."""
    grains, loose = state.grains, state.control.group[: len(state.grains.radius)] < 0
    i0 = (grains.inertia / (grains.mass * grains.radius**2))[loose]
    if not len(i0):
        return 0.4
    return float(i0[0]) if np.allclose(i0, i0[0], rtol=1e-9) else np.nan


INSTANT = 1e-200  # time step for steps without motion; `fix langevin` gives NaN for zero [time]
AXES = "xyz"
BOX = {(0, 0): "lx", (1, 1): "ly", (2, 2): "lz", (0, 1): "xy", (0, 2): "xz", (1, 2): "yz"}
Matrix = dict[tuple[int, int], str]  # upper triangular: formulas of the entries that are not zero
ONE = {(k, k): "1" for k in range(3)}


class CellCommands(NamedTuple):
    """Commands for the cell and its grains: before the run, and after the first and second steps of zero duration."""

    before: list[str]
    first: list[str]
    second: list[str]


def needs_forces(leg: Leg) -> bool:
    """Return True if the cell deforms other than by simple shear at a constant rate, or deforms with drag."""
    rate = leg.state.control.cell_rate
    return bool(leg.state.control.cell_free.any() or (rate @ rate).any() or (rate.any() and leg.drag))


def tilts_of(state: State) -> np.ndarray:
    """Return the mask (3, 3) of the transposed cell vectors: components that are or become nonzero."""
    step = np.eye(3) + (state.control.cell_rate != 0)
    return step @ step @ (state.cell.vectors.T != 0) > 0


def free_axes(state: State) -> str:
    """Axes along which the length of the cell follows the stress."""
    return "".join(AXES[k] for k in np.flatnonzero(np.diag(state.control.cell_free)))


def rates_in_log(state: State) -> str:
    """Return the columns of the log for the cell rates in the next and the previous step."""
    return "".join(f" v_cell_rate_{x} v_cell_old_{x}" for x in free_axes(state))


def cell_commands(leg: Leg, turning: float = 0.0) -> CellCommands:
    """Commands that move a cell and its grains.

    Parameters
    ----------
    turning : drag that another fix exerts on the grains and that the forces compensate [1/time]
    """
    start, dt, axes = driven_bodies(leg.state).rate, digits(leg.dt), free_axes(leg.state)
    places = np.argwhere(leg.state.control.cell_free | (start != 0)).tolist()
    rate = {(a, b): f"({digits(start[a, b])})" for a, b in places}
    later, before, control = rate.copy(), [], []
    pulls = ["compute cell_stress all pressure NULL pair", "variable zero equal 0.0"] if axes else []
    for x in axes:
        k = AXES.index(x)
        rate[k, k], later[k, k] = f"v_cell_rate_{x}", f"v_cell_next_{x}"
        # L̇ follows from the stress of contacts and from Σ m v² along the axis, which is the energy of a fix
        inertia = f"({digits(cell_mass(leg.state))}*vol^{digits(2 / leg.state.cell.dim)})"
        target = f"({digits(leg.state.control.stress[k, k])})"
        pull = f"(vol*(c_cell_stress[{k + 1}]-{target})+f_cell_twice_{x})/{inertia}"
        pulls.append(f"variable cell_pull_{x} equal {pull}")
        for name in ("old", "rate"):
            before.append(f"variable cell_{name}_{x} internal {digits(start[k, k])}")
            control.append(
                f"fix cell_{name}_{x} all controller 1 -1.0 1.0 0.0 0.0 v_cell_{name}_gain_{x} 0.0 cell_{name}_{x}"
            )
    still = [f"variable cell_{name}_gain_{x} equal 0.0" for x in axes for name in ("old", "rate")]
    begin = [f"variable cell_rate_gain_{x} equal (v_cell_next_{x}-v_cell_rate_{x})/{INSTANT}" for x in axes]
    go_on = [f"variable cell_rate_gain_{x} equal (v_cell_next_{x}-v_cell_rate_{x})/{dt}" for x in axes]
    go_on += [f"variable cell_old_gain_{x} equal (v_cell_rate_{x}-v_cell_old_{x})/{dt}" for x in axes]
    first, totals, push = _grain_commands(leg, rate, later, turning, first=True)
    course, _, _ = _grain_commands(leg, rate, later, turning)
    at_rest, moves, deform = _shape_commands(leg, rate, start)
    before += [*pulls, *first, *totals, *push, *still, *control, *at_rest, deform]
    return CellCommands(before, [*begin, *moves], [*course, *go_on])


def _product(*factors: Matrix) -> Matrix:
    first, *others = factors
    if not others:
        return first
    second, sums = _product(*others), {}
    for (a, k), left in first.items():
        for b in range(k, 3):
            if right := second.get((k, b)):
                sums.setdefault((a, b), []).append(f"{left}*{right}")
    return {place: f"({'+'.join(terms)})" for place, terms in sums.items()}


def _sum(*terms: tuple[float, Matrix]) -> Matrix:
    places = dict.fromkeys(place for _, matrix in terms for place in matrix)
    return {p: "(" + "+".join(f"({digits(f)})*{m[p]}" for f, m in terms if p in m) + ")" for p in places}


def _inverse(m: Matrix) -> Matrix:
    inverse = {(k, k): f"(1/{m[k, k]})" for k in range(3)}
    for a, b in ((0, 1), (1, 2)):
        if (a, b) in m:
            inverse[a, b] = f"(-{m[a, b]}/({m[a, a]}*{m[b, b]}))"
    corner = [f"{m[0, 1]}*{m[1, 2]}"] if {(0, 1), (1, 2)} <= m.keys() else []
    corner += [f"-{m[0, 2]}*{m[1, 1]}"] if (0, 2) in m else []
    if corner:
        inverse[0, 2] = f"(({''.join(corner)})/({m[0, 0]}*{m[1, 1]}*{m[2, 2]}))"
    return inverse


def _turn(rate: Matrix, dt: float) -> Matrix:
    """Return the matrix T, the effect of half a step at the rate L on a velocity."""
    return _product(_inverse(_sum((1, ONE), (0.25 * dt, rate))), _sum((1, ONE), (-0.25 * dt, rate)))


def _grain_commands(leg: Leg, rate: Matrix, later: Matrix, turning: float, *, first: bool = False):
    """Return coefficients, fixes for Σ m v², and the fix for forces on grains; `first` selects the first step."""
    dt, h = leg.dt, 0.5 * leg.dt
    keep, slow = 1 - h * leg.drag, 1 / (1 + h * leg.drag)  # κ and σ
    half, turn = _inverse(_sum((1, ONE), (-h, later))), _turn(rate, dt)
    ahead = _product(half, _turn(later, dt))
    v, x, kick = _sum((slow, _product(turn, _sum((1, ONE), (h, rate))))), _sum((-slow, _product(turn, rate))), slow * h
    share = 1 / dt
    if first:
        v, x, kick, share = _sum((1, ONE), (0, rate)), _sum((-1, rate)), 0.0, 2 / dt
    gain = keep * kick + h
    coefficients, totals, formulas, parts = [], [], [], []
    for axis in free_axes(leg.state):
        k = AXES.index(axis)
        ended = _row(f"cell_twice_{axis}", k, {"v": v, "x": x}, leg, coefficients)
        coefficients.append(f"variable cell_twice_f_{axis} equal {digits(kick)}")
        grown = f"v_cell_rate_{axis}*{digits(keep if first else keep * slow)}+{digits(gain)}*v_cell_pull_{axis}"
        coefficients.append(f"variable cell_next_{axis} equal {grown}")
        totals += [
            f"variable cell_twice_{axis} atom mass*({ended}+v_cell_twice_f_{axis}*f{axis}/mass)^2",
            f"fix cell_twice_{axis} all addforce 0.0 0.0 v_zero energy v_cell_twice_{axis}",
        ]
    push = {
        "v": _sum((keep * share, _product(ahead, v)), (turning - share, ONE)),
        "x": _sum((share, _product(half, later)), (keep * share, _product(ahead, x))),
    }
    force = {"f": _sum((gain * share, ahead), (-1, ONE))}
    for k, axis in enumerate(AXES[: leg.state.cell.dim]):
        if not leg.drag and not any(place[0] == k for place in rate):
            parts.append("0.0")
            continue
        moving, rest = (_row(f"cell_push_{axis}", k, terms, leg, coefficients) for terms in (push, force))
        formulas.append(f"variable cell_push_{axis} atom mass*({moving})+{rest}")
        parts.append(f"v_cell_push_{axis}")
    return coefficients, totals, [*formulas, f"fix cell_push all addforce {' '.join([*parts, '0.0'][:3])}"]


def _row(name: str, k: int, terms: dict[str, Matrix], leg: Leg, lines: list[str]) -> str:
    """Return a formula: row k of matrices times velocity, position or force; coefficients are added to `lines`."""
    parts = []
    for letter, matrix in terms.items():
        for b in range(k, leg.state.cell.dim):
            if (k, b) in matrix:
                lines.append(f"variable {name}_{letter}{AXES[b]} equal {matrix[k, b]}")
                parts.append(f"v_{name}_{letter}{AXES[b]}*{letter.replace('x', '')}{AXES[b]}")
    return "+".join(parts)


def _shape_commands(leg: Leg, rate: Matrix, now: np.ndarray) -> tuple[list[str], list[str], str]:
    """Return variables for the cell's lengths and tilts, first at rest and then in motion, and `fix deform`."""
    dt, h, start, words = leg.dt, 0.5 * leg.dt, leg.state.cell.vectors.T, []
    tilts = tilts_of(leg.state)
    stretch = _product(_inverse(_sum((1, ONE), (-h, rate))), _sum((1, ONE), (h, rate)))
    at_rest, moves, speed = [], [], now @ start
    for (a, b), text in _product(stretch, BOX).items():
        if not (tilts[a, b] if a < b else any(place[0] == a for place in rate)):
            continue
        side = AXES[a] if a == b else AXES[a] + AXES[b]
        at_rest += [f"variable cell_move_{side} equal 0.0", f"variable cell_speed_{side} equal {digits(speed[a, b])}"]
        moves += [
            f"variable cell_move_{side} equal {text}-({digits(start[a, b])})",
            f"variable cell_speed_{side} equal ({text}-{BOX[a, b]})/{digits(dt)}",
        ]
        words.append(f"{side} variable v_cell_move_{side} v_cell_speed_{side}")
    # a flip adds one vector of the cell to another, but keeps the rates of both for a step
    moving = [any((a, k) in rate for a in range(k + 1)) for k in range(3)]
    flips = not ((moving[0] and tilts[0, 1:].any()) or (moving[1] and tilts[1, 2]))
    return at_rest, moves, f"fix cell all deform 1 {' '.join(words)} remap v{'' if flips else ' flip no'}"


def read_cell(leg: Leg, following: np.ndarray, rates: np.ndarray, table):
    """Return cell, positions and velocities from the next step's cell vectors, the rates in the log, and a dump."""
    one, h, mass = np.eye(3), 0.5 * leg.dt, leg.state.grains.mass[:, None]
    later, before = driven_bodies(leg.state).rate, driven_bodies(leg.state).rate
    for n, axis in enumerate(free_axes(leg.state)):
        k = AXES.index(axis)
        later[k, k], before[k, k] = rates[2 * n : 2 * n + 2]
    vectors = following @ np.linalg.inv(np.linalg.solve(one - h * later, one + h * later)).T
    vectors[leg.state.cell.dim :] = leg.state.cell.vectors[leg.state.cell.dim :]
    x, image = table.numbers("x", "y", "z"), table.numbers("ix", "iy", "iz")
    u, kick = table.numbers("vx", "vy", "vz"), h * table.numbers("fx", "fy", "fz") / mass
    ended, begins = u - kick, u + kick  # velocities in the middle of the previous and the next step
    ended = ended - (x - h * ended) @ before.T
    begins = begins - (x + h * begins) @ later.T
    turn = np.linalg.solve(one + 0.5 * h * before, one - 0.5 * h * before)
    back = np.linalg.solve(one - 0.5 * h * later, one + 0.5 * h * later)
    velocity = 0.5 * (ended @ turn.T + begins @ back.T)
    cell = leg.state.cell._replace(vectors=vectors, rate=0.5 * (before + later))
    return cell, x + (image * cell.periodic) @ vectors, velocity


MAX_KNOTS = 64  # largest number of knots of a varying velocity in a leg
STAY = 'or use engine = "stickslip"'


def is_linear(law: Law) -> bool:
    """Return True if the normal force of a built-in law is linear in the overlap."""
    return BUILTIN_LAWS[law.kind].exponent == 1


def lacks_radius(law: Law) -> bool:
    """Return True for Hertz's law without the factor √R_eff, which LAMMPS includes."""
    return not (is_linear(law) or BUILTIN_LAWS[law.kind].uses_radius)


def check_law(law: Law, state: State) -> None:
    """Raise ScenarioError if LAMMPS has no pair style equivalent to this law."""
    if isinstance(law.kind, Kind) or name_with_radius(law) not in lammps_laws.MODELS:
        raise ScenarioError(f"LAMMPS does not have this law in stickslip's form: {STAY[3:]}")
    if law.coulomb != builtin.SHARP:
        raise ScenarioError(f'LAMMPS does not have smooth Coulomb friction: use "sharp", {STAY}')
    if len(np.unique(state.grains.material)) > 1:
        raise ScenarioError(f"the LAMMPS input written here supports grains of one material only: {STAY[3:]}")
    entry = BUILTIN_LAWS[law.kind]
    if entry.bonds:
        raise ScenarioError(f"LAMMPS separates contacts of {entry.name} at 0.48 of the pull-off gap: {STAY[3:]}")
    if law.properties & builtin.TWISTING:
        raise ScenarioError(
            "LAMMPS reverses the twisting spring to the direction of the present rate when its limit decreases: "
            f"{STAY[3:]}"
        )
    if (law.properties or entry.parameters) and not law.properties & builtin.LEVER:
        names = {builtin.KEEPS_FORCE: "a memory of forces", builtin.ROLLING: "rolling moments"}
        name = next((name for part, name in names.items() if law.properties & part), entry.name)
        raise ScenarioError(
            f'LAMMPS has {name} with lever arms R - δ/2 only: use lever = "overlap", or laws.with_lever, {STAY}'
        )
    _check_moments(law, parameters_of(law, state))
    _check_dashpots(law, parameters_of(law, state), walls=len(state.walls.mass) > 0)
    if lacks_radius(law) and np.ptp(state.grains.radius) > 1e-12 * state.grains.radius.max():
        raise ScenarioError(
            f"LAMMPS multiplies Hertz's law by √R_eff, which is constant for grains of one size only: use "
            f"hertz_mindlin_reff, {STAY}"
        )
    if builtin.rescales(law) and len(state.walls.mass):
        raise ScenarioError(f"LAMMPS computes torques at walls differently under a rescaled law: {STAY[3:]}")


def name_with_radius(law: Law) -> str:
    """Name of a law, with √R_eff if it lacks this factor."""
    name = BUILTIN_LAWS[law.kind].name
    return name.replace("hertz_mindlin", "hertz_mindlin_reff") if lacks_radius(law) else name


def _check_moments(law: Law, q: np.ndarray) -> None:
    """Raise ScenarioError if LAMMPS lacks these rolling moments."""
    values = dict(zip(builtin.parameter_names(law), q.tolist(), strict=True))
    if law.properties & builtin.ROLLING and (law.properties & builtin.VISCOUS or not values["k_roll"]):
        raise ScenarioError(f'LAMMPS does not have rolling moments without a spring: use rolling = "spring", {STAY}')
    if law.properties & builtin.ROLLING and not values["mu"]:
        raise ScenarioError(f"LAMMPS does not have rolling moments without friction: use mu > 0, {STAY}")


def _check_dashpots(law: Law, q: np.ndarray, *, walls: bool) -> None:
    """Raise ScenarioError if LAMMPS lacks these dashpots, given the parameters of contacts between grains."""
    model, entry = builtin.damping_model(law) & ~builtin.NO_TENSION, BUILTIN_LAWS[law.kind]
    rest, general = (builtin.TSUJI, builtin.RESTITUTION), (builtin.VELOCITY, builtin.MASS, builtin.VISCOELASTIC)
    usual = builtin.MASS if is_linear(law) else builtin.VISCOELASTIC
    allowed = (*general, *rest) if law.properties & builtin.LEVER else (usual,)
    if entry.parameters:
        allowed = general
    if (q[builtin.DAMPING_N] > 0 or q[builtin.DAMPING_T] > 0) and model not in allowed:
        raise ScenarioError(
            f"LAMMPS does not have these dashpots for {entry.name}: use hertz_mindlin_reff with viscoelastic dashpots, "
            f"linear with mass_velocity ones, or lever arms R - δ/2, {STAY}"
        )
    if model == builtin.RESTITUTION and dashpot_coefficients(law).max() >= critical_coefficient(law.kind):
        raise ScenarioError(
            f"LAMMPS has no dashpots strong enough for a restitution of {q[builtin.DAMPING_N]:g} with tension = "
            f"false: use at least {restitution_of(1.0, tension=False):.3f}, {STAY}"
        )
    if entry.parameters and law.damping & builtin.NO_TENSION:
        raise ScenarioError(f"LAMMPS does not allow tension = false with {entry.name}: {STAY[3:]}")
    if (is_granular(law) or walls) and model not in rest and q[builtin.DAMPING_T] > 0 and not q[builtin.DAMPING_N] > 0:
        raise ScenarioError(
            f"LAMMPS expresses damping_t {'of this law' if is_granular(law) else 'at walls'} as a multiple of "
            "damping_n: give both or neither"
        )


def is_granular(law: Law) -> bool:
    """Return True if LAMMPS has a law only in `pair_style granular`, with lever arms R − δ/2."""
    return bool(builtin.rescales(law) or law.properties)


def parameters_of(law: Law, state: State) -> np.ndarray:
    """Return the parameters of a law for contacts between grains."""
    material = state.grains.material[0] if len(state.grains.material) else 0
    return law.table[material, material]


def check_leg(leg: Leg) -> None:
    """Raise ScenarioError if LAMMPS cannot run the conditions of a leg exactly."""
    check_law(leg.law, leg.state)
    _check_order(leg)
    _check_cell(leg)
    _check_grains(leg.state)
    _check_groups(leg)
    _check_walls(leg)
    if leg.samples < 1:
        raise ScenarioError(f"samples must be at least 1, got {leg.samples}")
    if leg.samples > leg.steps and not leg.every:
        raise ScenarioError(
            f"{leg.samples} samples do not fit into {leg.steps} steps, as LAMMPS writes at most one per step: use "
            "fewer samples or a smaller dt"
        )


def _check_order(leg: Leg) -> None:
    """Raise ScenarioError if LAMMPS would reverse the memory of rolling."""
    periodic = leg.state.cell.periodic[: leg.state.cell.dim].any()
    if leg.law.properties & builtin.ROLLING and (periodic or leg.ranks > 1):
        raise ScenarioError(
            "LAMMPS reverses the memory of rolling moments where grains cross a periodic side or pass to another "
            f"process: use open sides and one process, {STAY}"
        )


def _check_cell(leg: Leg) -> None:
    state = leg.state
    control, cell = state.control, state.cell
    rate, free = control.cell_rate, control.cell_free
    if (free & ~np.eye(3, dtype=bool)).any():
        raise ScenarioError(
            "LAMMPS cannot control a shear stress by the cell, as it sums f_y r_x but not f_x r_y: control only the "
            f"lengths of the cell, {STAY}"
        )
    if np.tril(rate, -1).any() or (control.cell_follows[rate != 0] >= 0).any():
        raise ScenarioError(
            "LAMMPS does not support cell rates that vary in time or tilt along yx, zx or zy: use a constant rate "
            f"and shear along xy, xz or yz, {STAY}"
        )
    if needs_forces(leg) and (tilts := tilts_of(state))[0, 1] and tilts[1, 2]:
        raise ScenarioError(f"LAMMPS cannot tilt a cell along xy and yz at once: use one, {STAY}")
    if needs_forces(leg) and (len(state.walls.mass) or (control.group >= 0).any()):
        raise ScenarioError(
            f"LAMMPS does not support walls or rigid groups in a cell whose lengths change: leave them out, {STAY}"
        )
    if not (np.triu(cell.vectors, 1) == 0).all() or not (np.diag(cell.vectors) > 0).all():
        raise ScenarioError("LAMMPS needs a cell whose first vector is along x and whose second is in the xy plane")
    reach = 4 * float(state.grains.radius.max(initial=0.0))
    for k in np.flatnonzero(cell.periodic[: cell.dim]):
        if cell.vectors[k, k] < reach:
            raise ScenarioError(
                f"LAMMPS does not distinguish images of a grain, but the cell is only {cell.vectors[k, k]:.3g} long "
                f"along {'xyz'[k]}: use a cell at least two diameters long"
            )


def _check_grains(state: State) -> None:
    control, n = state.control, len(state.grains.radius)
    loose = control.group[:n] < 0
    used = [*range(state.cell.dim), *range(6 - (3 if state.cell.dim == 3 else 1), 6)]
    if not control.free[:n][loose][:, used].all():
        raise ScenarioError(
            f"the LAMMPS input written here cannot hold or drive single grains: make them a rigid group, {STAY}"
        )
    if control.force[:n][loose].any() or control.torque[:n].any() or control.spring[:n][loose].any():
        raise ScenarioError(f"the LAMMPS input written here does not support forces on single grains: {STAY[3:]}")
    i0 = inertia_factor(state)
    if not (np.isclose(i0, 0.4, rtol=1e-9) or (state.cell.dim == 2 and np.isclose(i0, 0.5, rtol=1e-9))):
        raise ScenarioError(
            f"LAMMPS has I0 = 2/5 and, in two dimensions, 1/2, but not {i0:.4g}: use one of these, {STAY}"
        )


def _check_groups(leg: Leg) -> None:
    control, dim = leg.state.control, leg.state.cell.dim
    for members in members_of(leg.state).values():
        free, follows = control.free[members[0], :dim], control.follows[members[0], :dim]
        if free.any() and (follows[~free] >= 0).any():
            raise ScenarioError(
                "the LAMMPS input written here does not support a plate moved by a force along one axis and by a "
                f"varying velocity along another: use a constant velocity, {STAY}"
            )
        if control.free[members, 3:].any():
            raise ScenarioError(f"the LAMMPS input written here does not support rotating rigid groups: {STAY[3:]}")
        if is_held(leg.state, members):
            for k in range(dim):
                _check_course(leg, int(follows[k]))


def _check_walls(leg: Leg) -> None:
    state, n = leg.state, len(leg.state.grains.radius)
    if state.control.free[n:, : state.cell.dim].any():
        raise ScenarioError(
            "LAMMPS moves walls at prescribed velocities only, not by forces: use a plate, which is a rigid body of "
            f"grains, {STAY}"
        )
    for column in np.unique(state.control.follows[n:, :3]):
        _check_course(leg, int(column))


def _check_course(leg: Leg, column: int) -> None:
    """Raise ScenarioError if a varying velocity has too many knots for a formula."""
    if column < 0 or column in leg.waves:
        return
    inside = len(leg_course(leg, column, leg.steps * leg.dt)[0]) - 2
    if inside > MAX_KNOTS:
        raise ScenarioError(
            f"LAMMPS evaluates a varying velocity as a formula, here with {inside} knots in one leg: use at most "
            f"{MAX_KNOTS}, {STAY}"
        )
