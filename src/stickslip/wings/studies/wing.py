"""Head of the wing of studies. They may use the samples of papers."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="granular flows, thresholds of friction, a catalogue of events, failure of a packing",
    needs=("papers", "faults", "status", "lammps"),
    experiments={"flow": "flow", "threshold": "threshold", "catalogue": "catalogue", "failure": "failure"},
    commands="commands",
    pages=("catalogue", "failure"),
)
