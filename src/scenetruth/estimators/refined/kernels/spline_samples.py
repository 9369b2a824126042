"""Samples of cubic and quintic B-splines and their derivatives at one point, with vector instructions."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from scenetruth.kernels import kernel

__all__ = [
    "TAPS",
    "cubic_values",
    "cubic_weights",
    "quintic_values",
    "quintic_weights",
    "sample_cubic",
    "sample_quintic",
]


_jit = kernel(error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})

TAPS = 6


@numba.njit(inline="always")
def _far(f: Any) -> Any:
    """Return 120 times the quintic B-spline at the distance 2 - f, for f from 0 to 1."""
    return 1.0 + f * (5.0 + f * (10.0 + f * (10.0 + f * (5.0 - 5.0 * f))))


@numba.njit(inline="always")
def _far_slope(f: Any) -> Any:
    return 5.0 + f * (20.0 + f * (30.0 + f * (20.0 - 25.0 * f)))


@numba.njit(inline="always")
def _near(f: Any) -> Any:
    """Return 120 times the quintic B-spline at the distance 1 - f, for f from 0 to 1."""
    return 26.0 + f * (50.0 + f * (20.0 + f * (-20.0 + f * (-20.0 + 10.0 * f))))


@numba.njit(inline="always")
def _near_slope(f: Any) -> Any:
    return 50.0 + f * (40.0 + f * (-60.0 + f * (-80.0 + 50.0 * f)))


@_jit
def cubic_weights(f: float, w: Any, dw: Any) -> None:
    """Write the weights of six coefficients of a cubic spline, with outer weights 0, as `quintic_weights`."""
    g = 1.0 - f
    w[0], w[1], w[2] = 0.0, g**3 / 6.0, 2.0 / 3.0 - 0.5 * f * f * (2.0 - f)
    w[3], w[4], w[5] = 2.0 / 3.0 - 0.5 * g * g * (2.0 - g), f**3 / 6.0, 0.0
    dw[0], dw[1], dw[2] = 0.0, -0.5 * g * g, f * (1.5 * f - 2.0)
    dw[3], dw[4], dw[5] = g * (2.0 - 1.5 * g), 0.5 * f * f, 0.0


@_jit
def quintic_weights(f: float, w: Any, dw: Any) -> None:
    """Write the weights of six coefficients at a fraction f of a step, and their derivatives."""
    g = 1.0 - f
    w[0], w[1], w[2] = g**5 / 120.0, _far(g) / 120.0, _near(g) / 120.0
    w[3], w[4], w[5] = _near(f) / 120.0, _far(f) / 120.0, f**5 / 120.0
    dw[0], dw[1], dw[2] = -(g**4) / 24.0, -_far_slope(g) / 120.0, -_near_slope(g) / 120.0
    dw[3], dw[4], dw[5] = _near_slope(f) / 120.0, _far_slope(f) / 120.0, f**4 / 24.0


def _compiled_samples(pieces: list[Any], lanes: int, *, slopes: bool = True) -> Any:
    """Return an intrinsic that samples a spline from its polynomial pieces, one for each of the taps.

    It takes image (flat), offset of its first coefficient, width, and the fractions of a step along x and y, and
    returns the value and its derivatives along x and y. All taps along x are in one vector, with lanes of weight zero.

    ``slopes``: Whether derivatives are required; otherwise, only the value is returned.
    """
    taps = len(pieces)

    def columns(polynomials: list[Any]) -> Any:
        """Return the coefficients of all lanes, from the highest power."""
        most = max(each.order for each in polynomials)
        table = np.zeros((most + 1, lanes))
        for lane, each in enumerate(polynomials):
            table[most - each.order :, lane] = each.coeffs
        return np.asarray(table, dtype=np.float32).astype(np.float64).tolist()

    by_value, by_slope = columns(pieces), columns([np.polyder(piece) for piece in pieces])
    single, index = ir.FloatType(), ir.IntType(32)
    vector = ir.VectorType(single, lanes)
    fast = ("contract", "reassoc", "nsz")

    @intrinsic
    def sampled(typing_context: Any, image: Any, offset: Any, width: Any, right: Any, down: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            flat, first, stride, x, y = arguments
            data = context.make_array(signature.args[0])(context, builder, flat).data
            undefined = ir.Constant(vector, ir.Undefined)

            def spread(values: Any, lane: int) -> Any:
                mask = ir.Constant(ir.VectorType(index, lanes), [ir.Constant(index, lane)] * lanes)
                return builder.shuffle_vector(values, undefined, mask)

            def add(a: Any, b: Any, c: Any) -> Any:
                return builder.fadd(builder.fmul(a, b, flags=fast), c, flags=fast)

            def constant(values: list[float]) -> Any:
                return ir.Constant(vector, [ir.Constant(single, value) for value in values])

            def polynomial(table: list[list[float]], at: Any) -> Any:
                total = constant(table[0])
                for line in table[1:]:
                    total = add(total, at, constant(line))
                return total

            along, below = (
                spread(builder.insert_element(undefined, each, ir.Constant(index, 0)), 0) for each in (x, y)
            )
            weights = polynomial(by_value, below)
            differences = polynomial(by_slope, below) if slopes else weights
            start, zero = builder.gep(data, [first]), constant([0.0] * lanes)
            value, slope = zero, zero
            for k in range(taps):
                place = builder.gep(start, [builder.mul(stride, ir.Constant(stride.type, k))])
                line = builder.load(builder.bitcast(place, vector.as_pointer()))
                line.align = 4
                value = add(spread(weights, k), line, value)
                slope = add(spread(differences, k), line, slope) if slopes else slope
            kind = ir.FunctionType(single, [single, vector])
            total = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{lanes}f32")
            weights = polynomial(by_value, along)
            terms = [(weights, value)]
            if slopes:
                terms += [(polynomial(by_slope, along), value), (weights, slope)]
            found = [
                builder.call(total, [ir.Constant(single, 0.0), builder.fmul(*pair, flags=fast)], fastmath=("reassoc",))
                for pair in terms
            ]
            return context.make_tuple(builder, signature.return_type, found) if slopes else found[0]

        kind = types.UniTuple(types.float32, 3) if slopes else types.float32
        return kind(image, types.int64, types.int64, types.float32, types.float32), generate

    return sampled


def _mirrored(pieces: list[Any]) -> list[Any]:
    """Return the pieces of all taps, from those of the second half."""
    return [piece(np.poly1d([-1.0, 1.0])) for piece in reversed(pieces)] + pieces


_QUINTIC = [np.poly1d(each) / 120.0 for each in ([10, -20, -20, 20, 50, 26], [-5, 5, 10, 10, 5, 1], [1, 0, 0, 0, 0, 0])]
_CUBIC = [np.poly1d(each) / 6.0 for each in ([-3, 3, 3, 1], [1, 0, 0, 0])]
_quintic = _compiled_samples(_mirrored(_QUINTIC), 8)
_cubic = _compiled_samples(_mirrored(_CUBIC), 4)
_quintic_value = _compiled_samples(_mirrored(_QUINTIC), 8, slopes=False)
_cubic_value = _compiled_samples(_mirrored(_CUBIC), 4, slopes=False)
_BEYOND = 8 - TAPS  # coefficients read beyond the last tap, of weight zero


@_jit
def _sample_plainly(cubic: bool, image: Any, offset: int, width: int, right: Any, down: Any) -> Any:
    """Return the same as `sample_quintic` for one point, without reading beyond the last tap."""
    wx, wy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
    dx, dy = np.empty(TAPS, dtype=np.float32), np.empty(TAPS, dtype=np.float32)
    if cubic:
        cubic_weights(right, wx, dx)
        cubic_weights(down, wy, dy)
    else:
        quintic_weights(right, wx, dx)
        quintic_weights(down, wy, dy)
    value, along, below = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(TAPS):
        a, b = np.float32(0.0), np.float32(0.0)
        for j in range(TAPS):
            c = image[offset + k * width + j]
            a += wx[j] * c
            b += dx[j] * c
        value += wy[k] * a
        along += wy[k] * b
        below += dy[k] * a
    return value, along, below


# Functions in a closure would prevent caching.
def _compiled_row(*, cubic: bool) -> Any:
    @_jit
    def compiled(image: Any, offsets: Any, width: Any, right: Any, down: Any, out: Any) -> None:
        values, along, below = out[0], out[1], out[2]
        last = image.size - (TAPS - 1) * width - TAPS - _BEYOND
        beyond = False
        for n in range(offsets.size):
            if not (offsets[n] >= 0 and offsets[n] <= last):
                continue
            if cubic:
                values[n], along[n], below[n] = _cubic(image, offsets[n] + width + 1, width, right[n], down[n])
            else:
                values[n], along[n], below[n] = _quintic(image, offsets[n], width, right[n], down[n])
        for n in range(offsets.size):
            beyond = beyond or offsets[n] > last
        if beyond:
            for n in range(offsets.size):
                if offsets[n] > last:
                    values[n], along[n], below[n] = _sample_plainly(cubic, image, offsets[n], width, right[n], down[n])

    return compiled


sample_cubic, sample_quintic = _compiled_row(cubic=True), _compiled_row(cubic=False)
"""Functions that sample a spline and its derivatives along x and y at several points.

