"""Packings in the formats of other programs: one module per format; `files` selects it from the file extension."""
