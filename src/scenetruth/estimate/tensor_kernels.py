"""Kernels of the 4D structure tensor: derivatives, windowed products and null space, tile by tile."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["estimate_tiles"]

_LANES = 16
_SWEEPS = 6
# Products of derivatives, in the order in which `_accumulate_products` makes them.
_XX, _XY, _YY, _XS, _YS, _XT, _YT, _SS, _ST, _TT, _XE, _YE, _SE, _TE, _EE = range(15)
# Entries of the tensor, in the order in which `_window_row` makes them.
_ROWS = np.array([0, 0, 1, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3, 3, 4])
_COLUMNS = np.array([0, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 3, 4, 4])

# No fast mathematics: with fused operations, results would depend on what the compiler happened to inline.
_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _reduce_cameras(
    images: Any, camera: int, shift: int, first: int, frame: int, top: int, over_s: Any, reduced: Any
) -> None:
    """Filter the registered images of a frame along s: with S, with D, and with the moment -shift s S."""
    taps = over_s.shape[1]
    _, rows, columns = reduced.shape
    for y in range(rows):
        for part in range(3):
            for x in range(columns):
                reduced[part, y, x] = 0.0
        for s in range(taps):
            start = first - (s - taps // 2) * shift
            image = images[camera + s, frame, top + y, start : start + columns]
            a, b, c = over_s[0, s], over_s[1, s], over_s[2, s]
            for x in range(columns):
                value = np.float32(image[x])
                reduced[0, y, x] += a * value
                reduced[1, y, x] += b * value
                reduced[2, y, x] += c * value


@_jit
def _filter_row(source: Any, kernel: Any, out: Any) -> None:
    """Correlate one row with a short kernel."""
    count = out.shape[0]
    for x in range(count):
        out[x] = 0.0
    for k in range(kernel.shape[0]):
        weight = kernel[k]
        for x in range(count):
            out[x] += weight * source[x + k]


@_jit
def _derive(ring: Any, newest: int, smoothing: Any, derivative: Any, moment: Any, scratch: Any, out: Any) -> None:
    """Make g_x, g_y, g_s, g_t and the divergence correction e of one frame from five frames along t.

    ``scratch`` holds, for every row, what has been filtered along t and x: S, D and M of the smoothed images, S of
    their derivatives along s and t, D of their moment along s.
    """
    taps = smoothing.shape[0]
    rows, columns = ring.shape[2], ring.shape[3]
    smooth = np.empty(columns, dtype=np.float32)
    over_s = np.empty(columns, dtype=np.float32)
    over_t = np.empty(columns, dtype=np.float32)
    tilted = np.empty(columns, dtype=np.float32)
    for y in range(rows):
        for x in range(columns):
            smooth[x] = 0.0
            over_s[x] = 0.0
            over_t[x] = 0.0
            tilted[x] = 0.0
        for k in range(taps):
            slot = (newest + 1 + k) % taps
            a, b = smoothing[k], derivative[k]
            one, two, three = ring[slot, 0, y], ring[slot, 1, y], ring[slot, 2, y]
            for x in range(columns):
                smooth[x] += a * one[x]
                over_s[x] += a * two[x]
                over_t[x] += b * one[x]
                tilted[x] += a * three[x]
        _filter_row(smooth, smoothing, scratch[0, y])
        _filter_row(smooth, derivative, scratch[1, y])
        _filter_row(smooth, moment, scratch[2, y])
        _filter_row(over_s, smoothing, scratch[3, y])
        _filter_row(over_t, smoothing, scratch[4, y])
        _filter_row(tilted, derivative, scratch[5, y])
        for x in range(scratch.shape[2]):
            scratch[2, y, x] += scratch[5, y, x]
    count = out.shape[2]
    for y in range(out.shape[1]):
        for part in range(5):
            for x in range(count):
                out[part, y, x] = 0.0
        for k in range(taps):
            a, b, c = smoothing[k], derivative[k], moment[k]
            s_x, d_x, m_x = scratch[0, y + k], scratch[1, y + k], scratch[2, y + k]
            s_s, s_t = scratch[3, y + k], scratch[4, y + k]
            for x in range(count):
                out[0, y, x] += a * d_x[x]
                out[1, y, x] += b * s_x[x]
                out[2, y, x] += a * s_s[x]
                out[3, y, x] += a * s_t[x]
                out[4, y, x] += a * m_x[x] + (c - np.float32(2.0) * a) * s_x[x]


@_jit
def _accumulate_products(derivatives: Any, newest: int, weights: Any, with_correction: bool, y: int, out: Any) -> None:
    """Sum up one row of the products of derivatives over the frames of the window."""
    frames, count = derivatives.shape[0], derivatives.shape[3]
    out[:] = 0.0
    for m in range(frames):
        slot = (newest + 1 + m) % frames
        w = weights[m]
        g_x, g_y = derivatives[slot, 0, y], derivatives[slot, 1, y]
        g_s, g_t, e = derivatives[slot, 2, y], derivatives[slot, 3, y], derivatives[slot, 4, y]
        for x in range(count):
            a, b = w * g_x[x], w * g_y[x]
            out[0, x] += a * g_x[x]
            out[1, x] += a * g_y[x]
            out[2, x] += b * g_y[x]
            out[3, x] += a * g_s[x]
            out[4, x] += b * g_s[x]
            out[5, x] += a * g_t[x]
            out[6, x] += b * g_t[x]
        for x in range(count):
            a, b = w * g_s[x], w * g_t[x]
            out[7, x] += a * g_s[x]
            out[8, x] += a * g_t[x]
            out[9, x] += b * g_t[x]
        if with_correction:
            for x in range(count):
                a = w * e[x]
                out[10, x] += a * g_x[x]
                out[11, x] += a * g_y[x]
                out[12, x] += a * g_s[x]
                out[13, x] += a * g_t[x]
                out[14, x] += a * e[x]


@_jit
def _add(source: Any, weight: Any, out: Any) -> None:
    for x in range(out.shape[0]):
        out[x] += weight * source[x]


@_jit
def _window_columns(products: Any, y: int, kernels: Any, with_correction: bool, plain: Any, tilted: Any) -> None:
    """Weigh the products along y; gather what the window along x treats alike.

    ``plain`` becomes the 15 rows that the window w sums up to the tensor's entries, ``tilted`` the 5 rows whose sums
    with w ξ belong to the entries (1,3), (2,3), (3,3), (3,4), (3,5).
    """
    plain[:] = 0.0
    tilted[:] = 0.0
    for k in range(kernels.shape[1]):
        row = products[:, y + k]
        w0, w1, w2 = kernels[0, k], kernels[1, k], kernels[2, k]
        _add(row[_XX], w0, plain[0])
        _add(row[_XY], w0, plain[1])
        _add(row[_YY], w0, plain[2])
        _add(row[_XY], w1, plain[3])
        _add(row[_YY], w1, plain[4])
        _add(row[_YY], w2, plain[5])
        _add(row[_XS], w0, plain[6])
        _add(row[_YS], w0, plain[7])
        _add(row[_YS], w1, plain[8])
        _add(row[_XT], w0, plain[9])
        _add(row[_YT], w0, plain[10])
        _add(row[_YT], w1, plain[11])
        _add(row[_SS], w0, plain[12])
        _add(row[_ST], w0, plain[13])
        _add(row[_TT], w0, plain[14])
        if with_correction:
            _add(row[_XE], w0, plain[3])
            _add(row[_YE], w0, plain[4])
            _add(row[_YE], np.float32(2.0) * w1, plain[5])
            _add(row[_EE], w0, plain[5])
            _add(row[_SE], w0, plain[8])
            _add(row[_TE], w0, plain[11])
    for x in range(plain.shape[1]):
        tilted[0, x] = plain[0, x]
        tilted[1, x] = plain[1, x]
        tilted[2, x] = np.float32(2.0) * plain[3, x]
        tilted[3, x] = plain[6, x]
        tilted[4, x] = plain[9, x]


@_jit
def _window_row(plain: Any, tilted: Any, kernels: Any, out: Any) -> None:
    """Weigh the gathered rows along x: one row of the tensor's 15 entries."""
    count = out.shape[1]
    out[:] = 0.0
    for k in range(kernels.shape[1]):
        w0, w1, w2 = kernels[0, k], kernels[1, k], kernels[2, k]
        for entry in range(15):
            _add(plain[entry, k : k + count], w0, out[entry])
        _add(tilted[0, k : k + count], w1, out[3])
        _add(tilted[1, k : k + count], w1, out[4])
        _add(tilted[2, k : k + count], w1, out[5])
        _add(plain[0, k : k + count], w2, out[5])
        _add(tilted[3, k : k + count], w1, out[8])
        _add(tilted[4, k : k + count], w1, out[11])


