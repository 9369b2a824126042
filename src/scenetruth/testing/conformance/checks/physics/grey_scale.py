"""Images of less contrast and another brightness give the same estimate."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_GAIN, _OFFSET = 0.7, 0.2
_LEAST_KEPT = 0.1
"""Thresholds on contrast may leave fewer pixels; if they leave none, nothing can be compared."""


def check(bench: Bench) -> None:
    """Change gain and offset of all images alike."""
    images = _GAIN * bench.plane.images() + _OFFSET
    bench.agrees(
        scalar_maps(bench.estimate(bench.plane.recording(images))),
        done=f"all images were made {_GAIN:g} times as bright, and {_OFFSET:g} of full scale was added",
        expectation="the same estimate within three times the method's own error",
        remedy="depth and motion are ratios of differences of grey values: look for one that is used by itself",
        least_kept=_LEAST_KEPT,
    )
