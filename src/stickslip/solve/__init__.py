"""Equilibrium and stability, in generalised coordinates."""
