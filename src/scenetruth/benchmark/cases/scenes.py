"""The case that goes through the bundled scenes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from scenetruth.benchmark.cases.case import BenchmarkRecord, Case, CaseEstimates, Mask
from scenetruth.benchmark.error_statistics import compute_growth_records
from scenetruth.input_files import bundled_files
from scenetruth.scene import load_scene

__all__ = ["GalleryCase"]

_CHANGES = ("render.backend=raycast", "frames.count=5")
_STILL = 1e-9
"""Rounding makes what does not grow grow by less than this, per frame."""


class GalleryCase(Case):
    """Every scene of the folder ``scenes``, with its own sensor and its noise."""

    kind = "gallery"
    title = "Gallery"
    question = "What does it make of whole scenes?"
    varied = "scene"
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")

    def labels(self) -> Mapping[float, str]:
        """Return the names of the scenes, numbered in the order of the alphabet."""
        return {float(number): file.stem for number, file in enumerate(scene_files())}

    def values(self, suite: str) -> tuple[float, ...]:
        """Return the numbers of the scenes, of the suite ``full`` alone."""
        return tuple(self.labels()) if suite == "full" else ()

    def lacks(self) -> str:
        """Return that the folder is needed, where it is not there."""
        return (
            ""
            if scene_files()
            else "needs the folder scenes/, which only a checkout of the project has: run it from one"
        )

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the scene of this number: five of its frames, ray-cast."""
        plain = load_scene(scene_files()[int(value)], overrides=_CHANGES).to_dict()
        # Methods are those of the comparison.
        plain.pop("estimate", None)
        return plain

    def noise_std(self, value: float) -> float:
        """Return none: each scene has a sensor of its own."""
        return 0.0

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the interior, of what all images show."""
        return np.asarray(super().region_at(truth, value) & truth["seen_throughout"].values)

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the errors of the growth rate over windows, in % per hour, where anything grows."""
        grows = float(np.nanmax(np.abs(found.truth["growth_rate"].values))) > _STILL
        return compute_growth_records(self, found) if grows else ()


@cache
def scene_files() -> tuple[Path, ...]:
    """Return the files of the scenes that are shipped."""
    return tuple(bundled_files().values())
