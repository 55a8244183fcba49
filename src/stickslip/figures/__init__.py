"""Figures: a result in, a matplotlib Figure out (`view`: a widget, `movie`: a file); nothing is simulated here.

Every function is here, and is loaded when first used: `ss.figures.packing(state, law)`.
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
