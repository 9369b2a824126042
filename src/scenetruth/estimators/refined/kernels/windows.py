"""Kernels that put the pixels' normal equations together in windows, and solve them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import PRODUCTS, View

__all__ = ["FULL", "Fit", "Model", "correct_brightness", "solve_rows"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

FULL = 15
"""Parameters of the full model: d, d_x, d_y, d_xx, d_xy, d_yy; q_X, its slopes along x and y, q_Y alike, q_Z alike."""
_D, _Q = 6, 9

# Monomials x^j y^k of the disparity's parameters, then of each velocity component's.
_J = (0, 1, 0, 2, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0)
_K = (0, 0, 1, 0, 1, 2, 0, 0, 1, 0, 0, 1, 0, 0, 1)
_FIELD = (0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3)
# Which of the ten products belongs to a pair of fields, and the highest power that its moments need.
_PAIR = ((0, 1, 2, 3), (1, 4, 5, 6), (2, 5, 7, 8), (3, 6, 8, 9))
_DEGREE = (4, 4, 4, 4, 3, 3, 3, 3, 3, 3, 2, 1, 1, 1, 0, 0, 0, 0)
_POWERS = 5
# Parameters whose variances are told.
_TOLD = (0, 1, 2, 6, 9, 12)


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
    growth: NDArray[np.float64]
    """Areal growth rate per frame, and its variance, shape (2, height, width)."""
    residual: NDArray[np.float64]
    """Mean squares of what is left, per degree of freedom, and of the texture's gradient, shape (2, height, width)."""


@_jit
def correct_brightness(
    image: NDArray[np.float32],
    texture: NDArray[np.float32],
    window: NDArray[np.float32],
    rows: tuple[int, int],
    out: NDArray[np.float32],
) -> None:
    """Take a gain and an offset from an image, found in the window around every pixel against the texture.

    Parameters
    ----------
    image
        Warped grey values, NaN where unknown, shape (rows, width).
    texture
        The texture, NaN where unknown, of the same shape.
    window
        Weights along either axis, shape (2 r + 1,).
    rows
        First and last + 1 row of the output; windows are cut at the array's border.
    out
        The grey values with the texture's own brightness.
    """
    height, width = image.shape
    reach = window.shape[0] // 2
    sums = np.empty((5, width + 2 * reach), dtype=np.float32)
    total = np.empty((5, width), dtype=np.float32)
    for y in range(rows[0], rows[1]):
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
        total[:] = 0.0
        for j in range(2 * reach + 1):
            weight = window[j]
            for k in range(5):
                for x in range(width):
                    total[k, x] += weight * sums[k, x + j]
        for x in range(width):
            n, g, h = total[0, x], total[1, x], total[2, x]
            spread = total[4, x] * n - h * h
            gain = (total[3, x] * n - g * h) / spread if spread > 1e-6 * h * h + 1e-12 else np.float32(1.0)
            offset = (g - gain * h) / n if n > 0.0 else np.float32(0.0)
            out[y, x] = (image[y, x] - offset) / gain if gain > 0.1 else np.float32(np.nan)


@_jit
def _columns(model: Model, theta: Any, x: float, y: float, focal: float, basis: Any) -> int:
    """Write the basis of the parameters that are fitted, columns over the full model's; return their number."""
    basis[:] = 0.0
    used = 0
    for k in range(model.surface):
        basis[k, used] = 1.0
        used += 1
    for c in range(model.components):
        basis[_D + 3 * c, used] = 1.0
        used += 1
    if model.gradient == 3:
        for c in range(model.components):
            basis[_D + 3 * c + 1, used] = 1.0
            basis[_D + 3 * c + 2, used + 1] = 1.0
            used += 2
    elif model.gradient > 0:
        # q changes by A p over the surface, whose tangents are p_x and p_y; a rotation is A = [w]x, growth is A = e I.
        tangents = np.empty((2, 3))
        _tangents(theta, x, y, focal, tangents)
        for side in range(2):
            p, q, r = tangents[side, 0], tangents[side, 1], tangents[side, 2]
            at = _D + 1 + side
            basis[at + 3, used], basis[at + 6, used] = -r, q
            basis[at, used + 1], basis[at + 6, used + 1] = r, -p
            basis[at, used + 2], basis[at + 3, used + 2] = -q, p
            if model.gradient == 2:
                basis[at, used + 3], basis[at + 3, used + 3], basis[at + 6, used + 3] = p, q, r
        used += 3 + (model.gradient == 2)
    return used


