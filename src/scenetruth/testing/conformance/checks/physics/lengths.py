"""With ten times the baseline and the same images, depth and velocity are ten times as large, nothing else is."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_to_rounding, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(any_of=("depth", "disparity"), cameras=2)
_TIMES = 10.0
_LENGTHS = ("depth", "velocity_x", "velocity_y", "velocity_z")


def check(bench: Bench) -> None:
    """Change the unit of length, in effect."""
    recording = bench.plane.recording(baseline_mm=_TIMES * bench.plane.baseline_mm)
    before = scalar_maps(bench.plain)
    near_to_rounding(
        scalar_maps(bench.estimate(recording)),
        {name: item * _TIMES if name in _LENGTHS else item for name, item in before.items()},
        done=f"baseline_mm and stage_x_mm were {_TIMES:g} times as large, the images the same",
        expectation=f"depth and velocity {_TIMES:g} times as large, disparity and flow the same, but for rounding",
        remedy="images know pixels only: lengths enter at the end, by f V_X / disparity; take no thresholds in mm",
    )
