"""LAMMPS input for a leg: a data file of its grains, and commands for law, walls, plates, loads and output."""

from pathlib import Path

import numpy as np

from ... import Law
from ...kit import BY_NAME, Leg, builtin, driven_bodies, lammps_laws, wrapped_into
from .supported import (
    INSTANT,
    LOOSE,
    CellCommands,
    atom_types,
    cell_commands,
    digits,
    inertia_factor,
    is_granular,
    is_held,
    is_linear,
    lacks_radius,
    leg_course,
    members_of,
    name_with_radius,
    needs_forces,
    parameters_of,
    rates_in_log,
    warm_up,
)

INPUT, DATA, BEFORE, PREPARE = "in.lammps", "grains.data", "before.restart", "in.prepare"
SAMPLE, PLACES = "sample.*.restart", "places.*.dump"
ROTATION = 10 / 3  # LAMMPS's `fix langevin` damps the rotation of spheres by this multiple of the drag
SPHERE = 0.4  # I0 assumed by `fix langevin`


def format_data(leg: Leg) -> str:
    """Format a data file of `atom_style sphere`; velocities include the flow of a deforming cell."""
    state, grains = leg.state, leg.state.grains
    inside, image, corner, size = _box(leg)
    vectors = state.cell.vectors
    density = grains.mass / (4 / 3 * np.pi * grains.radius**3)
    types, moving, n = atom_types(state), driven_bodies(state), len(density)
    velocity, spin = moving.velocity[:n] + inside @ moving.rate.T, moving.spin[:n]
    atoms = [
        f"{k + 1} {types[k]} {digits(2 * grains.radius[k], density[k], *inside[k])} {' '.join(map(str, image[k]))}"
        for k in range(len(density))
    ]
    motion = [f"{k + 1} {digits(*velocity[k], *spin[k])}" for k in range(len(density))]
    head = [
        "Grains: type 1 is loose, others are rigid groups", "", f"{len(density)} atoms",
        f"{int(types.max(initial=LOOSE))} atom types", "",
        *(f"{digits(corner[k], corner[k] + size[k])} {a}lo {a}hi" for k, a in enumerate("xyz")),
    ]  # fmt: skip
    if np.tril(vectors, -1).any() or leg.state.control.cell_rate.any():
        head.append(f"{digits(vectors[1, 0], vectors[2, 0], vectors[2, 1])} xy xz yz")
    return "\n".join([*head, "", "Atoms # sphere", "", *atoms, "", "Velocities", "", *motion, ""])


def _box(leg: Leg):
    """Return positions inside the box, the numbers of periods subtracted, and the corner and lengths of the box."""
    state, grains = leg.state, leg.state.grains
    periodic, vectors = state.cell.periodic, state.cell.vectors.copy()
    corner = np.zeros(3)
    inside, image = wrapped_into(grains.position, vectors, corner, periodic)
    size, reach = np.diag(vectors).copy(), 2 * float(grains.radius.max())
    for k in range(3):
        if not periodic[k]:
            corner[k] = inside[:, k].min() - reach
            size[k] = inside[:, k].max() + reach - corner[k]
    if state.cell.dim == 2:
        corner[2], size[2] = -0.5 * reach, reach
    return inside, image, corner, size


def write_input(leg: Leg, folder: Path, *, begin: str = DATA) -> Path:
    """Write the input of a leg to a folder; `mpirun -np 4 lmp -in in.lammps` runs it there.

    Parameters
    ----------
    begin : file from which the leg starts: the data file, which is then written too, or a restart file
    """
    folder.mkdir(parents=True, exist_ok=True)
    if begin == DATA:
        (folder / DATA).write_text(format_data(leg), encoding="utf-8")
    path = folder / INPUT
    path.write_text(format_input(leg, begin), encoding="utf-8")
    return path


