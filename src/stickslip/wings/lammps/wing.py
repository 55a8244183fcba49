"""Definition of the LAMMPS wing: LAMMPS as an engine."""

from ...wing import Command, Wing

WING = Wing(
    package=__package__,
    words="LAMMPS as an engine, and watching its runs",
    commands=(Command("watch", "Follow the dumps of a running LAMMPS simulation.", "commands.watch"),),
    fault="run.load_error",
    pages=("lammps",),
)
