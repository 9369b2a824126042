"""Kernels of the 4D structure tensor: derivatives, windowed products and null space, tile by tile.

They stand in one file because a compiled kernel is kept until the file that it stands in changes.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.fused import fma

__all__ = ["estimate_tile"]

# How many numbers `_solve_row` finds for a pixel.
_FOUND = 23
_LANES = 16
_MOST_SWEEPS = 12
# Rotations smaller than this change an eigenvalue by their square times it: nothing in float64.
_SMALL = 1e-18
# Entries of the tensor, in the order in which they are given.
_ROWS = np.array([0, 0, 1, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3, 3, 4])
_COLUMNS = np.array([0, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 3, 4, 4])

# Products of derivatives, in the order in which `_accumulate_products` makes them.
_XX, _XY, _YY, _XS, _YS, _XT, _YT, _SS, _ST, _TT, _XE, _YE, _SE, _TE, _EE = range(15)

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def _add(source: Any, weight: Any, out: Any) -> None:
    for x in range(out.shape[0]):
        out[x] = fma(weight, source[x], out[x])


@_jit
def _add_four(a: Any, b: Any, c: Any, d: Any, weights: Any, k: int, out: Any) -> None:
    """Add four weighted rows at once: the accumulator is read and written once instead of four times."""
    one, two, three, four = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
    for x in range(out.shape[0]):
        out[x] = fma(four, d[x], fma(three, c[x], fma(two, b[x], fma(one, a[x], out[x]))))


@_jit
def _add_shifted(source: Any, kernel: Any, out: Any) -> None:
    """Add the correlation of one row with a kernel."""
    taps, count = kernel.shape[0], out.shape[0]
    blocks = taps - taps % 4
    for k in range(0, blocks, 4):
        _add_four(
            source[k : k + count],
            source[k + 1 : k + 1 + count],
            source[k + 2 : k + 2 + count],
            source[k + 3 : k + 3 + count],
            kernel,
            k,
            out,
        )
    for k in range(blocks, taps):
        _add(source[k : k + count], kernel[k], out)


@_jit
def _add_rows(rows: Any, first: int, kernel: Any, out: Any) -> None:
    """Add the rows from the first on, weighted by a kernel."""
    taps = kernel.shape[0]
    blocks = taps - taps % 4
    for k in range(0, blocks, 4):
        _add_four(rows[first + k], rows[first + k + 1], rows[first + k + 2], rows[first + k + 3], kernel, k, out)
    for k in range(blocks, taps):
        _add(rows[first + k], kernel[k], out)


@_jit
def _reduce_cameras(
    images: Any, channel: int, frame: int, top: int, left: int, columns_of_s: Any, over_s: Any, values: Any, out: Any
) -> None:
    """Filter the registered images of a frame along s: with S, with D, and with the moment of S."""
    _, rows, columns = out.shape
    out[:] = 0.0
    for y in range(rows):
        for s in range(over_s.shape[1]):
            start = left + columns_of_s[s]
            image = images[channel, s, frame, top + y, start : start + columns]
            for x in range(columns):
                values[s, x] = np.float32(image[x])
        for part in range(3):
            _add_rows(values, 0, over_s[part], out[part, y])


@_jit
def _derive(
    ring: Any, times: Any, oldest: int, over_t: Any, step: Any, over_xy: Any, rows_t: Any, scratch: Any, out: Any
) -> None:
    """Make g_x, g_y, g_s, g_t and the divergence correction e of one frame from the frames of the filter along t.

    ``rows_t`` holds one row filtered along t: S of the smoothed images, S of their derivative along s, D of the
    smoothed images, S of their moments along x and y. ``scratch`` holds, for every row, what has then been filtered
    along x: S, D and M of the smoothed images (with D of the moment along x), S of the others.
    """
    frames, rows = ring.shape[0], ring.shape[2]
    smoothing, derivative, moment = over_xy[0], over_xy[1], over_xy[2]
    scratch[:] = 0.0
    for y in range(rows):
        rows_t[:] = 0.0
        for k in range(frames):
            slot = (oldest + k) % frames
            a, b = over_t[0, k], over_t[1, k]
            _add(ring[slot, 0, y], a, rows_t[0])
            _add(ring[slot, 1, y], a, rows_t[1])
            _add(ring[slot, 0, y], b, rows_t[2])
            _add(ring[slot, 2, y], a, rows_t[3])
            # At time τ a registered frame sees x + step τ, and a flow that has grown by the factor 1 + u_z τ.
            twice = np.float32(2.0) * a * times[slot]
            if step[0] != 0.0:
                _add(ring[slot, 0, y], twice * step[0], rows_t[3])
            if step[1] != 0.0:
                _add(ring[slot, 0, y], twice * step[1], rows_t[4])
        _add_shifted(rows_t[0], smoothing, scratch[0, y])
        _add_shifted(rows_t[0], derivative, scratch[1, y])
        _add_shifted(rows_t[0], moment, scratch[2, y])
        _add_shifted(rows_t[3], derivative, scratch[2, y])
        _add_shifted(rows_t[1], smoothing, scratch[3, y])
        _add_shifted(rows_t[2], smoothing, scratch[4, y])
        if step[1] != 0.0:
            _add_shifted(rows_t[4], smoothing, scratch[5, y])
    out[:] = 0.0
    for y in range(out.shape[1]):
        _add_rows(scratch[1], y, smoothing, out[0, y])
        _add_rows(scratch[0], y, derivative, out[1, y])
        _add_rows(scratch[3], y, smoothing, out[2, y])
        _add_rows(scratch[4], y, smoothing, out[3, y])
        _add_rows(scratch[2], y, smoothing, out[4, y])
        _add_rows(scratch[0], y, over_xy[3], out[4, y])
        if step[1] != 0.0:
            _add_rows(scratch[5], y, derivative, out[4, y])


@_jit
def _accumulate_products(derivatives: Any, w: Any, with_correction: bool, y: int, out: Any) -> None:
    """Add one row of the products of one frame's derivatives, with the frame's weight."""
    count = derivatives.shape[2]
    g_x, g_y, g_s, g_t, e = (
        derivatives[0, y],
        derivatives[1, y],
        derivatives[2, y],
        derivatives[3, y],
        derivatives[4, y],
    )
    for x in range(count):
        a, b = w * g_x[x], w * g_y[x]
        out[0, x] = fma(a, g_x[x], out[0, x])
        out[1, x] = fma(a, g_y[x], out[1, x])
        out[2, x] = fma(b, g_y[x], out[2, x])
        out[3, x] = fma(a, g_s[x], out[3, x])
        out[4, x] = fma(b, g_s[x], out[4, x])
        out[5, x] = fma(a, g_t[x], out[5, x])
        out[6, x] = fma(b, g_t[x], out[6, x])
    for x in range(count):
        a, b = w * g_s[x], w * g_t[x]
        out[7, x] = fma(a, g_s[x], out[7, x])
        out[8, x] = fma(a, g_t[x], out[8, x])
        out[9, x] = fma(b, g_t[x], out[9, x])
    if with_correction:
        for x in range(count):
            a = w * e[x]
            out[10, x] = fma(a, g_x[x], out[10, x])
            out[11, x] = fma(a, g_y[x], out[11, x])
            out[12, x] = fma(a, g_s[x], out[12, x])
            out[13, x] = fma(a, g_t[x], out[13, x])
            out[14, x] = fma(a, e[x], out[14, x])


@_jit
def _window_columns(products: Any, y: int, kernels: Any, with_correction: bool, out: Any) -> None:
    """Weigh the products along y: 15 rows, which the window w along x sums up to the tensor's entries.

    ``kernels`` holds w, w η, w η² and 2 w η. The entries (1,3), (2,3), (3,3), (3,4), (3,5) need sums with w ξ and w ξ²
    besides, which `_window_row` takes of the rows made here.
    """
    w0, w1, w2, double = kernels[0], kernels[1], kernels[2], kernels[3]
    out[:] = 0.0
    _add_rows(products[_XX], y, w0, out[0])
    _add_rows(products[_XY], y, w0, out[1])
    _add_rows(products[_YY], y, w0, out[2])
    _add_rows(products[_XY], y, w1, out[3])
    _add_rows(products[_YY], y, w1, out[4])
    _add_rows(products[_YY], y, w2, out[5])
    _add_rows(products[_XS], y, w0, out[6])
    _add_rows(products[_YS], y, w0, out[7])
    _add_rows(products[_YS], y, w1, out[8])
    _add_rows(products[_XT], y, w0, out[9])
    _add_rows(products[_YT], y, w0, out[10])
    _add_rows(products[_YT], y, w1, out[11])
    _add_rows(products[_SS], y, w0, out[12])
    _add_rows(products[_ST], y, w0, out[13])
    _add_rows(products[_TT], y, w0, out[14])
    if with_correction:
        _add_rows(products[_XE], y, w0, out[3])
        _add_rows(products[_YE], y, w0, out[4])
        _add_rows(products[_YE], y, double, out[5])
        _add_rows(products[_EE], y, w0, out[5])
        _add_rows(products[_SE], y, w0, out[8])
        _add_rows(products[_TE], y, w0, out[11])


@_jit
def _window_row(rows: Any, kernels: Any, out: Any) -> None:
    """Weigh the gathered rows along x: one row of the tensor's 15 entries."""
    w0, w1, w2, double = kernels[0], kernels[1], kernels[2], kernels[3]
    out[:] = 0.0
    for entry in range(15):
        _add_shifted(rows[entry], w0, out[entry])
    _add_shifted(rows[0], w1, out[3])
    _add_shifted(rows[1], w1, out[4])
    _add_shifted(rows[3], double, out[5])
    _add_shifted(rows[0], w2, out[5])
    _add_shifted(rows[6], w1, out[8])
    _add_shifted(rows[9], w1, out[11])


