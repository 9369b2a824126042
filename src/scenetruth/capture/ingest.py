"""Image files as a recording: collection by a pattern, checks of all headers, reading image by image."""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.capture.corrections import FixedPatternCorrection
from scenetruth.capture.file_patterns import (
    IMAGE_SUFFIXES,
    TIME_FIELD,
    FilePattern,
    MatchedFile,
    expected_indices,
    list_names,
    missing_names,
    nearest_patterns,
    read_pattern,
)
from scenetruth.capture.image_reading import (
    BayerPlane,
    Encoding,
    ImageHeader,
    PixelFormat,
    UsedBits,
    header_problems,
    read_header,
    read_pixels,
)
from scenetruth.errors import CaptureError, CaptureWarning, Problem, RecordingError
from scenetruth.progress import Progress
from scenetruth.scene.picture_file import PictureFileError
from scenetruth.schema import IncrementalDataset, Put, blank_map, describe_variable, make_recording

if TYPE_CHECKING:
    from scenetruth.capture.rectification import Rectification

__all__ = [
    "ImageSeries",
    "RecordingPlan",
    "collect_images",
    "list_missing",
    "no_match_message",
    "read_images",
    "split_pattern",
]

Floats = NDArray[np.float64]
Index = tuple[int, int, int]

_MOST_LISTED = 8
_FIELDS = ("row", "s", "t")


