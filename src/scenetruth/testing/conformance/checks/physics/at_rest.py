"""A plane at rest has no flow and no velocity."""

from __future__ import annotations

from dataclasses import replace

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(any_of=("flow_x", "velocity_x", "velocity_z"), frames=2)


def check(bench: Bench) -> None:
    """Stop it."""
    plane = replace(bench.plane, velocity_mm=(0.0, 0.0, 0.0))
    bench.agrees(
        scalar_maps(bench.estimate(plane.recording())),
        bench.known_of(plane.truth()),
        done="all frames showed the same",
        expectation="no flow, no velocity and the true depth, within three times the method's own error with motion",
        remedy="look for what takes disparity or slope for motion, and for exact zeros that are taken as missing",
    )
