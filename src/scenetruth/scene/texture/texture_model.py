"""Base model of textures: radiance of a surface as a function of texture coordinates."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.scene.mesh import TriangleMesh
from scenetruth.validated_model import FrozenModel

__all__ = [
    "UV", "Floats", "Painted", "Radiance", "SurfaceTexture", "TextureModel", "TintedTexture", "tint_texture",
]  # fmt: skip

UV = NDArray[np.float64]
Floats = NDArray[np.float64]
Radiance = Annotated[float, Field(ge=0, le=1)]


class SurfaceTexture(Protocol):
    """Texture of a surface; coordinates (u, v) in tiles, u to the right and v down."""

    @property
    def tiled(self) -> bool:
        """Whether the raster repeats beyond [0, 1]; otherwise its border is extended."""
        ...

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        ...

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return the weighted mean radiance over the samples of footprints.

        ``forms``: Texture coordinates (u, v) = (U / W, V / W) of n footprints, shape (n, 3, 3): one row for each of U,
          V and W, with its value at the centre and its steps per px to the right and down.
        ``offsets``, ``weights``: Sample offsets from the centre in px, shape (m, 2); weights with sum 1, shape (m,).
        """
        ...

    @property
    def cubic(self) -> bool:
        """Whether the raster is interpolated as a cubic B-spline; otherwise bilinearly."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the raster."""
        ...

    def raster(self) -> NDArray[np.float32]:
        """Return a tile (h, w) of spline coefficients or values; texel (i, j) at ((j + 1/2) / w, (i + 1/2) / h)."""
        ...


@dataclass(frozen=True, eq=False)
class TintedTexture:
    """Texture times a factor, which shares its raster."""

    untinted: SurfaceTexture
    factor: float

    @property
    def tiled(self) -> bool:
        """Whether the raster repeats, see `SurfaceTexture`."""
        return self.untinted.tiled

    @property
    def cubic(self) -> bool:
        """Whether the raster is that of a spline, see `SurfaceTexture`."""
        return self.untinted.cubic

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the raster."""
        return self.untinted.shape

    @property
    def notes(self) -> tuple[str, ...]:
        """What was read from the files, for people."""
        return tuple(getattr(self.untinted, "notes", ()))

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        return self.untinted.radiance(uv) * np.float32(self.factor)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return weighted means over footprints, see `SurfaceTexture`."""
        return self.untinted.mean_radiance(forms, offsets, weights) * np.float32(self.factor)

    def raster(self) -> NDArray[np.float32]:
        """Return a tile of spline coefficients or values, see `SurfaceTexture`."""
        return self.untinted.raster() * np.float32(self.factor)


def tint_texture(texture: SurfaceTexture, factor: float) -> SurfaceTexture:
    """Return a texture times a factor, or the texture itself if the factor is 1."""
    return texture if factor == 1.0 else TintedTexture(texture, factor)


class Painted(NamedTuple):
    """Texture with the texture coordinates of a mesh."""

    texture: SurfaceTexture
    """The texture."""
    uv: UV
    """Texture coordinates at every face corner, shape (m, 3, 2)."""
    uv_back: UV | None = None
    """Texture coordinates for the back of faces if different, shape (m, 3, 2)."""


class TextureModel(FrozenModel):
    """Base class of textures."""

    kind: str
    """Type of the texture."""

    @abstractmethod
    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture and the texture coordinates of a mesh."""

    def in_band(self, band: str) -> TextureModel:
        """Return the texture of one band of the camera: the same for all by default."""
        return self

    @abstractmethod
    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the rows and columns of the raster without painting or decoding it."""

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str | None:
        """Return the key of the finished raster in the cache (`scenetruth.cache`), or None if it is not cached."""
        return None

    @property
    def repetitive(self) -> bool:
        """Whether the texture repeats itself over the surface, so that several matches look alike."""
        return False

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float] | None:
        """Shortest and longest wavelength on the surface in mm; None if not specified."""
        return None
