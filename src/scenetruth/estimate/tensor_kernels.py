"""Kernels of the 4D structure tensor: derivatives, windowed products and null space, tile by tile.

They stand in one file because a compiled kernel is kept until the file that it stands in changes.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimate.fused import fma

__all__ = ["estimate_tiles"]

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


@_jit
def _diagonalise(a: Any, v: Any, c: Any, s: Any) -> None:
    """Diagonalise many symmetric 5 x 5 matrices at once by cyclic Jacobi rotations; the last axis counts matrices."""
    lanes = a.shape[2]
    v[:] = 0.0
    for i in range(5):
        for n in range(lanes):
            v[i, i, n] = 1.0
    for _ in range(_MOST_SWEEPS):
        worst = 0.0
        for n in range(lanes):
            outside, inside = 0.0, 0.0
            for i in range(5):
                inside += a[i, i, n] * a[i, i, n]
                for j in range(i + 1, 5):
                    outside += a[i, j, n] * a[i, j, n]
            worst = max(worst, outside / (inside + 1e-300))
        if worst <= _SMALL:
            break
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
def _covariance(j: Any, n: int, moment_ratio: float, found: Any) -> None:
    """Propagate white noise of unit power in the constraint to p: A⁻¹ B A⁻¹, the parts that the world needs.

    A is the tensor's block of g_x, g_y and the divergence term; B the same summed with the squared window, up to the
    factor Σ w² that is left out: where a coordinate stands, the squared window is narrower by ``moment_ratio``.
    """
    a11, a12, a13 = j[0, n], j[1, n], j[3, n]
    a22, a23, a33 = j[2, n], j[4, n], j[5, n]
    c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
    c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
    determinant = a11 * c11 + a12 * c12 + a13 * c13
    if not determinant > 1e-12 * a11 * a22 * a33:
        found[:] = np.nan
        return
    # B = A - (1 - r) C with C the rows and columns of the third entry; A⁻¹ B A⁻¹ = A⁻¹ - (1 - r) A⁻¹ C A⁻¹, and
    # A⁻¹ C A⁻¹ = k e₃ᵀ + e₃ kᵀ - A₃₃ k kᵀ with k = A⁻¹ e₃.
    k1, k2, k3 = c13 / determinant, c23 / determinant, c33 / determinant
    less = 1.0 - moment_ratio
    found[0] = c11 / determinant + less * a33 * k1 * k1
    found[1] = c22 / determinant + less * a33 * k2 * k2
    found[2] = k3 - less * (2.0 * k3 - a33 * k3 * k3)
    found[3] = k1 - less * (k1 - a33 * k1 * k3)
    found[4] = k2 - less * (k2 - a33 * k2 * k3)


@_jit
def _misfit(j: Any, n: int, p1: float, p2: float, p3: float, axis: int) -> float:
    """Return pᵀ J p for p = (p1, p2, p3) and 1 for ds (axis 3) or dt (axis 4)."""
    first = 6 if axis == 3 else 9
    return float(
        p1 * (p1 * j[0, n] + 2.0 * (p2 * j[1, n] + p3 * j[3, n] + j[first, n]))
        + p2 * (p2 * j[2, n] + 2.0 * (p3 * j[4, n] + j[first + 1, n]))
        + p3 * (p3 * j[5, n] + 2.0 * j[first + 2, n])
        + j[12 if axis == 3 else 14, n]
    )


@_jit
def _solve_pixel(j: Any, a: Any, v: Any, n: int, model: Any, order: Any, found: Any) -> None:
    weight_t, tau, moment_ratio, moment = model[0], model[1], model[2], model[3]
    j11, j12, j22 = j[0, n], j[1, n], j[2, n]
    for i in range(5):
        order[i] = i
    for i in range(1, 5):
        k = i
        while k > 0 and a[order[k], order[k], n] > a[order[k - 1], order[k - 1], n]:
            order[k], order[k - 1] = order[k - 1], order[k]
            k -= 1
    above = 0
    for i in range(5):
        found[9 + i] = a[order[i], order[i], n]
        if found[9 + i] > tau:
            above += 1
    found[0] = j[12, n] / (j11 + 1e-30) + weight_t * j[14, n] / (j11 + j22 + 1e-30)
    found[1] = 1e30
    # Texture in every direction of the image, in one, or none.
    mean, radius = 0.5 * (j11 + j22), np.sqrt(0.25 * (j11 - j22) ** 2 + j12 * j12)
    directions = int(mean + radius > tau) + int(mean - radius > tau)
    rank = min(above, directions + 1) if directions > 0 else 0
    found[2] = 2.0 if j11 > tau else 0.0
    found[3] = 2.0 if rank == 3 else float(min(rank, 1))
    found[4] = 1.0 if above > rank and directions > 0 else 0.0
    # Disparity where not all is known: the smallest eigenvector of the block of g_x and g_s, p_s = (v_x, 0, 0, 1, 0).
    b, c = j[6, n], j[12, n]
    root = np.sqrt((j11 - c) ** 2 + 4.0 * b * b)
    found[5] = -2.0 * b / (j11 - c + root) if j11 >= c and root > 0.0 else np.nan
    found[14] = 0.5 * (j11 + c - root)
    found[15] = 1.0 / (j11 + 1e-300)
    found[16:] = np.nan
    # With P the projector on the null space and A the block of its rows and columns 4 and 5, the columns of P[:, 4:5]
    # A⁻¹ are the vectors of least norm with ds = 1, dt = 0 and with ds = 0, dt = 1; in two dimensions these are the
    # paper's combinations a b5 - b a5 and a b4 - b a4, scaled.
    p33, p34, p44 = 1.0, 0.0, 1.0
    for i in range(rank):
        ds, dt = v[3, order[i], n], v[4, order[i], n]
        p33 -= ds * ds
        p34 -= ds * dt
        p44 -= dt * dt
    determinant = p33 * p44 - p34 * p34
    if determinant <= 1e-12:
        found[3] = 0.0
        found[6:9] = np.nan
        return
    along_s1, along_s2, along_s3 = 0.0, 0.0, 0.0
    for k in range(3):
        towards_s, towards_t = 0.0, 0.0
        for i in range(rank):
            entry = v[k, order[i], n]
            towards_s -= entry * v[3, order[i], n]
            towards_t -= entry * v[4, order[i], n]
        found[6 + k] = (towards_t * p33 - towards_s * p34) / determinant
        along_s1, along_s2, along_s3 = along_s2, along_s3, (towards_s * p44 - towards_t * p34) / determinant
    if rank < 3:
        return
    found[5] = along_s1
    found[14] = _misfit(j, n, along_s1, along_s2, along_s3, 3)
    found[16] = np.sqrt(along_s1 * along_s1 + along_s2 * along_s2)
    found[17] = _misfit(j, n, found[6], found[7], found[8], 4)
    # Of the divergence term's energy, what coordinates in the window make is narrower in the squared window.
    inside = min(moment * (j11 + j22), j[5, n])
    ratio = 1.0 - (1.0 - moment_ratio) * inside / (j[5, n] + 1e-300)
    _covariance(j, n, ratio, found[18:23])
    found[15] = found[18]
    found[1] = (max(found[17], 0.0) + weight_t * j[14, n]) * found[20]
    if not np.isfinite(found[1]):
        found[1] = 1e30


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
        Output, shape (x, 23): what is left to move, (v_x² and perhaps u_x² + u_y², in the mean); how uncertain u_z is;
        kind of disparity, kind of motion, model violation; v_x, u_x + x0 u_z, u_y + y0 u_z, u_z; λ1 to λ5; p_sᵀ J p_s,
        variance of v_x for unit noise in the constraint, length of the image's part of p_s; p_tᵀ J p_t, variances of
        the three components of motion and covariances of the first two with the third for unit noise.
    """
    j = np.zeros((15, _LANES))
    a, v = np.zeros((5, 5, _LANES)), np.empty((5, 5, _LANES))
    c, s = np.empty(_LANES), np.empty(_LANES)
    order = np.arange(5)
    count = entries.shape[1]
    for start in range(0, count, _LANES):
        used = min(_LANES, count - start)
        for entry in range(15):
            i, k = _ROWS[entry], _COLUMNS[entry]
            for n in range(used):
                j[entry, n] = entries[entry, start + n]
                a[i, k, n] = j[entry, n]
        _diagonalise(a, v, c, s)
        for n in range(used):
            _solve_pixel(j, a, v, n, model, order, found[start + n])


