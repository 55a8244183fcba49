"""Sweeps: many scenarios defined by a `[sweep]` table, and the dataset of their results."""
