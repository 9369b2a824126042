"""The folder of a capture: all its image files, their correction and their geometry."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import StageErrors
from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.capture_file import Capture, CaptureCamera, CaptureLike, CaptureReading, read_capture
from scenetruth.capture.corrections import FixedPatternCorrection, correction_problems
from scenetruth.capture.file_patterns import IMAGE_SUFFIXES, TIME_FIELD, FilePattern, list_names, read_pattern
from scenetruth.capture.image_reading import (
    FrameMoments,
    ImageHeader,
    PixelFormat,
    UsedBits,
    frame_moments,
    header_problems,
    read_header,
    read_pixels,
)
from scenetruth.capture.ingest import ImageSeries, RecordingPlan, collect_images, no_match_message, times_of
from scenetruth.capture.radiometry import find_defects
from scenetruth.capture.rectification import (
    Geometry,
    Rectification,
    calibration_problems,
    estimate_distance_mm,
    recorded_geometry,
)
from scenetruth.errors import CaptureError, Problem
from scenetruth.scene.picture_file import PictureFileError
from scenetruth.schema import tolerance_attributes
from scenetruth.schema.plausible_units import describe_distance, describe_rig

__all__ = ["CaptureFolder", "FrameSet", "load_checked_capture", "measurement_hash", "open_capture", "read_table"]

Floats = NDArray[np.float64]

_SETS = ("dark", "flat", "static")
_DEFECT_FRAMES = 4
_HALF = 0.5
_COINCIDE = 1e-3  # smallest step relative to the planned baseline
_DISTANT = 1e6  # depth of a distant plane in mm per px of focal length


@dataclass(frozen=True, eq=False)
class FrameSet:
    """Repeated frames without light, of a flat field or of a static scene, by exposure level.

    ``levels``: Names of the files of each level; level 0 if the pattern has none.
    ``headers``: Headers by the name of the file.
    ``exposure_times_s``: Exposure time of each level, if it is stated.
    ``used_bits``: Bits of all values read so far, those of the images included.
    """

    folder: Path
    levels: Mapping[int, tuple[str, ...]]
    headers: Mapping[str, ImageHeader]
    pixels: PixelFormat
    exposure_times_s: Mapping[int, float] = field(default_factory=dict)
    used_bits: UsedBits = field(default_factory=UsedBits)
    _moments: dict[int, FrameMoments] = field(default_factory=dict, repr=False)

    def frames(self, level: int) -> Iterator[NDArray[Any]]:
        """Yield the frames of a level."""
        for name in self.levels[level]:
            try:
                values = read_pixels(self.folder / name)
            except PictureFileError as error:
                raise CaptureError([Problem(name, str(error))], source=self.folder) from error
            self.used_bits.add(values, name, self.pixels, self.folder)
            yield self.pixels.convert(values)

    def moments(self, level: int) -> FrameMoments:
        """Return the moments of the frames of a level, which are read once."""
        if level not in self._moments:
            self._moments[level] = frame_moments(self.frames(level))
        return self._moments[level]

    def exposure_time_s(self, level: int) -> float | None:
        """Return the exposure time of a level: stated, or that of its files."""
        if level in self.exposure_times_s:
            return self.exposure_times_s[level]
        times = {self.headers[name].exposure_time_s for name in self.levels[level]}
        return times.pop() if len(times) == 1 else None

    def level_at(self, time_s: float | None) -> int:
        """Return the level of an exposure time; the only one, or the nearest in the logarithm of the time."""
        times = {level: self.exposure_time_s(level) for level in self.levels}
        if len(times) == 1 or time_s is None:
            return next(iter(times))
        return min(times, key=lambda level: abs(math.log((times[level] or 1e9) / time_s)))


@dataclass(frozen=True, eq=False)
class CaptureFolder:
    """All image files of a capture, with headers that were checked.

    ``board``: Files of the calibration board by (pose, row, s).
    """

    capture: Capture
    images: ImageSeries
    sets: Mapping[str, FrameSet]
    board: Mapping[tuple[int, int, int], str]

    @cached_property
    def exposure_time_s(self) -> float | None:
        """Exposure time of the images: that of the capture file, or of all their headers."""
        if self.capture.camera.exposure_time_s is not None:
            return self.capture.camera.exposure_time_s
        times = {header.exposure_time_s for header in self.images.headers.values()}
        return times.pop() if len(times) == 1 else None

    @cached_property
    def dark(self) -> FrameMoments | None:
        """Moments of the dark frames of the exposure of the images."""
        dark = self.sets.get("dark")
        return None if dark is None else dark.moments(dark.level_at(self.exposure_time_s))

    def black(self) -> Floats:
        """Return the mean dark frame, or the black level everywhere."""
        if self.dark is not None:
            return self.dark.mean
        level = self.capture.camera.black_level_dn
        return np.full(self.images.shape, level * self.images.pixels.full_scale / (2**self.images.pixels.bit_depth - 1))

    def light_of_flat(self, level: int) -> Floats:
        """Return the mean flat field of a level less the dark frame of its exposure."""
        flat, dark = self.sets["flat"], self.sets.get("dark")
        black = (
            self.black() if dark is None else dark.moments(dark.level_at(flat.exposure_time_s(level))).mean
        )  # fmt: skip
        return np.asarray(flat.moments(level).mean - black)

    def flat_level(self) -> int | None:
        """Return the level of the brightest flat field that is not saturated, None if there is none."""
        flat = self.sets.get("flat")
        if flat is None:
            return None
        full = self.images.pixels.full_scale
        usable = [level for level in flat.levels if float(np.mean(flat.moments(level).highest >= full)) == 0.0]
        return max(usable, key=lambda level: float(flat.moments(level).mean.mean()), default=None)

    def correction(self) -> FixedPatternCorrection | None:
        """Return the correction by dark frames and flat fields; None without both.

        Raises
        ------
        CaptureError
            If they do not serve for a correction.
        """
        flat_level = self.flat_level()
        if self.dark is None and "flat" not in self.sets:
            return None
        full, dark = self.images.pixels.full_scale, self.black()
        flat = None if flat_level is None else self.light_of_flat(flat_level) + dark
        problems = correction_problems(dark, flat, full)
        if "flat" in self.sets and flat_level is None:
            problems.append(Problem("files.flat", "every flat field is saturated; take them with a shorter exposure"))
        if problems:
            raise CaptureError(problems, source=self.capture.folder)
        return FixedPatternCorrection(dark, flat, full, self._defects(flat_level))

    def _defects(self, flat_level: int | None) -> NDArray[np.bool_] | None:
        """Return the defective pixels; None without enough dark frames."""
        if self.dark is None or self.dark.count < _DEFECT_FRAMES or self.dark.mean.ndim != 2:
            return None
        moments = None if flat_level is None else self.sets["flat"].moments(flat_level)
        mosaic = self.images.pixels.bayer is not None and self.images.pixels.plane == "mosaic"
        # The colours of a mosaic differ in sensitivity.
        usable = moments is not None and moments.count >= _DEFECT_FRAMES and not mosaic
        return find_defects(self.dark, moments if usable else None)

    def positions_mm(self) -> Floats:
        """Return the camera positions along the stage: measured, or planned; raises `CaptureError`."""
        problems: list[Problem] = []
        measured = _positions(self, problems)
        if problems:
            raise CaptureError(problems, source=self.capture.folder)
        return self.capture.stage.x_mm if measured is None else measured

    def plan(
        self,
        *,
        correct: bool = True,
        calibration: RigCalibration | None = None,
        geometry: Geometry = "rectified",
    ) -> RecordingPlan:
        """Return the recording that the folder makes, with a calibration rectified or with its lens.

        Raises
        ------
        CaptureError
            If the focal length is missing, a table of positions or times does not fit, or the calibration is that of
            another rig; lists every problem.
        """
        problems: list[Problem] = []
        if calibration is not None:
            x_mm = self.positions_mm()
            problems += calibration_problems(self.capture, calibration, self.images.pixels, geometry, x_mm)
        stated = _geometry(self, problems, calibrated=calibration is not None)
        if problems:
            raise CaptureError(problems, source=self.capture.folder)
        plan = RecordingPlan(self.images, stated, self.correction() if correct else None)
        if calibration is None:
            return plan
        if geometry == "recorded":
            return replace(plan, geometry=_joined(stated, recorded_geometry(self.capture, calibration)))
        return self._rectified(plan, calibration)

    def _rectified(self, plan: RecordingPlan, calibration: RigCalibration) -> RecordingPlan:
        """Return a recording that is resampled to the ideal rig of a calibration."""
        images, given = self.images, self.capture
        height, width, *_ = images.shape
        visits = None
        if calibration.measured_visits and calibration.measured_images == measurement_hash(images):
            # A strip has determined the pose of every image.
            calibration = calibration.measured()
            visits = {
                (position, frame): visit
                for position, each in enumerate(calibration.measured_visits)
                for frame, visit in enumerate(each)
            }
        distant = _DISTANT * calibration.value("f")
        far = Rectification(calibration, images.pixels, (height, width), distant, visits)
        depth = given.distance_mm if given.distance_mm is not None else self._distance_mm(plan, far)
        rectification = replace(far, depth_mm=depth)
        return replace(
            plan, geometry=_joined(plan.geometry, rectification.geometry(given)), rectification=rectification
        )

    def _distance_mm(self, plan: RecordingPlan, far: Rectification) -> float:
        """Return the distance of the surface, from the first frame that two neighbouring positions have."""
        files, places = dict(self.images.indices()), range(len(self.images.positions))
        middle = (len(places) - 1) // 2
        pairs = [(middle, middle + 1), (middle - 1, middle), *pairwise(places)]
        if len(places) == 1:
            # Without a second position, the depth of the plane has no effect.
            return far.depth_mm
        for (one, other), frame in product(pairs, range(len(self.images.frames))):
            found = [files.get((0, place, frame)) for place in (one, other)]
            if None in found:
                continue
            here, there = (
                far.apply(plan.image(file), place, frame) for place, file in zip((one, other), found, strict=True)
            )
            along = far.calibration.positions_mm[other] - far.calibration.positions_mm[one]
            focal = far.calibration.value("f") / far.pixels.step
            distance = estimate_distance_mm(here, there, focal, float(far.step * along))
            if distance is not None:
                return distance
            break
        message = "is missing, and the images do not determine it: measure the distance of the surface"
        raise CaptureError([Problem("distance_mm", message)], source=self.capture.folder)

    def describe_units(self) -> list[str]:
        """Return which values of the capture file are likely to be in another unit; empty if none is."""
        capture = self.capture
        camera, stage = capture.camera, capture.stage
        lens = None if camera.focal_length_px is None and camera.focal_length_mm is None else camera.to_camera()
        found = []
        if lens is not None:
            found += describe_rig(lens.focal_px, stage.baseline_mm, camera.width, camera.height)
        if capture.distance_mm is not None:
            focal = None if lens is None else lens.focal_px
            found += describe_distance(capture.distance_mm, focal, stage.baseline_mm, camera.width, stage.positions)
        return found


def _joined(stated: Mapping[str, Any], calibrated: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments of `make_recording` that a calibration replaces in part; attributes are joined."""
    attrs = {**stated.get("attrs", {}), **calibrated.get("attrs", {})}
    return {**stated, **calibrated, **({"attrs": attrs} if attrs else {})}


