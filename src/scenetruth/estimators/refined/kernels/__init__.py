"""Numba kernels of the method ``refined``."""
