"""Checkerboards."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from scenetruth.model import Positive
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.base import Painted, Radiance, TextureModel
from scenetruth.scene.texture.image import Picture

__all__ = ["CheckerboardTexture"]

# Radiance rises from square to square over one texel.
_TEXELS_PER_SQUARE = 256


class CheckerboardTexture(TextureModel):
    """Squares of two radiances by turns; four of them meet at the origin of the surface coordinates.

    From one square to the next the radiance changes linearly over 1/256 of a square, for all renderers alike.
    """

    kind: Literal["checkerboard"]
    """``checkerboard``."""
    square_mm: Positive
    """Edge length of the squares on the surface in mm."""
    radiances: tuple[Radiance, Radiance] = (0.1, 0.9)
    """Radiance of the square to the right of the origin and below it, and of its neighbours."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        one, other = self.radiances
        tile = np.array([[one, other], [other, one]], dtype=np.float32)
        values = np.kron(tile, np.ones((_TEXELS_PER_SQUARE, _TEXELS_PER_SQUARE), dtype=np.float32))
        return Painted(Picture(values, tiled=True), mesh.chart_mm / (2 * self.square_mm))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        return 2 * _TEXELS_PER_SQUARE, 2 * _TEXELS_PER_SQUARE

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Wavelength of its strongest waves, which run along the diagonals; the others are shorter and weaker."""
        diagonal = float(np.sqrt(2)) * self.square_mm
        return diagonal, diagonal