def measurement_hash(images: ImageSeries) -> str:
    """Return a hash of the first and the last image, by which a measurement is recognised."""
    files = [images.files[index] for index in sorted(images.files)]
    contents = [(images.folder / file.name).read_bytes() for file in (files[0], files[-1])]
    return hashlib.sha256(b"".join(contents)).hexdigest()


def load_checked_capture(capture: CaptureLike) -> Capture:
    """Load a capture as `load_capture` does; the error of an invalid one also lists the problems of its files."""
    reading = read_capture(capture)
    if reading.problems and reading.valid_part is not None:
        raise CaptureError([*reading.problems, *_find_file_problems(reading)], source=reading.source)
    return reading.required()


def _find_file_problems(reading: CaptureReading) -> list[Problem]:
    """Return the problems of the files that the valid fields of an invalid capture name."""
    capture, is_wrong = reading.valid_part, reading.repair.is_wrong
    assert capture is not None
    problems = _table_problems(capture)
    try:
        names = _list_images(capture)
    except CaptureError as error:
        return [*problems, *error.problems]
    camera = None if is_wrong("camera") else capture.camera
    for name, fields in _PATTERN_FIELDS.items():
        text = getattr(capture.files, name)
        if text is None or ("files", name) in reading.repair.wrong or ("files",) in reading.repair.wrong:
            continue
        matched = read_pattern(text, fields).matches(names)
        if not matched:
            problems.append(Problem(f"files.{name}", no_match_message(read_pattern(text, fields), names), text))
        problems += _checked_headers(capture.folder, [one.name for one in matched], camera)[1]
    return problems


