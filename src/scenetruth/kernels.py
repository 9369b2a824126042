"""Decorators that compile kernels with numba, and what is common to all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys

__all__ = ["inlined", "kernel"]

# Compiled code does not hold the interpreter lock, and is not called from C.
_COMMON: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True}


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """Compiled code on disk, loaded with the runtime of numba only.

    The declarations of all that numba compiles take 0.26 s, and are loaded when a kernel is compiled.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


def kernel(*, cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function; ``options`` are those of `numba.njit`."""
    compiled = numba.njit(**{**_COMMON, **options})

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if cache:
            dispatcher._cache = _KernelCache(function)
        # Packages that extend numba are searched when a kernel is compiled.
        dispatcher._compilation_chain_init_hook = _do_nothing
        return dispatcher

    return decorate


def _do_nothing() -> None:
    pass


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
