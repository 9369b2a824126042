"""A method that has `thread_safe = True` gives in two threads at once what it gives alone."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import xarray as xr

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import same_bytes
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_ROUNDS = 3


def check(bench: Bench) -> None:
    """Estimate two recordings at once, which differ, so that what is shared shows."""
    if not bench.says_it_is_thread_safe:
        msg = "the method does not say that it is thread-safe: it has no attribute thread_safe = True"
        raise NotApplicable(msg)
    plain = bench.recording()
    upside_down = bench.plane.recording(bench.plane.images()[:, :, ::-1])
    recordings = (plain, upside_down)
    alone = [bench.estimate(recording.copy(deep=True)) for recording in recordings]
    together = Barrier(len(recordings))

    def work(recording: xr.Dataset) -> xr.Dataset:
        together.wait(timeout=60)
        return bench.estimate(recording.copy(deep=True))

    differing: set[str] = set()
    with ThreadPoolExecutor(len(recordings)) as threads:
        for _ in range(_ROUNDS):
            for one, other in zip(alone, threads.map(work, recordings), strict=True):
                differing |= set(same_bytes(one, other))
    if differing:
        raise Deviation(
            f"two recordings were estimated in two threads at once, {_ROUNDS} times",
            "the same bytes as alone",
            f"they differ in {', '.join(sorted(differing))}",
            "keep what a call works on in local variables, not in the method or in globals; or take thread_safe away",
        )
