"""Options of compiled functions."""

# for functions that only kernels call: their interface to Python takes a good part of their compilation
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
