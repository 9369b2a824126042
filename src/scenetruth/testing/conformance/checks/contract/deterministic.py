"""Two calls with the same recording give the same bytes."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import same_bytes
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Estimate again."""
    again = bench.estimate(bench.recording())
    differing = same_bytes(bench.plain, again)
    if differing:
        raise Deviation(
            "the plain recording was estimated twice",
            "the same bytes",
            f"they differ in {', '.join(differing)}",
            "seed random numbers with a setting (numpy.random.default_rng(settings.seed)), keep nothing between calls, "
            "and sum in the same order whichever thread is first",
        )
