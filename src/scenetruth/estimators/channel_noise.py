"""Noise of colour images: weights of channels of unequal noise, and noise that demosaicing correlates.

Demosaicing interpolates the missing colours of a pixel from its neighbours, and with them their noise, which is no
longer white: at low frequencies its power is larger than the variance of the pixels suggests. Standard deviations
follow from the noise around the frequencies of the texture, but the noise is measured from residuals, which a filter or
an interpolation has passed. The ratios of both are tabulated here for low frequencies, at which they are largest; there
the noise of different colours is not correlated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.schema import DEMOSAICING

__all__ = ["DEMOSAICED_NOISE", "CorrelatedNoise", "compute_channel_weights", "read_demosaicing"]

# Ratio of the standard deviations of two channels up to which they have equal weights, so that the scatter of estimated
# noise has no effect; and the ratio at which weights are limited: channels without noise are those without contrast.
_EQUAL, _LARGEST = 1.25, 10.0


@dataclass(frozen=True)
class CorrelatedNoise:
    """Noise of images that were demosaiced, averaged over the pixels of the pattern and the three colours.

    Attributes
    ----------
    of_pixels
        Power at low frequencies, relative to the variance of the pixels.
    of_residuals
        Power at low frequencies, relative to that of white noise with the same residual after the smoothing of the
        structure tensor in x and y.
    along_row
        Covariances of pixels of a row at distances from 0 px, relative to the power at low frequencies.
    share
        Share of the variance of white noise, with the same power at low frequencies, that interpolation by quintic
        splines leaves as residual, in the units of ``noise_share`` of a recording.
    of_gradient
        Mean square gradient of noise after interpolation by quintic splines, relative to that of white noise with the
        same power at low frequencies.

    See Also
    --------
    read_demosaicing : Returns how a recording was demosaiced.

    Examples
    --------
    >>> DEMOSAICED_NOISE["bilinear"].of_pixels
    5.714
    """

    of_pixels: float
    of_residuals: float
    share: float
    of_gradient: float
    along_row: tuple[float, ...]


DEMOSAICED_NOISE: Mapping[str, CorrelatedNoise] = MappingProxyType(
    {
        "bilinear": CorrelatedNoise(
            5.714, of_residuals=1.650, share=0.105, of_gradient=0.0742, along_row=(0.175, 0.1, 0.02188)
        ),
        "malvar": CorrelatedNoise(
            3.636,
            of_residuals=1.516,
            share=0.189,
            of_gradient=0.178,
            along_row=(0.275, 0.1, 0.00078, 0.0, 0.00352),
        ),
        "binomial": CorrelatedNoise(
            18.891,
            of_residuals=3.120,
            share=0.01995,
            of_gradient=0.00692,
            along_row=(0.05294, 0.04505, 0.02758, 0.01186, 0.00341, 0.00059, 0.00005),
        ),
    }
)
"""Noise by method of demosaicing, computed from the kernels of the methods."""


def read_demosaicing(recording: xr.Dataset) -> CorrelatedNoise | None:
    """Return the noise of the demosaicing that a recording states, None without.

    Parameters
    ----------
    recording
        Recording; its attribute ``demosaicing`` is ``bilinear``, ``malvar`` or ``binomial`` if it was demosaiced.

    Returns
    -------
    CorrelatedNoise | None
        Ratios of noise powers.

    See Also
    --------
    compute_channel_weights : Weights of channels.

    Examples
    --------
    >>> import scenetruth as st
    >>> images = np.zeros((2, 3, 30, 40, 3))
    >>> recording = st.make_recording(images, 500, 5, attrs={"demosaicing": "malvar"})
    >>> read_demosaicing(recording).share
    0.189
    """
    name = recording.attrs.get("demosaicing")
    return DEMOSAICED_NOISE[name] if name in DEMOSAICING else None


def compute_channel_weights(power: ArrayLike) -> NDArray[np.float64]:
    """Return weights of channels that make their noise equal: inverse to its power, with a mean of 1.

    Parameters
    ----------
    power
        Noise power of each channel, shape (n,).

    Returns
    -------
    NDArray[np.float64]
        Weights of squares, shape (n,); exactly 1 if the standard deviations differ by less than a factor of 1.25, or
        if the noise of a channel has no estimate.

    See Also
    --------
    read_demosaicing : Noise that is correlated between pixels.

    Examples
    --------
    >>> compute_channel_weights([4.0, 1.0, 1.0]).round(3)
    array([0.333, 1.333, 1.333])
    >>> compute_channel_weights([1.2, 1.0, 1.0])
    array([1., 1., 1.])
    """
    given = np.asarray(power, dtype=np.float64)
    if not np.isfinite(given).all() or given.max(initial=0.0) <= 0:
        return np.ones(given.shape)
    bounded = np.maximum(given, given.max() / _LARGEST**2)
    if bounded.max() <= _EQUAL**2 * bounded.min():
        return np.ones(given.shape)
    return np.asarray(1 / bounded / np.mean(1 / bounded))
