"""Noise variance of the images, and texture gradients without noise bias."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.bound.surface_geometry import ImageTimes, ReferencePoints
from scenetruth.errors import Problem
from scenetruth.schema import read_scene

__all__ = [
    "GreyNoise",
    "SignedTexture",
    "compute_noise_variance",
    "compute_signed_textures",
    "compute_visibility",
    "is_noise_free",
]


Map = NDArray[np.float64]

# Variance of the rounding to digital numbers.
_ROUNDING_VARIANCE = 1 / 12
_NOISE_STD_HINT = "specify noise_std in grey values of the recording"


@dataclass(frozen=True)
class GreyNoise:
    """Variance of white noise, linear in the grey value, with a lower limit (rounding or readout noise)."""

    at_zero: float
    per_grey: float = 0.0
    least: float = 0.0

    def variance(self, grey: Map) -> Map:
        """Return the variance at the given grey values."""
        return np.maximum(self.at_zero + self.per_grey * grey, self.least)


def compute_noise_variance(recording: xr.Dataset, noise_std: float | None, problems: list[Problem]) -> GreyNoise:
    """Return the temporal noise of the images of a recording; add to ``problems`` if it is undefined."""
    nothing = GreyNoise(np.nan)
    if noise_std is not None:
        return GreyNoise(noise_std**2)
    sensor = _load_sensor(recording)
    if sensor is None:
        problems.append(
            Problem("noise_std", f"is missing, and the recording does not specify its sensor: {_NOISE_STD_HINT}")
        )
        return nothing
    if sensor == "ideal" or (sensor.get("kind") == "gaussian" and _gaussian(sensor, 1.0) == 0):
        problems.append(Problem("noise_std", f"is zero, because the sensor is noise-free: {_NOISE_STD_HINT}"))
        return nothing
    if sensor.get("kind") == "gaussian":
        return GreyNoise(_gaussian(sensor, float(recording.attrs["full_scale"])))
    plain = sensor.get("kind") == "emva1288" and sensor["gamma"] == 1 and not sensor["bayer"] and not sensor["insert"]
    if not plain:
        message = f"is derived from a Gaussian or a linear emva1288 sensor only, not from this one: {_NOISE_STD_HINT}"
        problems.append(Problem("noise_std", message))
        return nothing
    gain = float(sensor["gain_dn_per_e"])
    least = (gain * float(sensor["temporal_dark_noise_e"])) ** 2 + _ROUNDING_VARIANCE
    return GreyNoise(least - gain * float(sensor["black_level_dn"]), gain, least)


def is_noise_free(recording: xr.Dataset) -> bool:
    """Return whether the recording specifies a sensor without noise, including rounding."""
    sensor = _load_sensor(recording)
    if sensor is None or sensor == "ideal":
        return bool(sensor == "ideal")
    return bool(sensor.get("kind") == "gaussian") and _gaussian(sensor, 1.0) == 0


def _load_sensor(recording: xr.Dataset) -> Any:
    scene = read_scene(recording)
    return None if scene is None else scene.get("sensor")


def _gaussian(sensor: dict[str, Any], full_scale: float) -> float:
    """Return the variance of the Gaussian sensor, whose noise is specified as a fraction of full scale."""
    rounding = 0.0 if sensor["bit_depth"] is None else _ROUNDING_VARIANCE
    return float((float(sensor["noise_std"]) * full_scale) ** 2 + rounding)


Mask = NDArray[np.bool_]

# Number of noisy images that are averaged to the texture; windows average anyway, and further images cost time.
_MOST_IMAGES = 8
_ORDER = 5
_ROUNDING_ERROR = 1e-10  # relative to the range of grey values
_DERIVATIVE = np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0  # derivative of the quintic B-spline at integer distances


@dataclass(frozen=True, eq=False)
class SignedTexture:
    """A texture whose products of gradients enter the sums with a sign.

    ``gradient``: Gradient along x and y, in grey values per px, shape (2, y, x); 0 where invalid.
    ``grey``, ``one``: Grey value minus a mean, shape (y, x), and value of a constant offset in this layer.
    ``weight``: Signed inverse of the noise variance, shape (y, x); 0 where invalid.
    """

    gradient: Map
    grey: Map
    one: float
    weight: Map


def compute_signed_textures(
    recording: xr.Dataset, views: ImageTimes, points: ReferencePoints, shown: Mask, usable: Mask, noise: GreyNoise
) -> list[SignedTexture]:
    """Return layers for products of texture gradients, from visible points (n, y, x) at usable pixels (y, x)."""
    channels = recording.sizes.get("channel", 1)
    reference = int(views.nearest(1)[0])
    found = []
    for channel in range(channels):
        if "radiance" in recording or is_noise_free(recording):
            grey = _clean(recording, views.frame_of[reference], channel)
            known = usable & shown[reference]
            found.append(_signed_texture(grey, 1.0, known / noise.variance(grey), known))
            continue
        one, other, known = _halves(recording, views, points, shown, channel)
        known &= usable
        mean, half = 0.5 * (one + other), 0.5 * (one - other)
        weight = known / noise.variance(mean)
        found += [_signed_texture(mean, 1.0, weight, known), _signed_texture(half, 0.0, -weight, known)]
    return found


def compute_visibility(
    truth: xr.Dataset, recording: xr.Dataset, views: ImageTimes, points: ReferencePoints, pieces: NDArray[np.int64]
) -> Mask:
    """Return where each image shows the points and is not masked, shape (n, y, x)."""
    height, width = pieces.shape
    first_x, first_y = points.x[0, 0], points.y[0, 0]
    shown = np.zeros((len(views), height, width), dtype=np.bool_)
    seen = _cameras_first(truth["visible"]) if "visible" in truth else None
    masked = None
    if "exclusion_mask" in recording:
        like = recording["image"].isel(channel=0, missing_dims="ignore")
        masked = _cameras_first(recording["exclusion_mask"].broadcast_like(like))
    for i in range(len(views)):
        place = points.place(views.s[i], views.s_y[i], views.t[i])
        column, row = place.x - first_x, place.y - first_y
        inside = (pieces >= 0) & (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
        if seen is not None:
            inside &= seen[tuple(views.frame_of[i])]
        if masked is not None:
            at = (np.rint(np.where(inside, part, 0.0)).astype(np.int64) for part in (row, column))
            inside &= ~masked[tuple(views.frame_of[i])][tuple(at)]
        shown[i] = inside
    return shown


def _cameras_first(maps: xr.DataArray) -> Mask:
    """Return the maps as booleans with the dimensions s_y, s, t, y, x."""
    named = maps if "s_y" in maps.dims else maps.expand_dims("s_y")
    return np.asarray(named.transpose("s_y", "s", "t", "y", "x").values, dtype=np.bool_)


def _image(recording: xr.Dataset, name: str, frame: NDArray[np.int64], channel: int) -> Map:
    row, camera, time = (int(k) for k in frame)
    image = recording[name].isel(s=camera, t=time).isel(s_y=row, channel=channel, missing_dims="ignore")
    return np.asarray(image.transpose("y", "x").values, dtype=np.float64)


def _clean(recording: xr.Dataset, frame: NDArray[np.int64], channel: int) -> Map:
    """Return a noise-free image, in grey values of the recording."""
    image = _image(recording, "image", frame, channel)
    if "radiance" not in recording:
        return image
    ideal = _image(recording, "radiance", frame, channel)
    # Sensors are linear, and the ideal image is noise-free: the slope of a regression on it is unbiased.
    spread = ideal - ideal.mean()
    square = float(np.sum(spread * spread))
    slope = float(np.sum(spread * image)) / square if square > 0 else 0.0
    return np.asarray(image.mean() + slope * spread)


def _halves(
    recording: xr.Dataset, views: ImageTimes, points: ReferencePoints, shown: Mask, channel: int
) -> tuple[Map, Map, Mask]:
    """Return the means of two sets of images, warped to the reference, and where both are valid."""
    from scipy.ndimage import map_coordinates

    height, width = points.d.shape
    sums, counts = np.zeros((2, height, width)), np.zeros((2, height, width))
    for number, i in enumerate(views.nearest(_MOST_IMAGES)):
        image = _image(recording, "image", views.frame_of[i], channel)
        place = points.place(views.s[i], views.s_y[i], views.t[i])
        at = np.stack([place.y - points.y[0, 0], place.x - points.x[0, 0]])
        warped = map_coordinates(image, at, order=_ORDER, mode="mirror")
        sums[number % 2] += np.where(shown[i], warped, 0.0)
        counts[number % 2] += shown[i]
    known = np.asarray((counts > 0).all(axis=0))
    # Fill invalid pixels from the other mean or the reference image, to avoid steps that derivatives would respond to.
    reference = _image(recording, "image", views.frame_of[views.nearest(1)[0]], channel)
    one = np.where(counts[0] > 0, sums[0] / np.maximum(counts[0], 1.0), reference)
    other = np.where(counts[1] > 0, sums[1] / np.maximum(counts[1], 1.0), one)
    return one, other, known


def _signed_texture(grey: Map, one: float, weight: Map, known: Mask) -> SignedTexture:
    middle = one * float(grey[known].mean()) if known.any() else 0.0
    gradient = np.stack([np.where(known, gradient_along(grey, axis), 0.0) for axis in (1, 0)])
    # Suppress rounding errors of a texture that is constant along an axis.
    gradient[np.abs(gradient) < _ROUNDING_ERROR * np.ptp(grey)] = 0.0
    return SignedTexture(gradient, np.where(known, grey - middle, 0.0), one, weight)


def gradient_along(image: Map, axis: int) -> Map:
    """Return the derivative by quintic splines, too small by 0.03 % at wavelengths of 6 px, 0.5 % at 4, 4.6 % at 3."""
    from scipy.ndimage import correlate1d, spline_filter1d

    coefficients = spline_filter1d(image, order=_ORDER, axis=axis, mode="mirror")
    return np.asarray(correlate1d(coefficients, _DERIVATIVE, axis=axis, mode="mirror"))
