"""Preparation of a gouge sample, and the dimensionless numbers of an experiment, each with its defining formula.

Grains are poured, pressed between flat walls, glued into rough plates, and pressed again with friction. The lowest and
highest grains of the pressed sample form the plates, which are rigid bodies without rotation. x is the direction of
shear, y that of the normal stress, and z the transverse direction. The lower plate is fixed. The upper plate is pressed
along y, fixed along z, and fixed, driven or pulled by a spring along x.
"""

from typing import NamedTuple

import numpy as np

from .... import FROZEN, Grains, Law, State, assembly, box, flat_walls, forces, run, spheres
from ....control import driven, force_controlled, loads, rigid, spring_loaded
from ....kit import Report, ScenarioError, builtin, make_law, silent
from ....measure import contact_forces, elastic_energy, inertial_number, stable_time_step, touching, unbalanced_forces
from ....packings import without_walls
from .scenario import GougeScenario

# limits of the range in which shear is quasi-static, grains are hard, and plates do not dominate the layer
INERTIAL, STIFFNESS, OVERLAP, LAYER = 1e-3, 100.0, 0.02, 8.0
LONG = 0.4  # fraction of the largest stable time step above which errors at the stiffest contacts exceed one per cent


def stiffness(scenario: GougeScenario, value: float | None = None, definition: str | None = None) -> float:
    """Stiffness k of the spring per plate area [Pa/m], from `value` in terms of `definition`.

    The default is the scenario's stiffness. Definitions are per_area, k; per_stress, k/σ; grain, k D/σ; and rate_state,
    k dc/(b σ).

    Examples
    --------
    The stiffness of 425 in Ferdowsi & Rubin 2021, read as `rate_state`, in units of σ/D:

    >>> import stickslip as ss
    >>> slide = {"kind": "slide", "velocity": 0.1, "slip": 1.0}
    >>> paper = ss.scenario(experiment="gouge", law={"damping_n": 1e4}, protocol=[slide])
    >>> k = stiffness(paper, 425.0, "rate_state")
    >>> round(k * paper.grains.mean / paper.load.normal_stress, 2)
    4.28
    """
    load = scenario.load
    value, definition = (load.stiffness, load.definition) if value is None else (value, definition)
    return value * _unit(scenario, definition)


def normalised_stiffness(scenario: GougeScenario) -> dict[str, float]:
    """Return the scenario's stiffness by every definition; see `stiffness`."""
    return {
        name: stiffness(scenario) / _unit(scenario, name) for name in ("per_area", "per_stress", "grain", "rate_state")
    }


def _unit(scenario: GougeScenario, definition: str) -> float:
    stress, scales = scenario.load.normal_stress, scenario.scales
    return {
        "per_area": 1.0,
        "per_stress": stress,
        "grain": stress / scenario.grains.mean,
        "rate_state": scales.b * stress / scales.dc,
    }[definition]


def normalised_hold(scenario: GougeScenario, hold: float, velocity: float) -> dict[str, float]:
    """Return a hold time t after sliding at V, normalised by every definition.

    Definitions are load_point, V t/dc; frozen, k V t/(a σ), which governs the decay of velocity in a hold with frozen
    state; and inertial, t/(D √(ρ/σ)). Ferdowsi & Rubin 2021 quote 1650 without a definition.
    """
    stress, scales, grains = scenario.load.normal_stress, scenario.scales, scenario.grains
    return {
        "load_point": velocity * hold / scales.dc,
        "frozen": stiffness(scenario) * velocity * hold / (scales.a * stress),
        "inertial": hold / (grains.mean * np.sqrt(grains.density / stress)),
    }


def inertial_numbers(scenario: GougeScenario, velocity: float, thickness: float) -> dict[str, float]:
    """Return the inertial number at a plate velocity V and a thickness H [m] by every definition.

    Definitions are mean_grain, (V/H) D √(ρ/σ) with the mean diameter, on which warnings are based; largest_grain, the
    same with the largest diameter; and slip, V √(ρ/σ), for shear localised in one layer of grains.
    """
    grains, stress = scenario.grains, scenario.load.normal_stress
    sizes = {"mean_grain": grains.mean, "largest_grain": grains.diameter[1], "slip": thickness}
    return {
        name: inertial_number(velocity / thickness, stress, diameter=size, density=grains.density)
        for name, size in sizes.items()
    }


