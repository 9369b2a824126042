"""Images that cannot be written to, as `scenetruth.estimate` hands them over, give the same estimate."""

from __future__ import annotations

from scenetruth.estimators import estimate
from scenetruth.estimators.returned import returned_problems
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import near_to_rounding, scalar_maps
from scenetruth.testing.conformance.deviation import NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Take the way of users."""
    if returned_problems(bench.plain, bench.recording(), bench.method.gives):
        msg = "scenetruth.estimate refuses what the method returns: see 'form' and 'gives_what_it_promises'"
        raise NotApplicable(msg)
    found = estimate(bench.recording(), bench.method, bench.settings)
    near_to_rounding(
        scalar_maps(found),
        scalar_maps(bench.plain),
        done="scenetruth.estimate was called, which makes the recording's arrays read-only",
        expectation="the same estimate as with arrays that can be written to",
        remedy="work on copies, whether or not arrays can be written to",
    )
