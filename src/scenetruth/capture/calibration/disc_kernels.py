"""Kernels that fit the blurred edge of an ellipse to the image of a dot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenetruth.capture.calibration.corner_kernels import (
    PART,
    PART_VARIANCE,
    add_pixel,
    damped_step,
    position_covariance,
)
from scenetruth.kernels import kernel, subkernel

__all__ = ["fit_discs"]

_PARAMETERS = 10  # x, y, radius, blur, ground, contrast, two slopes of the ground and of the contrast
_ROUNDS = 25
_CONVERGED = 1e-4  # squared length of a step in standard deviations: 0.01 of the uncertainty
_LEAST_BLUR, _LARGEST_BLUR = 0.1, 8.0
_FEWEST = 20  # pixels
_FAR = 4.0  # erfc(4) = 1.5e-8
_SMALLEST, _LARGEST = 0.6, 1.4  # radius, in the expected radius


@subkernel()
def _accumulate(
    values: NDArray[np.float64], variances: NDArray[np.float64], places: NDArray[np.float64], count: int,
    inverse: NDArray[np.float64], p: NDArray[np.float64], normal: NDArray[np.float64], gradient: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Write the normal equations of the disc; return the robust cost and the weighted sum of squares."""
    normal[:] = 0.0
    gradient[:] = 0.0
    total = p[3] * p[3] + PART_VARIANCE
    unit = math.sqrt(2.0 * total)
    # The shorter semi-axis of the dot in px: the inverse of the largest singular value.
    determinant = inverse[0, 0] * inverse[1, 1] - inverse[0, 1] * inverse[1, 0]
    square = inverse[0, 0] ** 2 + inverse[0, 1] ** 2 + inverse[1, 0] ** 2 + inverse[1, 1] ** 2
    shortest = 1.0 / math.sqrt(0.5 * (square + math.sqrt(max(square * square - 4.0 * determinant * determinant, 0.0))))
    slope = np.empty(_PARAMETERS)
    cost = squares = 0.0
    for n in range(count):
        contrast = p[5] + p[8] * places[n, 0] + p[9] * places[n, 1]
        slope[:4] = 0.0
        # Pixels away from the edge have no other derivatives than those of their level.
        dx, dy = places[n, 0] - p[0], places[n, 1] - p[1]
        away = math.hypot(inverse[0, 0] * dx + inverse[0, 1] * dy, inverse[1, 0] * dx + inverse[1, 1] * dy) - p[2]
        inside = 1.0 if away < 0.0 else 0.0
        near = abs(away) * shortest < _FAR * unit + 1.0
        if near:
            inside = 0.0
        for part in range(4 if near else 0):
            dx = places[n, 0] - p[0] + (PART if part % 2 else -PART)
            dy = places[n, 1] - p[1] + (PART if part > 1 else -PART)
            a = inverse[0, 0] * dx + inverse[0, 1] * dy
            b = inverse[1, 0] * dx + inverse[1, 1] * dy
            radius = max(math.hypot(a, b), 1e-9)
            # Gradient of the radius; the distance from the edge in px is that of the radius over its length.
            g_x = (inverse[0, 0] * a + inverse[1, 0] * b) / radius
            g_y = (inverse[0, 1] * a + inverse[1, 1] * b) / radius
            length = math.hypot(g_x, g_y)
            u = (radius - p[2]) / (length * unit)
            inside += 0.125 * math.erfc(u)
            edge = 0.25 * contrast * math.exp(-u * u) / (math.sqrt(math.pi) * unit)
            slope[0] += edge * g_x / length
            slope[1] += edge * g_y / length
            slope[2] += edge / length
            slope[3] += edge * unit * u * p[3] / total
        slope[4] = 1.0
        slope[5] = inside
        slope[6] = places[n, 0]
        slope[7] = places[n, 1]
        slope[8] = inside * places[n, 0]
        slope[9] = inside * places[n, 1]
        level = p[4] + p[6] * places[n, 0] + p[7] * places[n, 1] + contrast * inside
        robust, square = add_pixel(values[n] - level, variances[n], slope, normal, gradient)
        cost, squares = cost + robust, squares + square
    return cost, squares


