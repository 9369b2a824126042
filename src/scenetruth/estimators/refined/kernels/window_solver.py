"""Kernels that fit one window from its sums, and derive slope, curvature, rotation and growth of the surface."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.pixel_equations import PAIR_OF, SIDE_OF, SQUARE_OF
from scenetruth.estimators.refined.kernels.warp import ImageView
from scenetruth.kernels import kernel

__all__ = [
    "ALL",
    "CURVED",
    "DIRECTION",
    "EVERY_VARIANCE",
    "FULL",
    "FUNCTIONALS",
    "GRADIENTS",
    "KNOWN",
    "POWERS",
    "TOLD",
    "VALUES",
    "Fit",
    "Model",
    "describe_element",
    "fit_window",
    "work_space",
]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

FUNCTIONALS = 11
"""Number of quantities with a variance: slopes along X and Y, mean and Gaussian curvature, three components of the
rotation rate, growth rate of the area, two principal growth rates, angle of the first principal direction."""
VALUES = 13
"""Number of values: the first ten of these, and the three components of the direction."""
DIRECTION = 10
"""Index of the first component of the direction among the values; its sign is arbitrary."""
_CURVATURE, _ROTATION, _AREA, _PRINCIPAL, _ANGLE = 2, 4, 7, 8, 10
# Number of velocity slopes among the parameters: along x and along y, for three components.
_VELOCITY = 6
# Rates that are linear in the velocity slopes: rotation, growth of area, and the growth tensor (aa, bb, ab).
_RATES = 7
# Relative step of the parameters for numerical derivatives, accurate to about two thirds of the digits.
_STEP = 1e-5


@_jit
def tangents_of(theta: Any, x: float, y: float, focal: float, out: Any) -> None:
    """Write the derivatives of the surface along x and y, in baselines: p = (x, y, f) / d."""
    d = theta[0]
    for side in range(2):
        slope = theta[1 + side] / (d * d)
        out[side, 0] = -x * slope
        out[side, 1] = -y * slope
        out[side, 2] = -focal * slope
        out[side, side] += 1.0 / d


@_jit
def metric(tangents: Any) -> Any:
    """Return the first fundamental form E, F, G of two tangents, and its determinant."""
    e, f, g = 0.0, 0.0, 0.0
    for k in range(3):
        e += tangents[0, k] * tangents[0, k]
        f += tangents[0, k] * tangents[1, k]
        g += tangents[1, k] * tangents[1, k]
    return e, f, g, e * g - f * f


@_jit
def _shape(theta: Any, x: float, y: float, focal: float, curved: bool, values: Any, gradients: Any) -> None:
    """Write slopes and curvatures, and their derivatives by the parameters of the disparity.

    The normal is (f d_x, f d_y, m) with m = d - x d_x - y d_y. The normal components of the second derivatives of
    p = (x, y, f) / d are those of d times -(p n) / d: the second fundamental form is the Hessian of d.
    """
    d, d_x, d_y = theta[0], theta[1], theta[2]
    ahead = d - x * d_x - y * d_y
    for side in range(2):
        slope = -focal * theta[1 + side] / ahead
        values[side] = slope
        gradients[side, 0] = -slope / ahead
        gradients[side, 1] = slope * x / ahead
        gradients[side, 2] = slope * y / ahead
        gradients[side, 1 + side] -= focal / ahead
    if not curved:
        return
    xx, xy, yy = 2.0 * theta[3], theta[4], 2.0 * theta[5]
    # Tangents times d², and normal times d³.
    u = (d - x * d_x, -y * d_x, -focal * d_x)
    v = (-x * d_y, d - y * d_y, -focal * d_y)
    n = (focal * d_x, focal * d_y, ahead)
    e, f, g, square = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        e += u[k] * u[k]
        f += u[k] * v[k]
        g += v[k] * v[k]
        square += n[k] * n[k]
    size = np.sqrt(square)
    trace, area = g * xx - 2.0 * f * xy + e * yy, xx * yy - xy * xy
    factor = -0.5 * focal * d / (square * size)
    mean, product = factor * trace, focal * focal * d**4 * area / square**2
    values[_CURVATURE], values[_CURVATURE + 1] = mean, product
    along = (x, y, focal)
    for p in range(3):
        by_e, by_f, by_g, by_square = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            # Derivatives of u, v and n by d, d_x and d_y.
            by_u = (1.0 if k == 0 else 0.0) if p == 0 else (-along[k] if p == 1 else 0.0)
            by_v = (1.0 if k == 1 else 0.0) if p == 0 else (-along[k] if p == 2 else 0.0)
            by_n = (1.0 if k == 2 else 0.0) if p == 0 else (focal if k == p - 1 else 0.0)
            if p > 0 and k == 2:
                by_n -= along[p - 1]
            by_e += 2.0 * u[k] * by_u
            by_f += u[k] * by_v + v[k] * by_u
            by_g += 2.0 * v[k] * by_v
            by_square += 2.0 * n[k] * by_n
        change = by_g * xx - 2.0 * by_f * xy + by_e * yy
        gradients[2, p] = factor * change - 1.5 * mean * by_square / square
        gradients[3, p] = -2.0 * product * by_square / square
    gradients[2, 0] += mean / d
    gradients[3, 0] += 4.0 * product / d
    gradients[2, 3], gradients[2, 4], gradients[2, 5] = 2.0 * factor * g, -2.0 * factor * f, 2.0 * factor * e
    scale = focal * focal * d**4 / square**2
    gradients[3, 3], gradients[3, 4], gradients[3, 5] = 2.0 * scale * yy, -2.0 * scale * xy, 2.0 * scale * xx


@_jit
def _rates(theta: Any, x: float, y: float, focal: float, rows: Any, values: Any, second: Any) -> Any:
    """Write the rates of the element; return the difference of the principal rates, and cosine and sine of the angle.

    ``rows``: Output: coefficients of each rate for the slopes q_x and q_y, shape (7, 6).
    """
    tangents = np.empty((2, 3))
    tangents_of(theta, x, y, focal, tangents)
    e, f, g, area = metric(tangents)
    size, first = np.sqrt(area), np.sqrt(e)
    n, a, b = np.empty(3), np.empty(3), np.empty(3)
    dual, turned = np.empty((2, 3)), np.empty((2, 3))
    for k in range(3):
        one, other = (k + 1) % 3, (k + 2) % 3
        n[k] = (tangents[0, one] * tangents[1, other] - tangents[0, other] * tangents[1, one]) / size
        a[k] = tangents[0, k] / first
        dual[0, k] = (g * tangents[0, k] - f * tangents[1, k]) / area
        dual[1, k] = (e * tangents[1, k] - f * tangents[0, k]) / area
    for k in range(3):
        one, other = (k + 1) % 3, (k + 2) % 3
        b[k] = n[one] * a[other] - n[other] * a[one]
        for side in range(2):
            turned[side, k] = n[one] * dual[side, other] - n[other] * dual[side, one]
    for side in range(2):
        by_a, by_b = 0.0, 0.0
        for k in range(3):
            by_a += dual[side, k] * a[k]
            by_b += dual[side, k] * b[k]
        for k in range(3):
            at = 3 * side + k
            for i in range(3):
                # n x dn/dt with dn/dt = -(p^x (n q_x) + p^y (n q_y)), and half the curl along n.
                rows[i, at] = -turned[side, i] * n[k] + 0.5 * n[i] * turned[side, k]
            rows[3, at] = dual[side, k]
            rows[4, at] = a[k] * by_a
            rows[5, at] = b[k] * by_b
            rows[6, at] = 0.5 * (a[k] * by_b + b[k] * by_a)
    rates = np.zeros(_RATES)
    for i in range(_RATES):
        for side in range(2):
            for k in range(3):
                rates[i] += rows[i, 3 * side + k] * theta[_VELOCITY + 3 * k + 1 + side]
    for i in range(4):
        values[_ROTATION + i] = rates[i]
    half = 0.5 * (rates[4] - rates[5])
    spread = np.sqrt(half * half + rates[6] * rates[6])
    values[_PRINCIPAL], values[_PRINCIPAL + 1] = 0.5 * rates[3] + spread, 0.5 * rates[3] - spread
    angle = 0.5 * np.arctan2(rates[6], half)
    cosine, sine = np.cos(angle), np.sin(angle)
    for k in range(3):
        values[_ANGLE + k] = cosine * a[k] + sine * b[k]
        second[k] = cosine * b[k] - sine * a[k]
    return 2.0 * spread, cosine, sine


@_jit
def _motion(theta: Any, x: float, y: float, focal: float, free: bool, values: Any, gradients: Any) -> None:
    """Write rotation and growth, and their derivatives by the parameters.

    Where the velocity slopes are ``free``, that is independent of the surface, errors of the surface also contribute.
    Otherwise rotation and growth are the fitted parameters, and the slopes vary with the surface.
    """
    rows, second = np.empty((_RATES, 6)), np.empty(3)
    apart, cosine, sine = _rates(theta, x, y, focal, rows, values, second)
    mixed = cosine * sine
    for at in range(6):
        place = _VELOCITY + 3 * (at % 3) + 1 + at // 3
        for i in range(4):
            gradients[_ROTATION + i, place] = rows[i, at]
        aa, bb, ab = rows[4, at], rows[5, at], rows[6, at]
        gradients[_PRINCIPAL, place] = cosine * cosine * aa + 2.0 * mixed * ab + sine * sine * bb
        gradients[_PRINCIPAL + 1, place] = sine * sine * aa - 2.0 * mixed * ab + cosine * cosine * bb
        gradients[_ANGLE, place] = (mixed * (bb - aa) + (cosine * cosine - sine * sine) * ab) / apart
    if not free:
        return
    changed, either, unused = theta.copy(), np.empty((2, VALUES)), np.empty(3)
    for p in range(3):
        step = _STEP * (abs(theta[0]) if p == 0 else abs(theta[0]) / focal)
        for side in range(2):
            changed[p] = theta[p] + (step if side == 0 else -step)
            _rates(changed, x, y, focal, rows, either[side], unused)
        changed[p] = theta[p]
        for i in range(_ROTATION, _ANGLE):
            gradients[i, p] = (either[0, i] - either[1, i]) / (2.0 * step)
        for side in range(2):
            along, across = 0.0, 0.0
            for k in range(3):
                along += either[side, _ANGLE + k] * values[_ANGLE + k]
                across += either[side, _ANGLE + k] * second[k]
            # The sign of a direction is arbitrary.
            gradients[_ANGLE, p] += (0.5 if side == 0 else -0.5) * across / along / step


@_jit
def describe_element(
    surface: int, gradient: int, theta: Any, x: float, y: float, focal: float, values: Any, gradients: Any
) -> None:
    """Write the quantities of a surface element and their derivatives by the parameters of the fit.

    ``values``: Output, shape (13,), lengths in baselines: see `VALUES`. Curvatures are positive where the surface is
      convex towards the camera; rotations are right-handed; the sign of the direction is arbitrary.
    ``gradients``: Output, shape (11, 15): derivatives of the quantities of `FUNCTIONALS` by the parameters.
    """
    values[:] = np.nan
    gradients[:] = 0.0
    if surface < 2:
        return
    _shape(theta, x, y, focal, surface == _VELOCITY, values, gradients)
    if gradient > 0:
        _motion(theta, x, y, focal, gradient == 3, values, gradients)
    # Without growth in the model, growth is undetermined rather than zero.
    if gradient < 2:
        values[_AREA] = np.nan
    if gradient < 3:
        values[_PRINCIPAL:] = np.nan


FULL = 15
"""Number of parameters of the full model: d, d_x, d_y, d_xx, d_xy, d_yy; q_X and its slopes along x and y; q_Y; q_Z."""
ALL = FULL + 3
"""Number with the acceleration, a_X, a_Y and a_Z, which is constant in a window."""
CURVED = 6

# Monomials x^j y^k of the disparity parameters, then of each velocity component, and the field of each parameter.
_J = np.array((0, 1, 0, 2, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0))
_K = np.array((0, 0, 1, 0, 1, 2, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 0))
_FIELD = np.repeat(np.arange(7), [CURVED, 3, 3, 3, 1, 1, 1])
# Moments are numbered by product, power of x, power of y: those of pairs of parameters, of the right-hand sides, and of
# parameters with the second powers of each velocity component. (Tuples would be copied at every access.)
POWERS = 5


def _number(product: Any, j: Any, k: Any) -> NDArray[np.int64]:
    return np.asarray((product * POWERS + j) * POWERS + k)


_OF_PAIR = _number(PAIR_OF[_FIELD[:, None], _FIELD], _J[:, None] + _J, _K[:, None] + _K)
_OF_RIGHT = _number(SIDE_OF[_FIELD], _J, _K)
_OF_BEND = _number(
    PAIR_OF[_FIELD, 1:4][:, None, :].repeat(3, axis=1),
    _J[:, None, None] + np.array([2, 1, 0])[:, None],
    _K[:, None, None] + np.array([0, 1, 2])[:, None],
)
_SQUARES, _FREEDOM, KNOWN, GRADIENTS = (int(_number(n, 0, 0)) for n in (14, 15, 16, 17))
# Squares of b of the fields, and their expectation for white noise of 1.
_LEFT, _EXPECTED = _number(SQUARE_OF, 0, 0), _number(np.diag(PAIR_OF), 0, 0)
TOLD = np.array([0, 1, 2, 6, 9, 12, 15, 16, 17])
"""Parameters whose variances are output."""
EVERY_VARIANCE = len(TOLD) + 1
"""Number that selects all variances, including those of the surface element."""
_GRADIENTS = len(TOLD) + FUNCTIONALS  # number of functions of the parameters with a variance


class Model(NamedTuple):
    """Models of surface and motion."""

    surface: int
    """Number of disparity parameters: 0 (none), 1 (constant), 3 (slopes), 6 (curvature)."""
    components: int
    """Number of velocity components: 0 (none), 2 (X and Y) or 3."""
    gradient: int
    """Velocity gradient: 0 (none), 1 (rotation), 2 (rotation and isotropic growth), 3 (all six)."""
    accelerated: bool = False
    """Whether the velocity components change uniformly over time."""


class Fit(NamedTuple):
    """Output of `solve_rows`, with the rows and columns of the image last."""

    theta: NDArray[np.float64]
    """Parameters of the full model, shape (15, height, width), or (18, height, width) with acceleration."""
    variance: NDArray[np.float64]
    """Variances of d, d_x, d_y, q_X, q_Y, q_Z, and a_X, a_Y, a_Z, shape (9, height, width)."""
    element: NDArray[np.float32]
    """Quantities of the surface element from `describe_element`, shape (13, height, width)."""
    element_variance: NDArray[np.float32]
    """Variances of these quantities, shape (11, height, width)."""
    images: NDArray[np.float32]
    """Mean number of valid images over the pixels of the window, shape (height, width)."""
    residual: NDArray[np.float64]
    """Mean square residual per degree of freedom, and mean square texture gradient, shape (2, height, width)."""


@_jit
def _columns(model: Model, theta: Any, x: float, y: float, focal: float, places: Any, values: Any, sizes: Any) -> int:
    """Write the basis of the fitted model, as indices and values of each column; return the number of columns."""
    used = 0
    for k in range(model.surface):
        places[used, 0], values[used, 0], sizes[used] = k, 1.0, 1
        used += 1
    for c in range(model.components):
        for side in range(3 if model.gradient == 3 else 1):
            places[used, 0], values[used, 0], sizes[used] = CURVED + 3 * c + side, 1.0, 1
            used += 1
    if model.gradient == 1 or model.gradient == 2:
        # q changes by A p over the surface, whose tangents are p_x and p_y; rotation is A = [w]x, growth is A = e I.
        tangents = np.empty((2, 3))
        tangents_of(theta, x, y, focal, tangents)
        for turn in range(3):
            sizes[used + turn] = 4
        sizes[used + 3] = 6
        for side in range(2):
            at = CURVED + 1 + side
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
    if model.accelerated:
        for c in range(model.components):
            places[used, 0], values[used, 0], sizes[used] = FULL + c, 1.0, 1
            used += 1
    return used


@_jit
def _bend(theta: Any, x: float, y: float, focal: float, tangents: Any, bend: Any) -> None:
    """Write the second-order velocity terms that follow from the surface: those of ξ², ξη and η², shape (3, 3).

    A rotating and growing surface element retains its curvature: the second derivatives of q are A p_xx, A p_xy and
    A p_yy, where A maps the tangents to the derivatives of q, and the normal to its rate of change.
    """
    tangents_of(theta, x, y, focal, tangents)
    d = theta[0]
    e, f, g, area = metric(tangents)
    n0 = tangents[0, 1] * tangents[1, 2] - tangents[0, 2] * tangents[1, 1]
    n1 = tangents[0, 2] * tangents[1, 0] - tangents[0, 0] * tangents[1, 2]
    n2 = tangents[0, 0] * tangents[1, 1] - tangents[0, 1] * tangents[1, 0]
    # Rates of rotation of the tangents towards the normal.
    along = n0 * theta[CURVED + 1] + n1 * theta[CURVED + 4] + n2 * theta[CURVED + 7]
    down = n0 * theta[CURVED + 2] + n1 * theta[CURVED + 5] + n2 * theta[CURVED + 8]
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
            bend[term, k] = half * (a * theta[CURVED + 1 + 3 * k] + b * theta[CURVED + 2 + 3 * k] + c * turned)


@_jit
def _factorise(a: Any, n: int) -> bool:
    """Factorise a symmetric matrix in place as L Lᵀ; return whether it is positive definite."""
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
def _solve_columns(factor: Any, n: int, x: Any) -> None:
    """Solve L Lᵀ X = X in place, for all columns together: their constant number fills vector instructions."""
    for i in range(n):
        for k in range(i):
            for m in range(_GRADIENTS):
                x[i, m] -= factor[i, k] * x[k, m]
        inverse = 1.0 / factor[i, i]
        for m in range(_GRADIENTS):
            x[i, m] *= inverse
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            for m in range(_GRADIENTS):
                x[i, m] -= factor[k, i] * x[k, m]
        inverse = 1.0 / factor[i, i]
        for m in range(_GRADIENTS):
            x[i, m] *= inverse


@_jit
def _quadratic_forms(matrix: Any, n: int, x: Any, share: Any, out: Any) -> None:
    """Write xᵀ S x of every column of x, with a symmetric matrix S."""
    for m in range(_GRADIENTS):
        out[m] = 0.0
    for i in range(n):
        for m in range(_GRADIENTS):
            share[m] = 0.0
        for j in range(n):
            for m in range(_GRADIENTS):
                share[m] += matrix[i, j] * x[j, m]
        for m in range(_GRADIENTS):
            out[m] += x[i, m] * share[m]


@_jit
def _full_matrix(moments: Any, place: int, surface: int, count: int, out: Any, weights: Any) -> None:
    """Write W H W with the normal matrix H at a pixel and weights W of the fields, for parameters of the model only."""
    for p in range(count):
        if surface <= p < CURVED:
            continue
        for q in range(p, count):
            if surface <= q < CURVED:
                continue
            out[p, q] = out[q, p] = moments[_OF_PAIR[p, q], place] * weights[_FIELD[p]] * weights[_FIELD[q]]


@_jit
def _reduce(full: Any, places: Any, values: Any, sizes: Any, n: int, out: Any) -> None:
    """Write Cᵀ F C with a matrix F of the full model."""
    for j in range(n):
        for i in range(j, n):
            total = 0.0
            for k in range(sizes[j]):
                line, share = full[places[j, k]], 0.0
                for m in range(sizes[i]):
                    share += values[i, m] * line[places[i, m]]
                total += values[j, k] * share
            out[i, j] = out[j, i] = total


@_jit
def _along(column: Any, places: Any, values: Any, sizes: Any, n: int, out: Any) -> None:
    """Write Cᵀ times a vector of the parameters of the full model."""
    for i in range(n):
        out[i] = 0.0
        for k in range(sizes[i]):
            out[i] += values[i, k] * column[places[i, k]]


class WorkSpace(NamedTuple):
    """Scratch arrays for the fit of one window."""

    places: NDArray[np.int64]
    values: NDArray[np.float64]
    sizes: NDArray[np.int64]
    bend: NDArray[np.float64]
    tangents: NDArray[np.float64]
    matrices: NDArray[np.float64]
    vectors: NDArray[np.float64]
    element: NDArray[np.float64]
    gradients: NDArray[np.float64]
    noise: NDArray[np.float64]
    ones: NDArray[np.float64]
    columns: NDArray[np.float64]
    variances: NDArray[np.float64]


@_jit
def work_space() -> Any:
    """Return arrays for `fit_window`."""
    return WorkSpace(
        np.empty((ALL, 6), dtype=np.int64),
        np.empty((ALL, 6)),
        np.empty(ALL, dtype=np.int64),
        np.empty((3, 3)),
        np.empty((2, 3)),
        np.empty((3, ALL, ALL)),
        np.empty((5, ALL)),
        np.empty(VALUES),
        np.zeros((FUNCTIONALS, ALL)),
        np.empty(7),
        np.ones(7),
        np.zeros((ALL, _GRADIENTS)),
        np.empty((2, _GRADIENTS)),
    )


@_jit
def fit_window(
    moments: Any,
    seconds: Any,
    place: int,
    model: Model,
    view: ImageView,
    enough: bool,
    fit: Fit,
    pixel: tuple[int, int],
    entry: tuple[int, int],
    told: int,
    work: Any,
) -> None:
    """Fit a model to the moments, in column ``place``, of the window around a pixel, if they suffice.

    ``pixel``: Column and row of the image.
    ``entry``: Column and row of the maps of the fit.
    """
    x, y = pixel
    column_of, row_of = entry
    places, values, sizes, bend, tangents = work.places, work.values, work.sizes, work.bend, work.tangents
    small, other, full = work.matrices[0], work.matrices[1], work.matrices[2]
    right, scale, solution, column = work.vectors[0], work.vectors[1], work.vectors[2], work.vectors[3]
    element = work.element
    fit.residual[:, row_of, column_of] = np.nan
    count = fit.theta.shape[0]
    if not enough:
        for k in range(count):
            fit.theta[k, row_of, column_of] = np.nan
        return
    # Contiguous, as everywhere else, so that the kernels below are compiled once.
    theta = work.vectors[4, :count]
    for k in range(count):
        theta[k] = fit.theta[k, row_of, column_of]
    from_x, from_y = x - view.centre_x, y - view.centre_y
    n = _columns(model, theta, from_x, from_y, view.focal, places, values, sizes)
    _full_matrix(moments, place, model.surface, count, full, work.ones)
    _reduce(full, places, values, sizes, n, small)
    for p in range(count):
        right[p] = moments[_OF_RIGHT[p], place]
    if model.surface == 0:
        for p in range(count):
            right[p] -= moments[_OF_PAIR[p, 0], place] * theta[0]
    if model.gradient > 0 and model.surface > 1:
        _bend(theta, from_x, from_y, view.focal, tangents, bend)
        for p in range(count):
            for term in range(3):
                for c in range(3):
                    right[p] -= bend[term, c] * moments[_OF_BEND[p, term, c], place]
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
        for k in range(count):
            fit.theta[k, row_of, column_of] = np.nan
        return
    _solve(small, n, solution)
    # Without depth, d is a unit and remains unchanged.
    theta[1 if model.surface == 0 else 0 :] = 0.0
    for i in range(n):
        for k in range(sizes[i]):
            theta[places[i, k]] += values[i, k] * solution[i] * scale[i]
    for k in range(count):
        fit.theta[k, row_of, column_of] = theta[k]
    fit.residual[0, row_of, column_of] = moments[_SQUARES, place] / max(moments[_FREEDOM, place], 1e-300)
    fit.residual[1, row_of, column_of] = moments[GRADIENTS, place] / moments[KNOWN, place]
    if told == 0:
        return
    # Cov = H^-1 S H^-1 with the sums H of the weights, and S of their squares times the ratio of b to its expectation
    # for white noise: residuals may be correlated between images.
    for field in range(7 if count > FULL else 4):
        expected = moments[_EXPECTED[field], place]
        square = moments[_LEFT[field], place] / expected if expected > 0.0 else 0.0
        work.noise[field] = np.sqrt(max(square, fit.residual[0, row_of, column_of]))
    _full_matrix(seconds, place, model.surface, count, full, work.noise)
    _reduce(full, places, values, sizes, n, other)
    for i in range(n):
        for j in range(n):
            other[i, j] *= scale[i] * scale[j]
    fit.images[row_of, column_of] = moments[_FREEDOM, place] / moments[KNOWN, place] + 1.0
    if told == 1:
        for i in range(n):
            column[i] = scale[i] if sizes[i] == 1 and places[i, 0] == TOLD[0] else 0.0
        _solve(small, n, column)
        total = 0.0
        for i in range(n):
            for j in range(n):
                total += column[i] * other[i, j] * column[j]
        fit.variance[0, row_of, column_of] = total
        return
    several = len(TOLD)
    if told > several:
        describe_element(model.surface, model.gradient, theta, from_x, from_y, view.focal, element, work.gradients)
        for k in range(VALUES):
            fit.element[k, row_of, column_of] = element[k]
    columns, variances = work.columns, work.variances[0]
    for i in range(n):
        for k in range(several):
            columns[i, k] = scale[i] if sizes[i] == 1 and places[i, 0] == TOLD[k] else 0.0
    if told > several:
        for k in range(several, _GRADIENTS):
            _along(work.gradients[k - several], places, values, sizes, n, column)
            for i in range(n):
                columns[i, k] = column[i] * scale[i]
    _solve_columns(small, n, columns)
    _quadratic_forms(other, n, columns, work.variances[1], variances)
    for k in range(min(told, several)):
        if TOLD[k] < count:
            fit.variance[k, row_of, column_of] = variances[k]
    if told > several:
        for k in range(FUNCTIONALS):
            if not np.isnan(element[k]):
                fit.element_variance[k, row_of, column_of] = variances[several + k]
