"""The pose of a camera at one moment."""

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
        Added to X / Z and Y / Z of every direction. It keeps points at the focus distance at their pixels when the
        camera moves from the centre of the aperture to another point of it.
    """

    position_mm: NDArray[np.float64]
    rotation: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    shear: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def on_axis(cls, x_mm: float) -> Self:
        """Return the viewpoint at a position of an ideal stage; its axes are those of the world.

        Parameters
        ----------
        x_mm
            X_s, position along the stage.
        """
        return cls(np.array([x_mm, 0.0, 0.0]))

    def moved(self, offset_mm: ArrayLike, shear: tuple[float, float] = (0.0, 0.0)) -> Self:
        """Return the viewpoint moved by an offset.

        Parameters
        ----------
        offset_mm
            Offset in the world, shape (3,).
        shear
            Shear of the new viewpoint.
        """
        return replace(self, position_mm=self.position_mm + np.asarray(offset_mm, dtype=np.float64), shear=shear)

    def to_camera(self, points_mm: ArrayLike) -> NDArray[np.float64]:
        """Transform world points into the camera's frame.

        Parameters
        ----------
        points_mm
            Points in the world, shape (..., 3).

        Returns
        -------
        numpy.ndarray
            The points in the camera's frame in mm, shape (..., 3), float64.
        """
        return self.directions_to_camera(np.asarray(points_mm, dtype=np.float64) - self.position_mm)

    def directions_to_camera(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions or velocities from the world into the camera's frame.

        Parameters
        ----------
        directions
            Vectors in the world, shape (..., 3).

        Returns
        -------
        numpy.ndarray
            The vectors in the camera's frame, in the same unit, shape (..., 3).
        """
        # Without a rotation, the numbers stay the same to the bit.
        turned = directions if self._straight else np.asarray(directions @ self.rotation)
        return self._sheared(turned, -1.0)

    def directions_to_world(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rotate directions from the camera's frame into the world.

        Parameters
        ----------
        directions
            Vectors in the camera's frame, shape (..., 3).

        Returns
        -------
        numpy.ndarray
            The vectors in the world, in the same unit, shape (..., 3).
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
