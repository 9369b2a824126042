"""Settings of all processes of a comparison: compare_checkouts.py copies this file as sitecustomize.py."""

from __future__ import annotations

import os
from importlib import metadata
from typing import Any

__all__: list[str] = []

_version_of = metadata.version


def _version(distribution_name: str) -> str:
    """Return one version of scenetruth for both checkouts: it belongs to the installation, and most files hold it."""
    return "0.0.0" if distribution_name == "scenetruth" else _version_of(distribution_name)


def _compile_exactly() -> None:
    """Let numba compile without fast mathematics.

    With it, roundings depend on names of modules, on the order of functions, and on which of them a process compiles
    itself and which it reads from the cache.
    """
    import numba

    njit = numba.njit

    def exact(*args: Any, **options: Any) -> Any:
        return njit(*args, **{name: value for name, value in options.items() if name != "fastmath"})

    numba.njit = exact


metadata.version = _version
if os.environ.get("COMPARISON_EXACT"):
    _compile_exactly()
