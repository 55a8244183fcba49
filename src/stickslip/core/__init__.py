"""Compiled kernels and the data that they operate on; the only dependencies are NumPy and Numba."""

from .. import kernel_cache

kernel_cache.install()
