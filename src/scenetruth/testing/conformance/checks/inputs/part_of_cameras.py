"""Cameras on one side of the reference only, told apart by `s` and `stage_x_mm`, give depth that is right."""

from __future__ import annotations

from dataclasses import replace

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_in_the_middle, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(any_of=("depth", "disparity", "flow_x"), cameras=2)


def check(bench: Bench) -> None:
    """Keep the cameras from s = 0 to one side, then to the other."""
    count = max(2, bench.method.needs.cameras)
    plane = replace(bench.plane, cameras=2 * count - 1)
    recording = plane.recording()
    for side, part in (("right", slice(0, None)), ("left", slice(None, 0))):
        found = bench.estimate_if_it_suits(recording.sel(s=part))
        steps = recording["s"].sel(s=part).values.tolist()
        near_in_the_middle(
            scalar_maps(found),
            plane.truth(),
            ("depth", "disparity", "flow_x", "flow_y"),
            done=f"only the reference and cameras to its {side} were there, s = {steps}",
            remedy="find the reference by recording.sel(s=0), and where cameras stand in stage_x_mm, not by their "
            "place in the array",
        )
