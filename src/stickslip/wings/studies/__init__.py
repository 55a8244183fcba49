"""Granular flows, static and kinetic friction of a sample, and a catalogue of events."""
