"""Cameras numbered from right to left, with a negative baseline, give the same depth and velocity."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import changed_sign, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(any_of=("depth", "disparity"), cameras=2, odd_cameras=True)


def check(bench: Bench) -> None:
    """Exchange the cameras and their positions: the same images from the same places, under other numbers."""
    recording = bench.plane.recording(bench.plane.images()[::-1], baseline_mm=-bench.plane.baseline_mm)
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    bench.agrees(
        changed_sign(found, ("disparity",)),
        done="the cameras were numbered from right to left: stage_x_mm falls with s, baseline_mm is negative",
        expectation="the same depth and velocity, disparity with the other sign, within three times the method's own "
        "error",
        remedy="take where cameras stand from stage_x_mm and baseline_mm; x_s = x_0 - disparity s",
    )
