"""Output for people: terminal, claims tables, and reports on a packing."""