@_jit
def _diagonalise(a: Any, v: Any) -> None:
    """Diagonalise many symmetric 5 x 5 matrices at once by cyclic Jacobi rotations; the last axis counts matrices."""
    lanes = a.shape[2]
    v[:] = 0.0
    for i in range(5):
        for n in range(lanes):
            v[i, i, n] = 1.0
    c, s = np.empty(lanes), np.empty(lanes)
    for _ in range(_SWEEPS):
        for p in range(4):
            for q in range(p + 1, 5):
                for n in range(lanes):
                    twice = 2.0 * a[p, q, n]
                    gap = a[q, q, n] - a[p, p, n]
                    root = abs(gap) + np.sqrt(gap * gap + twice * twice) + 1e-300
                    tangent = twice / root if gap >= 0.0 else -twice / root
                    c[n] = 1.0 / np.sqrt(1.0 + tangent * tangent)
                    s[n] = tangent * c[n]
                    a[p, p, n] -= tangent * a[p, q, n]
                    a[q, q, n] += tangent * a[p, q, n]
                    a[p, q, n] = 0.0
                for i in range(5):
                    if i not in (p, q):
                        low, high = min(i, p), max(i, p)
                        lower, upper = min(i, q), max(i, q)
                        for n in range(lanes):
                            one, two = a[low, high, n], a[lower, upper, n]
                            a[low, high, n] = c[n] * one - s[n] * two
                            a[lower, upper, n] = s[n] * one + c[n] * two
                    for n in range(lanes):
                        one, two = v[i, p, n], v[i, q, n]
                        v[i, p, n] = c[n] * one - s[n] * two
                        v[i, q, n] = s[n] * one + c[n] * two


