"""Image files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.files import InputFile
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture.base import UV, Floats, Painted, TextureModel

__all__ = ["ImageTexture", "Picture", "luminance"]


class ImageTexture(TextureModel):
    """An image file, laid on the surface by the mesh's UV coordinates."""

    kind: Literal["image"]
    """``image``."""
    file: InputFile
    """Path of the image; relative paths count from the scene file. Colours become luminance."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Meaning of the grey values: proportional to radiance, or sRGB encoded."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Make the texture; see `TextureModel`."""
        if mesh.uv is None:
            remedy = "the mesh has no UV coordinates to lay an image on; use a noise, plaid or uniform texture"
            raise SceneError([Problem("kind", remedy, self.kind)])
        values = luminance(_read_image(folder / self.file), self.encoding)
        return Painted(Picture(values, mesh.tiled), mesh.uv, mesh.uv_back)


@dataclass(frozen=True, eq=False)
class Picture:
    """An image of radiances, interpolated bilinearly."""

    values: NDArray[np.float32]
    tiled: bool
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        from scenetruth.scene.texture.kernels import linear_lookup

        values: NDArray[np.float32] = linear_lookup(self.values, np.ascontiguousarray(uv), self.tiled)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return weighted means over footprints; see `SurfaceTexture`."""
        from scenetruth.scene.texture.kernels import linear_means

        means: NDArray[np.float32] = linear_means(self.values, forms, offsets, weights, self.tiled)
        return means

    def raster(self) -> NDArray[np.float32]:
        """Return the image."""
        return self.values


def _read_image(file: Path) -> NDArray[Any]:
    import imageio.v3 as imageio

    if not file.is_file():
        raise SceneError([Problem("file", "no such image file", str(file))])
    try:
        # From memory: imageio leaves files open that none of its plugins can read.
        return np.asarray(imageio.imread(file.read_bytes(), extension=file.suffix))
    except Exception as error:  # the readers of imageio's plugins raise whatever they like
        raise SceneError([Problem("file", f"cannot be read as an image: {error}", str(file))]) from error


def luminance(image: NDArray[Any], encoding: str) -> NDArray[np.float32]:
    """Return the luminance (Rec. 709 primaries) of an image in [0, 1], linear in radiance."""
    values = image.astype(np.float64)
    if np.issubdtype(image.dtype, np.integer):
        values /= np.iinfo(image.dtype).max
    elif image.dtype == np.bool_:
        encoding = "linear"
    if encoding == "srgb":
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    if values.ndim == 3 and values.shape[2] >= 3:
        values = values[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    elif values.ndim == 3:
        values = values[..., 0]
    return np.clip(values, 0, 1).astype(np.float32)
