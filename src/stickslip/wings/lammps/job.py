"""Legs written for a queue: a folder that LAMMPS runs without this package, one leg after the other."""

from pathlib import Path
from shutil import rmtree

from ...core.dynamics.engine import Leg
from ...data.checkpoint import LEGS
from ...data.run_files import resume_command
from ...experiments import ScenarioError
from ...kit import write_atomically
from .run import sample_path
from .script import DATA, INPUT, SAMPLE, write_input

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
    """Folder of a leg in a folder written for a queue."""
    return folder / LEGS / f"leg-{number + 1:02d}"


def write_job(folder: Path, legs: list[Leg], ranks: int) -> list[Path]:
    """Write the input of legs, each starting where the previous one ends, a script that runs them, and a job for SLURM.

    The first leg starts without contact memory.

    Raises
    ------
    ScenarioError
        If LAMMPS has already run legs in this folder.
    """
    clear_legs(folder)
    paths, ends, begin = [], [], DATA
    for number, leg in enumerate(legs):
        place = leg_folder(folder, number)
        paths.append(write_input(leg._replace(number=number), place, begin=begin))
        ends.append(sample_path(leg, place, leg.steps))
        begin = f"../{place.name}/{ends[-1].name}"
    return [*paths, *write_scripts(folder, ends, ranks)]


def clear_legs(folder: Path) -> None:
    """Remove legs that were written before.

    Raises
    ------
    ScenarioError
        If LAMMPS has already run legs in this folder.
    """
    if any((folder / LEGS).rglob(SAMPLE)):
        raise ScenarioError(
            f"{folder} contains states that LAMMPS wrote: continue with {resume_command(folder)}, or choose another "
            f"folder"
        )
    rmtree(folder / LEGS, ignore_errors=True)


def write_scripts(folder: Path, ends: list[Path], ranks: int) -> list[Path]:
    """Write a script that runs legs one after the other, and a job for SLURM; `ends` are the states that end them."""
    runs = [ONE.format(leg=end.parent.name, last=end.name, input=INPUT) for end in ends]
    texts = {SCRIPT: RUN.format(ranks=ranks, legs=LEGS, runs="\n".join(runs)), JOB: SLURM.format(ranks=ranks)}
    for name, text in texts.items():
        write_atomically(folder / name, text.encode())
    return [folder / name for name in texts]
