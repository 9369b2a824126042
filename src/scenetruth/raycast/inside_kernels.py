"""The one rule by which a ray is inside a triangle, and how far rounding may blur it."""

from __future__ import annotations

from typing import Any

import numba

__all__ = ["blurs", "inside"]

# A volume d . (p x q) is rounded by at most 3 roundings (of 2^-53) of a sum of six products, and twice as a whole.
_ROUNDINGS = 8 * 2.0**-52
# Faces whose whole volume is less than so many times the rounding are seen edge-on: nothing is added to them.
_EDGE_ON = 1e3


@numba.njit(cache=True, nogil=True, inline="always")
def blurs(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float
) -> Any:  # fmt: skip
    """Return by how much a face's volumes may be rounded, per unit of |d_x|, |d_y| and |d_z|.

    Arguments are the face's corners, seen from where the ray starts.
    """
    x, y, z = max(abs(ax), abs(bx), abs(cx)), max(abs(ay), abs(by), abs(cy)), max(abs(az), abs(bz), abs(cz))
    return _ROUNDINGS * y * z, _ROUNDINGS * z * x, _ROUNDINGS * x * y


@numba.njit(cache=True, nogil=True, inline="always")
def inside(w0: float, w1: float, w2: float, blur: float) -> Any:
    """Tell from the three volumes of a ray and the edges of a face whether the ray is inside, edges included.

    The volumes of an edge have exactly opposite signs for the two faces that share it, so that no ray slips through
    between two faces. At a corner, the volumes of several edges are zero but for rounding, and their signs may be such
    that no face has it: a face therefore also has what lies beyond its edges by no more than rounding, ``blur``.
    """
    total = w0 + w1 + w2
    if (w0 >= 0.0 and w1 >= 0.0 and w2 >= 0.0) or (w0 <= 0.0 and w1 <= 0.0 and w2 <= 0.0):
        return total != 0.0
    if min(w0, w1, w2) >= -blur:
        return total > _EDGE_ON * blur
    if max(w0, w1, w2) <= blur:
        return total < -_EDGE_ON * blur
    return False
