"""Packings in the formats of other programs: one module a format, `files` sends a path to the one that fits."""
