"""Aperture problem: directions of the image in which the texture of a window exceeds the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from scenetruth.estimators.refined.fit_maps import find_discontinuities
from scenetruth.estimators.refined.image_stack import ImageStack
from scenetruth.estimators.refined.kernels.ambiguity import sum_members
from scenetruth.estimators.refined.kernels.warp import CUBIC, QUINTIC
from scenetruth.estimators.refined.mean_image import warped_rows
from scenetruth.estimators.refined.row_bands import around, window_weights
from scenetruth.threads import in_threads

__all__ = ["ApertureContext", "compute_normal_flow", "find_aperture"]

# Smallest ratio of the weakest to the strongest gradient energy that determines a motion: interpolation errors of some
# 1e-4 of a strong texture act on a weak one as a displacement of 1e-3 px. For disparity, which has one direction, less.
_LEAST_RATIO, _LEAST_ALONG = 1e-2, 1e-3
# In the mean of all images: its errors are those of the fits, and textures of two directions have more.
_LEAST_RATIO_OF_MEAN = 0.1
_ABOVE = 3.0  # smallest ratio of a gradient energy to its standard error
# B-splines and their derivatives at integer positions, by order.
_VALUES = {CUBIC: np.array([1.0, 4.0, 1.0]) / 6.0, QUINTIC: np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0}
_SLOPES = {CUBIC: np.array([1.0, 0.0, -1.0]) / 2.0, QUINTIC: np.array([1.0, 10.0, 0.0, -10.0, -1.0]) / 24.0}
_BORDER_PX = 4  # splines are mirrored at the border, which is a second direction of oblique stripes
_PIXELS = 4000
_REACH = 3.0  # standard deviations of a window around a pixel that the mean image decides
_LEAST_SEEN = 0.5  # smallest fraction of the images that show a pixel of the mean image
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
    images: ImageStack,
    theta: Map,
    sigma_px: float,
    small: Mask,
    small_sigma_px: float,
    noise: float,
    where: Mask | None = None,
    outlines: Mask | None = None,
) -> ApertureContext:
    """Test the structure tensor of the reference image in each window, less that of noise.

    Where noise conceals a direction, the mean of all images decides, in which it is weaker.

    ``small``: Pixels whose windows are smaller and contain the surface of the central pixel only, shape (y, x).
    ``where``: Pixels for which the mean image may decide; none by default.
    ``outlines``: Discontinuities, in whose neighbourhood it may not decide; by default those of the fits.
    """
    products, variance, usable = _gradient_products(images, noise)
    maps = np.stack([*products, variance, usable])
    windows = theta, sigma_px, small_sigma_px
    context, concealed = _decide(images, *_window_means(images, maps, *windows, small))
    if where is None:
        return context
    concealed &= where
    if (concealed & small).any():
        # At outlines, occluded images have the texture of another surface; at the border, they are outside.
        outlines = find_discontinuities(images, theta) if outlines is None else outlines
        concealed &= ~(small & around(outlines, math.ceil(2.0 * sigma_px)))
    if not concealed.any():
        return context
    near = around(concealed, math.ceil(_REACH * sigma_px)) & np.isfinite(theta).all(axis=0)
    maps = _mean_products(images, theta, noise, near)
    of_mean, _ = _decide(images, *_window_means(images, maps, *windows, small & concealed), _LEAST_RATIO_OF_MEAN)
    return ApertureContext(
        *(
            np.where(concealed, getattr(of_mean, name), getattr(context, name))
            for name in ("disparity", "motion", "normal", "direction")
        )
    )


def _window_means(
    images: ImageStack, maps: Map, theta: Map, sigma_px: float, small_sigma_px: float, small: Mask
) -> tuple[Map, Map]:
    """Return means of gradient products and their variance over windows, and the inverse number of their pixels."""
    from scipy.ndimage import gaussian_filter

    share = np.maximum(gaussian_filter(maps[4], sigma_px), 1e-9)
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
    return means, inverse


def _mean_products(images: ImageStack, theta: Map, noise: float, where: Mask) -> Map:
    """Return the gradient products of the mean of all images less noise, their variance, and where they are usable."""
    count = images.count
    energy, correlated = _noise_of_slope(images.spline, between=True)
    energy *= images.mean_share**_SHARE_POWER_BETWEEN
    out = np.zeros((5, *images.shape))
    grey = [images.grey(*images.reference(), channel) for channel in range(images.channels)]
    for channel, rows, warped, gradient in warped_rows(images, theta, where):
        seen = np.isfinite(warped).sum(axis=0)
        along, down = gradient.astype(np.float64)
        of_noise = energy * noise**2 * images.variance.at(grey[channel][rows]) / np.maximum(seen, 1)
        usable = (seen >= max(_LEAST_SEEN * count, 1)) & where[rows]
        parts = along * along - of_noise, along * down, down * down - of_noise, 2.0 * correlated * of_noise**2
        out[:4, rows] += np.where(usable, np.stack(parts), 0.0)
        out[4, rows] = usable
    return out


# A quintic resampling reduces the mean square slope of noise at the pixels by its share, to 3 %; that between the
# pixels, which the splines steepen at the highest frequencies, by this power of the share.
_SHARE_POWER_BETWEEN = 1.35


@cache
def _noise_of_slope(order: int, *, between: bool = False) -> tuple[float, float]:
    """Return the mean square slope of white noise, and by how much its correlation increases the variance of a mean.

    ``between``: Of slopes at any position between the pixels, not at the pixels.
    """
    count = 256
    phases = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(count), np.arange(-3, 4)))
    values = np.pad(_VALUES[order], (7 - len(_VALUES[order])) // 2)
    if between:
        steps = (np.arange(16) + 0.5) / 16
        spline = BSpline.basis_element(np.arange(order + 2) - (order + 1) / 2, extrapolate=False).derivative()
        slopes = np.nan_to_num(spline(np.arange(-3, 4)[:, None] + steps))
    else:
        slopes = np.pad(_SLOPES[order], (7 - len(_SLOPES[order])) // 2)[:, None]
    power = (np.abs(phases @ slopes) ** 2).mean(axis=1) / np.abs(phases @ values) ** 2
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
    energy *= float(np.mean(images.reference_share))
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


def _decide(
    images: ImageStack, means: Map, inverse: Map, least_ratio: float = _LEAST_RATIO
) -> tuple[ApertureContext, Mask]:
    """Return the quantities that mean gradient products determine, and where noise may conceal others."""
    xx, xy, yy, variance = means
    error = np.sqrt(np.maximum(variance * inverse, 0.0))
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    strongest, weakest = middle + half, middle - half
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    textured = strongest > _ABOVE * error
    motion = textured & (weakest > np.maximum(least_ratio * strongest, _ABOVE * error))
    along = _along_baselines(images, xx, xy, yy)
    disparity = textured & (along > np.maximum(_LEAST_ALONG * strongest, _ABOVE * error))
    if len(images.positions) == 1:
        disparity = textured
    if len(images.times) == 1:
        motion = textured
    # Directions that are below the limit in noise, and may be above it without.
    concealed = ~motion & (weakest + _ABOVE * error > _LEAST_RATIO * strongest)
    concealed |= ~disparity & (along + _ABOVE * error > _LEAST_ALONG * strongest)
    context = ApertureContext(disparity, motion, textured & ~motion, np.stack([np.cos(angle), np.sin(angle)]))
    return context, np.asarray(concealed)


def _along_baselines(images: ImageStack, xx: Map, xy: Map, yy: Map) -> Map:
    """Return the gradient energy along the baselines, weighted by their squares."""
    s: NDArray[Any] = images.positions - images.positions.mean(axis=0)
    spread = s.T @ s
    total = max(float(np.trace(spread)), 1e-300)
    return np.asarray((spread[0, 0] * xx + 2.0 * spread[0, 1] * xy + spread[1, 1] * yy) / total)


def compute_normal_flow(flow: Map, direction: Map) -> Map:
    """Return the component of a flow along a direction: the solution of least norm of the aperture problem."""
    return np.asarray((flow * direction).sum(axis=0) * direction)
