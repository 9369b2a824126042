"""Value of a cubic B-spline from the sixteen coefficients around a point, with vector instructions."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

__all__ = ["spline_value"]

_LANES = 4
_SINGLE, _INDEX = ir.FloatType(), ir.IntType(32)
_VECTOR = ir.VectorType(_SINGLE, _LANES)
# Lanes of the cubes, followed by those of the polynomials between them, that are the weights along x, and along y.
_ALONG, _BELOW = (1, 4, 5, 0), (3, 6, 7, 2)


@intrinsic
def spline_value(typing_context: Any, flat: Any, first: Any, stride: Any, right: Any, below: Any) -> Any:
    """Return 36 times the value of a spline, from its coefficients in row-major order.

    Compilers do not combine the sixteen products. Nothing is reassociated, for the same bytes on all processors: the
    weights are those of `cubic_weights`, and the sums those of single values, down each column and then in pairs.

    ``first``, ``stride``: Place of the first coefficient, and number of coefficients in a row.
    ``right``, ``below``: Position between the second and the third coefficient, from 0 to 1, float32.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        flat, first, stride, right, below = arguments
        one = ir.Constant(_SINGLE, 1.0)
        undefined = ir.Constant(_VECTOR, ir.Undefined)

        def mixed(values: Any, others: Any, lanes: tuple[int, ...]) -> Any:
            mask = ir.Constant(ir.VectorType(_INDEX, _LANES), [ir.Constant(_INDEX, lane) for lane in lanes])
            return builder.shuffle_vector(values, others, mask)

        def constant(value: float) -> Any:
            return ir.Constant(_VECTOR, [ir.Constant(_SINGLE, value)] * _LANES)

        shares = undefined
        for lane, share in enumerate((right, builder.fsub(one, right), below, builder.fsub(one, below))):
            shares = builder.insert_element(shares, share, ir.Constant(_INDEX, lane))
        cubes = builder.fmul(builder.fmul(shares, shares), shares)
        middle = builder.fsub(constant(4.0), builder.fmul(builder.fmul(constant(6.0), shares), shares))
        middle = builder.fadd(middle, builder.fmul(constant(3.0), cubes))
        place = builder.gep(context.make_array(signature.args[0])(context, builder, flat).data, [first])
        columns = None
        for lane in _BELOW:
            line = builder.load(builder.bitcast(place, _VECTOR.as_pointer()))
            line.align = 4
            part = builder.fmul(mixed(cubes, middle, (lane,) * _LANES), line)
            columns = part if columns is None else builder.fadd(columns, part)
            place = builder.gep(place, [stride])
        terms = builder.fmul(mixed(cubes, middle, _ALONG), columns)
        pairs = builder.fadd(terms, mixed(terms, undefined, (1, 0, 3, 2)))
        left, rest = (builder.extract_element(pairs, ir.Constant(_INDEX, lane)) for lane in (0, 2))
        return builder.fadd(left, rest)

    if not (isinstance(flat, types.Array) and flat.dtype == types.float32):
        return None
    return types.float32(flat, types.int64, types.int64, types.float32, types.float32), generate
