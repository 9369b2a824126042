"""Kernels for what a surface element does: its slopes, curvature, rotation and growth, from a fit's parameters."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

__all__ = ["FUNCTIONALS", "VALUES", "describe_element", "metric", "tangents_of"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

FUNCTIONALS = 11
"""What has a variance: slopes along X and Y, mean and Gaussian curvature, three components of the rotation, growth of
area, the larger and the lesser growth of length, the angle of the larger one's direction."""
VALUES = 13
"""The first ten of these, and the three components of the direction."""
_CURVATURE, _ROTATION, _AREA, _PRINCIPAL, _ANGLE = 2, 4, 7, 8, 10
# Of the parameters, those of velocity's slopes: along x and along y, for three components.
_VELOCITY = 6
# Rates that are linear in the velocity's slopes: rotation, growth of area, and the tensor of growth (aa, bb, ab).
_RATES = 7
# Parts of the disparity by which parameters are changed to find derivatives: two thirds of the digits are left.
_STEP = 1e-5


@_jit
def tangents_of(theta: Any, x: float, y: float, focal: float, out: Any) -> None:
    """Write the surface's derivatives along x and y, in baselines: p = (x, y, f) / d."""
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
    """Write slopes and curvatures, and their derivatives by the disparity's parameters.

    The normal is (f d_x, f d_y, m) with m = d - x d_x - y d_y. Of p = (x, y, f) / d, second derivatives along the
    normal are those of d, times -(p n) / d: the second fundamental form is the Hessian of d.
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
    # The tangents times d², and the normal times d³.
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
    """Write what the velocity's slopes make of the element; return both growths' difference, and the direction.

    Parameters
    ----------
    rows
        Output: what each rate takes of the slopes q_x and q_y, shape (7, 6).
    values
        Output: rotation, growth of area, both growths of length, and the direction of the larger.
    second
        Output: the direction across that one, in the surface.
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

    Where the velocity's slopes are ``free`` of the surface's, errors of the surface count too. Otherwise rotation and
    growth themselves are what is fitted, and turn the slopes along with the surface.
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
            # Either sign of a direction is the same.
            gradients[_ANGLE, p] += (0.5 if side == 0 else -0.5) * across / along / step


@_jit
def describe_element(
    surface: int, gradient: int, theta: Any, x: float, y: float, focal: float, values: Any, gradients: Any
) -> None:
    """Write what a surface element is and does, and how that depends on the fit's parameters.

    Parameters
    ----------
    surface, gradient
        Of the model, see `windows.Model`. What it does not tell is NaN.
    theta
        The parameters.
    x, y, focal
        The pixel, from the principal point, and the focal length.
    values
        Output, shape (13,), lengths in baselines: what `VALUES` says. Curvatures are positive where the surface bulges
        towards the camera, rotations turn by the right hand; of the direction either sign is meant.
    gradients
        Output, shape (11, 15): derivatives of what `FUNCTIONALS` says by the parameters.
    """
    values[:] = np.nan
    gradients[:] = 0.0
    if surface < 2:
        return
    _shape(theta, x, y, focal, surface == _VELOCITY, values, gradients)
    if gradient > 0:
        _motion(theta, x, y, focal, gradient == 3, values, gradients)
    # Of a turn without growth, growth is not known to be zero; it is not asked for.
    if gradient < 2:
        values[_AREA] = np.nan
    if gradient < 3:
        values[_PRINCIPAL:] = np.nan