def format_input(leg: Leg, begin: str = DATA) -> str:
    """Return the commands of a leg, including those for output and `run`."""
    first, moving = warm_up(leg), _moving_cell(leg)
    # two steps of zero duration, so that the first forces depend on the initial rate and vectors of the cell
    between = "\n".join(["run 1", *moving.first, "run 1 pre no", *moving.second]) if moving.before else "run 2"
    warming = f"timestep {INSTANT}\n{between}\ntimestep {digits(leg.dt)}\n"
    times = f"every {leg.every} steps, and at the end" if leg.every else f"at {leg.samples} times"
    return f"""{contact_commands(leg, begin)}
{motion_commands(leg)}
# a state is written to a restart file and a line to the log {times}
variable sample equal {_next_sample(leg, f"(step-{first})" if first else "step")}{f"+{first}" if first else ""}
restart v_sample {SAMPLE}
thermo_style custom step xlo xhi ylo yhi zlo zhi xy xz yz{rates_in_log(leg.state)}
thermo_modify format float %.17g flush yes norm no
thermo v_sample
{_place_commands(leg)}{warming if first else ""}run {leg.steps}{" pre no" if first else ""}
"""


def _next_sample(leg: Leg, step: str) -> str:
    """Formula for the step of the next sample: see `Leg.sample_steps`."""
    if leg.every:
        following = f"(floor({step}/{leg.every})+1)*{leg.every}"
        return f"ternary(({following}>{leg.steps})&&({step}<{leg.steps}),{leg.steps},{following})"
    past, done = leg.before
    count, steps = past + leg.samples, done + leg.steps
    here, back = (f"({step}+{done})", f"-{done}") if done else (step, "")
    return f"round((round({here}*{count}/{steps})+1)*{steps}/{count}){back}"


def _moving_cell(leg: Leg) -> CellCommands:
    """Commands for a cell that deforms other than in simple shear; empty for other cells."""
    return cell_commands(leg, _rotation_drag(leg)) if needs_forces(leg) else CellCommands([], [], [])


def format_preparation(leg: Leg) -> str:
    """Return commands that convert the data file to a restart file; `lammps_restart` then adds the contact memory."""
    return f"{contact_commands(leg)}\nfix move all nve/sphere\nrun 0\nwrite_restart {BEFORE}\n"


def contact_commands(leg: Leg, begin: str = DATA) -> str:
    """Return commands that read the grains and set the law of contacts between grains and with walls."""
    state = leg.state
    letters = " ".join("p" if p else "m" for p in state.cell.periodic[: state.cell.dim])
    new = begin == DATA
    read = (
        f"units si\ndimension {state.cell.dim}\natom_style sphere\nboundary {letters}{' p' * (3 - state.cell.dim)}"
        if new
        else f"# {state.cell.dim} dimensions"
    )
    load = f"read_data {DATA}" if new else f"read_restart {begin}"
    order = "atom_modify sort 0 0\n" if leg.law.properties & builtin.ROLLING else ""  # sorting would reverse the memory
    walls = []
    for k, number in enumerate(leg.wall_numbers):  # a region for each wall, with its own friction
        name, body = f"wall{number}", len(state.grains.radius) + k
        course = _course_commands(leg, body, name)
        walls += [moved for moved, _ in course.values()]
        moves = " move " + " ".join(f"v_{name}_d{a}" if a in course else "NULL" for a in "xyz") if course else ""
        walls.append(f"region {name} plane {digits(*state.walls.point[k], *state.walls.normal[k])}{moves}")
        q = leg.law.table[state.grains.material[0], state.walls.material[k]]
        model = granular_style(leg.law, _coefficients(leg.law, q, float(state.grains.radius[0])))
        walls.append(f"fix {name} all wall/gran/region granular {model} region {name}")
    wall_commands = "\n".join(walls)
    exclude = "".join(f" exclude type {g + 2} {g + 2}" for g in members_of(state))
    return f"""{read}
{order}newton off
{load}
reset_timestep 0
timestep {digits(leg.dt)}
comm_modify vel yes
neighbor {digits(leg.skin)} bin
neigh_modify delay 0 every 1 check yes{exclude}
{pair_commands(leg.law, leg)}
{wall_commands}"""


def _coefficients(law: Law, q, radius: float) -> dict[str, float]:
    """Return parameters by name; k_n and k_t are divided by √R_eff if LAMMPS adds this factor to the law."""
    share = np.sqrt(radius) if lacks_radius(law) else 1.0
    values = dict(zip(builtin.parameter_names(law), q.tolist(), strict=True))
    return values | {"kn": values["kn"] / share, "kt": values["kt"] / share}


