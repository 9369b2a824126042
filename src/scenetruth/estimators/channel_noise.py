"""Noise of colour images: weights of channels of unequal noise, and noise that demosaicing correlates.

Demosaicing interpolates the missing colours of a pixel from its neighbours, and with them their noise, which is no
longer white: at low frequencies its power is larger than the variance of the pixels suggests. Standard deviations
follow from the noise around the frequencies of the texture, but the noise is measured from residuals, which a filter or
an interpolation has passed. The ratios of both are tabulated here for low frequencies, at which they are largest; there
the noise of different colours is not correlated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.bands import COLOURS
from scenetruth.schema import DEMOSAICING

__all__ = ["DEMOSAICED_NOISE", "CorrelatedNoise", "compute_channel_weights", "read_demosaicing"]

# Ratio of the standard deviations of two channels up to which they have equal weights, so that the scatter of estimated
# noise has no effect; and the ratio at which weights are limited: channels without noise are those without contrast.
_EQUAL, _LARGEST = 1.25, 10.0


Covariances = tuple[tuple[float, ...], ...]


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
    covariances
        Covariances of the pixels of two channels, red, green and blue each, at distances from 0 px along y and x,
        relative to the mean power at low frequencies; empty for none.
    share
        Share of the variance of white noise, with the same power at low frequencies, that interpolation by quintic
        splines leaves as residual, in the units of ``noise_share`` of a recording.
    of_gradient
        Mean square gradient of noise after interpolation by quintic splines, relative to that of white noise with the
        same power at low frequencies.
    aliases
        Whether textures have aliases, which leave residuals.

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
    covariances: tuple[tuple[Covariances, ...], ...]
    aliases: bool = True


def _smoothed(given: Covariances, taps: tuple[float, ...]) -> Covariances:
    """Return covariances after a symmetric filter along both axes."""
    half = np.array(given)
    passed = np.convolve(taps, taps)
    reach = len(given) + len(taps) - 2
    for _ in range(2):
        whole = np.concatenate([half[:0:-1], half])
        half = np.stack([np.convolve(each, passed)[reach:] for each in whole.T])
    return tuple(tuple(round(float(each), 7) for each in row) for row in half)


_BILINEAR = (
    ((0.16875, 0.1125, 0.028125), (0.1125, 0.075, 0.01875), (0.028125, 0.01875, 0.0046875)),
    ((0.1875, 0.075, 0.009375), (0.075, 0.01875, 0.0), (0.009375, 0.0, 0.0)),
)
_MALVAR = (
    (
        (0.29531, 0.1125, 0.00586, 0.0, 0.0041),
        (0.1125, 0.05391, 0.01875, 0.00117, 0.0),
        (0.00586, 0.01875, 0.00996, 0.0, 0.0),
        (0.0, 0.00117, 0.0, 0.0, 0.0),
        (0.0041, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.23438, 0.075, -0.00937, 0.0, 0.00234),
        (0.075, 0.01875, 0.0, 0.0, 0.0),
        (-0.00937, 0.0, 0.00469, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (0.00234, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.16641, 0.02695, -0.02812, -0.00586, 0.00176),
        (0.02695, -0.01406, -0.01055, -0.00234, 0.0),
        (-0.02812, -0.01055, 0.00352, 0.0, 0.0),
        (-0.00586, -0.00234, 0.0, 0.0, 0.0),
        (0.00176, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.17578, 0.04219, -0.0293, -0.01406, -0.00117),
        (0.04219, -0.00703, -0.01406, -0.00586, 0.0),
        (-0.0293, -0.01406, 0.00527, 0.0, 0.0),
        (-0.01406, -0.00586, 0.0, 0.0, 0.0),
        (-0.00117, 0.0, 0.0, 0.0, 0.0),
    ),
)
"""Covariances of red and of blue, of green, of green and another colour, and of red and blue."""


def _between(
    red: Covariances, green: Covariances, with_green: Covariances = (), red_blue: Covariances = ()
) -> tuple[tuple[Covariances, ...], ...]:
    """Return the covariances of every pair of colours."""
    return (red, with_green, red_blue), (with_green, green, with_green), (red_blue, with_green, red)


_BINOMIAL = tuple(_smoothed(each, (0.0625, 0.25, 0.375, 0.25, 0.0625)) for each in _BILINEAR)

DEMOSAICED_NOISE: Mapping[str, CorrelatedNoise] = MappingProxyType(
    {
        "bilinear": CorrelatedNoise(
            5.714, of_residuals=1.650, share=0.105, of_gradient=0.0742, covariances=_between(*_BILINEAR)
        ),
        "malvar": CorrelatedNoise(
            3.636, of_residuals=1.516, share=0.189, of_gradient=0.178, covariances=_between(*_MALVAR)
        ),
        "binomial": CorrelatedNoise(
            18.891,
            of_residuals=3.120,
            share=0.01995,
            of_gradient=0.00692,
            covariances=_between(*_BINOMIAL),
            aliases=False,
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
    if name not in DEMOSAICING:
        return None
    noise, channels = DEMOSAICED_NOISE[name], recording.coords.get("channel")
    if channels is not None and tuple(map(str, channels.values)) == COLOURS:
        return noise
    # The colours of other channels are not stated.
    own = _mean([noise.covariances[c][c] for c in range(len(COLOURS))])
    others = _mean([noise.covariances[c][d] for c, d in combinations(range(len(COLOURS)), 2)])
    count = range(recording.sizes.get("channel", 1))
    return replace(noise, covariances=tuple(tuple(own if c == d else others for d in count) for c in count))


def _mean(given: Sequence[Covariances]) -> Covariances:
    """Return the mean of covariances, all or none of which are empty."""
    return tuple(map(tuple, np.mean(np.array(given), axis=0).tolist()))


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
