"""Kernels for values at the pixels of an image that are computed where they cannot be interpolated."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = [
    "CLEAR",
    "COARSEST",
    "EXACT",
    "LEVELS",
    "STEEP",
    "SURE",
    "UNKNOWN",
    "apply_shares",
    "extrapolate",
    "light_samples",
    "mix_light",
    "predict_level",
]

UNKNOWN, EXACT, SURE = 0, 1, 2
"""Knowledge of a pixel: none; a value; and that nothing shades the pixels around it."""
STEEP, CLEAR = 2, 3
"""Further knowledge of pixels in an image: shares hold for the centre only; nothing shades the pixels around it."""
COARSEST = 8
"""Spacing of the first pixels."""
LEVELS = ((4, True), (4, False), (2, True), (2, False), (1, True), (1, False))
"""Steps from a pixel to its nearest pixels with values, diagonally (True) or along rows and columns, level by level."""
_FINE = 2  # step up to which the tolerance is constant; it decreases with the square of longer steps
_FEWEST, _FLAT = 5, 0.03  # pixels around a point from which values are extrapolated, and their distance from a plane
_SAME = 1e-3  # difference from no light and all light
_LEAST_ROWS, _LEAST_SAMPLES = 8, 16384


def predict_level(
    step: int,
    diagonal: bool,
    label: NDArray[np.int32],
    known: NDArray[np.uint8],
    values: NDArray[np.float64],
    error: NDArray[np.float64],
    tolerance: float,
) -> NDArray[np.bool_]:
    """Interpolate the pixels of one level, in place, and return those that must be computed, shape (height, width).

    ``label``: Number of the surface at each pixel, 0 for none, shape (height, width).
    ``known``: `UNKNOWN`, `EXACT` or `SURE`. ``values``: Shape (height, width, 2); for pixels to be computed, the
      interpolated values, or NaN.
    ``error``: Difference of interpolated from computed values.
    ``tolerance``: Largest difference at the nearest pixels for which values are interpolated.
    """
    wanted = np.zeros(label.shape, dtype=np.bool_)
    maps = (label, known, values, error, wanted)
    in_bands(_predict_level, label.shape[0], step, diagonal, *maps, tolerance, least=_LEAST_ROWS)
    return wanted


@kernel()
def _predict_level(
    low: int, high: int, step: int, diagonal: bool, label: NDArray[np.int32], known: NDArray[np.uint8],
    values: NDArray[np.float64], error: NDArray[np.float64], wanted: NDArray[np.bool_], tolerance: float,
) -> None:  # fmt: skip
    rows, columns = label.shape
    near = np.array([[1, 1], [-1, -1], [1, -1], [-1, 1]]) if diagonal else np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    far = np.array([[3, 1], [3, -1], [-3, 1], [-3, -1], [1, 3], [-1, 3], [1, -3], [-1, -3]])
    if not diagonal:
        far = np.array([[2, 1], [2, -1], [-2, 1], [-2, -1], [1, 2], [-1, 2], [1, -2], [-1, -2]])
    for y in range(low, high):
        if y % step != 0 or (diagonal and y % (2 * step) != step):
            continue
        odd = step if diagonal or y % (2 * step) == 0 else 0
        for x in range(odd, columns, 2 * step):
            own = label[y, x]
            if own == 0 or known[y, x] != UNKNOWN:
                continue
            count, sure, worst, one, other = 0, 0, 0.0, 0.0, 0.0
            pairs, half_one, half_other = 0, 0.0, 0.0
            for k in range(4):
                v, u = y + near[k, 0] * step, x + near[k, 1] * step
                if v < 0 or u < 0 or v >= rows or u >= columns or label[v, u] != own or known[v, u] == UNKNOWN:
                    continue
                count += 1
                sure += known[v, u] == SURE
                # Errors of the level before.
                if (v // step % 2 == 1 and u // step % 2 == 1) or (diagonal and (v + u) // step % 4 == 2):
                    worst = max(worst, error[v, u])
                one, other = one + values[v, u, 0], other + values[v, u, 1]
                v, u = y - near[k, 0] * step, x - near[k, 1] * step
                if k % 2 == 0 and 0 <= v < rows and 0 <= u < columns and label[v, u] == own and known[v, u] != UNKNOWN:
                    pairs += 1
                    half_one += 0.5 * (values[v, u, 0] + values[y + near[k, 0] * step, x + near[k, 1] * step, 0])
                    half_other += 0.5 * (values[v, u, 1] + values[y + near[k, 0] * step, x + near[k, 1] * step, 1])
            if count >= 2 and sure == count:
                known[y, x], values[y, x, 0], values[y, x, 1], error[y, x] = SURE, 1.0, 1.0, 0.0
                continue
            if pairs == 0:
                wanted[y, x] = True
                values[y, x, 0], values[y, x, 1] = np.nan, np.nan
                continue
            one, other = half_one / pairs, half_other / pairs
            if count == 4:
                beyond, far_one, far_other = 0, 0.0, 0.0
                for k in range(8):
                    v, u = y + far[k, 0] * step, x + far[k, 1] * step
                    if v < 0 or u < 0 or v >= rows or u >= columns or label[v, u] != own or known[v, u] == UNKNOWN:
                        break
                    beyond += 1
                    far_one, far_other = far_one + values[v, u, 0], far_other + values[v, u, 1]
                if beyond == 8:
                    # Exact for cubic functions.
                    one, other = 1.25 * one - far_one / 32.0, 1.25 * other - far_other / 32.0
            values[y, x, 0], values[y, x, 1] = min(max(one, 0.0), 1.0), min(max(other, 0.0), 1.0)
            if worst * max(step, _FINE) ** 2 <= tolerance * _FINE**2:
                known[y, x], error[y, x] = EXACT, worst
            else:
                wanted[y, x] = True


def extrapolate(
    pixels: NDArray[np.int64],
    places: tuple[NDArray[np.int32], NDArray[np.float64]],
    image: tuple[NDArray[np.int32], NDArray[np.float64]],
    knowledge: NDArray[np.uint8],
    values: NDArray[np.float64],
    apart: float,
) -> NDArray[np.float64]:
    """Return both values at points from planes through the pixels with values around them, and the range, shape (n, 3).

    ``pixels``: In row-major order, shape (n,).
    ``places``: Body of each point, and distance from the camera, shape (n,) each.
    ``image``: The same for all pixels, shape (height, width) each.
    ``knowledge``: See `apply_shares`, shape (height, width). ``values``: Shape (height, width, 2).
    ``apart``: Difference of the distances between surfaces, relative to the distance.
    Returns: The range of the values of the pixels; NaN if there are too few, if they do not lie in a plane within
    `_FLAT`, or if the point may be in a shadow that they do not see.
    """
    out = np.empty((len(pixels), 3))
    maps = (places, image, knowledge, values, apart)
    in_bands(_extrapolate, len(pixels), pixels, *maps, out, least=1024)
    return out


@kernel()
def _extrapolate(
    low: int, high: int, pixels: NDArray[np.int64], places: tuple[Any, ...], image: tuple[Any, ...],
    knowledge: NDArray[np.uint8], values: NDArray[np.float64], apart: float, out: NDArray[np.float64],
) -> None:  # fmt: skip
    bodies, distances = places
    body, distance = image
    rows, columns = body.shape
    around = np.empty((25, 4))
    for n in range(low, high):
        row, column = pixels[n] // columns, pixels[n] % columns
        count, sure, least, most = 0, 0, np.inf, -np.inf
        x, y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(max(row - 2, 0), min(row + 3, rows)):
            for u in range(max(column - 2, 0), min(column + 3, columns)):
                near = abs(distance[v, u] - distances[n]) < apart * distances[n]
                if not near or body[v, u] != bodies[n] or knowledge[v, u] == UNKNOWN:
                    continue
                sure += knowledge[v, u] == CLEAR
                around[count, 0], around[count, 1] = float(u - column), float(v - row)
                around[count, 2], around[count, 3] = values[v, u, 0], values[v, u, 1]
                for k in range(2):
                    least, most = min(least, values[v, u, k]), max(most, values[v, u, k])
                count += 1
        out[n, 2] = most - least
        if count > 0 and sure == count:
            out[n, 0], out[n, 1] = 1.0, 1.0
            continue
        for item in range(count):
            x, y = x + around[item, 0] / count, y + around[item, 1] / count
        for item in range(count):
            u, v = around[item, 0] - x, around[item, 1] - y
            xx, xy, yy = xx + u * u, xy + u * v, yy + v * v
        square = xx * yy - xy * xy
        # Surfaces that are not partly in the shadow may be next to one.
        if count < _FEWEST or square < 1.0 or least > 1.0 - _SAME or most < _SAME:
            out[n, 2] = np.nan
            continue
        for k in range(2):
            mean, along, down, worst = 0.0, 0.0, 0.0, 0.0
            for item in range(count):
                mean += around[item, 2 + k] / count
            for item in range(count):
                value = around[item, 2 + k] - mean
                along, down = along + value * (around[item, 0] - x), down + value * (around[item, 1] - y)
            slope, fall = (along * yy - down * xy) / square, (down * xx - along * xy) / square
            for item in range(count):
                plane = mean + slope * (around[item, 0] - x) + fall * (around[item, 1] - y)
                worst = max(worst, abs(around[item, 2 + k] - plane))
            out[n, k] = min(max(mean - slope * x - fall * y, 0.0), 1.0)
            if worst > _FLAT:
                out[n, 2] = np.nan


def mix_light(
    corner_light: NDArray[np.float64], faces: NDArray[np.int32], weights: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Interpolate the light at the corners of faces, shape (m, 3, 2), in place; faces without remain unchanged.

    ``faces``, ``weights``: Faces and weights of the second and third corner, shapes (n,) and (n, 2).
    """
    in_bands(_mix_light, len(faces), corner_light, faces, weights, out, least=_LEAST_SAMPLES)


