"""The central projection of rays and faces along an axis, in which faces are sorted to rays."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["HIGH_U", "HIGH_V", "LEAST_COSINE", "LOW_U", "LOW_V", "PLANE_MARGIN", "RANGES", "components", "within"]

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


@numba.njit(cache=True, nogil=True, inline="always")
def within(
    along_u: float, along_v: float, constant: float, margin: float, low_v: float, high_v: float, low: float, high: float
) -> Any:  # fmt: skip
    """Narrow a range of u to where along_u u + along_v v + constant may be above 0, for some v in a range.

    Parameters
    ----------
    along_u, along_v, constant
        The linear function: an edge function over the ray's component along the axis.
    margin
        By how much it may be below 0; larger than all rounding.
    low_v, high_v
        The range of v.
    low, high
        The range of u.

    Returns
    -------
    tuple of float
        The narrower range of u, from infinity to minus infinity if it is empty.
    """
    least = -(margin + constant + max(along_v * low_v, along_v * high_v))
    if along_u > 0.0:
        low = max(low, least / along_u)
    elif along_u < 0.0:
        high = min(high, least / along_u)
    elif least > 0.0:
        low, high = np.inf, -np.inf
    return low, high
