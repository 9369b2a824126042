"""A `StreamingMethod` gives frame by frame, from a store that is read as needed, what it gives in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators import StreamingMethod, prepare
from scenetruth.schema import Filling
from scenetruth.storage import open_store, save
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import same_bytes
from scenetruth.testing.conformance.deviation import Deviation, NotApplicable

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_MORE_FRAMES = 2


def check(bench: Bench) -> None:
    """Estimate a longer recording both ways, and watch which maps are put."""
    method = bench.method
    if not isinstance(method, StreamingMethod):
        msg = "the method is no StreamingMethod: it has all images in memory at once"
        raise NotApplicable(msg)
    recording = replace(bench.plane, frames=bench.plane.frames + _MORE_FRAMES).recording()
    whole = bench.estimate(recording)
    puts: dict[str, NDArray[np.int64]] = {}
    with tempfile.TemporaryDirectory() as folder:
        save(recording, Path(folder) / "recording.zarr")
        opened = open_store(Path(folder) / "recording.zarr", "recording")
        estimation = prepare(opened, method, bench.settings)
        blank = estimation.blank()
        assert blank is not None
        filling = Filling(blank)

        def put(name: str, at: Mapping[str, int], values: NDArray[Any]) -> None:
            variable = blank.variables[name]
            counts = puts.setdefault(name, np.zeros(variable.shape, dtype=np.int64))
            counts[tuple(at.get(str(dim), slice(None)) for dim in variable.dims)] += 1
            filling.put(name, at, np.array(values))

        estimation.fill(put)
        found = filling.dataset()
    wrong = [f"{name} differs" for name in same_bytes(whole, found)]
    for name in map(str, blank.data_vars):
        counts = puts.get(name, np.zeros(1, dtype=np.int64))
        if (counts != 1).any():
            wrong.append(f"values of {name} were put {counts.min()} to {counts.max()} times")
    if wrong:
        sizes = dict(recording["image"].sizes)
        raise Deviation(
            f"a recording of {sizes} was saved, opened without loading it, and estimated by `blank` and `fill`",
            "every map put once, with the same bytes as of `estimate`",
            "; ".join(wrong),
            "put every map of every frame of `blank`, and let `estimate` be what StreamingMethod makes of them",
        )
