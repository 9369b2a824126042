"""One NaN pixel is refused by an error that says so, or leaves the rest of the estimate as it was."""

from __future__ import annotations

import numpy as np

from scenetruth.errors import ScenetruthError
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_AWAY_PX = 24
"""Further away, windows of usual size do not hold the pixel."""
_WORDS = ("finite", "nan", "missing", "mask", "not a number")
_REMEDY = (
    "raise EstimateError([Problem('image', 'holds values that are not finite')]) where images are not finite, or leave "
    "such pixels out"
)


def check(bench: Bench) -> None:
    """Put it near the upper left corner of the reference image."""
    images = bench.plane.images()
    height, width = bench.plane.size
    row, column = height // 8, width // 8
    images[(images.shape[0] - 1) // 2, (images.shape[1] - 1) // 2, row, column] = np.nan
    done = f"the pixel (x, y) = ({column}, {row}) of the reference image was NaN"
    try:
        found = bench.estimate(bench.plane.recording(images))
    except ScenetruthError as error:
        if any(word in str(error).lower() for word in _WORDS):
            return
        told = " ".join(str(error).split())
        raise Deviation(done, "an error that says so, or an estimate", f"another error: {told}", _REMEDY) from error
    away = {
        name: item.where((abs(item["x"] - column) > _AWAY_PX) | (abs(item["y"] - row) > _AWAY_PX))
        for name, item in bench.maps.items()
    }
    bench.agrees(
        scalar_maps(found),
        away,
        done=done,
        expectation=f"the same estimate more than {_AWAY_PX} px away, or an error that says so",
        remedy=_REMEDY,
    )