def pair_commands(law: Law, leg: Leg) -> str:
    """Pair style of a law: `gran/hooke/history`, `gran/hertz/history`, or `granular` for all other laws."""
    radius = 0.5 * float(leg.state.grains.radius[0])
    values = _coefficients(law, parameters_of(law, leg.state), radius)
    if is_granular(law):
        return f"pair_style granular\npair_coeff * * {granular_style(law, values)}"
    style = "hooke" if is_linear(law) else "hertz"
    numbers = digits(*(values[name] for name in ("kn", "kt", "damping_n", "damping_t", "mu")))
    return f"pair_style gran/{style}/history {numbers} 1{_tension_option(law)}\npair_coeff * *"


def _tension_option(law: Law) -> str:
    return " limit_damping" if law.damping & builtin.NO_TENSION else ""


def granular_style(law: Law, values: dict[str, float]) -> str:
    """Return a law as text for `pair_style granular`; γ_t is relative to γ_n, and E is that of grains with ν = 0."""
    name = name_with_radius(law)
    (normal, tangential), damping_n, share = lammps_laws.MODELS[name], values["damping_n"], values["damping_t"]
    damping = next(word for word, model in builtin.DAMPING.items() if model == law.damping & ~builtin.NO_TENSION)
    if damping in lammps_laws.RESTITUTION:
        damping_n, damping = lammps_laws.as_restitution(name, law.damping, damping_n), "coeff_restitution"
    else:
        if not is_granular(law) and not (damping_n or share):
            damping = BY_NAME[name].damping
        share = share / damping_n if damping_n > 0 else 0.0
    kn = [values["kn"], damping_n]
    if "work" in values:
        kn = [1.5 * values["kn"], damping_n, 0.0, values["work"] / 2]
    force = lammps_laws.FORCE if law.properties & builtin.KEEPS_FORCE else ""
    part, names = lammps_laws.SDS["rolling"]
    rolling = f" rolling sds {digits(*(values[name] for name in names))}" if law.properties & part else ""
    return (
        f"{normal} {digits(*kn)} tangential {tangential}{force} {digits(values['kt'], share, values['mu'])} "
        f"damping {damping}{rolling}{_tension_option(law)}"
    )


def _course_commands(leg: Leg, body: int, name: str) -> dict[str, tuple[str, str]]:
    """Variables for the displacement and velocity of a driven body along each axis of its motion.

    The velocity is the mean over the step.
    """
    control, variables = leg.state.control, {}
    for k, axis in enumerate("xyz"[: leg.state.cell.dim]):
        if control.rate[body, k]:
            moved, before = (
                displacement_formula(leg, control.rate[body, k], int(control.follows[body, k]), step)
                for step in ("step", "(step-1)")
            )
            variables[axis] = (
                f"variable {name}_d{axis} equal {moved}",
                f"variable {name}_v{axis} equal ({moved}-({before}))/dt",
            )
    return variables


def displacement_formula(leg: Leg, rate: float, column: int, step: str = "step") -> str:
    """Return a formula for the displacement since the start of the leg, as a function of the step."""
    time, begin = f"({step}*dt)", leg.state.time
    if column < 0:
        return f"{digits(rate)}*{time}"
    if wave := leg.waves.get(column):
        turn = 2 * np.pi * wave.frequency
        phase = turn * (begin - wave.start) + wave.phase
        angle = f"({digits(turn)}*{time}+{digits(phase)})"
        return f"{digits(rate * wave.amplitude / turn)}*({digits(np.cos(phase))}-cos{angle})"
    edges, values = leg_course(leg, column, leg.steps * leg.dt)
    values = rate * values
    parts = [f"{digits(values[0])}*{time}"]
    for a, b, low, high in zip(edges[:-1] - begin, edges[1:] - begin, values[:-1], values[1:], strict=True):
        slope = (high - low) / (b - a)
        if slope:  # the velocity increases by slope (t − a) up to b, and then stays constant
            part = f"ternary({time}<{digits(a)},0,ternary({time}>{digits(b)},{digits(b - a)},{time}-{digits(a)}))"
            later = f"ternary({time}>{digits(b)},{time}-{digits(b)},0)"
            parts.append(f"{digits(0.5 * slope)}*{part}*{part}+{digits(high - low)}*{later}")
    return "+".join(parts)


