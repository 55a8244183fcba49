"""Packings in the formats of other programs; `files` detects the format of a file."""
