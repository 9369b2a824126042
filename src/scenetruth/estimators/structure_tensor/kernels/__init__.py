"""Hot loops of the structure tensor, compiled by numba."""
