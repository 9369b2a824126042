"""Mean of all images at the points of the reference pixels: the texture of the fits with less noise than an image."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import DISCONTINUITY_PX, extract_fields, find_discontinuities
from scenetruth.estimators.refined.image_stack import ImageStack, filter_image
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.kernels.warp import warp_rows
from scenetruth.estimators.refined.kernels.window_solver import Fit
from scenetruth.estimators.refined.row_bands import NO_OCCLUSION
from scenetruth.threads import in_threads

__all__ = ["MeanImage", "find_outlines", "warped_rows"]

_ROWS, _TASK_ROWS = 64, 16  # rows of the warped images in memory, and per task of a thread
_LEAST_SEEN = 5  # images that must show a pixel of the mean image; with fewer, it is hardly less noisy than one of them
# Displacements whose standard deviation exceeds this fraction of a discontinuity differ between pixels by noise; and
# smallest number of connected pixels of an outline: the reach of the smallest windows.
_OF_NOISE, _SHORTEST_PX = 1 / 3, 4

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


def find_outlines(images: ImageStack, fit: Fit) -> Mask:
    """Return where the surface of an adjacent pixel is another, or invalid, apart from differences due to noise.

    In strong noise, fits of adjacent small windows at the border of the image differ, and single pixels have no fit.
    """
    from scipy.ndimage import label

    found = find_discontinuities(images, fit.theta)
    if not found.any():
        return found
    first, *others = images.arms(4)
    with np.errstate(invalid="ignore"):
        variance = np.stack([each * arm**2 for each, arm in zip(fit.variance[3:6], others, strict=True)])
        displacement = np.maximum(fit.variance[0] * first**2, (fit.theta[0] ** 2 * variance).max(axis=0))
        found &= ~(displacement > (_OF_NOISE * DISCONTINUITY_PX) ** 2)
    parts, _ = label(found, np.ones((3, 3)))
    return np.asarray(found & (np.bincount(parts.ravel()) >= _SHORTEST_PX)[parts])


def warped_rows(
    images: ImageStack, theta: Map, where: Mask
) -> Iterator[tuple[int, slice, NDArray[np.float32], NDArray[np.float32]]]:
    """Give, channel by channel, rows, their images at the points of the reference pixels, and the mean gradient.

    Images are NaN where they do not show a point, and everywhere if they are excluded, shape (n, rows, x); the gradient
    has shape (2, rows, x). Rows without a pixel in the mask are not given.
    """
    view, width = images.view(), images.shape[1]
    every = len(view.s)  # also excluded images, which are NaN
    fields = np.where(where, extract_fields(theta), np.nan)
    bad = images.bad_stack()
    wanted = np.flatnonzero(where.any(axis=1))
    for channel in range(images.channels if len(wanted) else 0):
        stack = images.stack(channel)
        for top in range(wanted[0], wanted[-1] + 1, _ROWS):
            rows = slice(top, min(top + _ROWS, wanted[-1] + 1))
            size = rows.stop - top
            warped = np.full((every, size, width), np.nan, dtype=np.float32)
            gradient = np.zeros((2, size, width), dtype=np.float32)
            work = partial(warp_rows, stack, view, fields, NO_OCCLUSION, bad, top, warped, gradient)
            in_threads(work, [(row, min(row + _TASK_ROWS, size)) for row in range(0, size, _TASK_ROWS)])
            yield channel, rows, warped, gradient


class MeanImage:
    """Mean of all images, computed at the pixels that are required.

    ``allowed``: Pixels whose windows contain no other surface, shape (y, x).
    """

    def __init__(self, images: ImageStack, theta: Map, allowed: Mask) -> None:
        self._images, self._theta = images, theta
        self.spline, self.fields = images.spline, len(extract_fields(theta[:, :1, :1]))
        self._allowed: Mask = allowed & np.isfinite(theta).all(axis=0)
        self._done: Mask = np.zeros(images.shape, dtype=np.bool_)
        self.grey: Map = np.full(images.shape, np.nan)
        """Grey values averaged over images and channels, NaN where not available, shape (y, x)."""
        self.share: Map = np.full(images.shape, np.nan)
        """Variance of their noise relative to that of one image, shape (y, x)."""
        self.coefficients: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
        """Spline coefficients, shape (y, x)."""

    def extend(self, where: Mask) -> None:
        """Compute further pixels."""
        wanted = where & self._allowed & ~self._done
        if not wanted.any():
            return
        self._done |= wanted
        total, seen = np.zeros(self._images.shape), np.zeros(self._images.shape)
        for channel, rows, warped, _ in warped_rows(self._images, self._theta, wanted):
            known = np.isfinite(warped)
            total[rows] += np.where(known, warped, 0.0).sum(axis=0, dtype=np.float64)
            if channel == 0:
                seen[rows] = known.sum(axis=0)
        shown = wanted & (seen >= _LEAST_SEEN)
        self.grey[shown] = total[shown] / (seen[shown] * self._images.channels)
        self.share[shown] = self._images.mean_share / seen[shown]
        available: NDArray[Any] = np.isfinite(self.grey)
        if available.any():
            whole = fill_gaps(self.grey[None], available)[0]
            self.coefficients = filter_image(whole, self._images.spline).astype(np.float32)
