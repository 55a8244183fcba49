"""The compiled core and the data that it operates on; needs only NumPy, and Numba for user-defined laws."""
