"""Variance of the images' noise as a function of the grey value."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.products import LEAST_VARIANCE

__all__ = ["EVEN", "GreyVariance", "known_variance", "variance_of"]

Map = NDArray[np.float64]

# Grey values are sorted into so many parts of equal size; in each, this share of the pixels is fitted well.
_PARTS, _WELL = 24, 0.25
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


def known_variance(dark_noise_dn: float, gain_dn_per_e: float, dark_level_dn: float, grey: float) -> GreyVariance:
    """Return the variance that a sensor's photon transfer says, over that of a mean grey value.

    Parameters
    ----------
    dark_noise_dn, gain_dn_per_e, dark_level_dn
        As of `PhotonTransferNoise`.
    grey
        The mean grey value.
    """
    return GreyVariance(dark_noise_dn**2 - gain_dn_per_e * dark_level_dn, gain_dn_per_e).over(grey)


def variance_of(grey: Map, square: Map) -> GreyVariance:
    """Find how the variance grows with the grey value, from what fits leave.

    The lower quartile of what is left, in each of 24 parts of the pixels that have grey values alike: windows that do
    not fit leave more. A line is fitted to it by relative errors.

    Parameters
    ----------
    grey
        Grey values of the pixels.
    square
        Mean square of what fits leave there, not finite where there is none; of the same shape.

    Returns
    -------
    GreyVariance
        Over that of the mean grey value; `EVEN` where nothing is known, or all is equally bright.
    """
    known = np.isfinite(square) & (square > 0)
    grey, square = grey[known], square[known]
    if grey.size < 2 * _LEAST_PIXELS:
        return EVEN
    mean = float(grey.mean())
    parts = np.array_split(np.argsort(grey), min(_PARTS, grey.size // _LEAST_PIXELS))
    middle = np.array([grey[part].mean() for part in parts])
    left = np.array([np.quantile(square[part], _WELL) for part in parts])
    if np.ptp(middle) < _LEAST_SPREAD * abs(mean):
        return EVEN
    design = np.stack([np.ones_like(middle), middle - mean], axis=-1) / left[:, None]
    (level, slope), *_ = np.linalg.lstsq(design, np.ones_like(left), rcond=None)
    # Light adds noise, and takes none away.
    if not (level > 0 and slope > 0):
        return EVEN
    return GreyVariance(float(level - slope * mean), float(slope)).over(mean)
