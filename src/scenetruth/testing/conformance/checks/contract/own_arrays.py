"""The estimate's arrays are its own: they share no memory with the recording, nor with the estimate of another call."""

from __future__ import annotations

import numpy as np

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()


def check(bench: Bench) -> None:
    """Compare addresses."""
    recording = bench.recording()
    first, second = bench.estimate(recording), bench.estimate(recording)
    wrong = []
    for name, variable in first.data_vars.items():
        values = variable.values
        wrong += [
            f"{name} shares memory with the recording's {other}"
            for other, item in recording.variables.items()
            if np.may_share_memory(values, item.values) and values.size
        ]
        if name in second and np.may_share_memory(values, second[name].values) and values.size:
            wrong.append(f"{name} shares memory with that of the next call")
    if wrong:
        raise Deviation(
            "the plain recording was estimated twice, and the addresses of all arrays were compared",
            "arrays of its own in each estimate",
            "; ".join(wrong),
            "return copies (array.copy()), and make new arrays in every call",
        )
