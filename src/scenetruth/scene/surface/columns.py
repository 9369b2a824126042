"""Columns of the tensors of motion and form of surface points; see `surface.kernels.surface_tensors`."""

__all__ = ["CURVATURE", "DEFORMATION", "NORMAL", "ROTATION", "TENSOR_COLUMNS", "TENSOR_ROWS", "WIDTH"]

NORMAL = 0
"""First of three: unit normal."""
DEFORMATION = 3
"""First of six: rate of deformation in the tangent plane, 1/frame."""
ROTATION = 9
"""First of three: rotation rate, rad/frame."""
CURVATURE = 12
"""First of six: curvature tensor, 1/mm."""
WIDTH = 18
"""All of them."""

# The order of the six numbers of a symmetric tensor: xx, yy, zz, xy, xz, yz.
TENSOR_ROWS = (0, 1, 2, 0, 0, 1)
TENSOR_COLUMNS = (0, 1, 2, 1, 2, 2)
