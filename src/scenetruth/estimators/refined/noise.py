"""The images' noise, as the fits tell it, and what noise alone would look like."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

__all__ = ["noise_of", "spline_slope_transfer", "spline_transfer", "textured"]

# Windows that are fitted this well, or better, show nothing but noise.
_WELL = 0.25
# A texture's mean square gradient is this many times that of the noise in the mean of the images.
_ABOVE_NOISE = 4.0


def noise_of(left: NDArray[np.float64]) -> float:
    """Return the standard deviation of the images' noise from what fits leave: that of the windows that fit well.

    Parameters
    ----------
    left
        Standard deviation around the fit in every window, NaN where there is none.
    """
    known = left[np.isfinite(left)]
    return float(np.quantile(known, _WELL)) if known.size else float("nan")


def textured(mean_square_gradient: NDArray[np.float64], noise: float, images: int, spline: int) -> NDArray[np.bool_]:
    """Tell where the mean of the images has more gradient than their noise would give it.

    Parameters
    ----------
    mean_square_gradient
        Mean over a window of the squared gradient of the images' mean, in grey values per px.
    noise
        Standard deviation of the noise of one image.
    images
        Number of images.
    spline
        Order of the splines through them.
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
