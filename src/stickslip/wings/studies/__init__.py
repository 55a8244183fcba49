"""Granular flows, static and kinetic friction, a catalogue of events, and failure of a packing."""
