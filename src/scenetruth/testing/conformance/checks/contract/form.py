"""The estimate has the agreed dimensions, units and types, and the frames, pixels and intrinsics of its recording."""

from __future__ import annotations

import numpy as np

from scenetruth.estimators.returned import returned_problems
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need(plain=False)
_INTRINSICS = ("focal_length_px", "principal_point_px", "baseline_mm", "frame_interval_s")


def check(bench: Bench) -> None:
    """Look at what the method returns for the lower right part of the plain recording, whose pixels begin elsewhere."""
    recording = bench.recording()
    part = recording.isel(y=slice(1, None), x=slice(2, None))
    found = bench.estimate_if_it_suits(part)
    wrong = [str(problem) for problem in returned_problems(found, part, frozenset())]
    wrong += [
        f"{name} begins at {found[name].values[:1]}, that of the recording at {part[name].values[:1]}"
        for name in ("y", "x")
        if name in found.coords and not np.array_equal(found[name].values, part[name].values)
    ]
    wrong += [
        f"attrs.{name} is {found.attrs.get(name)}, that of the recording {part.attrs[name]}"
        for name in _INTRINSICS
        if not np.array_equal(np.asarray(found.attrs.get(name)), np.asarray(part.attrs[name]))
    ]
    if wrong:
        raise Deviation(
            "a part of the plain recording was estimated, without its first row and its first two columns",
            "an estimate of this part, of the form in docs/variables.md",
            "; ".join(dict.fromkeys(wrong)),
            "return scenetruth.make_estimate(like=recording, ...), which puts all of that on plain arrays",
        )
