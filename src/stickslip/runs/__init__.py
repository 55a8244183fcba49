"""Run folders: write and resume runs, sweep over scenarios, and show results as datasets, pages and JSON."""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
