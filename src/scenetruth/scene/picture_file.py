"""Pictures from files: what their numbers mean, by their format, profile and encoding."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import COLOURS

if TYPE_CHECKING:
    from PIL.Image import Exif

__all__ = [
    "DecodedPicture", "PictureFileError", "as_picture", "component_of", "decode_picture", "linearise", "luminance_of",
]  # fmt: skip

Floats = NDArray[np.float64]

_REC_709 = np.array([0.2126, 0.7152, 0.0722])
_PART_OF_TEXELS = 1_000_000
_SRGB_GAMMA = 0.45455
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNG = b"\x89PNG\r\n\x1a\n"
_MODES = {"1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "I;16", "I;16B", "I;16L", "I", "F"}
_ONE_PICTURE = "must be a single grey or colour image"


class PictureFileError(ValueError):
    """Picture whose numbers cannot be read, or not without doubt."""


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """Numbers of a picture.

    ``values``: Grey or colour, shape (height, width) or (height, width, 3); integers up to ``full_scale``, or floats.
    ``full_scale``: Value of the largest radiance.
    ``alpha``: Opacity from 0 to 1, shape (height, width); None for an opaque picture.
    ``encoding``: ``srgb`` or ``linear`` if the file says so, else None.
    ``says_so``: How it says so, for people.
    """

    values: NDArray[Any]
    full_scale: float
    alpha: NDArray[np.float32] | None
    encoding: str | None
    says_so: str

    def describe(self) -> str:
        """Return size, bits, colours, opacity and encoding for people."""
        height, width = self.values.shape[:2]
        bits = "floating point" if self.values.dtype.kind == "f" else f"{round(np.log2(self.full_scale + 1))} bits"
        colours = "colour" if self.values.ndim == 3 else "grey"
        opacity = "" if self.alpha is None else ", with opacity"
        encoding = f"{self.encoding} ({self.says_so})" if self.encoding else "encoding not stated"
        return f"{width} x {height} texels, {bits}, {colours}{opacity}, {encoding}"

    def radiances(
        self, encoding: str | None, colour: tuple[float, float, float] = (1.0, 1.0, 1.0), band: str | None = None
    ) -> NDArray[np.float32]:
        """Return radiances from 0 to 1 in a band (`component_of`) times a linear colour, shape (h, w).

        ``encoding``: ``linear`` or ``srgb`` if it is given; None asks the file, whose silence means linear.
        """
        if encoding is None and self.encoding == "srgb":
            msg = (
                f"says that it is sRGB ({self.says_so}), whose grey values are not proportional to radiance: "
                "set encoding: srgb, or linear if they are"
            )
            raise PictureFileError(msg)
        out = np.empty(self.values.shape[:2], dtype=np.float32)
        # In blocks, to limit the memory of float64 intermediates.
        rows = max(_PART_OF_TEXELS // max(self.values.shape[1], 1), 1)
        for first in range(0, len(out), rows):
            part = self.values[first : first + rows].astype(np.float64) / self.full_scale
            part = linearise(part, encoding or self.encoding or "linear")
            if part.ndim == 2:
                part = part if colour == (1.0, 1.0, 1.0) else part * component_of(np.array(colour), band)
            else:
                part = component_of(part * np.array(colour), band)
            out[first : first + rows] = part
        return out


def as_picture(image: NDArray[Any]) -> DecodedPicture:
    """Return an array of grey values or colours as a picture, without its opacity; integers use their whole range."""
    full = float(np.iinfo(image.dtype).max) if image.dtype.kind in "ui" else 1.0
    if image.ndim == 3:
        image = image[..., 0] if image.shape[2] < 3 else image[..., :3]
    # Two values are the same in any encoding.
    return DecodedPicture(image, full, None, "linear" if image.dtype == np.bool_ else None, "")


def linearise(values: Floats, encoding: str) -> Floats:
    """Return values proportional to radiance (sRGB: IEC 61966-2-1)."""
    if encoding != "srgb":
        return values
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def luminance_of(colours: Floats) -> Floats:
    """Return the luminance of linear colours, with the components last."""
    return np.asarray(colours @ _REC_709)


def component_of(colours: Floats, band: str | None) -> Floats:
    """Return linear colours, with the components last, as seen in a band; without bands, their luminance (Rec. 709)."""
    if band is None:
        return luminance_of(colours)
    if band in COLOURS:
        return np.asarray(colours[..., COLOURS.index(band)])
    if (colours == colours[..., :1]).all():
        return np.asarray(colours[..., 0])
    msg = f"has colours, which are red, green and blue: specify a texture for the band '{band}' (`kind: by_band`)"
    raise PictureFileError(msg)


def decode_picture(content: bytes, *, obey_metadata: bool = True, most_pixels: int = 170_000_000) -> DecodedPicture:
    """Decode a picture from the bytes of its file.

    ``obey_metadata``: Whether orientation, profile and gamma count; glTF defines that they do not, and images of a
      measuring camera are read as they were taken.

    Raises
    ------
    PictureFileError
        If the bytes are no picture, or its numbers are not grey values or colours without doubt.
    """
    from PIL import UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if content[:4] in _TIFF:
                return _decode_tiff(content, most_pixels, obey_metadata=obey_metadata)
            return _decode_other(content, most_pixels, obey_metadata=obey_metadata)
        except PictureFileError:
            raise
        except UnidentifiedImageError as error:
            msg = "cannot be read as an image: its format is not recognised; save it as PNG, TIFF or JPEG"
            raise PictureFileError(msg) from error
        except Exception as error:  # decoders raise various exceptions
            text = " ".join(str(error).split())[:200] or type(error).__name__
            msg = f"cannot be read as an image: {text}"
            raise PictureFileError(msg) from error


def _check_size(width: int, height: int, pages: int, most: int) -> None:
    if width * height > most:
        msg = f"has {width} x {height} pixels, more than {most:,}; reduce it"
        raise PictureFileError(msg)
    if pages != 1:
        msg = f"{_ONE_PICTURE}; it has {pages} pages"
        raise PictureFileError(msg)


def _decode_tiff(content: bytes, most: int, *, obey_metadata: bool) -> DecodedPicture:
    """Decode a TIFF file."""
    import tifffile

    with tifffile.TiffFile(io.BytesIO(content)) as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        _check_size(int(page.imagewidth), int(page.imagelength), len(file.pages), most)
        photometric = int(page.photometric)
        orientation = int(page.tags.valueof(274, 1)) if obey_metadata else 1
        extra = tuple(int(each) for each in page.extrasamples)
        profile = page.tags.valueof(34675)
        bits = page.bitspersample
        # White is zero, black is zero, RGB, palette.
        if photometric not in (0, 1, 2, 3):
            kind = "CMYK" if photometric == 5 else f"of photometric interpretation {page.photometric.name}"
            msg = f"is {kind}; convert it to grey or RGB"
            raise PictureFileError(msg)
        values, axes = np.asarray(page.asarray()), str(page.axes)
        colours = page.colormap if photometric == 3 else None
    values = _image_axes(values, axes)
    samples = values.shape[2] if values.ndim == 3 else 1
    _check_samples(values, samples, photometric, extra)
    if colours is not None:
        # Entries have 16 bits, of which only the upper eight are the same for all writers.
        values, bits = np.asarray(colours)[:, values.astype(np.int64)].transpose(1, 2, 0) >> 8, 8
    if values.dtype == np.bool_:
        values, bits = values.astype(np.uint8), 1
    if photometric == 0:
        if values.dtype.kind != "u":
            msg = "has white as zero in numbers that are not unsigned integers"
            raise PictureFileError(msg)
        values = (2**bits - 1 - values.astype(np.int64)).astype(values.dtype)
    encoding, says = _profile(profile) if obey_metadata else (None, "")
    premultiplied = bool(extra) and extra[0] == 1
    return _made(_upright(values, orientation), bits, encoding, says, premultiplied=premultiplied)


def _image_axes(values: NDArray[Any], axes: str) -> NDArray[Any]:
    """Return rows, columns and samples, without axes of length 1 other than rows and columns."""
    kept = [n for n, axis in enumerate(axes) if axis in "YXS"]
    if len(axes) != values.ndim or any(values.shape[n] != 1 for n in range(values.ndim) if n not in kept):
        msg = f"{_ONE_PICTURE}; its shape is {values.shape}"
        raise PictureFileError(msg)
    order = sorted(kept, key=lambda n: "YXS".index(axes[n]))
    rest = [n for n in range(values.ndim) if n not in kept]
    return np.transpose(values, (*rest, *order)).reshape([values.shape[n] for n in order])


def _check_samples(values: NDArray[Any], samples: int, photometric: int, extra: tuple[int, ...]) -> None:
    """Raise PictureFileError for samples that are neither grey, colour, nor an opacity."""
    colours = 3 if photometric == 2 else 1
    if samples > colours + 1 or (samples == colours + 1 and len(extra) != 1) or samples < colours:
        kind = "colour" if colours == 3 else "grey"
        msg = f"{_ONE_PICTURE}; it is {kind} with {samples} samples per pixel"
        raise PictureFileError(msg)
    if samples == colours + 1 and extra[0] not in (1, 2):
        opaque = np.iinfo(values.dtype).max if values.dtype.kind in "ui" else 1.0
        if not (values[..., -1] == opaque).all():
            msg = (
                f"has {samples} samples per pixel, of which the last is unspecified (ExtraSamples 0); remove it, "
                "or declare it as unassociated alpha"
            )
            raise PictureFileError(msg)


def _upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return rows and columns in the order in which the picture is seen (Exif)."""
    if orientation in (5, 6, 7, 8):
        values = np.swapaxes(values, 0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    return np.ascontiguousarray(values)


def _decode_other(content: bytes, most: int, *, obey_metadata: bool) -> DecodedPicture:
    """Decode PNG, JPEG and other formats of Pillow."""
    from PIL import Image

    with Image.open(io.BytesIO(content)) as picture:
        _check_size(picture.width, picture.height, getattr(picture, "n_frames", 1), most)
        mode = picture.mode
        if mode not in _MODES:
            kind = {"CMYK": "CMYK", "LAB": "L*a*b*", "YCbCr": "YCbCr", "HSV": "HSV"}.get(mode, f"of mode {mode}")
            msg = f"is {kind}; convert it to grey or RGB"
            raise PictureFileError(msg)
        if content[:8] == _PNG and content[24] == 16:
            _check_16_bits(content[25], "transparency" in picture.info)
        orientation = int(picture.getexif().get(274, 1)) if obey_metadata else 1
        encoding, says = _stated_encoding(picture, content) if obey_metadata else (None, "")
        converted: Image.Image = picture
        if mode in ("P", "PA"):
            transparent = "transparency" in picture.info or mode == "PA"
            converted = picture.convert("RGBA" if transparent else "RGB")
        elif "transparency" in picture.info and mode in ("L", "RGB"):
            converted = picture.convert("LA" if mode == "L" else "RGBA")
        values = np.asarray(converted)
        mode = converted.mode
    bits = 8
    if mode == "1":
        values, bits = values.astype(np.uint8), 1
    elif mode in ("I;16", "I;16B", "I;16L"):
        bits = 16
    elif mode == "I":
        # 16-bit PNG of older versions of Pillow.
        if values.min() < 0 or values.max() > 65535:
            msg = "has 32-bit integers, of unspecified full scale; save it with 16 bits or as float"
            raise PictureFileError(msg)
        bits = 16
    return _made(_upright(values, orientation), bits, encoding, says, premultiplied=mode in ("La", "RGBa"))


def _check_16_bits(colour_type: int, transparent: bool) -> None:
    """Raise PictureFileError for PNG files of 16 bits that Pillow reduces to 8, or whose transparent value it omits."""
    if colour_type in (2, 4, 6):
        kind = "grey with opacity" if colour_type == 4 else "colour"
        msg = f"has 16 bits per channel in {kind}, of which only 8 could be read; save it as TIFF, or as 16-bit grey"
        raise PictureFileError(msg)
    if transparent:
        msg = "has a transparent value among 16-bit grey values (tRNS); save it as TIFF with opacity, or without it"
        raise PictureFileError(msg)


_CICP_TRANSFER = {8: "linear", 13: "srgb"}
_EXIF, _COLOUR_SPACE, _INTEROPERABILITY = 0x8769, 0xA001, 0xA005


def _coding_points(content: bytes) -> tuple[str | None, str]:
    """Return the encoding that the chunk cICP of a PNG file states, by its transfer function (ITU-T H.273)."""
    found, at = b"", len(_PNG)
    while at + 8 <= len(content) and content[at + 4 : at + 8] != b"IDAT":
        size = int.from_bytes(content[at : at + 4], "big")
        if content[at + 4 : at + 8] == b"cICP":
            found = content[at + 8 : at + 8 + size]
        at += 12 + size
    if len(found) < 2:
        return None, ""
    if found[1] not in _CICP_TRANSFER:
        msg = f"has the transfer function {found[1]} (cICP), neither linear (8) nor that of sRGB (13); convert it"
        raise PictureFileError(msg)
    return _CICP_TRANSFER[found[1]], "chunk cICP"


def _exif_encoding(picture: Any) -> tuple[str | None, str]:
    """Return the encoding that the Exif data of a picture states."""
    exif = picture.getexif()
    space = _read_directory(exif, _EXIF).get(_COLOUR_SPACE)
    if space == 2 or str(_read_directory(exif, _INTEROPERABILITY).get(1, "")).startswith("R03"):
        msg = "is in Adobe RGB (Exif), which is neither sRGB nor linear; convert it to sRGB"
        raise PictureFileError(msg)
    return ("srgb", "Exif ColorSpace 1") if space == 1 else (None, "")


def _read_directory(exif: Exif, tag: int) -> Mapping[int, Any]:
    """Return the entries of an Exif directory; older versions of Pillow raise an error where there is none."""
    try:
        return exif.get_ifd(tag)
    except KeyError:
        return {}


def _stated_encoding(picture: Any, content: bytes) -> tuple[str | None, str]:
    """Return the encoding that a file states, and how."""
    if content[:8] == _PNG:
        stated = _coding_points(content)
        if stated[0] is not None:
            return stated
    if "icc_profile" in picture.info:
        return _profile(picture.info["icc_profile"])
    if "srgb" in picture.info:
        return "srgb", "chunk sRGB"
    gamma = picture.info.get("gamma")
    if gamma is None:
        return _exif_encoding(picture)
    if abs(gamma - 1.0) < 0.01:
        return "linear", "gAMA of 1"
    if abs(gamma - _SRGB_GAMMA) < 0.01:
        return "srgb", "gAMA of 1 / 2.2"
    msg = f"has a gamma of {gamma:g} (gAMA), neither 1 nor that of sRGB; convert it"
    raise PictureFileError(msg)


def _profile(profile: bytes | None) -> tuple[str | None, str]:
    """Return the encoding of a colour profile."""
    if not profile:
        return None, ""
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(bytes(profile)))
        name = " ".join(ImageCms.getProfileDescription(opened).split())
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError) as error:
        msg = "has a colour profile that cannot be read; convert it to sRGB or remove it"
        raise PictureFileError(msg) from error
    plain = name.lower()
    if "linear" in plain or "gamma 1.0" in plain or "g10" in plain:
        return "linear", f"profile {name}"
    if "srgb" in plain or "iec61966" in plain or "iec 61966" in plain:
        return "srgb", f"profile {name}"
    msg = f'has the colour profile "{name}", which is neither sRGB nor linear; convert it to sRGB'
    raise PictureFileError(msg)


