"""Scenarios, archives, checkpoints and files of other programs."""
