"""Decorators that compile kernels with numba, and what is common to all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

__all__ = ["inlined", "kernel"]

# Compiled code is kept, does not hold the interpreter lock, and is not called from C.
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "no_cfunc_wrapper": True}


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function; ``options`` are those of `numba.njit`."""
    return numba.njit(**{**_COMMON, **options})  # type: ignore[no-any-return]


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function whose code becomes part of every kernel that calls it.

    Its types are inferred once, instead of once for every call as with ``inline="always"``.
    """
    return kernel(error_model="numpy", forceinline=True)(function)


class _CollectorPause(event.Listener):  # type: ignore[misc]
    """Suspend the garbage collector while a kernel is compiled.

    The compiler creates many objects that live as long as it runs, which the collector visits again and again: an
    eighth of the time.
    """

    def __init__(self) -> None:
        self._depth = 0
        self._resumes = False

    def on_start(self, event: Any) -> None:
        if self._depth == 0:
            self._resumes = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0 and self._resumes:
            gc.enable()


event.register("numba:compile", _CollectorPause())
