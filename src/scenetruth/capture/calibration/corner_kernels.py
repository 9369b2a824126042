"""Kernels that fit an edge model to the corners of a checkerboard, and centroids of dots."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import kernel, subkernel

__all__ = ["PART", "PART_VARIANCE", "centroids", "fit_corners", "solve_symmetric"]

_PARAMETERS = 9  # x, y, two angles, blur, mean, half contrast, two slopes of the light
_ROUNDS = 40
_HUBER = 3.0
_CONVERGED = 1e-4  # squared length of a step in standard deviations: 0.01 of the uncertainty
_LEAST_BLUR, _LARGEST_BLUR = 0.2, 6.0
# Below this blur two points per axis integrate the edge too coarsely: each pixel is divided into parts.
_SHARP_BLUR, _SHARPEST_BLUR = 0.25, 0.01
_PARTS = np.array([1, 4])
_FAR = 4.0  # erfc(4) = 1.5e-8
_FEWEST = 20  # pixels
# A pixel integrates over its area. Two points per axis and a Gaussian of this variance have the second and fourth
# moment of the box, 1 / 12 and 1 / 80: a^2 = 240^-0.5 and 1 / 12 - a^2.
PART = 240.0**-0.25
PART_VARIANCE = 1.0 / 12.0 - 240.0**-0.5


@subkernel()
def solve_symmetric(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> bool:
    """Solve a symmetric system by Cholesky's method in place of its right sides, shape (n, m); False if singular."""
    n, m = right.shape
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not value > 1e-14:
                    return False
                matrix[i, i] = math.sqrt(value)
            else:
                matrix[i, j] = value / matrix[j, j]
    for c in range(m):
        for i in range(n):
            value = right[i, c]
            for k in range(i):
                value -= matrix[i, k] * right[k, c]
            right[i, c] = value / matrix[i, i]
        for i in range(n - 1, -1, -1):
            value = right[i, c]
            for k in range(i + 1, n):
                value -= matrix[k, i] * right[k, c]
            right[i, c] = value / matrix[i, i]
    return True


