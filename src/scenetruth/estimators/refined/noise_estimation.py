"""The noise of the images as the fits show it, its dependence on the grey value, and the effect of interpolation."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.pixel_equations import LEAST_VARIANCE

__all__ = [
    "EVEN",
    "GreyVariance",
    "estimate_noise",
    "estimate_variance",
    "photon_transfer_variance",
    "spline_slope_transfer",
    "spline_transfer",
    "textured",
]


# Windows that are fitted this well, or better, show nothing but noise.
_WELL = 0.25
# A texture's mean square gradient is this many times that of the noise in the mean of the images.
_ABOVE_NOISE = 4.0


def estimate_noise(left: NDArray[np.float64]) -> float:
    """Return the standard deviation of the images' noise from what fits leave: that of the windows that fit well."""
    known = left[np.isfinite(left)]
    return float(np.quantile(known, _WELL)) if known.size else float("nan")


def textured(mean_square_gradient: NDArray[np.float64], noise: float, images: int, spline: int) -> NDArray[np.bool_]:
    """Tell where the mean of the images has more gradient than their noise would give it.

    ``mean_square_gradient``: Mean over a window of the squared gradient of the images' mean, in grey values per px.
    """
    by_noise = 2.0 * (spline_slope_transfer(spline) * noise) ** 2 / images
    with np.errstate(invalid="ignore"):
        return np.asarray(mean_square_gradient > _ABOVE_NOISE * by_noise)


@cache
def spline_transfer(order: int) -> float:
    """Return what share of white noise, as a standard deviation, splines of an order leave between pixels.

    The square root of the mean, over all places between pixels, of the sum of the squared weights that a place gives to
    the pixels around it, in two dimensions.
    """
    return _mean_square(order, 0)


@cache
def spline_slope_transfer(order: int) -> float:
    """Return the standard deviation of a derivative between pixels that white noise of 1 leaves, per px."""
    return float(np.sqrt(_mean_square(order, 0) * _mean_square(order, 1)))


def _mean_square(order: int, derivative: int) -> float:
    """Return the integral of the squared cardinal spline, or of its squared derivative, in one dimension."""
    from scipy.interpolate import make_interp_spline

    at = np.arange(-32.0, 33.0)
    cardinal = make_interp_spline(at, (at == 0).astype(np.float64), k=order)
    fine = np.arange(-24.0, 24.0, 1 / 64)
    values = (cardinal.derivative() if derivative else cardinal)(fine)
    return float(np.sum(values**2) / 64)


Map = NDArray[np.float64]

# Grey values are sorted into so many parts of equal size; in each, this share of the pixels is fitted well.
_PARTS, _WELL_FITTED_SHARE = 24, 0.25
# A part needs so many pixels.
_LEAST_PIXELS = 50
# Parts are told apart if their grey values spread by this share of their mean.
_LEAST_SPREAD = 1e-3


class GreyVariance(NamedTuple):
    """A variance that is linear in the grey value, over that of a mean grey value: the photon transfer of a sensor."""

    at_zero: float
    """At a grey value of zero."""
    per_grey: float
    """What it grows by per grey value."""

    def at(self, grey: Map) -> Map:
        """Return the variance at grey values."""
        return np.maximum(self.at_zero + self.per_grey * grey, LEAST_VARIANCE)

    def over(self, grey: float) -> GreyVariance:
        """Return the same over the variance at another grey value."""
        unit = max(self.at_zero + self.per_grey * grey, 1e-300)
        return GreyVariance(self.at_zero / unit, self.per_grey / unit)


EVEN = GreyVariance(1.0, 0.0)
"""The same at all grey values."""


def photon_transfer_variance(
    dark_noise_dn: float, gain_dn_per_e: float, dark_level_dn: float, grey: float
) -> GreyVariance:
    """Return the variance that a sensor's photon transfer says, over that of a mean grey value."""
    return GreyVariance(dark_noise_dn**2 - gain_dn_per_e * dark_level_dn, gain_dn_per_e).over(grey)


def estimate_variance(grey: Map, square: Map) -> GreyVariance:
    """Find how the variance grows with the grey value, from what fits leave.

    The lower quartile of what is left, in each of 24 parts of the pixels that have grey values alike: windows that do
    not fit leave more. A line is fitted to it by relative errors.

    ``square``: Mean square of what fits leave there, not finite where there is none; of the same shape.
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
    # Light adds noise, and takes none away.
    if not (level > 0 and slope > 0):
        return EVEN
    return GreyVariance(float(level - slope * mean), float(slope)).over(mean)
