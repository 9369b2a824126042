"""Comparison of the images of a capture with a calibration: direction, vertical parallax, distance, strip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from scenetruth.capture.calibration import CalibrationError, RigCalibration
from scenetruth.capture.calibration.corner_detection import opencv
from scenetruth.capture.folder_reading import CaptureFolder, measurement_hash
from scenetruth.capture.ingest import RecordingPlan
from scenetruth.capture.rectification import Rectification, recorded_pixels
from scenetruth.number_format import format_two_digits

__all__ = ["compare_measurement", "contradictions"]

Floats = NDArray[np.float64]

_BLOCK_PX, _MOST_BLOCKS = 40, 12  # along either axis
_ABOVE_PX = 10  # largest vertical parallax that is searched
_LEAST_PEAK = 0.8
_LEAST_MATCHES = 8
_LEAST_SHIFT_PX = 1.0
_CLEAR_SHARE = 0.8
_SMALL_PX, _LARGE_PX, _SIGMAS = 0.04, 0.1, 5.0
_DISTANT = 1e6  # depth of a distant plane in mm per px of focal length
_CONTRAST = 0.02  # standard deviation of a block relative to the brightness
_SMOOTH_PX = 0.7
_MOST_PAIRS = 4
_CLEAR_SHIFT_PX, _RATIO = 5.0, 1.25
_IMPROBABLE = 1e-6
_ROUNDING = 1e-9
_TURNS = (
    "pitch",
    "yaw",
    "roll",
    "y",
    "z",
)  # of a visit, all but the repeatability
_MOVING = ("axis", "position")  # parameters that displace images across the stage


@dataclass(frozen=True, eq=False)
class _Matches:
    """Displacements of the blocks of an image in another: along x, along y, in px."""

    x: Floats
    y: Floats

    @property
    def parallax(self) -> tuple[float, float]:
        """Median along y, and its standard deviation."""
        middle = float(np.median(self.y))
        spread = 1.4826 * float(np.median(np.abs(self.y - middle)))
        return middle, 1.2533 * spread / float(np.sqrt(len(self.y)))


@dataclass(frozen=True)
class _Parallax:
    """Displacement of an image against the reference position, along and across the stage, in px."""

    name: str
    place: int
    along: float
    across: float
    std: float


def compare_measurement(folder: CaptureFolder, calibration: RigCalibration) -> list[str]:
    """Return what the images of the measurement show against the calibration, in words; empty if they agree.

    Images of one frame are rectified through a distant plane, where a scene at rest moves along X only, to the left
    where the camera moves to the right. Blocks of the reference image are searched in the others.
    """
    given, pixels = folder.images, folder.images.pixels
    if calibration.measured_visits and calibration.measured_images == measurement_hash(given):
        return _compare_strip(calibration)
    if len(given.positions) < 2 or (pixels.bayer and pixels.plane == "mosaic"):
        return []
    try:
        opencv()
    except CalibrationError:
        return []
    files = dict(given.indices())
    middle, frame = (len(given.positions) - 1) // 2, (len(given.frames) - 1) // 2
    reference = files.get((0, middle, frame))
    others = [place for place in _nearest_places(len(given.positions), middle) if files.get((0, place, frame))]
    if reference is None or not others or len(given.rows) > 1:
        return []
    height, width, *_ = given.shape
    rectification = Rectification(calibration, pixels, (height, width), _DISTANT * calibration.value("f"))
    plan = RecordingPlan(given, {}, folder.correction())

    def image(place: int) -> NDArray[np.float32]:
        file = files[0, place, frame]
        assert file is not None
        return _grey(rectification.apply(plan.image(file), place, frame))

    here = image(middle)
    along = calibration.positions_mm - calibration.positions_mm[middle]
    against, parallaxes = list[bool](), list[_Parallax]()
    for place in others:
        found = _match_blocks(here, image(place))
        if len(found.x) < _LEAST_MATCHES:
            continue
        shift = float(np.median(found.x))
        clear = float(np.mean(np.sign(found.x) == np.sign(shift)))
        if abs(shift) > _LEAST_SHIFT_PX and clear > _CLEAR_SHARE:
            against.append(shift * along[place] > 0)
        file = files[0, place, frame]
        assert file is not None
        parallaxes.append(_Parallax(file.name, place, shift, *found.parallax))
    if against and all(against):
        return [
            "images of the measurement: move in the opposite direction of those of the board: were they turned by half "
            "a turn, mirrored, or numbered against the direction of the stage? Turn them, or reverse the positions"
        ]
    if not parallaxes:
        return []
    return [*_describe_parallax(calibration, parallaxes), *_describe_distance(folder, calibration, parallaxes)]


def _describe_distance(
    folder: CaptureFolder, calibration: RigCalibration, parallaxes: Sequence[_Parallax]
) -> list[str]:
    """Return whether the displacements along the stage are those of another distance than is stated."""
    stated, clear = folder.capture.distance_mm, [each for each in parallaxes if abs(each.along) > _CLEAR_SHIFT_PX]
    if stated is None or not clear:
        return []
    seen = float(_usual_point(calibration, clear)[2])
    if 1 / _RATIO < seen / stated < _RATIO:
        return []
    return [
        f"images of the measurement: are displaced as those of a surface at {seen:.3g} mm, but distance_mm is "
        f"{stated:g}: use the calibration of this camera and lens, check the size of the board, or correct distance_mm"
    ]


def contradictions(folder: CaptureFolder, calibration: RigCalibration) -> list[str]:
    """Return what a capture and its images show against a calibration, without what that states itself."""
    found = compare_measurement(folder, calibration)
    camera = folder.capture.camera
    if camera.focal_length_px is not None or camera.focal_length_mm is not None:
        stated, calibrated = camera.to_camera().focal_px, calibration.value("f")
        # Close objects need a longer image distance than the focal length of the lens.
        if not 1 / _RATIO < calibrated / stated < _RATIO:
            found.append(
                f"calibration: has a focal length of {calibrated:.5g} px, but that of the capture file is "
                f"{stated:.5g} px: use the calibration of this camera and lens, or correct camera.focal_length_px"
            )
    return [text for text in found if text not in calibration.warnings]


def _usual_point(calibration: RigCalibration, parallaxes: Sequence[_Parallax]) -> Floats:
    """Return a point on the optical axis at the median depth of the displacements along the stage, in mm."""
    focal = calibration.value("f")
    along = np.abs(calibration.positions_mm - calibration.positions_mm[calibration.reference])
    depths = [min(focal * along[each.place] / max(abs(each.along), _LEAST_SHIFT_PX), _DISTANT * focal)
              for each in parallaxes]  # fmt: skip
    return np.array([0.0, 0.0, float(np.median(depths))])


def _expected_across(calibration: RigCalibration, point: Floats, places: Sequence[int]) -> Floats:
    """Return the displacements of a point across the stage that a rectification through a distant plane leaves, in px.

    It corrects the turns of the camera, not the deviations of its positions from a straight line.
    """
    distant = point * (_DISTANT * calibration.value("f") / point[2])

    def left(place: int) -> float:
        near, far = (recorded_pixels(calibration, each, place)[1] for each in (point, distant))
        return float(near - far)

    return np.array([left(place) for place in places]) - left(calibration.reference)


def _parallax_covariance(calibration: RigCalibration, parallaxes: Sequence[_Parallax], point: Floats) -> Floats:
    """Return the covariance in px² of displacements across the stage: calibration, new visits and matching."""
    focal, reference = calibration.value("f"), calibration.reference

    def across(given: RigCalibration) -> Floats:
        rows = [recorded_pixels(given, point, each.place)[1] for each in parallaxes]
        return np.asarray(np.array(rows) - recorded_pixels(given, point, reference)[1])

    chosen = [
        n for n, name in enumerate(calibration.names) if name.startswith(_MOVING) and calibration.covariance[n, n] > 0
    ]
    slopes, start = [], across(calibration)
    for n in chosen:
        step = float(np.sqrt(calibration.covariance[n, n]))
        values = calibration.values.copy()
        values[n] += step
        slopes.append((across(replace(calibration, values=values)) - start) / step)
    matrix = np.array(slopes).reshape(len(chosen), len(parallaxes))
    pitch, y = calibration.visit_std[0], calibration.visit_std[4]
    # The visit of the reference is common to all.
    new = ((focal * pitch) ** 2 + (focal * y / point[2]) ** 2) * (np.eye(len(parallaxes)) + 1)
    own = np.diag([each.std**2 for each in parallaxes])
    return np.asarray(matrix.T @ calibration.covariance[np.ix_(chosen, chosen)] @ matrix + new + own)


def _compare_strip(calibration: RigCalibration) -> list[str]:
    """Return whether the strip shows other poses than the board, with their uncertainty."""
    from scipy.stats import chi2

    visits = {visit for each in calibration.measured_visits for visit in each}
    chosen = [
        n for n, name in enumerate(calibration.names)
        if name.startswith("visit[") and int(name[6 : name.index("]")]) in visits
        and name.rpartition(".")[2] in _TURNS and calibration.covariance[n, n] > 0
    ]  # fmt: skip
    if not chosen:
        return []
    values = calibration.values[chosen]
    covariance = calibration.covariance[np.ix_(chosen, chosen)]
    scale = 1 / np.sqrt(np.diag(covariance))
    eigenvalues, vectors = np.linalg.eigh(covariance * scale[:, None] * scale)
    usable = eigenvalues > _ROUNDING
    parts = vectors[:, usable].T @ (values * scale)
    square = float((parts**2 / eigenvalues[usable]).sum())
    if chi2.sf(square, int(usable.sum())) > _IMPROBABLE:
        return []
    turns = [n for n, index in enumerate(chosen) if not calibration.names[index].endswith((".y", ".z"))]
    largest = float(np.abs(values[turns]).max()) if turns else 0.0
    return [
        f"strip: shows other poses of the camera in the measurement than the board (chi-squared {square:.0f} for "
        f"{int(usable.sum())}, turned by up to {format_two_digits(1e6 * largest)} "
        "µrad): it was knocked or remounted, or the guide "
        "does not repeat, which the strip corrects; or the strip has another size than strip.file states. Calibrate "
        "again, check the strip, or state the tolerance in strip.errors"
    ]


def _describe_parallax(calibration: RigCalibration, parallaxes: Sequence[_Parallax]) -> list[str]:
    """Return messages on displacements across the stage: those of a turned camera, or of single images."""
    point = _usual_point(calibration, parallaxes)
    covariance = _parallax_covariance(calibration, parallaxes, point)
    across, along = (np.array([getattr(each, name) for each in parallaxes]) for name in ("across", "along"))
    across -= _expected_across(calibration, point, [each.place for each in parallaxes])
    # A camera that is turned about its axis sees displacements along the stage under the angle of the turn.
    weights = np.linalg.solve(covariance, along)
    information = float(along @ weights)
    if information > 0:
        turn, std = float(weights @ across) / information, information**-0.5
        if abs(turn) > _SIGMAS * std and abs(turn) * np.abs(along).max() > _SMALL_PX:
            return [
                f"images of the measurement: are displaced across the stage by {1e3 * turn:+.2g} ± {1e3 * std:.1g} "
                "mrad of their displacement along it (up to "
                f"{format_two_digits(np.abs(across).max())} px): the camera was knocked or "
                "remounted since the calibration; calibrate again with this mounting, or add a fiducial strip"
            ]
    found = []
    for each, shift, deviation in zip(parallaxes, across.tolist(), np.sqrt(np.diag(covariance)), strict=True):
        if abs(shift) > max(_LARGE_PX, _SIGMAS * deviation):
            found.append(
                f"{each.name}: is displaced by {shift:+.2f} ± {deviation:.2f} px across the stage against the "
                "reference position: the camera was knocked, or the scene moved between the images of a frame; check "
                "the image, or calibrate again"
            )
    return found


def _nearest_places(count: int, middle: int) -> list[int]:
    """Return positions in the order of their distance from the reference; neighbours first."""
    return sorted((place for place in range(count) if place != middle), key=lambda place: abs(place - middle))[
        :_MOST_PAIRS
    ]


def _grey(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return values if values.ndim == 2 else np.asarray(values.mean(axis=-1), dtype=np.float32)


def _match_blocks(here: NDArray[np.float32], there: NDArray[np.float32]) -> _Matches:
    """Return the displacements of blocks with texture, from the largest correlation within the rows of a block."""
    cv2 = opencv()
    one, other = (gaussian_filter(np.nan_to_num(image), _SMOOTH_PX) for image in (here, there))
    known, seen = np.isfinite(here), np.isfinite(there)
    height, width = one.shape
    brightness = float(np.median(one[known])) if known.any() else 0.0
    counts = [int(np.clip((size - 2 * _ABOVE_PX) // _BLOCK_PX, 0, _MOST_BLOCKS)) for size in (height, width)]
    if min(counts) < 1:
        return _Matches(np.empty(0), np.empty(0))
    rows, columns = (
        np.linspace(_ABOVE_PX, size - _ABOVE_PX - _BLOCK_PX, count).astype(int)
        for size, count in zip((height, width), counts, strict=True)
    )
    x, y = [], []
    for row in rows.tolist():
        strip = np.s_[row - _ABOVE_PX : row + _BLOCK_PX + _ABOVE_PX]
        for column in columns.tolist():
            part = np.s_[row : row + _BLOCK_PX, column : column + _BLOCK_PX]
            block = one[part]
            if not known[part].all() or block.std() < _CONTRAST * abs(brightness):
                continue
            score = cv2.matchTemplate(other[strip], block, cv2.TM_CCOEFF_NORMED)
            v, u = np.unravel_index(int(score.argmax()), score.shape)
            if score[v, u] < _LEAST_PEAK or not (0 < v < score.shape[0] - 1 and 0 < u < score.shape[1] - 1):
                continue
            if not seen[row - _ABOVE_PX + v : row - _ABOVE_PX + v + _BLOCK_PX, u : u + _BLOCK_PX].all():
                continue
            x.append(u - column + _vertex(*score[v, u - 1 : u + 2].tolist()))
            y.append(v - _ABOVE_PX + _vertex(*score[v - 1 : v + 2, u].tolist()))
    return _Matches(np.array(x), np.array(y))


def _vertex(before: float, top: float, after: float) -> float:
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
