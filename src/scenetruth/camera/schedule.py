"""Times and camera poses of all images of a recording, as planned and with the errors of the stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera.stage import Frames, Stage
from scenetruth.camera.stage_errors import StageErrors
from scenetruth.camera.viewpoint import Viewpoint
from scenetruth.randomness import GeneratorFor

__all__ = ["Moment", "Schedule"]


@dataclass(frozen=True, eq=False)
class Moment:
    """Time and pose of one image.

    Parameters
    ----------
    t
        Time in frames.
    viewpoint
        Pose of the camera.
    rotation_rad
        Rotation of the camera as a rotation vector in the world, shape (3,): pitch about X, yaw about Y, roll about Z.
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

    Parameters
    ----------
    stage, frames
        Where and when images are planned.
    generator_for
        Source of the errors' random numbers: called with ``("guide", s_y, s)`` for a position, and with
        ``("visit", s_y, s, t)`` for an arrival there.
    """

    def __init__(self, stage: Stage, frames: Frames, generator_for: GeneratorFor) -> None:
        self.stage = stage
        self.frames = frames
        self._errors = stage.errors or StageErrors()
        self._generator_for = generator_for
        self._x_mm = dict(zip(stage.s.tolist(), stage.x_mm.tolist(), strict=True))
        self._y_mm = dict(zip(stage.s_y.tolist(), stage.y_mm.tolist(), strict=True))

    def nominal(self, s: int, t: int, s_y: int = 0) -> Moment:
        """Return the planned moment of an image: without errors, and with all images of a frame at the same time.

        Parameters
        ----------
        s, t, s_y
            Camera position, frame and row, 0 the reference.

        Returns
        -------
        Moment
            Time t, and the nominal position on the stage without rotation.
        """
        position = np.array([self._x_mm[s], self._y_mm[s_y], 0.0])
        return Moment(float(t), Viewpoint(position), np.zeros(3))

    def moment(self, s: int, t: int, s_y: int = 0) -> Moment:
        """Return the real moment of an image: at its time in the scan, with the errors of the stage.

        Parameters
        ----------
        s, t, s_y
            Camera position, frame and row, 0 the reference.

        Returns
        -------
        Moment
            Real time and pose.
        """
        planned = self.nominal(s, t, s_y)
        time = planned.t + self.offset_s(s, t, s_y) / self.frames.frame_interval_s
        if self.stage.errors is None:
            return Moment(time, planned.viewpoint, planned.rotation_rad)
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
        return Moment(time, viewpoint, rotation)

    def offset_s(self, s: int, t: int, s_y: int = 0) -> float:
        """Return how much later than the reference camera's image of the same frame an image is taken.

        Parameters
        ----------
        s, t, s_y
            Camera position, frame and row, 0 the reference.

        Returns
        -------
        float
            Time in s; negative if it is taken before.
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
