"""Kernels that put the pixels' normal equations together in windows, and solve them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.element import (
    FUNCTIONALS,
    VALUES,
    describe_element,
    metric,
    tangents_of,
)
from scenetruth.estimators.refined.kernels.warp import PRODUCTS, View

__all__ = ["FULL", "Fit", "Model", "correct_brightness", "solve_rows"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

FULL = 15
"""Parameters of the full model: d, d_x, d_y, d_xx, d_xy, d_yy; q_X, its slopes along x and y, q_Y alike, q_Z alike."""
_D = 6

# Monomials x^j y^k of the disparity's parameters, then of each velocity component's, and the fields of all.
_J = np.array((0, 1, 0, 2, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0))
_K = np.array((0, 0, 1, 0, 1, 2, 0, 0, 1, 0, 0, 1, 0, 0, 1))
_FIELD = np.repeat([0, 1, 2, 3], [_D, 3, 3, 3])
# Which of the ten products belongs to a pair of fields.
_PAIR = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
# Moments are numbered by product, power of x, power of y: those of pairs of parameters, of the right sides, and of
# parameters with the second powers of each velocity component. (Tuples would be copied at every look.)
_POWERS = 5
_MOMENTS = PRODUCTS * _POWERS**2


def _number(product: Any, j: Any, k: Any) -> NDArray[np.int64]:
    return np.asarray((product * _POWERS + j) * _POWERS + k)


_OF_PAIR = _number(_PAIR[_FIELD[:, None], _FIELD], _J[:, None] + _J, _K[:, None] + _K)
_OF_RIGHT = _number(10 + _FIELD, _J, _K)
_OF_BEND = _number(
    _PAIR[_FIELD, 1:][:, None, :].repeat(3, axis=1),
    _J[:, None, None] + np.array([2, 1, 0])[:, None],
    _K[:, None, None] + np.array([0, 1, 2])[:, None],
)
_SQUARES, _FREEDOM, _KNOWN, _GRADIENTS = (int(_number(n, 0, 0)) for n in (14, 15, 16, 17))
# Parameters whose variances are told.
_TOLD = np.array([0, 1, 2, 6, 9, 12])


class Model(NamedTuple):
    """Which surface and which motion are fitted."""

    surface: int
    """Parameters of disparity: 0 (none), 1 (constant), 3 (slopes), 6 (curvature)."""
    components: int
    """Components of velocity: 0 (none), 2 (X and Y) or 3."""
    gradient: int
    """Velocity gradient: 0 (none), 1 (rotation), 2 (rotation and isotropic growth), 3 (all six)."""


class Fit(NamedTuple):
    """What `solve_rows` writes, each with the rows and columns of the image last."""

    theta: NDArray[np.float64]
    """The full model's parameters, shape (15, height, width)."""
    variance: NDArray[np.float64]
    """Variances of d, d_x, d_y, q_X, q_Y and q_Z in units of the noise's, shape (6, height, width)."""
    element: NDArray[np.float32]
    """What the surface element is and does, as of `describe_element`, shape (13, height, width)."""
    element_variance: NDArray[np.float32]
    """Variances of that in units of the noise's, shape (11, height, width)."""
    images: NDArray[np.float32]
    """Mean number of images that show the pixels of the window, shape (height, width)."""
    residual: NDArray[np.float64]
    """Mean squares of what is left, per degree of freedom, and of the texture's gradient, shape (2, height, width)."""


