"""Other frame numbers for the same images change the numbers in the estimate, and nothing else."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need(frames=2)


def check(bench: Bench) -> None:
    """Let the first frame be the reference, t = 0."""
    recording = bench.recording()
    later = -int(recording["t"].values[0]) or -int(np.ptp(recording["t"].values))
    interval = float(recording.attrs["frame_interval_s"])
    numbers = recording["t"].values + later
    found = scalar_maps(
        bench.estimate_if_it_suits(recording.assign_coords(t=numbers, time_s=("t", interval * numbers)))
    )
    bench.agrees(
        {name: item.assign_coords(t=item["t"] - later) for name, item in found.items()},
        done=f"the frames were numbered {numbers.tolist()} instead of {recording['t'].values.tolist()}",
        expectation="the same estimate of the same images, within the method's own error",
        remedy="take frame numbers from recording['t'], and give them back by t= of scenetruth.make_estimate",
        factor=1.0,
    )
