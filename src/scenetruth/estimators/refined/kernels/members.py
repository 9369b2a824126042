"""Kernel that fits windows to those of their pixels that belong to the surface in their middle."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.products import PAIR_OF, SIDE_OF, is_pair
from scenetruth.estimators.refined.kernels.solving import (
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
from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, View

__all__ = ["solve_members"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

# Place of the number of channels that are known, among the products.
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
    """Tell whether a pixel at (x, y) from a window's centre shows the surface that is fitted there.

    It does if the surface's parameters at the pixel hardly move it against its own ones, and explain its images.
    """
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
        # One power of the distance after the other, so that the products of a pixel are taken at once.
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
            fit_window(moments, seconds, 0, model, view, known > 0.0, fit, x, y, told, work)

    return compiled


_SOLVES = {several: _compiled(several) for several in (STEADY, ACCELERATED)}


def solve_members(
    products: NDArray[np.float64],
    limit: NDArray[np.float64],
    fields: NDArray[np.float64],
    reach: NDArray[np.float64],
    weights: NDArray[np.float64],
    model: Model,
    view: View,
    first_row: int,
    fit: Fit,
    pixels: NDArray[np.int64],
    shares: NDArray[np.float64],
    part: tuple[int, int],
) -> None:
    """Fit surface and motion around some pixels to those of their windows' pixels that belong to the same surface.

    Parameters
    ----------
    products
        The pixels' normal equations, as of `products.add_products`, side by side: shape (rows, width, 22 or 46).
    limit
        Largest mean square that is left where a pixel is explained, shape (rows, width).
    fields
        The own d and q of the image's pixels, and their acceleration if the fit has one, shape (4 or 7, height, width).
    reach
        The farthest camera in steps, the longest time in frames, half an image over the focal length, and by how much a
        pixel may be moved against its own parameters, in px.
    weights
        As of `windows.solve_rows`.
    model
        What is fitted.
    view
        Focal length and principal point.
    first_row
        Row of the image at which the products begin.
    fit
        Read, and written at the pixels, of the whole image; with variances if there is room for them.
    pixels
        Rows and columns in the image, shape (n, 2).
    shares
        Output: share of the window that belongs to the surface, and distance of the middle of its texture (weighted by
        the squared gradient) from the window's, in px, shape (n, 2).
    part
        First and last + 1 of the pixels.
    """
    _SOLVES[len(fields)](products, limit, fields, reach, weights, model, view, first_row, fit, pixels, shares, part)
