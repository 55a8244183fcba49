"""Check of an installation: versions and optional parts, and a self-check against stored numbers."""
