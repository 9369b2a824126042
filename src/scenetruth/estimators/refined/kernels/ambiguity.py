"""Kernels of the tests for ambiguity: texture of members of a window, self-similarity, and costs of rivals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.spline_samples import sample_cubic, sample_quintic
from scenetruth.estimators.refined.kernels.warp import (
    ACCELERATED,
    CUBIC,
    QUINTIC,
    STEADY,
    ImageView,
    corrected,
    find_offsets,
    place_of,
)
from scenetruth.kernels import kernel

__all__ = ["COSTS", "add_similarity", "compare_rivals", "compare_windows", "sum_members"]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@_jit
def sum_members(
    products: NDArray[np.float64],
    theta: NDArray[np.float64],
    limits: NDArray[np.float64],
    weights: NDArray[np.float64],
    pixels: NDArray[np.int64],
    out: NDArray[np.float64],
    part: tuple[int, int],
) -> None:
    """Compute the weighted means of maps over those pixels of a window that belong to the surface of its centre.

    A pixel belongs to it if its disparity and its d q agree with the linear model of the centre.

    ``products``: Maps, shape (n, y, x).
    ``theta``: Parameters of the fits, shape (15 or 18, y, x), NaN where invalid.
    ``limits``: Largest differences of the disparity and of d q, shape (2,).
    ``weights``: Window along one axis, odd length.
    ``pixels``: Rows and columns of the centres, shape (m, 2).
    ``out``: Output: means, and the inverse of the effective number of members, shape (n + 1, m).
    """
    count, height, width = products.shape
    reach = len(weights) // 2
    sums = np.empty(count)
    for n in range(part[0], part[1]):
        row, column = pixels[n]
        centre = theta[:, row, column]
        sums[:] = 0.0
        total, squares = 0.0, 0.0
        for y in range(max(row - reach, 0), min(row + reach + 1, height)):
            for x in range(max(column - reach, 0), min(column + reach + 1, width)):
                xi, eta = float(x - column), float(y - row)
                d = centre[0] + xi * (centre[1] + centre[3] * xi + centre[4] * eta) + eta * centre[2]
                d += centre[5] * eta * eta
                own = theta[0, y, x]
                member = abs(own - d) <= limits[0]
                for k in (6, 9):
                    q = centre[k] + centre[k + 1] * xi + centre[k + 2] * eta
                    member = member and abs(own * theta[k, y, x] - d * q) <= limits[1]
                if member:
                    w = weights[y - row + reach] * weights[x - column + reach]
                    total += w
                    squares += w * w
                    for k in range(count):
                        sums[k] += w * products[k, y, x]
        for k in range(count):
            out[k, n] = sums[k] / total if total > 0 else 0.0
        out[count, n] = squares / total**2 if total > 0 else 1.0


@_jit
def add_similarity(
    image: NDArray[np.float32], right: int, down: int, block: int, first: int, out: NDArray[np.float32]
) -> None:
    """Sum the products of an image with itself at a displacement, and its squares, over every other row of blocks.

    ``block``: Side length of a block in px.
    ``first``: First row of blocks.
    ``out``: Incremented: sums of g g' and of g² + g'², shape (2, rows of blocks, columns of blocks).
    """
    height, width = image.shape
    left, size = max(-right, 0), width - abs(right)
    cross, power = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    for place in range(out.shape[1]):
        cross[:] = np.float32(0.0)
        power[:] = np.float32(0.0)
        top = (first + place) * block
        for y in range(top, min(top + block, height), 2):
            if y + down < 0 or y + down >= height:
                continue
            # Views with indices from 0, so that the loop is vectorised.
            own, other = image[y, left : left + size], image[y + down, left + right : left + right + size]
            own_cross, own_power = cross[left : left + size], power[left : left + size]
            for n in range(size):
                a, b = own[n], other[n]
                own_cross[n] += a * b
                own_power[n] += a * a + b * b
        for column in range(out.shape[2]):
            a, b = np.float32(0.0), np.float32(0.0)
            for x in range(column * block, min((column + 1) * block, width)):
                a += cross[x]
                b += power[x]
            out[0, place, column] += a
            out[1, place, column] += b


@_jit
def compare_windows(
    sums: NDArray[np.float32],
    rows: tuple[NDArray[np.int64], NDArray[np.float32]],
    columns: tuple[NDArray[np.int64], NDArray[np.float32]],
    insides: NDArray[np.float32],
    inside_columns: NDArray[np.float32],
    by_noise: float,
    least_inside: float,
    out: NDArray[np.float32],
) -> None:
    """Compute the dissimilarities of windows to those at a displacement from sums over blocks.

    ``sums``: Sums of `add_similarity`, shape (2, rows of blocks, columns of blocks).
    ``rows``, ``columns``: First block and weights of the windows along an axis, shapes (m,) and (m, taps).
    ``insides``, ``inside_columns``: Fractions of the windows inside the image along either axis, after the displacement
      and its opposite, shapes (2, rows) and (2, columns).
    ``by_noise``: Part of the second sum due to noise, for windows inside the image.
    ``least_inside``: Smallest fraction of both displaced windows inside the image, of 2; with less, windows are
      unrelated.
    ``out``: Output: 0 if equal, 1 if unrelated, shape (rows, columns).
    """
    first_rows, row_weights = rows
    first_columns, column_weights = columns
    lines = np.empty((2, sums.shape[2]), dtype=np.float32)
    taps, small = column_weights.shape[1], np.float32(1e-30)
    for y in range(out.shape[0]):
        for side in range(2):
            line = lines[side]
            line[:] = np.float32(0.0)
            for k in range(row_weights.shape[1]):
                weight, values = row_weights[y, k], sums[side, first_rows[y] + k]
                for x in range(line.size):
                    line[x] += weight * values[x]
        for x in range(out.shape[1]):
            share = insides[0, y] * inside_columns[0, x] + insides[1, y] * inside_columns[1, x]
            if not share > least_inside:
                out[y, x] = np.float32(1.0)
                continue
            cross, power = np.float32(0.0), np.float32(0.0)
            for k in range(taps):
                cross += column_weights[x, k] * lines[0, first_columns[x] + k]
                power += column_weights[x, k] * lines[1, first_columns[x] + k]
            expected = max(power - np.float32(by_noise) * share, np.float32(0.1) * power + small)
            out[y, x] = np.float32(1.0) - np.float32(2.0) * cross / expected


COSTS = 5
"""Number of outputs of `compare_rivals` for each rival."""
_LARGEST = 6
_FARTHEST_PX, _LARGEST_GRADIENT = 1.0, 0.02  # largest change of displacement and of its gradient in an iteration
_SUMS = 6
# Change of displacement over the window, in px, from which on further iterations are without effect; and ratio of the
# differences of a rival to those of the fit, with those of a shift in px, from which on a rival is given up that an
# iteration does not improve by this ratio.
_SETTLED_PX = 0.01
_HOPELESS, _SHIFT_PX, _SLOW = 6.0, 0.1, 0.5


@_jit
def _line(sums: Any) -> Any:
    """Return gain and offset of an image relative to the reference."""
    if sums[0] <= 0.0:
        return 1.0, 0.0
    square = sums[3] - sums[1] * sums[1] / sums[0]
    gain = (sums[4] - sums[1] * sums[2] / sums[0]) / square if square > 0.0 else 1.0
    # Gains of images differ by little: a gain near zero would fit any image by a constant.
    gain = min(max(gain, 0.5), 2.0)
    return gain, (sums[2] - gain * sums[1]) / sums[0]


@_jit
def _residual(sums: Any) -> Any:
    """Return the weighted sum of squared differences from the reference, after gain and offset."""
    if sums[0] <= 0.0:
        return 0.0
    gain, offset = _line(sums)
    square = sums[5] - 2.0 * gain * sums[4] - 2.0 * offset * sums[2]
    return max(square + gain * gain * sums[3] + 2.0 * gain * offset * sums[1] + offset * offset * sums[0], 0.0)


@_jit
def _solve(matrix: Any, values: Any) -> None:
    """Solve a symmetric positive definite system in place."""
    size = len(values)
    for k in range(size):
        for m in range(k + 1, size):
            share = matrix[m, k] / matrix[k, k]
            for n in range(k, size):
                matrix[m, n] -= share * matrix[k, n]
            values[m] -= share * values[k]
    for k in range(size - 1, -1, -1):
        for n in range(k + 1, size):
            values[k] -= matrix[k, n] * values[n]
        values[k] /= matrix[k, k]


@_jit
def _add_samples(w: Any, g: Any, values: Any, sums: Any) -> None:
    """Add the grey values of the reference and of an image to the sums of `_line` and `_residual`."""
    one, by_g, by_value, square, product, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(w.size):
        value = float(values[k])
        one += w[k]
        by_g += w[k] * g[k]
        by_value += w[k] * value
        square += w[k] * g[k] * g[k]
        product += w[k] * g[k] * value
        squares += w[k] * value * value
    sums[0] += one
    sums[1] += by_g
    sums[2] += by_value
    sums[3] += square
    sums[4] += product
    sums[5] += squares


@_jit
def _add_moments(w: Any, u: Any, one: Any, other: Any, v: float, normal: Any) -> None:
    """Add the products of two derivatives in a row of a window, for changes that are linear in u and v."""
    s, s_u, s_uu = 0.0, 0.0, 0.0
    for k in range(w.size):
        product = w[k] * one[k] * other[k]
        s += product
        s_u += product * u[k]
        s_uu += product * u[k] * u[k]
    normal[0, 0] += s
    normal[1, 0] += s_u
    normal[2, 0] += v * s
    normal[1, 1] += s_uu
    normal[2, 1] += v * s_u
    normal[2, 2] += v * v * s


@_jit
def _add_side(w: Any, u: Any, derivative: Any, left: Any, v: float, side: Any) -> None:
    """Add the products of a derivative and a difference in a row of a window."""
    s, s_u = 0.0, 0.0
    for k in range(w.size):
        product = w[k] * derivative[k] * left[k]
        s += product
        s_u += product * u[k]
    side[0] += s
    side[1] += s_u
    side[2] += v * s


def _compile_rivals(*, accelerated: bool, cubic: bool) -> Any:
    # A closure over other kernels would be compiled anew by every process: numba does not find it in its cache.
    @_jit
    def compiled(
        coefficients: Any,
        reference: Any,
        view: Any,
        fields: Any,
        bad: Any,
        factors: Any,
        both: Any,
        weights: Any,
        sampling: Any,
        rivals: Any,
        out: Any,
        part: Any,
    ) -> None:
        count, height, width = coefficients.shape
        flat = coefficients.reshape((count, height * width))
        # Of the region, which is smaller than the parts of the images around it.
        bottom, right = reference.shape[1:]
        step, rounds = sampling
        reach = len(weights) // 2
        size = 6 if both else 3
        sums, before = np.empty((count, _SUMS)), np.empty((count, _SUMS))
        gain, offset = np.empty(count), np.empty(count)
        change = np.empty(_LARGEST)
        # Positions in an image of the pixels of a row of the window: fitted, and displaced.
        at_x, at_y = np.empty((2, len(weights))), np.empty((2, len(weights)))
        every_offset = np.empty((2, len(weights)), dtype=np.int64)
        fractions = np.empty((2, len(weights)), dtype=np.float32)
        samples = np.zeros((2, 3, len(weights)), dtype=np.float32)
        # Weights, distances from the centre, grey values, derivatives by the changes, and differences of these pixels.
        of_row = np.zeros((6, len(weights)))
        for n in range(part[0], part[1]):
            row, column = int(rivals[n, 0]), int(rivals[n, 1])
            change[:] = 0.0
            change[0] = rivals[n, 2]
            if both:
                change[3] = rivals[n, 3]
            normal, right_side = np.zeros((size, size)), np.zeros(size)
            before[:] = 0.0
            slope, own, previous, settled = 0.0, 0.0, np.inf, False
            begun = column - reach
            while begun < 0:
                begun += step
            number = (min(column + reach, right - 1) - begun) // step + 1
            for iteration in range(rounds + 1):
                first, last = iteration == 0, iteration == rounds or settled
                # Gain and offset of the previous iteration; none are available in the first.
                solving = iteration > 0 and not last
                normal[:] = 0.0
                right_side[:] = 0.0
                sums[:] = 0.0
                if last:
                    slope = 0.0
                    before[:] = 0.0
                for v in range(-reach, reach + 1, step):
                    y = row + v
                    if y < 0 or y >= bottom:
                        continue
                    for i in range(count):
                        for k in range(number):
                            x = begun + k * step
                            u = x - column
                            # Outside the image.
                            at_x[:, k] = -1.0
                            at_y[:, k] = -1.0
                            if np.isnan(reference[i, y, x]) or np.isnan(fields[0, y, x]):
                                continue
                            over, below, _ = place_of(
                                accelerated, view, view.s[i], view.s_y[i], view.t[i], fields, y, x
                            )
                            over, below = corrected(view, i, over, below)
                            along = change[0] + change[1] * u + change[2] * v
                            down = change[3] + change[4] * u + change[5] * v if both else along
                            at_x[0, k], at_y[0, k] = over, below
                            at_x[1, k], at_y[1, k] = over + factors[i, 0] * along, below + factors[i, 1] * down
                        own_bad = bad[min(i, bad.shape[0] - 1)] if bad.shape[0] > 0 else bad[0:0, 0]
                        for k in range(2):
                            find_offsets(
                                at_x[k, :number],
                                at_y[k, :number],
                                height,
                                width,
                                own_bad,
                                every_offset[k, :number],
                                fractions[0, :number],
                                fractions[1, :number],
                            )
                            if k == 1 or first or last:
                                offsets = every_offset[k, :number]
                                parts = fractions[0, :number], fractions[1, :number]
                                if cubic:
                                    sample_cubic(flat[i], offsets, width, parts[0], parts[1], samples[k])
                                else:
                                    sample_quintic(flat[i], offsets, width, parts[0], parts[1], samples[k])
                        w, u_of, g = of_row[0, :number], of_row[1, :number], of_row[2, :number]
                        along_of, down_of, left = of_row[3, :number], of_row[4, :number], of_row[5, :number]
                        for k in range(number):
                            x = begun + k * step
                            known = every_offset[0, k] >= 0 and every_offset[1, k] >= 0
                            w[k] = weights[v + reach] * weights[x - column + reach] if known else 0.0
                            g[k] = reference[i, y, x] if known else 0.0
                            u_of[k] = x - column
                        _add_samples(w, g, samples[1, 0, :number], sums[i])
                        if first or last:
                            _add_samples(w, g, samples[0, 0, :number], before[i])
                            for k in range(number):
                                along, down = float(samples[0, 1, k]), float(samples[0, 2, k])
                                slope += w[k] * (along * along + down * down)
                        elif solving:
                            for k in range(number):
                                along_of[k] = factors[i, 0] * samples[1, 1, k]
                                down_of[k] = factors[i, 1] * samples[1, 2, k]
                                left[k] = offset[i] + gain[i] * g[k] - samples[1, 0, k]
                            if both:
                                _add_moments(w, u_of, along_of, along_of, float(v), normal[:3, :3])
                                _add_moments(w, u_of, down_of, down_of, float(v), normal[3:, 3:])
                                _add_moments(w, u_of, down_of, along_of, float(v), normal[3:, :3])
                                _add_side(w, u_of, along_of, left, float(v), right_side[:3])
                                _add_side(w, u_of, down_of, left, float(v), right_side[3:])
                            else:
                                for k in range(number):
                                    along_of[k] += down_of[k]
                                _add_moments(w, u_of, along_of, along_of, float(v), normal)
                                _add_side(w, u_of, along_of, left, float(v), right_side)
                for i in range(count):
                    gain[i], offset[i] = _line(sums[i])
                if first or last:
                    own = 0.0
                    for i in range(count):
                        own += _residual(before[i])
                if last:
                    break
                rival = 0.0
                for i in range(count):
                    rival += _residual(sums[i])
                if rival > _SLOW * previous and rival > _HOPELESS * (own + _SHIFT_PX * _SHIFT_PX * slope):
                    break
                # The first two are those of the start.
                previous = rival if iteration > 0 else np.inf
                if solving:
                    largest = 0.0
                    for k in range(3 if both else 0):
                        # The moments of a product of two derivatives are symmetric.
                        for m in range(k):
                            normal[3 + m, k] = normal[3 + k, m]
                    for k in range(size):
                        largest = max(largest, normal[k, k])
                        for m in range(k):
                            normal[m, k] = normal[k, m]
                    if largest <= 0.0:
                        break
                    for k in range(size):
                        # Directions without texture stay as they are.
                        arm = 1.0 if k % 3 == 0 else 0.1 * reach * reach
                        normal[k, k] = normal[k, k] * (1.0 + 1e-3) + 1e-4 * largest * arm / (0.1 * reach * reach)
                    _solve(normal, right_side)
                    settled = True
                    for k in range(size):
                        most = _FARTHEST_PX if k % 3 == 0 else _LARGEST_GRADIENT
                        moved = min(max(right_side[k], -most), most)
                        change[k] += moved
                        settled = settled and abs(moved) * (1.0 if k % 3 == 0 else reach) < _SETTLED_PX
            total, rival = 0.0, 0.0
            for i in range(count):
                total += sums[i, 0]
                rival += _residual(sums[i])
            out[0, n], out[1, n], out[2, n], out[3, n] = own, rival, total, slope
            out[4, n] = np.hypot(change[0], change[3] if both else 0.0)

    return compiled


_RIVALS = {
    (fields, order): _compile_rivals(accelerated=fields == ACCELERATED, cubic=order == CUBIC)
    for fields in (STEADY, ACCELERATED)
    for order in (CUBIC, QUINTIC)
}


def compare_rivals(
    coefficients: NDArray[np.float32],
    reference: NDArray[np.float64],
    view: ImageView,
    fields: NDArray[np.float64],
    bad: NDArray[np.uint8],
    factors: NDArray[np.float64],
    both: bool,
    weights: NDArray[np.float64],
    sampling: tuple[int, int],
    rivals: NDArray[np.float64],
    out: NDArray[np.float64],
    part: tuple[int, int],
) -> None:
    """Compare the differences of images from the reference at the fitted places and at those of a rival.

    The rival displaces image i by its factors times a change that is linear in the window, refined from its start.

    ``coefficients``: Spline coefficients of the images, shape (n, y, x).
    ``reference``: Grey values of the reference, NaN where unusable or not visible in an image, shape (n, y, x).
    ``fields``: Fitted fields, NaN where invalid, shape (4 or 7, y, x).
    ``factors``: Displacement of the images along x and y by a change of 1 px, shape (n, 2).
    ``both``: Whether the changes along x and y are independent; else they are the same.
    ``weights``: Window along one axis, evaluated at every n-th pixel.
    ``sampling``: n, and the number of iterations.
    ``rivals``: Row, column and changes along x and y at the start, shape (m, 4).
    ``out``: Output: weighted sums of squares at the fitted places and of the rival, sum of the weights, weighted sum of
      the squared gradient, and change after refinement in px, shape (5, m).
    """
    kernel = _RIVALS[len(fields), view.spline]
    kernel(coefficients, reference, view, fields, bad, factors, both, weights, sampling, rivals, out, part)
