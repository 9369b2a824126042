"""Played backwards, depth stays and flow and velocity change their sign."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import changed_sign, scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(odd_frames=True, frames=3)


def check(bench: Bench) -> None:
    """Take the frames in the opposite order."""
    found = scalar_maps(bench.estimate(bench.plane.recording(bench.plane.images()[:, ::-1])))
    back = {name: item.assign_coords(t=-item["t"]).sortby("t") for name, item in found.items()}
    motion = ("flow_x", "flow_y", "velocity_x", "velocity_y", "velocity_z")
    bench.agrees(
        changed_sign(back, motion),
        done="the frames were taken in the opposite order",
        expectation="the same depth, and the opposite flow and velocity, within three times the method's own error",
        remedy="look for what is one-sided in time: flow belongs to the frame itself, forward, px per frame",
    )