@numba.njit(forceinline=True, error_model="numpy")
def _rotate(m: Any, pp: int, qq: int, pq: int, a: int, b: int, c: int, d: int, e: int, f: int, p: int, q: int) -> None:
    """Rotate the axes p and q of many matrices; a and b, c and d, e and f hold (i, p) and (i, q) of the other i."""
    for n in range(_LANES):
        # The angle may be rough, cosine and sine may not: from single precision, two steps of Newton's method.
        one, two, three = m[pp * _LANES + n], m[qq * _LANES + n], m[pq * _LANES + n]
        twice, gap = np.float32(2.0 * three), np.float32(two - one)
        root = abs(gap) + np.sqrt(gap * gap + twice * twice) + np.float32(1e-30)
        tangent = np.float64(twice / root if gap >= 0.0 else -twice / root)
        square = 1.0 + tangent * tangent
        co = np.float64(np.float32(1.0) / np.sqrt(np.float32(square)))
        half = -0.5 * square
        co *= fma(half, co * co, 1.5)
        co *= fma(half, co * co, 1.5)
        si = tangent * co
        cc, ss, cs = co * co, si * si, co * si
        m[pp * _LANES + n] = fma(cc, one, fma(ss, two, -2.0 * cs * three))
        m[qq * _LANES + n] = fma(ss, one, fma(cc, two, 2.0 * cs * three))
        m[pq * _LANES + n] = fma(cs, one - two, (cc - ss) * three)
        one, two = m[a * _LANES + n], m[b * _LANES + n]
        m[a * _LANES + n], m[b * _LANES + n] = fma(co, one, -(si * two)), fma(si, one, co * two)
        one, two = m[c * _LANES + n], m[d * _LANES + n]
        m[c * _LANES + n], m[d * _LANES + n] = fma(co, one, -(si * two)), fma(si, one, co * two)
        one, two = m[e * _LANES + n], m[f * _LANES + n]
        m[e * _LANES + n], m[f * _LANES + n] = fma(co, one, -(si * two)), fma(si, one, co * two)
        for i in range(5):
            one, two = m[(15 + 5 * i + p) * _LANES + n], m[(15 + 5 * i + q) * _LANES + n]
            m[(15 + 5 * i + p) * _LANES + n] = fma(co, one, -(si * two))
            m[(15 + 5 * i + q) * _LANES + n] = fma(si, one, co * two)


