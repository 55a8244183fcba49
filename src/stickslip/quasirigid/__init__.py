"""Quasi-rigidity: stiffness matrix with contact status, the principle of minimum sliding, piecewise-linear loading."""
