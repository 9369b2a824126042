"""The fused multiplication and addition of kernels: rounded once, and the same from every compilation."""

from __future__ import annotations

from typing import Any

from numba.extending import intrinsic

__all__ = ["fma"]


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Compute a b + c with one rounding; a, b and c are of one floating type.

    Leaving the choice of what to fuse to the compiler (fast mathematics) makes results depend on what it happened to
    inline.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return c(a, b, c), generate
