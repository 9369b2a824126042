"""Another time between frames changes nothing: flow and velocity are per frame."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_to_rounding, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_SECONDS = 0.04


def check(bench: Bench) -> None:
    """Say that the camera is quick."""
    recording = bench.plane.recording(frame_interval_s=_SECONDS)
    near_to_rounding(
        scalar_maps(bench.estimate(recording)),
        scalar_maps(bench.plain),
        done=f"frame_interval_s was {_SECONDS:g} instead of 1, the images the same",
        expectation="the same estimate: px per frame and mm per frame",
        remedy="do not divide by frame_interval_s",
    )
