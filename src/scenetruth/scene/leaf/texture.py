"""What is seen on leaves, as a texture."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from scenetruth.scene.leaf.look import LeafLook
from scenetruth.scene.leaf.painting import paint_leaf, painting_key, painting_shape
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture import Painted

__all__ = ["LeafTexture"]


class LeafTexture(LeafLook):
    """What is seen on a leaf: veins of four orders, mottling between them, and hairs; two-sided."""

    kind: Literal["leaf"]
    """``leaf``."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        return Painted(*paint_leaf(self, mesh, generator))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        return painting_shape(self, mesh)

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str:
        """Return the key of its raster; see `TextureModel`."""
        return painting_key(self, mesh, generator)

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return self.mottling_wavelength_mm
