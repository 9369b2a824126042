"""What a camera sees of coarse meshes at the pixels of a coarse picture, in plain NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["picture_of", "pieces_of"]

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# A point is on a triangle if it is outside by less than this share of it: no gaps between neighbours.
_SLACK = 1e-9
# Pairs of a triangle and a pixel in its box that are tried at a time.
_AT_A_TIME = 2_000_000


def picture_of(corners_mm: Array, focal_px: float, x_px: Array, y_px: Array) -> Numbers:
    """Return the nearest triangle at points of the image.

    Parameters
    ----------
    corners_mm
        Corners of the triangles before the camera, shape (m, 3, 3).
    focal_px
        Focal length.
    x_px, y_px
        Columns and rows, evenly spaced, from the principal point.

    Returns
    -------
    numpy.ndarray
        Numbers of triangles, -1 for none, shape (rows, columns).
    """
    width, height = len(x_px), len(y_px)
    nearest = np.zeros(width * height)
    face = np.full(width * height, -1, dtype=np.int64)
    ahead = np.flatnonzero((corners_mm[..., 2] > 0).all(axis=1))
    inverse = 1.0 / corners_mm[ahead, :, 2]
    x, y = (focal_px * corners_mm[ahead, :, k] * inverse for k in range(2))
    left, right = _span(x, x_px)
    top, bottom = _span(y, y_px)
    across, down = np.maximum(right - left, 0), np.maximum(bottom - top, 0)
    counts = across * down
    ends = np.cumsum(counts)
    first = 0
    while first < len(ahead):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + _AT_A_TIME, side="right")), first + 1)
        some = np.arange(first, last)
        triangle = np.repeat(some, counts[some])
        place = np.arange(len(triangle)) - np.repeat(ends[some] - counts[some] - before, counts[some])
        column = left[triangle] + place % np.maximum(across[triangle], 1)
        row = top[triangle] + place // np.maximum(across[triangle], 1)
        with np.errstate(all="ignore"):
            # Triangles that are seen edge on have no area.
            found = _inverse_depth(x[triangle], y[triangle], inverse[triangle], x_px[column], y_px[row])
        hit = found > 0
        pixel, found, triangle = (row * width + column)[hit], found[hit], triangle[hit]
        order = np.lexsort((found, pixel))
        pixel, found, triangle = pixel[order], found[order], triangle[order]
        # The last of each pixel is the nearest.
        closest = np.ones(len(pixel), dtype=np.bool_)
        closest[:-1] = pixel[1:] != pixel[:-1]
        pixel, found, triangle = pixel[closest], found[closest], triangle[closest]
        better = found > nearest[pixel]
        nearest[pixel[better]], face[pixel[better]] = found[better], ahead[triangle[better]]
        first = last
    return face.reshape(height, width)


def pieces_of(face: Numbers, normals: Array, body: Numbers, most_turned: Array) -> Numbers:
    """Give numbers to pieces of surface: neighbours in a picture on one body whose normals hardly differ are of one.

    Parameters
    ----------
    face
        As of `picture_of`.
    normals, body
        Of the triangles: unit normals towards the camera, and the object, shape (m, 3) and (m,).
    most_turned
        Cosine of the angle between neighbours that is an edge, by body.

    Returns
    -------
    numpy.ndarray
        The same shape: any number for each piece, -1 where nothing is seen.
    """
    number = np.arange(face.size).reshape(face.shape)
    seen = face >= 0
    own, normal = np.where(seen, body[face], -1), normals[face]
    pairs = []
    for one, other in (((slice(None), slice(1, None)), (slice(None), slice(-1))), (slice(1, None), slice(-1))):
        same = (own[one] == own[other]) & seen[one] & seen[other]
        same &= (normal[one] * normal[other]).sum(axis=-1) >= most_turned[own[one]]
        pairs.append(np.stack([number[one][same], number[other][same]]))
    one, other = np.concatenate(pairs, axis=1)
    label = number.ravel().copy()
    while True:
        least = np.minimum(label[one], label[other])
        before = label.copy()
        np.minimum.at(label, label[one], least)
        np.minimum.at(label, label[other], least)
        label = label[label]
        if (label == before).all():
            break
    return np.where(seen, label.reshape(face.shape), -1)


def _span(corners: Array, places: Array) -> tuple[Numbers, Numbers]:
    """Return the first, and the last + 1, of evenly spaced places that lie between the corners of triangles."""
    step = places[1] - places[0] if len(places) > 1 else 1.0
    low, high = (each - places[0] for each in (corners.min(axis=1), corners.max(axis=1)))
    first = np.clip(np.ceil(low / step - _SLACK), 0, len(places)).astype(np.int64)
    last = np.clip(np.floor(high / step + _SLACK) + 1, 0, len(places)).astype(np.int64)
    return first, last


def _inverse_depth(x: Array, y: Array, inverse: Array, at_x: Array, at_y: Array) -> Array:
    """Return 1/Z, linear in the image, of triangles at points; 0 outside of them."""
    one_x, one_y, two_x, two_y = (each[:, k] - each[:, 0] for k in (1, 2) for each in (x, y))
    area = one_x * two_y - one_y * two_x
    p_x, p_y = at_x - x[:, 0], at_y - y[:, 0]
    b = (p_x * two_y - p_y * two_x) / area
    c = (one_x * p_y - one_y * p_x) / area
    inside = (b >= -_SLACK) & (c >= -_SLACK) & (b + c <= 1 + _SLACK)
    value = inverse[:, 0] + b * (inverse[:, 1] - inverse[:, 0]) + c * (inverse[:, 2] - inverse[:, 0])
    return np.where(inside, value, 0.0)
