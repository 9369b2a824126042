"""Kernels that interpolate textures and average them over pixel footprints."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.kernels import inlined, kernel, subkernel
from scenetruth.scene.texture.spline_tap_kernels import spline_value
from scenetruth.threads import in_bands

__all__ = [
    "cubic_weights",
    "linear_at",
    "linear_lookup",
    "linear_means",
    "plaid_means",
    "spline_at",
    "spline_lookup",
    "spline_means",
]

_LEAST_POINTS, _LEAST_FOOTPRINTS = 8192, 256  # minimum number of points, and of multi-sample footprints, per thread
# Kernels use unsigned indices, because signed indices are tested for negative values at every access.


@subkernel()
def cubic_weights(share: np.float32) -> Any:
    """Return six times the four weights of a cubic B-spline between its second and third coefficient."""
    rest = np.float32(1.0) - share
    first, last = rest * rest * rest, share * share * share
    second = np.float32(4.0) - np.float32(6.0) * share * share + np.float32(3.0) * last
    third = np.float32(4.0) - np.float32(6.0) * rest * rest + np.float32(3.0) * first
    return first, second, third, last


@subkernel()
def _spline_across_border(
    flat: NDArray[np.float32], rows: int, columns: int, left: int, top: int, right: np.float32, below: np.float32
) -> Any:  # fmt: skip
    """Return `spline_value` at a place where the spline repeats."""
    w0, w1, w2, w3 = cubic_weights(right)
    i0, i1, i2, i3 = left % columns, (left + 1) % columns, (left + 2) % columns, (left + 3) % columns
    weights, c0, c1, c2, c3 = cubic_weights(below), np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(4):
        weight, start = weights[k], (top + k) % rows * columns
        c0, c1 = c0 + weight * flat[start + i0], c1 + weight * flat[start + i1]
        c2, c3 = c2 + weight * flat[start + i2], c3 + weight * flat[start + i3]
    return (w0 * c0 + w1 * c1) + (w2 * c2 + w3 * c3)


@inlined
def spline_at(flat: NDArray[np.float32], rows: int, columns: int, x: float, y: float) -> Any:
    """Return 36 times the value of a periodic spline, from its coefficients in row-major order, at x, y in texels."""
    fx, fy = np.floor(x), np.floor(y)
    left, top = int(fx) - 1, int(fy) - 1
    right, below = np.float32(x - fx), np.float32(y - fy)
    if left >= 0 and top >= 0 and left + 3 < columns and top + 3 < rows:
        return spline_value(flat, top * columns + left, columns, right, below)
    return _spline_across_border(flat, rows, columns, left, top, right, below)


@inlined
def linear_at(values: NDArray[np.float32], u: float, v: float, tiled: bool) -> Any:
    """Return the value of `linear_lookup` at a point."""
    rows, columns = values.shape
    x = u * columns - 0.5
    y = v * rows - 0.5
    fx, fy = np.floor(x), np.floor(y)
    x0, y0 = int(fx), int(fy)
    x1, y1 = x0 + 1, y0 + 1
    if x0 < 0 or y0 < 0 or x1 >= columns or y1 >= rows:
        if tiled:
            x0, x1, y0, y1 = x0 % columns, x1 % columns, y0 % rows, y1 % rows
        else:
            x0, x1 = min(max(x0, 0), columns - 1), min(max(x1, 0), columns - 1)
            y0, y1 = min(max(y0, 0), rows - 1), min(max(y1, 0), rows - 1)
    a, b = x - fx, y - fy
    upper = (1.0 - a) * values[y0, x0] + a * values[y0, x1]
    lower = (1.0 - a) * values[y1, x0] + a * values[y1, x1]
    return (1.0 - b) * upper + b * lower


def spline_lookup(coefficients: NDArray[np.float32], uv: NDArray[np.float64]) -> NDArray[np.float32]:
    """Evaluate a periodic cubic B-spline; texel (i, j) is at ((j + 1/2) / w, (i + 1/2) / h)."""
    out = np.empty(uv.shape[0], dtype=np.float32)
    in_bands(_spline_lookup, uv.shape[0], coefficients, uv, out, least=_LEAST_POINTS)
    return out


@kernel()
def _spline_lookup(
    low: int, high: int, coefficients: NDArray[np.float32], uv: NDArray[np.float64], out: NDArray[np.float32]
) -> None:
    rows, columns = coefficients.shape
    for n in range(np.uint64(low), np.uint64(high)):
        x, y = uv[n, 0] * columns - 0.5, uv[n, 1] * rows - 0.5
        fx, fy = np.floor(x), np.floor(y)
        x0, y0 = int(fx) - 1, int(fy) - 1
        wx0, wx1, wx2, wx3 = cubic_weights(np.float32(x - fx))
        wy = cubic_weights(np.float32(y - fy))
        total = np.float32(0.0)
        if x0 >= 0 and y0 >= 0 and x0 + 3 < columns and y0 + 3 < rows:
            # Divisions for the period take most of the time elsewhere.
            left, top = np.uint64(x0), np.uint64(y0)
            for k in range(4):
                down = top + np.uint64(k)
                total += wy[k] * (
                    wx0 * coefficients[down, left]
                    + wx1 * coefficients[down, left + np.uint64(1)]
                    + wx2 * coefficients[down, left + np.uint64(2)]
                    + wx3 * coefficients[down, left + np.uint64(3)]
                )
        else:
            c0, c1, c2, c3 = x0 % columns, (x0 + 1) % columns, (x0 + 2) % columns, (x0 + 3) % columns
            for k in range(4):
                # A row view would be reference-counted.
                r = (y0 + k) % rows
                total += wy[k] * (
                    wx0 * coefficients[r, c0]
                    + wx1 * coefficients[r, c1]
                    + wx2 * coefficients[r, c2]
                    + wx3 * coefficients[r, c3]
                )
        out[n] = total / np.float32(36.0)


def spline_means(
    coefficients: NDArray[np.float32],
    forms: NDArray[np.float64],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Average the spline of `spline_lookup` over samples whose coordinates are quotients of linear forms.

    Rows of ``forms``, shape (n, 3, 3): numerators of u and v and their denominator; columns: value at zero offset,
    steps per unit of the offset components.
    """
    out = np.empty(forms.shape[0], dtype=np.float32)
    in_bands(_spline_means, forms.shape[0], coefficients, forms, offsets, weights, out, least=_LEAST_FOOTPRINTS)
    return out