class Range(NamedTuple):
    """Dimensionless numbers for the quasi-static limit, the hardness of grains, and the size of the layer."""

    inertial_number: float  # (V/H) D √(ρ/σ) at the largest velocity V
    stiffness: float  # (E/((1 − ν²) σ))^(2/3), about D over the overlap
    overlap: float  # mean overlap of contacts over D
    thickness: float  # H/D
    length: float  # length of the cell over D
    time_step: float  # dt over the largest stable time step

    @property
    def warnings(self) -> list[str]:
        """One sentence for each number outside the range in which it does not affect results."""
        said = []
        if self.inertial_number > INERTIAL:
            said.append(
                f"the inertial number reaches {self.inertial_number:.1e}, above {INERTIAL:g}: shear is no longer "
                f"quasi-static; use lower velocities"
            )
        if self.stiffness < STIFFNESS or self.overlap > OVERLAP:
            said.append(
                f"grains overlap by {self.overlap:.1%} of a diameter, and (E/((1 − ν²) σ))^(2/3) = "
                f"{self.stiffness:.3g}: grains count as hard below {OVERLAP:.0%} and above {STIFFNESS:g}; use a larger "
                f"young"
            )
        if self.time_step > LONG:
            said.append(f"dt is {self.time_step:.2f} of the largest stable time step: use a shorter dt")
        for name, value in (("thickness", self.thickness), ("length", self.length)):
            if value < LAYER:
                said.append(
                    f"the {name} of the layer is {value:.0f} D: below {LAYER:g} D, plates and periodic images affect "
                    f"the results; use more grains or a longer cell"
                )
        return said


def make_range(scenario: GougeScenario, velocity: float, thickness: float, overlap: float, stable: float) -> Range:
    """Return the Range of a sample, given thickness [m], mean overlap over D, and largest stable time step [s]."""
    grains, law, stress = scenario.grains, scenario.law, scenario.load.normal_stress
    return Range(
        inertial_numbers(scenario, velocity, thickness)["mean_grain"],
        (law.young / ((1 - law.poisson**2) * stress)) ** (2 / 3),
        overlap, thickness / grains.mean, scenario.cell.length / grains.mean, scenario.dt / stable,
    )  # fmt: skip


SPACING = 1.05  # spacing of the lattice on which grains are placed, in units of the largest diameter
CHUNK = 500  # number of steps between checks of a settling sample
MAX_KINETIC_RATIO = 1e-3  # largest ratio of kinetic to elastic energy at rest
BOTTOM, TOP = 0, 1  # indices of the rigid groups


class Gouge(NamedTuple):
    """Sample of gouge between two rough plates."""

    state: State  # rigid groups BOTTOM and TOP, the latter pressed along y
    law: Law
    area: float  # area of a plate [m²]
    normal_stress: float  # [Pa]
    diameter: float  # D, mean of the diameter distribution [m]
    leg: str = ""  # name of the leg that ends with this state

    @property
    def top(self) -> np.ndarray:
        """Indices of the grains of the upper plate."""
        return np.flatnonzero(self.state.control.group == TOP)

    @property
    def loose(self) -> np.ndarray:
        """Indices of the mobile grains."""
        return np.flatnonzero(self.state.control.group[: len(self.state.grains.radius)] < 0)

    @property
    def thickness(self) -> float:
        """Distance between the mean heights of the two plates' grains [m]."""
        y, group = self.state.grains.position[:, 1], self.state.control.group
        return float(y[group == TOP].mean() - y[group == BOTTOM].mean())


def gouge_law(scenario: GougeScenario, mu: float) -> Law:
    """Return a scenario's contact law with friction `mu`."""
    chosen, meeting = scenario.law, {}
    if chosen.size is not None:
        meeting = {"radius": chosen.size / 2, "mass": scenario.grains.density * np.pi / 6 * chosen.size**3}
    return builtin.with_values(make_law(chosen, **meeting), mu=mu)


def damping(scenario: GougeScenario) -> float:
    """Damping γ_n of a scenario, stated or computed from its restitution [1/(m s)]."""
    return float(gouge_law(scenario, 0.0).table[0, 0, builtin.DAMPING_N])


