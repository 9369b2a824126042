"""Kernel that averages bilinear textures over pixel footprints exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel
from scenetruth.threads import in_bands

__all__ = ["MOST_TEXELS", "bilinear_means"]

MOST_TEXELS = 24
"""Largest extent of a footprint along an axis of the texture, in texels."""

_LEAST = 128  # minimum number of pixels per thread
_GAUSS = 0.5 / np.sqrt(3.0)  # offset of the two Gauss points in an interval of length 1
_SMALLEST = 1e-12  # area in square texels, below which a footprint is a line
_MOST_PERSPECTIVE = 0.005  # relative change of the depth per pixel, above which the correction is inaccurate


def bilinear_means(
    values: NDArray[np.float32], tiled: bool, forms: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Average a bilinear texture over pixels on one plane.

    The footprint of a pixel on the texture is a quadrilateral Q. Green's theorem turns the integral over Q into one
    along its border: ∫_Q f = ∮ F dy with F = ∫ f dx. Between the lines through texel centres, F is a cubic polynomial
    along a straight line, which two Gauss points integrate exactly. Means over a pixel are weighted by the inverse of
    the magnification, which varies in perspective: the variation, of the order of the change of the depth in a pixel,
    is averaged over 2 x 2 Gauss points.

    Parameters
    ----------
    values
        Texture, see `linear_lookup`, shape (h, w).
    tiled
        Whether the texture repeats; otherwise its border is extended.
    forms
        Texture coordinates as quotients of linear forms in the pixel, see `footprint_forms`, shape (n, 3, 3).

    Returns
    -------
    Whether the mean was computed, not for footprints of more than `MOST_TEXELS` texels along an axis, or of surfaces
    that are seen at a grazing angle; and the means; shape (n,) each.
    """
    done, means = np.zeros(len(forms), dtype=np.bool_), np.zeros(len(forms), dtype=np.float32)
    in_bands(_bilinear_means, len(forms), values, tiled, forms, done, means, least=_LEAST)
    return done, means


