"""The paper's pattern."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from scenetruth.model import Finite, NonNegative, Positive
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.base import UV, Floats, Painted, Radiance, TextureModel

__all__ = ["PlaidTexture"]

_PLAID_TEXELS = 64


class PlaidTexture(TextureModel):
    """The paper's pattern (eq. 13): mean + amplitude cos(K_X X) cos(K_Y Y) in surface coordinates."""

    kind: Literal["plaid"]
    """``plaid``."""
    wavelength_mm: tuple[Positive, Positive]
    """Wavelengths 2π/K_X and 2π/K_Y on the surface in mm."""
    mean: Radiance = 0.5
    """Mean radiance."""
    amplitude: NonNegative = 0.5
    """Amplitude of the pattern; 0.5 gives grey values in [-1, 1] as in the paper."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases in X and Y at the surface's origin, in degrees."""

    @model_validator(mode="after")
    def _displayable(self) -> PlaidTexture:
        if self.mean - self.amplitude < 0 or self.mean + self.amplitude > 1:
            msg = f"mean ± amplitude must stay within [0, 1] (got {self.mean} ± {self.amplitude})"
            raise ValueError(msg)
        return self

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        phases = np.asarray(self.phase_deg) / 360.0
        return Painted(_Plaid(self.mean, self.amplitude), mesh.chart_mm / self.wavelength_mm + phases)

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        return _PLAID_TEXELS, _PLAID_TEXELS

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return min(self.wavelength_mm), max(self.wavelength_mm)


@dataclass(frozen=True)
class _Plaid:
    """Crossed waves; one tile is one wavelength."""

    mean: float
    amplitude: float
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        waves = np.cos(2 * np.pi * uv[:, 0]) * np.cos(2 * np.pi * uv[:, 1])
        return (self.mean + self.amplitude * waves).astype(np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture.kernels import plaid_means

        return np.asarray(self.mean + self.amplitude * plaid_means(forms, offsets, weights), dtype=np.float32)

    def raster(self) -> NDArray[np.float32]:
        centres = (np.arange(_PLAID_TEXELS) + 0.5) / _PLAID_TEXELS
        wave = np.cos(2 * np.pi * centres)
        # A cubic B-spline takes a sampled wave of angular frequency ω per texel times (2 + cos ω) / 3.
        response = (2 + np.cos(2 * np.pi / _PLAID_TEXELS)) / 3
        coefficients = self.mean + self.amplitude / response**2 * np.outer(wave, wave)
        return np.asarray(coefficients, dtype=np.float32)
