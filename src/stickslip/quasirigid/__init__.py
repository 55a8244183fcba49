"""Quasi-rigid contact mechanics: which contacts stick and which slide, and where a load path ends.

linear_system       matrices of a state: contact matrix, stiffness, loads
stiffness_matrix, damping_matrix, quadratic_form    parts of them
contact_status      status of all contacts under a load rate
complementarity, status_map, consistent_statuses, statuses_at_apex      the problem behind it, and slower solutions
certificate         whether the status is unique
mechanisms          motions that nothing resists
load_path, with_load    piecewise-linear path from event to event
slow_dynamics       the same path by slow dynamics
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
