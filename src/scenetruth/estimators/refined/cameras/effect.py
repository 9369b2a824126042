"""What uncertain corrections of images do to disparity and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.cameras.points import moves_of
from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["Effect", "effect_of"]

# Distance in px of the points at which it is computed; in between it is linear.
_STEP_PX = 24

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Effect:
    """Variances that uncertain corrections add."""

    variance: Array
    """Of d, q_X, q_Y and q_Z at every pixel, shape (4, y, x)."""


def effect_of(view: View, fields: Array, rooted: Array) -> Effect:
    """Return by how much uncertain corrections vary what is fitted to every pixel.

    A point whose texture is the same in all directions follows the corrections c by K c, with the derivatives A and E
    of where images show it by its own parameters and by corrections, K = (Aᵀ A)⁻¹ Aᵀ E.

    Parameters
    ----------
    view
        Where and when the images were taken.
    fields
        d, q_X, q_Y and q_Z of every pixel, finite, shape (4, y, x).
    rooted
        L of the corrections' covariance L Lᵀ, shape (4 n, any).
    """
    from scipy.ndimage import map_coordinates

    height, width = fields.shape[1:]
    rows, columns = (np.linspace(0, size - 1, max(2, size // _STEP_PX)).round().astype(int) for size in (height, width))
    down, across = np.meshgrid(rows, columns, indexing="ij")
    at = np.stack([across.ravel(), down.ravel()]).astype(np.float64)
    own = fields[:, down.ravel(), across.ravel()]
    moves = moves_of(view, own, at)
    points = len(at[0])
    by_point = moves.by_point.reshape(points, -1, moves.by_point.shape[-1])
    size = np.linalg.norm(by_point, axis=1) + 1e-300
    follow = np.linalg.pinv(by_point / size[:, None], rcond=1e-4) / size[:, :, None]
    varied = np.empty((4, points))
    pairs = rooted.reshape(-1, 4, rooted.shape[-1])
    for n in range(points):
        moved = np.einsum("nki,niu->nku", moves.by_image[n], pairs, optimize=True).reshape(-1, rooted.shape[-1])
        varied[:, n] = np.square(follow[n, :4] @ moved).sum(axis=-1)
    # The effect on the velocity goes with 1 / d.
    varied[1:] *= own[0] ** 2
    y, x = np.mgrid[:height, :width]
    places = np.stack([np.interp(y, rows, np.arange(len(rows))), np.interp(x, columns, np.arange(len(columns)))])
    maps = [map_coordinates(each.reshape(down.shape), places, order=1, mode="nearest") for each in varied]
    variance = np.stack(maps)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance[1:] /= fields[0] ** 2
    return Effect(variance)