@_jit
def _solve_pixel(a: Any, v: Any, n: int, tau: float, solution: Any) -> int:
    """Return how many eigenvalues are above τ; put (v_x, u_x + x0 u_z, u_y + y0 u_z, u_z, λ1, ..., λ5) in ``solution``.

    p_s (dt = 0, ds = 1) and p_t (ds = 0, dt = 1) are the vectors of least norm in the null space: with P the projector
    on it and A the block of its rows and columns 4 and 5, the columns of P[:, 4:5] A⁻¹. If it has two dimensions,
    these are the paper's combinations a b5 - b a5 and a b4 - b a4, scaled.
    """
    order = np.arange(5)
    for i in range(1, 5):
        j = i
        while j > 0 and a[order[j], order[j], n] > a[order[j - 1], order[j - 1], n]:
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    above = 0
    for i in range(5):
        value = a[order[i], order[i], n]
        solution[4 + i] = value
        if value > tau:
            above += 1
    rank = min(above, 3)
    p33, p34, p44 = 1.0, 0.0, 1.0
    for i in range(rank):
        ds, dt = v[3, order[i], n], v[4, order[i], n]
        p33 -= ds * ds
        p34 -= ds * dt
        p44 -= dt * dt
    determinant = p33 * p44 - p34 * p34
    if determinant <= 1e-12:
        solution[:4] = np.nan
        return above
    for k in range(3):
        towards_s, towards_t = 0.0, 0.0
        for i in range(rank):
            entry = v[k, order[i], n]
            towards_s -= entry * v[3, order[i], n]
            towards_t -= entry * v[4, order[i], n]
        if k == 0:
            solution[0] = (towards_s * p44 - towards_t * p34) / determinant
        solution[1 + k] = (towards_t * p33 - towards_s * p34) / determinant
    return above


@_jit
def _solve_row(entries: Any, tau: float, out: Any, above: Any) -> None:
    """Solve all pixels of a row."""
    a, v = np.zeros((5, 5, _LANES)), np.empty((5, 5, _LANES))
    count = entries.shape[1]
    for start in range(0, count, _LANES):
        used = min(_LANES, count - start)
        for entry in range(15):
            i, j = _ROWS[entry], _COLUMNS[entry]
            for n in range(used):
                a[i, j, n] = entries[entry, start + n]
        _diagonalise(a, v)
        for n in range(used):
            above[start + n] = _solve_pixel(a, v, n, tau, out[start + n])