@kernel()
def _mix_light(
    low: int, high: int, corner_light: NDArray[np.float64], faces: NDArray[np.int32], weights: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    for n in range(low, high):
        face, one, other = faces[n], weights[n, 0], weights[n, 1]
        first, gloss = corner_light[face, 0, 0], corner_light[face, 0, 1]
        if first == first:
            out[n, 0] = first + one * (corner_light[face, 1, 0] - first) + other * (corner_light[face, 2, 0] - first)
            out[n, 1] = gloss + one * (corner_light[face, 1, 1] - gloss) + other * (corner_light[face, 2, 1] - gloss)


def apply_shares(
    pixels: NDArray[np.int64],
    bodies: NDArray[np.int32],
    body: NDArray[np.int32],
    knowledge: NDArray[np.uint8],
    shares: NDArray[np.float64],
    light: NDArray[np.float64],
) -> NDArray[np.uint8]:
    """Multiply light by the shares of the pixels, in place, and return what is left to do, shape (n,).

    ``pixels``, ``bodies``: Pixel and body of each sample, shape (n,).
    ``body``, ``knowledge``, ``shares``: Body of each pixel, shape (k,); `UNKNOWN`, `EXACT`, `STEEP` or `CLEAR`; and
      the shares, shape (k, 2).
    ``light``: Shape (n, 2). Returns: 0 for samples with shares, 1 if they are unknown, 2 if they must be computed.
    """
    left = np.empty(len(pixels), dtype=np.uint8)
    in_bands(_apply_shares, len(pixels), pixels, bodies, body, knowledge, shares, light, left, least=_LEAST_SAMPLES)
    return left


@kernel()
def _apply_shares(
    low: int, high: int, pixels: NDArray[np.int64], bodies: NDArray[np.int32], body: NDArray[np.int32],
    knowledge: NDArray[np.uint8], shares: NDArray[np.float64], light: NDArray[np.float64], left: NDArray[np.uint8],
) -> None:  # fmt: skip
    for n in range(low, high):
        pixel = pixels[n]
        if body[pixel] != bodies[n] or knowledge[pixel] == UNKNOWN:
            left[n] = 1
            continue
        left[n] = 2 if knowledge[pixel] == STEEP else 0
        if left[n] == 0:
            light[n, 0], light[n, 1] = light[n, 0] * shares[pixel, 0], light[n, 1] * shares[pixel, 1]


def light_samples(
    samples: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]],
    corner_light: NDArray[np.float64],
    face_body: NDArray[np.int32],
    body: NDArray[np.int32],
    knowledge: NDArray[np.uint8],
    shares: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Light samples by lamps and ambient light where light at the corners of their faces and shares are available.

    ``samples``: Pixel and face of each, shape (n,), and weights of the second and third corner, shape (n, 2).
    ``corner_light``: Light of each lamp and ambient light at the corners of faces, shape (lamps + 1, m, 3, 2).
    ``face_body``: Body of each face, shape (m,). ``body``, ``knowledge``: As for `apply_shares`.
    ``shares``: For each lamp, shape (lamps, k, 2).
    Returns: Factors and gloss, shape (n,) each; and the indices of the samples without a value.
    """
    count = len(samples[0])
    factors, gloss, left = np.empty(count), np.empty(count), np.empty(count, dtype=np.bool_)
    maps = (corner_light, face_body, body, knowledge, shares)
    in_bands(_light_samples, count, samples, *maps, factors, gloss, left, least=_LEAST_SAMPLES)
    return factors, gloss, np.flatnonzero(left)


@kernel()
def _light_samples(
    low: int, high: int, samples: tuple[Any, ...], corner_light: NDArray[np.float64], face_body: NDArray[np.int32],
    body: NDArray[np.int32], knowledge: NDArray[np.uint8], shares: NDArray[np.float64], factors: NDArray[np.float64],
    gloss: NDArray[np.float64], left: NDArray[np.bool_],
) -> None:  # fmt: skip
    pixels, faces, weights = samples
    lamps = shares.shape[0]
    for n in range(low, high):
        pixel, face, one, other = pixels[n], faces[n], weights[n, 0], weights[n, 1]
        first = 1.0 - one - other
        left[n] = body[pixel] != face_body[face] or knowledge[pixel] == UNKNOWN or knowledge[pixel] == STEEP
        total, shine = 0.0, 0.0
        for lamp in range(lamps + 1):
            light = first * corner_light[lamp, face, 0, 0] + one * corner_light[lamp, face, 1, 0]
            light += other * corner_light[lamp, face, 2, 0]
            bright = first * corner_light[lamp, face, 0, 1] + one * corner_light[lamp, face, 1, 1]
            bright += other * corner_light[lamp, face, 2, 1]
            if lamp < lamps:
                light, bright = light * shares[lamp, pixel, 0], bright * shares[lamp, pixel, 1]
            total, shine = total + light, shine + bright
        # Light that is not interpolated is NaN.
        if total != total:
            left[n] = True
        factors[n], gloss[n] = total, shine