@_jit
def _brightness(image: Any, texture: Any, window: Any, y: int, step: int, sums: Any, nodes: Any) -> None:
    """Write gain and offset at every n-th column of a row, and at the last, found in the window around it."""
    height, width = image.shape
    reach = window.shape[0] // 2
    sums[:] = 0.0
    for v in range(max(y - reach, 0), min(y + reach + 1, height)):
        weight = window[v - y + reach]
        for x in range(width):
            g, h = image[v, x], texture[v, x]
            known = not (np.isnan(g) or np.isnan(h))
            w = weight if known else np.float32(0.0)
            a, b = (g, h) if known else (np.float32(0.0), np.float32(0.0))
            at = x + reach
            sums[0, at] += w
            sums[1, at] += w * a
            sums[2, at] += w * b
            sums[3, at] += w * a * b
            sums[4, at] += w * b * b
    for node in range(nodes.shape[1]):
        x = min(node * step, width - 1)
        n, g, h, gh, hh = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(2 * reach + 1):
            weight = window[j]
            n += weight * sums[0, x + j]
            g += weight * sums[1, x + j]
            h += weight * sums[2, x + j]
            gh += weight * sums[3, x + j]
            hh += weight * sums[4, x + j]
        spread = hh * n - h * h
        gain = (gh * n - g * h) / spread if spread > 1e-6 * h * h + 1e-12 else 1.0
        nodes[0, node] = gain if gain > 0.1 else np.nan
        nodes[1, node] = (g - gain * h) / n if n > 0.0 else np.nan


