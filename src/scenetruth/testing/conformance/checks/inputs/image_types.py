"""The same images as float32, float64 and digital numbers of 16 bits give the same estimate."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_FACTOR = 1.0
"""Quantisation to 16 bits is far below any method's own error."""


def check(bench: Bench) -> None:
    """Estimate each."""
    for dtype, full_scale in ((np.float64, 1.0), (np.uint16, 65535.0)):
        found = bench.estimate(bench.plane.recording(dtype=dtype, full_scale=full_scale))
        bench.agrees(
            scalar_maps(found),
            done=f"the images were given as {np.dtype(dtype).name} with full_scale {full_scale:g} instead of float32",
            expectation="the same estimate within the method's own error",
            remedy="convert images first: recording['image'].values.astype(float) / recording.attrs['full_scale']; "
            "differences of unsigned integers wrap around",
            factor=_FACTOR,
        )
