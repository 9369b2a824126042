"""Textures that differ between the bands of a camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, NoReturn

import numpy as np

from scenetruth.bands import ByBand, mapping_by_band
from scenetruth.discovery import discriminated_union
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture import TextureModel

__all__ = ["BandTextures"]

if TYPE_CHECKING:
    TexturesByBand = ByBand[TextureModel]
else:
    TexturesByBand = mapping_by_band(
        discriminated_union(TextureModel, "scenetruth.scene.texture", "scenetruth.scene.leaf")
    )


class BandTextures(TextureModel):
    """One texture for each band of the camera.

    Noise and leaf textures have the same pattern in all bands as far as their settings are the same.
    """

    kind: Literal["by_band"]
    """``by_band``."""
    textures: TexturesByBand
    """Textures by the names of the bands."""

    def in_band(self, band: str) -> TextureModel:
        """Return the texture of a band."""
        return self.textures[band].in_band(band)

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> NoReturn:
        """Raise an error, because only the textures of single bands are painted."""
        msg = "textures by band are painted band by band"
        raise TypeError(msg)

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return rows and columns of a raster with as many texels as those of all bands together."""
        shapes = [texture.raster_shape(mesh, folder) for texture in self.textures.values()]
        return sum(rows * columns for rows, columns in shapes), 1

    @property
    def repetitive(self) -> bool:
        """Whether the textures of all bands repeat themselves."""
        return all(texture.repetitive for texture in self.textures.values())

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float] | None:
        """Shortest and longest wavelength in any band in mm; None if one of them is not specified."""
        every = [texture.shortest_and_longest_mm for texture in self.textures.values()]
        known = [each for each in every if each is not None]
        if len(known) < len(every):
            return None
        return min(each[0] for each in known), max(each[1] for each in known)
