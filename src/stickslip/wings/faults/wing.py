"""Definition of the faults wing, which needs no grains."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="rate-and-state friction, records and their fits, spring-sliders, earthquake cycles",
    experiments={"rate-state": "rate_state", "fault": "fault"},
    commands="commands",
    selfchecks="friction.laws.selfchecks",
    pages=(
        "rate_and_state", "faults", "tutorials/laboratory_record", "tutorials/from_record_to_fault",
        "theory/rate_and_state",
    ),
)  # fmt: skip
