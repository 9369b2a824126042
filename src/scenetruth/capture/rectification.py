"""Resampling of the images of a calibrated rig to those of an ideal rig: a pinhole camera moved along its X axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.capture.calibration import RigCalibration
from scenetruth.capture.capture_file import Capture
from scenetruth.capture.corrections import noise_share, resample_image, touched_pixels
from scenetruth.capture.image_reading import PixelFormat
from scenetruth.errors import Problem
from scenetruth.number_format import format_two_digits

__all__ = [
    "Geometry",
    "Rectification",
    "calibration_problems",
    "estimate_distance_mm",
    "ideal_principal_point",
    "ideal_rotation",
    "load_calibration",
    "recorded_geometry",
    "recorded_pixels",
    "step_factor",
]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Geometry = Literal["rectified", "recorded"]
"""Images of a recording: resampled to an ideal rig, or as recorded."""

_ORDER = 5
_MOST_POSITION = 1e-3  # largest difference of a position from that of the calibration, in steps
_MOST_TALLER_PX = 0.02  # largest effect of pixels that are not square for images as recorded
_LEAST_PEAK = 0.25  # smallest correlation of two images from which a distance is taken
_LEAST_PX = 1.0  # smallest disparity of a distance
_LEAST_OVERLAP = 0.2  # smallest part of an image that both show
_COARSE_PX = 12.0  # standard deviation of the shading that is removed before a correlation


@dataclass(frozen=True, eq=False)
class Rectification:
    """Resampling of recorded images to those of the ideal rig of a calibration.

    The ideal rig has the estimated focal length, no distortion, X along the stage axis, Z nearest that of the reference
    camera, and the centre of the reference camera at s = 0. Its principal point is moved by whole pixels, so that its
    images show what the recorded images show. Pixels are mapped through the plane at ``depth_mm``, on which errors of
    angles and positions have no effect on the resampled images.

    ``calibration``: Calibration of the rig.
    ``pixels``: Pixel format of the images; a plane of a mosaic has every second pixel.
    ``shape``: Rows and columns of the images.
    ``depth_mm``: Depth of the plane.
    ``visits``: Numbers of the visits of the calibration by (position, frame), where it has estimated them.
    """

    calibration: RigCalibration
    pixels: PixelFormat
    shape: tuple[int, int]
    depth_mm: float
    visits: Mapping[tuple[int, int], int] | None = None

    @cached_property
    def step(self) -> float:
        """Length of the steps of the ideal rig relative to the nominal length: (1 + κ) |A|."""
        return step_factor(self.calibration)

    @cached_property
    def rotation(self) -> Floats:
        """Axes of the ideal cameras as columns, in the frame of the reference camera."""
        return ideal_rotation(self.calibration)

    @property
    def constant(self) -> bool:
        """Whether all frames of a position have the same map."""
        return self.visits is None

    def geometry(self, capture: Capture) -> dict[str, Any]:
        """Return the arguments of `make_recording` that the calibration determines, in pixels of the camera.

        Of the tolerances, those of a new visit remain: displacements along X, and rotations that shift the image alike.
        """
        given, calibration = capture.stage, self.calibration
        along = calibration.positions_mm - calibration.positions_mm[calibration.reference]
        if calibration.visits:
            start = calibration.layout.first_visit
            visit = calibration.prior_std[start : start + 6]
            moved_um = 1e3 * float(np.hypot(visit[3], visit[1] * self.depth_mm))
        else:
            moved_um = 0.0 if given.errors is None else given.errors.repeatability_um
        if given.errors is not None and given.scan != "unidirectional":
            # Approaches from either side miss a position by half the backlash.
            moved_um = float(np.hypot(moved_um, 0.5 * given.errors.backlash_um))
        return {
            "focal_length_px": calibration.value("f"),
            "principal_point_px": ideal_principal_point(calibration),
            "baseline_mm": self.step * given.baseline_mm,
            "stage_x_mm": self.step * along,
            "stage_tolerances": {"repeatability_um": moved_um} if moved_um > 0 and self.visits is None else {},
            "attrs": {"geometry": "rectified", "rectified_depth_mm": self.depth_mm},
        }

    def apply(self, values: NDArray[Any], position: int, frame: int) -> NDArray[np.float32]:
        """Return an image resampled by a quintic spline; NaN outside and around pixels that are not finite."""
        where = self._places(position, frame)
        bad = ~np.isfinite(values)
        if values.ndim == 2:
            return resample_image(values, bad, where, _ORDER)
        channels = range(values.shape[-1])
        return np.stack([resample_image(values[..., n], bad[..., n], where, _ORDER) for n in channels], axis=-1)

    def mask(self, excluded: Mask, position: int, frame: int) -> Mask:
        """Return the pixels that rest on an excluded pixel."""
        return touched_pixels(excluded, self._places(position, frame))

    def noise_share(self, position: int, frame: int) -> NDArray[np.float32]:
        """Return the variance of white noise after the resampling relative to that before, shape (y, x)."""
        return noise_share(self._places(position, frame), _ORDER)

    def _places(self, position: int, frame: int) -> Floats:
        visit = None if self.visits is None else self.visits[position, frame]
        found: Floats = self._cached_places(position, visit)
        return found

    @cached_property
    def _cached_places(self) -> Any:
        return lru_cache(maxsize=2)(self.places)

    def places(self, position: int, visit: int | None = None) -> Floats:
        """Return the rows and columns in the recorded image of a position of all ideal pixels, shape (2, y, x)."""
        given, step = self.calibration, self.pixels.step
        first_row, first_column = self.pixels.offset
        rows, columns = np.mgrid[: self.shape[0], : self.shape[1]].astype(np.float64)
        c = np.array(ideal_principal_point(given))
        pixels = np.stack([first_column + step * columns, first_row + step * rows], axis=-1)
        rays = np.concatenate([(pixels - c) / given.value("f"), np.ones((*self.shape, 1))], axis=-1)
        seen = recorded_pixels(given, self.depth_mm * rays, position, visit)
        return np.stack([(seen[..., 1] - first_row) / step, (seen[..., 0] - first_column) / step])


def recorded_pixels(calibration: RigCalibration, points_mm: Floats, position: int, visit: int | None = None) -> Floats:
    """Return the recorded pixels of points in the frame of the ideal camera of a position, shape (..., 2)."""
    along = calibration.positions_mm - calibration.positions_mm[calibration.reference]
    centre = np.array([step_factor(calibration) * along[position], 0.0, 0.0])
    points = (points_mm + centre) @ ideal_rotation(calibration).T
    camera, view = calibration.camera, calibration.viewpoint(position, visit)
    inside = Viewpoint(view.position_mm, view.rotation).to_camera(points)
    normalised = inside[..., :2] / inside[..., 2:]
    if camera.distortion is not None:
        normalised = camera.distortion.distort(normalised)
    focal_px = camera.focal_px * np.array([1.0, 1.0 + calibration.value("aspect")])
    return np.asarray(focal_px * normalised + np.array(camera.principal_point))


def step_factor(calibration: RigCalibration) -> float:
    """Return the length of the steps along the axis relative to their nominal length."""
    along = np.array([1.0, calibration.value("axis_y"), calibration.value("axis_z")])
    return float((1.0 + calibration.value("step_scale")) * np.linalg.norm(along))


def ideal_rotation(calibration: RigCalibration) -> Floats:
    """Return the axes of the ideal cameras as columns, in the frame of the reference camera, shape (3, 3)."""
    x = calibration.axis
    z = np.array([0.0, 0.0, 1.0]) - x[2] * x
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def ideal_principal_point(calibration: RigCalibration) -> tuple[float, float]:
    """Return the principal point of the ideal cameras: that of the calibration, moved by whole pixels."""
    camera = calibration.camera
    middle = np.array([[(calibration.width - 1) / 2, (calibration.height - 1) / 2]])
    ray = camera.ray_directions(middle)[0] @ ideal_rotation(calibration)
    moved = middle[0] - (camera.focal_px * ray[:2] / ray[2] + np.array(camera.principal_point))
    x, y = np.array(camera.principal_point) + np.rint(moved)
    return float(x), float(y)


def load_calibration(calibration: RigCalibration | str | Path) -> RigCalibration:
    """Return a calibration, or that of a file."""
    return calibration if isinstance(calibration, RigCalibration) else RigCalibration.load(calibration)


def recorded_geometry(capture: Capture, calibration: RigCalibration) -> dict[str, Any]:
    """Return the arguments of `make_recording` for recorded images: lens and step of a calibration, tolerances."""
    camera = calibration.camera
    along = calibration.positions_mm - calibration.positions_mm[calibration.reference]
    step = step_factor(calibration)
    found: dict[str, Any] = {
        "focal_length_px": camera.focal_px,
        "principal_point_px": camera.principal_point,
        "baseline_mm": step * capture.stage.baseline_mm,
        "stage_x_mm": step * along,
        "lens_tolerances": {
            "focal_length_std_px": calibration.std("f"),
            "principal_point_std_px": [calibration.std("c_x"), calibration.std("c_y")],
        },
        "attrs": {"geometry": "recorded"},
    }
    if camera.distortion is not None:
        found["distortion"] = list(camera.distortion.coefficients)
    return found


def calibration_problems(
    capture: Capture, calibration: RigCalibration, pixels: PixelFormat, geometry: Geometry, x_mm: Floats
) -> list[Problem]:
    """Return why a calibration is not that of a capture, or its images cannot be resampled.

    ``x_mm``: Positions of the camera along the stage, measured or planned.
    """
    problems = []
    if geometry == "rectified" and pixels.bayer is not None and pixels.plane == "mosaic":
        message = "must be red, green or blue for a rectification: resampling would mix the colours of the mosaic"
        problems.append(Problem("camera.plane", message, pixels.plane))
    taller = abs(calibration.value("aspect")) * calibration.height / 2
    if geometry == "recorded" and taller > _MOST_TALLER_PX:
        message = f"has pixels that are not square (aspect {format_two_digits(calibration.value('aspect'))})"
        problems.append(Problem("calibration", f"{message}: use images that are resampled (geometry='rectified')"))
    size, own = (capture.camera.width, capture.camera.height), (calibration.width, calibration.height)
    if own != size:
        message = f"is of a camera of {own[0]} x {own[1]} px, but the images have {size[0]} x {size[1]} px"
        problems.append(Problem("calibration", f"{message}: use the calibration of this camera"))
    if calibration.bit_depth not in (None, pixels.bit_depth):
        message = f"is of a camera of {calibration.bit_depth} bits, but the images have {pixels.bit_depth}"
        problems.append(Problem("calibration", f"{message}: use the calibration of this camera, in this mode"))
    stage = capture.stage
    if stage.rows > 1:
        message = f"is of a single row of positions, but the stage has {stage.rows} rows"
        problems.append(Problem("calibration", f"{message}: import without a calibration"))
        return problems
    calibrated = calibration.positions_mm
    if len(x_mm) != len(calibrated):
        message = f"has {len(calibrated)} positions ({_listed(calibrated)} mm), but the stage has {len(x_mm)}"
        problems.append(Problem("calibration", f"{message} ({_listed(x_mm)} mm): calibrate at the same positions"))
        return problems
    middle = (len(x_mm) - 1) // 2
    if calibration.reference != middle:
        message = f"refers to the position with index {calibration.reference}, but the images to that with {middle}"
        problems.append(Problem("calibration", f"{message}: calibrate with this reference"))
        return problems
    far = np.abs((x_mm - x_mm[middle]) - (calibrated - calibrated[middle]))
    if (far > _MOST_POSITION * abs(stage.baseline_mm)).any():
        message = f"is for the positions {_listed(calibrated)} mm, but the stage has {_listed(x_mm)} mm"
        problems.append(Problem("calibration", f"{message}: calibrate at the same positions"))
    return problems


def _listed(values: Floats) -> str:
    return ", ".join(f"{value:g}" for value in values)


def estimate_distance_mm(here: NDArray[Any], there: NDArray[Any], focal_px: float, along_mm: float) -> float | None:
    """Return the distance of the plane for which two rectified images agree best; None if they do not agree.

    ``here``, ``there``: Images rectified through a distant plane, shape (y, x[, channel]).
    ``along_mm``: Displacement of the camera from one to the other along X.
    """
    one, other = (_contrast(image) for image in (here, there))
    width = one.shape[1]
    size = 2 * width
    spectra = [np.fft.rfft(each, size, axis=1) for each in (one, other, one**2, other**2, one != 0, other != 0)]

    def correlate(first: int, second: int) -> Floats:
        return np.asarray(np.fft.irfft((spectra[first] * np.conj(spectra[second])).sum(axis=0), size))

    # A displacement of the camera to the right by its step moves the scene to the left.
    both = correlate(0, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = both / np.sqrt(correlate(2, 5) * correlate(4, 3))
    overlap = correlate(4, 5) / (one != 0).sum()
    shifts = np.arange(size)
    shifts = np.where(shifts > width, shifts - size, shifts)
    found[(overlap < _LEAST_OVERLAP) | ~np.isfinite(found) | (shifts * np.sign(along_mm) < _LEAST_PX)] = -1.0
    best = int(found.argmax())
    if found[best] < _LEAST_PEAK:
        return None
    left, top, right = (found[(best + k) % size] for k in (-1, 0, 1))
    bend = left - 2 * top + right
    fine = 0.5 * (left - right) / bend if min(left, right) > -1.0 and bend < 0 else 0.0
    return float(focal_px * along_mm / (shifts[best] + fine))


def _contrast(image: NDArray[Any]) -> Floats:
    """Return an image without its coarse shading, 0 where it is not finite."""
    from scipy.ndimage import gaussian_filter

    grey = image.astype(np.float64) if image.ndim == 2 else image.astype(np.float64).mean(axis=-1)
    known = np.isfinite(grey)
    weight = gaussian_filter(known.astype(np.float64), _COARSE_PX)
    smooth = gaussian_filter(np.where(known, grey, 0.0), _COARSE_PX) / np.maximum(weight, 1e-6)
    return np.where(known, grey - smooth, 0.0)