@_jit
def _diagonalise(m: Any) -> None:
    """Diagonalise `_LANES` symmetric 5 x 5 matrices at once by cyclic Jacobi rotations.

    ``m`` holds, each for all matrices, the 15 entries in the tensor's order and, from place 15 on, the eigenvectors as
    columns, row by row. It is one array with all places known beforehand, so that the compiler sees that rotations of
    different matrices do not touch each other.
    """
    for n in range(15 * _LANES, 40 * _LANES):
        m[n] = 0.0
    for i in range(5):
        for n in range(_LANES):
            m[(15 + 6 * i) * _LANES + n] = 1.0
    for _ in range(_MOST_SWEEPS):
        worst = 0.0
        for n in range(_LANES):
            outside, inside = 0.0, 0.0
            for entry in range(15):
                square = m[entry * _LANES + n] * m[entry * _LANES + n]
                if _ROWS[entry] == _COLUMNS[entry]:
                    inside += square
                else:
                    outside += square
            worst = max(worst, outside / (inside + 1e-300))
        if worst <= _SMALL:
            break
        _rotate(m, 0, 2, 1, 3, 4, 6, 7, 9, 10, 0, 1)
        _rotate(m, 0, 5, 3, 1, 4, 6, 8, 9, 11, 0, 2)
        _rotate(m, 0, 12, 6, 1, 7, 3, 8, 9, 13, 0, 3)
        _rotate(m, 0, 14, 9, 1, 10, 3, 11, 6, 13, 0, 4)
        _rotate(m, 2, 5, 4, 1, 3, 7, 8, 10, 11, 1, 2)
        _rotate(m, 2, 12, 7, 1, 6, 4, 8, 10, 13, 1, 3)
        _rotate(m, 2, 14, 10, 1, 9, 4, 11, 7, 13, 1, 4)
        _rotate(m, 5, 12, 8, 3, 6, 4, 7, 11, 13, 2, 3)
        _rotate(m, 5, 14, 11, 3, 9, 4, 10, 8, 13, 2, 4)
        _rotate(m, 12, 14, 13, 6, 9, 7, 10, 8, 11, 3, 4)


