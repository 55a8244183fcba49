"""Definition of the studies wing."""

from ...wing import Command, ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="granular flows, thresholds of friction, a catalogue of events, failure of a packing",
    experiments={
        "flow": ExperimentEntry("flow", needs=("lammps",)),
        "threshold": ExperimentEntry("threshold", needs=("papers", "faults", "lammps")),
        "catalogue": ExperimentEntry("catalogue"),
        "failure": ExperimentEntry("failure"),
    },
    commands=(Command("shear", "When will this packing fail?", "commands.shear"),),
    pages=("catalogue", "failure"),
)
