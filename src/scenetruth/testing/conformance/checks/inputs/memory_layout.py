"""Images give the same estimate however they lie in memory: by columns first, or as part of a larger array."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_to_rounding, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Lay them out anew."""
    for layout in ("by columns first (Fortran order)", "every second value of a larger array", "backwards"):
        recording = bench.recording()
        values = recording["image"].values
        if "columns" in layout:
            laid = np.asfortranarray(values)
        elif "second" in layout:
            larger = np.full(tuple(2 * size for size in values.shape), np.nan, dtype=values.dtype)
            laid = larger[tuple(slice(None, None, 2) for _ in values.shape)]
            laid[...] = values
        else:
            laid = np.ascontiguousarray(np.flip(values))
            laid = np.flip(laid)
        recording = recording.assign(image=(recording["image"].dims, laid, recording["image"].attrs))
        near_to_rounding(
            scalar_maps(bench.estimate(recording)),
            scalar_maps(bench.plain),
            done=f"the images lay in memory {layout}",
            expectation="the same estimate but for rounding",
            remedy="take np.ascontiguousarray(...) of images before code that needs them so; never reshape by strides",
        )
