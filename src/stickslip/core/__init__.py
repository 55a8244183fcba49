"""The compiled core and the data that it operates on; the only dependency is NumPy, and Numba for user-defined laws."""
