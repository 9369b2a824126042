"""What the images tell of each pixel's own disparity, velocity and brightness: its Fisher information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.geometry import Points, Views
from scenetruth.bound.model import Model
from scenetruth.bound.texture import Layer

__all__ = ["brightness_of", "pair_of", "products_of", "sensitivity"]

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Rows that are worked on at a time: their arrays stay in a processor's cache.
_ROWS = 16
# Edge-on, a surface shrinks to nothing in an image.
_LEAST_AREA = 1e-3


def pair_of(fields: int) -> dict[tuple[int, int], int]:
    """Return a number for each pair of fields, the first at most as large as the second."""
    return {pair: n for n, pair in enumerate((k, m) for k in range(fields) for m in range(k, fields))}


def brightness_of(views: Views) -> Map:
    """Return the ways in which brightness may change over the images, shape (number, n).

    A gain and an offset of every image may change in as many ways as there are images. Those that can be taken for
    depth or motion change as the surface's places in the images do, but for perspective: in proportion to s and s_y
    (disparity), to t (motion), and to their products (motion in depth changes the disparity).
    """
    s, s_y, t = (each - each.mean() for each in (views.s, views.s_y, views.t))
    ways = (each - each.mean() for each in (s, s_y, t, s * t, s_y * t))
    return np.array([way / np.abs(way).max() for way in ways if np.ptp(way) > 0])


def products_of(points: Points, views: Views, shown: Mask, layers: Sequence[Layer], model: Model) -> Map:
    """Return the Fisher information of every pixel, its texture eliminated.

    With a_i, the derivatives of what image i shows of the pixel's point by its fields, and their mean ā over the images
    that show it, it is Σ_i (a_i - ā)(a_i - ā)ᵀ / σ². Each image counts with one sample for a pixel, whether it shows
    the surface larger or smaller.

    Parameters
    ----------
    points, views
        Where the images show which points.
    shown
        Which do, shape (n, y, x).
    layers
        The texture.
    model
        Tells which fields there are.

    Returns
    -------
    numpy.ndarray
        The products of each pair of fields, in the order of `pair_of`, shape (pairs, y, x).
    """
    height, width = points.d.shape
    pairs = pair_of(model.fields)
    ways = brightness_of(views) if model.brightness else np.zeros((0, len(views)))
    found = np.zeros((len(pairs), height, width))
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        band = points.at((rows, slice(None)))
        first = np.zeros((len(layers), model.fields, *band.d.shape))
        second = np.zeros((len(layers), len(pairs), *band.d.shape))
        for i in range(len(views)):
            if not shown[i, rows].any():
                continue
            inverse, moves = sensitivity(band, views.s[i], views.s_y[i], views.t[i], shown[i, rows])
            for number, layer in enumerate(layers):
                t_x, t_y = layer.gradient[:, rows]
                along = inverse[0] * t_x + inverse[1] * t_y
                down = inverse[2] * t_x + inverse[3] * t_y
                own = [along * moves[0] + down * moves[1]]
                if model.moving:
                    own += [along * moves[2], down * moves[2], along * moves[3] + down * moves[4]]
                own += [layer.one * way * shown[i, rows] for way in ways[:, i]]
                own += [layer.grey[rows] * way * shown[i, rows] for way in ways[:, i]]
                for k, one in enumerate(own):
                    first[number, k] += one
                for (k, m), n in pairs.items():
                    second[number, n] += own[k] * own[m]
        count = np.maximum(shown[:, rows].sum(axis=0), 1)
        for number, layer in enumerate(layers):
            for (k, m), n in pairs.items():
                left = second[number, n] - first[number, k] * first[number, m] / count
                found[n, rows] += layer.weight[rows] * left
    return found


def sensitivity(points: Points, s: float | Map, s_y: float | Map, t: float | Map, shown: Mask) -> tuple[Map, Map]:
    """Return how an image's gradient follows from the texture's, and how its places follow from disparity and velocity.

    Parameters
    ----------
    points
        The points.
    s, s_y, t
        Where and when the image was taken; of several images, arrays that broadcast with those of the points.
    shown
        Whether it shows the points.

    Returns
    -------
    tuple of numpy.ndarray
        The inverse of the places' derivatives along x and y, transposed, as xx, xy, yx, yy: shape (4, ...). Then
        derivatives of the places: x and y by d; x by q_X, which is y by q_Y too; x and y by q_Z: shape (5, ...). The
        former are 0 where the image does not show the point.
    """
    x, y, scale = points.place(s, s_y, t)
    ahead = t * scale / points.focal
    along, down = t * points.q[0] - s, t * points.q[1] - s_y
    nearer_x = ahead * (points.d_x * points.q[2] + points.d * points.q_x[2])
    nearer_y = ahead * (points.d_y * points.q[2] + points.d * points.q_y[2])
    x_x = scale * (1.0 + points.d_x * along + points.d * t * points.q_x[0]) - x * nearer_x
    x_y = scale * (points.d_y * along + points.d * t * points.q_y[0]) - x * nearer_y
    y_x = scale * (points.d_x * down + points.d * t * points.q_x[1]) - y * nearer_x
    y_y = scale * (1.0 + points.d_y * down + points.d * t * points.q_y[1]) - y * nearer_y
    area = x_x * y_y - x_y * y_x
    share = shown / np.where(np.abs(area) > _LEAST_AREA, area, np.inf)
    inverse = np.stack([y_y, -y_x, -x_y, x_x]) * share
    by_q = scale * points.d * t
    by_d = [scale * along - x * ahead * points.q[2], scale * down - y * ahead * points.q[2]]
    return inverse, np.stack([*by_d, by_q, -x * by_q / points.focal, -y * by_q / points.focal])
