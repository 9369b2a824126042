"""Depth and disparity say the same, and so do flow, depth and velocity."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import agree, near_to_rounding

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Make one from the others."""
    maps, plane = bench.maps, bench.plane
    done = "one map of the plain recording's estimate was computed from the others"
    remedy = "scenetruth.make_estimate derives what follows: give it disparity and flow, or depth and velocity, only"
    if "depth" in maps and "disparity" in maps:
        follows = plane.focal_length_px * plane.baseline_mm / maps["disparity"]
        near_to_rounding(
            {"depth": follows},
            {"depth": maps["depth"]},
            done=done,
            expectation="depth = f V_X / disparity",
            remedy=remedy,
        )
    moving = ("depth", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
    if all(name in maps for name in moving):
        c_x, c_y = plane.centre_px
        f, depth = plane.focal_length_px, maps["depth"]
        found = {
            f"flow_{axis}": (f * maps[f"velocity_{axis}"] - (depth[axis] - centre) * maps["velocity_z"]) / depth
            for axis, centre in (("x", c_x), ("y", c_y))
        }
        both = {name: maps[name].where(np.isfinite(found[name])) for name in found}
        limits = bench.tolerances()
        agree(
            found,
            both,
            {name: limits[name] for name in found},
            done=done,
            expectation="flow = (f U_X - x' U_Z, f U_Y - y' U_Z) / Z within the method's own error, x' from the "
            "principal point",
            remedy=remedy,
        )
