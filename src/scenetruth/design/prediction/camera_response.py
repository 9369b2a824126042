"""Camera response: modulation transfer of pixels, lens, focus and motion; grey levels and their noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import LinearImage, SensorChain, build_sensor_chain
from scenetruth.camera.sensor.sensor_types import EmvaSensor, GaussianSensor
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene

__all__ = [
    "GreyLevelNoise",
    "compute_blur_px",
    "compute_derivative_response",
    "compute_grey_levels",
    "compute_irradiance",
    "compute_transfer",
]


Array = NDArray[np.float64]

_NYQUIST = 0.5  # Nyquist frequency, in periods per px


def compute_transfer(frequency: Array, scene: Scene, depth_mm: Array, motion_px: Array) -> Array:
    """Return the modulation transfer function of waves at points.

    Pixels average over their area or over n x n samples, sin(π f) / (n sin(π f / n)) along x and y; the lens has its
    point-spread function; the aperture is a disc; motion averages over a line. Waves beyond the Nyquist frequency are
    set to 0: their aliases do not move with the surface. ``frequency`` is in periods per px, shape (points, waves, 2),
    ``motion_px`` the motion during the exposure, shape (points, 2).
    """
    settings = scene.render
    if settings.supersampling == "auto" and settings.backend != "pyrender":
        found = np.asarray(np.prod(np.sinc(frequency), axis=-1))
    else:
        found = _pixel(frequency, settings.samples)
    optics, focal = scene.optics, scene.camera.focal_px
    if optics.psf is not None:
        found = found * optics.psf.transfer(np.hypot(frequency[..., 0], frequency[..., 1]))
    if optics.defocus is not None:
        diameter = optics.defocus.blur_diameter_px(depth_mm, focal)
        found = found * _disc(np.pi * diameter[:, None] * np.hypot(frequency[..., 0], frequency[..., 1]))
    if motion_px.any():
        found = found * np.sinc(np.einsum("pwk,pk->pw", frequency, motion_px))
    return np.asarray(found * (np.abs(frequency) < _NYQUIST).all(axis=-1))


def compute_blur_px(scene: Scene, depth_mm: Array, flow_px: Array) -> Array:
    """Return the motion (points, 2) in px during the exposure, by the flow in px per frame and by the stage."""
    shutter = scene.shutter
    found = flow_px * (shutter.exposure_time_s / scene.frames.frame_interval_s)
    travel_mm = shutter.stage_speed_mm_per_s * shutter.exposure_time_s
    found[:, 0] -= scene.camera.focal_px * travel_mm / depth_mm
    return found


def compute_derivative_response(frequency: Array) -> Array:
    """Return the derivative in radian per px of a quintic spline through waves at ``frequency`` periods per px."""
    turn = 2 * np.pi * frequency
    return np.asarray(5 * (10 * np.sin(turn) + np.sin(2 * turn)) / (33 + 26 * np.cos(turn) + np.cos(2 * turn)))


def _pixel(frequency: Array, samples: int) -> Array:
    if samples == 1:
        return np.ones(frequency.shape[:-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.sin(np.pi * frequency) / (samples * np.sin(np.pi * frequency / samples))
    # Beyond the Nyquist frequency of the samples, the transfer is set to 0 anyway.
    return np.asarray(np.prod(np.where(np.abs(frequency) < 1e-9, 1.0, along), axis=-1))


def _disc(argument: Array) -> Array:
    """Return 2 J1(z) / z, the transform of a uniform disc, as the mean of a wave over its chords."""
    nodes, shares = np.polynomial.chebyshev.chebgauss(24)
    # 2 J1(z) / z = 2/π ∫ √(1 - u²) cos(z u) du over [-1, 1]; the Chebyshev weight is 1 / √(1 - u²).
    weights = 2 / np.pi * shares * (1 - nodes**2)
    return np.asarray(sum(weight * np.cos(argument * node) for node, weight in zip(nodes, weights, strict=True)))


_ROUNDING = 1 / 12
# Size, grey levels and number of the flat images from which a sensor without formula is measured.
_SIDE, _LEVELS, _IMAGES = 48, 9, 8


@dataclass(frozen=True, eq=False)
class GreyLevelNoise:
    """Grey values of points and their noise, in fractions of full scale, each of shape (n,)."""

    level: Array
    gain: Array  # derivative of the grey value by radiance
    noise: Array  # standard deviation of temporal noise, including rounding
    pattern: Array  # standard deviation of fixed-pattern noise


def compute_grey_levels(sensor: Any, radiance: Array) -> GreyLevelNoise:
    """Return grey values and noise for the mean radiance of points, shape (n,)."""
    radiance = np.asarray(radiance, dtype=np.float64)
    if isinstance(sensor, GaussianSensor):
        variance = sensor.noise_std**2
        if sensor.bit_depth is not None:
            variance += _ROUNDING / (2**sensor.bit_depth - 1) ** 2
        one = np.ones_like(radiance)
        level = radiance / sensor.full_scale_radiance
        return GreyLevelNoise(level, one / sensor.full_scale_radiance, np.sqrt(variance) * one, 0.0 * one)
    if isinstance(sensor, EmvaSensor) and sensor.gamma == 1 and sensor.bayer is None and not sensor.insert:
        return _emva(sensor, radiance)
    if isinstance(sensor, str) or not build_sensor_chain(sensor).effects:
        one = np.ones_like(radiance)
        return GreyLevelNoise(radiance, one, 0.0 * one, 0.0 * one)
    levels = np.linspace(0.0, build_sensor_chain(sensor).saturation_radiance, _LEVELS)
    measured = _measured(build_sensor_chain(sensor).model_dump_json())
    return GreyLevelNoise(*(np.interp(radiance, levels, each) for each in measured))


def compute_irradiance(scene: Scene, points_mm: Array, normals: Array) -> Array:
    """Return radiance / texture value of matt surfaces at world points with unit normals towards the camera at t = 0.

    Shadows are not included, and a lamp with a size has the light of a small lamp at its centre.
    """
    lighting = scene.lighting
    factor = np.full(len(points_mm), lighting.brightness(0.0))
    if not lighting.lit:
        return factor
    total = np.full(len(points_mm), lighting.ambient_irradiance)
    for lamp in lighting.lamps_at(0.0):
        if lamp.position_mm is None:
            total += lamp.irradiance * np.maximum(-normals @ lamp.axis, 0.0)
            continue
        away = points_mm - lamp.position_mm
        length = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        beam = away / length[:, None]
        part = lamp.irradiance * (lamp.reference_distance_mm / length) ** 2
        part = part * np.maximum(-(normals * beam).sum(axis=1), 0.0)
        if lamp.area is not None and lamp.area.shape != "sphere":
            part = part * np.maximum(beam @ lamp.axis, 0.0)
        if lamp.beam is not None:
            part = part * lamp.relative_intensity(-beam)
        if lamp.cos_inner > -1.0:
            span = max(lamp.cos_inner - lamp.cos_outer, 1e-12)
            share = np.clip((beam @ lamp.axis - lamp.cos_outer) / span, 0.0, 1.0)
            part = part * share**2 * (3 - 2 * share)
        total += part
    return np.asarray(factor * total)


def _emva(sensor: EmvaSensor, radiance: Array) -> GreyLevelNoise:
    full = 2.0**sensor.bit_depth - 1
    light = sensor.photon_rate_per_s * sensor.exposure_time_s * sensor.quantum_efficiency
    electrons = light * radiance
    dark = sensor.dark_current_e_per_s * sensor.exposure_time_s
    gain = sensor.gain_dn_per_e
    variance = gain**2 * (electrons + dark + sensor.temporal_dark_noise_e**2) + _ROUNDING
    pattern = gain * np.hypot(sensor.prnu * electrons, sensor.dsnu_e)
    level = gain * (electrons + dark) + sensor.black_level_dn
    return GreyLevelNoise(
        level / full, np.full_like(radiance, gain * light / full), np.sqrt(variance) / full, pattern / full
    )


@lru_cache(maxsize=64)
def _measured(chain: str) -> tuple[Array, Array, Array, Array]:
    """Measure levels, slopes, noise and fixed patterns of a sensor from flat images."""
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
