"""Compiler intrinsics for numba kernels: fused multiply-add, and arithmetic of small integers without widening."""

from __future__ import annotations

from typing import Any

from numba.extending import intrinsic

__all__ = ["add", "fma", "least", "ones", "subtract"]


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Compute a b + c with one rounding, for one floating type; independent of compiler contraction and inlining."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return c(a, b, c), generate


@intrinsic
def add(typing_context: Any, a: Any, b: Any) -> Any:
    """Add two integers of one type; overflow wraps around."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.add(*arguments)

    return a(a, a), generate


@intrinsic
def subtract(typing_context: Any, a: Any, b: Any) -> Any:
    """Subtract two integers of one type; underflow wraps around."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.sub(*arguments)

    return a(a, a), generate


@intrinsic
def least(typing_context: Any, a: Any, b: Any) -> Any:
    """Return the smaller of two unsigned integers of one type."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(builder.icmp_unsigned("<", *arguments), *arguments)

    return a(a, a), generate


@intrinsic
def ones(typing_context: Any, a: Any) -> Any:
    """Return the number of set bits of an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(*arguments)

    return a(a), generate
