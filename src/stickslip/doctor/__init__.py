"""Is this installation sound? What it is made of, and a self-check against stored numbers."""
