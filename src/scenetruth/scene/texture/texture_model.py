"""What all textures share: a model that gives the radiance of a surface at texture coordinates."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenetruth.scene.mesh import TriangleMesh
from scenetruth.validated_model import FrozenModel

__all__ = ["UV", "Floats", "Painted", "Radiance", "SurfaceTexture", "TextureModel"]

UV = NDArray[np.float64]
Floats = NDArray[np.float64]
Radiance = Annotated[float, Field(ge=0, le=1)]


class SurfaceTexture(Protocol):
    """What is painted on a surface; coordinates (u, v) count in tiles, u to the right and v down."""

    @property
    def tiled(self) -> bool:
        """Whether the raster repeats beyond [0, 1]; otherwise its border extends."""
        ...

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        ...

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return the weighted mean of the radiance over the samples of footprints.

        ``forms``: Texture coordinates (u, v) = (U / W, V / W) of n footprints, shape (n, 3, 3): one row for each of U,
          V and W, with its value in the middle and its steps per px to the right and down.
        ``offsets``: Where the samples are, in px from the middle, shape (m, 2).
        ``weights``: What each of them counts, shape (m,); they sum to 1.
        """
        ...

    @property
    def cubic(self) -> bool:
        """Whether the raster is to be read as a cubic B-spline; otherwise by bilinear interpolation."""
        ...

    def raster(self) -> NDArray[np.float32]:
        """Return one tile, shape (h, w), for other renderers: coefficients of the spline, or values to interpolate.

        Texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h).
        """
        ...


class Painted(NamedTuple):
    """A texture, and where the corners of a mesh's faces are on it."""

    texture: SurfaceTexture
    """The texture."""
    uv: UV
    """Texture coordinates at every corner of every face, shape (m, 3, 2)."""
    uv_back: UV | None = None
    """Those of the side that faces wind clockwise on, if it shows something else; shape (m, 3, 2)."""


class TextureModel(FrozenModel):
    """What all textures share."""

    kind: str
    """Name of the texture."""

    @abstractmethod
    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture, and the texture coordinates of a mesh."""

    @abstractmethod
    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the rows and columns of the raster that the texture will have; nothing is painted or decoded."""

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str | None:
        """Return under which key the finished raster is kept between runs (`scenetruth.cache`); None if it is not."""
        return None

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float] | None:
        """Shortest and longest wavelength on the surface in mm; None if it states none."""
        return None
