"""Image noise from the residuals of the fits, its dependence on the grey value, and the effect of interpolation."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.pixel_equations import LEAST_VARIANCE

__all__ = [
    "EVEN",
    "GreyVariance",
    "estimate_noise",
    "estimate_variance",
    "photon_transfer_variance",
    "resampled_transfer",
    "spline_slope_transfer",
    "spline_transfer",
]


Map = NDArray[np.float64]

QUINTIC_ORDER = 5
_WELL = 0.25  # quantile of the residuals at which windows are assumed to contain pure noise


def estimate_noise(left: NDArray[np.float64]) -> float:
    """Return the standard deviation of the image noise from the residuals of the windows that fit well."""
    known = left[np.isfinite(left)]
    return float(np.quantile(known, _WELL)) if known.size else float("nan")


@cache
def spline_transfer(order: int) -> float:
    """Return the ratio of the standard deviation of white noise after spline interpolation to that before.

    It is the square root of the mean, over all subpixel positions, of the sum of the squared weights of the surrounding
    pixels, in two dimensions.
    """
    return _mean_square(order, 0)


def resampled_transfer(order: int, share: Map | float) -> Any:
    """Return the transfer of a spline for images that were resampled before by a quintic spline.

    A first interpolation removes the same high frequencies as the second, so that the second removes less of them. Its
    variance is the share to a power of about 0.7, to 1 % for every subpixel position, of the transfer of white noise.

    ``share``: Variance of white noise after the resampling, relative to that before; 1 for images as recorded.
    """
    return spline_transfer(order) * np.asarray(share) ** (0.5 * _resampled_power(order))


@cache
def _resampled_power(order: int) -> float:
    """Return the power of the share of a quintic resampling by which it changes the variance after a spline."""
    frequencies = np.linspace(0.0, np.pi, 1025)
    places = np.arange(32) / 32
    every = np.mean([_power(order, place, frequencies) for place in places], axis=0)
    first = [_power(QUINTIC_ORDER, place, frequencies) for place in places]
    shares = np.array([np.trapezoid(power, frequencies) / np.pi for power in first])
    both = np.array([np.trapezoid(power * every, frequencies) for power in first])
    both /= np.trapezoid(every, frequencies)
    return float(np.log(both).sum() / np.log(shares).sum())


def _power(order: int, place: float, frequencies: Map) -> Map:
    """Return the squared amplitude of waves after interpolation at a subpixel position by a spline."""
    from scipy.interpolate import make_interp_spline

    at = np.arange(-32.0, 33.0)
    taps = np.arange(-24, 25)
    weights = make_interp_spline(at, (at == 0).astype(np.float64), k=order)(taps + place)
    return np.asarray(np.abs(np.exp(1j * np.outer(frequencies, taps)) @ weights) ** 2)


@cache
def spline_slope_transfer(order: int) -> float:
    """Return the standard deviation of an interpolated derivative, per px, for white noise of 1."""
    return float(np.sqrt(_mean_square(order, 0) * _mean_square(order, 1)))


def _mean_square(order: int, derivative: int) -> float:
    """Return the integral of the squared cardinal spline, or of its squared derivative, in one dimension."""
    from scipy.interpolate import make_interp_spline

    at = np.arange(-32.0, 33.0)
    cardinal = make_interp_spline(at, (at == 0).astype(np.float64), k=order)
    fine = np.arange(-24.0, 24.0, 1 / 64)
    values = (cardinal.derivative() if derivative else cardinal)(fine)
    return float(np.sum(values**2) / 64)


# Number of grey-value classes of equal size, and fraction of well-fitted pixels in each.
_PARTS, _WELL_FITTED_SHARE = 24, 0.25
_LEAST_PIXELS = 50  # smallest number of pixels of a class
_LEAST_SPREAD = 1e-3  # smallest spread of the grey values of the classes relative to their mean


class GreyVariance(NamedTuple):
    """Noise variance linear in the grey value, relative to that of a mean grey value: photon transfer of a sensor."""

    at_zero: float
    """Variance at a grey value of zero."""
    per_grey: float
    """Increase of the variance per grey value."""

    def at(self, grey: Map) -> Map:
        """Return the variance at grey values."""
        return np.maximum(self.at_zero + self.per_grey * grey, LEAST_VARIANCE)

    def over(self, grey: float) -> GreyVariance:
        """Return the variance relative to that at another grey value."""
        unit = max(self.at_zero + self.per_grey * grey, 1e-300)
        return GreyVariance(self.at_zero / unit, self.per_grey / unit)


EVEN = GreyVariance(1.0, 0.0)
"""Constant variance."""


def photon_transfer_variance(
    dark_noise_dn: float, gain_dn_per_e: float, dark_level_dn: float, grey: float
) -> GreyVariance:
    """Return the variance from the photon transfer of a sensor, relative to that of a mean grey value."""
    return GreyVariance(dark_noise_dn**2 - gain_dn_per_e * dark_level_dn, gain_dn_per_e).over(grey)


def estimate_variance(grey: Map, square: Map) -> GreyVariance:
    """Estimate the noise variance as a function of the grey value from the residuals of the fits.

    The lower quartile of the squared residuals in each of 24 grey-value classes is used, because windows with a misfit
    have larger residuals. A line is fitted to it by relative errors.

    ``square``: Mean square residual, not finite where invalid; of the same shape.
    """
    known = np.isfinite(square) & (square > 0)
    grey, square = grey[known], square[known]
    if grey.size < 2 * _LEAST_PIXELS:
        return EVEN
    mean = float(grey.mean())
    parts = np.array_split(np.argsort(grey), min(_PARTS, grey.size // _LEAST_PIXELS))
    middle = np.array([grey[part].mean() for part in parts])
    left = np.array([np.quantile(square[part], _WELL_FITTED_SHARE) for part in parts])
    if np.ptp(middle) < _LEAST_SPREAD * abs(mean):
        return EVEN
    design = np.stack([np.ones_like(middle), middle - mean], axis=-1) / left[:, None]
    (level, slope), *_ = np.linalg.lstsq(design, np.ones_like(left), rcond=None)
    # The variance increases with the intensity.
    if not (level > 0 and slope > 0):
        return EVEN
    return GreyVariance(float(level - slope * mean), float(slope)).over(mean)
