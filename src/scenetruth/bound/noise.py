"""How much noise the images of a recording have, as a function of the grey value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.errors import Problem
from scenetruth.schema import scene_of

__all__ = ["GreyNoise", "is_noise_free", "noise_of"]

Map = NDArray[np.float64]

# What rounding to digital numbers adds.
_ROUNDING = 1 / 12
_GIVE_IT = "give noise_std, in grey values of the recording"


@dataclass(frozen=True)
class GreyNoise:
    """A variance of white noise that is linear in the grey value.

    Parameters
    ----------
    at_zero
        At a grey value of 0, in squared grey values.
    per_grey
        What it grows by per grey value.
    least
        At least this much: rounding, or readout noise.
    """

    at_zero: float
    per_grey: float = 0.0
    least: float = 0.0

    def variance(self, grey: Map) -> Map:
        """Return the variance at grey values."""
        return np.maximum(self.at_zero + self.per_grey * grey, self.least)


def noise_of(recording: xr.Dataset, noise_std: float | None, problems: list[Problem]) -> GreyNoise:
    """Return the temporal noise of a recording's images.

    Parameters
    ----------
    recording
        The recording; the scene that it was made from tells its sensor.
    noise_std
        Standard deviation in grey values of the recording, the same everywhere; the sensor's if not given. A checked
        number.
    problems
        Where to note that nothing tells.

    Returns
    -------
    GreyNoise
        Of the Gaussian sensor, the noise and rounding. Of ``emva1288``, readout noise, shot noise of light and dark
        current, and rounding; fixed patterns are no noise.
    """
    nothing = GreyNoise(np.nan)
    if noise_std is not None:
        return GreyNoise(noise_std**2)
    sensor = _sensor_of(recording)
    if sensor is None:
        problems.append(Problem("noise_std", f"is not known, for the recording does not tell its sensor: {_GIVE_IT}"))
        return nothing
    if sensor == "ideal" or (sensor.get("kind") == "gaussian" and _gaussian(sensor, 1.0) == 0):
        problems.append(Problem("noise_std", f"is zero, for the sensor has no noise: {_GIVE_IT}"))
        return nothing
    if sensor.get("kind") == "gaussian":
        return GreyNoise(_gaussian(sensor, float(recording.attrs["full_scale"])))
    plain = sensor.get("kind") == "emva1288" and sensor["gamma"] == 1 and not sensor["bayer"] and not sensor["insert"]
    if not plain:
        message = f"is not known of such a sensor, only of a linear emva1288 and of the Gaussian one: {_GIVE_IT}"
        problems.append(Problem("noise_std", message))
        return nothing
    gain = float(sensor["gain_dn_per_e"])
    least = (gain * float(sensor["temporal_dark_noise_e"])) ** 2 + _ROUNDING
    return GreyNoise(least - gain * float(sensor["black_level_dn"]), gain, least)


def is_noise_free(recording: xr.Dataset) -> bool:
    """Tell whether a recording says that its images have no noise, not even that of rounding."""
    sensor = _sensor_of(recording)
    if sensor is None or sensor == "ideal":
        return bool(sensor == "ideal")
    return bool(sensor.get("kind") == "gaussian") and _gaussian(sensor, 1.0) == 0


def _sensor_of(recording: xr.Dataset) -> Any:
    scene = scene_of(recording)
    return None if scene is None else scene.get("sensor")


def _gaussian(sensor: dict[str, Any], full_scale: float) -> float:
    """Return the variance of the Gaussian sensor, whose noise is a share of full scale."""
    rounding = 0.0 if sensor["bit_depth"] is None else _ROUNDING
    return float((float(sensor["noise_std"]) * full_scale) ** 2 + rounding)
