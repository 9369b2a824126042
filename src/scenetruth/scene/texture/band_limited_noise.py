"""Periodic band-limited random fields."""

from __future__ import annotations

import itertools
from bisect import bisect_left
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scenetruth.compilation import thread_count

__all__ = ["BandLimitedNoise", "compute_noise_shape", "contains_wavelength", "make_band_limited_noise"]

SAMPLES_PER_WAVELENGTH = 16
"""Raster points per shortest wavelength."""

_MOST_SAMPLES = 4096
_MOST_ROUNDS = 100
_COARSER = 2  # subsampling of the raster for peak limiting, with 8 points per shortest wavelength


@dataclass(frozen=True, eq=False)
class BandLimitedNoise:
    """Noise of zero mean and unit variance with its cubic B-spline coefficients, float32, repeated with ``period``."""

    values: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    period: tuple[float, float]


def make_band_limited_noise(
    wavelength: tuple[float, float],
    size: tuple[float, float],
    generator: np.random.Generator,
    *,
    exponent: float = 0.0,
    peak: float = 4.0,
) -> BandLimitedNoise:
    """Return isotropic Gaussian noise whose spectrum is exactly zero outside a wavelength band."""
    from scipy import fft

    pitch = wavelength[0] / SAMPLES_PER_WAVELENGTH
    rows, columns = compute_noise_shape(wavelength, size)
    small = _limited_spectrum(
        (rows // _COARSER, columns // _COARSER), pitch * _COARSER, wavelength, generator, exponent, peak
    )
    used = small.shape[1]
    spectrum = np.zeros((rows, used), dtype=np.complex128)
    half = small.shape[0] // 2
    spectrum[:half] = small[:half]
    spectrum[-half:] = small[-half:]
    values = _inverse(spectrum, (rows, columns))
    scale = 1 / values.std()
    # Samples of a cubic B-spline are its coefficients filtered by (1, 4, 1) / 6 along both axes.
    response = ((2 + np.cos(2 * np.pi * fft.fftfreq(rows))) / 3)[:, None] * (
        (2 + np.cos(2 * np.pi * fft.rfftfreq(columns)[:used])) / 3
    )[None, :]
    coefficients = _inverse(spectrum / response, (rows, columns))
    return BandLimitedNoise(_scaled(values, scale), _scaled(coefficients, scale), (columns * pitch, rows * pitch))


def compute_noise_shape(wavelength: tuple[float, float], size: tuple[float, float]) -> tuple[int, int]:
    """Return the rows and columns of the noise raster."""
    shortest, longest = wavelength
    pitch = shortest / SAMPLES_PER_WAVELENGTH
    columns, rows = (_raster_points(max(extent, 4 * longest), pitch) for extent in size)
    return rows, columns


def contains_wavelength(wavelength: tuple[float, float], size: tuple[float, float]) -> bool:
    """Return whether the noise raster supports any wave of a band; otherwise the noise is zero."""
    pitch = wavelength[0] / SAMPLES_PER_WAVELENGTH * _COARSER
    # Maximum number of periods of the band along either side.
    down, across = (
        np.fft.rfftfreq(side // _COARSER, pitch)[: side // SAMPLES_PER_WAVELENGTH + 2]
        for side in compute_noise_shape(wavelength, size)
    )
    frequency = np.hypot(down[:, None], across[None, :])
    return bool(((frequency >= 1 / wavelength[1]) & (frequency <= 1 / wavelength[0])).any())


def _scaled(values: NDArray[np.float64], scale: float) -> NDArray[np.float32]:
    values *= scale
    return values.astype(np.float32)


def _raster_points(extent: float, pitch: float) -> int:
    return _COARSER * _fast_length(int(np.ceil(min(extent / pitch, _MOST_SAMPLES) / _COARSER)))


def _fast_length(least: int) -> int:
    """Return `scipy.fft.next_fast_len` for real input without SciPy: products of 2, 3 and 5."""
    lengths = _fast_lengths()
    return lengths[bisect_left(lengths, least)]


@cache
def _fast_lengths() -> list[int]:
    """Return the products of 2, 3 and 5 in ascending order."""
    powers = itertools.product(range(13), range(9), range(6))
    return sorted(2**twos * 3**threes * 5**fives for twos, threes, fives in powers)


def _limited_spectrum(
    shape: tuple[int, int],
    pitch: float,
    wavelength: tuple[float, float],
    generator: np.random.Generator,
    exponent: float,
    peak: float,
) -> NDArray[np.complex128]:
    """Return the half spectrum of band-limited noise with limited peaks, up to its last nonzero column."""
    from scipy import fft

    rows, columns = shape
    frequency = np.hypot(fft.fftfreq(rows, pitch)[:, None], fft.rfftfreq(columns, pitch)[None, :])
    band = (frequency >= 1 / wavelength[1]) & (frequency <= 1 / wavelength[0])
    # The spectrum is zero beyond the highest frequency of the band along x.
    used = int(np.flatnonzero(band.any(axis=0)).max(initial=0)) + 1
    frequency, band = frequency[:, :used], band[:, :used]
    spectrum = np.zeros(band.shape, dtype=np.complex128)
    count = int(band.sum())
    spectrum[band] = frequency[band] ** (exponent / 2) * (
        generator.standard_normal(count) + 1j * generator.standard_normal(count)
    )
    for _ in range(_MOST_ROUNDS):
        field = _inverse(spectrum, shape)
        limit = peak * field.std()
        if max(field.max(), -field.min()) <= 0.99 * limit:
            break
        # Clipping slightly below the limit makes the projections converge in a few iterations.
        np.clip(field, -0.96 * limit, 0.96 * limit, out=field)
        across = fft.rfft(field, axis=1, workers=thread_count())
        spectrum = fft.fft(across[:, :used], axis=0, workers=thread_count()) * band
    return spectrum


def _inverse(spectrum: NDArray[np.complex128], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return `scipy.fft.irfft2`, bit-identical, for a half spectrum without its trailing zero columns."""
    from scipy import fft

    rows, columns = shape
    part = np.zeros((rows, columns // 2 + 1), dtype=np.complex128)
    part[:, : spectrum.shape[1]] = fft.ifft(spectrum, axis=0, norm="forward", workers=thread_count())
    values: NDArray[np.float64] = fft.irfft(part, columns, axis=1, norm="forward", workers=thread_count())
    values *= 1 / (rows * columns)
    return values
