"""Procedural textures: checkerboard, band-limited noise, plaid and uniform grey."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from scenetruth.cache import entry_key, load_or_compute, source_hash
from scenetruth.errors import Problem, SceneError
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.band_limited_noise import (
    compute_noise_shape,
    contains_wavelength,
    make_band_limited_noise,
)
from scenetruth.scene.texture.image_textures import Picture
from scenetruth.scene.texture.texture_model import UV, Floats, Painted, Radiance, TextureModel
from scenetruth.validated_model import Finite, NonNegative, Positive

__all__ = ["CheckerboardTexture", "NoiseTexture", "PlaidTexture", "UniformTexture"]


_TEXELS_PER_SQUARE = 256  # radiance changes between squares over one texel


class CheckerboardTexture(TextureModel):
    """Checkerboard of two radiances with a corner at the origin of the surface coordinates.

    Radiance changes linearly between squares over 1/256 of a square, identically in all renderers.
    """

    kind: Literal["checkerboard"]
    """``checkerboard``."""
    square_mm: Positive
    """Edge length of the squares on the surface in mm."""
    radiances: tuple[Radiance, Radiance] = (0.1, 0.9)
    """Radiance of the square at the lower right of the origin, and of its neighbours."""

    @property
    def repetitive(self) -> bool:
        """Return True: all periods look alike."""
        return True

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        one, other = self.radiances
        tile = np.array([[one, other], [other, one]], dtype=np.float32)
        values = np.kron(tile, np.ones((_TEXELS_PER_SQUARE, _TEXELS_PER_SQUARE), dtype=np.float32))
        return Painted(Picture(values, tiled=True), mesh.chart_mm / (2 * self.square_mm))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        return 2 * _TEXELS_PER_SQUARE, 2 * _TEXELS_PER_SQUARE

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Wavelength of the strongest components, along the diagonals; all others are shorter and weaker."""
        diagonal = float(np.sqrt(2)) * self.square_mm
        return diagonal, diagonal


