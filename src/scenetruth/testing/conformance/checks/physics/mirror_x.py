"""In a mirror, left and right exchanged, depth is mirrored and U_X changes its sign."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import changed_sign, flipped, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(odd_cameras=True)


def check(bench: Bench) -> None:
    """Turn the images and the order of the cameras around."""
    images = bench.plane.images()[::-1, :, :, ::-1]
    found = flipped(scalar_maps(bench.estimate(bench.plane.recording(images))), "x")
    bench.agrees(
        changed_sign(found, ("flow_x", "velocity_x")),
        done="the images were mirrored along x, and the cameras taken in the opposite order",
        expectation="the mirrored estimate, the sign of U_X and of the flow along x changed, within three times the "
        "method's own error",
        remedy="look for signs and offsets that are right for one direction only",
    )
