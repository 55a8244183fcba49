"""Quasi-rigid contact mechanics: contact status, uniqueness, and piecewise-linear load paths.

linear_system       matrices of a state: contact matrix, stiffness, loads
stiffness_matrix, damping_matrix, quadratic_form    matrices and energy derived from a linear system
contact_status      status of all contacts under a load rate
complementarity, status_map, consistent_statuses, statuses_at_apex  complementarity problem; slower ways to solve it
certificate         uniqueness of the status
probe_statuses      contact status and strain under small stresses of a periodic cell
mechanisms          unresisted motions
rigid_clusters      clusters that move as rigid bodies in all motions that contacts do not resist
load_path, with_load    piecewise-linear path from event to event, and through collapses
with_machine, with_travel    load by a spring whose load point moves
slow_dynamics       load path followed by dynamics under slowly changing loads
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
