"""Kernel for normal, deformation rate, rotation rate and curvature of surface points, with the layout of its result."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.scene.taylor import AA, AB, BB, TA, TB, A, B
from scenetruth.threads import in_bands

__all__ = [
    "CURVATURE",
    "DEFORMATION",
    "NORMAL",
    "ROTATION",
    "TENSOR_COLUMNS",
    "TENSOR_ROWS",
    "WIDTH",
    "surface_tensors",
]


NORMAL = 0
"""First of three: unit normal."""
DEFORMATION = 3
"""First of six: rate of deformation in the tangent plane, 1/frame."""
ROTATION = 9
"""First of three: rotation rate, rad/frame."""
CURVATURE = 12
"""First of six: curvature tensor, 1/mm."""
WIDTH = 18
"""Total number of values."""

# Order of the six numbers of a symmetric tensor: xx, yy, zz, xy, xz, yz.
TENSOR_ROWS = (0, 1, 2, 0, 0, 1)
TENSOR_COLUMNS = (0, 1, 2, 1, 2, 2)


_LEAST = 1024  # minimum number of points per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


def surface_tensors(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute normal, rate of deformation, rotation rate and curvature of n surface points.

    ``x``, ``y``, ``z`` are coefficients of jets in t, a, b, shape (10, n). Returns shape (n, 18):

    - 0..2: unit normal n = X_a x X_b / ‖.‖,
    - 3..8: rate of deformation in the tangent plane D = P sym(∇V) P (xx, yy, zz, xy, xz, yz), 1/frame; its trace is the
      areal growth rate,
    - 9..11: rotation rate ω = n x dn/dt + s n with the spin s = n . (X^a x V_a + X^b x V_b) / 2, rad/frame,
    - 12..17: curvature tensor Σ (X_ij . n) X^i X^j, 1/mm, in the order of D; negative where the surface bulges along n.

    NaN where the derivatives along the surface are parallel.
    """
    out = np.empty((x.shape[1], WIDTH), dtype=np.float64)
    in_bands(_surface_tensors, x.shape[1], x, y, z, out, least=_LEAST)
    return out


@kernel()
def _surface_tensors(
    low: int, high: int, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    rows = (x, y, z)
    one, two = np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64)
    normal, turning = np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64)
    rate_one, rate_two = np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64)
    dual_one, dual_two = np.empty(3, dtype=np.float64), np.empty(3, dtype=np.float64)
    for n in range(np.uint64(low), np.uint64(high)):
        for k in range(3):
            one[k], two[k] = rows[k][A, n], rows[k][B, n]
            rate_one[k], rate_two[k] = rows[k][TA, n], rows[k][TB, n]
        e, f, g = 0.0, 0.0, 0.0
        for k in range(3):
            e += one[k] * one[k]
            f += one[k] * two[k]
            g += two[k] * two[k]
        area = e * g - f * f
        if not area > 0.0:
            # Slices take long to compile.
            for k in range(WIDTH):
                out[n, k] = np.nan
            continue
        normal[0] = (one[1] * two[2] - one[2] * two[1]) / np.sqrt(area)
        normal[1] = (one[2] * two[0] - one[0] * two[2]) / np.sqrt(area)
        normal[2] = (one[0] * two[1] - one[1] * two[0]) / np.sqrt(area)
        for k in range(3):
            dual_one[k] = (g * one[k] - f * two[k]) / area
            dual_two[k] = (e * two[k] - f * one[k]) / area
        along_one, along_two, spin = 0.0, 0.0, 0.0
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            along_one += rate_one[k] * normal[k]
            along_two += rate_two[k] * normal[k]
            spin += 0.5 * normal[k] * (dual_one[k1] * rate_one[k2] - dual_one[k2] * rate_one[k1])
            spin += 0.5 * normal[k] * (dual_two[k1] * rate_two[k2] - dual_two[k2] * rate_two[k1])
        for k in range(3):
            rate_one[k] -= along_one * normal[k]
            rate_two[k] -= along_two * normal[k]
            turning[k] = -(dual_one[k] * along_one + dual_two[k] * along_two)
        aa, ab, bb = 0.0, 0.0, 0.0
        for k in range(3):
            aa += rows[k][AA, n] * normal[k]
            ab += rows[k][AB, n] * normal[k]
            bb += rows[k][BB, n] * normal[k]
        for k in range(3):
            k1, k2 = (k + 1) % 3, (k + 2) % 3
            out[n, NORMAL + k] = normal[k]
            out[n, ROTATION + k] = normal[k1] * turning[k2] - normal[k2] * turning[k1] + spin * normal[k]
        for entry in range(6):
            i, j = TENSOR_ROWS[entry], TENSOR_COLUMNS[entry]
            out[n, DEFORMATION + entry] = 0.5 * (
                rate_one[i] * dual_one[j]
                + rate_two[i] * dual_two[j]
                + rate_one[j] * dual_one[i]
                + rate_two[j] * dual_two[i]
            )
            out[n, CURVATURE + entry] = (
                aa * dual_one[i] * dual_one[j]
                + ab * (dual_one[i] * dual_two[j] + dual_two[i] * dual_one[j])
                + bb * dual_two[i] * dual_two[j]
            )
