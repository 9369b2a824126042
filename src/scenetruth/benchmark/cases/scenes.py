"""The case that runs the bundled scenes."""

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
"""Growth per frame below this value is rounding error."""


class GalleryCase(Case):
    """Every scene of the directory ``scenes``, with its own sensor and noise."""

    kind = "gallery"
    title = "Gallery"
    question = "What accuracy is reached on complete scenes?"
    varied = "scene"
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")

    @staticmethod
    @cache
    def files() -> tuple[Path, ...]:
        """Return the files of the bundled scenes."""
        return tuple(bundled_files().values())

    def labels(self) -> Mapping[float, str]:
        """Return the names of the scenes, numbered in alphabetical order."""
        return {float(number): file.stem for number, file in enumerate(self.files())}

    def values(self, suite: str) -> tuple[float, ...]:
        """Return the numbers of the scenes, in the suite ``full`` only."""
        return tuple(self.labels()) if suite == "full" else ()

    def lacks(self) -> str:
        """Return that the directory of scenes is required, if it is missing."""
        return (
            ""
            if self.files()
            else "needs the folder scenes/, which only a checkout of the project has: run it from one"
        )

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the scene of this number: five of its frames, ray-cast."""
        plain = load_scene(self.files()[int(value)], overrides=_CHANGES).to_dict()
        # The methods are those of the comparison.
        plain.pop("estimate", None)
        return plain

    def noise_std(self, value: float) -> float:
        """Return 0, because each scene has a sensor model with noise."""
        return 0.0

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the interior that is visible in all images."""
        return np.asarray(super().region_at(truth, value) & truth["seen_throughout"].values)

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the errors of windowed growth in %/h, for scenes with growth."""
        grows = float(np.nanmax(np.abs(found.truth["growth_rate"].values))) > _STILL
        return compute_growth_records(self, found) if grows else ()