@numba.njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def estimate_tiles(
    images: NDArray[Any],
    frames: tuple[int, int, int],
    columns_of_s: NDArray[np.int64],
    step: NDArray[np.int64],
    centre_t: float,
    tiles: NDArray[np.int64],
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
) -> None:
    """Estimate frames at one registration in tiles, each by one thread, so that scratch depends on the tiles alone.

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
    tiles
        First and last + 1 row, then column, of the output of every tile; shape (n, 4).
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
    """
    taps_t, taps, frames_in_window, window = over_t.shape[1], over_xy.shape[1], window_t.shape[0], window_xy.shape[1]
    channels, cameras = images.shape[0], images.shape[1]
    reach = taps // 2 + window // 2
    speed = step.astype(np.float32)
    for n in numba.prange(tiles.shape[0]):
        rows, columns = tiles[n, 1] - tiles[n, 0], tiles[n, 3] - tiles[n, 2]
        top, left = tiles[n, 0] - reach, tiles[n, 2] - reach
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
        results = np.empty((columns, _FOUND))
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
                _derive(
                    ring[channel], times, oldest, over_t, speed, over_xy, rows_t, scratch, derivatives[channel, made]
                )
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
                row = tiles[n, 0] - first_row + y
                for x in range(columns):
                    column = tiles[n, 2] + x
                    to_move, uncertain = np.float32(results[x, 0]), np.float32(results[x, 1])
                    if to_move < best[0, out, row, column]:
                        best[0, out, row, column] = to_move
                        choice[out, row, column] = candidate
                        for k in range(3):
                            kinds[k, out, row, column] = np.uint8(results[x, 2 + k])
                        for k in range(4):
                            solved[k, out, row, column] = results[x, 5 + k]
                        for k in range(8):
                            found[k, out, row, column] = results[x, 9 + k]
                    if uncertain < best[1, out, row, column]:
                        best[1, out, row, column] = uncertain
                        solved[4, out, row, column] = results[x, 8]
                        for k in range(6):
                            found[8 + k, out, row, column] = results[x, 17 + k]
