"""Compiled kernels and the values that they work on, with NumPy and Numba only."""

from .. import kernel_cache

kernel_cache.install()
