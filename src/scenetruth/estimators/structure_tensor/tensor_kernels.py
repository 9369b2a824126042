"""Kernels of the 4D structure tensor: derivatives, windowed products and null space, tile by tile."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.intrinsic_kernels import fma
from scenetruth.estimators.structure_tensor.maps import BestRegistration, Filters
from scenetruth.kernels import inlined, kernel, subkernel

__all__ = ["Criteria", "Registered", "estimate_tile"]

# Number of matrices that are diagonalised together.
_LANES = 16
_MOST_SWEEPS = 12
# Smaller rotations change an eigenvalue by their square, which is below the resolution of float64.
_SMALL = 1e-18

# Images of one frame filtered along s: S g, D g, and the moment of S.
_SMOOTH, _ALONG_S, _MOMENT_S = range(3)
# Rows filtered along t: S of the smoothed images, S of their derivative along s, D of the smoothed images, S of their
# moments along x and y.
_T_SMOOTH, _T_ALONG_S, _T_ALONG_T, _T_MOMENT_X, _T_MOMENT_Y = range(5)
# These filtered along x: S, D and M of the smoothed images (with D of the moment along x), S of the others.
_X_SMOOTH, _X_ALONG_X, _X_MOMENT, _X_ALONG_S, _X_ALONG_T, _X_MOMENT_Y = range(6)
# Derivatives of the grey value, and the divergence correction e.
_G_X, _G_Y, _G_S, _G_T, _G_E = range(5)
# Products of two derivatives, summed over the window along t.
_PRODUCTS = 15
_XX, _XY, _YY, _XS, _YS, _XT, _YT, _SS, _ST, _TT, _XE, _YE, _SE, _TE, _EE = range(_PRODUCTS)
# Entries of the tensor J; its axes are those of p: x, y, z (the divergence term), s and t.
_ENTRIES = 15
_J_XX, _J_XY, _J_YY, _J_XZ, _J_YZ, _J_ZZ, _J_XS, _J_YS, _J_ZS = range(9)
_J_XT, _J_YT, _J_ZT, _J_SS, _J_ST, _J_TT = range(9, _ENTRIES)
# The axes. Values of plain integers are part of a signature: what they are passed to is compiled for each of them.
_X, _Y, _Z, _S, _T = (np.int64(axis) for axis in range(5))
# Index of the entry of two axes.
_ENTRY = np.array(
    [
        [_J_XX, _J_XY, _J_XZ, _J_XS, _J_XT],
        [_J_XY, _J_YY, _J_YZ, _J_YS, _J_YT],
        [_J_XZ, _J_YZ, _J_ZZ, _J_ZS, _J_ZT],
        [_J_XS, _J_YS, _J_ZS, _J_SS, _J_ST],
        [_J_XT, _J_YT, _J_ZT, _J_ST, _J_TT],
    ]
)
# Eigenvectors follow the entries: five numbers for every axis, one of each vector.
_VECTORS = _ENTRIES
_PLACES = _VECTORS + 25
# Output of `_solve_row` for a pixel, in the order of `BestRegistration`, without the choice and with only one u_z;
# then intermediate values: the image components of p_s, and the rank.
_TO_MOVE, _UNCERTAINTY, _KIND_DISPARITY, _KIND_MOTION, _MODEL_VIOLATION, _V_X, _FLOW_X, _FLOW_Y, _U_Z = range(9)
_EIGENVALUES = 9
_RESIDUAL_S, _VARIANCE_V_X, _LENGTH_S, _RESIDUAL_T = range(14, 18)
_VARIANCE_FLOW_X, _VARIANCE_FLOW_Y, _VARIANCE_U_Z, _COVARIANCE_X_Z, _COVARIANCE_Y_Z = range(18, 23)
_FOUND = 23
_P_S, _RANK = 23, 26
_FOUND_AND_NEEDED = 27

# Rows of `Filters.kernels` and of `Filters.windows`.
_S_KERNEL, _D_KERNEL, _M_KERNEL, _M_LESS_2S_KERNEL = range(4)
_WINDOW, _WINDOW_MOMENT, _WINDOW_SECOND_MOMENT, _WINDOW_TWICE_MOMENT = range(4)
# Sums of weighted rows as tables of source, weights and output: one loop compiles faster than a call for each sum.
_ALONG_X_SUMS = np.array(
    [
        [_T_SMOOTH, _S_KERNEL, _X_SMOOTH],
        [_T_SMOOTH, _D_KERNEL, _X_ALONG_X],
        [_T_SMOOTH, _M_KERNEL, _X_MOMENT],
        [_T_MOMENT_X, _D_KERNEL, _X_MOMENT],
        [_T_ALONG_S, _S_KERNEL, _X_ALONG_S],
        [_T_ALONG_T, _S_KERNEL, _X_ALONG_T],
        [_T_MOMENT_Y, _S_KERNEL, _X_MOMENT_Y],
    ]
)
_ALONG_Y_SUMS = np.array(
    [
        [_X_ALONG_X, _S_KERNEL, _G_X],
        [_X_SMOOTH, _D_KERNEL, _G_Y],
        [_X_ALONG_S, _S_KERNEL, _G_S],
        [_X_ALONG_T, _S_KERNEL, _G_T],
        [_X_MOMENT, _S_KERNEL, _G_E],
        [_X_SMOOTH, _M_LESS_2S_KERNEL, _G_E],
        [_X_MOMENT_Y, _D_KERNEL, _G_E],
    ]
)
_WINDOW_COLUMN_SUMS = np.array(
    [
        [_XX, _WINDOW, _J_XX],
        [_XY, _WINDOW, _J_XY],
        [_YY, _WINDOW, _J_YY],
        [_XY, _WINDOW_MOMENT, _J_XZ],
        [_YY, _WINDOW_MOMENT, _J_YZ],
        [_YY, _WINDOW_SECOND_MOMENT, _J_ZZ],
        [_XS, _WINDOW, _J_XS],
        [_YS, _WINDOW, _J_YS],
        [_YS, _WINDOW_MOMENT, _J_ZS],
        [_XT, _WINDOW, _J_XT],
        [_YT, _WINDOW, _J_YT],
        [_YT, _WINDOW_MOMENT, _J_ZT],
        [_SS, _WINDOW, _J_SS],
        [_ST, _WINDOW, _J_ST],
        [_TT, _WINDOW, _J_TT],
    ]
)
_CORRECTION_SUMS = np.array(
    [
        [_XE, _WINDOW, _J_XZ],
        [_YE, _WINDOW, _J_YZ],
        [_YE, _WINDOW_TWICE_MOMENT, _J_ZZ],
        [_EE, _WINDOW, _J_ZZ],
        [_SE, _WINDOW, _J_ZS],
        [_TE, _WINDOW, _J_ZT],
    ]
)
_WINDOW_ROW_SUMS = np.array(
    [
        [_J_XX, _WINDOW_MOMENT, _J_XZ],
        [_J_XY, _WINDOW_MOMENT, _J_YZ],
        [_J_XZ, _WINDOW_TWICE_MOMENT, _J_ZZ],
        [_J_XX, _WINDOW_SECOND_MOMENT, _J_ZZ],
        [_J_XS, _WINDOW_MOMENT, _J_ZS],
        [_J_XT, _WINDOW_MOMENT, _J_ZT],
    ]
)

_jit = subkernel()


class Registered(NamedTuple):
    """Images and the offsets at which they are read for one registration."""

    images: NDArray[Any]
    """Images as recorded, shape (channel, s, t, y, x), any real type."""
    columns_of_s: NDArray[np.int64]
    """Column offset at which the image of each camera is read; shape (s,)."""
    flow: NDArray[np.int64]
    """Column and row offsets between consecutive frames."""
    first: int
    """First and last + 1 of the frames used."""
    last: int
    centre_t: float
    """Centre of the first estimate relative to the first frame, in frames; may be half-integer."""


class Criteria(NamedTuple):
    """Parameters of the selection between registrations, and of the rank decision."""

    candidate: int
    """Number of this registration."""
    weight_t: float
    """Weight of the displacement along t relative to that along s."""
    tau: float
    """Threshold τ of the eigenvalues."""
    moment_ratio: float
    """Relative second moment of the squared window; see `NoiseModel`."""
    window_moment: float
    """Σ w ξ²."""


@_jit
def _add(source: Any, weight: Any, out: Any) -> None:
    for x in range(out.shape[0]):
        out[x] = fma(weight, source[x], out[x])


@_jit
def _add_four(a: Any, b: Any, c: Any, d: Any, weights: Any, k: int, out: Any) -> None:
    """Add four weighted rows together: the accumulator is read and written once instead of four times."""
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
    """Add consecutive rows, weighted by a kernel."""
    taps = kernel.shape[0]
    blocks = taps - taps % 4
    for k in range(0, blocks, 4):
        _add_four(rows[first + k], rows[first + k + 1], rows[first + k + 2], rows[first + k + 3], kernel, k, out)
    for k in range(blocks, taps):
        _add(rows[first + k], kernel[k], out)


@_jit
def _reduce_cameras(
    view: Registered, channel: int, frame: int, corner: Any, filters: Filters, values: Any, out: Any
) -> None:
    """Filter the registered images of a frame along s, from row and column ``corner`` of the camera at s = 0."""
    _, rows, columns = out.shape
    top, left = corner
    out[:] = 0.0
    for y in range(rows):
        for s in range(filters.smoothing_s.shape[0]):
            start = left + view.columns_of_s[s]
            image = view.images[channel, s, frame, top + y, start : start + columns]
            for x in range(columns):
                values[s, x] = np.float32(image[x])
        _add_rows(values, 0, filters.smoothing_s, out[_SMOOTH, y])
        _add_rows(values, 0, filters.derivative_s, out[_ALONG_S, y])
        _add_rows(values, 0, filters.moment_s, out[_MOMENT_S, y])


@_jit
def _derive(
    ring: Any, times: Any, oldest: int, filters: Filters, step: Any, rows_t: Any, rows_x: Any, out: Any
) -> None:
    """Compute g_x, g_y, g_s, g_t and the divergence correction e of one frame from the frames of the filter along t.

    ``ring``: Output of `_reduce_cameras` for these frames, shape (frame, 3, y, x); ``oldest`` is the first in time.
    ``rows_t``, ``rows_x``: Scratch: one row filtered along t, shape (5, x), and all rows then filtered along x, shape
      (6, y, x).
    ``out``: Output, shape (5, y, x).
    """
    frames, rows = ring.shape[0], ring.shape[2]
    # Moments along y follow from motion along y only.
    sums = _ALONG_X_SUMS.shape[0] - (0 if step[1] != 0.0 else 1)
    rows_x[:] = 0.0
    for y in range(rows):
        rows_t[:] = 0.0
        for k in range(frames):
            slot = (oldest + k) % frames
            a, b = filters.smoothing_t[k], filters.derivative_t[k]
            _add(ring[slot, _SMOOTH, y], a, rows_t[_T_SMOOTH])
            _add(ring[slot, _ALONG_S, y], a, rows_t[_T_ALONG_S])
            _add(ring[slot, _SMOOTH, y], b, rows_t[_T_ALONG_T])
            _add(ring[slot, _MOMENT_S, y], a, rows_t[_T_MOMENT_X])
            # At time τ a registered frame is offset by step τ, and its flow is scaled by the factor 1 + u_z τ.
            twice = np.float32(2.0) * a * times[slot]
            if step[0] != 0.0:
                _add(ring[slot, _SMOOTH, y], twice * step[0], rows_t[_T_MOMENT_X])
            if step[1] != 0.0:
                _add(ring[slot, _SMOOTH, y], twice * step[1], rows_t[_T_MOMENT_Y])
        for k in range(sums):
            source, weights, to = _ALONG_X_SUMS[k]
            _add_shifted(rows_t[source], filters.kernels[weights], rows_x[to, y])
    out[:] = 0.0
    for y in range(out.shape[1]):
        for k in range(sums):
            source, weights, to = _ALONG_Y_SUMS[k]
            _add_rows(rows_x[source], y, filters.kernels[weights], out[to, y])


@_jit
def _accumulate_products(derivatives: Any, w: Any, with_correction: bool, y: int, out: Any) -> None:
    """Add one row of the products of the derivatives of one frame, weighted along t."""
    count = derivatives.shape[2]
    g_x, g_y, g_s, g_t, e = (
        derivatives[_G_X, y],
        derivatives[_G_Y, y],
        derivatives[_G_S, y],
        derivatives[_G_T, y],
        derivatives[_G_E, y],
    )
    for x in range(count):
        a, b = w * g_x[x], w * g_y[x]
        out[_XX, x] = fma(a, g_x[x], out[_XX, x])
        out[_XY, x] = fma(a, g_y[x], out[_XY, x])
        out[_YY, x] = fma(b, g_y[x], out[_YY, x])
        out[_XS, x] = fma(a, g_s[x], out[_XS, x])
        out[_YS, x] = fma(b, g_s[x], out[_YS, x])
        out[_XT, x] = fma(a, g_t[x], out[_XT, x])
        out[_YT, x] = fma(b, g_t[x], out[_YT, x])
    for x in range(count):
        a, b = w * g_s[x], w * g_t[x]
        out[_SS, x] = fma(a, g_s[x], out[_SS, x])
        out[_ST, x] = fma(a, g_t[x], out[_ST, x])
        out[_TT, x] = fma(b, g_t[x], out[_TT, x])
    if with_correction:
        for x in range(count):
            a = w * e[x]
            out[_XE, x] = fma(a, g_x[x], out[_XE, x])
            out[_YE, x] = fma(a, g_y[x], out[_YE, x])
            out[_SE, x] = fma(a, g_s[x], out[_SE, x])
            out[_TE, x] = fma(a, g_t[x], out[_TE, x])
            out[_EE, x] = fma(a, e[x], out[_EE, x])


@_jit
def _window_columns(products: Any, y: int, filters: Filters, out: Any) -> None:
    """Sum the weighted products along y to 15 rows, which `_window_row` sums along x to the entries of the tensor."""
    out[:] = 0.0
    for k in range(_WINDOW_COLUMN_SUMS.shape[0]):
        source, weights, to = _WINDOW_COLUMN_SUMS[k]
        _add_rows(products[source], y, filters.windows[weights], out[to])
    if filters.with_correction:
        for k in range(_CORRECTION_SUMS.shape[0]):
            source, weights, to = _CORRECTION_SUMS[k]
            _add_rows(products[source], y, filters.windows[weights], out[to])


@_jit
def _window_row(rows: Any, filters: Filters, out: Any) -> None:
    """Sum the weighted rows along x: one row of the tensor entries."""
    out[:] = 0.0
    for entry in range(_ENTRIES):
        _add_shifted(rows[entry], filters.windows[_WINDOW], out[entry])
    for k in range(_WINDOW_ROW_SUMS.shape[0]):
        source, weights, to = _WINDOW_ROW_SUMS[k]
        _add_shifted(rows[source], filters.windows[weights], out[to])


@inlined
def _rotate(m: Any, p: int, q: int, others: tuple[int, int, int]) -> None:
    """Rotate axes p and q of all matrices to eliminate their entry (p, q); ``others`` are the other axes."""
    i, j, k = others
    pp, qq, pq = _ENTRY[p, p], _ENTRY[q, q], _ENTRY[p, q]
    a, b, c, d, e, f = _ENTRY[i, p], _ENTRY[i, q], _ENTRY[j, p], _ENTRY[j, q], _ENTRY[k, p], _ENTRY[k, q]
    for n in range(_LANES):
        # The angle may be approximate, but not cosine and sine: two Newton iterations from single precision.
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
        for axis in range(5):
            u, v = _VECTORS + 5 * axis + p, _VECTORS + 5 * axis + q
            one, two = m[u * _LANES + n], m[v * _LANES + n]
            m[u * _LANES + n] = fma(co, one, -(si * two))
            m[v * _LANES + n] = fma(si, one, co * two)


@_jit
def _diagonalise(m: Any) -> None:
    """Diagonalise `_LANES` symmetric 5 x 5 matrices together by cyclic Jacobi rotations.

    ``m`` contains, each for all matrices, the entries of the tensor and then the eigenvectors. In a single array with
    constant indices, the compiler recognises that rotations of different matrices are independent.
    """
    for n in range(_ENTRIES * _LANES, _PLACES * _LANES):
        m[n] = 0.0
    for axis in range(5):
        for n in range(_LANES):
            m[(_VECTORS + 5 * axis + axis) * _LANES + n] = 1.0
    for _ in range(_MOST_SWEEPS):
        worst = 0.0
        for n in range(_LANES):
            outside, inside = 0.0, 0.0
            for entry in range(_ENTRIES):
                square = m[entry * _LANES + n] * m[entry * _LANES + n]
                if entry in (_J_XX, _J_YY, _J_ZZ, _J_SS, _J_TT):
                    inside += square
                else:
                    outside += square
            worst = max(worst, outside / (inside + 1e-300))
        if worst <= _SMALL:
            break
        _rotate(m, _X, _Y, (_Z, _S, _T))
        _rotate(m, _X, _Z, (_Y, _S, _T))
        _rotate(m, _X, _S, (_Y, _Z, _T))
        _rotate(m, _X, _T, (_Y, _Z, _S))
        _rotate(m, _Y, _Z, (_X, _S, _T))
        _rotate(m, _Y, _S, (_X, _Z, _T))
        _rotate(m, _Y, _T, (_X, _Z, _S))
        _rotate(m, _Z, _S, (_X, _Y, _T))
        _rotate(m, _Z, _T, (_X, _Y, _S))
        _rotate(m, _S, _T, (_X, _Y, _Z))


@inlined
def _order(m: Any, p: int, q: int) -> None:
    """Exchange the eigenvalues p and q and their vectors where the second is larger."""
    one, two = _ENTRY[p, p], _ENTRY[q, q]
    for n in range(_LANES):
        swap = m[two * _LANES + n] > m[one * _LANES + n]
        a, b = m[one * _LANES + n], m[two * _LANES + n]
        m[one * _LANES + n], m[two * _LANES + n] = b if swap else a, a if swap else b
        for axis in range(5):
            u, v = _VECTORS + 5 * axis + p, _VECTORS + 5 * axis + q
            a, b = m[u * _LANES + n], m[v * _LANES + n]
            m[u * _LANES + n] = b if swap else a
            m[v * _LANES + n] = a if swap else b


@_jit
def _sort(m: Any) -> None:
    """Sort eigenvalues and vectors in descending order with the shortest network for five."""
    _order(m, 0, 4)
    _order(m, 1, 3)
    _order(m, 0, 2)
    _order(m, 2, 4)
    _order(m, 0, 1)
    _order(m, 2, 3)
    _order(m, 1, 4)
    _order(m, 1, 2)
    _order(m, 3, 4)


@_jit
def _residual(j: Any, vector: int, axis: int, place: int, r: Any) -> None:
    """Write pᵀ J p to index ``place`` of r, for p = (p1, p2, p3) at index ``vector`` of r, and 1 along s or t."""
    along_x, along_y, along_z, alone = _ENTRY[_X, axis], _ENTRY[_Y, axis], _ENTRY[_Z, axis], _ENTRY[axis, axis]
    for n in range(_LANES):
        xx, xy, xz = j[_J_XX * _LANES + n], j[_J_XY * _LANES + n], j[_J_XZ * _LANES + n]
        yy, yz, zz = j[_J_YY * _LANES + n], j[_J_YZ * _LANES + n], j[_J_ZZ * _LANES + n]
        p1, p2, p3 = r[vector * _LANES + n], r[(vector + 1) * _LANES + n], r[(vector + 2) * _LANES + n]
        r[place * _LANES + n] = (
            p1 * (p1 * xx + 2.0 * (p2 * xy + p3 * xz + j[along_x * _LANES + n]))
            + p2 * (p2 * yy + 2.0 * (p3 * yz + j[along_y * _LANES + n]))
            + p3 * (p3 * zz + 2.0 * j[along_z * _LANES + n])
            + j[alone * _LANES + n]
        )


@_jit
def _covariances(j: Any, criteria: Criteria, r: Any) -> None:
    """Propagate white noise of unit power in the constraint to the required elements of the covariance A⁻¹ B A⁻¹ of p.

    A is the tensor block of g_x, g_y and the divergence term; B is the same with the squared window, without the
    factor Σ w². For terms with a coordinate, the squared window is narrower.
    """
    for n in range(_LANES):
        a11, a12, a22 = j[_J_XX * _LANES + n], j[_J_XY * _LANES + n], j[_J_YY * _LANES + n]
        a13, a23, a33 = j[_J_XZ * _LANES + n], j[_J_YZ * _LANES + n], j[_J_ZZ * _LANES + n]
        c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
        c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
        determinant = a11 * c11 + a12 * c12 + a13 * c13
        sound = determinant > 1e-12 * a11 * a22 * a33
        inverse = 1.0 / (determinant if sound else np.nan)
        # In the energy of the divergence term, only the part from coordinates in the window is narrower.
        less = (1.0 - criteria.moment_ratio) * min(criteria.window_moment * (a11 + a22), a33) / (a33 + 1e-300)
        # B = A - (1 - r) C with C the third row and column; with k = A⁻¹ e₃, A⁻¹ C A⁻¹ = k e₃ᵀ + e₃ kᵀ - A₃₃ k kᵀ.
        k1, k2, k3 = c13 * inverse, c23 * inverse, c33 * inverse
        r[_VARIANCE_FLOW_X * _LANES + n] = c11 * inverse + less * a33 * k1 * k1
        r[_VARIANCE_FLOW_Y * _LANES + n] = c22 * inverse + less * a33 * k2 * k2
        r[_VARIANCE_U_Z * _LANES + n] = k3 - less * (2.0 * k3 - a33 * k3 * k3)
        r[_COVARIANCE_X_Z * _LANES + n] = k1 - less * (k1 - a33 * k1 * k3)
        r[_COVARIANCE_Y_Z * _LANES + n] = k2 - less * (k2 - a33 * k2 * k3)


@_jit
def _solve_full(j: Any, m: Any, criteria: Criteria, r: Any) -> None:
    """Solve all matrices under the assumption of full rank: the combinations of the two null vectors in the paper."""
    weight_t, tau = criteria.weight_t, criteria.tau
    for n in range(_LANES):
        a1, b1 = m[(_VECTORS + 5 * _X + 3) * _LANES + n], m[(_VECTORS + 5 * _X + 4) * _LANES + n]
        a2, b2 = m[(_VECTORS + 5 * _Y + 3) * _LANES + n], m[(_VECTORS + 5 * _Y + 4) * _LANES + n]
        a3, b3 = m[(_VECTORS + 5 * _Z + 3) * _LANES + n], m[(_VECTORS + 5 * _Z + 4) * _LANES + n]
        a4, b4 = m[(_VECTORS + 5 * _S + 3) * _LANES + n], m[(_VECTORS + 5 * _S + 4) * _LANES + n]
        a5, b5 = m[(_VECTORS + 5 * _T + 3) * _LANES + n], m[(_VECTORS + 5 * _T + 4) * _LANES + n]
        cross = a4 * b5 - b4 * a5
        inverse = 1.0 / (cross if abs(cross) > 1e-6 else np.nan)
        # p_s = a b5 - b a5 has dt = 0, p_t = a b4 - b a4 has ds = 0.
        r[_P_S * _LANES + n] = (a1 * b5 - b1 * a5) * inverse
        r[(_P_S + _Y) * _LANES + n] = (a2 * b5 - b2 * a5) * inverse
        r[(_P_S + _Z) * _LANES + n] = (a3 * b5 - b3 * a5) * inverse
        r[_FLOW_X * _LANES + n] = (b1 * a4 - a1 * b4) * inverse
        r[_FLOW_Y * _LANES + n] = (b2 * a4 - a2 * b4) * inverse
        r[_U_Z * _LANES + n] = (b3 * a4 - a3 * b4) * inverse
    for n in range(_LANES):
        r[_V_X * _LANES + n] = r[_P_S * _LANES + n]
        r[_LENGTH_S * _LANES + n] = np.sqrt(r[_P_S * _LANES + n] ** 2 + r[(_P_S + _Y) * _LANES + n] ** 2)
        r[_EIGENVALUES * _LANES + n] = m[_J_XX * _LANES + n]
        r[(_EIGENVALUES + 1) * _LANES + n] = m[_J_YY * _LANES + n]
        r[(_EIGENVALUES + 2) * _LANES + n] = m[_J_ZZ * _LANES + n]
        r[(_EIGENVALUES + 3) * _LANES + n] = m[_J_SS * _LANES + n]
        r[(_EIGENVALUES + 4) * _LANES + n] = m[_J_TT * _LANES + n]
    _residual(j, _P_S, _S, _RESIDUAL_S, r)
    _residual(j, _FLOW_X, _T, _RESIDUAL_T, r)
    _covariances(j, criteria, r)
    for n in range(_LANES):
        j11, j12, j22 = j[_J_XX * _LANES + n], j[_J_XY * _LANES + n], j[_J_YY * _LANES + n]
        along_s, along_t = j[_J_SS * _LANES + n], weight_t * j[_J_TT * _LANES + n]
        r[_TO_MOVE * _LANES + n] = along_s / (j11 + 1e-30) + along_t / (j11 + j22 + 1e-30)
        uncertain = (max(r[_RESIDUAL_T * _LANES + n], 0.0) + along_t) * r[_VARIANCE_U_Z * _LANES + n]
        r[_UNCERTAINTY * _LANES + n] = uncertain if uncertain < 1e30 else 1e30
        r[_VARIANCE_V_X * _LANES + n] = r[_VARIANCE_FLOW_X * _LANES + n]
        # Texture in two directions of the image, in one, or none.
        mean, radius = 0.5 * (j11 + j22), np.sqrt(0.25 * (j11 - j22) ** 2 + j12 * j12)
        directions = (1.0 if mean + radius > tau else 0.0) + (1.0 if mean - radius > tau else 0.0)
        above = 0.0
        for k in range(5):
            above += 1.0 if r[(_EIGENVALUES + k) * _LANES + n] > tau else 0.0
        rank = min(above, directions + 1.0) if directions > 0.0 else 0.0
        r[_RANK * _LANES + n] = rank
        r[_KIND_DISPARITY * _LANES + n] = 2.0 if j11 > tau else 0.0
        known = 2.0 if abs(r[_FLOW_X * _LANES + n]) < 1e30 else 0.0
        r[_KIND_MOTION * _LANES + n] = known if rank > 2.0 else min(rank, 1.0)
        r[_MODEL_VIOLATION * _LANES + n] = 1.0 if above > rank and directions > 0.0 else 0.0


@_jit
def _solve_part(j: Any, m: Any, n: int, r: Any) -> None:
    """Solve one matrix of reduced rank and overwrite the result of `_solve_full`.

    Disparity is the smallest eigenvector of the block of g_x and g_s, for p_s = (v_x, 0, 0, 1, 0). Motion is the vector
    of minimum norm with ds = 0 and dt = 1 in the null space: with P the projector onto it and A the block of its rows
    and columns 4 and 5, the second column of P[:, 4:5] A⁻¹, which in two dimensions is the p_t of the paper.
    """
    rank = int(r[_RANK * _LANES + n])
    j11, b, c = j[_J_XX * _LANES + n], j[_J_XS * _LANES + n], j[_J_SS * _LANES + n]
    root = np.sqrt((j11 - c) ** 2 + 4.0 * b * b)
    r[_V_X * _LANES + n] = -2.0 * b / (j11 - c + root) if j11 >= c and root > 0.0 else np.nan
    r[_RESIDUAL_S * _LANES + n] = 0.5 * (j11 + c - root)
    r[_VARIANCE_V_X * _LANES + n] = 1.0 / (j11 + 1e-300)
    r[_UNCERTAINTY * _LANES + n] = 1e30
    for k in range(_LENGTH_S, _FOUND):
        r[k * _LANES + n] = np.nan
    p33, p34, p44 = 1.0, 0.0, 1.0
    for i in range(rank):
        ds, dt = m[(_VECTORS + 5 * _S + i) * _LANES + n], m[(_VECTORS + 5 * _T + i) * _LANES + n]
        p33 -= ds * ds
        p34 -= ds * dt
        p44 -= dt * dt
    determinant = p33 * p44 - p34 * p34
    if determinant <= 1e-12:
        r[_KIND_MOTION * _LANES + n] = 0.0
    for k in range(3):
        towards_s, towards_t = 0.0, 0.0
        for i in range(rank):
            entry = m[(_VECTORS + 5 * k + i) * _LANES + n]
            towards_s -= entry * m[(_VECTORS + 5 * _S + i) * _LANES + n]
            towards_t -= entry * m[(_VECTORS + 5 * _T + i) * _LANES + n]
        moved = (towards_t * p33 - towards_s * p34) / determinant
        r[(_FLOW_X + k) * _LANES + n] = moved if determinant > 1e-12 else np.nan


@_jit
def _solve_row(entries: Any, criteria: Criteria, found: Any) -> None:
    """Solve all pixels of a row: entries `_J_XX` to `_J_TT`, shape (15, x); results, shape (23, x).

    Where filters and window touch an invalid pixel, entries are NaN, and the result is not better than any other.
    """
    j, m, r = np.zeros(_ENTRIES * _LANES), np.empty(_PLACES * _LANES), np.empty(_FOUND_AND_NEEDED * _LANES)
    invalid = np.zeros(_LANES, dtype=np.bool_)
    count = entries.shape[1]
    for start in range(0, count, _LANES):
        used = min(_LANES, count - start)
        for entry in range(_ENTRIES):
            for n in range(used):
                j[entry * _LANES + n] = entries[entry, start + n]
        for n in range(used):
            invalid[n] = False
            for entry in range(_ENTRIES):
                invalid[n] |= np.isnan(j[entry * _LANES + n])
            if invalid[n]:
                # NaN must not affect the convergence of other matrices.
                for entry in range(_ENTRIES):
                    j[entry * _LANES + n] = 0.0
        for k in range(_ENTRIES * _LANES):
            m[k] = j[k]
        _diagonalise(m)
        _sort(m)
        _solve_full(j, m, criteria, r)
        for n in range(used):
            if r[_RANK * _LANES + n] < 3.0:
                _solve_part(j, m, n, r)
        for k in range(_FOUND):
            for n in range(used):
                found[k, start + n] = r[k * _LANES + n]
        for n in range(used):
            if invalid[n]:
                found[_TO_MOVE, start + n] = found[_UNCERTAINTY, start + n] = np.nan


@_jit
def _keep_better(found: Any, candidate: int, best: BestRegistration, frame: int, row: int, first_column: int) -> None:
    """Store the result of `_solve_row` for a row where it is better than those of other registrations.

    Disparity and flow are stored only where the residual displacement is the smallest so far, since the filters are
    most exact for small displacements; the divergence only where its uncertainty is the smallest so far, since a
    residual disparity, through its change in time, adds information about motion in depth.
    """
    for x in range(found.shape[1]):
        at = frame, row, first_column + x
        to_move, uncertain = np.float32(found[_TO_MOVE, x]), np.float32(found[_UNCERTAINTY, x])
        if to_move < best.to_move[at]:
            best.to_move[at] = to_move
            best.choice[at] = candidate
            best.kind_disparity[at] = np.uint8(found[_KIND_DISPARITY, x])
            best.kind_motion[at] = np.uint8(found[_KIND_MOTION, x])
            best.model_violation[at] = np.uint8(found[_MODEL_VIOLATION, x])
            best.v_x[at] = found[_V_X, x]
            best.flow_x[at] = found[_FLOW_X, x]
            best.flow_y[at] = found[_FLOW_Y, x]
            best.u_z[at] = found[_U_Z, x]
            for k in range(5):
                best.eigenvalues[frame, k, row, first_column + x] = found[_EIGENVALUES + k, x]
            best.residual_s[at] = found[_RESIDUAL_S, x]
            best.variance_v_x[at] = found[_VARIANCE_V_X, x]
            best.length_s[at] = found[_LENGTH_S, x]
        if uncertain < best.uncertainty[at]:
            best.uncertainty[at] = uncertain
            best.certain_u_z[at] = found[_U_Z, x]
            best.residual_t[at] = found[_RESIDUAL_T, x]
            best.variance_flow_x[at] = found[_VARIANCE_FLOW_X, x]
            best.variance_flow_y[at] = found[_VARIANCE_FLOW_Y, x]
            best.variance_u_z[at] = found[_VARIANCE_U_Z, x]
            best.covariance_x_z[at] = found[_COVARIANCE_X_Z, x]
            best.covariance_y_z[at] = found[_COVARIANCE_Y_Z, x]


@kernel()
def estimate_tile(
    view: Registered,
    filters: Filters,
    criteria: Criteria,
    best: BestRegistration,
    first_frame: int,
    first_row: int,
    tile: NDArray[np.int64],
) -> None:
    """Estimate frames at one registration in one tile (first and last + 1 row, then column), in one thread."""
    taps_t, taps = filters.smoothing_t.shape[0], filters.kernels.shape[1]
    frames_in_window, window = filters.window_t.shape[0], filters.windows.shape[1]
    channels, cameras = view.images.shape[0], view.images.shape[1]
    reach = taps // 2 + window // 2
    speed = view.flow.astype(np.float32)
    rows, columns = tile[1] - tile[0], tile[3] - tile[2]
    top, left = tile[0] - reach, tile[2] - reach
    rows_in, columns_in = rows + 2 * reach, columns + 2 * reach
    rows_d, columns_d = rows_in - taps + 1, columns_in - taps + 1
    values = np.empty((cameras, columns_in), dtype=np.float32)
    ring = np.empty((channels, taps_t, 3, rows_in, columns_in), dtype=np.float32)
    times = np.zeros(taps_t, dtype=np.float32)
    rows_t = np.empty((5, columns_in), dtype=np.float32)
    rows_x = np.empty((6, rows_in, columns_d), dtype=np.float32)
    derivatives = np.empty((channels, frames_in_window, 5, rows_d, columns_d), dtype=np.float32)
    products = np.empty((_PRODUCTS, rows_d, columns_d), dtype=np.float32)
    gathered = np.empty((_ENTRIES, columns_d), dtype=np.float32)
    entries = np.empty((_ENTRIES, columns), dtype=np.float32)
    found = np.empty((_FOUND, columns))
    for t in range(view.first, view.last):
        done = t - view.first
        slot = done % taps_t
        times[slot] = done - view.centre_t
        ahead = done - int(np.floor(view.centre_t))
        corner = top + ahead * view.flow[1], left + ahead * view.flow[0]
        for channel in range(channels):
            _reduce_cameras(view, channel, t, corner, filters, values, ring[channel, slot])
        if done < taps_t - 1:
            continue
        made = (done - taps_t + 1) % frames_in_window
        oldest = (slot + 1) % taps_t
        for channel in range(channels):
            _derive(ring[channel], times, oldest, filters, speed, rows_t, rows_x, derivatives[channel, made])
        out = done - (taps_t - 1) - (frames_in_window - 1)
        if out < 0:
            continue
        for y in range(rows_d):
            products[:, y] = 0.0
            for m in range(frames_in_window):
                at = (made + 1 + m) % frames_in_window
                for channel in range(channels):
                    weight = filters.window_t[m] * filters.channels[channel]
                    _accumulate_products(derivatives[channel, at], weight, filters.with_correction, y, products[:, y])
        for y in range(rows):
            _window_columns(products, y, filters, gathered)
            _window_row(gathered, filters, entries)
            _solve_row(entries, criteria, found)
            _keep_better(found, criteria.candidate, best, first_frame + out, tile[0] - first_row + y, tile[2])