def _list_images(capture: Capture) -> list[str]:
    folder = capture.folder
    try:
        return list_names(folder, suffixes=IMAGE_SUFFIXES) if folder.is_dir() else []
    except (OSError, ValueError) as error:
        raise CaptureError([Problem("", f"the folder cannot be used: {error}")], source=folder) from error


def _table_problems(capture: Capture) -> list[Problem]:
    """Return the problems of tables and of the mask that do not depend on the images."""
    problems: list[Problem] = []
    stage, frames, files = capture.stage, capture.frames, capture.files
    if stage.positions_file is not None:
        read_table(Path(stage.positions_file), ("s", "x_mm"), "stage.positions_file", problems)
    if frames.times_file is not None:
        names = ("row", "s", "t", "time_s") if stage.rows > 1 else ("s", "t", "time_s")
        read_table(Path(frames.times_file), names, "frames.times_file", problems)
    if capture.strip is not None:
        read_table(Path(capture.strip.file), ("x_mm", "y_mm", "z_mm"), "strip.file", problems)
    if files.mask is not None:
        try:
            read_pixels(Path(files.mask))
        except PictureFileError as error:
            problems.append(Problem("files.mask", str(error), files.mask))
    return problems


def open_capture(capture: CaptureLike) -> CaptureFolder:
    """Return the files of a capture after a check of their names and headers.

    Raises
    ------
    CaptureError
        If files are missing as a whole, or any of them cannot be used; lists every problem.
    """
    capture = load_checked_capture(capture)
    folder, files = capture.folder, capture.files
    names = _list_images(capture)
    size, pixels = (capture.camera.width, capture.camera.height), capture.camera.pixels
    problems: list[Problem] = []
    images = None
    try:
        images = collect_images(
            folder,
            read_pattern(files.images, _PATTERN_FIELDS["images"]),
            pixels,
            rows=capture.stage.rows,
            positions=capture.stage.positions,
            frames=capture.frames.count,
            first_position=files.first_position,
            first_frame=files.first_frame,
            size=size,
            path="files.images",
            names=names,
        )
    except CaptureError as error:
        problems += error.problems
    sets = {}
    for name in _SETS:
        text = getattr(files, name)
        if text is not None:
            found = _frame_set(name, folder, read_pattern(text, _PATTERN_FIELDS[name]), names, capture, problems)
            if found is not None:
                sets[name] = found if images is None else replace(found, used_bits=images.used_bits)
    board: dict[tuple[int, int, int], str] = {}
    if files.board is not None:
        pattern = read_pattern(files.board, _PATTERN_FIELDS["board"])
        matched = pattern.matches(names)
        if not matched:
            problems.append(Problem("files.board", no_match_message(pattern, names), files.board))
        _, found_problems = _checked_headers(folder, [one.name for one in matched], capture.camera)
        problems += found_problems
        for one in matched:
            pose, row, s = one.index("pose", "row", "s")
            board[pose, row, s] = one.name
    problems += _table_problems(capture)
    if problems or images is None:
        raise CaptureError(problems, source=folder)
    return CaptureFolder(capture, images, sets, board)