``image``: All coefficients of the image, flat: NDArray[np.float32], shape (height * width,).
``offsets``: Index of the coefficient two rows above and two columns left of the integer part of each position; negative
  for points to be skipped.
``right``, ``down``: Fractions of a step along x and y, float32.
``out``: Output: values and derivatives along x and y, shape (3, n).
"""


def _compiled_values(*, cubic: bool) -> Any:
    @_jit
    def compiled(image: Any, offsets: Any, width: Any, right: Any, down: Any, out: Any) -> None:
        last = image.size - (TAPS - 1) * width - TAPS - _BEYOND
        beyond = False
        for n in range(offsets.size):
            if not (offsets[n] >= 0 and offsets[n] <= last):
                beyond = beyond or offsets[n] > last
            elif cubic:
                out[n] = _cubic_value(image, offsets[n] + width + 1, width, right[n], down[n])
            else:
                out[n] = _quintic_value(image, offsets[n], width, right[n], down[n])
        if beyond:
            for n in range(offsets.size):
                if offsets[n] > last:
                    out[n], _, _ = _sample_plainly(cubic, image, offsets[n], width, right[n], down[n])

    return compiled


cubic_values, quintic_values = _compiled_values(cubic=True), _compiled_values(cubic=False)
"""Functions that sample a spline at several points, as `sample_cubic`, with values only, shape (n,)."""
