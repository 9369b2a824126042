"""Image textures: image files, and images or colours embedded in mesh files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import InputFile
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.file_preflight import MAX_FILE_BYTES, check_file_size
from scenetruth.scene.texture.texture_model import UV, Floats, Painted, TextureModel

__all__ = ["MAX_PIXELS", "EmbeddedTexture", "ImageTexture", "Picture", "compute_luminance", "read_image_header"]


MAX_PIXELS = 170_000_000
"""Maximum size of an image that is read, 13,000 x 13,000; resource limits of scenes apply far below."""

_PART_OF_TEXELS = 1_000_000
_ONE_PICTURE = "must be a single grey or colour image"


class ImageTexture(TextureModel):
    """Image file mapped by the UV coordinates of the mesh."""

    kind: Literal["image"]
    """``image``."""
    file: InputFile
    """Path of the image; relative paths refer to the directory of the scene file. Colours are converted to luminance.
    """
    encoding: Literal["linear", "srgb"] = "linear"
    """Encoding of the grey values: proportional to radiance, or sRGB."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        self._lay_on(mesh)
        assert mesh.uv is not None
        values = compute_luminance(_read_image(folder / self.file), self.encoding)
        return Painted(Picture(values, mesh.tiled), mesh.uv, mesh.uv_back)

    def _lay_on(self, mesh: TriangleMesh) -> None:
        if mesh.uv is None:
            remedy = "the mesh has no UV coordinates for an image; use a noise, plaid or uniform texture"
            raise SceneError([Problem("kind", remedy, self.kind)])

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the image size from its header, see `TextureModel`."""
        self._lay_on(mesh)
        width, height, _ = read_image_header(folder / self.file)
        return height, width


@dataclass(frozen=True, eq=False)
class Picture:
    """Image of radiances with bilinear interpolation."""

    values: NDArray[np.float32]
    tiled: bool
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        from scenetruth.scene.texture.texture_kernels import linear_lookup

        values: NDArray[np.float32] = linear_lookup(self.values, np.ascontiguousarray(uv), self.tiled)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return weighted means over footprints, see `SurfaceTexture`."""
        from scenetruth.scene.texture.texture_kernels import linear_means

        means: NDArray[np.float32] = linear_means(self.values, forms, offsets, weights, self.tiled)
        return means

    def raster(self) -> NDArray[np.float32]:
        """Return the image."""
        return self.values


def read_image_header(file: Path) -> tuple[int, int, int]:
    """Return width, height and number of pages of an image file without decoding it."""
    check_file_size(file, MAX_FILE_BYTES, "no such image file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            width, height, pages = _size_in_header(file)
    except Exception as error:  # image readers raise various exceptions
        raise _unreadable(file, error) from error
    if width * height > MAX_PIXELS:
        message = f"has {width} x {height} pixels, more than {MAX_PIXELS:,}; reduce it"
        raise SceneError([Problem("file", message, str(file))])
    if pages != 1:
        raise SceneError([Problem("file", _ONE_PICTURE, f"{pages} pages")])
    return width, height, pages


def _unreadable(file: Path, error: Exception) -> SceneError:
    text = " ".join(str(error).split())[:200] or type(error).__name__
    return SceneError([Problem("file", f"cannot be read as an image: {text}", str(file))])


def _read_image(file: Path) -> NDArray[Any]:
    import imageio.v3 as imageio

    _, height, _ = read_image_header(file)
    try:
        # From memory, because imageio leaves unreadable files open.
        content = file.read_bytes()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = np.asarray(imageio.imread(content, extension=file.suffix))
        # Multi-page formats have an additional dimension.
        image = image[0] if image.shape[:2] == (1, height) and height > 1 else image
    except Exception as error:  # imageio plugins raise various exceptions
        raise _unreadable(file, error) from error
    if image.ndim not in (2, 3) or 0 in image.shape or (image.ndim == 3 and image.shape[2] > 4):
        raise SceneError([Problem("file", _ONE_PICTURE, f"shape {image.shape}")])
    if image.dtype.kind not in "uifb":
        raise SceneError([Problem("file", "must hold real numbers", str(image.dtype))])
    if not np.isfinite(image).all():
        raise SceneError([Problem("file", "holds values that are not finite", str(file))])
    return image


def _size_in_header(file: Path) -> tuple[int, int, int]:
    """Return width, height and number of pages of an image file."""
    with file.open("rb") as content:
        head = content.read(4)
        content.seek(0)
        if head in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            import tifffile

            with tifffile.TiffFile(content) as pages:
                first = pages.pages[0]
                return int(first.imagewidth), int(first.imagelength), len(pages.pages)
        from PIL import Image

        with Image.open(content) as picture:
            return picture.width, picture.height, getattr(picture, "n_frames", 1)


def compute_luminance(image: NDArray[Any], encoding: str) -> NDArray[np.float32]:
    """Return the luminance (Rec. 709 primaries) of an image in [0, 1], linear in radiance."""
    out = np.empty(image.shape[:2], dtype=np.float32)
    # In blocks, to limit the memory of float64 intermediates.
    rows = max(_PART_OF_TEXELS // max(image.shape[1], 1), 1)
    for first in range(0, len(image), rows):
        out[first : first + rows] = _luminance_of_rows(image[first : first + rows], encoding)
    return out


def _luminance_of_rows(image: NDArray[Any], encoding: str) -> NDArray[np.float32]:
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


_RAMP = 256  # a linear ramp of 256 texels represents any radiance in [0, 1] as a texture coordinate


class EmbeddedTexture(TextureModel):
    """Texture image or vertex colours embedded in a mesh file."""

    kind: Literal["embedded"]
    """``own``."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Encoding of the grey values: proportional to radiance, or sRGB."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        if mesh.image is not None and mesh.uv is not None:
            return Painted(Picture(compute_luminance(mesh.image, self.encoding), mesh.tiled), mesh.uv)
        if mesh.vertex_colours is not None:
            values = compute_luminance(mesh.vertex_colours[None], self.encoding)[0].astype(np.float64)
            u = (values * (_RAMP - 1) + 0.5) / _RAMP
            corners = u[mesh.faces]
            return Painted(_Ramp(), np.stack([corners, np.full_like(corners, 0.5)], axis=-1))
        raise self._nothing()

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        if mesh.image is not None and mesh.uv is not None:
            return mesh.image.shape[0], mesh.image.shape[1]
        if mesh.vertex_colours is None:
            raise self._nothing()
        return 2, _RAMP

    def _nothing(self) -> SceneError:
        return SceneError(
            [Problem("kind", "the mesh has no texture image and no vertex colours; specify a texture", "embedded")]
        )


@dataclass(frozen=True)
class _Ramp:
    """Texture whose radiance equals u, for vertex colours."""

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
