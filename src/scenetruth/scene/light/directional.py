"""Parallel light."""

from __future__ import annotations

from typing import Literal

from scenetruth.model import Direction, NonNegative
from scenetruth.scene.light.base import EVERYWHERE, Lamp, LightModel, moved_axis
from scenetruth.scene.motions import Motion

__all__ = ["DirectionalLight"]


class DirectionalLight(LightModel):
    """Parallel light from infinitely far away."""

    kind: Literal["directional"]
    """``directional``."""
    direction: Direction
    """Direction in which the light travels at t = 0, of any length."""
    irradiance: NonNegative
    """Irradiance E of a surface that faces the light; 1 makes a surface as bright as its texture says."""
    motion: tuple[Motion, ...] = ()
    """How it moves; only rotations change it."""

    def lamp(self, t: float) -> Lamp:
        """Return the light at time t; see `LightModel`."""
        _, axis = moved_axis(self.motion, (0.0, 0.0, 0.0), self.direction, t)
        return Lamp(None, axis, self.irradiance, 0.0, EVERYWHERE, EVERYWHERE)
