"""Time and camera pose of every image, planned and actual, and the exposure of its rows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from scenetruth.camera.stage import Frames, Stage, StageErrors
from scenetruth.random_streams import GeneratorFor
from scenetruth.validated_model import Finite, FrozenModel, NonNegative

__all__ = ["ImageAcquisition", "Schedule", "Shutter", "Viewpoint"]


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """The pose of a camera.

    ``position_mm``: World position of its projection centre, shape (3,).
    ``rotation``: Directions of its axes X (right), Y (down), Z (forward) in the world, the columns of a rotation
      matrix; shape (3, 3).
    ``shear``: Added to X / Z and Y / Z of every direction. It keeps points at the focus distance at their pixels when
      the camera moves from the centre of the aperture to another point of it.
    """

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    shear: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def on_axis(cls, x_mm: float) -> Self:
        """Return the viewpoint at a position of an ideal stage; its axes are those of the world."""
        return cls(np.array([x_mm, 0.0, 0.0]))

    def moved(self, offset_mm: ArrayLike, shear: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return the viewpoint moved by an offset.

        ``offset_mm``: Offset in the world, shape (3,).
        """
        return replace(self, position_mm=self.position_mm + np.asarray(offset_mm, dtype=np.float64), shear=shear)

    def to_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Transform world points into the camera's frame.

        ``points_mm``: Points in the world, shape (..., 3).
        Returns: The points in the camera's frame in mm, shape (..., 3), float64.
        """
        return self.directions_to_camera(np.asarray(points_mm, dtype=np.float64) - self.position_mm)

    def directions_to_camera(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions or velocities from the world into the camera's frame.

        ``directions``: Vectors in the world, shape (..., 3).
        Returns: The vectors in the camera's frame, in the same unit, shape (..., 3).
        """
        # Without a rotation, the numbers stay the same to the bit.
        turned = directions if self._straight else np.asarray(directions @ self.rotation)
        return self._sheared(turned, -1.0)

    def directions_to_world(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions from the camera's frame into the world.

        ``directions``: Vectors in the camera's frame, shape (..., 3).
        Returns: The vectors in the world, in the same unit, shape (..., 3).
        """
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
    """The time over which an image is taken; its own time is the middle of the exposure of its middle row.

    The truth is that of this middle, for every row its own.
    """

    exposure_time_s: NonNegative = 0.0
    """Time in s over which every pixel collects light; 0 freezes all motion."""
    samples: Annotated[int, Field(ge=1, le=4096)] | Literal["auto"] = "auto"
    """Moments of the exposure whose images are averaged; ``auto`` takes four for each pixel of motion, 4 to 256."""
    readout_time_s: NonNegative = 0.0
    """Time in s from the exposure of the first row to that of the last (rolling shutter); 0 for a global shutter."""
    stage_speed_mm_per_s: Finite = 0.0
    """Speed of the camera along X while it takes an image, in mm/s; its position is reached in the image's middle."""

    def row_offsets_s(self, rows: Array, height: int) -> Array:
        """Return how much later than the middle of the image rows are exposed.

        Returns: Times in s, of the shape of ``rows``; negative for the upper half of the image.
        """
        return np.asarray((rows - (height - 1) / 2) * (self.readout_time_s / max(height - 1, 1)))

    def exposure_offsets_s(self, count: int) -> Array:
        """Return moments that sample the exposure: the middles of equal parts of it.

        Returns: Times in s from the middle of the exposure, in order, shape (count,).
        """
        return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * self.exposure_time_s)


@dataclass(frozen=True, eq=False)
class ImageAcquisition:
    """Time and pose of one image.

    ``t``: Time in frames.
    ``viewpoint``: Pose of the camera.
    ``rotation_rad``: Rotation of the camera as a rotation vector in the world, shape (3,): pitch about X, yaw about Y,
      roll about Z.
    """

    t: float
    viewpoint: Viewpoint
    rotation_rad: NDArray[np.float64]


class _Arrival(NamedTuple):
    """The visit that brought the camera to a position, and the direction in which it came."""

    s_y: int
    s: int
    t: int
    direction: int
    """1 towards +X, -1 towards -X."""