_PATTERN_FIELDS = {
    "images": ("s", "t", "row", TIME_FIELD),
    "board": ("pose", "s", "row"),
    **dict.fromkeys(_SETS, ("level",)),
}


def _frame_set(
    name: str, folder: Path, pattern: FilePattern, names: Sequence[str], capture: Capture, problems: list[Problem]
) -> FrameSet | None:
    matched = pattern.matches(names)
    path = f"files.{name}"
    if not matched:
        problems.append(Problem(path, no_match_message(pattern, names), pattern.text))
        return None
    levels: dict[int, list[str]] = {}
    for one in matched:
        levels.setdefault(one.indices.get("level", 0), []).append(one.name)
    stated = capture.files.exposure_times_s
    times = {}
    if stated and len(levels) > 1:
        if len(stated) != len(levels):
            message = f"has {len(stated)} times for the {len(levels)} levels of {path}"
            problems.append(Problem("files.exposure_times_s", message, list(stated)))
        times = dict(zip(sorted(levels), stated, strict=False))
    headers, found = _checked_headers(folder, [one.name for one in matched], capture.camera)
    problems += found
    ordered = {level: tuple(files) for level, files in sorted(levels.items())}
    return FrameSet(folder, ordered, headers, capture.camera.pixels, times)


def _checked_headers(
    folder: Path, names: Sequence[str], camera: CaptureCamera | None
) -> tuple[dict[str, ImageHeader], list[Problem]]:
    """Return the headers of files and their problems; without a camera, of those that cannot be read."""
    headers, problems = {}, []
    for name in names:
        try:
            headers[name] = read_header(folder / name)
            if camera is not None:
                problems += header_problems(name, headers[name], camera.pixels, (camera.width, camera.height))
        except PictureFileError as error:
            problems.append(Problem(name, str(error)))
    return headers, problems


