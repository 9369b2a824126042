"""Hot loops of the plane sweep, compiled by numba."""
