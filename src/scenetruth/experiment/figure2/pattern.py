"""The translating pattern of the paper (eq. 13), straight from its formula."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.schema import make_recording

__all__ = ["FOCAL_LENGTH_PX", "REFERENCE_DEPTH", "SHAPE", "pattern_images", "pattern_recording"]

FOCAL_LENGTH_PX = 10.0
"""f of the paper's experiment."""

REFERENCE_DEPTH = 100.0
"""Z_0 of the paper's experiment, in the units of V_X."""

SHAPE = (5, 9, 29, 29)
"""Cameras, frames, rows and columns that the filters and the window of one estimate need."""


def pattern_images(
    wavelength_px: float,
    *,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    baseline: float = 1.0,
    phase: tuple[float, float] = (0.0, 0.0),
    noise_std: float = 0.0,
    generator: np.random.Generator | None = None,
    shape: tuple[int, int, int, int] = SHAPE,
) -> NDArray[np.float64]:
    """Make images of g = cos(K_X X) cos(K_Y Y) (paper eq. 13).

    X = x Z_t / f - U_X t + V_X s, Y = y Z_t / f - U_Y t and Z_t = Z_0 + U_Z t, with x and y from the image's centre and
    K_X = K_Y such that the wavelength in the image is ``wavelength_px`` at t = 0.

    Parameters
    ----------
    wavelength_px
        λ in px.
    velocity
        (U_X, U_Y, U_Z) per frame.
    baseline
        V_X per step of s.
    phase
        Phases of the two cosines in radian.
    noise_std
        σ_n of Gaussian noise, for grey values in [-1, 1].
    generator
        Source of the noise; needed if there is noise.
    shape
        Cameras, frames, rows and columns.

    Returns
    -------
    numpy.ndarray
        Images (1 + g) / 2 + noise of that shape, which lead to the grey values g of the paper.
    """
    s, t, y, x = (
        (np.arange(size) - (size - 1) / 2 if axis > 1 else np.arange(size) - (size - 1) // 2).astype(np.float64)
        for axis, size in enumerate(shape)
    )
    wave_number = 2 * np.pi / wavelength_px * FOCAL_LENGTH_PX / REFERENCE_DEPTH
    scale = (REFERENCE_DEPTH + velocity[2] * t) / FOCAL_LENGTH_PX
    across = x * scale[:, None] - velocity[0] * t[:, None] + baseline * s[:, None, None]
    down = y * scale[:, None] - velocity[1] * t[:, None]
    grey: NDArray[np.float64] = (
        np.cos(wave_number * across + phase[0])[:, :, None, :] * np.cos(wave_number * down + phase[1])[None, :, :, None]
    )
    if noise_std > 0:
        assert generator is not None
        grey = grey + noise_std * generator.standard_normal(shape)
    return (grey + 1) / 2


def pattern_recording(images: NDArray[np.float64], baseline: float = 1.0) -> xr.Dataset:
    """Make a recording with the paper's camera.

    Parameters
    ----------
    images
        What `pattern_images` made, of one pattern, or of several side by side along x.
    baseline
        V_X per step of s.

    Returns
    -------
    xarray.Dataset
        The recording.
    """
    # Noise may exceed full scale a little.
    return make_recording(images, FOCAL_LENGTH_PX, baseline, full_scale=1.0)