@dataclass(frozen=True, eq=False)
class ImageSeries:
    """Image files of a recording, with the headers of all of them.

    ``rows``, ``positions``, ``frames``: Indices in the names of the files, in order.
    ``files``: Files by (row, position, frame).
    ``headers``: Headers by the name of the file.
    ``missing``: Names of the files that are missing.
    ``used_bits``: Bits of all values read so far.
    """

    folder: Path
    pattern: FilePattern
    pixels: PixelFormat
    rows: tuple[int, ...]
    positions: tuple[int, ...]
    frames: tuple[int, ...]
    files: Mapping[Index, MatchedFile]
    headers: Mapping[str, ImageHeader]
    missing: tuple[str, ...] = ()
    used_bits: UsedBits = field(default_factory=UsedBits)

    @property
    def header(self) -> ImageHeader:
        """Header of the first image; all have its size."""
        return next(iter(self.headers.values()))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an image of the recording, (y, x[, channel])."""
        size = self.pixels.shape(self.header.height, self.header.width)
        return (*size, 3) if self.header.channels == 3 else size

    def indices(self) -> Iterator[tuple[Index, MatchedFile | None]]:
        """Yield every index of the recording, counted from 0, with its file; None if that is missing."""
        for (r, row), (s, position), (t, frame) in product(*map(enumerate, (self.rows, self.positions, self.frames))):
            yield (r, s, t), self.files.get((row, position, frame))

    def read(self, file: MatchedFile) -> NDArray[Any]:
        """Return the values of an image; raises `CaptureError` if it cannot be read or exceeds the bit depth."""
        try:
            values = read_pixels(self.folder / file.name)
        except PictureFileError as error:
            raise CaptureError([Problem(file.name, str(error))], source=self.folder) from error
        self.used_bits.add(values, file.name, self.pixels, self.folder)
        return self.pixels.convert(values)


def split_pattern(given: str | os.PathLike[str]) -> tuple[Path, str]:
    """Return the folder of a path with fields, and the rest of the path.

    >>> split_pattern("/data/leaf/s{s}/t{t}.png")
    (PosixPath('/data/leaf'), 's{s}/t{t}.png')
    """
    parts = Path(given).parts
    first = next((n for n, part in enumerate(parts) if any(sign in part for sign in "{}*?")), len(parts) - 1)
    return Path(*parts[:first]), "/".join(parts[first:])


def list_missing(names: Sequence[str]) -> str:
    """Return names for a message, with the number of those that are not shown."""
    shown = ", ".join(names[:_MOST_LISTED])
    return shown + (f", and {len(names) - _MOST_LISTED:,} more" if len(names) > _MOST_LISTED else "")


def no_match_message(pattern: FilePattern, names: Sequence[str]) -> str:
    """Return the message of a pattern that matches no file, with the nearest patterns of the folder."""
    near = nearest_patterns(pattern, names)
    if near:
        return f"matches no file; nearest: {' or '.join(one.describe() for one in near)}"
    held = f"the folder has {len(names):,} image files of other names" if names else "the folder has no image files"
    return f"matches no file; {held}"


def collect_images(
    folder: Path,
    pattern: FilePattern,
    pixels: PixelFormat | Callable[[ImageHeader], PixelFormat],
    *,
    rows: int | None = None,
    positions: int | None = None,
    frames: int | None = None,
    first_position: int | None = None,
    first_frame: int | None = None,
    size: tuple[int, int] | None = None,
    path: str = "pattern",
    names: Sequence[str] | None = None,
) -> ImageSeries:
    """Return the images of a folder whose names match a pattern, after a check of all names and headers.

    ``rows``, ``positions``, ``frames``: Their numbers; None if the names define them.
    ``first_position``, ``first_frame``: Their first indices in the names; None if the names define them.
    ``size``: Width and height; None if the first image defines them.
    ``path``: Path of the pattern in messages.
    ``names``: Image files of the folder, if they are listed already.

    Raises
    ------
    CaptureError
        If there are no images, or any of them cannot be used; lists every problem.
    """
    if names is None:
        names = _image_names(folder, path)
    matched = pattern.matches(names)
    if not matched:
        raise CaptureError([Problem(path, no_match_message(pattern, names), pattern.text)], source=folder)
    problems: list[Problem] = []
    ranges = {}
    for name, count in zip(_FIELDS, (rows, positions, frames), strict=True):
        if name not in pattern.fields:
            if (count or 1) > 1:
                problems.append(Problem(path, f"needs the field {{{name}}} for {count} of them", pattern.text))
            ranges[name] = [0]
            continue
        values = {one.indices[name] for one in matched}
        signed = any(
            part == name and spec.startswith("+") for part, spec in zip(pattern.fields, pattern.specs, strict=True)
        )
        start = {"s": first_position, "t": first_frame}.get(name)
        ranges[name], why = expected_indices(values, count, signed=signed, first=start)
        if why:
            remedy = {"s": ": give first_position", "t": ": give first_frame"}.get(name, "")
            message = f"the indices {{{name}}} of the files {why}{remedy if 'open' in why else ''}"
            problems.append(Problem(path, message, pattern.text))
    files: dict[Index, MatchedFile] = {}
    for one in matched:
        row, s, t = one.index(*_FIELDS)
        index = (row, s, t)
        if index in files:
            which = ", ".join(f"{name} = {n}" for name, n in zip(_FIELDS, index, strict=True) if name in pattern.fields)
            message = f"matches two files of the same image ({which}): {files[index].name} and {one.name}"
            problems.append(Problem(path, message, pattern.text))
        files.setdefault(index, one)
    present = [name for name in _FIELDS if name in pattern.fields]
    missing = [] if problems else missing_names(pattern, {name: ranges[name] for name in present}, matched)
    headers, found = _read_headers(folder, files.values())
    problems += found
    if headers:
        first = next(iter(headers.values()))
        if not isinstance(pixels, PixelFormat):
            pixels = pixels(first)
        for name, header in headers.items():
            problems += header_problems(name, header, pixels, size or (first.width, first.height))
            if header.channels != first.channels:
                message = f"has {header.channels} channels, and other images have {first.channels}"
                problems.append(Problem(name, message))
    if problems:
        raise CaptureError(_bounded(problems), source=folder)
    assert isinstance(pixels, PixelFormat)
    every = [tuple(ranges[name]) for name in _FIELDS]
    return ImageSeries(folder, pattern, pixels, every[0], every[1], every[2], files, headers, tuple(missing))


def _image_names(folder: Path, path: str) -> list[str]:
    if not folder.is_dir():
        raise CaptureError([Problem(path, "its folder does not exist", str(folder))])
    try:
        return list_names(folder, suffixes=IMAGE_SUFFIXES)
    except (OSError, ValueError) as error:
        raise CaptureError([Problem(path, f"its folder cannot be used: {error}", str(folder))]) from error


def _read_headers(folder: Path, files: Iterator[MatchedFile] | Any) -> tuple[dict[str, ImageHeader], list[Problem]]:
    headers, problems = {}, []
    for file in files:
        try:
            headers[file.name] = read_header(folder / file.name)
        except PictureFileError as error:
            problems.append(Problem(file.name, str(error)))
    return headers, problems


_MOST_PROBLEMS = 50


def _bounded(problems: list[Problem]) -> list[Problem]:
    """Return the first problems, and how many follow."""
    if len(problems) <= _MOST_PROBLEMS:
        return problems
    more = len(problems) - _MOST_PROBLEMS
    return [*problems[:_MOST_PROBLEMS], Problem("", f"{more:,} more problems are omitted; fix these first")]


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """Images, their geometry and their correction: all that makes a recording.

    ``geometry``: Arguments of `make_recording` in pixels of the camera.
    ``correction``: Correction of every image; None for digital numbers as they are.
    ``rectification``: Resampling of every image after its correction; None for the recorded pixels.
    """

    series: ImageSeries
    geometry: Mapping[str, Any]
    correction: FixedPatternCorrection | None = None
    rectification: Rectification | None = None

    @property
    def floats(self) -> bool:
        """Whether the recording holds floats, in which invalid pixels are NaN."""
        if self.correction is not None or self.rectification is not None:
            return True
        return bool(self.series.missing) or self.series.pixels.encoding != "linear"

    @property
    def full_scale(self) -> float:
        """Full scale of the recording."""
        return self.series.pixels.full_scale if self.correction is None else self.correction.corrected_full_scale

    def blank(self) -> xr.Dataset:
        """Return the recording with blank images."""
        series, given = self.series, dict(self.geometry)
        grid = given.get("stage_y_mm") is not None
        sizes = (len(series.rows), len(series.positions), len(series.frames))[not grid :]
        pixels, header = series.pixels, series.header
        point = given.pop("principal_point_px", None) or ((header.width - 1) / 2, (header.height - 1) / 2)
        given["principal_point_px"] = pixels.principal_point(point)
        given["focal_length_px"] = given["focal_length_px"] / pixels.step
        given["line_time_s"] = given.get("line_time_s", 0.0) * pixels.step
        if "exclusion_mask" in given:
            given["exclusion_mask"] = self._mask(_selected(given["exclusion_mask"], pixels))
        attrs = {**(given.pop("attrs", None) or {})}
        if series.missing:
            attrs["missing_images"] = json.dumps(list(series.missing))
        dtype = np.dtype(np.float32) if self.floats else pixels.dtype
        try:
            blank = make_recording(
                blank_map(dtype, (*sizes, *series.shape)), full_scale=self.full_scale, attrs=attrs, copy=False, **given
            )
        except RecordingError as error:
            raise CaptureError(error.problems, source=error.source) from error
        if self.rectification is not None:
            dims = ("s", "y", "x") if self.rectification.constant else ("s", "t", "y", "x")
            share = blank_map(np.float32, [blank.sizes[dim] for dim in dims])
            blank["noise_share"] = (dims, share, describe_variable("recording", "noise_share"))
        return blank

    def _mask(self, excluded: NDArray[Any]) -> NDArray[Any]:
        """Return the excluded pixels of the recording, from those of the images."""
        if self.rectification is None:
            return excluded
        places = range(len(self.series.positions))
        if self.rectification.constant:
            return np.array([self.rectification.mask(excluded, s, 0) for s in places])
        frames = range(len(self.series.frames))
        return np.array([[self.rectification.mask(excluded, s, t) for t in frames] for s in places])

    def fill(self, put: Put, progress: Progress | None = None) -> None:
        """Read every image and hand it over; missing images are NaN."""
        grid = self.geometry.get("stage_y_mm") is not None
        every = list(self.series.indices())
        for number, ((row, position, frame), file) in enumerate(every):
            at = {**({"s_y": row} if grid else {}), "s": position, "t": frame}
            values = self.image(file)
            if self.rectification is not None:
                values = self.rectification.apply(values, position, frame)
                if frame == 0 or not self.rectification.constant:
                    put("noise_share", at, self.rectification.noise_share(position, frame))
            put("image", at, values)
            if progress is not None:
                progress("read", number + 1, len(every))

    def image(self, file: MatchedFile | None) -> NDArray[Any]:
        """Return the values of an image as they stand in the recording."""
        if file is None:
            return np.full(self.series.shape, np.nan, dtype=np.float32)
        values = self.series.read(file)
        if self.correction is not None:
            return self.correction.apply(values)
        if not self.floats:
            return values
        out = values.astype(np.float32)
        out[values >= self.series.pixels.full_scale] = np.nan
        return out

    def warn(self, stacklevel: int = 2) -> None:
        """Warn of missing images, of times that had to be interpolated, and of an unlikely bit depth."""
        missing = self.series.missing
        if missing:
            plural = "s are" if len(missing) > 1 else " is"
            message = f"{len(missing):,} image{plural} missing and invalid (NaN): {list_missing(missing)}"
            warnings.warn(message, CaptureWarning, stacklevel=stacklevel + 1)
        if text := self.series.used_bits.describe(self.series.pixels):
            warnings.warn(text, CaptureWarning, stacklevel=stacklevel + 1)

    def load(self, progress: Progress | None = None) -> xr.Dataset:
        """Return the recording in memory."""
        filling = IncrementalDataset(self.blank())
        self.fill(filling.put, progress)
        return filling.dataset()


def _selected(mask: Any, pixels: PixelFormat) -> NDArray[Any]:
    """Return an exclusion mask in the pixels of a plane; which are pixels of the camera."""
    row, column = pixels.offset
    return np.asarray(mask)[..., row :: pixels.step, column :: pixels.step]


def read_images(
    pattern: str | os.PathLike[str],
    focal_length_px: float,
    baseline_mm: float,
    *,
    positions: int | None = None,
    frames: int | None = None,
    first_position: int | None = None,
    first_frame: int | None = None,
    bit_depth: int | None = None,
    encoding: Encoding = "linear",
    gamma: float = 2.2,
    bayer: str | None = None,
    plane: BayerPlane = "mosaic",
    frame_interval_s: float | None = None,
    progress: Progress | None = None,
    **geometry: Any,
) -> xr.Dataset:
    """Read a recording from image files whose names have a pattern.

    Parameters
    ----------
    pattern
        Path of the files with the fields ``{s}`` (camera position, increasing to the right), ``{t}`` (frame), ``{row}``
        (row of a grid) and ``{time:FORMAT}`` (time stamp, a format of ``datetime.strptime``), and the wildcards ``*``
        and ``?``: ``"leaf/pos{s}_t{t:03d}.png"``. With a format, such as ``03d`` or ``+d``, only numbers of this form
        match. PNG and TIFF of 8 to 16 bits, grey, RGB or Bayer mosaic.
    focal_length_px
        f, in pixels of the files.
    baseline_mm
        V_X, the camera displacement in mm per step of s; positive if larger s is further to the right.
    positions, frames
        Number of camera positions and of frames; default: from the smallest to the largest index of the names.
    first_position, first_frame
        Index of the first position and of the first frame in the names, where their files may be missing; default: 0 or
        1, or symmetrically around 0 for indices with a sign.
    bit_depth
        Bits of a digital number of the camera, which define saturation: 12 for 12 bits in files of 16 bits. Default:
        the bits of the files.
    encoding
        ``linear``, ``srgb``, or ``gamma``; images that are not linear are made linear, with full scale 1.
    gamma
        Exponent of the encoding ``gamma``, full scale (x / full scale)^(1 / gamma).
    bayer
        Colours of a Bayer mosaic in row-major order: ``rggb``, ``grbg``, ``gbrg``, ``bggr``.
    plane
        Pixels of the mosaic that are used: ``mosaic`` for all of them as they are, or ``red``, ``green`` (the first of
        both) or ``blue`` at half the resolution; intrinsics are converted.
    frame_interval_s
        Time between consecutive frames; default: that of the time stamps in the names, or 1 s.
    progress
        Called with the number of images read.
    **geometry
        Other arguments of `make_recording`: ``principal_point_px``, ``stage_x_mm``, ``stage_y_mm``,
        ``planned_time_s``, ``line_time_s``, ``distortion``, ``stage_tolerances``, ``lens_tolerances``,
        ``exclusion_mask``, ``attrs``.

    Returns
    -------
    xarray.Dataset
        The recording. If images are missing, all are float32, the missing images and saturated pixels are NaN, and the
        attribute ``missing_images`` lists the names as JSON.

    Raises
    ------
    CaptureError
        If no file matches (the message states the nearest pattern), two files are the same image, or an image cannot
        be read, is turned, or differs in size; lists every problem.

    Warns
    -----
    CaptureWarning
        If images are missing, or the bit depth is unlikely.

    See Also
    --------
    make_recording : Creates a recording from arrays.
    correct_images : Corrects the images with dark frames and flat fields.
    undistort_images : Removes the distortion of the lens.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> with TemporaryDirectory() as folder:
    ...     for s in range(3):
    ...         for t in range(2):
    ...             imageio.imwrite(f"{folder}/pos{s}_t{t:03d}.png", np.full((30, 40), 10 * s + t, dtype=np.uint8))
    ...     recording = read_images(f"{folder}/pos{{s}}_t{{t:03d}}.png", focal_length_px=500, baseline_mm=5)
    >>> recording.s.values.tolist(), recording.image[:, :, 0, 0].values.tolist()
    ([-1, 0, 1], [[0, 1], [10, 11], [20, 21]])
    """
    problems = _format_problems(bit_depth, encoding, gamma, bayer, plane)
    unknown = sorted(set(geometry) - set(_GEOMETRY))
    problems += [Problem(name, f"is no argument; these are {', '.join(_GEOMETRY)}", geometry[name]) for name in unknown]
    read = None
    folder, text = split_pattern(pattern)
    try:
        read = read_pattern(text, (*_FIELDS, TIME_FIELD))
    except ValueError as error:
        problems.append(Problem("pattern", str(error), text))
    if problems or read is None:
        raise CaptureError(problems)

    def pixels_of(header: ImageHeader) -> PixelFormat:
        return PixelFormat(bit_depth or header.bits, encoding, gamma, bayer, plane)

    grid = geometry.get("stage_y_mm")
    series = collect_images(
        folder,
        read,
        pixels_of,
        rows=None if grid is None else np.size(grid),
        positions=positions,
        frames=frames,
        first_position=first_position,
        first_frame=first_frame,
    )
    if grid is None and len(series.rows) > 1:
        message = f"the names have {len(series.rows)} rows: give their positions"
        raise CaptureError([Problem("stage_y_mm", message)])
    given = dict(geometry)
    if TIME_FIELD in read.fields and "planned_time_s" not in given:
        given["planned_time_s"] = times_of(
            series, {index: file.time_s for index, file in series.files.items()}, grid=grid is not None
        )
    given["frame_interval_s"] = frame_interval_s or _interval_of(given.get("planned_time_s")) or 1.0
    plan = RecordingPlan(series, {**given, "focal_length_px": focal_length_px, "baseline_mm": baseline_mm})
    recording = plan.load(progress)
    plan.warn()
    return recording


_GEOMETRY = (
    "principal_point_px", "stage_x_mm", "stage_y_mm", "planned_time_s", "line_time_s", "distortion",
    "stage_tolerances", "lens_tolerances", "exclusion_mask", "attrs",
)  # fmt: skip


def _format_problems(bit_depth: Any, encoding: Any, gamma: Any, bayer: Any, plane: Any) -> list[Problem]:
    """Return the problems of the arguments of `PixelFormat`."""
    problems = []
    if bit_depth is not None and bit_depth not in range(8, 17):
        problems.append(Problem("bit_depth", "must be from 8 to 16", bit_depth))
    if encoding not in ("linear", "srgb", "gamma"):
        problems.append(Problem("encoding", "must be 'linear', 'srgb' or 'gamma'", encoding))
    if not isinstance(gamma, int | float) or not 0.2 <= gamma <= 5:
        problems.append(Problem("gamma", "must be from 0.2 to 5", gamma))
    if bayer not in (None, "rggb", "grbg", "gbrg", "bggr"):
        problems.append(Problem("bayer", "must be 'rggb', 'grbg', 'gbrg' or 'bggr'", bayer))
    if plane not in ("mosaic", "red", "green", "blue"):
        problems.append(Problem("plane", "must be 'mosaic', 'red', 'green' or 'blue'", plane))
    elif plane != "mosaic" and bayer is None:
        problems.append(Problem("plane", "needs the order of the mosaic: set bayer", plane))
    return problems


def times_of(series: ImageSeries, stamps: Mapping[Index, float | None], *, grid: bool) -> Floats:
    """Return the time of every image, 0 at the reference, from time stamps of the files.

    The time of a missing image is interpolated between the frames before and after it, of the same position.

    Raises
    ------
    CaptureError
        If a file has no time stamp, or a position has fewer than two of them to interpolate.
    """
    shape = (len(series.rows), len(series.positions), len(series.frames))
    times = np.full(shape, np.nan)
    problems = []
    for index, file in series.indices():
        if file is None:
            continue
        row, s, t = file.index(*_FIELDS)
        stamp = stamps.get((row, s, t))
        if stamp is None:
            problems.append(Problem(file.name, "has no time stamp"))
        else:
            times[index] = stamp
    number = np.arange(shape[2], dtype=np.float64)
    for row, position in product(range(shape[0]), range(shape[1])):
        line = times[row, position]
        known = np.isfinite(line)
        if known.all() or problems:
            continue
        if known.sum() < 2:
            message = f"position {series.positions[position]} has too few images to interpolate the time of the rest"
            problems.append(Problem("planned_time_s", message))
            continue
        line[~known] = np.interp(number[~known], number[known], line[known], left=np.nan, right=np.nan)
        step = float(np.diff(line[known]).mean() / np.diff(number[known]).mean())
        first, last = number[known][0], number[known][-1]
        before, after = ~known & (number < first), ~known & (number > last)
        line[before] = line[int(first)] - step * (first - number[before])
        line[after] = line[int(last)] + step * (number[after] - last)
    if problems:
        raise CaptureError(_bounded(problems), source=series.folder)
    times -= times[tuple((size - 1) // 2 for size in shape)]
    return times if grid else times[0]


def _interval_of(times: Any) -> float | None:
    """Return the median time between frames; None for a single frame."""
    if times is None:
        return None
    steps = np.diff(np.asarray(times, dtype=np.float64), axis=-1)
    interval = float(np.median(steps)) if steps.size else math.nan
    return interval if interval > 0 else None
