"""Noise of a band of wavelengths on a sheet, and its spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.pattern.base import Array, Box
from scenetruth.errors import Problem
from scenetruth.scene.texture.band_limited import band_limited_noise, holds_a_wave

__all__ = ["MOST_TEXELS", "Field", "band_power", "band_problems", "field_of"]

MOST_TEXELS = 40_000_000
"""Points at which noise is known on a printed sheet: more of them make files that nothing prints."""

SAMPLES = 8
"""Points per shortest wavelength on a printed sheet."""

# Points that are looked up at a time.
_PART = 2_000_000


@dataclass(frozen=True, eq=False)
class Field:
    """Noise of zero mean and unit variance that repeats.

    Parameters
    ----------
    coefficients
        Of a periodic cubic spline.
    period_mm
        Width and height after which it repeats.
    """

    coefficients: NDArray[np.float32]
    period_mm: tuple[float, float]

    def at(self, x_mm: Array, y_mm: Array) -> NDArray[np.float32]:
        """Return the noise on a grid of columns and rows, shape (y, x)."""
        from scenetruth.scene.texture.kernels import spline_lookup

        out = np.empty((y_mm.size, x_mm.size), dtype=np.float32)
        rows = max(_PART // x_mm.size, 1)
        for first in range(0, y_mm.size, rows):
            part = y_mm[first : first + rows]
            uv = np.empty((part.size, x_mm.size, 2))
            uv[..., 0], uv[..., 1] = x_mm / self.period_mm[0], part[:, None] / self.period_mm[1]
            out[first : first + rows] = spline_lookup(self.coefficients, uv.reshape(-1, 2)).reshape(part.size, -1)
        return out

    def texels(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the noise in the middle of texels that cover a box."""
        left, top, width, height = box_mm
        x = left + (np.arange(shape[1]) + 0.5) * width / shape[1]
        y = top + (np.arange(shape[0]) + 0.5) * height / shape[0]
        return self.at(x, y)


def field_of(
    wavelength_mm: tuple[float, float],
    size_mm: tuple[float, float],
    exponent: float,
    peak: float,
    generator: np.random.Generator,
) -> Field:
    """Make the noise of a sheet.

    Parameters
    ----------
    wavelength_mm
        Shortest and longest wavelength.
    size_mm
        Size of the sheet; what is larger than 256 shortest wavelengths repeats.
    exponent
        Power density in the band is proportional to (spatial frequency) ** exponent.
    peak
        It stays within so many standard deviations.
    generator
        Source of phases and amplitudes.
    """
    noise = band_limited_noise(wavelength_mm, size_mm, generator, exponent=exponent, peak=peak)
    return Field(noise.coefficients, noise.period)


def band_problems(wavelength_mm: tuple[float, float], size_mm: tuple[float, float]) -> list[Problem]:
    """Return what keeps noise of a band from being drawn on a sheet."""
    problems = []
    if not holds_a_wave(wavelength_mm, size_mm):
        message = "is so narrow a band that no wave of it fits on the sheet; make it wider"
        problems.append(Problem("wavelength_mm", message, wavelength_mm))
    texels = SAMPLES**2 * size_mm[0] * size_mm[1] / wavelength_mm[0] ** 2
    if texels > MOST_TEXELS:
        message = f"is too short for a sheet of this size: {texels:,.0f} points, more than {MOST_TEXELS:,}"
        problems.append(Problem("wavelength_mm", f"{message}; print a smaller sheet", wavelength_mm))
    return problems


def band_power(wavelength_mm: tuple[float, float], exponent: float, count: int, pitch_mm: float) -> Array:
    """Return the spectrum of noise of unit variance at the frequencies of `numpy.fft.fftfreq`, shape (count, count)."""
    at = np.fft.fftfreq(count, pitch_mm)
    frequency = np.hypot(at[:, None], at)
    band = (frequency >= 1 / wavelength_mm[1]) & (frequency <= 1 / wavelength_mm[0])
    power = np.zeros_like(frequency)
    power[band] = frequency[band] ** exponent
    return np.asarray(power / power.sum())
