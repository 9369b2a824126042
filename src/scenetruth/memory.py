"""Freed memory: retention for the next arrays, and return to the system (C library of GNU only)."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["keep_freed_memory", "release_memory", "retained_memory"]


# Options of mallopt in glibc, and their values while memory is retained and, as large arrays set them, otherwise.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_RETAINED = {_TRIM_THRESHOLD: 2**31 - 1, _MMAP_THRESHOLD: 2**30}
_USUAL = {_TRIM_THRESHOLD: 2**26, _MMAP_THRESHOLD: 2**25}


def release_memory() -> None:
    """Return freed memory to the system: the C library retains that of small arrays."""
    trim = _function("malloc_trim")
    if trim is not None:
        trim(0)


@contextmanager
def retained_memory() -> Iterator[None]:
    """Retain freed memory until `release_memory`, for the next arrays: the system clears the pages of new memory.

    Without it, each array of more than some MB is allocated and cleared anew: 490,000 pages for 45 images of a cube of
    640 x 480 px with truth instead of 52,000, and a second more.
    """
    option = _function("mallopt")
    if option is None:
        yield
        return
    for each in _RETAINED.items():
        option(*each)
    try:
        yield
    finally:
        for each in _USUAL.items():
            option(*each)
        release_memory()


def keep_freed_memory() -> None:
    """Restore the default of the C library to retain freed memory, which Dask disables.

    Dask starts its workers with ``MALLOC_TRIM_THRESHOLD_=65536``, so that the pages of every large array are allocated
    and cleared anew: 356,000 pages for a noise cube of 320 x 240 px instead of 2,500, and 0.9 s more.
    """
    option = _function("mallopt")
    if option is not None and "MALLOC_TRIM_THRESHOLD_" in os.environ:
        for each in _USUAL.items():
            option(*each)


def _function(name: str) -> Any:
    """Return a function that is specific to glibc, None in other C libraries."""
    return getattr(ctypes.CDLL(None), name, None) if os.name == "posix" else None
