"""Faults without grains: rate-and-state friction, records and their fits, spring-sliders, and earthquake cycles."""
