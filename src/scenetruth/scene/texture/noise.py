"""Noise, limited to a band of wavelengths."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from scenetruth.cache import key_of, remembered, source_hash
from scenetruth.errors import Problem, SceneError
from scenetruth.model import Positive
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.band_limited import band_limited_noise, holds_a_wave, noise_shape
from scenetruth.scene.texture.base import UV, Floats, Painted, Radiance, TextureModel

__all__ = ["NoiseTexture"]


class NoiseTexture(TextureModel):
    """Gaussian noise, strictly limited to a band of wavelengths."""

    kind: Literal["noise"]
    """``noise``."""
    wavelength_mm: tuple[Positive, Positive]
    """Shortest and longest wavelength on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    rms_contrast: Annotated[float, Field(ge=0, le=1 / 3)] = 0.25
    """Standard deviation of the radiance, divided by the mean; extremes are kept within [0, 1] inside the band."""
    spectrum_exponent: Annotated[float, Field(ge=-10, le=10, allow_inf_nan=False)] = 0.0
    """Power density inside the band is proportional to (spatial frequency) ** spectrum_exponent; 0 is white."""

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
        """Make the texture; see `TextureModel`."""
        low, size = mesh.chart_mm.min(axis=(0, 1)), _chart_size(mesh)

        def make() -> dict[str, NDArray[Any]]:
            with np.errstate(divide="ignore", invalid="ignore"):
                noise = band_limited_noise(
                    self.wavelength_mm, size, generator, exponent=self.spectrum_exponent, peak=self.peak
                )
            return {"coefficients": noise.coefficients, "period": np.array(noise.period)}

        found = remembered(self.cache_key(mesh, generator), make)
        if not np.isfinite(found["coefficients"][0, 0]):
            raise self._too_narrow()
        texture = _Noise(found["coefficients"], self.mean, self.mean * self.rms_contrast)
        return Painted(texture, (mesh.chart_mm - low) / found["period"])

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        size = _chart_size(mesh)
        if not holds_a_wave(self.wavelength_mm, size):
            raise self._too_narrow()
        return noise_shape(self.wavelength_mm, size)

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str:
        """Return the key of its raster; see `TextureModel`."""
        sources, state = source_hash(Path(__file__).parent), generator.bit_generator.state
        return key_of("noise", sources, self.wavelength_mm, _chart_size(mesh), self.spectrum_exponent, self.peak, state)

    def _too_narrow(self) -> SceneError:
        message = "is so narrow a band that no wave of it fits on the surface; make it wider"
        return SceneError([Problem("wavelength_mm", message, self.wavelength_mm)])

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return self.wavelength_mm

    @property
    def peak(self) -> float:
        """By how many standard deviations it may leave its mean without leaving [0, 1]."""
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
        from scenetruth.scene.texture.kernels import spline_lookup

        values: NDArray[np.float32] = spline_lookup(self.coefficients, np.ascontiguousarray(uv))
        values *= np.float32(self.std)
        values += np.float32(self.mean)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture.kernels import spline_means

        means: NDArray[np.float32] = spline_means(self.coefficients, forms, offsets, weights)
        means *= np.float32(self.std)
        means += np.float32(self.mean)
        return means

    def raster(self) -> NDArray[np.float32]:
        return np.float32(self.mean) + np.float32(self.std) * self.coefficients