@subkernel()
def add_pixel(
    residual: float, variance: float, slope: NDArray[np.float64], normal: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Add a pixel to the normal equations with a robust weight; return its robust cost and weighted square."""
    distance = abs(residual) / math.sqrt(variance)
    weight = 1.0 / variance
    cost = distance * distance
    if distance > _HUBER:
        cost = 2.0 * _HUBER * distance - _HUBER * _HUBER
        weight *= _HUBER / distance
    for i in range(slope.shape[0]):
        gradient[i] += weight * slope[i] * residual
        for j in range(i + 1):
            normal[i, j] += weight * slope[i] * slope[j]
    return cost, weight * residual * residual


@subkernel()
def damped_step(
    normal: NDArray[np.float64], gradient: NDArray[np.float64], damping: float, p: NDArray[np.float64],
    work: NDArray[np.float64], right: NDArray[np.float64], trial: NDArray[np.float64],
) -> bool:  # fmt: skip
    """Write the parameters after a step of Levenberg and Marquardt; False if the equations are singular."""
    size = p.shape[0]
    for i in range(size):
        scale = 1.0 / math.sqrt(max(normal[i, i], 1e-300))
        right[i, 0] = gradient[i] * scale
        for j in range(i + 1):
            work[i, j] = normal[i, j] * scale / math.sqrt(max(normal[j, j], 1e-300))
        work[i, i] += damping
    if not solve_symmetric(work, right):
        return False
    for i in range(size):
        trial[i] = p[i] + right[i, 0] / math.sqrt(max(normal[i, i], 1e-300))
    return True


@subkernel()
def position_covariance(
    normal: NDArray[np.float64], work: NDArray[np.float64], unit: NDArray[np.float64]
) -> tuple[float, float, float]:  # fmt: skip
    """Return variances and covariance of the first two parameters; NaN if the equations are singular."""
    size = normal.shape[0]
    for i in range(size):
        unit[i, 0], unit[i, 1] = 0.0, 0.0
        for j in range(i + 1):
            work[i, j] = normal[i, j] / math.sqrt(max(normal[i, i], 1e-300) * max(normal[j, j], 1e-300))
    unit[0, 0], unit[1, 1] = 1.0, 1.0
    if not solve_symmetric(work, unit):
        return math.nan, math.nan, math.nan
    first, second = max(normal[0, 0], 1e-300), max(normal[1, 1], 1e-300)
    return unit[0, 0] / first, unit[1, 1] / second, unit[1, 0] / math.sqrt(first * second)


@subkernel()
def _accumulate(
    values: NDArray[np.float64], variances: NDArray[np.float64], places: NDArray[np.float64],
    p: NDArray[np.float64], parts: int, normal: NDArray[np.float64], gradient: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Write the normal equations of the edge model; return the robust cost and the weighted sum of squares.

    ``parts``: Parts of a pixel per axis, each of which is integrated by two points.
    """
    normal[:] = 0.0
    gradient[:] = 0.0
    c1, s1, c2, s2 = math.cos(p[2]), math.sin(p[2]), math.cos(p[3]), math.sin(p[3])
    total = p[4] * p[4] + PART_VARIANCE / (parts * parts)
    unit = math.sqrt(2.0 * total)
    far = _FAR * unit + 0.75
    slope = np.empty(_PARAMETERS)
    cost = squares = 0.0
    for n in range(values.size):
        # The light is linear about the centre of the window.
        light = 1.0 + p[7] * places[n, 0] + p[8] * places[n, 1]
        slope[:5] = 0.0
        product = 0.0
        # The level of a pixel away from both edges is constant.
        dx, dy = places[n, 0] - p[0], places[n, 1] - p[1]
        first, second = abs(c1 * dx + s1 * dy) < far, abs(c2 * dx + s2 * dy) < far
        divided = parts if first or second else 1
        points = 2 * divided
        share = 1.0 / (points * points)
        amplitude = light * p[6] * share
        for part in range(points * points):
            i, j = part % points, part // points
            dx = places[n, 0] - p[0] + (i // 2 + 0.5 + (PART if i % 2 else -PART)) / divided - 0.5
            dy = places[n, 1] - p[1] + (j // 2 + 0.5 + (PART if j % 2 else -PART)) / divided - 0.5
            u, v = (c1 * dx + s1 * dy) / unit, (c2 * dx + s2 * dy) / unit
            e1 = math.erf(u) if first else math.copysign(1.0, u)
            e2 = math.erf(v) if second else math.copysign(1.0, v)
            g1 = 2.0 / math.sqrt(math.pi) * math.exp(-u * u) * e2 if first else 0.0
            g2 = 2.0 / math.sqrt(math.pi) * math.exp(-v * v) * e1 if second else 0.0
            product += e1 * e2 * share
            slope[0] -= amplitude * (g1 * c1 + g2 * c2) / unit
            slope[1] -= amplitude * (g1 * s1 + g2 * s2) / unit
            slope[2] += amplitude * g1 * (c1 * dy - s1 * dx) / unit
            slope[3] += amplitude * g2 * (c2 * dy - s2 * dx) / unit
            slope[4] -= amplitude * (g1 * u + g2 * v) * p[4] / total
        pattern = p[5] + p[6] * product
        slope[5] = light
        slope[6] = light * product
        slope[7] = pattern * places[n, 0]
        slope[8] = pattern * places[n, 1]
        robust, square = add_pixel(values[n] - light * pattern, variances[n], slope, normal, gradient)
        cost, squares = cost + robust, squares + square
    return cost, squares


@subkernel()
def _minimise(
    values: NDArray[np.float64], variances: NDArray[np.float64], places: NDArray[np.float64],
    p: NDArray[np.float64], parts: int, normal: NDArray[np.float64], gradient: NDArray[np.float64],
    work: NDArray[np.float64], right: NDArray[np.float64],
) -> tuple[bool, float]:  # fmt: skip
    """Minimise the cost from parameters in place; return whether it converged, and the weighted sum of squares."""
    trial = np.empty(_PARAMETERS)
    least = _LEAST_BLUR if parts == 1 else _SHARPEST_BLUR
    damping = 1e-3
    cost, squares = _accumulate(values, variances, places, p, parts, normal, gradient)
    for _ in range(_ROUNDS):
        if p[4] <= least and gradient[4] <= 0.0:
            # At its limit the blur is fixed.
            normal[4, :4] = 0.0
            normal[5:, 4] = 0.0
            normal[4, 4], gradient[4] = 1.0, 0.0
        if not damped_step(normal, gradient, damping, p, work, right, trial):
            damping = max(10.0 * damping, 1e-6)
            continue
        trial[4] = min(max(trial[4], least), _LARGEST_BLUR)
        step = 0.0
        for i in range(_PARAMETERS):
            step += (trial[i] - p[i]) * gradient[i]
        small = step < _CONVERGED * max(1.0, squares / values.size)
        later, later_squares = _accumulate(values, variances, places, trial, parts, normal, gradient)
        if later <= cost * (1.0 + 1e-9):
            for i in range(_PARAMETERS):
                p[i] = trial[i]
            cost, squares, damping = later, later_squares, 0.1 * damping
            if small:
                return True, squares
        else:
            damping = max(10.0 * damping, 1e-6)
            _accumulate(values, variances, places, p, parts, normal, gradient)
            # At the minimum, rounding decides about a small step.
            if small or damping > 1e6:
                return small, squares
    return False, squares


@kernel()
def fit_corners(
    image: NDArray[np.float64], variance: NDArray[np.float64], starts: NDArray[np.float64],
    axes: NDArray[np.float64], gaps: NDArray[np.float64], reach: float, half: int, found: NDArray[np.float64],
) -> None:  # fmt: skip
    """Fit m + h erf(u) erf(v) times a linear light to the surroundings of corners.

    ``image``, ``variance``: Grey values and the variances of their noise, shape (rows, columns).
    ``starts``: Start positions (x, y) in px, shape (n, 2).
    ``axes``: Pixels per square along the rows (first column) and columns (second column) of the board, shape (n, 2, 2).
    ``gaps``: Distance from the edges within which white squares have no markers, in squares, shape (n,).
    ``reach``: Largest distance from the corner in squares.
    ``half``: Largest distance from the corner in px.
    ``found``: Values to write, NaN where the fit fails: x, y, variances of x and y and their covariance, blur in px,
      mean square of the residuals, half contrast; shape (n, 8).
    """
    rows, columns = image.shape
    most = (2 * half + 1) ** 2
    values, variances, places = np.empty(most), np.empty(most), np.empty((most, 2))
    p, gradient = np.empty(_PARAMETERS), np.empty(_PARAMETERS)
    normal = np.empty((_PARAMETERS, _PARAMETERS))
    work, right = np.empty((_PARAMETERS, _PARAMETERS)), np.empty((_PARAMETERS, 1))
    unit = np.empty((_PARAMETERS, 2))
    for corner in range(starts.shape[0]):
        found[corner] = np.nan
        centre_x, centre_y = round(starts[corner, 0]), round(starts[corner, 1])
        a, b, c, d = axes[corner, 0, 0], axes[corner, 0, 1], axes[corner, 1, 0], axes[corner, 1, 1]
        determinant = a * d - b * c
        count, low, high, total = 0, np.inf, -np.inf, 0.0
        for y in range(max(centre_y - half, 0), min(centre_y + half + 1, rows)):
            for x in range(max(centre_x - half, 0), min(centre_x + half + 1, columns)):
                dx, dy = x - starts[corner, 0], y - starts[corner, 1]
                du, dv = abs(d * dx - b * dy) / abs(determinant), abs(a * dy - c * dx) / abs(determinant)
                if max(du, dv) > reach or dx * dx + dy * dy > half * half:
                    continue
                if not (math.isfinite(image[y, x]) and variance[y, x] > 0.0):
                    continue
                values[count], variances[count] = image[y, x], variance[y, x]
                places[count, 0], places[count, 1] = x - centre_x, y - centre_y
                low, high, total = min(low, image[y, x]), max(high, image[y, x]), total + image[y, x]
                count += 1
        if count < _FEWEST or not high > low:
            continue
        p[0], p[1] = starts[corner, 0] - centre_x, starts[corner, 1] - centre_y
        # Normals of the edges along the columns and the rows.
        p[2], p[3] = math.atan2(-b, d), math.atan2(a, -c)
        p[4], p[5], p[6], p[7], p[8] = 0.8, total / count, 0.4 * (high - low), 0.0, 0.0
        # The sign of the contrast from the correlation with the pattern.
        sign = 0.0
        c1, s1, c2, s2 = math.cos(p[2]), math.sin(p[2]), math.cos(p[3]), math.sin(p[3])
        for n in range(count):
            dx, dy = places[n, 0] - p[0], places[n, 1] - p[1]
            sign += (values[n] - p[5]) * math.erf(c1 * dx + s1 * dy) * math.erf(c2 * dx + s2 * dy)
        if sign < 0.0:
            p[6] = -p[6]
        # Markers are in white squares only.
        every, count = count, 0
        for n in range(every):
            dx, dy = places[n, 0] - p[0], places[n, 1] - p[1]
            du, dv = abs(d * dx - b * dy) / abs(determinant), abs(a * dy - c * dx) / abs(determinant)
            if p[6] * (c1 * dx + s1 * dy) * (c2 * dx + s2 * dy) > 0.0 and min(du, dv) > gaps[corner]:
                continue
            values[count], variances[count] = values[n], variances[n]
            places[count, 0], places[count, 1] = places[n, 0], places[n, 1]
            count += 1
        if count < _FEWEST:
            continue
        converged, squares = False, 0.0
        # Parts are a variable, and pixels are cut to their number here, so that the fit is compiled once.
        for parts in _PARTS:
            if parts == 1 or p[4] < _SHARP_BLUR:
                converged, squares = _minimise(
                    values[:count], variances[:count], places[:count], p, parts, normal, gradient, work, right
                )  # fmt: skip
        if not converged or math.hypot(p[0], p[1]) > 0.5 * half or p[4] >= _LARGEST_BLUR:
            continue
        across, down, both = position_covariance(normal, work, unit)
        if not math.isfinite(across):
            continue
        found[corner, 0], found[corner, 1] = centre_x + p[0], centre_y + p[1]
        found[corner, 2], found[corner, 3], found[corner, 4] = across, down, both
        found[corner, 5], found[corner, 6] = p[4], squares / max(count - _PARAMETERS, 1)
        found[corner, 7] = p[6]


@kernel()
def centroids(
    image: NDArray[np.float64], variance: NDArray[np.float64], starts: NDArray[np.float64],
    axes: NDArray[np.float64], inner: float, outer: float, found: NDArray[np.float64],
) -> None:  # fmt: skip
    """Compute grey-weighted centroids of dots above a plane of the background.

    ``axes``: Pixels per radius of a dot along the rows and columns of the board, shape (n, 2, 2).
    ``inner``, ``outer``: The centroid is that of the pixels within ``inner`` radii; the background is a plane fitted to
      the pixels between ``inner`` and ``outer`` radii.
    ``found``: Values to write, NaN where impossible: x, y, variances of x and y and their covariance; shape (n, 5).
    """
    rows, columns = image.shape
    normal, right, lever = np.empty((3, 3)), np.empty((3, 1)), np.empty((2, 3))
    for dot in range(starts.shape[0]):
        found[dot] = np.nan
        x_0, y_0 = starts[dot, 0], starts[dot, 1]
        a, b, c, d = axes[dot, 0, 0], axes[dot, 0, 1], axes[dot, 1, 0], axes[dot, 1, 1]
        determinant = a * d - b * c
        wide, tall = outer * math.hypot(a, b) + 1.0, outer * math.hypot(c, d) + 1.0
        left, last = math.floor(x_0 - wide), math.ceil(x_0 + wide)
        top, bottom = math.floor(y_0 - tall), math.ceil(y_0 + tall)
        if left < 0 or top < 0 or last >= columns or bottom >= rows:
            continue
        normal[:] = 0.0
        right[:] = 0.0
        lever[:] = 0.0
        around = 0.0
        usable = True
        for y in range(top, bottom + 1):
            for x in range(left, last + 1):
                dx, dy = x - x_0, y - y_0
                radius = math.hypot(d * dx - b * dy, a * dy - c * dx) / abs(determinant)
                if radius > outer:
                    continue
                if not (math.isfinite(image[y, x]) and variance[y, x] > 0.0):
                    usable = False
                if radius > inner:
                    around += variance[y, x]
                    normal[0, 0] += 1.0
                    normal[1, 0] += dx
                    normal[2, 0] += dy
                    normal[1, 1] += dx * dx
                    normal[2, 1] += dx * dy
                    normal[2, 2] += dy * dy
                    right[0, 0] += image[y, x]
                    right[1, 0] += image[y, x] * dx
                    right[2, 0] += image[y, x] * dy
        around /= max(normal[0, 0], 1.0)
        if not usable or normal[0, 0] < 6 or not solve_symmetric(normal, right):
            continue
        mass = sum_x = sum_y = 0.0
        for y in range(top, bottom + 1):
            for x in range(left, last + 1):
                dx, dy = x - x_0, y - y_0
                if math.hypot(d * dx - b * dy, a * dy - c * dx) / abs(determinant) <= inner:
                    signal = image[y, x] - right[0, 0] - right[1, 0] * dx - right[2, 0] * dy
                    mass += signal
                    sum_x += signal * dx
                    sum_y += signal * dy
        if mass == 0.0:
            continue
        mean_x, mean_y = sum_x / mass, sum_y / mass
        xx = yy = xy = 0.0
        for y in range(top, bottom + 1):
            for x in range(left, last + 1):
                dx, dy = x - x_0, y - y_0
                if math.hypot(d * dx - b * dy, a * dy - c * dx) / abs(determinant) <= inner:
                    weight = variance[y, x] / (mass * mass)
                    xx += weight * (dx - mean_x) ** 2
                    yy += weight * (dy - mean_y) ** 2
                    xy += weight * (dx - mean_x) * (dy - mean_y)
                    for k, off in enumerate((dx - mean_x, dy - mean_y)):
                        lever[k, 0] += off
                        lever[k, 1] += off * dx
                        lever[k, 2] += off * dy
        # The error of the background: levers over its Cholesky factor.
        for k in range(2):
            for i in range(3):
                for j in range(i):
                    lever[k, i] -= normal[i, j] * lever[k, j]
                lever[k, i] /= normal[i, i]
        weight = around / (mass * mass)
        for i in range(3):
            xx += weight * lever[0, i] * lever[0, i]
            yy += weight * lever[1, i] * lever[1, i]
            xy += weight * lever[0, i] * lever[1, i]
        found[dot, 0], found[dot, 1] = x_0 + mean_x, y_0 + mean_y
        found[dot, 2], found[dot, 3], found[dot, 4] = xx, yy, xy
