"""Kernels that propagate errors of disparity and velocity to the quantities of the surface element, pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenetruth.estimators.refined.kernels.window_solver import FULL, FUNCTIONALS, VALUES, describe_element
from scenetruth.kernels import kernel

__all__ = ["describe_rows", "propagate_rows"]

_jit = kernel(error_model="numpy")

_SURFACE, _GRADIENT = 6, 3  # every parameter of surface and motion
# Models of `describe_element`: with curvatures, and any velocity gradient. Literals would compile it once more.
_CURVED, _FREE = np.int64(3), np.int64(3)


@_jit
def describe_rows(first: int, last: int, theta: Any, x: Any, y: Any, focal: float, out: Any) -> None:
    """Write the quantities of the surface element of some rows: parameters (15, y, x) at the points x, y (y, x).

    ``out``: Output, shape (13, y, x): see `VALUES`.
    """
    values, gradients, own = np.empty(VALUES), np.empty((FUNCTIONALS, FULL)), np.empty(FULL)
    for row in range(first, last):
        for column in range(theta.shape[2]):
            for k in range(FULL):
                own[k] = theta[k, row, column]
            describe_element(_CURVED, _FREE, own, x[row, column], y[row, column], focal, values, gradients)
            for k in range(VALUES):
                out[k, row, column] = values[k]


@_jit
def propagate_rows(
    first: int, last: int, theta: Any, centre: Any, focal: float, covariance: Any, rows: Any, columns: Any, out: Any
) -> None:
    """Write the variances of the quantities of the surface element of some rows.

    ``covariance``: Covariances of the errors of the parameters at a grid of points, (rows, columns, 15, 15); those of
      velocities are multiplied by the disparity of the pixel: they are errors of displacements.
    ``rows``, ``columns``: Places of all rows and columns of the image in this grid, increasing.
    ``out``: Output, shape (11, y, x).
    """
    values, gradients, own = np.empty(VALUES), np.empty((FUNCTIONALS, FULL)), np.empty(FULL)
    mean, by = np.empty((FULL, FULL)), np.empty(FULL)
    down, across = covariance.shape[0], covariance.shape[1]
    for row in range(first, last):
        top = min(int(rows[row]), down - 2)
        below = rows[row] - top
        for column in range(theta.shape[2]):
            for k in range(FULL):
                own[k] = theta[k, row, column]
            d = own[0]
            if not np.isfinite(d):
                for k in range(FUNCTIONALS):
                    out[k, row, column] = np.nan
                continue
            x, y = column - centre[0], row - centre[1]
            describe_element(_CURVED, _FREE, own, x, y, focal, values, gradients)
            left = min(int(columns[column]), across - 2)
            right = columns[column] - left
            for i in range(FULL):
                for j in range(FULL):
                    upper = (1 - right) * covariance[top, left, i, j] + right * covariance[top, left + 1, i, j]
                    lower = (1 - right) * covariance[top + 1, left, i, j] + right * covariance[top + 1, left + 1, i, j]
                    mean[i, j] = (1 - below) * upper + below * lower
            for k in range(FUNCTIONALS):
                for i in range(_SURFACE):
                    by[i] = gradients[k, i]
                # The velocity is w / d with the displacement w: its slopes are w_x / d - w d_x / d².
                for component in range(3):
                    at = _SURFACE + _GRADIENT * component
                    along, beside = gradients[k, at + 1] / d, gradients[k, at + 2] / d
                    by[at] = gradients[k, at] / d - (along * own[1] + beside * own[2]) / d
                    by[at + 1], by[at + 2] = along, beside
                total = 0.0
                for i in range(FULL):
                    for j in range(FULL):
                        total += by[i] * mean[i, j] * by[j]
                out[k, row, column] = total
