"""The power spectrum of a picture, and what the rig leaves of it: contrast, gradients, size of what is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.compilation import thread_count
from scenetruth.design.pattern.rig import Rig
from scenetruth.design.pattern.transfer import transfer_of
from scenetruth.design.predict.transfer import derivative_response

__all__ = ["Figures", "Spectrum", "figures_of", "ring_means", "seen_patch", "spectrum_of"]

Array = NDArray[np.float64]

NYQUIST = 0.5
"""Periods per px beyond which waves are not seen as what they are."""

_REACH_PX = 16


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power at the frequencies of `numpy.fft.fftfreq`; it sums to the variance.

    Parameters
    ----------
    power
        Shape (rows, columns).
    pitch_px
        Distance of the raster's points on the sensor, in px.
    window
        Correlation of the window that the picture was faded out with, by distance in rows and columns; None for none.
    fade
        What the slopes of this window along x and y add to squared gradients, per variance.
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
class Figures:
    """What a rig sees of a pattern, in shares of the picture's unit.

    Parameters
    ----------
    contrast
        Standard deviation.
    gradient_x, gradient_y
        Rms of the derivatives, per px, of the quintic spline through the pixels, from which the bound and the refined
        method take them: of waves that are sampled finely enough.
    aliased_share
        Share of the variance in waves that are too short for the pixels.
    size_px
        Full width at half maximum of the autocorrelation, mean of x and y.
    """

    contrast: float
    gradient_x: float
    gradient_y: float
    aliased_share: float
    size_px: float


def spectrum_of(picture: Array, pitch_px: float, noise_std: float = 0.0) -> Spectrum:
    """Return the spectrum of a picture that does not repeat: without its mean, faded out towards its borders.

    Parameters
    ----------
    picture
        Shape (rows, columns).
    pitch_px
        Distance of its points on the sensor, in px.
    noise_std
        Standard deviation of white noise in it, whose power is taken away.
    """
    from scipy import fft

    fade = np.outer(*(np.hanning(side + 2)[1:-1] for side in picture.shape))
    mean = float((fade * picture).sum() / fade.sum())
    square = float((fade**2).sum())
    found = np.abs(fft.fft2(fade * (picture - mean), workers=thread_count())) ** 2 / (square * picture.size)
    window = fft.ifft2(np.abs(fft.fft2(fade)) ** 2, workers=thread_count()).real / square
    # Mean squared slope over mean square of a cosine bell of length L: (2 π / √3 L)².
    slopes = tuple((2 * np.pi / (side * pitch_px)) ** 2 / 3 for side in reversed(picture.shape))
    return Spectrum(found - noise_std**2 / picture.size, pitch_px, window, (slopes[0], slopes[1]))


def figures_of(spectrum: Spectrum, rig: Rig | None, texel_px: float = 0.0) -> Figures:
    """Return what a rig sees of a pattern with that spectrum.

    Parameters
    ----------
    spectrum
        Of the pattern.
    rig
        Lens and pixels; None for a picture that they have taken already.
    texel_px
        Size of the texels over which the picture has been averaged; that is taken back.
    """
    f_x, f_y = spectrum.frequencies()
    left = np.ones_like(spectrum.power) if rig is None else transfer_of(rig, f_x, f_y)
    # Beyond, where nothing is taken back, hardly anything is left.
    clear = (np.abs(f_x) <= NYQUIST) & (np.abs(f_y) <= NYQUIST)
    if texel_px > 0:
        left = left / np.where(clear, np.sinc(f_x * texel_px) * np.sinc(f_y * texel_px), 1.0)
    seen = spectrum.power * left**2
    usable = np.where(clear, seen, 0.0)
    squares = [
        float((derivative_response(f) ** 2 * usable).sum()) - fade * float(usable.sum())
        for f, fade in zip((f_x, f_y), spectrum.fade, strict=True)
    ]
    variance, aliased = max(float(seen.sum()), 0.0), max(float(np.where(clear, 0.0, seen).sum()), 0.0)
    return Figures(
        contrast=float(np.sqrt(variance)),
        gradient_x=float(np.sqrt(max(squares[0], 0.0))),
        gradient_y=float(np.sqrt(max(squares[1], 0.0))),
        aliased_share=aliased / variance if variance > 0 else 0.0,
        size_px=_width(seen, spectrum),
    )


def seen_patch(picture: Array, pitch_px: float, rig: Rig | None, side_px: int) -> Array:
    """Return the middle of a picture as a rig's pixels sample it, or as it is if they have taken it.

    Parameters
    ----------
    picture, pitch_px
        As of `spectrum_of`.
    rig
        Lens and pixels; None for a picture that they have taken already.
    side_px
        Pixels along each side, or as many as there are.
    """
    from scipy import fft
    from scipy.ndimage import map_coordinates

    sides = [min(side_px, int(count * pitch_px)) for count in picture.shape]
    # Lens and pixels reach no farther than this.
    wide = [
        min(count, math.ceil((side + 2 * _REACH_PX) / pitch_px))
        for side, count in zip(sides, picture.shape, strict=True)
    ]
    first = [(count - width) // 2 for count, width in zip(picture.shape, wide, strict=True)]
    part = picture[first[0] : first[0] + wide[0], first[1] : first[1] + wide[1]]
    if rig is not None:
        part = fft.ifft2(fft.fft2(part) * transfer_of(rig, *_frequencies(wide[0], wide[1], pitch_px))).real
    at = [
        (width - 1) / 2 + (np.arange(side) - (side - 1) / 2) / pitch_px for side, width in zip(sides, wide, strict=True)
    ]
    return np.asarray(map_coordinates(part, np.meshgrid(*at, indexing="ij"), order=3, mode="nearest"))


def ring_means(spectrum: Spectrum, rig: Rig | None, edges: Array) -> Array:
    """Return the mean power density in rings of frequencies, as the rig sees it, times px²; NaN in rings without any.

    Parameters
    ----------
    spectrum, rig
        As of `figures_of`.
    edges
        Borders of the rings in periods per px.
    """
    f_x, f_y = spectrum.frequencies()
    left = 1.0 if rig is None else transfer_of(rig, f_x, f_y)
    # One frequency stands for an area of 1 / (rows columns pitch²).
    density = spectrum.power * left**2 * spectrum.power.size * spectrum.pitch_px**2
    ring = np.digitize(np.hypot(f_x, f_y).ravel(), edges) - 1
    inside = (ring >= 0) & (ring < len(edges) - 1)
    counts = np.bincount(ring[inside], minlength=len(edges) - 1)
    sums = np.bincount(ring[inside], density.ravel()[inside], minlength=len(edges) - 1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def _frequencies(rows: int, columns: int, pitch_px: float) -> tuple[Array, Array]:
    x, y = (np.asarray(np.fft.fftfreq(count, pitch_px), dtype=np.float64) for count in (columns, rows))
    return x[None], y[:, None]


def _width(seen: Array, spectrum: Spectrum) -> float:
    """Return the full width at half maximum of the autocorrelation; NaN if it does not fall that far."""
    from scipy import fft

    correlation = fft.ifft2(seen, workers=thread_count()).real
    widths = []
    for axis in (0, 1):
        lags = correlation[:, 0] if axis == 0 else correlation[0]
        half = lags.size // 2
        along = lags[:half].copy()
        if spectrum.window is not None:
            fade = spectrum.window[:, 0] if axis == 0 else spectrum.window[0]
            # Far apart, the window leaves nothing.
            along = np.where(fade[:half] > 0.1, along / np.maximum(fade[:half], 0.1), 0.0)
        below = np.flatnonzero(along < along[0] / 2)
        if along[0] <= 0 or not below.size:
            return float("nan")
        n = int(below[0])
        widths.append(2 * (n - 1 + (along[n - 1] - along[0] / 2) / (along[n - 1] - along[n])) * spectrum.pitch_px)
    return float(np.mean(widths))
