"""Kernels for values at the pixels of an image that are computed where they cannot be interpolated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["COARSEST", "EXACT", "LEVELS", "SURE", "UNKNOWN", "find_spread", "mix_light", "predict_level"]

UNKNOWN, EXACT, SURE = 0, 1, 2
"""Knowledge of a pixel: none; a value; and that nothing shades the pixels around it."""
COARSEST = 8
"""Spacing of the first pixels."""
LEVELS = ((4, True), (4, False), (2, True), (2, False), (1, True), (1, False))
"""Steps from a pixel to its nearest known pixels, diagonally (True) or along rows and columns, level by level."""
_FINE = 2  # longest step over which values are interpolated
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


@kernel(error_model="numpy")
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
            if step <= _FINE and worst <= tolerance:
                known[y, x], error[y, x] = EXACT, worst
            else:
                wanted[y, x] = True


def find_spread(
    pixels: NDArray[np.int64], surface: NDArray[np.int32], surfaces: NDArray[np.int32], known: NDArray[np.bool_],
    values: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Return mean and range of both values at the known pixels around pixels, on one surface, shape (n, 4).

    The range is NaN if there is none. ``pixels``: In row-major order, shape (n,). ``surface``: Of each, shape (n,).
    ``surfaces``, ``known``, ``values``: Of the image, shape (height, width, ...).
    """
    out = np.empty((len(pixels), 4))
    in_bands(_find_spread, len(pixels), pixels, surface, surfaces, known, values, out, least=1024)
    return out


@kernel(error_model="numpy")
def _find_spread(
    low: int, high: int, pixels: NDArray[np.int64], surface: NDArray[np.int32], surfaces: NDArray[np.int32],
    known: NDArray[np.bool_], values: NDArray[np.float64], out: NDArray[np.float64],
) -> None:  # fmt: skip
    rows, columns = surfaces.shape
    for n in range(low, high):
        row, column = pixels[n] // columns, pixels[n] % columns
        for reach in range(1, 3):
            count = 0
            for k in range(2):
                total, least, most = 0.0, np.inf, -np.inf
                for v in range(max(row - reach, 0), min(row + reach + 1, rows)):
                    for u in range(max(column - reach, 0), min(column + reach + 1, columns)):
                        if known[v, u] and surfaces[v, u] == surface[n]:
                            total += values[v, u, k]
                            least, most = min(least, values[v, u, k]), max(most, values[v, u, k])
                            count += k
                out[n, k], out[n, 2 + k] = total, most - least
            if count > 0:
                break
        out[n, 0], out[n, 1] = out[n, 0] / count, out[n, 1] / count
        if count == 0:
            out[n, 2] = np.nan


def mix_light(
    corner_light: NDArray[np.float64], faces: NDArray[np.int32], weights: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Interpolate the light at the corners of faces, shape (m, 3, 2), in place; faces without remain unchanged.

    ``faces``, ``weights``: Faces and weights of the second and third corner, shapes (n,) and (n, 2).
    """
    in_bands(_mix_light, len(faces), corner_light, faces, weights, out, least=_LEAST_SAMPLES)


@kernel(error_model="numpy")
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