@numba.njit(forceinline=True, error_model="numpy")
def _order(m: Any, one: int, two: int, p: int, q: int) -> None:
    """Exchange the eigenvalues at two places and their vectors p and q where the second is the larger."""
    for n in range(_LANES):
        swap = m[two * _LANES + n] > m[one * _LANES + n]
        a, b = m[one * _LANES + n], m[two * _LANES + n]
        m[one * _LANES + n], m[two * _LANES + n] = b if swap else a, a if swap else b
        for i in range(5):
            a, b = m[(15 + 5 * i + p) * _LANES + n], m[(15 + 5 * i + q) * _LANES + n]
            m[(15 + 5 * i + p) * _LANES + n] = b if swap else a
            m[(15 + 5 * i + q) * _LANES + n] = a if swap else b


@_jit
def _sort(m: Any) -> None:
    """Put eigenvalues and vectors into descending order, by the shortest network for five."""
    _order(m, 0, 14, 0, 4)
    _order(m, 2, 12, 1, 3)
    _order(m, 0, 5, 0, 2)
    _order(m, 5, 14, 2, 4)
    _order(m, 0, 2, 0, 1)
    _order(m, 5, 12, 2, 3)
    _order(m, 2, 14, 1, 4)
    _order(m, 2, 5, 1, 2)
    _order(m, 12, 14, 3, 4)