@kernel()
def fit_discs(
    image: NDArray[np.float64], variance: NDArray[np.float64], starts: NDArray[np.float64],
    axes: NDArray[np.float64], inner: float, outer: float, found: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fit ellipses of given form with blurred edges to the images of dots; dot and ground are planes of grey values.

    ``image``, ``variance``: Grey values and the variances of their noise, shape (rows, columns).
    ``starts``: Start positions (x, y) in px, shape (n, 2).
    ``axes``: Pixels per radius of a dot along the rows and columns of the board, shape (n, 2, 2).
    ``inner``, ``outer``: Range of the pixels used, in radii; the middle may have a hole.
    ``found``: Values to write, NaN where the fit fails: x, y, variances of x and y and their covariance, blur in px,
      mean square of the residuals, contrast, radius in the expected radius; shape (n, 9).
    """
    rows, columns = image.shape
    normal, gradient = np.empty((_PARAMETERS, _PARAMETERS)), np.empty(_PARAMETERS)
    work, right = np.empty((_PARAMETERS, _PARAMETERS)), np.empty((_PARAMETERS, 1))
    unit = np.empty((_PARAMETERS, 2))
    p, trial, inverse = np.empty(_PARAMETERS), np.empty(_PARAMETERS), np.empty((2, 2))
    for dot in range(starts.shape[0]):
        found[dot] = np.nan
        a, b, c, d = axes[dot, 0, 0], axes[dot, 0, 1], axes[dot, 1, 0], axes[dot, 1, 1]
        determinant = a * d - b * c
        if not abs(determinant) > 0.0:
            continue
        inverse[0, 0], inverse[0, 1] = d / determinant, -b / determinant
        inverse[1, 0], inverse[1, 1] = -c / determinant, a / determinant
        centre_x, centre_y = round(starts[dot, 0]), round(starts[dot, 1])
        wide, tall = math.ceil(outer * math.hypot(a, b)) + 1, math.ceil(outer * math.hypot(c, d)) + 1
        left, last = centre_x - wide, centre_x + wide
        top, bottom = centre_y - tall, centre_y + tall
        if left < 0 or top < 0 or last >= columns or bottom >= rows:
            continue
        most = (2 * wide + 1) * (2 * tall + 1)
        values, variances, places = np.empty(most), np.empty(most), np.empty((most, 2))
        count = within = beyond = 0
        level = ground = 0.0
        usable = True
        for y in range(top, bottom + 1):
            for x in range(left, last + 1):
                dx, dy = x - starts[dot, 0], y - starts[dot, 1]
                radius = math.hypot(
                    inverse[0, 0] * dx + inverse[0, 1] * dy, inverse[1, 0] * dx + inverse[1, 1] * dy
                )  # fmt: skip
                if not inner <= radius <= outer:
                    continue
                if not (math.isfinite(image[y, x]) and variance[y, x] > 0.0):
                    usable = False
                    continue
                values[count], variances[count] = image[y, x], variance[y, x]
                places[count, 0], places[count, 1] = x - centre_x, y - centre_y
                count += 1
                if radius < 0.9:
                    level += image[y, x]
                    within += 1
                elif radius > 1.1:
                    ground += image[y, x]
                    beyond += 1
        if not usable or count < _FEWEST or within == 0 or beyond == 0:
            continue
        p[0], p[1], p[2], p[3] = starts[dot, 0] - centre_x, starts[dot, 1] - centre_y, 1.0, 0.9
        p[4], p[5] = ground / beyond, level / within - ground / beyond
        p[6:] = 0.0
        damping = 1e-3
        cost, squares = _accumulate(values, variances, places, count, inverse, p, normal, gradient)
        converged, factor = False, 1.0
        for turn in range(_ROUNDS):
            if turn == 3 or turn == 6:
                # Where the model or the noise is worse than stated, outliers are those of the larger residuals.
                more = squares / count
                if more > 1.0:
                    factor *= more
                    # Not as an array: the message for other shapes takes as long to compile as the loop.
                    for n in range(count):
                        variances[n] *= more
                    cost, squares = _accumulate(
                        values, variances, places, count, inverse, p, normal, gradient
                    )  # fmt: skip
            if not damped_step(normal, gradient, damping, p, work, right, trial):
                damping = max(10.0 * damping, 1e-6)
                continue
            trial[3] = min(max(trial[3], _LEAST_BLUR), _LARGEST_BLUR)
            trial[2] = min(max(trial[2], _SMALLEST), _LARGEST)
            # A parameter at its limit makes no step.
            step = 0.0
            for i in range(_PARAMETERS):
                step += (trial[i] - p[i]) * gradient[i]
            small = step < _CONVERGED * max(1.0, squares / count)
            later, later_squares = _accumulate(values, variances, places, count, inverse, trial, normal, gradient)
            if later <= cost * (1.0 + 1e-9):
                for i in range(_PARAMETERS):
                    p[i] = trial[i]
                cost, squares, damping = later, later_squares, 0.1 * damping
                if small:
                    converged = True
                    break
            else:
                damping = max(10.0 * damping, 1e-6)
                _accumulate(values, variances, places, count, inverse, p, normal, gradient)
                # At the minimum, rounding decides about a small step.
                converged = small
                if converged or damping > 1e6:
                    break
        if not converged or not _SMALLEST < p[2] < _LARGEST or p[3] >= _LARGEST_BLUR:
            continue
        across, down, both = position_covariance(normal, work, unit)
        if not math.isfinite(across):
            continue
        found[dot, 0], found[dot, 1] = centre_x + p[0], centre_y + p[1]
        found[dot, 2], found[dot, 3], found[dot, 4] = across / factor, down / factor, both / factor
        found[dot, 5], found[dot, 6] = p[3], factor * squares / max(count - _PARAMETERS, 1)
        found[dot, 7], found[dot, 8] = p[5], p[2]
