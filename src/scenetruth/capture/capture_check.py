"""Check of a capture: mistakes that image files and their names show before any calibration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.board_check import (
    BoardStatistics,
    blurred_boards,
    describe_blurred,
    read_boards,
    saturated_boards,
    sharpness,
)
from scenetruth.capture.capture_file import CaptureLike
from scenetruth.capture.corrections import PatternMatch
from scenetruth.capture.folder_reading import CaptureFolder, load_checked_capture, open_capture
from scenetruth.capture.image_reading import FrameMoments
from scenetruth.capture.ingest import list_missing
from scenetruth.capture.measured_noise import sensor_noise
from scenetruth.capture.radiometry import GammaFit, SensorNoise
from scenetruth.capture.response_check import CaptureFinding, Severity, check_response
from scenetruth.errors import CaptureError, Problem
from scenetruth.number_format import format_two_digits
from scenetruth.progress import Progress

__all__ = ["CaptureFinding", "CaptureReport", "check_capture"]

Floats = NDArray[np.float64]

_SATURATED = 1e-3  # share of the pixels of an image
_PLATEAU = 5.0  # ratio of the number of pixels at the largest value to the number at the values below
_UPPER, _ABOVE = 0.8, 0.02
_PART_OF_NOISE = 0.5
_BRIGHTNESS = 0.02
_BELOW_DARK = 0.01  # share of the pixels of an image
_EXPOSURE_RATIO = 1.05
_LEAST_SLOPE = 0.5
_SLOPE_SIGMAS = 3.1
"""Standard deviations at which one of a thousand right dark frames is named, as in the tests of a calibration."""
_BLACK_DN = 2.0
_MAX_DIM = 0.02  # brightest pixel of images that show nothing, as a share of full scale


@dataclass(frozen=True)
class CaptureReport:
    """Result of a check of a capture.

    ``findings``: Errors first, then warnings and notes.
    ``image_count``, ``missing``: Number of images, and names of the missing images.
    ``noise``: Noise of the sensor; None without dark frames.
    ``gamma``: Exponent of the response from the noise; None if there are no frames at rest.

    See Also
    --------
    check_capture : Returns it.

    Examples
    --------
    >>> report = CaptureReport((CaptureFinding("gamma", "error", "exponent 0.45"),), 45)
    >>> report.usable, report.mistakes("error", "warning")
    (False, ['gamma'])
    """

    findings: tuple[CaptureFinding, ...]
    image_count: int
    missing: tuple[str, ...] = ()
    noise: SensorNoise | None = None
    gamma: GammaFit | None = None

    @property
    def usable(self) -> bool:
        """Whether there is no error."""
        return not any(finding.severity == "error" for finding in self.findings)

    def mistakes(self, *severities: Severity) -> list[str]:
        """Return the names of the mistakes of some severities, without repetitions."""
        return list(dict.fromkeys(one.mistake for one in self.findings if one.severity in severities))

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values."""
        noise: dict[str, Any] | None = None
        if self.noise is not None:
            values = {name: value for name, value in vars(self.noise).items() if name != "notes"}
            noise = {name: value if np.isfinite(value) else None for name, value in values.items()}
            noise["notes"] = list(self.noise.notes)
        return {
            "usable": self.usable,
            "images": self.image_count,
            "missing": list(self.missing),
            "findings": [vars(finding) for finding in self.findings],
            "noise": noise,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CaptureReport:
        """Return the report of `to_dict`, without the exponent of the response."""
        noise = values["noise"]
        known: dict[str, Any] | None = None
        if noise is not None:
            known = {name: np.nan if value is None else value for name, value in noise.items() if name != "notes"}
            known["notes"] = tuple(noise.get("notes", ()))
        return cls(
            tuple(CaptureFinding(**finding) for finding in values["findings"]), values["images"],
            tuple(values["missing"]), None if known is None else SensorNoise(**known),
        )  # fmt: skip


@dataclass
class _ImageStatistics:
    """Statistics of all images, collected in one pass.

    ``saturated``: Share of saturated pixels by the name of the file.
    ``medians``: Median by index (row, s, t).
    ``counts``: Number of pixels by value.
    ``below``: Share of pixels darker than the dark frame by more than 5 standard deviations of its noise, by file.
    ``sharpness``: Steepest differences of neighbouring pixels relative to the contrast, by file.
    ``pattern``: How often the pattern of the dark frames is contained in the images; None without dark frames.
    ``count``: Number of images.
    """

    saturated: dict[str, float] = field(default_factory=dict)
    medians: dict[tuple[int, int, int], float] = field(default_factory=dict)
    counts: NDArray[np.int64] | None = None
    below: dict[str, float] = field(default_factory=dict)
    sharpness: dict[str, float] = field(default_factory=dict)
    pattern: PatternMatch | None = None
    count: int = 0


def check_capture(capture: CaptureLike, *, progress: Progress | None = None) -> CaptureReport:
    """Check the image files of a capture for mistakes that they show by themselves.

    Parameters
    ----------
    capture
        Folder with a ``capture.yaml``, the path of such a file, or a capture.
    progress
        Called with the number of images read.

    Returns
    -------
    CaptureReport
        All findings; a folder whose files do not fit has findings of the mistake ``files`` only.

    Raises
    ------
    CaptureError
        If the capture file itself is invalid; lists every problem.

    See Also
    --------
    scenetruth.capture.import_capture : Reads the images as a recording.

    Examples
    --------
    One of six images is missing, and another is saturated:

    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> from scenetruth.capture import Capture
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 100}, "frames": {"count": 2}}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "files": {"images": "s{s:+d}_t{t}.png"}}
    >>> image = np.random.default_rng(1).integers(40, 200, (30, 40)).astype(np.uint8)
    >>> with TemporaryDirectory() as folder:
    ...     for s in (-1, 0, 1):
    ...         for t in (0, 1):
    ...             imageio.imwrite(f"{folder}/s{s:+d}_t{t}.png", np.where(image > 150, 255, image) if t else image)
    ...     Path(folder, "s+1_t0.png").unlink()
    ...     report = check_capture(Capture.from_dict(plain, folder=Path(folder)))
    >>> report.mistakes("error", "warning")
    ['saturated', 'missing_image']
    """
    capture = load_checked_capture(capture)
    try:
        folder = open_capture(capture)
    except CaptureError as error:
        return CaptureReport(tuple(_in_files(error.problems)), 0)
    findings: list[CaptureFinding] = []
    noise, gamma = None, None
    series = folder.images
    if series.missing:
        message = f"{len(series.missing):,} images are missing and will be invalid: {list_missing(series.missing)}"
        findings.append(CaptureFinding("missing_image", "warning", message))
    if not capture.camera.focal_length_px and not capture.camera.focal_length_mm:
        message = "camera.focal_length_px: is missing, which an import without calibration requires"
        findings.append(CaptureFinding("files", "note", message))
    findings += [CaptureFinding("units", "warning", message) for message in folder.describe_units()]
    try:
        statistics = _read_images(folder, progress)
        boards = read_boards(folder, statistics.pattern, progress)
        noise = sensor_noise(folder)
        saturated = _saturation(statistics, folder.dark, noise)
        findings += saturated
        findings += _boards(folder, boards)
        findings += _brightness(folder, statistics)
        findings += _blurred(folder, statistics)
        findings += _encodings(folder)
        if not saturated and (text := series.used_bits.describe(series.pixels)):
            findings.append(CaptureFinding("bit_depth", "warning", text))
        level, dark = _dark(folder, statistics)
        gamma, more = check_response(folder, boards.exponent, usable=not saturated and not dark)
        findings += [*dark, *more]
        if not any(finding.mistake == "gamma" and finding.severity == "error" for finding in more):
            # An encoding also changes level and pattern of the dark frames.
            findings += level
        findings += _flat(folder)
    except CaptureError as error:
        findings += _in_files(error.problems)
    findings += _missing_boards(folder)
    order = ("error", "warning", "note")
    findings.sort(key=lambda finding: order.index(finding.severity))
    return CaptureReport(tuple(findings), len(series.files), series.missing, noise, gamma)


def _in_files(problems: Iterable[Problem]) -> list[CaptureFinding]:
    """Return problems of files as findings, each under the mistake that it shows."""
    found = []
    for problem in problems:
        text = problem.message
        mistake = "turned" if "Exif orientation" in text or "exchanged" in text else "files"
        mistake = "bit_depth" if "bits" in text and mistake == "files" else mistake
        found.append(CaptureFinding(mistake, "error", str(problem)))
    return found


def _read_images(folder: CaptureFolder, progress: Progress | None) -> _ImageStatistics:
    """Read every image once, and return its statistics."""
    series, statistics = folder.images, _ImageStatistics()
    linear = series.pixels.encoding == "linear"
    full, black = series.pixels.full_scale, folder.black()
    mosaic = series.pixels.bayer is not None and series.pixels.plane == "mosaic"
    dark, grey = folder.dark, len(folder.images.shape) == 2
    if dark is not None and dark.count > 1 and linear and grey:
        statistics.pattern = PatternMatch(dark)
    noise = np.sqrt(dark.variance) if dark is not None and dark.count > 1 else np.full(black.shape, np.sqrt(full))
    lowest = black - 5 * np.maximum(noise, 1.0 if linear else 1 / 255)
    counts = np.zeros(int(full) + 1 if linear else 1, dtype=np.int64)
    files = [(index, file) for index, file in series.indices() if file is not None]
    for number, (index, file) in enumerate(files):
        values = series.read(file)
        if linear:
            counts += np.bincount(values.ravel(), minlength=len(counts))
        statistics.saturated[file.name] = float(np.mean(values >= full))
        statistics.below[file.name] = float(np.mean(values < lowest))
        statistics.medians[index] = float(np.median(values) - black.mean())
        if grey and not mosaic:
            statistics.sharpness[file.name] = sharpness(values)
        if statistics.pattern is not None and values.ndim == 2:
            statistics.pattern.add(values)
        statistics.count += 1
        if progress is not None:
            progress("check", number + 1, len(files))
    statistics.counts = counts
    return statistics


def _saturation(
    statistics: _ImageStatistics, dark: FrameMoments | None, noise: SensorNoise | None
) -> list[CaptureFinding]:
    """Return saturated images, images that saturate below full scale, and images that show nothing."""
    shares = {name: share for name, share in statistics.saturated.items() if share > _SATURATED}
    if shares:
        worst = max(shares, key=lambda name: shares[name])
        message = (
            f"{len(shares):,} of {statistics.count:,} images have more than {100 * _SATURATED:g} % of saturated pixels "
            f"(up to {100 * shares[worst]:.3g} % in {worst}): shorten the exposure; saturated pixels are invalid"
        )
        return [CaptureFinding("saturated", "error", message)]
    counts = statistics.counts
    if counts is None or len(counts) < 2:
        return []
    top = int(np.flatnonzero(counts)[-1])
    if top < _MAX_DIM * (len(counts) - 1):
        message = f"no pixel exceeds {top} of {len(counts) - 1}: the images are dark; lengthen the exposure"
        return [CaptureFinding("exposure", "error", message)]
    level, share, spread = _plateau(counts, dark)
    if share <= _SATURATED:
        return []
    message = (
        f"{100 * share:.3g} % of all pixels have nearly the same value of "
        f"{level} DN (± {format_two_digits(spread)}), the largest of "
        f"all, which is below the full scale of {len(counts) - 1}"
    )
    if noise is None or not np.isfinite(noise.gain_dn_per_e):
        message += ": the camera saturates there, or shows a bright uniform surface"
        return [CaptureFinding("saturated", "warning", message)]
    expected = float(np.sqrt(noise.variance_dn2(level)))
    if spread > _PART_OF_NOISE * expected:
        return []
    message += (
        f", with less than the noise of {format_two_digits(expected)} DN that "
        "light of this level has: the camera saturates there. "
        "Shorten the exposure, and correct bit_depth"
    )
    return [CaptureFinding("saturated", "error", message)]


def _plateau(counts: NDArray[np.int64], dark: FrameMoments | None) -> tuple[int, float, float]:
    """Return the level at which values pile up, their share (0 if they do not), and their standard deviation.

    Light that is not cut off has shot noise and an unlimited tail, so that few values lie within the read noise of the
    largest of them.
    """
    noise = 1.0 if dark is None or dark.count < 2 else float(np.sqrt(max(dark.variance.mean(), 0.25)))
    window = 2 * int(np.ceil(3 * noise)) + 1
    near = np.convolve(counts, np.ones(window, dtype=np.int64), mode="same")
    top = int(np.flatnonzero(counts)[-1])
    low = int(_UPPER * top)
    level = low + int(np.argmax(near[low : top + 1]))
    before = near[max(level - 2 * window, 0)]
    above = int(counts[level + window :].sum())
    if near[level] < _PLATEAU * max(before, 1) or above > _ABOVE * near[level]:
        return level, 0.0, 0.0
    places = np.arange(max(level - window, 0), min(level + window + 1, len(counts)))
    weights = counts[places] / counts[places].sum()
    spread = np.sqrt(np.sum(weights * (places - np.sum(weights * places)) ** 2))
    return level, float(near[level] / counts.sum()), float(spread)


def _boards(folder: CaptureFolder, boards: BoardStatistics) -> list[CaptureFinding]:
    """Return saturated and blurred board images."""
    message = saturated_boards(boards)
    found = [CaptureFinding("saturated", "error", f"files.board: {message}")] if message else []
    return found + [CaptureFinding("blurred", "warning", text) for text in blurred_boards(folder, boards)]


def _blurred(folder: CaptureFolder, statistics: _ImageStatistics) -> list[CaptureFinding]:
    """Return images that are less sharp than the other frames of their position."""
    groups = {file.name: index[:2] for index, file in folder.images.indices() if file is not None}
    found = describe_blurred(statistics.sharpness, groups, "frames of its position")
    return [CaptureFinding("blurred", "warning", text) for text in found]


def _brightness(folder: CaptureFolder, statistics: _ImageStatistics) -> list[CaptureFinding]:
    """Return images whose brightness differs from that of the other frames of their position."""
    lines: dict[tuple[int, int], dict[str, float]] = {}
    files = dict(folder.images.indices())
    for (row, s, t), median in statistics.medians.items():
        file = files[row, s, t]
        if file is not None:
            lines.setdefault((row, s), {})[file.name] = median
    found = dict[str, float]()
    for line in lines.values():
        usual = float(np.median(list(line.values())))
        found |= {name: value / usual - 1 for name, value in line.items() if usual > 0}
    off = {name: value for name, value in found.items() if abs(value) > _BRIGHTNESS}
    if not off:
        return []
    worst = max(off, key=lambda name: abs(off[name]))
    message = (
        f"{len(off):,} of {len(found):,} images differ in brightness by more than {100 * _BRIGHTNESS:g} % from the "
        f"other frames of their position (up to {100 * off[worst]:+.3g} % in {worst}): by the scene, or by the light"
    )
    return [CaptureFinding("exposure", "note", message)]


def _encodings(folder: CaptureFolder) -> list[CaptureFinding]:
    """Return files that state another encoding, or a lossy compression."""
    headers: dict[str, Any] = dict(folder.images.headers)
    for frames in folder.sets.values():
        headers |= frames.headers
    found = []
    lossy = [name for name, header in headers.items() if header.lossy]
    if lossy:
        message = f"{len(lossy):,} files are JPEG, whose values are changed by compression: {list_missing(lossy[:3])}"
        found.append(CaptureFinding("gamma", "warning", message + "; store TIFF or PNG"))
    stated = [name for name, header in headers.items() if header.encoding == "srgb"]
    if stated and folder.capture.camera.encoding == "linear":
        message = (
            f"{len(stated):,} files state that they are sRGB, such as {stated[0]}: switch off gamma in the camera, or "
            "set camera.encoding to srgb"
        )
        found.append(CaptureFinding("gamma", "warning", message))
    return found


def _dark(folder: CaptureFolder, statistics: _ImageStatistics) -> tuple[list[CaptureFinding], list[CaptureFinding]]:
    """Return signs that the dark frames do not belong to the images: of their values, and others."""
    dark = folder.dark
    if dark is None:
        return [], []
    camera, frames = folder.capture.camera, folder.sets["dark"]
    of_level, found = list[str](), list[str]()
    level = float(dark.mean.mean())
    if camera.black_level_dn > 0 and camera.encoding == "linear":
        allowed = max(_BLACK_DN, 0.1 * camera.black_level_dn)
        if abs(level - camera.black_level_dn) > allowed:
            message = (
                f"the dark frames have a mean of {level:.4g} DN, but camera.black_level_dn is "
                f"{camera.black_level_dn:g}: light, gamma, another gain or another camera"
            )
            of_level.append(message)
    time, other = folder.exposure_time_s, frames.exposure_time_s(frames.level_at(folder.exposure_time_s))
    if time is not None and other is not None and not 1 / _EXPOSURE_RATIO < other / time < _EXPOSURE_RATIO:
        found.append(f"the dark frames were exposed for {other:g} s, the images for {time:g} s")
    darker = {name: share for name, share in statistics.below.items() if share > _BELOW_DARK}
    if darker:
        worst = max(darker, key=lambda name: darker[name])
        message = (
            f"{len(darker):,} images have pixels that are darker than the dark frames (up to {100 * darker[worst]:.3g} "
            f"% in {worst}): light in the dark frames, or another black level"
        )
        found.append(message)
    slope, std = (np.nan, np.inf) if statistics.pattern is None else statistics.pattern.slope()
    notes = []
    if slope < min(_LEAST_SLOPE, 1 - _SLOPE_SIGMAS * std):
        message = (
            f"the fixed pattern of the dark frames is contained {slope:.2f} ± {std:.2f} times in the images, and not "
            "once: they are from another camera, or of another exposure time or temperature"
        )
        of_level.append(message)
    elif np.isfinite(std) and slope < _SLOPE_SIGMAS * std:
        message = (
            f"files.dark: their fixed pattern is contained {slope:.2f} ± {std:.2f} times in the images, whose noise "
            "hides it: whether they are from this camera is not tested, and has little effect"
        )
        notes.append(CaptureFinding("dark", "note", message))
    errors = (
        [CaptureFinding("dark", "error", f"files.dark: {message}; take new dark frames") for message in messages]
        for messages in (of_level, found)
    )
    return [*next(errors), *notes], next(errors)


def _flat(folder: CaptureFolder) -> list[CaptureFinding]:
    """Return why flat fields do not serve for a correction."""
    try:
        correction = folder.correction()
    except CaptureError as error:
        return [CaptureFinding("flat", "error", str(problem)) for problem in error.problems]
    if correction is None or correction.defects is None or not correction.defects.any():
        return []
    count = int(correction.defects.sum())
    share = format_two_digits(100 * count / correction.defects.size)
    message = f"{count:,} {'pixel is' if count == 1 else 'pixels are'} defective ({share} %), and will be invalid"
    return [CaptureFinding("flat", "note", message)]


def _missing_boards(folder: CaptureFolder) -> list[CaptureFinding]:
    """Return poses of the board whose images are not complete."""
    if not folder.board:
        return []
    positions: Sequence[int] = sorted({s for _, _, s in folder.board})
    rows = sorted({row for _, row, _ in folder.board})
    poses = sorted({pose for pose, _, _ in folder.board})
    lacking = [
        f"pose {pose}, s {s}" for pose in poses for row in rows for s in positions if (pose, row, s) not in folder.board
    ]
    found = []
    if lacking:
        message = f"{len(lacking):,} images of the board are missing: {list_missing(lacking)}"
        found.append(CaptureFinding("board", "warning", message))
    if len(positions) not in (1, len(folder.images.positions)):
        message = f"the board was taken at {len(positions)} of {len(folder.images.positions)} positions"
        found.append(CaptureFinding("board", "note", message))
    return found
