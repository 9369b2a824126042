"""Kernels that look up textures on a periodic or bordered raster."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["linear_lookup", "linear_means", "plaid_means", "spline_lookup", "spline_means"]

# Footprints that share scratch memory.
_PART = 256


@numba.njit(cache=True, nogil=True)
def _cubic_weights(share: np.float32) -> Any:
    """Return six times the four weights of a cubic B-spline between its second and its third coefficient."""
    rest = np.float32(1.0) - share
    first, last = rest * rest * rest, share * share * share
    second = np.float32(4.0) - np.float32(6.0) * share * share + np.float32(3.0) * last
    third = np.float32(4.0) - np.float32(6.0) * rest * rest + np.float32(3.0) * first
    return first, second, third, last


@numba.njit(cache=True, nogil=True)
def _linear(values: NDArray[np.float32], u: float, v: float, tiled: bool) -> Any:
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


@numba.njit(cache=True, nogil=True, parallel=True)
def spline_lookup(coefficients: NDArray[np.float32], uv: NDArray[np.float64]) -> Any:
    """Evaluate a periodic cubic B-spline; texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h)."""
    rows, columns = coefficients.shape
    count = uv.shape[0]
    out = np.empty(count, dtype=np.float32)
    for n in numba.prange(count):
        x, y = uv[n, 0] * columns - 0.5, uv[n, 1] * rows - 0.5
        fx, fy = np.floor(x), np.floor(y)
        x0, y0 = int(fx) - 1, int(fy) - 1
        wx0, wx1, wx2, wx3 = _cubic_weights(np.float32(x - fx))
        wy = _cubic_weights(np.float32(y - fy))
        c0, c1, c2, c3 = x0 % columns, (x0 + 1) % columns, (x0 + 2) % columns, (x0 + 3) % columns
        total = np.float32(0.0)
        for k in range(4):
            row = coefficients[(y0 + k) % rows]
            total += wy[k] * (wx0 * row[c0] + wx1 * row[c1] + wx2 * row[c2] + wx3 * row[c3])
        out[n] = total / np.float32(36.0)
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def spline_means(
    coefficients: NDArray[np.float32],
    forms: NDArray[np.float64],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> Any:
    """Average the spline of `spline_lookup` over samples whose coordinates are quotients of linear forms.

    ``forms``, shape (n, 3, 3), has the numerators of u and v and their denominator as its rows: the value at an offset
    of zero, and the steps per unit of the offset's two components. ``offsets`` has shape (samples, 2), and
    ``weights`` (samples,).
    """
    rows, columns = coefficients.shape
    flat = coefficients.ravel()
    count, samples = forms.shape[0], offsets.shape[0]
    out = np.empty(count, dtype=np.float32)
    for part in numba.prange((count + _PART - 1) // _PART):
        # Positions and weights of all samples first: those loops run in vector registers.
        xs, ys = np.empty(samples, dtype=np.float64), np.empty(samples, dtype=np.float64)
        left, top = np.empty(samples, dtype=np.int64), np.empty(samples, dtype=np.int64)
        wx, wy = np.empty((4, samples), dtype=np.float32), np.empty((4, samples), dtype=np.float32)
        for n in range(part * _PART, min((part + 1) * _PART, count)):
            u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
            v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
            d0, dx, dy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
            for m in range(samples):
                x, y = offsets[m, 0], offsets[m, 1]
                scale = 1.0 / (d0 + x * dx + y * dy)
                xs[m] = (u0 + x * ux + y * uy) * scale * columns - 0.5
                ys[m] = (v0 + x * vx + y * vy) * scale * rows - 0.5
            for m in range(samples):
                fx, fy = np.floor(xs[m]), np.floor(ys[m])
                left[m], top[m] = int(fx) - 1, int(fy) - 1
                wx[0, m], wx[1, m], wx[2, m], wx[3, m] = _cubic_weights(np.float32(xs[m] - fx))
                wy[0, m], wy[1, m], wy[2, m], wy[3, m] = _cubic_weights(np.float32(ys[m] - fy))
            mean = 0.0
            for m in range(samples):
                i, j = left[m], top[m]
                w0, w1, w2, w3 = wx[0, m], wx[1, m], wx[2, m], wx[3, m]
                total = np.float32(0.0)
                if i >= 0 and j >= 0 and i + 3 < columns and j + 3 < rows:
                    at = j * columns + i
                    for k in range(4):
                        total += wy[k, m] * (w0 * flat[at] + w1 * flat[at + 1] + w2 * flat[at + 2] + w3 * flat[at + 3])
                        at += columns
                else:
                    c0, c1, c2, c3 = i % columns, (i + 1) % columns, (i + 2) % columns, (i + 3) % columns
                    for k in range(4):
                        row = coefficients[(j + k) % rows]
                        total += wy[k, m] * (w0 * row[c0] + w1 * row[c1] + w2 * row[c2] + w3 * row[c3])
                mean += weights[m] * np.float64(total / np.float32(36.0))
            out[n] = mean
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def linear_lookup(values: NDArray[np.float32], uv: NDArray[np.float64], tiled: bool) -> Any:
    """Interpolate bilinearly; texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h), outside it repeats or stays."""
    count = uv.shape[0]
    out = np.empty(count, dtype=np.float32)
    for n in numba.prange(count):
        out[n] = _linear(values, uv[n, 0], uv[n, 1], tiled)
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def linear_means(
    values: NDArray[np.float32],
    forms: NDArray[np.float64],
    offsets: NDArray[np.float64],
    weights: NDArray[np.float64],
    tiled: bool,
) -> Any:
    """Average the image of `linear_lookup` over samples; the rest as in `spline_means`."""
    count, samples = forms.shape[0], offsets.shape[0]
    out = np.empty(count, dtype=np.float32)
    for n in numba.prange(count):
        u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
        v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
        w0, wx, wy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        mean = 0.0
        for m in range(samples):
            x, y = offsets[m, 0], offsets[m, 1]
            scale = 1.0 / (w0 + x * wx + y * wy)
            mean += weights[m] * _linear(values, (u0 + x * ux + y * uy) * scale, (v0 + x * vx + y * vy) * scale, tiled)
        out[n] = mean
    return out


@numba.njit(cache=True, nogil=True, parallel=True)
def plaid_means(forms: NDArray[np.float64], offsets: NDArray[np.float64], weights: NDArray[np.float64]) -> Any:
    """Average cos(2 pi u) cos(2 pi v) over samples; the rest as in `spline_means`."""
    count, samples = forms.shape[0], offsets.shape[0]
    out = np.empty(count, dtype=np.float64)
    for n in numba.prange(count):
        u0, ux, uy = forms[n, 0, 0], forms[n, 0, 1], forms[n, 0, 2]
        v0, vx, vy = forms[n, 1, 0], forms[n, 1, 1], forms[n, 1, 2]
        w0, wx, wy = forms[n, 2, 0], forms[n, 2, 1], forms[n, 2, 2]
        mean = 0.0
        for m in range(samples):
            x, y = offsets[m, 0], offsets[m, 1]
            scale = 2.0 * np.pi / (w0 + x * wx + y * wy)
            mean += weights[m] * np.cos((u0 + x * ux + y * uy) * scale) * np.cos((v0 + x * vx + y * vy) * scale)
        out[n] = mean
    return out
