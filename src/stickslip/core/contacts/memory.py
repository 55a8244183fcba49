"""Treatments of the memory of contacts in an evaluation, as in `mechanics.h`."""

# FROZEN: transport it, but keep it bit for bit where nothing has moved since it was committed; HELD: transport it with
# every contact in its mode; FREE: transport it
FROZEN, HELD, FREE = 0, 1, 2
MIN_WEIGHT = 0.6  # of an increment, see `turning_weight`; above 1/2, so that a slip can change its sign
