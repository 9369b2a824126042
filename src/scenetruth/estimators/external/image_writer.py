"""Image files of a recording for external programs: PNG, TIFF or .npy, written frame by frame."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import xarray as xr
from numpy.typing import DTypeLike, NDArray

from scenetruth.errors import EstimateError, Problem
from scenetruth.progress import Progress

__all__ = [
    "ArrayFile",
    "ImageForm",
    "IntensityScaling",
    "each_frame",
    "image_problems",
    "image_scale",
    "single_row",
    "write_images",
]


def single_row(recording: xr.Dataset) -> xr.Dataset:
    """Return a recording without the dimension ``s_y``; raise for a grid."""
    if "s_y" not in recording["image"].dims:
        return recording
    if recording.sizes["s_y"] > 1:
        message = "a grid cannot be written; select one row, recording.sel(s_y=0)"
        raise EstimateError([Problem("stage.rows", message, recording.sizes["s_y"])])
    return recording.isel(s_y=0)


def each_frame(recording: xr.Dataset) -> Iterator[tuple[NDArray[Any], NDArray[np.bool_]]]:
    """Yield images (s, y, x[, channel]) and masks (s, y, x), which include values that are not finite, frame by frame.

    >>> import scenetruth as st
    >>> recording = st.make_recording(np.zeros((2, 3, 30, 40)), focal_length_px=500, baseline_mm=5)
    >>> [image.shape for image, bad in each_frame(recording)]
    [(2, 30, 40), (2, 30, 40), (2, 30, 40)]
    """
    images, mask = recording["image"], recording.get("exclusion_mask")
    for place in range(images.sizes["t"]):
        values = images.isel(t=place).values
        bad = np.zeros(values.shape[:3], dtype=np.bool_)
        if values.dtype.kind == "f":
            missing = ~np.isfinite(values)
            bad |= missing.any(axis=-1) if missing.ndim == 4 else missing
        if mask is not None:
            # Without s, the mask is the same for all cameras.
            bad |= (mask.isel(t=place) if "t" in mask.dims else mask).values
        yield values, bad


class ArrayFile:
    """Little-endian .npy file (s, t, ...), zero where unwritten; a memory map would count as memory of the process."""

    def __init__(self, file: Path, dtype: DTypeLike, shape: tuple[int, ...]) -> None:
        self._dtype, self._shape = np.dtype(dtype).newbyteorder("<"), shape
        self._opened = file.open("wb")
        head = {"descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._opened, head)
        self._first = self._opened.tell()
        self._image_bytes = self._dtype.itemsize * int(np.prod(shape[2:], dtype=np.int64))
        self._opened.truncate(self._first + shape[0] * shape[1] * self._image_bytes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._opened.close()

    def put(self, place: int, values: NDArray[Any]) -> None:
        """Write a frame of all cameras, shape (s, ...), at an index along t."""
        for camera, image in enumerate(values):
            self._opened.seek(self._first + (camera * self._shape[1] + place) * self._image_bytes)
            self._opened.write(np.ascontiguousarray(image, dtype=self._dtype).tobytes())


_COMPRESSION = 1  # the files exist only while one program runs: speed has priority over size


def write_png(file: Path, image: NDArray[Any]) -> None:
    """Write an image of shape (y, x) or (y, x, 3), uint8 or uint16, without scaling."""
    import imageio.v3 as imageio

    if image.ndim == 2 or image.dtype == np.uint8:
        imageio.imwrite(file, image, compress_level=_COMPRESSION)
        return
    # Pillow, which imageio uses, does not support 16-bit colour images.
    height, width, _ = image.shape
    # Every row begins with its filter type: none.
    rows = np.zeros((height, 1 + 6 * width), dtype=np.uint8)
    rows[:, 1:] = np.ascontiguousarray(image, dtype=">u2").view(np.uint8).reshape(height, 6 * width)
    # 16 bits, colour type 2: RGB.
    head = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), _COMPRESSION)
    parts = [_chunk(b"IHDR", head), _chunk(b"IDAT", body), _chunk(b"IEND", b"")]
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def write_mask_png(file: Path, bad: NDArray[np.bool_]) -> None:
    """Write a mask of shape (y, x): 255 where true, else 0."""
    write_png(file, bad.astype(np.uint8) * np.uint8(255))


_LARGEST = 65535
_EXACT_IN_FLOAT64 = 2**53  # larger integers are not exact in float64


@dataclass(frozen=True)
class IntensityScaling:
    """Linear map between values and file numbers from 0 to 65535: value = offset + scale number.

    ``lossless``: Whether the values are reproduced exactly; else the error is at most half of ``scale``.
    """

    scale: float = 1.0
    offset: float = 0.0
    lossless: bool = True

    def numbers(self, values: NDArray[Any]) -> NDArray[np.uint16]:
        """Return the file numbers of values; 0 where a value is not finite.

        >>> IntensityScaling(0.5, -1.0).numbers(np.array([-1.0, 0.0, 3.1, np.nan])).tolist()
        [0, 2, 8, 0]
        """
        if values.dtype.kind == "u" and values.dtype.itemsize <= 2 and (self.scale, self.offset) == (1.0, 0.0):
            return values.astype(np.uint16)
        known = values.astype(np.float64)
        known = np.rint((np.where(np.isfinite(known), known, self.offset) - self.offset) / self.scale)
        return np.clip(known, 0, _LARGEST).astype(np.uint16)


def choose_intensity_scaling(recording: xr.Dataset) -> IntensityScaling:
    """Return the scaling to 16 bits with the smallest loss.

    Integers are stored unchanged or offset, if their range allows: always for 8 and 16 bits, otherwise after the range
    of all images is determined. All other values are scaled to the full range of 65536 numbers.
    """
    dtype = recording["image"].dtype
    if dtype.kind == "u" and dtype.itemsize <= 2:
        return IntensityScaling()
    least, largest = np.inf, -np.inf
    for values, _ in each_frame(recording):
        known = values[np.isfinite(values)]
        if known.size:
            least, largest = min(least, float(known.min())), max(largest, float(known.max()))
    if least > largest:
        # All pixels are invalid.
        return IntensityScaling()
    if dtype.kind != "f" and largest - least <= _LARGEST and max(-least, largest) < _EXACT_IN_FLOAT64:
        return IntensityScaling(offset=0.0 if least >= 0 and largest <= _LARGEST else least)
    if least == largest:
        return IntensityScaling(offset=least)
    return IntensityScaling((largest - least) / _LARGEST, least, lossless=False)


ImageForm = Literal["png", "tiff", "npy"]
"""``png``: 16-bit numbers; ``tiff``: as recorded, or float32; ``npy``: all images in one float32 array."""

_EXACT_IN_FLOAT32 = 2**24  # larger integers are not exact in float32


def image_problems(recording: xr.Dataset, form: ImageForm) -> list[Problem]:
    """Return the reasons why the images cannot be written in a format."""
    channels = recording.sizes.get("channel", 1)
    if form == "png" and channels not in (1, 3):
        message = "PNG files require 1 or 3 channels; use images='tiff' or 'npy'"
        return [Problem("channel", message, channels)]
    return []


def image_scale(recording: xr.Dataset, form: ImageForm) -> IntensityScaling:
    """Return the relation between file numbers and values."""
    if form == "png":
        return choose_intensity_scaling(recording)
    dtype = recording["image"].dtype
    if dtype.kind == "f":
        return IntensityScaling(lossless=dtype.itemsize <= 4)
    # Larger integers may be rounded.
    return IntensityScaling(lossless=np.iinfo(dtype).max <= _EXACT_IN_FLOAT32)


def write_images(
    recording: xr.Dataset, folder: Path, form: ImageForm, scale: IntensityScaling, progress: Progress | None = None
) -> list[str]:
    """Write all images frame by frame; return the names of the mask files."""
    write = _write_arrays if form == "npy" else _write_files
    masks = []
    for done, mask in enumerate(write(recording, folder, form, scale), start=1):
        masks += mask
        if progress is not None:
            progress("images", done, recording.sizes["t"])
    return sorted(set(masks))


def _write_files(recording: xr.Dataset, folder: Path, form: ImageForm, scale: IntensityScaling) -> Iterator[list[str]]:
    """Write a file for each image and for each mask that marks a pixel; yield the mask names of every frame."""
    cameras, frames = (recording[name].values.tolist() for name in ("s", "t"))
    write = _png_writer(recording, scale) if form == "png" else _write_tiff
    for t, (images, bad) in zip(frames, each_frame(recording), strict=True):
        masks = []
        for s, image, wrong in zip(cameras, images, bad, strict=True):
            name = f"s{s:+d}_t{t:+d}"
            write(folder / f"{name}.{form}", image[..., 0] if image.ndim == 3 and image.shape[-1] == 1 else image)
            if wrong.any():
                masks.append(f"exclusion_mask_{name}.png")
                write_mask_png(folder / masks[-1], wrong)
        yield masks


def _png_writer(recording: xr.Dataset, scale: IntensityScaling) -> Callable[[Path, NDArray[Any]], None]:
    # Most readers convert colours to 8 bits; colours of 8 bits are therefore written as such.
    eight = recording["image"].dtype == np.uint8 and recording.sizes.get("channel", 1) == 3
    return lambda file, image: write_png(file, image if eight else scale.numbers(image))


def _write_tiff(file: Path, image: NDArray[Any]) -> None:
    import tifffile

    values = image if image.dtype.kind == "u" and image.dtype.itemsize <= 2 else image.astype(np.float32)
    colours = image.ndim == 3 and image.shape[-1] == 3
    tifffile.imwrite(
        file,
        values,
        photometric="rgb" if colours else "minisblack",
        planarconfig="contig" if image.ndim == 3 else None,
        metadata=None,
    )


def _write_arrays(recording: xr.Dataset, folder: Path, form: ImageForm, scale: IntensityScaling) -> Iterator[list[str]]:
    """Write images.npy and, if any pixel is masked, exclusion_mask.npy."""
    shape = recording["image"].shape
    with ExitStack() as open_:
        images = open_.enter_context(ArrayFile(folder / "images.npy", np.float32, shape))
        mask: ArrayFile | None = None
        for place, (values, bad) in enumerate(each_frame(recording)):
            with np.errstate(over="ignore"):
                images.put(place, values)
            if bad.any():
                if mask is None:
                    mask = open_.enter_context(ArrayFile(folder / "exclusion_mask.npy", np.uint8, shape[:4]))
                mask.put(place, bad)
            yield [] if mask is None else ["exclusion_mask.npy"]
