"""Sweeps: many scenarios defined by a table `[sweep]`, and the dataset of their results."""