def motion_commands(leg: Leg) -> str:
    """Commands for gravity, drag, plates, springs, the cell, and the integration of loose grains."""
    lines = [f"group loose type {LOOSE}"]
    gravity = leg.state.control.gravity
    if gravity.any():
        lines.append(f"fix gravity all gravity {digits(np.linalg.norm(gravity))} vector {digits(*gravity)}")
    lines += _moving_cell(leg).before  # must come first: it uses forces that are due to contacts and gravity only
    lines += _drag_commands(leg) if leg.drag else []
    lines += _plate_commands(leg)
    disc = " disc" if leg.state.cell.dim == 2 and abs(inertia_factor(leg.state) - SPHERE) > 1e-6 else ""
    lines.append(f"fix loose loose nve/sphere{disc}")
    # simple shear: `fix deform` deforms the cell at the end of a step, after the forces, and changes the velocity of
    # grains that cross a boundary; its input is the tilt of the next step
    rate, tilts = leg.state.control.cell_rate, []
    for a, b in zip(*np.nonzero(rate), strict=True) if not needs_forces(leg) else ():
        name, speed = f"{'xyz'[a]}{'xyz'[b]}", digits(rate[a, b] * leg.state.cell.vectors[b, b])
        lines.append(f"variable tilt_{name} equal {speed}*{digits(leg.dt)}*(step-1)")
        lines.append(f"variable rate_{name} equal {speed}")
        tilts.append(f"{name} variable v_tilt_{name} v_rate_{name}")
    if tilts:
        lines.append(f"fix cell all deform 1 {' '.join(tilts)} remap v")
    if leg.state.cell.dim == 2:
        lines.append("fix plane all enforce2d")
    if leg.ranks > 1 and not leg.state.cell.periodic[: leg.state.cell.dim].all():
        axes = "xyz"[: leg.state.cell.dim]
        lines.append(f"fix balance all balance 1000 1.1 shift {axes} 10 1.05")
    return "\n".join(lines)


def _rotation_drag(leg: Leg) -> float:
    """Return the drag of `fix langevin` for which rotations have the drag of the leg."""
    return leg.drag * inertia_factor(leg.state) / (ROTATION * SPHERE)


def _drag_commands(leg: Leg) -> list[str]:
    """Return commands for drag: −m ν v by `addforce`, and −I ν ω by `langevin` without noise, which also drags v."""
    nu, turning = leg.drag, _rotation_drag(leg)
    lines = [f"fix slow loose langevin 0.0 0.0 {digits(1 / turning)} 1 omega yes"]
    if needs_forces(leg):
        return lines
    for axis in "xyz"[: leg.state.cell.dim]:
        lines.append(f"variable slow_{axis} atom -{digits(nu)}*mass*v{axis}")
        lines.append(f"variable rest_{axis} atom -{digits(nu - turning)}*mass*v{axis}")
    third = "" if leg.state.cell.dim == 3 else "0.0"
    lines.append(f"fix drag loose addforce v_rest_x v_rest_y {third or 'v_rest_z'}")
    moving = [g + 2 for g, members in members_of(leg.state).items() if not is_held(leg.state, members)]
    if moving:
        lines.append(f"group slowed type {' '.join(map(str, moving))}")
        lines.append(f"fix drag_plates slowed addforce v_slow_x v_slow_y {third or 'v_slow_z'}")
    return lines


def _plate_commands(leg: Leg) -> list[str]:
    """Return commands for plates: held plates are frozen (infinitely heavy) and moved, others are rigid and loaded."""
    state = leg.state
    lines, held, moving = [], [], []
    for g, members in members_of(state).items():
        name = f"plate{g}"
        lines.append(f"group {name} type {g + 2}")
        if is_held(state, members):
            held.append((g, name, members))
        else:
            moving.append((g, name, members))
            lines += _load_commands(leg, name, members)
    if held:
        lines.append(f"group held type {' '.join(str(g + 2) for g, _, _ in held)}")
        lines.append("fix held held freeze")
        for _, name, members in held:
            lines += _held_commands(leg, name, members[0])
    if moving:
        flags = []
        for number, (_, _, members) in enumerate(moving, 1):
            free = state.control.free[members[0], :3] & (np.arange(3) < state.cell.dim)
            flags.append(f"force {number} {' '.join('on' if f else 'off' for f in free)}")
        names = " ".join(name for _, name, _ in moving)
        lines.append(f"group moving type {' '.join(str(g + 2) for g, _, _ in moving)}")
        lines.append(f"fix plates moving rigid group {len(moving)} {names} {' '.join(flags)} torque * off off off")
    return lines


