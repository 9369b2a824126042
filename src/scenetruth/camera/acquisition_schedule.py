"""Acquisition schedule: time and pose of every image, nominal and actual, and shutter timing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from scenetruth.camera.stage import Frames, PoseOffset, Stage, StageErrors, StagePose
from scenetruth.random_streams import GeneratorFor
from scenetruth.validated_model import Finite, FrozenModel, NonNegative

__all__ = ["ImageAcquisition", "Schedule", "Shutter", "Viewpoint"]


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Pose of a camera.

    ``position_mm``: World position of the projection centre, shape (3,).
    ``rotation``: Rotation matrix whose columns are the camera axes X (right), Y (down), Z (forward) in world
      coordinates, shape (3, 3).
    ``shear``: Offset added to X / Z and Y / Z of every direction. For a viewpoint off the aperture centre it keeps
      points at the focus distance at their pixels.
    """

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    shear: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def on_axis(cls, x_mm: float) -> Self:
        """Return the viewpoint at a position of an ideal stage, aligned with the world axes."""
        return cls(np.array([x_mm, 0.0, 0.0]))

    def moved(self, offset_mm: ArrayLike, shear: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return the viewpoint translated by a world offset, shape (3,)."""
        return replace(self, position_mm=self.position_mm + np.asarray(offset_mm, dtype=np.float64), shear=shear)

    def to_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Transform world points, shape (..., 3), into the camera frame, in mm."""
        return self.directions_to_camera(np.asarray(points_mm, dtype=np.float64) - self.position_mm)

    def directions_to_camera(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions or velocities, shape (..., 3), from the world into the camera frame."""
        # Without a rotation, the result is bit-identical.
        turned = directions if self._straight else np.asarray(directions @ self.rotation)
        return self._sheared(turned, -1.0)

    def directions_to_world(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions, shape (..., 3), from the camera frame into the world."""
        sheared = self._sheared(directions, 1.0)
        return sheared if self._straight else np.asarray(sheared @ self.rotation.T)

    def _sheared(self, directions: NDArray[np.float64], sign: float) -> NDArray[np.float64]:
        if self.shear == (0.0, 0.0):
            return directions
        shift = np.array([sign * self.shear[0], sign * self.shear[1], 0.0])
        return np.asarray(directions + directions[..., 2:] * shift)

    @property
    def _straight(self) -> bool:
        return bool((self.rotation == np.eye(3)).all())


Array = NDArray[np.float64]


class Shutter(FrozenModel):
    """Exposure and readout timing of an image.

    The image time is the mid-exposure of the middle row. The ground truth of each row refers to the mid-exposure of
    that row.
    """

    exposure_time_s: NonNegative = 0.0
    """Exposure time of every pixel in s; 0 for no motion blur."""
    samples: Annotated[int, Field(ge=1, le=4096)] | Literal["auto"] = "auto"
    """Number of exposure samples averaged per image; ``auto`` uses four per pixel of motion, from 4 to 256."""
    readout_time_s: NonNegative = 0.0
    """Time in s between the exposures of the first and the last row (rolling shutter); 0 for a global shutter."""
    stage_speed_mm_per_s: Finite = 0.0
    """Speed of the camera along X during the exposure, in mm/s; the nominal position is reached at the image time."""

    def row_offsets_s(self, rows: Array, height: int) -> Array:
        """Return the exposure times of rows relative to the image time in s; negative for the upper half."""
        return np.asarray((rows - (height - 1) / 2) * (self.readout_time_s / max(height - 1, 1)))

    def exposure_offsets_s(self, count: int) -> Array:
        """Return the midpoints of equal subintervals of the exposure in s relative to mid-exposure, shape (count,)."""
        return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * self.exposure_time_s)


@dataclass(frozen=True, eq=False)
class ImageAcquisition:
    """Time in frames, pose, and rotation vector in rad (pitch about X, yaw about Y, roll about Z) of one image."""

    t: float
    viewpoint: Viewpoint
    rotation_rad: NDArray[np.float64]


class _Arrival(NamedTuple):
    """Stage move that brought the camera to a position, with its direction."""

    s_y: int
    s: int
    t: int
    direction: int
    """1 towards +X, -1 towards -X."""


class Schedule:
    """Times and poses of all images of a recording, available in any order."""

    def __init__(self, stage: Stage, frames: Frames, generator_for: GeneratorFor) -> None:
        self.stage = stage
        self.frames = frames
        self._errors = stage.errors or StageErrors()
        self._generator_for = generator_for
        self._x_mm = dict(zip(stage.s.tolist(), stage.x_mm.tolist(), strict=True))
        self._y_mm = dict(zip(stage.s_y.tolist(), stage.y_mm.tolist(), strict=True))

    def nominal(self, s: int, t: int, s_y: int = 0) -> ImageAcquisition:
        """Return the nominal acquisition of an image: no stage errors, all images of a frame simultaneous."""
        position = np.array([self._x_mm[s], self._y_mm[s_y], 0.0])
        return ImageAcquisition(float(t), Viewpoint(position), np.zeros(3))

    def moment(self, s: int, t: int, s_y: int = 0) -> ImageAcquisition:
        """Return the actual acquisition of an image: scan time and stage errors included."""
        planned = self.nominal(s, t, s_y)
        time = planned.t + self.offset_s(s, t, s_y) / self.frames.frame_interval_s
        stage = self.stage
        if stage.errors is None and stage.poses is None and stage.axis_tilt_urad is None:
            return ImageAcquisition(time, planned.viewpoint, planned.rotation_rad)
        off_um, rotation = self._guide(s, s_y)
        visit = self._listed_visit(s, t, s_y)
        if visit is None:
            off_um[0] += self._drawn_visit_um(s, t, s_y)
        else:
            off_um += visit.offset_um
            rotation = rotation + visit.rotation_rad
        if stage.axis_tilt_urad is not None:
            # Drawn errors along the direction of travel are micrometres, whose tilt is negligible.
            off_um[1:] += 1e-3 * self._x_mm[s] * np.asarray(stage.axis_tilt_urad)
        viewpoint = Viewpoint(planned.viewpoint.position_mm + 1e-3 * off_um, _matrix(rotation))
        return ImageAcquisition(time, viewpoint, rotation)

    def _guide(self, s: int, s_y: int) -> tuple[Array, Array]:
        """Return the displacement in µm and the rotation vector in rad of a position: listed, or drawn."""
        if self.stage.poses is not None:
            pose = self._listed(s, s_y)
            return pose.offset_um, pose.rotation_rad
        errors = self._errors
        straight_y, straight_z, *turns = self._generator_for("guide", s_y, s).standard_normal(5)
        off_um = np.array([0.0, errors.straightness_um * straight_y, errors.straightness_um * straight_z])
        return off_um, 1e-6 * np.array([errors.pitch_urad, errors.yaw_urad, errors.roll_urad]) * turns

    def _listed(self, s: int, s_y: int) -> StagePose:
        stage = self.stage
        assert stage.poses is not None  # asked by the callers
        return stage.poses[(s_y - int(stage.s_y[0])) * stage.positions + s - int(stage.s[0])]

    def _listed_visit(self, s: int, t: int, s_y: int) -> PoseOffset | None:
        visits = None if self.stage.poses is None else self._listed(s, s_y).visits
        # Relative to the reference frame, which previews use alone.
        return None if visits is None else visits[(len(visits) - 1) // 2 + t]

    def _drawn_visit_um(self, s: int, t: int, s_y: int) -> float:
        """Return the displacement along X of one visit in µm, by repeatability and backlash."""
        errors, arrival = self._errors, self._arrival(s, t, s_y)
        visit = self._generator_for("visit", arrival.s_y, arrival.s, arrival.t)
        along = errors.repeatability_um * float(visit.standard_normal())
        # Backlash: the camera stops short in its direction of travel.
        return along - arrival.direction * errors.backlash_um / 2

    def planned_time_s(self, s: int, t: int, s_y: int = 0) -> float:
        """Return the planned time of an image in s: that of its frame and its place in the scan."""
        return t * self.frames.frame_interval_s + self.offset_s(s, t, s_y)

    def offset_s(self, s: int, t: int, s_y: int = 0) -> float:
        """Return the acquisition time in s relative to the reference camera's image of the frame."""
        return (self.stage.number_in_scan(s, t, s_y) - self.stage.number_in_scan(0, t)) * self.stage.time_per_position_s

    def _turned(self, t: int, s_y: int) -> bool:
        """Return whether a row is scanned from its last to its first position."""
        row = s_y - int(self.stage.s_y[0])
        return self.stage.scan == "bidirectional" and (row + t) % 2 == 1

    def _arrival(self, s: int, t: int, s_y: int) -> _Arrival:
        """Return the most recent stage move before an image, which may belong to an earlier image."""
        stage = self.stage
        if stage.positions == 1:
            # A single position is reached once and never left.
            return _Arrival(0, s, 0, 1)
        rising = 1 if stage.x_mm[-1] > stage.x_mm[0] else -1
        if stage.scan == "unidirectional":
            # The return move overshoots the first position, so all positions are approached from the same side.
            return _Arrival(s_y, s, t, rising)
        backwards = self._turned(t, s_y)
        direction = -rising if backwards else rising
        if s != stage.s[-1 if backwards else 0]:
            return _Arrival(s_y, s, t, direction)
        # The scan starts where the previous row or frame ended, without a move along X.
        earlier = s_y + (1 if t % 2 == 1 else -1)
        return _Arrival(earlier, s, t, -direction) if earlier in self._y_mm else _Arrival(s_y, s, t - 1, -direction)


def _matrix(rotation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(rotation_rad).as_matrix()) if rotation_rad.any() else np.eye(3)
