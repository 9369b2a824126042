"""What is not known is NaN, not 0 or infinite; depths are positive; `kind` says the same as the maps."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.errors import ScenetruthError
from scenetruth.schema import KIND_NONE, VARIABLES
from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.deviation import Deviation

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_KINDS = {"kind_disparity": ("depth", "disparity"), "kind_motion": ("flow",)}


def check(bench: Bench) -> None:
    """Look at the plain recording, and at one whose right third shows nothing."""
    blank = bench.plane.images()
    blank[:, :, :, -(blank.shape[3] // 3) :] = 0.5
    wrong = _wrong(bench.plain, bench)
    try:
        found = bench.estimate(bench.plane.recording(blank))
    except ScenetruthError:
        # Who needs texture everywhere may say so.
        pass
    else:
        wrong += [f"{told}, where a third of the images is blank" for told in _wrong(found, bench)]
    if wrong:
        raise Deviation(
            "the plain recording was estimated, and one whose right third is a single grey value",
            "NaN wherever there is no estimate, and `kind` none exactly there",
            "; ".join(wrong),
            "write NaN where nothing is known; scenetruth.make_estimate makes the kinds from that",
        )


def _wrong(found: xr.Dataset, bench: Bench) -> list[str]:
    wrong = []
    for name in map(str, found.data_vars):
        if name in VARIABLES["estimate"] and found[name].dtype.kind == "f" and not name.endswith("_std"):
            count = int(np.isinf(found[name].values).sum())
            wrong += [f"{name} holds {count} infinite values"] if count else []
    sign = np.sign(bench.plane.baseline_mm)
    for name, positive in (("depth", 1.0), ("disparity", sign)):
        if name in found:
            count = int((found[name].values * positive <= 0).sum())
            wrong += [f"{name} holds {count} values that are zero or of the wrong sign"] if count else []
    for kind, names in _KINDS.items():
        for name in names:
            if kind not in found or name not in found:
                continue
            known = np.isfinite(found[name].values)
            # Of a flow, both components.
            known = known if known.ndim == found[kind].ndim else known.all(axis=0)
            count = int((known == (found[kind].values == KIND_NONE)).sum())
            wrong += [f"{kind} and {name} contradict each other in {count} pixels"] if count else []
    return wrong