class Schedule:
    """The moments of all images of a recording.

    Every moment is found from the stage, the frames and its own random numbers, and from no other moment. They may be
    asked for in any order.

    ``stage``, ``frames``: Where and when images are planned.
    ``generator_for``: Source of the errors' random numbers: called with ``("guide", s_y, s)`` for a position, and with
      ``("visit", s_y, s, t)`` for an arrival there.
    """

    def __init__(self, stage: Stage, frames: Frames, generator_for: GeneratorFor) -> None:
        self.stage = stage
        self.frames = frames
        self._errors = stage.errors or StageErrors()
        self._generator_for = generator_for
        self._x_mm = dict(zip(stage.s.tolist(), stage.x_mm.tolist(), strict=True))
        self._y_mm = dict(zip(stage.s_y.tolist(), stage.y_mm.tolist(), strict=True))

    def nominal(self, s: int, t: int, s_y: int = 0) -> ImageAcquisition:
        """Return the planned moment of an image: without errors, and with all images of a frame at the same time."""
        position = np.array([self._x_mm[s], self._y_mm[s_y], 0.0])
        return ImageAcquisition(float(t), Viewpoint(position), np.zeros(3))

    def moment(self, s: int, t: int, s_y: int = 0) -> ImageAcquisition:
        """Return the real moment of an image: at its time in the scan, with the errors of the stage."""
        planned = self.nominal(s, t, s_y)
        time = planned.t + self.offset_s(s, t, s_y) / self.frames.frame_interval_s
        if self.stage.errors is None:
            return ImageAcquisition(time, planned.viewpoint, planned.rotation_rad)
        errors = self._errors
        straight_y, straight_z, *turns = self._generator_for("guide", s_y, s).standard_normal(5)
        arrival = self._arrival(s, t, s_y)
        visit = self._generator_for("visit", arrival.s_y, arrival.s, arrival.t)
        along = errors.repeatability_um * visit.standard_normal()
        # Backlash: the camera stops short, in the direction in which it came.
        along -= arrival.direction * errors.backlash_um / 2
        off_um = np.array([along, errors.straightness_um * straight_y, errors.straightness_um * straight_z])
        rotation = 1e-6 * np.array([errors.pitch_urad, errors.yaw_urad, errors.roll_urad]) * turns
        viewpoint = Viewpoint(planned.viewpoint.position_mm + 1e-3 * off_um, _matrix(rotation))
        return ImageAcquisition(time, viewpoint, rotation)

    def offset_s(self, s: int, t: int, s_y: int = 0) -> float:
        """Return how much later than the reference camera's image of the same frame an image is taken.

        Returns: Time in s; negative if it is taken before.
        """
        return (self.stage.number_in_scan(s, t, s_y) - self.stage.number_in_scan(0, t)) * self.stage.time_per_position_s

    def _turned(self, t: int, s_y: int) -> bool:
        """Whether a row is scanned from its last position to its first."""
        row = s_y - int(self.stage.s_y[0])
        return self.stage.scan == "bidirectional" and (row + t) % 2 == 1

    def _arrival(self, s: int, t: int, s_y: int) -> _Arrival:
        """Return how the camera arrived where an image is taken; without a move since, it is an earlier visit."""
        stage = self.stage
        if stage.positions == 1:
            # The camera arrived there once, and never leaves.
            return _Arrival(0, s, 0, 1)
        rising = 1 if stage.x_mm[-1] > stage.x_mm[0] else -1
        if stage.scan == "unidirectional":
            # On its way back the stage runs past the first position, to reach it from the same side as the others.
            return _Arrival(s_y, s, t, rising)
        backwards = self._turned(t, s_y)
        direction = -rising if backwards else rising
        if s != stage.s[-1 if backwards else 0]:
            return _Arrival(s_y, s, t, direction)
        # The row begins where the row, or the frame, before it ended: the stage has not moved along X since.
        earlier = s_y + (1 if t % 2 == 1 else -1)
        return _Arrival(earlier, s, t, -direction) if earlier in self._y_mm else _Arrival(s_y, s, t - 1, -direction)


def _matrix(rotation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(rotation_rad).as_matrix()) if rotation_rad.any() else np.eye(3)
