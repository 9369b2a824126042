"""The areal growth rate from affine fits in Gaussian windows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["windowed_growth"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]
Moments = tuple[Map, Map, Map]

_TRUNCATE = 3.0
"""Reach of the window in standard deviations. The fit of affine fields is exact for any weights."""

_FLAT = 1e-6
"""Least determinant of a window's covariance, in units of sigma^4, that tells x from y."""


def windowed_growth(
    points: Map, velocity: Map, patches: Labels, window_px: float | tuple[float, float], min_coverage: float = 0.5
) -> Map:
    """Return the areal growth rate of one frame; see `scenetruth.scoring.surface_growth` for the formula.

    Parameters
    ----------
    points, velocity
        Surface points in mm and their velocities in mm per frame, shape (3, y, x).
    patches
        The piece of surface that each pixel belongs to, shape (y, x); windows take pixels of their centre's piece only,
        and none where it is negative.
    window_px
        Standard deviation of the Gaussian weights, in pixels of the map; they reach three times as far. If two, along
        y and along x.
    min_coverage
        Least share of a window's weight that must lie on its piece.

    Returns
    -------
    numpy.ndarray
        In 1/frame, shape (y, x); NaN off all pieces, and where the window holds too little.
    """
    growth = np.full(patches.shape, np.nan)
    sigma_y, sigma_x = window_px if isinstance(window_px, tuple) else (window_px, window_px)
    window = _Window(_moments(sigma_y), _moments(sigma_x), _FLAT * (sigma_y * sigma_x) ** 2, min_coverage)
    # A piece smaller than this fills no window.
    least = min_coverage / (window.along_y[0].max() * window.along_x[0].max())
    sizes = np.bincount(patches[patches >= 0].ravel(), minlength=1)
    for number, box in enumerate(ndimage.find_objects(patches + 1)):
        if sizes[number] < least:
            continue
        inside = patches[box] == number
        fields = np.where(inside, np.concatenate([points[:, *box], velocity[:, *box]]), 0.0)
        values = _growth_of_piece(fields, inside, window)
        growth[box][inside] = values[inside]
    return growth


@dataclass(frozen=True)
class _Window:
    """Gaussian weights along y and x (see `_moments`), and the least that a window must hold."""

    along_y: Moments
    along_x: Moments
    min_determinant: float
    min_coverage: float


def _growth_of_piece(fields: Map, inside: Mask, window: _Window) -> Map:
    """Return the growth rate of one piece, from its points and velocities (6, y, x), zero off it."""
    one_y, first_y, second_y = window.along_y
    one_x, first_x, second_x = window.along_x
    mask = inside.astype(np.float64)
    plain, along_x = _filtered(mask, one_x, -1), _filtered(mask, first_x, -1)
    weight = _filtered(plain, one_y, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_x, mean_y = _filtered(along_x, one_y, -2) / weight, _filtered(plain, first_y, -2) / weight
        # Covariance of the pixels' places in the window.
        c_xx = _filtered(_filtered(mask, second_x, -1), one_y, -2) / weight - mean_x**2
        c_xy = _filtered(along_x, first_y, -2) / weight - mean_x * mean_y
        c_yy = _filtered(plain, second_y, -2) / weight - mean_y**2
        determinant = c_xx * c_yy - c_xy**2
        plain, along_x = _filtered(fields, one_x, -1), _filtered(fields, first_x, -1)
        mean = _filtered(plain, one_y, -2) / weight
        by_x = _filtered(along_x, one_y, -2) / weight - mean_x * mean
        by_y = _filtered(plain, first_y, -2) / weight - mean_y * mean
        d_x, d_y = (c_yy * by_x - c_xy * by_y) / determinant, (c_xx * by_y - c_xy * by_x) / determinant
        (p_x, u_x), (p_y, u_y) = (np.split(derivative, 2) for derivative in (d_x, d_y))
        area = np.cross(p_x, p_y, axis=0)
        change = np.cross(u_x, p_y, axis=0) + np.cross(p_x, u_y, axis=0)
        growth = (change * area).sum(axis=0) / (area * area).sum(axis=0)
    usable = (weight >= window.min_coverage) & (determinant > window.min_determinant)
    return np.where(usable, growth, np.nan)


def _moments(window_px: float) -> Moments:
    """Return Gaussian weights over an offset u, of sum 1, and these times u and u²."""
    reach = max(1, math.ceil(_TRUNCATE * window_px))
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    weight = np.exp(-0.5 * (offset / window_px) ** 2)
    weight /= weight.sum()
    return weight, weight * offset, weight * offset**2


def _filtered(values: Map, kernel: Map, axis: int) -> Map:
    filtered: Map = ndimage.correlate1d(values, kernel, axis=axis, mode="constant")
    return filtered