@kernel()
def _spline_means(
    low: int, high: int, coefficients: NDArray[np.float32], forms: NDArray[np.float64], offsets: NDArray[np.float64],
    weights: NDArray[np.float64], out: NDArray[np.float32],
) -> None:  # fmt: skip
    rows, columns = coefficients.shape
    flat = coefficients.ravel()
    samples = offsets.shape[0]
    # Positions of all samples first, in a vectorised loop.
    xs, ys = np.empty(samples, dtype=np.float64), np.empty(samples, dtype=np.float64)
    for n in range(np.uint64(low), np.uint64(high)):
        u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
        v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
        d0, dx, dy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        for m in range(samples):
            x, y = offsets[m, 0], offsets[m, 1]
            scale = 1.0 / (d0 + x * dx + y * dy)
            xs[m] = (u0 + x * ux + y * uy) * scale * columns - 0.5
            ys[m] = (v0 + x * vx + y * vy) * scale * rows - 0.5
        mean = 0.0
        for m in range(samples):
            mean += weights[m] * np.float64(spline_at(flat, rows, columns, xs[m], ys[m]) / np.float32(36.0))
        out[n] = mean


def linear_lookup(values: NDArray[np.float32], uv: NDArray[np.float64], tiled: bool) -> NDArray[np.float32]:
    """Interpolate bilinearly; texel (i, j) is at ((j + 1/2) / w, (i + 1/2) / h), tiled or extended outside."""
    out = np.empty(uv.shape[0], dtype=np.float32)
    in_bands(_linear_lookup, uv.shape[0], values, uv, tiled, out, least=_LEAST_POINTS)
    return out


@kernel()
def _linear_lookup(
    low: int, high: int, values: NDArray[np.float32], uv: NDArray[np.float64], tiled: bool, out: NDArray[np.float32]
) -> None:
    for n in range(np.uint64(low), np.uint64(high)):
        out[n] = linear_at(values, uv[n, 0], uv[n, 1], tiled)


def linear_means(
    values: NDArray[np.float32],
    forms: NDArray[np.float64],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
    tiled: bool,
) -> NDArray[np.float32]:
    """Average the image of `linear_lookup` over samples; other arguments as in `spline_means`."""
    out = np.empty(forms.shape[0], dtype=np.float32)
    in_bands(_linear_means, forms.shape[0], values, forms, offsets, weights, tiled, out, least=_LEAST_FOOTPRINTS)
    return out


@kernel()
def _linear_means(
    low: int, high: int, values: NDArray[np.float32], forms: NDArray[np.float64], offsets: NDArray[np.float64],
    weights: NDArray[np.float64], tiled: bool, out: NDArray[np.float32],
) -> None:  # fmt: skip
    samples = offsets.shape[0]
    for n in range(np.uint64(low), np.uint64(high)):
        u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
        v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
        w0, wx, wy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        mean = 0.0
        for m in range(samples):
            x, y = offsets[m, 0], offsets[m, 1]
            scale = 1.0 / (w0 + x * wx + y * wy)
            mean += weights[m] * linear_at(
                values, (u0 + x * ux + y * uy) * scale, (v0 + x * vx + y * vy) * scale, tiled
            )
        out[n] = mean


def plaid_means(
    forms: NDArray[np.float64], offsets: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Average cos(2 pi u) cos(2 pi v) over samples; arguments as in `spline_means`."""
    out = np.empty(forms.shape[0], dtype=np.float64)
    in_bands(_plaid_means, forms.shape[0], forms, offsets, weights, out, least=_LEAST_FOOTPRINTS)
    return out


@kernel()
def _plaid_means(
    low: int, high: int, forms: NDArray[np.float64], offsets: NDArray[np.float64], weights: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    samples = offsets.shape[0]
    for n in range(np.uint64(low), np.uint64(high)):
        u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
        v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
        w0, wx, wy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        mean = 0.0
        for m in range(samples):
            x, y = offsets[m, 0], offsets[m, 1]
            scale = 2.0 * np.pi / (w0 + x * wx + y * wy)
            mean += weights[m] * np.cos((u0 + x * ux + y * uy) * scale) * np.cos((v0 + x * vx + y * vy) * scale)
        out[n] = mean
