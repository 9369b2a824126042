"""Circumnutation: the tilt of an organ goes round."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from scenetruth.model import Direction, Finite, Positive, Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points
from scenetruth.scene.motion.maps import turn_by

__all__ = ["Nutation"]


class Nutation(MotionModel):
    """Circumnutation: the tilt of an organ goes round, so that its tip draws an ellipse about its mean direction.

    The organ's direction d is tilted by the rotation vector a cos φ (d x e) + b sin φ (d x f), φ = 2 π t / period +
    phase, with e the part of ``towards`` perpendicular to d, and f = d x e.
    """

    kind: Literal["nutation"]
    """``nutation``."""
    direction: Direction
    """Mean direction d of the organ in the world frame, of any length."""
    towards: Vector3
    """Where the organ is tilted to at phase 0; from there it goes round d by the right-hand rule."""
    amplitudes_deg: tuple[Finite, Finite]
    """Tilts a and b in degrees; equal ones give a circle, one of them zero a sway."""
    period_frames: Positive
    """Frames of one round."""
    phase_deg: Finite = 0.0
    """Phase at t = 0 in degrees."""
    point_mm: Vector3 | None = None
    """World point that rests; the position of what moves if not given."""

    @field_validator("towards")
    @classmethod
    def _aside(cls, value: tuple[float, float, float], info: ValidationInfo) -> tuple[float, float, float]:
        direction = info.data.get("direction")
        if direction is not None:
            lengths = np.linalg.norm(value) * np.linalg.norm(direction)
            if np.linalg.norm(np.cross(value, direction)) <= 1e-6 * lengths:
                msg = "must not be parallel to direction"
                raise ValueError(msg)
        return value

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        centre = position_mm if self.point_mm is None else self.point_mm
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)
        aside = np.asarray(self.towards) - (direction @ np.asarray(self.towards)) * direction
        first = np.cross(direction, aside / np.linalg.norm(aside))
        second = np.cross(direction, first)
        amplitude_first, amplitude_second = np.deg2rad(self.amplitudes_deg)

        def move(points: Points, t: Field) -> Points:
            phase = 2 * np.pi / self.period_frames * t + np.deg2rad(self.phase_deg)
            cosine, sine = amplitude_first * np.cos(phase), amplitude_second * np.sin(phase)
            u, v, w = (one * cosine + other * sine for one, other in zip(first, second, strict=True))
            return turn_by(points, (u, v, w), centre)

        return move
