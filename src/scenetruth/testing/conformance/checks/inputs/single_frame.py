"""A single frame is refused as methods refuse, or gives depth that is right."""

from __future__ import annotations

from dataclasses import replace

from scenetruth.estimators.returned import returned_problems
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_in_the_middle, scalar_maps
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Leave the reference frame alone."""
    plane = replace(bench.plane, frames=1)
    recording = plane.recording()
    found = bench.estimate_if_it_suits(recording)
    done = "the plain recording's reference frame was estimated without the others"
    remedy = "say Needs(frames=2) if the method needs two; else give depth alone, motion NaN"
    wrong = [str(problem) for problem in returned_problems(found, recording, bench.method.gives)]
    if wrong:
        raise Deviation(done, "an error of scenetruth.errors, or an estimate of the form", "; ".join(wrong), remedy)
    near_in_the_middle(scalar_maps(found), plane.truth(), ("depth", "disparity"), done=done, remedy=remedy)
