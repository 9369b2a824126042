"""Comparison of growth between the plain and the affine motion model: significant anisotropy, and what noise may hide.

Isotropic growth is an assumption of the plain model. Where it fails, the plain growth rate is biased by many of its
standard deviations while disparity, velocity and residual hardly change, so that growth itself must be compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.fit_maps import LEAST_PX
from scenetruth.estimators.refined.initialisation import fill_gaps
from scenetruth.estimators.refined.iterations import RefinedState
from scenetruth.estimators.refined.kernels.window_solver import Fit
from scenetruth.schema.variables import MOTION_PLAIN

__all__ = ["RATES", "GrowthComparison", "add_growth_bias", "compare_growth"]


RATES = slice(4, 8)
"""Rotation rate (3) and growth rate among the quantities of the surface element."""
_GROWTH = 3  # growth rate among these
# Scales of averaging in window widths: a local bias shows at the first, a weak one of a whole surface at the last.
_SCALES = (2.0, 4.0, 8.0)
_MOST = 9.0  # largest squared difference of a pixel in a test, in multiples of its noise; as for other motion models
_ONE_IN_THOUSAND = 3.09  # normal deviate of the probability that noise appears significant
_LEAST_PART = 0.5  # lower limit of the noise of their difference, relative to that of the affine fit
# Standard deviations from which a mean difference, or a mean square, at one of the scales counts as a bias; and the
# bias that the mean over a whole surface may miss, as a fraction of its variance.
_LIKELY, _HIDDEN = 2.0, 0.75
_LEAST_WINDOWS = 3.0  # smallest surface that is averaged by itself, in squares of the window width
_Q_X = 3  # variance of q_X

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]


class GrowthComparison(NamedTuple):
    """Difference between the plain and the affine fit."""

    significant: Mask
    """Where growth differs by more than noise, and the bias of the plain fit exceeds the noise of the affine one."""
    bias: Map
    """Mean square bias of the plain rotation and growth rates, shape (4, y, x)."""


def compare_growth(plain: Fit, affine: Fit, sigma_px: float, among: Mask, transfer: float) -> GrowthComparison:
    """Compare plain and affine rotation and growth rates, with windows of a standard deviation in pixels of the maps.

    The squared difference D² of nested fits has the expectation b² + v with the bias b of the plain fit and the
    difference v of the variances. Means of D² / v at several scales, over n independent windows each, are compared with
    χ² / n. Below significance, the bias follows from the means of D, in which a bias of one sign over a surface exceeds
    noise by far earlier, and from the excess of the mean squares, for biases that change their sign.

    ``among``: Pixels included in the averages; parts that do not touch are separate surfaces. ``transfer``: Ratio of
    noise after interpolation to that before.
    """
    from scipy.ndimage import find_objects, label

    difference, noise = _differences(plain, affine, transfer)
    valid = among & np.isfinite(difference).all(axis=0) & (np.isfinite(noise) & (noise > 0.0)).all(axis=0)
    significant, included = np.zeros_like(valid), np.zeros_like(valid)
    bias = np.zeros(difference.shape)
    surfaces, _ = label(valid)
    for number, box in enumerate(find_objects(surfaces), 1):
        own = surfaces[box] == number
        if own.sum() < _LEAST_WINDOWS * sigma_px**2:
            continue
        part = (slice(None), *box)
        values = np.where(own, difference[part], 0.0), np.where(own, noise[part], np.inf)
        differs, biased = _compare(*values, own, sigma_px)
        significant[box] |= differs & own
        bias[part] = np.where(own, biased, bias[part])
        included[box] |= own
    # Windows over edges measure no anisotropy: they have the bias of the surface.
    return GrowthComparison(significant, fill_gaps(bias, included) if included.any() else bias)


def _compare(difference: Map, noise: Map, own: Mask, sigma_px: float) -> tuple[Mask, Map]:
    """Return where growth differs on one surface, and the mean square bias of all rates."""
    significant, bias = np.zeros_like(own), np.zeros(difference.shape)
    normal = difference / np.sqrt(noise)
    ratio = normal**2
    # The noise of the surroundings: single pixels of little texture have no information on the bias.
    usual = 1.0 / np.maximum(_mean(1.0 / noise, own, _SCALES[0] * sigma_px), 1e-300)
    for scale in _scales(own, sigma_px):
        tested = _mean(np.minimum(ratio, _MOST), own, scale.sigma_px) - 1.0
        if scale.sigma_px < _SCALES[-1] * sigma_px:
            excess = _mean(ratio, own, scale.sigma_px) - 1.0
            square = _mean(normal, own, scale.sigma_px) ** 2
            least = np.zeros_like(square)
        else:
            # Large differences of single pixels must not spread over a surface.
            excess = tested
            square = _mean(np.clip(normal, -math.sqrt(_MOST), math.sqrt(_MOST)), own, scale.sigma_px) ** 2
            least = _HIDDEN * scale.variance
        significant |= (tested[_GROWTH] > scale.significant) & (excess[_GROWTH] * usual[_GROWTH] > noise[_GROWTH])
        of_mean = np.where(square > _LIKELY**2 * scale.variance, square - scale.variance, least)
        of_square = np.where(tested > _LIKELY * scale.std, excess, 0.0)
        bias = np.maximum(bias, np.maximum(of_mean, of_square) * usual)
    return significant, bias


def add_growth_bias(refined: RefinedState) -> RefinedState:
    """Return the fit with the bias of the plain model, as far as noise may hide it, in the variances of its rates."""
    if refined.growth_bias is None:
        return refined
    variance = refined.fit.element_variance.copy()
    variance[RATES] += np.where(refined.motion == MOTION_PLAIN, refined.growth_bias, 0.0)
    return replace(refined, fit=refined.fit._replace(element_variance=variance))


class _Scale(NamedTuple):
    """Statistics of means of squares of unit variance."""

    sigma_px: float
    std: Map
    """Standard deviation of a mean of squares."""
    variance: Map
    """Variance of a mean of the values themselves."""
    significant: Map
    """Excess of a mean over 1 that noise reaches once in a thousand."""


def _scales(own: Mask, sigma_px: float) -> Iterator[_Scale]:
    """Yield the scales of averaging, the smallest first.

    Windows at a distance r have a correlation of exp(-r² / 4σ²), and their squares exp(-r² / 2σ²), so that a Gaussian
    mean over s σ includes 1 + 2 s² independent windows for squares, and 1 + s² for the values themselves. The quantile
    of χ² / n is that of Wilson and Hilferty.
    """
    for scale in _SCALES:
        windows = scale**2 * _blurred(own.astype(np.float64), scale * sigma_px)
        count = 1.0 + 2.0 * windows
        small = 2.0 / (9.0 * count)
        quantile = (1.0 - small + _ONE_IN_THOUSAND * np.sqrt(small)) ** 3
        yield _Scale(scale * sigma_px, np.sqrt(2.0 / count), 1.0 / (1.0 + windows), quantile - 1.0)


def _blurred(values: Map, sigma_px: float) -> Map:
    """Return Gaussian averages over the rows and columns, with zeros outside."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(values, sigma_px, axes=(-2, -1), mode="constant"))


def _mean(values: Map, own: Mask, sigma_px: float) -> Map:
    """Return the means of maps over the pixels of a surface, those of each pixel's surroundings."""
    return np.where(own, _blurred(values, sigma_px) / np.maximum(_blurred(own.astype(np.float64), sigma_px), 1e-9), 0.0)


def _differences(plain: Fit, affine: Fit, transfer: float) -> tuple[Map, Map]:
    """Return the differences of the rates, and the variances of these differences, shape (4, y, x)."""
    few, many = (fit.element_variance[RATES].astype(np.float64) / transfer**2 for fit in (plain, affine))
    with np.errstate(invalid="ignore", divide="ignore"):
        difference = affine.element[RATES].astype(np.float64) - plain.element[RATES]
        # Interpolated images are not exact: the same lower limit as for velocity, in units of its noise.
        floor = (LEAST_PX / np.maximum(np.abs(affine.theta[0]), 1e-3)) ** 2 / affine.variance[_Q_X] * transfer**2
        return difference, np.maximum(many - few, np.maximum(floor, _LEAST_PART) * many)
