"""Rate-and-state friction, laboratory records and fits, faults; public names are in `stickslip.friction`."""
