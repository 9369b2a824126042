"""Noise of the sensor of a capture, with a gain only if the noise of lit frames depends on the light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.folder_reading import CaptureFolder
from scenetruth.capture.image_reading import FrameMoments
from scenetruth.capture.radiometry import SensorNoise, measure_noise
from scenetruth.errors import ArgumentError
from scenetruth.number_format import format_two_digits

__all__ = ["sensor_noise", "without_undetermined_gain"]

Floats = NDArray[np.float64]

_GROUPS, _LEAST_IN_GROUP, _LEAST_GROUPS = 24, 50, 4
_LEAST_RANGE = 2.0  # ratio of the brightest to the darkest group
_SIGMAS = 4.0
_LEAST_SHARE = 0.5
"""Smallest ratio of the slope of variance over mean to the gain: that of linear values with photon noise is 1."""


def sensor_noise(folder: CaptureFolder) -> SensorNoise | None:
    """Return the noise of the sensor, None if the frames do not determine it."""
    dark = folder.dark
    if dark is None or dark.count < 2 or dark.mean.ndim != 2:
        return None
    flat_level = folder.flat_level()
    flat = None if flat_level is None else folder.sets["flat"].moments(flat_level)
    static = folder.sets.get("static")
    still = None if static is None else static.moments(next(iter(static.levels)))
    try:
        noise = measure_noise(
            dark,
            flat if flat is not None and flat.count > 1 else None,
            static=still if still is not None and still.count > 2 else None,
            full_scale=folder.images.pixels.full_scale,
        )
    except ArgumentError:
        return None
    if still is None or still.count < 3 or still.mean.ndim != 2:
        return noise
    return without_undetermined_gain(noise, [still], folder.images.pixels.full_scale)


def without_undetermined_gain(noise: SensorNoise, lit: Sequence[FrameMoments], full_scale: float) -> SensorNoise:
    """Return measured noise without values in electrons if the noise of lit frames does not increase with the light.

    The gain of one flat field is the excess of its variance over that of dark frames, which is that of the light only
    if the noise without light is the same. The slope of variance over mean within lit frames does not use dark frames.
    """
    if not np.isfinite(noise.gain_dn_per_e):
        return noise
    groups = [rows for moments in lit if len(rows := _group(moments, full_scale))]
    if not groups:
        return noise
    mean, variance, std = np.concatenate(groups).T
    if len(mean) < _LEAST_GROUPS or mean.max() < _LEAST_RANGE * max(mean.min(), 1.0):
        return noise
    slope, slope_std = _fit_slope(mean, variance, std)
    significant = noise.gain_dn_per_e > _SIGMAS * noise.gain_std
    if significant and slope + _SIGMAS * slope_std > _LEAST_SHARE * noise.gain_dn_per_e:
        return noise
    change = format_two_digits(max(slope, 0.0) * float(np.ptp(mean)))
    expected = format_two_digits(max(noise.gain_dn_per_e, 0.0) * float(np.ptp(mean)))
    note = (
        f"gain K is not determinable: the noise does not depend on the light. Between {mean.min():.0f} and "
        f"{mean.max():.0f} DN the temporal variance increases by {change} DN²; the difference of flat fields and dark "
        f"frames would require {expected} DN². DSNU and dark noise in electrons, which require K, are not stated"
    )
    lacking = dict.fromkeys(
        ("gain_dn_per_e", "gain_std", "temporal_dark_noise_e", "temporal_dark_noise_std", "dsnu_e", "dsnu_std"), np.nan
    )
    return replace(noise, **lacking, notes=(*noise.notes, note))


def _group(moments: FrameMoments, full_scale: float) -> Floats:
    """Return mean, temporal variance and its standard uncertainty of pixels in groups of nearly the same mean."""
    good = (moments.highest < full_scale) & (moments.lowest > 0)
    mean, variance = moments.mean[good], moments.variance[good]
    order = np.argsort(mean, kind="stable")
    parts = [part for part in np.array_split(order, _GROUPS) if len(part) >= _LEAST_IN_GROUP]
    rows = [(mean[part].mean(), variance[part].mean(), variance[part].std() / np.sqrt(len(part))) for part in parts]
    return np.array(rows).reshape(-1, 3)


def _fit_slope(mean: Floats, variance: Floats, std: Floats) -> tuple[float, float]:
    """Return the slope of a weighted line and its standard uncertainty, which includes departures from the line."""
    weight = 1 / np.maximum(std, 1e-12) ** 2
    centre = np.average(mean, weights=weight)
    spread = float(np.sum(weight * (mean - centre) ** 2))
    slope = float(np.sum(weight * (mean - centre) * variance)) / spread
    rest = variance - np.average(variance, weights=weight) - slope * (mean - centre)
    misfit = max(float(np.sum(weight * rest**2)) / (len(mean) - 2), 1.0)
    return slope, float(np.sqrt(misfit / spread))
