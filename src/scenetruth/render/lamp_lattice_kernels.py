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
    "find_bends",
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
_CUBIC = 4.0  # error of a value by a cubic function, where one by lines has that of their difference
_NEAREST = 2.0  # tolerance of what interpolations differ by at the nearest pixels, where most differences halve again
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

    These are pixels next to which computed values differed from interpolation, and those for which interpolations along
    different lines, or by lines and by cubic functions, differ: visibility bends where outlines enter the lamp. On one
    line only, values of shares are between those at its ends, so that half their difference is the largest error.

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
            pairs, half_one, half_other, differs = 0, 0.0, 0.0, 0.0
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
                    end_y, end_x = y + near[k, 0] * step, x + near[k, 1] * step
                    first = 0.5 * (values[v, u, 0] + values[end_y, end_x, 0])
                    second = 0.5 * (values[v, u, 1] + values[end_y, end_x, 1])
                    if pairs == 1:
                        differs = abs(first - values[v, u, 0]) + abs(second - values[v, u, 1])
                    else:
                        differs = abs(first - half_one) + abs(second - half_other)
                    half_one, half_other = half_one + first, half_other + second
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
                    cubic_one, cubic_other = 1.25 * one - far_one / 32.0, 1.25 * other - far_other / 32.0
                    differs = max(differs, _CUBIC * (abs(cubic_one - one) + abs(cubic_other - other)))
                    one, other = cubic_one, cubic_other
            values[y, x, 0], values[y, x, 1] = min(max(one, 0.0), 1.0), min(max(other, 0.0), 1.0)
            limit = tolerance if step > 1 else _NEAREST * tolerance
            if worst * max(step, _FINE) ** 2 <= tolerance * _FINE**2 and differs <= limit:
                known[y, x], error[y, x] = EXACT, worst
            else:
                wanted[y, x] = True


def find_bends(
    label: NDArray[np.int32], known: NDArray[np.uint8], values: NDArray[np.float64], tolerance: float
) -> NDArray[np.bool_]:
    """Return the pixels with a value next to which values bend, shape (height, width).

    At a bend, a value differs from the mean of both its neighbours in the row or in the column by more than the
    tolerance. Arguments as for `predict_level`, with values at all pixels of the surfaces.
    """
    found = np.zeros(label.shape, dtype=np.bool_)
    in_bands(_find_bends, label.shape[0], label, known, values, tolerance, found, least=_LEAST_ROWS)
    return found


@kernel()
def _find_bends(
    low: int, high: int, label: NDArray[np.int32], known: NDArray[np.uint8], values: NDArray[np.float64],
    tolerance: float, found: NDArray[np.bool_],
) -> None:  # fmt: skip
    rows, columns = label.shape
    for y in range(low, high):
        for x in range(columns):
            own = label[y, x]
            if own == 0 or known[y, x] != EXACT:
                continue
            for v in range(max(y - 1, 0), min(y + 2, rows)):
                for u in range(max(x - 1, 0), min(x + 2, columns)):
                    if found[y, x] or label[v, u] != own:
                        continue
                    if 0 < v < rows - 1 and label[v - 1, u] == own and label[v + 1, u] == own:
                        bend = abs(values[v, u, 0] - 0.5 * (values[v - 1, u, 0] + values[v + 1, u, 0]))
                        bend += abs(values[v, u, 1] - 0.5 * (values[v - 1, u, 1] + values[v + 1, u, 1]))
                        found[y, x] = bend > tolerance
                    if 0 < u < columns - 1 and label[v, u - 1] == own and label[v, u + 1] == own:
                        bend = abs(values[v, u, 0] - 0.5 * (values[v, u - 1, 0] + values[v, u + 1, 0]))
                        bend += abs(values[v, u, 1] - 0.5 * (values[v, u - 1, 1] + values[v, u + 1, 1]))
                        found[y, x] |= bend > tolerance


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
