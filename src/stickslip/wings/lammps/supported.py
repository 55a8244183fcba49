"""Conditions that LAMMPS can run, and error messages for those that it cannot."""

import numpy as np

from ... import Law, State
from ...kit import (
    BUILTIN_LAWS,
    Kind,
    Leg,
    ScenarioError,
    builtin,
    critical_coefficient,
    dashpot_coefficients,
    lammps_laws,
    restitution_of,
)
from .cell import inertia_factor, is_held, leg_course, members_of, needs_forces, tilts_of

MAX_KNOTS = 64  # largest number of knots of a varying velocity in a leg
STAY = 'or use engine = "stickslip"'


def is_linear(law: Law) -> bool:
    """Return True if the normal force of a built-in law is linear in the overlap."""
    return BUILTIN_LAWS[law.kind].exponent == 1


def lacks_radius(law: Law) -> bool:
    """Return True for Hertz's law without the √R_eff by which LAMMPS multiplies it."""
    return not (is_linear(law) or BUILTIN_LAWS[law.kind].uses_radius)


def check_law(law: Law, state: State) -> None:
    """Raise ScenarioError if LAMMPS has no pair style equivalent to this law."""
    if isinstance(law.kind, Kind) or name_with_radius(law) not in lammps_laws.MODELS:
        raise ScenarioError(f"LAMMPS does not have this law in stickslip's form: {STAY[3:]}")
    if law.coulomb != builtin.SHARP:
        raise ScenarioError(f'LAMMPS does not have smooth Coulomb friction: use "sharp", {STAY}')
    if len(np.unique(state.grains.material)) > 1:
        raise ScenarioError(f"the LAMMPS input written here supports grains of one material only: {STAY[3:]}")
    _check_memory(law)
    _check_moments(law, parameters_of(law, state))
    _check_dashpots(law, parameters_of(law, state), walls=len(state.walls.mass) > 0)
    if lacks_radius(law) and np.ptp(state.grains.radius) > 1e-12 * state.grains.radius.max():
        raise ScenarioError(
            f"LAMMPS multiplies Hertz's law by √R_eff, which is constant for grains of one size only: use "
            f"hertz_mindlin_reff, {STAY}"
        )
    if builtin.rescales(law) and len(state.walls.mass):
        raise ScenarioError(f"LAMMPS has other torques at walls under a rescaled law: {STAY[3:]}")


def name_with_radius(law: Law) -> str:
    """Name of a law, with √R_eff if it lacks this factor."""
    name = BUILTIN_LAWS[law.kind].name
    return name.replace("hertz_mindlin", "hertz_mindlin_reff") if lacks_radius(law) else name


def _check_memory(law: Law) -> None:
    """Raise ScenarioError if LAMMPS treats contact memory differently."""
    if BUILTIN_LAWS[law.kind].bonds:
        raise ScenarioError(
            f"LAMMPS separates contacts of {BUILTIN_LAWS[law.kind].name} at 0.48 of the pull-off gap: {STAY[3:]}"
        )
    if law.properties & builtin.TWISTING:
        raise ScenarioError(
            "LAMMPS reverses the twisting spring to the direction of the present rate when its limit decreases: "
            f"{STAY[3:]}"
        )
    granular = law.properties or BUILTIN_LAWS[law.kind].parameters
    if granular and not law.properties & builtin.LEVER:
        names = {builtin.KEEPS_FORCE: "a memory of forces", builtin.ROLLING: "rolling moments"}
        name = next((name for part, name in names.items() if law.properties & part), BUILTIN_LAWS[law.kind].name)
        raise ScenarioError(
            f'LAMMPS has {name} with lever arms R - δ/2 only: use lever = "overlap", or laws.with_lever, {STAY}'
        )


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
            f"LAMMPS needs stronger dashpots than it has for a restitution of {q[builtin.DAMPING_N]:g} with tension = "
            f"false: use at least {restitution_of(1.0, tension=False):.3f}, {STAY}"
        )
    if entry.parameters and law.damping & builtin.NO_TENSION:
        raise ScenarioError(f"LAMMPS does not allow tension = false with {entry.name}: {STAY[3:]}")
    if (is_granular(law) or walls) and model not in rest and q[builtin.DAMPING_T] > 0 and not q[builtin.DAMPING_N] > 0:
        raise ScenarioError(
            f"LAMMPS expresses damping_t of {'this law' if is_granular(law) else 'walls and a law'} as a multiple of "
            "damping_n: give both or neither"
        )


def is_granular(law: Law) -> bool:
    """Return True if LAMMPS has a law only in `pair_style granular`, with lever arms R − δ/2."""
    return bool(builtin.rescales(law) or law.properties)


def parameters_of(law: Law, state: State) -> np.ndarray:
    """Parameters of contacts between grains."""
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
        raise ScenarioError("LAMMPS needs a cell whose first vector is along x and second one in the xy plane")
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
        raise ScenarioError(f"forces on single grains are not translated for LAMMPS: {STAY[3:]}")
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
                "a plate moved by a force along one axis and by a varying velocity along another is not translated "
                f"for LAMMPS: use a constant velocity, {STAY}"
            )
        if control.free[members, 3:].any():
            raise ScenarioError(f"rotating rigid groups are not translated for LAMMPS: {STAY[3:]}")
        if is_held(leg.state, members):
            for k in range(dim):
                _check_course(leg, int(follows[k]))


def _check_walls(leg: Leg) -> None:
    state, n = leg.state, len(leg.state.grains.radius)
    if state.control.free[n:, : state.cell.dim].any():
        raise ScenarioError(
            "LAMMPS moves walls at prescribed velocities only, not by forces: use a plate, whose grains are a rigid "
            f"body, {STAY}"
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