def _geometry(folder: CaptureFolder, problems: list[Problem], *, calibrated: bool = False) -> dict[str, Any]:
    """Return the arguments of `make_recording` that a capture states; with a calibration, without those of the lens."""
    capture, images = folder.capture, folder.images
    camera, stage, frames = capture.camera, capture.stage, capture.frames
    grid = stage.rows > 1
    given: dict[str, Any] = {
        "baseline_mm": stage.baseline_mm,
        "frame_interval_s": frames.frame_interval_s,
        "line_time_s": camera.line_time_s,
        "stage_x_mm": _positions(folder, problems),
        "stage_y_mm": stage.y_mm if grid else None,
    }
    if calibrated:
        pass
    elif camera.focal_length_px is None and camera.focal_length_mm is None:
        message = "is missing: give focal_length_px, or focal_length_mm with pixel_pitch_um"
        problems.append(Problem("camera.focal_length_px", message))
    else:
        lens = camera.to_camera()
        given["focal_length_px"] = lens.focal_px
        given["principal_point_px"] = lens.principal_point
        if lens.distortion is not None:
            given["distortion"] = list(lens.distortion.coefficients)
    if capture.distance_mm is not None:
        given["attrs"] = {"distance_mm": capture.distance_mm}
    std = {"focal_length_std_px": camera.focal_length_std_px, "principal_point_std_px": camera.principal_point_std_px}
    given["lens_tolerances"] = {name: value for name, value in std.items() if value}
    given["stage_tolerances"] = _tolerances(capture)
    given["planned_time_s"] = _times(folder, problems)
    if capture.files.mask is not None:
        given["exclusion_mask"] = _mask(Path(capture.files.mask), images, problems)
    return {name: value for name, value in given.items() if value is not None}


def _tolerances(capture: Capture) -> dict[str, float]:
    errors = capture.stage.errors or StageErrors()
    found = errors.model_dump(exclude={"preset"})
    if capture.stage.scan == "unidirectional":
        # All positions are approached from the same side.
        del found["backlash_um"]
    found["scale_ppm"] = 1e6 * capture.stage.step_std
    assert set(tolerance_attributes(found))
    return {name: value for name, value in found.items() if value > 0}


