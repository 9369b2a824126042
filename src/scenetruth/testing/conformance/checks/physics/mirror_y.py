"""In a mirror, above and below exchanged, depth is mirrored and U_Y changes its sign."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import changed_sign, flipped, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Turn the images upside down."""
    images = bench.plane.images()[:, :, ::-1]
    found = flipped(scalar_maps(bench.estimate(bench.plane.recording(images))), "y")
    bench.agrees(
        changed_sign(found, ("flow_y", "velocity_y")),
        done="the images were mirrored along y",
        expectation="the mirrored estimate, the sign of U_Y and of the flow along y changed, within three times the "
        "method's own error",
        remedy="look for signs and offsets that are right for one direction only",
    )
