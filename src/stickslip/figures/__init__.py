"""Figures: functions take a result and return a matplotlib Figure (`view`: a widget, `movie`: a file).

Nothing is simulated here. Functions are loaded on first use, as in `ss.figures.packing(state, law)`.
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
