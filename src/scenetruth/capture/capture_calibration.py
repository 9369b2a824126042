"""Calibration of a capture: board images of a folder in linear light with the noise of their pixels, and tolerances."""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, StageErrors
from scenetruth.capture.board_check import board_of
from scenetruth.capture.board_reading import BoardReader, in_camera_pixels
from scenetruth.capture.calibration import (
    CalibrationError,
    CalibrationTarget,
    DotGrid,
    Observations,
    RigCalibration,
    RigGuess,
    RigPriors,
    RigSolution,
    TargetView,
    describe_fit,
    fit_rig,
    import_camera,
    observe_boards,
    observe_strip,
)
from scenetruth.capture.calibration.corner_detection import opencv
from scenetruth.capture.calibration.rig_model import INTRINSICS
from scenetruth.capture.capture_file import CaptureLike
from scenetruth.capture.file_patterns import read_pattern
from scenetruth.capture.folder_reading import CaptureFolder, measurement_hash, open_capture, read_table
from scenetruth.capture.measurement_check import compare_measurement
from scenetruth.capture.rectification import calibration_problems
from scenetruth.errors import CaptureError, Problem
from scenetruth.number_format import format_two_digits
from scenetruth.output import check_output, write_atomically
from scenetruth.progress import Progress, say

__all__ = [
    "CALIBRATION_FILE",
    "POINTS_FILE",
    "CaptureGuess",
    "board_problems",
    "calibrate_capture",
    "calibrate_folder",
    "fit_points",
    "load_points",
    "output_files",
    "rig_priors",
    "save_calibration",
    "start_values",
]

Floats = NDArray[np.float64]
CaptureGuess = RigGuess | Camera | RigCalibration | float | str | PathLike[str]
"""Start values of a calibration: focal length in px, a camera, a calibration, or a file with either."""

CALIBRATION_FILE, POINTS_FILE = "calibration.yaml", "calibration_points.npz"
"""Names of the calibration and of the detected points in an output directory."""
_LEAST_POSES, _ADVISED_POSES = 3, 8
_STATED_FOCAL, _STATED_CENTRE_PX = 1e-3, 5.0
_COEFFICIENTS = (*INTRINSICS[3:], "aspect")
_ADVICE = "tilted by 35 to 40° about different axes"


