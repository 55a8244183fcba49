"""Output for people: terminal, claims tables, and reports on a packing."""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
