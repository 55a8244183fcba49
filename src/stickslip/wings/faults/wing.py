"""Definition of the faults wing, which needs no grains."""

from ...wing import Command, ExperimentEntry, Wing

WING = Wing(
    package=__package__,
    words="rate-and-state friction, records and their fits, spring-sliders, earthquake cycles",
    experiments={
        "rate-state": ExperimentEntry("rate_state"),
        "fault": ExperimentEntry("fault", papers=("seas-bp1", "seas-bp3", "seas-bp6")),
    },
    commands=(Command("fit", "Fit rate-and-state friction to a record.", "commands.fit"),),
    selfchecks="friction.laws.selfchecks",
    pages=(
        "rate_and_state", "faults", "tutorials/laboratory_record", "tutorials/from_record_to_fault",
        "theory/rate_and_state",
    ),
)  # fmt: skip
