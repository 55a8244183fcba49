"""Packings in the formats of other programs: `files` tells which format a file has."""
