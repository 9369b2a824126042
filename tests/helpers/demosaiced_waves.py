"""Demosaiced images of waves that move: measured displacements, and that of the filters of the structure tensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

import scenetruth as st
from scenetruth.camera import demosaic, mosaic
from scenetruth.camera.sensor import DemosaicedWave
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.structure_tensor import PAPER, choose_acquisition_axes

__all__ = [
    "CAMERAS", "STEPS", "Waves", "demosaiced_image", "measured_displacement", "plane_recording", "random_waves",
    "tensor_displacement",
]  # fmt: skip

CAMERAS = 5
STEPS = np.arange(CAMERAS) - CAMERAS // 2
Waves = Sequence[tuple[tuple[float, float], Any]]


def random_waves(shortest_px: float, longest_px: float, colour: Any, count: int = 24, seed: int = 1) -> Waves:
    """Return wave vectors and complex amplitudes of random waves of all directions."""
    drawn, waves = np.random.default_rng(seed), []
    for _ in range(count):
        k = 2 * np.pi / np.exp(drawn.uniform(np.log(shortest_px), np.log(longest_px)))
        angle, phase = drawn.uniform(0, 2 * np.pi, 2)
        wave = (k * np.cos(angle), k * np.sin(angle)), np.asarray(colour) * np.exp(1j * phase) / np.sqrt(count)
        waves.append(wave)
    return waves


def demosaiced_image(
    waves: Waves, displacement_px: float, shape: tuple[int, int], pattern: str, method: Any
) -> NDArray[np.float64]:
    """Return a demosaiced image of waves that are displaced along x."""
    y, x = np.indices(shape).astype(np.float64)
    total = np.zeros((*shape, 3))
    for (k_x, k_y), colour in waves:
        phase = np.exp(1j * (k_x * (x - displacement_px) + k_y * y))
        total += (np.asarray(colour) * phase[..., None]).real
    return demosaic(mosaic(total, pattern), pattern, method)


def measured_displacement(waves: Waves, displacement_px: float, period_px: int, pattern: str, method: Any) -> float:
    """Return the displacement of least squares, over a window of whole periods of all waves and of the pattern."""
    shape = (24, period_px + 8)
    still, moved = (demosaiced_image(waves, d, shape, pattern, method)[8:16, 4:-4] for d in (0.0, displacement_px))
    frequencies = 2 * np.pi * np.fft.fftfreq(period_px)
    spectrum = np.fft.fft(moved, axis=1)

    def mismatch(found: float) -> float:
        registered = np.fft.ifft(spectrum * np.exp(1j * frequencies * found)[:, None], axis=1).real
        return float(np.sum((registered - still) ** 2))

    places = displacement_px + np.linspace(-0.5, 0.5, 101)
    best = places[np.argmin([mismatch(place) for place in places])]
    found = minimize_scalar(mismatch, bounds=(best - 0.01, best + 0.01), method="bounded", options={"xatol": 1e-9})
    return float(found.x)


def plane_recording(
    waves: Waves, displacement_px: float, pattern: str, method: Any, shape: tuple[int, int] = (80, 110)
) -> xr.Dataset:
    """Return a recording of a plane whose disparity is a displacement per step, with grey values around 0.5."""
    images = [0.5 + 0.2 * demosaiced_image(waves, -displacement_px * s, shape, pattern, method) for s in STEPS]
    single = np.array(images, dtype=np.float32)[:, None]
    return st.make_recording(single, 1000.0, 5.0, stage_x_mm=5.0 * STEPS, full_scale=1.0)


def tensor_displacement(waves: Sequence[DemosaicedWave], displacement_px: float) -> float:
    """Return the disparity of the structure tensor of images of a plane, unregistered, from its filters."""
    over_s = choose_acquisition_axes(STEPS.astype(np.float64), 1, StructureTensorSettings()).over_s
    scale = np.sqrt(PAPER.noise_ratio / over_s.noise_ratio)
    tensor = np.zeros((2, 2))
    for wave in waves:
        (along_x, smooth_x), (_, smooth_y) = (PAPER.transfer(k) for k in wave.wave_vectors.T)
        along_s, smooth_s = over_s.transfer(np.full(4, wave.wave_vector[0] * displacement_px))
        gradient = np.stack([along_x * smooth_y * smooth_s, scale * smooth_x * smooth_y * along_s])
        power = (np.abs(wave.amplitudes) ** 2).sum(axis=1)
        tensor += ((power * gradient) @ gradient.conj().T).real
    _, vectors = np.linalg.eigh(tensor)
    along, step = vectors[:, 0]
    return float(-along / step / scale)
