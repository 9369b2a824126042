"""Photographs of patterns and power spectra: contrast, gradients and speckle size as imaged by the rig."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.compilation import thread_count
from scenetruth.design.patterns.pattern_rig import PatternRig, compute_contrast_transfer
from scenetruth.design.prediction.camera_response import compute_derivative_response
from scenetruth.errors import ArgumentError, Problem, SceneError
from scenetruth.scene.picture_file import DecodedPicture, PictureFileError, as_picture, decode_picture
from scenetruth.scene.texture.image_textures import read_image_header

__all__ = [
    "PatternSpectrum",
    "PatternStatistics",
    "compute_pattern_statistics",
    "compute_ring_means",
    "compute_spectrum",
    "load_grey_values",
    "remove_shading",
    "sample_patch",
]


Array = NDArray[np.float64]

_MOST_SIDE = 2048


def load_grey_values(picture: str | Path | NDArray[Any], encoding: str) -> Array:
    """Return the linear grey values of a photograph, from 0 to 1; of the centre if it is large."""
    if encoding not in ("linear", "srgb"):
        raise ArgumentError([Problem("encoding", "must be linear or srgb", encoding)], source="a pattern")
    if isinstance(picture, str | Path):
        made = _read(Path(picture))
    else:
        image, text = np.asarray(picture), f"shape {np.shape(picture)}, {np.asarray(picture).dtype}"
        if image.ndim not in (2, 3) or 0 in image.shape or (image.ndim == 3 and image.shape[2] > 4):
            problem = Problem("picture", "must be a single grey or colour picture", text)
            raise ArgumentError([problem], source="a pattern")
        if image.dtype.kind not in "uifb" or not np.isfinite(image).all():
            raise ArgumentError([Problem("picture", "must contain finite numbers", text)], source="a pattern")
        made = as_picture(image)
    slices = tuple(slice(max((side - _MOST_SIDE) // 2, 0), None) for side in made.values.shape[:2])
    made = replace(made, values=made.values[slices][:_MOST_SIDE, :_MOST_SIDE])
    return np.clip(made.radiances(encoding), 0, 1).astype(np.float64)


def remove_shading(grey: Array) -> Array:
    """Return a picture divided by its quadratic trend, with its mean preserved, to correct uneven illumination."""
    rows, columns = grey.shape
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    fitted = terms @ np.linalg.lstsq(terms, grey.ravel(), rcond=None)[0]
    mean = float(grey.mean())
    surface = np.maximum(fitted.reshape(grey.shape), 0.05 * mean)
    return np.asarray(grey / surface * mean) if mean > 0 else grey


def _read(file: Path) -> DecodedPicture:
    try:
        read_image_header(file)
        return decode_picture(file.read_bytes())
    except SceneError as error:
        problems = [Problem("picture", problem.message, str(file)) for problem in error.problems]
        raise ArgumentError(problems, source="a pattern") from error
    except (OSError, PictureFileError) as error:
        raise ArgumentError([Problem("picture", str(error), str(file))], source="a pattern") from error


NYQUIST = 0.5
"""Nyquist frequency in periods per px."""

_REACH_PX = 16


@dataclass(frozen=True, eq=False)
class PatternSpectrum:
    """Power (rows, columns) at the frequencies of `numpy.fft.fftfreq`; its sum is the variance.

    ``pitch_px``: Sampling distance on the sensor, in px.
    ``window``: Autocorrelation of the window applied to the picture, by distance in rows and columns; None for none.
    ``fade``: Contribution of the window's slopes along x and y to squared gradients, relative to the variance.
    """

    power: Array
    pitch_px: float
    window: Array | None = None
    fade: tuple[float, float] = (0.0, 0.0)

    def frequencies(self) -> tuple[Array, Array]:
        """Return the frequencies along x, shape (1, columns), and y, shape (rows, 1), in periods per px."""
        rows, columns = self.power.shape
        return _frequencies(rows, columns, self.pitch_px)


@dataclass(frozen=True)
class PatternStatistics:
    """Image statistics of a pattern for a rig, in units of the picture.

    ``gradient_x``, ``gradient_y``: RMS derivatives, per px, of the quintic spline through the pixels, as used by the
      bound and the refined method, for frequencies below Nyquist.
    ``aliased_share``: Fraction of the variance beyond the Nyquist frequency.
    ``size_px``: Full width at half maximum of the autocorrelation, mean of x and y.
    """

    contrast: float
    gradient_x: float
    gradient_y: float
    aliased_share: float
    size_px: float


def compute_spectrum(picture: Array, pitch_px: float, noise_std: float = 0.0) -> PatternSpectrum:
    """Return the spectrum of a non-periodic picture with samples ``pitch_px`` apart, without its mean, windowed."""
    from scipy import fft

    fade = np.outer(*(np.hanning(side + 2)[1:-1] for side in picture.shape))
    mean = float((fade * picture).sum() / fade.sum())
    square = float((fade**2).sum())
    found = np.abs(fft.fft2(fade * (picture - mean), workers=thread_count())) ** 2 / (square * picture.size)
    window = fft.ifft2(np.abs(fft.fft2(fade)) ** 2, workers=thread_count()).real / square
    # Mean squared slope over mean square of a Hann window of length L: (2 π / √3 L)².
    slopes = tuple((2 * np.pi / (side * pitch_px)) ** 2 / 3 for side in reversed(picture.shape))
    return PatternSpectrum(found - noise_std**2 / picture.size, pitch_px, window, (slopes[0], slopes[1]))


def compute_pattern_statistics(
    spectrum: PatternSpectrum, rig: PatternRig | None, texel_px: float = 0.0
) -> PatternStatistics:
    """Return the image statistics of a pattern with a given spectrum."""
    f_x, f_y = spectrum.frequencies()
    left = np.ones_like(spectrum.power) if rig is None else compute_contrast_transfer(rig, f_x, f_y)
    # Beyond the Nyquist frequency, the power is small and not corrected.
    clear = (np.abs(f_x) <= NYQUIST) & (np.abs(f_y) <= NYQUIST)
    if texel_px > 0:
        left = left / np.where(clear, np.sinc(f_x * texel_px) * np.sinc(f_y * texel_px), 1.0)
    seen = spectrum.power * left**2
    usable = np.where(clear, seen, 0.0)
    squares = [
        float((compute_derivative_response(f) ** 2 * usable).sum()) - fade * float(usable.sum())
        for f, fade in zip((f_x, f_y), spectrum.fade, strict=True)
    ]
    variance, aliased = max(float(seen.sum()), 0.0), max(float(np.where(clear, 0.0, seen).sum()), 0.0)
    return PatternStatistics(
        contrast=float(np.sqrt(variance)),
        gradient_x=float(np.sqrt(max(squares[0], 0.0))),
        gradient_y=float(np.sqrt(max(squares[1], 0.0))),
        aliased_share=aliased / variance if variance > 0 else 0.0,
        size_px=_width(seen, spectrum),
    )


def sample_patch(picture: Array, pitch_px: float, rig: PatternRig | None, side_px: int) -> Array:
    """Return the centre of a picture as sampled by a rig's pixels, or unchanged if recorded by the rig."""
    from scipy import fft
    from scipy.ndimage import map_coordinates

    sides = [min(side_px, int(count * pitch_px)) for count in picture.shape]
    # Largest extent of blur by lens and pixels.
    wide = [
        min(count, math.ceil((side + 2 * _REACH_PX) / pitch_px))
        for side, count in zip(sides, picture.shape, strict=True)
    ]
    first = [(count - width) // 2 for count, width in zip(picture.shape, wide, strict=True)]
    part = picture[first[0] : first[0] + wide[0], first[1] : first[1] + wide[1]]
    if rig is not None:
        part = fft.ifft2(
            fft.fft2(part) * compute_contrast_transfer(rig, *_frequencies(wide[0], wide[1], pitch_px))
        ).real
    at = [
        (width - 1) / 2 + (np.arange(side) - (side - 1) / 2) / pitch_px for side, width in zip(sides, wide, strict=True)
    ]
    return np.asarray(map_coordinates(part, np.meshgrid(*at, indexing="ij"), order=3, mode="nearest"))


def compute_ring_means(spectrum: PatternSpectrum, rig: PatternRig | None, edges: Array) -> Array:
    """Return the mean power density by rings of frequencies with borders ``edges`` in periods per px; NaN if empty."""
    f_x, f_y = spectrum.frequencies()
    left = 1.0 if rig is None else compute_contrast_transfer(rig, f_x, f_y)
    # Each frequency represents an area of 1 / (rows columns pitch²).
    density = spectrum.power * left**2 * spectrum.power.size * spectrum.pitch_px**2
    ring = np.digitize(np.hypot(f_x, f_y).ravel(), edges) - 1
    inside = (ring >= 0) & (ring < len(edges) - 1)
    counts = np.bincount(ring[inside], minlength=len(edges) - 1)
    sums = np.bincount(ring[inside], density.ravel()[inside], minlength=len(edges) - 1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _frequencies(rows: int, columns: int, pitch_px: float) -> tuple[Array, Array]:
    x, y = (np.asarray(np.fft.fftfreq(count, pitch_px), dtype=np.float64) for count in (columns, rows))
    return x[None], y[:, None]


def _width(seen: Array, spectrum: PatternSpectrum) -> float:
    """Return the full width at half maximum of the autocorrelation; NaN if it does not fall below half."""
    from scipy import fft

    correlation = fft.ifft2(seen, workers=thread_count()).real
    widths = []
    for axis in (0, 1):
        lags = correlation[:, 0] if axis == 0 else correlation[0]
        half = lags.size // 2
        along = lags[:half].copy()
        if spectrum.window is not None:
            fade = spectrum.window[:, 0] if axis == 0 else spectrum.window[0]
            # At large distances, the autocorrelation of the window vanishes.
            along = np.where(fade[:half] > 0.1, along / np.maximum(fade[:half], 0.1), 0.0)
        below = np.flatnonzero(along < along[0] / 2)
        if along[0] <= 0 or not below.size:
            return float("nan")
        n = int(below[0])
        widths.append(2 * (n - 1 + (along[n - 1] - along[0] / 2) / (along[n - 1] - along[n])) * spectrum.pitch_px)
    return float(np.mean(widths))
