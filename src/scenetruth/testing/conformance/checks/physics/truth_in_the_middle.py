"""Depth, disparity, flow and velocity of the plain recording have the right sign and size."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_in_the_middle

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Compare with the truth, in the median."""
    plane = bench.plane
    near_in_the_middle(
        bench.maps,
        plane.truth(),
        bench.maps,
        done=f"a plane at {plane.depth_mm:g} mm was estimated that moves by {plane.velocity_mm} mm per frame",
        remedy="docs/conventions.md: x_s = x_0 - disparity s, depth Z in mm along the optical axis, flow and velocity "
        "forward in time per frame, Y down, U_Z < 0 comes nearer",
    )
