"""Power spectra of surface textures: analytic where a formula exists, otherwise measured from a painted texture."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.discovery import classes_in
from scenetruth.random_streams import generator_for
from scenetruth.scene.leaf.leaf_model import LeafAppearance
from scenetruth.scene.scene_object import SceneObject
from scenetruth.scene.texture.procedural_textures import CheckerboardTexture, NoiseTexture, PlaidTexture, UniformTexture

__all__ = [
    "CheckerboardSpectrum",
    "LeafSpectrum",
    "NoiseSpectrum",
    "PlaidSpectrum",
    "SpectralComponents",
    "TextureSpectrum",
    "UniformSpectrum",
    "analytic_spectra",
    "compute_ring_spectrum",
    "measure_spectrum",
]


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SpectralComponents:
    """Waves of random phase on a surface: frequencies (n, 2), variances of the radiance (n,), and mean radiance."""

    frequencies_per_mm: Array
    variances: Array
    mean: float

    @property
    def contrast(self) -> float:
        """Standard deviation of the radiance."""
        return float(np.sqrt(self.variances.sum()))

    def joined(self, other: Self) -> SpectralComponents:
        """Return the sum with another, independent texture."""
        frequencies = np.concatenate([self.frequencies_per_mm, other.frequencies_per_mm])
        return SpectralComponents(frequencies, np.concatenate([self.variances, other.variances]), self.mean)


class TextureSpectrum(ABC):
    """Spectrum of a texture type; subclasses in this module are discovered automatically."""

    kind: ClassVar[str]
    """Name of the texture type."""
    exact: ClassVar[bool] = True
    """Whether the components describe the texture completely."""

    @abstractmethod
    def waves(self, texture: Any) -> SpectralComponents:
        """Return the spectral components of a texture."""


def compute_ring_spectrum(
    wavelength_mm: tuple[float, float],
    exponent: float,
    variance: float,
    mean: float,
    *,
    radii: int = 8,
    angles: int = 8,
) -> SpectralComponents:
    """Return the spectrum of band-limited isotropic noise."""
    nodes, shares = np.polynomial.legendre.leggauss(radii)
    octaves = np.log(wavelength_mm[1] / wavelength_mm[0])
    share_of_highest = np.exp(0.5 * octaves * (nodes - 1.0))
    frequency = share_of_highest / wavelength_mm[0]
    # The area of a ring of frequencies f is proportional to f, and nodes are evenly spaced in log f.
    shares = shares * share_of_highest ** (exponent + 2)
    turn = np.pi * (np.arange(angles) + 0.5) / angles
    grid = frequency[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    variances = np.repeat(variance * shares / (shares.sum() * angles), angles)
    return SpectralComponents(grid.reshape(-1, 2), variances, mean)


@cache
def analytic_spectra() -> dict[str, TextureSpectrum]:
    """Return the analytic spectra by texture type."""
    return {cls.kind: cls() for cls in classes_in(TextureSpectrum, __name__)}


_HIGHEST = 31  # highest harmonic of a square wave that pixels resolve for the largest squares


class CheckerboardSpectrum(TextureSpectrum):
    """Product of two square waves, each 4/π Σ sin(k x) / k over odd k."""

    kind: ClassVar[str] = "checkerboard"

    def waves(self, texture: CheckerboardTexture) -> SpectralComponents:
        """Return the spectral components; see `TextureSpectrum`."""
        one, other = texture.radiances
        odd = np.arange(1, _HIGHEST + 1, 2)
        k, m = (each.ravel() for each in np.meshgrid(odd, odd))
        frequency = np.stack([k, m], axis=-1) / (2 * texture.square_mm)
        # sin a sin b is half the difference of two cosines.
        variance = 0.5 * (8 * 0.5 * (one - other) / (np.pi**2 * k * m)) ** 2
        return SpectralComponents(
            np.concatenate([frequency, frequency * [1, -1]]), np.concatenate([variance] * 2), 0.5 * (one + other)
        )


_WIDTH = 2.354820045  # full width at half maximum of a Gaussian, in standard deviations
_DOT_BAND = 3.0  # highest frequency of a dot, in widths of its spectrum
_LEAF_RADII, _LEAF_ANGLES = 10, 8


class LeafSpectrum(TextureSpectrum):
    """Mottling with a power density f ** -2.5, and hairs at random positions.

    Veins have no formula and are not included: the result is a lower limit of the contrast.
    """

    kind: ClassVar[str] = "leaf"
    exact: ClassVar[bool] = False

    def waves(self, texture: LeafAppearance) -> SpectralComponents:
        """Return the spectral components; see `TextureSpectrum`."""
        values = texture.settings
        mean, contrast = values["mean"], values["mottling_contrast"]
        mottling = compute_ring_spectrum(texture.mottling_wavelength_mm, -2.5, (mean * contrast) ** 2, mean)
        sigma = texture.speckle_size_mm / _WIDTH
        # Campbell's theorem: dots exp(-r² / 2σ²) at random positions have the variance density x ∫ dot².
        variance = texture.speckle_density_per_mm2 * np.pi * sigma**2 * (mean * values["speckle_contrast"]) ** 2
        if variance == 0:
            return mottling
        frequency = _DOT_BAND / (2 * np.pi * sigma) * (np.arange(_LEAF_RADII) + 0.5) / _LEAF_RADII
        shares = frequency * np.exp(-((2 * np.pi * sigma * frequency) ** 2))
        turn = np.pi * (np.arange(_LEAF_ANGLES) + 0.5) / _LEAF_ANGLES
        grid = frequency[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        each = np.repeat(variance * shares / (shares.sum() * _LEAF_ANGLES), _LEAF_ANGLES)
        return mottling.joined(SpectralComponents(grid.reshape(-1, 2), each, mean))


_MOST_TEXELS = 1024  # largest side of the measured part, at the centre of the raster
_MEASURED_RADII, _MEASURED_ANGLES = 24, 8
# Largest residual of an affine chart, relative to the edge lengths; otherwise the texture is not flat on the surface.
_MOST_BENT = 0.1


def measure_spectrum(item: SceneObject, seed: int, folder: Path) -> SpectralComponents:
    """Paint the texture of an object and measure its spectrum."""
    return _measured(_Key(item, seed, folder))


class _Key:
    """Cache key: the properties of an object that determine its texture."""

    def __init__(self, item: SceneObject, seed: int, folder: Path) -> None:
        self.item, self.seed, self.folder = item, seed, folder
        parts = [item.mesh.model_dump(mode="json"), item.texture.model_dump(mode="json")]
        self._text = json.dumps([*parts, item.name, seed, str(folder)])

    def __hash__(self) -> int:
        return hash(self._text)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._text == other._text


@lru_cache(maxsize=256)
def _measured(key: _Key) -> SpectralComponents:
    mesh = key.item.mesh.make(key.folder)
    painted = key.item.texture.paint(mesh, key.folder, generator_for(key.seed, "texture", key.item.name))
    raster = np.asarray(painted.texture.raster(), dtype=np.float64)
    rows, columns = raster.shape
    per_mm = _tiles_per_mm(mesh.chart_mm, painted.uv)
    part = raster[_middle(painted.uv[..., 1], rows), _middle(painted.uv[..., 0], columns)]
    mean = float(part.mean())
    window = np.outer(np.hanning(part.shape[0] + 2)[1:-1], np.hanning(part.shape[1] + 2)[1:-1])
    power = np.abs(np.fft.rfft2((part - mean) * window)) ** 2
    power[:, 1:] *= 2.0  # each column but the first and the last represents two waves
    power /= window.size * np.square(window).sum()
    across = np.fft.rfftfreq(part.shape[1]) * columns
    down = np.fft.fftfreq(part.shape[0]) * rows
    if painted.texture.cubic:
        # Values of a cubic B-spline are smoother than its coefficients.
        power *= np.square(np.outer(_spline(down / rows), _spline(across / columns)))
    f_u, f_v = np.meshgrid(across, down)
    return _binned(np.stack([f_u.ravel(), f_v.ravel()], axis=-1) @ per_mm, power.ravel(), mean)


def _middle(places: Array, texels: int) -> slice:
    """Return the central part of the texels used along one side; the other side may use another part."""
    low, high = (float(np.clip(end, 0.0, 1.0)) * texels for end in (places.min(), places.max()))
    first, count = round(low), max(round(high) - round(low), 1)
    if np.ptp(places) > 1.0:
        first, count = 0, texels
    first += max(count - _MOST_TEXELS, 0) // 2
    return slice(first, first + min(count, _MOST_TEXELS))


def _spline(frequency: Array) -> Array:
    return (2.0 + np.cos(2 * np.pi * frequency)) / 3.0


def _tiles_per_mm(chart_mm: Array, uv: Array) -> Array:
    """Return the matrix from steps on the surface in mm to steps in texture tiles."""
    steps, tiles = (np.diff(each, axis=1).reshape(-1, 2) for each in (chart_mm, uv))
    matrix = np.linalg.lstsq(steps, tiles, rcond=None)[0].T
    if np.square(tiles - steps @ matrix.T).sum() > _MOST_BENT**2 * np.square(tiles).sum():
        area, flat = (np.abs(np.linalg.det(each.reshape(-1, 2, 2))).sum() for each in (tiles, steps))
        matrix = np.sqrt(area / flat) * np.eye(2)
    return np.asarray(matrix)


def _binned(frequencies: Array, power: Array, mean: float) -> SpectralComponents:
    """Return spectral components binned by frequency and direction."""
    frequencies = frequencies * np.where(frequencies[:, 1] < 0, -1.0, 1.0)[:, None]
    size = np.hypot(*frequencies.T)
    kept = size > 0
    frequencies, power, size = frequencies[kept], power[kept], size[kept]
    least, most = size.min(), size.max() * (1 + 1e-9)
    ring = (_MEASURED_RADII * np.log(size / least) / np.log(most / least)).astype(np.int64)
    turn = np.minimum(
        (_MEASURED_ANGLES * np.arctan2(frequencies[:, 1], frequencies[:, 0]) / np.pi).astype(np.int64),
        _MEASURED_ANGLES - 1,
    )
    place = ring * _MEASURED_ANGLES + turn
    total, xx, xy, yy = (
        np.bincount(place, power * each, _MEASURED_RADII * _MEASURED_ANGLES)
        for each in (1.0, frequencies[:, 0] ** 2, frequencies[:, 0] * frequencies[:, 1], frequencies[:, 1] ** 2)
    )
    used = total > 0
    # The strongest direction of the gradients in a bin: a texture of one direction between two bins keeps it.
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)[used]
    length = np.sqrt((xx + yy)[used] / total[used])
    grid = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return SpectralComponents(grid, np.asarray(total[used], dtype=np.float64), mean)


class NoiseSpectrum(TextureSpectrum):
    """Isotropic noise of a given power density in a band."""

    kind: ClassVar[str] = "noise"

    def waves(self, texture: NoiseTexture) -> SpectralComponents:
        """Return the spectral components; see `TextureSpectrum`."""
        variance = (texture.mean * texture.rms_contrast) ** 2
        return compute_ring_spectrum(texture.wavelength_mm, texture.spectrum_exponent, variance, texture.mean)


class PlaidSpectrum(TextureSpectrum):
    """Product of two waves, the mean of two others: cos a cos b = (cos(a + b) + cos(a - b)) / 2."""

    kind: ClassVar[str] = "plaid"

    def waves(self, texture: PlaidTexture) -> SpectralComponents:
        """Return the spectral components; see `TextureSpectrum`."""
        across, down = 1.0 / texture.wavelength_mm[0], 1.0 / texture.wavelength_mm[1]
        return SpectralComponents(
            np.array([[across, down], [across, -down]]), np.full(2, texture.amplitude**2 / 8), texture.mean
        )


class UniformSpectrum(TextureSpectrum):
    """No spectral components: no texture contrast."""

    kind: ClassVar[str] = "uniform"

    def waves(self, texture: UniformTexture) -> SpectralComponents:
        """Return the spectral components; see `TextureSpectrum`."""
        return SpectralComponents(np.zeros((0, 2)), np.zeros(0), texture.radiance)
