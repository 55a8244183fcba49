"""LAMMPS as the engine of fault gouge: legs are written as LAMMPS input, run, and read back as Series.

One leg is a folder that contains `in.lammps` and its starting point, which is a data file or a restart file. It is run
in processes of its own; `mpirun -np 2 lmp -in in.lammps` does the same. A place between legs holds the sample with its
contact memory, and the contents of the restart file, so any number of legs may start from it, and nothing is left on
disk. Numbers are SI.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from ...core.contacts.forces import accept, forces
from ...core.laws.builtin import MU
from ...core.measure import coordination, elastic_energy, fabric, least_supports
from ...core.state import State, empty_contacts
from ...lammps.leg import Leg
from ...lammps.process import error_line, require_lammps, run_lammps
from ...lammps.run import read_state, sample_path, write_start, written_boxes
from ...lammps.script import BEFORE, contact_commands, motion_commands
from ...lammps.script import write_input as write_leg
from ...lammps.supported import check_leg
from .dimensionless import stiffness
from .protocol import Engine, Series, load_point_lead
from .sample import TOP, Gouge, attach_spring
from .scenario import GougeScenario

SKIN = 0.02  # skin of neighbour lists in mean diameters: the fastest of those tried in `benchmarks/gouge.py`
# share of the Coulomb limit from which a contact counts as sliding; LAMMPS prints dashpots half a step after truncation
AT_LIMIT = 1 - 1e-3
GRAINS, CONTACTS, PLATE = "grains.dump", "contacts.dump", "plate.txt"


class Place(NamedTuple):
    """State at the end of a leg, from which others may start."""

    gouge: Gouge  # sample with the memory of its contacts
    restart: bytes  # LAMMPS restart file of the same state; empty before the first leg, and of legs run in a queue
    number: int = 0  # of the leg that ends here, in a queue


def engine(ranks: int = 1) -> Engine:
    """Return LAMMPS as an Engine that runs legs in one process, or under mpirun with several MPI ranks.

    The memory of contacts is passed to LAMMPS, and comes back from it.

    Raises
    ------
    MissingExtraError
        If LAMMPS or the MPI library that it needs is missing. The message says how to install it.
    ScenarioError
        If there are fewer cores than ranks.
    """
    require_lammps(ranks)
    return engine_of(partial(_leg, ranks=ranks))


def engine_of(leg: Callable) -> Engine:
    """Return an Engine with places of LAMMPS and a function that runs legs."""
    return Engine(
        start, leg, lambda place: place.gouge.state,
        lambda place: elastic_energy(place.gouge.state, place.gouge.law), (Place, Gouge),
    )  # fmt: skip


def start(scenario: GougeScenario, gouge: Gouge) -> Place:
    """Return a sample attached to its spring; the spring is attached first if necessary.

    Raises
    ------
    ScenarioError
        If LAMMPS does not have its contact law.
    """
    ahead = load_point_lead(gouge) if gouge.state.control.spring[gouge.top, 0].any() else 0.0
    attached = attach_spring(gouge, stiffness(scenario) * scenario.area, [gouge.state.time], [ahead])
    place = Place(attached, b"")
    check_leg(make_leg(scenario, place, 0.0, scenario.sample_every))
    return place


def make_leg(
    scenario: GougeScenario, place: Place, velocity: float, steps: int, *, ranks: int = 1, skin: float = SKIN
) -> Leg:
    """Return the leg in which the load point of the spring moves at a velocity."""
    gouge, seconds = place.gouge, steps * scenario.dt
    begin, ahead = gouge.state.time, load_point_lead(gouge)
    course = [begin, begin + seconds], [ahead, ahead + velocity * seconds]
    here = attach_spring(gouge, stiffness(scenario) * scenario.area, *course)
    diameters = skin * gouge.diameter / (2 * float(gouge.state.grains.radius.mean()))
    return Leg(
        here.state, gouge.law, scenario.dt, steps, 1, ranks=ranks, more=_output_commands(scenario.sample_every),
        skin_diameters=diameters,
    )  # fmt: skip


def _output_commands(every: int) -> str:
    """Commands that write grains, contacts and the plate at an interval of steps."""
    name = f"plate{TOP}"
    return f"""compute contacts all pair/local force p4 cutoff radius
dump grains all custom {every} {GRAINS} id xu yu zu vx vy vz omegax omegay omegaz
dump_modify grains sort id format float %.17g
dump contacts all local {every} {CONTACTS} c_contacts[1] c_contacts[2]
dump_modify contacts format float %.10g
fix plate_forces {name} ave/time {every} 1 {every} v_{name}_leadx v_{name}_pullx f_push_{name}[1] f_push_{name}[2] &
  file {PLATE} format " %.17g"