@_jit
def _misfit(r: Any, place: int, j: Any, axis: int, first: int) -> None:
    """Put pᵀ J p into a place of r, for p = (p1, p2, p3) in its places from ``axis`` on and 1 for ds or dt."""
    last = 12 if first == 6 else 14
    for n in range(_LANES):
        p1, p2, p3 = r[axis * _LANES + n], r[(axis + 1) * _LANES + n], r[(axis + 2) * _LANES + n]
        r[place * _LANES + n] = (
            p1 * (p1 * j[n] + 2.0 * (p2 * j[_LANES + n] + p3 * j[3 * _LANES + n] + j[first * _LANES + n]))
            + p2 * (p2 * j[2 * _LANES + n] + 2.0 * (p3 * j[4 * _LANES + n] + j[(first + 1) * _LANES + n]))
            + p3 * (p3 * j[5 * _LANES + n] + 2.0 * j[(first + 2) * _LANES + n])
            + j[last * _LANES + n]
        )


@_jit
def _covariances(j: Any, model: Any, r: Any) -> None:
    """Propagate white noise of unit power in the constraint to p: A⁻¹ B A⁻¹, the parts that the world needs.

    A is the tensor's block of g_x, g_y and the divergence term; B the same summed with the squared window, up to the
    factor Σ w² that is left out. Where a coordinate stands, the squared window is narrower.
    """
    for n in range(_LANES):
        a11, a12, a22 = j[n], j[_LANES + n], j[2 * _LANES + n]
        a13, a23, a33 = j[3 * _LANES + n], j[4 * _LANES + n], j[5 * _LANES + n]
        c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
        c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
        determinant = a11 * c11 + a12 * c12 + a13 * c13
        sound = determinant > 1e-12 * a11 * a22 * a33
        inverse = 1.0 / (determinant if sound else np.nan)
        # Of the divergence term's energy, the part that coordinates in the window make is the narrower one.
        less = (1.0 - model[2]) * min(model[3] * (a11 + a22), a33) / (a33 + 1e-300)
        # B = A - (1 - r) C with C the third row and column; with k = A⁻¹ e₃, A⁻¹ C A⁻¹ = k e₃ᵀ + e₃ kᵀ - A₃₃ k kᵀ.
        k1, k2, k3 = c13 * inverse, c23 * inverse, c33 * inverse
        r[18 * _LANES + n] = c11 * inverse + less * a33 * k1 * k1
        r[19 * _LANES + n] = c22 * inverse + less * a33 * k2 * k2
        r[20 * _LANES + n] = k3 - less * (2.0 * k3 - a33 * k3 * k3)
        r[21 * _LANES + n] = k1 - less * (k1 - a33 * k1 * k3)
        r[22 * _LANES + n] = k2 - less * (k2 - a33 * k2 * k3)


