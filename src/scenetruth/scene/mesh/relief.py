"""Waves over a rectangle."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Finite, Positive
from scenetruth.scene.jets import Field
from scenetruth.scene.mesh.base import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.resolution import sheet_resolution
from scenetruth.scene.mesh.sheet import sheet, sheet_size
from scenetruth.scene.motion import Points

__all__ = ["ReliefMesh", "relief"]

# A wave of which less is sampled is no wave any more.
_PIECES_PER_WAVE = 4


class ReliefMesh(MeshModel):
    """Waves Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y) over a rectangle: a sheet, upper side -Z."""

    kind: Literal["relief"]
    """``relief``."""
    size_mm: tuple[Positive, Positive]
    """Lengths of the rectangle along X and Y in mm."""
    amplitude_mm: Finite
    """Height of the crests above the middle plane in mm, towards the camera."""
    wavelength_mm: tuple[Positive | None, Positive | None]
    """Wavelengths λ_X and λ_Y in mm; null for a relief that does not change in this direction."""
    phase_deg: tuple[Finite, Finite] = (0.0, 0.0)
    """Phases φ_X and φ_Y at the origin in degrees."""
    resolution_mm: Positive = 0.5
    """Longest edge of the flat sheet's triangles along X and Y in mm; at most a quarter of a wavelength."""

    @field_validator("resolution_mm")
    @classmethod
    def _reasonable(cls, value: float, info: ValidationInfo) -> float:
        waves = [length for length in info.data.get("wavelength_mm", ()) if length is not None]
        if waves and value > min(waves) / _PIECES_PER_WAVE:
            msg = f"must be at most a quarter of wavelength_mm, {min(waves) / _PIECES_PER_WAVE:g} mm"
            raise ValueError(msg)
        return sheet_resolution(value, info)

    def size(self, folder: Path) -> MeshSize:
        """Return how large the mesh will be; see `MeshModel`."""
        return sheet_size(self.size_mm, self.resolution_mm)

    def triangles(self, folder: Path) -> TriangleMesh:
        """Return the mesh; see `MeshModel`."""
        return relief(self.size_mm, self.amplitude_mm, self.wavelength_mm, self.phase_deg, self.resolution_mm)


def relief(
    size_mm: tuple[float, float],
    amplitude_mm: float,
    wavelength_mm: tuple[float | None, float | None],
    phase_deg: tuple[float, float],
    resolution_mm: float,
) -> TriangleMesh:
    """Return the waves Z = -amplitude cos(2 π X / λ_X + φ_X) cos(2 π Y / λ_Y + φ_Y); λ of None means a constant."""
    rates = [0.0 if length is None else 2 * np.pi / length for length in wavelength_mm]
    phases = np.deg2rad(phase_deg)

    def shape(points: Points, t: Field) -> Points:
        x, y, z = points
        return x, y, z - amplitude_mm * np.cos(rates[0] * x + phases[0]) * np.cos(rates[1] * y + phases[1])

    return sheet(size_mm, resolution_mm, shape)
