"""The recording is as it was when the method returns: images, coordinates and attributes."""

from __future__ import annotations

import copy

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import same_bytes
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Hand over arrays that can be written to, and look at them afterwards."""
    recording = bench.recording()
    before, attributes = recording.copy(deep=True), copy.deepcopy(recording.attrs)
    of_variables = {name: copy.deepcopy(item.attrs) for name, item in recording.variables.items()}
    bench.estimate(recording)
    changed = [*same_bytes(before, recording)]
    changed += [f"attrs.{name}" for name in sorted({*attributes, *recording.attrs}, key=str)
                if attributes.get(name) != recording.attrs.get(name)]  # fmt: skip
    changed += [
        f"{name}.attrs" for name, item in recording.variables.items() if item.attrs != of_variables.get(name, {})
    ]
    if changed:
        raise Deviation(
            "the plain recording was handed over in arrays that can be written to",
            "the recording as it was",
            f"changed: {', '.join(map(str, changed))}",
            "work on copies: recording['image'].values.copy(), dict(recording.attrs)",
        )