def prepare_sample(scenario: GougeScenario, seed: int, *, report: Report = silent) -> Gouge:
    """Prepare a sample with friction, at rest under its normal stress and before any shear.

    Raises
    ------
    ScenarioError
        If dt is too long for the contacts under this stress.
    RuntimeError
        If the sample does not come to rest within the time that the scenario allows.
    """
    rng = np.random.default_rng(seed)
    smooth = gouge_law(scenario, 0.0)
    state = _pour(scenario, rng)
    state = _approach(scenario, state, smooth, report)
    state = _settle(scenario, state, smooth, "pressed", report)
    state = _glue_plates(scenario, state)
    law = gouge_law(scenario, scenario.law.mu)
    state = _settle(scenario, state, law, "glued", report)
    grains = state.grains._replace(velocity=0 * state.grains.velocity, spin=0 * state.grains.spin)
    return Gouge(state._replace(grains=grains), law, scenario.area, scenario.load.normal_stress, scenario.grains.mean)


def attach_spring(gouge: Gouge, stiffness: float, times, displacement) -> Gouge:
    """Attach a spring along x to the upper plate, or change the load-point motion of an attached spring.

    Parameters
    ----------
    stiffness : k A [N/m]
    times, displacement : (K,) motion of the load point relative to the point of attachment (see `spring_loaded`) [s],
        [m]
    """
    state, top = gouge.state, gouge.top
    attached = state.control.spring[top, 0].any()
    where = state.control.anchor[top] if attached else state.grains.position[top]
    control = spring_loaded(state.control, top, where, stiffness, times=times, displacement=displacement)
    return gouge._replace(state=state._replace(control=control))


def _pour(scenario: GougeScenario, rng) -> State:
    """Place grains of all sizes on a loose lattice between a fixed flat wall and one that moves down."""
    cell, chosen = scenario.cell, scenario.grains
    number = chosen.number + 2 * scenario.plate_grains
    radius = rng.uniform(*chosen.diameter, number) / 2
    wide = SPACING * chosen.diameter[1]
    across = [max(1, int(length / wide)) for length in (cell.length, cell.width)]
    steps = cell.length / across[0], cell.width / across[1]
    site = np.arange(number)
    layer, rest = divmod(site, across[0] * across[1])
    x, z = divmod(rest, across[1])
    room = 0.5 * (min(*steps, wide) - 2 * radius)[:, None]
    position = np.stack([(x + 0.5) * steps[0], (layer + 0.5) * wide, (z + 0.5) * steps[1]], axis=1)
    position += rng.uniform(-1, 1, position.shape) * room
    height = (layer[-1] + 1) * wide
    grains = spheres(position, radius, mass=chosen.density * 4 / 3 * np.pi * radius**3)
    mass = scenario.plate_grains * float(grains.mass.mean()) * cell.plate_mass
    walls = flat_walls([[0, 0, 0], [0, height, 0]], [[0, 1, 0], [0, -1, 0]], mass=mass)
    control = driven(loads(number, 2), [number + 1], [0, -scenario.preparation.approach, 0, 0, 0, 0])
    return assembly(grains, walls, box([cell.length, height, cell.width], [True, False, True]), control)


def _drag(scenario: GougeScenario) -> float:
    """Drag on translations and rotations while settling [1/s]."""
    d = scenario.grains.mean
    mass = scenario.grains.density * np.pi / 6 * d**3
    return scenario.preparation.drag * float(np.sqrt(scenario.load.normal_stress * d / mass))


def _approach(scenario: GougeScenario, state: State, law: Law, report: Report) -> State:
    """Move the upper wall down until it carries the normal stress, then apply that stress to it."""
    n, wanted = len(state.grains.radius), scenario.load.normal_stress
    start, least = float(state.walls.point[1, 1]), np.pi / 6 * (state.grains.radius**3 * 8).sum() / scenario.area
    while True:
        state = _advance(scenario, state, law, _drag(scenario))
        acting, _ = forces(state, law, memory=FROZEN)
        height, stress = float(state.walls.point[1, 1]), float(acting.force[n + 1, 1]) / scenario.area
        report("pour and press", min(1.0, (start - height) / (start - 1.5 * least)), f"stress {stress:.2e} Pa")
        if stress >= wanted:
            break
        if height < least:
            raise RuntimeError("the wall moved through the grains: use a shorter dt or a lower preparation.approach")
    control = force_controlled(state.control, [n + 1], [0, -wanted * scenario.area])
    return state._replace(control=control)


