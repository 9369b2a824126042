"""How blocks of pixels move in the images when their depth, their motion or the images' places change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["CORRECTIONS", "Moves", "moves_of"]

CORRECTIONS = 4
"""Corrections of an image: along x and y in px, roll in rad, larger by a share."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Moves:
    """Derivatives of where images show points, x and y in px."""

    by_point: Array
    """By d, q_X, q_Y, q_Z and the point's column and row; behind them, if wanted, by the acceleration along X and Y;
    shape (points, n, 2, 6 or 8)."""
    by_image: Array
    """By the corrections of the image itself, shape (points, n, 2, 4)."""


def moves_of(view: View, fields: Array, at: Array, *, accelerated: bool = False) -> Moves:
    """Return how points move in images.

    Parameters
    ----------
    view
        Where and when the images were taken.
    fields
        d, q_X, q_Y and q_Z of the points, shape (4, points).
    at
        Column and row of the points in the reference image, shape (2, points).
    accelerated
        Whether the points' velocity may change.
    """
    d, q_x, q_y, q_z = fields[:, :, None]
    s, s_y, t = view.s[None], view.s_y[None], view.t[None]
    scale = 1.0 / (1.0 + t * d * q_z / view.focal)
    x = (at[0][:, None] - view.centre_x + d * (t * q_x - s)) * scale
    y = (at[1][:, None] - view.centre_y + d * (t * q_y - s_y)) * scale
    nil, one = np.zeros_like(x), np.ones_like(x)
    shrink = t / view.focal
    right = [scale * (t * q_x - s - x * shrink * q_z), scale * d * t, nil, -scale * d * shrink * x, one, nil]
    down = [scale * (t * q_y - s_y - y * shrink * q_z), nil, scale * d * t, -scale * d * shrink * y, nil, one]
    if accelerated:
        later = 0.5 * scale * d * t**2
        right, down = [*right, later, nil], [*down, nil, later]
    by_point = np.stack([np.stack(np.broadcast_arrays(*each), axis=-1) for each in (right, down)], axis=2)
    by_image = np.stack([np.stack([one, nil, -y, x], axis=-1), np.stack([nil, one, x, y], axis=-1)], axis=2)
    return Moves(by_point, by_image)