@_jit
def _tangents(theta: Any, x: float, y: float, focal: float, out: Any) -> None:
    """Write the surface's derivatives along x and y, in baselines: p = (x, y, f) / d."""
    d = theta[0]
    for side in range(2):
        slope = theta[1 + side] / (d * d)
        out[side, 0] = -x * slope
        out[side, 1] = -y * slope
        out[side, 2] = -focal * slope
        out[side, side] += 1.0 / d


@_jit
def _bend(theta: Any, x: float, y: float, focal: float, tangents: Any, bend: Any) -> None:
    """Write the velocity's second-order terms that follow from the surface's: those of ξ², ξη and η², shape (3, 3).

    A surface element that turns and grows takes its curvature along: the second derivatives of q are A p_xx, A p_xy and
    A p_yy, where A takes the tangents to the derivatives of q, and the normal to the normal's own rate.
    """
    _tangents(theta, x, y, focal, tangents)
    d = theta[0]
    e, f, g = 0.0, 0.0, 0.0
    for k in range(3):
        e += tangents[0, k] * tangents[0, k]
        f += tangents[0, k] * tangents[1, k]
        g += tangents[1, k] * tangents[1, k]
    area = e * g - f * f
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


@_jit
def _window_sums(products: Any, window: Any, y: int, scratch: Any, moments: Any) -> None:
    """Sum products over windows of a row, times powers of the distance: moments (18, power of x, power of y, x)."""
    _, height, width = products.shape
    reach = window.shape[1] // 2
    moments[:] = 0.0
    for n in range(PRODUCTS):
        degree = _DEGREE[n]
        for k in range(degree + 1):
            scratch[:] = 0.0
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                weight = window[k, v - y + reach]
                for x in range(width):
                    scratch[x + reach] += weight * products[n, v, x]
            for j in range(degree + 1 - k):
                out = moments[n, j, k]
                for u in range(2 * reach + 1):
                    weight = window[j, u]
                    for x in range(width):
                        out[x] += weight * scratch[x + u]


@_jit
def _assemble(moments: Any, x: int, h: Any) -> None:
    """Write the full normal matrix at a pixel."""
    for p in range(FULL):
        for q in range(p, FULL):
            h[p, q] = moments[_PAIR[_FIELD[p]][_FIELD[q]], _J[p] + _J[q], _K[p] + _K[q], x]
            h[q, p] = h[p, q]