def _advance(scenario: GougeScenario, state: State, law: Law, drag: float, steps: int = CHUNK) -> State:
    state = state._replace(instant=None)  # so that each seed gives the same sample as in earlier results
    try:
        state, _, outcome = run(state, law, steps, scenario.dt, drag=drag, threads=1)
    except ValueError as problem:
        longest = stable_time_step(state, law)
        raise ScenarioError(
            f"dt = {scenario.dt:g} exceeds the largest stable time step under this stress, {longest:.3g}: use about "
            f"{0.1 * longest:.1g}"
        ) from problem
    if not outcome.ok:
        raise RuntimeError(f"the run stopped at time {state.time:.4g}: {outcome}")
    return state


def _settle(scenario: GougeScenario, state: State, law: Law, stage: str, report: Report) -> State:
    """Run until the mean unbalanced force and the kinetic energy are small."""
    chosen = scenario.preparation
    for k in range(max(1, round(chosen.most / CHUNK))):
        state = _advance(scenario, state, law, _drag(scenario))
        acting, _ = forces(state, law, memory=FROZEN)
        free, rows = state.control.group[: len(state.grains.radius)] < 0, touching(state)
        pull = np.linalg.norm(unbalanced_forces(state, acting)[: len(free)][free, :3], axis=1).mean()
        held = np.linalg.norm(contact_forces(state, law)[rows], axis=1).mean() if len(rows) else 0.0
        moving = state.grains
        energy = moving.mass @ (moving.velocity**2).sum(axis=1) + moving.inertia @ (moving.spin**2).sum(axis=1)
        unrest = float(pull / held) if held > 0 else np.inf
        swing = float(0.5 * energy / elastic_energy(state, law)) if held > 0 else np.inf
        report(stage, min(1.0, (k + 1) * CHUNK / chosen.most), f"unbalanced {unrest:.1e}, kinetic/elastic {swing:.1e}")
        if unrest < chosen.unbalanced and swing < MAX_KINETIC_RATIO:
            return state
    raise RuntimeError(
        f"the sample did not settle in {chosen.most:g} steps (unbalanced force {unrest:.1e} of the contact force, "
        f"target {chosen.unbalanced:g}): raise preparation.most or preparation.drag"
    )


def _glue_plates(scenario: GougeScenario, state: State) -> State:
    """Replace the walls with plates of the lowest and highest grains; contacts then have no slip.

    Glued grains shrink until they no longer touch each other.
    """
    number, n = scenario.plate_grains, len(state.grains.radius)
    order = np.argsort(state.grains.position[:, 1], kind="stable")
    plates = order[:number], order[-number:]
    grains = _shrink_apart(state, np.concatenate(plates))
    for members in plates:
        share = scenario.cell.plate_mass * grains.mass[members].sum() / number
        grains.mass[members] = share
    control = loads(n)
    for members in plates:
        control = rigid(control, np.sort(members))
    control = driven(control, plates[BOTTOM], 0.0)
    control.free[plates[TOP], 0] = control.free[plates[TOP], 2] = False
    control = force_controlled(control, plates[TOP], [0, -scenario.load.normal_stress * scenario.area / number])
    bare = without_walls(state, [0, 1])
    high = float(grains.position[:, 1].max())
    cell = box([scenario.cell.length, high, scenario.cell.width], [True, False, True])
    return assembly(grains, cell=cell, control=control)._replace(time=bare.time)


def _shrink_apart(state: State, members: np.ndarray) -> Grains:
    """Shrink the grains with indices `members` until no two of them touch."""
    grains, size = state.grains, np.diag(state.cell.vectors)
    x, radius = grains.position[members], grains.radius.copy()
    r = x[:, None] - x[None]
    r[..., [0, 2]] -= size[[0, 2]] * np.round(r[..., [0, 2]] / size[[0, 2]])
    touch = np.linalg.norm(r, axis=2) / (radius[members][:, None] + radius[members][None])
    np.fill_diagonal(touch, np.inf)
    radius[members] *= min(1.0, float(touch.min()) * (1 - 1e-9))
    return grains._replace(radius=radius, velocity=0 * grains.velocity, spin=0 * grains.spin, mass=grains.mass.copy())
