"""Studies of granular flows, of static and kinetic friction, of classified events, and of the failure of packings."""
