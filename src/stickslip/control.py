"""Boundary conditions and loads; every function accepts a `Control` and returns a modified copy.

loads               forces, torques and gravity on free grains
fixed               bodies that do not move
driven              bodies that move at a given rate
time_dependent      rates multiplied by a function of time
force_controlled    walls or rigid groups that move until contacts balance a force
rigid               bodies that move together, without rotation
spring_loaded       bodies pulled by a spring whose end moves
spring_forces       forces of springs on bodies
strained_at         cell that deforms at a given velocity gradient
stress_controlled   cell whose strain follows the stress
between             interpolation between two controls
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
