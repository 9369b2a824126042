"""Triangles as linear functions of the ray direction, the ray-triangle test, and the central projection of faces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined

__all__ = [
    "DISTANCE",
    "FORMS",
    "HIGH_U",
    "HIGH_V",
    "LEAST_COSINE",
    "LOW_U",
    "LOW_V",
    "PLANE_MARGIN",
    "RANGES",
    "blurs",
    "components",
    "depth_on",
    "edge_functions",
    "inside",
    "rounding",
    "slope",
    "weigh",
    "within",
    "write_forms",
]


# Indices into the form of a face. All but DISTANCE are coefficients of the ray direction d = (x, y, z): of the edge
# functions opposite corners 0, 1 and 2, of the scalar product with the (unnormalised) normal, and of the rounding
# bound of the edge functions, multiplied by |x|, |y| and |z|. DISTANCE is the scalar product of the normal with a
# corner.
W0_X, W0_Y, W0_Z, W1_X, W1_Y, W1_Z, W2_X, W2_Y, W2_Z = range(9)
NORMAL_X, NORMAL_Y, NORMAL_Z, DISTANCE = range(9, 13)
BLUR_X, BLUR_Y, BLUR_Z = range(13, 16)
FORMS = 16

# An edge function d . (p x q) has at most 3 roundings (2^-53) of a sum of six products, and two of the total.
_ROUNDINGS = 8 * 2.0**-52
# Faces whose edge functions sum to less than this multiple of the rounding are edge-on and are not enlarged.
_EDGE_ON = 1e3


@inlined
def blurs(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float, cz: float
) -> Any:  # fmt: skip
    """Return bounds of the rounding errors of a face's edge functions; corners relative to the ray origin, in mm."""
    x, y, z = max(abs(ax), abs(bx), abs(cx)), max(abs(ay), abs(by), abs(cy)), max(abs(az), abs(bz), abs(cz))
    return _ROUNDINGS * y * z, _ROUNDINGS * z * x, _ROUNDINGS * x * y


@inlined
def inside(w0: float, w1: float, w2: float, blur: float) -> Any:
    """Return whether a ray is inside a face, edges included.

    The edge functions of two faces at a common edge have exactly opposite signs, so no ray passes between them. At a
    corner several edge functions are zero within rounding, and their signs may exclude all faces. A face therefore
    includes rays outside its edges by up to the rounding error.
    """
    total = w0 + w1 + w2
    if (w0 >= 0.0 and w1 >= 0.0 and w2 >= 0.0) or (w0 <= 0.0 and w1 <= 0.0 and w2 <= 0.0):
        return total != 0.0
    if min(w0, w1, w2) >= -blur:
        return total > _EDGE_ON * blur
    if max(w0, w1, w2) <= blur:
        return total < -_EDGE_ON * blur
    return False


@inlined
def write_forms(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], face: int, origin: NDArray[np.float64],
    form: NDArray[np.float64],
) -> None:  # fmt: skip
    """Write the coefficients of a face's edge functions, slope and rounding as functions of the ray direction.

    Operations and their order are those of `hit_kernels._meet`, for bit-identical results.

    ``vertices``: World positions in mm, shape (n, 3).
    ``faces``: Vertex indices of the faces, shape (m, 3).
    ``origin``: Origin of the rays in mm, shape (3,).
    ``form``: Output, shape (16,), in the order of `W0_X` to `BLUR_Z`.
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


@inlined
def edge_functions(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the edge functions of a face (Pineda, SIGGRAPH 1988) for a ray."""
    w2 = dx * form[W2_X] + dy * form[W2_Y] + dz * form[W2_Z]
    w0 = dx * form[W0_X] + dy * form[W0_Y] + dz * form[W0_Z]
    w1 = dx * form[W1_X] + dy * form[W1_Y] + dz * form[W1_Z]
    return w0, w1, w2


@inlined
def rounding(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the bound of the rounding errors of a face's edge functions for a ray."""
    return abs(dx) * form[BLUR_X] + abs(dy) * form[BLUR_Y] + abs(dz) * form[BLUR_Z]


@inlined
def slope(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the scalar product of the face normal and the ray direction."""
    return form[NORMAL_X] * dx + form[NORMAL_Y] * dy + form[NORMAL_Z] * dz


@inlined
def weigh(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the barycentric coordinates of a ray hit."""
    w0, w1, w2 = edge_functions(form, dx, dy, dz)
    total = w0 + w1 + w2
    return w1 / total, w2 / total


@inlined
def depth_on(form: NDArray[np.float64], dx: float, dy: float, dz: float) -> Any:
    """Return the ray parameter of the intersection with the plane of a face; -1 for a parallel ray."""
    towards = slope(form, dx, dy, dz)
    return form[DISTANCE] / towards if towards != 0.0 else -1.0


LOW_U, HIGH_U, LOW_V, HIGH_V = range(4)
"""Indices of the u and v ranges of a face, tile or ray field in the projection."""

RANGES = 4
"""Number of these indices."""

LEAST_COSINE = 0.05
"""Minimum cosine of the angle between a ray direction and the projection axis."""

PLANE_MARGIN = 1e-12
"""Relative safety margin of edge-function bounds that only skip work; larger than rounding."""

_ACROSS, _DOWN, _AXIS = range(3)  # rows of a frame: two transverse unit vectors and the axis


@inlined
def components(x: float, y: float, z: float, frame: NDArray[np.float64]) -> Any:
    """Return the components of a vector in a frame of two transverse unit vectors and the axis, shape (3, 3)."""
    across = x * frame[_ACROSS, 0] + y * frame[_ACROSS, 1] + z * frame[_ACROSS, 2]
    down = x * frame[_DOWN, 0] + y * frame[_DOWN, 1] + z * frame[_DOWN, 2]
    along = x * frame[_AXIS, 0] + y * frame[_AXIS, 1] + z * frame[_AXIS, 2]
    return across, down, along


@inlined
def within(
    along_u: float, along_v: float, constant: float, margin: float, low_v: float, high_v: float, low: float, high: float
) -> Any:  # fmt: skip
    """Narrow a range of u to where along_u u + along_v v + constant can be positive for v in a range."""
    least = -(margin + constant + max(along_v * low_v, along_v * high_v))
    if along_u > 0.0:
        low = max(low, least / along_u)
    elif along_u < 0.0:
        high = min(high, least / along_u)
    elif least > 0.0:
        low, high = np.inf, -np.inf
    return low, high
