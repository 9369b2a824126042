"""The paper's method: one 4D structure tensor gives disparity and 3D motion."""

from __future__ import annotations

import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators.protocol import Method, Needs
from scenetruth.progress import Progress
from scenetruth.settings import EstimateSettings

__all__ = ["METHOD"]


class _StructureTensor(Method):
    name = "structure_tensor"
    settings = EstimateSettings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(images=2)

    def requirements(self, recording: xr.Dataset, settings: EstimateSettings) -> list[Problem]:
        from scenetruth.estimators.structure_tensor.rig import requirements

        sizes = recording["image"].sizes
        return requirements(settings, sizes["s"], sizes["t"], sizes["x"], sizes["y"])

    def estimate(self, recording: xr.Dataset, settings: EstimateSettings, progress: Progress | None) -> xr.Dataset:
        from scenetruth.estimators.structure_tensor.method import estimate_structure_tensor

        return estimate_structure_tensor(recording, settings, progress)


METHOD = _StructureTensor()
