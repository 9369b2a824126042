"""Reading of camera images: headers, digital numbers, Bayer mosaics, averages of repeated frames."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import CaptureError, Problem
from scenetruth.scene.picture_file import PictureFileError, decode_picture, linearise

__all__ = [
    "BAYER_PLANES",
    "FrameMoments",
    "ImageHeader",
    "PixelFormat",
    "UsedBits",
    "average_frames",
    "frame_moments",
    "header_problems",
    "read_header",
    "read_pixels",
]

Floats = NDArray[np.float64]
BayerPlane = Literal["mosaic", "red", "green", "blue"]
Encoding = Literal["linear", "srgb", "gamma"]

BAYER_PLANES: Mapping[str, str] = {"red": "r", "green": "g", "blue": "b"}
"""Planes of a Bayer mosaic, and their letters in its order."""

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNG = b"\x89PNG\r\n\x1a\n"
_ORIENTATION, _DATE_TIME, _EXIF = 274, 306, 0x8769
_EXPOSURE, _TAKEN, _SUBSECONDS = 33434, 36867, 37521
_TURNED = {2: "mirrored", 3: "turned by 180°", 4: "mirrored", 5: "mirrored and turned by 90°",
           6: "turned by 90°", 7: "mirrored and turned by 90°", 8: "turned by 90°"}  # fmt: skip


@dataclass(frozen=True)
class ImageHeader:
    """Properties of an image file that are read without its pixels.

    ``bits``: Bits per value of the file, not necessarily those of the camera.
    ``orientation``: Exif orientation; 1 if the rows are stored from top to bottom.
    ``encoding``: ``srgb`` or ``linear`` if the file says so, else None.
    ``lossy``: Whether the compression changes values (JPEG).
    ``exposure_time_s``, ``taken_s``: Exposure time, and time of the exposure in s since 1970, if the file states them.
    ``resolution_s``: Resolution of ``taken_s``.
    """

    width: int
    height: int
    bits: int
    channels: int
    orientation: int = 1
    encoding: str | None = None
    lossy: bool = False
    exposure_time_s: float | None = None
    taken_s: float | None = None
    resolution_s: float = 1.0


@dataclass(frozen=True)
class PixelFormat:
    """Format of the pixels of a camera: how numbers of files become values of a recording.

    ``bit_depth``: Bits of a digital number of the camera.
    ``encoding``: ``linear``, ``srgb``, or ``gamma`` with its exponent.
    ``gamma``: Exponent of an encoding full scale (x / full scale)^(1 / gamma).
    ``bayer``: Colours of the 2 x 2 Bayer filter in row-major order; None for grey or RGB images.
    ``plane``: Pixels of a Bayer mosaic that are used: all, or those of one colour, at half the resolution.
    """

    bit_depth: int = 8
    encoding: Encoding = "linear"
    gamma: float = 2.2
    bayer: str | None = None
    plane: BayerPlane = "mosaic"

    @property
    def full_scale(self) -> float:
        """Largest value: a digital number for linear images, 1 after linearisation."""
        return float(2**self.bit_depth - 1) if self.encoding == "linear" else 1.0

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values."""
        if self.encoding != "linear":
            return np.dtype(np.float32)
        return np.dtype(np.uint8 if self.bit_depth <= 8 else np.uint16)

    @property
    def offset(self) -> tuple[int, int]:
        """Row and column of the first pixel of the plane."""
        if self.plane == "mosaic" or self.bayer is None:
            return 0, 0
        return divmod(self.bayer.index(BAYER_PLANES[self.plane]), 2)

    @property
    def step(self) -> int:
        """Distance of the pixels of the plane, in px of the camera."""
        return 1 if self.plane == "mosaic" or self.bayer is None else 2

    def shape(self, height: int, width: int) -> tuple[int, int]:
        """Return the shape of an image after selection of the plane."""
        row, column = self.offset
        return -(-(height - row) // self.step), -(-(width - column) // self.step)

    def principal_point(self, point_px: tuple[float, float]) -> tuple[float, float]:
        """Return the principal point in pixels of the plane, for one in pixels of the camera."""
        row, column = self.offset
        return (point_px[0] - column) / self.step, (point_px[1] - row) / self.step

    def select(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the pixels of the plane."""
        row, column = self.offset
        return values[row :: self.step, column :: self.step]

    def convert(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return digital numbers of a file as values of a recording; saturated values are the full scale."""
        values = self.select(values)
        if self.encoding == "linear":
            return np.ascontiguousarray(values, dtype=self.dtype)
        share = values / float(2**self.bit_depth - 1)
        straight = share**self.gamma if self.encoding == "gamma" else linearise(share, "srgb")
        return straight.astype(np.float32)


@dataclass
class UsedBits:
    """Bits that are set in any value read so far, which must be those of the camera."""

    bits: int = 0

    def add(self, values: NDArray[Any], name: str, pixels: PixelFormat, folder: Path) -> None:
        """Add the values of a file; raises `CaptureError` if they exceed the bit depth."""
        self.bits |= int(np.bitwise_or.reduce(values, axis=None))
        largest = 2**pixels.bit_depth - 1
        if self.bits <= largest or (most := int(values.max())) <= largest:
            return
        shift = 8 * values.dtype.itemsize - pixels.bit_depth
        message = f"has values up to {most:,}, more than the {largest:,} of {pixels.bit_depth} bits"
        if self.bits & (2**shift - 1):
            message += f"; set bit_depth to that of the camera, {self.bits.bit_length()} or more"
        else:
            message += (
                f"; all are multiples of {2**shift}: the numbers are stored in the upper bits. Set bit_depth to "
                f"{8 * values.dtype.itemsize}, which only changes their unit"
            )
        raise CaptureError([Problem(name, message)], source=folder)

    def describe(self, pixels: PixelFormat) -> str:
        """Return why the bit depth is likely to be another; empty if it is not."""
        needed, bits = self.bits.bit_length(), pixels.bit_depth
        if 0 < needed <= bits - 2 and bits > 8:
            return (
                f"bit_depth: no value needs more than {needed} of the {bits} bits; if the camera has {max(needed, 8)} "
                "bits, set bit_depth to it, because it defines saturation"
            )
        return ""


def read_header(file: Path) -> ImageHeader:
    """Return the header of an image file.

    Raises
    ------
    PictureFileError
        If it cannot be read as an image.
    """
    try:
        with file.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            head = stream.read(32)
            stream.seek(0)
            return _tiff_header(stream) if head[:4] in _TIFF else _other_header(stream, head)
    except PictureFileError:
        raise
    except Exception as error:  # decoders raise various exceptions
        if isinstance(error, OSError) and error.strerror:
            msg = f"cannot be read: {error.strerror}"
            raise PictureFileError(msg) from error
        if "cannot identify" in str(error):
            msg = "cannot be read as an image: it has the header of no image format"
            raise PictureFileError(msg) from error
        text = " ".join(str(error).split())[:200] or type(error).__name__
        msg = f"cannot be read as an image: {text}"
        raise PictureFileError(msg) from error


def _tiff_header(stream: Any) -> ImageHeader:
    import tifffile

    with tifffile.TiffFile(stream) as file:
        if len(file.pages) != 1:
            msg = f"must be a single image; it has {len(file.pages)} pages"
            raise PictureFileError(msg)
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        exif = page.tags.valueof(34665, {})
        exif = exif if isinstance(exif, dict) else {}
        # TIFF/EP has these tags among those of the image, Exif in a directory of its own.
        tags = page.tags
        taken, resolution = _time_of(
            exif.get("DateTimeOriginal") or tags.valueof(_TAKEN) or tags.valueof(_DATE_TIME),
            exif.get("SubsecTimeOriginal") or tags.valueof(_SUBSECONDS),
        )
        return ImageHeader(
            int(page.imagewidth),
            int(page.imagelength),
            int(page.bitspersample),
            int(page.samplesperpixel),
            int(page.tags.valueof(_ORIENTATION, 1)),
            lossy=int(page.compression) in (6, 7),
            exposure_time_s=_ratio(exif.get("ExposureTime") or tags.valueof(_EXPOSURE)),
            taken_s=taken,
            resolution_s=resolution,
        )


def _other_header(stream: Any, head: bytes) -> ImageHeader:
    from PIL import Image

    with Image.open(stream) as picture:
        exif = picture.getexif()
        inner = exif.get_ifd(_EXIF)
        bits, channels = _bits_and_channels(picture.mode, head)
        taken, resolution = _time_of(inner.get(_TAKEN) or exif.get(_DATE_TIME), inner.get(_SUBSECONDS))
        lossy = picture.format == "JPEG"
        gamma = picture.info.get("gamma")
        encoding = "srgb" if "srgb" in picture.info or (gamma is not None and abs(gamma - 0.45455) < 0.01) else None
        return ImageHeader(
            picture.width,
            picture.height,
            bits,
            channels,
            int(exif.get(_ORIENTATION, 1)),
            # JPEG files have sRGB values unless a camera was set up otherwise, which the file cannot state.
            "srgb" if encoding or lossy else None,
            lossy,
            _ratio(inner.get(_EXPOSURE)),
            taken,
            resolution,
        )


def _bits_and_channels(mode: str, head: bytes) -> tuple[int, int]:
    channels = {"RGB": 3, "RGBA": 4, "LA": 2, "P": 3, "PA": 4}.get(mode, 1)
    if head[:8] == _PNG:
        # Pillow reads colours of 16 bits as 8 bits.
        return int(head[24]), {2: 3, 6: 4, 4: 2, 3: 3}.get(head[25], 1)
    return (16 if mode.startswith("I") else 1 if mode == "1" else 32 if mode == "F" else 8), channels


def _ratio(value: Any) -> float | None:
    try:
        number = float(value[0] / value[1]) if isinstance(value, tuple) else float(value)
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return None
    return number if 0 < number < 1e6 else None


def _time_of(text: Any, fraction: Any) -> tuple[float | None, float]:
    """Return an Exif date in s since 1970, and its resolution."""
    try:
        stamp = datetime.strptime(str(text).strip("\0 "), "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None, 1.0
    digits = str(fraction or "").strip("\0 ")
    if digits.isdigit():
        return stamp + int(digits) / 10 ** len(digits), float(10.0 ** -len(digits))
    return stamp, 1.0


def header_problems(name: str, header: ImageHeader, pixels: PixelFormat, size: tuple[int, int] | None) -> list[Problem]:
    """Return why an image cannot be used as it is; ``size`` is the expected width and height."""
    problems = []
    if header.orientation != 1:
        message = (
            f"has the Exif orientation {header.orientation} ({_TURNED.get(header.orientation, 'not defined')}): pixels "
            "of a measurement must not be turned. Remove the tag if the camera was not turned, and switch off the "
            "automatic rotation"
        )
        problems.append(Problem(name, message))
    given = (header.width, header.height)
    if size is not None and given != size:
        turned = "; width and height are exchanged: was the image turned?" if given == size[::-1] else ""
        problems.append(
            Problem(name, f"has {given[0]} x {given[1]} px, but {size[0]} x {size[1]} px are expected{turned}")
        )
    if header.bits < pixels.bit_depth:
        message = f"has {header.bits} bits per value, fewer than the {pixels.bit_depth} of the camera"
        problems.append(Problem(name, f"{message}; set bit_depth to {header.bits}, or store files of 16 bits"))
    if header.bits not in range(8, 17):
        problems.append(Problem(name, "must have integers of 8 to 16 bits", header.bits))
    if pixels.bayer is not None and header.channels != 1:
        message = f"has {header.channels} channels, but a Bayer mosaic has one; omit bayer for demosaiced images"
        problems.append(Problem(name, message))
    if header.channels not in (1, 3):
        problems.append(Problem(name, "must be grey or RGB, without opacity", header.channels))
    return problems


def read_pixels(file: Path) -> NDArray[Any]:
    """Return the digital numbers of an image file as stored, uint8 or uint16, shape (y, x) or (y, x, 3).

    Raises
    ------
    PictureFileError
        If it cannot be read, or has no integers of 8 to 16 bits.
    """
    try:
        content = file.read_bytes()
    except OSError as error:
        msg = f"cannot be read: {error.strerror or error}"
        raise PictureFileError(msg) from error
    if content[:8] == _PNG and content[24:26] == b"\x10\x02":
        return _read_deep_colours(content)
    picture = decode_picture(content, obey_metadata=False)
    if picture.values.dtype.kind == "f":
        msg = "has floating-point values; images of a camera are integers of 8 to 16 bits"
        raise PictureFileError(msg)
    if picture.alpha is not None:
        msg = "has an opacity; save it without"
        raise PictureFileError(msg)
    return picture.values.astype(np.uint8 if picture.full_scale <= 255 else np.uint16, copy=False)


def _read_deep_colours(content: bytes) -> NDArray[Any]:
    """Return colours of 16 bits from a PNG file, which needs OpenCV."""
    try:
        import cv2
    except ImportError as error:
        msg = (
            "has 16 bits per channel in colour, for which OpenCV is required: `pip install scenetruth[opencv]`; or "
            "save it as TIFF"
        )
        raise PictureFileError(msg) from error
    values = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != np.uint16 or values.ndim != 3:
        msg = "cannot be read as an image of 16 bits per channel"
        raise PictureFileError(msg)
    return np.ascontiguousarray(values[..., 2::-1])


@dataclass(frozen=True, eq=False)
class FrameMoments:
    """Moments of repeated frames, pixel by pixel.

    ``mean``: Mean, shape (y, x[, channel]).
    ``variance``: Temporal variance of a single frame, with n - 1 degrees of freedom; NaN for a single frame.
    ``lowest``, ``highest``: Smallest and largest value.
    ``frame_means``: Mean of each frame, shape (n,).
    """

    mean: Floats
    variance: Floats
    lowest: NDArray[Any]
    highest: NDArray[Any]
    frame_means: Floats

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.frame_means)


def frame_moments(frames: Iterator[NDArray[Any]] | Sequence[NDArray[Any]] | NDArray[Any]) -> FrameMoments:
    """Return the moments of frames, of which only one is in memory at a time (Welford's method).

    >>> found = frame_moments(np.array([[[1, 5]], [[3, 5]]]))
    >>> found.mean.tolist(), found.variance.tolist(), found.count
    ([[2.0, 5.0]], [[2.0, 0.0]], 2)
    """
    count = 0
    mean = square = np.zeros(())
    lowest = highest = np.zeros(())
    means = []
    for frame in frames:
        count += 1
        means.append(float(frame.mean(dtype=np.float64)))
        if count == 1:
            mean, square = frame.astype(np.float64), np.zeros(frame.shape)
            lowest, highest = frame.copy(), frame.copy()
            continue
        if frame.shape != mean.shape:
            msg = f"frame {count} has the shape {frame.shape}, and the frames before it {mean.shape}"
            raise ValueError(msg)
        step = frame - mean
        mean = mean + step / count
        square += step * (frame - mean)
        np.minimum(lowest, frame, out=lowest)
        np.maximum(highest, frame, out=highest)
    if count == 0:
        msg = "there are no frames"
        raise ValueError(msg)
    variance = square / (count - 1) if count > 1 else np.full(square.shape, np.nan)
    return FrameMoments(mean, variance, lowest, highest, np.array(means))


def average_frames(files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> NDArray[np.float32]:
    """Return the mean of repeated images, for example of all dark frames.

    Parameters
    ----------
    files
        Pattern of the files with the wildcards ``*`` and ``?``, such as ``"dark/*.tif"``; or the files themselves.

    Returns
    -------
    numpy.ndarray
        float32, digital numbers, shape (y, x), or (y, x, 3) of colour images.

    Raises
    ------
    CaptureError
        If there are no such files, or if they cannot be read, are turned, or differ in size; lists every problem.

    See Also
    --------
    scenetruth.correct_images : Subtracts a dark frame, and divides by a flat field.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> with TemporaryDirectory() as folder:
    ...     for number, value in enumerate((16, 18)):
    ...         imageio.imwrite(f"{folder}/dark{number}.png", np.full((2, 3), value, dtype=np.uint8))
    ...     average_frames(f"{folder}/dark*.png").tolist()
    [[17.0, 17.0, 17.0], [17.0, 17.0, 17.0]]
    """
    paths = _listed(files)
    problems: list[Problem] = []
    size = None
    for path in paths:
        try:
            header = read_header(path)
        except PictureFileError as error:
            problems.append(Problem(str(path), str(error)))
            continue
        size = size or (header.width, header.height)
        problems += header_problems(str(path), header, PixelFormat(min(header.bits, 8)), size)
    if problems:
        raise CaptureError(problems)
    try:
        return frame_moments(map(read_pixels, paths)).mean.astype(np.float32)
    except (PictureFileError, ValueError) as error:
        raise CaptureError([Problem("files", str(error))]) from error


def _listed(files: Any) -> list[Path]:
    """Return the files of a pattern with wildcards, or those listed."""
    if not isinstance(files, str | os.PathLike):
        paths = [Path(each) for each in files]
        if not paths:
            raise CaptureError([Problem("files", "are empty; list one file at least")])
        return paths
    given = Path(files)
    parts = given.parts
    wild = next((n for n, part in enumerate(parts) if "*" in part or "?" in part), None)
    if wild is None:
        return [given]
    folder = Path(*parts[:wild])
    paths = sorted(path for path in folder.glob("/".join(parts[wild:])) if path.is_file())
    if not paths:
        held = len(list(folder.iterdir())) if folder.is_dir() else None
        where = "its folder does not exist" if held is None else f"'{folder}' has {held:,} other entries"
        raise CaptureError([Problem("files", f"matches no file; {where}", str(files))])
    return paths