@_jit
def _solve_full(j: Any, m: Any, model: Any, r: Any) -> None:
    """Solve all matrices as if everything were known about them: the paper's combinations of the two null vectors."""
    weight_t, tau = model[0], model[1]
    for n in range(_LANES):
        a1, b1 = m[18 * _LANES + n], m[19 * _LANES + n]
        a2, b2 = m[23 * _LANES + n], m[24 * _LANES + n]
        a3, b3 = m[28 * _LANES + n], m[29 * _LANES + n]
        a4, b4 = m[33 * _LANES + n], m[34 * _LANES + n]
        a5, b5 = m[38 * _LANES + n], m[39 * _LANES + n]
        cross = a4 * b5 - b4 * a5
        inverse = 1.0 / (cross if abs(cross) > 1e-6 else np.nan)
        # p_s = a b5 - b a5 has dt = 0, p_t = a b4 - b a4 has ds = 0.
        r[23 * _LANES + n] = (a1 * b5 - b1 * a5) * inverse
        r[24 * _LANES + n] = (a2 * b5 - b2 * a5) * inverse
        r[25 * _LANES + n] = (a3 * b5 - b3 * a5) * inverse
        r[6 * _LANES + n] = (b1 * a4 - a1 * b4) * inverse
        r[7 * _LANES + n] = (b2 * a4 - a2 * b4) * inverse
        r[8 * _LANES + n] = (b3 * a4 - a3 * b4) * inverse
    for n in range(_LANES):
        r[5 * _LANES + n] = r[23 * _LANES + n]
        r[16 * _LANES + n] = np.sqrt(r[23 * _LANES + n] ** 2 + r[24 * _LANES + n] ** 2)
        r[9 * _LANES + n] = m[n]
        r[10 * _LANES + n] = m[2 * _LANES + n]
        r[11 * _LANES + n] = m[5 * _LANES + n]
        r[12 * _LANES + n] = m[12 * _LANES + n]
        r[13 * _LANES + n] = m[14 * _LANES + n]
    _misfit(r, 14, j, 23, 6)
    _misfit(r, 17, j, 6, 9)
    _covariances(j, model, r)
    for n in range(_LANES):
        j11, j12, j22 = j[n], j[_LANES + n], j[2 * _LANES + n]
        r[n] = j[12 * _LANES + n] / (j11 + 1e-30) + weight_t * j[14 * _LANES + n] / (j11 + j22 + 1e-30)
        uncertain = (max(r[17 * _LANES + n], 0.0) + weight_t * j[14 * _LANES + n]) * r[20 * _LANES + n]
        r[_LANES + n] = uncertain if uncertain < 1e30 else 1e30
        r[15 * _LANES + n] = r[18 * _LANES + n]
        # Texture in every direction of the image, in one, or none.
        mean, radius = 0.5 * (j11 + j22), np.sqrt(0.25 * (j11 - j22) ** 2 + j12 * j12)
        directions = (1.0 if mean + radius > tau else 0.0) + (1.0 if mean - radius > tau else 0.0)
        above = 0.0
        for i in range(9, 14):
            above += 1.0 if r[i * _LANES + n] > tau else 0.0
        rank = min(above, directions + 1.0) if directions > 0.0 else 0.0
        r[26 * _LANES + n] = rank
        r[2 * _LANES + n] = 2.0 if j11 > tau else 0.0
        r[3 * _LANES + n] = (2.0 if abs(r[6 * _LANES + n]) < 1e30 else 0.0) if rank > 2.0 else min(rank, 1.0)
        r[4 * _LANES + n] = 1.0 if above > rank and directions > 0.0 else 0.0


@_jit
def _solve_part(j: Any, m: Any, n: int, r: Any) -> None:
    """Solve one matrix of which not everything is known, over what `_solve_full` found.

    Disparity is the smallest eigenvector of the block of g_x and g_s, for p_s = (v_x, 0, 0, 1, 0). Motion is the vector
    of least norm with ds = 0 and dt = 1 in the null space: with P the projector on it and A the block of its rows and
    columns 4 and 5, the second column of P[:, 4:5] A⁻¹, which in two dimensions is the paper's p_t.
    """
    rank = int(r[26 * _LANES + n])
    j11, b, c = j[n], j[6 * _LANES + n], j[12 * _LANES + n]
    root = np.sqrt((j11 - c) ** 2 + 4.0 * b * b)
    r[5 * _LANES + n] = -2.0 * b / (j11 - c + root) if j11 >= c and root > 0.0 else np.nan
    r[14 * _LANES + n] = 0.5 * (j11 + c - root)
    r[15 * _LANES + n] = 1.0 / (j11 + 1e-300)
    r[_LANES + n] = 1e30
    for k in range(16, 23):
        r[k * _LANES + n] = np.nan
    p33, p34, p44 = 1.0, 0.0, 1.0
    for i in range(rank):
        ds, dt = m[(30 + i) * _LANES + n], m[(35 + i) * _LANES + n]
        p33 -= ds * ds
        p34 -= ds * dt
        p44 -= dt * dt
    determinant = p33 * p44 - p34 * p34
    if determinant <= 1e-12:
        r[3 * _LANES + n] = 0.0
    for k in range(3):
        towards_s, towards_t = 0.0, 0.0
        for i in range(rank):
            entry = m[(15 + 5 * k + i) * _LANES + n]
            towards_s -= entry * m[(30 + i) * _LANES + n]
            towards_t -= entry * m[(35 + i) * _LANES + n]
        moved = (towards_t * p33 - towards_s * p34) / determinant
        r[(6 + k) * _LANES + n] = moved if determinant > 1e-12 else np.nan


