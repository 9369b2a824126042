"""A triangle as linear forms of a ray's direction, and the one rule by which a ray is inside it."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["blurs", "inside", "weigh", "write_forms"]

# Linear forms of a face in the direction d of a ray: the volumes with its edges (opposite to corners 0, 1 and 2), the
# normal (not of unit length), its product with a corner, and by how much rounding may blur the volumes per |d|.
W0_X, W0_Y, W0_Z, W1_X, W1_Y, W1_Z, W2_X, W2_Y, W2_Z = range(9)
NORMAL_X, NORMAL_Y, NORMAL_Z, DISTANCE = range(9, 13)
BLUR_X, BLUR_Y, BLUR_Z = range(13, 16)
FORMS = 16

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


@numba.njit(cache=True, nogil=True, inline="always")
def write_forms(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, origin: NDArray[np.float64],
    form: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write the linear forms of a face: of three volumes, of its normal, its distance, and how far rounding blurs them.

    The operations and their order are those of `kernels._meet`, so that both find the same bits.
    """
    i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
    ax, ay, az = vertices[i, 0] - origin[0], vertices[i, 1] - origin[1], vertices[i, 2] - origin[2]
    bx, by, bz = vertices[j, 0] - origin[0], vertices[j, 1] - origin[1], vertices[j, 2] - origin[2]
    cx, cy, cz = vertices[k, 0] - origin[0], vertices[k, 1] - origin[1], vertices[k, 2] - origin[2]
    form[W0_X], form[W0_Y], form[W0_Z] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    form[W1_X], form[W1_Y], form[W1_Z] = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    form[W2_X], form[W2_Y], form[W2_Z] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    form[NORMAL_X], form[NORMAL_Y], form[NORMAL_Z] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    form[DISTANCE] = form[NORMAL_X] * ax + form[NORMAL_Y] * ay + form[NORMAL_Z] * az
    form[BLUR_X], form[BLUR_Y], form[BLUR_Z] = blurs(ax, ay, az, bx, by, bz, cx, cy, cz)


@numba.njit(cache=True, nogil=True, inline="always")
def weigh(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the barycentric weights of a face's second and third corner where a ray meets it."""
    w2 = dx * form[W2_X] + dy * form[W2_Y] + dz * form[W2_Z]
    w0 = dx * form[W0_X] + dy * form[W0_Y] + dz * form[W0_Z]
    w1 = dx * form[W1_X] + dy * form[W1_Y] + dz * form[W1_Z]
    total = w0 + w1 + w2
    return w1 / total, w2 / total