@_jit
def correct_brightness(
    image: NDArray[np.float32],
    texture: NDArray[np.float32],
    window: NDArray[np.float32],
    step: int,
    first_row: int,
    out: NDArray[np.float32],
) -> None:
    """Take a gain and an offset from an image, found in the window around every n-th pixel against the texture.

    Between these pixels, gain and offset are linear: they change over the width of a window.

    Parameters
    ----------
    image
        Warped grey values, NaN where unknown, shape (rows, width).
    texture
        The texture, NaN where unknown, of the same shape.
    window
        Weights along either axis, shape (2 r + 1,).
    step
        n: every n-th row and column of the whole image, and the last ones.
    first_row
        Row of the whole image at which the arrays begin.
    out
        The grey values with the texture's own brightness; NaN where that is not found.
    """
    height, width = image.shape
    sums = np.empty((5, width + window.shape[0] - 1), dtype=np.float32)
    count = (width - 1 + step - 1) // step + 1
    above, below = np.empty((2, count)), np.empty((2, count))
    top = 0
    _brightness(image, texture, window, top, step, sums, above)
    while True:
        bottom = min(top + step - (top + first_row) % step, height - 1)
        _brightness(image, texture, window, bottom, step, sums, below)
        for y in range(top, bottom + 1 if bottom == height - 1 else bottom):
            down = (y - top) / (bottom - top) if bottom > top else 0.0
            for x in range(width):
                node = min(x // step, count - 2) if count > 1 else 0
                other = min(node + 1, count - 1)
                gap = min(other * step, width - 1) - node * step
                across = (x - node * step) / gap if gap > 0 else 0.0
                left, right = (1.0 - across) * (1.0 - down), across * (1.0 - down)
                low_left, low_right = (1.0 - across) * down, across * down
                gain = left * above[0, node] + right * above[0, other]
                gain += low_left * below[0, node] + low_right * below[0, other]
                offset = left * above[1, node] + right * above[1, other]
                offset += low_left * below[1, node] + low_right * below[1, other]
                out[y, x] = (image[y, x] - offset) / gain
        if bottom == height - 1:
            return
        top = bottom
        above[:] = below


@_jit
def _columns(model: Model, theta: Any, x: float, y: float, focal: float, places: Any, values: Any, sizes: Any) -> int:
    """Write the basis of what is fitted, the places and values of each column's numbers; return the columns' number."""
    used = 0
    for k in range(model.surface):
        places[used, 0], values[used, 0], sizes[used] = k, 1.0, 1
        used += 1
    for c in range(model.components):
        for side in range(3 if model.gradient == 3 else 1):
            places[used, 0], values[used, 0], sizes[used] = _D + 3 * c + side, 1.0, 1
            used += 1
    if model.gradient == 1 or model.gradient == 2:
        # q changes by A p over the surface, whose tangents are p_x and p_y; a rotation is A = [w]x, growth is A = e I.
        tangents = np.empty((2, 3))
        tangents_of(theta, x, y, focal, tangents)
        for turn in range(3):
            sizes[used + turn] = 4
        sizes[used + 3] = 6
        for side in range(2):
            at = _D + 1 + side
            for turn in range(3):
                one, other = (turn + 1) % 3, (turn + 2) % 3
                places[used + turn, 2 * side], values[used + turn, 2 * side] = at + 3 * one, -tangents[side, other]
                places[used + turn, 2 * side + 1], values[used + turn, 2 * side + 1] = (
                    at + 3 * other,
                    tangents[side, one],
                )
            if model.gradient == 2:
                for k in range(3):
                    places[used + 3, 3 * side + k], values[used + 3, 3 * side + k] = at + 3 * k, tangents[side, k]
        used += 3 + (model.gradient == 2)
    return used


@_jit
def _bend(theta: Any, x: float, y: float, focal: float, tangents: Any, bend: Any) -> None:
    """Write the velocity's second-order terms that follow from the surface's: those of ξ², ξη and η², shape (3, 3).

    A surface element that turns and grows takes its curvature along: the second derivatives of q are A p_xx, A p_xy and
    A p_yy, where A takes the tangents to the derivatives of q, and the normal to the normal's own rate.
    """
    tangents_of(theta, x, y, focal, tangents)
    d = theta[0]
    e, f, g, area = metric(tangents)
    n0 = tangents[0, 1] * tangents[1, 2] - tangents[0, 2] * tangents[1, 1]
    n1 = tangents[0, 2] * tangents[1, 0] - tangents[0, 0] * tangents[1, 2]
    n2 = tangents[0, 0] * tangents[1, 1] - tangents[0, 1] * tangents[1, 0]
    # How fast the tangents turn towards the normal.
    along = n0 * theta[_D + 1] + n1 * theta[_D + 4] + n2 * theta[_D + 7]
    down = n0 * theta[_D + 2] + n1 * theta[_D + 5] + n2 * theta[_D + 8]
    for term in range(3):
        i, j = (0, 0) if term == 0 else ((0, 1) if term == 1 else (1, 1))
        second = (2.0 * theta[3], theta[4], 2.0 * theta[5])[term]
        slope_i, slope_j = theta[1 + i] / (d * d), theta[1 + j] / (d * d)
        own = 2.0 * theta[1 + i] * theta[1 + j] / d**3 - second / (d * d)
        v0, v1, v2 = x * own, y * own, focal * own
        v0 -= (slope_j if i == 0 else 0.0) + (slope_i if j == 0 else 0.0)
        v1 -= (slope_j if i == 1 else 0.0) + (slope_i if j == 1 else 0.0)
        a = v0 * tangents[0, 0] + v1 * tangents[0, 1] + v2 * tangents[0, 2]
        b = v0 * tangents[1, 0] + v1 * tangents[1, 1] + v2 * tangents[1, 2]
        c = (v0 * n0 + v1 * n1 + v2 * n2) / area
        a, b = (g * a - f * b) / area, (e * b - f * a) / area
        half = 1.0 if term == 1 else 0.5
        # The normal n, as long as the area, turns by -(p^x (n q_x) + p^y (n q_y)), with the dual tangents p^x and p^y.
        for k in range(3):
            dual_x = (g * tangents[0, k] - f * tangents[1, k]) / area
            dual_y = (e * tangents[1, k] - f * tangents[0, k]) / area
            turned = -(dual_x * along + dual_y * down)
            bend[term, k] = half * (a * theta[_D + 1 + 3 * k] + b * theta[_D + 2 + 3 * k] + c * turned)


@_jit
def _factorise(a: Any, n: int) -> bool:
    """Factorise a symmetric matrix in place, L Lᵀ; return whether it is positive definite."""
    for j in range(n):
        total = a[j, j]
        for k in range(j):
            total -= a[j, k] * a[j, k]
        if not total > 1e-12:
            return False
        a[j, j] = np.sqrt(total)
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total / a[j, j]
    return True


@_jit
def _solve(factor: Any, n: int, x: Any) -> None:
    """Solve L Lᵀ x = x in place."""
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@numba.njit(inline="always")
def _degree(product: int, curved: bool, bent: bool) -> int:
    """Return the highest power of the distance by which moments of a product are asked for."""
    surface = 2 if curved else 1
    if product == 0:
        return 2 * surface
    if product < 4:
        return surface + (2 if bent else 1)
    if product < 10:
        return 3 if bent else 2
    if product == 10:
        return surface
    return 1 if product < 14 else 0


@_jit
def _window_sums(
    products: Any, count: int, window: Any, y: int, curved: bool, bent: bool, scratch: Any, moments: Any
) -> None:
    """Sum products over windows of a row, times powers of the distance: moments (numbered, x)."""
    _, height, width = products.shape
    reach = window.shape[1] // 2
    moments[: count * _POWERS**2] = 0.0
    for n in range(count):
        degree = _degree(n, curved, bent)
        for k in range(degree + 1):
            scratch[:] = 0.0
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                weight = window[k, v - y + reach]
                for x in range(width):
                    scratch[x + reach] += weight * products[n, v, x]
            for j in range(degree + 1 - k):
                out = moments[(n * _POWERS + j) * _POWERS + k]
                for u in range(2 * reach + 1):
                    weight = window[j, u]
                    for x in range(width):
                        out[x] += weight * scratch[x + u]


@_jit
def _reduce(moments: Any, x: int, places: Any, values: Any, sizes: Any, n: int, scratch: Any, out: Any) -> None:
    """Write Cᵀ H C with the full model's normal matrix H at a pixel."""
    for j in range(n):
        for p in range(FULL):
            total = 0.0
            for k in range(sizes[j]):
                q = places[j, k]
                total += values[j, k] * moments[_OF_PAIR[p, q], x]
            scratch[p] = total
        for i in range(j, n):
            total = 0.0
            for k in range(sizes[i]):
                total += values[i, k] * scratch[places[i, k]]
            out[i, j] = out[j, i] = total


@_jit
def _along(column: Any, places: Any, values: Any, sizes: Any, n: int, out: Any) -> None:
    """Write Cᵀ times a vector of the full model's parameters."""
    for i in range(n):
        out[i] = 0.0
        for k in range(sizes[i]):
            out[i] += values[i, k] * column[places[i, k]]


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
        The pixels' normal equations, as of `add_products`, shape (18, rows, width).
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
        The model of every pixel of the image, shape (height, width); all of them where it is -1.
    told
        How many variances are wanted, in the order of `Fit`; 7 for all, with those of the surface element.
    rows
        First and last + 1 row of the products to solve for.
    """
    width = products.shape[2]
    window, squared = weights[0], weights[1]
    scratch = np.empty(width + window.shape[1] - 1)
    moments = np.empty((_MOMENTS, width))
    seconds = np.empty((_MOMENTS if told > 0 else 1, width))
    places, values = np.empty((FULL, 6), dtype=np.int64), np.empty((FULL, 6))
    sizes, bend = np.empty(FULL, dtype=np.int64), np.empty((3, 3))
    small, other, partial = np.empty((FULL, FULL)), np.empty((FULL, FULL)), np.empty(FULL)
    right, scale, solution, column = np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL)
    tangents, values_of, gradients = np.empty((2, 3)), np.empty(VALUES), np.zeros((FUNCTIONALS + len(_TOLD), FULL))
    for k in range(len(_TOLD)):
        gradients[k, _TOLD[k]] = 1.0
    every = len(_TOLD) + FUNCTIONALS if told > len(_TOLD) else told
    whole = channels * window[0].sum() ** 2
    curved, bent = False, False
    for m in range(count):
        curved = curved or models[m].surface == _D
        bent = bent or (models[m].gradient > 0 and models[m].surface > 1)
    for row in range(rows[0], rows[1]):
        y = row + first_row
        _window_sums(products, PRODUCTS, window, row, curved, bent, scratch, moments)
        if told > 0:
            _window_sums(products, 10, squared, row, curved, False, scratch, seconds)
        for m in range(count):
            model, fit = models[m], fits[m]
            for x in range(width):
                if chosen[y, x] >= 0 and chosen[y, x] != m:
                    continue
                fit.residual[:, y, x] = np.nan
                theta = fit.theta[:, y, x]
                if not moments[_KNOWN, x] / whole >= least:
                    theta[:] = np.nan
                    continue
                from_x, from_y = x - view.centre_x, y - view.centre_y
                n = _columns(model, theta, from_x, from_y, view.focal, places, values, sizes)
                _reduce(moments, x, places, values, sizes, n, partial, small)
                for p in range(FULL):
                    right[p] = moments[_OF_RIGHT[p], x]
                if model.surface == 0:
                    for p in range(FULL):
                        right[p] -= moments[_OF_PAIR[p, 0], x] * theta[0]
                if model.gradient > 0 and model.surface > 1:
                    _bend(theta, from_x, from_y, view.focal, tangents, bend)
                    for p in range(FULL):
                        for term in range(3):
                            for c in range(3):
                                right[p] -= bend[term, c] * moments[_OF_BEND[p, term, c], x]
                _along(right, places, values, sizes, n, solution)
                good = True
                for i in range(n):
                    good = good and small[i, i] > 0.0
                    scale[i] = 1.0 / np.sqrt(small[i, i]) if small[i, i] > 0.0 else 0.0
                    solution[i] *= scale[i]
                for i in range(n):
                    for j in range(n):
                        small[i, j] *= scale[i] * scale[j]
                if not good or not _factorise(small, n):
                    theta[:] = np.nan
                    continue
                _solve(small, n, solution)
                # Without depth, d is a unit: it stays.
                theta[1 if model.surface == 0 else 0 :] = 0.0
                for i in range(n):
                    for k in range(sizes[i]):
                        theta[places[i, k]] += values[i, k] * solution[i] * scale[i]
                fit.residual[0, y, x] = moments[_SQUARES, x] / max(moments[_FREEDOM, x], 1e-300)
                fit.residual[1, y, x] = moments[_GRADIENTS, x] / moments[_KNOWN, x]
                if told == 0:
                    continue
                # Cov = H^-1 H2 H^-1 with the sums H of the weights, and H2 of their squares.
                _reduce(seconds, x, places, values, sizes, n, partial, other)
                for i in range(n):
                    for j in range(n):
                        other[i, j] *= scale[i] * scale[j]
                fit.images[y, x] = moments[_FREEDOM, x] / moments[_KNOWN, x] + 1.0
                if told > len(_TOLD):
                    described = gradients[len(_TOLD) :]
                    describe_element(
                        model.surface, model.gradient, theta, from_x, from_y, view.focal, values_of, described
                    )
                    fit.element[:, y, x] = values_of
                for k in range(every):
                    if k >= len(_TOLD) and np.isnan(values_of[k - len(_TOLD)]):
                        continue
                    _along(gradients[k], places, values, sizes, n, column)
                    for i in range(n):
                        column[i] *= scale[i]
                    _solve(small, n, column)
                    total = 0.0
                    for i in range(n):
                        share = 0.0
                        for j in range(n):
                            share += other[i, j] * column[j]
                        total += column[i] * share
                    if k < len(_TOLD):
                        fit.variance[k, y, x] = total
                    else:
                        fit.element_variance[k - len(_TOLD), y, x] = total
