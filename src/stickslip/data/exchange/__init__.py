"""Packings in the formats of other programs: one module per format; `files` selects it by the file extension."""
