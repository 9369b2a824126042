"""Frames from the reference on, told by `t`, are estimated as such: no others are told, and they are right."""

from __future__ import annotations

from dataclasses import replace

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_in_the_middle, scalar_maps
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Leave out what comes before t = 0."""
    count = max(2, bench.method.needs.frames)
    plane = replace(bench.plane, frames=2 * count - 1)
    recording = plane.recording().sel(t=slice(0, None))
    found = bench.estimate_if_it_suits(recording)
    done = f"only the frames t = {recording['t'].values.tolist()} were there"
    remedy = "take frame numbers from recording['t'], and say by t= of scenetruth.make_estimate which are estimated"
    others = sorted(set(found["t"].values.tolist()) - set(recording["t"].values.tolist()))
    if others:
        raise Deviation(done, "estimates of these frames", f"estimates of the frames {others} too", remedy)
    near_in_the_middle(
        scalar_maps(found),
        plane.truth(),
        ("depth", "disparity", "flow_x", "flow_y"),
        done=done,
        remedy=remedy,
    )
