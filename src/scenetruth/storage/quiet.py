"""What zarr warns of, and users need not hear."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["without_warnings"]


@contextmanager
def without_warnings() -> Iterator[None]:
    """Silence what zarr warns of: short strings, consolidated metadata and pcodec are not yet in its specification."""
    import zarr.errors

    with warnings.catch_warnings():
        for name in ("UnstableSpecificationWarning", "ZarrUserWarning"):
            warnings.filterwarnings("ignore", category=getattr(zarr.errors, name, FutureWarning))
        warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3")
        yield
