"""Decorators that compile kernels with numba, and what is common to all of them."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numba
from llvmlite.binding import ffi  # type: ignore[import-untyped]
from numba.core import codegen, event, types
from numba.core.caching import FunctionCache
from numba.core.environment import lookup_environment
from numba.core.runtime import rtsys

__all__ = ["inlined", "kernel", "subkernel"]

# Compiled code does not hold the interpreter lock, and is not called from C; divisions follow IEEE 754, as in NumPy.
# Functions of numba such as `min` are compiled anew for every combination of options of the kernels that call them.
_COMMON: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}


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


def _do_nothing(*_ignored: Any) -> None:
    pass


def _treat_constants_as_variables(dispatcher: Any) -> None:
    """Prevent that a function is compiled anew for every integer with which a kernel calls it."""
    find = dispatcher.get_call_template

    def find_for_any(args: Any, kws: Any) -> Any:
        return find(tuple(map(types.unliteral, args)), {name: types.unliteral(kws[name]) for name in kws})

    dispatcher.get_call_template = find_for_any


def subkernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function for kernels that call it; Python calls what is not compiled.

    What converts the arguments and results of compiled functions for Python takes long to compile.
    """
    compiled = kernel(cache=False, no_cpython_wrapper=True, **options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        _treat_constants_as_variables(dispatcher)
        dispatcher._insert = _do_nothing
        dispatcher._compile_for_args = lambda *_args, **_kws: function
        return dispatcher

    return decorate


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function whose code becomes part of every kernel that calls it.

    Its types are inferred once, instead of once for every call as with ``inline="always"``.
    """
    return subkernel(forceinline=True)(function)


_compiling: list[Any] = []
"""Dispatchers of what is being compiled, each for the one before; numba compiles in one thread at a time."""


class _CompilationWatch(event.Listener):  # type: ignore[misc]
    """Note what is being compiled, and suspend the garbage collector meanwhile.

    The compiler creates many objects that live as long as it runs, which the collector visits again and again: an
    eighth of the time.
    """

    def __init__(self) -> None:
        self._resumes = False

    def on_start(self, event: Any) -> None:
        if not _compiling:
            self._resumes = gc.isenabled()
            gc.disable()
        _compiling.append(event.data["dispatcher"])

    def on_end(self, event: Any) -> None:
        _compiling.pop()
        if not _compiling and self._resumes:
            gc.enable()


event.register("numba:compile", _CompilationWatch())


def _is_only_linked() -> bool:
    """Return whether what is being compiled is a function for one of our kernels that Python cannot call."""
    return (
        len(_compiling) > 1
        and isinstance(getattr(_compiling[0], "_cache", None), _KernelCache)
        and _compiling[-1].targetoptions.get("no_cpython_wrapper", False)
    )


class _Library(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Compiled code; what only becomes part of kernels has no machine code of its own: a tenth of compiling.

    Kernels contain the functions that they call, and numba optimises them again as a whole.
    """

    def _finalize_final_module(self) -> None:
        if _is_only_linked():
            self._finalize_dynamic_globals()
            self._finalized = True
            return
        super()._finalize_final_module()
        # Those of the functions that have become part of this one.
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                self._codegen.set_env(variable.name, environment)


_set_environment = codegen.JITCPUCodegen.set_env


def _set_if_compiled(self: Any, name: str, environment: Any) -> None:
    """Set the address of an environment of machine code, if there is any."""
    if self._engine.get_global_value_address(name):
        _set_environment(self, name, environment)


codegen.JITCPUCodegen._library_class = _Library
codegen.JITCPUCodegen.set_env = _set_if_compiled


def _stop_watch() -> None:
    """Take away what numba does at every call of LLVM: it adds up times that nobody reads, a twelfth of compiling.

    Numba registers local functions, which the public function of llvmlite cannot remove.
    """
    callbacks = getattr(getattr(ffi.lib, "_lock", None), "_cblist", None)
    if isinstance(callbacks, list):
        callbacks[:] = [pair for pair in callbacks if pair[0].__module__ != "numba.core.base"]


_stop_watch()
