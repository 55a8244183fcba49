"""Treatments of the memory of contacts in an evaluation, as in `mechanics.h`."""

# FREE: transport it, but keep it bit for bit where nothing has moved since it was committed; HELD: the same with every
# contact in its mode; FROZEN: as FREE, also where it is not that of this law
FROZEN, HELD, FREE = 0, 1, 2
GIVEN = 4  # added to HELD or FREE: the memory was not committed in motion but comes from elsewhere
MIN_WEIGHT = 0.6  # of an increment, see `turning_weight`; above 1/2, so that a slip can change its sign
ROUND_OFF = 1e-11  # of a slip, in units of R_i + R_j: a contact slides until its slip is shorter than its limit by more
AT_LIMIT = 1e-3  # share of its limit by which the slip of a sliding contact may fall short at rest; dashpots leave that
