"""An estimate and its truth, some frames at a time."""

from __future__ import annotations

from collections.abc import Iterator

import xarray as xr

from scenetruth.scoring.alignment import align

__all__ = ["aligned_parts", "part_count", "parts_of"]

_PIXELS = 1_500_000
"""How many pixels of all frames of a part together; a frame is never parted."""


def part_count(estimate: xr.Dataset) -> int:
    """Return in how many parts `aligned_parts` gives an estimate."""
    return -(-estimate.sizes["t"] // _frames(estimate))


def aligned_parts(estimate: xr.Dataset, truth: xr.Dataset) -> Iterator[tuple[xr.Dataset, xr.Dataset]]:
    """Give successive frames of an estimate, each time with the part of the truth that they can be compared with.

    Parameters
    ----------
    estimate, truth
        As of `align`; they may have been opened and not loaded.

    Raises
    ------
    ScoreError
        If they cannot be compared; as by `align`.
    """
    for part in parts_of(estimate):
        yield align(part, truth)


def parts_of(estimate: xr.Dataset) -> Iterator[xr.Dataset]:
    """Give successive frames of an estimate."""
    count = _frames(estimate)
    for first in range(0, estimate.sizes["t"], count):
        yield estimate.isel(t=slice(first, first + count))


def _frames(estimate: xr.Dataset) -> int:
    return max(1, _PIXELS // max(1, estimate.sizes["y"] * estimate.sizes["x"]))
