"""Images and colours that mesh files bring along."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.base import UV, Floats, Painted, TextureModel
from scenetruth.scene.texture.image import Picture, luminance

__all__ = ["OwnTexture"]

# A smooth ramp of 256 texels carries any radiance in [0, 1] as a texture coordinate.
_RAMP = 256


class OwnTexture(TextureModel):
    """The texture image or the vertex colours that a mesh file brings along."""

    kind: Literal["own"]
    """``own``."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Meaning of the grey values: proportional to radiance, or sRGB encoded."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        if mesh.image is not None and mesh.uv is not None:
            return Painted(Picture(luminance(mesh.image, self.encoding), mesh.tiled), mesh.uv)
        if mesh.vertex_colours is not None:
            values = luminance(mesh.vertex_colours[None], self.encoding)[0].astype(np.float64)
            u = (values * (_RAMP - 1) + 0.5) / _RAMP
            corners = u[mesh.faces]
            return Painted(_Ramp(), np.stack([corners, np.full_like(corners, 0.5)], axis=-1))
        raise self._nothing()

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return how large the raster will be; see `TextureModel`."""
        if mesh.image is not None and mesh.uv is not None:
            return mesh.image.shape[0], mesh.image.shape[1]
        if mesh.vertex_colours is None:
            raise self._nothing()
        return 2, _RAMP

    def _nothing(self) -> SceneError:
        return SceneError(
            [Problem("kind", "the mesh brings no texture image and no vertex colours; give it a texture", "own")]
        )


@dataclass(frozen=True)
class _Ramp:
    """Radiance carried by u itself, for colours that stand at the vertices."""

    tiled: bool = False
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        return ((uv[:, 0] * _RAMP - 0.5) / (_RAMP - 1)).astype(np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        lattice = np.column_stack([np.ones(len(offsets)), offsets])
        u = np.einsum("nm,m->n", (forms[:, 0] @ lattice.T) / (forms[:, 2] @ lattice.T), weights)
        return self.radiance(u[:, None])

    def raster(self) -> NDArray[np.float32]:
        return np.tile(np.linspace(0, 1, _RAMP, dtype=np.float32), (2, 1))