@_jit
def _solve_row(entries: Any, model: Any, found: Any) -> None:
    """Solve all pixels of a row.

    Parameters
    ----------
    entries
        The 15 entries of the tensor, shape (15, x): (1,1), (1,2), (2,2), (1,3), (2,3), (3,3), (1,4), (2,4), (3,4),
        (1,5), (2,5), (3,5), (4,4), (4,5), (5,5).
    model
        What motion along t counts beside that along s in the choice between registrations; τ; how much narrower the
        squared window is in ξ²; Σ w ξ².
    found
        Output, shape (23, x): what is left to move, (v_x² and perhaps u_x² + u_y², in the mean); how uncertain u_z is;
        kind of disparity, kind of motion, model violation; v_x, u_x + x0 u_z, u_y + y0 u_z, u_z; λ1 to λ5; p_sᵀ J p_s,
        variance of v_x for unit noise in the constraint, length of the image's part of p_s; p_tᵀ J p_t, variances of
        the three components of motion and covariances of the first two with the third for unit noise.
    """
    j, m, r = np.zeros(15 * _LANES), np.empty(40 * _LANES), np.empty((_FOUND + 4) * _LANES)
    count = entries.shape[1]
    for start in range(0, count, _LANES):
        used = min(_LANES, count - start)
        for entry in range(15):
            for n in range(used):
                j[entry * _LANES + n] = entries[entry, start + n]
        for k in range(15 * _LANES):
            m[k] = j[k]
        _diagonalise(m)
        _sort(m)
        _solve_full(j, m, model, r)
        for n in range(used):
            if r[26 * _LANES + n] < 3.0:
                _solve_part(j, m, n, r)
        for k in range(_FOUND):
            for n in range(used):
                found[k, start + n] = r[k * _LANES + n]