def calibrate_capture(
    capture: CaptureLike,
    *,
    output: str | Path | None = None,
    overwrite: bool = False,
    guess: CaptureGuess | None = None,
    std: Mapping[str, float] | None = None,
    distortion: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> RigCalibration:
    """Calibrate camera and stage from the images of a capture folder.

    Boards are detected in images of linear light: dark frames and flat fields of the capture are applied. The noise of
    every pixel follows from the measured noise of the sensor where dark frames with flat or static frames determine it,
    else from the images. Tolerances of the capture file are the priors: ``stage.errors`` (a screw stage if they are not
    stated), ``stage.step_std``, ``board.scale_std`` and ``board.warp_mm``.

    Parameters
    ----------
    capture
        Folder with a ``capture.yaml``, the path of such a file, or a capture.
    output
        Directory of ``calibration.yaml``, its covariance ``calibration.npz``, and the detected points
        ``calibration_points.npz``; default: no files.
    overwrite
        Replace existing files.
    guess
        Start values: focal length in px, a camera, a calibration, or a file: one of `RigCalibration.save`, or of
        another program (see `scenetruth.capture.calibration.import_camera`). Default: ``camera`` of the capture file.
        Without board images, the camera of the guess is the result, with the standard deviations ``std`` and the
        tolerances of the stage.
    std
        Standard deviations of the intrinsic parameters of a guess without a covariance, by name; default: 0.1 % of the
        focal length and 5 px of the principal point.
    distortion
        Estimated coefficients of the distortion, and ``aspect``; default: k1, k2, p1, p2, and those that the residuals
        ask for.
    progress
        Called with (what, done, total).

    Returns
    -------
    RigCalibration
        The calibration. Its ``warnings`` list everything that speaks against it.

    Raises
    ------
    CaptureError
        If files of the capture do not serve for a calibration; lists every problem before any image is analysed.
    ValueError
        A `CalibrationError` if boards are not detected, contradict each other, or determine too little.
    OutputExistsError
        If an output file exists and ``overwrite`` is not set.

    See Also
    --------
    scenetruth.capture.calibration.calibrate : The calibration of images in memory.
    scenetruth.capture.check_capture : Checks the images in advance.

    Examples
    --------
    A capture without a board, whose camera another program has calibrated:

    >>> from tempfile import TemporaryDirectory
    >>> import imageio.v3 as imageio
    >>> from scenetruth.capture import Capture
    >>> plain = {"camera": {"width": 40, "height": 30}, "frames": {"count": 1}}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "files": {"images": "s{s:+d}.png"}}
    >>> with TemporaryDirectory() as folder:
    ...     for s in (-1, 0, 1):
    ...         imageio.imwrite(f"{folder}/s{s:+d}.png", np.full((30, 40), 100, dtype=np.uint8))
    ...     _ = Path(folder, "cameras.txt").write_text("1 RADIAL 40 30 500 20 15 -0.5 3.0")
    ...     found = calibrate_capture(Capture.from_dict(plain, folder=Path(folder)), guess=f"{folder}/cameras.txt")
    >>> found.value("f"), found.std("f"), found.std("step_scale")
    (500.0, 0.5, 0.0001)
    """
    for file in () if output is None else output_files(Path(output)):
        check_output(file, overwrite=overwrite)
    calibration, solution = calibrate_folder(
        open_capture(capture), guess=guess, std=std, distortion=distortion, progress=progress
    )
    if output is not None:
        save_calibration(calibration, solution, Path(output), overwrite=overwrite)
    return calibration


def output_files(output: Path) -> tuple[Path, ...]:
    """Return the files of a calibration in an output directory."""
    file = output / CALIBRATION_FILE
    return file, file.with_suffix(".npz"), output / POINTS_FILE


def save_calibration(
    calibration: RigCalibration, solution: RigSolution | None, output: Path, *, overwrite: bool
) -> Path:
    """Write a calibration and its points; the file of the calibration is the last, and stands for all of them."""
    output.mkdir(parents=True, exist_ok=True)
    file, _, points = output_files(output)
    if solution is not None:
        with write_atomically(points, overwrite=overwrite) as partial:
            partial.write_bytes(_points_bytes(solution.observed))
    return calibration.save(file, overwrite=overwrite)


def calibrate_folder(
    folder: CaptureFolder,
    *,
    guess: CaptureGuess | None = None,
    std: Mapping[str, float] | None = None,
    distortion: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> tuple[RigCalibration, RigSolution | None]:
    """Return the calibration of an opened folder, and its fit; None without a board."""
    problems = board_problems(folder, has_guess=guess is not None)
    start = start_values(folder, guess, std, problems)
    priors = rig_priors(folder, distortion=distortion, problems=problems)
    if problems:
        raise CaptureError(problems, source=folder.capture.folder)
    if not folder.board:
        assert start is not None
        say("no board images: the given camera is used with its stated standard deviations")
        return _stated_calibration(folder, start, std, priors), None
    solution = fit_points(folder, _detect(folder, progress), start, priors)
    found = replace(describe_fit(solution), bit_depth=folder.images.pixels.bit_depth)
    found = _with_measured_visits(found, folder)
    bits = folder.images.used_bits.describe(folder.images.pixels)
    words = (*found.warnings, *compare_measurement(folder, found), *([bits] if bits else []))
    return replace(found, warnings=words), solution


def _with_measured_visits(found: RigCalibration, folder: CaptureFolder) -> RigCalibration:
    """Return a calibration with the visits of the measurement, if a strip has determined all of them."""
    images = folder.images
    if folder.capture.strip is None:
        return found
    frames, first = len(images.frames), _first_measured(folder)
    visits = tuple(
        tuple(first + position * frames + frame for frame in range(frames)) for position in range(len(images.positions))
    )
    lost = {visit for each in visits for visit in each} - set(found.visits)
    if lost:
        say(f"strip: not detected in {len(lost)} images, so that all visits have the tolerances of the stage")
        return found
    return replace(found, measured_visits=visits, measured_images=measurement_hash(images))


def _first_measured(folder: CaptureFolder) -> int:
    """Return the number of the first visit of the measurement; those of the board precede."""
    return len(folder.board)


def fit_points(
    folder: CaptureFolder, given: Observations, start: RigGuess | RigCalibration | None, priors: RigPriors
) -> RigSolution:
    """Return the fit of detected points of a capture."""
    board = board_of(folder)
    return fit_rig(given, start, priors, board if isinstance(board, DotGrid) else None)


def board_problems(folder: CaptureFolder, *, has_guess: bool = False) -> list[Problem]:
    """Return why the files of a capture do not serve for a calibration."""
    capture, problems = folder.capture, list[Problem]()
    if capture.stage.rows > 1:
        message = "must be 1 for a calibration, whose model has positions along one axis; capture each row by itself"
        problems.append(Problem("stage.rows", message, capture.stage.rows))
    if not folder.board:
        if not has_guess:
            message = (
                "is missing: add images of a board, or import a calibration of another program (--import); without "
                "either, `corrections` of method `refined` correct the poses of the camera only"
            )
            problems.append(Problem("files.board", message))
        return problems
    pattern = read_pattern(capture.files.board or "", ("pose", "s", "row"))
    if "s" in pattern.fields:
        foreign = sorted({s for _, _, s in folder.board} - set(folder.images.positions))
        if foreign:
            message = f"has images at s = {', '.join(map(str, foreign))}, where there are no images of the measurement"
            problems.append(Problem("files.board", message, pattern.text))
    poses = len({pose for pose, _, _ in folder.board})
    if poses < _LEAST_POSES:
        message = f"shows {poses} poses of the board; take {_LEAST_POSES} at least, better {_ADVISED_POSES}, {_ADVICE}"
        problems.append(Problem("files.board", message, pattern.text))
    pixels = folder.images.pixels
    if pixels.bayer is not None and pixels.plane == "mosaic" and "flat" not in folder.sets:
        message = "of a mosaic has pixels of different colours; add flat fields, or set camera.plane to green"
        problems.append(Problem("files.board", message))
    strip_points(folder, problems)
    try:
        opencv()
    except CalibrationError as error:
        problems += error.problems
    for read in (folder.correction, folder.positions_mm):
        try:
            read()
        except CaptureError as error:
            problems += error.problems
    return problems


def strip_points(folder: CaptureFolder, problems: list[Problem]) -> Floats | None:
    """Return the points of the strip about their middle, shape (n, 3); None without a strip, or with a problem."""
    strip = folder.capture.strip
    if strip is None:
        return None
    rows = read_table(Path(strip.file), ("x_mm", "y_mm", "z_mm"), "strip.file", problems)
    points = np.array([[row["x_mm"], row["y_mm"], row["z_mm"]] for row in rows]).reshape(-1, 3)
    if not len(points):
        return None
    return np.asarray(points - (points.max(axis=0) + points.min(axis=0)) / 2)


def start_values(
    folder: CaptureFolder, guess: CaptureGuess | None, std: Mapping[str, float] | None, problems: list[Problem]
) -> RigGuess | RigCalibration | None:
    """Return start values of the intrinsic parameters; None if there is a problem."""
    size = (folder.capture.camera.width, folder.capture.camera.height)
    for name in std or {}:
        if name not in INTRINSICS:
            problems.append(Problem(f"std.{name}", f"must be one of {', '.join(INTRINSICS)}"))
        elif not (std or {})[name] >= 0:
            problems.append(Problem(f"std.{name}", "must not be negative", (std or {})[name]))
    if isinstance(guess, str | PathLike):
        try:
            guess = _read_guess(Path(guess), size)
        except CalibrationError as error:
            problems += [
                Problem(f"{guess}: {each.path}".rstrip(": "), each.message, each.value) for each in error.problems
            ]
            return None
    if isinstance(guess, RigCalibration):
        x_mm = folder.positions_mm()
        problems += calibration_problems(folder.capture, guess, folder.images.pixels, "recorded", x_mm)
        return guess
    if isinstance(guess, Camera):
        if (guess.width, guess.height) != size:
            message = f"has images of {guess.width} x {guess.height} px, not {size[0]} x {size[1]}: another camera"
            problems.append(Problem("guess", message))
        return RigGuess(
            focal_length_px=guess.focal_px, principal_point_px=guess.principal_point, distortion=guess.distortion
        )
    if isinstance(guess, RigGuess):
        return guess
    return _stated_start(folder, guess)


def _read_guess(file: Path, size: tuple[int, int]) -> Camera | RigCalibration:
    """Return the calibration or the camera of a file."""
    try:
        text = file.read_bytes()[:4000].decode("utf-8", errors="replace")
    except OSError as error:
        raise CalibrationError([Problem("", f"cannot be read: {error.strerror or error}")], file) from error
    if "covariance:" in text or text.startswith("format: 1"):
        return RigCalibration.load(file)
    return import_camera(file, size=size)


def _stated_start(folder: CaptureFolder, focal_length_px: float | None) -> RigGuess:
    """Return the camera of the capture file as start values."""
    camera = folder.capture.camera
    if focal_length_px is None and (camera.focal_length_px or camera.focal_length_mm) is not None:
        focal_length_px = camera.to_camera().focal_px
    return RigGuess(
        focal_length_px=focal_length_px, principal_point_px=camera.principal_point_px, distortion=camera.distortion
    )


def rig_priors(
    folder: CaptureFolder,
    *,
    distortion: Sequence[str] | None = None,
    problems: list[Problem] | None = None,
    announced: bool = True,
) -> RigPriors:
    """Return the tolerances of a capture file as priors; ``announced``: state assumed tolerances to the user.

    Tolerances of the guide that are not stated are those of a screw stage. The direction of approach of board images is
    unknown for a bidirectional scan, so that half of the backlash adds to the repeatability.
    """
    stage = folder.capture.stage
    errors = stage.errors or StageErrors(preset="screw_stage")
    if stage.errors is None and announced:
        say("stage.errors: not stated; the tolerances of a screw stage are assumed")
    repeatability = errors.repeatability_um
    if stage.scan == "bidirectional":
        repeatability = float(np.hypot(repeatability, errors.backlash_um / 2))
    changed = errors.model_copy(update={"repeatability_um": repeatability, "backlash_um": 0.0})
    strip = folder.capture.strip
    fresh = None
    if strip is not None:
        # Whatever the stage does, the strip shows it.
        fresh = strip.errors or errors
        fresh = fresh.model_copy(update={"repeatability_um": max(fresh.repeatability_um, repeatability)})
    if distortion is None:
        return RigPriors(errors=changed, step_std=stage.step_std, strip_errors=fresh)
    unknown = [name for name in distortion if name not in _COEFFICIENTS]
    if unknown and problems is not None:
        message = f"must be some of {', '.join(_COEFFICIENTS)}"
        problems.append(Problem("distortion", message, unknown))
    return RigPriors(
        errors=changed, step_std=stage.step_std, strip_errors=fresh, free_distortion=tuple(distortion)
    )  # fmt: skip


def _stated_calibration(
    folder: CaptureFolder, start: RigGuess | RigCalibration, std: Mapping[str, float] | None, priors: RigPriors
) -> RigCalibration:
    """Return a given camera as a calibration, whose stage has its tolerances."""
    if isinstance(start, RigCalibration) and std is None:
        return start
    size = (folder.capture.camera.width, folder.capture.camera.height)
    if isinstance(start, RigCalibration):
        camera = start.camera
    else:
        camera = Camera(
            width=size[0], height=size[1], focal_length_px=start.focal_length_px,
            principal_point_px=start.principal_point_px, distortion=start.distortion,
        )  # fmt: skip
    deviations = std or {
        "f": _STATED_FOCAL * camera.focal_px, "c_x": _STATED_CENTRE_PX, "c_y": _STATED_CENTRE_PX,
    }  # fmt: skip
    return RigCalibration.from_camera(
        camera, folder.positions_mm(), std=deviations, priors=priors, bit_depth=folder.images.pixels.bit_depth
    )


def _detect(folder: CaptureFolder, progress: Progress | None) -> Observations:
    """Return the detected points of all board images."""
    pattern = read_pattern(folder.capture.files.board or "", ("pose", "s", "row"))
    positions = folder.images.positions
    middle = (len(positions) - 1) // 2
    reader = BoardReader.open(folder, progress)
    images = []
    for number, ((pose, _, s), name) in enumerate(sorted(folder.board.items())):
        place = positions.index(s) if "s" in pattern.fields else middle
        images.append(reader.board_image(name, place, pose, number))
    found = observe_boards(images, board_of(folder), folder.positions_mm(), reference=middle)
    if progress is not None:
        progress("detect boards", len(images), len(images))
    found = _with_strip(found, folder, reader)
    for name, share in reader.saturated.items():
        say(
            f"{name}: {format_two_digits(100 * share)} % of the pixels "
            "are saturated, and not used; shorten the exposure"
        )
    return in_camera_pixels(found, folder)


def _with_strip(given: Observations, folder: CaptureFolder, reader: BoardReader) -> Observations:
    """Return observations with the views of the strip in all images of the measurement."""
    points = strip_points(folder, [])
    if points is None or folder.capture.strip is None:
        return given
    pose = 1 + max(pose for pose, _, _ in folder.board)
    files = [(index, file) for index, file in folder.images.indices() if file is not None]
    first, frames = _first_measured(folder), len(folder.images.frames)
    images = [
        reader.board_image(file.name, position, pose, first + position * frames + frame, "detect strip", len(files))
        for (_, position, frame), file in files
    ]
    views = observe_strip(images, points, given.positions_mm)
    strip = folder.capture.strip
    half = float(np.abs(points).max())
    target = CalibrationTarget(name="strip", half_width_mm=half, scale_std=strip.scale_std, warp_mm=strip.warp_mm)
    return replace(given, targets=(*given.targets, target), views=(*given.views, *views))


_ARRAYS = ("first", "points_mm", "pixels", "covariance_px2")


def _points_bytes(given: Observations) -> bytes:
    """Return detected points as the content of an NPZ file."""
    described = {
        "size": [given.width, given.height],
        "positions_mm": given.positions_mm.tolist(),
        "reference": given.reference,
        "targets": [target.model_dump(mode="json") for target in given.targets],
        "views": [
            [view.name, view.position, view.visit, view.pose, view.target, view.direction] for view in given.views
        ],
    }
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, described=np.array(json.dumps(described)), first=given.first, points_mm=given.points_mm,
        pixels=given.pixels, covariance_px2=np.concatenate([view.covariance_px2 for view in given.views]),
    )  # fmt: skip
    return buffer.getvalue()


def load_points(file: str | PathLike[str]) -> Observations:
    """Return the detected points of a calibration; raises `CalibrationError` if the file holds none."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            described: dict[str, Any] = json.loads(str(arrays["described"]))
            first, points, pixels, covariance = (arrays[name] for name in _ARRAYS)
        parts = [slice(int(low), int(high)) for low, high in itertools.pairwise(first)]
        views = [
            TargetView(name, position, visit, pose, points[part], pixels[part], covariance[part], target, direction)
            for (name, position, visit, pose, target, direction), part in zip(described["views"], parts, strict=True)
        ]
        width, height = described["size"]
        return Observations(
            width, height, np.array(described["positions_mm"], dtype=np.float64),
            tuple(CalibrationTarget.model_validate(each) for each in described["targets"]), tuple(views),
            described["reference"],
        )  # fmt: skip
    except CalibrationError:
        raise
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise CalibrationError([Problem("", f"holds no detected points: {error}")], Path(file)) from error
