"""Definition of the contact status wing."""

from ...wing import Wing

WING = Wing(
    package=__package__,
    words="contact status, load paths and rigid clusters",
    selfchecks="apex_status.selfchecks",
    pages=("tutorials/biaxial_test", "theory/quasi_rigidity"),
)
