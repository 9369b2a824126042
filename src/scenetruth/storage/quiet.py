"""What zarr warns of, and users need not hear."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["without_warnings"]

_lock = threading.Lock()
_inside = 0
_filters: warnings.catch_warnings[None] | None = None


@contextmanager
def without_warnings() -> Iterator[None]:
    """Silence what zarr warns of: short strings, consolidated metadata and pcodec are not yet in its specification.

    Several threads may be inside at a time: filters are the same for all threads, so that the first one in sets them
    and the last one out restores them.
    """
    global _inside, _filters
    if getattr(sys.flags, "context_aware_warnings", False):
        # Newer Pythons may keep filters for each thread.
        with warnings.catch_warnings():
            _silence()
            yield
        return
    with _lock:
        if _inside == 0:
            _filters = warnings.catch_warnings()
            _filters.__enter__()
            _silence()
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _filters is not None:
                _filters.__exit__(None, None, None)
                _filters = None


def _silence() -> None:
    import zarr.errors

    for name in ("UnstableSpecificationWarning", "ZarrUserWarning"):
        warnings.filterwarnings("ignore", category=getattr(zarr.errors, name, FutureWarning))
    warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3")
