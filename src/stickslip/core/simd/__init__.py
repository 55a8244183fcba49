"""Vectorised blocks of contacts: layout, partition, transposition, sums."""
