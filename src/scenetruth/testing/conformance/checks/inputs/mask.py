"""Pixels that the recording's mask marks are left out: what they hold does not spoil those around them."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps
from scenetruth.testing.conformance.deviation import NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need(plain=False)
_SIDE_PX = 4
_NEAR_PX = 10
"""Closer than this, windows of usual size hold marked pixels."""


def check(bench: Bench) -> None:
    """Mark a square in the middle of all images, and fill it with black and white."""
    if not bench.method.needs.mask:
        msg = "the method refuses recordings with a mask: it has no Needs(mask=True)"
        raise NotApplicable(msg)
    images = bench.plane.images()
    height, width = bench.plane.size
    row, column = (height - _SIDE_PX) // 2, (width - _SIDE_PX) // 2
    square = (slice(row, row + _SIDE_PX), slice(column, column + _SIDE_PX))
    mask = np.zeros((height, width), dtype=bool)
    mask[square] = True
    pattern = np.indices((_SIDE_PX, _SIDE_PX)).sum(axis=0) % 2
    images[(slice(None), slice(None), *square)] = pattern if images.ndim == 4 else pattern[..., None]
    found = bench.estimate(bench.plane.recording(images, mask=mask))
    around = np.zeros((height, width), dtype=bool)
    around[row - _NEAR_PX : row + _SIDE_PX + _NEAR_PX, column - _NEAR_PX : column + _SIDE_PX + _NEAR_PX] = True
    ring = xr.DataArray(around & ~mask, {"y": np.arange(height), "x": np.arange(width)}, ("y", "x"))
    bench.agrees(
        scalar_maps(found),
        {name: item.where(ring) for name, item in bench.maps.items()},
        done=f"a square of {_SIDE_PX} px in the middle of all images was masked and held a chequerboard",
        expectation=f"the same estimate up to {_NEAR_PX} px around it, within three times the method's own error",
        remedy="give masked pixels no weight, or take mask=True from `needs`: such recordings are refused then",
    )