@numba.njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def estimate_tiles(
    images: NDArray[Any],
    camera: int,
    shift: int,
    first: int,
    tiles: NDArray[np.int64],
    filters: NDArray[np.float32],
    over_s: NDArray[np.float32],
    over_t: NDArray[np.float32],
    windows: NDArray[np.float32],
    with_correction: bool,
    tau: float,
    disparity: NDArray[np.float64],
    flow: NDArray[np.float64],
    divergence: NDArray[np.float64],
    eigenvalues: NDArray[np.float32],
    above: NDArray[np.uint8],
) -> None:
    """Estimate all frames in tiles, each by one thread, so that scratch memory depends on the tiles alone.

    Parameters
    ----------
    images
        Images as recorded, shape (s, t, y, x), any real type.
    camera
        First of the five cameras.
    shift, first
        Registration in px per step of s, and the first column that all registered images share.
    tiles
        First and last + 1 output row, then column, of every tile, counted from the first pixel whose
        window lies inside the shared images; shape (n, 4).
    filters
        S, D and the moment M of D, as correlation kernels, shape (3, 5).
    over_s
        S, D and -shift s S along s, scaled from the images' values to grey values, shape (3, 5).
    over_t, windows
        Window along t, shape (m,); windows w, w ξ and w ξ² along x and y, shape (3, k).
    with_correction
        Whether to add the correction of the divergence term.
    tau
        Threshold of the eigenvalues.
    disparity, flow, divergence, eigenvalues, above
        Outputs, shapes (f, y, x), (2, f, y, x), (f, y, x), (5, f, y, x), (f, y, x), written where the window reaches:
        shift - v_x, (u_x + x0 u_z, u_y + y0 u_z), u_z, λ1 to λ5, and how many of them are above τ.
    """
    taps, frames_in_window, window = filters.shape[1], over_t.shape[0], windows.shape[1]
    smoothing, derivative, moment = filters[0], filters[1], filters[2]
    reach = taps // 2 + window // 2
    for n in numba.prange(tiles.shape[0]):
        top, rows = tiles[n, 0], tiles[n, 1] - tiles[n, 0]
        left, columns = first + tiles[n, 2], tiles[n, 3] - tiles[n, 2]
        rows_in, columns_in = rows + 2 * reach, columns + 2 * reach
        rows_d, columns_d = rows_in - taps + 1, columns_in - taps + 1
        ring = np.empty((taps, 3, rows_in, columns_in), dtype=np.float32)
        scratch = np.empty((6, rows_in, columns_d), dtype=np.float32)
        derivatives = np.empty((frames_in_window, 5, rows_d, columns_d), dtype=np.float32)
        products = np.empty((15, rows_d, columns_d), dtype=np.float32)
        plain = np.empty((15, columns_d), dtype=np.float32)
        tilted = np.empty((5, columns_d), dtype=np.float32)
        entries = np.empty((15, columns), dtype=np.float32)
        found = np.empty((columns, 9))
        counts = np.empty(columns, dtype=np.int64)
        for t in range(images.shape[1]):
            slot = t % taps
            _reduce_cameras(images, camera, shift, left, t, top, over_s, ring[slot])
            if t < taps - 1:
                continue
            made = (t - taps + 1) % frames_in_window
            _derive(ring, slot, smoothing, derivative, moment, scratch, derivatives[made])
            out = t - (taps - 1) - (frames_in_window - 1)
            if out < 0:
                continue
            for y in range(rows_d):
                _accumulate_products(derivatives, made, over_t, with_correction, y, products[:, y])
            for y in range(rows):
                _window_columns(products, y, windows, with_correction, plain, tilted)
                _window_row(plain, tilted, windows, entries)
                _solve_row(entries, tau, found, counts)
                row = top + y + reach
                for x in range(columns):
                    column = left + x + reach
                    disparity[out, row, column] = shift - found[x, 0]
                    flow[0, out, row, column] = found[x, 1]
                    flow[1, out, row, column] = found[x, 2]
                    divergence[out, row, column] = found[x, 3]
                    above[out, row, column] = counts[x]
                    for k in range(5):
                        eigenvalues[k, out, row, column] = found[x, 4 + k]
