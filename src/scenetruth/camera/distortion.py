"""Lens distortion after Brown and Conrady, with OpenCV's coefficients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.model import Finite, FrozenModel

__all__ = ["Distortion"]

Array = NDArray[np.float64]

# Points solved together: what Newton's method keeps of them fits into the cache.
_BLOCK = 8192
_MOST_STEPS = 50
# Newton's method doubles its digits with each step: below this, the next step is exact.
_CONVERGED = 1e-15
_ON_THE_WAY = np.linspace(0.0, 1.0, 17)[1:]


class Distortion(FrozenModel):
    """Where a lens images what a pinhole would image at (x, y), in units of the focal length from the principal point.

    With r² = x² + y²: x_d = x R + 2 p1 x y + p2 (r² + 2 x²), y_d = y R + p1 (r² + 2 y²) + 2 p2 x y,
    R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) (Brown 1971; OpenCV, module calib3d).
    """

    k1: Finite = 0.0
    """Radial coefficient of r²; negative for a barrel."""
    k2: Finite = 0.0
    """Radial coefficient of r⁴."""
    p1: Finite = 0.0
    """First tangential (decentring) coefficient."""
    p2: Finite = 0.0
    """Second tangential coefficient."""
    k3: Finite = 0.0
    """Radial coefficient of r⁶."""
    k4: Finite = 0.0
    """Coefficient of r² in the denominator."""
    k5: Finite = 0.0
    """Coefficient of r⁴ in the denominator."""
    k6: Finite = 0.0
    """Coefficient of r⁶ in the denominator."""

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The coefficients in OpenCV's order (k1, k2, p1, p2, k3, k4, k5, k6)."""
        return (self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6)

    def distort(self, points: Array) -> Array:
        """Distort image positions.

        Parameters
        ----------
        points
            Positions (x, y) in the image of a pinhole, in units of the focal length from the principal point, shape
            (..., 2).

        Returns
        -------
        numpy.ndarray
            Positions (x_d, y_d) in the image of the lens, in the same unit, shape (..., 2).
        """
        x, y = points[..., 0], points[..., 1]
        return self._image(x, y, self._radial(x, y)[0])

    def jacobian(self, points: Array) -> Array:
        """Return the derivatives of `distort`.

        Parameters
        ----------
        points
            Positions as for `distort`, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Shape (..., 2, 2): rows x_d and y_d, columns x and y.
        """
        x, y = points[..., 0], points[..., 1]
        a, b, d = self._slopes(x, y, *self._radial(x, y))
        return np.stack([np.stack([a, b], axis=-1), np.stack([b, d], axis=-1)], axis=-2)

    def undistort(self, points: Array) -> Array:
        """Find the inverse of `distort` by Newton's method.

        Parameters
        ----------
        points
            Distorted positions, shape (..., 2).

        Returns
        -------
        numpy.ndarray
            Positions in the image of a pinhole, shape (..., 2). NaN where the distortion folds the image, so that no
            pinhole position, or more than one, belongs to the distorted one.
        """
        given = np.asarray(points, dtype=np.float64)
        found = np.empty((given.size // 2, 2))
        for first in range(0, len(found), _BLOCK):
            found[first : first + _BLOCK] = self._undistort_block(given.reshape(-1, 2)[first : first + _BLOCK])
        return found.reshape(given.shape)

    def _undistort_block(self, points: Array) -> Array:
        found = self._solve(points)
        # The determinant must stay positive from the axis to the solution: else there are other solutions.
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for share in _ON_THE_WAY:
                x, y = share * found[:, 0], share * found[:, 1]
                a, b, d = self._slopes(x, y, *self._radial(x, y))
                found[~(a * d - b * b > 0)] = np.nan
        return found

    def _solve(self, points: Array) -> Array:
        found = points.copy()
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            for _ in range(_MOST_STEPS):
                x, y = found[:, 0], found[:, 1]
                radial, slope = self._radial(x, y)
                left = self._image(x, y, radial) - points
                a, b, d = self._slopes(x, y, radial, slope)
                step = np.stack([d * left[:, 0] - b * left[:, 1], a * left[:, 1] - b * left[:, 0]], axis=-1)
                step /= (a * d - b * b)[:, None]
                found -= step
                if not (np.abs(step) > _CONVERGED * (1 + np.abs(found))).any():
                    break
            away = ~(np.abs(self.distort(found) - points).max(axis=-1, initial=0.0) < 1e-12)
        found[away] = np.nan
        return found

    def _radial(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return R and dR / d(r²)."""
        square = x * x + y * y
        above, above_slope = _cubic(square, self.k1, self.k2, self.k3)
        below, below_slope = _cubic(square, self.k4, self.k5, self.k6)
        radial = above / below
        return radial, (above_slope - radial * below_slope) / below

    def _image(self, x: Array, y: Array, radial: Array) -> Array:
        square, p1, p2 = x * x + y * y, self.p1, self.p2
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )

    def _slopes(self, x: Array, y: Array, radial: Array, slope: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of x_d along x, of either along the other, which are equal, and of y_d along y."""
        p1, p2 = self.p1, self.p2
        return (
            radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x,
            2 * x * y * slope + 2 * p1 * x + 2 * p2 * y,
            radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x,
        )


def _cubic(square: Array, a: float, b: float, c: float) -> tuple[Any, Any]:
    return 1 + square * (a + square * (b + square * c)), a + square * (2 * b + square * 3 * c)
