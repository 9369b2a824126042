"""Sensor characterisation: photon transfer method of EMVA 1288 and two-point flat-field correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "QUANTISATION_VARIANCE",
    "PhotonTransfer",
    "fit_response_line",
    "photon_transfer",
    "spatial_variance",
    "two_point_correction",
]


Array = NDArray[np.float64]

QUANTISATION_VARIANCE = 1 / 12
"""Variance in DN² that rounding adds to a digital number."""

# The standard fits the gain up to 70 % of saturation and evaluates linearity from 5 % to 95 %.
_GAIN_RANGE = 0.7
_LINEAR_RANGE = (0.05, 0.95)
_LEVELS = 3


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """Measured EMVA 1288 parameters of a sensor.

    ``gain_dn_per_e``: K, overall system gain: slope of temporal variance over mean, both dark-corrected.
    ``temporal_dark_noise_e``: σ_d in electrons at the shortest exposure, without quantisation noise.
    ``dsnu_e``: DSNU_1288, spatial standard deviation of the dark images at the shortest exposure, in electrons.
    ``prnu``: PRNU_1288, spatial standard deviation of the sensitivity, relative to its mean.
    ``quantum_efficiency``: η: responsivity / K, electrons per photon.
    ``saturation_e``: Saturation capacity in electrons, limited by the full well or the converter.
    ``dark_e``: Electrons added by the dark current from the shortest to the operating exposure.
    ``linearity_error``: Largest relative deviation of the mean from a fitted line, from 5 % to 95 % of saturation.
    ``photons``: Photons per pixel of each level, shape (n,).
    ``mean_dn``, ``variance_dn2``: Dark-corrected mean and temporal variance, shape (n,).
    """

    gain_dn_per_e: float
    temporal_dark_noise_e: float
    dsnu_e: float
    prnu: float
    quantum_efficiency: float
    saturation_e: float
    dark_e: float
    linearity_error: float
    photons: Array
    mean_dn: Array
    variance_dn2: Array


def photon_transfer(
    photons: ArrayLike, pairs: ArrayLike, dark: ArrayLike, bias: ArrayLike, flat: ArrayLike, saturated: ArrayLike
) -> PhotonTransfer:
    """Measure sensor parameters from images of a uniform surface (EMVA 1288, release 3.1, sections 6 to 8).

    Unlike in the standard, no high-pass filter removes non-uniform illumination, and saturation is the largest mean
    rather than the mean of largest variance.

    ``photons``: Photons per pixel and exposure of each level, shape (n,); three or more from 5 % to 70 % of saturation.
    ``pairs``: Two images of each level at the operating exposure, shape (n, 2, y, x), digital numbers.
    ``dark``, ``bias``: Images without light at the operating and at the shortest exposure, shape (m, y, x).
    ``flat``: Images at about half of saturation, shape (m, y, x).
    ``saturated``: Images far beyond saturation, shape (m, y, x) or (y, x).

    Temporal variance is half the mean square difference of a pair, which cancels fixed patterns; spatial variance is
    that of the mean image minus its residual temporal noise. Quantisation adds 1/12 DN² to the temporal variance.
    """
    light = np.asarray(photons, dtype=np.float64)
    stacks = {"dark": np.asarray(dark), "bias": np.asarray(bias), "flat": np.asarray(flat)}
    images = np.asarray(pairs)
    _check_shapes(light, images, stacks)

    dark_mean, dark_variance, dark_spatial = _moments(stacks["dark"])
    bias_mean, bias_variance, bias_spatial = _moments(stacks["bias"])
    flat_mean, _, flat_spatial = _moments(stacks["flat"])
    means = np.array([pair.mean(dtype=np.float64) for pair in images]) - dark_mean
    variances = np.array([_difference_variance(pair) for pair in images]) - dark_variance
    plateau = float(np.asarray(saturated, dtype=np.float64).mean()) - dark_mean
    if plateau <= 0 or flat_mean <= dark_mean:
        msg = "digital numbers do not increase with light: dark images must be darker than flat and saturated images"
        raise ValueError(msg)

    steep = (means > 0) & (means <= _GAIN_RANGE * plateau)
    straight = (means >= _LINEAR_RANGE[0] * plateau) & (means <= _LINEAR_RANGE[1] * plateau)
    if min(steep.sum(), straight.sum()) < _LEVELS:
        msg = f"at least {_LEVELS} levels must lie between 5 % and 70 % of saturation"
        raise ValueError(msg)
    # The ratio of sums weights levels by 1 / mean, a compromise between the scatter of bright variances and the readout
    # noise of dark levels.
    gain = float(np.sum(variances[steep]) / np.sum(means[steep]))
    slope, deviation = fit_response_line(light[straight], means[straight])
    return PhotonTransfer(
        gain_dn_per_e=gain,
        temporal_dark_noise_e=float(np.sqrt(max(bias_variance - QUANTISATION_VARIANCE, 0.0))) / gain,
        dsnu_e=float(np.sqrt(max(bias_spatial, 0.0))) / gain,
        prnu=float(np.sqrt(max(flat_spatial - dark_spatial, 0.0))) / (flat_mean - dark_mean),
        quantum_efficiency=slope / gain,
        saturation_e=plateau / gain,
        dark_e=(dark_mean - bias_mean) / gain,
        linearity_error=deviation,
        photons=light,
        mean_dn=means,
        variance_dn2=variances,
    )


def _check_shapes(light: Array, images: NDArray[np.generic], stacks: dict[str, NDArray[np.generic]]) -> None:
    if images.ndim != 4 or images.shape[:2] != (light.size, 2) or light.ndim != 1:
        msg = f"pairs must have the shape (levels, 2, y, x) with {light.size} levels as in photons; got {images.shape}"
        raise ValueError(msg)
    for name, stack in stacks.items():
        if stack.ndim != 3 or len(stack) < 2 or stack.shape[1:] != images.shape[2:]:
            msg = f"{name} must contain at least two images of {images.shape[2:]} pixels; got {stack.shape}"
            raise ValueError(msg)


def _difference_variance(pair: NDArray[np.generic]) -> float:
    """Return the temporal variance from the difference of two images."""
    first, second = pair.astype(np.float64)
    return float(np.var(first - second)) / 2


def _moments(stack: NDArray[np.generic]) -> tuple[float, float, float]:
    """Return the mean, temporal variance and spatial variance of repeated images, shape (m, y, x)."""
    values = stack.astype(np.float64)
    mean_image = values.mean(axis=0)
    temporal = float(values.var(axis=0, ddof=1).mean())
    return float(mean_image.mean()), temporal, spatial_variance(mean_image, temporal, len(values))


def spatial_variance(mean_image: Array, temporal: float, count: int) -> float:
    """Return the variance between pixels of a mean of ``count`` images, less the temporal noise that remains in it."""
    return float(mean_image.var()) - temporal / count


def fit_response_line(light: Array, means: Array) -> tuple[float, float]:
    """Fit a line by minimising relative deviations; return its slope and the largest deviation."""
    columns = np.stack([light, np.ones_like(light)], axis=1) / means[:, None]
    (slope, offset), *_ = np.linalg.lstsq(columns, np.ones_like(means), rcond=None)
    line = slope * light + offset
    return float(slope), float(np.max(np.abs(means / line - 1)))


def two_point_correction(images: ArrayLike, dark: ArrayLike, flat: ArrayLike) -> NDArray[np.float32]:
    """Correct the fixed pattern of images with a dark and a flat-field image (two-point correction).

    Computes (image - dark) / (flat - dark) times the mean of (flat - dark), so that every pixel has zero offset and the
    mean responsivity.

    Parameters
    ----------
    images
        Digital numbers, shape (..., y, x).
    dark, flat
        Averaged images without light and of a uniformly bright surface, shape (y, x), below saturation.

    Returns
    -------
    numpy.ndarray
        float32, the shape of ``images``; NaN where the flat field is not brighter than the dark image.

    Raises
    ------
    ValueError
        If the shapes do not match, or no pixel is brighter in the flat field.

    See Also
    --------
    scenetruth.simulate : Simulate images with fixed-pattern noise (``dsnu_e``, ``prnu``).

    References
    ----------
    EMVA Standard 1288, Standard for Characterization of Image Sensors and Cameras: dark-signal and photo-response
    non-uniformity (DSNU, PRNU).

    Examples
    --------
    The second pixel is twice as sensitive as the first and has an offset of 10:

    >>> two_point_correction([[[5.0, 20.0]], [[10.0, 30.0]]], dark=[[0.0, 10.0]], flat=[[20.0, 50.0]]).tolist()
    [[[7.5, 7.5]], [[15.0, 15.0]]]
    """
    values = np.asarray(images)
    low, high = np.asarray(dark, dtype=np.float64), np.asarray(flat, dtype=np.float64)
    if not low.shape == high.shape == values.shape[-2:]:
        msg = f"dark and flat must have the shape (y, x) of the images, {values.shape[-2:]}: {low.shape}, {high.shape}"
        raise ValueError(msg)
    span = np.where(high > low, high - low, np.nan)
    if np.isnan(span).all():
        msg = "flat must be brighter than dark: no pixel responds to light"
        raise ValueError(msg)
    return np.asarray((values - low) / span * np.nanmean(span), dtype=np.float32)
