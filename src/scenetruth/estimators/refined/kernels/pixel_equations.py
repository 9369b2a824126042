"""Kernels for the normal equations of single pixels, including gain and offset of the images."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.kernels.warp import ACCELERATED, STEADY, ImageView, place_of
from scenetruth.kernels import kernel

__all__ = [
    "ALL_PRODUCTS",
    "LEAST_VARIANCE",
    "PAIR_OF",
    "PRODUCTS",
    "SIDE_OF",
    "SQUARE_OF",
    "add_products",
    "add_row",
    "correct_brightness",
    "dot",
    "is_pair",
]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

PRODUCTS, ALL_PRODUCTS = 22, 46
"""Numbers of maps that `add_products` fills: for the four fields d and q, and with those of the acceleration."""
LEAST_VARIANCE = 0.01
"""Lower limit of the relative noise variance."""


def _pairs() -> NDArray[np.int64]:
    """Return the index of the product of each pair of fields."""
    found = np.zeros((7, 7), dtype=np.int64)
    found[np.triu_indices(STEADY)] = np.arange(10)
    first = PRODUCTS
    for k in range(STEADY, 7):
        found[: k + 1, k] = first + np.arange(k + 1)
        first += k + 1
    return np.maximum(found, found.T)


PAIR_OF = _pairs()
"""Index of the product of each pair of fields, shape (7, 7)."""
SIDE_OF = np.array([10, 11, 12, 13, 40, 41, 42])
"""Index of the component of M (d, q, a) + b of each field."""
SQUARE_OF = np.array([18, 19, 20, 21, 43, 44, 45])
"""Index of the square of b of each field."""


# With the positions x' in an image, x in the reference, and their scale c, the derivatives a_i of the fields are
# multiples, constant over the images, of r = c d ∇T·(x' - x), p = c d t, v = p ∇T·x', and for the acceleration of
# t p / 2 and t v / 2. Basis and multiple of each field: 1 / d², the gradient along x and y, and -1 / f.
_BASIS_OF = np.array([0, 1, 1, 2, 3, 3, 4])
_FACTOR_OF = np.array([0, 1, 2, 3, 1, 2, 3])
_CHUNK = 128  # pixels evaluated together, whose sums stay in the cache


@_jit
def _multiply(one: Any, other: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = one[x] * other[x]


@_jit
def _add_product(out: Any, one: Any, other: Any) -> None:
    for x in range(out.size):
        out[x] += one[x] * other[x]


@_jit
def _add(out: Any, values: Any) -> None:
    for x in range(out.size):
        out[x] += values[x]


@_jit
def _subtract_known(values: Any, texture: Any, known: Any, left: Any) -> None:
    """Write 1 where a value is valid, else 0, and its difference to the texture, else 0."""
    for x in range(known.size):
        known[x] = 0.0 if np.isnan(values[x]) else 1.0
    for x in range(known.size):
        left[x] = 0.0 if np.isnan(values[x]) else texture[x] - values[x]


@_jit
def _project(along: Any, at_x: Any, down: Any, at_y: Any, known: Any, out: Any) -> None:
    """Write the products of gradients and positions, 0 where invalid."""
    for x in range(out.size):
        total = along[x] * at_x[x] + down[x] * at_y[x]
        out[x] = total if known[x] != 0.0 else 0.0


@_jit
def _select_product(one: Any, other: Any, known: Any, out: Any) -> None:
    for x in range(out.size):
        product = one[x] * other[x]
        out[x] = product if known[x] != 0.0 else 0.0


@_jit
def _difference(factor: Any, after: Any, before: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = factor[x] * (after[x] - before[x])


@_jit
def _scaled(factor: Any, seen: Any, weight: float, out: Any, product: Any) -> None:
    """Write multiples of factors, and their products with other values."""
    for x in range(out.size):
        out[x] = weight * factor[x]
        product[x] = weight * factor[x] * seen[x]


@_jit
def _add_powers(weight: float, values: Any, sums: Any, squares: Any) -> None:
    """Add multiples of values, and the squares of these multiples."""
    for x in range(values.size):
        own = weight * values[x]
        sums[x] += own
        squares[x] += own * own


@_jit
def _add_pair(weight: float, common: Any, one: Any, other: Any, first: Any, second: Any) -> None:
    """Add multiples of the products of a common factor with two others."""
    for x in range(common.size):
        own = weight * common[x]
        first[x] += own * one[x]
        second[x] += own * other[x]


@_jit
def _add_multiple_product(weight: float, one: Any, other: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] += weight * one[x] * other[x]


@_jit
def _accumulate(r: Any, p: Any, v: Any, left: Any, sums: Any, sides: Any, pairs: Any) -> None:
    """Add an image to the sums of r, p and v, of their products with each other, and with the residual."""
    size = p.size
    _add_powers(1.0, r, sums[0, :size], pairs[0, 0, :size])
    _add_powers(1.0, p, sums[1, :size], pairs[1, 1, :size])
    _add_powers(1.0, v, sums[2, :size], pairs[2, 2, :size])
    _add_pair(1.0, p, r, v, pairs[0, 1, :size], pairs[1, 2, :size])
    _add_pair(1.0, r, v, left, pairs[0, 2, :size], sides[0, :size])
    _add_pair(1.0, left, p, v, sides[1, :size], sides[2, :size])


@_jit
def _accumulate_acceleration(half: float, r: Any, p: Any, v: Any, left: Any, sums: Any, sides: Any, pairs: Any) -> None:
    """Add the same for half the time times p and v, which belong to the acceleration."""
    size = p.size
    _add_powers(half, p, sums[3, :size], pairs[3, 3, :size])
    _add_powers(half, v, sums[4, :size], pairs[4, 4, :size])
    _add_pair(half, p, p, v, pairs[1, 3, :size], pairs[1, 4, :size])
    _add_pair(half, r, p, v, pairs[0, 3, :size], pairs[0, 4, :size])
    _add_pair(half, left, p, v, sides[3, :size], sides[4, :size])
    # The product of v with half the time times p is that of p with half the time times v.
    _add_multiple_product(half, v, v, pairs[2, 4, :size])
    _add_multiple_product(half * half, p, v, pairs[3, 4, :size])


@_jit
def _center(pairs: Any, sums: Any, others: Any, share: Any, weight: Any, out: Any) -> None:
    """Write weighted sums of products of differences to means."""
    for x in range(out.size):
        out[x] = weight[x] * (pairs[x] - sums[x] * others[x] * share[x])


@_jit
def _mean_of_images(warped: Any, row: int, first: int, used: Any, texture: Any) -> None:
    """Write number and mean of the valid images of some pixels of a row."""
    used[:], texture[:] = 0.0, 0.0
    for i in range(warped.shape[0]):
        values = warped[i, row, first : first + used.size]
        for x in range(used.size):
            used[x] += 0.0 if np.isnan(values[x]) else 1.0
        for x in range(used.size):
            texture[x] += 0.0 if np.isnan(values[x]) else values[x]
    for x in range(used.size):
        texture[x] /= used[x]


def _compiled_products(several: int) -> Any:
    @_jit
    def compiled(
        view: Any,
        fields: Any,
        warped: Any,
        gradient: Any,
        first_row: Any,
        least: Any,
        variance: Any,
        products: Any,
        rows: Any,
    ) -> None:
        count, _, width = warped.shape
        bases, acceleration = (5 if several > STEADY else 3), several > STEADY
        sums, sides, pairs = np.empty((bases, _CHUNK)), np.empty((bases, _CHUNK)), np.empty((bases, bases, _CHUNK))
        singles, shares, factors = np.empty((17, _CHUNK)), np.empty((bases, _CHUNK)), np.empty((STEADY, _CHUNK))
        for row, first in [(row, first) for row in range(rows[0], rows[1]) for first in range(0, width, _CHUNK)]:
            y, size = row + first_row, min(_CHUNK, width - first)
            if np.isnan(fields[0, y, first : first + size]).all():
                continue
            used, texture, known, left, squares = (
                singles[0, :size],
                singles[1, :size],
                singles[2, :size],
                singles[3, :size],
                singles[4, :size],
            )
            at_x, at_y, scale = singles[5, :size], singles[6, :size], singles[7, :size]
            along, down, d = singles[8, :size], singles[9, :size], singles[10, :size]
            inverse, begun, seen, factor = (
                singles[11, :size],
                singles[12, :size],
                singles[13, :size],
                singles[14, :size],
            )
            p, v, r = singles[15, :size], singles[16, :size], at_x
            _mean_of_images(warped, row, first, used, texture)
            if used.max() < least:
                continue
            for x in range(size):
                along[x], down[x] = gradient[0, row, first + x], gradient[1, row, first + x]
                # Where fields are not given, all values are 0.
                d[x] = fields[0, y, first + x] if used[x] > 0.0 else 1.0
                begun[x] = along[x] * (first + x - view.centre_x) + down[x] * (y - view.centre_y)
                factors[0, x], factors[1, x], factors[2, x] = 1.0 / (d[x] * d[x]), along[x], down[x]
                # With q_Z, images shrink towards the principal point.
                factors[3, x] = -1.0 / view.focal
            sums[:], sides[:], pairs[:], squares[:] = 0.0, 0.0, 0.0, 0.0
            for i in range(count):
                s, s_y, t = view.s[i], view.s_y[i], view.t[i]
                _subtract_known(warped[i, row, first : first + size], texture, known, left)
                for x in range(size):
                    at_x[x], at_y[x], scale[x] = place_of(several > STEADY, view, s, s_y, t, fields, y, first + x)
                _project(along, at_x, down, at_y, known, seen)
                _select_product(scale, d, known, factor)
                _difference(factor, seen, begun, r)
                _scaled(factor, seen, t, p, v)
                _add_product(squares, left, left)
                _accumulate(r, p, v, left, sums, sides, pairs)
                if acceleration:
                    _accumulate_acceleration(0.5 * t, r, p, v, left, sums, sides, pairs)
            if acceleration:
                # Not as an array: the message for other shapes takes half as long to compile as the kernel.
                for x in range(size):
                    pairs[2, 3, x] = pairs[1, 4, x]
            # From here on, 0 where too few images are valid.
            weight, phi = known, d
            for x in range(size):
                # Noise does not vanish in dark pixels.
                by_noise = 1.0 / max(variance[0] + variance[1] * texture[x], LEAST_VARIANCE)
                weight[x] = by_noise if used[x] >= least else 0.0
            for x in range(size):
                inverse[x] = 1.0 / used[x] if used[x] >= least else 0.0
            last = first + size
            for one in range(bases):
                _multiply(sides[one, :size], weight, sides[one, :size])
                for other in range(one, bases):
                    pair = pairs[one, other, :size]
                    _center(pair, sums[one, :size], sums[other, :size], inverse, weight, pair)
            # The sums over M of the fields are those over their bases.
            shares[:] = 0.0
            for k in range(several):
                for x in range(size):
                    phi[x] = fields[k, y, first + x] if used[x] >= least else 0.0
                _multiply(phi, factors[_FACTOR_OF[k], :size], phi)
                _add(shares[_BASIS_OF[k], :size], phi)
            for k in range(several):
                basis, own = _BASIS_OF[k], factors[_FACTOR_OF[k], :size]
                _multiply(sides[basis, :size], own, left)
                _add_product(products[SQUARE_OF[k], row, first:last], left, left)
                for other in range(bases):
                    one, two = min(basis, other), max(basis, other)
                    _multiply(pairs[one, two, :size], own, phi)
                    _add_product(left, phi, shares[other, :size])
                _add(products[SIDE_OF[k], row, first:last], left)
                for m in range(k + 1):
                    one, two = min(basis, _BASIS_OF[m]), max(basis, _BASIS_OF[m])
                    _multiply(pairs[one, two, :size], own, left)
                    _add_product(products[PAIR_OF[k, m], row, first:last], left, factors[_FACTOR_OF[m], :size])
            _add_product(products[14, row, first:last], squares, weight)
            square = products[17, row, first:last]
            for x in range(size):
                square[x] += weight[x] * (along[x] * along[x] + down[x] * down[x])
            numbers, valid = products[15, row, first:last], products[16, row, first:last]
            for x in range(size):
                numbers[x] += used[x] - 1.0 if used[x] >= least else 0.0
                valid[x] += 1.0 if used[x] >= least else 0.0

    return compiled


_ADD_PRODUCTS = {several: _compiled_products(several) for several in (STEADY, ACCELERATED)}


def add_products(
    view: ImageView,
    fields: NDArray[np.float64],
    warped: NDArray[np.float32],
    gradient: NDArray[np.float32],
    first_row: int,
    least: int,
    variance: tuple[float, float],
    products: NDArray[np.float64],
    rows: tuple[int, int],
) -> None:
    """Compute the normal equations of each pixel for disparity and velocity, with the texture as an unknown.

    With a_i = ∇T · ∂x'_i / ∂(d, q), its mean over the images ā, and the mean image as texture T:
    M = Σ_i (a_i - ā)(a_i - ā)ᵀ and b = Σ_i (a_i - ā)(T - g_i). All squares and products of grey values are divided by
    the variance of their noise, relative to that of a mean grey value.

    ``products``: Sums to increment, shape (22, rows, width): the 10 products of M, row by row above the diagonal,
      then the 4 of M (d, q) + b, then Σ_i (g_i - T)², the number of images less one, 1, |∇T|², and the 4 squares of b.
      If the acceleration is a field, shape (46, rows, width): also the columns of M of a_X, a_Y and a_Z down to the
      diagonal, then the other 3 of M (d, q, a) + b, and the other 3 squares of b. Invalid pixels are skipped.
    """
    _ADD_PRODUCTS[len(fields)](view, fields, warped, gradient, first_row, least, variance, products, rows)


@numba.njit(inline="always")
def is_pair(product: int) -> bool:
    """Return whether a product is an element of M."""
    return product < 10 or PRODUCTS <= product < SIDE_OF[STEADY]


@_jit
def add_row(out: Any, weight: float, line: Any) -> None:
    """Add a multiple of a row."""
    for x in range(out.size):
        out[x] += weight * line[x]


@_jit
def dot(weights: Any, values: Any) -> float:
    """Return the weighted sum of values."""
    total = 0.0
    for u in range(weights.size):
        total += weights[u] * values[u]
    return total


@_jit
def _brightness_terms(image: Any, texture: Any, terms: Any) -> None:
    """Write 1, g, h, g h and h² of the pixels of a row with grey values g and texture h, 0 where one is invalid."""
    known, g, h = terms[0], terms[1], terms[2]
    for x in range(known.size):
        both = image[x] + texture[x]
        known[x] = np.float32(0.0) if np.isnan(both) else np.float32(1.0)
    for x in range(known.size):
        g[x] = np.float32(0.0) if known[x] == 0 else image[x]
    for x in range(known.size):
        h[x] = np.float32(0.0) if known[x] == 0 else texture[x]
    _multiply(g, h, terms[3])
    _multiply(h, h, terms[4])


@_jit
def _node_rows(height: int, step: int, first_row: int) -> Any:
    """Return the rows with nodes: the first, every n-th of the image, and the last."""
    first = step - first_row % step
    inner = max((height - 1 - first + step - 1) // step, 0)
    rows = np.empty(inner + 2, dtype=np.int64)
    rows[0], rows[inner + 1] = 0, height - 1
    for n in range(inner):
        rows[n + 1] = first + n * step
    return rows


@_jit
def _estimate_brightness(sums: Any, window: Any, step: int, nodes: Any) -> None:
    """Write gain and offset at every n-th column, and the last, from the sums along the columns of the windows."""
    width = sums.shape[1] - window.shape[0] + 1
    size = window.shape[0]
    for node in range(nodes.shape[1]):
        x = min(node * step, width - 1)
        n, g, h = (
            dot(window, sums[0, x : x + size]),
            dot(window, sums[1, x : x + size]),
            dot(window, sums[2, x : x + size]),
        )
        gh, hh = dot(window, sums[3, x : x + size]), dot(window, sums[4, x : x + size])
        spread = hh * n - h * h
        gain = (gh * n - g * h) / spread if spread > 1e-6 * h * h + 1e-12 else 1.0
        nodes[0, node] = gain if gain > 0.1 else np.nan
        nodes[1, node] = (g - gain * h) / n if n > 0.0 else np.nan


@_jit
def _along_row(nodes: Any, step: int, out: Any) -> None:
    """Interpolate the values of nodes linearly along a row."""
    width, count = out.size, nodes.size
    if count == 1:
        out[:] = nodes[0]
    for node in range(count - 1):
        first, start = nodes[node], node * step
        end = min(start + step, width - 1)
        each = (nodes[node + 1] - first) / (end - start)
        for x in range(start, end):
            out[x] = first + each * (x - start)
        if end == width - 1:
            out[end] = nodes[node + 1]


@_jit
def _remove_brightness(source: Any, above: Any, below: Any, down: Any, target: Any) -> None:
    """Remove gain and offset, shape (2, width) each, interpolated between the rows above and below."""
    gain, offset, second_gain, second_offset = above[0], above[1], below[0], below[1]
    for x in range(source.size):
        own_gain = gain[x] + down * (second_gain[x] - gain[x])
        own_offset = offset[x] + down * (second_offset[x] - offset[x])
        target[x] = (source[x] - own_offset) / own_gain


@_jit
def correct_brightness(
    image: NDArray[np.float32],
    texture: NDArray[np.float32],
    window: NDArray[np.float32],
    step: int,
    first_row: int,
    out: NDArray[np.float32],
) -> None:
    """Remove gain and offset of an image relative to the texture, estimated in the window around every n-th pixel.

    Gain and offset are interpolated linearly; they vary over the width of a window.

    ``image``: Warped grey values, NaN where invalid, shape (rows, width).
    ``texture``: The texture, NaN where invalid, of the same shape.
    ``window``: Weights along either axis, shape (2 r + 1,).
    ``out``: Output; may be the image.
    """
    height, width = image.shape
    reach = window.shape[0] // 2
    rows = _node_rows(height, step, first_row)
    some = np.empty(height, dtype=np.bool_)
    # Sums of the rows of nodes whose windows contain a row, in turn.
    ring = 2 * reach // step + 3
    sums = np.zeros((ring, 5, width + 2 * reach), dtype=np.float32)
    terms = np.empty((5, width), dtype=np.float32)
    nodes = np.empty((2, (width - 1 + step - 1) // step + 1))
    # Gain and offset of all pixels of the rows with nodes.
    lines = np.empty((rows.size, 2, width), dtype=np.float32)
    begun, done = 0, 0
    for y in range(height):
        some[y] = False
        for x in range(width):
            if not np.isnan(texture[y, x]):
                some[y] = True
                break
        while begun < rows.size and rows[begun] <= y + reach:
            sums[begun % ring] = np.float32(0.0)
            begun += 1
        if some[y]:
            _brightness_terms(image[y], texture[y], terms)
            for node in range(done, begun):
                if abs(y - rows[node]) <= reach:
                    weight = window[y - rows[node] + reach]
                    for k in range(5):
                        add_row(sums[node % ring, k, reach : reach + width], weight, terms[k])
        while done < begun and (rows[done] + reach <= y or y == height - 1):
            _estimate_brightness(sums[done % ring], window, step, nodes)
            for k in range(2):
                _along_row(nodes[k], step, lines[done, k])
            done += 1
    place = 0
    for y in range(height):
        if not some[y]:
            out[y] = np.nan
            continue
        while place + 2 < rows.size and rows[place + 1] <= y:
            place += 1
        top, bottom = rows[place], rows[min(place + 1, rows.size - 1)]
        down = (y - top) / (bottom - top) if bottom > top else 0.0
        _remove_brightness(image[y], lines[place], lines[min(place + 1, rows.size - 1)], np.float32(down), out[y])