def _positions(folder: CaptureFolder, problems: list[Problem]) -> Floats | None:
    """Return the camera positions: measured, or planned where they are not equidistant."""
    stage, images = folder.capture.stage, folder.images
    if stage.positions_file is None:
        return stage.x_mm if stage.positions_mm is not None else None
    file = Path(stage.positions_file)
    rows = read_table(file, ("s", "x_mm"), "stage.positions_file", problems)
    listed = {int(row["s"]): row["x_mm"] for row in rows}
    names = [int(row["s"]) for row in rows]
    twice = sorted({s for s in names if names.count(s) > 1})
    if twice:
        message = f"lists the positions s = {', '.join(map(str, twice))} more than once: keep one line for each"
        problems.append(Problem("stage.positions_file", message, str(file)))
        return None
    lacking = [str(s) for s in images.positions if s not in listed]
    if rows and lacking:
        message = f"lacks the positions s = {', '.join(lacking)} of the images"
        problems.append(Problem("stage.positions_file", message, str(file)))
    if not rows or lacking:
        return None
    x_mm = np.array([listed[s] for s in images.positions])
    near = np.abs(np.diff(x_mm)) < _COINCIDE * abs(stage.baseline_mm)
    if near.any():
        place = int(near.argmax())
        message = (
            f"positions s = {images.positions[place]} and {images.positions[place + 1]} are at {x_mm[place]:g} and "
            f"{x_mm[place + 1]:g} mm: they coincide; correct the table"
        )
        problems.append(Problem("stage.positions_file", message, str(file)))
        return None
    x_mm -= x_mm[(len(x_mm) - 1) // 2]
    far = np.abs(x_mm - stage.x_mm)
    if (far > 0.5 * abs(stage.baseline_mm)).any():
        worst = int(far.argmax())
        message = (
            f"position s = {images.positions[worst]} is {x_mm[worst]:g} mm from the reference, but "
            f"{stage.x_mm[worst]:g} mm are planned: correct positions_mm, or the unit or order of the table"
        )
        problems.append(Problem("stage.positions_file", message, str(file)))
    return x_mm


def _times(folder: CaptureFolder, problems: list[Problem]) -> Floats | None:
    """Return the time of every image, 0 at the reference; None if all images of a frame are simultaneous."""
    capture, images = folder.capture, folder.images
    stage, frames = capture.stage, capture.frames
    grid = stage.rows > 1
    if frames.times == "planned":
        if stage.time_per_position_s == 0:
            return None
        times = np.array(
            [
                [
                    [
                        t * frames.frame_interval_s
                        + (stage.number_in_scan(s, t, row) - stage.number_in_scan(0, t)) * stage.time_per_position_s
                        for t in frames.t.tolist()
                    ]
                    for s in stage.s.tolist()
                ]
                for row in stage.s_y.tolist()
            ]
        )
        return times if grid else times[0]
    stamps: dict[tuple[int, int, int], float | None]
    if frames.times == "file":
        assert frames.times_file is not None
        names = ("row", "s", "t", "time_s") if grid else ("s", "t", "time_s")
        rows = read_table(Path(frames.times_file), names, "frames.times_file", problems)
        stamps = {(int(row.get("row", 0)), int(row["s"]), int(row["t"])): row["time_s"] for row in rows}
    elif frames.times == "name":
        stamps = {index: file.time_s for index, file in images.files.items()}
    else:
        stamps = {index: images.headers[file.name].taken_s for index, file in images.files.items()}
        resolution = max(images.headers[file.name].resolution_s for file in images.files.values())
        if resolution > _MOST_RESOLUTION * frames.frame_interval_s:
            message = (
                f"the times of the files have a resolution of {resolution:g} s, which is too coarse for frames every "
                f"{frames.frame_interval_s:g} s: use names, a table, or the plan"
            )
            problems.append(Problem("frames.times", message, "exif"))
    if problems:
        return None
    try:
        return times_of(images, stamps, grid=grid)
    except CaptureError as error:
        problems += error.problems
        return None


_MOST_RESOLUTION = 0.1


def _mask(file: Path, images: ImageSeries, problems: list[Problem]) -> NDArray[np.bool_] | None:
    try:
        values = read_pixels(file)
    except PictureFileError as error:
        problems.append(Problem("files.mask", str(error), str(file)))
        return None
    expected = (images.header.height, images.header.width)
    if values.shape != expected:
        message = f"must be a grey image of {expected[1]} x {expected[0]} px"
        problems.append(Problem("files.mask", message, values.shape[::-1]))
        return None
    return np.asarray(values != 0)


def read_table(file: Path, columns: Sequence[str], path: str, problems: list[Problem]) -> list[dict[str, float]]:
    """Return the rows of a CSV file as numbers; empty after appending a problem."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            heads = [(name or "").strip() for name in reader.fieldnames or ()]
            lacking = [name for name in columns if name not in heads]
            if lacking:
                message = f"lacks the columns {', '.join(lacking)}; it has {', '.join(heads) or 'none'}"
                problems.append(Problem(path, message, str(file)))
                return []
            rows = [dict(zip(heads, row.values(), strict=False)) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        problems.append(Problem(path, f"cannot be read: {getattr(error, 'strerror', None) or error}", str(file)))
        return []
    found = []
    for number, row in enumerate(rows):
        values = {}
        for name in columns:
            text = str(row.get(name) or "").strip()
            try:
                values[name] = float(text)
            except ValueError:
                values[name] = math.nan
            whole = name in ("row", "s", "t")
            if not math.isfinite(values[name]) or (whole and values[name] != int(values[name])):
                kind = "an integer" if whole else "a number"
                problems.append(Problem(path, f"line {number + 2}: {name} must be {kind} with a decimal point", text))
                return []
        found.append(values)
    if not found:
        problems.append(Problem(path, "has no rows", str(file)))
    return found
