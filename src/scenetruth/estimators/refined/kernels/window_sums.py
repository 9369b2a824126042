"""Kernels that sum the normal equations over windows and fit them, for all pixels or those of the central surface."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.pixel_equations import PAIR_OF, PRODUCTS, SIDE_OF, add_row, dot, is_pair
from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, ImageView
from scenetruth.estimators.refined.kernels.window_solver import (
    CURVED,
    EVERY_VARIANCE,
    FULL,
    GRADIENTS,
    KNOWN,
    POWERS,
    Fit,
    Model,
    fit_window,
    work_space,
)
from scenetruth.kernels import kernel

__all__ = ["EVERY_MODEL", "NO_MODEL", "solve_members", "solve_rows"]


EVERY_MODEL, NO_MODEL = -1, -2
"""Values that select all models, or none, at a pixel."""

# Index of the number of valid channels among the products.
_IN_USE = 16

_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})


@numba.njit(inline="always")
def _degree(product: int, curved: bool, turning: bool, bent: bool) -> int:
    """Return the highest power of the distance required for the moments of a product."""
    surface = 2 if curved else 1
    if product == 0:
        return 2 * surface
    motion = 1 if turning else 0
    if product < 4:
        return surface + (2 if bent else motion)
    if product < 10:
        return motion + (2 if bent else motion)
    if product == 10:
        return surface
    if product < PRODUCTS:
        return motion if product < 14 else 0
    # Products of the acceleration, which is constant in a window.
    if product in (PAIR_OF[0, 4], PAIR_OF[0, 5], PAIR_OF[0, 6]):
        return surface
    return 2 if bent else motion


@_jit
def _find_used_rows(products: Any, first: int, last: int) -> Any:
    """Return which rows of a range have pixels in use; products of the others are 0, as of start values."""
    used = np.zeros(products.shape[1], dtype=np.bool_)
    for v in range(max(first, 0), min(last, used.size)):
        for x in range(products.shape[2]):
            if products[_IN_USE, v, x] != 0.0:
                used[v] = True
                break
    return used


@_jit
def _sums_along_y(
    products: Any, pairs_only: bool, window: Any, y: int, used: Any, ends: Any, asked: Any, lines: Any
) -> None:
    """Sum products along the columns of the windows of a row, times powers of the distance: (numbered, x).

    ``used``: Rows with pixels in use.
    ``ends``: First and last column + 1 of the sums.
    ``lines``: Output, with a margin of the half-width of a window on both sides.
    """
    count, height, _ = products.shape
    reach = window.shape[1] // 2
    curved, turning, bent = asked
    first, last = ends
    for n in range(count):
        if pairs_only and not is_pair(n):
            continue
        for k in range(_degree(n, curved, turning, bent) + 1):
            out = lines[n * POWERS + k, first + reach : last + reach]
            out[:] = 0.0
            for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                if used[v]:
                    add_row(out, window[k, v - y + reach], products[n, v, first:last])


@_jit
def _sums_along_x(lines: Any, pairs_only: bool, window: Any, x: int, asked: Any, moments: Any) -> None:
    """Sum the sums of `_sums_along_y` over the window around column x: moments (numbered, 1)."""
    width = window.shape[1]
    curved, turning, bent = asked
    for n in range(lines.shape[0] // POWERS):
        if pairs_only and not is_pair(n):
            continue
        degree = _degree(n, curved, turning, bent)
        for k in range(degree + 1):
            line = lines[n * POWERS + k, x : x + width]
            for j in range(degree + 1 - k):
                moments[(n * POWERS + j) * POWERS + k, 0] = dot(window[j], line)


@_jit
def solve_rows(
    products: NDArray[np.float64],
    weights: NDArray[np.float64],
    models: tuple[Model, Model],
    count: int,
    view: ImageView,
    first_row: int,
    least: float,
    fits: tuple[Fit, Fit],
    chosen: NDArray[np.int8],
    told: int,
    step: int,
    rows: tuple[int, int],
) -> None:
    """Fit surface and motion in the windows around the pixels of a lattice, for a range of its rows.

    ``products``: Normal equations of `pixel_equations.add_products` of image rows from ``first_row`` on.
    ``weights``: Weights of a window, and their squares for variances, times the powers 0 to 4 of the distance, shape
      (2, 5, 2 r + 1).
    ``least``: Smallest number of valid channels in a window, averaged with its weights.
    ``fits``: Maps with the rows and columns of the lattice.
    ``chosen``: Model of every pixel of the lattice, `EVERY_MODEL` or `NO_MODEL`.
    ``step``: Distance of adjacent pixels of the lattice, which begins at row and column 0 of the image.
    """
    size, _, width = products.shape
    window, squared = weights[0], weights[1]
    reach = window.shape[1] // 2
    # Beyond the ends of a row, all values are zero.
    lines = np.zeros((size * POWERS, width + 2 * reach))
    second_lines = np.zeros((len(lines) if told > 0 else 1, lines.shape[1]))
    moments = np.zeros((size * POWERS**2, 1))
    seconds = np.zeros((len(moments) if told > 0 else 1, 1))
    work = work_space()
    whole = window[0].sum() ** 2
    asked = _asked(models, count)
    plain = (asked[0], asked[1], False)
    used = _find_used_rows(products, rows[0] * step - first_row - reach, rows[1] * step - first_row + reach)
    for row in range(rows[0], rows[1]):
        y = row * step
        first, last = width, 0
        for column in range(chosen.shape[1]):
            if chosen[row, column] >= EVERY_MODEL:
                first = min(first, column * step)
                last = column * step + 1
        if last == 0:
            continue
        ends = (max(first - reach, 0), min(last + reach, width))
        _sums_along_y(products, False, window, y - first_row, used, ends, asked, lines)
        if told > 0:
            _sums_along_y(products, True, squared, y - first_row, used, ends, plain, second_lines)
        for column in range(first // step, (last - 1) // step + 1):
            if chosen[row, column] < EVERY_MODEL:
                continue
            x = column * step
            _sums_along_x(lines, False, window, x, asked, moments)
            if told > 0:
                _sums_along_x(second_lines, True, squared, x, plain, seconds)
            enough = moments[KNOWN, 0] / whole >= least
            for m in range(count):
                if chosen[row, column] == EVERY_MODEL or chosen[row, column] == m:
                    fit_window(moments, seconds, 0, models[m], view, enough, fits[m], (x, y), (column, row), told, work)


@_jit
def _asked(models: Any, count: int) -> Any:
    """Return whether any model has curvature, a velocity gradient, or motion of second order."""
    curved, turning, bent = False, False, False
    for m in range(count):
        curved = curved or models[m].surface == CURVED
        turning = turning or models[m].gradient > 0
        bent = bent or (models[m].gradient > 0 and models[m].surface > 1)
    return curved, turning, bent


@_jit
def _square_after_step(several: int, theta: Any, x: float, y: float, fields: Any, v: int, u: int, of_pixel: Any) -> Any:
    """Return the squares of a pixel at (x, y) from a window centre if it had the parameters of the window.

    ``fields``, ``u``, ``v``: Those of the pixel, and its place among them.
    ``of_pixel``: Its products.
    """
    d, q_x, q_y, q_z = fields[0, v, u], fields[1, v, u], fields[2, v, u], fields[3, v, u]
    there = (
        theta[0] + theta[1] * x + theta[2] * y + theta[3] * x * x + theta[4] * x * y + theta[5] * y * y,
        theta[6] + theta[7] * x + theta[8] * y,
        theta[9] + theta[10] * x + theta[11] * y,
        theta[12] + theta[13] * x + theta[14] * y,
    )
    s = (there[0] - d, there[1] - q_x, there[2] - q_y, there[3] - q_z)
    # Squares after a step s from the parameters p are e - 2 b s + s M s, with b = (M p + b) - M p: these are
    # e - 2 (M p + b) s + s M (s + 2 p).
    r = (there[0] + d, there[1] + q_x, there[2] + q_y, there[3] + q_z)
    m = of_pixel
    total = m[14] - 2.0 * (s[0] * m[10] + s[1] * m[11] + s[2] * m[12] + s[3] * m[13])
    total += s[0] * r[0] * m[0] + (s[0] * r[1] + s[1] * r[0]) * m[1] + (s[0] * r[2] + s[2] * r[0]) * m[2]
    total += (s[0] * r[3] + s[3] * r[0]) * m[3] + s[1] * r[1] * m[4] + (s[1] * r[2] + s[2] * r[1]) * m[5]
    total += (s[1] * r[3] + s[3] * r[1]) * m[6] + s[2] * r[2] * m[7] + (s[2] * r[3] + s[3] * r[2]) * m[8]
    total += s[3] * r[3] * m[9]
    if several == STEADY:
        return total
    for k in range(STEADY, several):
        step, both = theta[FULL + k - STEADY] - fields[k, v, u], theta[FULL + k - STEADY] + fields[k, v, u]
        total += step * (both * m[PAIR_OF[k, k]] - 2.0 * m[SIDE_OF[k]])
        total += (s[0] * both + step * r[0]) * m[PAIR_OF[0, k]] + (s[1] * both + step * r[1]) * m[PAIR_OF[1, k]]
        total += (s[2] * both + step * r[2]) * m[PAIR_OF[2, k]] + (s[3] * both + step * r[3]) * m[PAIR_OF[3, k]]
        for n in range(STEADY, k):
            first, other = theta[FULL + n - STEADY] - fields[n, v, u], theta[FULL + n - STEADY] + fields[n, v, u]
            total += (first * both + step * other) * m[PAIR_OF[n, k]]
    return total


@_jit
def _displacements(several: int, theta: Any, x: int, y: int, fields: Any, v: int, u: int, reach: Any, out: Any) -> None:
    """Write by how many px the parameters of a window displace the points of a row of pixels, NaN where unknown.

    ``x``, ``y``: The first pixel relative to the centre of the window; ``u``, ``v``: its column and row in the image.
    """
    d = fields[0, v, u : u + out.size]
    for n in range(out.size):
        right = float(x + n)
        step = theta[0] + theta[1] * right + theta[2] * y + right * (theta[3] * right + theta[4] * y) + theta[5] * y * y
        out[n] = abs(step - d[n]) * reach[0]
    for k in range(1, several):
        own = fields[k, v, u : u + out.size]
        arm = reach[1] * (reach[2] if k == 3 or k == 6 else 1.0)
        if k < STEADY:
            begun, along = theta[3 + 3 * k] + theta[5 + 3 * k] * y, theta[4 + 3 * k]
        else:
            begun, along = theta[FULL + k - STEADY], 0.0
            arm *= 0.5 * reach[1]
        for n in range(out.size):
            moved = abs(begun + along * float(x + n) - own[n]) * abs(d[n]) * arm
            out[n] = moved if moved > out[n] else out[n]


_LANES = 8  # numbers of a vector


def _compiled_sums(count: int, powers: int) -> Any:
    """Return an intrinsic that sums products of some pixels of a row, times several weights of each.

    It takes the products of a row, shape (width, n), the columns of the pixels, and the weights of all columns, shape
    (width, powers); and writes the sums to an array of shape (powers, m). Until then, they are in registers.

    ``count``: Number of products, a multiple of 8.
    """

    @intrinsic
    def summed(typing_context: Any, products: Any, columns: Any, weights: Any, out: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            of_pixels, chosen, of_columns, target = (
                context.make_array(kind)(context, builder, value)
                for kind, value in zip(signature.args, arguments, strict=True)
            )
            number = cgutils.unpack_tuple(builder, chosen.shape)[0]
            width, stride = (cgutils.unpack_tuple(builder, each.shape)[1] for each in (of_pixels, target))
            vector = ir.VectorType(context.get_value_type(products.dtype), _LANES)
            undefined, zero = ir.Constant(vector, ir.Undefined), ir.Constant(ir.IntType(32), 0)
            every = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
            sums = [[cgutils.alloca_once(builder, vector) for _ in range(0, count, _LANES)] for _ in range(powers)]

            def of(value: int) -> Any:
                return ir.Constant(number.type, value)

            def place(start: Any, first: Any, n: int) -> Any:
                each = builder.gep(start, [builder.add(first, of(n * _LANES))])
                return builder.bitcast(each, vector.as_pointer())

            for line in sums:
                for each in line:
                    builder.store(ir.Constant(vector, [0.0] * _LANES), each)
            with cgutils.for_range(builder, number) as loop:
                column = builder.load(builder.gep(chosen.data, [loop.index]))
                first, values = builder.mul(column, width), []
                for n in range(len(sums[0])):
                    values.append(builder.load(place(of_pixels.data, first, n)))
                    values[-1].align = 4
                for k, line in enumerate(sums):
                    at = builder.add(builder.mul(column, of(powers)), of(k))
                    weight = builder.load(builder.gep(of_columns.data, [at]))
                    weight = builder.shuffle_vector(builder.insert_element(undefined, weight, zero), undefined, every)
                    for value, each in zip(values, line, strict=True):
                        product = builder.fmul(weight, value, flags=("contract",))
                        builder.store(builder.fadd(builder.load(each), product, flags=("contract",)), each)
            for k, line in enumerate(sums):
                for n, each in enumerate(line):
                    builder.store(builder.load(each), place(target.data, builder.mul(stride, of(k)), n)).align = 4
            return context.get_dummy_value()

        return types.void(products, columns, weights, out), generate

    return summed


@_jit
def _by_column(window: Any, powers: int) -> Any:
    """Return the weights of a window by column, in groups of powers of the distance: (group, column, power)."""
    out = np.zeros((-(-POWERS // powers), window.shape[1], powers), window.dtype)
    for k in range(POWERS):
        for n in range(window.shape[1]):
            out[k // powers, n, k % powers] = window[k, n]
    return out


# Points that the parameters of a window displace by less than this share of the largest displacement have no other
# residual.
_CLOSE = 0.1
# Powers of the distance whose sums, and those of squares of weights, are in registers together.
_TOGETHER, _SQUARES_TOGETHER = 4, 3
# Numbers of products with and without acceleration, and of those that are elements of M, in whole vectors.
_COUNT, _PAIRS, _ALL_COUNT, _ALL_PAIRS = 24, 16, 48, 40
# Functions in a closure would prevent caching.
_sum_products, _sum_pairs = _compiled_sums(_COUNT, _TOGETHER), _compiled_sums(_PAIRS, _SQUARES_TOGETHER)
_sum_all_products, _sum_all_pairs = _compiled_sums(_ALL_COUNT, _TOGETHER), _compiled_sums(_ALL_PAIRS, _SQUARES_TOGETHER)


def _compiled(several: int) -> Any:
    # Constants, so that loops over them are vector instructions.
    count, pairs = (_COUNT, _PAIRS) if several == STEADY else (_ALL_COUNT, _ALL_PAIRS)
    accelerated = several != STEADY

    @_jit
    def compiled(
        products: Any,
        limit: Any,
        fields: Any,
        reach: Any,
        weights: Any,
        model: Any,
        view: Any,
        first_row: Any,
        fit: Any,
        pixels: Any,
        shares: Any,
        numbers: Any,
    ) -> None:
        rows, width = limit.shape
        around = weights.shape[2] // 2
        window, squared = weights[0].astype(products.dtype), weights[1].astype(products.dtype)
        by_column, squared_by_column = _by_column(window, _TOGETHER), _by_column(squared, _SQUARES_TOGETHER)
        moments, seconds = np.zeros((count * POWERS**2, 1)), np.zeros((count * POWERS**2, 1))
        # Sums of a row by powers of the distance along x, and of the window by those along y and along x.
        sums, second_sums = np.empty((8, count), products.dtype), np.empty((6, count), products.dtype)
        total, second_total = (
            np.empty((POWERS, POWERS, count), products.dtype),
            np.empty((POWERS, POWERS, count), products.dtype),
        )
        work, theta, every = work_space(), np.empty(len(fit.theta)), np.empty(2 * around + 1)
        columns = np.empty(2 * around + 1, dtype=np.int64)
        powers = 4 if model.gradient > 0 and model.surface > 1 else 3
        fewer = 3
        if model.surface == CURVED:
            powers = fewer = POWERS
        told = EVERY_VARIANCE if fit.variance.shape[2] == len(pixels) else 0
        fewer = fewer if told > 0 else 0
        whole = weights[0, 0].sum() ** 2
        # A variable, so that `fit_window` is compiled once for both kernels.
        single = fit.theta.shape[1] - 1
        for place in range(numbers.size):
            number = numbers[place]
            y, x = pixels[number]
            for k in range(len(theta)):
                theta[k] = fit.theta[k, 0, number]
            total[:], second_total[:] = 0.0, 0.0
            row = y - first_row
            first, last = max(x - around, 0), min(x + around + 1, width)
            moved = every[: last - first]
            # Columns of the window begin left of the image at its edge.
            skipped = first - x + around
            for v in range(max(row - around, 0), min(row + around + 1, rows)):
                _displacements(several, theta, first - x, v - row, fields, v + first_row, first, reach, moved)
                used = 0
                for n in range(moved.size):
                    u = first + n
                    if not moved[n] < reach[3] or products[v, u, _IN_USE] == 0.0:
                        continue
                    if not products[v, u, 14] <= limit[v, u] * products[v, u, 15]:
                        continue
                    if moved[n] > _CLOSE * reach[3]:
                        square = _square_after_step(
                            several, theta, u - x, v - row, fields, v + first_row, u, products[v, u]
                        )
                        if not square <= limit[v, u] * products[v, u, 15]:
                            continue
                    columns[used] = n
                    used += 1
                if used == 0:
                    continue
                line, chosen = products[v, first:last], columns[:used]
                for group in range(-(-powers // _TOGETHER)):
                    of_columns, of_group = by_column[group, skipped:], sums[group * _TOGETHER :]
                    if accelerated:
                        _sum_all_products(line, chosen, of_columns, of_group)
                    else:
                        _sum_products(line, chosen, of_columns, of_group)
                for group in range(-(-fewer // _SQUARES_TOGETHER)):
                    of_columns, of_group = squared_by_column[group, skipped:], second_sums[group * _SQUARES_TOGETHER :]
                    if accelerated:
                        _sum_all_pairs(line, chosen, of_columns, of_group)
                    else:
                        _sum_pairs(line, chosen, of_columns, of_group)
                at = v - row + around
                for k in range(powers):
                    for j in range(powers - k):
                        w, sum_of_row, out = window[k, at], sums[j], total[k, j]
                        for n in range(count):
                            out[n] += w * sum_of_row[n]
                for k in range(fewer):
                    for j in range(fewer - k):
                        w, sum_of_row, out = squared[k, at], second_sums[j], second_total[k, j]
                        for n in range(pairs):
                            out[n] += w * sum_of_row[n]
            for n in range(count):
                for k in range(powers):
                    for j in range(powers - k):
                        moments[(n * POWERS + j) * POWERS + k, 0] = total[k, j, n]
            for n in range(pairs):
                for k in range(fewer):
                    for j in range(fewer - k):
                        seconds[(n * POWERS + j) * POWERS + k, 0] = second_total[k, j, n]
            gradient = moments[GRADIENTS, 0]
            known = moments[KNOWN, 0]
            shares[number, 0] = known / whole
            if gradient > 0.0:
                shares[number, 1] = np.hypot(moments[GRADIENTS + POWERS, 0], moments[GRADIENTS + 1, 0]) / gradient
            else:
                shares[number, 1] = np.inf
            fit_window(moments, seconds, 0, model, view, known > 0.0, fit, (x, y), (number, single), told, work)

    return compiled


_SOLVES = {several: _compiled(several) for several in (STEADY, ACCELERATED)}


def solve_members(
    products: NDArray[np.floating[Any]],
    limit: NDArray[np.floating[Any]],
    fields: NDArray[np.float64],
    reach: NDArray[np.float64],
    weights: NDArray[np.float64],
    model: Model,
    view: ImageView,
    first_row: int,
    fit: Fit,
    pixels: NDArray[np.int64],
    shares: NDArray[np.float64],
    numbers: NDArray[np.int64],
) -> None:
    """Fit surface and motion around pixels to those pixels of their windows that belong to the same surface.

    ``products``: Normal equations of the pixels from `pixel_equations.add_products`, with the products last: shape
      (rows, width, 24 or 48), the last two without meaning; sums have their precision.
    ``limit``: Largest mean square residual of a pixel that is explained, shape (rows, width).
    ``fields``: d and q of the pixels of the image, with the acceleration if fitted, shape (4 or 7, height, width).
    ``reach``: Farthest camera in steps, longest time in frames, half the image width over the focal length, and largest
      displacement in px relative to a pixel's own parameters.
    ``fit``: Maps of a single row, with an entry for each pixel; variances are computed if it has maps of them.
    ``pixels``: Rows and columns in the image, shape (n, 2).
    ``shares``: Output: fraction of the window that belongs to the surface, and distance of its texture centroid
      (weighted by the squared gradient) from the window centre, in px, shape (n, 2).
    ``numbers``: Pixels to be fitted.
    """
    _SOLVES[len(fields)](products, limit, fields, reach, weights, model, view, first_row, fit, pixels, shares, numbers)