def _made(values: NDArray[Any], bits: int, encoding: str | None, says: str, *, premultiplied: bool) -> DecodedPicture:
    """Return grey values or colours and opacity, after checks of their range."""
    if values.ndim not in (2, 3) or 0 in values.shape or (values.ndim == 3 and values.shape[2] > 4):
        msg = f"{_ONE_PICTURE}; its shape is {values.shape}"
        raise PictureFileError(msg)
    if values.dtype.kind not in "uif":
        msg = f"must hold real numbers, not {values.dtype}"
        raise PictureFileError(msg)
    alpha = None
    if values.ndim == 3 and values.shape[2] in (2, 4):
        values, alpha = values[..., :-1], values[..., -1]
    values = values[..., 0] if values.ndim == 3 and values.shape[2] == 1 else values
    if values.dtype.kind == "f":
        full = 1.0
        if not np.isfinite(values).all():
            msg = "holds values that are not finite"
            raise PictureFileError(msg)
        if values.min() < 0 or values.max() > 1:
            msg = f"has radiances from {values.min():g} to {values.max():g}; divide them so that they lie from 0 to 1"
            raise PictureFileError(msg)
    elif values.dtype.kind == "i" and not (values.dtype.itemsize == 4 and bits == 16):
        msg = f"has signed integers ({values.dtype}), of unspecified full scale; save it as unsigned 8 or 16 bits"
        raise PictureFileError(msg)
    elif bits > 16:
        msg = f"has integers of {bits} bits, of unspecified full scale; save it with 8 or 16 bits, or as float"
        raise PictureFileError(msg)
    else:
        full = float(2**bits - 1)
    opacity = None if alpha is None else (alpha.astype(np.float64) / full).astype(np.float32)
    if opacity is not None and (opacity == 1.0).all():
        opacity = None
    if premultiplied and opacity is not None:
        msg = "has colours that are multiplied by their opacity; save it without premultiplied alpha"
        raise PictureFileError(msg)
    return DecodedPicture(np.ascontiguousarray(values), full, opacity, encoding, says)
