"""Minimal kernel, whose absence from the cache of numba indicates the first run on a machine."""

from scenetruth.kernels import kernel

__all__ = ["probe_kernel"]


@kernel()
def probe_kernel() -> int:
    """Return 0."""
    return 0