@_jit
def _reduce(h: Any, basis: Any, n: int, scratch: Any, out: Any) -> None:
    """Write Cᵀ H C."""
    for p in range(FULL):
        for j in range(n):
            total = 0.0
            for q in range(FULL):
                total += h[p, q] * basis[q, j]
            scratch[p, j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for p in range(FULL):
                total += basis[p, i] * scratch[p, j]
            out[i, j] = total


@_jit
def solve_rows(
    products: NDArray[np.float64],
    window: NDArray[np.float64],
    squared: NDArray[np.float64],
    model: Model,
    view: View,
    channels: int,
    first_row: int,
    least: float,
    fit: Fit,
    with_variance: bool,
    rows: tuple[int, int],
) -> None:
    """Fit surface and motion in the window around every pixel of some rows.

    Parameters
    ----------
    products
        The pixels' normal equations, as of `add_products`, shape (18, rows, width).
    window
        Weights times the powers 0 to 4 of the distance, shape (5, 2 r + 1).
    squared
        Squared weights times the same powers, for variances.
    model
        What is fitted.
    view
        Focal length and principal point, as of `warp.View`.
    channels
        Number of colour channels that were added up.
    first_row
        Row of the image at which the products begin.
    least
        Least share of the window that must be known.
    fit
        Output for the whole image; its ``theta`` is read too: tangents of the surface come from it.
    with_variance
        Whether variances and growth are wanted.
    rows
        First and last + 1 row of the products to solve for.
    """
    width = products.shape[2]
    reach = window.shape[1] // 2
    scratch = np.empty(width + 2 * reach)
    moments = np.empty((PRODUCTS, _POWERS, _POWERS, width))
    seconds = np.empty((PRODUCTS, _POWERS, _POWERS, width))
    h, partial, basis = np.empty((FULL, FULL)), np.empty((FULL, FULL)), np.empty((FULL, FULL))
    small, other = np.empty((FULL, FULL)), np.empty((FULL, FULL))
    right, scale, solution, column = np.empty(FULL), np.empty(FULL), np.empty(FULL), np.empty(FULL)
    functional, tangents, bend = np.empty(FULL), np.empty((2, 3)), np.empty((3, 3))
    whole = channels * window[0].sum() ** 2
    for row in range(rows[0], rows[1]):
        y = row + first_row
        _window_sums(products, window, row, scratch, moments)
        if with_variance:
            _window_sums(products, squared, row, scratch, seconds)
        for x in range(width):
            share = moments[16, 0, 0, x] / whole
            fit.residual[:, y, x] = np.nan
            theta = fit.theta[:, y, x]
            if not share >= least:
                theta[:] = np.nan
                continue
            from_x, from_y = x - view.centre_x, y - view.centre_y
            n = _columns(model, theta, from_x, from_y, view.focal, basis)
            _assemble(moments, x, h)
            _reduce(h, basis, n, partial, small)
            for p in range(FULL):
                right[p] = moments[10 + _FIELD[p], _J[p], _K[p], x]
            if model.surface == 0:
                for p in range(FULL):
                    right[p] -= moments[_PAIR[0][_FIELD[p]], _J[p], _K[p], x] * theta[0]
            if model.gradient > 0 and model.surface > 1:
                _bend(theta, from_x, from_y, view.focal, tangents, bend)
                for p in range(FULL):
                    for k in range(3):
                        pair = _PAIR[_FIELD[p]][k + 1]
                        j, m = _J[p], _K[p]
                        right[p] -= (
                            bend[0, k] * moments[pair, j + 2, m, x]
                            + bend[1, k] * moments[pair, j + 1, m + 1, x]
                            + bend[2, k] * moments[pair, j, m + 2, x]
                        )
            good = True
            for i in range(n):
                scale[i] = 1.0 / np.sqrt(small[i, i]) if small[i, i] > 0.0 else 0.0
                good = good and small[i, i] > 0.0
                total = 0.0
                for p in range(FULL):
                    total += basis[p, i] * right[p]
                solution[i] = total * scale[i]
            for i in range(n):
                for j in range(n):
                    small[i, j] *= scale[i] * scale[j]
            if not good or not _factorise(small, n):
                theta[:] = np.nan
                continue
            _solve(small, n, solution)
            # Without depth, d is a unit: it stays.
            for p in range(1 if model.surface == 0 else 0, FULL):
                total = 0.0
                for i in range(n):
                    total += basis[p, i] * solution[i] * scale[i]
                theta[p] = total
            fit.residual[0, y, x] = moments[14, 0, 0, x] / max(moments[15, 0, 0, x], 1e-300)
            fit.residual[1, y, x] = moments[17, 0, 0, x] / moments[16, 0, 0, x]
            if not with_variance:
                continue
            # Cov = H^-1 H2 H^-1 with the sums H of the weights, and H2 of their squares.
            _assemble(seconds, x, h)
            _reduce(h, basis, n, partial, other)
            for i in range(n):
                for j in range(n):
                    other[i, j] *= scale[i] * scale[j]
            functional[:] = 0.0
            if model.gradient > 1 and model.surface >= 3:
                _growth(theta, from_x, from_y, view.focal, tangents, functional)
            for k in range(len(_TOLD) + 1):
                for i in range(n):
                    if k < len(_TOLD):
                        column[i] = basis[_TOLD[k], i] * scale[i]
                    else:
                        total = 0.0
                        for q in range(FULL):
                            total += functional[q] * basis[q, i]
                        column[i] = total * scale[i]
                _solve(small, n, column)
                total = 0.0
                for i in range(n):
                    for j in range(n):
                        total += column[i] * other[i, j] * column[j]
                if k < len(_TOLD):
                    fit.variance[k, y, x] = total
                else:
                    fit.growth[1, y, x] = total
            total = 0.0
            for q in range(FULL):
                total += functional[q] * theta[q]
            fit.growth[0, y, x] = total


@_jit
def _growth(theta: Any, x: float, y: float, focal: float, tangents: Any, out: Any) -> None:
    """Write the functional of the parameters that is the areal growth rate: the surface divergence of q."""
    _tangents(theta, x, y, focal, tangents)
    a, b, c = 0.0, 0.0, 0.0
    for k in range(3):
        a += tangents[0, k] * tangents[0, k]
        b += tangents[0, k] * tangents[1, k]
        c += tangents[1, k] * tangents[1, k]
    area = a * c - b * b
    for k in range(3):
        out[_D + 3 * k + 1] = (c * tangents[0, k] - b * tangents[1, k]) / area
        out[_D + 3 * k + 2] = (a * tangents[1, k] - b * tangents[0, k]) / area
