"""A principal point beside the image's centre changes flow and velocity as it must."""

from __future__ import annotations

from dataclasses import replace

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(any_of=("depth", "disparity", "flow_x", "velocity_x"))
_ASIDE_PX = (16.0, -14.0)


def check(bench: Bench) -> None:
    """Shift the lens sideways, so that the same plane is seen by another part of the image plane."""
    c_x, c_y = bench.plane.centre_px
    plane = replace(bench.plane, principal_point_px=(c_x + _ASIDE_PX[0], c_y + _ASIDE_PX[1]))
    found = scalar_maps(bench.estimate(plane.recording()))
    bench.agrees(
        found,
        bench.known_of(plane.truth()),
        done=f"the plane was seen with the principal point {_ASIDE_PX} px beside the image's centre",
        expectation="the truth, within three times the method's own error on the plain recording",
        remedy="count x and y from recording.attrs['principal_point_px'], not from the image's centre",
    )
