"""Definition of the LAMMPS wing: LAMMPS as an engine."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="LAMMPS as an engine, and watching its runs",
    commands="commands",
    fault="run.load_error",
    pages=("lammps",),
)
