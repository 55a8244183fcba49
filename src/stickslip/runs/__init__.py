"""Run folders: written, resumed, swept, opened as datasets, and shown as pages and JSON."""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
