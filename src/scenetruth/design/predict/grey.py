"""How much noise grey values have, and how bright a surface is in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import LinearImage, SensorChain, chain_of
from scenetruth.camera.sensor.emva1288 import EmvaSensor
from scenetruth.camera.sensor.gaussian import GaussianSensor
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene

__all__ = ["Grey", "grey_of", "irradiance_of"]

Array = NDArray[np.float64]

_ROUNDING = 1 / 12
# Of a sensor without formula: images of so many pixels at so many levels.
_SIDE, _LEVELS, _IMAGES = 48, 9, 8


@dataclass(frozen=True, eq=False)
class Grey:
    """Grey values of points and their noise, as shares of full scale.

    Parameters
    ----------
    level
        Mean grey value, shape (n,).
    gain
        What it changes by per radiance, shape (n,).
    noise
        Standard deviation of the noise that is new in every image, rounding included, shape (n,).
    pattern
        Standard deviation of what pixels keep over all images, shape (n,).
    """

    level: Array
    gain: Array
    noise: Array
    pattern: Array


def grey_of(sensor: Any, radiance: Array) -> Grey:
    """Return grey values and noise of points.

    Parameters
    ----------
    sensor
        The scene's sensor.
    radiance
        Mean radiance of the points, shape (n,).

    Returns
    -------
    Grey
        Of ``gaussian`` and a linear ``emva1288`` by their formulas; of any other sensor as a few flat images of it
        tell. The ideal sensor has no noise.
    """
    radiance = np.asarray(radiance, dtype=np.float64)
    if isinstance(sensor, GaussianSensor):
        variance = sensor.noise_std**2
        if sensor.bit_depth is not None:
            variance += _ROUNDING / (2**sensor.bit_depth - 1) ** 2
        one = np.ones_like(radiance)
        level = radiance / sensor.full_scale_radiance
        return Grey(level, one / sensor.full_scale_radiance, np.sqrt(variance) * one, 0.0 * one)
    if isinstance(sensor, EmvaSensor) and sensor.gamma == 1 and sensor.bayer is None and not sensor.insert:
        return _emva(sensor, radiance)
    if isinstance(sensor, str) or not chain_of(sensor).effects:
        one = np.ones_like(radiance)
        return Grey(radiance, one, 0.0 * one, 0.0 * one)
    levels = np.linspace(0.0, chain_of(sensor).saturation_radiance, _LEVELS)
    measured = _measured(chain_of(sensor).model_dump_json())
    return Grey(*(np.interp(radiance, levels, each) for each in measured))


def irradiance_of(scene: Scene, points_mm: Array, normals: Array) -> Array:
    """Return by what factor points are brighter than their texture says, at the reference frame; without shadows.

    Parameters
    ----------
    scene
        Its lighting.
    points_mm, normals
        The points in the world, and unit normals towards the camera, shape (n, 3).
    """
    lighting = scene.lighting
    factor = np.full(len(points_mm), lighting.brightness(0.0))
    if not lighting.lit:
        return factor
    total = np.full(len(points_mm), lighting.ambient or 0.0)
    for lamp in lighting.lamps_at(0.0):
        if lamp.position_mm is None:
            total += lamp.irradiance * np.maximum(-normals @ lamp.axis, 0.0)
            continue
        away = points_mm - lamp.position_mm
        length = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        beam = away / length[:, None]
        part = lamp.irradiance * (lamp.reference_distance_mm / length) ** 2
        part = part * np.maximum(-(normals * beam).sum(axis=1), 0.0)
        if lamp.cos_inner > -1.0:
            span = max(lamp.cos_inner - lamp.cos_outer, 1e-12)
            share = np.clip((beam @ lamp.axis - lamp.cos_outer) / span, 0.0, 1.0)
            part = part * share**2 * (3 - 2 * share)
        total += part
    return np.asarray(factor * total)


def _emva(sensor: EmvaSensor, radiance: Array) -> Grey:
    full = 2.0**sensor.bit_depth - 1
    light = sensor.photon_rate_per_s * sensor.exposure_time_s * sensor.quantum_efficiency
    electrons = light * radiance
    dark = sensor.dark_current_e_per_s * sensor.exposure_time_s
    gain = sensor.gain_dn_per_e
    variance = gain**2 * (electrons + dark + sensor.temporal_dark_noise_e**2) + _ROUNDING
    pattern = gain * np.hypot(sensor.prnu * electrons, sensor.dsnu_e)
    level = gain * (electrons + dark) + sensor.black_level_dn
    return Grey(level / full, np.full_like(radiance, gain * light / full), np.sqrt(variance) / full, pattern / full)


@lru_cache(maxsize=64)
def _measured(chain: str) -> tuple[Array, Array, Array, Array]:
    """Measure levels, slopes, noise and patterns of a sensor from flat images."""
    sensor = SensorChain.model_validate_json(chain)
    opened = sensor.open((_SIDE, _SIDE), partial(generator_for, 0, "prediction"))
    rows = []
    for radiance in np.linspace(0.0, sensor.saturation_radiance, _LEVELS):
        flat = np.full((_SIDE, _SIDE), radiance, dtype=np.float32)
        images = [LinearImage(flat, 0, 0, t) for t in range(_IMAGES)]
        before = [None, *images[:-1]]
        taken = np.array([opened.read(*pair) for pair in zip(images, before, strict=True)], dtype=np.float64)
        noise = taken.std(axis=0, ddof=1)
        temporal = float(np.mean(noise**2))
        spatial = max(float(taken.mean(axis=0).var()) - temporal / _IMAGES, 0.0)
        rows.append((taken.mean(), np.sqrt(temporal), np.sqrt(spatial)))
    level, temporal_std, pattern = (np.array(each) / sensor.full_scale for each in zip(*rows, strict=True))
    slope = np.gradient(level, np.linspace(0.0, sensor.saturation_radiance, _LEVELS))
    return level, slope, temporal_std, pattern
