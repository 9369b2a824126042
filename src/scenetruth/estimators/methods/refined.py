"""The refined method: one least-squares fit of all images to a surface that moves, turns and grows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.estimators.refined.settings import RefinedSettings
from scenetruth.progress import Progress
from scenetruth.schema import Put

__all__ = ["METHOD"]


class _Refined(StreamingMethod):
    """Depth, slopes, 3D motion and growth of every pixel from all images at once."""

    name = "refined"
    settings = RefinedSettings
    gives: frozenset[str] = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(images=2)

    def requirements(self, recording: xr.Dataset, settings: RefinedSettings) -> list[Problem]:
        from scenetruth.estimators.structure_tensor.rig import requirements
        from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings

        # It starts from the structure tensor's estimate.
        sizes = recording["image"].sizes
        return requirements(StructureTensorSettings(), sizes["s"], sizes["t"], sizes["x"], sizes["y"])

    def blank(self, recording: xr.Dataset, settings: RefinedSettings) -> xr.Dataset:
        from scenetruth.estimators.refined.method import blank_estimate

        return blank_estimate(recording, settings)

    def fill(
        self, recording: xr.Dataset, settings: RefinedSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        from scenetruth.estimators.refined.method import fill_estimate

        return fill_estimate(recording, settings, put, progress)


METHOD = _Refined()