def _held_commands(leg: Leg, name: str, body: int) -> list[str]:
    """Return commands for the prescribed motion of a held plate."""
    course = _course_commands(leg, body, name)
    if not course:
        return [f"velocity {name} set 0.0 0.0 0.0"]
    control, dim = leg.state.control, leg.state.cell.dim
    if (control.follows[body, :dim] < 0).all():
        return [f"fix move{leg.number}_{name} {name} move linear {digits(*control.rate[body, :3])}"]
    lines = [line for pair in course.values() for line in pair]
    lines += [f"variable {name}_{w}{a} equal 0.0" for a in "xyz"[:dim] if a not in course for w in "dv"]
    third = [] if dim == 3 else ["NULL"]
    moved, speed = (" ".join([*(f"v_{name}_{w}{a}" for a in "xyz"[:dim]), *third]) for w in "dv")
    return [*lines, f"fix move{leg.number}_{name} {name} move variable {moved} {speed}"]


def _load_commands(leg: Leg, name: str, members: np.ndarray) -> list[str]:
    """Return commands for velocities along driven axes, and for forces and springs, shared equally, along free axes."""
    control, body, n = leg.state.control, members[0], len(members)
    free = control.free[body, :3] & (np.arange(3) < leg.state.cell.dim)
    lines, parts = [], []
    speeds = ["NULL" if f else digits(control.rate[body, k]) for k, f in enumerate(free)]
    lines.append(f"velocity {name} set {' '.join(speeds)}")
    for k, axis in enumerate("xyz"):
        share = control.force[members, k].sum() / n
        stiffness = control.spring[members, k].sum()
        if free[k] and stiffness > 0:
            # LAMMPS provides the centre of mass, at a constant distance from the mean position of the grains
            position, mass = leg.state.grains.position[members, k], leg.state.grains.mass[members]
            anchor = digits(control.anchor[members, k].mean() + (mass @ (position - position.mean())) / mass.sum())
            lines.append(f"variable {name}_lead{axis} equal {lead_formula(leg, int(control.leads[body, k]))}")
            stretch = f"({anchor}+v_{name}_lead{axis}-xcm({name},{axis}))"
            lines.append(f"variable {name}_pull{axis} equal {digits(stiffness)}*{stretch}")
            lines.append(f"variable {name}_share{axis} equal {digits(share)}+v_{name}_pull{axis}/{n}")
            parts.append(f"v_{name}_share{axis}")
        else:
            parts.append(digits(share if free[k] else 0.0))
    return [*lines, f"fix push_{name} {name} addforce {' '.join(parts)}"]


def lead_formula(leg: Leg, column: int) -> str:
    """Return a formula for the displacement of a spring's load point, linear between knots."""
    if column < 0:
        return "0.0"
    time, begin, (edges, values) = "(step*dt)", leg.state.time, leg_course(leg, column, leg.steps * leg.dt)
    slopes = np.diff(values) / np.diff(edges)
    parts = [f"{digits(values[0])}+{digits(slopes[0])}*{time}"]
    for when, before, after in zip(edges[1:-1] - begin, slopes[:-1], slopes[1:], strict=True):
        parts.append(f"{digits(after - before)}*ternary({time}>{digits(when)},{time}-{digits(when)},0)")
    return "+".join(parts)


def _place_commands(leg: Leg) -> str:
    """Return commands that dump positions if the cell deforms, because restart files then lack image numbers."""
    if not warm_up(leg):
        return ""
    columns = "x y z ix iy iz vx vy vz fx fy fz" if needs_forces(leg) else "xu yu zu"
    how = "every v_sample sort id format float %.17g"
    return f"dump places all custom 1 {PLACES} id {columns}\ndump_modify places {how}\n"