@kernel(error_model="numpy")
def _bilinear_means(
    low: int, high: int, values: NDArray[np.float32], tiled: bool, forms: NDArray[np.float64],
    done: NDArray[np.bool_], means: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = values.shape
    # Texels around a footprint, and the integrals of their rows from the first column on.
    texels = np.empty((MOST_TEXELS + 3, MOST_TEXELS + 3), dtype=np.float64)
    sums = np.empty((MOST_TEXELS + 3, MOST_TEXELS + 3), dtype=np.float64)
    xs, ys = np.empty(5, dtype=np.float64), np.empty(5, dtype=np.float64)
    for n in range(low, high):
        u0, ux, uy = forms[n, 0, 0] * columns, forms[n, 0, 1] * columns, forms[n, 0, 2] * columns
        v0, vx, vy = forms[n, 1, 0] * rows, forms[n, 1, 1] * rows, forms[n, 1, 2] * rows
        d0, dx, dy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        if not abs(dx) + abs(dy) <= _MOST_PERSPECTIVE * abs(d0):
            continue
        for k in range(4):
            right, below = (0.5 if k == 1 or k == 2 else -0.5), (0.5 if k >= 2 else -0.5)
            inverse = 1.0 / (d0 + right * dx + below * dy)
            xs[k] = (u0 + right * ux + below * uy) * inverse - 0.5
            ys[k] = (v0 + right * vx + below * vy) * inverse - 0.5
        left, most_x = min(xs[0], xs[1], xs[2], xs[3]), max(xs[0], xs[1], xs[2], xs[3])
        top, most_y = min(ys[0], ys[1], ys[2], ys[3]), max(ys[0], ys[1], ys[2], ys[3])
        if not (most_x - left <= MOST_TEXELS and most_y - top <= MOST_TEXELS):
            continue
        # In texels from the first.
        first_x, first_y = np.floor(left), np.floor(top)
        for k in range(4):
            xs[k] -= first_x
            ys[k] -= first_y
        xs[4], ys[4] = xs[0], ys[0]
        area = 0.0
        for k in range(4):
            area += 0.5 * (xs[k + 1] + xs[k]) * (ys[k + 1] - ys[k])
        if not abs(area) > _SMALLEST:
            continue
        across, down = int(most_x - first_x) + 1, int(most_y - first_y) + 1
        i0, j0 = int(first_x), int(first_y)
        if i0 < 0 or j0 < 0 or i0 + across >= columns or j0 + down >= rows:
            for j in range(down + 1):
                row = (j0 + j) % rows if tiled else min(max(j0 + j, 0), rows - 1)
                for i in range(across + 1):
                    column = (i0 + i) % columns if tiled else min(max(i0 + i, 0), columns - 1)
                    texels[j, i] = values[row, column]
        else:
            for j in range(down + 1):
                for i in range(across + 1):
                    texels[j, i] = values[j0 + j, i0 + i]
        for j in range(down + 1):
            total = 0.0
            sums[j, 0] = 0.0
            for i in range(across):
                total += 0.5 * (texels[j, i] + texels[j, i + 1])
                sums[j, i + 1] = total
        integral = 0.0
        for k in range(4):
            x, y = xs[k], ys[k]
            run, rise = xs[k + 1] - x, ys[k + 1] - y
            if rise == 0.0:
                continue
            per_x = 1.0 / run if run != 0.0 else np.inf
            per_y = 1.0 / rise
            # Cell of the start, and the next lines through texel centres.
            i, j = min(int(x), across - 1), min(int(y), down - 1)
            step_i, step_j = (1 if run > 0.0 else -1), (1 if rise > 0.0 else -1)
            if run < 0.0 and x == i and i > 0:
                i -= 1
            if rise < 0.0 and y == j and j > 0:
                j -= 1
            next_x = (i + (1 if run > 0.0 else 0) - x) * per_x if run != 0.0 else np.inf
            next_y = (j + (1 if rise > 0.0 else 0) - y) * per_y
            at = 0.0
            while True:
                to = min(next_x, next_y, 1.0)
                middle, half = 0.5 * (at + to), _GAUSS * (to - at)
                value = 0.0
                for side in range(2):
                    t = middle + (half if side == 1 else -half)
                    a, b = x + t * run - i, y + t * rise - j
                    upper = sums[j, i] + a * (texels[j, i] + 0.5 * a * (texels[j, i + 1] - texels[j, i]))
                    lower = sums[j + 1, i] + a * (
                        texels[j + 1, i] + 0.5 * a * (texels[j + 1, i + 1] - texels[j + 1, i])
                    )
                    value += upper + b * (lower - upper)
                integral += 0.5 * value * (to - at) * rise
                if to >= 1.0:
                    break
                at = to
                if next_x <= next_y:
                    i = min(max(i + step_i, 0), across - 1)
                    next_x += abs(per_x)
                else:
                    j = min(max(j + step_j, 0), down - 1)
                    next_y += abs(per_y)
        mean = integral / area
        # Inverse of the magnification at the Gauss points, relative to its mean.
        if dx != 0.0 or dy != 0.0:
            weights, weighted, plain = 0.0, 0.0, 0.0
            for k in range(4):
                right, below = (_GAUSS if k & 1 else -_GAUSS), (_GAUSS if k & 2 else -_GAUSS)
                inverse = 1.0 / (d0 + right * dx + below * dy)
                x = (u0 + right * ux + below * uy) * inverse - 0.5 - first_x
                y = (v0 + right * vx + below * vy) * inverse - 0.5 - first_y
                i, j = min(max(int(x), 0), across - 1), min(max(int(y), 0), down - 1)
                a, b = x - i, y - j
                upper = texels[j, i] + a * (texels[j, i + 1] - texels[j, i])
                lower = texels[j + 1, i] + a * (texels[j + 1, i + 1] - texels[j + 1, i])
                value, scale = upper + b * (lower - upper), (d0 * inverse) ** 3
                weights, weighted, plain = weights + scale, weighted + scale * value, plain + value
            mean += 0.25 * plain - weighted / weights
        means[n] = mean
        done[n] = True
