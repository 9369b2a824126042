"""Kernel that sums the pixels' normal equations over windows, and fits them."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.products import PAIR_OF, PRODUCTS, is_pair
from scenetruth.estimators.refined.kernels.solving import (
    CURVED,
    KNOWN,
    POWERS,
    Fit,
    Model,
    fit_window,
    work_space,
)
from scenetruth.estimators.refined.kernels.warp import View

__all__ = ["EVERY_MODEL", "NO_MODEL", "solve_rows"]

EVERY_MODEL, NO_MODEL = -1, -2
"""Whether every model is fitted to a pixel, or none."""

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@numba.njit(inline="always")
def _degree(product: int, curved: bool, turning: bool, bent: bool) -> int:
    """Return the highest power of the distance by which moments of a product are asked for."""
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
    # Those of the acceleration, which is the same in a whole window.
    if product in (PAIR_OF[0, 4], PAIR_OF[0, 5], PAIR_OF[0, 6]):
        return surface
    return 2 if bent else motion


@_jit
def _add_pairs(out: Any, weight: float, one: Any, other: Any, odd: bool) -> None:
    """Add what lies at either side of the middle, whose weights are the same, or opposite."""
    if odd:
        for x in range(out.size):
            out[x] += weight * (one[x] - other[x])
    else:
        for x in range(out.size):
            out[x] += weight * (one[x] + other[x])


@_jit
def _window_sums(products: Any, pairs_only: bool, window: Any, y: int, asked: Any, scratch: Any, moments: Any) -> None:
    """Sum products over windows of a row, times powers of the distance: moments (numbered, x)."""
    count, height, width = products.shape
    reach = window.shape[1] // 2
    curved, turning, bent = asked
    middle = scratch[reach : reach + width]
    for n in range(count):
        if pairs_only and not is_pair(n):
            continue
        degree = _degree(n, curved, turning, bent)
        for k in range(degree + 1):
            middle[:] = 0.0
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                weight, line = window[k, v - y + reach], products[n, v]
                for x in range(width):
                    middle[x] += weight * line[x]
            for j in range(degree + 1 - k):
                out = moments[(n * POWERS + j) * POWERS + k]
                for x in range(width):
                    out[x] = window[j, reach] * middle[x]
                for u in range(1, reach + 1):
                    right, left = scratch[reach + u : reach + u + width], scratch[reach - u : reach - u + width]
                    _add_pairs(out, window[j, reach + u], right, left, j % 2 == 1)


@_jit
def solve_rows(
    products: NDArray[np.float64],
    weights: NDArray[np.float64],
    models: tuple[Model, Model],
    count: int,
    view: View,
    channels: int,
    first_row: int,
    least: float,
    fits: tuple[Fit, Fit],
    chosen: NDArray[np.int8],
    told: int,
    rows: tuple[int, int],
) -> None:
    """Fit surface and motion in the window around every pixel of some rows.

    Parameters
    ----------
    products
        The pixels' normal equations, as of `add_products`.
    weights
        Weights of a window, and their squares for variances, times the powers 0 to 4 of the distance, shape
        (2, 5, 2 r + 1).
    models, count
        What is fitted; only the first ``count`` are.
    view
        Focal length and principal point, as of `warp.View`.
    channels
        Number of colour channels that were added up.
    first_row
        Row of the image at which the products begin.
    least
        Least share of the window that must be known.
    fits
        Output for the whole image, of each model; ``theta`` is read too: tangents of the surface come from it.
    chosen
        The model of every pixel of the image, shape (height, width); or `EVERY_MODEL`, or `NO_MODEL`.
    told
        How many variances are wanted, in the order of `Fit`; `EVERY_VARIANCE` for all, those of the surface
        element too.
    rows
        First and last + 1 row of the products to solve for.
    """
    width = products.shape[2]
    window, squared = weights[0], weights[1]
    # Nothing lies beyond the ends of a row.
    scratch = np.zeros(width + window.shape[1] - 1)
    moments = np.zeros((len(products) * POWERS**2, width))
    seconds = np.zeros((len(moments) if told > 0 else 1, width))
    work = work_space()
    whole = channels * window[0].sum() ** 2
    curved, turning, bent = _asked(models, count)
    for row in range(rows[0], rows[1]):
        y = row + first_row
        if chosen[y].max() < EVERY_MODEL:
            continue
        _window_sums(products, False, window, row, (curved, turning, bent), scratch, moments)
        if told > 0:
            _window_sums(products, True, squared, row, (curved, turning, False), scratch, seconds)
        for m in range(count):
            for x in range(width):
                if chosen[y, x] == EVERY_MODEL or chosen[y, x] == m:
                    enough = moments[KNOWN, x] / whole >= least
                    fit_window(moments, seconds, x, models[m], view, enough, fits[m], x, y, told, work)


@_jit
def _asked(models: Any, count: int) -> Any:
    """Tell whether any model has curvature, any a velocity gradient, and any motion of second order."""
    curved, turning, bent = False, False, False
    for m in range(count):
        curved = curved or models[m].surface == CURVED
        turning = turning or models[m].gradient > 0
        bent = bent or (models[m].gradient > 0 and models[m].surface > 1)
    return curved, turning, bent
