"""Compiled kernels and the values that they work on, using only NumPy and Numba."""

from .. import kernel_cache

kernel_cache.install()
