"""The parameters of a fit at every pixel, and what they make of a pixel and of its neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.solving import ALL, FULL

__all__ = ["CURVATURES", "STEADY_PLACES", "accelerated", "carried", "fields_of", "fill_between", "started"]

STEADY_PLACES = [0, 6, 9, 12]
"""Places of d, q_X, q_Y and q_Z among the parameters."""
CURVATURES = [3, 4, 5]
"""Places of d_xx, d_xy and d_yy."""
_ACCELERATION = [15, 16, 17]

Map = NDArray[np.float64]


def started(start: Map, *, accelerated: bool) -> Map:
    """Return parameters to start from, shape (15 or 18, y, x).

    Parameters
    ----------
    start
        Disparity and velocity, shape (4, y, x).
    accelerated
        Whether there is room for an acceleration.
    """
    theta = np.zeros((ALL if accelerated else FULL, *start.shape[1:]))
    theta[STEADY_PLACES] = start
    return theta


def accelerated(theta: Map) -> Map:
    """Return parameters with room for an acceleration, which is 0 if there was none, shape (18, y, x).

    Parameters
    ----------
    theta
        Parameters, shape (15 or 18, y, x).
    """
    out = np.zeros((ALL, *theta.shape[1:]))
    out[: len(theta)] = theta
    return out


def fields_of(theta: Map) -> Map:
    """Return d and q at the pixels, and their acceleration if there is one, shape (4 or 7, y, x).

    Parameters
    ----------
    theta
        Parameters, shape (15 or 18, y, x).
    """
    return theta[STEADY_PLACES + (_ACCELERATION if len(theta) > FULL else [])]


def fill_between(theta: Map) -> None:
    """Give every pixel in odd rows or columns the parameters of the pixel above, or at the left, carried to it.

    Parameters
    ----------
    theta
        Parameters, shape (15 or 18, y, x); read at even rows and columns, written elsewhere.
    """
    even = theta[:, ::2, ::2]
    for down, right in ((0, 1), (1, 0), (1, 1)):
        out = theta[:, down::2, right::2]
        out[:] = _moved(even[:, : out.shape[1], : out.shape[2]], right, down)


def carried(theta: Map, right: int, down: int) -> Map:
    """Return parameters at every pixel as the model of a pixel beside it has them.

    Parameters
    ----------
    theta
        Parameters of the full model, shape (15 or 18, y, x).
    right, down
        By how many pixels they are carried, in columns and rows; NaN where they would come from outside.
    """
    height, width = theta.shape[1:]
    out = np.full_like(theta, np.nan)
    if abs(right) >= width or abs(down) >= height:
        return out
    rows, columns = slice(max(down, 0), height + min(down, 0)), slice(max(right, 0), width + min(right, 0))
    from_rows = slice(max(-down, 0), height + min(-down, 0))
    out[:, rows, columns] = _moved(theta[:, from_rows, max(-right, 0) : width + min(-right, 0)], right, down)
    return out


def _moved(p: Map, right: int, down: int) -> Map:
    """Return parameters as of another place in the window, so many columns and rows away."""
    moved = p.copy()
    x, y = float(right), float(down)
    moved[0] += p[1] * x + p[2] * y + p[3] * x * x + p[4] * x * y + p[5] * y * y
    moved[1] += 2.0 * p[3] * x + p[4] * y
    moved[2] += p[4] * x + 2.0 * p[5] * y
    for k in STEADY_PLACES[1:]:
        moved[k] += p[k + 1] * x + p[k + 2] * y
    return moved
