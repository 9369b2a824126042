"""Kernels that sum the normal equations over windows and fit them, for all pixels or those of the central surface."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.pixel_equations import PAIR_OF, PRODUCTS, SIDE_OF, add_row, dot, is_pair
from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, ImageView
from scenetruth.estimators.refined.kernels.window_solver import (
    CURVED,
    EVERY_VARIANCE,
    FULL,
    GRADIENTS,
    KNOWN,
    POWERS,
    Fit,
    Model,
    fit_window,
    work_space,
)

__all__ = ["EVERY_MODEL", "NO_MODEL", "solve_members", "solve_rows"]


EVERY_MODEL, NO_MODEL = -1, -2
"""Values that select all models, or none, at a pixel."""

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@numba.njit(inline="always")
def _degree(product: int, curved: bool, turning: bool, bent: bool) -> int:
    """Return the highest power of the distance required for the moments of a product."""
    surface = 2 if curved else 1
    if product == 0:
        return 2 * surface
    motion = 1 if turning else 0
    if product < 4:
        return surface + (2 if bent else motion)
    if product < 10:
        return motion + (2 if bent else motion)
    if product == 10:
        return surface
    if product < PRODUCTS:
        return motion if product < 14 else 0
    # Products of the acceleration, which is constant in a window.
    if product in (PAIR_OF[0, 4], PAIR_OF[0, 5], PAIR_OF[0, 6]):
        return surface
    return 2 if bent else motion


@_jit
def _sums_along_y(products: Any, pairs_only: bool, window: Any, y: int, ends: Any, asked: Any, lines: Any) -> None:
    """Sum products along the columns of the windows of a row, times powers of the distance: (numbered, x).

    ``ends``: First and last column + 1 of the sums.
    ``lines``: Output, with a margin of the half-width of a window on both sides.
    """
    count, height, _ = products.shape
    reach = window.shape[1] // 2
    curved, turning, bent = asked
    first, last = ends
    for n in range(count):
        if pairs_only and not is_pair(n):
            continue
        for k in range(_degree(n, curved, turning, bent) + 1):
            out = lines[n * POWERS + k, first + reach : last + reach]
            out[:] = 0.0
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                add_row(out, window[k, v - y + reach], products[n, v, first:last])


@_jit
def _sums_along_x(lines: Any, pairs_only: bool, window: Any, x: int, asked: Any, moments: Any) -> None:
    """Sum the sums of `_sums_along_y` over the window around column x: moments (numbered, 1)."""
    width = window.shape[1]
    curved, turning, bent = asked
    for n in range(lines.shape[0] // POWERS):
        if pairs_only and not is_pair(n):
            continue
        degree = _degree(n, curved, turning, bent)
        for k in range(degree + 1):
            line = lines[n * POWERS + k, x : x + width]
            for j in range(degree + 1 - k):
                moments[(n * POWERS + j) * POWERS + k, 0] = dot(window[j], line)


@_jit
def solve_rows(
    products: NDArray[np.float64],
    weights: NDArray[np.float64],
    models: tuple[Model, Model],
    count: int,
    view: ImageView,
    first_row: int,
    least: float,
    fits: tuple[Fit, Fit],
    chosen: NDArray[np.int8],
    told: int,
    step: int,
    rows: tuple[int, int],
) -> None:
    """Fit surface and motion in the windows around the pixels of a lattice, for a range of its rows.

    ``products``: Normal equations of `pixel_equations.add_products` of image rows from ``first_row`` on.
    ``weights``: Weights of a window, and their squares for variances, times the powers 0 to 4 of the distance, shape
      (2, 5, 2 r + 1).
    ``least``: Smallest number of valid channels in a window, averaged with its weights.
    ``fits``: Maps with the rows and columns of the lattice.
    ``chosen``: Model of every pixel of the lattice, `EVERY_MODEL` or `NO_MODEL`.
    ``step``: Distance of adjacent pixels of the lattice, which begins at row and column 0 of the image.
    """
    size, _, width = products.shape
    window, squared = weights[0], weights[1]
    reach = window.shape[1] // 2
    # Beyond the ends of a row, all values are zero.
    lines = np.zeros((size * POWERS, width + 2 * reach))
    second_lines = np.zeros((len(lines) if told > 0 else 1, lines.shape[1]))
    moments = np.zeros((size * POWERS**2, 1))
    seconds = np.zeros((len(moments) if told > 0 else 1, 1))
    work = work_space()
    whole = window[0].sum() ** 2
    asked = _asked(models, count)
    plain = (asked[0], asked[1], False)
    for row in range(rows[0], rows[1]):
        y = row * step
        first, last = width, 0
        for column in range(chosen.shape[1]):
            if chosen[row, column] >= EVERY_MODEL:
                first = min(first, column * step)
                last = column * step + 1
        if last == 0:
            continue
        ends = (max(first - reach, 0), min(last + reach, width))
        _sums_along_y(products, False, window, y - first_row, ends, asked, lines)
        if told > 0:
            _sums_along_y(products, True, squared, y - first_row, ends, plain, second_lines)
        for column in range(first // step, (last - 1) // step + 1):
            if chosen[row, column] < EVERY_MODEL:
                continue
            x = column * step
            _sums_along_x(lines, False, window, x, asked, moments)
            if told > 0:
                _sums_along_x(second_lines, True, squared, x, plain, seconds)
            enough = moments[KNOWN, 0] / whole >= least
            for m in range(count):
                if chosen[row, column] == EVERY_MODEL or chosen[row, column] == m:
                    fit_window(moments, seconds, 0, models[m], view, enough, fits[m], (x, y), (column, row), told, work)


@_jit
def _asked(models: Any, count: int) -> Any:
    """Return whether any model has curvature, a velocity gradient, or motion of second order."""
    curved, turning, bent = False, False, False
    for m in range(count):
        curved = curved or models[m].surface == CURVED
        turning = turning or models[m].gradient > 0
        bent = bent or (models[m].gradient > 0 and models[m].surface > 1)
    return curved, turning, bent


# Index of the number of valid channels among the products.
_IN_USE = 16


@numba.njit(inline="always")
def _belongs(
    several: Any,
    theta: Any,
    x: float,
    y: float,
    own: Any,
    products: Any,
    v: int,
    u: int,
    limit: float,
    reach: Any,
    step: Any,
) -> bool:
    """Return whether a pixel at (x, y) from a window centre belongs to its surface: parameters and residual agree."""
    x_x, x_y, y_y = x * x, x * y, y * y
    if not products[v, u, 14] <= limit * products[v, u, 15]:
        return False
    step[0] = (theta[0] + theta[1] * x + theta[2] * y + theta[3] * x_x + theta[4] * x_y + theta[5] * y_y) - own[0]
    for k in range(3):
        step[1 + k] = theta[CURVED + 3 * k] + theta[CURVED + 1 + 3 * k] * x + theta[CURVED + 2 + 3 * k] * y - own[1 + k]
    for k in range(STEADY, several):
        step[k] = theta[FULL + k - STEADY] - own[k]
    moved = abs(step[0]) * reach[0]
    along = abs(own[0]) * reach[1]
    for k in range(1, several):
        later = 0.5 * reach[1] if k >= STEADY else 1.0
        moved = max(moved, abs(step[k]) * along * later * (reach[2] if k == 3 or k == 6 else 1.0))
    if not moved < reach[3]:
        return False
    # b = (M p + b) - M p; squares after the step are e - 2 b step + step M step.
    total = products[v, u, 14]
    for k in range(several):
        total -= 2.0 * step[k] * products[v, u, SIDE_OF[k]]
        total += products[v, u, PAIR_OF[k, k]] * (step[k] * step[k] + 2.0 * step[k] * own[k])
        for m in range(k + 1, several):
            total += 2.0 * products[v, u, PAIR_OF[k, m]] * (step[k] * step[m] + step[k] * own[m] + step[m] * own[k])
    return bool(total <= limit * products[v, u, 15])


def _compiled(several: int) -> Any:
    @_jit
    def compiled(
        products: Any,
        limit: Any,
        fields: Any,
        reach: Any,
        weights: Any,
        model: Any,
        view: Any,
        first_row: Any,
        fit: Any,
        pixels: Any,
        shares: Any,
        part: Any,
    ) -> None:
        rows, width = limit.shape
        around = weights.shape[2] // 2
        window, squared = weights[0], weights[1]
        count = products.shape[2]
        moments, seconds = np.empty((count * POWERS**2, 1)), np.empty((count * POWERS**2, 1))
        # One power of the distance after another, so that the products of a pixel are read together.
        sums, second_sums = np.empty((POWERS, count)), np.empty((POWERS, count))
        work, step = work_space(), np.empty(several)
        theta, own = np.empty(len(fit.theta)), np.empty(several)
        powers = 4 if model.gradient > 0 and model.surface > 1 else 3
        fewer = 3
        if model.surface == CURVED:
            powers = fewer = POWERS
        told = EVERY_VARIANCE if fit.variance.shape[1] > 1 else 0
        fewer = fewer if told > 0 else 0
        whole = window[0].sum() ** 2
        for number in range(part[0], part[1]):
            y, x = pixels[number]
            for k in range(len(theta)):
                theta[k] = fit.theta[k, y, x]
            moments[:], seconds[:] = 0.0, 0.0
            row = y - first_row
            for v in range(max(row - around, 0), min(row + around + 1, rows)):
                sums[:], second_sums[:] = 0.0, 0.0
                met = False
                for u in range(max(x - around, 0), min(x + around + 1, width)):
                    if products[v, u, _IN_USE] == 0.0:
                        continue
                    for k in range(several):
                        own[k] = fields[k, v + first_row, u]
                    if not _belongs(several, theta, u - x, v - row, own, products, v, u, limit[v, u], reach, step):
                        continue
                    met = True
                    for j in range(powers):
                        w = window[j, u - x + around]
                        for n in range(count):
                            sums[j, n] += w * products[v, u, n]
                    for j in range(fewer):
                        w = squared[j, u - x + around]
                        for n in range(count):
                            second_sums[j, n] += w * products[v, u, n]
                if not met:
                    continue
                at = v - row + around
                for k in range(powers):
                    for n in range(count):
                        for j in range(powers - k):
                            moments[(n * POWERS + j) * POWERS + k, 0] += window[k, at] * sums[j, n]
                    for n in range(count):
                        if not is_pair(n):
                            continue
                        for j in range(max(fewer - k, 0)):
                            seconds[(n * POWERS + j) * POWERS + k, 0] += squared[k, at] * second_sums[j, n]
            gradient = moments[GRADIENTS, 0]
            known = moments[KNOWN, 0]
            shares[number, 0] = known / whole
            if gradient > 0.0:
                shares[number, 1] = np.hypot(moments[GRADIENTS + POWERS, 0], moments[GRADIENTS + 1, 0]) / gradient
            else:
                shares[number, 1] = np.inf
            fit_window(moments, seconds, 0, model, view, known > 0.0, fit, (x, y), (x, y), told, work)

    return compiled


_SOLVES = {several: _compiled(several) for several in (STEADY, ACCELERATED)}


def solve_members(
    products: NDArray[np.float64],
    limit: NDArray[np.float64],
    fields: NDArray[np.float64],
    reach: NDArray[np.float64],
    weights: NDArray[np.float64],
    model: Model,
    view: ImageView,
    first_row: int,
    fit: Fit,
    pixels: NDArray[np.int64],
    shares: NDArray[np.float64],
    part: tuple[int, int],
) -> None:
    """Fit surface and motion around pixels to those pixels of their windows that belong to the same surface.

    ``products``: Normal equations of the pixels from `pixel_equations.add_products`, with the products last: shape
      (rows, width, 22 or 46).
    ``limit``: Largest mean square residual of a pixel that is explained, shape (rows, width).
    ``fields``: d and q of the pixels of the image, with the acceleration if fitted, shape (4 or 7, height, width).
    ``reach``: Farthest camera in steps, longest time in frames, half the image width over the focal length, and largest
      displacement in px relative to a pixel's own parameters.
    ``pixels``: Rows and columns in the image, shape (n, 2).
    ``shares``: Output: fraction of the window that belongs to the surface, and distance of its texture centroid
      (weighted by the squared gradient) from the window centre, in px, shape (n, 2).
    """
    _SOLVES[len(fields)](products, limit, fields, reach, weights, model, view, first_row, fit, pixels, shares, part)
