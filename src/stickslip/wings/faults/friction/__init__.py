"""Rate-and-state friction, laboratory records and their fits, and faults; public names are in `stickslip.friction`."""
