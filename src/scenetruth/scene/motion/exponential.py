"""Translation by a distance that grows or relaxes exponentially."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from scenetruth.model import Direction, Finite, Vector3
from scenetruth.scene.jets import Field
from scenetruth.scene.motion.base import MotionModel, PointMap, Points

__all__ = ["Exponential"]


def _not_zero(value: float) -> float:
    if value == 0:
        msg = "must not be zero: positive lets the distance grow, negative lets it relax"
        raise ValueError(msg)
    return value


class Exponential(MotionModel):
    """Translation that grows or relaxes exponentially, as elongation does: amplitude (exp(t / time_constant) - 1)."""

    kind: Literal["exponential"]
    """``exponential``."""
    direction: Direction
    """Direction in the world frame, of any length."""
    amplitude_mm: Finite
    """Amplitude in mm: the distance after ln 2 time constants; relaxation ends at its negative."""
    time_constant_frames: Annotated[Finite, AfterValidator(_not_zero)]
    """Time in frames in which the distance to the asymptote changes by a factor e; negative: it falls, and relaxes."""

    def point_map(self, position_mm: Vector3) -> PointMap:
        """Return the map; see `MotionModel`."""
        direction = np.asarray(self.direction) / np.linalg.norm(self.direction)

        def move(points: Points, t: Field) -> Points:
            distance = self.amplitude_mm * np.expm1(t / self.time_constant_frames)
            x, y, z = (field + n * distance for field, n in zip(points, direction, strict=True))
            return x, y, z

        return move