class NoiseTexture(TextureModel):
    """Gaussian noise, strictly band-limited."""

    kind: Literal["noise"]
    """``noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    rms_contrast: Annotated[float, Field(ge=0, le=1 / 3)] = 0.25
    """Standard deviation of the radiance, divided by the mean; extremes are limited to [0, 1] within the band."""
    spectrum_exponent: Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Power density in the band is proportional to (spatial frequency) ** spectrum_exponent; 0 is white."""

    @model_validator(mode="after")
    def _displayable(self) -> NoiseTexture:
        if 3 * self.rms_contrast * self.mean > min(self.mean, 1 - self.mean):
            std = self.rms_contrast * self.mean
            msg = f"mean ± 3 rms_contrast mean must stay within [0, 1] (got {self.mean} ± 3 x {std:g})"
            raise ValueError(msg)
        return self

    @field_validator("wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        low, size = mesh.chart_mm.min(axis=(0, 1)), _chart_size(mesh)

        def make() -> dict[str, NDArray[Any]]:
            with np.errstate(divide="ignore", invalid="ignore"):
                noise = make_band_limited_noise(
                    self.wavelength_mm, size, generator, exponent=self.spectrum_exponent, peak=self.peak
                )
            return {"coefficients": noise.coefficients, "period": np.array(noise.period)}

        found = load_or_compute(self.cache_key(mesh, generator), make)
        if not np.isfinite(found["coefficients"][0, 0]):
            raise self._too_narrow()
        texture = _Noise(found["coefficients"], self.mean, self.mean * self.rms_contrast)
        return Painted(texture, (mesh.chart_mm - low) / found["period"])

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        size = _chart_size(mesh)
        if not contains_wavelength(self.wavelength_mm, size):
            raise self._too_narrow()
        return compute_noise_shape(self.wavelength_mm, size)

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str:
        """Return the cache key of the raster, see `TextureModel`."""
        sources, state = source_hash(Path(__file__).parent), generator.bit_generator.state
        return entry_key(
            "noise", sources, self.wavelength_mm, _chart_size(mesh), self.spectrum_exponent, self.peak, state
        )

    def _too_narrow(self) -> SceneError:
        message = "no wave of the band fits on the surface; widen the band"
        return SceneError([Problem("wavelength_mm", message, self.wavelength_mm)])

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return self.wavelength_mm

    @property
    def peak(self) -> float:
        """Maximum deviation from the mean within [0, 1], in standard deviations."""
        std = self.mean * self.rms_contrast
        return 4.0 if std == 0 else min(4.0, min(self.mean, 1 - self.mean) / std)


def _chart_size(mesh: TriangleMesh) -> tuple[float, float]:
    width, height = np.ptp(mesh.chart_mm, axis=(0, 1))
    return float(width), float(height)


@dataclass(frozen=True, eq=False)
class _Noise:
    """Noise about a mean."""

    coefficients: NDArray[np.float32]
    mean: float
    std: float
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        from scenetruth.scene.texture.texture_kernels import spline_lookup

        values: NDArray[np.float32] = spline_lookup(self.coefficients, np.ascontiguousarray(uv))
        values *= np.float32(self.std)
        values += np.float32(self.mean)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture.texture_kernels import spline_means

        means: NDArray[np.float32] = spline_means(self.coefficients, forms, offsets, weights)
        means *= np.float32(self.std)
        means += np.float32(self.mean)
        return means

    @property
    def shape(self) -> tuple[int, int]:
        return self.coefficients.shape[0], self.coefficients.shape[1]

    def raster(self) -> NDArray[np.float32]:
        return np.float32(self.mean) + np.float32(self.std) * self.coefficients


_PLAID_TEXELS = 64


class PlaidTexture(TextureModel):
    """Pattern of the paper (eq. 13): mean + amplitude cos(K_X X) cos(K_Y Y) in surface coordinates."""

    kind: Literal["plaid"]
    """``plaid``."""
    wavelength_mm: tuple[Positive, Positive]
    """Wavelengths 2π/K_X and 2π/K_Y on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    amplitude: NonNegative = 0.5
    """Amplitude of the pattern; 0.5 gives grey values in [-1, 1] as in the paper."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases in X and Y at the surface origin, in degrees."""

    @model_validator(mode="after")
    def _displayable(self) -> PlaidTexture:
        if self.mean - self.amplitude < 0 or self.mean + self.amplitude > 1:
            msg = f"mean ± amplitude must stay within [0, 1] (got {self.mean} ± {self.amplitude})"
            raise ValueError(msg)
        return self

    @property
    def repetitive(self) -> bool:
        """Return True: all periods look alike."""
        return True

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        phases = np.asarray(self.phase_deg) / 360.0
        return Painted(_Plaid(self.mean, self.amplitude), mesh.chart_mm / self.wavelength_mm + phases)

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        return _PLAID_TEXELS, _PLAID_TEXELS

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return min(self.wavelength_mm), max(self.wavelength_mm)


@dataclass(frozen=True)
class _Plaid:
    """Crossed cosine waves; one tile is one wavelength."""

    mean: float
    amplitude: float
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        waves = np.cos(2 * np.pi * uv[:, 0]) * np.cos(2 * np.pi * uv[:, 1])
        return (self.mean + self.amplitude * waves).astype(np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture.texture_kernels import plaid_means

        return np.asarray(self.mean + self.amplitude * plaid_means(forms, offsets, weights), dtype=np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        return _PLAID_TEXELS, _PLAID_TEXELS

    def raster(self) -> NDArray[np.float32]:
        centres = (np.arange(_PLAID_TEXELS) + 0.5) / _PLAID_TEXELS
        wave = np.cos(2 * np.pi * centres)
        # A cubic B-spline multiplies a sampled wave of angular frequency ω per texel by (2 + cos ω) / 3.
        response = (2 + np.cos(2 * np.pi / _PLAID_TEXELS)) / 3
        coefficients = self.mean + self.amplitude / response**2 * np.outer(wave, wave)
        return np.asarray(coefficients, dtype=np.float32)


class UniformTexture(TextureModel):
    """Uniform radiance."""

    kind: Literal["uniform"]
    """``uniform``."""
    radiance: Radiance = 0.5
    """The radiance."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        return Painted(_Uniform(self.radiance), np.zeros_like(mesh.chart_mm))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        return 2, 2


@dataclass(frozen=True)
class _Uniform:
    """Uniform radiance."""

    value: float
    tiled: bool = True
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        return np.full(len(uv), self.value, dtype=np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        return np.full(len(forms), self.value, dtype=np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        return 2, 2

    def raster(self) -> NDArray[np.float32]:
        return np.full((2, 2), self.value, dtype=np.float32)
