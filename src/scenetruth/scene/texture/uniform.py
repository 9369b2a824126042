"""One radiance everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.base import UV, Floats, Painted, Radiance, TextureModel

__all__ = ["UniformTexture"]


class UniformTexture(TextureModel):
    """One radiance everywhere."""

    kind: Literal["uniform"]
    """``uniform``."""
    radiance: Radiance = 0.5
    """The radiance."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        return Painted(_Uniform(self.radiance), np.zeros_like(mesh.chart_mm))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        return 2, 2


@dataclass(frozen=True)
class _Uniform:
    """One radiance."""

    value: float
    tiled: bool = True
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        return np.full(len(uv), self.value, dtype=np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        return np.full(len(forms), self.value, dtype=np.float32)

    def raster(self) -> NDArray[np.float32]:
        return np.full((2, 2), self.value, dtype=np.float32)
