"""Where a camera stands at one moment, and how it is turned."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
    shear
        Added to X / Z and Y / Z of every direction: a camera beside the centre of a lens that still sees the same
        points at the distance in focus.
    """

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    shear: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def on_axis(cls, x_mm: float) -> Self:
        """Return the viewpoint at X_s on an ideal stage: its axes are the world's."""
        return cls(np.array([x_mm, 0.0, 0.0]))

    def moved(self, offset_mm: ArrayLike, shear: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return the viewpoint that lies an offset in the world, shape (3,), further on."""
        return replace(self, position_mm=self.position_mm + np.asarray(offset_mm, dtype=np.float64), shear=shear)

    def to_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Return world points, shape (..., 3), in the camera's frame."""
        return self.directions_to_camera(np.asarray(points_mm, dtype=np.float64) - self.position_mm)

    def directions_to_camera(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return world directions or velocities, shape (..., 3), in the camera's frame."""
        # A camera that is not turned must not change a bit.
        turned = directions if self._straight else np.asarray(directions @ self.rotation)
        return self._sheared(turned, -1.0)

    def directions_to_world(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return directions in the camera's frame, shape (..., 3), in the world."""
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
