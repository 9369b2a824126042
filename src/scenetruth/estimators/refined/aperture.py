"""Aperture problem: directions of the image in which the texture of a window exceeds the noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.ambiguity import sum_members
from scenetruth.estimators.refined.kernels.warp import CUBIC, QUINTIC
from scenetruth.estimators.refined.row_bands import window_weights
from scenetruth.threads import in_threads

__all__ = ["ApertureContext", "compute_normal_flow", "find_aperture"]

# Smallest ratio of the weakest to the strongest gradient energy that determines a motion: interpolation errors of some
# 1e-4 of a strong texture act on a weak one as a displacement of 1e-3 px. For disparity, which has one direction, less.
_LEAST_RATIO, _LEAST_ALONG = 1e-2, 1e-3
_ABOVE = 3.0  # smallest ratio of a gradient energy to its standard error
# B-splines and their derivatives at integer positions, by order.
_VALUES = {CUBIC: np.array([1.0, 4.0, 1.0]) / 6.0, QUINTIC: np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0}
_SLOPES = {CUBIC: np.array([1.0, 0.0, -1.0]) / 2.0, QUINTIC: np.array([1.0, 10.0, 0.0, -10.0, -1.0]) / 24.0}
_BORDER_PX = 4  # splines are mirrored at the border, which is a second direction of oblique stripes
_PIXELS = 4000
_DISCONTINUITY_PX = 0.5  # pixels of a window that differ by more than this in the farthest image are of other surfaces

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ApertureContext:
    """Quantities that the texture of each window determines."""

    disparity: Mask
    """Where the texture varies along the baselines, shape (y, x)."""
    motion: Mask
    """Where it varies in both directions of the image."""
    normal: Mask
    """Where it varies in one direction only."""
    direction: Map
    """Unit vector (x, y) of the strongest variation, shape (2, y, x)."""


def find_aperture(
    images: ImageStack, theta: Map, sigma_px: float, small: Mask, small_sigma_px: float, noise: float
) -> ApertureContext:
    """Test the structure tensor of the reference image in each window, less that of noise.

    ``small``: Pixels whose windows are smaller and contain the surface of the central pixel only, shape (y, x).
    """
    from scipy.ndimage import gaussian_filter

    products, variance, usable = _gradient_products(images, noise)
    maps = np.stack([*products, variance, usable])
    share = np.maximum(gaussian_filter(usable, sigma_px), 1e-9)
    means = np.stack([gaussian_filter(each, sigma_px) / share for each in maps[:4]])
    inverse = 1.0 / (4.0 * np.pi * sigma_px**2 * share)
    if small.any():
        pixels = np.argwhere(small & np.isfinite(theta).all(axis=0))
        found = np.zeros((len(maps) + 1, len(pixels)))
        limits = np.array(
            [_DISCONTINUITY_PX / max(images.farthest, 1e-9), _DISCONTINUITY_PX / max(images.longest, 1e-9)]
        )
        weights = window_weights(small_sigma_px)[0, 0]
        work = partial(sum_members, maps, np.ascontiguousarray(theta), limits, weights, pixels, found)
        in_threads(work, [(n, min(n + _PIXELS, len(pixels))) for n in range(0, len(pixels), _PIXELS)])
        at = (pixels[:, 0], pixels[:, 1])
        with np.errstate(invalid="ignore", divide="ignore"):
            for k in range(4):
                means[k][at] = np.where(found[4] > 0, found[k] / found[4], 0.0)
            inverse[at] = found[5] / np.maximum(found[4], 1e-9)
    return _decide(images, means, inverse)


@cache
def _noise_of_slope(order: int) -> tuple[float, float]:
    """Return the mean square slope of white noise, and by how much its correlation increases the variance of a mean."""
    count = 256
    phases = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(count), np.arange(-2, 3)))
    slopes, values = (np.pad(taps[order], (5 - len(taps[order])) // 2) for taps in (_SLOPES, _VALUES))
    power = np.abs(phases @ slopes) ** 2 / np.abs(phases @ values) ** 2
    return float(power.mean()), float((power**2).mean() / power.mean() ** 2)


def _gradient_products(images: ImageStack, noise: float) -> tuple[Map, Map, Map]:
    """Return the gradient products xx, xy, yy of the reference less noise, its variance, and where it is usable.

    Derivatives are those of the splines: central differences weaken short waves along x and y, and would turn the
    direction of a texture.
    """
    from scipy.ndimage import convolve1d

    frame, camera = images.reference()
    usable = images.usable(frame, camera)
    inner = np.zeros(images.shape, dtype=np.bool_)
    inner[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
    usable = usable & inner if inner.any() else usable
    products, variance = np.zeros((3, *images.shape)), np.zeros(images.shape)
    energy, correlated = _noise_of_slope(images.spline)
    values, slopes = _VALUES[images.spline], _SLOPES[images.spline]
    for channel in range(images.channels):
        coefficients = images.cut(images.coefficients[frame][channel, camera], frame, camera).astype(np.float64)
        rows, columns = (convolve1d(coefficients, values, axis=axis, mode="mirror") for axis in (0, 1))
        along = convolve1d(rows, slopes, axis=1, mode="mirror")
        down = convolve1d(columns, slopes, axis=0, mode="mirror")
        grey = convolve1d(rows, values, axis=1, mode="mirror")
        of_noise = energy * noise**2 * images.variance.at(grey)
        products += [along * along - of_noise, along * down, down * down - of_noise]
        # Of a mean square over independent pixels, without the texture.
        variance += 2.0 * correlated * of_noise**2
    flags = usable.astype(np.float64)
    return products * flags, variance * flags, flags


def _decide(images: ImageStack, means: Map, inverse: Map) -> ApertureContext:
    """Return the quantities that are determined by mean gradient products and their variances."""
    xx, xy, yy, variance = means
    error = np.sqrt(np.maximum(variance * inverse, 0.0))
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    strongest, weakest = middle + half, middle - half
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    textured = strongest > _ABOVE * error
    motion = textured & (weakest > np.maximum(_LEAST_RATIO * strongest, _ABOVE * error))
    along = _along_baselines(images, xx, xy, yy)
    disparity = textured & (along > np.maximum(_LEAST_ALONG * strongest, _ABOVE * error))
    if len(images.positions) == 1:
        disparity = textured
    if len(images.times) == 1:
        motion = textured
    return ApertureContext(disparity, motion, textured & ~motion, np.stack([np.cos(angle), np.sin(angle)]))


def _along_baselines(images: ImageStack, xx: Map, xy: Map, yy: Map) -> Map:
    """Return the gradient energy along the baselines, weighted by their squares."""
    s: NDArray[Any] = images.positions - images.positions.mean(axis=0)
    spread = s.T @ s
    total = max(float(np.trace(spread)), 1e-300)
    return np.asarray((spread[0, 0] * xx + 2.0 * spread[0, 1] * xy + spread[1, 1] * yy) / total)


def compute_normal_flow(flow: Map, direction: Map) -> Map:
    """Return the component of a flow along a direction: the solution of least norm of the aperture problem."""
    return np.asarray((flow * direction).sum(axis=0) * direction)
