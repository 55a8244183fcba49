"""Packings in the formats of other programs: one module per format; `formats` tells which a file has."""
