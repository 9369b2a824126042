"""Where a camera stands at one moment, and how it is turned."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Viewpoint"]


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """The pose of a camera.

    Parameters
    ----------
    position_mm
        World position of its projection centre, shape (3,).
    rotation
        Directions of its axes X (right), Y (down), Z (forward) in the world, the columns of a rotation matrix; shape
        (3, 3).
    """

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))

    @classmethod
    def on_axis(cls, x_mm: float) -> Self:
        """Return the viewpoint at X_s on an ideal stage: its axes are the world's."""
        return cls(np.array([x_mm, 0.0, 0.0]))

    def to_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Return world points, shape (..., 3), in the camera's frame."""
        # A camera that is not turned must not change a bit of the coordinates' differences.
        relative = np.asarray(points_mm, dtype=np.float64) - self.position_mm
        return relative if self._straight else np.asarray(relative @ self.rotation)

    def directions_to_camera(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return world directions or velocities, shape (..., 3), in the camera's frame."""
        return directions if self._straight else np.asarray(directions @ self.rotation)

    def directions_to_world(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return directions in the camera's frame, shape (..., 3), in the world."""
        return directions if self._straight else np.asarray(directions @ self.rotation.T)

    @property
    def _straight(self) -> bool:
        return bool((self.rotation == np.eye(3)).all())
