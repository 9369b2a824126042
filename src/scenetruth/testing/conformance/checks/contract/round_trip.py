"""The estimate can be saved, loaded and pickled, and is the same afterwards."""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path

import xarray as xr

from scenetruth.errors import ScenetruthError
from scenetruth.storage import load, save
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import same_bytes
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_REMEDY = (
    "return plain arrays and attributes of plain values (numbers, texts, lists of them): scenetruth.make_estimate does"
)


def check(bench: Bench) -> None:
    """Take both ways."""
    estimate = bench.plain
    wrong = []
    try:
        pickled: xr.Dataset = pickle.loads(pickle.dumps(estimate))
        wrong += [f"{name} changes when pickled" for name in same_bytes(estimate, pickled)]
    except Exception as error:  # whatever an attribute raises
        wrong.append(f"it cannot be pickled: {type(error).__name__}: {error}")
    with tempfile.TemporaryDirectory() as folder:
        try:
            save(estimate, Path(folder) / "estimate.zarr")
            loaded = load(Path(folder) / "estimate.zarr", "estimate")
            wrong += [f"{name} changes when saved and loaded" for name in same_bytes(estimate, loaded)]
        except (ScenetruthError, TypeError, ValueError) as error:
            wrong.append(f"it cannot be saved and loaded: {' '.join(str(error).split())}")
    if wrong:
        raise Deviation("the estimate was pickled, and saved and loaded", "the same bytes", "; ".join(wrong), _REMEDY)
