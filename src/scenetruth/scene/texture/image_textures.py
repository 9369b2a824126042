"""Image textures: image files, and images or colours embedded in mesh files."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import PrivateAttr

from scenetruth.errors import Problem, SceneError
from scenetruth.input_files import InputFile
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.mesh.appearance import MeshAppearance
from scenetruth.scene.mesh.file_preflight import MAX_FILE_BYTES, check_file_size
from scenetruth.scene.mesh.polygon_mesh import MeshFileError
from scenetruth.scene.picture_file import DecodedPicture, PictureFileError, as_picture, decode_picture
from scenetruth.scene.texture.texture_model import UV, Floats, Painted, TextureModel

__all__ = ["MAX_PIXELS", "EmbeddedTexture", "ImageTexture", "Picture", "compute_luminance", "read_image_header"]


MAX_PIXELS = 170_000_000
"""Maximum size of an image that is read, 13,000 x 13,000; resource limits of scenes apply far below."""

_PART_OF_TEXELS = 1_000_000
_ONE_PICTURE = "must be a single grey or colour image"


class _ColourTexture(TextureModel):
    """Base class of textures with colours of files, which are red, green and blue, or grey."""

    _band: str | None = PrivateAttr(None)

    def in_band(self, band: str) -> Self:
        """Return the texture of one band of the camera, see `TextureModel`."""
        found = self.model_copy()
        found._band = band
        return found


class ImageTexture(_ColourTexture):
    """Image file mapped by the UV coordinates of the mesh."""

    kind: Literal["image"]
    """``image``."""
    file: InputFile
    """Path of the image; relative paths refer to the directory of the scene file. Grey cameras see the luminance of
    colours; the bands ``red``, ``green`` and ``blue`` see their components.
    """
    encoding: Literal["linear", "srgb"] = "linear"
    """Encoding of the grey values: proportional to radiance, or sRGB. Without it, they are proportional to radiance,
    and a file that says it is sRGB is refused."""

    @property
    def stated_encoding(self) -> str | None:
        """The encoding if it is stated, else None."""
        return self.encoding if "encoding" in self.model_fields_set else None

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        self._lay_on(mesh)
        assert mesh.uv is not None
        decoded = self._decode(folder)
        try:
            values = decoded.radiances(self.stated_encoding, band=self._band)
        except PictureFileError as error:
            raise SceneError([Problem("file", str(error), str(folder / self.file))]) from error
        note = f"{Path(self.file).name}: {decoded.describe()}"
        return Painted(Picture(values, mesh.tiled, notes=(note,)), mesh.uv, mesh.uv_back)

    def _decode(self, folder: Path) -> DecodedPicture:
        file = folder / self.file
        read_image_header(file)
        try:
            return decode_picture(file.read_bytes(), most_pixels=MAX_PIXELS)
        except (OSError, PictureFileError) as error:
            raise SceneError([Problem("file", str(error), str(file))]) from error

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
    notes: tuple[str, ...] = ()
    """What was read from the files, for people."""

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

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the raster."""
        return self.values.shape[0], self.values.shape[1]

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
    from PIL import UnidentifiedImageError

    text = " ".join(str(error).split())[:200] or type(error).__name__
    if isinstance(error, UnidentifiedImageError):
        text = "its format is not recognised; save it as PNG, TIFF or JPEG"
    return SceneError([Problem("file", f"cannot be read as an image: {text}", str(file))])


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
    return np.clip(as_picture(image).radiances(encoding), 0, 1)


_RAMP = 256  # a linear ramp of 256 texels represents any radiance in [0, 1] as a texture coordinate


class EmbeddedTexture(_ColourTexture):
    """Materials, texture images or colours of a mesh file."""

    kind: Literal["embedded"]
    """``embedded``."""
    encoding: Literal["linear", "srgb"] = "linear"
    """Encoding of images and of colours: proportional to radiance, or sRGB. Without it, glTF is read as it defines
    (images sRGB, colours linear), and other formats are linear, unless an image says that it is sRGB, which is refused.
    """

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        appearance = self._appearance(mesh)
        stated = self.encoding if "encoding" in self.model_fields_set else None
        try:
            if appearance.has_pictures:
                laid = appearance.lay(stated)
                return Painted(Picture(laid.values, laid.tiled, notes=tuple(appearance.describe())), laid.uv)
            u = (appearance.radiances(stated) * (_RAMP - 1) + 0.5) / _RAMP
        except MeshFileError as error:
            raise SceneError([Problem("kind", str(error), "embedded")]) from error
        return Painted(_Ramp(), np.stack([u, np.full_like(u, 0.5)], axis=-1))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        try:
            return self._appearance(mesh).shape()
        except MeshFileError as error:
            raise SceneError([Problem("kind", str(error), "embedded")]) from error

    def _appearance(self, mesh: TriangleMesh) -> MeshAppearance:
        if mesh.appearance is None:
            raise self._nothing()
        return replace(mesh.appearance, band=self._band)

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

    @property
    def shape(self) -> tuple[int, int]:
        return 2, _RAMP

    def raster(self) -> NDArray[np.float32]:
        return np.tile(np.linspace(0, 1, _RAMP, dtype=np.float32), (2, 1))
