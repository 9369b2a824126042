"""The central projection of rays and faces along an axis, in which faces are sorted to rays."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["HIGH_U", "HIGH_V", "LEAST_COSINE", "LOW_U", "LOW_V", "PLANE_MARGIN", "RANGES", "components"]

LOW_U, HIGH_U, LOW_V, HIGH_V = range(4)
"""Places of the ranges of u and v that a face, a tile or a field of rays covers in the projection."""

RANGES = 4
"""How many numbers these are."""

LEAST_COSINE = 0.05
"""Directions must point this far (cosine of the angle to the axis) into the half space of the axis."""

PLANE_MARGIN = 1e-12
"""Bounds of edge functions that only skip work err by this share of their size on the safe side; rounding is below."""

# Rows of a frame: two unit vectors across the axis, and the axis itself.
_ACROSS, _DOWN, _AXIS = range(3)


@numba.njit(cache=True, nogil=True, inline="always")
def components(x: float, y: float, z: float, frame: NDArray[np.float64]) -> Any:
    """Return the components of a vector in a frame.

    Parameters
    ----------
    x, y, z
        The vector, in the world.
    frame
        Two unit vectors across the axis, and the axis, as the rows of a rotation, shape (3, 3).

    Returns
    -------
    tuple of float
        Components across, down and along the axis. Across / along and down / along are u and v of the projection.
    """
    across = x * frame[_ACROSS, 0] + y * frame[_ACROSS, 1] + z * frame[_ACROSS, 2]
    down = x * frame[_DOWN, 0] + y * frame[_DOWN, 1] + z * frame[_DOWN, 2]
    along = x * frame[_AXIS, 0] + y * frame[_AXIS, 1] + z * frame[_AXIS, 2]
    return across, down, along