@_jit
def estimate_tile(
    images: NDArray[Any],
    frames: tuple[int, int, int],
    columns_of_s: NDArray[np.int64],
    step: NDArray[np.int64],
    centre_t: float,
    first_row: int,
    over_s: NDArray[np.float32],
    over_t: NDArray[np.float32],
    over_xy: NDArray[np.float32],
    window_t: NDArray[np.float32],
    window_xy: NDArray[np.float32],
    with_correction: bool,
    model: NDArray[np.float64],
    best: NDArray[np.float32],
    found: NDArray[np.float32],
    solved: NDArray[np.float64],
    kinds: NDArray[np.uint8],
    choice: NDArray[np.int16],
    candidate: int,
    tile: NDArray[np.int64],
) -> None:
    """Estimate frames at one registration in one tile; it takes one thread, and scratch for the tile alone.

    Disparity and flow are written only where this registration leaves less to move than the best one so far, since
    filters are most exact for small displacements; divergence only where its error bar is smaller, since with some
    disparity left, its change in time adds to what the images say of motion in depth.

    Parameters
    ----------
    images
        Images as recorded, shape (channel, s, t, y, x), any real type.
    frames
        First and last + 1 of the recorded frames to use, and the output frame that their first window gives.
    columns_of_s
        By how many columns the image of each camera is read to the right; shape (s,).
    step
        By how many columns and rows a frame is read further than the one before.
    centre_t
        How many frames after the first of ``frames`` the first estimate stands; may be half of one.
    first_row
        Row of the image at which the outputs begin.
    over_s
        S, D and the moment of S along s, scaled from the images' values to grey values, shape (3, s).
    over_t
        S and D along t, shape (2, m).
    over_xy
        S, D, the moment M of D, and M - 2 S along x and y, as correlation kernels, shape (4, 5).
    window_t, window_xy
        Window along t, shape (k,); windows w, w ξ, w ξ² and 2 w ξ along x and y, shape (4, n).
    with_correction
        Whether to add the correction of the divergence term.
    model
        What `_solve_row` must know.
    best
        The least that was left to move and the smallest uncertainty of u_z so far, shape (2, f, y, x).
    found, solved, kinds, choice
        Outputs, shapes (14, f, y, x), (5, f, y, x), (3, f, y, x), (f, y, x); see `_solve_row`. The last of ``solved``
        and the last six of ``found`` are of the registration at which u_z is most certain, all others of the one that
        leaves least to move, whose number ``choice`` keeps.
    candidate
        Number of this registration.
    tile
        First and last + 1 row, then column, of the tile's output; shape (4,).
    """
    taps_t, taps, frames_in_window, window = over_t.shape[1], over_xy.shape[1], window_t.shape[0], window_xy.shape[1]
    channels, cameras = images.shape[0], images.shape[1]
    reach = taps // 2 + window // 2
    speed = step.astype(np.float32)
    rows, columns = tile[1] - tile[0], tile[3] - tile[2]
    top, left = tile[0] - reach, tile[2] - reach
    rows_in, columns_in = rows + 2 * reach, columns + 2 * reach
    rows_d, columns_d = rows_in - taps + 1, columns_in - taps + 1
    values = np.empty((cameras, columns_in), dtype=np.float32)
    ring = np.empty((channels, taps_t, 3, rows_in, columns_in), dtype=np.float32)
    times = np.zeros(taps_t, dtype=np.float32)
    rows_t = np.empty((5, columns_in), dtype=np.float32)
    scratch = np.empty((6, rows_in, columns_d), dtype=np.float32)
    derivatives = np.empty((channels, frames_in_window, 5, rows_d, columns_d), dtype=np.float32)
    products = np.empty((15, rows_d, columns_d), dtype=np.float32)
    gathered = np.empty((15, columns_d), dtype=np.float32)
    entries = np.empty((15, columns), dtype=np.float32)
    results = np.empty((_FOUND, columns))
    for t in range(frames[0], frames[1]):
        done = t - frames[0]
        slot = done % taps_t
        times[slot] = done - centre_t
        ahead = done - int(np.floor(centre_t))
        for channel in range(channels):
            _reduce_cameras(
                images,
                channel,
                t,
                top + ahead * step[1],
                left + ahead * step[0],
                columns_of_s,
                over_s,
                values,
                ring[channel, slot],
            )
        if done < taps_t - 1:
            continue
        made = (done - taps_t + 1) % frames_in_window
        oldest = (slot + 1) % taps_t
        for channel in range(channels):
            _derive(ring[channel], times, oldest, over_t, speed, over_xy, rows_t, scratch, derivatives[channel, made])
        out = done - (taps_t - 1) - (frames_in_window - 1)
        if out < 0:
            continue
        out += frames[2]
        for y in range(rows_d):
            products[:, y] = 0.0
            for m in range(frames_in_window):
                at = (made + 1 + m) % frames_in_window
                for channel in range(channels):
                    _accumulate_products(derivatives[channel, at], window_t[m], with_correction, y, products[:, y])
        for y in range(rows):
            _window_columns(products, y, window_xy, with_correction, gathered)
            _window_row(gathered, window_xy, entries)
            _solve_row(entries, model, results)
            row = tile[0] - first_row + y
            for x in range(columns):
                column = tile[2] + x
                to_move, uncertain = np.float32(results[0, x]), np.float32(results[1, x])
                if to_move < best[0, out, row, column]:
                    best[0, out, row, column] = to_move
                    choice[out, row, column] = candidate
                    for k in range(3):
                        kinds[k, out, row, column] = np.uint8(results[2 + k, x])
                    for k in range(4):
                        solved[k, out, row, column] = results[5 + k, x]
                    for k in range(8):
                        found[k, out, row, column] = results[9 + k, x]
                if uncertain < best[1, out, row, column]:
                    best[1, out, row, column] = uncertain
                    solved[4, out, row, column] = results[8, x]
                    for k in range(6):
                        found[8 + k, out, row, column] = results[17 + k, x]
