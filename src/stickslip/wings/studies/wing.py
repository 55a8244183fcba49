"""Definition of the studies wing, which also uses the papers wing."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="granular flows, thresholds of friction, a catalogue of events, failure of a packing",
    needs=("papers", "faults", "status", "lammps"),
    experiments={"flow": "flow", "threshold": "threshold", "catalogue": "catalogue", "failure": "failure"},
    commands="commands",
    pages=("catalogue", "failure"),
)