"""


def write_input(
    scenario: GougeScenario, place: Place, velocity: float, steps: int, folder: Path, *, ranks: int = 1
) -> Path:
    """Write a leg for LAMMPS into a folder, where `mpirun -np 2 lmp -in in.lammps` runs it; return the input's path.

    Contact memory of a place without a restart file is written with the help of LAMMPS.

    Parameters
    ----------
    velocity : velocity of the load point [m/s]
    steps : number of steps, a multiple of the scenario's `sample_every`: the interval at which LAMMPS writes grains,
        contacts and plate
    """
    folder.mkdir(parents=True, exist_ok=True)
    leg = make_leg(scenario, place, velocity, steps, ranks=ranks)
    if not place.restart:
        return write_start(leg, folder)
    (folder / BEFORE).write_bytes(place.restart)
    return write_leg(leg, folder, begin=BEFORE)


def read_output(
    scenario: GougeScenario, place: Place, velocity: float, steps: int, folder: Path
) -> tuple[Place, Series]:
    """Read the final state and the series of a leg written by `write_input` with the same arguments and run by LAMMPS.

    Raises
    ------
    RuntimeError
        If LAMMPS did not finish the leg.
    """
    leg = make_leg(scenario, place, velocity, steps)
    begin, here = place.gouge.state.time, place.gouge._replace(state=leg.state)
    try:
        plate = np.loadtxt(folder / PLATE, ndmin=2)[-(steps // scenario.sample_every) :]
        grains, pairs = _read_frames(folder / GRAINS, 10), _read_frames(folder / CONTACTS, 2)
        restart = sample_path(leg, folder, steps).read_bytes()
        frames = [(grains[step], pairs[step]) for step in plate[:, 0].astype(int)]
        box = written_boxes(leg, folder)[steps]
    except (OSError, ValueError, KeyError, IndexError) as problem:
        raise RuntimeError(f"LAMMPS did not finish a leg of {steps} steps: {problem}") from problem
    states = [
        _state_from_frame(here, g, begin + step * scenario.dt) for step, (g, _) in zip(plate[:, 0], frames, strict=True)
    ]
    end = read_state(leg, folder, steps, box)
    series = _series(here, states, plate, [p for _, p in frames])
    return Place(here._replace(state=end), restart), series


def _leg(scenario: GougeScenario, place: Place, velocity: float, steps: int, *, ranks: int):
    with TemporaryDirectory(prefix="stickslip-lammps-") as name:
        path = write_input(scenario, place, velocity, steps, Path(name), ranks=ranks)
        run = run_lammps(path.name, folder=path.parent, ranks=ranks)
        if run.returncode:
            raise RuntimeError(f"LAMMPS stopped: {error_line(run)}")
        return read_output(scenario, place, velocity, steps, path.parent)


def mechanics_commands(scenario: GougeScenario, place: Place, velocity: float, skin: float = SKIN) -> str:
    """Return the LAMMPS commands of a leg from a data file, except run and output.

    `skin` is the skin distance of the neighbour lists, in diameters.
    """
    leg = make_leg(scenario, place, velocity, scenario.sample_every, skin=skin)
    return f"{contact_commands(leg)}\n{motion_commands(leg)}\n"


def _read_frames(path: Path, columns: int) -> dict[int, np.ndarray]:
    """Read the tables of a dump, keyed by the step at which each was written."""
    frames = {}
    for frame in path.read_text(encoding="utf-8").split("ITEM: TIMESTEP\n")[1:]:
        *head, body = frame.split("\n", 8)
        frames[int(head[0])] = np.array(body.split(), float).reshape(int(head[2]), columns)
    return frames


def _state_from_frame(gouge: Gouge, frame: np.ndarray, time: float) -> State:
    """Convert a frame to a State without contact memory; positions are unwrapped, angles are those at the start."""
    position, velocity, spin = frame[:, 1:4].copy(), frame[:, 4:7].copy(), frame[:, 7:10].copy()
    if not np.isfinite(position).all():
        raise RuntimeError("the sample became unstable in LAMMPS: use a shorter dt")
    state = gouge.state
    grains = state.grains._replace(position=position, velocity=velocity, spin=spin)
    bare = state._replace(
        grains=grains, time=float(time), contacts=empty_contacts(state.n_bodies, 0, state.contacts.skin)
    )
    return accept(bare, forces(bare, gouge.law)[1])


def _series(gouge: Gouge, states: list[State], plate: np.ndarray, pairs: list[np.ndarray]) -> Series:
    grains, top, loose, whole = gouge.state.grains, gouge.top, gouge.loose, gouge.normal_stress * gouge.area
    _, ahead, pull, force_x, force_y = plate.T
    mass, inertia, mu = grains.mass[loose], grains.inertia[loose], gouge.law.table[0, 0, MU]
    x = np.array([state.grains.position[top, 0].mean() for state in states])
    v, spin = (np.array([getattr(s.grains, name)[loose] for s in states]) for name in ("velocity", "spin"))
    return Series(
        np.array([state.time for state in states]),
        ahead,
        x - gouge.state.control.anchor[top, 0].mean(),
        np.array([state.grains.velocity[top[0], 0] for state in states]),
        pull / whole,
        -force_x / whole,
        force_y / whole,
        np.array([gouge._replace(state=state).thickness for state in states]),
        0.5 * ((v**2).sum(axis=2) @ mass + (spin**2).sum(axis=2) @ inertia),
        (v[..., 1] ** 2 + v[..., 2] ** 2) @ mass / (2 * mass.sum()),
        np.array([coordination(state, least_supports(gouge.law, state.cell.dim)) for state in states]),
        np.array([np.mean(p[:, 1] >= AT_LIMIT * mu * np.abs(p[:, 0])) if len(p) else 0.0 for p in pairs]),
        np.array([fabric(state) for state in states]),
    )
