"""Vectorised evaluation of many contacts, and the layout of bodies in memory."""
